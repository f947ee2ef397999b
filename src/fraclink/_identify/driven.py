"""A link with its motor, identified from a frequency response whose input is the
amplifier's voltage.

    J θ̈m + ν θ̇m = K V − Γ,    Γ = c (s/z)^λ/((s/z)^λ + 1) θm,    z = ω₀^(2/λ)

so that θm/V = A ((s/z)^λ + 1)/((s² + B s)((s/z)^λ + 1) + m (s/z)^λ) with A = K/J, B =
ν/J and m = c/J: an anti-resonance at z, where the swinging link keeps the motor at
rest, and a peak above it, where both swing.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import Annotated, ClassVar, Literal

import numpy as np

from fraclink._arm.link import LinkModel
from fraclink._arm.recording import FrequencyResponse
from fraclink._display import Overview, number, rows_of
from fraclink._files import document
from fraclink._identify.expression import parse_expression
from fraclink._identify.structure_data import Limits
from fraclink._identify.structure_fit import StructureFit
from fraclink._identify.structure_problem import POSITIVE_LIMITS
from fraclink._identify.structures import Weighting, identify_structure
from fraclink.errors import FieldError, NotConvergedError
from fraclink.findings import Finding, errors_of
from fracsys._loops import as_loop
from fracsys._sweep import gain_slope, sweep, valleys, zeros_of
from fracsys.checks import Positive, above, checked

Output = Literal["motor_angle", "torque"]

# λ up to 2.2: the value of a classical link then lies inside the range, and its
# interval includes 2.
_ORDERS = (1.0, 2.2)
# Motor (1) and link (10): gain, friction and m are linear in numerator and denominator.
_BOTTOM = "((s**2 + B*s)*((s/z)**l + 1) + m*(s/z)**l)*exp(-T*s)"
_STRUCTURES = {
    "motor_angle": f"A*((s/z)**l + 1)/{_BOTTOM}",
    "torque": f"k*(s/z)**l/{_BOTTOM}",
}
# Factor by which a peak may lie outside the band, since its slope extends into it.
_BEYOND = 3.0
_LEAST_OCTAVES = 2  # anti-resonance and peak, with lines on either side of them
# Lines required on either side of a feature for the response to show it: one each for its
# place, its height and its width.
_AROUND = 3


@document(
    "driven-link",
    version=3,
)
@checked
@dataclass(frozen=True, eq=False, repr=False)
class DrivenLinkFit(StructureFit):
    """A link and its motor, fitted to a frequency response from voltage to motor angle
    or to torque.

    Parameters
    ----------
    parameters
        ``l`` λ, ``z`` anti-resonance [rad/s], ``B`` ν/J [1/s], ``m`` c/J [1/s²], ``T``
        delay [s], and ``A`` K/J [rad/(s²·V)], or ``k`` A·c for a torque; all else as in
        `StructureFit`.
    output
        "motor_angle" or "torque".
    peak
        highest local maximum of the fitted response [rad/s], for a motor angle above
        the anti-resonance; None where there is none.
    findings
        those of the fit, and W315 where the band misses the anti-resonance or the
        peak.

    Examples
    --------
    See `identify_driven_link`.
    """

    output: Output = "motor_angle"
    peak: float | None = None

    __made_by__ = "fraclink.extend.identify_driven_link(response)"
    _labels: ClassVar[Mapping[str, tuple[str, str]]] = {
        "l": ("λ", ""),
        "z": ("anti-resonance (motor held)", "rad/s"),
        "m": ("c/J", "1/s²"),
        "B": ("ν/J", "1/s"),
        "A": ("K/J", "rad/(V·s²)"),
        "k": ("K c/J", ""),
        "T": ("delay", "ms"),
    }

    def overview(self) -> Overview:
        """Link and motor, and how well each figure is known."""
        whole = super().overview()
        rows = rows_of(
            self,
            "output",
            "order",
            "anti_resonance",
            ("peak", "peak", "rad/s"),
            *whole.rows,
        )
        headline = f"error {number(100 * self.nmse, 2)} %"
        return replace(whole, headline=headline, rows=rows)

    @property
    def order(self) -> float:
        """λ of the link, at most 2."""
        return min(self.parameters["l"], 2.0)

    @property
    def anti_resonance(self) -> float:
        """z = ω₀^(2/λ), the link's frequency with the motor held [rad/s]."""
        return self.parameters["z"]

    def model(
        self,
        inertia: Positive,
        *,
        payload: Annotated[float, above(0.0, unit="kg")] | None = None,
    ) -> LinkModel:
        """Return the link, c = m J for the motor's inertia J at the gear's output,
        gear² times that of the rotor.

        The gauge's delay is not in a response from voltage to motor angle, and in one
        to torque it cannot be told from the amplifier's: it is left at 0.

        Raises FieldError where a gate of the fit failed: a link model has no findings,
        and a design with it would pass.
        """
        if not self.passed:
            gates = "; ".join(
                f"{finding.code}: {finding.message}"
                for finding in errors_of(self.findings)
            )
            raise FieldError(
                "fit",
                gates,
                "not passed",
                "a fit without errors",
                "measure a band that shows anti-resonance and peak, and fit again",
            )
        # A fit that passed has an interval for each of these.
        orders, places, inertias = (
            (self.intervals[name].low, self.intervals[name].high) for name in "lzm"
        )
        orders = min(orders[0], 2.0), min(orders[1], 2.0)
        # All four corners: z^(λ/2) increases with λ for z above 1 rad/s and decreases
        # below.
        ends = [place ** (order / 2) for place in places for order in orders]
        return LinkModel(
            self.parameters["m"] * inertia,
            # z^λ = ω₀².
            self.anti_resonance ** (self.order / 2),
            self.order,
            payload=payload,
            intervals=(
                ("order", *orders),
                ("natural_frequency", min(ends), max(ends)),
                ("stiffness", inertias[0] * inertia, inertias[1] * inertia),
            ),
        )


