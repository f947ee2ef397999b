"""The studio's answers read number by number: requests, states, messages, pictures,
files, and refusals.
"""

from __future__ import annotations

import asyncio
import json
import math
import socket
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from starlette.testclient import TestClient

import fraclink as fl
from fraclink.errors import (
    FieldError,
    FraclinkError,
    InfeasibleError,
)
from fraclink.findings import Finding
from fraclink.studio import _logs as logs
from fraclink.studio import _outputs as outputs
from fraclink.studio import _played as played
from fraclink.studio import _server as server
from fraclink.studio import _serving as serving
from fraclink.studio import _work as work
from fraclink.studio._copied import as_command, as_python, copies
from fraclink.studio._history import History
from fraclink.studio._messages import (
    Reply,
    checked_request,
    parsed,
    refusal,
    wanted_of,
)
from fraclink.studio._preview import Subject, nearest, preview
from fraclink.studio._protocol import LONGEST
from fraclink.studio._regions import (
    Region,
    checked_regions,
    fan_of,
    map_of,
    parted,
    round_regions,
)
from fraclink.studio._session import Session, opened
from fraclink.trials._faults import Case, Check, FaultTable, Outcome
from fraclink.view._text import number

ASKED = {"gain_crossover": 12.0, "phase_margin_deg": 50.0, "payloads": [0.02, 0.04]}
RIG = fl.Rig.named("paper-2023")


@pytest.fixture(scope="module")
def subject() -> Subject:
    assert RIG.model is not None
    return Subject(RIG, RIG.model)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Session:
    """A session with a design."""
    found = opened(None, rig=RIG, out=tmp_path_factory.mktemp("made") / "results")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(
            Session, "arm", lambda self, known="": {}
        )  # its engine takes a second to pack
        found.exact(ASKED)
    return found


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Session:
    """A session with a log and two fits of it."""
    found = opened(None, rig=RIG, out=tmp_path_factory.mktemp("fitted") / "results")
    logs.LOG_VERBS["log"](found, {"name": "pulse_30g"})
    logs.LOG_VERBS["columns"](found, {"columns": []})
    log = found.study.experiment
    comparison = fl.compare_structures(log, details=False)
    found.become(
        replace(found.study, comparison=comparison, fit=comparison.fits["UD-FOM"])
    )
    return found


# --- requests -------------------------------------------------------------------------------------------


def test_a_request_is_written_as_the_command_and_as_python() -> None:
    request = checked_request(
        {**ASKED, "filter_time": 0.005, "box": True, "margins": "ideal"}
    )
    assert as_command(
        request, "paper-2023", Path("m.json"), Path("d.json")
    ).split() == [
        "fraclink",
        "design",
        "--rig",
        "paper-2023",
        "--model",
        "m.json",
        *_words(request),
        "--out",
        "d.json",
    ]
    assert "--phase-margin-deg 50.0" in as_command(request, "r", None, Path("d"))
    assert "--payloads 0.02 0.04" in as_command(request, "r", None, Path("d"))
    assert as_command(request, "r", None, Path("d")).count("--box ") == 1
    assert "--model" not in as_command(request, "r", None, Path("d"))
    lines = as_python(request, "paper-2023", None).splitlines()
    assert lines[:5] == [
        "import fraclink as fl",
        "",
        "rig = fl.Rig.named('paper-2023')",
        "design = fl.design(",
        "    rig.model, rig,",
    ]
    assert lines[-3:] == [
        "    law=False,",
        ").with_law()",
        "law = fl.discretize(design)",
    ]
    assert {
        "    phase_margin=fl.deg(50.0),",
        "    payloads=(0.02, 0.04),",
        "    margins='ideal',",
    } <= set(lines)
    assert "    filter_time=0.005," in lines and "    box=True," in lines
    from_file = as_python(request, "r/rig.toml", Path("m.json")).splitlines()
    assert from_file[2:4] == [
        "rig = fl.Rig.load('r/rig.toml')",
        "fit = fl.load('m.json')",
    ]
    assert "    fit, rig," in from_file
    usual = checked_request({})
    assert as_command(usual, "r", None, Path("d")).split() == [
        "fraclink",
        "design",
        "--rig",
        "r",
        "--out",
        "d",
    ]
    assert (usual["margins"], usual["box"], usual["gain_crossover"]) == (
        "loop",
        False,
        None,
    )


def _words(request: dict[str, Any]) -> list[str]:
    """What `request` states, option by option in its order."""
    stated = {
        "payloads": ["--payloads", "0.02", "0.04"],
        "gain_crossover": ["--gain-crossover", "12.0"],
        "phase_margin_deg": ["--phase-margin-deg", "50.0"],
        "margins": ["--margins", "ideal"],
        "filter_time": ["--filter-time", "0.005"],
        "box": ["--box"],
    }
    return [word for name in request for word in stated.get(name, [])]


def test_a_request_is_asked_of_the_design_in_radians() -> None:
    wanted = wanted_of(checked_request(ASKED))
    assert (
        wanted["phase_margin"] == pytest.approx(math.radians(50.0))
        and "phase_margin_deg" not in wanted
    )
    assert wanted["box"] is False and wanted["payloads"] == (0.02, 0.04)
    assert wanted_of(checked_request({}))["phase_margin"] is None
    for given, field in (
        ([], "state"),
        ({"gain": 1}, "state"),
        ({"gain_crossover": -1}, "gain_crossover"),
    ):
        with pytest.raises(FieldError) as why:
            checked_request(given)
        assert why.value.field == field


# --- messages -------------------------------------------------------------------------------------------


def test_an_answer_is_its_head_padded_to_four_and_its_curves_behind() -> None:
    data = Reply({"ok": True}, {"a": [1.0, 2.0], "b": [[3.0], [4.0]]}).packed(7, "x")
    size = int.from_bytes(data[:4], "little")
    head = json.loads(data[4 : 4 + size])
    assert head == {
        "ok": True,
        "seq": 7,
        "verb": "x",
        "curves": {"a": [1, 2], "b": [2, 1]},
    }
    assert size % 4 == 0 and len(json.dumps(head, separators=(",", ":"))) + 3 >= size
    assert np.frombuffer(data[4 + size :], "<f4").tolist() == [1.0, 2.0, 3.0, 4.0]


