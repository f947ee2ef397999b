"""A campaign's numbers: its draws, sizes, fingerprint and files, the words of its
summary, a fault's row.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr

import fraclink as fl
from campaigns import fault_bench, small
from fraclink._simulate.links import batch_links
from fraclink.errors import FieldError, SizeError
from fraclink.trials._arms import arm_of, block_of, unit_paths
from fraclink.trials._campaign import (
    Campaign,
    Distribution,
    draw,
    draws_for,
    load_campaign,
    save_campaign,
)
from fraclink.trials._faults import (
    Case,
    Check,
    FaultTable,
    Outcome,
    cases,
    fault_named,
)
from fraclink.trials._run import part_path, read_part, write_part

RIG = fl.Rig.named("paper-2023")
MODEL = RIG.model
assert MODEL is not None


# ── draws
# ───────────────────────────────────────────────────────────────────────────────────────────────────


def test_a_distribution_by_its_cumulated_probability() -> None:
    uniform = np.array([0.0, 0.25, 0.5, 0.9999])
    assert Distribution("uniform", 2.0, 6.0).at(uniform) == pytest.approx(
        [2.0, 3.0, 4.0, 5.9996]
    )
    assert Distribution("whole", 1, 3).at(uniform).tolist() == [1.0, 1.0, 2.0, 3.0]
    assert Distribution("whole", 1, 3).at(
        np.array([1 / 3 - 1e-9, 1 / 3 + 1e-9])
    ).tolist() == [1.0, 2.0]
    normal = Distribution("normal", 2.0, 6.0)  # mean 4, deviation 0.5, cut at ±4 of it
    cut = float(ndtr(-4.0))
    at_one = (float(ndtr(1.0)) - cut) / (1.0 - 2.0 * cut)
    assert normal.at(np.array([0.0, 0.5, at_one])) == pytest.approx([2.0, 4.0, 4.5])
    assert Distribution("normal", 3.0, 3.0).at(uniform).tolist() == [3.0] * 4
    Distribution("whole", 2.0, 2.0)
    for bad in ((2.0, 2.5), (1.5, 2.0)):
        with pytest.raises(FieldError, match="not whole"):
            Distribution("whole", *bad)


def test_the_default_draws_are_those_that_the_documentation_states() -> None:
    late = replace(MODEL, gauge_delay=0.011, gauge_gain=1.1)
    found = draws_for(RIG, late)
    assert found.payload == Distribution("uniform", 0.020, 0.040)
    assert found.stiffness == Distribution("normal", 0.92 * 1.56, 1.08 * 1.56)
    assert (found.order.kind, found.order.low, found.order.high) == (
        "normal",
        pytest.approx(1.90),
        1.94,
    )
    assert found.gauge_offset == Distribution("uniform", -0.05, 0.05)
    assert found.delay_samples == Distribution("whole", 1, 1)
    assert found.motor_gain == Distribution("normal", 0.9, 1.1)
    assert found.viscous_friction == Distribution("normal", 0.7, 1.3)
    assert found.coulomb_torque == Distribution("uniform", 0.5, 1.5)
    assert found.noise == Distribution("uniform", 0.5, 2.0)
    assert found.amplitude == Distribution("uniform", 0.2, 1.2)
    assert found.gauge_delay == Distribution("uniform", 0.011, 0.011)
    assert found.gauge_gain == Distribution("uniform", 1.1, 1.1)
    assert found.payload_given == Distribution("uniform", 0.0, 0.0)
    near = draws_for(RIG, replace(MODEL, order=1.99)).order
    assert (near.low, near.high) == (
        pytest.approx(1.98),
        pytest.approx(2.0),
    ) and near.high <= 2.0
    assert draws_for(
        RIG, replace(MODEL, gauge_delay=-0.01)
    ).gauge_delay == Distribution("uniform", 0.0, 0.0)


@pytest.mark.parametrize(
    ("name", "low", "high", "fits"),
    [
        ("payload", 0.0, 0.1, False), ("payload", 1e-9, 0.1, True), ("stiffness", 0.0, 1.0, False),
        ("motor_gain", 0.0, 1.0, False), ("amplitude", 0.0, 1.0, False), ("amplitude", 0.1, 1.0, True),
        ("order", 1.0, 1.9, False), ("order", 1.5, 2.0, True), ("order", 1.5, 2.01, False),
        ("delay_samples", 0, 100, True), ("delay_samples", 0, 101, False), ("delay_samples", -1, 1, False),
        ("viscous_friction", 0.0, 2.0, True), ("coulomb_torque", -1, 1, False), ("noise", 0, 1, True),
        ("coulomb_torque", 0, 1, True), ("gauge_delay", 0.0, 0.1, True), ("gauge_delay", -0.1, 0.1, False),
        ("payload_given", 0, 1.5, True), ("payload_given", -0.1, 1, False), ("gauge_offset", -9, 9, True),
    ],
)  # fmt: skip
def test_a_parameter_is_drawn_from_its_range(
    name: str, low: float, high: float, fits: bool
) -> None:
    kind: Any = "whole" if name == "delay_samples" else "uniform"
    own = Distribution(kind, low, high)
    if fits:
        assert getattr(replace(small().draws, **{name: own}), name) == own
    else:
        with pytest.raises(FieldError, match=rf"draws\.{name}"):
            replace(small().draws, **{name: own})


# ── the campaign
# ────────────────────────────────────────────────────────────────────────────────────────────


def test_a_campaign_has_parts_of_a_thousand_and_a_rest() -> None:
    assert [small().part_runs(part) for part in range(3)] == [
        1000,
        1000,
        500,
    ] and small().parts == 3
    assert (
        small(1000).parts == 1
        and small(1001).parts == 2
        and small(1001).part_runs(1) == 1
    )
    assert replace(small(), runs=10**9).parts == 10**6
    with pytest.raises(SizeError, match="runs"):
        replace(small(), runs=10**9 + 1)
    shortest = replace(small(), duration=2.0)
    assert (
        shortest.duration == 2.0 and replace(small(), duration=600.0).duration == 600.0
    )
    for duration in (1.999, 600.1):
        with pytest.raises(FieldError, match="duration"):
            replace(small(), duration=duration)


def test_a_campaign_follows_the_reference_that_it_is_given() -> None:
    law = small().law
    moves = [each.duration for each in small().references]
    assert (
        moves == [0.5, 0.75, 1.0]
        and small().duration == 4.0
        and small().reference is None
    )
    long = fl.smooth_step(0.7, 2.5)
    own = Campaign.of(
        RIG, MODEL, law, runs=10, reference=long, estimated=(0.02, 0.04), told=True
    )
    assert (
        own.references == (long,)
        and own.duration == 5.5
        and own.payloads == (0.02, 0.04)
    )
    assert own.draws.amplitude == Distribution("uniform", 1.0, 1.0)
    assert own.draws.payload_given == Distribution("uniform", 1.0, 1.0)
    assert (
        Campaign.of(
            RIG, MODEL, law, runs=10, reference=fl.smooth_step(0.7, 0.5)
        ).duration
        == 4.0
    )
    assert unit_paths(own).shape == (1, 2, 1376) and unit_paths(own, 2).shape == (
        1,
        2,
        2751,
    )
    path = unit_paths(small())
    time = 0.004 * np.arange(1001)
    assert path[1, 0] == pytest.approx(fl.smooth_step(1.0, 0.75).angle(time))
    assert path[1, 1] == pytest.approx(fl.smooth_step(1.0, 0.75).acceleration(time))
    # A second is left behind it, and no less.
    assert replace(own, reference=fl.smooth_step(1.0, 4.5)).duration == 5.5
    with pytest.raises(FieldError, match=r"reference: too long .* <= 4.5 s"):
        replace(own, reference=fl.smooth_step(1.0, 4.51))


def test_a_campaign_gives_the_law_the_motor_loop_of_its_rig() -> None:
    bare = replace(small().law, drive=None)
    assert Campaign.of(RIG, MODEL, bare, runs=1).law.drive == small().law.drive
    assert Campaign.of(RIG, MODEL, bare, runs=1, motor_loop="ideal").law is bare
    own = replace(small().law, limits=replace(small().law.limits, motor_limit=1.0))
    assert Campaign.of(RIG, MODEL, own, runs=1).law is own
    assert Campaign.of(RIG, MODEL, bare, runs=1, draws=small().draws, seed=5).seed == 5
    assert small().estimator is None
    bank = replace(small(), payloads=(0.02, 0.04)).estimator
    assert bank is not None and bank.certified == pytest.approx((0.02, 0.04))


def test_the_fingerprint_is_of_all_that_a_result_depends_on() -> None:
    """The same for more runs; another for everything else; unchanged by later fields at
    their defaults.
    """
    plain = small()
    assert replace(plain, runs=7).fingerprint == plain.fingerprint
    changed = [
        replace(plain, seed=8),
        replace(plain, duration=5.0),
        replace(plain, motor_loop="ideal"),
        replace(plain, payloads=(0.02, 0.04)),
        replace(plain, reference=fl.smooth_step(1.0, 0.5)),
        replace(plain, rig=replace(RIG, name="other")),
        replace(plain, model=replace(MODEL, stiffness=1.57)),
        replace(plain, model=replace(MODEL, gauge_delay=0.001)),
        replace(
            plain,
            draws=replace(plain.draws, payload_given=Distribution("uniform", 1.0, 1.0)),
        ),
        replace(plain, law=replace(plain.law, stiffness=1.57)),
    ]
    assert len({campaign.fingerprint for campaign in (plain, *changed)}) == 11
    assert (
        replace(plain, model=replace(MODEL, unseen_up_to=None)).fingerprint
        == plain.fingerprint
    )


def test_a_campaign_comes_back_with_its_reference_and_its_payloads(
    tmp_path: Path,
) -> None:
    made = replace(
        small(),
        reference=fl.smooth_step(0.8, 0.6),
        payloads=(0.02, 0.04),
        motor_loop="ideal",
    )
    save_campaign(made, tmp_path)
    back = load_campaign(tmp_path)
    assert (back.payloads, back.motor_loop, back.runs, back.seed) == (
        (0.02, 0.04),
        "ideal",
        2500,
        7,
    )
    assert back.reference is not None and back.fingerprint == made.fingerprint
    assert back.reference.angle([0.3, 0.6, 2.0]) == pytest.approx(
        [0.4, 0.8, 0.8], abs=1e-6
    )
    written = json.loads((tmp_path / "campaign.json").read_text())
    assert written["part_runs"] == 1000 and written["shapes"] == [0.5, 0.75, 1.0]


# ── its arms
# ────────────────────────────────────────────────────────────────────────────────────────────────


def test_the_arm_of_a_run_is_what_was_drawn_for_it() -> None:
    campaign = small()
    rig, link, own = arm_of(campaign, 1234)
    values = draw(campaign.draws, 7, 1, 1000)
    assert own == {
        name: pytest.approx(float(column[234])) for name, column in values.items()
    }
    motor = campaign.rig.motor
    assert rig.motor.torque_constant == pytest.approx(
        motor.torque_constant * own["motor_gain"]
    )
    assert rig.motor.viscous_friction == pytest.approx(
        motor.viscous_friction * own["viscous_friction"]
    )
    assert rig.motor.coulomb_torque == pytest.approx(
        motor.coulomb_torque * own["coulomb_torque"]
    )
    assert link.natural_frequency == pytest.approx(
        math.sqrt(own["stiffness"] / (own["payload"] * 0.65**2))
    )
    assert (link.stiffness, link.order, link.payload) == (
        own["stiffness"],
        own["order"],
        own["payload"],
    )


def test_a_block_has_the_numbers_of_its_arms() -> None:
    draws = replace(
        small().draws,
        gauge_delay=Distribution("uniform", 0.0, 0.01),
        payload_given=Distribution("uniform", 0.9, 1.1),
    )
    campaign = replace(small(), draws=draws)
    own = {name: column[10:13] for name, column in draw(draws, 7, 0, 1000).items()}
    arms, chosen = block_of(campaign, own, 10)
    motor = RIG.motor
    assert arms.noise == pytest.approx(0.01 * own["noise"])
    assert arms.stiffness == pytest.approx(own["stiffness"])
    assert arms.gauge_delay == pytest.approx(own["gauge_delay"] / 0.004)
    assert arms.payload_given == pytest.approx(own["payload_given"] * own["payload"])
    assert arms.motor_gain == pytest.approx(motor.gain * own["motor_gain"])
    assert arms.motor_decay == pytest.approx(motor.decay * own["viscous_friction"])
    friction = motor.coulomb_torque / (motor.inertia * motor.gear_ratio)
    assert arms.friction == pytest.approx(friction * own["coulomb_torque"])
    # 2^64 over the golden ratio: every run of every seed has noise of its own.
    assert [int(seed) for seed in arms.seed] == [
        (k * 0x9E3779B97F4A7C15 + 7) % 2**64 for k in (10, 11, 12)
    ]
    assert chosen.tolist() == [int(shape) % 3 for shape in own["shape"]]


def test_links_of_a_block_are_valid_up_to_two_radians_in_a_period() -> None:
    for order in (1.5, 2.0):
        edge = (2.0 / 0.004) ** order
        model, orders, none = MODEL, np.full(2, order), np.zeros(2)
        batch_links(model, np.array([100.0, 0.999 * edge]), orders, none, 0.004)
        with pytest.raises(
            FieldError, match=r"period: too long for the fastest link .* < 0.004 s"
        ):
            batch_links(model, np.array([100.0, 1.001 * edge]), orders, none, 0.004)


# ── its parts
# ───────────────────────────────────────────────────────────────────────────────────────────────


@pytest.fixture(scope="module")
def one_part(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("part")
    save_campaign(small(30), place)
    assert write_part(small(30), place, 0) == 30
    return place


def test_a_part_of_another_length_place_or_campaign_is_not_believed(
    one_part: Path,
) -> None:
    assert part_path(one_part, 12).name == "part-0000012.parquet"
    good = read_part(small(30), one_part, 0)
    assert good is not None and len(good["run"]) == 30
    assert (
        read_part(small(31), one_part, 0) is None
    )  # of the same campaign, but not all of the part
    assert (
        read_part(small(30, seed=8), one_part, 0) is None
        and read_part(small(30), one_part, 1) is None
    )
    part_path(one_part, 1).write_bytes(part_path(one_part, 0).read_bytes())
    assert read_part(small(1030), one_part, 1) is None  # it says that it is part 0
    part_path(one_part, 1).unlink()
    some = read_part(small(30), one_part, 0, names=("payload", "passed"))
    assert some is not None and sorted(some) == ["passed", "payload"]
    assert some["payload"].tolist() == good["payload"].tolist()


# ── what they say together
# ──────────────────────────────────────────────────────────────────────────────────


# ── the table of faults
# ─────────────────────────────────────────────────────────────────────────────────────


def outcome(
    number: str, *checks: Check, seed: int = 1, detail: str = "", peak: float = 0.1
) -> Outcome:
    return Outcome(
        Case(number, 1, 0.03, "mid", seed),
        checks,
        peak,
        0.1,
        0.0,
        "run",
        "none",
        -1,
        detail,
    )


def test_a_row_names_the_check_that_is_exceeded_most() -> None:
    mild, worse = (
        Check.at_most("peak tip error over clean", 1.3, 1.1),
        Check.at_most("recovery [s]", 3.0, 1.0),
    )
    never = Check.at_most("periods until off (never)", math.inf, 20.0)
    met = Check.at_most("final tip error [rad]", 0.5, 1.0)
    count = Check.at_most("periods in another mode than allowed", 7.0, 0.0)
    table = FaultTable((
        outcome("F02", met), outcome("F01", mild, met), outcome("F01", worse, mild, seed=2, detail="byte 3"),
        outcome("F01", met, seed=3), outcome("F03", count, worse),
    ))  # fmt: skip
    first, second, third = table.rows()
    assert [row.number for row in (first, second, third)] == ["F02", "F01", "F03"]
    assert (first.passed, first.worst, first.example, first.group) == (
        True,
        "",
        None,
        "met",
    )
    assert (second.runs, second.failed, second.passed) == (3, 2, False)
    assert second.worst == "recovery [s]: 3 (limit 1) (F01-1-30g-mid-2: byte 3)"
    assert (
        second.example is table.outcomes[2] and second.group == "slower than promised"
    )
    assert third.worst.startswith("periods in another mode than allowed: 7 (limit 0)")
    assert third.group == "trips without need"
    assert not table.passed and table.failures == (
        *table.outcomes[1:3],
        table.outcomes[4],
    )
    lost = FaultTable((outcome("F07", worse, never),)).rows()[0]
    assert lost.worst.startswith("periods until off (never): inf")
    assert FaultTable((outcome("F02", met),)).passed


def test_the_page_explains_what_is_missed_and_what_is_not_shown() -> None:
    missed = Check.at_most("|x|", 2.0, 1.0)
    page = (
        FaultTable((outcome("F21", missed), outcome("F16"), outcome("F08")))
        .markdown()
        .splitlines()
    )
    assert page[2].endswith(
        "| slower than promised | \\|x\\|: 2 (limit 1) (F21-1-30g-mid-1) |"
    )
    assert (
        page[2].startswith("| F21 | missed ticks, few | A | ")
        and "| 1 | 1 | slower" in page[2]
    )
    causes, notes = (
        page.index("Why, on the paper's arm:"),
        page.index("What this does not show:"),
    )
    assert (
        page[causes + 2]
        == "- F21: law: its modes go on by one step for up to six periods."
    )
    assert (
        page[notes + 2]
        == "- F16: the self-test must be run: law_step alone does not refuse."
    )
    assert not any(
        line.startswith("- F08") for line in page
    )  # it was met: no cause is told
    assert len(page) == notes + 3


@pytest.mark.slow
def test_cases_are_those_that_make_sense_in_order() -> None:
    bench = fault_bench()
    found = cases(
        bench,
        only=["F40", "f12"],
        severities=(3, 1),
        phases=("whole", "mid", "rest"),
        seeds=(5,),
    )
    blow = [
        (s, p, phase)
        for s in (3, 1)
        for p in (0.02, 0.03, 0.04)
        for phase in ("mid", "rest")
    ]
    wanted = [("F40", *each) for each in blow if each[0] != 3 or each[2] != "rest"]
    wanted += [("F12", s, p, "whole") for s in (3, 1) for p in (0.02, 0.03, 0.04)]
    assert [(c.fault, c.severity, c.payload, c.phase) for c in found] == wanted
    assert {case.seed for case in found} == {5}
    one = cases(
        bench,
        only=["F01"],
        severities=(2,),
        payloads=(0.025,),
        phases=("mid",),
        seeds=(1, 2),
    )
    assert [case.name for case in one] == ["F01-2-25g-mid-1", "F01-2-25g-mid-2"]
    every: Sequence[Case] = cases(bench)
    assert (
        len(every)
        == sum(9 * 3 * len(phases_of(number)) for number in range(1, 45)) - 27 // 3
    )
    with pytest.raises(
        FieldError, match=r"phases: none in which the fault is run .* mid, rest, start"
    ):
        cases(bench, only=["F01"], phases=("whole",))


def phases_of(number: int) -> tuple[str, ...]:
    return fault_named(f"F{number:02}").phases
