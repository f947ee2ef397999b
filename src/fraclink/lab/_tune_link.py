"""The link: an excitation that is planned from the errors of the last fit and grows
until they suffice.
"""

from __future__ import annotations

import cmath
import contextlib
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.experiment import Experiment
from fraclink._arm.link import LinkModel, SecondMode
from fraclink._files import document
from fraclink._identify import Fit, identify, simulated_torque
from fraclink._law import Law
from fraclink.errors import FraclinkError
from fraclink.lab._tune_guard import PLANNED, Guard, Record
from fraclink.lab._tune_motion import burst, calm, follow, motor_law, random_steps
from fraclink.lab._tune_motor import FIRST, MotorResult, closed_motor, fitted_motor
from fraclink.lab._tune_wiring import Wiring

Real = NDArray[np.float64]

__all__ = ["LinkResult", "experiment_of", "motor_again", "tune_link"]

# Standard errors that suffice. What they leave open is in the box: 95 % of λ's, and of a
# delay that turns the vibration's phase as much, cost 2 · 0.018 · π/2, 3° of margin; those
# of ω₀ and of the gauge's gain are as the drift that `watch` does not name.
ENOUGH = {"order": 0.018, "natural_frequency": 0.012, "gain": 0.045, "delay": 0.018}
# Errors fall with the root of the length but with the amplitude itself: size is tried
# first.
_SHORTEST, _LONGEST = 4.0, 16.0  # [s] of one excitation
_LARGER = 3.0  # the most by which an excitation grows at once
_ROUNDS = 2
# A random voltage that changes every T has half of its power up to 2.8/T: 250 rad/s for
# 12 ms, and as far as the second mode of a link that weighs an eighth of its payload.
# The smooth moves end at a tenth of that. A quarter of the speed limit is small.
_BIT, _BURST, _PUSH = 0.012, 2.0, 0.25  # [s] at most, [s], of the speed limit
_HALF, _SECOND = 2.8, 25.0
_CLEANED = 6  # fits, at most, of a record without what the structure does not have
_DECAYS = (1.97, 1.87)  # orders λ of links that ring for long, and for some periods


@document("tuned-link")
@dataclass(frozen=True, eq=False)
class LinkResult:
    """The link's fit, the motor with the link's own torque, and what each excitation
    gave.

    `rounds` has (amplitude [rad], duration [s], standard error of λ) of each
    excitation.
    """

    fit: Fit
    motor: MotorResult
    rounds: tuple[tuple[float, float, float], ...]


def tune_link(
    guard: Guard,
    wiring: Wiring,
    motor: MotorResult,
    payload: float,
    *,
    longer: float = 1.0,
    tell: Callable[[str], None] = lambda line: None,
) -> LinkResult:
    """Excite the link until every standard error suffices, or the limits are reached.

    `longer` stretches every excitation, for an experiment that is repeated; `tell` is
    told where one reached a limit, and is made again smaller.
    """
    limits = guard.limits
    model = _first_model(guard, wiring)
    law = motor_law(motor.gain, motor.loop, guard, friction=motor.compensation)
    duration = longer * _SHORTEST
    # Half of the sequence's power lies below the vibration.
    bit = _HALF / abs(model.pole)
    reach = min(FIRST, PLANNED * limits.angle)
    # The very sequence on the model: near the resonance the gauge's limit is met before
    # the angle's.
    path = _sequence(guard, motor, reach, bit, duration)
    bent = simulated_torque(model, path[0], guard.period, hold="first")
    reach *= min(PLANNED * limits.torque / float(np.max(np.abs(bent))), 1.0)
    rounds: list[tuple[float, float, float]] = []
    for _ in range(_ROUNDS):
        motion = partial(
            _excited, guard, wiring, motor, law, model, reach, bit, duration
        )
        (record, whole), size = guard.sized(motion, wiring.gauge_noise, tell)
        guard.release()
        moves = experiment_of(record, payload)
        fit = _fitted(moves, experiment_of(whole, payload))
        model = fit.model
        short, reach = shortfall(fit), size * reach
        rounds.append(
            (reach, record.duration, fit.standard_errors.get("order", math.nan))
        )
        if fit.passed and short <= 1.0:
            break
        most = min(
            PLANNED * limits.angle / reach,
            PLANNED * limits.torque / float(abs(record.torque).max()),
            PLANNED * limits.voltage / float(abs(record.voltage).max()),
        )
        # A tenth more of size is less than the errors' own scatter: another round would
        # cost time and change nothing.
        if most < 1.1 and duration >= _LONGEST:
            break
        # Errors fall with the amplitude, so that the shortfall is the factor that is
        # missing; a fifth more allows for their own scatter.
        grown = min(max(1.2 * short, 1.2), _LARGER, max(most, 1.0))
        # What the amplitude may not give, the length must: errors fall with its root.
        duration = min(duration * max(1.0, (1.2 * short / grown) ** 2), _LONGEST)
        reach *= grown
    return LinkResult(fit, motor_again(motor, guard, wiring, fit), tuple(rounds))


