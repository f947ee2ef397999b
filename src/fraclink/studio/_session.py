"""An open study: the state shown in the page, and its saved state."""

from __future__ import annotations

import hashlib
import math
import shutil
import tempfile
import weakref
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from threading import Lock
from typing import Any

from fraclink._arm.draft import doubts_of
from fraclink._arm.experiment import Experiment
from fraclink._arm.link import LinkModel
from fraclink._arm.rig import Rig
from fraclink._design import Design
from fraclink._display import Table, marked, state_of
from fraclink._files import load
from fraclink._identify import Fit
from fraclink._law import Law
from fraclink.errors import FieldError, required
from fraclink.findings import Finding, errors_of
from fraclink.studio._copied import copies
from fraclink.studio._history import History
from fraclink.studio._messages import Reply, checked_request, wanted_of
from fraclink.studio._preview import Subject, blocks_of
from fraclink.trials._stages import designed, moved, subject
from fraclink.trials._study import Study, load_study, save_study
from fraclink.view._arm_box import arm_box
from fraclink.view._text import grid_of, sentence

__all__ = ["Session", "SupersededError", "bare", "begun", "opened"]

# Files of a study that become invalid with another design or other fits.
_OUTDATED = (
    "run-*g.npz",
    "twin-*g.npz",
    "certificate.json",
    "arms.npz",
    "faults.json",
    "model-*.json",
)


class SupersededError(Exception):
    """A newer request has made this one pointless."""


# Answered in order, in a thread: session and the values from the page -> answer.
Verb = Callable[["Session", Mapping[str, Any]], Reply]


