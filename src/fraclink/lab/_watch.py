"""`watch`: whether a running arm is still the one for which its law was designed, and
what has changed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from fraclink._arm.experiment import Experiment
from fraclink._display import Overview, Row, Table, displayed, number, rows_of, state_of
from fraclink._files import document
from fraclink._identify import Fit, identify, identify_motor, simulated_torque
from fraclink._law.block import COULOMB_SPEED
from fraclink.errors import FieldError, LogError
from fraclink.lab._tune_causes import sensor_noise
from fraclink.lab._tune_motor import MotorResult
from fraclink.lab._tune_wiring import SURE
from fraclink.lab._tuning import Tuning, measured
from fracsys.checks import checked

__all__ = ["Change", "Watch", "changed_link", "watch"]

# Smallest changes that are reported: half of what justifies a new tuning, and no less
# than the drift covered by the box of the design. Relative, except for delay [s] and
# order.
_WORTH = {
    "natural_frequency": 0.04,
    "gauge_gain": 0.05,
    "gauge_delay": 0.0025,
    "order": 0.01,
    "motor_gain": 0.15,  # the range for which the motor loop is placed
    "friction": 0.4,
}
_ABSOLUTE = ("gauge_delay", "order")
# Parameter of the link -> its attribute in a fit; the last part names its standard error.
_LINK = {
    "natural_frequency": "model.natural_frequency",
    "gauge_gain": "gain",
    "gauge_delay": "delay",
    "order": "model.order",
}
# Least motion, in vibrations of the link: frequency and decay need several.
_LEAST_VIBRATIONS = 5.0


@dataclass(frozen=True)
class Change:
    """One parameter of the arm: its values in the tuning and in the record, and the
    standard error of their difference.

    name: "natural_frequency", "gauge_gain", "gauge_delay", "order" (λ, higher with less
    damping), "motor_gain" (K/J) or "friction"; with " within the record" where its
    halves differ. was, now and standard_error are in the parameter's unit.
    """

    name: str
    was: float
    now: float
    standard_error: float
    changed: bool

    @property
    def rows(self) -> tuple[Row, ...]:
        """The change as shown to people and programs."""
        return rows_of(
            self,
            "name",
            Row("", "what", self.name.replace("_", " ")),
            ("was", "tuned"),
            ("now", "now"),
            ("standard_error", "± standard error", "", 2),
            "changed",
            Row("", "verdict", "changed" if self.changed else "as before"),
        )


@displayed
@document("watch")
@dataclass(frozen=True)
class Watch:
    """What a record says about a tuned arm.

    Parameters
    ----------
    changes
        every parameter that was compared.
    residual, expected
        standard deviation of the torque that a fit of the record leaves unexplained;
        and that of the sensors' noise, or what the tuning's fit left where that is more
        [N·m].
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
        """The reasons for a retune; empty if the arm is unchanged."""
        names = tuple(change.name for change in self.changes if change.changed)
        return names or (
            ("unexplained motion",)
            # More than half of the residual's power is unexplained.
            if self.residual**2 > 2.0 * self.expected**2
            else ()
        )

    @property
    def passed(self) -> bool:
        """Whether the arm is still the one that was tuned."""
        return not self.due

    def overview(self) -> Overview:
        """What has changed, and everything that was compared."""
        due = ", ".join(name.replace("_", " ") for name in self.due)
        unchanged = f"as it was tuned, judged by {self.motion:.0f} s of motion"
        rows = rows_of(self, "due", "residual", "expected", "motion")
        note = (
            f"the fit leaves {number(self.residual, 2)} N·m, "
            f"sensors and tuning explain {number(self.expected, 2)} N·m"
        )
        return Overview(
            f"a retune is due: {due}" if due else unchanged,
            state_of(self.passed),
            rows,
            (Table.of("changes", self.changes),),
            notes=(note,),
        )


@checked
def watch(log: Experiment, tuning: Tuning) -> Watch:
    """Compare a record of a running arm with its tuning: ω₀, gauge gain, gauge delay or
    λ, K/J, friction, residual.

    The link's ω₀ and gain are fitted anew, with the delay or with λ, whichever explains
    the record better; friction is fitted with the motor's K/J. A parameter counts as
    changed if it differs by more than half of what justifies a retune and by five
    standard errors, friction only if it has grown. If the halves of the record differ
    by as much, that is reported, and only the second half is compared with the tuning.

    Parameters
    ----------
    log
        a record with the voltage, from rest or with its `earlier_angle`;
        `RealtimeRun.experiment` makes one.
    tuning
        what `tune` found.

    Raises
    ------
    FieldError
        a tuning without a model, another period, less motion than five vibrations.

    Examples
    --------
    See docs/how-to/tune-an-arm.md.
    """
    wiring, motor, link = measured(tuning)
    if not math.isclose(log.period, tuning.period, rel_tol=1e-6):
        raise FieldError(
            "log.period",
            log.period,
            "not the tuning's",
            f"{tuning.period:g} s",
            "record at the period of the law",
        )
    # Only the time in motion counts: an arm at rest for a minute shows only noise.
    moving = _moving_time(log)
    least = _LEAST_VIBRATIONS * math.tau / link.fit.model.resonance
    if moving < least:
        raise FieldError(
            "log",
            f"{moving:.3g} s of motion",
            "too little to tell",
            f">= {least:.3g} s, five vibrations of the link",
            "record for longer, while the arm moves",
        )
    baseline = link.fit
    halves = [_part(log, rows) for rows in log.split(0.5)]
    within: tuple[Change, ...] = ()
    if min(map(_moving_time, halves)) >= least:
        former, latter = (_fitted(half, baseline) for half in halves)
        within = tuple(
            replace(change, name=f"{change.name} within the record")
            for change in _link_changes(former, latter)
            if change.changed
        )
    now = halves[1] if within else log
    fit = latter if within else _fitted(log, baseline)
    changes = (
        *within,
        *_link_changes(baseline, fit),
        *_motor_changes(now, fit, motor),
    )
    noise = sensor_noise(fit.model, log.output, log.period, wiring)
    expected = max(noise, math.sqrt(baseline.mse))
    return Watch(changes, math.sqrt(fit.mse), expected, moving)


