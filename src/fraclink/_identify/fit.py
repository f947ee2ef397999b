"""A fit: the identified model with everything needed to judge it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.link import LinkModel, structure
from fraclink._files import read_json, write_json
from fraclink._identify.profile import Interval
from fraclink._identify.statistics import ResidualTests
from fraclink.errors import FieldError, FileFormatError, SizeError
from fraclink.findings import Finding

__all__ = ["Fit", "load_model", "save_model"]

_KIND, _VERSION = "fit", 1
_MODEL_KIND = "model"
_SAMPLES_MOST = 300_000  # 47 bytes a sample, against the 16 MB that read_json admits


@dataclass(frozen=True, eq=False)
class Fit:
    """One structure fitted to one log.

        output(t) = gain · y(t − delay) + offset,    Y = (s^λ/(s^λ + μ s^α + ω₀²)) Θm

    Arguments:
        structure: the structure that was fitted, "UD-IOM", "D-IOM", "UD-FOM" or "D-FOM".
        model: the link; for a torque log its stiffness is |gain|.
        gain: output per radian of deflection, with its sign [N·m/rad], or [1] for a deflection log.
        offset: of the gauge [unit of the output].
        delay: of the output behind the motor angle [s]; negative where the motor angle is the later one.
        hold: what the motor angle was taken to do between samples.
        output_kind: "torque" [N·m] or "deflection" [rad].
        period: sampling period [s].
        fitted_samples: samples the fit has seen; the later ones are held out.
        mse: mean squared error over the fitted samples [unit², eq. (18)].
        nmse: mse over the mean square of (output − offset): 0 is perfect, 1 as bad as an arm at rest.
        aic, bic: criteria of the fitted samples, eq. (18); k counts the structure's own parameters.
        heldout_mse, heldout_nmse: the same over the samples held out; None where none were.
        standard_errors: of the free parameters inside their limits, in their units. Where the residual is
            coloured they come from the sandwich estimate, see `errors_allow_colour`.
        white_standard_errors: what they would be if the residual were white.
        errors_allow_colour: whether `standard_errors` are the sandwich estimate.
        intervals: 95 % profile-likelihood intervals of the link's parameters and the delay.
        at_bound: parameters that ended on a limit of their range; they have no error.
        effective_parameters: fitted parameters (nuisances included) as the residual's colour counts them,
            Takeuchi's tr(H⁻¹J); equal to their number where the residual is white.
        tests: of the residual, None where details were not asked for.
        converged: whether the optimiser met its tolerance; evaluations: passes over the data it took.
        predicted, residual: model and output − model, every sample of the log, shape (N,) [unit].
        findings: codes W3xx.
        source, sha256: of the log.

    Source: the paper, section 3.3, Algorithm 1 and equations (17), (18).

    >>> import fraclink as fl
    >>> fit = fl.identify(fl.read_log(fl.bundled_log("prbs_30g")), "UD-FOM", details=False)
    >>> fit.structure, round(fit.model.order, 2), fit.samples
    ('UD-FOM', 1.92, 5001)
    >>> print(fit)  # doctest: +ELLIPSIS
    UD-FOM: ω₀ = ..., λ = 1.9...
    delay ... ms, offset ...; error ... % (NMSE), held-out error ... %; AIC ...
    """

    structure: str
    model: LinkModel
    gain: float
    offset: float
    delay: float
    hold: Literal["zero", "first"]
    output_kind: str
    period: float
    fitted_samples: int
    mse: float
    nmse: float
    aic: float
    bic: float
    heldout_mse: float | None
    heldout_nmse: float | None
    standard_errors: Mapping[str, float]
    white_standard_errors: Mapping[str, float]
    errors_allow_colour: bool
    intervals: Mapping[str, Interval]
    at_bound: tuple[str, ...]
    effective_parameters: float
    tests: ResidualTests | None
    converged: bool
    evaluations: int
    predicted: NDArray[np.float64] = field(repr=False)
    residual: NDArray[np.float64] = field(repr=False)
    findings: tuple[Finding, ...] = ()
    source: str = ""
    sha256: str = ""

    def __post_init__(self) -> None:
        for name in ("standard_errors", "white_standard_errors", "intervals"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))
        for name in ("predicted", "residual"):
            array = np.array(getattr(self, name), dtype=np.float64)
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Fit):
            return NotImplemented
        return _to_plain(self) == _to_plain(other)

    def __hash__(self) -> int:
        return hash((self.structure, self.model, self.gain, self.offset, self.delay, self.sha256))

    def __str__(self) -> str:
        from fraclink._identify.text import fit_text

        return fit_text(self)

    @property
    def tic(self) -> float:
        """Takeuchi's criterion n ln(MSE) + 2 tr(H⁻¹J): the AIC of a residual that is not white.

        The AIC takes a thousand samples of one slow wiggle for a thousand witnesses; this does not.
        """
        counted = self.effective_parameters + len(self.at_bound)
        return self.aic + 2 * (counted - len(structure(self.structure).free))

    @property
    def samples(self) -> int:
        """Number of samples of the log."""
        return int(self.predicted.size)

    def save(self, path: Path | str) -> None:
        """Write the fit as JSON, complete or not at all; `load` reads back an equal one.

        Raises SizeError where the log is so long that the file could not be read back.
        """
        if self.samples > _SAMPLES_MOST:
            raise SizeError(
                "samples",
                self.samples,
                "too many to save with their residual",
                allowed=f"<= {_SAMPLES_MOST}",
                remedy="fit a part of the log, or keep the link alone with save_model(fit.model, path)",
            )
        write_json(path, _KIND, _VERSION, _to_plain(self))

    @classmethod
    def load(cls, path: Path | str) -> Fit:
        """Read a fit that `save` wrote; FileFormatError where the file is another or damaged."""
        data = read_json(path, _KIND)
        try:
            return _from_plain(data)
        except FieldError:
            raise
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise FileFormatError(
                "file",
                str(path),
                f"damaged ({type(error).__name__}: {error})",
                allowed="a fit written by fraclink",
                remedy="run identify again",
            ) from error


def _to_plain(fit: Fit) -> dict[str, Any]:
    """The fit as plain JSON values."""
    plain: dict[str, Any] = {}
    for item in dataclasses.fields(fit):
        value = getattr(fit, item.name)
        if isinstance(value, np.ndarray):
            value = value.tolist()
        elif isinstance(value, Mapping):
            value = {k: dataclasses.asdict(v) if isinstance(v, Interval) else v for k, v in value.items()}
        elif item.name == "findings":
            value = [
                {name: getattr(f, name) for name in ("code", "severity", "message", "remedy")}
                | {"evidence": dict(f.evidence)}
                for f in value
            ]
        elif isinstance(value, LinkModel | ResidualTests):
            value = dataclasses.asdict(value)
        elif isinstance(value, tuple):
            value = list(value)
        elif isinstance(value, float):
            value = _finite(value)
        plain[item.name] = value
    return plain


def _finite(value: float) -> float:
    # ln(0) of a perfect fit: JSON has no infinity, and the largest double orders the same way.
    return float(np.nan_to_num(value))


def _from_plain(data: dict[str, Any]) -> Fit:
    values = {item.name: data[item.name] for item in dataclasses.fields(Fit)}
    values["model"] = LinkModel(**values["model"])
    values["intervals"] = {name: Interval(**value) for name, value in values["intervals"].items()}
    values["tests"] = ResidualTests(**values["tests"]) if values["tests"] is not None else None
    values["findings"] = tuple(Finding(**value) for value in values["findings"])
    values["at_bound"] = tuple(values["at_bound"])
    return Fit(**values)


def save_model(model: LinkModel, path: Path | str) -> None:
    """Write a link model made by hand as JSON; `load_model` reads it back equal."""
    write_json(path, _MODEL_KIND, 1, {"model": dataclasses.asdict(model)})


def load_model(path: Path | str) -> LinkModel:
    """Read a link model from a file written by `Fit.save` or `save_model`.

    Raises FileFormatError for any other file and FieldError for a value out of its range.
    """
    try:
        return Fit.load(path).model
    except FileFormatError as error:
        if f"of kind '{_MODEL_KIND}'" not in error.problem:
            raise
    data = read_json(path, _MODEL_KIND)
    try:
        return LinkModel(**data["model"])
    except (KeyError, TypeError) as error:
        raise FileFormatError(
            "file",
            str(path),
            f"damaged ({error})",
            allowed="a model written by fraclink",
            remedy="make the file again",
        ) from error
