"""What each fault does to a run: the rows, the values and the moments that the
catalogue states.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from campaigns import fault_bench
from fraclink._simulate import sensors as columns
from fraclink._simulate.kernel import ArmState
from fraclink.trials import _fault_sensors as fault_sensors
from fraclink.trials._fault_trial import (
    REALS,
    WORDS,
    Bench,
    Case,
    Phase,
    Trial,
    execute,
    members,
)
from fraclink.trials._faults import fault_named

RUN, DEGRADED = 1, 2


@pytest.fixture(scope="module")
def bench() -> Bench:
    return fault_bench()


def broken(
    bench: Bench,
    number: str,
    severity: int,
    phase: Phase = "mid",
    *,
    inject: bool = True,
    seed: int = 1,
) -> Trial:
    fault = fault_named(number)
    trial = Trial(
        bench,
        Case(number, severity, 0.03, phase, seed),
        bench.law,
        fault.rule.reference,
        fault.duration,
    )
    if fault.rule.prepare is not None:
        fault.rule.prepare(trial)
    if inject:
        fault.rule.inject(trial)
    return trial


@pytest.mark.slow
def test_dropped_samples_repeat_the_last_one_of_both_sensors(bench: Bench) -> None:
    for severity, share in ((1, 0.01), (2, 0.05), (3, 0.2)):
        bits = broken(bench, "F06", severity, "whole").inputs[:, columns.FAULT_BITS]
        assert set(bits.tolist()) == {0.0, 12.0} and np.all(bits[:2] == 0.0)
        assert np.mean(bits > 0) == pytest.approx(share, rel=0.5)


@pytest.mark.slow
def test_a_jump_of_the_reference_is_what_is_then_wanted(bench: Bench) -> None:
    trial = broken(bench, "F25", 3)
    assert np.array_equal(
        trial.wanted, trial.inputs[:, columns.REFERENCE]
    ) and trial.wanted[-1] == pytest.approx(2.0)
    far = [
        broken(bench, "F33", severity, "whole").start_angle for severity in (1, 2, 3)
    ]
    assert far == [1.0, 2.0, 3.0]


def arm_of(trial: Trial) -> ArmState:
    return ArmState(
        trial.twin, trial.period, trial.state, start_angle=trial.start_angle
    )


def acted(trial: Trial) -> tuple[ArmState, ArmState]:
    """The arm before and after everything that the trial does to it, whenever it does
    so.
    """
    before, after = arm_of(trial), arm_of(trial)
    for actions in trial.actions.values():
        for action in actions:
            action(after)
    return before, after


@pytest.mark.slow
@pytest.mark.parametrize(
    ("severity", "counts", "factor", "later"),
    [(1, 8000, 1.5, 1), (2, 4000, 2.0, 2), (3, 2000, 3.0, 3)],
)
def test_encoder_friction_and_delay_of_the_arm_are_changed(
    bench: Bench, severity: int, counts: int, factor: float, later: int
) -> None:
    before, after = acted(broken(bench, "F19", severity, "whole"))
    assert after.rig[7] == pytest.approx(2 * math.pi / counts) and np.array_equal(
        after.rig[:7], before.rig[:7]
    )
    before, after = acted(broken(bench, "F41", severity, "whole"))
    assert after.rig[[5, 6]] == pytest.approx(factor * before.rig[[5, 6]])
    assert np.array_equal(np.delete(after.rig, [5, 6]), np.delete(before.rig, [5, 6]))
    before, after = acted(broken(bench, "F24", severity, "whole"))
    assert (
        after.rig[1] == before.rig[1] + later
        and after.voltage.size == before.voltage.size + later
    )


@pytest.mark.slow
def test_the_watchdog_and_a_clock_that_is_set_back(bench: Bench) -> None:
    trial = broken(bench, "F22", 1)
    arm = arm_of(trial)
    arm.voltage[:] = 5.0
    trial.actions[405][0](arm)
    assert np.all(arm.voltage == 0.0)
    trial = broken(bench, "F23", 3)
    arm = arm_of(trial)
    arm.counters[:] = (1, 401)
    trial.actions[400][0](arm)
    assert arm.counters.tolist() == [1, 398]


@pytest.mark.slow
def test_a_wiped_memory_is_all_zeros_all_ones_or_no_numbers(bench: Bench) -> None:
    assert set(acted(broken(bench, "F30", 1))[1].law.tolist()) == {0}
    assert set(acted(broken(bench, "F30", 2))[1].law.tolist()) == {255}
    before, after = acted(broken(bench, "F30", 3))
    assert np.all(np.isnan(members(after.law, 4)))
    assert np.array_equal(after.law[: 4 * len(WORDS)], before.law[: 4 * len(WORDS)])


def flipped_bits(trial: Trial) -> list[int]:
    before, after = acted(trial)
    changed = np.unpackbits(before.law ^ after.law, bitorder="little")
    return np.flatnonzero(changed).tolist()


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["double", "single"])
def test_a_flip_is_of_one_bit_and_of_the_number_that_it_names(
    bench: Bench, precision: Any
) -> None:
    made = bench.with_law(bench.law.in_precision(precision))
    width = 32 if precision == "single" else 64
    first = {name: 32 * len(WORDS) + width * k for k, name in enumerate(REALS)}
    seen = set()
    for severity, bit, part in (
        (1, width - 1, "sign"),
        (2, width - 2, "exponent"),
        (3, width - 2, "exponent"),
    ):
        for seed in range(6):
            trial = broken(made, "F29", severity, seed=seed)
            name = trial.detail.split(",")[0]
            assert trial.detail == f"{name}, {part}"
            assert flipped_bits(trial) == [first[name] + bit]
            assert severity == 3 or int(name.removeprefix("modes[")[:-1]) < len(
                made.law.correction.poles
            )
            seen.add(name)
    assert any(
        not name.startswith("modes") for name in seen
    )  # of any real: beside the modes, too


@pytest.mark.slow
def test_a_stuck_gauge_is_given_up_by_a_law_that_knows(bench: Bench) -> None:
    trial = broken(bench, "F11", 1)
    fault_sensors.without_gauge(trial)
    run = execute(trial)
    assert (
        run.mode[399] == RUN and run.mode[400] == DEGRADED and run.mode[-1] == DEGRADED
    )
