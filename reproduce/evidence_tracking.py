"""Statements of section 7.2, the abstract and the conclusions about moves, offset,
noise and [31].
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from fraclink._arm.controller import Controller
from fraclink._law import discretize
from reproduce import designs, forms
from reproduce.judged import HOLDS, NOT, PART, Evidence, Reading, judged, together
from reproduce.loops import sampled
from reproduce.published import Published
from reproduce.runs import move

__all__ = ["TRACKING"]

# fraction of the move of 1 rad, the usual band of the settling time: the tolerance of
# "same" and "zero" here
_BAND = 0.02


def _pairs() -> tuple[designs.Pair, ...]:
    """Return the readings with a filter: without one, noise and a sampled law say
    nothing about the rig.
    """
    as_printed, _, rescaled, _, own = designs.readings()
    return as_printed, rescaled, own


def _both(pair: designs.Pair) -> tuple[tuple[str, Controller], tuple[str, Controller]]:
    return ("C", pair.fractional), ("C'", pair.integer)


def _grams(payload: float) -> str:
    return f"{1e3 * payload:.0f} g"


def _tracking_printed(published: Published) -> Evidence:
    rows = []
    for pair in _pairs():
        good, words = [], []
        for payload in (0.030, 0.040):
            for name, controller in _both(pair):
                stable, run = (
                    sampled(controller, payload).stable,
                    move(controller, payload),
                )
                over = run.metrics.overshoot
                good.append(stable and run.verdict.passed and over < _BAND)
                told = f"overshoot {100 * over:.2f} %" if stable else "unstable"
                settled = "" if run.verdict.passed or not stable else ", not settled"
                words.append(f"{name} at {_grams(payload)} {told}{settled}")
        rows.append(Reading(pair.name, ", ".join(words), judged(good)))
    return together(rows, "in the loop of 4 ms with M(s), offset and noise")


def _same_at_heavy(published: Published) -> Evidence:
    rows = []
    for pair in _pairs():
        good, words = [], []
        for payload in (0.030, 0.040):
            runs = [move(controller, payload) for _, controller in _both(pair)]
            apart = float(np.max(np.abs(runs[0].tip_angle - runs[1].tip_angle)))
            good.append(apart < _BAND)
            words.append(f"at most {apart:.3f} rad apart at {_grams(payload)}")
        rows.append(Reading(pair.name, ", ".join(words), judged(good)))
    return together(
        rows, "'approximately the same' taken as within 2 % of the move of 1 rad"
    )


def _offset_left(published: Published) -> Evidence:
    gain, order = (
        designs.printed().fractional.derivative_gain,
        designs.printed().fractional.derivative_order,
    )
    law = discretize(
        designs.printed().fractional, designs.rig().period, precision="double"
    )
    exact = abs(complex(law.frequency_response(np.array([0.0]))[0]))
    rows = [
        Reading(
            "Ĉ(0) = 0, as (28) has it",
            f"{100 * forms.offset_error(exact):g} % of the offset stays",
            judged([exact == 0.0]),
        )
    ]
    for count in (100, 1000, 5000):
        # The value of a Grünwald–Letnikov sum of N terms at ω = 0: Γ(N + 1 − β)/(Γ(1 −
        # β) N!).
        tail = math.exp(
            math.lgamma(count + 1 - order) - math.lgamma(count + 1)
        ) / math.gamma(1 - order)
        left = abs(forms.offset_error(gain * designs.rig().period ** -order * tail))
        words = f"{100 * left:.1f} % of the offset stays"
        name = f"a backward-difference sum cut at {count} samples"
        rows.append(Reading(name, words, HOLDS if left < 1e-3 else NOT))
    return together(
        rows,
        "the paper does not say over how many samples its sums run; uncut they remove it in time, as t^−β",
    )


def _compared(pair: designs.Pair, payload: float) -> tuple[bool, str]:
    """Return whether C is stable and further from −1 than C', and a description of both
    with the vibration of the move.
    """
    loops = [sampled(controller, payload) for _, controller in _both(pair)]
    words = []
    for (name, controller), loop in zip(_both(pair), loops, strict=True):
        margin = f"{loop.margin:.1f}°" if loop.crosses else "no crossing"
        told = f"{margin}, {loop.distance:.2f} from −1" if loop.stable else "unstable"
        left = 1e3 * move(controller, payload).metrics.residual_vibration
        words.append(f"{name} {told}, {left:.0f} mrad")
    # A stable C is better than an unstable C'; an unstable C is never better.
    better = loops[0].stable and (
        not loops[1].stable or loops[0].distance > loops[1].distance
    )
    return better, f"{_grams(payload)}: " + "; ".join(words)


def _more_oscillatory(payloads: tuple[float, ...]) -> Evidence:
    rows = []
    for pair in _pairs():
        found = [_compared(pair, payload) for payload in payloads]
        rows.append(
            Reading(
                pair.name,
                " | ".join(text for _, text in found),
                judged(good for good, _ in found),
            )
        )
    return together(
        rows,
        "phase margin and distance from −1 of the loop of 4 ms; vibration in the two periods after the move",
    )


def _vibration_at_light(published: Published) -> Evidence:
    return _more_oscillatory((0.040, 0.030, 0.020))


def _margins_below(published: Published) -> Evidence:
    return _more_oscillatory(designs.SMALL)


def _damped_at_light(published: Published) -> Evidence:
    rows = []
    for pair in _pairs():
        run = move(pair.fractional, 0.016)
        stable = sampled(pair.fractional, 0.016).stable
        text = run.verdict.reason if stable else f"unstable; {run.verdict.reason}"
        rows.append(
            Reading(
                pair.name, f"C at 16 g: {text}", judged([stable and run.verdict.passed])
            )
        )
    return together(rows, "in the loop of 4 ms with M(s), offset and noise, 5 s")


def _better_than_integer(published: Published) -> Evidence:
    """The controller of [31] is not printed; the paper itself uses C' in its place."""
    rows = []
    for low, high in zip(
        _margins_below(published).readings,
        _vibration_at_light(published).readings,
        strict=True,
    ):
        text = f"C better than C' at 16 and 8 g: {low.verdict}; at 40, 30 and 20 g: {high.verdict}"
        rows.append(
            Reading(
                low.name, text, low.verdict if low.verdict == high.verdict else PART
            )
        )
    own = designs.corrected()
    ratio = own.integer.derivative_gain / own.fractional.derivative_gain
    text = (
        f"k_d'/k_d is {0.241 / 0.148:.2f} as printed and {ratio:.2f} by the procedure; the controller of "
        "[31] itself is not printed, C' stands for it"
    )
    return together(rows, text)


def _noise_reduced(published: Published) -> Evidence:
    """|P22| at the Nyquist frequency: θm* per radian of noise in the tip estimate."""
    nyquist = math.pi / designs.rig().period
    rows = []
    for pair in designs.readings():
        gains = [float(np.abs(item.response(nyquist))) for _, item in _both(pair)]
        proper = all(item.is_strictly_proper for _, item in _both(pair))
        text = f"|Ĉ| at 125 Hz: C {gains[0]:.2g}, C' {gains[1]:.2g}"
        rows.append(Reading(pair.name, text, judged([proper and max(gains) < 1.0])))
    return together(
        rows,
        "'reduces' taken as a strictly proper Ĉ, condition (32), with a gain below 1 at the Nyquist "
        "frequency; the filter does it, for C and C' alike",
    )


TRACKING: Mapping[str, Callable[[Published], Evidence]] = {
    "tracking_printed": _tracking_printed,
    "same_at_heavy": _same_at_heavy,
    "offset_left": _offset_left,
    "vibration_at_light": _vibration_at_light,
    "margins_below": _margins_below,
    "damped_at_light": _damped_at_light,
    "better_than_integer": _better_than_integer,
    "noise_reduced": _noise_reduced,
}
