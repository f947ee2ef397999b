"""Assessment of a design: the phase budget, margins over the payload, the loop gain at
higher modes, and the feasible specifications.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Literal, Unpack

import numpy as np
from numpy.typing import ArrayLike

from fraclink._arm.box import Arm
from fraclink._arm.controller import Controller
from fraclink._arm.link import LinkModel
from fraclink._arm.loop import Loop, with_payload
from fraclink._arm.rig import Rig
from fraclink._design.procedure import link_of, request_of
from fraclink._design.rows import specification
from fraclink._design.search import solved
from fraclink._design.table import Figure, Outer, Table, Trial, tabulated
from fraclink._law.design import Design, Requirement, Specification
from fraclink._law.modes import MODE_LIMIT, higher_modes, mode_requirements
from fraclink.errors import FieldError
from fracsys.checks import (
    Array,
    Frequency,
    Mask,
    Payload,
    PhaseMargin,
    Real,
    above,
    checked,
)
from fracsys.checks.equality import compared
from fracsys.checks.rules import rule

if TYPE_CHECKING:
    from fraclink._identify import Fit

__all__ = [
    "FeasibilityMap",
    "Links",
    "MarginCurve",
    "PhaseShare",
    "feasibility_map",
    "margin_curve",
    "mode_gains",
    "phase_budget",
    "phase_shares",
]


GainLimit = Annotated[float, above(0.0, 1e3)]
CurveKind = Literal["ideal", "motor", "loop", "sampled"]


# ---- one design -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PhaseShare:
    """The phase [rad] contributed by one element at the gain crossover; negative is
    lag.
    """

    element: str
    phase: float


@checked
def phase_budget(design: Design, payload: float) -> tuple[PhaseShare, ...]:
    """Return the phase that each element of the loop adds at the upper gain crossover, at
    `payload` [kg] > 0.

    The shares and the 180° of feedback add up to the phase margin of the full loop.

    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023")
    >>> wanted = {"gain_crossover": 12.0, "phase_margin": fl.deg(50), "filter_time": 0.0}
    >>> design = fl.design(rig.model, rig, payloads=(0.020, 0.040), **wanted)
    >>> shares = phase_budget(design, 0.020)
    >>> print(f"{sum(share.phase for share in shares) + 3.141592653589793:.3f}")
    0.873
    """
    w0 = design.natural_frequency(payload)
    crossings = design.full_loop.crossings(w0).frequency
    if crossings.size == 0:
        raise FieldError(
            "payload",
            payload,
            "without a gain crossover",
            "a payload at which |L| crosses one",
            "give the mass in kg",
        )
    # The highest crossing: where |L| rises through one, the frequency is low, and a delay
    # costs almost nothing.
    return phase_shares(design, float(np.max(crossings)), w0)


def phase_shares(design: Design, w: float, w0: float) -> tuple[PhaseShare, ...]:
    """Return the phase that each element of the loop adds at ω [rad/s], at a link's ω₀."""
    loop = design.full_loop
    hold = 0.5 * design.rig.period
    # The share of the gauge is the difference from a perfect one: its delay alone would
    # omit the effect of the second mode on the phase.
    tip = float(
        replace(loop, gauge_delay=0.0, gauge_gain=1.0, second_mode=None)
        .link_log(w, w0)
        .imag
    )
    gauge = float(loop.link_log(w, w0).imag) - tip
    return (
        PhaseShare("link", tip),
        *(() if loop.exact_gauge else (PhaseShare("gauge and second mode", gauge),)),
        PhaseShare("derivative", 0.5 * math.pi * loop.order),
        PhaseShare("filter", -loop.filter_order * math.atan(loop.filter_time * w)),
        PhaseShare("motor loop", float(loop.motor_log(w).imag) + loop.delay * w),
        PhaseShare("hold", -hold * w),
        PhaseShare("computation delay", -(loop.delay - hold) * w),
    )


@compared
@dataclass(frozen=True, eq=False)
class MarginCurve:
    """Margins against payload (Fig. 10): arrays of shape (N,) in kg, rad/s and rad.

    ``phase_margin`` is the smallest over all gain crossings, below zero where the loop
    is unstable.
    """

    kind: str
    payload: Real
    gain_crossover: Real
    phase_margin: Real


@dataclass(frozen=True)
class Links:
    """A link at some payloads [kg], shape (N,), with the loop without Ĉ tabulated once
    for the margins of many controllers, as while a slider is dragged.
    """

    model: LinkModel
    rig: Rig
    payloads: Real

    @cached_property
    def natural_frequencies(self) -> Real:
        """ω₀ at each payload [s^(-λ/2)]."""
        link = with_payload(self.model, self.rig)
        return np.array(
            [link.at_payload(float(mass)).natural_frequency for mass in self.payloads]
        )

    @cached_property
    def _table(self) -> Table:
        rig = self.rig
        request = request_of(link_of(self.model, rig), rig, {}, False)
        loop = Loop.around(request.model, request.motor_loop, rig.motor, rig.period)
        return tabulated(
            loop,
            self.natural_frequencies,
            rig.period,
            arm=0,
            highest=loop.highest,
            motor=(rig.motor.gain, rig.motor.decay),
            empty=True,
        )

    def margins(self, controller: Controller) -> Real:
        """Return the smallest phase margin [rad] at each payload, π without a crossing,
        negative where the loop is unstable.
        """
        trial = Trial(self._table, Outer.of(controller, 1.0))
        (margins,) = trial.value(Figure("margin"))
        return np.where(np.isnan(margins), math.pi, margins)


