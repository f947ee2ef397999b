"""From order to order: the best fractions found, started from those of the order below.

The minimax problem over the poles has many local minima. Adding one real pole or one pair to the best
three fractions of the order below, at places spread over the band, ends as low as the best of 60 random
starts (benchmarks/bench_stability.py compares), needs no random numbers, and gives every lower order.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fraclink._systems.rational.minimax import (
    PartialFractions,
    Target,
    best_residues,
    improve,
    log_spaced_start,
    newton,
    score,
)
from fraclink._systems.rational.relocation import relocate

__all__ = ["cancellation", "finish", "grow"]

Real = NDArray[np.float64]

_KEPT = 3  # fractions kept at each order
_TRIED = 8  # starts that are iterated; the others are dropped by their least-squares residue
_NOISY = 20.0  # cancellation above which a smaller error is paid for in single precision


def grow(
    target: Target,
    band: tuple[float, float],
    highest: int,
    *,
    resonances: Sequence[complex] = (),
    pairs: int | None = None,
) -> Iterator[list[PartialFractions]]:
    """Yield the best few fractions of order 0, 1, … `highest`, the best first; `finish` makes one of them.

    `band` is the range of Ω to spread poles over, `resonances` are q (poles −q, −q̄) that are tried as they
    are, `pairs` is the largest number of pairs.
    """
    spots = np.linspace(math.log(band[0]), math.log(band[1]) + 3.0, 9)
    most = highest if pairs is None else pairs
    empty = np.zeros(0)
    nothing = PartialFractions(0.0, empty, empty, empty, empty, empty.astype(complex))
    kept = [[best_residues(nothing, target)]]
    yield kept[0]
    for order in range(1, highest + 1):
        starts = [_with_real(c, x) for c in kept[order - 1] for x in spots]
        for c in kept[order - 2][:2] if order > 1 else ():
            starts += [_with_pair(c, x) for x in spots[3:]] + [_with_known(c, q) for q in resonances]
        spread = log_spaced_start(*band, order % 2, order // 2)
        chosen = [*_promising(starts, target, most), relocate(spread, target, 12)[-1]]
        found = [_quick(c, target) for c in chosen if len(c.pair_logs) <= most]
        kept.append(_distinct(found, target))
        yield kept[order]


def finish(candidates: list[PartialFractions], target: Target) -> PartialFractions:
    """The best of the candidates after the whole ladder of norms."""
    return min((improve(c, target) for c in candidates), key=lambda c: _cost(c, target))


def cancellation(fit: PartialFractions, target: Target) -> float:
    """Largest sum of the moduli of all terms over the largest modulus of their sum: 1 is ideal."""
    real, pair, mirrored = fit.shapes(target.omega)
    parts = abs(fit.direct) + np.abs(fit.real_gains * real).sum(1)
    parts = parts + 0.5 * (np.abs(fit.pair_gains) * (np.abs(pair) + np.abs(mirrored))).sum(1)
    factor = np.abs(target.factor)
    whole = factor * np.abs(fit.columns(target.omega) @ fit.linear())
    return float(np.max(parts * factor) / np.max(whole))


def _cost(fit: PartialFractions, target: Target) -> float:
    return score(fit, target) * max(1.0, cancellation(fit, target) / _NOISY)


def _with_real(c: PartialFractions, log: float) -> PartialFractions:
    return replace(c, real_logs=np.append(c.real_logs, log), real_gains=np.append(c.real_gains, 0.0))


def _with_pair(c: PartialFractions, log: float) -> PartialFractions:
    # η = 0.7 is 54° off the negative real axis: between two real poles and a resonance.
    return replace(
        c,
        pair_logs=np.append(c.pair_logs, log),
        pair_angles=np.append(c.pair_angles, 0.7),
        pair_gains=np.append(c.pair_gains, 0j),
    )


def _with_known(c: PartialFractions, q: complex) -> PartialFractions:
    angle = min(abs(cmath.phase(q)) / (0.5 * math.pi), 1 - 1e-9)
    return replace(
        c,
        pair_logs=np.append(c.pair_logs, math.log(abs(q))),
        pair_angles=np.append(c.pair_angles, math.atanh(angle)),
        pair_gains=np.append(c.pair_gains, 0j),
    )


def _promising(starts: list[PartialFractions], target: Target, pairs: int) -> list[PartialFractions]:
    fitted = [best_residues(c, target) for c in starts if len(c.pair_logs) <= pairs]
    residue = [float(np.sum(c.error(target) ** 2)) for c in fitted]
    return [fitted[i] for i in np.argsort(residue, kind="stable")[:_TRIED]]


def _quick(start: PartialFractions, target: Target) -> PartialFractions:
    here = best_residues(start, target)
    for power in (2, 8):
        here = newton(here, target, power)
    return here


def _distinct(found: list[PartialFractions], target: Target) -> list[PartialFractions]:
    ranked = sorted(((_cost(c, target), i) for i, c in enumerate(found)))
    kept: list[tuple[float, PartialFractions]] = []
    for cost, i in ranked:
        if all(abs(cost - other) > 1e-3 * cost for other, _ in kept):
            kept.append((cost, found[i]))
        if len(kept) == _KEPT:
            break
    return [c for _, c in kept]
