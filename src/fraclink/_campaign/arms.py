"""The arms of a campaign: each drawn, run in blocks through the kernel, measured, and repeated on demand.

The links of many arms at once are the recursion of `fraclink._simulate.kernel`, vectorised. The step
response of ``G = ω₀²/(s^λ + ω₀²)`` is, in the link's own time x = Ω t with Ω = ω₀^(2/λ),

``S = 1 − (2/λ) Re e^(x e^(iπ/λ)) − (1/π) ∫ sin(πλ) e^(λv) / |1 + e^(λv + iπλ)|² · e^(−x e^v) dv``,

so one grid in v = ln(r/Ω) serves every payload (Lemma 1's homothety) and only exponentials are left to do.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from fraclink._arm.link import LinkModel
from fraclink._arm.reference import sampled
from fraclink._arm.rig import Rig
from fraclink._campaign.campaign import PART_RUNS, Campaign, draw
from fraclink._simulate.estimates import ESTIMATED
from fraclink._simulate.kernel import SUBSTEPS, LumpedArms, run_lumped, shared_rig
from fraclink._simulate.metrics import Signals, judge_many, measure_many
from fraclink._simulate.plant import LONGEST, POWERS, LinkWeights, second_mode_weights
from fraclink._simulate.run import Run
from fraclink._simulate.simulate import estimates_of_model, model_run
from fraclink._validate import Between, checked, is_whole
from fraclink.errors import FieldError

__all__ = ["arm_of", "replay_run", "simulate_part"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

BLOCK = 50  # runs simulated before they are measured: 50 × 1000 periods × 6 signals stay in the cache
# Trapezoidal step in ln r. The integrand's poles lie at distances π(1 − 1/λ) and π(3/λ − 1); the first is
# corrected exactly, and the second, which cannot be (its exponential grows), leaves e^(−2π·1.57/0.6) = 7e-8.
STEP = 0.6
NEGLIGIBLE = 15.0  # e^-15 = 3e-7 of the step response: a Monte Carlo metric is read to 1e-4


# ── parts ───────────────────────────────────────────────────────────────────────────────────────────────────


@checked
def simulate_part(campaign: Campaign, part: Annotated[int, Between(0)]) -> dict[str, NDArray[np.generic]]:
    """Return parameters, metrics and verdict of every run of a part, by column name; shape (R,)."""
    Between(0, campaign.parts - 1).check("part", part)
    runs = campaign.part_runs(part)
    values = draw(campaign.draws, campaign.seed, part, runs)
    path = unit_paths(campaign)
    blocks = [_measured_block(campaign, values, path, part, at) for at in range(0, runs, BLOCK)]
    measured = {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}
    number = np.arange(part * PART_RUNS, part * PART_RUNS + runs, dtype=np.int64)
    values["shape"] = values["shape"] % len(campaign.references)
    return {"run": number} | {name: np.asarray(column) for name, column in values.items()} | measured


def unit_paths(campaign: Campaign, times: int = 1) -> Real:
    """Return angle and acceleration of each of the campaign's references, (shapes, 2, N)."""
    count = round(times * campaign.duration / campaign.law.period) + 1
    rows = [sampled(each, campaign.law.period, count)[[0, 2]] for each in campaign.references]
    return np.ascontiguousarray(np.stack(rows))


def _measured_block(
    campaign: Campaign, values: dict[str, Real], path: Real, part: int, at: int
) -> dict[str, NDArray[np.generic]]:
    own = {name: column[at : at + BLOCK] for name, column in values.items()}
    arms, chosen = block_of(campaign, own, part * PART_RUNS + at)
    block, metrics = _measured(campaign, arms, chosen, path, _vibration(campaign, own))
    return metrics | judge_many(block, metrics)


def _vibration(campaign: Campaign, own: dict[str, Real]) -> Real:
    """Period of each link's vibration [s], shape (R,)."""
    pole = (own["stiffness"] / (own["payload"] * campaign.rig.link.length**2)) ** (1.0 / own["order"])
    return np.asarray(2.0 * np.pi / (pole * np.sin(np.pi / own["order"])))