@checked
def margin_curve(
    design: Design, payloads: ArrayLike, *, kind: CurveKind = "loop"
) -> MarginCurve:
    """Return the margins of a design against payload (Fig. 10).

    Parameters
    ----------
    design
        the design.
    payloads
        masses at the tip [kg], > 0, shape (N,).
    kind
        "ideal" (the paper's L), "motor" (its LM, with M(s) and the filter), "loop"
        (hold and delay too) or "sampled" (the law that is shipped, in the exactly
        sampled loop).
    """
    whole, masses = design.full_loop, axis_of("payloads", payloads, Payload)
    if kind == "sampled":
        margins = [design.sampled_at(float(m)) for m in masses]
        # An unstable loop may have a large margin at a crossing; it is drawn below
        # zero.
        sign = np.where([bool(f.stable) for f in margins], 1.0, -1.0)
        return MarginCurve(
            kind,
            masses,
            np.array([f.gain_crossover for f in margins]),
            sign * np.array([min(abs(f.phase_margin), math.pi) for f in margins]),
        )
    loops = {
        # Up to the Nyquist frequency like the others: no controller realises a crossing
        # of the paper's L beyond it.
        "ideal": replace(design.ideal_loop, highest=whole.highest),
        "motor": replace(
            whole,
            delay=0.0,
            correction=None,
            gauge_delay=0.0,
            gauge_gain=1.0,
            second_mode=None,
        ),
        "loop": whole,
    }
    w0 = np.array([design.natural_frequency(float(m)) for m in masses])
    return MarginCurve(kind, masses, *loops[kind].margins(w0))


def axis_of(field: str, values: ArrayLike, annotation: object) -> Real:
    """A number or a list of numbers as an array of shape (N,), N > 0, each in the range
    of its annotation.
    """
    axis = rule(Annotated[Real, Array(min_size=1)]).check(
        field, np.atleast_1d(np.asarray(values))
    )
    return np.array([rule(annotation).check(field, float(value)) for value in axis])


@checked
def mode_gains(
    design: Design, *, limit: GainLimit = MODE_LIMIT, damping_ratio: float | None = None
) -> tuple[Requirement, ...]:
    """Return the loop gain at the link's higher modes against `limit`; empty where none
    is known.

    A mode with a loop gain below one cannot be destabilised, whatever its phase. The
    modes are those of a beam of the rig's link mass (``[link] mass_kg``), with the
    model's damping unless `damping_ratio` is given, and the second mode that was
    identified. At a mode above the identified one only the part of L that points to -1
    counts, 1 + |L|/2 - |1 + L/2|, with the phase of L in doubt by 29°.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023")
    >>> rig = replace(rig, link=replace(rig.link, mass=0.00735))
    >>> wanted = {"gain_crossover": 12.0, "phase_margin": fl.deg(50)}
    >>> design = fl.design(rig.model, rig, **wanted, law=False)
    >>> second, third = mode_gains(design)
    >>> second.passed, round(second.achieved, 1)
    (True, 0.3)
    """
    modes = higher_modes(
        Arm(design.model),
        design.rig,
        design.motor_loop,
        np.geomspace(*design.payloads, 3),
        damping_ratio=damping_ratio,
    )
    response = design.controller.response
    return () if modes is None else mode_requirements(modes, response, limit)


@compared
@dataclass(frozen=True, eq=False)
class FeasibilityMap:
    """The crossovers [rad/s] and phase margins [rad] that are feasible together.

    ``noise_gain``, shape (len(phase_margin), len(gain_crossover)), is the smallest with
    which `design` meets both; NaN where it does not.
    """

    gain_crossover: Real
    phase_margin: Real
    noise_gain: Real

    @property
    def feasible(self) -> Mask:
        """The cells in which a controller meets every row."""
        return np.isfinite(self.noise_gain)


def feasibility_map(
    model: LinkModel | Fit,
    rig: Rig,
    *,
    gain_crossovers: ArrayLike,
    phase_margins: ArrayLike,
    **wanted: Unpack[Specification],
) -> FeasibilityMap:
    """Return the noise gain of `design` for every pair of crossover [rad/s] and phase
    margin [rad], with whatever else is `wanted`; the law is not checked.

    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023")
    >>> axes = {"gain_crossovers": [12.0, 40.0], "phase_margins": [fl.deg(50)]}
    >>> feasibility_map(rig.model, rig, **axes).feasible.tolist()
    [[True, False]]
    """
    crossovers = axis_of("gain_crossovers", gain_crossovers, Frequency)
    angles = axis_of("phase_margins", phase_margins, PhaseMargin)
    request = request_of(link_of(model, rig), rig, specification(wanted), False)
    noise = np.full((angles.size, crossovers.size), np.nan)
    for column, crossover in enumerate(crossovers):
        for row in np.argsort(angles):
            cell = {"gain_crossover": crossover, "phase_margin": angles[row]}
            solution = solved(request.asking(**cell))
            if not solution.kept:
                break  # a larger margin is infeasible as well
            noise[row, column] = solution.noise_gain
    return FeasibilityMap(crossovers, angles, noise)
