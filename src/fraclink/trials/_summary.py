"""Summary of a campaign: quantiles, failures, worst cases and the parameters that drive
them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from scipy import stats

from fraclink._display import Overview, Row, Table, displayed, state_of
from fraclink._law import MODES, REASONS
from fraclink._simulate.metrics import Metrics
from fraclink.errors import FieldError
from fraclink.trials._campaign import Campaign, Draws, load_campaign
from fraclink.trials._run import PARTS, read_part
from fracsys.checks import Real

__all__ = [
    "METRICS",
    "PARAMETERS",
    "Failure",
    "MetricSummary",
    "Quantile",
    "Summary",
    "columns_of",
    "summarise",
]


METRICS = tuple(field.name for field in fields(Metrics))
PARAMETERS = tuple(field.name for field in fields(Draws))
# Display units of the metrics.
UNITS = {row.key: row.unit for row in Metrics(*[0.0] * len(METRICS)).rows}
# A parameter with a smaller rank correlation explains about 2 % of the variance of the
# ranks, which has no practical use. This is not a significance test: of ten parameters
# without any effect, one exceeds it by chance in three of four campaigns of 100 runs,
# but in only one of 50 000 campaigns of 1000 runs.
WEAK = 0.15
# The 99.9 % quantile of 1000 runs has no upper bound, which is reported as infinite: it
# shows that more runs are needed.
PROBABILITIES = (0.05, 0.5, 0.95, 0.99, 0.999)
WORST = 5


@dataclass(frozen=True)
class Quantile:
    """A quantile and its distribution-free 95 % interval from order statistics.

    An end of the interval is infinite if the sample is too small to bound it.
    """

    probability: float
    value: float
    low: float
    high: float


@dataclass(frozen=True)
class MetricSummary:
    """One metric: quantiles, the run numbers of its worst cases, and Spearman's rank
    correlation with every parameter, largest first.
    """

    name: str
    quantiles: tuple[Quantile, ...]
    worst: tuple[tuple[int, float], ...]
    drivers: tuple[tuple[str, float], ...]

    def row(self, label: str, value: float) -> Row:
        """A value of the metric; an infinite time means never."""
        unit = UNITS[self.name]
        return Row(self.name, label, value, unit, digits=3, infinite="never")

    @property
    def rows(self) -> tuple[Row, ...]:
        """Its quantiles over the arms, and its strongest driver."""
        # Only the strongest driver; the report of the campaign shows all of them.
        strong = [(name, r) for name, r in self.drivers[:1] if abs(r) >= WEAK]
        driver = ", ".join(f"{name.replace('_', ' ')} {r:+.2f}" for name, r in strong)
        return (
            Row("name", "", self.name),
            Row("", "metric", self.name.replace("_", " ")),
            *(
                replace(
                    self.row(f"{100 * q.probability:g} %", q.value),
                    key=f"quantiles.{q.probability:g}",
                )
                for q in self.quantiles
            ),
            Row(
                "intervals",
                "",
                [(q.probability, q.low, q.high) for q in self.quantiles],
            ),
            Row("worst", "", self.worst),
            Row("drivers", "", dict(self.drivers)),
            Row("", "driven by", driver.replace("-", "−") or "–"),
        )


@dataclass(frozen=True)
class Failure:
    """The failure rate of the law: count, estimate, and the two-sided 95 %
    Clopper–Pearson interval.
    """

    count: int
    runs: int
    estimate: float
    low: float
    high: float

    @property
    def sentence(self) -> str:
        """The claim in words."""
        claim = f"{self.count} of {self.runs} runs failed"
        if self.count:
            interval = f"95 % interval {100 * self.low:.3g} to {100 * self.high:.3g} %"
            return f"{claim}: {100 * self.estimate:.3g} % ({interval})"
        return f"{claim} (95 % confidence: fewer than {100 * self.high:.2g} %)"


@displayed
@dataclass(frozen=True)
class Summary:
    """What `summarise` found: failures, tripped runs by (mode, reason), every metric,
    and what the law was given of the payloads, in words; empty where it was given
    nothing.

    missing: runs that are in no figure, since their part is not computed, or its file
    is cut, edited or of another campaign.
    """

    failure: Failure
    trips: tuple[tuple[int, int, int], ...]
    metrics: tuple[MetricSummary, ...]
    failed: tuple[int, ...]
    given: str = ""
    missing: int = 0

    @property
    def passed(self) -> bool:
        """Whether every run passed, and none is missing."""
        return not self.failure.count and not self.missing

    @property
    def left_out(self) -> str:
        """Which runs are in no figure, and what brings them back."""
        if not self.missing:
            return ""
        runs = self.missing + self.failure.runs
        return (
            f"{self.missing} of {runs} runs are left out: not computed yet, or their file is "
            "damaged or edited. The command that began the campaign computes them"
        )

    def overview(self) -> Overview:
        """How many fail, how they are spread, and what drives it."""
        failure = self.failure
        headline = failure.sentence
        # otherwise "failed" would stand before "0 of 2000 runs failed"
        if self.missing:
            headline = f"{self.missing} runs missing; of the others, {headline}"
        rows = (
            Row("left_out", "", self.left_out),
            Row("runs", "", failure.runs),
            Row("failures", "", failure.count),
            Row("probability", "", (failure.estimate, failure.low, failure.high)),
            Row(
                "trips",
                "",
                [{"mode": m, "reason": r, "runs": c} for m, r, c in self.trips],
            ),
            Row("failed", "", list(self.failed)),
            Row("given", "", self.given),
            Row("metrics", "", {metric.name: metric for metric in self.metrics}),
        )
        # rows of zeros, such as of a voltage that is never at its limit, say nothing
        shown = (m for m in self.metrics if any(q.value for q in m.quantiles))
        trips = (
            f"{count} runs: {MODES[mode]} ({REASONS[reason]})"
            for mode, reason, count in self.trips
        )
        return Overview(
            headline,
            state_of(self.passed),
            rows,
            (Table.of("", (metric.rows for metric in shown)),),
            notes=(*filter(None, (self.left_out, self.given)), *trips),
        )


def summarise(folder: Path | str) -> Summary:
    """Summarise the finished parts of a campaign's folder; FieldError where none is."""
    campaign = load_campaign(folder)
    columns = columns_of(campaign, folder)
    run, passed = columns["run"], columns["passed"]
    failed = run[passed == 0.0]
    ranks = {name: _ranks(columns[name]) for name in PARAMETERS}
    return Summary(
        failure=_failure(len(failed), len(run)),
        trips=_trips(columns["mode"], columns["reason"]),
        metrics=tuple(_metric(name, columns[name], run, ranks) for name in METRICS),
        # A hundred are enough to replay, and the page still loads if everything fails.
        failed=tuple(int(n) for n in failed[:100]),
        given=_given(campaign),
        missing=campaign.runs - len(run),
    )


