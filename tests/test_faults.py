"""The fault campaign: complete, repeatable, and its verdicts turn when a guard is taken
out.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import fraclink as fl
from campaigns import fault_bench
from fraclink.errors import FieldError, FileFormatError
from fraclink.trials import (
    CATALOGUE,
    Bench,
    Case,
    FaultTable,
    Outcome,
    Soak,
    cases,
    run_case,
    run_faults,
    soak,
)
from fraclink.trials import _endurance as endurance
from fraclink.trials._endurance import upsets
from fraclink.trials._fault_rules import RULES
from fraclink.trials._fault_trial import REALS, WORDS, members
from fraclink.trials._faults import Check, fault_named, observe

# Open points of the shipped law on this arm; docs/how-to/run-a-fault-campaign.md gives
# their values.
OPEN = {"F03", "F06", "F07", "F08", "F21", "F24", "F27", "F37"}
WIDE = 1e3


@pytest.fixture(scope="module")
def bench() -> Bench:
    return fault_bench()


@pytest.fixture(scope="module")
def table(bench: Bench) -> FaultTable:
    return run_faults(
        bench, cases(bench, severities=(2,), payloads=(0.03,), seeds=(1,))
    )


def loosened(bench: Bench, **limits: float) -> Bench:
    return bench.with_law(
        replace(bench.law, limits=replace(bench.law.limits, **limits))
    )


def test_the_catalogue_is_complete() -> None:
    assert [fault.number for fault in CATALOGUE] == [f"F{k:02}" for k in range(1, 45)]
    assert all(len(set(fault.severities)) == 3 for fault in CATALOGUE)
    assert all(
        fault.injection and fault.required and fault.rule.require for fault in CATALOGUE
    )
    assert sorted(RULES) == [fault.number for fault in CATALOGUE]
    assert {fault.reaction for fault in CATALOGUE} == {"A", "B", "C", "D", "-"}


@pytest.mark.slow
def test_every_fault_has_a_verdict_and_no_new_one_is_open(table: FaultTable) -> None:
    assert [row.number for row in table.rows()] == [fault.number for fault in CATALOGUE]
    assert all(len(outcome.checks) >= 5 for outcome in table.outcomes)
    assert {outcome.case.fault for outcome in table.failures} <= OPEN


@pytest.mark.slow
def test_outputs_are_finite_and_in_limits_in_every_run(table: FaultTable) -> None:
    for outcome in table.outcomes:
        broken = [
            check.name
            for check in outcome.failed
            if check.name.startswith(("G1", "G2"))
        ]
        assert broken == [], outcome.case.name


@pytest.mark.slow
def test_both_precisions_take_the_same_modes(table: FaultTable) -> None:
    for outcome in table.outcomes:
        assert outcome.checks[-1].name.startswith("single precision"), outcome.case.name
        assert outcome.checks[-1].passed, outcome.case.name


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "limits"),
    [
        (
            Case("F18", 3, 0.03, "mid", 1),
            {"torque_step": WIDE},
        ),  # A: spikes are let through
        (
            Case("F36", 1, 0.03, "mid", 1),
            {"angle_step": WIDE, "angle_limit": WIDE, "residual_angle": WIDE},
        ),
        (
            Case("F09", 1, 0.03, "mid", 1),
            {"torque_limit": WIDE, "torque_step": WIDE},
        ),  # B
        (Case("F10", 2, 0.03, "mid", 1), {"torque_step": WIDE}),  # B, by the slew test
        (
            Case("F35", 2, 0.03, "whole", 1),
            {"angle_step": WIDE, "residual_angle": WIDE},
        ),  # D, by the residual
    ],
)
def test_a_guard_that_is_removed_turns_the_verdict(
    bench: Bench, name: Case, limits: dict[str, float]
) -> None:
    assert run_case(bench, name, single=False).passed
    assert not run_case(loosened(bench, **limits), name, single=False).passed


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "limits"),
    [
        (
            Case("F04", 2, 0.03, "mid", 1),
            {"bad_limit": 10**6},
        ),  # D: dead sensors are waited for
        (
            Case("F22", 3, 0.03, "mid", 1),
            {"missed_limit": 10**6},
        ),  # D: a dead task is forgiven
    ],
)
def test_a_counter_that_never_ends_turns_the_verdict(
    bench: Bench, case: Case, limits: dict[str, int]
) -> None:
    assert run_case(bench, case, single=False).passed
    assert not run_case(loosened(bench, **limits), case, single=False).passed


@pytest.mark.slow
def test_a_blocked_link_is_held_for_a_torque_that_does_not_swing_back(
    bench: Bench,
) -> None:
    case = Case("F40", 3, 0.03, "mid", 1)  # C
    assert run_case(bench, case, single=False).passed
    assert run_case(loosened(bench, torque_trip=WIDE), case, single=False).passed
    assert not run_case(loosened(bench, torque_block=WIDE), case, single=False).passed


@pytest.mark.slow
@pytest.mark.parametrize(
    "number",
    [
        f"F{k:02}"
        for k in (
            1,
            2,
            3,
            4,
            5,
            7,
            9,
            10,
            16,
            18,
            21,
            22,
            23,
            25,
            26,
            31,
            32,
            34,
            35,
            36,
            37,
            44,
        )
    ],
)
def test_a_run_in_which_nothing_happened_does_not_pass(
    bench: Bench, number: str
) -> None:
    fault = fault_named(number)
    case = next(iter(cases(bench, only=[number], severities=(2,), payloads=(0.03,))))
    e = observe(bench, case, bench.law)
    e = replace(e, faulty=e.clean)
    assert not all(check(e).passed for check in fault.rule.require)


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["double", "single"])
def test_the_members_of_the_state_are_where_they_are_said_to_be(
    bench: Bench, precision
) -> None:
    e = observe(
        bench, Case("F02", 1, 0.03, "mid", 1), bench.law.in_precision(precision)
    )
    memory = np.frombuffer(e.faulty.law_state, dtype=np.uint8)
    reals = dict(
        zip(REALS, members(memory, 4 if precision == "single" else 8), strict=True)
    )
    for name in ("encoder", "gauge", "command", "asked"):
        member = {
            "encoder": "motor_angle",
            "gauge": "torque",
            "command": "motor_reference",
            "asked": "voltage",
        }
        assert reals[member[name]] == pytest.approx(
            getattr(e.faulty, name)[-1], rel=1e-6
        ), name
    assert reals["reference"] == pytest.approx(1.0) and reals["fade"] == 1.0
    used = [reals[f"modes[{k}]"] for k in range(len(bench.law.correction.poles))]
    assert np.all(np.array(used) != 0.0)


@pytest.mark.slow
def test_a_run_repeats_to_the_last_bit(bench: Bench) -> None:
    planned = cases(
        bench, only=["F06", "F18", "F29"], severities=(3,), payloads=(0.02,), seeds=(3,)
    )
    table = run_faults(bench, planned)
    for outcome in reversed(table.outcomes):
        assert run_case(bench, outcome.case) == outcome
    other = run_case(bench, replace(planned[0], seed=4))
    assert other.peak != table.outcomes[0].peak


@pytest.mark.slow
def test_the_table_comes_back_equal(table: FaultTable, tmp_path) -> None:
    place = tmp_path / "faults.json"
    assert fl.load(fl.save(table, place), FaultTable) == table
    place.write_text(
        place.read_text("utf-8").replace('"severity": 2', '"severity": 7'), "utf-8"
    )
    with pytest.raises(FileFormatError):
        fl.load(place)


@pytest.mark.slow
def test_the_page_names_every_fault_and_what_is_open(table: FaultTable) -> None:
    page = table.markdown()
    assert all(f"| {fault.number} |" in page for fault in CATALOGUE)
    assert all(row.worst in page for row in table.rows())


def outcome(*failed: str, peak: float = 0.1, mode: str = "run") -> Outcome:
    checks = tuple(Check(name, math.inf, 1.0, passed=False) for name in failed)
    case = Case("F01", 1, 0.03, "mid", 1)
    return Outcome(case, checks, peak, 0.04, 0.0, mode, "none", -1)


@pytest.mark.slow
def test_every_fault_that_is_missed_has_a_cause_and_none_is_unsafe(
    table: FaultTable,
) -> None:
    missed = [row for row in table.rows() if not row.passed]
    assert all(
        fault_named(row.number).cause.startswith(("arm: ", "law: ", "test: "))
        for row in missed
    )
    assert all(fault_named(row.number).cause in table.markdown() for row in missed)
    assert {row.group for row in missed} <= {
        "slower than promised",
        "trips without need",
    }


@pytest.mark.slow
def test_a_limit_cycle_is_seen_without_the_noise_that_hid_it(bench: Bench) -> None:
    """Friction that is compensated fifteen times over keeps the motor moving."""
    case = Case("F28", 1, 0.03, "whole", 1)
    assert run_case(bench, case, single=False).passed
    drive = bench.law.drive
    assert drive is not None
    wild = replace(
        bench.law, drive=replace(drive, coulomb_voltage=15.0 * drive.coulomb_voltage)
    )
    failed = run_case(bench.with_law(wild), case, single=False).failed
    assert "limit cycle [rad]" in [check.name for check in failed]


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["single", "double"])
def test_a_flipped_bit_of_what_decides_leaves_the_arm_where_it_is_or_the_drive_off(
    bench: Bench, precision
) -> None:
    made = bench.with_law(bench.law.in_precision(precision))
    # the reals: what goes on from period to period without anything that contradicts
    # it, a slow mode among it
    reals = ("reference", "motor_reference", "integral", "filter", "modes[9]")
    found = upsets(made, names=["stamp", "mode", "tick", *reals])
    assert len(found) == 32 * (3 + len(reals) * (1 if precision == "single" else 2))
    assert [upset for upset in found if not upset.passed] == []


@pytest.mark.slow
def test_a_flipped_bit_of_any_counter_does_no_harm(bench: Bench) -> None:
    single = bench.with_law(bench.law.in_precision("single"))
    for phase in ("start", "mid", "rest"):
        found = upsets(single, phase=phase, names=WORDS)
        assert len(found) == len(WORDS) * 32
        assert [upset for upset in found if not upset.passed] == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"only": ["F45"]}, "only"),
        ({"severities": (4,)}, "severities[0]"),
        ({"phases": ("night",)}, "phases[0]"),
        ({"only": ["F08"], "phases": ("mid",)}, "phases"),
        ({"payloads": (-0.02,)}, "payloads[0]"),
        ({"seeds": (-1,)}, "seeds[0]"),
    ],
)
def test_bad_requests_name_the_field(
    bench: Bench, options: dict[str, object], field: str
) -> None:
    with pytest.raises(FieldError) as caught:
        cases(bench, **options)
    assert caught.value.field == field


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["double", "single"])
def test_a_clean_arm_is_left_alone(bench: Bench, precision) -> None:
    made = bench.with_law(bench.law.in_precision(precision))
    for payload in bench.payloads:
        result = soak(made, payload, periods=50_000)
        assert (result.periods, result.trips, result.flagged) == (50_000, 0, 0)


@pytest.mark.slow
def test_a_soak_counts_what_the_law_says_and_what_was_not_run(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Chunks of a hundred rounds of a thousand periods; a chunk that is cut short ends
    it.
    """
    asked: list[int] = []

    class Arm:
        def __init__(self, *_: Any) -> None: ...

        def run(self, block: bytes, inputs: Any, *, single: bool) -> Any:
            asked.append(len(inputs))
            noisy.append(inputs[:, 3].copy())
            record = np.zeros((len(inputs) - (7 if len(asked) == cut else 0), 15))
            record[:, 9] = 1  # mode run
            record[:3, 9], record[:5, 11], record[0, 11] = (
                4,
                2,
                128,
            )  # off; a flag; started, which is none
            record[10, 0], record[10, 2] = 1.0, 0.75 - len(asked)
            return record

    monkeypatch.setattr(endurance, "ArmState", Arm)
    noisy: list[Any] = []
    cut = 0
    assert soak(bench, 0.03, periods=150_000, seed=5) == Soak(150_000, 6, 8, 2.25)
    assert asked == [100_000, 50_000] and not np.array_equal(
        noisy[0][:50_000], noisy[1]
    )
    assert np.std(noisy[0]) == pytest.approx(bench.twin.sensors.gauge_noise, rel=0.02)
    asked.clear()
    cut = 1
    assert soak(bench, 0.03, periods=150_000) == Soak(99_993, 3 + 50_007, 4, 1.25)


