"""The studio without a browser: the answers to a drag, what is refused, what is kept."""

from __future__ import annotations

import inspect
import json
import math
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

import fraclink as fl
import fraclink.studio._conversation as conversation
import fraclink.studio._work as swept_module
from fraclink import main
from fraclink._law.requirement import margins_of
from fraclink.errors import FieldError, FraclinkError
from fraclink.studio._history import History
from fraclink.studio._messages import NAMES, Reply, parsed
from fraclink.studio._preview import Subject, fan_of, map_of, preview
from fraclink.studio._server import Studio, application
from fraclink.studio._session import Session, SupersededError, opened
from fraclink.studio._work import swept
from junk import CHARACTERS

ADDRESS = "http://127.0.0.1:8000"
ASKED = {"gain_crossover": 12.0, "phase_margin_deg": 50.0, "payloads": [0.02, 0.04]}


@pytest.fixture(scope="module")
def subject() -> Subject:
    rig = fl.Rig.named("paper-2023")
    made = fl.design(
        rig.model, rig, gain_crossover=12.0, phase_margin=fl.deg(50), law=False
    )
    return Subject(rig, rig.model, made.law())


def unpacked(data: bytes) -> tuple[dict, dict[str, np.ndarray]]:
    """Head and curves of an answer, as read by the page; NaN and infinity are not valid
    JSON.
    """

    def none(name: str) -> float:
        raise AssertionError(f"{name} was sent")

    (size,) = struct.unpack("<I", data[:4])
    head = json.loads(data[4 : 4 + size], parse_constant=none)
    assert size % 4 == 0
    at, curves = 4 + size, {}
    for name, (rows, count) in head["curves"].items():
        curves[name] = np.frombuffer(data, "<f4", rows * count, at).reshape(rows, count)
        at += 4 * rows * count
    assert at == len(data)
    return head, curves


def talked(socket, **message) -> tuple[dict, dict]:
    """Send one request and return its answer; progress messages are skipped."""
    socket.send_text(json.dumps(message))
    while True:
        head, curves = unpacked(socket.receive_bytes())
        assert "defect" not in head  # whichever message it answers
        if head["seq"] == message["seq"] and head["verb"] != "progress":
            return head, curves


@contextmanager
def connected(session: Session) -> Iterator[Any]:
    """Provide the socket of a page that a session serves."""
    studio = Studio(lambda: session, hosts=["127.0.0.1:8000"])
    page = TestClient(application(studio), base_url=ADDRESS)
    with page.websocket_connect(
        "ws://127.0.0.1:8000/talk", headers={"origin": ADDRESS}
    ) as socket:
        socket.send_text(studio.token)
        yield socket


def answered(session: Session, verb: str, **given) -> tuple[dict, dict]:
    """Return the answer to one request of a page that a session serves."""
    with connected(session) as socket:
        return talked(socket, seq=1, verb=verb, **given)


# --- preview --------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_preview_has_the_figures_of_design(subject):
    head, curves = unpacked(preview(subject, ASKED)[0].packed(3, "preview"))
    made = fl.design(
        subject.model, subject.rig, gain_crossover=12.0, phase_margin=fl.deg(50)
    )
    assert head["controller"]["k_d"] == made.controller.derivative_gain
    assert head["controller"]["beta"] == made.controller.derivative_order
    assert (head["ok"], head["seq"], head["verb"], head["preview"]) == (
        True,
        3,
        "preview",
        True,
    )
    margin = next(row for row in made.requirements if row.name == "phase margin")
    assert sum(phase for _, phase in head["budget"]) + 180 == pytest.approx(
        margin.achieved / fl.deg(1),
        abs=2e-3,  # accuracy of the table on which the rows are measured
    )
    at_20g = np.interp(0.02, subject.links.payloads, curves["margin"][0])
    assert at_20g == pytest.approx(50.0, abs=0.05)


