"""Calls of the FMU out of order, with wrong values, saved, restored and in pairs, as
made by FMPy.
"""

from __future__ import annotations

import ctypes
from pathlib import Path

import numpy as np
import pytest

from fmu_bench import Imported
from fraclink import export_fmu
from law_bench import PERIOD, law, signals
from needed_tools import tool

ROWS = signals(300)
ERROR = 3


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    tool("cc", "gcc")
    return export_fmu(law(), tmp_path_factory.mktemp("fmus") / "arm.fmu")


@pytest.fixture
def arm(file: Path, tmp_path: Path) -> Imported:
    return Imported(file, tmp_path / "fmu")


def _refused(arm: Imported, why: str, name: str, *arguments: object) -> None:
    """The call ends with an error that states the reason, and ends the simulation."""
    from fmpy.fmi1 import FMICallException

    arm.messages.clear()
    with pytest.raises(FMICallException) as told:
        if name == "DoStep":
            arm.step(*arguments)
        elif name == "EnterInitializationMode":
            arm.slave.enterInitializationMode()
        else:
            arm.call(name, *arguments)
    assert told.value.status == ERROR
    assert len(arm.messages) == 1 and why in arm.messages[0], arm.messages


@pytest.mark.slow
def test_another_step_than_the_period_is_an_error_until_a_reset(arm: Imported) -> None:
    arm.initialize()
    fresh = arm.run(ROWS, PERIOD)
    _refused(
        arm,
        "set the communication step to 0.004 s (it was 0.008 s)",
        "DoStep",
        300 * PERIOD,
        2 * PERIOD,
    )
    _refused(arm, "initialize first, or reset", "DoStep", 300 * PERIOD, PERIOD)
    assert arm.read() == fresh[-1].tolist()  # the results so far can still be read
    arm.call("Reset")
    arm.initialize()
    np.testing.assert_array_equal(arm.run(ROWS, PERIOD), fresh)


@pytest.mark.slow
@pytest.mark.parametrize(
    "step", [0.0, -PERIOD, float("nan"), float("inf"), PERIOD * (1 + 1e-5)]
)
def test_steps_that_are_none(arm: Imported, step: float) -> None:
    arm.initialize()
    _refused(arm, "communication step", "DoStep", 0.0, step)


@pytest.mark.slow
def test_rounding_of_the_step_is_no_error(arm: Imported) -> None:
    arm.initialize(1e5)
    now = 1e5
    for _ in range(50):
        after = now + PERIOD
        arm.step(now, after - now)  # 1.4e-11 s of rounding
        now = after


@pytest.mark.slow
def test_steps_follow_each_other(arm: Imported) -> None:
    arm.initialize(5.0)
    arm.step(5.0, PERIOD)
    arm.step(5.0 + PERIOD, PERIOD)
    _refused(
        arm,
        "the last one ended at 5.008 s, this one begins at 5.004 s",
        "DoStep",
        5.0 + PERIOD,
        PERIOD,
    )
    arm.call("Reset")
    arm.initialize()
    arm.step(0.0, PERIOD)
    _refused(arm, "this one begins at 0.008 s", "DoStep", 2 * PERIOD, PERIOD)


@pytest.mark.slow
def test_calls_out_of_order(arm: Imported) -> None:
    _refused(arm, "outside the simulation", "DoStep", 0.0, PERIOD)
    arm.call("Reset")
    _refused(arm, "without having been entered", "ExitInitializationMode")
    arm.call("Reset")
    _refused(arm, "only a simulation that runs", "Terminate")
    arm.call("Reset")
    arm.initialize()
    _refused(
        arm,
        "right after instantiation or a reset",
        "EnterInitializationMode",
    )
    arm.call("Reset")
    arm.initialize()
    arm.call("Terminate")
    assert arm.read()[3] == 0
    _refused(arm, "outside the simulation", "DoStep", 0.0, PERIOD)
    _refused(arm, "after the end", *_writing(arm, 0, 1.0))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("categories", "logged"),
    [([], 1), ([b"logEvents", b"logStatusError"], 1), ([b"logEvents"], 0)],
)
def test_errors_are_logged_where_their_category_is_chosen(
    arm: Imported, categories: list[bytes], logged: int
) -> None:
    from fmpy.fmi1 import FMICallException

    names = (ctypes.c_char_p * len(categories))(*categories)
    arm.call("SetDebugLogging", True, len(categories), names)
    with pytest.raises(FMICallException):
        arm.step(0.0, PERIOD)
    assert len(arm.messages) == logged


