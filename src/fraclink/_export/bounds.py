"""Worst-case bounds of the exported law, rigorous: sums in ball arithmetic where python-flint is
installed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fraclink._law import Law

__all__ = ["CommandBounds", "worst_case"]


@dataclass(frozen=True)
class CommandBounds:
    """gain: |Ĉe| ≤ gain · max|e| for every error signal [rad/rad] (l1 norm of the exact coefficients).

    rounding: largest distance of the computed correction from the exact one while nothing is limited, for
    |e| ≤ `error` [rad]: one-step rounding errors times the l1 norms from where they enter to the output.
    rigorous: the sums were made in ball arithmetic, else in plain double precision.
    """

    gain: float
    rounding: float
    error: float
    rigorous: bool


def worst_case(law: Law, *, error: float = 0.5) -> CommandBounds:
    """Return the worst-case bounds of the correction for errors up to `error` [rad].

    With the modes apart, the impulse response of Ĉ is h[0] = d, h[k] = Σ g (p − 1) p^(k−2) + ...; its sum
    of moduli is taken to N and closed with the geometric tail Σ |g(p − 1)| |p|^(N−1)/(1 − |p|).
    """
    c = law.coefficients
    n, m = len(law.correction.poles), len(law.correction.pair_poles)
    real = np.asarray(c["real"]).reshape(-1, 2)[:n].tolist()
    pair = np.asarray(c["pair"]).reshape(-1, 4)[:m].tolist()
    poles: list[complex] = [pole for pole, _ in real] + [complex(a, b) for a, b, _, _ in pair]
    gains: list[complex] = [gain for _, gain in real] + [complex(a, b) for _, _, a, b in pair]
    direct = float(c["direct"])  # type: ignore[arg-type]
    slowest = max((abs(p) for p in poles), default=0.0)
    count = 3 if slowest == 0 else min(200_000, max(50, math.ceil(-40 / math.log(slowest))))
    gain, rigorous = _ball_norm(direct, poles, gains, count)
    return CommandBounds(gain, _rounding(law, direct, poles, gains, error), error, rigorous)


def _ball_norm(direct: float, poles: list[complex], gains: list[complex], count: int) -> tuple[float, bool]:
    try:
        from flint import acb, arb, ctx
    except ImportError:
        return _plain_norm(direct, poles, gains, count), False
    before, ctx.prec = ctx.prec, 106
    try:
        p, g = [acb(x) for x in poles], [acb(x) for x in gains]
        total = abs(arb(direct))
        power = list(g)  # g p^(k-1)
        previous = arb(direct)
        for _ in range(count):
            level = sum((x.real for x in power), arb(0))
            total += abs(level - previous)  # (1 − z⁻¹) of the inner response
            previous = level
            power = [x * y for x, y in zip(power, p, strict=True)]
        tail = sum((abs(x) * 2 / (1 - abs(y)) for x, y in zip(power, p, strict=True)), arb(0)) + abs(previous)
        return math.nextafter(float((total + tail).upper()), math.inf), True
    finally:
        ctx.prec = before


def _plain_norm(direct: float, poles: list[complex], gains: list[complex], count: int) -> float:
    k = np.arange(count)
    inner = np.zeros(count + 1)
    inner[0] = direct
    tail = 0.0
    for pole, gain in zip(poles, gains, strict=True):
        inner[1:] += (gain * np.power(complex(pole), k)).real
        tail += 2 * abs(gain) * abs(pole) ** count / (1 - abs(pole))
    return float(np.abs(np.diff(inner, prepend=0.0)).sum() + tail + abs(inner[-1])) * (1 + 1e-9)


def _rounding(law: Law, direct: float, poles: list[complex], gains: list[complex], error: float) -> float:
    """Sum over the modes of (largest one-step rounding) × (l1 norm from the state to the output)."""
    unit = 2.0**-24 if law.precision == "single" else 2.0**-53
    change = 2 * error
    # the change of the error is rounded once, and so is each product and each partial sum of the output
    total = abs(direct) * change * unit
    partial = abs(direct) * change
    for pole, gain in zip(poles, gains, strict=True):
        # a mode that leaks slowly without turning holds e minus its average: at most 2 max|e|, which is
        # `change`
        steady = isinstance(pole, float) and pole >= 0
        size = change if steady else change / (1 - abs(pole))
        step = (abs(pole) * size * 3 + change) * unit * (1 if isinstance(pole, float) else 2)
        total += abs(gain) * step / (1 - abs(pole)) + abs(gain) * size * unit
        partial += abs(gain) * size
    terms = len(poles) + 1
    # a change that is rounded by u·change acts through the whole filter without its difference
    static = abs(direct) + sum(abs(g) / (1 - abs(p)) for p, g in zip(poles, gains, strict=True))
    return total + terms * partial * unit + static * change * unit
