"""Shaped moves: what the linear loop promises is what the arm does, and every limit is
kept.
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
from scipy.optimize import linprog

import fraclink as fl
from fraclink import Callback, Twin, main
from fraclink._arm.reference import sampled
from fraclink._simulate import shaped_move as move
from fraclink._simulate.shape_programme import (
    SIGNALS,
    MoveBounds,
    Programme,
    ShapedArm,
    responses_of,
    without_friction,
)
from fraclink.errors import FieldError, FileFormatError
from fraclink.extend import LawInputs, ShapedMove
from fraclink.lab._machine import VirtualClock
from fraclink.trials import Campaign
from fraclink.trials._campaign import load_campaign, save_campaign
from fraclink.view._runs import shaped_figure
from fraclink.view._tunings import shaped_view
from needed_tools import tool

RIG = fl.Rig.named("paper-2023-geared")
KNOWN = (0.030, 0.030)


@pytest.fixture(scope="module")
def design() -> fl.Design:
    return fl.design(
        RIG.model,
        RIG,
        payloads=(0.020, 0.040),
        gain_crossover=12.0,
        phase_margin=fl.deg(50),
        filter_time=0.02,
    ).with_law()


@pytest.fixture(scope="module")
def unknown(design: fl.Design) -> ShapedMove:
    return fl.shape(design, 1.0, voltage=8.0, gauge_offset=0.05, seeds=1)


@pytest.fixture(scope="module")
def known(design: fl.Design) -> ShapedMove:
    return fl.shape(design, 1.0, payloads=KNOWN, told=True, gauge_offset=0.05, seeds=2)


# ─────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.slow
@pytest.mark.parametrize("told", [False, True])
@pytest.mark.parametrize("on", ["twin", "model"])
def test_the_responses_predict_every_signal_of_a_run(
    design: fl.Design, told: bool, on: str
) -> None:
    arm = ShapedArm(RIG, design.model, Twin.from_rig(RIG) if on == "twin" else None)
    free, plain = without_friction(design.law(), arm.with_exact_sensors())
    move = fl.smooth_step(0.4, 0.3, 0.05)
    run = plain.run(free, move, 0.033, 1.0, told=told)
    loops = responses_of(design.law(), arm, (0.033,), 1.2, told=told)
    (found,) = loops.to(move)
    rows = dict(zip(SIGNALS, found[:, : len(run.time)], strict=True))
    np.testing.assert_allclose(rows["tip"], run.tip_angle, atol=1e-8)
    np.testing.assert_allclose(rows["voltage"], run.voltage, atol=1e-5)
    np.testing.assert_allclose(rows["torque"], run.torque, atol=1e-7)
    speed = run.extras.get(
        "motor_velocity", np.diff(run.motor_angle, prepend=0.0) / run.period
    )
    np.testing.assert_allclose(rows["motor_speed"], speed, atol=1e-5)
    np.testing.assert_allclose(
        np.cumsum(rows["motor_step"]), run.motor_reference, atol=1e-8
    )


@pytest.mark.slow
def test_the_programme_of_some_rows_has_the_optimum_of_all(design: fl.Design) -> None:
    arm = ShapedArm(RIG, design.model, Twin.from_rig(RIG))
    loops = responses_of(design.law(), arm, (0.020, 0.040), 2.5, told=False)
    bounds = MoveBounds(
        {"voltage": 5.0, "torque": 1.0}, velocity=6.0, acceleration=60.0
    )
    programme = Programme(loops, 6, bounds)
    target, count = np.ones(programme.length), programme.count_for(0.5)
    found = programme.solve(count, target, 125, 400)
    rows, sides = programme._kept(count, target, 125, 400)
    ends = np.append(np.ones(count), 0.0)[None, :]
    free = [(None, None)] * count + [(0.0, None)]
    every = linprog(np.append(np.zeros(count), 1.0), rows, sides, ends, [1.0], free)
    assert found is not None and found.distance == pytest.approx(every.fun, abs=2e-4)
    # of all that are as near, the gentlest: no farther, and its acceleration varies
    # less
    gentle = programme.solve(count, target, 125, 400, within=1.2 * found.distance)
    assert gentle is not None and gentle.distance <= 1.2 * found.distance + 1e-4
    varied = [
        np.abs(programme._jerk(count)[:, :-1] @ s.coefficients).sum()
        for s in (gentle, found)
    ]
    assert varied[0] < 0.8 * varied[1]
    assert (
        programme.solve(3, target, 125, 400) is None
    )  # three knots for 1 rad: beyond every limit


# ────────────────────────────────────────────────────────────────────────────────


@pytest.mark.slow
def test_one_reference_moves_every_payload_as_promised(unknown: ShapedMove) -> None:
    (ours,) = unknown.measured
    assert unknown.passed and unknown.findings == ()
    assert ours.settling_time <= 0.62 and ours.settling_time <= ours.predicted + 0.004
    assert ours.peak_voltage <= 8.0 and ours.limited == 0.0
    assert unknown.amplitude == pytest.approx(1.0, abs=1e-9)
    assert unknown.shown.tolist() == pytest.approx([0.020, math.sqrt(0.0008), 0.040])


@pytest.mark.slow
def test_a_known_payload_moves_twice_as_fast(known: ShapedMove) -> None:
    assert known.passed and known.settling_time <= 0.35
    assert [each.name for each in known.measured] == ["shaped"]


@pytest.mark.slow
def test_a_move_for_the_identified_model_suits_that_model(design: fl.Design) -> None:
    """An arm that is 15 % slower than stiffness and length say, as identified, with a
    second mode.
    """
    slow = replace(
        design.model,
        natural_frequency=0.85 * design.model.natural_frequency,
        second_mode=fl.SecondMode(frequency=180.0, damping_ratio=0.02, gain=0.1),
    )
    made = fl.design(
        slow,
        RIG,
        payloads=(0.020, 0.040),
        gain_crossover=10.0,
        phase_margin=fl.deg(45),
        filter_time=0.02,
    )
    fitting = fl.shape(made, 1.0, payloads=KNOWN, told=True, on="model", seeds=2)
    assert fitting.passed and fitting.settling_time < 0.45
    of_twin = fl.shape(made, 1.0, payloads=KNOWN, told=True, seeds=1)
    run = fl.simulate(made, of_twin.reference, payload=0.030, told=True)
    assert run.metrics.settling_time > fitting.settling_time + 0.1


@pytest.mark.slow
def test_moves_to_the_other_side_are_the_same(
    design: fl.Design, known: ShapedMove
) -> None:
    back = fl.shape(design, -1.0, payloads=KNOWN, told=True, seeds=1)
    assert back.amplitude == pytest.approx(-1.0) and back.passed
    assert back.settling_time == pytest.approx(known.settling_time, abs=0.009)


@pytest.mark.slow
def test_limits_of_speed_and_torque_cost_time(
    design: fl.Design, known: ShapedMove
) -> None:
    slow = fl.shape(design, 1.0, payloads=KNOWN, told=True, speed=3.0, seeds=1)
    run = fl.simulate(
        design, slow.reference, arm=Twin.from_rig(RIG, payload=0.030), told=True
    )
    assert np.abs(run.extras["motor_velocity"]).max() <= 3.0
    assert slow.settling_time > known.settling_time + 0.05
    soft = fl.shape(design, 1.0, payloads=KNOWN, told=True, torque=0.3, seeds=1)
    run = fl.simulate(
        design, soft.reference, arm=Twin.from_rig(RIG, payload=0.030), told=True
    )
    assert np.abs(run.torque).max() <= 0.3
    assert soft.settling_time > known.settling_time + 0.05


@pytest.mark.slow
def test_a_promise_that_noise_breaks_is_a_finding(
    design: fl.Design, monkeypatch: pytest.MonkeyPatch
) -> None:
    small = fl.shape(design, 0.01, payloads=KNOWN, told=True, seeds=1)
    assert [finding.code for finding in small.findings] == ["W501"] and not small.passed
    monkeypatch.setattr(move, "_NOISES", 0.0)  # nothing is left to noise
    tight = fl.shape(design, 1.0, payloads=KNOWN, told=True, voltage=6.0, seeds=2)
    assert [finding.code for finding in tight.findings] == ["W501"]


@pytest.mark.slow
def test_a_motor_that_sticks_where_the_rig_says_it_does_not(design: fl.Design) -> None:
    arm = Twin.from_rig(RIG)
    sticks = replace(arm, motor=replace(arm.motor, coulomb_torque=0.4))
    found = fl.shape(design, 1.0, payloads=KNOWN, told=True, arm=sticks, seeds=1)
    assert "W501" in {finding.code for finding in found.findings}
    assert not found.passed


@pytest.mark.slow
def test_what_cannot_be_shaped_is_refused(design: fl.Design) -> None:
    def refused(field: str, *move: object, **options: object) -> FieldError:
        with pytest.raises(FieldError) as caught:
            fl.shape(design, *move, **options)
        assert caught.value.field == field
        return caught.value

    refused("move", 0.0)
    refused("move", 20.0)
    refused("move", math.nan)
    refused("payloads", 1.0, payloads=(0.04, 0.02))
    refused("payloads", 1.0, payloads=(0.0, 0.02))
    refused("arm", 1.0, on="model", arm=Twin.from_rig(RIG))
    assert "V" in str(refused("voltage", 1.0, voltage=1.0, payloads=KNOWN))
    refused("move", fl.spline([0.0, 1.0], [0.1, 1.0]), payloads=KNOWN)
    refused("move", fl.smooth_step(1.0, 30.0), payloads=KNOWN)
    refused("reserve", 1.0, reserve=1.0)
    light = replace(design, rig=fl.Rig.named("paper-2023"))
    with pytest.raises(FieldError, match="not stable"):
        fl.shape(light, 1.0)


# ────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.slow
def test_the_tip_follows_a_path_much_nearer(design: fl.Design) -> None:
    wanted = fl.extend.SampledReference(
        0.004, sampled(fl.smooth_step(0.5, 0.5, 0.2), 0.004, 176)
    )
    found = fl.shape(design, wanted, payloads=KNOWN, told=True, seeds=1)
    ours, given = found.measured
    assert found.passed and ours.largest_error < 0.005
    assert given.largest_error > 0.04 and given.name == "as given"
    assert found.target is not None and float(
        found.target.angle(0.45)
    ) == pytest.approx(0.25, abs=1e-4)
    assert "mrad of the path" in shaped_view(found).headline
    assert shaped_figure(found).alone().startswith("<svg")


@pytest.mark.slow
def test_a_path_that_no_limit_allows_fails(design: fl.Design) -> None:
    found = fl.shape(
        design,
        fl.spline([0.0, 0.1, 0.3], [0.0, 1.0, 0.0]),
        payloads=KNOWN,
        seeds=1,
    )
    assert "W504" in [finding.code for finding in found.findings] and not found.passed


# ──────────────────────────────────────────────────────────────────────────────────


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
    assert isinstance(again, ShapedMove) and again.measured == unknown.measured
    assert np.array_equal(again.tip_angle, unknown.tip_angle) and again.target is None
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
    assert "settles in" in str(shaped_view(again)) and shaped_figure(
        again
    ).alone().startswith("<svg")
    assert repr(again).startswith("ShapedMove(") and "<svg" in again._repr_html_()  # type: ignore[attr-defined]


@pytest.mark.slow
def test_the_loop_in_real_time_takes_a_table(
    design: fl.Design, known: ShapedMove
) -> None:
    law = design.law()
    table = fl.extend.SampledReference(0.004, sampled(known.reference, 0.004, 100))
    board = Callback(read=lambda: (0.0, 0.0), write=lambda command: None)
    run = fl.lab.run_realtime(
        law,
        table,
        board,
        duration=0.3,
        priority=0,
        lock_memory=False,
        clock=VirtualClock(1),
    )
    expected = sampled(known.reference, 0.004, len(run.tick))
    assert np.array_equal(run.reference, expected[0])
    assert np.array_equal(run.reference_acceleration, expected[2])


@pytest.mark.slow
def test_a_campaign_follows_it_and_comes_back(
    design: fl.Design, unknown: ShapedMove, tmp_path: Path
) -> None:
    law = design.law()
    asked = Campaign.of(RIG, design.model, law, runs=60, reference=unknown.reference)
    found = fl.trials.simulate_part(asked, 0)
    assert found["passed"].all() and found["settling_time"].max() < 0.65
    assert np.all(found["amplitude"] == 1.0)
    save_campaign(asked, tmp_path)
    again = load_campaign(tmp_path)
    assert again.fingerprint == asked.fingerprint
    assert again.fingerprint != Campaign.of(RIG, design.model, law, runs=60).fingerprint
    run = fl.trials.replay_run(again, 17)
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
    angle, _, acceleration = sampled(reference, law.period, count).tolist()
    for k in range(count):
        state, out = law.step(
            state, LawInputs(angle[k], acceleration[k], at, 0.0, 0.0), tick=k + 1
        )
        at = out.motor_reference
        rows.append([out.motor_reference, out.voltage])
    return np.array(rows)


@pytest.mark.parametrize("name", ["move.txt", "int.h", "law_move.h"])
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
    assert (
        main(
            [
                "shape",
                "design.json",
                "--payload",
                "0.03",
                "--told",
                "--seeds",
                "1",
                "--table",
                "move.h",
            ]
        )
        == 0
    )
    assert "settles in 0.2" in capsys.readouterr().out
    move = ["--reference", "move.json", "--json"]
    assert (
        main(["simulate", "design.json", "--payload", "0.03", "--told", "0.03", *move])
        == 0
    )
    assert (
        json.loads(capsys.readouterr().out)["metrics"]["settling_time"] < 0.5
    )  # the model has no link mass
    assert (
        main(["twin", "design.json", "--payload", "0.03", "--told", "0.03", *move]) == 0
    )
    assert json.loads(capsys.readouterr().out)["metrics"]["settling_time"] < 0.35
    Path("path.csv").write_text("time_s,angle_rad\n0,0\n0.7,1\n")
    known = ["--payload", "0.03", "--told", "--seeds", "1"]
    assert main(
        [
            "shape",
            "design.json",
            "--follow",
            "path.csv",
            *known,
            "--out",
            "along.json",
            "--json",
        ]
    ) in (0, 1)
    assert json.loads(capsys.readouterr().out)["measured"][1]["name"] == "as given"
    assert (
        main(
            [
                "shape",
                "design.json",
                "--on",
                "model",
                "--model",
                "design.json",
                "--force",
            ]
        )
        == 2
    )
    assert (
        main(
            [
                "shape",
                "design.json",
                "--payload",
                "0.03",
                "--payloads",
                "0.02",
                "0.04",
                "--force",
            ]
        )
        == 2
    )
    assert "payload" in capsys.readouterr().err