def _measured(
    campaign: Campaign, arms: LumpedArms, chosen: NDArray[np.int32], path: Real, vibration: Real
) -> tuple[Signals, dict[str, Real]]:
    """The signals and metrics of a block; a vibration that seems to grow is followed for twice as long.

    Noise rings a good arm so that its envelope rises through a whole run once in some thousand runs, which a
    campaign of a thousand would call an unstable arm once in a few; an unstable arm goes on growing.
    """
    block = _signals(campaign, arms, chosen, path, vibration)
    metrics = measure_many(block)
    grown = np.flatnonzero(metrics["growth"] > 0.0)
    if grown.size:
        longer = _signals(
            campaign, arms.rows(grown), chosen[grown], unit_paths(campaign, 2), vibration[grown]
        )
        metrics["growth"][grown] = measure_many(longer)["growth"]
    return block, metrics


def _signals(
    campaign: Campaign, arms: LumpedArms, chosen: NDArray[np.int32], path: Real, vibration: Real
) -> Signals:
    shared = shared_rig(campaign.rig, campaign.law, campaign.motor_loop)
    (tip, motor_reference, voltage), marks = run_lumped(
        campaign.law, shared, arms, path, chosen, estimator=campaign.estimator
    )
    flags, mode, reason = marks
    return Signals(
        reference=arms.amplitude[:, None] * path[chosen, 0],
        tip=tip,
        motor_reference=motor_reference,
        voltage=voltage,
        flags=flags,
        mode=mode,
        reason=reason,
        period=campaign.law.period,
        ended=np.array([each.duration for each in campaign.references])[chosen],
        vibration_period=vibration,
    )


def block_of(campaign: Campaign, own: dict[str, Real], first: int) -> tuple[LumpedArms, NDArray[np.int32]]:
    """Return the arms of what was drawn for runs `first` …, and which reference each follows."""
    rig, period = campaign.rig, campaign.law.period
    count = len(own["payload"])
    stiff = own["stiffness"] / (own["payload"] * rig.link.length**2)
    links = batch_links(stiff, own["order"], period)
    second = np.repeat(second_mode_weights(campaign.model.second_mode, period), count, axis=0)
    number = first + np.arange(count, dtype=np.uint64)
    with np.errstate(over="ignore"):  # an odd multiplier folds the run's number into the seed: a bijection
        seeds = np.asarray(number * np.uint64(0x9E3779B97F4A7C15) + np.uint64(campaign.seed), dtype=np.uint64)
    same = ("stiffness", "motor_gain", "viscous_friction", "coulomb_torque", "gauge_offset", "delay_samples")
    values = {name: own[name] for name in (*same, "amplitude", "gauge_gain")}
    arms = LumpedArms.of(
        rig,
        replace(links, second=second),
        seeds,
        noise=rig.gauge.noise * own["noise"],
        gauge_delay=own["gauge_delay"] / period,
        payload_given=own["payload_given"] * own["payload"],
        **values,
    )
    return arms, (own["shape"] % len(campaign.references)).astype(np.int32)


# ── one run again ───────────────────────────────────────────────────────────────────────────────────────────


def _drawn(campaign: Campaign, run: int) -> tuple[dict[str, Real], int]:
    """All draws of the run's part, and the run's place in it."""
    if not is_whole(run, 0, campaign.runs - 1):
        allowed = f"0 … {campaign.runs - 1}"
        raise FieldError("run", run, "not in the campaign", allowed=allowed, remedy="give a run's number")
    part, at = divmod(run, PART_RUNS)
    return draw(campaign.draws, campaign.seed, part, campaign.part_runs(part)), at


