"""From a log to a design: each option reaches the call that it is for, in its unit.

The work itself is left out: in its place stands a function that keeps what it was
called with.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import fraclink as fl
from command_line import RIG, Found, Line, made_design, prepared
from fraclink._cli.models import AT_REST, _excitation
from fraclink._reading.reading import bundled_log
from fraclink.findings import Finding


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


def test_what_is_wrong_with_a_log_is_told_beside_its_fit(line: Line) -> None:
    log = fl.read_log(bundled_log("prbs_30g"), rig=RIG)
    bad = Finding("W201", "error", "reversed", {}, "turn it")
    for findings, code in (
        ((), 0),
        ((bad,), 1),
        ((replace(bad, severity="warning"),), 0),
    ):
        line.hear("models.load_log", log)
        line.hear("models.examine", findings)
        fit = line.hear("models.identification.identify", found := Found())
        line.patch.setattr("fraclink._cli.models.doubts_of", lambda *_: ())
        found.model = RIG.model  # type: ignore[attr-defined]
        told = line(
            "identify log.csv --rig paper-2023 --structure D-FOM --heldout 0.3 --force --out m.json"
        )
        assert told.code == code and found.saved == [Path("m.json")]
        assert told.err.endswith(
            "next: fraclink design --rig paper-2023 --model m.json\n"
        )
        assert fit.given == (log, "D-FOM")
        assert fit.last == {
            "heldout": 0.3,
            "stiffness": None,
        }  # a torque shows the stiffness
        found.model = replace(RIG.model, payload=None)  # type: ignore[attr-defined]
        told = line("identify log.csv --rig paper-2023 --force --out m.json")
        missing = "repeat with --force and --payload, the log's payload [kg]: `design` needs it"
        assert told.err.endswith(f"next: {missing}\n")
        code_of = line("diagnose log.csv --rig paper-2023 --payload 0.04")
        assert code_of.code == code
        next_one = "next: fraclink identify log.csv --rig paper-2023 --payload 0.04\n"
        assert code_of.err == ("" if code else next_one)
    bent = replace(log, output_kind="deflection")
    line.hear("models.load_log", bent)
    line.hear("models.examine", ())
    compared = line.hear("models.identification.compare_structures", Found())
    line("compare-structures log.csv --rig paper-2023 --heldout 0.2")
    assert compared.last == {"heldout": 0.2, "stiffness": RIG.link.stiffness}


def test_several_payloads_are_read_in_their_order(line: Line) -> None:
    read = line.hear("models.load_log", "a log")
    test = SimpleNamespace(common=True)
    fit = line.hear(
        "models.identification.identify_payloads", SimpleNamespace(test=test)
    )
    words = "identify-payloads a.csv b.csv --rig paper-2023 --payload 0.02 --payload 0.04 --structure D-IOM"
    assert line(f"{words} --tied --column torque=x").code == 0
    assert [given[0] for given, _ in read] == ["a.csv", "b.csv"]
    assert [given[3] for given, _ in read] == [0.02, 0.04] and read.given[2] == [
        "torque=x"
    ]
    assert fit.given == (["a log", "a log"], "D-IOM")
    assert fit.last == {"tied": True, "length": RIG.link.length}
    test.common = False
    assert line("identify-payloads a.csv b.csv --rig paper-2023").code == 1
    assert fit.last["tied"] is False and read.given[3] is None
    told = line("identify-payloads a.csv b.csv --rig paper-2023 --payload 0.02")
    assert (
        told.code == 2
        and "payload: not one for each log (got 1); expected 2 values" in told.err
    )


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


def test_excitations_begin_at_rest_and_have_the_size_that_was_asked_for() -> None:
    time = np.arange(0.0, 20.0, 0.01)
    for kind in ("prbs", "pulse", "chirp"):
        angle = _excitation(kind, 0.2, 20.0).angle(time)  # type: ignore[arg-type]
        assert np.abs(angle).max() == pytest.approx(0.2, rel=1e-3), kind
        if kind != "chirp":
            assert (
                not angle[time < AT_REST - 0.005].any()
                and angle[time > AT_REST + 0.3].any()
            )
    pulse = _excitation("pulse", 0.2, 10.0)
    up = time[np.abs(pulse.angle(time)) > 0.1]
    assert np.ptp(up) == pytest.approx(3.5, abs=0.5)  # 35 % of the log, and then rest
    bits = _excitation("prbs", 0.2, 20.0).angle(AT_REST + 0.24 * np.arange(81) + 0.2)
    assert set(np.round(bits, 9)) == {0.2, -0.2}
    # Registers of 9: no sequence of 9 bits comes twice within 511; one of 8 would begin
    # anew behind 255.
    assert np.all(bits[:9] == bits[0]) and bits[9] != bits[0]


def test_a_log_of_the_twin_has_the_length_and_the_noise_that_were_asked_for(
    line: Line,
) -> None:
    log = SimpleNamespace(header={}, save=lambda place: None)
    made = line.hear("models.simulate_log", log)
    words = "record --rig paper-2023 --payload 0.025 --link-mass 0.008 --amplitude 0.3 --duration 4"
    told = line(
        f"{words} --seed 7 --gauge-delay 0.002 --excitation pulse --out log2.csv"
    )
    assert told.code == 0
    count = round(4.0 / RIG.period) + 1
    assert told.err.splitlines()[0] == f"{count} samples, simulated"
    assert told.err.endswith("next: fraclink diagnose log2.csv --rig paper-2023\n")
    beam, _, reference = made.given
    assert (beam.payload, beam.link_mass) == (0.025, 0.008)
    assert reference.shape == (count,) and np.abs(reference).max() == pytest.approx(0.3)
    assert made.last["period"] == RIG.period and made.last["seed"] == 7
    assert made.last["servo_pole"] == RIG.motor_loop.pole
    assert made.last["sensors"].gauge_delay == pytest.approx(0.002)
    told = line(f"{words} --json --force")
    assert json.loads(told.out)["samples"] == count


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


def test_a_spectrum_names_the_frequencies_that_are_left_out(line: Line) -> None:
    measured = SimpleNamespace(
        frequency=np.array([1.0, 2.0, 3.0]), response="r", coherence="c"
    )
    line.hear("recordings.read_frequency_response", measured)
    found = SimpleNamespace(passed=True, outliers=(0, 2))
    fit = line.hear("recordings.identification.identify_frequency_response", found)
    told = line("identify-spectrum table.csv --resonances 2 --anti-resonances 1 --json")
    assert json.loads(told.out)["outliers"] == [1.0, 3.0]
    assert fit.given == (measured.frequency, "r")
    assert fit.last == {"coherence": "c", "resonances": 2, "anti_resonances": 1}
    assert line("identify-spectrum table.csv --resonances 7").code == 2


def test_a_driven_link_becomes_a_model_at_the_gears_output(line: Line) -> None:
    line.hear("recordings.read_frequency_response", "measured")
    asked: list[float] = []

    def model(inertia: float) -> str:
        asked.append(inertia)
        return "model"

    found = SimpleNamespace(passed=True, model=model)
    fit = line.hear("recordings.identification.identify_driven_link", found)
    saved = line.hear("recordings.identification.save_model")
    told = line(
        "identify-driven-link table.csv --rig paper-2023-geared --output torque --out m.json"
    )
    motor = fl.Rig.named("paper-2023-geared").motor
    assert asked == [motor.inertia * motor.gear_ratio**2]
    assert fit.given == ("measured",) and fit.last == {"output": "torque"}
    assert saved.given == ("model", Path("m.json"))
    assert (
        told.err
        == "written: m.json\nnext: fraclink design --rig paper-2023-geared --model m.json\n"
    )
    found.passed = False
    told = line("identify-driven-link table.csv --rig paper-2023 --out n.json")
    assert told.code == 1 and told.err == "" and len(saved) == 1


def test_a_structures_parameters_are_fixed_and_bounded_as_written(line: Line) -> None:
    line.hear("recordings.read_recording", recording := SimpleNamespace())
    read = line.hear("recordings.read_frequency_response", "response")
    fit = line.hear("recordings.identification.identify_structure", found := Found())
    words = ("--fix", "a = 1.5", "--bound", "k=-10,10", "--bound", "T=0,2")
    told = line(
        "identify-structure log.csv k/s --input u --output y --out s.json", *words
    )
    assert told.code == 0 and found.saved == [Path("s.json")]
    assert fit.given == (recording, "k/s")
    assert fit.last == {
        "fixed": {"a": 1.5},
        "bounds": {"k": (-10.0, 10.0), "T": (0.0, 2.0)},
    }
    line("identify-structure table.csv k/s --force")
    assert (
        read.given == (Path("table.csv"),)
        and fit.given[0] == "response"
        and fit.last == {"fixed": {}, "bounds": {}}
    )
    recorded = line.hear("recordings.read_recording", recording)
    line(
        "identify-structure log.csv k/s --input u --output y --time t --period-ms 2.5 --force"
    )
    assert recorded.given == (Path("log.csv"), "u", "y")
    assert recorded.last == {"time": "t", "period": 0.0025}
    for wrong, said in (
        (
            ("--fix", "a"),
            'fix: without a value (got a); expected NAME=VALUE. Write it as --fix "k=1"',
        ),
        (("--fix", "a=1,2"), "fix: not understood (got 1,2); expected a number."),
        (
            ("--bound", "a=1"),
            "bound: not understood (got 1); expected two numbers with a comma between them",
        ),
        (("--ring-down",), "input: given beside --ring-down (got u)"),
    ):
        told = line(
            "identify-structure log.csv k/s --input u --output y --force", *wrong
        )
        assert told.code == 2 and said in told.err
    for name, value in (("time", "t"), ("period-ms", "2"), ("ring-down", None)):
        told = line(
            f"identify-structure table.csv k/s --force --{name}"
            + (f" {value}" if value else "")
        )
        assert (
            told.code == 2
            and f"{name.replace('-', '_')}: given beside a frequency response"
            in told.err
        )


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


def test_a_study_reads_fits_and_designs_as_the_options_say(line: Line) -> None:
    arms = SimpleNamespace(failure=SimpleNamespace(count=0), failed=(17,))
    study = SimpleNamespace(
        law="a law", arms=None, verdict=SimpleNamespace(passed=True)
    )
    asked = line.hear("designs.run_study", study)
    written = line.hear("designs.write_report", Path("o/report.html"))
    read = line.hear("designs.load_log", "log")
    words = "run --rig paper-2023 --log log.csv --out o --structure D-FOM --heldout 0.3 --certify --arms 5"
    told = line(
        f"{words} --title T --no-script --box --phase-margin-deg 45 --keep 1 9 --payload 0.04 --force"
    )
    assert told.code == 0
    assert (
        told.err
        == "written: o/report.html\nnext: fraclink export c o/design.json --out firmware\n"
    )
    assert (
        read.given[0] == "log.csv"
        and read.last["keep"] == (1.0, 9.0)
        and read.last["payload"] == 0.04
    )
    assert asked.given[1] == "log"
    wanted = {
        "structure": "D-FOM",
        "heldout": 0.3,
        "certified": True,
        "arms": 5,
        "out": Path("o"),
        "box": True,
    }
    assert {name: asked.last[name] for name in wanted} == wanted
    assert asked.last["phase_margin"] == math.radians(45.0) and "keep" not in asked.last
    assert written.given == (study, Path("o/report.html")) and written.last == {
        "title": "T",
        "script": False,
    }
    study.law, study.verdict.passed = None, False
    told = line("run --rig paper-2023 --log log.csv --out o --force --json")
    assert (told.code, told.err, json.loads(told.out)["report"]) == (
        1,
        "",
        "o/report.html",
    )
    assert (asked.last["arms"], asked.last["certified"], written.last["script"]) == (
        1000,
        False,
        True,
    )
    study.arms = arms
    assert (
        line("run --rig paper-2023 --log log.csv --out o --force").err
        == "written: o/report.html\n"
    )
    arms.failure.count = 2
    told = line("run --rig paper-2023 --log log.csv --out o --force")
    assert told.err.endswith("next: fraclink campaign replay o/arms --run 17\n")
    opened = line.hear("command.webbrowser.open", True)
    line("run --rig paper-2023 --log log.csv --out o --force")
    assert not opened
    line("run --rig paper-2023 --log log.csv --out o --force --open")
    assert opened.given[0].endswith("o/report.html")


def test_a_move_is_simulated_as_the_options_say(line: Line) -> None:
    move = Found()
    move.verdict = SimpleNamespace(passed=True)  # type: ignore[attr-defined]
    asked = line.hear("designs.simulate_move", move)
    words = "simulate design.json --payload 0.08 --told 0.07 --amplitude 2 --duration 3 --gauge-offset 0.1"
    told = line(f"{words} --noise 0.02 --inner ideal --seed 4 --out r.npz")
    made, payload = asked.given
    assert made == made_design() and payload == 0.08
    reference = asked.last.pop("reference")
    assert (reference.duration, float(reference.angle(np.array([9.0]))[0])) == (
        0.5,
        2.0,
    )
    assert asked.last == {
        "told": 0.07, "duration": 3.0, "gauge_offset": 0.1, "noise": 0.02, "inner": "ideal", "seed": 4,
    }  # fmt: skip
    assert (
        told.err == "written: r.npz\nnext: fraclink twin design.json --payload 0.08\n"
        and told.code == 0
    )
    line("simulate design.json --payload 0.03 --force")
    assert (asked.last["duration"], asked.last["inner"], asked.last["seed"]) == (
        4.0,
        "sampled",
        0,
    )
    assert (
        line("simulate design.json --payload 30 --force").code == 1
    )  # a payload in grams
    ran = line.hear("designs.run_law", move)
    told = line(
        "twin design.json --told 0.03 --seed 3 --move-time 0.8 --payload 0.03 --link-mass 0.007"
    )
    assert (
        ran.given[0].digest == made_design().law().digest
        and ran.given[1].duration == 0.8
    )
    assert (ran.last["told"], ran.last["seed"], ran.last["arm"].beam.link_mass) == (
        0.03,
        3,
        0.007,
    )
    assert told.err == "next: fraclink certify design.json\n"
    move.verdict.passed = False  # type: ignore[attr-defined]
    told = line("twin design.json")
    assert (told.code, told.err) == (1, "next: fraclink assess design.json\n")
    assert line("twin design.json --payload 30").code == 1


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


@pytest.mark.parametrize(
    ("verb", "writer"), [("report", "write_report"), ("share", "write_arm_page")]
)
def test_a_folder_becomes_a_page(line: Line, verb: str, writer: str) -> None:
    study = SimpleNamespace(verdict=SimpleNamespace(passed=False))
    loaded = line.hear("designs.load_study", study)
    written = line.hear(f"designs.{writer}")
    opened = line.hear("command.webbrowser.open", True)
    told = line(f"{verb} results --title T")
    usual = Path("results/report.html" if verb == "report" else "arm.html")
    assert (
        told == (0, f"{usual}\n", "")
        and loaded.given == (Path("results"),)
        and not opened
    )
    assert written.given == (study, usual) and written.last["title"] == "T"
    assert verb == "share" or written.last["script"] is True
    told = line(f"{verb} results --out p.html --open --json")
    assert json.loads(told.out) == {"out": "p.html", "passed": False}
    assert opened.given[0].endswith("/p.html")
    Path("p.html").touch()
    assert line(f"{verb} results --out p.html").code == 2
    assert line(f"{verb} results --out p.html --force").code == 0


# --- assessments -----------------------------------------------------------------------------------------


def test_an_optimisation_is_bounded_as_asked(line: Line) -> None:
    @dataclass
    class Better:
        design: Any

    design = Found()
    design.with_law = lambda: design  # type: ignore[attr-defined]
    asked = line.hear("assessments.better", Better(design))
    words = "optimise design.json --goal crossover --max-sensitivity 1.5 --gain-crossover 9 --noise-gain 2"
    told = line(f"{words} --mode-gain 0.4 --least-percent 5 --out o.json")
    assert told == (0, "", "written: o.json\nnext: fraclink assess o.json\n")
    assert asked.given == (made_design(),) and design.saved == [Path("o.json")]
    bounds = {
        "max_sensitivity": 1.5,
        "gain_crossover": 9.0,
        "noise_gain": 2.0,
        "mode_gain": 0.4,
    }
    assert asked.last == bounds | {"goal": "crossover", "least": 0.05}
    line("optimise design.json --out p.json")
    assert asked.last["goal"] == "noise" and asked.last["least"] == pytest.approx(0.02)
    design.passed = False
    assert line("optimise design.json --out q.json").code == 1


def test_rivals_are_tuned_as_asked_and_written(line: Line) -> None:
    class Result(Found):
        standings = (SimpleNamespace(passed=False),)

        def markdown(self) -> str:
            return "a table"

        def draw(self, place: Path) -> None:
            self.saved.append(place)

    result = Result()
    asked = line.hear("assessments.run_rivals", result)
    words = "compare --rig paper-2023 --only ZV --only PD --link-mass 0.01 --gain-crossover 11"
    told = line(
        f"{words} --phase-margin-deg 40 --filter-time 0.02 --seed 3 --out c --model design.json --json"
    )
    assert (told.code, json.loads(told.out)["out"]) == (1, "c")
    asked.last.pop("progress")
    assert asked.last == {
        "model": made_design().model, "link_mass": 0.01, "gain_crossover": 11.0, "seed": 3,
        "phase_margin": math.radians(40.0), "filter_time": 0.02, "names": ["ZV", "PD"],
    }  # fmt: skip
    assert result.saved == [Path("c/comparison.json"), Path("c/comparison.svg")]
    assert Path("c/comparison.md").read_text() == "a table"
    result.standings = (SimpleNamespace(passed=True),)
    assert line("compare --rig paper-2023 --out d").code == 0
    assert asked.last["names"] is None


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