class Session:
    """A study in memory, the folder that Keep writes it to, and the states that led to
    it.

    `draft` is a folder for unsaved files, which `close` removes; `source` is the log's
    file, `upload` the last file that the page sent.
    """

    def __init__(
        self,
        study: Study,
        folder: Path,
        *,
        kept: bool = False,
        source: Path | None = None,
    ) -> None:
        self.draft = Path(tempfile.mkdtemp(prefix="fraclink-studio-"))
        # Also at interpreter exit, for a session that was not closed: the draft
        # contains a user's log.
        self.close = weakref.finalize(
            self, shutil.rmtree, self.draft, ignore_errors=True
        )
        self.study, self.folder, self.source = study, folder, source
        self.upload: Path | None = None
        # Values that a copied command repeats: statements of columns, payload [kg],
        # stretch [s], held-out share.
        self.columns: tuple[str, ...] = ()
        self.payload: float | None = None
        self.stretch: tuple[float, float] | None = None
        # the log from which `stretch` was cut: the page shows all of it
        self.whole: Experiment | None = None
        self.heldout: float | None = None
        # The exported files with their sizes [B], and the design from which they were
        # made.
        self.written: dict[str, int] = {}
        self.exported: Design | None = None
        self.lock = Lock()
        self._kept = _digests(folder) if kept else {}
        self.history = History.of(folder)
        self.subject = _subject_of(study)
        # The request of the study's design: if it is repeated, the design is kept.
        self.asked: dict[str, Any] | None
        self.state = self._first_state()

    def _first_state(self) -> dict[str, Any]:
        """The last state of the history; without one, the request of the study's design,
        or that of the rig.
        """
        self.asked = None
        try:
            if self.history.state is not None:
                return checked_request(self.history.state)
        except FieldError:  # a state of another release, or edited by hand
            self.history.states, self.history.at = [], -1
        design, rig = self.study.design, self.study.rig
        values: dict[str, Any] = {}
        if design is not None:
            values = {
                "payloads": design.payloads,
                "box": design.box is not None,
                "gain_crossover": design.gain_crossover,
                "phase_margin_deg": round(math.degrees(design.phase_margin), 9),
            }
        elif rig is not None:
            values["payloads"] = (rig.payloads.low, rig.payloads.high)
            if rig.design is not None:
                values["gain_crossover"] = rig.design.gain_crossover
                values["phase_margin_deg"] = rig.design.phase_margin_deg
        request = checked_request(values)
        self.asked = request if design is not None else None
        return request

    def become(self, study: Study) -> None:
        """Show another study, whose rig and link may differ."""
        self.study, self.subject = study, _subject_of(study)

    @property
    def axes(self) -> dict[str, Any]:
        """The axes of the study's plots; none without a rig and a link."""
        return self.subject.axes() if self.subject else {}

    def shippable(self) -> tuple[Design, Law]:
        """The study's design and law; FieldError without them."""
        allowed, remedy = "a study with a design", "make one in step 4"
        design = required("design", self.study.design, allowed, remedy)
        law = required("law", self.study.law, allowed, remedy)
        return design, law

    def renew(self) -> None:
        """Begin a new history for another rig, which may not support the states of the
        old one.
        """
        self.history.states, self.history.at = [], -1
        self.state = self._first_state()

    # ---- the exact design ---------------------------------------------------------------------------------

    def exact(
        self,
        state: object,
        arm_key: object = "",
        newer: Callable[[], bool] = lambda: False,
    ) -> Reply:
        """Compute the design of `state` as `fraclink design` does, its law and its
        moves, and store them in the study.

        `newer` tells whether a newer request has arrived: SupersededError is then
        raised.
        """
        request, before = checked_request(state), self.study
        if before.runs and request == self.asked:
            return Reply(self._answer(arm_key))
        study = designed(bare(before), **wanted_of(request))
        if newer():
            raise SupersededError
        # The moves come last: a request that is already outdated does without them.
        study = moved(study)
        with self.lock:
            # Compared by identity: an equal log that was read again is a different one,
            # whose findings may differ. The page may have read a log in the meantime.
            if newer() or any(
                getattr(self.study, name) is not getattr(before, name)
                for name in ("rig", "experiment", "fit")
            ):
                raise SupersededError
            # If a handle returns to the same position nothing is lost: proof, arms and
            # faults still apply.
            same = before.design == study.design
            if same:
                parts = ("certificate", "missing", "arms", "faults")
                study = replace(
                    study, **{name: getattr(before, name) for name in parts}
                )
            self.state = self.asked = request
            self.become(study)
        return Reply(self._answer(arm_key))

    def _answer(self, arm_key: object) -> dict[str, Any]:
        """The answer about the study's design."""
        return {"preview": False, **self.overview(), **self.arm(arm_key)}

    def arm(self, known: object = "") -> dict[str, Any]:
        """The data of the engine in the page; only the key of the arm, and its law, if
        the page already has the arm.
        """
        design, law = self.study.design, self.study.law
        if design is None or law is None:
            return {"arm_key": "", "arm": None}
        # The data of the page's engine, 100 kB, are sent only if one of these has
        # changed. The law, which changes during a drag, is sent separately.
        whole = repr((design.model, design.rig, design.payloads)).encode()
        key = hashlib.sha256(whole).hexdigest()[:16]
        if known == key:
            return {"arm_key": key, "blocks": blocks_of(law)}
        box = arm_box(self.study, design)
        return {"arm_key": key, "arm": None if box is None else box.data}

    def doubts(self, request: Mapping[str, Any]) -> tuple[Finding, ...]:
        """The errors of rig, link and payloads of a request, known before any search."""
        if self.subject is None:
            return ()
        payloads = request["payloads"] or ()
        return doubts_of(self.subject.rig, self.subject.model, payloads)

    # ---- what the page shows ------------------------------------------------------------------------------

    def overview(self) -> dict[str, Any]:
        """Verdict, marks of the steps, tables and commands of the present study."""
        study, verdict = self.study, self.study.verdict
        design = study.design
        return {
            "name": study.rig.name if study.rig else "",
            "folder": str(self.folder),
            "of": self.subject.key if self.subject else "",
            "title": " · ".join([*([study.rig.name] if study.rig else []), str(self.folder)]),
            "spoken": verdict.sentence,
            "doubts": self.doubts(self.state),
            "verdict": grid_of(verdict.overview().tables[0]).lines,
            "marks": {step: [marked(mark)[0], mark] for step, mark in self.marks().items()},
            "design": None if design is None else {
                "requirements": grid_of(
                    design.overview().tables[0].columns("requirement", "required", "achieved", "verdict")
                ),
                "findings": design.findings,
                "moves": grid_of(Table.of("", study.runs)),
                "passed": design.passed,
            },
            "certificate": study.certificate is not None,
            "proof_said": self._proof_said(),
            "files": self.written,
            "board_said": f"Outdated: {self.folder} holds the files of another design."
            if self.written and not self.current
            else f"Written to {self.folder}." if self.written
            else "Nothing written yet." if design else "Make a design first (step 4).",
            "copies": copies(self),
        }  # fmt: skip

    def _proof_said(self) -> str:
        study = self.study
        if study.certificate is not None:
            return sentence(study.certificate.sentence)
        why = study.missing.get("certificate")
        return f"Not proved: {why}" if why else ""

    def marks(self) -> dict[str, str]:
        """The state of each step, as words of a verdict."""
        study, verdict = self.study, self.study.verdict
        proof = (
            "passed"
            if study.certificate
            else "failed"
            if "certificate" in study.missing
            else "not run"
        )
        return {
            "log": "not run"
            if study.experiment is None
            else "failed"
            if errors_of(study.findings)
            else "passed",
            "channels": "not run" if study.experiment is None else "passed",
            "model": "not run" if study.fit is None else state_of(study.fit.passed),
            "design": verdict.promise.state,
            "move": verdict.model.state,
            "proof": "failed" if "failed" in (proof, verdict.twin.state) else proof,
            "board": "not run"
            if not self.written
            else "passed"
            if self.current
            else "outdated",
        }

    @property
    def current(self) -> bool:
        """Whether the exported files are of the present design."""
        return self.exported == self.study.design

    # ---- what is kept -------------------------------------------------------------------------------------

    def keep(self, *, force: bool = False) -> Reply:
        """Write the study to its folder by the functions of the command line.

        Raises FieldError if a file there is not the one that was read or kept, unless
        `force` is given.
        """
        # Written to the draft first, which shows the files that Keep would write.
        trial = self.draft / "keep"
        shutil.rmtree(trial, ignore_errors=True)
        save_study(self.study, trial)
        names = {path.name for path in trial.iterdir()}
        there = _digests(self.folder)
        # A file belongs to the session if its digest is that of a file read or kept:
        # times and sizes are unreliable.
        changed = sorted(
            n
            for n in names | set(self._kept)
            if n in there and there[n] != self._kept.get(n)
        )
        if changed and not force:
            raise FieldError(
                "folder",
                ", ".join(changed),
                "already there, or changed since it was read",
                "files that this studio wrote or read",
                "replace them, or open the folder again",
            )
        self.folder.mkdir(parents=True, exist_ok=True)
        save_study(self.study, self.folder)
        removed = self._remove_outdated(names)
        self._kept = _digests(self.folder)
        return Reply({"kept": sorted(names), "removed": removed, **self.overview()})

    def _remove_outdated(self, names: set[str]) -> list[str]:
        """Remove the results of the previously kept design, which would be taken for
        those of this one.
        """
        # Only files that this session read or kept: other files in the folder belong to
        # the user.
        gone = [
            path
            for pattern in _OUTDATED
            for path in self.folder.glob(pattern)
            if path.name in self._kept and path.name not in names
        ]
        for path in gone:
            path.unlink()
        return [path.name for path in gone]


