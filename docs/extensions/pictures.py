"""The pictures of the pages, drawn by the package in every build. Each has a title, the
page that explains it, and a function that draws it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from loop_sketch import loop_sketch

import fraclink as fl
import fracsys
from fraclink import Twin
from fraclink.extend import PayloadChange, equip, geared, phase_budget
from fraclink.view import _figures as figures
from fraclink.view import _loops as loops
from fraclink.view import _runs as runs
from fraclink.view._drawing import Figure, Panel
from fraclink.view._marks import Across, Curve, Mark, Point, Upright, Zone
from fraclink.view._scales import Scale
from fraclink.view._sketches import arm_sketch

ASK: dict[str, Any] = {
    "payloads": (0.020, 0.040),
    "gain_crossover": 12.0,
    "phase_margin": fl.deg(50),
}


@cache
def rig() -> fl.Rig:
    return fl.Rig.named("paper-2023")


@cache
def design(filter_time: float | None = None) -> fl.Design:
    return fl.design(rig().model, rig(), filter_time=filter_time, **ASK)


@cache
def log() -> fl.Experiment:
    return fl.read_log(fl.bundled_log("prbs_30g"), rig=rig())


@cache
def comparison() -> fl.Comparison:
    return fl.compare_structures(log())


def fit() -> fl.Fit:
    return comparison().fits["UD-FOM"]


def lines(
    name: str,
    said: str,
    label: str,
    curves: list[tuple[str, Any, Any]],
    xlabel: str,
    **more: Any,
) -> Figure:
    """One panel of curves, each with its name."""
    marks: list[Mark] = [
        Curve(x, y, k, text) for k, (text, x, y) in enumerate(curves, 1)
    ]
    marks = [*more.pop("below", []), *marks, *more.pop("above", [])]
    x = more.pop("x", None) or Scale(
        *(float(f(curves[0][1])) for f in (np.min, np.max)), more.pop("log", False)
    )
    y = more.pop("y", None) or Scale.around(*(c[2] for c in curves))
    return Figure(name, said, (Panel(label, marks, 240.0, y),), xlabel, scale=x)


def filters() -> Figure:
    """Noise, margin and sensitivity over the filter's time constant."""
    times = np.array([0.0, 0.002, 0.005, 0.01, 0.02, 0.03, 0.04])
    noise, light, peak = [], [], []
    for time in times:
        made = design(float(time))
        run = fl.simulate(
            made.law(),
            fl.extend.hold(0.0, duration=1.0),
            rig=rig(),
            model=rig().model,
            duration=8.0,
        )
        noise.append(1e3 * run.metrics.motor_reference_noise)
        light.append(math.degrees(made.sampled_at(0.008).phase_margin))
        peak.append(1 / made.sampled_at(0.020).modulus_margin)
    milli = 1e3 * times
    rows = (
        ("noise of the motor reference at rest [mrad]", noise),
        ("margin at 8 g, lighter than designed for [°]", light),
        ("Ms at 20 g", peak),
    )
    panels = [
        Panel(label, [Curve(milli, values, k)], 100.0)
        for k, (label, values) in enumerate(rows, 1)
    ]
    said = "A longer filter lowers the noise, but costs margin below the range and raises Ms inside it"
    return Figure("filters", said, panels, "filter δ [ms]", scale=Scale(0.0, 40.0))


def damping() -> Figure:
    """Damping ratio over the frequency of the mode: viscous and power law."""
    payloads = np.geomspace(0.004, 0.12, 60)
    law = [
        fl.LinkModel(1.56, rig().natural_frequency(float(m)), order=1.92)
        for m in payloads
    ]
    base = rig().natural_frequency(0.030)
    viscous = (
        0.0628 * np.array([rig().natural_frequency(float(m)) for m in payloads]) / base
    )
    w = [abs(model.pole) for model in law]
    said = "The damping ratio of a viscous link rises with its frequency; that of a power law does not"
    curves = [
        ("power law, λ = 1.92", w, [100 * m.damping_ratio for m in law]),
        ("viscous", w, 100 * viscous),
    ]
    return lines(
        "damping",
        said,
        "damping ratio [%]",
        curves,
        "frequency of the mode [rad/s]",
        log=True,
        y=Scale(0, 18),
    )


