"""Reports as single HTML files: no network requests, complete without scripts, all
external data escaped.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fraclink._design import Design
from fraclink._design.assess import phase_budget
from fraclink._display import Row, Table, number, source_name
from fraclink._files import write_text
from fraclink.errors import FieldError
from fraclink.trials._study import Study
from fraclink.view import _figures as figures
from fraclink.view import _loops as loops
from fraclink.view import _runs as runs
from fraclink.view import _tables as tables
from fraclink.view import _words as words
from fraclink.view._arm_box import arm_box
from fraclink.view._drawing import Figure
from fraclink.view._pages import rendered, scoped
from fraclink.view._sketches import arm_sketch
from fraclink.view._text import grams_between

__all__ = ["write_report"]

Figures = Table | tuple[Row, ...]


def write_report(study: Study, path: Path | str, *, script: bool = True) -> Path:
    """Write the report of `study` to `path`, in one step, and return the path; the same
    study gives the same bytes.

    With `script`, figures show their values under the pointer, and if the study has a
    design, the first figure is the moving arm, as in `write_arm_page`; without, the
    report contains no script at all.

    Raises MissingExtraError if jinja2 is not installed.

    >>> import tempfile
    >>> write_report(Study(), Path(tempfile.mkdtemp()) / "report.html").name
    'report.html'
    """
    name = study.rig.name if study.rig else "unnamed rig"
    source = source_name(study.experiment.source if study.experiment else "")
    verdict, design = study.verdict, study.design
    model = (
        design.model
        if design
        else study.fit.model
        if study.fit
        else study.rig.model
        if study.rig
        else None
    )
    # The moving arm needs a law: from the design, or from the study if the design has
    # none.
    moves = study.law is not None or (design is not None and design.has_law)
    drawings = {name: figure.inline() for name, figure in _figures(study).items()}
    text = rendered(
        "report.html",
        title=f"{name}: {source}",
        study=study,
        arm=arm_box(study, design) if script and design and moves else None,
        pointer=scoped("figures.js") if script else "",
        zone=grams_between(*design.payloads) if design else "",
        source=source,
        verdict=verdict,
        headline=study.sentence,
        in_short=(*study.rows, *_margin_rows(design)),
        tables=_tables(study),
        sketch=_inline(arm_sketch(words.sketch_notes(study.rig, model)))
        if study.rig
        else "",
        said=words.arm_sentences(study.rig, model) if study.rig else [],
        rig_findings=[
            finding for finding in study.findings if finding.code.startswith("W1")
        ],
        log_findings=[
            finding for finding in study.findings if not finding.code.startswith("W1")
        ],
        notes=study.comparison.overview().notes if study.comparison else (),
        figures=drawings,
        on_paper=[
            _copy(drawings[name]) for name in ("margins", "moves") if name in drawings
        ],
        steps=words.steps(study),
        power_on=words.power_on(design) if design else [],
        files=_files(study),
    )
    write_text(path, text)
    return Path(path)


def _margin_rows(design: Design | None) -> list[Row]:
    """A row with the least phase margin over all arms consistent with fit and rig."""
    band = design and loops.margin_band(design, np.array(design.payloads))
    label = "Phase margin of every arm consistent with fit and rig"
    return [Row("", label, f"at least {number(band[0].min(), 3)}°")] if band else []


def _inline(text: str) -> str:
    """A separate drawing without style and background, which the page provides."""
    # The page has these rules once; they would take 3 kB in every drawing.
    return (
        text[: text.index("<style>")]
        + text[text.index("/>", text.index("</style>")) + 2 :]
    )


def _copy(drawing: str) -> str:
    """A copy of a drawing for the first printed sheet, without the attributes for the
    pointer and for screen readers.
    """
    return re.sub(r' (?:id|role|aria-label|data-[\w-]+)="[^"]*"', "", drawing)


def _files(study: Study) -> list[tuple[str, str]]:
    """The files of the folder that belong to this study."""
    parts = (
        ("rig.toml", "the rig", study.rig),
        ("model.json", "the model that the design uses", study.fit),
        ("design.json", "request, controller, requirements", study.design),
        ("law.json", "coefficients of the law that is shipped", study.law),
        ("certificate.json", "the proof", study.certificate),
        ("faults.json", "the fault campaign", study.faults),
    )
    return [(name, what) for name, what, part in parts if part is not None]


def _tables(study: Study) -> Mapping[str, Figures]:
    """The tables of the sections that this study has."""
    sections: dict[str, Figures] = {}
    if study.rig is not None:
        sections["rig"] = study.rig.overview().rows
    if study.experiment is not None:
        sections["log"] = study.experiment.overview().rows
    if study.comparison is not None:
        sections["models"] = study.comparison.table
    elif study.fit is not None:
        sections["models"] = study.fit.rows
    if study.design is not None:
        payloads = [
            loops.LIGHTER * study.design.payloads[0],
            *loops.payloads_of(study.design),
        ]
        of_law = () if study.law is None else study.law.overview().rows
        sections["controller"] = (*study.design.overview().rows, *of_law)
        (sections["requirements"],) = study.design.overview().tables
        sections["margins"] = tables.margins_table(study.design, payloads)
        sections["budget"] = _budget(study.design)
    if study.runs:
        sections["moves"] = Table.of("", study.runs)
    if study.arms is not None:
        (sections["arms"],) = study.arms.summary.overview().tables
    if study.faults is not None:
        (sections["faults"],) = study.faults.overview().tables
    return sections


def _figures(study: Study) -> dict[str, Figure]:
    log, fit, design = study.experiment, study.fit, study.design
    drawings: dict[str, Figure | None] = {}
    if log is not None:
        drawings["log"] = figures.log_figure(log)
    if fit is not None:
        drawings["detail"] = figures.detail_figure(fit)
        drawings["residual"] = figures.residual_figure(fit)
        # A tuning keeps its whole record and fits only a part of it.
        drawings["response"] = (
            figures.response_figure(log, fit)
            if log is not None and log.output.size == fit.predicted.size
            else None
        )
    if study.fits:
        drawings["models"] = figures.models_figure(
            study.fits, fit.structure if fit else None
        )
    if design is not None:
        proved = study.certificate.statement.modulus if study.certificate else None
        drawings["bode"] = loops.bode_figure(design)
        drawings["nyquist"] = loops.nyquist_figure(design, proved)
        drawings["margins"] = loops.margins_figure(design)
    if study.runs:
        drawings["moves"] = runs.moves_figure(study.runs)
    return {name: figure for name, figure in drawings.items() if figure is not None}


def _budget(design: Design) -> Figures:
    payload = design.payloads[0]
    try:
        return tables.budget_table(phase_budget(design, payload), payload)
    except FieldError:  # a loop without crossings has no phase budget
        return ()
