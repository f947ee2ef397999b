"""Shaped moves: every arm of the set behaves as predicted by the linear loops, and
every limit is kept.
"""

from __future__ import annotations

import json
import math
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import fraclink as fl
from fraclink import Callback, Twin, main
from fraclink.errors import FieldError, FileFormatError
from fraclink.extend import LawInputs, ShapedMove
from fraclink.trials import Campaign
from law_bench import documented_design
from needed_tools import tool

PLAIN = fl.Rig.named("paper-2023-geared")
# the gauge offset of the paper's figures, which the law must not react to
RIG = replace(PLAIN, gauge=replace(PLAIN.gauge, offset=0.05))
KNOWN = (0.030, 0.030)
BAND = 0.02


@pytest.fixture(scope="module")
def design() -> fl.Design:
    return documented_design(RIG, filter_time=0.02).with_law()


@pytest.fixture(scope="module")
def unknown(design: fl.Design) -> ShapedMove:
    return fl.shape(design, 1.0, voltage=8.0, over="model")


@pytest.fixture(scope="module")
def known(design: fl.Design) -> ShapedMove:
    return fl.shape(design, 1.0, payloads=KNOWN, told=True, over="model", seeds=2)


def viscous_link() -> fl.LinkModel:
    """The link of the other damping law, with the same damping ratio."""
    assert RIG.model is not None
    return replace(
        RIG.model,
        order=2.0,
        damping=2 * RIG.model.damping_ratio * RIG.model.natural_frequency,
    )


def other_arms(payload: float) -> list[Twin]:
    """Arms with the same payload whose λ differs by 0.03, and a viscous one with equal
    damping.
    """
    links = [
        RIG.model,
        viscous_link(),
        *(replace(RIG.model, order=o) for o in (1.89, 1.95)),
    ]
    return [Twin.from_rig(RIG, model=link, payload=payload) for link in links]


# --- arms that are not the model ------------------------------------------------------


def test_the_worst_arm_of_the_box_is_told_beside_the_model(design: fl.Design) -> None:
    case = fl.worst_case(
        design, fl.smooth_step(1.0, 0.5), payloads=(0.08, 0.08), told=True
    )
    assert case.nominal.arm == "model" and case.nominal.settling_time < 0.5
    assert "viscous" in case.worst.arm and case.settling_time > 1.5
    assert f"{case.settling_time:.3g} s" in str(case)
    (alone,) = fl.worst_case(
        design,
        fl.smooth_step(1.0, 0.5),
        payloads=(0.08, 0.08),
        told=True,
        over="model",
    ).arms
    assert alone == case.nominal


def test_an_unstable_arm_does_not_settle_however_small_its_vibration_is() -> None:
    """The law of a viscous link, for 20 to 40 g, on one of 12 g with the other damping
    law: its vibration grows by a tenth a second.
    """
    made = fl.design(
        viscous_link(),
        RIG,
        payloads=(0.020, 0.040),
        gain_crossover=11.7,
        phase_margin=fl.deg(45),
    )
    options = {"payloads": (0.012, 0.012), "told": True}
    case = fl.worst_case(made, fl.smooth_step(1.0, 0.5), **options)
    assert "fractional" in case.worst.arm and case.settling_time == math.inf
    assert case.nominal.settling_time < 0.6
    with pytest.raises(FieldError, match=r"not stable.*fractional"):
        fl.shape(made, 1.0, **options)


@pytest.mark.slow
@pytest.mark.parametrize("payload", [0.008, 0.030, 0.080])
def test_a_move_for_the_box_settles_on_every_arm_of_it(
    design: fl.Design, payload: float
) -> None:
    move = fl.shape(design, 1.0, payloads=(payload, payload), told=True)
    assert move.passed and move.settling_time <= 0.70
    assert move.settling_time <= move.promised + 1.5 * move.period
    for arm in other_arms(payload):
        run = fl.simulate(design, move.reference, arm=arm, told=payload, seed=3)
        assert run.metrics.settling_time <= move.promised + 0.01
        assert run.metrics.peak_voltage <= RIG.motor.voltage_limit


