"""Gates between a rig and what is used with it: payloads, models, logs. Each message
contains both numbers.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fraclink as fl
from fraclink import Design, LinkModel, bundled_log, main, read_log
from fraclink._arm.draft import doubts_of
from fraclink.errors import InfeasibleError
from fraclink.extend import simulated_torque
from fraclink.trials import Study, run
from identify_cases import PERIOD, TRUTH

RIG = fl.Rig.named("paper-2023")
LINK = replace(TRUTH, payload=0.030)
ASK: dict[str, Any] = {
    "gain_crossover": 12.0,
    "phase_margin": fl.deg(50),
    "filter_time": 0.0,
}
DEGREES = replace(LINK, stiffness=np.rad2deg(1e-3) / 1e-3 * LINK.stiffness)
OTHER = LinkModel(4.8, 29.0, damping=1.2, payload=0.030)


@pytest.mark.parametrize(
    ("model", "payloads", "numbers"),
    [
        (LINK, (20.0, 40.0), ("W105", "20 kg", "500 times")),
        (replace(LINK, payload=50.0), (), ("W105", "50 kg", "1.25e+03 times")),
        (
            replace(LINK, payload=30e-6),
            (),
            ("W105", "3e-05 kg", "0.0015 times the lightest"),
        ),
        (DEGREES, (), ("W106", "89.38", "1.56", "degrees")),
        (replace(LINK, stiffness=1560.0), (), ("W106", "1560", "1.56", "milli")),
        (OTHER, (), ("W106", "4.8", "1.56")),
        (replace(LINK, natural_frequency=41.0), (), ("W106", "47.86", "11.09")),
        (replace(LINK, natural_frequency=3.0), (), ("W106", "3.14", "11.09")),
    ],
)
def test_a_contradiction_is_an_error_with_both_numbers(
    model: LinkModel, payloads: tuple[float, ...], numbers: tuple[str, ...]
) -> None:
    errors = [str(finding) for finding in doubts_of(RIG, model, payloads)]
    assert any(all(number in error for number in numbers) for error in errors), errors


def test_arms_that_are_merely_imprecise_are_in_no_doubt() -> None:
    for stiffness in (0.8, 1.2, 1.56, 3.0):
        for factor in (0.65, 1.0, 1.6):
            model = replace(
                LINK,
                stiffness=stiffness,
                natural_frequency=factor * LINK.natural_frequency,
            )
            assert doubts_of(RIG, model, (0.010, 0.080)) == ()
    # With a heavy link in the rig file, the arm vibrates more slowly than with its
    # payload alone.
    heavy = replace(RIG, link=replace(RIG.link, mass=0.4))
    slow = replace(
        LINK,
        order=2.0,
        natural_frequency=11.09 * (0.030 / (0.030 + 33 / 140 * 0.4)) ** 0.5,
    )
    assert doubts_of(heavy, slow) == ()
    assert [finding.code for finding in doubts_of(RIG, slow)] == ["W106"]


def test_a_link_without_a_stiffness_of_its_own_is_judged_by_its_vibration() -> None:
    damped = replace(LINK, natural_frequency=0.0, damping=100.0, damping_order=0.05)
    assert doubts_of(RIG, damped) == ()
    (doubt,) = doubts_of(RIG, replace(damped, damping=1e4))
    assert doubt.code == "W106"
    assert doubt.evidence["model"] == pytest.approx(1e4 ** (1 / (LINK.order - 0.05)))


@pytest.mark.slow
def test_a_design_behind_a_contradiction_meets_its_requirements_and_does_not_pass() -> (
    None
):
    good, bad = (fl.design(model, RIG, **ASK) for model in (LINK, DEGREES))
    assert good.passed
    assert all(item.passed for item in bad.requirements)
    assert not bad.passed and "not shown" in str(bad)
    assert [finding.code for finding in bad.doubts] == ["W106"]


@pytest.mark.slow
def test_a_refusal_names_the_contradiction_behind_it_and_offers_nothing() -> None:
    """Whatever is asked for instead, no design passes while model and rig disagree."""
    heavy, stiff = replace(LINK, payload=50.0), replace(LINK, natural_frequency=60.0)
    with pytest.raises(InfeasibleError, match=r"50 kg is 1\.25e\+03 times") as weight:
        fl.design(heavy, RIG, **ASK | {"phase_margin": 2.4})
    with pytest.raises(InfeasibleError, match=r"71\.1\d* rad/s .* give 11\.0") as speed:
        fl.design(stiff, RIG, **ASK)
    for refused in (weight.value, speed.value):
        assert refused.condition == "contradiction" and not refused.nearest


@pytest.mark.slow
def test_a_design_of_a_fit_that_failed_a_gate_does_not_pass() -> None:
    angle = 0.3 * np.clip((PERIOD * np.arange(3000) - 0.5) / 0.2, 0, 1)
    torque = -simulated_torque(TRUTH, angle, PERIOD)
    fit = fl.identify(
        fl.Experiment(period=PERIOD, motor_angle=angle, output=torque, payload=0.030)
    )
    made = fl.design(fit, RIG, **ASK)
    assert [finding.code for finding in made.doubts] == ["W211"]
    assert not made.passed and "not shown" in str(made)


# --- the commands -----------------------------------------------------------------------------------------


def _written(path: Path, model: LinkModel) -> str:
    fl.save(model, path)
    return str(path)


@pytest.mark.slow
def test_a_model_of_another_arm_fails_the_command(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    model, out = _written(tmp_path / "model.json", DEGREES), tmp_path / "design.json"
    assert (
        main(["design", "--rig", "paper-2023", "--model", model, "--out", str(out)])
        == 1
    )
    printed = capsys.readouterr().out
    assert "not shown" in printed
    assert "W106" in printed
    assert not Design.load(out).passed
    assert main(["assess", str(out)]) == 1
    assert "not shown" in capsys.readouterr().out
    assert (
        main(
            [
                "simulate",
                str(out),
                "--payload",
                "0.03",
                "--out",
                str(tmp_path / "run.npz"),
            ]
        )
        == 1
    )


@pytest.mark.slow
def test_a_payload_in_grams_fails_the_command(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    design = tmp_path / "design.json"
    assert main(["design", "--rig", "paper-2023", "--out", str(design)]) == 0
    capsys.readouterr()
    code = main(
        [
            "simulate",
            str(design),
            "--payload",
            "50",
            "--out",
            str(tmp_path / "run.npz"),
            "--json",
        ]
    )
    assert code == 1
    assert json.loads(capsys.readouterr().out)["findings"][0]["code"] == "W105"
    arguments = ["--payload", "50", "--out", str(tmp_path / "model.json")]
    assert main(["identify", "demo", "--rig", "paper-2023", *arguments]) == 1
    assert "50 kg is 1.25e+03 times" in " ".join(capsys.readouterr().out.split())


@pytest.mark.slow
def test_a_log_against_its_header_is_shown_nothing(tmp_path: Path) -> None:
    text = bundled_log("prbs_30g").read_text("utf-8")
    path = tmp_path / "log.csv"
    path.write_text(text, "utf-8")
    stated = RIG.log or fl.LogColumns(
        fl.Channel("time_s", "s"),
        fl.Channel("motor_angle_rad", "rad"),
        torque=fl.Channel("torque_Nm", "Nm"),
    )
    wrong = replace(stated, motor_angle=replace(stated.motor_angle, unit="deg"))
    rig = replace(RIG, log=wrong)
    study = run(rig, read_log(path, rig=rig), arms=0)
    assert study.verdict.state in ("failed", "not shown")
    reasons = " ".join(study.verdict.reasons)
    assert "is in rad by the log's own header, in deg by [log]" in reasons
    assert "as if degrees were called radians" in reasons


@pytest.mark.slow
def test_a_study_of_a_design_behind_a_contradiction_is_not_shown() -> None:
    verdict = Study(rig=RIG, design=fl.design(DEGREES, RIG, **ASK)).verdict
    assert verdict.promise.state == "not shown"
    assert any(
        "89.38 N·m/rad, the rig's 1.56 N·m/rad" in reason for reason in verdict.reasons
    )