@checked
def identify_driven_link(
    measured: FrequencyResponse,
    *,
    output: Output = "motor_angle",
    band: tuple[float, float] | None = None,
    weighting: Weighting | None = None,
    details: bool = True,
) -> DrivenLinkFit:
    """Fit a link with its motor to a frequency response from the amplifier's voltage;
    no guess is needed.

        θm/V = A ((s/z)^λ + 1) e^(−Ts)/((s² + B s)((s/z)^λ + 1) + m (s/z)^λ),    Γ/V = c (s/z)^λ/((s/z)^λ +
        1) θm/V

    Parameters
    ----------
    measured
        lines from below the anti-resonance to above the peak. [rad/V], or [N·m/V] for a
        torque.
    output
        what was measured, "motor_angle" or "torque".
    band
        lines to fit, (from, until) [rad/s]; default: all lines or, if that fit fails,
        the widest band, shortened by octaves at either end, in which it passes (W349).
    weighting
        of the errors, as in `identify_structure`.
    details
        False: intervals from the standard errors alone.

    Raises
    ------
    FieldError
        too few lines, a line that is zero.
    NotConvergedError
        nothing fits.

    References
    ----------
    Benftima et al. (2023), (1), (10) and (11).

    Examples
    --------
    >>> import fraclink as fl
    >>> import fracsys
    >>> s, w = fracsys.s, np.geomspace(2, 60, 80)
    >>> link = s**1.92 / (s**1.92 + 100)
    >>> arm = 60 / (s**2 + 15 * s + 9 * link)
    >>> found = identify_driven_link(fl.FrequencyResponse(w, arm(1j * w)))
    >>> round(found.order, 4), round(found.anti_resonance, 3), round(found.peak, 3)
    (1.92, 11.007, 12.004)
    """
    if band is not None:
        return _fitted(measured.between(*band), output, weighting, details)
    fit = _fitted(measured, output, weighting, details)
    if fit.passed:
        return fit
    lowest, highest = measured.band
    for low, high in _narrower(measured.band):
        # Too few lines for the parameters, or no fit.
        with contextlib.suppress(FieldError, NotConvergedError):
            narrowed = _fitted(measured.between(low, high), output, weighting, details)
            if narrowed.passed:
                warning = Finding(
                    "W349",
                    "warning",
                    f"fitted from {low:.4g} to {high:.4g} rad/s: over all lines a motor with a link "
                    "of one mode does not fit",
                    {"low": low, "high": high, "lowest": lowest, "highest": highest},
                    "look at the rest for higher modes, friction and noise; give band to choose another part",
                )
                return replace(narrowed, findings=(warning, *narrowed.findings))
    return fit


