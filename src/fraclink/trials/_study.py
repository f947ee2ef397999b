"""A study: everything computed from one log, its verdict, and its folder with one file
for each part:

rig.toml  log.npz  model.json  model-UD-IOM.json …  design.json  law.json
certificate.json  run-20g.npz …  arms.npz  faults.json  study.json
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from fraclink._arm.experiment import Experiment
from fraclink._arm.link import STRUCTURES
from fraclink._arm.rig import Rig
from fraclink._certify import Certificate
from fraclink._design import Design
from fraclink._display import Overview, Row, Table, displayed, number, quantity, rows_of
from fraclink._files import checked_path, document, kind_of, load, save
from fraclink._identify import Comparison, Fit
from fraclink._law import Law
from fraclink._simulate import Run
from fraclink.errors import FileFormatError
from fraclink.findings import Finding, Scope, Verdict
from fraclink.trials._faults import FaultTable
from fraclink.trials._summary import CampaignRuns

__all__ = ["Refusal", "Study", "load_study", "save_study"]

# Part with a file of its own next to study.json -> that file and its kind. The fits have
# one each.
_FILES = {
    "rig": ("rig.toml", "rig"),
    "experiment": ("log.npz", "log"),
    "design": ("design.json", "design"),
    "law": ("law.json", "law"),
    "certificate": ("certificate.json", "certificate"),
    "arms": ("arms.npz", "campaign-runs"),
    "faults": ("faults.json", "fault-campaign"),
}


@dataclass(frozen=True)
class Refusal:
    """A request that no controller meets, and the nearest feasible one, both as
    arguments of `design`.
    """

    asked: Mapping[str, Any]
    nearest: Mapping[str, float]


@displayed
@document("study", version=3)
@dataclass(frozen=True)
class Study:
    """The results from one log. Every part may be missing: a folder may hold only some
    of the files.

    rig, experiment, findings (of their examination); comparison of the structures; the
    fit that the design used; design, law and certificate; missing: why a part is not
    there, by its name ("design", "certificate", "twins", "arms"); refused: the request
    and the nearest that can be met, if the request ended the study; runs: simulated
    moves, one for each payload; twins: the same moves of the twin, under the law's own
    compensation, each without and with its payload told to the law; arms: the runs of
    varied arms; faults: a fault campaign; assumptions: sentences on everything that was
    not stated.

    >>> Study().verdict.state
    'not run'
    """

    rig: Rig | None = None
    experiment: Experiment | None = None
    findings: tuple[Finding, ...] = ()
    comparison: Comparison | None = None
    fit: Fit | None = None
    design: Design | None = None
    law: Law | None = None
    missing: Mapping[str, str] = field(default_factory=dict)
    refused: Refusal | None = None
    certificate: Certificate | None = None
    runs: tuple[Run, ...] = ()
    twins: tuple[Run, ...] = ()
    arms: CampaignRuns | None = None
    faults: FaultTable | None = None
    assumptions: tuple[str, ...] = ()

    @property
    def fits(self) -> Mapping[str, Fit]:
        """The fits by structure: all that were compared, or the one that there is."""
        if self.comparison is not None:
            return self.comparison.fits
        return {} if self.fit is None else {self.fit.structure: self.fit}

    @property
    def verdict(self) -> Verdict:
        """The verdict in four scopes."""
        # A design may be good while the log behind it is wrong: a reversed gauge fits
        # as well as a correct one.
        wrong = [("the log", finding) for finding in self.findings]
        wrong += [
            ("the model", finding)
            for finding in (self.fit.findings if self.fit else ())
        ]
        reported = {finding for _, finding in wrong}
        wrong += [
            ("the design", f)
            for f in (self.design.findings if self.design else ())
            if f not in reported
        ]
        # Errors only: a warning calls for a look, an error means that the numbers do
        # not describe the arm.
        doubts = [
            f"{what}: {f.message}. {f.remedy}"
            for what, f in wrong
            if f.severity == "error"
        ]
        return Verdict(
            _scope(self._broken_promises(), doubts, self.design is not None),
            _scope(
                [_failed_move(run) for run in self.runs if not run.verdict.passed],
                doubts,
                bool(self.runs),
            ),
            self._twin(doubts),
            remarks=("the log is simulated, not measured",) if self.simulated else (),
        )

    @property
    def sentence(self) -> str:
        """The decisive figures, first in every interface: payloads and speed, settling
        time, tolerated additional delay, and the tightest requirement.
        """
        if self.design is None:
            return self.missing.get("design", self.verdict.sentence)
        parts = self.design.sentence.split("; ")
        times = [run.metrics.settling_time for run in (*self.runs, *self.twins)]
        if times:
            longest = max(times)
            parts.insert(
                1,
                f"settles within {number(longest, 3)} s"
                if math.isfinite(longest)
                else "does not settle with every payload",
            )
        return "; ".join(parts)

    @property
    def rows(self) -> tuple[Row, ...]:
        """The handful of figures that a reader looks for first."""
        rows: list[Row] = []
        if self.fit is not None:
            rows.append(Row("", "Model", self.fit.overview().headline))
        if self.design is not None:
            c = self.design.controller
            late = f", δ = {quantity(c.filter_time, 'ms', 3)}" if c.filter_time else ""
            controller = f"k_d = {number(c.derivative_gain)}, β = {number(c.derivative_order)}{late}"
            rows.append(Row("", "Controller", controller))
        if self.certificate is not None:
            clearance = self.certificate.statement.clearance
            rows.append(Row("", "Proved for every arm of the box", clearance))
        if self.arms is not None:
            failure = self.arms.summary.failure
            count = f"{failure.runs - failure.count} of {failure.runs} passed"
            rows.append(Row("", "Varied arms", count))
        if self.faults is not None:
            rows.append(Row("", "Faults on the twin", self.faults.sentence))
        return tuple(rows)

    def overview(self) -> Overview:
        """The verdict in its scopes, the decisive figures, and the existing parts."""
        verdict = self.verdict
        parts = [
            stage.overview()
            for stage in (self.comparison, self.design)
            if stage is not None
        ]
        rows = rows_of(
            self,
            "verdict",
            Row("reasons", "", verdict.reasons),
            Row("fits", "", tuple(self.fits.values())),
            *("design", "runs", "assumptions"),
            Row("arms", "", self.arms and self.arms.summary),
        )
        tables = [table for part in parts for table in part.tables]
        if self.runs:
            tables.append(Table.of("", self.runs))
        notes = (note for part in parts for note in part.notes)
        return Overview(
            self.sentence,
            verdict.state,
            rows,
            tuple(
                replace(table, key="")
                for table in (*verdict.overview().tables, *tables)
            ),
            (*self.findings, *(self.design.findings if self.design else ())),
            (*verdict.remarks, *notes),
        )

    @property
    def simulated(self) -> bool:
        """Whether the log's own header says that it was simulated."""
        return self.experiment is not None and self.experiment.simulated

    def _broken_promises(self) -> list[str]:
        misses = [
            f"{item.name}: {quantity(item.achieved, item.unit)} instead of {quantity(item.wanted, item.unit)}"
            for item in (self.design.requirements if self.design else ())
            if not item.passed
        ]
        design, proof = map(self.missing.get, ("design", "certificate"))
        unproved = [f"not certified: {proof}"] if proof else []
        return ([design] if design else []) + misses + unproved

    def _twin(self, doubts: list[str]) -> Scope:
        ran = self.arms is not None or self.faults is not None
        # The twin alone contains no varied arms: it can refute a design, but not
        # confirm it.
        off = [
            f"twin: {_failed_move(run)}" for run in self.twins if not run.verdict.passed
        ]
        scope = _scope(off + self._failures(), doubts, ran)
        untried = filter(None, map(self.missing.get, ("twins", "arms")))
        return replace(scope, reasons=(*scope.reasons, *untried))

    def _failures(self) -> list[str]:
        sentences = []
        arms = self.arms.summary if self.arms else None
        if arms is not None and arms.failure.count:
            count, runs = arms.failure.count, arms.failure.runs
            settling = next(m for m in arms.metrics if m.name == "settling_time")
            # The first two: with a thousand runs, chance alone gives correlations of 3
            # %, which the third soon reaches.
            causes = " and ".join(
                name.replace("_", " ") for name, _ in settling.drivers[:2]
            )
            sentences.append(
                f"{count} of {runs} arms fail ({100 * count / runs:.1f} %); most depends on {causes}"
            )
        if self.faults is not None and not self.faults.passed:
            rows = self.faults.rows()
            sentences.append(
                f"{sum(not row.passed for row in rows)} of {len(rows)} faults miss their requirement"
            )
        return sentences


