"""Shared by the tests of the FMU: a long run of the twin with many events, and an FMU
loaded by FMPy.
"""

from __future__ import annotations

import functools
import importlib.util
import math
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import fraclink as fl
from fraclink import Law, Run, Twin
from fraclink.extend import PayloadChange, SensorFault, TipPulse, equip, geared
from law_bench import default_controller
from needed_tools import missing

INPUTS, REALS, WHOLES = (0, 1, 2, 3), (4, 5, 6), (7, 8, 9)


@functools.cache
def geared_law(precision: str) -> tuple[Twin, Law]:
    """The twin of the geared rig, and a law with its motor loop."""
    rig = geared(fl.Rig.named("paper-2023"))
    law = equip(fl.discretize(default_controller(), rig.period), rig, rig.model)
    return Twin.from_rig(rig, link_mass=0.00735), law.in_precision(precision)  # type: ignore[arg-type]


def _moves(count: int) -> fl.Reference:
    """Back and forth; every tenth move is too fast for the motor, which then saturates."""
    path = fl.smooth_step(1.0, duration=0.6, start=0.4)
    for k in range(1, count):
        duration = 0.25 if k % 10 == 5 else 0.5 + 0.01 * (k % 40)
        path = path.then(fl.smooth_step((-1.0) ** k, duration=duration, start=0.8))
    return path


def _events(law: Law, reference: fl.Reference, end: float, ending: str) -> list[Any]:
    """Faults that the law rides through, followed by one that it does not: see
    `ending`.
    """
    period = law.period
    kinds = (
        ("gauge value", math.nan),
        ("encoder value", math.nan),
        ("gauge value", math.inf),
        ("encoder value", -9.0),
        (
            "gauge value",
            1e300,
        ),  # beyond the range of a float: a law in single precision must reject it too
        ("gauge offset", 0.05),
    )
    events: list[Any] = [
        PayloadChange(0.3 * end, 0.040),
        PayloadChange(0.55 * end, 0.020),
    ]
    events += [TipPulse(0.1 * end + 0.085 * k * end, 0.3) for k in range(6)]
    for k in range(40):
        kind, value = kinds[k % len(kinds)]
        begin = 0.01 * end + 0.0175 * k * end
        lasting = 200 if kind == "gauge offset" else 3
        events.append(SensorFault(begin, begin + lasting * period, kind, value))
    # the gauge is lost; later, at angle 0, the encoder: the motor deviates from its
    # model
    if ending == "degraded":
        events.append(SensorFault(0.8 * end, 0.81 * end, "gauge value", math.nan))
        late = 0.9 * end + period * np.arange(2000)
        at_zero = float(late[np.argmin(np.abs(reference.angle(late)))])
        events.append(SensorFault(at_zero, 2 * end, "encoder gain", 1e-3))
    else:  # the torque of a blocked link rises step by step: hold; later the encoder is lost: off
        rise = np.linspace(0.0, law.limits.torque_trip + 0.5, 40)
        for k, offset in enumerate(rise):
            begin = 0.8 * end + k * period
            until = 0.85 * end if k == len(rise) - 1 else begin + period
            events.append(SensorFault(begin, until, "gauge offset", float(offset)))
        events.append(SensorFault(0.9 * end, 2 * end, "encoder value", math.nan))
    return events


@functools.cache
def eventful(
    periods: int, precision: str, ending: str
) -> tuple[Law, NDArray[np.float64], Run]:
    """A run of the twin under its law: the law, what the law read, shape (4, periods +
    1), and the run.
    """
    twin, law = geared_law(precision)
    end = periods * law.period
    reference = _moves(math.ceil(end / 1.45))
    events = _events(law, reference, end, ending)
    run = fl.simulate(law, reference, arm=twin, duration=end, events=events, seed=3)
    rows = np.array(
        [
            run.reference,
            reference.acceleration(run.time),
            run.motor_angle_measured,
            run.torque_measured,
        ]
    )
    return law, rows, run


