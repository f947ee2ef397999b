"""The twin in real time at the other end: an arm for whoever has none at hand."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fraclink import _kernels
from fraclink._npz import read_npz, write_npz
from fraclink._realtime.connections import Connection
from fraclink._realtime.loop import PRIORITY, check_machine, granted_priority, period_ns
from fraclink._simulate import Twin
from fraclink._simulate.kernel import ArmState
from fraclink._validate import checked_number, checked_whole
from fraclink.errors import FieldError, FileFormatError, SizeError

__all__ = ["ServedArm", "serve_arm"]

Real = NDArray[np.float64]

KIND, FORMAT = "served-arm", 1
MOST_PERIODS = 2_000_000
# The law rides through 5 missed periods and trips at the 6th; whoever is silent for 10 will not come back.
WATCHDOG = 10
_SIGNALS = ("tip_angle", "motor_angle", "torque", "voltage", "connected")
_COUNTS = ("late", "controllers", "silences", "rejected")


@dataclass(frozen=True, eq=False)
class ServedArm:
    """What really happened at the simulated arm, one value for each of its periods; shape (N,).

    tip_angle θt and motor_angle θm [rad], torque Γ [N·m], the voltage that acted [V], connected: 1 where a
    controller was heard. `period` [s]; `late`, periods that began after their own end; `controllers` that
    came, `silences`: how many of them left without a stop, so that the watchdog switched the drive off;
    `rejected` messages; `scheduling`: what the machine granted.
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
        """Whether every controller took its leave: the watchdog never had to act."""
        return self.silences == 0

    def save(self, path: Path | str) -> None:
        """Write signals and counts to one NPZ file, complete or not at all."""
        about = {name: getattr(self, name) for name in ("period", "scheduling", *_COUNTS)}
        about["simulated"] = True
        write_npz(path, KIND, FORMAT, about, {name: getattr(self, name) for name in _SIGNALS})

    @classmethod
    def load(cls, path: Path | str) -> ServedArm:
        """Read back what `save` wrote; FileFormatError for anything else."""
        about, arrays = read_npz(path, KIND, (FORMAT,))
        try:
            parts: dict[str, Any] = {name: arrays[name] for name in _SIGNALS}
            return cls(**parts, **{name: about[name] for name in ("period", "scheduling", *_COUNTS)})
        except (KeyError, TypeError, ValueError) as error:
            raise FileFormatError(
                "arm",
                str(path),
                "not the record of a served arm",
                allowed="an NPZ of ServedArm.save",
                remedy="serve it again",
            ) from error


def serve_arm(
    twin: Twin,
    connection: Connection,
    period: float,
    *,
    duration: float = 600.0,
    watchdog: int = WATCHDOG,
    once: bool = False,
    seed: int = 0,
    priority: int = PRIORITY - 10,
) -> ServedArm:
    """Run the twin in real time and let controllers reach it; return what happened.

    In every period the arm takes the newest command, samples encoder and gauge, sends the sample and moves on
    under that command's voltage, so that a voltage acts one period after its sample; a twin with a longer
    `voltage_delay` waits the rest itself. One controller is heard at a time. When it has been silent for
    `watchdog` periods, or sends a stop, the voltage is 0 and the next one may come. Ends after `duration`,
    at SIGINT, SIGTERM or SIGHUP, or with `once` when the first controller has left.

    Parameters
    ----------
    twin : Twin
        With a `voltage_delay` of at least 1.
    connection : Udp or SharedMemory
        Where controllers reach it; `Udp` is bound to that host, and anybody who can send there moves the arm.
    period : float
        The law's [s].
    duration : float
        [s], at most 2 000 000 periods.
    watchdog : int
        [periods], 1 to 1000.
    seed : int
        Of the gauge's noise.
    priority : int
        Of SCHED_FIFO, below the controller's, 1 to 99; 0 asks for none. What is refused stands in the result.

    Raises
    ------
    FieldError
        A value out of its range, a port or name in use, another system than Linux. SizeError for too long a
        duration.
    """
    check_machine()
    nanoseconds = period_ns(period)
    checked_number("duration", duration, allowed=f">= {period} s", holds=lambda x: x >= period)
    checked_whole("watchdog", watchdog, 1, 1000, "periods")
    checked_whole("seed", seed, 0, 2**64 - 1)
    checked_whole("priority", priority, 0, 99)
    count = math.ceil(duration / period)
    if count > MOST_PERIODS:
        raise SizeError(
            "duration", duration, "too long", allowed=f"{MOST_PERIODS} periods", remedy="stay below"
        )
    if twin.voltage_delay < 1:
        raise FieldError(
            "voltage_delay",
            twin.voltage_delay,
            "shorter than a message's way",
            allowed=">= 1 period",
            remedy="a command acts one period after its sample here, as on a board",
        )
    # A twin whose way through the messages is the first period of its delay.
    arm = ArmState(replace(twin, voltage_delay=twin.voltage_delay - 1), period, b"")
    record = np.full((count, _kernels.SERVED_COLUMNS), 0.0)
    from fraclink._realtime.opening import arm_end  # locks of files are Unix's

    with arm_end(connection) as way:
        told = _kernels.realtime_serve(
            way,
            *arm.step.arrays,
            arm.rig,
            arm.state,
            arm.gauge,
            arm.voltage,
            arm.sensed,
            arm.counters,
            _gauge_error(twin, period, count, seed),
            record,
            nanoseconds,
            watchdog,
            once,
            priority,
        )
    parts: dict[str, Any] = {name: record[: told["count"], i].copy() for i, name in enumerate(_SIGNALS)}
    parts |= {name: int(told[name]) for name in _COUNTS}
    return ServedArm(**parts, period=period, scheduling=granted_priority(priority, told["priority_error"]))


def _gauge_error(twin: Twin, period: float, count: int, seed: int) -> Real:
    """Offset, drift and noise of the gauge, drawn as `simulate` draws them."""
    sensors = twin.sensors
    noise = np.random.default_rng(seed).standard_normal(count)
    drift = sensors.gauge_drift * period * np.arange(count)
    return np.asarray(sensors.gauge_offset + drift + sensors.gauge_noise * noise)