def test_a_request_is_its_number_its_verb_and_the_rest() -> None:
    found = parsed('{"seq": 0, "verb": "go", "at": 3}')
    assert (found.seq, found.verb, found.given) == (0, "go", {"at": 3})
    assert parsed(json.dumps({"seq": 2**53 - 1, "verb": 40 * "v"})).seq == 2**53 - 1
    for wrong in (
        {"seq": 2**53, "verb": "go"},
        {"seq": 0, "verb": 41 * "v"},
        {"seq": 0.0, "verb": "go"},
    ):
        with pytest.raises(FieldError, match="not a request"):
            parsed(json.dumps(wrong))
    frame = '{"seq": 0, "verb": "go", "x": ""}'
    longest = frame.replace('""', '"' + (LONGEST - len(frame)) * "y" + '"')
    assert len(longest) == LONGEST == 16_384 and parsed(longest).verb == "go"
    with pytest.raises(FieldError, match="16385 characters"):
        parsed(longest + " ")


def test_a_refusal_has_the_parts_that_stand_beside_a_field() -> None:
    error = FieldError("payload", -1.0, "negative", allowed="> 0 kg", remedy="give kg")
    assert refusal(error).head == {
        "ok": False,
        "error": str(error),
        "field": "payload",
        "problem": "negative",
        "allowed": "> 0 kg",
        "remedy": "give kg",
    }
    assert refusal(FraclinkError("plain")).head == {"ok": False, "error": "plain"}
    assert RIG.model is not None
    with pytest.raises(InfeasibleError) as why:
        fl.design(RIG.model, RIG, gain_crossover=30.0, phase_margin=fl.deg(60))
    head = refusal(why.value).head
    assert (head["condition"], head["nearest"]) == (
        why.value.condition,
        why.value.nearest,
    )
    assert head["explanation"] == why.value.explanation


# --- what can be undone ---------------------------------------------------------------------------------


def test_a_history_is_a_line_for_every_state(tmp_path: Path) -> None:
    history = History.of(tmp_path)
    assert (history.state, history.at, history.path) == (
        None,
        -1,
        tmp_path / "studio.jsonl",
    )
    history.keep()  # nothing to keep yet
    assert not history.path.exists()
    for k in range(3):
        history.add({"k": k})
        history.add({"k": k})  # what stands already is not added again
    history.go(1)
    history.go(1)
    history.keep()
    history.keep()
    assert [json.loads(line) for line in history.path.read_text().splitlines()] == [
        {"at": 0, "state": {"k": 0}},
        {"at": 1, "state": {"k": 1}},
        {"at": 2, "state": {"k": 2}},
        {"at": 1},
        {"at": 1, "kept": True},
    ]
    for wrong in (-1, 3):
        with pytest.raises(FieldError, match="0 to 2"):
            history.go(wrong)
    assert (history.at, history.kept) == (1, {1})
    history.add({"k": 9})
    assert (history.states, history.at, history.kept) == (
        [{"k": 0}, {"k": 1}, {"k": 9}],
        2,
        {1},
    )


@pytest.mark.parametrize(
    ("line", "taken"),
    [
        ('{"at": 1, "state": {"k": 1}}', True),
        ('{"at": 7, "state": {"k": 1}}', True),  # behind the last: the last
        ('{"at": -1, "state": {"k": 1}}', False),
        ('{"at": true, "state": {"k": 1}}', False),
        ('{"at": 1.0, "state": {"k": 1}}', False),
        ('{"at": 1, "state": [1]}', False),
        ("[1]", False),
        ('{"at": 1, "state": {"k": 1}, "x": "' + 16_384 * "y" + '"}', False),
    ],
)
def test_what_is_no_line_of_a_history_ends_it(
    tmp_path: Path, line: str, taken: bool
) -> None:
    behind = '{"at": 2, "state": {"k": 2}}'
    (tmp_path / "studio.jsonl").write_text(
        f'{{"at": 0, "state": {{"k": 0}}}}\n{line}\n{behind}\n'
    )
    found = History.of(tmp_path)
    assert found.states == ([{"k": 0}, {"k": 1}, {"k": 2}] if taken else [{"k": 0}])
    assert found.at == (2 if taken else 0)


def test_a_history_from_elsewhere_is_read_up_to_ten_thousand_lines(
    tmp_path: Path,
) -> None:
    lines = (json.dumps({"at": 0, "state": {"k": k}}) for k in range(10_005))
    (tmp_path / "studio.jsonl").write_text("\n".join(lines) + "\n")
    assert History.of(tmp_path).state == {"k": 9999}


# --- regions, map and fan -------------------------------------------------------------------------------


def test_regions_are_taken_up_to_eight_of_finite_edges() -> None:
    one = {"plot": "nichols", "left": -200, "right": -160.5, "low": -6, "high": 6}
    assert checked_regions([one]) == (Region("nichols", -200.0, -160.5, -6.0, 6.0),)
    assert len(checked_regions(8 * [one])) == 8
    for wrong in (
        9 * [one],
        [{**one, "right": 1e6}],
        [{**one, "low": 6}],
        [{**one, "right": -200}],
        None,
    ):
        with pytest.raises(FieldError, match="no regions"):
            checked_regions(wrong)
    assert checked_regions([{**one, "right": 999_999}])[0].right == 999_999.0
    assert parted({"a": 1}) == ({"a": 1}, ()) and parted(5) == (5, ())
    assert parted({"a": 1, "regions": [one]}) == ({"a": 1}, checked_regions([one]))


def test_a_region_is_told_with_its_unit() -> None:
    assert (
        Region("nichols", -200.0, -160.0, -6.0, 6.5).said(True)
        == "✗ entered: −200 to −160 °, −6 to 6.5 dB"
    )


def test_a_region_is_entered_only_by_what_lies_inside() -> None:
    box, w = (
        Region("gain", 10.0, 100.0, 0.0, 20.0),
        np.array([1.0, 10.0, 100.0, 1000.0]),
    )
    none = np.zeros((1, 4))
    for gain, inside in (
        ([30.0, 30.0, -10.0, -10.0], True),  # through
        (
            [30.0, 20.0, 20.0, -10.0],
            False,
        ),  # along the upper edge and down the right one
        ([10.0, 30.0, 30.0, 10.0], False),  # beside it
        ([-10.0, -10.0, -10.0, 50.0], False),
        ([5.0, 5.0, 5.0, 5.0], True),
        ([-10.0, -10.0, 0.5, -10.0], True),
    ):
        assert box.entered(w, np.array([gain]), none) is inside, gain


