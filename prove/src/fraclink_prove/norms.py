"""The worst-case gain of a law's correction: its l1 norm, in ball arithmetic."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from flint import acb, arb, ctx

from fraclink._law import Law

__all__ = ["worst_gain"]

_GONE = 80.0  # |p|^k = e^(-80): 1e-35


def worst_gain(law: Law) -> float:
    """Return the least g with |Ĉe| ≤ g · max|e| for every error signal, rounded up.

    As a sum of modes, the impulse response of Ĉ is h[0] = d, h[k] = Σ g (p − 1)
    p^(k−2) + ...; its sum of moduli is taken to N and closed with the geometric tail Σ
    |g(p − 1)| |p|^(N−1)/(1 − |p|).
    """
    c = law.coefficients
    n, m = len(law.correction.poles), len(law.correction.pair_poles)
    real = np.asarray(c["real"]).reshape(-1, 2)[:n].tolist()
    pair = np.asarray(c["pair"]).reshape(-1, 4)[:m].tolist()
    poles: list[complex] = [pole for pole, _ in real] + [
        complex(a, b) for a, b, _, _ in pair
    ]
    gains: list[complex] = [gain for _, gain in real] + [
        complex(a, b) for _, _, a, b in pair
    ]
    slowest = max((abs(p) for p in poles), default=0.0)
    # e^(−40) = 4e-18 of the slowest mode: the rest is below the last bit of a double.
    # The limit ends the sum of a pole such as 0.99997 early, which makes the bound less
    # sharp but no less rigorous, since the tail is added as a bound.
    count = (
        3 if slowest == 0 else min(200_000, max(50, math.ceil(-40 / math.log(slowest))))
    )
    return _ball_norm(float(c["direct"]), poles, gains, count)  # type: ignore[arg-type]


def _ball_norm(
    direct: float, poles: list[complex], gains: list[complex], count: int
) -> float:
    # A rectangle around a complex number grows by a factor √2 with each rotation, half
    # a bit: more bits are needed until a pair has decayed below the last bit of a
    # double, and is dropped.
    lives = max(
        (math.ceil(-_GONE / math.log(abs(p))) for p in poles if isinstance(p, complex)),
        default=0,
    )
    before, ctx.prec = ctx.prec, 106 + (lives + 1) // 2
    try:
        # The coefficients are doubles: each is an exact ball, so the norm is that of
        # the numbers that ship, not of the design from which they were rounded.
        p, g = [acb(x) for x in poles], [acb(x) for x in gains]
        total = abs(arb(direct))
        power = list(g)  # g p^(k-1)
        previous, tail = arb(direct), arb(0)
        before_it = power
        for k in range(count):
            if lives and k == lives:
                pairs = [isinstance(x, complex) for x in poles]
                dropped = zip(before_it, power, p, pairs, strict=True)
                # `previous` includes the pairs, whose contribution is counted too
                tail += sum(
                    (abs(w) + _rest(x, y) for w, x, y, pair in dropped if pair), arb(0)
                )
                power, p = (
                    [x for x, pair in zip(each, pairs, strict=True) if not pair]
                    for each in (power, p)
                )
                ctx.prec = 106
            level = sum((x.real for x in power), arb(0))
            total += abs(level - previous)  # (1 − z⁻¹) of the inner response
            previous, before_it = level, power
            power = [x * y for x, y in zip(power, p, strict=True)]
        tail += sum((_rest(x, y) for x, y in zip(power, p, strict=True)), arb(0)) + abs(
            previous
        )
        # float() rounds to nearest, possibly below the upper end of the ball; one unit
        # in the last place more is above it.
        return math.nextafter(float((total + tail).upper()), math.inf)
    finally:
        ctx.prec = before


def _rest(power: Any, pole: Any) -> Any:
    """The remaining contribution of a mode to the sum of |h[k] − h[k−1]|: Σ |g p^j (p −
    1)| ≤ 2 |g p^k|/(1 − |p|).
    """
    return abs(power) * 2 / (1 - abs(pole))
