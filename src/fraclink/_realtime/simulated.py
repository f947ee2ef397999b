"""The twin as an arm in this process, without a clock: each call of `write` is one period of its life."""

from __future__ import annotations

import numpy as np

from fraclink import _kernels
from fraclink._realtime.connections import Callback, Command
from fraclink._simulate import Twin
from fraclink._simulate.kernel import ArmState

__all__ = ["SimulatedArm"]

_IDLE, _OFF = 0, 4  # modes in which the drive is off, see arm_io.h
_CHUNK = 4096  # noise is drawn in rows, as one draw a period costs more than the period


class SimulatedArm:
    """A twin that a `Callback` reaches; what really happened is kept, one row for each period.

    Parameters
    ----------
    twin
        its `voltage_delay` counts from a sample to the effect of the voltage that answers it.
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
        self._noise = iter(np.zeros(0))
        self._input = np.zeros(_kernels.TWIN_INPUTS)
        self._input[[6, 9]] = 1.0  # TWIN_ENCODER_GAIN and TWIN_GAUGE_GAIN of twin.h
        self._rows: list[tuple[float, ...]] = []

    def read(self) -> tuple[float, float]:
        """Return what encoder [rad] and gauge [N·m] show now."""
        sensors = self._state.twin.sensors
        noise = next(self._noise, None)
        if noise is None:
            self._noise = iter(self._random.standard_normal(_CHUNK))
            noise = next(self._noise)
        self._input[3] = sensors.gauge_offset + sensors.gauge_noise * noise  # TWIN_GAUGE_ERROR
        return self._state.sense(self._input)

    def write(self, command: Command) -> None:
        """Move on for one period under the command's voltage [V]."""
        asked = 0.0 if command.mode in (_IDLE, _OFF) else command.voltage
        s = self._state
        buffers = (s.rig, s.state, s.gauge, s.voltage, s.sensed, s.counters)
        self._rows.append(_kernels.twin_drive(*s.step.arrays, *buffers, asked))

    @property
    def callback(self) -> Callback:
        """The connection that reaches this arm."""
        return Callback(self.read, self.write)

    @property
    def record(self) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
        """True tip angle, motor angle [rad], speed [rad/s], torque [N·m] and voltage [V], shape (N, 5)."""
        return np.array(self._rows).reshape(-1, len(self.COLUMNS))
