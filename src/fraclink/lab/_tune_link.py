"""The link: an excitation planned from the errors of the last fit, which grows until
they are small enough.
"""

from __future__ import annotations

import cmath
import contextlib
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from fraclink._arm.experiment import Experiment
from fraclink._arm.link import LinkModel, SecondMode
from fraclink._files import document
from fraclink._identify import Fit, identify, simulated_torque
from fraclink._law import Law
from fraclink.errors import FraclinkError
from fraclink.lab._tune_guard import PLANNED, Guard, Record, largest
from fraclink.lab._tune_motion import burst, calm, follow, motor_law, random_steps
from fraclink.lab._tune_motor import (
    FIRST,
    ROUNDS,
    MotorResult,
    breakaway_voltage,
    closed_motor,
    fitted_motor,
)
from fraclink.lab._tune_wiring import Wiring
from fracsys.checks import Real

__all__ = ["LinkResult", "experiment_of", "motor_again", "tune_link"]

# Sufficient standard errors. The remaining uncertainty is covered by the box: the 95 %
# interval of λ, and that of a delay with the same phase at the vibration frequency,
# cost 2 · 0.018 · π/2, 3° of margin; those of ω₀ and of the gauge's gain are ±2.4 % and
# ±9 %.
ENOUGH = {"order": 0.018, "natural_frequency": 0.012, "gain": 0.045, "delay": 0.018}
# [s] of one excitation. Errors fall with the square root of the length, but in
# proportion to the amplitude, which is therefore increased first.
_SHORTEST, _LONGEST = 4.0, 16.0
# [s] at most; [s]; share of the speed limit. The power density of a random voltage that
# changes every T falls to half at 2.8/T, here at 25 times the resonance: the second
# mode of a link that weighs an eighth of its payload. The smooth moves end at a tenth
# of that. A quarter of the speed limit is small.
_BIT, _BURST, _PUSH = 0.012, 2.0, 0.25
_HALF, _SECOND = 2.8, 25.0
# A clamped beam has its second mode at 6.27 times its first, each a factor of √6.27
# from their geometric mean; a mass at its tip moves them farther apart.
_BETWEEN = math.sqrt(6.27)
_STEEL = 5e-4  # damping ratio of steel alone, half its loss factor: no link has less
# Largest number of fits to a record corrected for effects outside the structure. The second
# mode is known after two; without one, every fit leaves 0.1 to 0.7 of the ringing's error,
# and what the sixth changes is at most a thirtieth of the residual.
_CLEANED = 6
# orders λ of links that ring for a long time, and for a few periods
_DECAYS = (1.97, 1.87)


@document("tuned-link")
@dataclass(frozen=True, eq=False)
class LinkResult:
    """The link's fit, the motor with the link's own torque, and the result of each
    excitation.

    `rounds` has (amplitude [rad], duration [s], standard error of λ) of each
    excitation.
    """

    fit: Fit
    motor: MotorResult
    rounds: tuple[tuple[float, float, float], ...]

    @property
    def residual(self) -> Real:
        """What the fit leaves of the moves [N·m], without the burst after them: in that,
        an error of the gauge's delay is a torque of the second mode.
        """
        return self.fit.residual[: round(self.rounds[-1][1] / self.fit.period)]


def tune_link(
    guard: Guard,
    wiring: Wiring,
    motor: MotorResult,
    payload: float,
    tell: Callable[[str], None] = lambda line: None,
) -> LinkResult:
    """Excite the link until the fit passes and every standard error suffices, or the
    limits are reached.

    `tell` is called if an excitation reached a limit and is repeated smaller, or if
    another one follows.
    """
    limits = guard.limits
    model = _first_model(guard, wiring)
    law = motor_law(motor.gain, motor.loop, guard, friction=motor.compensation)
    duration = _SHORTEST
    reach = min(FIRST, PLANNED * limits.angle)
    # Plan with the same sequence on the model: near the resonance the limit of the
    # gauge is reached before that of the angle. Half of the planned torque leaves room
    # for a larger excitation, and keeps a hardening link near the deflections of its
    # moves.
    path = _sequence(guard, motor, model, reach, duration)
    peak = np.abs(simulated_torque(model, path[0], guard.period, hold="first")).max()
    reach *= min(0.5 * PLANNED * limits.torque / float(peak), 1.0)
    rounds: list[tuple[float, float, float]] = []
    for number in range(1, ROUNDS + 1):
        if number > 1:
            tell(f"experiment {number} on the link, larger or longer")
        motion = partial(_excited, guard, wiring, motor, law, model, reach, duration)
        (record, whole), size = guard.sized(motion, wiring.gauge_noise, tell)
        guard.release()
        moves = experiment_of(record, payload)
        fit = _fitted(moves, experiment_of(whole, payload))
        model = fit.model
        # A fit that fails a gate needs at least twice the motion.
        short, reach = max(shortfall(fit), 1.0 if fit.passed else 2.0), size * reach
        rounds.append(
            (reach, record.duration, fit.standard_errors.get("order", math.nan))
        )
        if short <= 1.0:
            break
        most = min(
            PLANNED * limits.angle / reach,
            PLANNED * limits.torque / largest(record.torque),
            PLANNED * limits.voltage / largest(record.voltage),
        )
        # Another tenth of size is less than the scatter of the errors: a further round
        # would take time and change nothing.
        if most < 1.1 and duration >= _LONGEST:
            break
        # Errors fall in proportion to the amplitude, so the shortfall is the missing
        # factor; another fifth allows for their scatter.
        factor = min(max(1.2 * short, 1.2), max(most, 1.0))
        # If the amplitude cannot grow enough, the length must: errors fall with its
        # square root.
        duration = min(duration * max(1.0, (1.2 * short / factor) ** 2), _LONGEST)
        reach *= factor
    return LinkResult(fit, motor_again(motor, guard, wiring, fit), tuple(rounds))


