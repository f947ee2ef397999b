"""The answers of the studio, checked number by number: requests, states, messages,
pictures, files, and refusals.
"""

from __future__ import annotations

import asyncio
import socket
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from starlette.testclient import TestClient

import fraclink as fl
from fraclink.errors import (
    FieldError,
    FraclinkError,
)
from fraclink.studio import _logs as logs
from fraclink.studio import _server as server
from fraclink.studio import _serving as serving
from fraclink.studio import _work as work
from fraclink.studio._session import Session, opened
from fraclink.trials import Case, Check, FaultTable, Outcome

ASKED = {"gain_crossover": 12.0, "phase_margin_deg": 50.0, "payloads": [0.02, 0.04]}
RIG = fl.Rig.named("paper-2023")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Session:
    """A session with a design."""
    found = opened(None, rig=RIG, out=tmp_path_factory.mktemp("made") / "results")
    with pytest.MonkeyPatch.context() as patched:
        # its engine takes a second to compress
        patched.setattr(Session, "arm", lambda self, known="": {})
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


def test_every_column_of_a_log_has_units_to_choose_from(fitted: Session) -> None:
    units = logs.LOG_VERBS["log"](fitted, {}).head["units"]
    for role, first in (("motor_angle", "rad"), ("deflection", "rad"), ("time", "s")):
        # The one in SI is what a column takes that states none.
        assert units[role][0] == first


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
    with pytest.raises(FraclinkError, match="law"):  # neither a design nor a model
        opened(tmp_path / "law.json", out=tmp_path / "r")
    # the link of a frequency response or a transfer function: the rig becomes its rig
    link = fl.LinkModel(1.5, 9.5, 1.9, payload=0.03)
    fl.save(link, tmp_path / "model.json")
    of_model = opened(tmp_path / "model.json", rig=other, out=tmp_path / "r")
    assert of_model.study.rig == replace(other, model=link)
    of_model.study.rig.save(tmp_path / "rig.toml")
    assert opened(tmp_path / "rig.toml").study.rig == of_model.study.rig
    of_log = opened(Path(fl.bundled_log("prbs_30g")), out=tmp_path / "r")
    assert of_log.source == Path(fl.bundled_log("prbs_30g")) and of_log.study.rig == RIG
    assert opened(None).study.rig == RIG and opened(None).folder == Path("results")
    assert opened(None, rig=other).study.rig is other
    fl.save(design, tmp_path / "of" / "design.json")
    assert opened(tmp_path / "of", rig=other).study.rig is other
    assert opened(tmp_path / "of").folder == tmp_path / "of"


# --- jobs -----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_job_that_is_cancelled_or_fails_leaves_the_study(
    made: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = work.Job(made, "prove", {})
    job.cancel()
    with pytest.raises(FraclinkError, match="Cancelled"):
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
    proved = replace(made.study, missing={"certificate": "because of 8 g"})
    monkeypatch.setattr(work, "load_study", lambda place: proved)
    answer = work.Job(own, "prove", {}).done(lambda progress: None)
    assert (
        own.study.missing == {"certificate": "because of 8 g"}
        and own.study.design is made.study.design
    )
    assert (
        answer.head["ok"] and answer.head["proof_said"] == "Not proved: because of 8 g"
    )
    monkeypatch.setattr(
        work, "load_study", lambda place: replace(made.study, faults=table())
    )
    answer = work.Job(own, "faults", {}).done(lambda progress: None)
    assert own.study.faults == table() and own.study.missing == {
        "certificate": "because of 8 g"
    }
    assert answer.head["faults_said"].startswith("1 of 2 faults")
    job = work.Job(own, "faults", {})
    own.become(
        replace(own.study, design=replace(made.study.design, gain_crossover=12.5))
    )
    with pytest.raises(FieldError, match="changed in the meantime"):
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
    assert answer.head["name"] == "paper-2023-geared" == own.study.rig.name
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
    assert logs.LOG_VERBS["rig"](bare_, {"name": "upload"}).head["name"] == "mine"
    # the model of a file replaces that of the rig, and of a fit the log too
    own.upload = tmp_path / "model.json"
    fl.save(fitted.study.fit, own.upload)
    logs.LOG_VERBS["rig"](own, {"name": "upload"})
    assert own.study.fit == fitted.study.fit and own.study.experiment is None
    assert own.subject.model == fitted.study.fit.loop_model(own.study.rig)


# --- server ---------------------------------------------------------------------------------------------


def test_a_port_that_is_taken_is_named() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(FieldError, match=f"port: .*127.0.0.1:{port}") as why:
            serving._listening(port)
        assert why.value.allowed == "a free port of this machine"
    listener = serving._listening(0)
    assert listener.getsockname()[1] > 0
    # it is already listening
    with socket.create_connection(listener.getsockname(), timeout=5):
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
    monkeypatch.setattr("fraclink._reading.table.FILE_LIMIT", 10)
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
    assert refused.status_code == 413 and "too large" in refused.text
    assert not (studio.session.draft / "upload" / "b.csv").exists()


@pytest.mark.slow
def test_a_session_that_cannot_be_opened_is_failed() -> None:
    def refused() -> Session:
        raise FieldError("place", "x", "missing", allowed="a folder", remedy="name one")

    failing = server.Studio(refused)
    with pytest.raises(FieldError, match="place"):
        _ = failing.session
    assert failing.failed
