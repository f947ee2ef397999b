"""The arms of a campaign: drawn, run in blocks through the kernel, measured, and
repeated on demand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.link import LinkModel
from fraclink._arm.reference import sampled
from fraclink._arm.rig import Rig
from fraclink._simulate.estimates import ESTIMATED
from fraclink._simulate.kernel import LumpedArms, run_lumped, shared_rig
from fraclink._simulate.links import batch_links
from fraclink._simulate.metrics import Signals, judge_many, measure_many
from fraclink._simulate.run import Run
from fraclink._simulate.simulate import model_run
from fraclink.errors import FieldError
from fraclink.trials._campaign import PART_RUNS, Campaign, draw
from fracsys.checks import Between, Real, checked

__all__ = ["arm_of", "replay_run", "simulate_part"]


# Periods that the kernel simulates in one call, without the interpreter's lock: 2 MB a
# signal, whatever the length of a run.
BATCH = 250_000


# --- parts ----------------------------------------------------------------------------


@checked
def simulate_part(
    campaign: Campaign, part: Annotated[int, Between(0)]
) -> dict[str, NDArray[np.generic]]:
    """Return parameters, metrics and verdict of every run of a part, by column name;
    shape (R,).
    """
    Between(0, campaign.parts - 1).check("part", part)
    runs = campaign.part_runs(part)
    values = draw(campaign.draws, campaign.seed, part, runs)
    blocks = []
    for at in range(0, runs, batch_runs(campaign)):
        block = block_of(campaign, values, part, at)
        rows, metrics = _measured(campaign, block)
        blocks.append(metrics | judge_many(_judged(campaign, block, rows), metrics))
    measured = {
        name: np.concatenate([each[name] for each in blocks]) for name in blocks[0]
    }
    number = np.arange(part * PART_RUNS, part * PART_RUNS + runs, dtype=np.int64)
    # Drawn as an integer of 31 bits, so that a seed draws the same arms for one
    # reference as for three; the index of the reference that the run followed is stored.
    values["shape"] = values["shape"] % len(campaign.references)
    return {"run": number} | values | measured


def batch_runs(campaign: Campaign) -> int:
    """Number of runs of a campaign that are simulated together."""
    return max(1, round(BATCH * campaign.law.period / campaign.duration))


@dataclass(frozen=True)
class Block:
    """Some arms of a part, the index of the reference that each follows, and the period
    of each link's vibration [s], shape (R,).
    """

    arms: LumpedArms
    chosen: NDArray[np.int32]
    vibration: Real

    def rows(self, rows: NDArray[np.intp]) -> Block:
        """Return the arms at the given indices."""
        return Block(self.arms.rows(rows), self.chosen[rows], self.vibration[rows])


def block_of(campaign: Campaign, values: dict[str, Real], part: int, at: int) -> Block:
    """Return the block of arms from the draws of a part that begins with run `at`."""
    rig, period = campaign.rig, campaign.law.period
    batch = slice(at, at + batch_runs(campaign))
    own = {name: column[batch] for name, column in values.items()}
    # Equation (5) for each arm: the link is massless, so stiffness and payload
    # determine its frequency. η = μ/ω₀² is the same for every payload, as in
    # `LinkModel.at_payload`.
    stiff = own["stiffness"] / (own["payload"] * rig.link.length**2)
    order, damping = own["order"], campaign.model.loss * own["damping"] * stiff
    # Twice as long as a run: a vibration that seems to grow is followed that far.
    links = batch_links(
        campaign.model, stiff, order, damping, period, 2.0 * campaign.duration
    )
    # The pole Ω e^(iπ/λ) oscillates at Ω sin(π/λ). With Ω alone, the windows in which
    # growth and residual vibration are measured would be 0.3 % short for λ = 1.9, and
    # 13 % for λ = 1.5.
    pole = np.log(links.pair[:, 0]) / period
    number = part * PART_RUNS + at + np.arange(len(stiff), dtype=np.uint64)
    # an odd multiplier maps the run number to the seed one to one
    with np.errstate(over="ignore"):
        seeds = np.asarray(
            number * np.uint64(0x9E3779B97F4A7C15) + np.uint64(campaign.seed),
            np.uint64,
        )
    as_drawn = (
        "stiffness",
        "motor_gain",
        "viscous_friction",
        "coulomb_torque",
        "gauge_offset",
        "delay_samples",
        "amplitude",
        "gauge_gain",
    )
    arms = LumpedArms.of(
        rig,
        links,
        seeds,
        noise=rig.gauge.noise * own["noise"],
        gauge_delay=own["gauge_delay"] / period,
        payload_given=own["payload_given"] * own["payload"],
        **{name: own[name] for name in as_drawn},
    )
    references = (own["shape"] % len(campaign.references)).astype(np.int32)
    return Block(arms, references, 2.0 * np.pi / np.maximum(pole.imag, -pole.real))


def _rows(campaign: Campaign, block: Block, times: int = 1) -> dict[str, Any]:
    """The signals of a block's runs, `times` as long as a run of the campaign."""
    length = times * campaign.duration
    # angle and acceleration of each of the campaign's references, (shapes, 2, N)
    path = np.ascontiguousarray(
        [
            sampled(each, campaign.law.period, length)[[0, 2]]
            for each in campaign.references
        ]
    )
    rows = run_lumped(
        campaign.law,
        shared_rig(campaign.rig, campaign.law),
        block.arms,
        path,
        block.chosen,
        estimator=campaign.estimator,
    )
    # The kernel scales the unit reference by the amplitude; the signals contain the
    # reference that the arm followed.
    return rows | {
        "reference": block.arms.column("amplitude")[:, None] * path[block.chosen, 0]
    }


