"""Statements of sections 7.1 and 7.3 about crossovers and margins, for every reading of
the controllers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from reproduce import designs
from reproduce.judged import HOLDS, NOT, Evidence, Reading, judged, together
from reproduce.loops import SWEEP, Crossing, Curves, curves, last_crossing
from reproduce.published import Published

__all__ = ["MARGINS"]

_NOMINAL = 0.030
_LIGHT = tuple(m for m in SWEEP if m < _NOMINAL)
# kg: the payloads that section 7 calls very small, small and minimal
_LOW = (0.008, 0.016, 0.020)


def _every() -> Iterator[Curves]:
    return (curves(pair) for pair in designs.readings())


def _trend(found: Sequence[Crossing], quantity: str, sign: int) -> tuple[bool, str]:
    """Return whether a quantity is monotonic over the payloads at which the loop has a
    crossover, and its values at the ends.
    """
    there = [
        (m, getattr(item, quantity))
        for m, item in zip(SWEEP, found, strict=True)
        if item.crosses
    ]
    if len(there) < 2:
        return False, "no crossing"
    values = [value for _, value in there]
    good = bool(np.all(sign * np.diff(values) > 0))
    peak = max(there, key=lambda item: -sign * item[1])
    ends = f"{values[0]:.1f}" + (
        "" if good else f", {peak[1]:.1f} at {1e3 * peak[0]:.0f} g"
    )
    gone = (
        ""
        if len(there) == len(SWEEP)
        else f" (crosses only from {1e3 * there[0][0]:.0f} g on)"
    )
    return good, f"{ends}, {values[-1]:.1f}{gone}"


def _monotone(quantity: str, sign: int, unit: str, holds: str) -> Evidence:
    rows = []
    for item in _every():
        found = {
            name: _trend(loop, quantity, sign) for name, loop in item.loops.items()
        }
        text = "; ".join(f"{name} {words} {unit}" for name, (_, words) in found.items())
        rows.append(
            Reading(item.pair.name, text, judged(good for good, _ in found.values()))
        )
    return together(rows, f"{holds}; from 8 g to 45 g:")


def _monotone_crossover(published: Published) -> Evidence:
    return _monotone(
        "frequency", -1, "rad/s", "four loops (60), five readings, where they cross"
    )


def _monotone_margin(published: Published) -> Evidence:
    return _monotone(
        "margin", 1, "°", "four loops (60), five readings, where they cross"
    )


def _meeting_at_nominal(published: Published) -> Evidence:
    rows = []
    for pair in designs.readings():
        own = last_crossing(pair.fractional, _NOMINAL)
        for order in (designs.ORDER, 2.0):
            other = last_crossing(pair.integer, _NOMINAL, order=order)
            meets = (
                abs(own.frequency - other.frequency) < 0.1
                and abs(own.margin - other.margin) < 0.5
            )
            name = f"{pair.name}; L'_M on λ = {order:g}"
            rows.append(
                Reading(name, f"L_M {own}, L'_M {other}", HOLDS if meets else NOT)
            )
    return together(rows, "at 30 g; (60) prints λ = 1.92 for both loops")


def _compare(
    words: str,
    test: Callable[[Curves, int], bool | None],
    shown: Callable[[Curves, int], str],
    masses: Sequence[float],
) -> Evidence:
    """Return one row per reading: the test at each of `masses`, and the values at the
    payloads named in section 7.

    A test returns None if a loop has no crossover: then there is nothing to compare,
    which the row states.
    """
    rows = []
    for item in _every():
        found = [test(item, SWEEP.index(m)) for m in masses]
        known = [value for value in found if value is not None]
        text = "; ".join(
            f"{1e3 * m:.0f} g: {shown(item, SWEEP.index(m))}" for m in _LOW
        )
        if len(known) < len(found):
            text += f"; one of the two does not cross at {len(found) - len(known)} of {len(found)} payloads"
        rows.append(Reading(item.pair.name, text, judged(known) if known else NOT))
    return together(rows, words)


def _value(item: Curves, name: str, at: int, quantity: str) -> float:
    """Return the quantity of a loop: NaN without a crossover, so that every comparison
    with it is false.
    """
    return float(getattr(item.loops[name][at], quantity))


def _above(
    first: str, second: str, quantity: str
) -> Callable[[Curves, int], bool | None]:
    def test(item: Curves, at: int) -> bool | None:
        values = [_value(item, name, at, quantity) for name in (first, second)]
        return None if any(map(math.isnan, values)) else values[0] > values[1]

    return test


def _both(
    first: str, second: str, quantity: str, unit: str
) -> Callable[[Curves, int], str]:
    def shown(item: Curves, at: int) -> str:
        pair = [_value(item, name, at, quantity) for name in (first, second)]
        told = ["none" if math.isnan(value) else f"{value:.1f}{unit}" for value in pair]
        return f"{first} {told[0]}, {second} {told[1]}"

    return shown


def _crossover_order(published: Published) -> Evidence:
    test, shown = (
        _above("L'_M", "L_M", "frequency"),
        _both("L'_M", "L_M", "frequency", " rad/s"),
    )
    return _compare("at every payload from 8 to 29 g", test, shown, _LIGHT)


def _crossover_order_with_motor(published: Published) -> Evidence:
    printed = _compare(
        "",
        _above("LM'_M", "L'_M", "frequency"),
        _both("LM'_M", "L'_M", "frequency", " rad/s"),
        _LIGHT,
    )
    meant = _compare(
        "",
        _above("LM'_M", "LM_M", "frequency"),
        _both("LM'_M", "LM_M", "frequency", " rad/s"),
        _LIGHT,
    )
    rows = [
        Reading(f"as printed; {row.name}", row.text, row.verdict)
        for row in printed.readings
    ]
    rows += [
        Reading(f"LM_M for L'_M; {row.name}", row.text, row.verdict)
        for row in meant.readings
    ]
    return together(
        rows, "as printed it contradicts item 2 of the same list; LM_M must be meant"
    )


def _motor_lowers_crossover(published: Published) -> Evidence:
    def test(item: Curves, at: int) -> bool | None:
        found = [
            _above(f"L{p}_M", f"LM{p}_M", "frequency")(item, at) for p in ("", "'")
        ]
        known = [value for value in found if value is not None]
        return all(known) if known else None

    shown = _both("LM_M", "L_M", "frequency", " rad/s")
    return _compare(
        "at every payload from 8 to 29 g, for C and C'", test, shown, _LIGHT
    )


def _cost_of_motor_loop(published: Published) -> Evidence:
    def cost(item: Curves, at: int, prime: str) -> float:
        return _value(item, f"L{prime}_M", at, "margin") - _value(
            item, f"LM{prime}_M", at, "margin"
        )

    def test(item: Curves, at: int) -> bool | None:
        known = [value for p in ("", "'") if not math.isnan(value := cost(item, at, p))]
        return all(value > 15.0 for value in known) if known else None

    def shown(item: Curves, at: int) -> str:
        return f"{_degrees(cost(item, at, ''))} of L_M, {_degrees(cost(item, at, chr(39)))} of L'_M"

    return _compare(
        "'strongly' taken as more than 15°, at every payload from 8 to 45 g",
        test,
        shown,
        SWEEP,
    )


def _degrees(value: float) -> str:
    return "none" if math.isnan(value) else f"{value:.1f}°"


def _margin_order(published: Published) -> Evidence:
    test, shown = _above("L'_M", "L_M", "margin"), _both("L'_M", "L_M", "margin", "°")
    return _compare("at every payload from 8 to 29 g", test, shown, _LIGHT)


def _reversal_with_motor_loop(published: Published) -> Evidence:
    test, shown = (
        _above("LM_M", "LM'_M", "margin"),
        _both("LM_M", "LM'_M", "margin", "°"),
    )
    return _compare("'low payloads' taken as 8, 16 and 20 g", test, shown, _LOW)


MARGINS: Mapping[str, Callable[[Published], Evidence]] = {
    "meeting_at_nominal": _meeting_at_nominal,
    "monotone_crossover": _monotone_crossover,
    "monotone_margin": _monotone_margin,
    "cost_of_motor_loop": _cost_of_motor_loop,
    "crossover_order": _crossover_order,
    "crossover_order_with_motor": _crossover_order_with_motor,
    "motor_lowers_crossover": _motor_lowers_crossover,
    "margin_order": _margin_order,
    "reversal_with_motor_loop": _reversal_with_motor_loop,
}
