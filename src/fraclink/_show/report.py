"""Reports as one HTML file each: no script, no request, everything from files escaped where it is set."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from fraclink._campaign import Campaign, Summary, columns
from fraclink._campaign.faults import fault_named
from fraclink._files import write_text
from fraclink._show import figures, tables
from fraclink._show.drawing import needed
from fraclink._show.text import Row, Table, marked, sentence
from fraclink._workflow import Study

__all__ = ["render_report", "write_campaign_report", "write_report"]

_BEYOND = 0.4  # margins are tabulated at this share of the lightest payload too: 8 g for 20 g


def write_report(study: Study, path: Path | str, *, title: str | None = None) -> Path:
    """Write the report of `study` to `path`, in one step, and return the path.

    Raises MissingExtraError where matplotlib or jinja2 are not installed.

    >>> import tempfile
    >>> write_report(Study(), Path(tempfile.mkdtemp()) / "report.html").name
    'report.html'
    """
    write_text(path, render_report(study, title=title))
    return Path(path)


def render_report(study: Study, *, title: str | None = None) -> str:
    """Return the report of `study` as HTML; the same study gives the same bytes.

    >>> "Content-Security-Policy" in render_report(Study(), title="<script>")
    True
    """
    needed()
    name = study.rig.name if study.rig else "unnamed rig"
    source = tables.source_name(study.experiment)
    verdict = study.verdict
    return _rendered(
        "report.html",
        title=title or f"{name}: {source}",
        study=study,
        source=source,
        verdict=verdict,
        headline=tables.verdict_sentence(verdict),
        scopes=[(row[0], row[1], scope) for row, scope in _scopes(study)],
        in_short=tables.summary_rows(study),
        tables=_tables(study),
        rig_findings=[finding for finding in study.findings if finding.code.startswith("W1")],
        log_findings=[finding for finding in study.findings if not finding.code.startswith("W1")],
        coincidence=tables.coincidence(study.fits),
        fault_notes=_fault_notes(study),
        following=_following(study),
        figures=_figures(study),
    )


def _scopes(study: Study) -> list[tuple[Row, Any]]:
    rows = tables.verdict_table(study.verdict).rows
    return list(zip(rows, study.verdict.scopes.values(), strict=True))


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


def _following(study: Study) -> list[tuple[str, str]]:
    """What a reader does next: why, and the command."""
    steps: list[tuple[str, str]] = []
    if study.design is None:
        return steps
    if study.arms is not None and study.arms.failed:
        worst = study.arms.failed[0]
        steps.append(
            ("See why an arm fails, with all signals", f"fraclink campaign replay arms --run {worst}")
        )
    if study.certificate is None:
        steps.append(("Prove the promise", "fraclink certify design.json"))
    if study.faults is None:
        steps.append(
            ("Break sensors and memory on the twin", "fraclink campaign faults --design design.json --out .")
        )
    steps.append(("Write the law as C99 with a self-test", "fraclink export c design.json --out firmware"))
    steps.append(
        (
            "Serve a simulated arm, then run the law on it",
            "fraclink serve-arm design.json --io udp:127.0.0.1:5005",
        )
    )
    return steps


def _figures(study: Study) -> dict[str, Any]:
    from markupsafe import Markup  # comes with jinja2

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
    # matplotlib's SVG writer has escaped every text of a figure already.
    return {name: Markup(text) for name, text in drawn.items()}  # noqa: S704


def _rendered(template: str, **contents: object) -> str:
    """Return the page that `template` makes of `contents`; a name that is missing is an error."""
    import jinja2

    from fraclink import __version__

    folder = files("fraclink._show") / "templates"
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(lambda name: (folder / name).read_text("utf-8")),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["sentence"] = sentence
    environment.filters["marked"] = marked
    return environment.get_template(template).render(version=__version__, **contents)


# --- campaigns --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Part:
    title: str
    text: str = ""
    figure: Any = ""
    caption: str = ""
    table: Table | None = None


def write_campaign_report(campaign: Campaign, folder: Path | str, summary: Summary, path: Path | str) -> Path:
    """Write histograms, failure map, drivers and worst cases of a campaign to `path`; return it.

    Raises MissingExtraError where matplotlib or jinja2 are not installed.
    """
    needed()
    from markupsafe import Markup

    names = [name for name, _, _ in figures.SHOWN]
    values = dict(zip(names, columns(campaign, folder, *names), strict=True))
    payload, offset, passed = columns(campaign, folder, "payload", "gauge_offset", "passed")
    grams = 1e3 * payload.astype(float)
    axes = ("payload [g]", "gauge offset [N·m]")
    failures = figures.failures_figure(grams, offset.astype(float), ~passed.astype(bool), axes)
    worst = tuple(
        (m.name.replace("_", " "), f"{value:.4g}", f"fraclink campaign replay {folder} --run {run}")
        for m in summary.metrics
        for run, value in m.worst[:2]
        if m.name != "saturated"
    )
    parts = [
        _Part(
            "How the metrics are spread",
            figure=Markup(figures.spread_figure(values)),  # noqa: S704
            caption="Median and 95 % quantile of the runs that have one; the last bar holds the last 0.1 %.",
            table=tables.spread_table(summary),
        ),
        _Part(
            "Where runs fail",
            figure=Markup(failures),  # noqa: S704
            caption="Share of each cell's runs that do not settle, or whose law leaves its normal mode.",
        ),
        _Part(
            "What drives the metrics",
            text="Spearman's rank correlation with each parameter; ±1: a monotonic function of it alone.",
            figure=Markup(figures.drivers_figure(summary)),  # noqa: S704
            caption="Correlations below 0.05 are left without a number.",
        ),
        _Part(
            "Worst cases",
            text="The command repeats the run with all its signals.",
            table=Table(("metric [SI]", "value", "command"), worst),
        ),
    ]
    failure = summary.failure
    text = _rendered(
        "campaign.html",
        title=f"Campaign on {campaign.rig.name}",
        subtitle=f"{failure.runs} of {campaign.runs} runs · seed {campaign.seed} · {campaign.duration:g} s",
        state="failed" if failure.count else "passed",
        sentence=failure.sentence,
        parts=parts,
    )
    write_text(path, text)
    return Path(path)
