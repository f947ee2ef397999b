"""The committed engine under wasmtime, called from Python as the script of the page
calls it.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import fraclink as fl
from fraclink import Design, Law, Reference
from fraclink._simulate.engine import (
    engine_link,
    engine_noise,
    engine_rig,
    twin_noise,
)
from fraclink._simulate.events import fault_rows
from fraclink._simulate.kernel import twin_numbers
from fraclink.extend import SensorFault
from needed_tools import missing

try:
    import wasmtime
except ModuleNotFoundError:
    wasmtime = None  # type: ignore[assignment]

SIGNALS = (
    "tip_angle",
    "motor_angle",
    "motor_reference",
    "torque",
    "torque_measured",
    "voltage",
    "tip_estimate",
    "motor_angle_measured",
)
MARKS = ("flags", "mode", "reason")


# The inputs of one period, in the order of the engine's C header.
HEADER = Path(__file__).parents[1] / "csrc" / "kernels" / "twin.h"
INPUTS = re.search(r"enum[^{]*{([^}]*TWIN_REFERENCE,[^}]*)}", HEADER.read_text("utf-8"))
assert INPUTS is not None
COLUMNS = re.findall(r"^ *TWIN_(\w+),", INPUTS[1], re.MULTILINE)
ENGINE = Path(fl.__file__).parent / "_simulate" / "engine.wasm"


def path(
    reference: Reference, law: Law, count: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Angle and acceleration of the reference in each period."""
    time = law.period * np.arange(count)
    return reference.angle(time), reference.acceleration(time)


class Engine:
    """One instance of the engine."""

    def __init__(self, code: bytes | None = None) -> None:
        if wasmtime is None:
            missing("wasmtime is not installed (pip install wasmtime)")
        store = wasmtime.Store()
        module = wasmtime.Module(
            store.engine, ENGINE.read_bytes() if code is None else code
        )
        self.imports = list(module.imports)
        self._store = store
        self._exports = wasmtime.Instance(store, module, []).exports(store)

    def call(self, name: str, *given: int) -> int:
        return int(self._exports[name](self._store, *given))

    def write(self, place: int, data: bytes) -> None:
        self._exports["memory"].write(self._store, data, place)

    def read(self, place: int, kind: str, count: int) -> NDArray[Any]:
        size = count * np.dtype(kind).itemsize
        return np.frombuffer(
            bytes(self._exports["memory"].read(self._store, place, place + size)), kind
        )

    def fill(self, place: int, numbers: NDArray[np.float64]) -> None:
        """Fill in a rig: three integers, and its doubles from byte 16 on."""
        self.write(place, numbers[:3].astype("<i4").tobytes())
        self.write(place + 16, numbers[3:].tobytes())

    def signals(self, count: int) -> dict[str, NDArray[Any]]:
        found = {
            name: self.read(self.call("signal", i), "<f8", count)
            for i, name in enumerate(SIGNALS)
        }
        return found | {
            name: self.read(self.call("mark", i), "<u4", count)
            for i, name in enumerate(MARKS)
        }

    def run_twin(
        self,
        twin: fl.Twin,
        law: Law,
        reference: Reference,
        *,
        duration: float,
        seed: int = 0,
        told: float = 0.0,
        events: Sequence[SensorFault] = (),
    ) -> dict[str, NDArray[Any]]:
        """Return the signals and marks of one run of the twin."""
        count, numbers = (
            round(duration / law.period) + 1,
            twin_numbers(twin, law.period),
        )
        fine = law.period / numbers[0]
        plant = twin.plant(fine)
        size, stride = plant.order + 2, -(-plant.order // 8) * 8
        block, outputs = (
            np.zeros((size, size)),
            np.zeros((plant.outputs.shape[0], stride)),
        )
        block[: plant.order, : plant.order], block[: plant.order, plant.order :] = (
            plant.dynamics * fine,
            plant.inputs * fine,
        )
        outputs[:, : plant.order] = plant.outputs
        inputs = fault_rows(tuple(events), law.period, count)
        (
            inputs[:, COLUMNS.index("REFERENCE")],
            inputs[:, COLUMNS.index("ACCELERATION")],
        ) = path(reference, law, count)
        inputs[:, COLUMNS.index("GAUGE_ERROR")] = (
            twin.gauge.offset + twin.gauge.noise * twin_noise(seed, count)
        )
        inputs[:, COLUMNS.index("PAYLOAD")] = told
        self.write(self.call("block"), law.block)
        self.fill(self.call("twin"), numbers)
        self.write(self.call("matrix"), block.tobytes())
        self.write(self.call("outputs"), outputs.tobytes())
        self.write(self.call("faults"), inputs.tobytes())
        assert self.call("discretise", size) == 0
        assert self.call("run_twin", int(law.precision == "single"), size, count) == 0
        return self.signals(count)

    def run(
        self,
        design: Design,
        law: Law,
        reference: Reference,
        *,
        payload: float,
        duration: float,
        seed: int = 0,
        told: float = 0.0,
        events: Sequence[SensorFault] = (),
        **changed: float,
    ) -> dict[str, NDArray[Any]]:
        """Return the signals and marks of one run; `changed`: numbers of the rig, by
        name.
        """
        count = round(duration / law.period) + 1
        model = design.model.at_payload(payload)
        link = engine_link(model, law.period, duration)
        numbers = engine_rig(design.rig, law, model) | changed | {"payload": told}
        angle, acceleration = path(reference, law, count)
        self.write(self.call("block"), law.block)
        self.fill(self.call("rig"), np.array(list(numbers.values())))
        self.write(self.call("link"), link.numbers.tobytes())
        for row, values in enumerate((angle, acceleration, engine_noise(seed, count))):
            self.write(self.call("path", row), values.tobytes())
        if events:
            faults = fault_rows(tuple(events), law.period, count)
            self.write(self.call("faults"), faults.tobytes())
        single = int(law.precision == "single")
        given = (
            single,
            link.reals,
            link.pairs,
            int(link.second),
            int(bool(events)),
            count,
        )
        assert self.call("run", *given) == 0
        return self.signals(count)
