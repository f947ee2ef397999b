"""A campaign as one HTML file, in the style of a study's report."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from fraclink._campaign import Campaign, MetricSummary, Summary, columns
from fraclink._files import write_text
from fraclink._show.report.templating import needed, rendered

__all__ = ["write_campaign_report"]


@dataclass(frozen=True)
class _Part:
    title: str
    text: str = ""
    figure: str = ""
    caption: str = ""
    header: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    words: bool = False  # the last column is text


def write_campaign_report(campaign: Campaign, folder: Path | str, summary: Summary, path: Path | str) -> Path:
    """Write histograms, failure map, drivers and worst cases of a campaign to `path`; return it.

    Raises MissingExtraError where matplotlib or jinja2 are not installed.
    """
    needed()
    from fraclink._show.report.figures.campaign import SHOWN, drivers_figure, failures_figure, spread_figure

    names = [name for name, _, _ in SHOWN]
    values = dict(zip(names, columns(campaign, folder, *names), strict=True))
    payload, offset, holds = columns(campaign, folder, "payload", "gauge_offset", "passed")
    failed = ~holds.astype(bool)
    runs = summary.failure.runs
    parts = [
        _Part(
            "How the metrics are spread",
            figure=spread_figure(values),
            caption="Median and 95 % quantile of the runs that have one; the last bar holds the last 0.1 %.",
            header=("metric", *(f"{100 * q.probability:g} %" for q in summary.metrics[0].quantiles)),
            rows=tuple(_quantiles(m) for m in summary.metrics),
        ),
        _Part(
            "Where runs fail",
            figure=failures_figure(
                1e3 * payload.astype(float),
                offset.astype(float),
                failed,
                ("payload [g]", "gauge offset [N·m]"),
            ),
            caption="Share of each cell's runs that do not settle, or whose law leaves its normal mode.",
        ),
        _Part(
            "What drives the metrics",
            text="Spearman's rank correlation with each parameter; ±1: a monotonic function of it alone.",
            figure=drivers_figure(summary),
            caption="Correlations below 0.05 are left without a number.",
        ),
        _Part(
            "Worst cases",
            text="Each can be repeated with all its signals by the command beside it.",
            words=True,
            header=("metric", "value", "command"),
            rows=tuple(
                (m.name, f"{value:.4g}", f"fraclink campaign replay {folder} --run {run}")
                for m in summary.metrics
                for run, value in m.worst[:2]
                if m.name != "saturated"
            ),
        ),
    ]
    subtitle = f"{runs} of {campaign.runs} runs · seed {campaign.seed} · {campaign.duration:g} s each"
    return _write(
        path,
        f"Campaign on {campaign.rig.name}",
        subtitle,
        summary.failure.count == 0,
        summary.failure.sentence,
        parts,
    )


def _quantiles(metric: MetricSummary) -> tuple[str, ...]:
    def shown(value: float) -> str:
        return f"{value:.3g}" if math.isfinite(value) else "never" if value > 0 else "?"

    return (
        metric.name.replace("_", " "),
        *(f"{shown(q.value)} ({shown(q.low)} … {shown(q.high)})" for q in metric.quantiles),
    )


def _write(
    path: Path | str, title: str, subtitle: str, holds: bool, sentence: str, parts: list[_Part]
) -> Path:
    from dataclasses import replace

    from markupsafe import Markup

    from fraclink import __version__

    # matplotlib's SVG writer has escaped every text of a figure already.
    drawn = [replace(part, figure=Markup(part.figure)) for part in parts]  # noqa: S704
    text = rendered(
        "campaign.html",
        version=__version__,
        title=title,
        subtitle=subtitle,
        holds=holds,
        sentence=sentence,
        parts=drawn,
    )
    write_text(path, text)
    return Path(path)
