"""A fit: the identified link with everything needed to judge it, and its file."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from fraclink._arm.box import in_loop
from fraclink._arm.link import FRACTIONAL, LinkModel, structure
from fraclink._display import Overview, Row, displayed, number, rows_of
from fraclink._files import Saved, document
from fraclink._identify.problem import Interval
from fraclink._identify.residual import ResidualTests
from fraclink.findings import Finding, Findings, Judged
from fracsys.checks import Real, checked
from fracsys.checks.equality import compared

if TYPE_CHECKING:
    from fraclink._arm.experiment import Experiment
    from fraclink._arm.rig import Rig
    from fraclink._identify.validation import Validation

SYMBOLS = {
    "natural_frequency": ("ω₀", "s^(−λ/2)"),
    "order": ("λ", ""),
    "damping": ("μ", "s^(α−λ)"),
    "damping_order": ("α", ""),
}


def aic(mse: float, samples: int, parameters: int) -> float:
    """Return Akaike's criterion 2k + n ln(MSE), equation (18); lower is better.

    Parameters
    ----------
    mse
        mean squared error > 0 [unit of the output, squared].
    samples
        n, number of fitted samples.
    parameters
        k of the structure (1, 2, 2, 3 in the order of the table).

    Examples
    --------
    With n = 5001 it gives Table 2 of the paper:

    >>> [round(aic(mse, 5001, k)) for mse, k in ((0.05845, 1), (0.00531, 2), (0.00524, 2), (0.00524, 3))]
    [-14199, -26192, -26258, -26256]
    """
    # The likelihood of a perfect fit is unbounded; simulated logs without noise have
    # such fits.
    return 2.0 * parameters + samples * math.log(mse) if mse > 0 else -math.inf


@displayed
@document(
    "fit",
    version=5,
    container="either",
    summary=lambda fit: {"passed": fit.passed, "text": fit.overview().headline},
)
@compared
@checked
@dataclass(frozen=True, eq=False, repr=False)
class Fit(Judged, Saved):
    """One structure fitted to one log.

        output(t) = gain · y(t − delay) + offset,    Y = (s^λ/(s^λ + μ s^α + ω₀²)) Θm

    Parameters
    ----------
    structure
        the structure that was fitted, a key of the table in `fraclink._arm.link`.
    model
        the link with everything else that the log showed about it: gauge delay, gauge
        gain, second mode and the 95 % intervals. For a torque log its stiffness is
        |gain|.
    gain
        output per radian of deflection, with its sign [N·m/rad], or [1] for a
        deflection log.
    offset
        of the gauge [unit of the output].
    delay
        of the output behind the motor angle [s]; negative where the motor angle is the
        later one.
    hold
        what the motor angle was taken to do between samples, "zero" or "first".
    output_kind
        "torque" [N·m] or "deflection" [rad].
    period
        sampling period [s].
    fitted_samples
        samples that the fit has seen; the later ones are held out.
    mse
        mean squared error over the fitted samples [unit², eq. (18)].
    nmse
        mse over the mean square of (output − offset): 0 is perfect, 1 as bad as an arm
        at rest.
    aic
        criterion of the fitted samples, eq. (18); k counts the structure's own
        parameters.
    heldout_mse, heldout_nmse
        the same over the samples held out, up to the last one at which the model
        predicts more than the noise (mse): a ring-down below the noise says nothing.
        None where no samples remain.
    standard_errors
        of the free parameters inside their limits, in their units; with `details`
        they allow for the residual's colour by the sandwich estimate.
    intervals
        95 % profile-likelihood intervals of the link's parameters and the delay.
    at_bound
        parameters that ended on a limit of their range; they have no standard error.
    effective_parameters
        effective number of fitted parameters (nuisances included) under the residual's
        colour, Takeuchi's tr(H⁻¹J); their actual number where the residual is white.
    tests
        of the residual, None without `details`.
    converged
        whether the optimiser met its tolerance.
    predicted, residual
        model and output − model, every sample of the log, shape (N,) [unit].
    findings
        codes W2xx and W3xx, worst first; one of severity "error" means that the model
        must not be used.
    source, sha256
        of the log.

    References
    ----------
    Benftima et al. (2023), section 3.3, Algorithm 1 and equations (17), (18).

    Examples
    --------
    >>> import fraclink as fl
    >>> fit = fl.identify(fl.read_log(fl.bundled_log("prbs_30g")), "UD-FOM", details=False)
    >>> fit.structure, round(fit.model.order, 2), fit.samples, fit.passed
    ('UD-FOM', 1.92, 5001, True)
    >>> print(fit)  # doctest: +ELLIPSIS
    ✓ passed: UD-FOM swings at 11.8... rad/s (1.89 Hz) with 30 g, ...
    ...
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
    heldout_mse: float | None
    heldout_nmse: float | None
    standard_errors: Mapping[str, float]
    intervals: Mapping[str, Interval]
    at_bound: tuple[str, ...]
    effective_parameters: float
    tests: ResidualTests | None
    converged: bool
    predicted: Real
    residual: Real
    findings: tuple[Finding, ...] = ()
    source: str = ""
    sha256: str = ""

    __made_by__ = "fraclink.identify(log)"
    # `validation` fits each log itself and therefore depends on this module; it sets
    # this attribute.
    _validated: ClassVar[Callable[..., Any]]

    def __post_init__(self) -> None:
        object.__setattr__(self, "findings", Findings(self.findings))

    @property
    def rows(self) -> tuple[Row, ...]:
        """The identified figures, each with its standard error."""
        errors, unit = self.standard_errors, OUTPUT_UNITS[self.output_kind]
        link = (
            Row(
                f"model.{name}",
                symbol,
                self._stated(name),
                dimension,
                errors.get(name),
                5,
            )
            for name, (symbol, dimension) in SYMBOLS.items()
        )
        return rows_of(
            self,
            ("structure", "structure"),
            *link,
            "model.stiffness",
            "model.payload",
            Row("delay", "gauge delay", self.delay, "ms", errors.get("delay"), 3),
            Row("gain", "gain", self.gain, f"{unit}/rad", errors.get("gain")),
            Row("offset", "offset", self.offset, unit, errors.get("offset")),
            "mse",
            "nmse",
            ("aic", "AIC", "", 6),
            ("heldout_nmse", "held-out error", "%", 3),
        )

    def _stated(self, name: str) -> float | None:
        """A parameter of the link; None if this structure does not have it."""
        value: float = getattr(self.model, name)
        absent = value == 0 or (name == "damping_order" and self.model.damping == 0)
        # ω₀ = 0 is a bound at which a damped fit may end, and not a frequency.
        default = (
            name not in structure(self.structure).free or name == "natural_frequency"
        )
        return None if absent and default else value

    def overview(self) -> Overview:
        """The link in words, its parameters, and how well they predict."""
        heldout = (
            "nothing held out"
            if self.heldout_nmse is None
            else f"held-out error {number(100 * self.heldout_nmse, 2)} %"
        )
        return Overview(
            f"{self.structure} {self.model.sentence}; {heldout}",
            "passed" if self.passed else "not shown",
            self.rows,
            findings=self.findings,
            notes=coincidence({self.structure: self}),
        )

    @property
    def samples(self) -> int:
        """Number of samples of the log."""
        return int(self.predicted.size)

    def loop_model(self, rig: Rig) -> LinkModel:
        """Return the model as it appears in the control loop of this rig.

        A delay that belongs to the logger and not to the loop (``[gauge] delay_in_loop
        = false`` in the rig file) is left out, and the rig's stiffness stands in where
        the log could show none (W304); everything else that was identified stays.
        """
        model = self.model
        if any(finding.code == "W304" for finding in self.findings):
            # The 1 N·m/rad of such a fit is arbitrary; it would scale the tip estimate
            # θm − Γ/c of the law.
            model = dataclasses.replace(model, stiffness=rig.link.stiffness)
        return in_loop(model, rig)

    def validate(self, *logs: Experiment) -> Validation:
        """Compare the fit with other logs of the same arm: error and bias of its
        prediction, also over frequency, and the link that each log shows by itself.

        Parameters
        ----------
        logs
            one or more, each from rest. If log and fit state their payloads, ω₀ is
            converted to the log's payload by eq. (5).

        Raises
        ------
        FieldError
            no log, or one of the other output kind.

        Examples
        --------
        >>> import fraclink as fl
        >>> fit = fl.identify(fl.read_log(fl.bundled_log("prbs_30g")))
        >>> fit.validate(fl.read_log(fl.bundled_log("pulse_30g")))
        Validation(✓ passed: the model predicts the other log: error 1.33 % (NMSE))
        """
        validation: Validation = self._validated(logs)
        return validation


# --- a fit in words ---------------------------------------------------------------------------------------


OUTPUT_UNITS = {"torque": "N·m", "deflection": "rad"}


def coincidence(fits: Mapping[str, Fit]) -> tuple[str, ...]:
    """Return what the dash of a table means: s²/(s² + μ s^α) is s^(2−α)/(s^(2−α) + μ),
    one model.
    """
    return tuple(
        f"– {name} ended at ω₀ = 0: it is {FRACTIONAL} with "
        f"λ = 2 − α = {2.0 - fit.model.damping_order:.4f}, ω₀ = √μ = {math.sqrt(fit.model.damping):.4f}."
        for name, fit in fits.items()
        if not fit.model.natural_frequency
    )
