"""Shape a move: the fastest reference for the loop that runs, under limits, for every
payload of a range.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Annotated, Literal

import numpy as np

from fraclink._arm.reference import Path, SampledReference
from fraclink._law.design import Design
from fraclink._simulate.arm import Twin
from fraclink._simulate.metrics import BAND
from fraclink._simulate.shape_programme import MoveSolution, Programme, Responses
from fraclink._simulate.shaped_move import (
    Candidate,
    MoveSetting,
    ShapedMove,
    settling,
)
from fraclink.errors import FieldError
from fraclink.findings import Finding
from fracsys.checks import Between, Ordered, checked

__all__ = ["shape"]

# Beyond, what is left of a vibration only decays: a tip that was in the band for two
# and a half periods stays.
_TAIL = 2.5  # vibration periods after settling that the programme looks at
_LONGEST = 16  # times that: no move of an arm takes longer
_FAR = 0.1  # of a path's span: a tip that is farther away does not follow it
# Rows and columns of the programme both grow with it, and the time of a solution with
# more than the square.
_MOST = 60  # coefficients; a longer reference gets fewer knots in a second


@checked
def shape(
    design: Design,
    move: Annotated[float, Between(-1e3, 1e3, "rad")] | Path | SampledReference,
    *,
    payloads: Annotated[tuple[float, float], Ordered()] | None = None,
    told: bool = False,
    voltage: Annotated[float, Between(0.0, 1e6, "V", low_open=True)] | None = None,
    speed: Annotated[float, Between(0.0, 1e6, "rad/s", low_open=True)] | None = None,
    torque: Annotated[float, Between(0.0, 1e6, "N·m", low_open=True)] | None = None,
    reserve: Annotated[float, Between(0.0, 0.9)] = 0.25,
    on: Literal["twin", "model"] = "twin",
    arm: Twin | None = None,
    gauge_offset: Annotated[float, Between(-1e6, 1e6, "N·m")] | None = None,
    seeds: Annotated[int, Between(1, 1000)] = 5,
) -> ShapedMove:
    """Return the fastest reference from rest to rest, or the one that makes the tip
    follow a path best.

    The closed loop of the shipped law and the arm is linear as long as no limit acts,
    so the coefficients of a spline follow from a linear programme: the tips of all
    payloads within 2 % of the move, less a reserve, from the settling time on, and
    every voltage within its limit. The shortest settling time is found by bisection.
    Along a path the largest distance of any payload's tip is made least.

    What is returned was then run on the arm with friction, noise and all its modes,
    and a path beside itself as the reference; where the arm does not do what was
    promised, a finding says so.

    Parameters
    ----------
    design
        whose law runs.
    move
        size of the move [rad], not 0, or the path of the tip that is followed: a
        `spline`, or samples.
    payloads
        lightest and heaviest payload [kg], one reference for all; the design's where it
        is left out. Twice the same where it is known.
    told
        whether the law is given the payload (`simulate`).
    voltage
        limit of |V| [V], noise and friction included; the rig's where it is left out.
    speed, torque
        limits of the motor's speed at the gear's output [rad/s] and of the torque at
        the link's root [N·m], noise included.
    reserve
        part of the 2 % band that the linear loop leaves to friction and noise, 0 … 0.9
        [1].
    on
        what the loop is taken from and measured on: "twin", an arm made from the rig's
        stiffness, length and masses, or "model", the link as it was identified.
    arm
        the twin to take; default `Twin.from_rig` of the design.
    gauge_offset
        of the gauge while it is measured [N·m]; the rig's where it is left out.
    seeds
        noises to measure each payload with.

    Raises
    ------
    FieldError
        a value out of its range, a law or a limit with which the arm cannot be moved, a
        path that its limits do not let the tip follow.

    Examples
    --------
    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023-geared")
    >>> design = fl.design(rig.model, rig, payloads=(0.020, 0.040), gain_crossover=12.0,
    ...                    phase_margin=fl.deg(50), filter_time=0.02)
    >>> move = fl.shape(design, 0.5, voltage=8.0, seeds=1)
    >>> [m.name for m in move.measured], move.passed
    (['shaped'], True)
    """
    move = move.through() if isinstance(move, SampledReference) else move
    if move == 0.0:
        raise FieldError(
            "move", 0.0, "no move", allowed="not 0 rad", remedy="give its size"
        )
    if on == "model" and arm is not None:
        allowed, remedy = "on='twin'", "leave one of the two out"
        raise FieldError(
            "arm", "given", "a twin, beside on='model'", allowed=allowed, remedy=remedy
        )
    twin = (
        None if on == "model" else arm or Twin.from_rig(design.rig, model=design.model)
    )
    setting = MoveSetting.of(design, payloads, told, twin, gauge_offset)
    # Beyond the law's own limit of an angle its guard would reject the reference; the
    # programme does not know of guards.
    farthest, limit = setting.law.limits.angle_limit, setting.arm.voltage_limit
    if not isinstance(move, Path) and abs(move) >= farthest:
        allowed, remedy = (
            f"< {farthest:.4g} rad, the law's own limit",
            "derive the law's limits for it",
        )
        raise FieldError("move", move, "too far", allowed=allowed, remedy=remedy)
    # Whatever is allowed, the amplifier gives no more.
    most = limit if voltage is None else min(voltage, limit)
    shaped, tried, kept_back = _references(
        setting, move, (most, speed, torque), reserve
    )
    target = move if isinstance(move, Path) else None
    shown = setting.between(2)
    drawn = [setting.run(shaped, payload, 0) for payload in shown]
    made = ShapedMove(
        reference=shaped,
        period=setting.law.period,
        target=target,
        payloads=setting.payloads,
        told=told,
        voltage=most,
        kept_back=kept_back,
        reserve=reserve,
        measured=tuple(setting.measured(each, target, seeds) for each in tried),
        seeds=seeds,
        shown=np.array(shown),
        tip_angle=np.stack([run.tip_angle for run in drawn]),
        motor_voltage=np.stack([run.voltage for run in drawn]),
        law_sha256=setting.law.digest,
    )
    return replace(made, findings=_findings(made))


def _references(
    setting: MoveSetting,
    move: float | Path,
    limits: tuple[float, float | None, float | None],
    reserve: float,
) -> tuple[Path, tuple[Candidate, ...], float]:
    """Return the shaped path, all that are measured (it first), and the voltage left to
    noise [V].
    """
    began = time.perf_counter()
    programme, kept_back = setting.programme(*limits)
    if isinstance(move, Path):
        programme = _coarse(programme, move.duration)
        found = _following(programme, move)
    else:
        found, programme = _fastest(setting, programme, move, reserve)
    path = programme.path(found)
    spent = time.perf_counter() - began
    if isinstance(move, Path):
        shaped = Candidate(
            "shaped", path, _distance(programme.loops, path, move), spent
        )
        given = Candidate("as given", move, _distance(programme.loops, move, move))
        return path, (shaped, given), kept_back
    promised = settling(
        programme.loops.to(path, ("tip",))[:, 0],
        move,
        BAND * abs(move),
        programme.period,
    )
    return path, (Candidate("shaped", path, promised, spent),), kept_back


# ── the programme
# ───────────────────────────────────────────────────────────────────────────────────────────


def _fastest(
    setting: MoveSetting, programme: Programme, move: float, reserve: float
) -> tuple[MoveSolution, Programme]:
    """Bisect the settling time [periods] and return the gentlest reference that keeps
    the shortest.
    """
    allowed = (1.0 - reserve) * BAND * abs(move)
    tail = math.ceil(_TAIL * setting.vibration / programme.period)
    low, high, factor = 0, math.ceil(setting.vibration / programme.period), 1

    def within(settled: int) -> bool:
        found = _settling_at(programme, move, settled, tail)
        return found is not None and found.distance <= allowed

    while not within(high):
        # Up by half until it is within reach: the fastest is then sought between the
        # last two.
        low, high = high, math.ceil(1.5 * high)
        if high + tail > programme.length:
            factor *= 2
            if factor > _LONGEST:
                raise _unreachable(move, programme)
            programme = setting.longer(programme, factor)
        programme = _coarse(programme, high * programme.period)
    # To a period, or to one in a hundred: the last bit of a second is below what noise
    # does to the settling time.
    while high - low > max(1, high // 100):
        middle = (low + high) // 2
        low, high = (low, middle) if within(middle) else (middle, high)
    # Of all references that settle as soon the gentlest: the extreme one rattles
    # between its bounds, and the arm with it.
    found = _settling_at(programme, move, high, tail, within=allowed)
    return found or _required(_settling_at(programme, move, high, tail)), programme


def _coarse(programme: Programme, duration: float) -> Programme:
    """Return the programme with its knots so far apart that a reference of `duration`
    [s] needs few.
    """
    times = math.ceil(programme.count_for(duration) / _MOST)
    return programme if times == 1 else replace(programme, knot=times * programme.knot)


def _settling_at(
    programme: Programme,
    move: float,
    settled: int,
    tail: int,
    *,
    within: float | None = None,
) -> MoveSolution | None:
    target = np.full(programme.length, move)
    count = programme.count_for(settled * programme.period)
    return programme.solve(count, target, settled, settled + tail, within=within)


def _required(solution: MoveSolution | None) -> MoveSolution:
    if solution is None:
        raise AssertionError("a programme that was solved before is not any more")
    return solution


def _unreachable(move: float, programme: Programme) -> FieldError:
    time = programme.length * programme.period
    allowed, remedy = (
        f"one that settles within {time:.3g} s",
        "allow more voltage, or move less",
    )
    return FieldError(
        "move", move, "not reached within its limits", allowed=allowed, remedy=remedy
    )


def _following(programme: Programme, path: Path) -> MoveSolution:
    last = math.ceil(path.duration / programme.period) + 1
    if last + programme.knot > programme.length:
        allowed = f"<= {(programme.length - programme.knot) * programme.period:.3g} s"
        raise FieldError(
            "move",
            path.duration,
            "too long a path",
            allowed=allowed,
            remedy="cut it into parts",
        )
    # The loop is at rest at zero; a path from elsewhere is that path and a jump before
    # it.
    if float(path.angle(0.0)) != 0.0:
        allowed, remedy = (
            "a path from 0 rad",
            "count the path from where the arm stands",
        )
        raise FieldError(
            "move",
            float(path.angle(0.0)),
            "not at 0 at first",
            allowed=allowed,
            remedy=remedy,
        )
    target = path.angle(programme.period * np.arange(programme.length))
    found = programme.solve(
        programme.count_for(path.duration), target, 0, programme.length
    )
    if found is None:
        allowed, remedy = (
            "a path within the limits",
            "make it slower, or allow more voltage",
        )
        raise FieldError(
            "move", path.kind, "not to be followed", allowed=allowed, remedy=remedy
        )
    return found


def _distance(loops: Responses, reference: Path, target: Path) -> float:
    """Largest distance of any payload's tip to where it shall be [rad]."""
    tip = loops.to(reference, ("tip",))[:, 0]
    return float(
        np.abs(tip - target.angle(loops.period * np.arange(loops.length))).max()
    )