def _excited(
    guard: Guard,
    wiring: Wiring,
    motor: MotorResult,
    law: Law,
    model: LinkModel,
    reach: float,
    bit: float,
    duration: float,
    size: float,
) -> tuple[Record, Record]:
    """The record of a random sequence of `size` times its reach, and the same with a
    burst at its end that shows the second mode.
    """
    resonance = abs(model.pole)
    calm(
        guard,
        law,
        stiffness=model.stiffness,
        resonance=resonance,
        noise=wiring.gauge_noise,
    )
    path = _sequence(
        guard, motor, size * reach, bit, duration, start=guard.connect_angle()
    )
    record = follow(guard, law, path, origin=guard.origin)
    fast = max(guard.period, min(_BIT, _HALF / (_SECOND * resonance)))
    # What turns the motor by that speed within one bit; friction comes on top, or the
    # burst would not move it.
    push = size * _PUSH * guard.limits.speed / (motor.fit.gain * fast)
    voltage = min(motor.friction + push, PLANNED * guard.limits.voltage)
    voltages = burst(voltage, fast, _BURST, guard.period)
    follow(guard, law, np.zeros((2, voltages.size)), shaken=voltages)
    return record, guard.record(guard.count - path.shape[1] - voltages.size)


def _sequence(
    guard: Guard,
    motor: MotorResult,
    reach: float,
    bit: float,
    duration: float,
    start: float = 0.0,
) -> Real:
    """A random sequence of ± `reach` [rad] for about `duration` [s]."""
    # The edge of a bit is as fast as the limits allow, and slow enough for the motor's
    # loop to follow: a reference that saturates the voltage excites less than it says.
    rise = max(
        2 * 1.875 * reach / (PLANNED * guard.limits.speed),
        3.0 / motor.loop.pole,
        6 * guard.period,
    )
    bit = max(bit, 1.2 * rise)
    # Fewer than eight bits may leave out the band in which the resonance lies.
    bits = max(8, math.floor(duration / bit))
    return random_steps(reach, bit, rise, bits, guard.period, start=start)


def _fitted(moves: Experiment, whole: Experiment) -> Fit:
    """The link from the moves and the burst behind them, with the second mode or up to
    where there is none.

    What the structure does not have is taken out of the record and the link is fitted
    again: the torque of the second mode, and what still rang from the motion before.
    Either bends λ and the delay, and colours the residual, from which their errors are
    taken; a wrong delay bends the mode. Nothing is held out of these fits, as one of a
    part leaves in the other what would be taken for ringing; whether a part is
    predicted is looked at in the end.
    """
    mode: SecondMode | None = None
    rings, held = np.zeros(whole.output.size), dict[str, float]()
    for _ in range(_CLEANED):
        # With its delay held from the second time on: on the burst it and the mode's
        # phase stand for each other, and only without the mode is it known.
        seen = replace(whole, output=whole.output - rings)
        shown = identify(seen, "UD-FOM", heldout=0.0, fixed=held).model
        before, mode = mode, shown.second_mode or mode
        rest = whole.output
        if mode is not None:
            rest = rest - _torque_of(mode, shown, whole)
        alone = replace(whole, output=rest - rings)
        fit = identify(alone, "UD-FOM", heldout=0.0, details=False)
        rings, held = _ringing(fit, rest), {"delay": fit.delay}
        if (
            before is not None
            and mode is not None
            and math.isclose(
                mode.frequency, before.frequency, rel_tol=ENOUGH["natural_frequency"]
            )
        ):
            break
    clean = rest - rings
    fit = identify(replace(whole, output=clean), "UD-FOM", heldout=0.0)
    # On the moves alone, of which a part is held out: what a fit to everything may hide
    # is whether it predicts.
    tested = identify(replace(moves, output=clean[: moves.output.size]), "UD-FOM")
    found = fit if tested.passed else tested
    return replace(
        found,
        model=replace(found.model, second_mode=mode, unseen_up_to=shown.unseen_up_to),
    )


