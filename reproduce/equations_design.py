"""Equations (34) to (60): open loop, lemma and theorems, and the procedure with its
results.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import brentq

from fraclink._arm.loop import Loop
from reproduce import designs, forms
from reproduce.points import (
    Check,
    Mass,
    Sides,
    crossing_at,
    power,
    random_crossing,
    slope_of,
)

__all__ = ["DESIGN"]

Draw = np.random.Generator
Crossing = forms.Crossing


def _loop_of(at: Crossing) -> Loop:
    return Loop(gain=at.gain, order=at.beta, link_order=at.order)


def _link_of(at: Crossing) -> Mass:
    """Return a link with this ω₀ and λ: c = 1 N·m, m L² = 1/ω₀²."""
    return Mass(1.0, at.natural**-2, 1.0, at.order)


def _value(at: Crossing, w: float) -> complex:
    """L(jω), with the link from Newton's law and the strain of the gauge."""
    return at.gain * power(1j * w, at.beta) * _link_of(at).solved(1j * w)[0]


def _bracket(at: Crossing, w: float) -> complex:
    """(jω)^λ + ω₀², the denominator of G."""
    return at.square / _link_of(at).solved(1j * w)[0]


def _phase(at: Crossing, w: float) -> float:
    """The phase of L at ω, unwrapped from ω → 0, so that no branch of an arctangent has
    to be chosen.
    """
    mode = at.natural ** (2.0 / at.order)
    grid = np.unique(np.append(np.geomspace(1e-4 * mode, 1e4 * mode, 1500), w))
    turns = np.unwrap(np.angle([_value(at, x) for x in grid[grid <= w]]))
    return float(turns[-1])


def _frequency(draw: Draw, at: Crossing) -> float:
    return float(at.natural ** (2.0 / at.order) * draw.uniform(0.3, 4.0))


# ---- the open loop ----------------------------------------------------------------------------------------


def _open(code: Any, draw: Draw) -> Sides:
    """(34)."""
    at = random_crossing(draw)
    w = _frequency(draw, at)
    printed = (
        at.gain * (1j * w) ** at.beta * at.square / ((1j * w) ** at.order + at.square)
    )
    own = code(gain=at.gain, order=at.beta, link_order=at.order)(w, at.natural)
    return printed, own, _value(at, w)


def _phase_of(code: Any, draw: Draw) -> Sides:
    """(35)."""
    at = random_crossing(draw)
    w, angle = _frequency(draw, at), 0.5 * math.pi * at.order
    ratio = math.sin(angle) * w**at.order / (math.cos(angle) * w**at.order + at.square)
    printed = 0.5 * math.pi * at.beta - math.atan(ratio)
    return printed, float(code(_loop_of(at), w, at.natural).imag), _phase(at, w)


def _phase_slope(code: Any, draw: Draw) -> Sides:
    """(36)."""
    at = random_crossing(draw)
    w, angle = _frequency(draw, at), 0.5 * math.pi * at.order
    size = (
        w ** (2 * at.order)
        + 2 * at.square * math.cos(angle) * w**at.order
        + at.square**2
    )
    printed = -at.order * at.square * math.sin(angle) * w ** (at.order - 1) / size
    true = slope_of(lambda x: cmath.phase(_value(at, x) / _value(at, w)), w, 1e-4)
    return printed, float(code(_loop_of(at), w, at.natural).imag) / w, true


def _positive(code: Any, draw: Draw) -> Sides:
    """(37): both sides, and that the first is not less than the second."""
    at = random_crossing(draw)
    w = _frequency(draw, at)
    found = code(w, at.natural, at.order)
    p = w**at.order
    printed = (
        p**2 + 2 * at.square * math.cos(0.5 * math.pi * at.order) * p + at.square**2
    )
    true = abs(_bracket(at, w)) ** 2, (abs(power(1j * w, at.order)) - at.square) ** 2
    holds = [float(a >= b >= 0.0) for a, b in (found, (printed, (p - at.square) ** 2))]
    return [printed, (p - at.square) ** 2, holds[1]], [*found, holds[0]], [*true, 1.0]


def _homothety(code: Any, draw: Draw) -> Sides:
    """(38)."""
    at = random_crossing(draw)
    x = float(draw.uniform(0.3, 4.0))
    printed = (
        at.gain
        * at.natural ** (2 * at.beta / at.order)
        * (1j * x) ** at.beta
        / ((1j * x) ** at.order + 1)
    )
    w = x * at.natural ** (2.0 / at.order)
    own = code(gain=at.gain, order=at.beta, link_order=at.order)(w, at.natural)
    return printed, own, _value(at, w)


# ---- the crossing -----------------------------------------------------------------------------------------