def _excited(
    guard: Guard,
    wiring: Wiring,
    motor: MotorResult,
    law: Law,
    model: LinkModel,
    reach: float,
    duration: float,
    size: float,
) -> tuple[Record, Record]:
    """The record of a random sequence of `size` times its reach, and the same with a
    burst at its end that excites the second mode.
    """
    resonance = model.resonance
    calm(
        guard,
        law,
        stiffness=model.stiffness,
        resonance=resonance,
        noise=wiring.gauge_noise,
    )
    path = _sequence(guard, motor, model, size * reach, duration, start=guard.angle)
    start = guard.count
    record = follow(guard, law, path, origin=guard.origin)
    fast = max(guard.period, min(_BIT, _HALF / (_SECOND * resonance)))
    # The voltage that changes the motor's speed by this amount within one bit; friction
    # is added, otherwise the burst would not move the motor.
    push = size * _PUSH * guard.limits.speed / (motor.fit.gain * fast)
    voltage = min(motor.friction + push, PLANNED * guard.limits.voltage)
    voltages = burst(voltage, fast, _BURST, guard.period)
    follow(guard, law, np.zeros((2, voltages.size)), shaken=voltages)
    return record, guard.record(start)


def _sequence(
    guard: Guard,
    motor: MotorResult,
    model: LinkModel,
    reach: float,
    duration: float,
    start: float = 0.0,
) -> Real:
    """A random sequence of ± `reach` [rad] for about `duration` [s]."""
    # The edge of a bit is as fast as the limits allow, and slow enough for the motor
    # loop to follow: a reference that saturates the voltage excites less than its model
    # predicts.
    rise = max(
        2 * 1.875 * reach / (PLANNED * guard.limits.speed),
        3.0 / motor.loop.pole,
        6 * guard.period,
    )
    # The sequence's power density falls to half at the vibration frequency.
    bit = max(_HALF / model.resonance, 1.2 * rise)
    # Fewer than eight bits may leave out the frequency band of the resonance.
    bits = max(8, math.floor(duration / bit))
    return random_steps(reach, bit, rise, bits, guard.period, start=start)


def _fitted(moves: Experiment, whole: Experiment) -> Fit:
    """The link from the moves and the burst after them, with the second mode if it is
    visible.

    Effects that the structure does not include are removed from the record, and the
    link is fitted again: the torque of the second mode, and the remaining vibration of
    earlier motion. Both bias λ and the delay, and colour the residual from which their
    errors are computed; a wrong delay in turn biases the mode. Nothing is held out of
    these fits, since the residual of a held-out part would be taken for ringing;
    prediction is tested at the end.
    """
    mode: SecondMode | None = None
    rings, fixed = np.zeros(whole.output.size), dict[str, float]()
    link = identify(moves, "UD-FOM", heldout=0.0, details=False).model
    for _ in range(_CLEANED):
        # The delay is held from the second time on: on the burst it cannot be separated
        # from the phase of the mode, so it is determined without the mode only.
        cleaned = replace(whole, output=whole.output - rings)
        model = identify(cleaned, "UD-FOM", heldout=0.0, fixed=fixed).model
        before, mode = mode, model.second_mode or mode
        if model.resonance > _BETWEEN * link.resonance:
            mode = _louder_mode(link, cleaned, fixed)
        rest = whole.output
        if mode is not None:
            rest = rest - second_torque(mode, model, whole.motor_angle, whole.period)
        alone = replace(whole, output=rest - rings)
        fit = identify(alone, "UD-FOM", heldout=0.0, details=False)
        link = fit.model
        rings, fixed = _ringing(fit, rest, mode), {"delay": fit.delay}
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
    # On the moves alone, with a part held out: a fit to everything does not show
    # whether it predicts.
    trial = identify(replace(moves, output=clean[: moves.output.size]), "UD-FOM")
    result = fit if trial.passed else trial
    return replace(
        result,
        model=replace(result.model, second_mode=mode, unseen_up_to=model.unseen_up_to),
    )


