"""Reports as one HTML file each: no request, no script but the arm's, whatever files hold is escaped."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from fraclink._campaign import Campaign, Summary, columns
from fraclink._campaign.faults import fault_named
from fraclink._design import Design
from fraclink._files import write_text
from fraclink._show import figures, tables
from fraclink._show.arm_box import arm_box
from fraclink._show.drawing import load_matplotlib
from fraclink._show.pages import rendered
from fraclink._show.text import Table, number
from fraclink._workflow import Study

__all__ = ["render_report", "write_campaign_report", "write_report"]

_PAYLOADS = 15  # of the arm that moves: 40 kB of a report of 700
_BEYOND = 0.4  # margins are tabulated at this share of the lightest payload too: 8 g for 20 g


def write_report(study: Study, path: Path | str, *, title: str | None = None, script: bool = True) -> Path:
    """Write the report of `study` to `path`, in one step, and return the path.

    With `script`, and where the study has a design, its first figure is the arm that moves, as in
    `write_arm_page`; without, the report holds no script at all.

    Raises MissingExtraError where matplotlib or jinja2 are not installed.

    >>> import tempfile
    >>> write_report(Study(), Path(tempfile.mkdtemp()) / "report.html").name
    'report.html'
    """
    write_text(path, render_report(study, title=title, script=script))
    return Path(path)


def render_report(study: Study, *, title: str | None = None, script: bool = True) -> str:
    """Return the report of `study` as HTML; the same study gives the same bytes.

    >>> "Content-Security-Policy" in render_report(Study(), title="<script>")
    True
    """
    name = study.rig.name if study.rig else "unnamed rig"
    source = tables.source_name(study.experiment)
    verdict, design = study.verdict, study.design
    return _rendered(
        "report.html",
        title=title or f"{name}: {source}",
        study=study,
        arm=arm_box(study, design, payloads=_PAYLOADS) if script and design else None,
        zone=_zone(design),
        source=source,
        verdict=verdict,
        headline=tables.verdict_sentence(verdict),
        scopes=tables.scopes(verdict),
        in_short=tables.summary_rows(study),
        tables=_tables(study),
        rig_findings=[finding for finding in study.findings if finding.code.startswith("W1")],
        log_findings=[finding for finding in study.findings if not finding.code.startswith("W1")],
        coincidence=tables.coincidence(study.fits),
        fault_notes=_fault_notes(study),
        figures=_figures(study),
    )


def _zone(design: Design | None) -> str:
    low, high = design.payloads if design else (0.0, 0.0)
    return f"{number(1e3 * low)} to {number(1e3 * high)} g"


def _tables(study: Study) -> Mapping[str, Table]:
    """The tables of the sections that there are."""
    found: dict[str, Table] = {}
    if study.rig is not None:
        found["rig"] = tables.rig_table(study.rig)
    if study.experiment is not None:
        found["log"] = tables.log_table(study.experiment)
    if study.fits:
        found["models"] = tables.fits_table(study.fits)
    if study.design is not None:
        payloads = [_BEYOND * study.design.payloads[0], *figures.payloads_of(study.design)]
        found["controller"] = tables.controller_table(study.design, study.law)
        found["requirements"] = tables.requirements_table(study.design.requirements)
        found["margins"] = tables.margins_table(study.design, payloads)
    if study.runs:
        found["moves"] = tables.moves_table(study.runs)
    if study.arms is not None:
        found["arms"] = tables.spread_table(study.arms)
    if study.faults is not None:
        found["faults"] = tables.faults_table(study.faults)
    return found


def _fault_notes(study: Study) -> list[tuple[str, str]]:
    """What a fault campaign cannot show of a fault: its number and a sentence."""
    rows = study.faults.rows() if study.faults is not None else ()
    notes = ((row.number, fault_named(row.number).note) for row in rows)
    return [(number, note) for number, note in notes if note]


def _figures(study: Study) -> dict[str, str]:
    drawn: dict[str, str] = {}
    if study.experiment is not None:
        drawn["log"] = figures.log_figure(study.experiment)
    if study.fits:
        drawn["models"] = figures.models_figure(study.fits)
    if study.design is not None:
        drawn["bode"] = figures.bode_figure(study.design)
        drawn["nyquist"] = figures.nyquist_figure(study.design)
        drawn["margins"] = figures.margins_figure(study.design)
    if study.runs:
        drawn["moves"] = figures.moves_figure(study.runs)
    return drawn


def _rendered(template: str, **contents: object) -> str:
    load_matplotlib()  # a page without its figures is not written
    return rendered(template, **contents)


def write_campaign_report(campaign: Campaign, folder: Path | str, summary: Summary, path: Path | str) -> Path:
    """Write histograms, failure map, drivers and worst cases of a campaign to `path`; return it.

    Raises MissingExtraError where matplotlib or jinja2 are not installed.
    """
    names = list(figures.SHOWN)
    payload, offset, passed, *values = columns(campaign, folder, "payload", "gauge_offset", "passed", *names)
    failed = ~passed.astype(bool)
    axes = ("payload [g]", "gauge offset [N·m]")
    worst = tuple(
        (m.name.replace("_", " "), f"{value:.4g}", f"fraclink campaign replay {folder} --run {run}")
        for m in summary.metrics
        for run, value in m.worst[:2]
        if m.name != "saturated"
    )
    text = _rendered(
        "campaign.html",
        title=f"Campaign on {campaign.rig.name}",
        campaign=campaign,
        given=summary.given,
        failure=summary.failure,
        state="failed" if summary.failure.count else "passed",
        tables={
            "spread": tables.spread_table(summary),
            "worst": Table(("metric [SI]", "value", "command"), worst),
        },
        figures={
            "spread": figures.spread_figure(dict(zip(names, values, strict=True))),
            "failures": figures.failures_figure(
                1e3 * payload.astype(float), offset.astype(float), failed, axes
            ),
            "drivers": figures.drivers_figure(summary),
        },
    )
    write_text(path, text)
    return Path(path)