def _bound(code: Any, draw: Draw) -> Sides:
    """(39): its bound is the resonance of the measured torque, found as a maximum of
    |Γ|.
    """
    at = random_crossing(draw)
    link = _link_of(at)
    printed = (-at.square / math.cos(0.5 * math.pi * at.order)) ** (1.0 / at.order)
    mode = at.natural ** (2.0 / at.order)

    def rising(w: float) -> float:
        return slope_of(lambda x: -1.0 / abs(link.solved(1j * x)[1]), w, 1e-3)

    return (
        printed,
        code(_loop_of(at), at.natural),
        brentq(rising, 0.5 * mode, 20.0 * mode, xtol=1e-13),
    )


def _condition(code: Any, draw: Draw) -> Sides:
    """(40), (50): the real part of the denominator of G, which is negative exactly if
    (39) holds.
    """
    at = random_crossing(draw)
    elsewhere = Crossing(at.gain, at.beta, at.order, at.natural, _frequency(draw, at))
    printed = (
        at.square + math.cos(0.5 * math.pi * at.order) * elsewhere.frequency**at.order
    )
    right = float(elsewhere.frequency > _loop_of(at).sufficient(at.natural))
    own = code(elsewhere)
    true = _bracket(at, elsewhere.frequency).real
    return [printed, 1.0 + (printed < 0)], [own, 1.0 + (own < 0)], [true, 1.0 + right]


def _consequence(code: Any, draw: Draw) -> Sides:
    """(41), where (39) holds."""
    at = random_crossing(draw)
    cosine = math.cos(0.5 * math.pi * at.order)
    p = at.frequency**at.order
    printed = [at.square / cosine + p, cosine * at.square + p]
    found = list(code(at))
    bracket = _bracket(at, at.frequency)
    true = [bracket.real / cosine, (bracket / power(1j, at.order)).real]
    holds = [float(0 < a <= b) for a, b in (printed, found)]
    return [*printed, holds[0]], [*found, holds[1]], [*true, 1.0]


def _margin(at: Crossing) -> float:
    """φ_m [rad]: the phase unwrapped from ω → 0, plus π."""
    return _phase(at, at.frequency) + math.pi


def _crossing(code: Any, draw: Draw) -> Sides:
    """(42), (43): L(jω_c) = −e^{jφ_m}."""
    at = random_crossing(draw)
    found = code(_loop_of(at), at.natural)
    w, phase = float(found.frequency[-1]), float(found.phase[-1])
    printed = (
        at.gain
        * (1j * at.frequency) ** at.beta
        * at.square
        / ((1j * at.frequency) ** at.order + at.square)
    )
    own = [-cmath.exp(1j * (phase + math.pi)), w]
    return (
        [printed, at.frequency],
        own,
        [-cmath.exp(1j * _margin(at)), crossing_at(at, at.natural).frequency],
    )


def _modulus(code: Any, draw: Draw) -> Sides:
    """(43)."""
    at = random_crossing(draw)
    w = float(code(_loop_of(at), at.natural).frequency[-1])
    left = at.gain**2 * w ** (2 * at.beta) * at.square**2
    cosine = math.cos(0.5 * math.pi * at.order)
    right = w ** (2 * at.order) + 2 * cosine * at.square * w**at.order + at.square**2
    true = abs(_bracket(at, crossing_at(at, at.natural).frequency)) ** 2
    return right, left, true


def _phase_margin(code: Any, draw: Draw) -> Sides:
    """(44), with ω_c in place of ω."""
    at = random_crossing(draw)
    angle = 0.5 * math.pi * at.order
    ratio = math.sin(angle) * at.power / (math.cos(angle) * at.power + at.square)
    printed = 0.5 * math.pi * at.beta + math.pi - math.atan(ratio)
    return (
        printed,
        float(code(_loop_of(at), at.natural).phase[-1]) + math.pi,
        _margin(at),
    )


# ---- the derivatives by ω₀ --------------------------------------------------------------------------------


def _by_natural(of: Callable[[Crossing], float], at: Crossing) -> float:
    """d/dω₀ along the crossovers, each of which is found by bisection."""
    return slope_of(lambda natural: of(crossing_at(at, natural)), at.natural, 1e-3)


def _angle(at: Crossing, other: Crossing) -> float:
    """The difference of two phase margins, as the angle between the two values of −L."""
    return cmath.phase(_value(other, other.frequency) / _value(at, at.frequency))


def _derived(
    code: Callable[[Crossing], Any], true: Callable[[Crossing], Any], draw: Draw
) -> Sides:
    """The printed form is the code itself: these rows have no other form."""
    at = random_crossing(draw)
    own = code(at)
    return own, own, true(at)


def _rate_of_margin(at: Crossing) -> float:
    return slope_of(
        lambda natural: _angle(at, crossing_at(at, natural)), at.natural, 1e-3
    )


