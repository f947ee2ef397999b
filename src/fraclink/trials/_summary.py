"""Summary of a campaign: quantiles, failures, worst cases and the parameters that drive
them.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from scipy.special import bdtr, bdtrc, bdtri

from fraclink._display import Overview, Row, Table, displayed, rows_of, state_of
from fraclink._files import Saved, document
from fraclink._law import MODES, REASONS
from fraclink._simulate.metrics import Metrics
from fraclink.trials._campaign import Campaign, Draws
from fracsys.checks import Real
from fracsys.checks.equality import compared

__all__ = [
    "METRICS",
    "PARAMETERS",
    "CampaignRuns",
    "Failure",
    "MetricSummary",
    "Quantile",
    "Summary",
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
        # Only the strongest driver; the JSON has all of them.
        strong = [(name, r) for name, r in self.drivers[:1] if abs(r) >= WEAK]
        driver = ", ".join(f"{name.replace('_', ' ')} {r:+.2f}" for name, r in strong)
        return rows_of(
            self,
            "name",
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
            "worst",
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
    """The runs of a campaign in figures: failures, tripped runs by (mode, reason), every
    metric, and the payloads that the law was given, in words; empty where it was given
    none.
    """

    failure: Failure
    trips: tuple[tuple[int, int, int], ...]
    metrics: tuple[MetricSummary, ...]
    failed: tuple[int, ...]
    given: str = ""

    @property
    def passed(self) -> bool:
        """Whether every run passed."""
        return not self.failure.count

    def overview(self) -> Overview:
        """How many fail, how they are spread, and what drives it."""
        failure = self.failure
        rows = rows_of(
            self,
            Row("runs", "", failure.runs),
            Row("failures", "", failure.count),
            Row("probability", "", (failure.estimate, failure.low, failure.high)),
            Row(
                "trips",
                "",
                [{"mode": m, "reason": r, "runs": c} for m, r, c in self.trips],
            ),
            Row("failed", "", list(self.failed)),
            "given",
            Row("metrics", "", {metric.name: metric for metric in self.metrics}),
        )
        # rows of zeros, such as of a voltage that is never at its limit, say nothing
        shown = (m for m in self.metrics if any(q.value for q in m.quantiles))
        trips = (
            f"{count} runs: {MODES[mode]} ({REASONS[reason]})"
            for mode, reason, count in self.trips
        )
        return Overview(
            failure.sentence,
            state_of(self.passed),
            rows,
            (Table.of("", shown),),
            notes=(*filter(None, (self.given,)), *trips),
        )


@document(
    "campaign-runs",
    container="npz",
    summary=lambda runs: {"failures": runs.summary.failure.count},
)
@compared
@dataclass(frozen=True, eq=False)
class CampaignRuns(Saved):
    """What a campaign measured.

    columns: number, drawn parameters, metrics and verdict of every run, by name, shape
    (R,); booleans are 1 or 0.
    """

    campaign: Campaign
    columns: Mapping[str, Real]

    @cached_property
    def summary(self) -> Summary:
        """Failures, quantiles and what drives them."""
        columns = self.columns
        run, passed = columns["run"], columns["passed"]
        failed = run[passed == 0.0]
        ranks = {name: _ranks(columns[name]) for name in PARAMETERS}
        return Summary(
            failure=_failure(len(failed), len(run)),
            trips=_trips(columns["mode"], columns["reason"]),
            metrics=tuple(_metric(name, columns[name], run, ranks) for name in METRICS),
            # A hundred are enough to replay, and the page still loads if everything
            # fails.
            failed=tuple(int(n) for n in failed[:100]),
            given=_given(self.campaign),
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


def _metric(
    name: str, values: Real, run: Real, drawn: dict[str, Real]
) -> MetricSummary:
    # An error is as bad on either side; the other signed metric, growth, is worst at its
    # largest value.
    size = np.abs(values) if name == "steady_state_error" else values
    order = np.sort(size)
    worst = np.argsort(size)[::-1][:WORST]
    ranks = _ranks(size)
    return MetricSummary(
        name,
        tuple(_quantile(order, p) for p in PROBABILITIES),
        tuple((int(run[i]), float(values[i])) for i in worst),
        drivers=tuple(
            sorted(
                ((p, float(ranks @ other)) for p, other in drawn.items()),
                key=lambda pair: -abs(pair[1]),
            )
        ),
    )


def _quantile(order: Real, probability: float) -> Quantile:
    """A quantile of a sorted sample with its confidence interval from order statistics
    (David and Nagaraja 2003).
    """
    # The smallest value with at least that share of the sample at or below it; an
    # interpolated value would not be covered by order statistics.
    count, tail = len(order), 0.025
    value = float(order[max(math.ceil(probability * count), 1) - 1])
    # How many of the sample lie below the quantile is binomial.
    below = bisect_left(
        range(count + 1), tail, key=lambda k: bdtr(k, count, probability)
    )
    above = bisect_left(
        range(count + 1), -tail, key=lambda k: -bdtrc(k, count, probability)
    )
    # infinite if the sample is too small for a bound
    return Quantile(
        probability,
        value,
        float(order[below - 1]) if below > 0 else -math.inf,
        float(order[above]) if above < count else math.inf,
    )


def _failure(count: int, runs: int) -> Failure:
    """The failure rate with the interval of Clopper and Pearson (1934)."""
    return Failure(
        count,
        runs,
        count / runs,
        low=float(bdtri(count - 1, runs, 0.975)) if count > 0 else 0.0,
        high=float(bdtri(count, runs, 0.025)) if count < runs else 1.0,
    )


def _trips(mode: Real, reason: Real) -> tuple[tuple[int, int, int], ...]:
    counts = Counter(zip(map(int, mode), map(int, reason), strict=True))
    return tuple((m, r, count) for (m, r), count in sorted(counts.items()) if m != 1)


def _ranks(values: Real) -> Real:
    """Mean ranks, centred and normalised: the dot product of two of them is Spearman's
    correlation.
    """
    _, place, ties = np.unique(values, return_inverse=True, return_counts=True)
    ranks = (np.cumsum(ties) - 0.5 * (ties - 1.0))[place] - 0.5 * (len(values) + 1)
    # A parameter that does not vary has rank zero everywhere, and a correlation of 0
    # instead of 0/0.
    return ranks / (np.linalg.norm(ranks) or 1.0)