def _louder_mode(
    link: LinkModel, cleaned: Experiment, fixed: dict[str, float]
) -> SecondMode:
    """The second mode, from the residual of the link in a record in which the mode has
    more energy than the link.
    """
    own = simulated_torque(
        link,
        cleaned.motor_angle,
        cleaned.period,
        delay=link.gauge_delay,
        hold="first",
    )
    rest = replace(cleaned, output=cleaned.output - own)
    louder = identify(rest, "UD-FOM", heldout=0.0, fixed=fixed, details=False).model
    return SecondMode(
        louder.resonance,
        louder.stiffness / link.stiffness,
        max(-math.cos(math.pi / louder.order), _STEEL),
    )


def second_torque(
    mode: SecondMode, model: LinkModel, motor_angle: Real, period: float
) -> Real:
    """The torque [N·m] that the second mode of a link adds to that of the first."""
    alone = LinkModel(
        stiffness=model.stiffness * mode.gain,
        natural_frequency=mode.frequency,
        order=2.0,
        damping=2.0 * mode.damping_ratio * mode.frequency,
        damping_order=1.0,
    )
    return simulated_torque(
        alone, motor_angle, period, delay=model.gauge_delay, hold="first"
    )


def _ringing(fit: Fit, output: Real, mode: SecondMode | None) -> Real:
    """The free vibrations in the residual of a fit: they begin with the record and only
    decay.

    Two dampings represent all others: a fit to a record that still contains the
    vibration does not know the damping of the link. That of its second mode is known,
    as it vibrates freely after every edge.
    """
    time = fit.period * np.arange(output.size)
    # s^λ = −ω₀² has its poles at ω e^{±jπ/λ}: a link of order λ rings with ζ =
    # −cos(π/λ).
    poles = [cmath.rect(fit.model.resonance, math.pi / order) for order in _DECAYS]
    if mode is not None:
        poles.append(cmath.rect(mode.frequency, math.acos(-mode.damping_ratio)))
    turns = [np.exp(pole * time) for pole in poles]
    columns = np.column_stack(
        [part for turn in turns for part in (turn.real, turn.imag)]
    )
    size, *_ = np.linalg.lstsq(columns, output - fit.predicted, rcond=None)
    return columns @ size


def shortfall(fit: Fit) -> float:
    """The largest ratio of a standard error to the sufficient one."""
    errors, model = fit.standard_errors, fit.model
    # ω₀ and gain are relative; the delay is expressed as the order λ whose phase j^λ it
    # has at the vibration frequency.
    scale = {
        "order": 1.0,
        "delay": 0.5 * math.pi / model.resonance,
        "natural_frequency": model.natural_frequency,
        "gain": abs(fit.gain),
    }
    ratios = [
        errors[name] / scale[name] / most
        for name, most in ENOUGH.items()
        if name in errors
    ]
    return max(ratios, default=math.inf)


def experiment_of(record: Record, payload: float | None) -> Experiment:
    """The record as a log."""
    return Experiment(
        period=record.period,
        motor_angle=record.angle,
        output=record.torque,
        payload=payload,
        voltage=record.voltage,
        source="fraclink tune",
    )


def motor_again(
    motor: MotorResult, guard: Guard, wiring: Wiring, fit: Fit
) -> MotorResult:
    """The motor from the whole record after the gauge's delay is known, and its loop.

    A gauge reads curvature, and the moment on the hub is D(s) times that: for a power
    law |jω|^(2−λ), 1.22 at the 11.9 rad/s of the paper's arm. The inertia comes out
    smaller by this factor, so that Γ/J, which the law compensates, is the true effect
    on the hub at the vibration frequency.
    """
    try:
        again = fitted_motor(guard.record(), fit.model.gauge_delay, guard.starts)
        # A negative inertia is noise from moves that hardly load the motor: then only
        # the motor is known, and no load is assumed.
        if again.inertia is None or again.inertia <= 0 or not again.passed:
            return motor
        closed = closed_motor(again, guard, wiring)
        held = breakaway_voltage(
            guard.record(), closed, wiring.count, fit.model.gauge_delay
        )
        return replace(closed, breakaway=held)
    except FraclinkError:
        return motor


def _first_model(guard: Guard, wiring: Wiring) -> LinkModel:
    """The link fitted to the whole record or to the last moves alone, or the wiring
    check's guess.

    The doublets of the wiring show the second mode of a slow link, and smooth moves its
    first: a model of the wrong mode fails to predict what it was not fitted to.
    """
    fits = []
    for start in {0, guard.starts[-1]}:
        log = experiment_of(guard.record(start), None)
        with contextlib.suppress(FraclinkError):
            fits.append(identify(log, "UD-FOM", details=False))
    if not fits:
        return LinkModel(wiring.stiffness, wiring.natural_frequency)
    return min(fits, key=lambda fit: (not fit.passed, fit.nmse)).model