def _scope(failures: list[str], doubts: list[str], ran: bool) -> Scope:
    # Failed before doubtful: a run that missed a requirement is a fact, whatever is
    # wrong with the model.
    if failures:
        return Scope("failed", tuple(failures + doubts))
    if doubts:
        return Scope("not shown", tuple(doubts))
    return Scope("passed" if ran else "not run")


def _failed_move(run: Run) -> str:
    return f"move at {run.carried}: {run.verdict.reason}"


# --- a study as a folder --------------------------------------------------------------------------------


def save_study(study: Study, folder: Path | str) -> None:
    """Write every part of `study` to its file in `folder`; `load_study` reads them
    back.

    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> save_study(Study(rig=Rig.named("paper-2023")), folder)
    >>> sorted(path.name for path in folder.iterdir()), load_study(folder).rig.name
    (['rig.toml', 'study.json'], 'paper-2023')
    """
    place = checked_path("folder", folder)
    parts = {file: getattr(study, part) for part, (file, _) in _FILES.items()}
    for name, fit in study.fits.items():
        # The fit that the design used is model.json, so that commands that take a model
        # need no structure name.
        selected = study.fit is not None and fit.structure == study.fit.structure
        parts["model.json" if selected else f"model-{name}.json"] = fit
    parts |= {f"run-{1e3 * move.payload:.6g}g.npz": move for move in study.runs}
    parts |= {
        f"twin-{'told-' if move.about.get('payload_given') else ''}{1e3 * move.payload:.6g}g.npz": move
        for move in study.twins
    }
    for name, part in parts.items():
        # Missing parts leave no empty file: the files of a folder show what was done.
        if part is not None:
            save(part, place / name, force=True)
    elsewhere: dict[str, Any] = dict.fromkeys((*_FILES, "fit"))
    comparison = study.comparison
    if comparison is not None:
        # study.json holds the part of a comparison that its fits, which are separate
        # files, do not contain
        comparison = replace(comparison, fits={})
    about = replace(study, comparison=comparison, runs=(), twins=(), **elsewhere)
    save(about, place / "study.json", force=True)