def _judged(campaign: Campaign, block: Block, rows: dict[str, Any]) -> Signals:
    # The end of the reference only: the metrics add the vibration periods in which the
    # residual is measured.
    ended = np.array([each.duration for each in campaign.references])[block.chosen]
    return Signals.of(rows, campaign.law.period, ended, block.vibration)


def _measured(
    campaign: Campaign, block: Block
) -> tuple[dict[str, Any], dict[str, Real]]:
    """The signals and metrics of a block; a vibration that seems to grow is followed
    for twice as long.

    In one of several thousand runs, noise excites a good arm such that its envelope
    rises throughout the run; one in a few campaigns of a thousand runs would report an
    unstable arm. The vibration of an unstable arm goes on growing.
    """
    rows = _rows(campaign, block)
    metrics = measure_many(_judged(campaign, block, rows))
    growing = np.flatnonzero(metrics["growth"] > 0.0)
    if growing.size:
        # The same arms with the same noise as in the first run, continued for the same
        # time again: an envelope raised by noise falls back, one that grows is larger
        # by e^(growth · duration).
        some = block.rows(growing)
        longer = _judged(campaign, some, _rows(campaign, some, 2))
        metrics["growth"][growing] = measure_many(longer)["growth"]
    return rows, metrics


# --- one run again --------------------------------------------------------------------


def _drawn(campaign: Campaign, run: int) -> tuple[dict[str, Real], int]:
    """All draws of the part that contains the run, and the index of the run in it."""
    if not 0 <= run < campaign.runs:
        raise FieldError(
            "run",
            run,
            "not in the campaign",
            f"0 … {campaign.runs - 1}",
            "give a run's number",
        )
    part, at = divmod(run, PART_RUNS)
    return draw(campaign.draws, campaign.seed, part, campaign.part_runs(part)), at


@checked
def arm_of(campaign: Campaign, run: int) -> tuple[Rig, LinkModel, dict[str, float]]:
    """Return rig and link of run number `run`, and all values drawn for it, by name.

    Pass them to `simulate` to vary the run.
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
    stiff = own["stiffness"] / (own["payload"] * campaign.rig.link.length**2)
    link = LinkModel(
        own["stiffness"],
        stiff**0.5,
        order=own["order"],
        damping=campaign.model.loss * own["damping"] * stiff,
        damping_order=campaign.model.damping_order,
        payload=own["payload"],
        gauge_delay=own["gauge_delay"],
        gauge_gain=own["gauge_gain"],
        second_mode=campaign.model.second_mode,
    )
    return rig, link, own


@checked
def replay_run(campaign: Campaign, run: int) -> Run:
    """Return run number `run` of a campaign with all its signals, to the last bit what
    the campaign saw.

    Raises FieldError where the campaign has no such run.

    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023")
    >>> controller = fl.Controller(derivative_gain=0.069876, derivative_order=0.612197, link=rig.model)
    >>> law = fl.discretize(controller, rig.period, order=4)
    >>> replay_run(Campaign.of(rig, rig.model, law, runs=100), 44).verdict.passed
    True
    """
    _, link, own = arm_of(campaign, run)
    values, at = _drawn(campaign, run)
    # The grid of a block's links depends on all of its arms.
    first = at - at % batch_runs(campaign)
    whole = block_of(campaign, values, run // PART_RUNS, first)
    block = whole.rows(np.array([at - first]))
    rows, metrics = _measured(campaign, block)
    arms, estimator = block.arms, campaign.estimator
    return model_run(
        campaign.law,
        link,
        {name: signal[0] for name, signal in rows.items()},
        ended=campaign.references[block.chosen[0]].duration,
        growth=float(metrics["growth"][0]),
        estimator=estimator,
        about={
            "arm": "model",
            "rig": campaign.rig.name,
            "law_sha256": campaign.law.digest,
            "campaign_run": run,
            "motor_loop": "sampled",
            "gauge_delay": own["gauge_delay"],
            "gauge_gain": own["gauge_gain"],
            "gauge_offset": own["gauge_offset"],
            "gauge_noise": float(arms.column("noise")[0]),
            "seed": int(arms.seed[0]),
            "delay_samples": int(own["delay_samples"]),
            "payload_given": float(arms.column("payload_given")[0])
            if estimator is None
            else ESTIMATED,
        },
    )