@pytest.mark.slow
def test_the_map_spans_from_half_the_slowest_to_four_times_the_fastest_mode(
    subject: Subject,
) -> None:
    found = map_of(subject, {})
    power = 2.0 / subject.model.order
    crossovers, margins = np.asarray(found["crossovers"]), np.asarray(found["margins"])
    slow, fast = (
        subject.link_frequencies.min() ** power,
        subject.link_frequencies.max() ** power,
    )
    assert (crossovers[0], crossovers[-1], crossovers.size) == pytest.approx(
        (0.5 * slow, 4.0 * fast, 33)
    )
    assert (margins[0], margins[-1], margins.size) == (10.0, 100.0, 25)
    noise = np.asarray(found["noise"])
    assert (
        noise.shape == (25, 33)
        and (noise == -1.0).any()
        and (noise[noise > -1.0] > 0.0).all()
    )
    row, column = np.argwhere(noise > 0)[3]
    direct = fl.design(
        subject.model,
        RIG,
        payloads=(0.02, 0.04),
        gain_crossover=float(crossovers[column]),
        phase_margin=math.radians(float(margins[row])),
        filter_order=1,
        law=False,
    )
    assert noise[row, column] == pytest.approx(_noise_gain(direct), rel=1e-6)
    narrow = np.asarray(
        map_of(subject, {"payloads": [0.03, 0.03], "filter_order": 2})["noise"]
    )
    assert (narrow > 0).sum() > (noise > 0).sum()  # one payload is easier than a range


def _noise_gain(made: fl.Design) -> float:
    from fraclink._design.feasibility import feasibility_map

    assert RIG.model is not None
    cell = feasibility_map(
        RIG.model,
        RIG,
        gain_crossovers=(made.gain_crossover,),
        phase_margins=(made.phase_margin,),
        payloads=made.payloads,
        filter_order=1,
    )
    return float(cell.noise_gain[0, 0])


@pytest.mark.slow
def test_the_way_round_is_the_nearest_cell_in_round_figures(subject: Subject) -> None:
    wall = checked_regions(
        [{"plot": "gain", "left": 11.5, "right": 12.5, "low": -3.0, "high": 3.0}]
    )
    found = round_regions(subject, ASKED, wall)
    chart = map_of(subject, ASKED)
    near = np.abs(np.asarray(chart["crossovers"]) / found["gain_crossover"] - 1).min()
    assert (
        near < 0.005
        and np.abs(np.asarray(chart["margins"]) - found["phase_margin_deg"]).min()
        < 0.05
    )
    far = math.hypot(
        math.log2(found["gain_crossover"] / 12.0),
        (found["phase_margin_deg"] - 50.0) / 30.0,
    )
    assert far < 0.6 and found["payloads"] == (0.02, 0.04)
    assert found["gain_crossover"] == float(f"{found['gain_crossover']:.3g}")


@pytest.mark.slow
def test_the_fan_has_every_corner_of_the_box_up_to_sixteen(made: Session) -> None:
    from fraclink._arm.box import ParameterBox, arms_of

    design = made.study.design
    w = np.geomspace(1.0, 100.0, 40)
    found = fan_of(design, w)
    arms = arms_of(ParameterBox.of(design.model, design.rig), design.model)
    rows = 2 * min(16, len(arms))
    assert found["fan_gain"].shape == found["fan_phase"].shape == (rows, 10)
    first = arms[0].loop(design.controller, design.rig)
    value = first.log(
        w[::4],
        np.array([[design.natural_frequency(0.02)], [design.natural_frequency(0.04)]]),
    )
    assert found["fan_gain"][:2] == pytest.approx(20.0 / math.log(10.0) * value.real)
    assert found["fan_phase"][:2] == pytest.approx(np.degrees(value.imag))


# --- previews -------------------------------------------------------------------------------------------


def test_what_stands_still_while_a_hand_drags(subject: Subject) -> None:
    axes = subject.axes()
    assert axes["rated"] == [0.02, 0.03, 0.04]
    payloads, w = np.asarray(axes["payloads"]), np.asarray(axes["frequencies"])
    assert (payloads[0], payloads[-1], payloads.size) == pytest.approx(
        (0.008, 0.08, 49)
    )
    assert (w[-1], w.size) == pytest.approx((math.pi / 0.004, 280))
    links = [
        subject.model.at_payload(float(mass)).natural_frequency for mass in payloads
    ]
    assert subject.link_frequencies.tolist() == links
    slowest = min(links) ** (2 / 1.92)
    assert w[0] == pytest.approx(min(0.1 * slowest, 0.01 * math.pi / 0.004))


