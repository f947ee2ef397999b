"""Drawings of moves in time: simulated runs, shaped moves, and runs with a fault next
to their clean run.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import cycle

import numpy as np

from fraclink._law import MODES
from fraclink._simulate import Run
from fraclink._simulate.metrics import BAND
from fraclink._simulate.shape import ShapedMove
from fraclink.trials._fault_checks import Evidence
from fraclink.trials._fault_trial import Bench
from fraclink.trials._faults import Outcome, fault_named, observe
from fraclink.view._drawing import Figure, Panel, figure_of
from fraclink.view._marks import Across, Curve, Mark, Upright, Zone, record
from fraclink.view._pages import LINES
from fraclink.view._scales import Scale
from fraclink.view._text import grams

__all__ = ["moves_figure", "outcome_figure", "shaped_figure"]


def moves_figure(runs: Sequence[Run]) -> Figure:
    """Draw the tip's tracking with its 2 % band, its error, the gauge's torque and the
    motor's voltage.
    """
    first = runs[0]
    end = float(first.reference[-1])
    size = abs(end - float(first.reference[0]))
    tip: list[Mark] = (
        [Zone(end - BAND * size, end + BAND * size, lying=True)] if size else []
    )
    tip.append(record(first.time, first.reference, 0, "reference", dashed=True))
    band_mrad = 1e3 * BAND * size
    error: list[Mark] = [Zone(-band_mrad, band_mrad, lying=True)] if size else []
    torque: list[Mark] = []
    voltage: list[Mark] = []
    for line, run in zip(cycle(LINES), runs, strict=False):
        tip.append(record(run.time, run.tip_angle, line, grams(run.payload)))
        error.append(record(run.time, 1e3 * (run.tip_angle - run.reference), line))
        torque.append(record(run.time, run.torque_measured, line, weight="thin"))
        voltage.append(record(run.time, run.voltage, line, weight="thin"))
    panels = (
        Panel("tip angle θt [rad]; shaded: within 2 % of the move", tip, 200.0),
        Panel("tip error [mrad]", error, 110.0),
        Panel("gauge Γ [N·m]", torque, 90.0),
        Panel("motor [V]", voltage, 90.0),
    )
    return Figure(
        "moves",
        "Tip angle, tip error, torque and voltage of the simulated moves",
        panels,
        "time [s]",
        "time",
    )


@figure_of.register
def _run(run: Run) -> Figure:
    return moves_figure([run])


@figure_of.register
def shaped_figure(move: ShapedMove) -> Figure:
    """Draw the reference with the tips of all arms of the set, its acceleration, and
    the voltages.
    """
    reference, time = move.reference, move.period * np.arange(move.tip_angle.shape[1])
    # Half of the picture for the move, half for the time after it.
    end = min(float(time[-1]), 2.0 * reference.duration)
    part = time <= end * (1 + 1e-9)
    time = time[part]
    low, high = (1 - BAND) * move.amplitude, (1 + BAND) * move.amplitude
    tip: list[Mark] = [Zone(low, high, lying=True)]
    if math.isfinite(move.settling_time) and move.settling_time < end:
        tip.append(Upright(move.settling_time, "all settled"))
    tip.append(record(time, reference.angle(time), 0, "reference", dashed=True))
    # The acceleration shows the difference between a shaped and a smooth move, which
    # angles do not.
    acceleration = [record(time, reference.acceleration(time), 0)]
    voltage: list[Mark] = [Across(move.voltage, "limit"), Across(-move.voltage)]
    for line, arm, angle, volts in zip(
        cycle(LINES),
        move.worst_case.arms,
        move.tip_angle,
        move.motor_voltage,
        strict=False,
    ):
        words = f"{arm.arm}, {grams(arm.payload)}"
        tip.append(record(time, angle[part], line, words))
        voltage.append(record(time, volts[part], line, weight="thin"))
    panels = (
        Panel("tip angle θt [rad]", tip, 200.0),
        Panel("acceleration of the reference [rad/s²]", acceleration, 100.0),
        Panel("motor [V]", voltage, 100.0),
    )
    return Figure(
        "shaped",
        "Tip angle, acceleration of the reference and voltage of a shaped move",
        panels,
        "time [s]",
        "time",
    )


def outcome_figure(bench: Bench, outcome: Outcome) -> Figure:
    """Run a case again and draw it: the tip next to that of the clean run, motor and
    gauge as measured and true, and the mode of the law.
    """
    e = observe(bench, outcome.case)
    title = f"{outcome.name}: {fault_named(outcome.case.fault).title}"
    verdict = str(outcome.failed[0]) if outcome.failed else "passed"
    event = e.trial.row * e.trial.period
    gauge: list[Mark] = [
        record(e.faulty.time, e.faulty.torque_measured, 2, "gauge", "thin"),
        record(e.faulty.time, e.faulty.torque, 0, "true"),
    ]
    modes = Scale(
        -0.4,
        len(MODES) - 0.6,
        ticks=tuple((float(k), name) for k, name in enumerate(MODES)),
    )
    # The mode is held for a period and changes at once: a slope between two modes would
    # suggest a third.
    time, mode = np.repeat(e.faulty.time, 2)[1:], np.repeat(e.faulty.mode, 2)[:-1]
    rows = (
        Panel(f"{title}. Tip angle [rad]", _tip(e), 190.0),
        _motor(e),
        Panel("torque [N·m]", gauge, 110.0),
        Panel("mode of the law", [Curve(time, mode, 1)], 60.0, modes),
    )
    panels = tuple(
        replace(panel, marks=[*panel.marks, Upright(event, "" if k else "fault")])
        for k, panel in enumerate(rows)
    )
    return Figure(
        "outcome",
        f"{title}; {verdict}",
        panels,
        f"time [s]; {verdict}",
        "time",
        left=66.0,
    )


def _tip(e: Evidence) -> list[Mark]:
    time, reference = e.faulty.time, e.faulty.reference
    return [
        record(time, reference, 0, "reference", dashed=True),
        record(e.clean.time, e.clean.tip_angle, 2, "clean"),
        record(time, e.faulty.tip_angle, 1, "faulty"),
    ]


def _motor(e: Evidence) -> Panel:
    # The scale follows the true angle, since an encoder in degrees would flatten
    # everything else; 0.1 rad of room even if the arm stands still.
    low, high = float(e.faulty.motor_angle.min()), float(e.faulty.motor_angle.max())
    edge = 0.2 * max(high - low, 0.5)
    marks: list[Mark] = [
        record(e.faulty.time, e.faulty.motor_angle, 0, "true"),
        record(
            e.faulty.time,
            e.faulty.motor_angle_measured,
            2,
            "encoder",
            "thin",
        ),
        record(e.faulty.time, e.faulty.motor_reference, 1, "reference"),
    ]
    return Panel("motor [rad]", marks, 120.0, Scale(low - edge, high + edge))
