"""Which cause costs how many arms of the default campaign: take one away, run the same
arms again.

    python benchmarks/why_arms_fail.py [--runs 2000]

Every variant draws the same arms (one seed). What is counted: arms that fail, of these
the tripped ones, the growing ones, and the share of failures among moves below and
above 0.5 rad.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

import fraclink as fl
from fraclink._campaign import Campaign, Distribution, simulate_part
from fraclink._campaign.campaign import PART_RUNS
from fraclink._simulate import geared

PAPER = fl.Rig.named("paper-2023")
SMALL = 0.5  # [rad]


def design_of(rig: fl.Rig, **asked: object) -> fl.Design:
    """The design that the rig asks for."""
    wanted = {"gain_crossover": 12.0, "phase_margin": fl.deg(50)} | asked
    return fl.design(rig.model, rig, **wanted)  # type: ignore[arg-type]


def always(value: float) -> Distribution:
    """A parameter that does not vary."""
    return Distribution("uniform", value, value)


def variants(runs: int) -> Iterator[tuple[str, Campaign]]:
    """The default campaign, and each with one cause less."""
    base = Campaign.of(PAPER, PAPER.model, design_of(PAPER).law(), runs=runs)

    def drawn(**changes: Distribution) -> Campaign:
        return replace(base, draws=replace(base.draws, **changes))

    yield "default: paper-2023 as printed", base
    yield "without Coulomb friction in the motor", drawn(coulomb_torque=always(0.0))
    yield "Coulomb torque as the law compensates it", drawn(coulomb_torque=always(1.0))
    yield "without gauge noise", drawn(noise=always(0.0))
    yield "without gauge offset", drawn(gauge_offset=always(0.0))
    yield (
        "neither friction nor noise",
        drawn(coulomb_torque=always(0.0), noise=always(0.0)),
    )
    yield (
        "moves of 0.5 to 1.2 rad only",
        drawn(amplitude=Distribution("uniform", SMALL, 1.2)),
    )
    yield (
        "nominal link, motor and payload",
        drawn(
            payload=always(PAPER.payloads.nominal),
            stiffness=always(base.model.stiffness),
            order=always(base.model.order),
            motor_gain=always(1.0),
            viscous_friction=always(1.0),
        ),
    )
    exact = replace(PAPER, encoder=replace(PAPER.encoder, counts_per_revolution=None))
    yield "exact encoder", replace(base, rig=exact)
    longer = replace(base, duration=8.0)
    yield "8 s in place of 4 s", longer
    for ratio in (10.0, 50.0, 100.0):
        rig = geared(PAPER, ratio)
        yield (
            f"reduction gear of {ratio:g}",
            Campaign.of(rig, rig.model, design_of(rig).law(), runs=runs),
        )


def counted(campaign: Campaign) -> str:
    """One line of the table."""
    parts = [simulate_part(campaign, part) for part in range(campaign.parts)]
    column = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    failed = ~column["passed"].astype(bool)
    small = column["amplitude"].astype(float) < SMALL
    tripped = column["mode"] != 1
    grew = column["growth"].astype(float) > 0.0
    shares = [
        100 * float(failed[rows].mean()) if rows.any() else float("nan")
        for rows in (small, ~small)
    ]
    left = np.abs(column["steady_state_error"].astype(float))[failed & ~tripped]
    median = 1e3 * float(np.median(left)) if left.size else float("nan")
    return (
        f"{100 * failed.mean():6.1f} % {100 * tripped.mean():8.1f} % {100 * grew.mean():8.1f} % "
        f"{shares[0]:8.1f} % {shares[1]:8.1f} % {median:10.2f} mrad"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=2 * PART_RUNS)
    runs = parser.parse_args().runs
    head = ("tripped", "growing", "< 0.5 rad", ">= 0.5 rad", "median error")
    print(f"{'variant':42} {'failed':>8} " + " ".join(f"{word:>10}" for word in head))
    for title, campaign in variants(runs):
        print(f"{title:42} {counted(campaign)}", flush=True)


if __name__ == "__main__":
    main()
