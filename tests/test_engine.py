"""The engine of the arm in a page: built from csrc without a C library, and bitwise
equal to the package.
"""

from __future__ import annotations

import hashlib
import importlib.util
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import fraclink as fl
from engine_bench import MARKS, SIGNALS, Engine
from fraclink import Design, SecondMode
from fraclink._simulate.engine import LONGEST, MOST_ROWS, TWIN_MODES
from fraclink.extend import KelvinVoigt, SensorFault
from law_bench import documented_design
from needed_tools import missing, tool

ROOT = Path(__file__).parents[1]
MOVE = fl.smooth_step(1.0, duration=0.5)
END = 3.0
# The faults for which the page has buttons, from 0.3 s on.
FAULTS = {
    "gauge NaN": [SensorFault(0.3, 9.0, "gauge value", float("nan"))],
    "gauge stuck": [SensorFault(0.3, 9.0, "gauge frozen")],
    "encoder stuck": [SensorFault(0.3, 9.0, "encoder frozen")],
    "gauge reversed": [SensorFault(0.3, 9.0, "gauge gain", -1.0)],
    "missed periods": [
        SensorFault(0.004 * k - 1e-6, 0.004 * k + 0.002, "tick missed")
        for k in range(75, 750)
        if k % 3
    ],
}


@pytest.fixture(scope="module")
def design() -> Design:
    rig = fl.Rig.named("paper-2023")
    return documented_design(rig)


@pytest.fixture(scope="module")
def engine() -> Engine:
    return Engine()


def builder() -> ModuleType:
    """tools/build_engine.py as a module."""
    spec = importlib.util.spec_from_file_location(
        "build_engine", ROOT / "tools" / "build_engine.py"
    )
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def same(page: dict[str, np.ndarray], run: fl.Run) -> None:
    """Compare every signal and mark bit by bit; NaNs are equal."""
    for name in SIGNALS:
        assert np.array_equal(page[name], getattr(run, name), equal_nan=True), name
    for name in MARKS:
        assert np.array_equal(page[name], getattr(run, name)), name


def test_the_engine_asks_for_nothing_and_is_small(engine):
    assert engine.imports == []
    assert builder().ENGINE.stat().st_size <= builder().LARGEST == 24_000


def test_the_digest_beside_the_engine_is_its_own():
    digest = builder().DIGEST.read_text().split()[0]
    assert hashlib.sha256(builder().ENGINE.read_bytes()).hexdigest() == digest


@pytest.mark.slow
def test_the_engine_is_what_csrc_compiles_to():
    clang, _ = tool("clang"), tool("wasm-ld", "lld")
    build = builder()
    committed = " ".join(build.DIGEST.read_text().split()[2:])
    if build.compiler_version(clang) != committed:
        missing(
            f"{committed} built the engine, {build.compiler_version(clang)} is here"
        )
    assert build.built(clang) == build.ENGINE.read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("payload", [0.008, 0.016, 0.030, 0.054])
@pytest.mark.parametrize(
    ("noise", "offset", "delay"), [(0.0, 0.0, 1), (0.02, 0.05, 2), (0.2, -0.1, 0)]
)
def test_a_run_has_the_packages_bits(
    engine, design, precision, payload, noise, offset, delay
):
    law = design.law().in_precision(precision)
    gauge = {"noise": noise, "gauge_offset": offset, "delay_samples": delay}
    run = fl.simulate(
        law,
        MOVE,
        rig=design.rig,
        model=design.model,
        payload=payload,
        duration=END,
        seed=7,
        **gauge,
    )
    changed = {"noise": noise, "offset": offset, "delay": delay}
    same(
        engine.run(design, law, MOVE, payload=payload, duration=END, seed=7, **changed),
        run,
    )


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("fault", list(FAULTS))
def test_a_fault_has_the_packages_bits_and_a_reaction(engine, design, precision, fault):
    law = design.law().in_precision(precision)
    run = fl.simulate(
        law,
        MOVE,
        rig=design.rig,
        model=design.model,
        payload=0.03,
        duration=END,
        noise=0.01,
        events=FAULTS[fault],
    )
    same(
        engine.run(
            design,
            law,
            MOVE,
            payload=0.03,
            duration=END,
            events=FAULTS[fault],
            noise=0.01,
        ),
        run,
    )
    # The law has no guard against a reversed gauge; moves with one fail.
    noticed = run.mode.max() >= 2
    assert noticed or (fault == "gauge reversed" and not run.verdict.passed)