@pytest.mark.parametrize(
    "changed",
    [{"gain_crossover": 13.0}, {"filter_order": 1}, {"gain_crossover": None}],
)
def test_a_preview_from_the_one_before_it_shows_the_design_of_its_own_request(
    subject, changed
):
    """Also from a controller that has nothing in common with the request."""
    _, last = preview(subject, ASKED)
    assert last is not None
    asked = {**ASKED, "phase_margin_deg": 40.0, **changed}
    anew, _ = preview(subject, asked)
    for near in (last, replace(last, derivative_gain=50.0)):
        reply, _ = preview(subject, asked, near=near)
        margins = (one.curves["margin"] for one in (reply, anew))
        np.testing.assert_allclose(*margins, atol=0.3)


VALUES = st.one_of(
    st.none(),
    st.floats(),
    st.integers(-5, 10**400),
    st.text(CHARACTERS, max_size=8),
    st.booleans(),
    st.lists(st.floats(), max_size=3),
    st.dictionaries(st.text(CHARACTERS, max_size=3), st.none(), max_size=2),
)
WILD = st.dictionaries(st.sampled_from([*NAMES, "gain", ""]), VALUES, max_size=4)
SANE = st.fixed_dictionaries(
    {
        "gain_crossover": st.floats(5.0, 60.0),
        "phase_margin_deg": st.floats(5.0, 120.0),
        "payloads": st.tuples(st.floats(0.005, 0.03), st.floats(0.03, 0.09)).map(list),
    },
    optional={"filter_time": st.one_of(st.none(), st.floats(0.0, 0.1))},
)


@pytest.mark.slow
@settings(max_examples=60, deadline=None, derandomize=True)
@given(state=st.one_of(WILD, SANE, VALUES))
def test_every_state_is_answered_in_numbers_or_refused_in_words(subject, state):
    head, _ = unpacked(preview(subject, state)[0].packed(0, "preview"))
    assert head["ok"] or len(head["error"]) > 10


@pytest.mark.parametrize(
    ("option", "state", "words"),
    [
        ("gain_crossover", -1.0, ["--gain-crossover", "-1"]),
        ("phase_margin_deg", 200.0, ["--phase-margin-deg", "200"]),
        ("filter_time", -0.1, ["--filter-time", "-0.1"]),
        ("filter_order", 3, ["--filter-order", "3"]),
        ("max_sensitivity", 0.5, ["--max-sensitivity", "0.5"]),
        ("payloads", [0.04, 0.02], ["--payloads", "0.04", "0.02"]),
        (
            "phase_margin_deg",
            99.0,
            ["--phase-margin-deg", "99", "--gain-crossover", "40"],
        ),
    ],
)
def test_the_command_line_refuses_the_same_in_the_same_words(
    subject, option, state, words, tmp_path, capsys
):
    asked = {option: state} | (
        {"gain_crossover": 40.0} if len(words) == 4 and option != "payloads" else {}
    )
    head, _ = unpacked(preview(subject, asked)[0].packed(0, "preview"))
    out = str(tmp_path / "design.json")
    assert main(["design", "--rig", "paper-2023", *words, "--out", out]) in (1, 2)
    printed = " ".join(capsys.readouterr().err.split())
    assert not head["ok"]
    # The command line proposes the nearest request as its own options.
    assert " ".join(head["error"].split()).partition("; nearest feasible")[0] in printed


def test_the_options_are_keywords_of_design():
    keywords = {
        *inspect.signature(fl.design).parameters,
        *get_type_hints(fl.Specification),
    }
    assert set(NAMES) - {"phase_margin_deg"} <= keywords


@pytest.mark.slow
def test_a_refusal_names_the_nearest_that_is_feasible(subject, tmp_path):
    refused, _ = preview(subject, {**ASKED, "gain_crossover": 30.0})
    assert refused.head["condition"] == "gain crossover"
    state = {**ASKED, "gain_crossover": 30.0}
    head, _ = answered(opened(None, out=tmp_path), "exact", state=state)
    found = state | head["nearest"]
    assert preview(subject, found)[0].head["ok"]
    assert 10 < found["gain_crossover"] < 30