@pytest.mark.slow
def test_a_preview_has_the_loop_of_its_design_at_three_payloads(
    subject: Subject, made: Session
) -> None:
    answer = preview(subject, ASKED)
    design = made.study.design
    assert answer.head["three"] == (0.02, 0.03, 0.04) and answer.head["names"] == [
        "20 g",
        "30 g",
        "40 g",
    ]
    for row, payload in enumerate((0.02, 0.03, 0.04)):
        value = design.loop(subject.frequencies, design.natural_frequency(payload))
        assert answer.curves["gain"][row] == pytest.approx(
            20 * np.log10(np.abs(value)), abs=1e-6
        )  # type: ignore[index]
        turned = np.exp(1j * np.radians(answer.curves["phase"][row]))  # type: ignore[index]
        assert turned == pytest.approx(value / np.abs(value), abs=1e-6)
    at = design.at(float(subject.payloads[20]))
    assert answer.curves["crossover"][20] == pytest.approx(at.gain_crossover)  # type: ignore[index]
    assert answer.curves["margin"][20] == pytest.approx(math.degrees(at.phase_margin))  # type: ignore[index]
    assert answer.head["asked"] == {
        "gain_crossover": 12.0,
        "phase_margin_deg": pytest.approx(50.0),
    }
    c = design.controller
    assert (
        answer.head["controller"]["k_d"] == c.gain
        and answer.head["controller"]["formula"] == c.formula
    )
    assert answer.head["controller"]["upper"] == design.gain_crossover_upper
    assert answer.head["facts"] == [
        ("ω_c", "12 rad/s"),
        ("φ_m", "50°"),
        ("k_d", number(c.gain)),
        ("β", number(c.order)),
        ("δ", f"{1e3 * c.filter_time:.3g} ms" if c.filter_time else "none"),
        ("n", str(c.filter_order)),
        ("ω̄_c", f"{number(design.gain_crossover_upper)} rad/s"),
    ]
    assert answer.head["passed"] is True and "blocks" not in answer.head
    with_law = preview(replace(subject, law=made.study.law), ASKED).head
    assert len(with_law["blocks"]) == 2 and with_law["law_error"] < 0.05
    edge = preview(subject, {**ASKED, "payloads": [0.03, 0.05]}).head
    assert edge["three"] == (
        0.03,
        0.04,
        0.05,
    )  # the nominal one lies on the edge: the middle instead
    unfiltered = dict(preview(subject, {**ASKED, "filter_time": 0.0}).head["facts"])
    assert unfiltered["δ"] == "none"
    filtered = dict(preview(subject, {**ASKED, "filter_time": 0.012345}).head["facts"])
    assert filtered["δ"] == "12.3 ms"


@pytest.mark.slow
def test_the_nearest_request_is_the_same_where_it_is_feasible(subject: Subject) -> None:
    assert nearest(subject, ASKED).head["state"] == checked_request(ASKED)
    far = {**ASKED, "gain_crossover": 30.0}
    assert RIG.model is not None
    with pytest.raises(InfeasibleError) as why:
        fl.design(
            RIG.model,
            RIG,
            payloads=(0.02, 0.04),
            gain_crossover=30.0,
            phase_margin=fl.deg(50),
        )
    found = nearest(subject, far).head["state"]
    for name, value in why.value.nearest.items():
        shown = math.degrees(value) if name == "phase_margin" else value
        name = "phase_margin_deg" if name == "phase_margin" else name
        assert found[name] == pytest.approx(shown, rel=1e-9)


# --- the session ----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_session_opens_what_it_is_given(made: Session, tmp_path: Path) -> None:
    design = made.study.design
    fl.save(design, tmp_path / "design.json")
    of_design = opened(tmp_path / "design.json", out=tmp_path / "r")
    assert of_design.study.design == design and of_design.study.rig == design.rig
    assert (
        of_design.study.law.digest == design.law().digest
        and of_design.folder == tmp_path / "r"
    )
    other = fl.Rig.named("paper-2023-geared")
    assert opened(tmp_path / "design.json", rig=other).study.rig is other
    fl.save(design.law(), tmp_path / "law.json")
    assert (
        opened(tmp_path / "law.json", out=tmp_path / "r").source
        == tmp_path / "law.json"
    )  # no design
    of_log = opened(Path(fl.bundled_log("prbs_30g")), out=tmp_path / "r")
    assert of_log.source == Path(fl.bundled_log("prbs_30g")) and of_log.study.rig == RIG
    assert opened(None).study.rig == RIG and opened(None).folder == Path("results")
    assert opened(None, rig=other).study.rig is other
    fl.save(design, tmp_path / "of" / "design.json")
    assert opened(tmp_path / "of", rig=other).study.rig is other
    assert opened(tmp_path / "of").folder == tmp_path / "of"


@pytest.mark.slow
def test_a_session_begins_with_what_its_design_or_its_rig_asks(
    made: Session, tmp_path: Path
) -> None:
    of_rig = Session(fl.trials.Study(rig=RIG), tmp_path).state
    assert (of_rig["payloads"], of_rig["gain_crossover"]) == (
        (0.02, 0.04),
        RIG.design.gain_crossover,
    )
    assert of_rig["phase_margin_deg"] == RIG.design.phase_margin_deg
    assert (
        Session(fl.trials.Study(rig=replace(RIG, design=None)), tmp_path).state[
            "gain_crossover"
        ]
        is None
    )
    assert Session(fl.trials.Study(), tmp_path).state["payloads"] is None
    of_design = Session(
        fl.trials.Study(rig=RIG, design=made.study.design), tmp_path
    ).state
    assert (of_design["gain_crossover"], of_design["phase_margin_deg"]) == (12.0, 50.0)
    assert (of_design["box"], of_design["margins"]) == (False, "loop")
    (tmp_path / "studio.jsonl").write_text(
        '{"at": 0, "state": {"gain_crossover": -5}}\n'
    )
    edited = Session(fl.trials.Study(rig=RIG), tmp_path)
    assert (
        edited.state["gain_crossover"] == RIG.design.gain_crossover
        and edited.history.states == []
    )


@pytest.mark.slow
def test_the_steps_are_marked_by_what_was_done(
    made: Session, fitted: Session, tmp_path: Path
) -> None:
    fresh = Session(fl.trials.Study(rig=RIG), tmp_path)
    assert fresh.marks() == {
        "log": "not run",
        "channels": "not run",
        "model": "not run",
        "design": fresh.study.verdict.promise.state,
        "move": fresh.study.verdict.model.state,
        "proof": "not run",
        "board": "not run",
    }
    assert {name: fitted.marks()[name] for name in ("log", "channels", "model")} == {
        "log": "passed",
        "channels": "passed",
        "model": "passed" if fitted.study.fit.passed else "failed",
    }
    assert made.marks()["design"] == "passed" and made.marks()["proof"] == "not run"
    other = Session(replace(made.study, uncertified="no"), tmp_path)
    assert (
        other.marks()["proof"] == "failed"
        and other.overview()["proof_said"] == "Not proved: no"
    )
    other.written = {"a": 1}
    assert other.marks()["board"] == "passed"
    wrong = Session(
        replace(fitted.study, findings=(Finding("W299", "error", "bad"),)), tmp_path
    )
    assert wrong.marks()["log"] == "failed"


