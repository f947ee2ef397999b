"""The result of a structure's fit: its parameters, how sure they are, and the function
they make.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fraclink._display import displayed
from fraclink._files import document, load, save
from fraclink._identify.expression import parse_expression
from fraclink._identify.problem import Interval
from fraclink.errors import SizeError
from fraclink.findings import Finding, errors_of
from fracsys._fractional import FractionalTransferFunction
from fracsys.checks.equality import compared

__all__ = ["StructureFit"]

Reals = NDArray[np.float64]

_SAMPLES_MOST = (
    300_000  # 47 bytes a sample, against the 16 MB that a JSON file may have
)


def _check_size(fit: StructureFit) -> None:
    if fit.predicted.size > _SAMPLES_MOST:
        allowed, remedy = f"<= {_SAMPLES_MOST}", "fit a part of the recording"
        raise SizeError(
            "samples",
            fit.predicted.size,
            "too many to save",
            allowed=allowed,
            remedy=remedy,
        )


@displayed
@document(
    "structure-fit",
    period=lambda fit: fit.period,
    sources=lambda fit: {fit.source: fit.sha256} if fit.sha256 else {},
    summary=lambda fit: {"passed": fit.passed, "text": str(fit)},
    before_save=_check_size,
)
@compared
@dataclass(frozen=True, eq=False, repr=False)
class StructureFit:
    """A structure of one's own, fitted to a recording or to a frequency response.

    Parameters
    ----------
    expression
        the transfer function as it was given, such as ``"k/(T*s**a + 1)"``.
    parameters
        value of every parameter, in the order of the text.
    fixed
        those that were given and not fitted.
    limits
        range of every fitted parameter.
    intervals
        95 % intervals; an open end is a limit of the range that is not excluded. A
        parameter that ended at a limit, or that the data do not tell from others, has
        none.
    standard_errors
        of the parameters with an interval; colour of the residual is allowed for.
    at_bound
        parameters that ended at a limit of their range.
    undetermined
        parameters that the data do not determine, whatever their value says.
    offset
        constant part of a recording's output.
    domain
        "time" or "frequency".
    period, hold
        sampling period [s] and what the input does between samples; None for a
        frequency response.
    fitted
        samples (or lines) that the parameters come from; later samples are held out.
    nmse
        squared error over the squared (output − offset); relative to each line for a
        frequency response.
    heldout_nmse
        the same over the samples held out, or over every fourth line, predicted from
        the others; None where none were.
    place
        time [s] of the samples, or frequency [rad/s] of the lines, shape (N,).
    measured, predicted
        output of the recording, shape (N,); of a frequency response the real parts,
        then the imaginary ones, shape (2N,).
    converged, evaluations
        whether the descent met its tolerance, and the candidates that it took.
    findings
        codes W35x; one of severity "error" means that the parameters are not to be
        believed.
    source, sha256
        of the data.

    Examples
    --------
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
    domain: Literal["time", "frequency"]
    period: float | None
    hold: Literal["zero", "first"] | None
    fitted: int
    nmse: float
    heldout_nmse: float | None
    place: Reals
    measured: Reals
    predicted: Reals
    converged: bool
    evaluations: int
    findings: tuple[Finding, ...] = ()
    source: str = ""
    sha256: str = ""

    __made_by__ = "fraclink.identify_structure(data, expression)"

    def __post_init__(self) -> None:
        for name in ("parameters", "limits", "intervals", "standard_errors"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))
        for name in ("place", "measured", "predicted"):
            # Copies that cannot be written: a fit that is hashed, cached and drawn must
            # not change behind them.
            array = np.array(getattr(self, name), dtype=np.float64)
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def __repr__(self) -> str:
        values = ", ".join(
            f"{name} = {value:.5g}" for name, value in self.parameters.items()
        )
        return f"StructureFit({self.expression}: {values})"

    def __str__(self) -> str:
        rows = [self._row(name) for name in self.parameters]
        error = f"error {100 * self.nmse:.3g} % (NMSE), {self._held}"
        return "\n".join([self.expression, *rows, error, *map(str, self.findings)])

    def _row(self, name: str) -> str:
        value = f"{name} = {self.parameters[name]:.6g}"
        if name in self.fixed:
            return f"{value} (given)"
        # An interval that determines nothing is in the data and not in the text: a
        # reader would quote it.
        if name in self.intervals and name not in self.undetermined:
            return f"{value}, 95 % {self.intervals[name].low:.6g} to {self.intervals[name].high:.6g}"
        return (
            f"{value} ({'at its bound' if name in self.at_bound else 'not determined'})"
        )

    @property
    def _held(self) -> str:
        held = self.heldout_nmse
        return (
            "nothing held out" if held is None else f"held-out error {100 * held:.3g} %"
        )

    @property
    def passed(self) -> bool:
        """Whether the data determine the parameters: no finding of severity "error"."""
        return not errors_of(self.findings)

    @cached_property
    def transfer_function(self) -> FractionalTransferFunction:
        """The exact function, for `step_response`, `margins`, `poles`, `time_response`
        and all else.
        """
        return parse_expression(self.expression).function(self.parameters)

    def save(self, path: Path | str) -> None:
        """Write the fit as JSON, complete or not at all; `load` reads back an equal
        one.
        """
        save(self, path, force=True)

    @classmethod
    def load(cls, path: Path | str) -> StructureFit:
        """Read a fit that `save` wrote; raises FileFormatError where the file is
        another or damaged.
        """
        return load(path, cls)
