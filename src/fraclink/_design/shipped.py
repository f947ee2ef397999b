"""What the law that is shipped keeps of a design's promise, in the exactly sampled loop."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from fraclink._design.plan import Design, Requirement
from fraclink.findings import Finding

__all__ = ["with_law"]

NAME = "phase margin, shipped law"
ALLOWANCE = math.radians(0.5)  # of the fit of C, which the law states as its own error
_PAYLOADS = 9


def with_law(design: Design) -> Design:
    """Return the design with the worst sampled phase margin of its law as a further requirement.

    It is the margin asked for less the law's own tolerance of 0.5°; finding W404 says where less than the
    margin asked for is kept. A design for the paper's reading (`margins` "ideal") gets the finding alone: the
    sampled loop was not what it was asked for.
    """
    kept, payload = _worst(design)
    requirements = tuple(r for r in design.requirements if r.name != NAME)
    if design.margins_kind == "loop":
        wanted = design.phase_margin - ALLOWANCE
        requirements += (Requirement.at_least(NAME, wanted, kept, "rad", payload),)
    findings = tuple(f for f in design.findings if f.code != "W404")
    if kept < design.phase_margin:
        findings += (_finding(design, kept, payload),)
    return replace(design, requirements=requirements, findings=findings)


def _worst(design: Design) -> tuple[float, float]:
    """(smallest signed phase margin of the law [rad], its payload [kg]); negative where unstable."""
    found = []
    for pi in np.geomspace(*design.natural_frequencies, _PAYLOADS):
        payload = design.payload(float(pi))
        got = design.sampled_at(payload)
        margin = math.pi if got.phase_margin is None else abs(got.phase_margin)
        found.append((margin if got.stable else -margin, payload))
    return min(found)


def _finding(design: Design, kept: float, payload: float) -> Finding:
    small = kept >= design.phase_margin - ALLOWANCE
    return Finding(
        "W404",
        "info" if small else "warning",
        "the shipped law in the sampled loop keeps less phase margin than was asked for",
        {"phase_margin_rad": kept, "wanted_rad": design.phase_margin, "payload_kg": payload},
        "ask for as much more as is missing, with margins='loop'",
    )