@pytest.mark.slow
def test_the_arm_is_sent_once_and_then_only_its_law(
    made: Session, tmp_path: Path
) -> None:
    first = made.arm()
    assert len(first["arm_key"]) == 16 and json.loads(first["arm"])["period"] == 0.004
    again = made.arm(first["arm_key"])
    assert (
        sorted(again) == ["arm_key", "blocks"] and again["arm_key"] == first["arm_key"]
    )
    assert again["blocks"] == json.loads(first["arm"])["blocks"]
    assert Session(fl.trials.Study(rig=RIG), tmp_path).arm("x") == {
        "arm_key": "",
        "arm": None,
    }


@pytest.mark.slow
def test_what_a_step_copies_names_the_files_of_the_folder(
    made: Session, fitted: Session
) -> None:
    told = copies(made)
    assert list(told) == [
        "log",
        "channels",
        "model",
        "design",
        "move",
        "proof",
        "board",
    ]
    folder = made.folder
    assert (
        told["move"]["command"]
        == f"fraclink simulate {folder / 'design.json'} --payload 0.04"
    )
    assert "payload=0.04, duration=4.0" in told["move"]["python"]
    assert told["proof"]["command"] == f"fraclink certify {folder / 'design.json'}"
    assert told["board"]["command"].endswith(f"--out {folder / 'firmware'}")
    assert told["log"]["command"] == "fraclink inspect demo"
    assert told["log"]["python"] == (
        'import fraclink as fl\n\nprint(fl.inspect_log(fl.bundled_log("prbs_30g")))'
    )
    assert (
        told["channels"]["python"].splitlines()[2] == "rig = fl.Rig.named('paper-2023')"
    )
    assert told["design"]["command"].startswith("fraclink design --rig paper-2023 ")
    assert (
        "--payload 0.04" in copies(fitted)["move"]["command"]
    )  # no design yet: the rig's heaviest
    broad = replace(RIG, payloads=replace(RIG.payloads, high=0.05))
    assert (
        "--payload 0.05"
        in copies(Session(fl.trials.Study(rig=broad), folder))["move"]["command"]
    )
    of_fit = copies(fitted)
    assert of_fit["model"]["command"].endswith(
        f"--structure UD-FOM --out {fitted.folder / 'model.json'}"
    )
    assert "fit = fl.identify(log, 'UD-FOM')" in of_fit["model"]["python"]
    assert f"--rig {fitted.folder / 'rig.toml'}" in of_fit["channels"]["command"]
    assert str(fl.bundled_log("pulse_30g")) in of_fit["log"]["command"]
    assert f"--model {fitted.folder / 'model.json'}" in of_fit["design"]["command"]


def test_a_copied_log_repeats_what_was_said_of_it(tmp_path: Path) -> None:
    own = Session(
        fl.trials.Study(rig=RIG), tmp_path / "r", source=tmp_path / "mine.csv"
    )
    own.columns = (
        "time=t [s]",
        "motor_angle=-th [deg]",
        "deflection=d [rad]",
        "voltage=u [V]",
    )
    own.payload, own.stretch, own.heldout = 0.025, (1.0, 9.5), 0.2
    own.become(
        replace(
            own.study,
            experiment=fl.Experiment(
                period=0.1, motor_angle=[0, 1], output=[0, 1], output_kind="deflection"
            ),
        )
    )
    told = copies(own)
    words = told["model"]["command"]
    assert (
        f"identify {tmp_path / 'mine.csv'} --rig {tmp_path / 'r' / 'rig.toml'} --column 'time=t [s]'"
        in words
    )
    assert "--payload 0.025 --keep 1 9.5" in words and "--heldout 0.2" in words
    python = told["model"]["python"]
    assert "fl.Channel('t', 's'), fl.Channel('th', 'deg', sign=-1)" in python
    assert "fl.Channel('d', 'rad'), 'deflection', fl.Channel('u', 'V'))" in python
    assert "payload=0.025, keep=(1.0, 9.5))" in python
    assert "fit = fl.identify(log, heldout=0.2, stiffness=rig.link.stiffness)" in python
    assert "--payload" not in told["log"]["command"]  # inspecting needs nothing of it
    own.source = own.draft / "upload" / "sent.csv"
    assert copies(own)["log"]["command"] == "fraclink inspect sent.csv"


# --- jobs -----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_job_needs_its_part_and_its_range(made: Session, tmp_path: Path) -> None:
    fresh = Session(fl.trials.Study(rig=RIG), tmp_path)
    for verb, remedy in (
        ("identify", "steps 1 and 2"),
        ("prove", "step 4"),
        ("arms", "step 4"),
        ("faults", "step 4"),
    ):
        with pytest.raises(FieldError, match="is required") as why:
            work.Job(fresh, verb, {}).done(lambda progress: None)
        assert remedy in why.value.remedy
    for runs in (0, 20_001, "x"):
        with pytest.raises(FieldError, match="runs"):
            work.Job(made, "arms", {"runs": runs}).done(lambda progress: None)
    assert work.JOBS["identify"][1][0][1:] == (fl_between(0.05, 0.9), None)
    assert work.JOBS["arms"][1][0][2] == 1000


def fl_between(low: float, high: float) -> Any:
    from fracsys.checks import Between

    return Between(low, high)


