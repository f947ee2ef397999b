"""`watch`: whether a running arm is still the one that its law was made for, and what
has changed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from fraclink._arm.experiment import Experiment
from fraclink._display import displayed
from fraclink._files import document
from fraclink._identify import Fit, identify, identify_motor, simulated_torque
from fraclink.errors import FieldError, LogError
from fraclink.lab._tuning import Tuning
from fracsys.checks import checked

__all__ = ["Change", "Watch", "watch"]

# What a change must exceed to be named: half of what is worth a retune, and more than
# the drift that the design's box holds. Relative, but for the delay [s].
_WORTH = {
    "natural_frequency": 0.04,
    "gauge_gain": 0.05,
    "gauge_delay": 0.0025,
    "friction": 0.4,
}
# standard errors, as well: the errors of a short record are larger than the limits
# above
_SURE = 4.0
_LEAST_MOTION = 4.0  # [s] of motion; less shows nothing
_MOVING = 0.02  # [rad/s]
_UNEXPLAINED = 4.0  # times the residual that the tuning left, with nothing else changed


@dataclass(frozen=True)
class Change:
    """One parameter of the arm: what the law was made for, what the record shows, and
    how sure that is.

    name: "natural_frequency", "gauge_gain", "gauge_delay", "friction"; was, now,
    standard_error in its unit, and `changed`.
    """

    name: str
    was: float
    now: float
    standard_error: float
    changed: bool

    def __str__(self) -> str:
        word = "changed" if self.changed else "as before"
        return f"{self.name} {word}: {self.was:.4g}, now {self.now:.4g} ± {self.standard_error:.2g}"


@displayed
@document("watch", summary=lambda found: {"passed": found.passed})
@dataclass(frozen=True)
class Watch:
    """What a record says of a tuned arm.

    Parameters
    ----------
    changes
        every parameter that was compared.
    residual, expected
        standard deviation of the torque that the record's own best fit leaves, and of
        the gauge's noise when the arm was tuned [N·m].
    motion
        how long the arm moved [s].

    Examples
    --------
    >>> Watch((Change("gauge_gain", 1.6, 1.76, 0.01, True),), 0.01, 0.01, 12.0).due
    ('gauge_gain',)
    """

    changes: tuple[Change, ...]
    residual: float
    expected: float
    motion: float

    __made_by__ = "fraclink.lab.watch(log, tuning)"

    @property
    def due(self) -> tuple[str, ...]:
        """What a retune is due for; empty where the arm is as it was."""
        named = tuple(change.name for change in self.changes if change.changed)
        return named or (
            ("unexplained motion",)
            if self.residual > _UNEXPLAINED * self.expected
            else ()
        )

    @property
    def passed(self) -> bool:
        """Whether the arm is still the one that was tuned."""
        return not self.due


@checked
def watch(log: Experiment, tuning: Tuning) -> Watch:
    """Compare a record of a running arm with its tuning: ω₀, gauge gain, gauge delay,
    friction, residual.

    The link's ω₀, gain and delay are fitted anew with λ held, and the friction with the
    motor's K/J; each is named where it is off by more than half of what is worth a
    retune and by four standard errors, friction only where it has grown.

    Parameters
    ----------
    log
        a record that begins at rest, or that knows the angle before its cut, with the
        voltage; `RealtimeRun.experiment` makes one.
    tuning
        what `tune` found.

    Raises
    ------
    FieldError
        a tuning without a model, another period, less than 4 s of motion.

    Examples
    --------
    See docs/how-to/tune-an-arm.md.
    """
    if tuning.link is None or tuning.motor is None or tuning.wiring is None:
        allowed, remedy = (
            "a tuning that has a model",
            "resume it: `fraclink tune --resume`",
        )
        raise FieldError(
            "tuning",
            tuning.stopped or "unfinished",
            "without a model",
            allowed=allowed,
            remedy=remedy,
        )
    if not math.isclose(log.period, tuning.period, rel_tol=1e-6):
        allowed, remedy = f"{tuning.period:g} s", "record at the period of the law"
        raise FieldError(
            "log.period", log.period, "not the tuning's", allowed=allowed, remedy=remedy
        )
    # Motion and not length: an arm that rests for a minute shows its noise.
    moving = _moving_time(log)
    if moving < _LEAST_MOTION:
        allowed, remedy = f">= {_LEAST_MOTION:g} s", "give a longer record, of moves"
        raise FieldError(
            "log",
            f"{moving:.3g} s of motion",
            "too little to tell",
            allowed=allowed,
            remedy=remedy,
        )
    known = tuning.link.fit
    # λ is the link's material and does not change within a run; left free it takes up
    # what a changed delay or gain does to the phase, and neither is named.
    fixed = {"order": known.model.order} if known.model.order < 2.0 else {}
    fit = identify(
        log, known.structure, fixed=fixed, hold="first", heldout=0.0, details=False
    )
    changes = (
        _compared(
            "natural_frequency",
            known.model.natural_frequency,
            fit.model.natural_frequency,
            fit,
            known,
        ),
        _compared("gauge_gain", known.gain, fit.gain, fit, known, "gain"),
        _compared("gauge_delay", known.delay, fit.delay, fit, known, "delay"),
        *_friction(log, fit, tuning),
    )
    return Watch(changes, math.sqrt(fit.mse), tuning.wiring.gauge_noise, moving)


def _moving_time(log: Experiment) -> float:
    # Over 50 ms: from one sample to the next an encoder's count is a speed above the
    # threshold.
    lag = max(1, round(0.05 / log.period))
    speed = np.abs(log.motor_angle[lag:] - log.motor_angle[:-lag]) / (lag * log.period)
    return float(np.count_nonzero(speed > _MOVING)) * log.period


def _compared(
    name: str, was: float, now: float, fit: Fit, known: Fit, error: str = ""
) -> Change:
    # Both fits err, independently.
    parts = (found.standard_errors.get(error or name, 0.0) for found in (fit, known))
    return _change(name, was, now, math.hypot(*parts))


def _change(name: str, was: float, now: float, spread: float) -> Change:
    # A delay has no scale of its own: 2.5 ms cost the same phase behind a gauge that is
    # never late.
    worth = _WORTH[name] * (1.0 if name == "gauge_delay" else abs(was))
    off = abs(now - was)
    return Change(name, was, now, spread, off > worth and off > _SURE * spread)


def _friction(log: Experiment, fit: Fit, tuning: Tuning) -> tuple[Change, ...]:
    """Friction and dead zone as one voltage; nothing where the record has no voltage or
    too few moves.
    """
    assert tuning.motor is not None  # `watch` looked  # noqa: S101
    if log.voltage is None:
        return ()
    # All of the angle: a link that swings at a cut loads the motor by what it did
    # before.
    whole = simulated_torque(fit.model, log.whole_angle, log.period, hold="first")
    torque = whole[-log.motor_angle.size :]
    try:
        found = identify_motor(
            log.voltage,
            log.motor_angle,
            period=log.period,
            torque=torque,
            delay=tuning.motor.fit.delay,
            # As one voltage: what a record of moves shows is their sum.
            dead_zone=0.0,
        )
    except LogError:
        return ()
    # Its own error and a twentieth of what it was: friction depends on where the gear
    # stands.
    spread = math.hypot(
        found.standard_errors["coulomb_voltage"], 0.05 * tuning.motor.friction
    )
    grown = _change("friction", tuning.motor.friction, found.coulomb_voltage, spread)
    # Less friction than before is how moves that turn round often look, too: only more
    # of it is a change.
    return (replace(grown, changed=grown.changed and grown.now > grown.was),)
