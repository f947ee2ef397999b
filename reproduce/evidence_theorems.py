"""Lemma 1, Theorems 1 and 2, Remark 1 and the two rules of thumb of section 6, tested
on random loops.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from fraclink._arm.loop import Loop
from reproduce import designs
from reproduce.judged import HOLDS, NOT, PART, Evidence, Reading, judged, together
from reproduce.loops import last_crossing
from reproduce.published import Published

__all__ = ["THEOREMS"]

_TRIALS = 200
_SEED = 58
# multiples of ω₀, starting from the value that meets (39)
_FACTORS = (1.0, 1.05, 1.2, 2.0)


@dataclass(frozen=True)
class _Case:
    """A loop (34) that meets the conditions of Theorem 1 at ω₀ = `natural` > 1."""

    loop: Loop
    natural: float
    crossover: float


@cache
def _cases() -> tuple[_Case, ...]:
    draw = np.random.default_rng(_SEED)
    found = []
    for _ in range(_TRIALS):
        order = draw.uniform(1.05, 2.0)
        beta, natural = order * draw.uniform(0.05, 0.95), draw.uniform(1.5, 40.0)
        bare = Loop(gain=1.0, order=beta, link_order=order)
        crossover = bare.sufficient(natural) * draw.uniform(1.02, 6.0)
        gain = math.exp(-float(bare.log(crossover, natural).real))
        found.append(_Case(replace(bare, gain=gain), natural, crossover))
    return tuple(found)


def _count(
    kept: Callable[[_Case], bool],
    name: str,
    change: Callable[[_Case], _Case] | None = None,
) -> Reading:
    """Count the random loops for which a statement holds; `change` replaces each loop by
    one that the statement does not cover.
    """
    good = sum(kept(change(case) if change else case) for case in _cases())
    verdict = HOLDS if good == _TRIALS else NOT if good == 0 else PART
    return Reading(name, f"{good} of {_TRIALS} random loops satisfy it", verdict)


def _with_motor(case: _Case) -> _Case:
    """Return the same crossover with M(s) included, its poles at five times the
    crossover frequency: 80 rad/s for 16 rad/s.
    """
    slower = replace(case.loop, lag=1.0 / (5.0 * case.crossover))
    level = float(slower.log(case.crossover, case.natural).real)
    return replace(case, loop=replace(slower, gain=slower.gain * math.exp(-level)))


def _slow(case: _Case) -> _Case:
    """Return the same relative crossover at an ω₀ below one, which Theorem 2 excludes."""
    natural = case.natural / 50.0
    ratio = case.crossover / case.loop.sufficient(case.natural)
    crossover = ratio * case.loop.sufficient(natural)
    level = float(case.loop.log(crossover, natural).real)
    return _Case(
        replace(case.loop, gain=case.loop.gain * math.exp(-level)), natural, crossover
    )


def _beyond(statement: Evidence, rows: list[Reading]) -> Evidence:
    """Return the verdict on the paper's statement, with rows on cases that it does not
    cover.
    """
    return Evidence(statement.text, statement.verdict, (*statement.readings, *rows))


def _phase_falls(case: _Case) -> bool:
    w = np.geomspace(1e-6, 1e6, 300) * case.crossover
    phase = case.loop.log(w, case.natural).imag
    start, end = (
        0.5 * math.pi * case.loop.order,
        0.5 * math.pi * (case.loop.order - case.loop.link_order),
    )
    between = bool(phase[0] <= start + 1e-9 and phase[-1] >= end - 1e-9)
    return between and bool(np.all(np.diff(phase) <= 1e-12))


def _homothety(case: _Case) -> bool:
    x, scale = np.geomspace(0.01, 100.0, 30), 2.0 / case.loop.link_order
    first = case.loop(x * case.natural**scale, case.natural)
    second = case.loop(x * (3.0 * case.natural) ** scale, 3.0 * case.natural)
    return bool(
        np.allclose(second, 3.0 ** (scale * case.loop.order) * first, rtol=1e-9)
    )


def _lemma_1(published: Published) -> Evidence:
    own = together(
        [
            _count(_phase_falls, "phase falls between its two limits, loop (34)"),
            _count(_homothety, "homothety, loop (34)"),
        ],
        "for λ = 2 the phase does not fall but jumps by 180° at ω₀",
    )
    return _beyond(
        own, [_count(_homothety, "homothety, with M(s): not stated", _with_motor)]
    )


def _last(case: _Case) -> Iterator[tuple[float, float]]:
    """ω_c and φ_m of the last crossover for increasing ω₀."""
    for factor in _FACTORS:
        found = case.loop.crossings(case.natural * factor)
        at = int(np.argmax(found.frequency))
        yield float(found.frequency[at]), float(found.phase[at] + math.pi)


def _margin_falls(case: _Case) -> bool:
    return bool(np.all(np.diff([margin for _, margin in _last(case)]) <= 1e-9))


def _crossover_rises(case: _Case) -> bool:
    return bool(np.all(np.diff([crossover for crossover, _ in _last(case)]) > 0.0))


def _condition_stays(case: _Case) -> bool:
    found = zip(_FACTORS, _last(case), strict=True)
    return all(
        w > case.loop.sufficient(case.natural * factor) * (1.0 - 1e-9)
        for factor, (w, _) in found
    )


def _theorem(kept: Callable[[_Case], bool], words: str) -> Evidence:
    own = together([_count(kept, "loop (34), M(s) = 1, no filter: as stated")], words)
    return _beyond(
        own, [_count(kept, "with M(s) in the loop: not stated", _with_motor)]
    )


def _theorem_1(published: Published) -> Evidence:
    return _theorem(
        _margin_falls,
        "(39) is sufficient: the exact condition is that ω_c lies right of the peak of |L|, where the "
        "denominator of (49) is positive",
    )


def _remark_1(published: Published) -> Evidence:
    return _theorem(_crossover_rises, "under the conditions of Theorem 1")


def _theorem_2(published: Published) -> Evidence:
    own = _theorem(
        _condition_stays,
        "the condition ω₀ > 1 depends on the unit of time, which is arbitrary",
    )
    return _beyond(own, [_count(_condition_stays, "ω₀ < 1: not stated", _slow)])


def _rules_of_thumb() -> Iterator[tuple[str, float, float, float]]:
    """Yield the payload in words, and φ_m [°], ζ and ω_c t_s of the loop from the
    procedure, with M(s) = 1 and no filter.
    """
    controller = designs.unfiltered(designs.corrected(), "").fractional
    for payload in (0.020, 0.030, 0.040):
        crossing = last_crossing(controller, payload)
        pole = designs.closed_loop_poles(controller, designs.link(payload))[0]
        # settled when the envelope is within 2 %
        settling = math.log(50.0) / -pole.real
        yield (
            f"{1e3 * payload:.0f} g",
            crossing.margin,
            -pole.real / abs(pole),
            settling * crossing.frequency,
        )


def _margin_and_damping(published: Published) -> Evidence:
    rows = []
    second = [
        (
            zeta,
            math.degrees(
                math.atan(
                    2 * zeta / math.sqrt(math.sqrt(1 + 4 * zeta**4) - 2 * zeta**2)
                )
            ),
        )
        for zeta in (0.1, 0.3, 0.5, 0.6)
    ]
    text = ", ".join(f"ζ = {zeta:g}: {margin:.1f}°" for zeta, margin in second)
    good = judged(abs(margin - 100 * zeta) < 10 for zeta, margin in second)
    rows.append(Reading("second-order loop, for which the rule was made", text, good))
    found = [(name, margin, zeta) for name, margin, zeta, _ in _rules_of_thumb()]
    text = ", ".join(
        f"{name}: φ_m = {margin:.1f}°, ζ = {zeta:.2f}" for name, margin, zeta in found
    )
    good = judged(abs(margin - 100 * zeta) < 10 for _, margin, zeta in found)
    rows.append(Reading("the procedure's loop, its dominant pole", text, good))
    return together(rows, "within 10°")


def _settling_and_crossover(published: Published) -> Evidence:
    found = [(name, product) for name, _, _, product in _rules_of_thumb()]
    text = ", ".join(f"{name}: t_s = {product:.1f}/ω_c" for name, product in found)
    near = judged(0.5 < product / (2 * math.pi) < 2.0 for _, product in found)
    return together(
        [
            Reading(
                "the procedure's loop, 2 % envelope of its dominant pole", text, near
            )
        ],
        "within a factor of 2; 2π is 6.3",
    )


THEOREMS: Mapping[str, Callable[[Published], Evidence]] = {
    "lemma_1": _lemma_1,
    "theorem_1": _theorem_1,
    "remark_1": _remark_1,
    "theorem_2": _theorem_2,
    "margin_and_damping": _margin_and_damping,
    "settling_and_crossover": _settling_and_crossover,
}