@pytest.mark.slow
def test_the_map_is_the_one_of_feasibility_map_and_the_fan_is_of_the_box(subject):
    found = map_of(subject, ASKED)
    assert np.any(found["noise"] > 0)
    head, curves = unpacked(preview(subject, ASKED, fan=True)[0].packed(0, "preview"))
    assert (
        head["ok"]
        and len(curves["fan_gain"]) > 8
        and np.ptp(curves["fan_gain"], axis=0).max() > 3.0
    )
    # a box that is a single point contains one arm, that of the model, at both payloads
    made = fl.design(
        subject.model,
        subject.rig,
        gain_crossover=12.0,
        phase_margin=fl.deg(50),
        law=False,
    )
    point = fan_of(
        replace(made, box=fl.ParameterBox.at(subject.model)), subject.frequencies
    )
    assert np.allclose(point["fan_gain"], curves["gain"][[0, 2], ::4], atol=1e-3)
    assert np.allclose(point["fan_phase"], curves["phase"][[0, 2], ::4], atol=1e-3)


# --- messages -------------------------------------------------------------------------------------------

BAD = ("", "{", "[]", "null", '"x"', '{"seq": 1}', '{"seq": -1, "verb": "hello"}', '{"verb": "hello"}',
       '{"seq": 1e400, "verb": "hello"}', '{"seq": NaN, "verb": "hello"}', '{"seq": true, "verb": "hello"}',
       '{"seq": 1, "verb": 5}', "[" * 5000, "x" * 20_000, "\udcff", None, b"bytes")  # fmt: skip


@pytest.mark.parametrize("text", BAD)
def test_what_is_no_request_is_refused(text):
    with pytest.raises(FieldError, match="not a request"):
        parsed(text)


# --- runs that Python makes for the page ----------------------------------------------------------------

MOVED = {"payload": 0.03, "move": 1.0, "time": 0.5, "half": 2.0, "duration": 4.0, "noise": 0.0, "offset": 0.0,
         "delay": 1, "told": False}  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Session:
    session = opened(
        None,
        rig=fl.Rig.named("paper-2023-geared"),
        out=tmp_path_factory.mktemp("made") / "r",
    )
    session.exact(ASKED)
    return session


@pytest.mark.slow
def test_a_tip_that_is_held_stays_and_a_payload_that_is_lost_is_gone(made):
    _, free = answered(made, "play", **MOVED)
    design = made.study.design
    path = fl.smooth_step(1.0, 0.5).then(fl.smooth_step(-1.0, 0.5, start=1.5))
    arm = fl.Twin.from_rig(
        design.rig, model=design.model, link_mass=design.rig.link.mass
    )
    own = fl.simulate(
        made.study.law,
        path,
        arm=arm,
        duration=4.0,
        noise=0.0,
        payload=0.03,
        delay_samples=1,
    )
    assert np.array_equal(free["tip"][0], own.tip_angle.astype("<f4"))
    hold = {
        "begin": 0.2,
        "until": 0.6,
        "angle": float(np.interp(0.2, own.time, own.tip_angle)),
    }
    head, held = answered(made, "play", **MOVED, hold=hold)
    inside = (own.time > 0.25) & (own.time < 0.6)
    assert (
        held["tip"][0][inside].max()
        < hold["angle"] + 0.05
        < free["tip"][0][inside].max() - 0.3
    )
    assert "held at" in head["said"]
    lost = {"throw": {"time": 0.3, "payload": 0.008}}
    head, thrown = answered(made, "play", **MOVED, **lost)
    before = own.time < 0.299
    assert np.array_equal(thrown["tip"][0][before], free["tip"][0][before])
    assert np.abs(thrown["torque"][0] - free["torque"][0]).max() > 0.05
    assert "8 g at 0.30 s" in head["said"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["payload", "move", "time", "delay", "duration"])
