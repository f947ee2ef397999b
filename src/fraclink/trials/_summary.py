"""What a campaign's runs say: quantiles, failures, worst cases and what drives them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtr, bdtrik, betaincinv

from fraclink._display import displayed
from fraclink.errors import FieldError, FraclinkError
from fraclink.trials._campaign import Campaign, load_campaign
from fraclink.trials._run import part_path, parts_there, read_part

__all__ = [
    "METRICS",
    "PARAMETERS",
    "Failure",
    "MetricSummary",
    "Quantile",
    "Summary",
    "columns",
    "summarise",
]

Real = NDArray[np.float64]

METRICS = (
    "overshoot",
    "settling_time",
    "residual_vibration",
    "steady_state_error",
    "peak_tip_error",
    "peak_voltage",
    "motor_reference_noise",
    "saturated",
    "growth",
)
PARAMETERS = (
    "payload",
    "stiffness",
    "order",
    "gauge_offset",
    "delay_samples",
    "motor_gain",
    "viscous_friction",
    "coulomb_torque",
    "noise",
    "amplitude",
    "gauge_delay",
    "gauge_gain",
)
# The 99.9 % quantile of 1000 runs has no upper bound, and is told with an infinite one:
# a reader sees how many runs would be needed.
PROBABILITIES = (0.05, 0.5, 0.95, 0.99, 0.999)
CONFIDENCE = 0.95
WORST = 5


@dataclass(frozen=True)
class Quantile:
    """A quantile and its 95 % interval, free of any distribution: order statistics of
    the sample.

    An end of the interval is infinite where the sample is too small to bound it.
    """

    probability: float
    value: float
    low: float
    high: float


@dataclass(frozen=True)
class MetricSummary:
    """One metric: quantiles, the run numbers of its worst cases, and Spearman's rank
    correlation with every parameter, largest first."""

    name: str
    quantiles: tuple[Quantile, ...]
    worst: tuple[tuple[int, float], ...]
    drivers: tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class Failure:
    """How often the law fails: count, estimate, and the two-sided 95 % Clopper–Pearson
    interval.
    """

    count: int
    runs: int
    estimate: float
    low: float
    high: float

    @property
    def sentence(self) -> str:
        """The claim in words, with the number of runs a stronger one needs."""
        claim = f"{self.count} of {self.runs} runs failed"
        if self.count:
            interval = f"95 % interval {100 * self.low:.3g} to {100 * self.high:.3g} %"
            return f"{claim}: {100 * self.estimate:.3g} % ({interval})"
        more = f"to show a tenth of that, {10 * self.runs} runs without a failure are needed"
        return f"{claim}: less than {100 * self.high:.2g} % fail, at 95 % confidence; {more}"


@displayed
@dataclass(frozen=True)
class Summary:
    """What `summarise` found: failures, tripped runs by (mode, reason), every metric,
    and what the law was given of the payloads, in words; empty where it was given
    nothing.

    damaged: numbers of the parts that are there and are not believed: cut, edited, of
    another campaign, or beyond the last run that campaign.json states; their runs are
    in no figure. left_out: what is missing, in words; empty where nothing is.
    """

    failure: Failure
    trips: tuple[tuple[int, int, int], ...]
    metrics: tuple[MetricSummary, ...]
    failed: tuple[int, ...]
    given: str = ""
    damaged: tuple[int, ...] = ()
    left_out: str = ""

    @property
    def passed(self) -> bool:
        """Whether every run passed, and no part is damaged."""
        return not self.failure.count and not self.damaged


def summarise(campaign: Campaign, folder: Path | str) -> Summary:
    """Summarise the finished parts of a campaign; FieldError where none is.

    Columns are read one at a time: the memory is that of two columns, 16 bytes a run.
    """
    place = Path(folder)
    parts = _finished(campaign, place)

    def column(name: str) -> NDArray[np.generic]:
        return np.concatenate([_column(campaign, place, part, name) for part in parts])

    missing = sorted(set(range(campaign.parts)) - set(parts))
    stated = _stated(campaign, place)
    # A shorter request of a longer campaign is no reason to doubt the parts that it
    # does not ask for.
    asked = (
        part for part in parts_there(place) if not campaign.parts <= part < stated.parts
    )
    damaged = tuple(sorted(set(asked) - set(parts)))
    # One column after the other: a million runs of 25 columns would be 200 MB at once.
    run, passed = column("run"), column("passed").astype(bool)
    failed = run[~passed]
    drawn = {name: _ranks(column(name)) for name in PARAMETERS}
    metrics = tuple(
        _metric(name, np.asarray(column(name), dtype=float), run, drawn)
        for name in METRICS
    )
    return Summary(
        failure=_failure(len(failed), len(run)),
        trips=_trips(column("mode"), column("reason")),
        metrics=metrics,
        # A hundred: enough to replay, and a page that still loads where everything
        # fails.
        failed=tuple(int(n) for n in failed[:100]),
        given=_given(campaign),
        damaged=damaged,
        left_out=_left_out(campaign, place, missing, damaged),
    )


def _stated(campaign: Campaign, place: Path) -> Campaign:
    """The campaign that the folder states where it is a longer one of the same; else
    this one.
    """
    try:
        known = load_campaign(place)
    except (FraclinkError, OSError):  # what cannot be read vouches for no part
        return campaign
    return (
        known
        if known.fingerprint == campaign.fingerprint and known.runs > campaign.runs
        else campaign
    )


def _left_out(
    campaign: Campaign, place: Path, missing: list[int], damaged: tuple[int, ...]
) -> str:
    """Which runs are in no figure, and what brings them back."""
    inside = tuple(part for part in damaged if part < campaign.parts)
    told = []
    if missing:
        runs, waiting = (
            sum(campaign.part_runs(part) for part in missing),
            len(missing) - len(inside),
        )
        causes = [f"{_named(place, inside)} damaged or edited"] if inside else []
        causes += (
            [f"{waiting} part{'s' if waiting > 1 else ''} not computed yet"]
            if waiting
            else []
        )
        told.append(
            f"{runs} of {campaign.runs} runs are left out: {'; '.join(causes)}. "
            "The command that began the campaign computes them"
        )
    if beyond := damaged[len(inside) :]:
        stated = _stated(campaign, place).runs
        told.append(
            f"{_named(place, beyond)} left out: beyond the {stated} runs that campaign.json states. "
            "Remove it if it is not of this campaign; else its command, given again, states them all"
        )
    return ". ".join(told)


def _named(place: Path, parts: tuple[int, ...]) -> str:
    more = f" and {len(parts) - 3} more" if len(parts) > 3 else ""
    return ", ".join(part_path(place, part).name for part in parts[:3]) + more


def _given(campaign: Campaign) -> str:
    """What the law was given of each arm's payload; the bounds of the draw are ratios
    to it.
    """
    if campaign.payloads is not None:
        return "the law was given the payload that it estimated of each arm"
    ratio = campaign.draws.payload_given
    if not ratio.high:
        return ""
    if ratio.low == ratio.high:
        share = "" if ratio.low == 1.0 else f"{100 * ratio.low:.4g} % of "
        return f"the law was given {share}the payload of each arm"
    return f"the law was given {100 * ratio.low:.4g} to {100 * ratio.high:.4g} % of the payload of each arm"


def columns(
    campaign: Campaign, folder: Path | str, *names: str
) -> tuple[NDArray[np.generic], ...]:
    """Return columns of all finished parts of a campaign, by name; FieldError where no
    part is finished.
    """
    place = Path(folder)
    parts = _finished(campaign, place)
    return tuple(
        np.concatenate([_column(campaign, place, part, name) for part in parts])
        for name in names
    )


def _finished(campaign: Campaign, place: Path) -> list[int]:
    # every column: one that is damaged leaves its part out from the beginning, and not
    # from one figure
    there = (part for part in parts_there(place) if part < campaign.parts)
    parts = [part for part in there if _read(campaign, place, part) is not None]
    if not parts:
        raise FieldError(
            "parts",
            str(place),
            "empty",
            allowed="at least one finished part",
            remedy="run the campaign first",
        )
    return parts


def _read(
    campaign: Campaign, place: Path, part: int, *names: str
) -> dict[str, NDArray[np.generic]] | None:
    """A finished part; the first runs of it where it is the last one of a shorter
    request.
    """
    found = read_part(campaign, place, part, names=names)
    if found is not None or part != campaign.parts - 1:
        return found
    # Only where campaign.json states more runs: a part that is longer than the file
    # says may hide failures.
    longer = read_part(_stated(campaign, place), place, part, names=names)
    return longer and {
        name: values[: campaign.part_runs(part)] for name, values in longer.items()
    }


def _column(
    campaign: Campaign, place: Path, part: int, name: str
) -> NDArray[np.generic]:
    columns = _read(campaign, place, part, name)
    if columns is None:
        raise FieldError(
            "part",
            part,
            "gone while it was read",
            allowed="a finished part",
            remedy="run the campaign again",
        )
    return columns[name]


def _metric(
    name: str, values: Real, run: NDArray[np.generic], drawn: dict[str, Real]
) -> MetricSummary:
    # The only metric with a sign; its worst case is the farthest, on either side.
    size = np.abs(values) if name == "steady_state_error" else values
    order = np.sort(size)
    worst = np.argsort(size)[::-1][:WORST]
    ranks = _ranks(size)
    drivers = [(p, _correlation(ranks, other)) for p, other in drawn.items()]
    return MetricSummary(
        name,
        tuple(_quantile(order, p) for p in PROBABILITIES),
        tuple((int(run[i]), float(values[i])) for i in worst),
        tuple(sorted(drivers, key=lambda pair: -abs(pair[1]))),
    )


def _quantile(order: Real, probability: float) -> Quantile:
    """Order statistics l, u with P(B < l), P(B ≥ u) ≤ 2.5 %, B binomial(n, p) (David
    and Nagaraja 2003).
    """
    n, tail = len(order), 0.5 * (1.0 - CONFIDENCE)
    low = _binomial_quantile(tail, n, probability)
    high = _binomial_quantile(1.0 - tail, n, probability) + 1
    return Quantile(
        probability,
        # The smallest value with at least that part of the sample at or below it; no
        # interpolation, which a bound on order statistics would not cover.
        float(order[max(math.ceil(probability * n), 1) - 1]),
        float(order[low - 1]) if low >= 1 else -math.inf,
        float(order[high - 1]) if high <= n else math.inf,
    )


def _binomial_quantile(tail: float, count: int, probability: float) -> int:
    """The smallest k with P(B ≤ k) ≥ tail."""
    above: int = math.ceil(bdtrik(tail, count, probability))
    # The inverse is that of the continuous beta function: where it returns k + 1e-12 it
    # means k.
    return (
        above - 1
        if above > 0 and bdtr(above - 1, count, probability) >= tail
        else above
    )


def _failure(count: int, runs: int) -> Failure:
    """Clopper and Pearson 1934: the beta quantiles that make the binomial tails 2.5 %."""
    tail = 0.5 * (1.0 - CONFIDENCE)
    # No run failed: nothing bounds the share from below, and the interval is one-sided
    # by its data.
    low = float(betaincinv(count, runs - count + 1, tail)) if count else 0.0
    high = (
        float(betaincinv(count + 1, runs - count, 1.0 - tail)) if count < runs else 1.0
    )
    return Failure(count, runs, count / runs, low, high)


def _trips(
    mode: NDArray[np.generic], reason: NDArray[np.generic]
) -> tuple[tuple[int, int, int], ...]:
    pairs, counts = np.unique(
        np.stack([mode, reason], axis=1), axis=0, return_counts=True
    )
    return tuple(
        (int(m), int(r), int(c))
        for (m, r), c in zip(pairs, counts, strict=True)
        if m != 1
    )


def _ranks(values: NDArray[np.generic]) -> Real:
    """Mean ranks, centred and of length one: a dot product of two of them is Spearman's
    correlation.
    """
    _, place, ties = np.unique(values, return_inverse=True, return_counts=True)
    # Ties share their mean rank: a parameter that is not varied then has rank zero
    # everywhere, and a correlation of 0 instead of 0/0.
    ranks = (np.cumsum(ties) - 0.5 * (ties - 1))[place] - 0.5 * (len(values) + 1)
    length = float(np.linalg.norm(ranks))
    return np.asarray(ranks / length if length else ranks)


def _correlation(a: Real, b: Real) -> float:
    return float(a @ b)