@pytest.mark.slow
def test_a_job_that_is_cancelled_or_fails_leaves_the_study(
    made: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = work.Job(made, "prove", {})
    job.cancel()
    with pytest.raises(FieldError, match="stopped as you asked"):
        job.done(lambda progress: None)
    codes = "import sys; print('{\"said\": \"half\"}'); sys.stderr.write('first\\nthe reason\\n'); sys.exit(2)"
    original = work.subprocess.Popen
    monkeypatch.setattr(
        work.subprocess,
        "Popen",
        lambda command, **more: original([sys.executable, "-c", codes], **more),
    )
    said: list[Any] = []
    before = made.study
    with pytest.raises(FieldError, match="failed: the reason") as why:
        work.Job(made, "prove", {}).done(said.append)
    assert (
        said == [{"said": "half"}]
        and made.study is before
        and why.value.field == "prove"
    )
    codes = "import sys; sys.exit(3)"
    with pytest.raises(FieldError, match="ended with code 3"):
        work.Job(made, "prove", {}).done(said.append)
    assert not [path for path in made.draft.iterdir() if path.name.startswith("tmp")]


@pytest.mark.slow
def test_a_jobs_result_is_taken_by_the_study_that_it_began_with(
    made: Session, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    own = Session(made.study, tmp_path)
    monkeypatch.setattr(work.Job, "_run", lambda self, place, asked, tell: None)
    proved = replace(made.study, uncertified="because of 8 g")
    monkeypatch.setattr(work, "load_study", lambda place: proved)
    answer = work.Job(own, "prove", {}).done(lambda progress: None)
    assert (
        own.study.uncertified == "because of 8 g"
        and own.study.design is made.study.design
    )
    assert (
        answer.head["ok"] and answer.head["proof_said"] == "Not proved: because of 8 g"
    )
    monkeypatch.setattr(
        work, "load_study", lambda place: replace(made.study, faults=table())
    )
    answer = work.Job(own, "faults", {}).done(lambda progress: None)
    assert own.study.faults == table() and own.study.uncertified == "because of 8 g"
    assert answer.head["faults_said"].startswith("1 of 2 faults")
    job = work.Job(own, "faults", {})
    own.become(
        replace(own.study, design=replace(made.study.design, gain_crossover=12.5))
    )
    with pytest.raises(FieldError, match="changed meanwhile"):
        job.done(lambda progress: None)


def table() -> FaultTable:
    good, bad = (
        Check("peak", 1.0, 1.1, passed=True),
        Check("peak over clean", 1.3, 1.1, passed=False),
    )

    def outcome(fault: str, phase: Any, *checks: Check) -> Outcome:
        return Outcome(
            Case(fault, 1, 0.02, phase, 1), checks, 0.1, 0.1, 0.0, "run", "none", 0
        )

    return FaultTable(
        (
            outcome("F09", "mid", good),
            outcome("F11", "start", good),
            outcome("F11", "mid", bad),
            outcome("F11", "rest", bad),
        ),
        {},
    )


# --- logs and fits --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_listing_has_every_channel_and_what_it_is_taken_for(fitted: Session) -> None:
    answer = logs.LOG_VERBS["log"](fitted, {})
    told = answer.head["log"]
    listing = fl.inspect_log(fl.bundled_log("pulse_30g"))
    samples = listing.channels[0].samples
    assert (
        told["said"]
        == f"{listing.path}: {listing.kind}, {len(listing.channels)} channels, {samples} samples."
    )
    assert [channel["name"] for channel in told["channels"]] == [
        c.name for c in listing.channels
    ]
    assert told["channels"][0]["facts"].startswith("time · 0 … ")
    assert set(answer.head["roles"]) >= {"time", "motor_angle", "torque"}
    assert (
        answer.head["roles"]["torque"]["column"] == "torque_Nm"
        and answer.head["roles"]["torque"]["sign"] == 1
    )
    assert answer.head["units"]["time"] == sorted(answer.head["units"]["time"])
    assert answer.head["rig"] == "paper-2023" and len(told["sha256"]) == 64
    spark = np.asarray(answer.curves["spark1"])
    assert spark.size <= 240 and (spark.min(), spark.max()) == (0.0, 1.0)
    assert answer.head["experiment"]["kind"] == "torque"
    degrees_ = np.asarray(answer.curves["motor_angle"])
    assert degrees_.max() == pytest.approx(
        math.degrees(fitted.study.experiment.motor_angle.max())
    )


def test_a_question_with_a_default_is_answered_by_it_and_any_other_is_asked(
    tmp_path: Path,
) -> None:
    rng = np.random.default_rng(0)
    rows = zip(
        0.004 * np.arange(1000),
        0.01 * rng.normal(size=1000).cumsum(),
        rng.normal(size=1000),
        strict=True,
    )
    lines = (f"{t:.3f},{a:.5f},{b:.5f}" for t, a, b in rows)
    own = opened(None, out=tmp_path / "r")
    own.source = tmp_path / "x.csv"
    own.source.write_text("t,a,b\n" + "\n".join(lines))
    columns = logs.LOG_VERBS["columns"]
    with pytest.raises(
        FieldError, match="Which column is the output of the link"
    ) as why:
        columns(own, {"columns": ["motor_angle=a [rad]"]})
    assert why.value.value == "motor_angle=a [rad]"
    sign_left_open = ["motor_angle=a [rad]", "torque=b [Nm]"]
    assert (
        columns(own, {"columns": sign_left_open}).head["experiment"]["kind"] == "torque"
    )
    assert own.columns == (
        "time=t [s]",
        "motor_angle=a [rad]",
        "torque=b [Nm]",
    )  # what is copied states all


@pytest.mark.slow
@pytest.mark.parametrize(
    ("asked", "margin", "filter_time"),
    [
        ({"phase_margin_deg": 48.0}, 48.0, 0.02),
        ({}, 50.0, 0.02),  # what the design has, in degrees of the page
        ({"max_sensitivity": 1.8}, None, 0.02),
        ({"max_sensitivity": 1.8, "phase_margin_deg": 48.0}, 48.0, 0.02),
        ({"filter_time": 0.01}, 50.0, 0.01),
        ({"noise_gain": 5.0}, 50.0, None),
        ({"mode_gain": 0.4}, 50.0, None),
    ],
)
def test_python_states_what_the_command_completes_from_the_rig(
    made: Session,
    tmp_path: Path,
    asked: dict[str, Any],
    margin: float | None,
    filter_time: float | None,
) -> None:
    assert RIG.design is not None
    rig = replace(RIG, design=replace(RIG.design, filter_time=0.02))
    own = Session(replace(made.study, rig=rig), tmp_path)
    own.state = checked_request({"gain_crossover": 11.0, **asked})
    python = copies(own)["design"]["python"]
    assert (
        "payloads=(0.02, 0.04)" in python and "gain_crossover=12.0" in python
    )  # of the design as it was made
    assert (f"phase_margin=fl.deg({margin})" in python) == (margin is not None)
    assert ("phase_margin" in python) == (margin is not None)
    assert (f"filter_time={filter_time}" in python) == (filter_time is not None)
    assert ("filter_time" in python) == (filter_time is not None)
    fresh = Session(fl.trials.Study(rig=rig), tmp_path / "fresh")
    assert "payloads=(0.02, 0.04)" in copies(fresh)["design"]["python"]


@pytest.mark.slow
def test_another_rig_begins_anew(fitted: Session, tmp_path: Path) -> None:
    own = Session(fitted.study, tmp_path)
    own.history.add({"gain_crossover": 30.0})
    answer = logs.LOG_VERBS["rig"](own, {"name": "paper-2023-geared"})
    assert answer.head["rig"] == "paper-2023-geared" == own.study.rig.name
    assert (
        own.history.states == []
        and own.study.fit is None
        and own.study.experiment is not None
    )
    assert answer.head["state"] == own.state and answer.head["rated"] == [
        0.02,
        0.03,
        0.04,
    ]
    with pytest.raises(FraclinkError):
        logs.LOG_VERBS["rig"](own, {"name": "no such rig"})
    bare_ = Session(fl.trials.Study(rig=RIG), tmp_path / "b")
    logs.LOG_VERBS["rig"](bare_, {"name": "paper-2023-geared"})
    assert bare_.study.assumptions == bare_.study.rig.assumptions
    bare_.upload = tmp_path / "mine.toml"
    replace(RIG, name="mine").save(bare_.upload)
    assert logs.LOG_VERBS["rig"](bare_, {"name": "upload"}).head["rig"] == "mine"


@pytest.mark.slow
def test_every_fit_is_a_card_with_its_curves(fitted: Session, tmp_path: Path) -> None:
    answer = logs.LOG_VERBS["model"](fitted, {})
    study, log = fitted.study, fitted.study.experiment
    assert [card["name"] for card in answer.head["fits"]] == list(study.fits) and len(
        study.fits
    ) == 4
    assert [card["name"] for card in answer.head["fits"] if card["used"]] == ["UD-FOM"]
    card = next(card for card in answer.head["fits"] if card["used"])
    fit = study.fits["UD-FOM"]
    assert (
        card["at"] == [abs(fit.model.pole), fit.model.order]
        and card["passed"] == fit.passed
    )
    assert (
        card["words"] == logs.words_of(fit) and card["heldout_nmse"] == fit.heldout_nmse
    )
    assert answer.head["said"] == f"The arm {logs.words_of(fit)}."
    assert answer.head["conclusion"] == study.comparison.verdict
    assert answer.head["heldout"] == pytest.approx(
        1.0 - fit.fitted_samples / log.output.size
    )
    assert (
        answer.head["duration"] == log.duration
        and answer.head["table"]["header"][0] == "structure"
    )
    for name, signal in (
        ("measured", log.output),
        ("predicted", fit.predicted),
        ("residual", fit.residual),
    ):
        kept = np.asarray(answer.curves[name])
        assert kept.size <= 2400 and (kept.min(), kept.max()) == (
            np.min(signal),
            np.max(signal),
        )
    axes = answer.head["axes"]
    high = 1.08 * np.abs(log.output).max()
    assert (
        axes["overlay"]
        == axes["rest"]
        == [
            {"low": 0.0, "high": log.duration},
            {"low": pytest.approx(-high), "high": pytest.approx(high)},
        ]
    )
    w = np.asarray(answer.curves["response_w"])
    both = [
        np.asarray(answer.curves[name]) for name in ("response_log", "response_model")
    ]
    top = 5.0 + max(float(each.max()) for each in both)
    assert axes["bode"] == [
        {"low": w[0], "high": w[-1]},
        {"low": pytest.approx(top - 70.0), "high": pytest.approx(top)},
    ]
    assert min(each.min() for each in both) >= max(both[0].max(), both[1].max()) - 140.0
    assert (
        both[0].min() >= both[0].max() - 80.0 - 1e-9
    )  # nothing more than 80 dB below the log's largest
    hertz = np.asarray(answer.curves["spectrum_hz"])
    assert axes["spectrum"][0] == {"low": max(hertz[0], 0.05), "high": hertz[-1]}
    assert axes["valley"][0]["low"] == pytest.approx(
        answer.curves["error_resonance"][0]
    )  # type: ignore[index]
    assert {entry[0] for entry in answer.head["drawn"]} == {
        "overlay",
        "rest",
        "bode",
        "trust",
        "spectrum",
    }
    own = Session(study, tmp_path)
    logs.LOG_VERBS["model"](own, {"structure": "D-IOM"})
    assert own.study.fit is study.fits["D-IOM"] and own.study.design is None
    with pytest.raises(FieldError, match=", ".join(study.fits)):
        logs.LOG_VERBS["model"](own, {"structure": "x"})


def test_before_a_fit_the_step_says_what_is_missing(tmp_path: Path) -> None:
    own = opened(None, out=tmp_path)
    assert (
        logs.LOG_VERBS["model"](own, {}).head["said"]
        == "Read a log first (steps 1 and 2)."
    )
    own.become(
        replace(
            own.study,
            experiment=fl.Experiment(period=0.1, motor_angle=[0, 1], output=[0, 1]),
        )
    )
    answer = logs.LOG_VERBS["model"](own, {})
    assert (answer.head["said"], answer.head["fits"], answer.curves) == (
        "Not fitted yet.",
        [],
        {},
    )


# --- runs for the page ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_run_for_the_page_is_no_longer_than_its_engine_holds(
    made: Session, tmp_path: Path
) -> None:
    asked = {
        "payload": 0.03,
        "move": 1.0,
        "time": 0.5,
        "half": 2.0,
        "duration": 16.01,
        "noise": 0.0,
        "offset": 0.0,
        "delay": 1,
        "told": False,
    }
    with pytest.raises(FieldError, match="duration: too long") as why:
        played.PLAY_VERBS["play"](made, asked)
    assert why.value.allowed == "<= 16 s"
    fresh = Session(fl.trials.Study(rig=RIG), tmp_path)
    for verb in ("play", "fault"):
        with pytest.raises(FieldError, match="design is required"):
            played.PLAY_VERBS[verb](fresh, asked)
    answer = played.PLAY_VERBS["play"](
        made, {**asked, "duration": 1.0, "half": 0.5, "time": 0.4}
    )
    assert (
        answer.head["move"] == pytest.approx(math.degrees(1.0))
        and answer.head["payload"] == 0.03
    )
    assert answer.head["said"].startswith("On the twin: the move as it is.")
    assert len(answer.curves["tip"]) == 251  # type: ignore[arg-type]  # both ends of a second


# --- files for a board ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_law_with_more_modes_takes_eight_instructions_more_for_each(
    made: Session,
) -> None:
    rows = outputs.OUTPUT_VERBS["board"](made, {"precision": "single"}).head["board"]
    law = made.study.law
    modes = law.order + len(law.feedforward.poles)
    assert rows[2] == [
        f"instructions a period, Cortex-M4F, {modes} modes",
        f"about {409 + 8 * (modes - 8)}",
        f"about {495 + 8 * (modes - 8)}",
    ]
    assert int(rows[0][1].split()[0]) <= int(rows[0][2].split()[0])
    assert int(rows[1][1].split()[0]) <= int(rows[1][2].split()[0])