@pytest.mark.parametrize("value", [None, "x", True, 1e300, -5.0])
def test_a_run_of_impossible_settings_is_refused_in_words(made, name, value):
    if (name, value) == ("move", -5.0):
        return  # a move in the other direction is possible
    head, _ = answered(made, "play", **MOVED | {name: value})
    assert not head["ok"] and len(head["error"]) > 10


@pytest.mark.slow
def test_the_map_about_minus_one_is_the_true_sampled_loops(made):
    design, law = made.study.design, made.study.law
    head, curves = swept(design, law)
    delays, near = np.asarray(head["delays"]), np.asarray(head["near"])
    assert near.shape == (delays.size, len(head["payloads"])) and delays[0] == 0.0
    late = [swept_module._distance(design, law, mass, 0.0) for mass in design.payloads]
    margins = [
        -margins_of(law.frequency_response, _plant_of(design, m)).modulus_margin
        for m in design.payloads
    ]
    assert late == pytest.approx(margins)
    assert near[-1, 0] > near[0, 0]  # a longer delay is closer, or unstable
    assert (near[-1] > 0.0).any() == any(
        not margins_of(
            law.frequency_response,
            replace(_plant_of(design, 1e-3 * float(m)), delay=1e-3 * float(delays[-1])),
        ).stable
        for m in head["payloads"]
    )
    assert curves["sweep_x"].shape == curves["sweep_y"].shape == (6, 1200)


def _plant_of(design: fl.Design, payload: float):
    return design.sampled_plant(design.natural_frequency(payload))


# --- the server -----------------------------------------------------------------------------------------


@pytest.fixture
def studio(tmp_path) -> Studio:
    return Studio(
        lambda: opened(None, out=tmp_path / "results"), hosts=["127.0.0.1:8000"]
    )


@pytest.fixture
def client(studio) -> TestClient:
    return TestClient(application(studio), base_url=ADDRESS)


def test_every_file_carries_the_policy_and_nothing_else_is_served(client):
    page = client.get("/")
    assert page.status_code == 200
    found = page.headers
    policy = found["content-security-policy"]
    assert policy.startswith("default-src 'none'")
    assert (found["cache-control"], found["x-content-type-options"]) == (
        "no-store",
        "nosniff",
    )
    assert "unsafe-inline" not in policy and "http" not in policy
    assert (
        "<script>" not in page.text
        and " style=" not in page.text
        and " onclick" not in page.text
    )
    for path in (
        "studio.js",
        "plot.js",
        "arm_box.js",
        "studio.css",
        "arm_box.css",
        "icon.svg",
    ):
        assert client.get(f"/{path}").headers["content-security-policy"] == policy
    for path in (
        "/index.html",
        "/arm_before.txt",
        "/../pyproject.toml",
        "/%2e%2e/session.py",
        "/x",
    ):
        assert client.get(path).status_code == 404


def test_another_host_or_origin_is_refused(client, studio):
    assert client.get("/", headers={"host": "evil.example:8000"}).status_code == 421
    assert client.get("/", headers={"host": "127.0.0.1:9"}).status_code == 421
    assert client.get("/", headers={"origin": "http://evil.example"}).status_code == 403
    for origin in ({"origin": "http://evil.example"}, {"origin": "null"}, {}):
        refused = pytest.raises(Exception)  # the client's own exception for a refusal
        with (
            refused as why,
            client.websocket_connect("ws://127.0.0.1:8000/talk", headers=origin),
        ):
            pass
        assert getattr(why.value, "status_code", 403) == 403


def test_a_wrong_token_closes_the_socket(client):
    for token in ("", "wrong", "x" * 1000):
        with client.websocket_connect(
            "ws://127.0.0.1:8000/talk", headers={"origin": ADDRESS}
        ) as socket:
            socket.send_text(token)
            with pytest.raises(WebSocketDisconnect) as why:
                socket.receive_bytes()
            assert why.value.code == 1008


