"""The twin in place of a real arm: in real time, or in this process without a clock."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np

from fraclink import _kernels
from fraclink._arm.reference import LONGEST
from fraclink._display import Overview, Row, displayed, rows_of, state_of
from fraclink._files import document
from fraclink._law import MODES
from fraclink._law.limits import Limits
from fraclink._simulate import Twin
from fraclink._simulate.kernel import ArmState
from fraclink.errors import FieldError
from fraclink.lab._connections import Callback, Command, Connection, arm_end
from fraclink.lab._machine import (
    PRIORITY,
    Priority,
    check_machine,
    granted,
    period_ns,
)
from fracsys.checks import Between, Real, Seed, above, checked
from fracsys.checks.equality import compared

__all__ = ["ServedArm", "SimulatedArm", "serve_arm"]


_DRIVE_OFF = (MODES.index("idle"), MODES.index("off"))
_SIGNALS = ("tip_angle", "motor_angle", "torque", "voltage", "connected")
_COUNTS = ("late", "controllers", "silences", "rejected")


@displayed
@document(
    "served-arm",
    version=2,
    container="npz",
    summary=lambda arm: {"passed": arm.passed, "simulated": True},
)
@compared
@dataclass(frozen=True, eq=False)
class ServedArm:
    """What really happened at the simulated arm, one value for each of its periods;
    shape (N,).

    tip_angle θt and motor_angle θm [rad], torque Γ [N·m], the voltage that acted [V],
    connected: 1 where a controller was heard. `period` [s]; `late`, periods that began
    after their own end; `controllers` that came, `silences`: how many of them left
    without a stop, so that the watchdog switched the drive off; `rejected` messages;
    `scheduling`: what the machine granted.
    """

    tip_angle: Real
    motor_angle: Real
    torque: Real
    voltage: Real
    connected: Real
    period: float
    late: int
    controllers: int
    silences: int
    rejected: int
    scheduling: str

    @property
    def time(self) -> Real:
        """Time of each period since the arm was started [s]."""
        return np.asarray(self.period * np.arange(len(self.tip_angle)))

    @property
    def passed(self) -> bool:
        """Whether every controller left with a stop: the watchdog never had to act."""
        return self.silences == 0

    def overview(self) -> Overview:
        """How many periods and controllers there were, and how they ended."""
        last = float(self.tip_angle[-1]) if len(self.tip_angle) else None
        rows = rows_of(
            self,
            Row("periods", "periods", len(self.voltage)),
            ("late", "late periods"),
            ("controllers", "controllers"),
            ("silences", "left without a stop"),
            ("rejected", "messages rejected"),
            Row("last_tip_angle", "", last),
        )
        headline = (
            f"{self.controllers} controllers, {self.silences} left without a stop"
        )
        return Overview(headline, state_of(self.passed), rows)


@checked
def serve_arm(
    twin: Twin,
    connection: Connection,
    period: float,
    *,
    duration: Annotated[float, above(0.0, 1e300, "s")] = 600.0,
    # Silence for twice as long as a law bridges: such a controller will not return.
    watchdog: Annotated[int, Between(1, 1000, "periods")] = 2 * Limits.missed_limit,
    once: bool = False,
    seed: Seed = 0,
    priority: Priority = PRIORITY - 10,
    begin: Callable[[str], None] = lambda name: None,
    clock: Any = None,
) -> ServedArm:
    """Run the twin in real time and let controllers reach it; return what happened.

    In every period the arm takes the newest command, samples encoder and gauge, sends
    the sample and moves on under that command's voltage, so that a voltage acts one
    period after its sample; a twin with a longer `voltage_delay` adds the rest itself.
    One controller is heard at a time. When it has been silent for `watchdog` periods,
    or sends a stop, the voltage is 0, its run is over, and no command of that run is
    obeyed again, however late it comes; the next controller may come. Ends after
    `duration`, at a signal, or with `once` when the first controller has left.

    Parameters
    ----------
    twin
        with a `voltage_delay` of at least 1.
    connection
        `Serial` or `Udp`, where controllers reach it. `Udp` listens at its host; the
        port "pty" of `Serial` is a pseudo-terminal.
    period
        the law's [s].
    duration
        time to serve [s], at most 2 000 000 periods.
    watchdog
        silent periods after which the drive is switched off.
    once
        end when the first controller has left.
    seed
        of the gauge's noise.
    priority
        of SCHED_FIFO, below the controller's; 0 asks for none. The result states a
        refusal.
    begin
        called with the name of the pseudo-terminal, once a controller may open it.
    clock
        of a test, with `now_ns()` and `sleep_until(ns)`; default: the machine's.

    Raises
    ------
    FieldError
        A value out of its range, a port or name in use, a system other than Linux.
    """
    check_machine()
    # Whole nanoseconds, as in the message: both ends test their periods for equality.
    nanoseconds = period_ns(period)
    Between(period, LONGEST * period, "s").check("duration", duration)
    # A sample goes out and its command comes back; without this period of delay the arm
    # would have to respond before it receives the command.
    if twin.voltage_delay < 1:
        raise FieldError(
            "voltage_delay",
            twin.voltage_delay,
            "shorter than a message's way",
            ">= 1 period",
            "a command acts one period after its sample here",
        )
    # The transmission of the messages is the first period of the twin's delay.
    arm = ArmState(replace(twin, voltage_delay=twin.voltage_delay - 1), period, b"")
    noise = np.random.default_rng(seed).standard_normal(math.ceil(duration / period))
    with arm_end(connection, begin) as way:
        outcome, record = _kernels.realtime_serve(
            way,
            arm,
            # Drawn in advance: the loop in C calls no Python, and the noise is that of
            # `simulate` with the same seed.
            twin.gauge.offset + twin.gauge.noise * noise,
            nanoseconds,
            watchdog,
            once,
            priority,
            _kernels.RealtimeClock(clock),
        )
    columns = (*SimulatedArm.COLUMNS, "connected")
    parts: dict[str, Any] = {
        name: record[:, columns.index(name)].copy() for name in _SIGNALS
    }
    parts |= {name: int(outcome[name]) for name in _COUNTS}
    return ServedArm(
        **parts,
        period=period,
        scheduling=granted(outcome, priority)[0],
    )


class SimulatedArm:
    """A twin that a `Callback` reaches, without a clock: each call of `write` is one
    period of its life.

    What really happened is kept, one row for each period.

    Parameters
    ----------
    twin
        its `voltage_delay` counts from a sample to the effect of the voltage that
        answers it.
    period
        [s].
    seed
        of the gauge's noise.

    Examples
    --------
    >>> import fraclink as fl
    >>> arm = SimulatedArm(fl.Twin.from_rig(fl.Rig.named("paper-2023-geared")), 0.004)
    >>> arm.write(Command(0.0, 1.0, 1, 1, 0, 0))
    >>> arm.read() is not None, arm.record.shape
    (True, (1, 5))
    """

    COLUMNS = ("tip_angle", "motor_angle", "speed", "torque", "voltage")

    def __init__(self, twin: Twin, period: float, *, seed: int = 0) -> None:
        self._state = ArmState(twin, period, b"")
        self._random = np.random.default_rng(seed)
        self._input = np.zeros(_kernels.TWIN_INPUTS)
        # TWIN_ENCODER_GAIN and TWIN_GAUGE_GAIN of twin.h: gains that no fault changes
        # here
        self._input[[6, 9]] = 1.0
        self._rows: list[Real] = []

    def read(self) -> tuple[float, float]:
        """Return what encoder [rad] and gauge [N·m] show now."""
        gauge = self._state.twin.gauge
        error = gauge.offset + gauge.noise * self._random.standard_normal()
        self._input[3] = error  # TWIN_GAUGE_ERROR
        return self._state.sense(self._input)

    def write(self, command: Command) -> None:
        """Move on for one period under the command's voltage [V]."""
        # A board whose drive is off ignores the voltage.
        voltage = 0.0 if command.mode in _DRIVE_OFF else command.voltage
        self._rows.append(_kernels.twin_drive(self._state, voltage))

    @property
    def callback(self) -> Callback:
        """The connection that reaches this arm."""
        return Callback(self.read, self.write)

    @property
    def record(self) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
        """True tip angle, motor angle [rad], speed [rad/s], torque [N·m] and voltage
        [V], shape (N, 5).
        """
        return np.array(self._rows).reshape(-1, len(self.COLUMNS))