# --- server ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("host", "own"),
    [
        ("localhost", True),
        ("127.0.0.1", True),
        ("127.8.0.1", True),
        ("::1", True),
        ("192.168.0.2", False),
        ("here", False),
    ],
)
def test_an_address_is_of_this_machine_or_of_others(host: str, own: bool) -> None:
    assert serving._is_loopback(host) is own


def test_a_port_that_is_taken_is_named() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(FieldError, match=f"port: .*127.0.0.1:{port}") as why:
            serving._listening("127.0.0.1", port, False)
        assert why.value.allowed == "a free port of this machine"
    listener = serving._listening("127.0.0.1", 0, False)
    assert listener.getsockname()[1] > 0
    with socket.create_connection(
        listener.getsockname(), timeout=5
    ):  # it listens already
        listener.close()


@pytest.mark.parametrize(
    ("pages", "alone", "failed", "ends"),
    [
        (0, 601.0, False, True),
        (0, 590.0, False, False),
        (1, 9999.0, False, False),
        (1, 0.0, True, True),
    ],
)
def test_the_studio_ends_ten_minutes_after_the_last_page(
    monkeypatch: pytest.MonkeyPatch, pages: int, alone: float, failed: bool, ends: bool
) -> None:
    monkeypatch.setattr(serving, "_LOOK", 0.0)
    watched = SimpleNamespace(should_exit=False)
    studio = SimpleNamespace(
        pages=pages, alone_since=time.monotonic() - alone, failed=failed
    )

    async def look() -> None:
        task = asyncio.create_task(serving._watch(watched, studio))  # type: ignore[arg-type]
        for _ in range(5):
            await asyncio.sleep(0)
        task.cancel()

    asyncio.run(look())
    assert watched.should_exit is ends