@checked
def arm_of(campaign: Campaign, run: int) -> tuple[Rig, LinkModel, dict[str, float]]:
    """Return rig and link of run number `run`, and everything that was drawn for it, by name.

    Hand them to `simulate` to see what the run would be otherwise.
    """
    values, at = _drawn(campaign, run)
    own = {name: float(column[at]) for name, column in values.items()}
    motor = campaign.rig.motor
    rig = replace(
        campaign.rig,
        motor=replace(
            motor,
            torque_constant=motor.torque_constant * own["motor_gain"],
            viscous_friction=motor.viscous_friction * own["viscous_friction"],
            coulomb_torque=motor.coulomb_torque * own["coulomb_torque"],
        ),
    )
    link = LinkModel(
        own["stiffness"],
        (own["stiffness"] / (own["payload"] * campaign.rig.link.length**2)) ** 0.5,
        order=own["order"],
        payload=own["payload"],
        gauge_delay=own["gauge_delay"],
        gauge_gain=own["gauge_gain"],
        second_mode=campaign.model.second_mode,
    )
    return rig, link, own


@checked
def replay_run(campaign: Campaign, run: int) -> Run:
    """Return run number `run` of a campaign with all its signals, to the last bit what the campaign saw.

    Raises FieldError where the campaign has no such run.

    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023")
    >>> law = fl.discretize(fl.Controller(gain=0.069876, order=0.612197, link=rig.model), rig.period, order=4)
    >>> replay_run(Campaign.of(rig, rig.model, law, runs=100), 42).verdict.passed
    True
    """
    _, link, own = arm_of(campaign, run)
    values, at = _drawn(campaign, run)
    first = at - at % BLOCK  # the grid of a block's links depends on all of its arms
    block = {name: column[first : first + BLOCK] for name, column in values.items()}
    arms, chosen = block_of(campaign, block, run - at + first)
    row = np.array([at - first])
    arms, chosen = arms.rows(row), chosen[row]
    path = unit_paths(campaign)
    signals, marks = run_lumped(
        campaign.law,
        shared_rig(campaign.rig, campaign.law, campaign.motor_loop),
        arms,
        path,
        chosen,
        everything=True,
        estimator=campaign.estimator,
    )
    bank = campaign.estimator
    _, metrics = _measured(campaign, arms, chosen, path, _vibration(campaign, block)[row])
    return model_run(
        campaign.law,
        link,
        own["amplitude"] * path[chosen[0], 0],
        signals[:, 0],
        marks[:, 0],
        ended=campaign.references[chosen[0]].duration,
        growth=float(metrics["growth"][0]),
        estimates=None if bank is None else (bank, estimates_of_model(bank, signals[:, 0])),
        about={
            "arm": "model",
            "rig": campaign.rig.name,
            "law_sha256": campaign.law.digest,
            "campaign_run": run,
            "motor_loop": campaign.motor_loop,
            "gauge_delay": own["gauge_delay"],
            "gauge_gain": own["gauge_gain"],
            "gauge_offset": own["gauge_offset"],
            "gauge_noise": float(arms.noise[0]),
            "seed": int(arms.seed[0]),
            "delay_samples": int(own["delay_samples"]),
            "substeps": SUBSTEPS,
            "compensation": "ideal",
            "payload_given": float(arms.payload_given[0]) if bank is None else ESTIMATED,
        },
    )


# ── links ───────────────────────────────────────────────────────────────────────────────────────────────────