def _narrower(band: Limits) -> Iterator[Limits]:
    """Parts of a band, shortened by octaves at either end, the widest first.

    The model of a motor with a one-mode link fails at high frequencies, where higher
    modes or the noise floor begin, and far below the anti-resonance, where friction
    dominates. Anti-resonance and peak lie in between, within two octaves.
    """
    low, high = band
    octaves = int(math.log2(high / low)) - _LEAST_OCTAVES
    for octave in range(1, octaves + 1):
        for upper in range(octave, -1, -1):
            yield low * 2.0 ** (octave - upper), high / 2.0**upper


def _fitted(
    measured: FrequencyResponse,
    output: Output,
    weighting: Weighting | None,
    details: bool,
) -> DrivenLinkFit:
    low, high = measured.band
    gain = "A" if output == "motor_angle" else "k"
    bounds = {
        "l": _ORDERS,
        # Wide enough for an anti-resonance outside the band to be found there and
        # reported, instead of being pressed to the edge of the range.
        "z": (low / 30, high * 30),
        # gain of the amplifier, friction and stiffness
        **dict.fromkeys((gain, "B", "m"), POSITIVE_LIMITS),
    }
    fit = identify_structure(
        measured,
        _STRUCTURES[output],
        bounds=bounds,
        weighting=weighting,
        details=details,
    )
    peak = _peak(fit, output, measured.band)
    parts = {each.name: getattr(fit, each.name) for each in fields(fit)}
    parts["findings"] = (
        *_of_the_band(fit, measured, output, peak),
        *fit.findings,
    )
    return DrivenLinkFit(**parts, output=output, peak=peak)


def _peak(fit: StructureFit, output: Output, band: tuple[float, float]) -> float | None:
    """Frequency [rad/s] of the highest local maximum of |H|; for a motor angle only
    above the anti-resonance.
    """
    # Below its anti-resonance the response of a motor angle falls like an integrator: a
    # maximum there is not a resonance.
    low = fit.parameters["z"] if output == "motor_angle" else band[0] / _BEYOND
    high = _BEYOND * max(band[1], low)
    # Of the fitted function, since noise has maxima everywhere; and without its delay,
    # which turns the phase only.
    response = parse_expression(fit.expression).function({**fit.parameters, "T": 0.0})
    loop = replace(as_loop(response, high), low=math.log(low), high=math.log(high))
    x, values, _ = sweep(loop)
    tops = valleys(1 / np.abs(values), spare=math.inf)
    peaks = zeros_of(loop, gain_slope, [(x[k - 1], x[k + 1]) for k in tops])
    if not peaks:
        return None
    return math.exp(max(peaks, key=lambda peak: abs(peak[1]))[0])


def _of_the_band(
    fit: StructureFit, measured: FrequencyResponse, output: Output, peak: float | None
) -> Iterator[Finding]:
    """W315: a feature that is not surrounded by lines is extrapolated, however narrow
    its interval.
    """
    link = (
        "anti-resonance"
        if output == "motor_angle"
        else "frequency of the link with the motor held"
    )
    unsure = {"z", "l"} & {*fit.undetermined, *fit.at_bound}
    low, high = measured.band
    for name, place, known in (
        (link, fit.parameters["z"], not unsure),
        ("peak", math.nan if peak is None else peak, True),
    ):
        below = int(np.count_nonzero(measured.frequency < place))
        if not (known and _AROUND <= below <= measured.frequency.size - _AROUND):
            yield Finding(
                "W315",
                "error",
                f"the band does not show the {name}",
                {"place": place, "low": low, "high": high},
                "measure at frequencies on both sides of it",
            )