@pytest.fixture
def studio(tmp_path: Path) -> server.Studio:
    return server.Studio(
        lambda: opened(None, out=tmp_path / "results"), hosts=["127.0.0.1:8000"]
    )


@pytest.fixture
def client(studio: server.Studio) -> TestClient:
    return TestClient(server.application(studio), base_url="http://127.0.0.1:8000")


def test_files_are_served_with_their_kind(client: TestClient) -> None:
    for path, kind in (
        ("/", "text/html"),
        ("/studio.js", "text/javascript"),
        ("/studio.css", "text/css"),
        ("/icon.svg", "image/svg+xml"),
        ("/arm_box.js", "text/javascript"),
        ("/arm_box.css", "text/css"),
    ):
        answer = client.get(path)
        assert (
            answer.headers["content-type"].startswith(kind)
            and answer.status_code == 200
        )
        assert answer.headers["referrer-policy"] == "no-referrer"
    assert (
        "<!-- arm_box.html -->" not in client.get("/").text
        and "{#" not in client.get("/").text
    )
    script = client.get("/arm_box.js").text
    page = Path(server.__file__).parent / "page"
    assert script.startswith((page / "arm_before.txt").read_text("utf-8"))
    assert script.endswith((page / "arm_after.txt").read_text("utf-8"))
    assert (
        client.post("/").status_code == 405 and client.post("/").text == "nothing here"
    )


def test_an_upload_that_no_file_system_takes_is_refused(
    client: TestClient, studio: server.Studio
) -> None:
    token = {"x-studio-token": studio.token}

    def answer(name: str) -> tuple[int, str]:
        reply = client.post(
            "/upload", params={"name": name}, content=b"x", headers=token
        )
        assert "content-security-policy" in reply.headers
        return reply.status_code, reply.text

    assert answer(80 * "中" + ".csv")[0] == 204
    status, why = answer(101 * "中" + ".csv")
    assert status == 400 and "255 bytes" in why
    (studio.session.draft / "upload" / "taken.csv").mkdir()
    assert answer("taken.csv")[0] == 507


def test_an_upload_of_more_than_the_readers_take_is_refused(
    client: TestClient, studio: server.Studio, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "UPLOAD_LIMIT", 10)
    token = {"x-studio-token": studio.token}
    assert (
        client.post("/upload?name=a.csv", content=10 * b"x", headers=token).status_code
        == 204
    )
    assert (
        studio.session.upload is not None
        and studio.session.upload.read_bytes() == 10 * b"x"
    )
    refused = client.post("/upload?name=b.csv", content=11 * b"x", headers=token)
    assert (refused.status_code, refused.text) == (413, "at most 10 bytes")
    assert not (studio.session.draft / "upload" / "b.csv").exists()
    (studio.session.draft / "studio.zip").write_bytes(b"PK")
    answer = client.get("/studio.zip", headers=token)
    assert (answer.content, answer.headers["content-type"]) == (
        b"PK",
        "application/zip",
    )


def test_pages_are_counted_while_they_are_open(studio: server.Studio) -> None:
    async def opened_twice() -> tuple[int, int]:
        async with server._counted(studio):
            async with server._counted(studio):
                most = studio.pages
            return most, studio.pages

    studio.alone_since = 0.0
    assert asyncio.run(opened_twice()) == (2, 1) and studio.pages == 0
    assert time.monotonic() - studio.alone_since < 60.0
    assert (
        studio.knows(studio.token)
        and not studio.knows(studio.token + "x")
        and not studio.knows(None)
    )


@pytest.mark.slow
def test_a_session_that_cannot_be_opened_is_failed() -> None:
    def refused() -> Session:
        raise FieldError("place", "x", "missing", allowed="a folder", remedy="name one")

    failing = server.Studio(refused)
    with pytest.raises(FieldError, match="place"):
        _ = failing.session
    assert failing.failed