def batch_links(stiff: Real, order: Real, period: float) -> LinkWeights:
    """Return the recursions of links ``G = ω₀²/(s^λ + ω₀²)`` at `period` [s] for a motor angle of degree 5.

    Parameters
    ----------
    stiff
        ω₀² of each run [s^−λ], shape (R,), > 0.
    order
        λ of each run, shape (R,), 1 < λ ≤ 2.
    period
        control period [s]; |pole|·period < 2, beyond that no loop at that period holds.

    Raises
    ------
    FieldError
        a link too fast for the period.

    >>> import numpy as np
    >>> links = batch_links(np.array([123.1, 184.6]), np.array([1.92, 2.0]), 0.004)
    >>> links.weight.shape[:2], links.pair_weight.shape
    ((2, 6), (2, 6, 1))
    """
    speed = stiff ** (1.0 / order)
    reach = speed * period
    if float(reach.max()) >= LONGEST:
        raise FieldError(
            "period",
            period,
            "too long for the fastest link of the campaign",
            allowed=f"< {LONGEST / float(speed.max()):.3g} s",
            remedy="draw heavier payloads or a smaller stiffness",
        )
    grid = _grid(float(reach.min()), float(order.min()))
    density = -np.sin(np.pi * order)[:, None] * np.exp(np.multiply.outer(order, grid)) / np.pi
    density /= np.abs(1.0 + np.exp(order[:, None] * (grid + 1j * np.pi))) ** 2
    # Weight of e^(−r t) in S; over one period a mode answers a step by −gain·(1 − e^(−rT)) of it.
    real = STEP * density
    log_decay = -reach[:, None] * np.exp(grid)
    pole = reach * np.exp(1j * np.pi / order)
    pair = -(2.0 / order) * _correction(order, float(grid[0]))
    weight = _answers(real, log_decay)
    pair_weight = _answers(pair[:, None], pole[:, None])
    at_end = _powers_at_end(stiff, order, period)
    first = at_end - weight.sum(axis=2) - pair_weight.sum(axis=2).real
    return LinkWeights(
        decay=np.exp(log_decay),
        weight=np.ascontiguousarray(weight),
        pair=np.exp(pole[:, None]),
        pair_weight=np.ascontiguousarray(pair_weight),
        first=np.ascontiguousarray(first),
        second=np.zeros((0, 15)),
    )


def _grid(reach: float, order: float) -> Real:
    """Nodes v: the density falls like e^(−λ|v|), and above like e^(−e^v ΩT) from one period on."""
    low = -NEGLIGIBLE / order
    high = min(NEGLIGIBLE / order, math.log(NEGLIGIBLE / reach))
    return np.asarray(np.arange(math.floor(low / STEP), math.ceil(high / STEP) + 1) * STEP + 0.5 * STEP)


def _correction(order: Real, start: float) -> Complex:
    """What the trapezoidal rule leaves of a pole's residue: the rule counts the rest of it by itself.

    The density has simple poles at v = ±i y, y = π(1 − 1/λ), whose exponential is the link's own pair.
    """
    y = np.pi * (1.0 - 1.0 / order)
    phase = np.exp(2j * np.pi * start / STEP)
    return np.asarray(1.0 / (1.0 - phase * np.exp(-2.0 * np.pi * y / STEP)))


def _answers(gain: NDArray[np.inexact], log_decay: NDArray[np.inexact]) -> NDArray[np.inexact]:
    """Answer of gain·e^(zt/T), a part of a step response, to x^j over one period, at its end: (R, 6, modes).

    A step's share is gain·(e^z − 1) = gain·z·φ_0, so x^j's is gain·z·φ_j with φ_j = ∫₀¹ x^j e^(z(1−x)) dx.
    """
    near = np.abs(log_decay) < 1.0
    small, large = np.where(near, log_decay, 0.0), np.where(near, 1.0, log_decay)
    rows = []
    by_recursion = np.expm1(large) / large
    for j in range(POWERS):
        by_series = _series(small, j)
        if j:
            by_recursion = (j * by_recursion - 1.0) / large
        rows.append(gain * log_decay * np.where(near, by_series, by_recursion))
    return np.stack(rows, axis=1)


def _series(z: NDArray[np.inexact], power: int) -> NDArray[np.inexact]:
    """φ_j(z) = j! Σ zⁿ/(n + j + 1)! by Horner's rule: 16 terms give 1e-15 for |z| < 1."""
    total = np.zeros_like(z)
    for n in range(16, -1, -1):
        total = math.factorial(power) / math.factorial(n + power + 1) + z * total
    return total


def _powers_at_end(stiff: Real, order: Real, period: float) -> Real:
    """Response of G to x^j at x = 1, from the power series −Σ (−X)ⁿ of G: shape (R, 6)."""
    ratio = (stiff * period**order)[:, None, None]
    power = np.arange(POWERS)[None, :, None]
    n = np.arange(1, 40)[None, None, :]
    size = n * np.log(ratio) + gammaln(power + 1.0) - gammaln(order[:, None, None] * n + power + 1.0)
    return np.asarray(-np.sum((-1.0) ** n * np.exp(size), axis=2))
