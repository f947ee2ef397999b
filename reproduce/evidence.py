"""The paper's statements in words, each measured: what is found, and the verdict that follows from it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.controller import Controller
from fraclink._identify import aic
from fraclink._law import discretize
from fraclink._systems.margins import margins
from reproduce import designs
from reproduce.published import Published
from reproduce.values import PAYLOADS, comparison

__all__ = ["EVIDENCE", "Crossing", "Evidence", "last_crossing"]

Complex = NDArray[np.complex128]

_LOOP_DELAY = 0.006  # s: half a sample of hold and one of computation, at 4 ms
_SWEEP = np.linspace(0.008, 0.045, 38)


@dataclass(frozen=True)
class Evidence:
    """What was measured, in words, and the verdict."""

    text: str
    verdict: str


@dataclass(frozen=True)
class Crossing:
    """The last gain crossing of a loop: frequency [rad/s], phase margin [°], and whether it is stable."""

    frequency: float
    margin: float
    stable: bool


def last_crossing(
    controller: Controller,
    payload: float,
    *,
    motor: bool = False,
    delay: float = 0.0,
    order: float = designs.ORDER,
) -> Crossing:
    """The crossing of Ĉ·G, with M(s) if `motor`, at `payload` [kg]; NaN where |L| < 1 everywhere."""
    tip = designs.link(payload, order).tip()

    def loop(s: Complex) -> Complex:
        value = controller.response(np.imag(s)) * tip(s) * np.exp(-delay * s)
        return np.asarray(value / (1.0 + s / 80.0) ** 2 if motor else value, dtype=np.complex128)

    found = margins(loop, unstable_poles=0)
    if not found.gain_crossings:
        return Crossing(math.nan, math.nan, found.stable is not False)
    last = max(found.gain_crossings, key=lambda item: item.frequency)
    return Crossing(last.frequency, math.degrees(last.phase_margin), found.stable is not False)


def _unfiltered(pair: designs.Pair, delta: float = 0.0) -> designs.Pair:
    return designs.Pair(
        pair.name, replace(pair.fractional, filter_time=delta), replace(pair.integer, filter_time=delta)
    )


def _order_of_payloads(published: Published) -> Evidence:
    fits = {name: comparison(name).fits["UD-FOM"] for name in PAYLOADS}
    shown = ", ".join(
        f"{fit.model.order:.4f} ± {fit.standard_errors['order']:.4f} at {1e3 * PAYLOADS[name]:g} g"
        for name, fit in fits.items()
    )
    spread = max(f.model.order for f in fits.values()) - min(f.model.order for f in fits.values())
    error = max(fit.standard_errors["order"] for fit in fits.values())
    return Evidence(
        f"the twin's three PRBS logs give λ = {shown}", "holds" if spread < 4 * error else "does not hold"
    )


def _ratios_of_table_3(published: Published) -> Evidence:
    light, nominal, heavy = (
        next(item.printed for item in published.numbers if item.id == f"table3_{key}_udfom_varpi")
        for key in ("m_min", "m_nom", "m_max")
    )
    first, second = light / nominal, nominal / heavy
    text = (
        f"UD-FOM: ϖ(20 g)/ϖ(30 g) = {first:.3f} where (5) asks for {math.sqrt(1.5):.3f}, "
        f"ϖ(30 g)/ϖ(40 g) = {second:.3f} where it asks for {math.sqrt(4 / 3):.3f}"
    )
    good = abs(first - math.sqrt(1.5)) < 0.02 and abs(second - math.sqrt(4 / 3)) < 0.02
    return Evidence(text, "holds" if good else "does not hold")


def _mse(published: Published, name: str) -> float:
    return next(item.printed for item in published.numbers if item.id == f"table2_{name}_mse")


def _error_of_undamped(published: Published) -> Evidence:
    ratios = [_mse(published, "udiom") / _mse(published, name) for name in ("diom", "udfom", "dfom")]
    text = f"Table 2: {min(ratios):.1f} to {max(ratios):.1f} times"
    return Evidence(text, "holds" if min(ratios) >= 9.5 and max(ratios) <= 12 else "does not hold")


def _gap_of_aic(published: Published) -> Evidence:
    udfom = aic(_mse(published, "udfom"), 5001, 2)
    gaps = [aic(_mse(published, name), 5001, k) - udfom for name, k in (("dfom", 3), ("diom", 2))]
    text = f"AIC of D-FOM and D-IOM lie {gaps[0]:.1f} and {gaps[1]:.1f} above UD-FOM's, all on fitted samples"
    return Evidence(text, "holds in part" if min(gaps) > 0 else "does not hold")


def _told(crossing: Crossing) -> str:
    return f"{crossing.frequency:.2f} rad/s and {crossing.margin:.1f}°"


def _meeting_at_nominal(published: Published) -> Evidence:
    pair = _unfiltered(designs.corrected())
    c = last_crossing(pair.fractional, 0.030)
    both = {order: last_crossing(pair.integer, 0.030, order=order) for order in (designs.ORDER, 2.0)}
    text = (
        f"at 30 g L_M has {_told(c)}, L'_M {_told(both[designs.ORDER])} on λ = 1.92 "
        f"and {_told(both[2.0])} on λ = 2"
    )
    meets = abs(both[2.0].margin - c.margin) < 0.1 and abs(both[designs.ORDER].margin - c.margin) > 1
    return Evidence(text, "holds in part" if meets else "does not hold")


def _sweep(motor: bool) -> tuple[list[Crossing], list[Crossing]]:
    pair = _unfiltered(designs.corrected())
    return (
        [last_crossing(pair.fractional, float(m), motor=motor) for m in _SWEEP],
        [last_crossing(pair.integer, float(m), motor=motor) for m in _SWEEP],
    )


def _monotone_crossover(published: Published) -> Evidence:
    found = [item.frequency for item in _sweep(False)[0]]
    text = f"C of the procedure: {found[0]:.2f} rad/s at 8 g, {found[-1]:.2f} rad/s at 45 g, never rising"
    return Evidence(text, "holds" if bool(np.all(np.diff(found) < 0)) else "does not hold")


def _monotone_margin(published: Published) -> Evidence:
    found = [item.margin for item in _sweep(False)[0]]
    text = f"C of the procedure: {found[0]:.2f}° at 8 g, {found[-1]:.2f}° at 45 g, never falling between"
    return Evidence(text, "holds" if bool(np.all(np.diff(found) > 0)) else "does not hold")


def _tracking_printed(published: Published) -> Evidence:
    pair = designs.printed()
    states = {
        name: [last_crossing(controller, m, motor=True).stable for m in (0.030, 0.040)]
        for name, controller in (("(58)", pair.fractional), ("(59)", pair.integer))
    }
    text = ", ".join(
        f"{name} is {'stable' if all(good) else 'unstable'} at 30 g and 40 g with M(s)"
        for name, good in states.items()
    )
    return Evidence(
        text,
        "does not hold" if not any(good for pair in states.values() for good in pair) else "holds in part",
    )


def _offset_left(published: Published) -> Evidence:
    gain, order = designs.printed().fractional.gain, designs.printed().fractional.order
    shares = []
    for count in (100, 1000):
        # What a Grünwald–Letnikov sum of N terms leaves at ω = 0: Γ(N + 1 − β)/(Γ(1 − β) N!).
        tail = math.exp(math.lgamma(count + 1 - order) - math.lgamma(count + 1)) / math.gamma(1 - order)
        direct = gain * designs.rig().period ** -order * tail
        shares.append(100.0 * direct / (1.0 + direct))
    law = discretize(designs.in_loop().fractional, designs.rig().period)
    left = abs(complex(law.frequency_response(np.array([0.0]))[0]))
    text = (
        f"with a sum over 100 or 1000 samples {shares[0]:.1f} % or {shares[1]:.1f} % of the offset stays; "
        f"fraclink's law has Ĉ(z = 1) = {left:g}"
    )
    return Evidence(text, "holds in part" if left == 0 and shares[1] > 0.1 else "does not hold")


def _sampled(controller: Controller, payload: float) -> Crossing:
    return last_crossing(controller, payload, motor=True, delay=_LOOP_DELAY)


def _vibration_at_light(published: Published) -> Evidence:
    printed, own = _unfiltered(designs.printed(), 0.0016), designs.corrected()
    a, b = (_sampled(c, 0.020).margin for c in (printed.fractional, printed.integer))
    c, d = (_sampled(x, 0.020).margin for x in (own.fractional, own.integer))
    text = (
        f"phase margin at 20 g in the loop of 4 ms: printed gains with δ = 0.0016 s {a:.1f}° for C and "
        f"{b:.1f}° for C'; the procedure's own {c:.1f}° and {d:.1f}°"
    )
    return Evidence(text, "holds in part" if a > b and d > c else "does not hold")


def _margins_below(published: Published) -> Evidence:
    printed, own = _unfiltered(designs.printed(), 0.0016), designs.corrected()
    rows = {
        m: [_sampled(x, m) for p in (printed, own) for x in (p.fractional, p.integer)] for m in (0.016, 0.008)
    }
    text = "; ".join(
        f"at {1e3 * m:g} g: printed gains with δ = 0.0016 s {r[0].margin:.1f}° and {r[1].margin:.1f}°, "
        f"the procedure's own {r[2].margin:.1f}° and {r[3].margin:.1f}°"
        for m, r in rows.items()
    )
    good = all(r[0].margin > r[1].margin + 5 for r in rows.values())
    alike = abs(rows[0.016][2].margin - rows[0.016][3].margin) < 2 and not rows[0.008][2].stable
    return Evidence(
        "phase margin of C and C' in the loop of 4 ms " + text, "holds in part" if good and alike else "holds"
    )


def _cost_of_motor_loop(published: Published) -> Evidence:
    pair = _unfiltered(designs.corrected())
    cost = [
        last_crossing(pair.fractional, m).margin - last_crossing(pair.fractional, m, motor=True).margin
        for m in (0.008, 0.020, 0.040)
    ]
    text = f"M(s) costs {cost[0]:.1f}°, {cost[1]:.1f}° and {cost[2]:.1f}° at 8, 20 and 40 g"
    return Evidence(text, "holds" if min(cost) > 15 else "does not hold")


def _crossover_order(published: Published) -> Evidence:
    rows = []
    for pair in (_unfiltered(designs.printed()), _unfiltered(designs.corrected())):
        rows.append([last_crossing(c, 0.020).frequency for c in (pair.fractional, pair.integer)])
    text = (
        f"at 20 g, L_M and L'_M: printed gains {rows[0][0]:.2f} and {rows[0][1]:.2f} rad/s, "
        f"the procedure's own {rows[1][0]:.2f} and {rows[1][1]:.2f} rad/s"
    )
    return Evidence(text, "holds" if all(a < b for a, b in rows) else "does not hold")


def _motor_lowers_crossover(published: Published) -> Evidence:
    without, within = _sweep(False), _sweep(True)
    drop = [a.frequency - b.frequency for k in (0, 1) for a, b in zip(without[k], within[k], strict=True)]
    text = f"by {min(drop):.2f} to {max(drop):.2f} rad/s between 8 g and 45 g, for C and C'"
    return Evidence(text, "holds" if min(drop) > 0 else "does not hold")


def _reversal_with_motor_loop(published: Published) -> Evidence:
    pair = _unfiltered(designs.corrected())
    rows = {
        m: [
            last_crossing(c, m, motor=k).margin
            for k in (False, True)
            for c in (pair.fractional, pair.integer)
        ]
        for m in (0.020, 0.008)
    }
    text = "; ".join(
        f"at {1e3 * m:g} g: {r[0]:.1f}° and {r[1]:.1f}° without M(s), {r[2]:.1f}° and {r[3]:.1f}° with it"
        for m, r in rows.items()
    )
    first = all(r[1] > r[0] for r in rows.values())
    second = [r[2] > r[3] for r in rows.values()]
    verdict = "holds" if first and all(second) else "holds in part" if first else "does not hold"
    return Evidence("the procedure's own C and C' " + text, verdict)


EVIDENCE: Mapping[str, Callable[[Published], Evidence]] = {
    "order_of_payloads": _order_of_payloads,
    "ratios_of_table_3": _ratios_of_table_3,
    "error_of_undamped": _error_of_undamped,
    "gap_of_aic": _gap_of_aic,
    "meeting_at_nominal": _meeting_at_nominal,
    "monotone_crossover": _monotone_crossover,
    "monotone_margin": _monotone_margin,
    "tracking_printed": _tracking_printed,
    "offset_left": _offset_left,
    "vibration_at_light": _vibration_at_light,
    "margins_below": _margins_below,
    "cost_of_motor_loop": _cost_of_motor_loop,
    "crossover_order": _crossover_order,
    "motor_lowers_crossover": _motor_lowers_crossover,
    "reversal_with_motor_loop": _reversal_with_motor_loop,
}
