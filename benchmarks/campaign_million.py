"""A million runs, as a user would ask for them: time, memory, size on disk, and what
they tell.

    python benchmarks/campaign_million.py [--runs 1000000] [--workers 2] [--out FOLDER]

Minutes, so `make bench` leaves it out. With --out a campaign that was interrupted goes
on, and the times are those of what was missing. Every line: what was measured | value |
wanted | error beside it.
"""

from __future__ import annotations

import argparse
import os
import resource
import tempfile
import time
from pathlib import Path

import fraclink as fl
from fraclink._campaign import Campaign, run_campaign, summarise


def line(what: str, value: str, wanted: str, error: str = "") -> None:
    """Print one figure."""
    print(f"{what} | {value} | {wanted} | {error}", flush=True)


def spent(who: int) -> float:
    """Processor time [s] of this process or of the workers it has waited for."""
    used = resource.getrusage(who)
    return used.ru_utime + used.ru_stime


def measure(runs: int, workers: int, folder: Path) -> None:
    """Compute the campaign, summarise it, and print what both took."""
    rig = fl.Rig.named("paper-2023")
    law = fl.discretize(
        fl.Controller(gain=0.069876, order=0.612197, link=rig.model),
        rig.period,
        order=4,
    )
    campaign = Campaign.of(rig, rig.model, law, runs=runs, seed=7)
    load, began = os.getloadavg()[0], time.monotonic()
    progress = run_campaign(campaign, folder, workers=workers)
    took, busy = time.monotonic() - began, spent(resource.RUSAGE_CHILDREN)
    done = progress.done - progress.before
    each = (
        f"{1e6 * busy / done:.0f} us a run of {round(campaign.duration / law.period) + 1} periods"
        if done
        else ""
    )
    line(
        f"{done} runs, {workers} workers: processor time of the workers",
        f"{busy:.0f} s, {busy / workers:.0f} s each",
        "-",
        each,
    )
    line(
        "  by the clock",
        f"{took:.0f} s",
        "-",
        f"load before: {load:.1f} on {os.cpu_count()} cores",
    )
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    line("  largest memory of a worker", f"{peak:.0f} MB", "<= 500 MB")
    size = sum(path.stat().st_size for path in folder.iterdir())
    line(
        "  on disk", f"{size / 1e6:.1f} MB", "-", f"{size / campaign.runs:.0f} B a run"
    )
    began_cpu = spent(resource.RUSAGE_SELF)
    summary = summarise(campaign, folder)
    mine = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    line(
        "  to summarise",
        f"{spent(resource.RUSAGE_SELF) - began_cpu:.1f} s",
        "-",
        f"{mine:.0f} MB",
    )
    line("  probability of failure", summary.failure.sentence, "-")


def main() -> None:
    """Print the figures of one campaign."""
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0] if __doc__ else None
    )
    parser.add_argument("--runs", type=int, default=1_000_000)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    if asked.out is not None:
        measure(asked.runs, asked.workers, asked.out)
        return
    with tempfile.TemporaryDirectory() as folder:
        measure(asked.runs, asked.workers, Path(folder))


if __name__ == "__main__":
    main()
