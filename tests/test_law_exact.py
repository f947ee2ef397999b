"""The law in both precisions against the exact law, whose recursion is computed in ball
arithmetic with 160 bits.
"""

from __future__ import annotations

import numpy as np
import pytest
from flint import arb, ctx

from fraclink import Law
from law_bench import law, run

PERIODS = 20_000
BITS = 160


def exact_correction(made: Law, torque: list[float]) -> tuple[list[float], float]:
    """Ĉ(z) applied to the error Γ/c in exact arithmetic, and the largest radius of its
    balls.
    """
    before, ctx.prec = ctx.prec, BITS
    try:
        poles, gains = map(arb, made.correction.poles), map(arb, made.correction.gains)
        modes = list(zip(poles, gains, strict=True))
        states, last = [arb(0)] * len(modes), arb(torque[0]) / arb(made.stiffness)
        result, radius = [], 0.0
        for value in torque:
            error = arb(value) / arb(made.stiffness)
            change, last = error - last, error
            output = arb(made.correction.direct) * change
            output += sum(
                (gain * x for (_, gain), x in zip(modes, states, strict=True)), arb(0)
            )
            states = [
                pole * x + change for (pole, _), x in zip(modes, states, strict=True)
            ]
            result.append(float(output.mid()))
            radius = max(radius, float(output.rad()))
        return result, radius
    finally:
        ctx.prec = before


@pytest.mark.slow
@pytest.mark.parametrize(("precision", "bound"), [("single", 1e-6), ("double", 1e-14)])
def test_the_law_stays_with_the_exact_one(precision: str, bound: float) -> None:
    noise = np.random.default_rng(7).standard_normal(PERIODS)
    smooth = np.convolve(noise, np.ones(25) / 25, mode="same")
    torque = (
        (1.56 * 0.005 * smooth / smooth.std()).astype(np.float32).astype(np.float64)
    )
    rows = np.zeros((4, PERIODS))
    rows[3] = torque
    outputs = run(law(precision, equipped=False), rows)
    exact, radius = exact_correction(law(equipped=False), torque.tolist())
    assert radius < 1e-40
    assert not outputs.flags[1:].any()  # no limit was active
    error = outputs.motor_reference - np.array(exact)
    assert np.sqrt(np.mean(error**2)) <= bound * np.sqrt(np.mean(np.square(exact)))