@pytest.mark.slow
def test_more_time_than_the_shortest_makes_a_gentler_move(design: fl.Design) -> None:
    options = {"payloads": KNOWN, "told": True, "seeds": 1}
    fast = fl.shape(design, 1.0, **options)
    gentle = fl.shape(design, 1.0, settle=0.7, **options)
    assert gentle.passed and fast.settling_time < gentle.settling_time <= 0.7
    push = [
        float(np.abs(move.reference.acceleration(np.linspace(0, 1, 400))).max())
        for move in (gentle, fast)
    ]
    assert push[0] < 0.6 * push[1]
    with pytest.raises(FieldError, match=r"does not settle within 0\.2 s"):
        fl.shape(design, 1.0, settle=0.2, **options)


@pytest.mark.slow
def test_of_all_moves_that_settle_as_soon_none_is_gentler(design: fl.Design) -> None:
    """A smooth step with the same settling time has a larger acceleration."""
    move = fl.shape(
        design, 1.0, payloads=KNOWN, told=True, settle=0.6, over="model"
    ).reference
    time = np.linspace(0.0, 1.0, 4001)
    smooth = fl.smooth_step(1.0, 0.6)
    varied = [np.abs(np.diff(each.acceleration(time))).sum() for each in (move, smooth)]
    assert varied[0] < varied[1]


# --- the model's own arms -------------------------------------------------------------


@pytest.mark.slow
def test_one_reference_moves_every_payload_as_promised(unknown: ShapedMove) -> None:
    (arm,) = unknown.worst_case.arms
    assert unknown.passed and unknown.findings == ()
    assert arm.settling_time <= 0.62 and arm.settling_time <= unknown.promised + 0.006
    assert arm.peak_voltage <= 8.0 and arm.guarded == 0.0
    assert unknown.amplitude == pytest.approx(1.0, abs=1e-9)
    assert unknown.worst_case.payloads == (0.020, pytest.approx(0.040))


@pytest.mark.slow
def test_a_known_payload_moves_twice_as_fast(known: ShapedMove) -> None:
    assert known.passed and known.settling_time <= 0.35


@pytest.mark.slow
def test_a_move_for_the_identified_model_suits_that_model(design: fl.Design) -> None:
    """An identified arm that is 15 % slower than stiffness and length imply, with a
    second mode.
    """
    slow = replace(
        design.model,
        natural_frequency=0.85 * design.model.natural_frequency,
        second_mode=fl.SecondMode(frequency=180.0, damping_ratio=0.02, gain=0.1),
    )
    # without the offset: that of the model appears at the start of the move and
    # disturbs it
    made = fl.design(
        slow,
        PLAIN,
        payloads=(0.020, 0.040),
        gain_crossover=10.0,
        phase_margin=fl.deg(45),
        filter_time=0.02,
    )
    options = {"payloads": KNOWN, "told": True, "over": "model"}
    fitting = fl.shape(made, 1.0, on="model", seeds=2, **options)
    assert fitting.passed and fitting.settling_time < 0.45
    of_twin = fl.shape(made, 1.0, **options)
    run = fl.simulate(made, of_twin.reference, payload=0.030, told=True)
    assert run.metrics.settling_time > fitting.settling_time + 0.1


@pytest.mark.slow
def test_moves_to_the_other_side_are_the_same(
    design: fl.Design, known: ShapedMove
) -> None:
    back = fl.shape(design, -1.0, payloads=KNOWN, told=True, over="model")
    assert back.amplitude == pytest.approx(-1.0) and back.passed
    assert back.settling_time == pytest.approx(known.settling_time, abs=0.009)


@pytest.mark.slow
def test_a_limit_of_the_voltage_costs_time(
    design: fl.Design, known: ShapedMove
) -> None:
    options = {"payloads": KNOWN, "told": True, "over": "model"}
    weak = fl.shape(design, 1.0, voltage=4.0, **options)
    assert weak.worst_case.worst.peak_voltage <= 4.0
    assert weak.settling_time > known.settling_time + 0.02
    with pytest.raises(FieldError, match="Allow more time or voltage"):
        fl.shape(design, 1.0, voltage=0.02, **options)


@pytest.mark.slow
def test_a_promise_that_noise_breaks_is_a_finding(design: fl.Design) -> None:
    options = {"payloads": KNOWN, "told": True, "over": "model"}
    small = fl.shape(design, 0.01, **options)
    assert {finding.code for finding in small.findings} == {"W501"} and not small.passed
    tight = fl.shape(design, 1.0, voltage=6.0, reserve=0.0, seeds=2, **options)
    assert any("voltage" in finding.message for finding in tight.findings)