def test_a_defect_of_an_answer_ends_nothing(client, studio, monkeypatch, capsys):
    """Neither the page nor the task for the next request of the same kind is ended."""
    broken = iter(
        (
            (Reply({"ok": True}, {"gain": np.array([np.nan])}), None),
            (Reply({"ok": True, "x": math.inf}), None),
        )
    )
    own = conversation.preview
    monkeypatch.setattr(
        conversation,
        "preview",
        lambda *given, **more: next(broken, None) or own(*given, **more),
    )
    with client.websocket_connect(
        "ws://127.0.0.1:8000/talk", headers={"origin": ADDRESS}
    ) as socket:
        socket.send_text(studio.token)
        for seq, defect in ((1, True), (2, None)):
            socket.send_text(
                json.dumps({"seq": seq, "verb": "preview", "state": ASKED})
            )
            head, _ = unpacked(socket.receive_bytes())
            assert (head["seq"], head["ok"], head.get("defect")) == (
                seq,
                not defect,
                defect,
            )
    assert "curve gain is not finite" in capsys.readouterr().err


def test_the_map_waits_for_the_release_of_a_handle(client, studio, monkeypatch):
    def columns(subject, state, going):
        going()
        return {}

    monkeypatch.setattr(conversation, "map_of", columns)
    with client.websocket_connect(
        "ws://127.0.0.1:8000/talk", headers={"origin": ADDRESS}
    ) as socket:
        socket.send_text(studio.token)
        held = {"state": ASKED, "held": True}
        socket.send_text(json.dumps({"seq": 1, "verb": "map", **held}))
        seen = []
        for seq in (2, 3):  # dragged
            socket.send_text(json.dumps({"seq": seq, "verb": "preview", **held}))
            seen.append(unpacked(socket.receive_bytes())[0]["seq"])
        assert seen == [2, 3]
        socket.send_text(json.dumps({"seq": 4, "verb": "preview", "state": ASKED}))
        rest = {unpacked(socket.receive_bytes())[0]["seq"] for _ in range(2)}
        assert rest == {1, 4}


@pytest.mark.slow
def test_a_page_says_hello_drags_notes_and_keeps(client, studio, tmp_path):
    with client.websocket_connect(
        "ws://127.0.0.1:8000/talk", headers={"origin": ADDRESS}
    ) as socket:
        socket.send_text(studio.token)
        hello, curves = talked(socket, seq=1, verb="hello")
        assert hello["name"] == "paper-2023" and len(hello["frequencies"]) == 280
        answer, curves = talked(
            socket, seq=2, verb="preview", state={**ASKED, "gain_crossover": 12.5}
        )
        assert answer["ok"] and curves["gain"].shape == (3, 280)
        exact, _ = talked(
            socket, seq=3, verb="exact", state={**ASKED, "gain_crossover": 12.5}
        )
        assert [state for *_, state in exact["verdict"]] == [
            "✓ passed",
            "✓ passed",
            "✗ failed",  # the link pushes the gearless motor away from its model
            "– not run",
        ]
        assert "--gain-crossover 12.5" in exact["copies"]["design"]
        noted, _ = talked(
            socket, seq=4, verb="note", state={**ASKED, "gain_crossover": 12.5}
        )
        assert noted["at"] == 0
        kept, _ = talked(socket, seq=5, verb="keep")
        assert "design.json" in kept["kept"]
        refused, _ = talked(socket, seq=6, verb="run-realtime")
        # the studio never moves a real arm
        assert refused["error"].startswith("verb: unknown")
        # known before any search
        in_grams = {**ASKED, "payloads": [20.0, 40.0]}
        doubted, _ = talked(socket, seq=7, verb="note", state=in_grams)
        assert not noted["doubts"]
        assert {one["code"] for one in doubted["doubts"]} == {"W105"}


