"""Simulation of a move on the model before the arm makes it."""

from __future__ import annotations

import numpy as np

from fraclink._arm.reference import Reference, sampled
from fraclink._law import MODES, REASONS, Law
from fraclink._law.design import Design
from fraclink._simulate.simulate import simulate
from fraclink.errors import FieldError
from fraclink.lab._tune_guard import largest

__all__ = ["rehearse"]


def rehearse(
    design: Design, law: Law, reference: Reference, *, payload: float = 0.0
) -> None:
    """FieldError if the move exceeds the law's limits, or trips the law on the model of
    the design.

    `payload` [kg] is given to the law; with 0 it gets none, and the simulated payload
    is the rig's nominal one.
    """
    reach = largest(sampled(reference, law.period, reference.duration)[0])
    # Relative to the position of the arm, which may be anywhere in the encoder's range.
    most = law.limits.motor_limit - abs(design.rig.moves.centre)
    if reach > most:
        raise FieldError(
            "reference",
            f"{reach:.3g} rad",
            "beyond the limits of the law; the arm has not moved",
            f"<= {most:.3g} rad",
            "ask for a smaller move, or state the rig's [moves]",
        )
    run = simulate(
        law,
        reference,
        rig=design.rig,
        model=design.model,
        payload=payload or design.rig.payloads.nominal,
        told=payload > 0,
        duration=reference.duration + 1.0,
    )
    if (trips := np.flatnonzero(run.mode > MODES.index("run"))).size:
        row = trips[0]
        raise FieldError(
            "reference",
            f"{REASONS[int(run.reason[row])]} at {run.time[row]:.3g} s",
            "trips the law on its own model; the arm has not moved",
            "a move that the law completes on its model",
            "ask for a slower or a smaller move (--move-time, --amplitude)",
        )
