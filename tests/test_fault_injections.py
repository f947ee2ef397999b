"""What each fault does to a run: the rows, the values and the moments that the
catalogue states.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

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
PERIOD = 0.004
NAN = math.nan

Real = NDArray[np.float64]


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


def written(rows: slice | list[int], **values: Any) -> Callable[[Real], None]:
    """A change of some rows: a column set to a value, or that added to it where its
    name begins with add_.
    """

    def write(inputs: Real) -> None:
        for name, value in values.items():
            column = getattr(columns, name.removeprefix("add_"))
            inputs[rows, column] = value + (
                inputs[rows, column] if name.startswith("add_") else 0.0
            )

    return write


START, MID, REST = 275, 400, 800  # rows of 1.1, 1.6 and 3.2 s
INPUTS: dict[tuple[str, int, Phase], tuple[Callable[[Real], None], ...]] = {
    ("F01", 1, "start"): (written([START], FAULT_BITS=1, ENCODER_VALUE=NAN),),
    ("F01", 2, "mid"): (written(slice(400, 650, 25), FAULT_BITS=1, ENCODER_VALUE=NAN),),
    ("F01", 3, "rest"): (written(slice(800, 1050, 5), FAULT_BITS=1, ENCODER_VALUE=NAN),),
    ("F02", 2, "mid"): (written(slice(400, 650, 25), FAULT_BITS=2, GAUGE_VALUE=NAN),),
    ("F03", 1, "mid"): (written([400, 401], FAULT_BITS=1, ENCODER_VALUE=NAN),),
    ("F03", 3, "mid"): (written(slice(400, 404), FAULT_BITS=1, ENCODER_VALUE=NAN),),
    ("F04", 1, "mid"): (written(slice(400, 405), FAULT_BITS=3, ENCODER_VALUE=NAN, GAUGE_VALUE=NAN),),
    ("F04", 3, "mid"): (written(slice(400, None), FAULT_BITS=3, ENCODER_VALUE=NAN, GAUGE_VALUE=NAN),),
    ("F05", 3, "mid"): (
        written(slice(400, 650, 10), FAULT_BITS=2, GAUGE_VALUE=math.inf),
        written(slice(405, 650, 10), FAULT_BITS=2, GAUGE_VALUE=-math.inf),
    ),
    ("F07", 2, "mid"): (written(slice(400, 525), FAULT_BITS=4),),
    ("F07", 3, "mid"): (written(slice(400, None), FAULT_BITS=4),),
    ("F08", 3, "rest"): (written(slice(800, 1675), FAULT_BITS=4),),
    ("F09", 2, "mid"): (written(slice(400, None), FAULT_BITS=2, GAUGE_VALUE=-4.1),),
    ("F10", 1, "mid"): (written(slice(400, 410), FAULT_BITS=2, GAUGE_VALUE=2.0),),
    ("F10", 3, "mid"): (written(slice(400, 450), FAULT_BITS=2, GAUGE_VALUE=-3.9),),
    ("F11", 3, "mid"): (written(slice(400, 650), FAULT_BITS=8),),
    ("F12", 2, "whole"): (written(slice(0, None), add_GAUGE_ERROR=0.05),),
    ("F13", 3, "rest"): (written(slice(800, None), add_GAUGE_ERROR=0.1),),
    ("F14", 1, "mid"): (written(slice(400, None), add_GAUGE_ERROR=0.005 * PERIOD * np.arange(1351)),),
    ("F15", 3, "mid"): (written(slice(400, None), GAUGE_GAIN=0.9),),
    ("F16", 1, "whole"): (written(slice(0, None), GAUGE_GAIN=-1.0),),
    ("F16", 3, "whole"): (written(slice(0, None), GAUGE_GAIN=-0.5, add_GAUGE_ERROR=0.1),),
    ("F21", 2, "mid"): (written(slice(400, 403), FAULT_BITS=32),),
    ("F22", 1, "mid"): (written(slice(400, 408), FAULT_BITS=32),),
    ("F23", 1, "mid"): (written([400], FAULT_BITS=64),),
    ("F23", 2, "mid"): (written(slice(400, 425), FAULT_BITS=64),),
    ("F23", 3, "mid"): (),
    ("F25", 1, "mid"): (written(slice(400, None), add_REFERENCE=0.25),),
    ("F26", 1, "mid"): (written([400], REFERENCE=NAN, ACCELERATION=NAN),),
    ("F26", 3, "mid"): (written(slice(400, 425), REFERENCE=1e3, ACCELERATION=1e6),),
    ("F34", 2, "whole"): (written(slice(0, 25), FAULT_BITS=1, ENCODER_VALUE=NAN),),
    ("F34", 3, "whole"): (written(slice(0, None), FAULT_BITS=1, ENCODER_VALUE=NAN),),
    ("F35", 2, "mid"): (written(slice(400, None), ENCODER_GAIN=180 / math.pi),),
    ("F36", 1, "mid"): (written(slice(400, None), add_ENCODER_ERROR=2 * math.pi),),
    ("F36", 2, "mid"): (written(slice(400, None), add_ENCODER_ERROR=-2 * math.pi),),
    ("F36", 3, "mid"): (written(slice(400, None), add_ENCODER_ERROR=65536 * 2 * math.pi / 100000),),
    ("F37", 2, "mid"): (written(slice(400, 525), FAULT_BITS=16),),
    ("F37", 1, "whole"): (written(slice(0, None), FAULT_BITS=16),),
    ("F40", 1, "mid"): (written(slice(400, 405), add_TIP_FORCE=0.1),),
    ("F40", 2, "mid"): (written(slice(400, 405), add_TIP_FORCE=0.25),),
    ("F40", 3, "mid"): (),
    ("F43", 1, "whole"): (),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "severity", "phase"), INPUTS, ids=lambda part: str(part)
)
def test_the_inputs_of_a_fault_are_those_that_the_catalogue_states(
    bench: Bench, number: str, severity: int, phase: Phase
) -> None:
    healthy, faulty = (
        broken(bench, number, severity, phase, inject=inject)
        for inject in (False, True)
    )
    for write in INPUTS[number, severity, phase]:
        write(healthy.inputs)
    np.testing.assert_allclose(faulty.inputs, healthy.inputs, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "severity", "marked"),
    [
        ("F01", 2, range(400, 650, 25)),
        ("F06", 3, ()),
        ("F07", 2, range(400, 525)),
        ("F21", 3, [405]),
        ("F22", 2, [412]),
        ("F23", 2, range(400, 425)),
        ("F23", 3, [400]),
        ("F25", 2, [400]),
        ("F26", 2, range(400, 425)),
        ("F32", 1, [400]),
        ("F32", 2, [403]),
        ("F32", 3, [400, 425]),
        ("F37", 2, ()),
    ],
)
def test_the_law_must_say_something_in_the_periods_that_a_fault_marks(
    bench: Bench, number: str, severity: int, marked: Any
) -> None:
    assert np.flatnonzero(broken(bench, number, severity).marks).tolist() == list(
        marked
    )


@pytest.mark.slow
def test_dropped_samples_repeat_the_last_one_of_both_sensors(bench: Bench) -> None:
    for severity, share in ((1, 0.01), (2, 0.05), (3, 0.2)):
        bits = broken(bench, "F06", severity, "whole").inputs[:, columns.FAULT_BITS]
        assert set(bits.tolist()) == {0.0, 12.0} and np.all(bits[:2] == 0.0)
        assert np.mean(bits > 0) == pytest.approx(share, rel=0.5)


@pytest.mark.slow
def test_noise_and_spikes_have_the_stated_size(bench: Bench) -> None:
    for severity, sigma, share in ((1, 0.02, 0.0025), (2, 0.05, 0.005), (3, 0.1, 0.01)):
        noisy = broken(bench, "F17", severity, "whole").inputs[:, columns.GAUGE_ERROR]
        assert np.std(noisy) == pytest.approx(sigma, rel=0.06)
        trial, healthy = (
            broken(bench, "F18", severity, inject=inject) for inject in (True, False)
        )
        added = (
            trial.inputs[:, columns.GAUGE_ERROR]
            - healthy.inputs[:, columns.GAUGE_ERROR]
        )
        rows = np.flatnonzero(added)
        assert np.abs(added[rows]) == pytest.approx(3.0) and rows.min() >= MID
        assert rows.size == pytest.approx(share * (trial.count - MID), abs=8)
        assert np.array_equal(rows, np.flatnonzero(trial.marks))
    both = broken(bench, "F18", 3).inputs[:, columns.GAUGE_ERROR]
    assert both.max() > 2.0 and both.min() < -2.0  # either sign


@pytest.mark.slow
def test_instants_of_sampling_are_early_and_late_and_keep_their_mean(
    bench: Bench,
) -> None:
    for severity, share in ((1, 2 / 30), (2, 2 / 3), (3, 1.0)):
        trial = broken(bench, "F20", severity, "whole")
        assert trial.shifts is not None
        assert (
            set(trial.shifts.tolist()) <= {-1, 0, 1}
            and trial.shifts[0] == trial.shifts[-1] == 0
        )
        assert np.mean(trial.shifts != 0) == pytest.approx(share, abs=0.03)
        times = PERIOD * np.arange(trial.count) + 1e-3 * trial.shifts
        assert trial.wanted == pytest.approx(trial.reference.angle(times), abs=1e-15)
    assert trial.shifts is not None and np.all(
        np.diff(trial.shifts[1:-1]) != 0
    )  # alternating


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
def test_actions_come_in_the_period_of_the_fault(bench: Bench) -> None:
    for number, rows in {
        "F19": [0], "F24": [0], "F41": [0], "F30": [400], "F29": [400], "F39": [400], "F22": [405],
        "F01": [], "F28": [],
    }.items():  # fmt: skip
        assert sorted(broken(bench, number, 1).actions) == rows, number
    assert (
        sorted(broken(bench, "F23", 3).actions)
        == sorted(broken(bench, "F40", 3).actions)
        == [400]
    )
    assert sorted(broken(bench, "F32", 2).actions) == [403]
    assert sorted(broken(bench, "F32", 3).actions) == [400, 425]


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
    assert np.all(np.isnan(members(after.law, 8)))
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
def test_a_block_is_made_another_version_size_or_sum(bench: Bench) -> None:
    words = np.frombuffer(bench.law.block[:16], "<u4").astype(int)
    for severity, place, value in (
        (1, 0, words[0] + 1),
        (2, 1, words[1] - 4),
        (3, 3, words[3] ^ 1),
    ):
        found = np.frombuffer(
            broken(bench, "F31", severity, "whole").block[:16], "<u4"
        ).astype(int)
        wanted = words.copy()
        wanted[place] = value
        assert found.tolist() == wanted.tolist()


@pytest.mark.slow
def test_one_byte_of_the_block_is_damaged_behind_its_header(bench: Bench) -> None:
    def places(severity: int, seed: int) -> list[int]:
        block = broken(bench, "F44", severity, "whole", seed=seed).block
        return [
            k
            for k, (a, b) in enumerate(zip(block, bench.law.block, strict=True))
            if a != b
        ]

    assert places(1, 1) == [16 + 40 + 2 * 8] and places(2, 1) == [
        len(bench.law.block) - 1
    ]
    drawn = [places(3, seed) for seed in range(8)]
    assert (
        all(len(each) == 1 and each[0] >= 16 for each in drawn)
        and len({each[0] for each in drawn}) > 4
    )


@pytest.mark.slow
def test_payloads_are_exchanged_and_a_stop_stands_ahead(bench: Bench) -> None:
    mass = [broken(bench, "F38", k, "whole").twin.beam.payload for k in (1, 2, 3)]
    assert mass == pytest.approx([0.03, 0.024, 0.012])
    for severity, begins, ends in (
        (1, 0.03, 0.015),
        (2, 0.03, 0.006),
        (3, 0.006, 0.03),
    ):
        before, after = acted(broken(bench, "F39", severity))
        assert (before.twin.beam.payload, after.twin.beam.payload) == pytest.approx(
            (begins, ends)
        )
    trial = broken(bench, "F40", 3)
    _, after = acted(trial)
    angle = float(trial.wanted[400]) + 0.05
    assert after.obstacle.tolist() == pytest.approx(
        [angle, 500.0, 2.0, trial.twin.beam.length, 1.0]
    )


@pytest.mark.slow
def test_limits_and_motor_loop_of_the_law_are_changed(bench: Bench) -> None:
    limits = bench.law.limits
    assert [
        broken(bench, "F27", k, "whole").law.limits.motor_limit for k in (1, 2, 3)
    ] == [0.9, 0.7, 0.5]
    steps = [broken(bench, "F28", k, "whole").law.limits.motor_step for k in (1, 2, 3)]
    assert steps == pytest.approx(
        [limits.motor_step / 3, limits.motor_step / 5, limits.motor_step / 10]
    )
    slow = [broken(bench, "F42", k, "whole") for k in (1, 2, 3)]
    assert all(
        trial.law.drive is not None and trial.law.drive != bench.law.drive
        for trial in slow
    )
    assert all(
        trial.block == trial.law.block for trial in slow
    )  # the new law is the one that runs
    stiff = [trial.law.drive.loop.direct for trial in slow]  # type: ignore[union-attr]
    assert stiff[0] > stiff[1] > stiff[2]


@pytest.mark.slow
def test_a_law_that_is_never_asked_for_more_than_its_motor_may(bench: Bench) -> None:
    trial = broken(bench, "F27", 1, "whole")
    whole = trial.inputs.copy()
    fault_sensors.asked_for_less(trial)
    beyond = whole[:, columns.REFERENCE] > 0.9
    assert (
        0 < beyond.sum() < trial.count
        and trial.inputs[:, columns.REFERENCE].max() == 0.9
    )
    assert (
        np.all(trial.inputs[beyond, columns.ACCELERATION] == 0.0)
        and trial.inputs[beyond, columns.REFERENCE].min() == 0.9
    )
    assert np.array_equal(trial.inputs[~beyond], whole[~beyond])


@pytest.mark.slow
def test_noise_is_left_out_where_it_would_hide_what_is_measured(bench: Bench) -> None:
    offset = bench.twin.sensors.gauge_offset
    assert np.all(
        broken(bench, "F38", 1, "whole").inputs[:, columns.GAUGE_ERROR] == offset
    )
    calm = broken(bench, "F28", 1, "whole").inputs[:, columns.GAUGE_ERROR]
    assert np.all(calm[-750:] == offset) and np.all(calm[-770:-750] != offset)


@pytest.mark.slow
def test_the_self_test_runs_the_motor_loop_alone(bench: Bench) -> None:
    trial = broken(bench, "F16", 1, "whole")
    assert trial.law.drive is not None and trial.law.drive.torque_voltage == 0.0
    assert (trial.law.correction.direct, trial.law.feedforward.direct) == (0.0, 0.0)
    assert trial.law.correction.poles == trial.law.feedforward.poles == ()
    assert trial.wanted[-1] == pytest.approx(0.35) and trial.wanted[25] == 0.0


@pytest.mark.slow
def test_a_wrong_unit_is_counted_from_when_it_shows(bench: Bench) -> None:
    """The first period in which the motor, a lag of 2/p + 1.5 T late, is read wrong by
    the guard's angle.
    """
    law = bench.law
    lag = round((2 / law.inner_pole + 1.5 * law.period) / law.period)
    for severity, factor in ((1, 10.0), (2, 180 / math.pi), (3, 1800 / math.pi)):
        trial = broken(bench, "F35", severity, "whole")
        shown = (factor - 1) * np.abs(trial.wanted) > law.limits.residual_angle
        assert trial.row == int(np.argmax(shown)) + lag
        assert (
            broken(bench, "F35", severity, "rest").row == REST
        )  # there it shows at once
    assert lag == 8


@pytest.mark.slow
def test_sensors_exchanged_from_the_beginning_are_counted_from_the_move(
    bench: Bench,
) -> None:
    assert broken(bench, "F37", 1, "whole").row == 250
    details = [
        broken(bench, "F37", k, phase).detail
        for k, phase in ((1, "whole"), (1, "mid"), (2, "mid"), (3, "mid"))
    ]
    assert details == ["for ever", "for a while", "for a while", "for ever"]


@pytest.mark.slow
def test_a_stuck_gauge_is_given_up_by_a_law_that_knows(bench: Bench) -> None:
    trial = broken(bench, "F11", 1)
    fault_sensors.without_gauge(trial)
    run = execute(trial)
    assert (
        run.mode[399] == RUN and run.mode[400] == DEGRADED and run.mode[-1] == DEGRADED
    )


@pytest.mark.slow
def test_a_run_that_diverges_is_cut_and_says_so(bench: Bench) -> None:
    trial = broken(bench, "F01", 1, inject=False)
    trial.at(300, lambda arm: arm.state.__setitem__(0, 1e9))
    run = execute(trial)
    assert not run.finished and 300 <= len(run.tip) < trial.count
    assert len(run.time) == len(run.wanted) == len(run.mode) == len(run.tip)
    whole = execute(broken(bench, "F01", 1, inject=False))
    assert (
        whole.finished
        and len(whole.tip) == 1751
        and whole.time[-1] == pytest.approx(7.0)
    )
    with pytest.raises(ValueError, match="read-only"):
        whole.tip[0] = 1.0


@pytest.mark.slow
def test_a_bench_takes_the_design_s_payloads_and_a_law_of_its_own_period(
    bench: Bench,
) -> None:
    assert bench.payloads == (0.020, 0.030, 0.040)
    assert 0.4 < bench.modulus_margin < 0.9
    with pytest.raises(Exception, match="period: not the rig's"):
        bench.with_law(replace(bench.law, period=0.002))