@pytest.mark.slow
def test_hostile_messages_end_nothing(client, studio):
    rng = np.random.default_rng(0)
    texts = [text for text in BAD if isinstance(text, str) and text.isascii()]
    for _ in range(150):
        length = int(rng.integers(0, 60))
        texts.append("".join(chr(c) for c in rng.integers(32, 127, length)))
    verbs = ("hello", "preview", "exact", "note", "go", "keep", "log", "columns", "rig", "model", "export",
             "board", "cancel", "prove")  # fmt: skip
    junk = (None, -1, 1e308, "..", "../../x", [], {}, [[1]], {"a": 1}, True, "\u202e")
    for k in range(150):
        verb = verbs[k % len(verbs)]
        fields = (
            "state",
            "at",
            "force",
            "name",
            "columns",
            "structure",
            "target",
            "payload",
        )
        given = {field: junk[int(rng.integers(len(junk)))] for field in fields}
        # these take half a second each; their states are those of preview
        if verb in (
            "exact",
            "keep",
        ):
            given = {"state": junk[int(rng.integers(len(junk)))], "force": None}
        texts.append(
            json.dumps(
                {"seq": 10 + k, "verb": verb if verb != "keep" else "go", **given}
            )
        )
    with client.websocket_connect(
        "ws://127.0.0.1:8000/talk", headers={"origin": ADDRESS}
    ) as socket:
        socket.send_text(studio.token)
        for number, text in enumerate(texts):
            socket.send_text(text)
            if number % 20 == 19:
                head, _ = talked(socket, seq=100_000 + number, verb="go", at=-1)
                assert not head["ok"]
        head, _ = talked(socket, seq=999_999, verb="hello")
        assert head["ok"]
    assert not list(Path(studio.session.folder).glob("../x*"))


def test_a_file_is_taken_with_the_token_and_a_plain_name_only(client, studio):
    token = {"x-studio-token": studio.token}
    assert client.post("/upload?name=a.csv", content=b"x").status_code == 403
    for name in ("../a.csv", "a/b.csv", ".csv", "a", "", "a.csv/.."):
        assert (
            client.post(
                "/upload", params={"name": name}, content=b"x", headers=token
            ).status_code
            == 400
        )
    log = fl.bundled_log("prbs_30g")
    answer = client.post(
        "/upload?name=my log.csv", content=Path(log).read_bytes(), headers=token
    )
    assert answer.status_code == 204
    assert (
        studio.session.upload is not None
        and studio.session.upload.parent.name == "upload"
    )


# --- what is kept ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_what_is_kept_is_what_the_commands_write_byte_for_byte(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    session = opened(None, out=Path("kept"))
    answer = session.exact(
        {
            **ASKED,
            "gain_crossover": 13.0,
            "phase_margin_deg": 47.5,
            "filter_time": 0.004,
        }
    )
    session.keep()
    words = answer.head["copies"]["design"].split()
    words[words.index("--out") + 1] = "made.json"
    assert main(words[1:]) == 0
    assert Path("made.json").read_bytes() == Path("kept/design.json").read_bytes()


