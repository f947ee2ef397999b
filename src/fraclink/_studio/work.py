"""What takes seconds: fits, proof, arms, faults, in a process of their own that Cancel kills."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from threading import Lock
from typing import Any

from fraclink._campaign.campaign import load_campaign
from fraclink._campaign.faults import FaultTable
from fraclink._campaign.study import Study, load_study, save_study
from fraclink._show import tables
from fraclink._studio.logs import fit_answer
from fraclink._studio.messages import Reply
from fraclink._studio.session import Session
from fraclink._studio.swept import moves_of_arms, swept
from fraclink._validate import Between
from fraclink.errors import FieldError

__all__ = ["JOBS", "WORK_VERBS", "Job"]

# Verb -> (part of the study it needs, what it is asked for beside: name, range, default).
_Option = tuple[str, Between, float | None]
JOBS: dict[str, tuple[str, tuple[_Option, ...]]] = {
    "identify": ("experiment", (("heldout", Between(0.05, 0.9), None),)),
    "prove": ("law", ()),
    "arms": ("law", (("runs", Between(1, 20_000), 1000),)),
    "faults": ("law", ()),
}
_NEEDS = {"experiment": "read a log first (steps 1 and 2)", "law": "make a design first (step 4)"}


class Job:
    """One job of the page, on a copy of the study in a folder of its own."""

    def __init__(self, session: Session, verb: str, given: Mapping[str, Any]) -> None:
        self.session, self.verb, self.given = session, verb, given
        self.study = session.study
        self._process: subprocess.Popen[str] | None = None
        self._lock, self._cancelled = Lock(), False

    def cancel(self) -> None:
        """Kill the process; what it had not finished is lost, and nothing else."""
        with self._lock:
            self._cancelled = True
            if self._process is not None:
                self._process.kill()

    def done(self, tell: Callable[[Mapping[str, Any]], None]) -> Reply:
        """Run to the end, with every piece of progress handed to `tell`, and return the study's answer."""
        part, options = JOBS[self.verb]
        if getattr(self.study, part) is None:
            raise FieldError(part, None, "missing", allowed="a study with it", remedy=_NEEDS[part])
        asked = {name: _checked(name, bounds, self.given.get(name, usual)) for name, bounds, usual in options}
        place = Path(tempfile.mkdtemp(dir=self.session.draft))
        try:
            save_study(replace(self.study, arms=None), place)
            self._run(place, asked, tell)
            return self._taken(place, asked)
        finally:
            shutil.rmtree(place, ignore_errors=True)

    def _run(self, place: Path, asked: Mapping[str, Any], tell: Callable[[Mapping[str, Any]], None]) -> None:
        command = [sys.executable, "-m", "fraclink._studio.worker", str(place), self.verb, json.dumps(asked)]
        with self._lock:
            if self._cancelled:
                raise _cancelled(self.verb)
            self._process = subprocess.Popen(  # noqa: S603  # this interpreter, this package
                command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
            )
        with self._process as process:
            for line in process.stdout or ():
                tell(json.loads(line))
            code, said = process.wait(), (process.stderr.read() if process.stderr else "")
        if self._cancelled:
            raise _cancelled(self.verb)
        if code:
            why = said.strip().splitlines()[-1][:400] if said.strip() else f"ended with code {code}"
            allowed, remedy = "a job that ends", "see the message; the study is as it was"
            raise FieldError(self.verb, code, f"failed: {why}", allowed=allowed, remedy=remedy)

    def _taken(self, place: Path, asked: Mapping[str, Any]) -> Reply:
        """Take over what the job added, if the study is still the one that it began with."""
        found, session = load_study(place), self.session
        with session.lock:
            now = session.study
            another = self.verb != "identify" and now.design != self.study.design
            if another or now.experiment is not self.study.experiment:
                raise FieldError(
                    self.verb, "another design", "for a study that has changed meanwhile",
                    allowed="the study it began with", remedy="start it again",
                )  # fmt: skip
            if self.verb == "identify":
                session.heldout = asked["heldout"]
                session.become(replace(found, experiment=now.experiment, rig=now.rig))
            elif self.verb == "prove":
                certificate, why = found.certificate, found.uncertified
                session.become(replace(now, certificate=certificate, uncertified=why))
            elif self.verb == "arms":
                shutil.rmtree(session.draft / "arms", ignore_errors=True)
                shutil.move(place / "arms", session.draft / "arms")
                session.become(replace(now, arms=found.arms))
            else:
                session.become(replace(now, faults=found.faults))
        if self.verb == "identify":
            return fit_answer(session)
        return Reply({"ok": True, **session.overview(), **proof_of(session.study)})


def proof_of(study: Study) -> dict[str, Any]:
    """Return what step 6 shows: the statement that was proved, the spread of the arms, the faults."""
    found: dict[str, Any] = {}
    if study.certificate is not None:
        statement = study.certificate.statement
        found["proved"] = {
            "modulus": statement.modulus,
            "payloads": [
                1e3 * statement.payload_low,
                1e3 * statement.payload_high,
            ],  # [g], [ms]: its box on the map
            "delays": [1e3 * statement.delay_low, 1e3 * statement.delay_high],
            "text": study.certificate.verdict,
        }
    if study.arms is not None:
        spread = tables.spread_table(study.arms)
        found["spread"] = {"header": spread.header, "rows": spread.rows}
        failure = study.arms.failure
        found["failures"] = {"count": failure.count, "runs": failure.runs, "failed": study.arms.failed[:12]}
    if study.faults is not None:
        rows = tables.faults_table(study.faults)
        found["faults"] = {"header": rows.header, "rows": rows.shown}
        found["faults_said"] = tables.faults_sentence(study.faults)
        found["cells"] = _cells(study.faults)
    return found


def _cells(table: FaultTable) -> list[dict[str, Any]]:
    """One for each fault, severity and payload: its first run that failed, or one that passed."""
    found: dict[tuple[Any, ...], dict[str, Any]] = {}
    for outcome in table.outcomes:
        case = outcome.case
        key = (case.fault, case.severity, case.payload)
        if key not in found or (found[key]["passed"] and not outcome.passed):
            names = ("fault", "severity", "payload")
            found[key] = dict(zip(names, key, strict=True)) | {"phase": case.phase, "passed": outcome.passed}
    return list(found.values())


def _proof(session: Session, given: Mapping[str, Any]) -> Reply:
    """Everything that step 6 shows of the study as it stands."""
    study = session.study
    head: dict[str, Any] = {"ok": True, **proof_of(study)}
    if study.design is None or study.law is None:
        return Reply(head)
    near, curves = swept(study.design, study.law)
    kept = [place for place in (session.draft / "arms", session.folder / "arms") if place.is_dir()]
    if study.arms is not None and kept:
        curves |= moves_of_arms(load_campaign(kept[0]), study.arms.failed)
    return Reply(head | {"swept": near}, curves)


WORK_VERBS: dict[str, Callable[[Session, Mapping[str, Any]], Reply]] = {"proof": _proof}


def _checked(name: str, bounds: Between, value: object) -> Any:
    return None if value is None else bounds.check(name, value)


def _cancelled(verb: str) -> FieldError:
    allowed, remedy = "a job that ends", "start it again when you want it"
    return FieldError(verb, "cancelled", "stopped as you asked", allowed=allowed, remedy=remedy)