def _rate_of_crossover(at: Crossing) -> float:
    return _by_natural(lambda item: item.frequency, at)


def _rate_of_reserve(at: Crossing) -> float:
    return _by_natural(lambda item: _bracket(item, item.frequency).real, at)


def _differentials(at: Crossing) -> list[float]:
    """Half the partial derivatives of k_d² ω_c^(2β) ω₀⁴ − |(jω_c)^λ + ω₀²|² with
    respect to ω₀ and to ω_c.
    """

    def balance(natural: float, w: float) -> float:
        item = Crossing(at.gain, at.beta, at.order, natural, w)
        return float(
            at.gain**2 * w ** (2 * at.beta) * natural**4 - abs(_bracket(item, w)) ** 2
        )

    return [
        0.5 * slope_of(lambda x: balance(x, at.frequency), at.natural, 1e-3),
        0.5 * slope_of(lambda x: balance(at.natural, x), at.frequency, 1e-3),
    ]


def _row(
    true: Callable[[Crossing], Any], also: Callable[[Crossing], float] | None = None
) -> Check:
    """A check of a derivative; `also` gives the rate of ω_c that (45) and (51) require."""

    def sides(code: Any, draw: Draw) -> Sides:
        return _derived((lambda at: code(at, also(at))) if also else code, true, draw)

    return Check(sides, 20)


def _with_gain(code: Any, draw: Draw) -> Sides:
    """(46) is the differential of (43) also away from a crossover, where k_d cannot be
    eliminated.
    """
    at = random_crossing(draw)
    beside = replace(at, gain=at.gain * float(draw.uniform(1.2, 3.0)))
    own = code(beside)
    return own, own, _differentials(beside)


def _without_gain(code: Any, draw: Draw) -> Sides:
    """(47) holds only at a crossover and does not depend on k_d: it is given a wrong
    one.
    """
    at = random_crossing(draw)
    own = code(replace(at, gain=2.0 * at.gain))
    return own, own, _differentials(at)


def _integral(code: Any, draw: Draw) -> Sides:
    """(53): h at the end of a range, from (52) by Gauss–Legendre quadrature, compared
    with its value there.
    """
    at = random_crossing(draw)
    end = at.natural * float(draw.uniform(1.1, 2.0))
    nodes, weights = np.polynomial.legendre.leggauss(20)
    half = 0.5 * (end - at.natural)
    rates = np.array(
        [
            forms.rate_of_reserve(crossing_at(at, at.natural + half * (1 + x)))
            for x in nodes
        ]
    )
    own = code(at, rates, half * weights)
    last = crossing_at(at, end)
    return own, own, _bracket(last, last.frequency).real


# ---- the procedure ----------------------------------------------------------------------------------------


def _solved(
    order: float, low: float, high: float, crossover: float, margin: float
) -> tuple[float, ...]:
    """χ, β, k_d and ω̄_c of (54) and (55), by bisection on the modulus of (55)."""

    def link(natural: float, w: float) -> complex:
        return Mass(1.0, natural**-2, 1.0, order).solved(1j * w)[0]

    chi = 1.0 / abs(link(low, crossover))

    def beta(w: float) -> float:
        return 2.0 / math.pi * (margin - math.pi - cmath.phase(link(high, w)))

    def level(w: float) -> float:
        return (
            math.log(chi)
            + beta(w) * math.log(w / crossover)
            + math.log(abs(link(high, w)))
        )

    # Above the resonance of the lightest payload the modulus falls through one exactly
    # once.
    start = high ** (2.0 / order) * 1.02
    upper = float(brentq(level, start, 50.0 * start, xtol=1e-13))
    return chi, beta(upper), chi / crossover ** beta(upper), upper


def _task(draw: Draw) -> tuple[float, ...]:
    """λ, both values of ω₀, ω_c and φ_m of a request that the procedure can meet."""
    low = float(draw.uniform(8.0, 12.0))
    high = low * float(draw.uniform(1.2, 1.45))
    return (
        1.92,
        low,
        high,
        low * float(draw.uniform(1.6, 2.0)),
        math.radians(float(draw.uniform(55.0, 72.0))),
    )


def _gain(code: Any, draw: Draw) -> Sides:
    """(54)."""
    order, low, high, crossover, margin = _task(draw)
    chi, beta, gain, _ = _solved(order, low, high, crossover, margin)
    p, cosine = crossover**order, math.cos(0.5 * math.pi * order)
    printed = math.sqrt(p**2 + 2 * cosine * low**2 * p + low**4) / low**2
    own = code(low, high, math.sqrt(low * high), crossover=crossover, margin=margin)
    return (
        [printed, printed / crossover**beta],
        [own.chi, own.controller.derivative_gain],
        [chi, gain],
    )


