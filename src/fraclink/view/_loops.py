"""Drawings of a design: its loop over frequency, its margins over the payload, its
phase budget.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import replace

import numpy as np

from fraclink._arm.box import ParameterBox, arms_of
from fraclink._certify.statement import Certificate
from fraclink._design import Design
from fraclink._design.assess import (
    CurveKind,
    margin_curve,
)
from fraclink._design.pid_tuning import PidTuning
from fraclink._display import number
from fraclink.errors import FieldError
from fraclink.view._drawing import Figure, Panel, figure_of
from fraclink.view._marks import (
    Across,
    Band,
    Curve,
    Mark,
    Point,
    Zone,
)
from fraclink.view._pages import LINES
from fraclink.view._responses import Response, loop_figure, loop_response
from fraclink.view._scales import Scale
from fraclink.view._text import grams
from fracsys.checks import Real

__all__ = [
    "bode_figure",
    "margin_band",
    "margins_figure",
]
__all__ += ["nyquist_figure", "payloads_about", "payloads_of", "pid_figure"]


# The range of payloads shown, as factors of the lightest and of the heaviest: 8 to 80 g
# for 20 to 40 g.
LIGHTER, _HEAVIER = (0.4, 2.0)
_STEPS = 25


def payloads_of(design: Design) -> list[float]:
    """Lightest, nominal (where it lies inside) and heaviest payload [kg]."""
    low, high = design.payloads
    return sorted(
        {low, high} | {m for m in (design.rig.payloads.nominal,) if low < m < high}
    )


def payloads_about(low: float, high: float, count: int = _STEPS) -> Real:
    """Payloads [kg] from well below a range to well above it, in equal ratios."""
    return np.geomspace(LIGHTER * low, _HEAVIER * high, count)


@figure_of.register
def bode_figure(design: Design) -> Figure:
    """Draw gain and phase of the open loop at the lightest, nominal and heaviest
    payload.
    """
    responses = [
        loop_response(design, payload, grams(payload))
        for payload in payloads_of(design)
    ]
    crossings = [
        [
            (each.frequency, each.phase_margin)
            for each in design.at(payload).gain_crossings
        ]
        for payload in payloads_of(design)
    ]
    return replace(
        loop_figure(responses, crossings),
        description="Gain and phase of the open loop over frequency; dots mark the gain crossings",
    )


@figure_of.register
def pid_figure(tuning: PidTuning) -> Figure:
    """Draw gain and phase of the open loop of a fractional PID; a dot marks the
    crossover of the phase margin.
    """
    limit = math.pi / tuning.period if tuning.period is not None else None
    response = Response.of(tuning.open_loop, None, limit)
    at = tuning.margins
    figure = loop_figure([response], [[(at.gain_crossover, at.phase_margin)]])
    description = f"Gain and phase of the open loop with {tuning.controller.formula}; the dot is the gain crossover"
    return replace(figure, name="pid", description=description)


# limits of both axes, around −1
_REACH = (-2.3, 0.9)


def nyquist_figure(design: Design, proved: float | None = None) -> Figure:
    """Draw L(jω) around −1, and the disk that these curves avoid.

    proved: the radius of the disk that a certificate states for every payload of the
    range; by default the smallest |1 + L| of the payloads drawn.
    """
    payloads = payloads_of(design)
    clear = proved or min(design.at(m).modulus_margin for m in payloads)
    marks: list[Mark] = []
    for line, payload in zip(LINES, payloads, strict=False):
        w0 = design.natural_frequency(payload)
        value = loop_response(design, payload).values
        # The circle of an undamped resonance is many times larger than this detail: it
        # is cut off outside, since its chords would otherwise cross the picture.
        value = np.where(np.abs(value) > 6.0, np.nan, value)
        marks.append(Curve(value.real, value.imag, line, grams(payload)))
        for crossing in design.at(payload).gain_crossings:
            at = complex(design.loop(np.array([crossing.frequency]), w0)[0])
            if min(at.real, at.imag) > _REACH[0] and max(at.real, at.imag) < _REACH[1]:
                marks.append(Point(at.real, at.imag, line=line))
    word = "proved" if proved else "worst"
    description = f"Nyquist curve around −1; {word} distance {number(clear, 3)}"
    return _around_critical(description, clear, marks)


@figure_of.register
def certificate_figure(certificate: Certificate) -> Figure | None:
    """Draw the disk around −1 that the loop of every proved arm avoids, and the phase and
    gain margins that it guarantees, on the unit circle and on the real axis; None if
    nothing was proved.
    """
    if not certificate.passed:
        return None
    modulus = certificate.statement.modulus
    turn = cmath.exp(1j * (math.pi - 2.0 * math.asin(min(1.0, 0.5 * modulus))))
    marks: list[Mark] = [
        Curve([0.0, turn.real], [0.0, -turn.imag], 1),
        Point(turn.real, -turn.imag, "phase margin", 1, beside=True),
        Point(modulus - 1.0, 0.0, "1/gain margin", 1, beside=True),
    ]
    return _around_critical(certificate.sentence, modulus, marks)


def _around_critical(description: str, radius: float, marks: list[Mark]) -> Figure:
    """The complex plane around −1, with a disk about it and the unit circle."""
    turn = np.exp(1j * np.linspace(0, math.tau, 181))
    disk = -1 + radius * turn
    marks = [
        Curve(disk.real, disk.imag, 2, weight="fill"),
        Curve(disk.real, disk.imag, 0, dashed=True),
        Curve(turn.real, turn.imag, 0, weight="thin"),
        *marks,
        Point(-1.0, 0.0, "−1", sign="cross"),
    ]
    square = Scale(*_REACH)
    panel = Panel("imaginary part of L", marks, 340.0, square)
    return Figure(
        "nyquist",
        description,
        (panel,),
        "real part of L",
        scale=square,
        rigid=True,
    )


def margins_figure(design: Design) -> Figure:
    """Draw phase margin and crossover over the payload: ideal, and in the real loop.

    The band covers the corners of the design's parameter box, or of the one that follows
    from fit and rig.
    """
    low, high = design.payloads
    # Below the range the mode is fast and the margin falls quickly; above it the margin
    # changes little. Hence more room on the light side, and geometric steps.
    payloads = np.geomspace(LIGHTER * low, 1.15 * high, _STEPS)
    kinds: tuple[tuple[CurveKind, int, str], ...] = (
        ("ideal", 4, "ideal loop"),
        ("motor", 3, "with motor loop"),
        ("sampled", 1, "sampled law") if design.has_law else ("loop", 2, "with delay"),
    )
    fan = margin_band(design, payloads)
    margin: list[Mark] = [Band(1e3 * payloads, *fan, 1)] if fan is not None else []
    margin += [Zone(1e3 * low, 1e3 * high), Across(0.0, limit=False)]
    for kind, line, name in kinds:
        curve = margin_curve(design, payloads, kind=kind)
        margin.append(Curve(1e3 * payloads, np.degrees(curve.phase_margin), line, name))
    margin.append(Across(math.degrees(design.phase_margin), "requested"))
    rate = curve.gain_crossover  # of the last, the law in its sampled loop
    if not design.has_law:
        rate = np.array([design.at(float(m)).gain_crossover for m in payloads])
    crossover: list[Mark] = [
        Zone(1e3 * low, 1e3 * high),
        Curve(1e3 * payloads, rate, 1),
        Across(design.gain_crossover, "requested"),
    ]
    return Figure(
        "margins",
        "Phase margin and gain crossover over the payload; the design range is shaded",
        (
            Panel("phase margin [°]", margin, 230.0),
            Panel("gain crossover [rad/s]", crossover, 110.0),
        ),
        "payload [g]; shaded: design range",
        "payload",
    )


def margin_band(design: Design, payloads: Real) -> tuple[Real, Real] | None:
    """Smallest and largest phase margin [°] over the corners of a parameter box, for
    each payload.
    """
    try:
        box = design.box or ParameterBox.of(design.model, design.rig)
    # A delay interval below zero, of a gauge that leads its encoder, gives no box of
    # arms that could exist.
    except FieldError:
        return None
    w0 = np.array([design.natural_frequency(float(m)) for m in payloads])
    # Every corner with the same controller: only the deviation of the arm from the model
    # changes the margin.
    loops = (
        arm.loop(design.controller, design.rig) for arm in arms_of(box, design.model)
    )
    angles = np.degrees([loop.margins(w0)[1] for loop in loops])
    return np.min(angles, axis=0), np.max(angles, axis=0)