@pytest.mark.slow
def test_the_soak_sees_trips(bench: Bench) -> None:
    result = soak(loosened(bench, residual_angle=1e-4), 0.03, periods=2_000)
    assert result.periods == 2_000 and 0 < result.trips < 2_000 and result.flagged > 0
    with pytest.raises(FieldError):
        soak(bench, 0.03, periods=0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed", [11, 12, 79, 117]
)  # the last two: held with noise left in the modes, it trips
def test_an_arm_that_is_quiet_for_an_hour_does_not_trip(
    bench: Bench, seed: int
) -> None:
    for severity in (1, 2):
        outcome = run_case(bench, Case("F43", severity, 0.04, "whole", seed))
        names = {check.name for check in outcome.checks}
        assert {
            "quiet periods in another mode than run",
            "denormal numbers left in the state",
        } <= names
        assert [check for check in outcome.checks if not check.passed] == []


@pytest.mark.slow
def test_a_healthy_arm_that_trips_ends_the_campaign_at_once(bench: Bench) -> None:
    tender = loosened(bench, residual_angle=1e-4)
    begun: list[str] = []
    with pytest.raises(
        FieldError, match=r"bench: trips with 20 g before anything is broken \(got off"
    ):
        run_faults(tender, cases(tender), progress=begun.append)
    assert begun == ["F01"]