@pytest.mark.slow
def test_what_cannot_be_shaped_is_refused(design: fl.Design) -> None:
    def refused(field: str, *move: object, **options: object) -> None:
        with pytest.raises(FieldError) as caught:
            fl.shape(design, *move, **options)
        assert caught.value.field == field

    refused("move", 0.0)
    refused("move", 20.0)
    refused("move", math.nan)
    refused("payloads", 1.0, payloads=(0.04, 0.02))
    refused("payloads", 1.0, payloads=(0.0, 0.02))
    refused("move", fl.spline([0.0, 1.0], [0.1, 1.0]), payloads=KNOWN, over="model")
    refused("reserve", 1.0, reserve=1.0)
    light = replace(design, rig=fl.Rig.named("paper-2023"))
    with pytest.raises(FieldError, match="not stable"):
        fl.shape(light, 1.0)


# --- tables, files, boards ------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        "time_s,angle\n0,0\n1,1\n",
        "time_s,angle_rad,velocity_rad_per_s\n0,0,0\n1,1,0\n",
        "time_s,angle_rad,velocity_rad_per_s,acceleration_rad_per_s2\n0,0,0,0\n1,1,0,0\n3,1,0,0\n",
        "time_s,angle_rad,velocity_rad_per_s,acceleration_rad_per_s2\n0,0,0,0\n",
    ],
)
def test_a_table_that_is_none_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "move.csv").write_text(text)
    with pytest.raises(FileFormatError):
        fl.extend.read_reference(tmp_path / "move.csv")


# ───────────────────────────────────────────────────────────────────


@pytest.mark.slow
def test_a_saved_move_comes_back_and_moves_the_same(
    design: fl.Design, unknown: ShapedMove, tmp_path: Path
) -> None:
    place = tmp_path / "move.json"
    unknown.save(place)
    again = fl.load(place)
    assert isinstance(again, ShapedMove) and again.worst_case == unknown.worst_case
    assert np.array_equal(again.tip_angle, unknown.tip_angle)
    table = fl.extend.read_reference(
        fl.extend.export_reference(
            unknown.reference, tmp_path / "move.csv", period=0.004
        )
    )
    runs = [
        fl.simulate(design, each, duration=1.0)
        for each in (unknown.reference, table, fl.extend.read_reference(place))
    ]
    assert all(np.array_equal(run.tip_angle, runs[0].tip_angle) for run in runs)
    runs = [
        fl.simulate(design, each, arm=Twin.from_rig(RIG), duration=1.0)
        for each in (unknown.reference, table)
    ]
    assert np.array_equal(runs[0].tip_angle, runs[1].tip_angle)
    assert "settles within" in str(again) and "<svg" in again._repr_html_()  # type: ignore[attr-defined]


@pytest.mark.slow
def test_the_loop_in_real_time_takes_a_table(
    design: fl.Design, known: ShapedMove
) -> None:
    law, time = design.law(), 0.004 * np.arange(100)
    move = known.reference
    rows = [move.angle(time), move.velocity(time), move.acceleration(time)]
    board = Callback(read=lambda: (0.0, 0.0), write=lambda command: None)
    run = fl.lab.run_realtime(
        law,
        fl.extend.SampledReference(0.004, np.array(rows)),
        board,
        duration=0.3,
        priority=0,
        lock_memory=False,
    )
    row = np.rint(run.time / 0.004).astype(int)  # a late period is left out
    assert np.array_equal(run.reference, rows[0][row])
    assert np.array_equal(run.reference_acceleration, rows[2][row])


@pytest.mark.slow
def test_a_campaign_follows_it_and_comes_back(
    design: fl.Design, unknown: ShapedMove
) -> None:
    law = design.law()
    asked = Campaign.of(RIG, design.model, law, runs=60, reference=unknown.reference)
    found = fl.trials.simulate_part(asked, 0)
    assert found["passed"].all() and found["settling_time"].max() < 0.65
    assert np.all(found["amplitude"] == 1.0)
    run = fl.trials.replay_run(asked, 17)
    assert run.metrics.settling_time == found["settling_time"][17]
    assert np.array_equal(
        run.reference[:160], unknown.reference.angle(0.004 * np.arange(160))
    )
    with pytest.raises(FieldError, match="reference"):
        replace(asked, reference=fl.smooth_step(1.0, 3.5))


