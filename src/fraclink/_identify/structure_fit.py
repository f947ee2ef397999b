"""The result of a structure's fit: its parameters with their uncertainty, and the
resulting transfer function.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Literal

from fraclink._display import Overview, Row, Table, displayed, number, quantity, rows_of
from fraclink._files import Saved, document
from fraclink._identify.expression import parse_expression
from fraclink._identify.problem import Interval
from fraclink.findings import Finding, Judged
from fracsys._fractional import FractionalTransferFunction
from fracsys.checks import Real, checked
from fracsys.checks.equality import compared


@displayed
@document(
    "structure-fit",
    version=2,
    container="either",
    summary=lambda fit: {"passed": fit.passed, "text": fit.overview().headline},
)
@compared
@checked
@dataclass(frozen=True, eq=False, repr=False)
class StructureFit(Judged, Saved):
    """A user-defined structure, fitted to a recording or to a frequency response.

    Parameters
    ----------
    expression
        the transfer function as it was given, such as ``"k/(T*s**a + 1)"``.
    parameters
        value of every parameter, in the order of the text.
    fixed
        names of the parameters that were given, not fitted.
    limits
        range of every fitted parameter.
    intervals
        95 % intervals; an open end is a limit of the range that is not excluded. A
        parameter that ended at a limit, or that the data do not tell from others, has
        none.
    standard_errors
        of the parameters with an interval; they allow for the residual's colour.
    at_bound
        parameters that ended at a limit of their range.
    undetermined
        parameters that the data do not determine, whatever value is stated.
    offset
        constant part of a recording's output.
    period, hold
        sampling period [s] and what the input does between samples; None for a
        frequency response.
    fitted
        samples (or lines) that the parameters come from; later samples are held out.
    nmse
        squared error over the squared (output − offset); relative to each line for a
        frequency response.
    heldout_nmse
        the same over the samples held out, or of every line as predicted from all
        others; None if nothing was held out.
    place
        time [s] of the samples, or frequency [rad/s] of the lines, shape (N,).
    measured, predicted
        output of the recording, shape (N,); of a frequency response the real parts,
        then the imaginary ones, shape (2N,).
    converged
        whether the descent met its tolerance.
    findings
        codes W3xx; one of severity "error" means that the parameters must not be
        trusted.
    source, sha256
        of the data.

    Examples
    --------
    >>> import numpy as np
    >>> import fraclink as fl
    >>> import fracsys
    >>> G, w = 2 / (fracsys.s**0.8 + 3), np.geomspace(0.1, 100, 60)
    >>> measured = fl.FrequencyResponse(w, G(1j * w))
    >>> fit = fl.identify_structure(measured, "k/(s**a + b)")
    >>> {name: round(value, 6) for name, value in fit.parameters.items()}, fit.passed
    ({'k': 2.0, 'a': 0.8, 'b': 3.0}, True)
    """

    expression: str
    parameters: Mapping[str, float]
    fixed: tuple[str, ...]
    limits: Mapping[str, tuple[float, float]]
    intervals: Mapping[str, Interval]
    standard_errors: Mapping[str, float]
    at_bound: tuple[str, ...]
    undetermined: tuple[str, ...]
    offset: float
    period: float | None
    hold: Literal["zero", "first"] | None
    fitted: int
    nmse: float
    heldout_nmse: float | None
    place: Real
    measured: Real
    predicted: Real
    converged: bool
    findings: tuple[Finding, ...] = ()
    source: str = ""
    sha256: str = ""

    __made_by__ = "fraclink.identify_structure(data, expression)"
    # Label and unit of the parameters that have a unit or a label other than their
    # name.
    _labels: ClassVar[Mapping[str, tuple[str, str]]] = {}

    def known(self, name: str) -> str | tuple[float, float]:
        """How well a parameter is known: its 95 % interval, or why it has none."""
        if name in self.fixed:
            return "given"
        # Before the interval: at a bound the curvature is meaningless, and so is an
        # interval from it.
        if name in self.at_bound:
            return "at a bound of its range"
        interval = self.intervals.get(name)
        if interval is None or name in self.undetermined:
            return "not determined"
        return interval.low, interval.high

    def overview(self) -> Overview:
        """The parameters, how well they are known, and how well they predict."""
        figures = [
            (name, self._labels.get(name, (name, "")), value)
            for name, value in self.parameters.items()
        ]
        parameters = (
            (
                Row("name", "parameter" if self._labels else self.expression, label),
                Row("value", "value", value, unit, digits=6),
                Row("known", "95 % interval", self.known(name), unit, digits=5),
            )
            for name, (label, unit), value in figures
        )
        rows = rows_of(
            self,
            *("expression", "parameters", "intervals", "standard_errors", "at_bound"),
            "undetermined",
            "offset",
            "nmse",
            "heldout_nmse",
        )
        values = ", ".join(f"{n} = {number(v)}" for n, v in self.parameters.items())
        # For data without noise the residual is rounding, which depends on the machine.
        error, heldout = (
            None if share is None else quantity(round(share, 12), "%", 2)
            for share in (self.nmse, self.heldout_nmse)
        )
        return Overview(
            f"{self.expression}: {values}; error {error}, "
            + (f"held-out error {heldout}" if heldout else "nothing held out"),
            "passed" if self.passed else "not shown",
            rows,
            (Table.of("", parameters),),
            self.findings,
            (f"G(s) = {self.transfer_function}",),
        )

    @cached_property
    def transfer_function(self) -> FractionalTransferFunction:
        """The exact function, for `step_response`, `margins`, `poles`, `time_response`
        and all else.
        """
        return parse_expression(self.expression).function(self.parameters)
