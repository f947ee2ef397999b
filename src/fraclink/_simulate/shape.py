"""Shape a move: the fastest reference, or the smoothest that settles in time, for every
arm of a set.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from fraclink._arm.reference import Path
from fraclink._display import (
    Overview,
    Row,
    displayed,
    number,
    quantity,
    rows_of,
    state_of,
)
from fraclink._files import Saved, document
from fraclink._law.design import Design
from fraclink._simulate.arm_set import (
    LONGEST,
    ArmSet,
    On,
    Over,
    Payloads,
    Told,
    WorstCase,
)
from fraclink._simulate.metrics import BAND
from fraclink._simulate.programme import Programme
from fraclink.errors import FieldError
from fraclink.findings import Finding
from fracsys.checks import Between, Duration, Real, above, checked
from fracsys.checks.equality import compared

__all__ = ["ShapedMove", "shape"]


# Vibration periods after settling that the programme covers: beyond them a vibration
# only decays, and a tip that was in the band for 2.5 periods stays there.
TAIL = 2.5
# per vibration period: more do not make the move settle sooner, and the cost is
# quadratic
KNOTS = 30
# Coefficients; a longer reference gets fewer knots per second. Both rows and columns of
# the programme grow with their number, and the time of a solution more than
# quadratically.
MOST = 60


@displayed
@document(
    "shaped-move",
    version=3,
    sources=lambda move: {"law": move.worst_case.law_sha256},
)
@compared
@dataclass(frozen=True, eq=False)
class ShapedMove(Saved):
    """One reference for every arm of a set, with the result that was promised and the
    one that was simulated.

    Parameters
    ----------
    reference
        of the tip: a piecewise cubic with its knots on the law's periods.
    period
        of the law [s].
    voltage
        limit of |V| [V], noise and friction included.
    reserve
        part of the band and of the voltage that the linear loops leave to friction and
        noise [1].
    promised
        time from which the linear loops keep the tip of every arm within 2 % of the
        move [s].
    worst_case
        the result on the arms with friction and noise.
    tip_angle, motor_voltage
        of each arm of the set with the payload that settles last, one value per period,
        shape (A, N) [rad], [V].
    findings
        what a reader should know.

    Examples
    --------
    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023-geared")
    >>> design = fl.design(rig.model, rig, payloads=(0.020, 0.040), gain_crossover=12.0,
    ...                    phase_margin=fl.deg(50), filter_time=0.02)
    >>> move = fl.shape(design, 1.0, payloads=(0.030, 0.030), told=True)
    >>> move.settling_time < 0.5, float(move.reference.angle(1.0).round(9))
    (True, 1.0)
    """

    reference: Path
    period: float
    voltage: float
    reserve: float
    promised: float
    worst_case: WorstCase
    tip_angle: Real
    motor_voltage: Real
    findings: tuple[Finding, ...] = ()

    def __post_init__(self) -> None:
        for values in (self.tip_angle, self.motor_voltage):
            values.flags.writeable = False

    @property
    def amplitude(self) -> float:
        """The move [rad]; the reference begins at 0."""
        return float(self.reference.angle(self.reference.duration))

    @property
    def settling_time(self) -> float:
        """Longest measured settling time of all arms [s]."""
        return self.worst_case.settling_time

    @property
    def passed(self) -> bool:
        """Whether the arms did what the linear loops promised, within the limits."""
        return not any(finding.severity != "info" for finding in self.findings)

    def overview(self) -> Overview:
        """The longest settling time, as promised and as measured."""
        case = self.worst_case
        if math.isfinite(self.settling_time):
            promise = quantity(self.promised, "s", 3)
            result = f"every arm settles within {quantity(self.settling_time, 's', 3)} ({promise} promised)"
        else:
            result = f"the arm “{case.worst.arm}” does not settle"
        peak = max(each.peak_voltage for each in case.arms)
        rows = rows_of(
            self,
            "amplitude",
            "voltage",
            "reserve",
            Row("duration", "", self.reference.duration),
            "promised",
            "settling_time",
            "worst_case",
        )
        return Overview(
            f"{number(self.amplitude)} rad with {case.carried}: {result}, "
            f"{number(peak, 3)} V of {number(self.voltage)} V",
            state_of(self.passed),
            rows,
            tuple(replace(table, key="") for table in case.overview().tables),
            self.findings,
        )


@checked
def shape(
    design: Design,
    move: Annotated[float, Between(-1e3, 1e3, "rad")],
    *,
    payloads: Payloads | None = None,
    told: Told = False,
    over: Over = "box",
    settle: Duration | None = None,
    voltage: Annotated[float, above(0.0, 1e6, "V")] | None = None,
    reserve: Annotated[float, Between(0.0, 0.9)] = 0.25,
    on: On = "twin",
    seeds: Annotated[int, Between(1, 1000)] = 1,
) -> ShapedMove:
    """Return the rest-to-rest reference with which every arm of a set settles soonest.

    The closed loop of the shipped law and an arm is linear as long as no limit acts, so
    the coefficients of a spline follow from a linear programme that keeps the tips of
    all arms with all payloads within 2 % of the move, less a reserve, from the settling
    time on, and every voltage within its limit. The shortest settling time is found by
    bisection. Of all references that reach it, or the requested time, the one whose
    acceleration varies least is taken.

    The result is then run on the arms with friction, noise and all their modes; a
    finding reports where they miss the promise.

    Parameters
    ----------
    design
        whose law runs.
    move
        size of the move [rad], not 0.
    payloads
        lightest and heaviest payload [kg], with one reference for all; default: the
        design's. Give a known payload twice.
    told
        whether the law is given the payload (`simulate`); "estimated": the one that its
        estimator finds in a first move (`worst_case`).
    over
        the set of arms: "box", the fit's box and both damping laws, or "model", the
        model alone (`worst_case`).
    settle
        settling time required of every arm [s]; default: the shortest.
    voltage
        limit of |V| [V], noise and friction included; default: the rig's.
    reserve
        part of the 2 % band and of the voltage that the linear loops leave to friction
        and noise, 0 … 0.9 [1].
    on
        "twin": arms made from the rig's stiffness, length and masses; "model": massless
        links as they were identified.
    seeds
        number of noise seeds with which each arm is run.

    Raises
    ------
    FieldError
        a value out of its range, an arm on which the loop is unstable, limits with which
        not every arm settles in the requested time.

    Examples
    --------
    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023-geared")
    >>> design = fl.design(rig.model, rig, payloads=(0.020, 0.040), gain_crossover=12.0,
    ...                    phase_margin=fl.deg(50), filter_time=0.02)
    >>> move = fl.shape(design, 0.5, payloads=(0.030, 0.030), told=True, settle=0.6)
    >>> move.settling_time <= 0.6, move.worst_case.worst.peak_voltage < 8.0
    (True, True)
    """
    limits, amplifier = design.law().limits, design.rig.motor.voltage_limit
    # The amplifier limits the voltage, whatever is allowed.
    most = amplifier if voltage is None else min(voltage, amplifier)
    # Beyond the law's own angle limit, its guard would reject the reference.
    if move == 0.0 or abs(move) >= limits.angle_limit:
        raise FieldError(
            "move",
            move,
            "not a move that this law can make",
            f"not 0, below {limits.angle_limit:.4g} rad, the law's own limit",
            "derive the law's limits for it",
        )
    arms = ArmSet.of(design, payloads, move, told=told, over=over, on=on)
    if arms.unstable:
        words, payload = arms.unstable[0]
        raise FieldError(
            "payloads",
            payload,
            f"a payload with which the loop is not stable on the {on} of the link “{words}”",
            "a payload that the law holds on every arm of the set",
            "narrow the range, or design for it",
        )
    coefficients, programme = _fastest(arms, move, 1.0 - reserve, most, settle)
    outside = np.abs(programme.tips(coefficients) - move).max(0) > BAND * abs(move)
    promise = programme.period * float(np.flatnonzero(outside)[-1] + 1)
    reference = programme.path(coefficients)
    figures = arms.figures(reference, seeds)
    runs = [arms.run(arms.links[each.arm], each.payload, reference) for each in figures]
    shaped = ShapedMove(
        reference=reference,
        period=arms.law.period,
        voltage=most,
        reserve=reserve,
        promised=promise,
        worst_case=WorstCase(
            figures, (arms.payloads[0], arms.payloads[-1]), told, on, arms.law.digest
        ),
        tip_angle=np.stack([run.tip_angle for run in runs]),
        motor_voltage=np.stack([run.voltage for run in runs]),
    )
    return replace(shaped, findings=_findings(shaped))


# --- the search -----------------------------------------------------------------------


def _fastest(
    arms: ArmSet, end: float, left: float, voltage: float, settle: float | None
) -> tuple[Real, Programme]:
    """Return the smoothest reference to `end` [rad] that settles at `settle` [s], or as
    early as possible, and its programme.

    left: share of the band and of `voltage` [V] available to the linear loops.
    """
    period, allowed, limits = arms.law.period, left * BAND * abs(end), arms.law.limits
    tail = math.ceil(TAIL * arms.vibration / period)

    def programme_for(time: float) -> Programme:
        knots = arms.vibration / (KNOTS * period), time / (MOST * period)
        return Programme.of(
            arms,
            max(1, round(knots[0]), math.ceil(knots[1])),
            LONGEST * arms.vibration,
            voltage=left * voltage,
            motor_step=left * limits.motor_step,
            torque=left * min(arms.rig.gauge.limit, limits.torque_limit),
        )

    def distance(settled: int) -> float:
        count = programme.count(settled * period)
        return programme.least_distance(count, end, settled, settled + tail)

    def out_of_reach(settled: int) -> FieldError:
        return FieldError(
            "move",
            end,
            f"does not settle within {settled * period:.3g} s on every arm of the set",
            "a move within the limits of voltage, speed and torque",
            "allow more time or voltage, move less, tell the law the payload, or "
            "narrow the payloads",
        )

    programme = programme_for(settle or arms.vibration)
    low, high = 0, math.floor((settle or arms.vibration) / period)
    while distance(high) > allowed:
        # Increase by half until the goal is within reach; the fastest move then lies
        # between the last two values.
        low, high = high, math.ceil(1.5 * high)
        if settle is not None or high + tail > programme.length:
            raise out_of_reach(low)
        programme = programme_for(high * period)
    # To within a period, or one per cent: finer steps are below the effect of noise on
    # the settling time.
    while settle is None and high - low > max(1, high // 100):
        middle = (low + high) // 2
        low, high = (low, middle) if distance(middle) <= allowed else (middle, high)
    count = programme.count(high * period)
    coefficients = programme.gentlest(count, end, high, high + tail, allowed)
    if coefficients is None:
        raise out_of_reach(high)
    return coefficients, programme


def _findings(move: ShapedMove) -> tuple[Finding, ...]:
    """W501: the arms do not behave as the linear loops predict."""
    worst, figures = move.worst_case.worst, move.worst_case.arms
    findings = []

    def doubt(what: str, measured: float, allowed: float, remedy: str) -> None:
        if measured > allowed:
            values = {"measured": measured, "allowed": allowed}
            findings.append(Finding("W501", "warning", what, values, remedy))

    doubt(
        f"the arm ({worst.arm}) settles later than the linear loop promises",
        worst.settling_time,
        # both times are counted in periods, and each may round
        move.promised + 1.5 * move.period,
        "keep a larger reserve: friction or noise takes more of the band",
    )
    doubt(
        "noise and friction take the voltage beyond its limit",
        max(each.peak_voltage for each in figures),
        move.voltage,
        "keep a larger reserve, or filter more",
    )
    doubt(
        "a guard of the law acts in some of the runs, so that the loop is not linear",
        max(each.guarded for each in figures),
        0.0,
        "allow less voltage, or derive the law's limits for faster moves",
    )
    return tuple(findings)
