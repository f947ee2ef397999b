"""The moves of Figs. 11 to 16, simulated with the offset and the noise of the gauge on
the paper's rig.
"""

from __future__ import annotations

from functools import cache

from fraclink._arm.controller import Controller
from fraclink._arm.reference import smooth_step
from fraclink._law import discretize
from fraclink._simulate import Run, simulate
from reproduce import designs

__all__ = ["OFFSET", "move", "tracking_pairs"]

OFFSET = 0.05  # N·m: not printed in the paper; its Fig. 14 shows a small one
DURATION = 5.0  # s, the length of the figures


@cache
def move(controller: Controller, payload: float) -> Run:
    """A move of 1 rad in 1 s at `payload` [kg] on the fractional link, M(s), 4 ms, one
    sample of delay.
    """
    return simulate(
        discretize(controller, designs.rig().period, precision="double"),
        smooth_step(1.0, duration=1.0),
        rig=designs.rig(),
        model=designs.link(0.030),
        payload=payload,
        duration=DURATION,
        gauge_offset=OFFSET,
        seed=1,
    )


def tracking_pairs() -> tuple[designs.Pair, ...]:
    """The pairs in the figures: as printed, with δ read as 0.0016 s, corrected, and
    fraclink's own.
    """
    return designs.printed(), designs.rescaled(), designs.corrected(), designs.in_loop()