def opened(
    place: Path | None, *, rig: Rig | None = None, out: Path = Path("results")
) -> Session:
    """Return the session for a folder of results, a log, a design, a model, or a rig.

    Raises the errors of reading the file.
    """
    if place is not None and place.is_dir():
        study = load_study(place)
        return Session(
            study if rig is None else replace(study, rig=rig), place, kept=True
        )
    if place is not None and place.suffix in (".json", ".toml"):
        return Session(begun(place, rig), out)
    return Session(Study(rig=rig or Rig.named("paper-2023")), out, source=place)


def begun(path: Path, rig: Rig | None = None) -> Study:
    """Return the study that begins with a rig, a design or a model.

    A model may come from any `identify`: from a log, a frequency response, or a
    transfer function brought into the form of a link.
    """
    if path.suffix == ".toml":
        rig = Rig.load(path)
        return Study(rig=rig, assumptions=rig.assumptions)
    content: Any = load(path, (Design, Fit, LinkModel))
    if isinstance(content, Design):
        return Study(rig=rig or content.rig, design=content, law=content.law())
    rig = rig or Rig.named("paper-2023")
    if isinstance(content, Fit):
        return Study(rig=rig, fit=content, assumptions=rig.assumptions)
    return Study(rig=replace(rig, model=content), assumptions=rig.assumptions)


def bare(study: Study) -> Study:
    """Return the study without its design and all results based on it."""
    kept = ("rig", "experiment", "findings", "comparison", "fit")
    return Study(
        **{name: getattr(study, name) for name in kept},
        assumptions=study.rig.assumptions if study.rig else (),
    )


def _subject_of(study: Study) -> Subject | None:
    try:
        rig, model, _ = subject(study)
    except FieldError:
        return None
    return Subject(rig, model, study.law)


def _digests(folder: Path) -> dict[str, str]:
    """SHA-256 of every file of a study in `folder`, by name."""
    if not folder.is_dir():
        return {}
    return {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.iterdir())
        if path.suffix in (".json", ".npz", ".toml")
    }