def offset() -> Figure:
    """The tip after an offset appears in the gauge."""
    made = design(0.0)
    run = fl.simulate(
        made.law(),
        fl.extend.hold(0.0),
        rig=rig(),
        model=rig().model,
        duration=6.0,
        noise=0.0,
        gauge_offset=0.078,
    )
    seen = np.abs(1e3 * run.tip_angle)
    envelope = np.maximum.accumulate(seen[::-1])[::-1]
    said = "After an offset of 0.05 rad appears in the gauge, the largest later error of the tip falls to zero"
    return lines(
        "offset",
        said,
        "largest error from then on [mrad]",
        [("tip", run.time, np.maximum(envelope, 1e-3))],
        "time [s]",
        y=Scale(1e-2, 100, log=True),
    )


def second_mode() -> Figure:
    """What the gauge sees of a link with mass, and of one without."""
    link = rig().link
    beam = fl.extend.Beam(link.length, link.stiffness * link.length / 3, 0.00735, 0.030)
    modes = beam.modes(3)
    shares = (modes.participation * modes.frequencies) ** 2 / link.stiffness
    w = np.unique(
        np.concatenate(
            [
                np.geomspace(3, 600, 500),
                *(m * np.linspace(0.9, 1.1, 81) for m in modes.frequencies),
            ]
        )
    )
    w = w[w <= 600]
    s = 1j * w
    material = s ** (2 - rig().model.order)
    real = sum(
        share * s**2 / (s**2 + m**2 * material)
        for share, m in zip(shares, modes.frequencies, strict=True)
    )
    lumped = rig().model.torque()(s) / link.stiffness
    said = "The gauge of a link with mass shows a second mode where the lumped model has none"
    curves = [
        ("twin", w, 20 * np.log10(np.abs(real))),
        ("lumped model", w, 20 * np.log10(np.abs(lumped))),
    ]
    return lines(
        "second-mode",
        said,
        "gauge over motor angle, Γ/(c θm) [dB]",
        curves,
        "frequency ω [rad/s]",
        log=True,
    )


def mode_gain() -> Figure:
    """The open loop at the second mode with a short filter and with the one that
    bounds it.
    """
    heavy = geared(rig(), 50)
    heavy = replace(heavy, link=replace(heavy.link, mass=0.00735))
    curves = []
    beam = fl.extend.Beam(
        heavy.link.length, heavy.link.stiffness * heavy.link.length / 3, 0.00735, 0.030
    )
    modes = beam.modes(3)
    shares = (modes.participation * modes.frequencies) ** 2 / heavy.link.stiffness
    w = np.unique(
        np.concatenate(
            [
                np.geomspace(3, 600, 400),
                *(m * np.linspace(0.85, 1.15, 121) for m in modes.frequencies[:2]),
            ]
        )
    )
    w, s = w[w <= 600], 1j * w[w <= 600]
    tip = 1 - sum(
        share * s**2 / (s**2 + m**2 * s ** (2 - heavy.model.order))
        for share, m in zip(shares, modes.frequencies, strict=True)
    )
    for text, more in (
        ("filter of 5 ms", {"mode_gain": 100.0, "filter_time": 0.005}),
        ("bounded to 0.5", {"mode_gain": 0.5}),
    ):
        made = fl.design(heavy.model, heavy, **ASK, **more)
        hold = (
            (1 - np.exp(-s * heavy.period))
            / (s * heavy.period)
            * np.exp(-s * heavy.period)
        )
        loop = (
            made.law().frequency_response(w)
            * hold
            * tip
            / (1 + s / heavy.motor_loop.pole) ** 2
        )
        curves.append((text, w, 20 * np.log10(np.abs(loop))))
    said = "The loop gain at the second mode: above one with a filter of 5 ms, below one half with the bound"
    peak = float(w[np.argmax(np.where(w > 100, curves[0][2], -np.inf))])
    above = [Across(0.0, "a gain of one"), Upright(peak, "second mode")]
    return lines(
        "mode-gain",
        said,
        "open loop |L| of a link of 7 g [dB]",
        curves,
        "frequency ω [rad/s]",
        log=True,
        above=above,
    )


