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
from fraclink.studio import _logs as logs
from fraclink.studio import _server as server
from fraclink.studio import _serving as serving
from fraclink.studio import _work as work
from fraclink.studio._history import History
from fraclink.studio._messages import (
    checked_request,
    refusal,
    wanted_of,
)
from fraclink.studio._regions import (
    Region,
)
from fraclink.studio._session import Session, opened
from fraclink.trials._faults import Case, Check, FaultTable, Outcome

ASKED = {"gain_crossover": 12.0, "phase_margin_deg": 50.0, "payloads": [0.02, 0.04]}
RIG = fl.Rig.named("paper-2023")


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


# --- regions, map and fan -------------------------------------------------------------------------------


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