def fmpy_or_skip() -> Any:
    """The module FMPy, or a skip that names it."""
    if importlib.util.find_spec("fmpy") is None:
        missing("FMPy is not installed (Python package fmpy)")
    import fmpy

    return fmpy


def sources_of(file: Path, folder: Path) -> Path:
    """Extract an FMU; return the folder of its C files."""
    with zipfile.ZipFile(file) as archive:
        archive.extractall(folder)
    return folder / "sources"


def outputs_of(columns: Any) -> NDArray[np.float64]:
    """The law's outputs as `Imported.run` returns an FMU's, shape (N, 6)."""
    names = ("motor_reference", "voltage", "tip_estimate", "mode", "reason", "flags")
    return np.column_stack([getattr(columns, name) for name in names])


class Imported:
    """An FMU that FMPy has loaded; `messages` is what
    it told its logger.
    """

    def __init__(
        self,
        file: Path,
        folder: Path,
        *,
        logging: bool = True,
        token: str | None = None,
    ) -> None:
        fmpy = fmpy_or_skip()
        from fmpy.fmi3 import FMU3Slave

        self.about = fmpy.read_model_description(file)
        self.messages: list[str] = []
        fmpy.extract(file, unzipdir=folder)
        self.slave: Any = FMU3Slave(
            guid=self.about.guid if token is None else token,
            modelIdentifier=self.about.coSimulation.modelIdentifier,
            unzipDirectory=str(folder),
        )
        self.instance = self._instantiate(logging)
        self._inputs, self._values = (
            _array("c_uint", 4, INPUTS),
            _array("c_double", 4),
        )
        self._reals, self._real_values = (
            _array("c_uint", 3, REALS),
            _array("c_double", 3),
        )
        self._wholes = _array("c_uint", 3, WHOLES)
        self._whole_values = _array("c_uint32", 3)

    def _instantiate(self, logging: bool) -> Any:
        self.slave.instantiate(
            loggingOn=logging, logMessage=lambda *told: self._hear(told)
        )
        return self.slave.component

    def _hear(self, told: tuple[Any, ...]) -> None:
        self.messages.append(told[-1].decode())

    def call(self, name: str, *arguments: Any) -> Any:
        """Call a function of the standard by its name without "fmi3"."""
        return self.slave._call(f"fmi3{name}", self.instance, *arguments)

    def initialize(self, start: float = 0.0) -> None:
        """From instantiation to the first step."""
        self.slave.enterInitializationMode(startTime=start)
        self.slave.exitInitializationMode()

    def write(self, values: NDArray[np.float64]) -> None:
        """Set the four inputs."""
        self._values[:] = values.tolist()
        self.call("SetFloat64", self._inputs, 4, self._values, 4)

    def read(self) -> list[float]:
        """Return the six outputs."""
        self.call("GetFloat64", self._reals, 3, self._real_values, 3)
        self.call("GetUInt32", self._wholes, 3, self._whole_values, 3)
        return [*self._real_values, *self._whole_values]

    def step(self, now: float, size: float) -> None:
        """One communication step."""
        self.slave.doStep(now, size)

    def run(
        self,
        rows: NDArray[np.float64],
        period: float,
        *,
        first: int = 0,
        each: Callable[[int], object] = id,
    ) -> NDArray[np.float64]:
        """Step through `rows`, shape (4, N), from period `first` on; return the
        outputs, shape (N, 6).
        """
        got = np.empty((rows.shape[1], 6))
        for k, values in enumerate(rows.T):
            self.write(values)
            self.step((first + k) * period, period)
            got[k] = self.read()
            each(k)
        return got

    def save(self) -> Any:
        """Take a snapshot of the simulation."""
        return self.slave.getFMUState()

    def restore(self, state: Any) -> None:
        """Go back to a snapshot."""
        self.slave.setFMUState(state)


def _array(kind: str, length: int, values: tuple[int, ...] = ()) -> Any:
    import ctypes

    return (getattr(ctypes, kind) * length)(*values)