def published() -> Figure:
    """What is left of a promised margin, over the payload."""
    old = fl.design(
        rig().model,
        rig(),
        payloads=(0.020, 0.040),
        gain_crossover=16.0,
        phase_margin=fl.deg(70),
        procedure="published",
        filter_order=2,
    )
    mass = np.linspace(0.008, 0.045, 30)
    curves = []
    for text, at in (
        ("fraclink, sampled law", design().sampled_at),
        ("published, sampled law", old.sampled_at),
        ("published, promised", old.at),
    ):
        found = [at(float(m)) for m in mass]
        sign = [-1.0 if f.stable is False else 1.0 for f in found]
        curves.append(
            (
                text,
                1e3 * mass,
                [
                    k * abs(math.degrees(f.phase_margin))
                    for k, f in zip(sign, found, strict=True)
                ],
            )
        )
    said = "The loop that runs keeps little of the margin that the published procedure promises"
    return lines(
        "published",
        said,
        "phase margin [°]",
        curves,
        "payload [g]; shaded: designed for",
        below=[Zone(20, 40), Across(0.0, limit=False)],
    )


def dropped() -> Figure:
    """A move of the twin that loses a third of its payload."""
    own = geared(rig(), 50)
    arm = Twin.from_rig(own, link_mass=0.00735)
    curves = []
    for time in (None, 0.02):
        made = design(time)
        law = equip(fl.discretize(made.controller, own.period), own, made.model)
        run = fl.simulate(
            law,
            fl.smooth_step(1.0, duration=1.0),
            arm=arm,
            duration=4.0,
            events=[PayloadChange(time=1.5, payload=0.020)],
        )
        curves.append(
            (
                f"δ = {1e3 * made.controller.filter_time:.0f} ms",
                run.time[::2],
                1e3 * run.error[::2],
            )
        )
    said = (
        "Tip error of two designs whose payload falls from 30 g to 20 g after the move"
    )
    return lines(
        "dropped",
        said,
        "tip error [mrad]",
        curves,
        "time [s]",
        above=[Upright(1.5, "10 g fall off")],
    )


def stand_ins() -> Figure:
    """Error of two rational approximations of the same order."""
    link = rig().model.tip()
    w = np.geomspace(0.1, 300, 500)
    exact = link(1j * w)
    curves = []
    for method in ("minimax", "oustaloup"):
        made = fracsys.approximate(link, band=(0.1, 300.0), order=6, method=method)
        curves.append((method, w, 20 * np.log10(np.abs(made(1j * w) / exact))))
    said = "Error of the modulus of two rational approximations of order six"
    return lines(
        "stand-ins", said, "error of |G| [dB]", curves, "frequency ω [rad/s]", log=True
    )


def budget() -> Figure:
    """The phase budget as a waterfall: from 180° down to the phase margin."""
    # The margin is 180° + arg L: the sign of the feedback is the first element, and
    # lags reduce it.
    steps, level = [("feedback", 0.0, 180.0, 4)], 180.0
    for share in phase_budget(design(), 0.020):
        size = math.degrees(share.phase)
        steps.append((share.element, level, level + size, 2 if size < 0 else 1))
        level += size
    steps.append(("phase margin", 0.0, level, 3))
    marks: list[Mark] = []
    for row, (_, start, end, line) in enumerate(steps):
        ends, sides = [start, end, end, start], [row + 0.15] * 2 + [row + 0.85] * 2
        marks.append(Curve(ends, sides, line, weight="fill"))
        text = f"{end - start:+.1f}°".replace("-", "−")
        marks.append(Point(max(start, end), row + 0.5, text, sign="", beside=True))
    names = tuple((row + 0.5, name) for row, (name, *_) in enumerate(steps))
    # The first element is at the top.
    y = Scale(float(len(steps)), 0.0, ticks=names)
    return Figure(
        "budget",
        "What each element of the loop takes from the phase",
        (Panel("", marks, 26.0 * len(steps), y),),
        "phase at the crossover [°]",
        scale=Scale(0.0, 1.33 * max(end for *_, end, _ in steps)),
        left=168.0,
    )


@cache
def moves() -> tuple[fl.Run, ...]:
    move = fl.smooth_step(1.0, duration=0.5)
    return tuple(
        fl.simulate(design(0.02), move, payload=m, duration=2.5)
        for m in (0.020, 0.030, 0.040)
    )


def link_steps() -> Figure:
    """Exact step responses of links of three orders."""
    t = np.linspace(0.0, 3.0, 400)
    curves = []
    for order in (2.0, 1.95, 1.85):
        link = fl.LinkModel(1.56, 11.5, order=order)
        curves.append(
            (f"λ = {order:g}", t[1:], fracsys.step_response(link.tip(), t).output[1:])
        )
    said = "Exact step responses of links of three orders"
    return lines("steps", said, "tip after a step of the motor", curves, "time [s]")


