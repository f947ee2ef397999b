"""A study as a folder of files, one for each noun, and back.

    rig.toml  log.npz  model.json  model-UD-IOM.json …  design.json  law.json  run-20g.npz …  faults.json
    study.json

Any of them may be missing, and the files that single stages wrote count whatever they are called: what a
file is stands in its envelope.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fraclink._files import read_json, write_json
from fraclink._npz import kind_of
from fraclink._workflow.log_file import load_log, save_log
from fraclink._workflow.nouns import Study
from fraclink.errors import FileFormatError
from fraclink.findings import Finding

if TYPE_CHECKING:
    from fraclink._identify import Comparison, Fit

__all__ = ["load_study", "save_study"]

_KIND, _VERSION = "study", 1


def run_name(payload: float) -> str:
    """The file of a run at `payload` [kg].

    >>> run_name(0.0305)
    'run-30.5g.npz'
    """
    return f"run-{1e3 * payload:.6g}g.npz"


def save_study(study: Study, folder: Path | str) -> None:
    """Write every part of `study` to its file in `folder`; `load_study` reads them back.

    >>> import tempfile
    >>> from fraclink._arm.rig import Rig
    >>> folder = Path(tempfile.mkdtemp())
    >>> save_study(Study(rig=Rig.named("paper-2023")), folder)
    >>> sorted(path.name for path in folder.iterdir()), load_study(folder).rig.name
    (['rig.toml', 'study.json'], 'paper-2023')
    """
    place = Path(folder)
    if study.rig is not None:
        study.rig.save(place / "rig.toml")
    if study.experiment is not None:
        save_log(study.experiment, place / "log.npz")
    for name, fit in study.fits.items():
        chosen = study.fit is not None and fit.structure == study.fit.structure
        fit.save(place / ("model.json" if chosen else f"model-{name}.json"))
    if study.design is not None:
        study.design.save(place / "design.json")
    if study.law is not None:
        study.law.save(place / "law.json")
    if study.certificate is not None:
        study.certificate.save(place / "certificate.json")
    for run in study.runs:
        run.save(place / run_name(run.payload))
    if study.faults is not None:
        study.faults.save(place / "faults.json")
    write_json(place / "study.json", _KIND, _VERSION, _summary(study))


def _summary(study: Study) -> dict[str, Any]:
    comparison = study.comparison
    return {
        "structure": study.fit.structure if study.fit else None,
        "infeasible": study.infeasible,
        "uncertified": study.uncertified,
        "assumptions": list(study.assumptions),
        "findings": [
            {"code": f.code, "severity": f.severity, "message": f.message, "remedy": f.remedy}
            | {"evidence": dict(f.evidence)}
            for f in study.findings
        ],
        "comparison": None
        if comparison is None
        else {
            "preferred": comparison.preferred,
            "contest": asdict(comparison.contest),
            "verdict": comparison.verdict,
        },
    }


def load_study(folder: Path | str) -> Study:
    """Read a folder that `fraclink run` or the single stages wrote.

    Raises FileFormatError where the folder holds nothing of fraclink, or a file in it is damaged.
    """
    place = Path(folder)
    if not place.is_dir():
        raise FileFormatError(
            "folder", str(place), "not a folder", allowed="a folder of results", remedy="check the path"
        )
    by_kind: dict[str, list[Path]] = {}
    for path in sorted(place.iterdir()):
        by_kind.setdefault(_kind(path), []).append(path)
    if not set(by_kind) & {"rig", "fit", "design", "run", "log"}:
        raise FileFormatError(
            "folder",
            str(place),
            "without results",
            allowed="model, design or run files",
            remedy="run `fraclink run` or its stages with --out in this folder",
        )
    return _gathered(by_kind)


def _kind(path: Path) -> str:
    """What a file holds, by its envelope; an empty text for anything foreign."""
    if path.suffix == ".toml":
        return "rig"
    if path.suffix == ".npz":
        return kind_of(path) or "run"  # what is damaged is told when it is read
    if path.suffix != ".json":
        return ""
    with path.open("rb") as stream:
        found = re.match(rb'\s*\{\s*"fraclink":\s*"([\w-]+)"', stream.read(200))
    return found.group(1).decode() if found else ""


def _gathered(by_kind: Mapping[str, list[Path]]) -> Study:
    from fraclink._arm.rig import Rig
    from fraclink._campaign.faults import FaultTable
    from fraclink._certify import Certificate
    from fraclink._design import Design
    from fraclink._identify import Fit
    from fraclink._law import Law
    from fraclink._simulate import Run

    def first(kind: str) -> Path | None:
        return by_kind.get(kind, [None])[0]

    rig, log, design_file, law, about = (first(kind) for kind in ("rig", "log", "design", "law", "study"))
    proof, faults = first("certificate"), first("fault-campaign")
    fits = {fit.structure: fit for fit in map(Fit.load, by_kind.get("fit", []))}
    told = read_json(about, _KIND, (_VERSION,)) if about else {}
    certificate = Certificate.load(proof) if proof else None
    proved = certificate is not None and certificate.passed
    design = Design.load(design_file) if design_file else None
    runs = sorted((Run.load(path) for path in by_kind.get("run", [])), key=lambda run: run.payload)
    chosen = told.get("structure") or next(iter(fits), None)
    return Study(
        rig=Rig.load(rig) if rig else design.rig if design else None,
        experiment=load_log(log) if log else None,
        findings=tuple(Finding(**item) for item in told.get("findings", [])),
        comparison=_comparison(fits, told.get("comparison")),
        fit=fits.get(str(chosen)),
        design=design,
        law=Law.load(law) if law else None,
        infeasible=told.get("infeasible"),
        certificate=certificate if proved else None,
        uncertified=told.get("uncertified") if proved or certificate is None else certificate.verdict,
        runs=tuple(runs),
        assumptions=tuple(told.get("assumptions", ())),
        faults=FaultTable.load(faults) if faults else None,
    )


def _comparison(fits: dict[str, Fit], told: dict[str, Any] | None) -> Comparison | None:
    from fraclink._arm.link import STRUCTURES
    from fraclink._identify import Comparison, Contest

    if told is None or set(fits) != set(STRUCTURES):
        return None
    ordered = {name: fits[name] for name in STRUCTURES}
    return Comparison(ordered, {}, told["preferred"], Contest(**told["contest"]), told["verdict"])
