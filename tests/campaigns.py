"""A small campaign, and the bench of the faults."""

from __future__ import annotations

import functools

import fraclink as fl
from fraclink.extend import geared
from fraclink.trials import Bench, Campaign
from law_bench import documented_design


@functools.cache
def small(runs: int = 2500, seed: int = 7) -> Campaign:
    """The paper's arm under our own law of order 4: three parts, the last one half
    full.
    """
    rig = fl.Rig.named("paper-2023")
    law = fl.discretize(
        fl.Controller(
            derivative_gain=0.069876, derivative_order=0.612197, link=rig.model
        ),
        rig.period,
        order=4,
    )
    return Campaign.of(rig, rig.model, law, runs=runs, seed=seed)


@functools.cache
def fault_bench() -> Bench:
    """The paper's arm behind a gear, its link with mass, under the design of the
    documentation.
    """
    rig = geared(fl.Rig.named("paper-2023"))
    design = documented_design(rig)
    return Bench.of(design, link_mass=0.00735)