@pytest.mark.slow
def test_a_study_made_step_by_step_is_the_one_of_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    made = "run --rig paper-2023-geared --log demo --arms 200 --out theirs"
    assert main(made.split()) in (0, 1)
    session = opened(None, rig=fl.Rig.named("paper-2023-geared"), out=Path("ours"))
    assert answered(session, "log", name="prbs_30g")[0]["log"]["channels"]
    assert answered(session, "columns", columns=[])[0]["ok"]
    fits, curves = answered(session, "identify")
    assert len(fits["fits"]) == 4 and "Hz" in fits["fits"][0]["words"]
    assert curves["fitted 0"].shape == curves["fitted 1"].shape
    session.exact({"gain_crossover": None})
    assert answered(session, "arms", runs=200)[0]["ok"]
    session.keep()
    names = {path.name for path in Path("theirs").glob("*.*")} - {"report.html"}
    assert {path.name for path in Path("ours").glob("*.*")} == names
    differ = [
        n
        for n in sorted(names)
        if Path("ours", n).read_bytes() != Path("theirs", n).read_bytes()
    ]
    assert differ == []
    assert Path("ours/arms.npz").read_bytes() == Path("theirs/arms.npz").read_bytes()
    written = answered(session, "export", target="c")[0]["written"]
    assert main(["export", "c", "theirs/design.json", "--out", "firmware"]) == 0
    for path in Path("firmware").iterdir():
        assert path.read_bytes() == Path("ours/firmware", path.name).read_bytes()
    assert f"firmware/{path.name}" in written
    assert not answered(session, "export", target="c")[0]["ok"]
    # a folder that is opened again shows its last state
    again = opened(Path("ours"))
    assert again.study.verdict == session.study.verdict
    assert again.state["gain_crossover"] == pytest.approx(
        session.study.design.gain_crossover
    )


@pytest.mark.slow
def test_a_file_that_changed_outside_is_not_replaced_unasked(tmp_path):
    session = opened(None, out=tmp_path / "results")
    session.exact(ASKED)
    session.keep()
    session.keep()
    place = tmp_path / "results" / "design.json"
    place.write_text(place.read_text() + " ")
    with pytest.raises(FieldError, match=r"design\.json"):
        session.keep()
    session.keep(force=True)
    # not opened from this folder, so its contents belong to another session
    other = opened(None, out=tmp_path / "results")
    other.exact({**ASKED, "gain_crossover": 12.2})
    with pytest.raises(FieldError, match="already there"):
        other.keep()


@pytest.mark.slow
def test_what_spoke_for_another_design_does_not_stay_behind(tmp_path):
    folder = tmp_path / "results"
    session = opened(None, out=folder)
    session.exact(ASKED)
    session.keep()
    assert (folder / "run-20g.npz").exists()
    session.exact({**ASKED, "payloads": [0.022, 0.04]})
    assert "run-20g.npz" in session.keep().head["removed"]
    assert not (folder / "run-20g.npz").exists() and (folder / "run-22g.npz").exists()
    assert fl.trials.load_study(folder).verdict == session.study.verdict


@pytest.mark.slow
def test_a_newer_request_stops_the_older_one(tmp_path):
    session = opened(None, out=tmp_path)
    with pytest.raises(SupersededError):
        session.exact(ASKED, newer=lambda: True)
    assert session.study.design is None


@pytest.mark.slow
def test_a_log_that_is_read_while_a_design_is_made_is_not_lost(tmp_path):
    session = opened(None, out=tmp_path)

    def read() -> bool:
        if session.study.experiment is None:
            answered(session, "log", name="prbs_30g")
            answered(session, "columns", columns=[])
        return False

    with pytest.raises(SupersededError):
        session.exact(ASKED, newer=read)
    assert session.study.experiment is not None


@pytest.mark.slow
def test_a_refused_design_leaves_the_one_before(tmp_path):
    session = opened(None, out=tmp_path)
    session.exact(ASKED)
    with pytest.raises(FraclinkError):
        session.exact({**ASKED, "gain_crossover": 60.0})
    assert session.study.design.gain_crossover == 12.0


def test_a_history_survives_a_torn_line(tmp_path):
    history = History.of(tmp_path)
    for margin in (45.0, 50.0, 55.0):
        history.add({"phase_margin_deg": margin})
    history.go(1)
    with history.path.open("a") as file:
        file.write('{"at": 2, "sta')
    again = History.of(tmp_path)
    assert (again.at, again.state) == (1, {"phase_margin_deg": 50.0})
    assert (
        Session(fl.trials.Study(rig=fl.Rig.named("paper-2023")), tmp_path).state[
            "phase_margin_deg"
        ]
        == 50.0
    )