def _writing(arm: Imported, reference: int, value: float) -> tuple[object, ...]:
    references, values = (ctypes.c_uint * 1)(reference), (ctypes.c_double * 1)(value)
    return "SetFloat64", references, 1, values, 1


@pytest.mark.slow
@pytest.mark.parametrize("reference", [4, 6, 9, 10, 12, 2**32 - 1])
def test_only_inputs_are_set(arm: Imported, reference: int) -> None:
    arm.initialize()
    _refused(arm, "that is no input", *_writing(arm, reference, 1.0))


@pytest.mark.slow
def test_before_the_first_step_the_arm_rests_where_it_is(arm: Imported) -> None:
    arm.write(np.array([0.0, 0.0, 0.7, 0.156]))
    stiffness = law().stiffness
    assert arm.read() == pytest.approx([0.7, 0.0, 0.7 - 0.156 / stiffness, 0, 0, 0])
    arm.write(np.array([0.0, 0.0, np.nan, np.inf]))
    assert arm.read() == [0.0, 0.0, 0.0, 0, 0, 0]


@pytest.mark.slow
def test_a_saved_state_comes_back_also_after_an_error(arm: Imported) -> None:
    arm.initialize()
    arm.run(ROWS[:, :200], PERIOD)
    saved = arm.save()
    first = arm.run(ROWS[:, 200:], PERIOD, first=200)
    _refused(arm, "communication step", "DoStep", 1.2, 1.0)
    arm.restore(saved)
    np.testing.assert_array_equal(arm.run(ROWS[:, 200:], PERIOD, first=200), first)


@pytest.mark.slow
def test_a_serialized_state_goes_on_in_another_instance(
    arm: Imported, file: Path, tmp_path: Path
) -> None:
    arm.initialize()
    arm.run(ROWS[:, :200], PERIOD)
    stored = arm.slave.serializeFMUState(arm.save())
    other = Imported(file, tmp_path / "other")
    other.restore(other.slave.deserializeFMUState(stored))
    np.testing.assert_array_equal(
        other.run(ROWS[:, 200:], PERIOD, first=200),
        arm.run(ROWS[:, 200:], PERIOD, first=200),
    )
    from fmpy.fmi1 import FMICallException

    for damaged, why in (
        (stored[:-1], "another size"),
        (bytes([stored[0] ^ 1]) + stored[1:], "another law"),
    ):
        with pytest.raises(FMICallException):
            other.slave.deserializeFMUState(damaged)
        assert why in other.messages[-1]


@pytest.mark.slow
def test_two_instances_do_not_see_each_other(arm: Imported) -> None:
    arm.initialize()
    alone = arm.run(ROWS, PERIOD)
    arm.call("Reset")
    first, second = arm.instance, arm._instantiate(True)
    for instance in (first, second):
        arm.instance = arm.slave.component = instance
        arm.initialize()
    got: dict[int, list[list[float]]] = {0: [], 1: []}
    for k in range(ROWS.shape[1]):
        for number, instance in enumerate((first, second)):
            arm.instance = arm.slave.component = instance
            # the second one moves in the opposite direction
            arm.write(ROWS[:, k] * (1 - 2 * number))
            arm.step(k * PERIOD, PERIOD)
            got[number].append(arm.read())
    np.testing.assert_array_equal(np.array(got[0]), alone)
    np.testing.assert_array_equal(np.array(got[1])[:, :3], -alone[:, :3])
    arm.instance = first
    arm.call("FreeInstance")
    arm.instance = second
    arm.read()  # the other one is unaffected