def _torque_of(mode: SecondMode, model: LinkModel, log: Experiment) -> Real:
    """The torque [N·m] that a second mode adds to a record."""
    alone = LinkModel(
        stiffness=model.stiffness * mode.gain,
        natural_frequency=mode.frequency,
        order=2.0,
        damping=2.0 * mode.damping_ratio * mode.frequency,
        damping_order=1.0,
    )
    return simulated_torque(
        alone, log.motor_angle, log.period, delay=model.gauge_delay, hold="first"
    )


def _ringing(fit: Fit, output: Real) -> Real:
    """The free vibration in what a fit leaves of the output: it begins with the record,
    and only decays.

    Two dampings stand for any: the fit that still has it in its record does not know
    the link's own.
    """
    time = fit.period * np.arange(output.size)
    # s^λ = −ω₀² has its poles at ω e^{±jπ/λ}: a link of order λ rings with ζ =
    # −cos(π/λ).
    turns = [
        np.exp(cmath.rect(abs(fit.model.pole), math.pi / order) * time)
        for order in _DECAYS
    ]
    columns = np.column_stack(
        [part for turn in turns for part in (turn.real, turn.imag)]
    )
    size, *_ = np.linalg.lstsq(columns, output - fit.predicted, rcond=None)
    return np.asarray(columns @ size)


def shortfall(fit: Fit) -> float:
    """The largest standard error over what suffices."""
    errors, model = fit.standard_errors, fit.model
    # ω₀ and gain relative, the delay as the order whose phase j^λ it has at the vibration.
    scale = {
        "order": 1.0,
        "delay": 0.5 * math.pi / abs(model.pole),
        "natural_frequency": model.natural_frequency,
        "gain": abs(fit.gain),
    }
    found = [
        errors[name] / scale[name] / most
        for name, most in ENOUGH.items()
        if name in errors
    ]
    return max(found, default=math.inf)


def experiment_of(record: Record, payload: float | None) -> Experiment:
    """The record as a log."""
    return Experiment(
        period=record.period,
        motor_angle=record.angle,
        output=record.torque,
        payload=payload,
        voltage=record.voltage,
        source="tuning",
    )


def motor_again(
    motor: MotorResult, guard: Guard, wiring: Wiring, fit: Fit
) -> MotorResult:
    """The motor as everything recorded shows it once the gauge's delay is known, and
    its loop.

    A gauge reads curvature, and the moment on the hub is D(s) times that: of a power
    law |jω|^(2−λ), 1.22 at the 11.9 rad/s of the paper's arm. The inertia comes out
    smaller by it, and Γ/J, which the law compensates, is what acts on the hub at the
    vibration.
    """
    try:
        again = fitted_motor(guard.record(), fit.model.gauge_delay, guard.starts)
        # A negative inertia is the noise of moves that hardly load the motor: then the
        # motor alone is known, and no load is made up.
        if again.inertia is None or again.inertia <= 0 or not again.passed:
            return motor
        return closed_motor(again, guard, wiring, motor.rounds)
    except FraclinkError:
        return motor


def _first_model(guard: Guard, wiring: Wiring) -> LinkModel:
    """The link as all that was recorded shows it, or as the last moves alone do, or the
    wiring check's guess.

    The doublets of the wiring show the second mode of a slow link, and smooth moves its
    first.
    """
    fits = []
    for start in {0, guard.starts[-1]}:
        log = experiment_of(guard.record(start), None)
        with contextlib.suppress(FraclinkError):
            fits.append(identify(log, "UD-FOM", details=False))
    if not fits:
        return LinkModel(wiring.stiffness, wiring.natural_frequency)
    return min(fits, key=lambda fit: fit.nmse).model