def _along(made: ShapedMove, span: float) -> list[Finding]:
    """What is to be said of the distance between tip and path, whose angles span that
    much [rad].
    """
    ours, found = made.shaped, []
    if ours.largest_error > ours.predicted + made.reserve * BAND * span:
        found.append(
            Finding(
                "W501",
                "warning",
                "the tip is farther from the path than the linear loop promises",
                {"measured": ours.largest_error, "promised": ours.predicted},
                "noise or friction moves the arm: make the path larger, or allow a larger reserve",
            )
        )
    if ours.predicted > _FAR * span:
        found.append(
            Finding(
                "W504",
                "warning",
                "the path is faster than the limits allow",
                {"farthest": ours.predicted, "span": span},
                "make it slower, begin it at rest, allow more voltage, or tell the law the payload",
            )
        )
    return found


def _findings(made: ShapedMove) -> tuple[Finding, ...]:
    """W501: later or farther away than promised, or by voltage or guards beyond the linear loop;
    W504: too fast.
    """
    ours, found = made.shaped, []
    if made.target is not None:
        found += _along(
            made,
            float(
                np.ptp(
                    made.target.angle(made.period * np.arange(made.tip_angle.shape[1]))
                )
            ),
        )
    # A sample and a half: measured and promised are both counted in periods, and each
    # may round by one.
    if made.target is None and ours.settling_time > ours.predicted + 1.5 * made.period:
        found.append(
            Finding(
                "W501",
                "warning",
                "the arm settles later than the linear loop promises",
                {"measured": ours.settling_time, "promised": ours.predicted},
                "keep a larger reserve: friction or noise takes more of the band",
            )
        )
    if ours.peak_voltage > made.voltage:
        found.append(
            Finding(
                "W501",
                "warning",
                "noise and friction take the voltage beyond its limit",
                {
                    "measured": ours.peak_voltage,
                    "limit": made.voltage,
                    "left_to_them": made.kept_back,
                },
                "allow less voltage, or filter more",
            )
        )
    if ours.limited:
        found.append(
            Finding(
                "W501",
                "warning",
                "a guard of the law acts during the move, so that the loop is not the linear one",
                {"part_of_the_runs": ours.limited},
                "allow less voltage or speed, or derive the law's limits for faster moves",
            )
        )
    return tuple(found)