def _part(log: Experiment, rows: slice) -> Experiment:
    """A range of samples including the earlier angle, on which the swing of the link
    depends.
    """
    return replace(
        log,
        motor_angle=log.motor_angle[rows],
        output=log.output[rows],
        voltage=None if log.voltage is None else log.voltage[rows],
        earlier_angle=log.whole_angle[
            : log.whole_angle.size - log.motor_angle.size + (rows.start or 0)
        ]
        if rows.start
        else log.earlier_angle,
    )


def _fitted(log: Experiment, known: Fit) -> Fit:
    """The link with λ held or with the delay held, whichever has the smaller residual:
    with both free, each compensates the phase of the other, and neither would be
    identified as changed.
    """
    choices: list[dict[str, float]] = [{}]
    if known.model.order < 2.0:
        choices = [{"order": known.model.order}, {"delay": known.delay}]
    return min(
        (
            identify(
                log,
                known.structure,
                fixed=fixed,
                hold="first",
                heldout=0.0,
                details=False,
            )
            for fixed in choices
        ),
        # No gauge is ahead of the link: a negative delay (W309) only fits noise.
        key=lambda fit: ("W309" in {finding.code for finding in fit.findings}, fit.mse),
    )


def changed_link(log: Experiment, known: Fit) -> tuple[str, ...]:
    """Sentences on a link that moves differently in the last quarter of a record than
    in its fit, with the cause and its remedy.
    """
    later = _part(log, log.split(0.75)[1])
    frequency, _, delay, _ = _link_changes(known, _fitted(later, known))
    if frequency.changed:
        share = 100.0 * (frequency.was / frequency.now) ** 2
        # A joint that gives makes a link softer, which looks like more mass.
        loose = (
            "a part is loose"
            if share < 100.0
            else "a joint gives, as with play in the gear"
        )
        return (
            f"the link swings as if with {share:.0f} % of the mass that it was tuned with: the payload "
            f"slipped or was changed, or {loose}; fix it, and tune again",
        )
    if delay.changed and delay.now > delay.was:
        late = 1e3 * (delay.now - delay.was)
        return (
            f"the link follows the motor {late:.2g} ms later than when it was measured, as with play in the gear or "
            "in a coupling, which the motor crosses first; reduce the play",
        )
    return ()


def _link_changes(was: Fit, now: Fit) -> tuple[Change, ...]:
    """Changes of ω₀, gauge gain, gauge delay and λ between two independent fits."""
    changes = []
    for name, path in _LINK.items():
        value, key = attrgetter(path), path.rpartition(".")[2]
        errors = (fit.standard_errors.get(key, 0.0) for fit in (now, was))
        changes.append(_change(name, value(was), value(now), math.hypot(*errors)))
    return tuple(changes)


def _moving_time(log: Experiment) -> float:
    # In motion: faster than where the friction compensation fades. Measured over 50 ms,
    # since one encoder count per sample is already a higher speed.
    lag = max(1, round(0.05 / log.period))
    speed = np.abs(log.motor_angle[lag:] - log.motor_angle[:-lag]) / (lag * log.period)
    return float(np.count_nonzero(speed > COULOMB_SPEED)) * log.period


def _change(name: str, was: float, now: float, spread: float) -> Change:
    # A delay has no scale of its own: 2.5 ms cost the same phase for a gauge without
    # delay.
    worth = _WORTH[name] * (1.0 if name in _ABSOLUTE else abs(was))
    off = abs(now - was)
    # Both, since the errors of a short record may exceed what is worth reporting.
    return Change(name, was, now, spread, off > worth and off > SURE * spread)


def _motor_changes(log: Experiment, fit: Fit, motor: MotorResult) -> tuple[Change, ...]:
    """K/J, and friction and dead zone as one voltage; nothing if the record has no
    voltage or too few moves.
    """
    if log.voltage is None:
        return ()
    # From the whole angle: a link that swings at a cut loads the motor according to its
    # earlier motion.
    whole = simulated_torque(fit.model, log.whole_angle, log.period, hold="first")
    torque = whole[-log.motor_angle.size :]
    try:
        motor_fit = identify_motor(
            log.voltage,
            log.motor_angle,
            period=log.period,
            torque=torque,
            delay=motor.fit.delay,
            # As a single voltage, since a record of moves only shows their sum.
            dead_zone=0.0,
        )
    except LogError:
        return ()
    gain = _change(
        "motor_gain",
        motor.fit.gain,
        motor_fit.gain,
        math.hypot(
            motor_fit.standard_errors["gain"], motor.fit.standard_errors["gain"]
        ),
    )
    # Converted to the voltage of the earlier motor: a weaker motor needs more voltage
    # for the same friction.
    friction = motor_fit.coulomb_voltage * motor_fit.gain / motor.fit.gain
    # Its own error and a twentieth of the earlier value, since friction varies with the
    # angle of the gear.
    spread = math.hypot(
        motor_fit.standard_errors["coulomb_voltage"], 0.05 * motor.friction
    )
    change = _change("friction", motor.friction, friction, spread)
    # Moves that reverse often appear to have less friction: only an increase counts as a
    # change.
    return gain, replace(change, changed=change.changed and change.now > change.was)