_PROGRAM = """
#include <stdio.h>
#include "law.c"
#include "law_data.h"
#include "move.h"
int main(void) {
    law_state state;
    law_input in = {0};
    law_output out = {0};
    (void)law_init(&state, &law_data);
    for (uint32_t k = 0; k < MOVE_LENGTH + 50U; k++) {
        const uint32_t row = (k < MOVE_LENGTH) ? k : MOVE_LENGTH - 1U;
        in.tick = k + 1U;
        in.reference = move_angle[row];
        in.reference_acceleration = (k < MOVE_LENGTH) ? move_acceleration[k] : (law_real)0;
        in.motor_angle = out.motor_reference;
        law_step(&state, &law_data, &in, &out);
        printf("%a %a\\n", (double)out.motor_reference, (double)out.voltage);
    }
    return 0;
}
"""


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["single", "double"])
def test_the_board_takes_it_as_an_array(
    design: fl.Design, known: ShapedMove, tmp_path: Path, precision: str
) -> None:
    law = design.law().in_precision(precision)
    fl.export_c(law, tmp_path)
    fl.extend.export_reference(known.reference, tmp_path / "move.h", period=law.period)
    (tmp_path / "main.c").write_text(_PROGRAM)
    flags = ["-std=c99", "-Wall", "-Werror", "-ffp-contract=off"] + ["-DLAW_SINGLE"] * (
        precision == "single"
    )
    subprocess.run(  # noqa: S603
        [tool("gcc"), *flags, "main.c", "-o", "main"], cwd=tmp_path, check=True
    )
    text = subprocess.run(  # noqa: S603
        [tmp_path / "main"], capture_output=True, text=True, check=True
    ).stdout
    told = np.array(
        [[float.fromhex(x) for x in line.split()] for line in text.splitlines()]
    )
    assert np.array_equal(told, _stepped(law, known.reference, len(told)))


def _stepped(law: fl.Law, reference: fl.Reference, count: int) -> NDArray[np.float64]:
    state, rows, at = law.initial_state(), [], 0.0
    time = law.period * np.arange(count)
    angle, acceleration = reference.angle(time), reference.acceleration(time)
    for k in range(count):
        state, out = law.step(
            state, LawInputs(angle[k], acceleration[k], at, 0.0, 0.0), tick=k + 1
        )
        at = out.motor_reference
        rows.append([out.motor_reference, out.voltage])
    return np.array(rows)


@pytest.mark.parametrize("name", ["move.txt", "int.h"])
def test_a_table_needs_a_name_that_c_or_csv_takes(tmp_path: Path, name: str) -> None:
    with pytest.raises(FieldError, match="out"):
        fl.extend.export_reference(
            fl.extend.hold(0.0, 1.0), tmp_path / name, period=0.004
        )


@pytest.mark.slow
def test_the_command_line_shapes_and_moves(
    design: fl.Design,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    design.save("design.json")
    shaping = ["shape", "design.json", "--payload", "0.03", "--told"]
    assert main([*shaping, "--over", "model", "--table", "move.h"]) == 0
    assert "settles within 0.2" in capsys.readouterr().out
    move = ["--reference", "move.json", "--json"]
    assert (
        main(["simulate", "design.json", "--payload", "0.03", "--told", "0.03", *move])
        == 0
    )
    # the model has no link mass
    assert json.loads(capsys.readouterr().out)["metrics"]["settling_time"] < 0.5
    assert (
        main(
            [
                *("simulate", "design.json", "--on", "twin"),
                *("--payload", "0.03", "--told", "0.03", *move),
            ]
        )
        == 0
    )
    assert json.loads(capsys.readouterr().out)["metrics"]["settling_time"] < 0.35
    assert main([*shaping, "--settle", "0.1", "--force"]) == 2
    assert "does not settle within 0.1 s" in capsys.readouterr().err
    assert main([*shaping, "--payloads", "0.02", "0.04", "--force"]) == 2
    assert "payload" in capsys.readouterr().err


@pytest.mark.slow
def test_the_command_line_shapes_for_an_estimate(
    design: fl.Design,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    design.save("design.json")
    shaping = ["shape", "design.json", "--payload", "0.03", "--estimate"]
    assert main([*shaping, "--over", "model"]) == 0
    wanted = fl.shape(
        design, 1.0, payloads=(0.03, 0.03), told="estimated", over="model"
    )
    assert fl.load("move.json") == wanted
    said = capsys.readouterr().out
    assert "payload estimated" in said
    assert main([*shaping, "--told", "--force"]) == 2
    assert "told: given beside --estimate" in capsys.readouterr().err
