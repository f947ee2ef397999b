"""Drawings of a design: its loop over frequency, its margins over the payload, where
the phase goes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.box import ParameterBox, arms_of
from fraclink._design import Design
from fraclink._design.assess import MarginCurve, PhaseShare, margin_curve
from fraclink._design.feasibility import FeasibilityMap
from fraclink._design.pid_tuning import PidTuning
from fraclink._law import Law
from fraclink.errors import FieldError
from fraclink.view._drawing import Figure, Panel
from fraclink.view._marks import (
    Across,
    Band,
    Cells,
    Curve,
    Frame,
    Mark,
    Point,
    Upright,
    Zone,
    escaped,
    percent,
)
from fraclink.view._pages import LINES
from fraclink.view._scales import Scale
from fraclink.view._text import grams, number

__all__ = [
    "bode_figure",
    "budget_figure",
    "map_figure",
    "margin_curves_figure",
    "margins_figure",
]
__all__ += ["nyquist_figure", "payloads_of", "pid_figure", "pid_step_figure"]

Real = NDArray[np.float64]

# the margins are shown down to this share of the lightest payload: 8 g for 20 g
BEYOND = 0.4
_STEPS = 25
# Quarters of a turn, down to a whole one: what a delay adds below lies where the gain
# is long gone.
_PHASE = Scale(
    -360.0,
    90.0,
    ticks=tuple((float(k), f"{k}".replace("-", "−")) for k in range(-360, 91, 90)),
)


def payloads_of(design: Design) -> list[float]:
    """Lightest, nominal (where it lies inside) and heaviest payload [kg]."""
    low, high = design.payloads
    return sorted(
        {low, high} | {m for m in (design.rig.payloads.nominal,) if low < m < high}
    )


def _frequencies(design: Design, payload: float) -> Real:
    """A grid [rad/s] that is dense where the mode turns the curve, and ends at the
    Nyquist frequency.
    """
    # Around the mode the phase turns by λ·90° within a few per cent of ω: sinh puts
    # half of the points within a quarter of it, a quarter within 9 %. On an even grid
    # of as many a resonance would have corners.
    mode = float(design.loop.peak(design.natural_frequency(payload)))
    near = mode * np.exp(np.sinh(np.linspace(-3.5, 3.5, 181)) / np.sinh(3.5) * 1.5)
    ends = np.geomspace(0.03 * mode, math.pi / design.rig.period, 160)
    grid = np.union1d(near, ends)
    second = design.model.second_mode
    if second is not None:
        grid = np.union1d(grid, second.frequency * np.exp(np.linspace(-0.25, 0.25, 81)))
    return np.asarray(grid[(grid >= ends[0]) & (grid <= ends[-1])])


def bode_figure(design: Design) -> Figure:
    """Draw gain and phase of the open loop at the lightest, nominal and heaviest
    payload.
    """
    gain: list[Mark] = [Across(0.0, limit=False)]
    phase: list[Mark] = [Across(-180.0, limit=False)]
    for line, payload in zip(LINES, payloads_of(design), strict=False):
        w = _frequencies(design, payload)
        value = design.loop.log(w, design.natural_frequency(payload))
        gain.append(Curve(w, 20 * value.real / math.log(10), line, grams(payload)))
        phase.append(Curve(w, np.degrees(value.imag), line))
        for crossing in design.at(payload).gain_crossings:
            # The logarithm keeps the sheet of the phase, so that the dot lies on its
            # curve however many turns a delay has added; the margin alone would leave
            # the turn open.
            at = design.loop.log(
                np.array([crossing.frequency]), design.natural_frequency(payload)
            )[0]
            gain.append(Point(crossing.frequency, 0.0, line=line))
            phase.append(Point(crossing.frequency, math.degrees(at.imag), line=line))
    panels = (
        Panel("gain of the open loop |L| [dB]", Scale(-45.0, 30.0), gain, 190.0),
        Panel("phase of L [°]", _PHASE, phase, 190.0),
    )
    x = Scale(1.0, math.pi / design.rig.period, log=True)
    said = (
        "Gain and phase of the open loop over frequency; dots mark the gain crossings"
    )
    return Figure("bode", said, x, panels, "frequency ω [rad/s]", "loop")


def pid_figure(made: PidTuning) -> Figure:
    """Draw gain and phase of the open loop of a fractional PID; a dot marks the
    crossover that counts.
    """
    crossover = made.margins.gain_crossover
    w = np.geomspace(crossover / 300.0, crossover * 300.0, 500)
    if made.period is not None:
        w = w[w < math.pi / made.period]
    loop = np.asarray(made.open_loop(1j * w))
    decibels = 20 * np.log10(np.abs(loop))
    # An integrator runs to infinity on the left: 60 dB either way is more than any
    # margin is read from.
    decibels = np.where(np.abs(decibels) > 60.0, np.nan, decibels)
    angle = np.degrees(np.unwrap(np.angle(loop)))
    here = float(np.interp(math.log(crossover), np.log(w), angle))
    # On the sheet of the stated margin: unwrapped from the left the phase may lie a
    # whole turn off.
    shift = 360.0 * round(
        (here + 180.0 - math.degrees(made.margins.phase_margin)) / 360.0
    )
    angle, here = np.where(angle - shift < -360.0, np.nan, angle - shift), here - shift
    panels = (
        Panel(
            "gain of the open loop |L| [dB]",
            Scale.around(decibels[np.isfinite(decibels)]),
            [
                Across(0.0, limit=False),
                Curve(w, np.clip(decibels, -60.0, 60.0), 1),
                Point(crossover, 0.0, line=1),
            ],
            190.0,
        ),
        Panel(
            "phase of L [°]",
            _PHASE,
            [
                Across(-180.0, limit=False),
                Curve(w, angle, 1),
                Point(crossover, here, line=1),
            ],
            190.0,
        ),
    )
    said = f"Gain and phase of the open loop with {made.controller.formula}; the dot is the gain crossover"
    return Figure(
        "pid",
        said,
        Scale(float(w[0]), float(w[-1]), log=True),
        panels,
        "frequency ω [rad/s]",
        "loop",
    )


def pid_step_figure(
    made: PidTuning, law: Law, size: float = 1.0, duration: float | None = None
) -> Figure:
    """Draw measurement and output of the shipped law after a step of the reference."""
    step = made.step(law=law, size=size, duration=duration)
    # The output is held between samples: steps and no slopes, as the actuator gets it.
    held = np.repeat(step.output, 2)[:-1]
    times = np.repeat(step.time, 2)[1:]
    panels = (
        Panel(
            "measurement",
            Scale.around(step.measurement, np.array([0.0, size])),
            [Across(size, "reference"), Curve(step.time, step.measurement, 1)],
            190.0,
        ),
        Panel(
            "controller's output",
            Scale.around(step.output),
            [Curve(times, held, 2)],
            130.0,
        ),
    )
    said = "The law of a fractional PID on its plant: measurement and output after a step of the reference"
    ends = Scale(0.0, float(step.time[-1]))
    return Figure("pid-step", said, ends, panels, "time [s]", "step")


_REACH = (
    -2.3,
    0.9,
)  # of both axes: what is near −1; the resonance's circle is many times larger


def nyquist_figure(design: Design, proved: float | None = None) -> Figure:
    """Draw L(jω) around −1, and the disk that these curves keep out of.

    proved: its radius where a certificate states one, min |1 + L| over every payload of
    the range.
    """
    turn = np.exp(1j * np.linspace(0, 2 * math.pi, 181))
    payloads = payloads_of(design)
    clear = proved or min(design.at(m).modulus_margin for m in payloads)
    disk = -1 + clear * turn
    marks: list[Mark] = [
        Curve(disk.real, disk.imag, 2, weight="fill"),
        Curve(disk.real, disk.imag, 0, dashed=True),
        Curve(turn.real, turn.imag, 0, weight="thin"),
    ]
    for line, payload in zip(LINES, payloads, strict=False):
        w0 = design.natural_frequency(payload)
        value = design.loop(_frequencies(design, payload), w0)
        # The circle of an undamped resonance is many times larger than the detail:
        # outside it is cut off, or its chords would cross the picture.
        value = np.where(np.abs(value) > 6.0, np.nan, value)
        marks.append(Curve(value.real, value.imag, line, grams(payload)))
        for crossing in design.at(payload).gain_crossings:
            at = complex(design.loop(np.array([crossing.frequency]), w0)[0])
            if min(at.real, at.imag) > _REACH[0] and max(at.real, at.imag) < _REACH[1]:
                marks.append(Point(at.real, at.imag, line=line))
    marks.append(Point(-1.0, 0.0, "−1", sign="cross"))
    panel = Panel("imaginary part of L", Scale(*_REACH), marks, 340.0)
    word = "proved" if proved else "worst"
    said = f"Nyquist curve around −1; {word} distance {number(clear, 3)}"
    return Figure(
        "nyquist", said, Scale(*_REACH), (panel,), "real part of L", rigid=True
    )


def margins_figure(design: Design) -> Figure:
    """Draw phase margin and crossover over the payload: on paper, and what is left in
    the loop that runs.

    The band is that of the corners of the box of parameters: the one that the design
    states, or what fit and rig leave open.
    """
    low, high = design.payloads
    # Below the range the mode is fast and the margin falls quickly; above it changes
    # little: hence more room on the light side, and geometric steps.
    payloads = np.geomspace(BEYOND * low, 1.15 * high, _STEPS)
    mass = 1e3 * payloads
    margin: list[Mark] = [Zone(1e3 * low, 1e3 * high), Across(0.0, limit=False)]
    fan = _fan(design, payloads)
    if fan is not None:
        margin.append(Band(mass, *fan, 1))
    shown: list[Real] = [] if fan is None else [*fan]
    for kind in ("ideal", "motor", "sampled" if design.has_law else "loop"):
        name, line = _KINDS[kind]
        angle = np.degrees(margin_curve(design, payloads, kind=kind).phase_margin)
        shown.append(angle)
        margin.append(Curve(mass, angle, line, name))
    margin.append(Across(math.degrees(design.phase_margin), "requested"))
    at = design.sampled_at if design.has_law else design.at
    rate = np.array([_or_nan(at(float(m)).gain_crossover) for m in payloads])
    crossover: list[Mark] = [Zone(1e3 * low, 1e3 * high), Curve(mass, rate, 1)]
    crossover.append(Across(design.gain_crossover, "requested"))
    panels = (
        Panel("phase margin [°]", Scale.around([0.0], *shown), margin, 230.0),
        Panel(
            "gain crossover [rad/s]",
            Scale.around(rate, [design.gain_crossover]),
            crossover,
            110.0,
        ),
    )
    said = (
        "Phase margin and gain crossover over the payload; the design range is shaded"
    )
    x = Scale(float(mass[0]), float(mass[-1]))
    return Figure(
        "margins", said, x, panels, "payload [g]; shaded: design range", "payload"
    )


def _fan(design: Design, payloads: Real) -> tuple[Real, Real] | None:
    """Smallest and largest phase margin [°] of the corners of a box of parameters, over
    payloads.
    """
    try:
        box = design.box or ParameterBox.of(design.model, design.rig)
    # A fit whose interval of the delay lies below zero states no box of arms that could
    # exist.
    except FieldError:  # of a gauge that leads its encoder nothing is known
        return None
    w0 = np.array([design.natural_frequency(float(m)) for m in payloads])
    # Every corner with the controller as it was designed: what an arm other than the
    # model does to the margin.
    loops = (
        arm.loop(design.controller, design.rig) for arm in arms_of(box, design.model)
    )
    angles = np.degrees(
        [loop.achieved(w0, design.rig.period).phase_margin for loop in loops]
    )
    return np.min(angles, axis=0), np.max(angles, axis=0)


def _or_nan(value: float | None) -> float:
    return math.nan if value is None or not math.isfinite(value) else value


_KINDS = {
    "ideal": ("on paper", 4),
    "motor": ("with motor loop", 3),
    "loop": ("with delay", 2),
    "sampled": ("as it runs", 1),
}


def margin_curves_figure(
    curves: Sequence[MarginCurve], payloads: tuple[float, float], wanted: float
) -> Figure:
    """Draw phase margins over the payload, one line for each kind of loop (Fig. 10)."""
    marks: list[Mark] = [
        Zone(1e3 * payloads[0], 1e3 * payloads[1]),
        Across(0.0, limit=False),
    ]
    for curve in curves:
        name, line = _KINDS[curve.kind]
        marks.append(
            Curve(1e3 * curve.payload, np.degrees(curve.phase_margin), line, name)
        )
    marks.append(Across(math.degrees(wanted), "requested"))
    shown = [np.degrees(curve.phase_margin) for curve in curves]
    panel = Panel("phase margin [°]", Scale.around([0.0], *shown), marks, 280.0)
    mass = 1e3 * curves[0].payload
    said = "Phase margin over the payload, with more and more of the real loop"
    x = Scale(float(mass[0]), float(mass[-1]))
    return Figure(
        "margins", said, x, (panel,), "payload [g]; shaded: design range", "payload"
    )


def budget_figure(shares: Sequence[PhaseShare], payload: float | None = None) -> Figure:
    """Draw the phase budget as a waterfall: from 180° down to the phase margin."""
    # The margin is 180° + arg L: the sign of the feedback is the first element, and
    # lags take from it.
    steps = [("feedback", 0.0, 180.0, "180°", 0)]
    level = 180.0
    for share in shares:
        size = math.degrees(share.phase)
        text = f"{size:+.1f}°".replace("-", "−")
        steps.append((share.element, level, level + size, text, 2 if size < 0 else 1))
        level += size
    steps.append(("phase margin", 0.0, level, f"{level:.1f}°", 3))
    ends = [end for step in steps for end in step[1:3]]
    x = Scale(min(0.0, *ends), 1.12 * max(ends))
    height = 26.0 * len(steps)

    def bars(frame: Frame) -> str:
        parts = []
        for row, (name, start, end, text, line) in enumerate(steps):
            left, right = (
                float(x.share(v)) for v in (min(start, end), max(start, end))
            )
            top = frame.top + 26.0 * row + 4
            place = f'x="{percent(left)}" width="{percent(right - left)}" y="{top:g}" height="18"'
            parts.append(f'<rect class="f{line}" {place}/>')
            parts.append(
                f'<text class="name" x="-8" y="{top + 13:g}" text-anchor="end">{escaped(name)}</text>'
            )
            parts.append(
                f'<text class="name" x="{percent(right)}" dx="5" y="{top + 13:g}">{text}</text>'
            )
        return "".join(parts)

    ticks = tuple((float(k), f"{k}°") for k in range(0, int(x.high) + 1, 45))
    where = "" if payload is None else f" at {grams(payload)}"
    panel = Panel("", Scale(0.0, 1.0, ticks=()), (), height, bars)
    said = f"Where the phase goes{where}: " + ", ".join(
        f"{name} {text}" for name, *_, text, _ in steps
    )
    return Figure(
        "budget",
        said,
        Scale(x.low, x.high, ticks=ticks),
        (panel,),
        f"phase at the gain crossover{where}",
        left=168.0,
    )


_SETTLING = (0.2, 0.3, 0.4, 0.5, 0.6, 0.8)


def map_figure(
    found: FeasibilityMap,
    request: tuple[float, float] | None = None,
    nearest: tuple[float, float] | None = None,
) -> Figure:
    """Draw which crossovers and margins are feasible, darker where the gauge's noise is
    amplified more.

    `request` and `nearest` (ω_c [rad/s], φ_m [rad]): what was asked for, and the
    nearest that can be had.
    """
    across, up = found.gain_crossover, np.degrees(found.phase_margin)
    x, y = (_edges(values) for values in (across, up))
    levels = _levels(found.noise_gain)
    asked = [place for place in (request, nearest) if place is not None]
    # Both the refused request and the nearest one must be seen, with some room beyond
    # them, wherever the map ends.
    sx = Scale(
        min(x[0], *(p[0] for p in asked)) if asked else x[0],
        max([x[-1], *(1.05 * p[0] for p in asked)]),
    )
    sy = Scale(
        min([y[0], *(math.degrees(p[1]) - 5 for p in asked)]),
        max([y[-1], *(math.degrees(p[1]) + 5 for p in asked)]),
    )
    marks: list[Mark] = []
    for settling in _SETTLING:
        # A crossover ω_c goes with a settling of about 2π/ω_c: workshops think in
        # seconds.
        w = 2 * math.pi / settling
        if sx.low < w < sx.high:
            marks.append(Upright(w, f"{settling:g} s"))
    if request is not None:
        marks.append(
            Point(request[0], math.degrees(request[1]), "requested", sign="cross")
        )
    if nearest is not None:
        near = (
            f"nearest: {number(nearest[0], 3)} rad/s, {math.degrees(nearest[1]):.1f}°"
        )
        marks.append(Point(nearest[0], math.degrees(nearest[1]), near, sign="ring"))
    with np.errstate(invalid="ignore"):
        table = np.digitize(np.nan_to_num(found.noise_gain, nan=0.0), levels)
    table = np.where(np.isfinite(found.noise_gain), table, -1)
    edge = _outline(x, y, found.feasible)
    panel = Panel(
        "phase margin at the lightest payload [°]",
        sy,
        (Cells(x, y, table), *edge, *marks),
        330.0,
    )
    key = ("noise gain", *_ranges(levels))
    said = f"Feasible requests in colours of their noise gain: {', '.join(key[1:])}; upright: 2π/ω_c"
    name = "gain crossover at the heaviest payload [rad/s]; upright: 2π/ω_c"
    return Figure("map", said, sx, (panel,), name, "map", key=key)


def _outline(x: Real, y: Real, feasible: NDArray[np.bool_]) -> list[Mark]:
    """The upper and the lower edge of what is feasible, column by column."""
    some = feasible.any(axis=0)
    # Steps along the cells, as they were computed: a smooth curve would promise what no
    # cell was asked for.
    top = np.where(
        some, y[feasible.shape[0] - np.argmax(feasible[::-1], axis=0)], np.nan
    )
    bottom = np.where(some, y[np.argmax(feasible, axis=0)], np.nan)
    across = np.repeat(x, 2)[1:-1]
    return [
        Curve(across, np.repeat(edge, 2), 0, weight="thin") for edge in (top, bottom)
    ]


def _edges(middles: Real) -> Real:
    """Edges of cells around their middles."""
    inner = 0.5 * (middles[1:] + middles[:-1])
    first, last = 2 * middles[0] - inner[0], 2 * middles[-1] - inner[-1]
    return np.concatenate([[first], inner, [last]])


def _levels(values: Real) -> Real:
    """Three round limits that part finite values into four groups of about one size."""
    finite = np.asarray(values)[np.isfinite(values)]
    if not finite.size:
        return np.array([1.0, 2.0, 3.0])
    # Quartiles, so that each colour has about a quarter of the map: of equal steps the
    # lowest would take nearly all, as the noise gain rises steeply at the edge.
    return np.array([float(f"{q:.2g}") for q in np.quantile(finite, (0.25, 0.5, 0.75))])


def _ranges(limits: Real) -> tuple[str, ...]:
    low, middle, high = (number(float(limit), 2) for limit in limits)
    return (f"up to {low}", f"to {middle}", f"to {high}", f"above {high}")
