"""One run of a campaign again, with all its signals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fraclink import _kernels
from fraclink._arm.link import LinkModel
from fraclink._arm.reference import smooth_step
from fraclink._arm.rig import Rig
from fraclink._campaign.campaign import PART_RUNS, SHAPES, Campaign
from fraclink._campaign.draws import draw
from fraclink._campaign.part import BLOCK, SUBSTEPS, Block, block_of, shared_rig, unit_paths
from fraclink._simulate.run import Run, Settings
from fraclink._simulate.simulate import judged
from fraclink._validate import checked_noun, is_whole
from fraclink.errors import FieldError

__all__ = ["arm_of", "replay"]

Real = NDArray[np.float64]


def _drawn(campaign: Campaign, run: int) -> tuple[dict[str, Real], int, int]:
    """All draws of the run's part, the part, and the run's place in it."""
    checked_noun("campaign", campaign, Campaign, remedy="Campaign.of makes one, load_campaign reads one")
    if not is_whole(run, 0, campaign.runs - 1):
        raise FieldError(
            "run",
            run,
            "not in the campaign",
            allowed=f"0 … {campaign.runs - 1}",
            remedy="give a run's number",
        )
    part, at = divmod(run, PART_RUNS)
    return draw(campaign.draws, campaign.seed, part, campaign.part_runs(part)), part, at


def arm_of(campaign: Campaign, run: int) -> tuple[Rig, LinkModel, dict[str, float]]:
    """Return rig and link of run number `run`, and everything that was drawn for it, by name.

    Hand them to `simulate` to see what the run would be otherwise.
    """
    values, _, at = _drawn(campaign, run)
    own = {name: float(v[at]) for name, v in values.items()}
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
    return rig, LinkModel(own["stiffness"], stiff**0.5, order=own["order"], payload=own["payload"]), own


def replay(campaign: Campaign, run: int) -> Run:
    """Return run number `run` of a campaign with all its signals, to the last bit what the campaign saw.

    Raises FieldError where the campaign has no such run.

    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023")
    >>> law = fl.Controller(gain=0.069876, order=0.612197, link=rig.model).discretize(rig.period, order=4)
    >>> replay(Campaign.of(rig, rig.model, law, runs=100), 42).verdict.passed
    True
    """
    values, part, at = _drawn(campaign, run)
    block = block_of(campaign, values, part, at - at % BLOCK)
    _, link, own = arm_of(campaign, run)
    row = at % BLOCK
    shape = SHAPES[int(block.chosen[row])]
    angle, acceleration = own["amplitude"] * unit_paths(campaign)[block.chosen[row]]
    path = np.stack([angle, np.zeros_like(angle), acceleration])  # the kernel does not read the speed
    signals = np.empty((7, path.shape[1]))
    marks = np.empty((3, path.shape[1]), dtype=np.uint32)
    _run_alone(campaign, block, row, path, signals, marks)
    settings = Settings(
        rig=campaign.rig.name,
        law_sha256=campaign.law.digest,
        payload=own["payload"],
        inner=campaign.inner,
        gauge_offset=own["gauge_offset"],
        noise=campaign.rig.gauge.noise * own["noise"],
        seed=int(block.seeds[row]),
        delay_samples=int(own["delay_samples"]),
        substeps=SUBSTEPS,
        compensation="ideal",
    )
    return judged(
        campaign.law, link, np.array(path[0]), signals, marks, settings, smooth_step(1.0, shape).duration
    )


def _run_alone(
    campaign: Campaign, block: Block, row: int, path: Real, signals: Real, marks: NDArray[np.uint32]
) -> None:
    links, n = block.links, block.numbers[row]
    rig = shared_rig(campaign, numbers=n, seed=int(block.seeds[row]))
    _kernels.loop_run(
        campaign.law.block,
        campaign.law.precision == "single",
        rig,
        float(n[0]),
        links.first[row],
        links.decay[row],
        links.weight[row],
        np.ascontiguousarray(links.pair[row].real),
        np.ascontiguousarray(links.pair[row].imag),
        np.ascontiguousarray(links.pair_weight[row].real),
        np.ascontiguousarray(links.pair_weight[row].imag),
        path,
        signals,
        marks,
    )