@pytest.mark.slow
def test_a_payload_that_is_told_a_late_gauge_and_a_second_mode_have_the_packages_bits(
    engine, design
):
    bent = replace(
        design.model,
        gauge_delay=0.0061,
        gauge_gain=0.93,
        second_mode=SecondMode(190.0, 0.02, 0.08),
    )
    odd = replace(design, model=bent)
    law = design.law()
    run = fl.simulate(
        law,
        MOVE,
        rig=odd.rig,
        model=bent,
        payload=0.04,
        duration=END,
        told=True,
        noise=0.0,
    )
    same(
        engine.run(odd, law, MOVE, payload=0.04, told=0.04, duration=END, noise=0.0),
        run,
    )


def twin_of(
    design: Design, payload: float = 0.030, *, delay: int = 1, **gauge: float
) -> fl.Twin:
    """The twin of a page, with a hub heavy enough to be controlled."""
    rig = replace(design.rig, gauge=replace(design.rig.gauge, **gauge))
    twin = fl.Twin.from_rig(
        rig,
        model=design.model,
        payload=payload,
        link_mass=0.00735,
        modes=TWIN_MODES,
    )
    return replace(twin, voltage_delay=delay)


@pytest.fixture(scope="module")
def geared() -> Design:
    rig = fl.Rig.named("paper-2023-geared")
    return documented_design(rig)


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("payload", [0.008, 0.016, 0.030, 0.054])
@pytest.mark.parametrize(
    ("noise", "offset", "delay"), [(0.0, 0.0, 1), (0.02, 0.05, 2), (0.2, -0.1, 0)]
)
def test_a_run_of_the_twin_has_the_packages_bits(
    engine, geared, precision, payload, noise, offset, delay
):
    law = geared.law().in_precision(precision)
    twin = twin_of(geared, payload, noise=noise, offset=offset, delay=delay)
    run = fl.simulate(law, MOVE, arm=twin, duration=END, seed=7, told=payload)
    same(engine.run_twin(twin, law, MOVE, duration=END, seed=7, told=payload), run)


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("fault", list(FAULTS))
def test_a_fault_of_the_twin_has_the_packages_bits(engine, geared, precision, fault):
    law, twin = geared.law().in_precision(precision), twin_of(geared)
    run = fl.simulate(law, MOVE, arm=twin, duration=END, events=FAULTS[fault])
    page = engine.run_twin(twin, law, MOVE, duration=END, events=FAULTS[fault])
    same(page, run)
    assert not np.array_equal(
        page["tip_angle"], engine.run_twin(twin, law, MOVE, duration=END)["tip_angle"]
    )


@pytest.mark.slow
def test_a_twin_with_a_late_gauge_or_another_material_has_the_packages_bits(
    engine, geared
):
    law = geared.law()
    for twin in (
        replace(twin_of(geared), gauge_delay=0.0063, gauge_gain=0.93),
        replace(twin_of(geared), damping=KelvinVoigt(0.0118)),
        replace(twin_of(geared), beam=replace(twin_of(geared).beam, link_mass=0.0)),
    ):
        run = fl.simulate(law, MOVE, arm=twin, duration=END)
        same(engine.run_twin(twin, law, MOVE, duration=END), run)


@pytest.mark.slow
def test_a_twin_that_leaves_every_bound_stays_where_it_was(engine, geared):
    law = geared.law()
    law = replace(law, motor_loop=replace(law.motor_loop, voltage_limit=1e4))
    weak = replace(
        twin_of(geared),
        motor=replace(twin_of(geared).motor, voltage_limit=1e9, torque_constant=1e8),
    )
    run = fl.simulate(law, MOVE, arm=weak, duration=END)
    page = engine.run_twin(weak, law, MOVE, duration=END)
    assert run.tip_angle.size < page["tip_angle"].size
    assert np.array_equal(page["tip_angle"][: run.tip_angle.size], run.tip_angle)
    assert np.all(page["tip_angle"][run.tip_angle.size :] == run.tip_angle[-1])


def test_the_engine_refuses_what_it_has_no_room_for(engine):
    assert engine.call("run", 0, 0, 0, 0, 0, LONGEST) == 0
    assert (
        engine.call("discretise", MOST_ROWS + 1)
        == engine.call("run_twin", 0, MOST_ROWS + 1, 10)
        == 1
    )
    assert engine.call("run_twin", 0, 8, LONGEST + 1) == 1
    assert engine.call("run", 0, 0, 0, 0, 0, LONGEST + 1) == 1
    assert engine.call("run", 0, 65, 0, 0, 0, 10) == 1