def _given(campaign: Campaign) -> str:
    """The payload given to the law for each arm; the bounds of the draw are ratios to
    it.
    """
    if campaign.payloads is not None:
        return "the law was given the payload that it estimated of each arm"
    draw = campaign.draws.payload_given
    shares = dict.fromkeys(f"{100.0 * ratio:.4g}" for ratio in (draw.low, draw.high))
    sentence = f"the law was given {' to '.join(shares)} % of the payload of each arm"
    return sentence if draw.high else ""


def columns_of(campaign: Campaign, folder: Path | str) -> dict[str, Real]:
    """Return all columns of the finished parts of a campaign's folder, by name;
    FieldError if no part is finished.
    """
    place = Path(folder)
    # Files are counted instead of parts: a campaign of 10⁹ runs that has just begun has
    # a million possible names.
    names = {path.stem.removeprefix("part-") for path in place.glob(PARTS)}
    numbers = sorted({int(name) for name in names if name.isdecimal()})
    contents = (read_part(campaign, place, n) for n in numbers if n < campaign.parts)
    parts = [part for part in contents if part is not None]
    if not parts:
        raise FieldError(
            "parts",
            str(place),
            "empty",
            allowed="at least one finished part",
            remedy="run the campaign first",
        )
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _metric(
    name: str, values: Real, run: Real, drawn: dict[str, Real]
) -> MetricSummary:
    # The only signed metric; its worst case is the largest deviation on either side.
    size = np.abs(values) if name == "steady_state_error" else values
    order = np.sort(size)
    worst = np.argsort(size)[::-1][:WORST]
    ranks = _ranks(size)
    drivers = [(p, float(ranks @ other)) for p, other in drawn.items()]
    return MetricSummary(
        name,
        tuple(_quantile(order, p) for p in PROBABILITIES),
        tuple((int(run[i]), float(values[i])) for i in worst),
        tuple(sorted(drivers, key=lambda pair: -abs(pair[1]))),
    )


def _quantile(order: Real, probability: float) -> Quantile:
    """A quantile of a sorted sample with its confidence interval from order statistics
    (David and Nagaraja 2003).
    """
    # The smallest value with at least that share of the sample at or below it; an
    # interpolated value would not be covered by order statistics.
    value = float(order[max(math.ceil(probability * len(order)), 1) - 1])
    test = stats.quantile_test(order, q=value, p=probability)
    low, high = test.confidence_interval()
    # NaN if the sample is too small for a bound
    return Quantile(
        probability,
        value,
        -math.inf if math.isnan(low) else float(low),
        math.inf if math.isnan(high) else float(high),
    )


def _failure(count: int, runs: int) -> Failure:
    """The failure rate with the interval of Clopper and Pearson (1934)."""
    interval = stats.binomtest(count, runs).proportion_ci()
    return Failure(count, runs, count / runs, float(interval.low), float(interval.high))


def _trips(mode: Real, reason: Real) -> tuple[tuple[int, int, int], ...]:
    pairs, counts = np.unique(
        np.stack([mode, reason], axis=1), axis=0, return_counts=True
    )
    return tuple(
        (int(m), int(r), int(c))
        for (m, r), c in zip(pairs, counts, strict=True)
        if m != 1
    )


def _ranks(values: Real) -> Real:
    """Mean ranks, centred and normalised: the dot product of two of them is Spearman's
    correlation.
    """
    ranks = stats.rankdata(values) - 0.5 * (len(values) + 1)
    # A parameter that does not vary has rank zero everywhere, and a correlation of 0
    # instead of 0/0.
    return np.asarray(ranks / (float(np.linalg.norm(ranks)) or 1.0))
