"""From a log to a design: each option reaches the call that it is for, in its unit.

The work itself is left out: in its place stands a function that keeps what it was
called with.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fraclink as fl
from command_line import RIG, Found, Line, made_design, prepared
from fraclink._reading.reading import bundled_log


@pytest.fixture
def line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Line:
    """The command line in a folder with a design and a log."""
    return prepared(monkeypatch, capsys, tmp_path)


# --- models and logs -------------------------------------------------------------------------------------


READ = ("--payload", "0.04", "--keep", "1", "9", "--resample", "--interpolate")


def test_a_log_is_read_as_the_options_say(line: Line) -> None:
    log = fl.read_log(bundled_log("prbs_30g"), rig=RIG)
    for verb in ("diagnose log.csv", "identify log.csv", "compare-structures log.csv"):
        read = line.hear("models.load_log", log)
        line.hear("models.examine", ())
        for name in ("identify", "compare_structures"):
            line.hear(f"models.identification.{name}", Found())
        line(f"{verb} --rig paper-2023 --column motor_angle=a", *READ)
        assert read.given[0] == "log.csv" and read.given[1].name == "paper-2023"
        asked = {
            "payload": 0.04,
            "keep": (1.0, 9.0),
            "resample": True,
            "interpolate": True,
        }
        assert read.last == asked | {"column": ["motor_angle=a"]}, verb


def test_an_experiment_is_planned_for_the_motor_and_the_limit(line: Line) -> None:
    planned = line.hear("models.identification.design_experiment", Found())
    asked = "--standard-error 0.002 --noise 0.03 --duration 12 --deflection-limit 0.4 --kind multisine"
    assert line(f"plan-experiment --rig paper-2023 {asked}").code == 0
    assert planned.given == (RIG.model,)
    assert planned.last == {
        "standard_error": 0.002,
        "noise": 0.03,
        "period": RIG.period,
        "duration": 12.0,
        "kind": "multisine",
        "motor": RIG.motor,
        "deflection_limit": 0.4,
    }
    line("plan-experiment --rig paper-2023 --standard-error 0.002 --noise 0.03")
    assert planned.last["deflection_limit"] == math.inf


# --- recordings ------------------------------------------------------------------------------------------


def test_the_motor_takes_the_links_torque_or_its_own_inertia(line: Line) -> None:
    angle = np.linspace(0.0, 1.0, 50)
    log = fl.Experiment(
        period=0.004, motor_angle=angle, output=2 * angle, voltage=3 * angle
    )
    fit = line.hear("recordings.identification.identify_motor", Found())
    for given, torque, inertia in (
        (log, log.output, None),
        (
            replace(log, output=angle.copy(), output_kind="deflection"),
            None,
            RIG.motor.inertia,
        ),
        (replace(log, output_kind="deflection"), RIG.link.stiffness * log.output, None),
    ):
        read = line.hear("recordings.read_log", given)
        assert line("identify-motor log.csv --rig paper-2023").code == 0
        assert read.given == (Path("log.csv"),) and read.last == {"columns": RIG.log}
        assert np.array_equal(fit.given[0], log.voltage) and np.array_equal(
            fit.given[1], angle
        )
        assert fit.last["period"] == 0.004 and fit.last["inertia"] == inertia
        assert (
            fit.last["torque"] is None
            if torque is None
            else np.array_equal(fit.last["torque"], torque)
        )
    told = line(
        "identify-motor log.csv",
        "--column",
        "motor_angle=t [rad]",
        "--column",
        "voltage=u [V]",
        "--column",
        "time=s [s]",
    )
    assert (told.code, "with a deflection only" in told.err) == (2, True)


# --- designs ---------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_design_is_asked_for_in_radians_and_names_the_next_step(line: Line) -> None:
    made = made_design()
    asked = line.hear("designs.design_for", (made, ("the payloads are the rig's",)))
    words = "design --rig paper-2023 --link-mass 0.01 --payloads 0.01 0.05 --gain-crossover 9 --box"
    more = "--phase-margin-deg 45 --filter-time 0.01 --mode-gain 0.5 --margins ideal --filter-order 2"
    rest = "--inner sampled --placement direct --max-sensitivity 1.7 --noise-gain 3 --settling-time 0.6"
    told = line(f"{words} {more} {rest} --out d.json")
    rig, model = asked.given
    assert rig.link.mass == 0.01 and model is None
    assert asked.last == {
        "payloads": (0.01, 0.05), "gain_crossover": 9.0, "phase_margin": math.radians(45.0),
        "filter_time": 0.01, "mode_gain": 0.5, "margins": "ideal", "filter_order": 2,
        "inner": "sampled", "placement": "direct",
        "max_sensitivity": 1.7, "noise_gain": 3.0, "settling_time": 0.6, "box": True,
    }  # fmt: skip
    assert told.err == (
        "assumed: the payloads are the rig's\nwritten: d.json\n"
        "next: fraclink simulate d.json --payload 0.02\n"
    )
    line("design --rig paper-2023 --force --out d.json")
    usual = {"margins": "loop", "inner": "ideal", "placement": "tustin", "box": False}
    assert {
        name: value for name, value in asked.last.items() if value is not None
    } == usual


def test_a_gear_is_refused_by_the_name_of_its_option(line: Line) -> None:
    for ratio in ("0", "-50"):
        told = line(f"twin design.json --gear {ratio}")
        assert told.code == 2 and told.err.startswith("error: gear: out of range"), (
            told.err
        )


def test_a_proof_is_kept_only_where_it_passed(line: Line) -> None:
    proof = Found()
    proved = line.hear("designs.prove", proof)
    told = line(
        "certify design.json --modulus-margin 0.3 --others design.json --out c.json"
    )
    assert told == (
        0,
        "",
        "written: c.json\nnext: fraclink export c design.json --out firmware\n",
    )
    assert proved.given == (made_design(),) and proved.last["modulus_margin"] == 0.3
    assert list(proved.last["others"]) == [made_design().model] and proof.saved == [
        Path("c.json")
    ]
    proof.passed = False
    told = line("certify design.json --out d.json --json")
    assert (told.code, json.loads(told.out)) == (1, {"out": None}) and len(
        proof.saved
    ) == 1
    assert (
        line("certify design.json --out d.json").err
        == "next: fraclink assess design.json\n"
    )
    assert list(proved.last["others"]) == []


# --- assessments -----------------------------------------------------------------------------------------


def test_a_pid_is_tuned_for_a_formula_or_a_fit(line: Line) -> None:
    made = Found()
    made.period, made.output_limit, made.measurement_limit = 0.002, 10.0, None  # type: ignore[attr-defined]
    asked = line.hear("assessments.pid_for", made)
    plant = "1/(0.4*s**1.5 + 1)"
    words = "--phase-margin-deg 50 --period-ms 2 --gain-crossover 2 --gain-margin 3 --max-sensitivity 1.8"
    more = "--no-flat-phase --form PI --integral-order 0.9 --derivative-order 0.8 --filter-time 0.01"
    last = "--horizon 20 --output-limit 10 --measurement-limit 5 --out p.json"
    told = line("tune-pid", plant, *f"{words} {more} {last}".split())
    assert (
        told.code == 0 and abs(asked.given[0](2j) - 1 / (0.4 * (2j) ** 1.5 + 1)) < 1e-12
    )
    assert asked.last == {
        "phase_margin": math.radians(50.0), "period": 0.002, "gain_crossover": 2.0, "gain_margin": 3.0,
        "max_sensitivity": 1.8, "flat_phase": False, "form": "PI", "integral_order": 0.9,
        "derivative_order": 0.8, "filter_time": 0.01, "horizon": 20.0, "output_limit": 10.0,
        "measurement_limit": 5.0,
    }  # fmt: skip
    ends = "fraclink export c p.json --out firmware\n"
    assert told.err.endswith(f"next: the same with --measurement-limit, then {ends}")
    made.measurement_limit = 5.0  # type: ignore[attr-defined]
    assert line("tune-pid", plant, "--out", "p.json", "--force").err.endswith(
        f"next: {ends}"
    )
    assert (
        asked.last["period"] is None
        and asked.last["flat_phase"] is True
        and asked.last["form"] == "PID"
    )
    told = line("tune-pid", "k/(s + b)", "--force")
    assert (
        told.code == 2
        and "plant: unknown (got " in told.err
        and "k" in told.err
        and "b" in told.err
    )