def pid_step() -> Figure:
    """The law of a fractional PID on a furnace."""
    s = fracsys.s
    made = fl.tune_pid(
        1 / (14994 * s**1.31 + 6009.5 * s**0.97 + 1.69),
        gain_crossover=0.1,
        phase_margin=fl.deg(60),
        period=1.0,
        output_limit=4000.0,
        measurement_limit=50.0,
    )
    step = made.step(law=made.law(), size=10.0, duration=150.0)
    # The output is held between samples: steps without slopes, as the actuator receives
    # them.
    times, output = np.repeat(step.time, 2)[1:], np.repeat(step.output, 2)[:-1]
    measured: list[Mark] = [
        Across(10.0, "reference"),
        Curve(step.time, step.measurement, 1),
        Across(0.0, limit=False),
    ]
    panels = (
        Panel("measurement", measured, 190.0),
        Panel("controller's output", [Curve(times, output, 2)], 130.0),
    )
    said = "The law of a fractional PID on its plant: measurement and output after a step of the reference"
    return Figure("pid-step", said, panels, "time [s]", "step")


@dataclass(frozen=True)
class Picture:
    """A title, the page that explains it, and what draws it."""

    title: str
    page: str
    draw: Callable[[], Figure | str]


PICTURES: dict[str, Picture] = {
    "arm": Picture("The arm and its signals", "reference/symbols", arm_sketch),
    "loop": Picture("The loop", "reference/law", loop_sketch),
    "log": Picture(
        "A recorded log", "how-to/read-your-log", lambda: figures.log_figure(log())
    ),
    "detail": Picture(
        "A model over the log",
        "tutorial/from-log-to-board",
        lambda: figures.detail_figure(fit()),
    ),
    "response": Picture(
        "Model and log over frequency",
        "how-to/read-the-report",
        lambda: figures.response_figure(log(), fit()) or "",
    ),
    "residual": Picture(
        "What a model leaves unexplained",
        "explanation/identification",
        lambda: figures.residual_figure(fit()) or "",
    ),
    "structures": Picture(
        "Four structures",
        "how-to/choose-a-structure",
        lambda: figures.models_figure(comparison().fits, comparison().preferred),
    ),
    "validation": Picture(
        "A second log",
        "how-to/validate-on-a-second-log",
        lambda: figures.validation_figure(
            fit().validate(fl.read_log(fl.bundled_log("pulse_30g"), rig=rig()))
        ),
    ),
    "damping": Picture("Two kinds of damping", "explanation/why-fractional", damping),
    "steps": Picture(
        "Step responses of fractional links", "how-to/fractional-calculus", link_steps
    ),
    "stand-ins": Picture("Rational stand-ins", "explanation/numerics", stand_ins),
    "second-mode": Picture("The twin’s second mode", "explanation/twin", second_mode),
    "bode": Picture(
        "The open loop",
        "how-to/design-a-controller",
        lambda: loops.bode_figure(design()),
    ),
    "pid-step": Picture(
        "A fractional PID on its plant", "how-to/tune-a-fractional-pid", pid_step
    ),
    "filters": Picture("The filter’s price", "how-to/choose-the-filter", filters),
    "mode-gain": Picture(
        "The loop at the second mode", "explanation/limits", mode_gain
    ),
    "margins": Picture(
        "Margins over the payload",
        "explanation/what-the-margins-mean",
        lambda: loops.margins_figure(design()),
    ),
    "published": Picture(
        "Promised and actual margin", "explanation/the-paper", published
    ),
    "budget": Picture(
        "Where the phase goes",
        "explanation/margins",
        budget,
    ),
    "nyquist": Picture(
        "The disk around −1",
        "how-to/read-a-certificate",
        lambda: loops.nyquist_figure(design(0.0), 0.45),
    ),
    "offset": Picture(
        "An offset is forgotten", "explanation/offset-and-memory", offset
    ),
    "moves": Picture(
        "One law, three payloads",
        "how-to/run-the-twin",
        lambda: runs.moves_figure(moves()),
    ),
    "dropped": Picture("A payload that falls off", "how-to/run-the-twin", dropped),
}