def _upper(code: Any, draw: Draw) -> Sides:
    """(55)."""
    order, low, high, crossover, margin = _task(draw)
    chi, beta, _, upper = _solved(order, low, high, crossover, margin)

    def left(beta: float, w: float) -> complex:
        return (
            chi * (1j * w / crossover) ** beta * high**2 / ((1j * w) ** order + high**2)
        )

    own = code(low, high, math.sqrt(low * high), crossover=crossover, margin=margin)
    found = own.controller.derivative_order, own.gain_crossover_upper
    true = [beta, upper, -cmath.exp(1j * margin)]
    return [beta, upper, left(beta, upper)], [*found, left(*found)], true


def _table_1() -> tuple[float, float, float, float]:
    """k_d, β, δ and ω_c of section 7.1 from the inputs of Table 1, with δ from the 10 %
    rule by bisection for n = 2.
    """
    margin = math.radians(designs.MARGIN_DEG)
    _, beta, gain, _ = _solved(1.92, 9.42, 14.14, designs.CROSSOVER, margin)

    def lost(delta: float) -> float:
        def value(w: float) -> complex:
            return (
                forms.loop_value(w, gain, beta, 1.92, 14.14)
                / (1.0 + 1j * w * delta) ** 2
            )

        w = brentq(lambda x: math.log(abs(value(x))), 17.0, 60.0, xtol=1e-12)
        return cmath.phase(-value(float(w))) - 0.9 * margin

    nominal = crossing_at(Crossing(gain, beta, 1.92, 11.54, 20.0), 11.54).frequency
    return gain, beta, float(brentq(lost, 1e-4, 0.01, xtol=1e-12)), nominal


def _controller(number: str, integer: bool) -> Check:
    """(58), (59): the printed controller against (54), (55), the 10 % rule and (42)."""

    def sides(code: Any, draw: Draw) -> Sides:
        w = float(draw.uniform(5.0, 60.0))
        gain, beta, delta, nominal = _table_1()
        if integer:
            # λ = 2: the phase of −L is β'π/2, and |G| = ω₀²/(ω_c² − ω₀²).
            phase = cmath.phase(-forms.loop_value(nominal, gain, beta, 1.92, 11.54))
            beta = 2.0 * phase / math.pi
            gain = (nominal**2 / 11.54**2 - 1.0) / nominal**beta
        true = gain * power(1j * w, beta) / (1.0 + 1j * w * delta) ** 2
        pair = code()
        own = pair.integer if integer else pair.fractional
        return designs.PRINTED[number].response(w), own.response(w), true

    return Check(sides, 3)


def _four_loops(code: Any, draw: Draw) -> Sides:
    """(60): L_M, L'_M, LM_M and LM'_M; in the first one C_M is printed for Ĉ_M."""
    payload, w = float(draw.uniform(0.008, 0.045)), float(draw.uniform(5.0, 60.0))
    arm, s = designs.rig(), 1j * w
    tip = Mass(arm.link.stiffness, payload, arm.link.length, designs.ORDER).solved(s)[0]
    hats = [
        item.derivative_gain
        * power(s, item.derivative_order)
        / (1.0 + item.filter_time * s) ** 2
        for item in designs.PRINTED.values()
    ]
    servo = 80.0**2 / (s + 80.0) ** 2
    true = [hat * tip * motor for motor in (1.0, servo) for hat in hats]
    own = [
        code(item, payload, motor=motor)(np.array([s]))[0]
        for motor in (False, True)
        for item in designs.PRINTED.values()
    ]
    return [true[0] + tip, *true[1:]], own, true


DESIGN: Mapping[str, Check] = {
    "(34)": Check(_open),
    "(35)": Check(_phase_of, 10),
    "(36)": Check(_phase_slope),
    "(37)": Check(_positive),
    "(38)": Check(_homothety),
    "(39)": Check(_bound, 20),
    "(40)": Check(_condition),
    "(41)": Check(_consequence),
    "(42)": Check(_crossing, 10),
    "(43)": Check(_modulus, 20),
    "(44)": Check(_phase_margin, 10),
    "(45)": _row(_rate_of_margin, _rate_of_crossover),
    "(46)": Check(_with_gain, 20),
    "(47)": Check(_without_gain, 20),
    "(48)": _row(_rate_of_crossover),
    "(49)": _row(_rate_of_margin),
    "(50)": Check(_condition),
    "(51)": _row(_rate_of_reserve, _rate_of_crossover),
    "(52)": _row(_rate_of_reserve),
    "(53)": Check(_integral, 5),
    "(54)": Check(_gain, 4),
    "(55)": Check(_upper, 4),
    "(58)": _controller("(58)", integer=False),
    "(59)": _controller("(59)", integer=True),
    "(60)": Check(_four_loops, 10),
}
