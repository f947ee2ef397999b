"""Rounding: the law in both precisions against the exact law, in ball arithmetic, over
a million periods.

The exact law has the coefficients of double precision; samples are numbers of single
precision, as those of a converter are. Its recursion runs in balls of 160 bits, whose
radius stands beside the figures.
"""

from __future__ import annotations

import numpy as np
from flint import arb, ctx
from numpy.typing import NDArray

import fraclink as fl
from bench_law import RIG, figure
from fraclink._law import Law, discretize_controller

PERIODS = 1_000_000
BITS = 160

Real = NDArray[np.float64]


def exact_correction(law: Law, torque: Real) -> tuple[Real, float]:
    """Return Ĉ(z) of the error Γ/c, shape (N,), and the largest radius of its balls."""
    before, ctx.prec = ctx.prec, BITS
    try:
        poles = [arb(pole) for pole in law.correction.poles]
        gains = [arb(gain) for gain in law.correction.gains]
        direct, compliance = arb(law.correction.direct), 1 / arb(law.stiffness)
        states, last, radius = [arb(0)] * len(poles), arb(torque[0]) * compliance, 0.0
        result = np.empty(len(torque))
        for k, value in enumerate(torque.tolist()):
            error = arb(value) * compliance
            change, last = error - last, error
            output = direct * change
            for gain, state in zip(gains, states, strict=True):
                output += gain * state
            states = [
                pole * state + change for pole, state in zip(poles, states, strict=True)
            ]
            result[k], radius = float(output.mid()), max(radius, float(output.rad()))
        return result, radius
    finally:
        ctx.prec = before


def signals() -> dict[str, Real]:
    """Return torques [N·m]: what the arm of the paper does all day, and slow swings
    with little on top.
    """
    noise = np.random.default_rng(3).standard_normal(PERIODS)
    smooth = np.convolve(noise, np.ones(25) / 25, mode="same")
    smooth /= smooth.std()
    swing = np.sin(np.pi * RIG.period * np.arange(PERIODS))
    # Small enough for the motor's speed limit: a limited output is right in every
    # precision.
    torques = {
        "0.005 rad rms, to 250 rad/s": 1.56 * 0.005 * smooth,
        "0.2 rad at 0.5 Hz": 1.56 * (0.2 * swing + 0.002 * smooth),
    }
    return {
        name: torque.astype(np.float32).astype(np.float64)
        for name, torque in torques.items()
    }


def main() -> None:
    law = discretize_controller(
        fl.Controller(gain=0.069876, order=0.612197, link=RIG.model), RIG.period
    )
    for name, torque in signals().items():
        exact, radius = exact_correction(law, torque)
        rows = np.zeros((4, PERIODS))
        rows[3] = torque
        for precision, bound in (("single", 1e-6), ("double", 1e-14)):
            made = law.in_precision(precision)  # type: ignore[arg-type]
            run = made.run(made.initial_state(), *rows)[1]
            limited = np.count_nonzero(run.flags[1:])
            rms = float(
                np.sqrt(np.mean((run.motor_reference - exact) ** 2) / np.mean(exact**2))
            )
            note = f"{name}; radius of the exact law {radius:.0e} rad; {limited} periods limited"
            figure(
                f"{precision} against exact, {PERIODS} periods, rms",
                f"{rms:.2e}",
                f"<= {bound:g}",
                rms <= bound,
                note,
            )


if __name__ == "__main__":
    main()
