"""A small campaign, and its command line as a process that can be killed."""

from __future__ import annotations

import functools
import subprocess
import sys
from pathlib import Path

import fraclink as fl
from fraclink.extend import geared
from fraclink.trials import Bench, Campaign, run_campaign


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
    design = fl.design(
        rig.model,
        rig,
        payloads=(0.020, 0.040),
        gain_crossover=12.0,
        phase_margin=fl.deg(50),
    )
    return Bench.of(design, link_mass=0.00735)


def computed(campaign: Campaign, folder: Path) -> Path:
    """Every part of a campaign, computed one after the other in this process without
    interruption.
    """
    run_campaign(campaign, folder)
    return folder


def continued(folder: Path, *, workers: int = 2) -> subprocess.Popen[str]:
    """`run_campaign` for the campaign in `folder`, as a process in a session of its
    own.
    """
    code = (
        "import sys; from fraclink.trials import load_campaign, run_campaign; f = sys.argv[1]; "
        ""
        f"run_campaign(load_campaign(f), f, workers={workers})"
    )
    return subprocess.Popen(  # noqa: S603
        [sys.executable, "-c", code, str(folder)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def parts_of(folder: Path) -> dict[str, bytes]:
    """Bytes of every finished part by name."""
    return {path.name: path.read_bytes() for path in sorted(folder.glob("part-*.npz"))}
