"""What a transfer function does at s → 0, taken off before it is expanded into modes.

    G(s) = c/s + Σ c_i s^(-a_i) + rest,   a_i ≥ 0.94

The integrator is a mode of its own (a decay of exactly 1). Higher singular powers have no modes whose sum
stays accurate from one period to the whole span; their responses t^a/Γ(1+a) are known and are convolved.
Weaker ones (a_i < 0.94) stay in the rest: the branch cut carries them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from fraclink._systems.fractional import Term
from fraclink._systems.fractional.terms import collect, same

__all__ = ["LowFrequency", "split_low_frequency"]

# The cut's quadrature runs down to where r^(1-a) is below rounding: 42/(1-a) e-folds. At 0.94 these are 700,
# and the exponent range of a double ends near.
STRONG = 0.94
_MOST = 20  # singular powers: such a series in closely spaced orders is useless where it is not exact


@dataclass(frozen=True)
class LowFrequency:
    """`integrator` c of c/s, `powers` as (c, a) of c·s^(-a), and the rest as numerator and denominator.

    `is_split` is False where the powers are too many to be told apart; then the rest is all of G.
    """

    integrator: float
    powers: tuple[tuple[float, float], ...]
    top: tuple[Term, ...]
    bottom: tuple[Term, ...]
    is_split: bool = True


def split_low_frequency(top: Sequence[Term], bottom: Sequence[Term]) -> LowFrequency:
    """Divide in rising powers of s until what is left is weaker than s^(-0.94)."""
    rest, lowest = collect(top), bottom[-1]
    integrator, powers = 0.0, []
    while rest and lowest.order - rest[-1].order >= STRONG:
        factor, order = rest[-1].coefficient / lowest.coefficient, lowest.order - rest[-1].order
        if same(order, 1.0):
            integrator += factor
        else:
            powers.append((factor, order))
        if len(powers) > _MOST:
            return LowFrequency(0.0, (), tuple(top), tuple(bottom), is_split=False)
        # The lowest term cancels by construction, exactly; leaving it to rounding would leave a pole at 0.
        product = [Term(-factor * t.coefficient, t.order - order) for t in bottom[:-1]]
        rest = collect([*rest[:-1], *product])
    return LowFrequency(integrator, tuple(powers), tuple(rest), tuple(bottom))