def load_study(folder: Path | str) -> Study:
    """Read a folder that `fraclink run` or its single steps wrote, whatever its files
    are called.

    Raises FileFormatError where the folder holds no results of fraclink, or a file in
    it is damaged.
    """
    place = checked_path("folder", folder)
    if not place.is_dir():
        raise FileFormatError(
            "folder",
            str(place),
            "not a folder",
            "a folder of results",
            "check the path",
        )
    by_kind: dict[str, list[Path]] = {}
    for path in sorted(place.iterdir()):
        if path.suffix in (".toml", ".json", ".npz"):
            by_kind.setdefault(kind_of(path), []).append(path)
    # A certificate or a table of faults alone does not describe an arm.
    if not set(by_kind) & {"rig", "fit", "design", "run", "log"}:
        raise FileFormatError(
            "folder",
            str(place),
            "without results",
            "model, design or run files",
            "run `fraclink run` with --out in this folder",
        )
    return _gathered(place, by_kind)


def _gathered(place: Path, by_kind: Mapping[str, list[Path]]) -> Study:
    def first(kind: str) -> Any:
        return load(by_kind[kind][0]) if kind in by_kind else None

    about = first("study") or Study()
    parts = {part: first(kind) for part, (_, kind) in _FILES.items()}
    fits = {fit.structure: fit for fit in map(Fit.load, by_kind.get("fit", []))}
    runs = sorted(map(Run.load, by_kind.get("run", [])), key=lambda move: move.payload)
    design, certificate = parts["design"], parts["certificate"]
    missing = dict(about.missing)
    # A failed certificate is kept as a file; in the verdict it is a reason and not a
    # proof.
    if certificate is not None and not certificate.passed:
        missing["certificate"], parts["certificate"] = certificate.verdict, None
    # model.json has the shortest name: the fit that the design used.
    file = min(by_kind.get("fit", []), key=lambda path: len(path.name), default=None)
    comparison = about.comparison
    if comparison is not None:
        # A comparison of only some structures would prefer one that was never compared
        # with the others.
        whole = set(fits) == set(STRUCTURES)
        ordered = {name: fits[name] for name in STRUCTURES if name in fits}
        comparison = replace(comparison, fits=ordered) if whole else None
    if design is not None:
        parts["rig"] = parts["rig"] or design.rig
    return replace(
        about,
        **parts,
        comparison=comparison,
        fit=None if file is None else Fit.load(file),
        missing=missing,
        runs=tuple(move for move in runs if move.about.get("arm") != "twin"),
        twins=tuple(move for move in runs if move.about.get("arm") == "twin"),
    )
