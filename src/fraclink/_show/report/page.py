"""A study as one HTML file: no script, no request, everything from files escaped where it is set."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from fraclink._files import write_text
from fraclink._identify import coincidence_text
from fraclink._show.report import sections
from fraclink._show.report.templating import needed, rendered

if TYPE_CHECKING:
    from fraclink._workflow import Study

__all__ = ["render_report", "write_report"]

_BEYOND = 0.4  # margins are tabulated at this share of the lightest payload too: 8 g for 20 g


def write_report(study: Study, path: Path | str, *, title: str | None = None) -> Path:
    """Write the report of `study` to `path`, in one step, and return the path.

    Raises MissingExtraError where matplotlib or jinja2 are not installed.

    >>> import tempfile
    >>> from fraclink._workflow import Study
    >>> folder = Path(tempfile.mkdtemp())
    >>> write_report(Study(), folder / "report.html").name
    'report.html'
    """
    text = render_report(study, title=title)
    write_text(path, text)
    return Path(path)


def render_report(study: Study, *, title: str | None = None) -> str:
    """Return the report of `study` as HTML; the same study gives the same bytes.

    >>> from fraclink._workflow import Study
    >>> "Content-Security-Policy" in render_report(Study(), title="<script>")
    True
    """
    needed()
    return rendered("report.html", **_contents(study, title))


def _contents(study: Study, title: str | None) -> dict[str, object]:
    """Everything the template sets."""
    from fraclink import __version__

    name = study.rig.name if study.rig else "unnamed rig"
    return {
        "version": __version__,
        "title": title or f"{name}: {sections.source_name(study.experiment)}",
        "study": study,
        "in_short": [*sections.in_short(study), *_faults_in_short(study)],
        "fit_findings": study.fit.findings if study.fit else (),
        "source": sections.source_name(study.experiment),
        "rig_rows": sections.rig_rows(study.rig) if study.rig else [],
        "rig_findings": [finding for finding in study.findings if finding.code.startswith("W1")],
        "log_findings": [finding for finding in study.findings if not finding.code.startswith("W1")],
        "log_rows": sections.log_rows(study.experiment) if study.experiment else [],
        "fit_rows": sections.fit_rows(study.fits),
        "coincidence": coincidence_text(study.fits),
        "move_rows": sections.move_rows(study.runs),
        **_design(study),
        **_faults(study),
        **_figures(study),
    }


def _design(study: Study) -> dict[str, object]:
    from fraclink._show.report.figures.loop import payloads_of

    design = study.design
    if design is None:
        return {"controller_rows": [], "requirement_rows": [], "margin_rows": []}
    payloads = [_BEYOND * design.payloads[0], *payloads_of(design)]
    return {
        "controller_rows": sections.controller_rows(design, study.law),
        "requirement_rows": sections.requirement_rows(design),
        "margin_rows": sections.margin_rows(design, payloads),
    }


def _faults_in_short(study: Study) -> list[tuple[str, str]]:
    from fraclink._show.report.faults import faults_met

    return [] if study.faults is None else [("Faults on the twin", faults_met(study.faults))]


def _faults(study: Study) -> dict[str, object]:
    from fraclink._show.report.faults import fault_lines, fault_notes, faults_met

    table = study.faults
    if table is None:
        return {"fault_lines": []}
    return {
        "fault_lines": fault_lines(table),
        "fault_notes": fault_notes(table),
        "faults_met": faults_met(table),
    }


def _figures(study: Study) -> dict[str, object]:
    from markupsafe import Markup

    from fraclink._show.report import figures

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
    # matplotlib's SVG writer has escaped every text of a figure; escaping it again would show the markup.
    return {"figures": {name: Markup(text) for name, text in drawn.items()}}  # noqa: S704
