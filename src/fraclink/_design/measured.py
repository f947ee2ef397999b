"""What a controller achieves in each row of the table: measured by the engine of the
loop, not by the solver's table.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from fraclink._arm.controller import Controller
from fraclink._arm.loop import Loop, noise_points, worst_margins
from fraclink._design.request import Request, Solved
from fraclink._design.sheet import voltage_share
from fraclink._law.modes import mode_requirements, vibration
from fraclink._law.requirement import Requirement
from fraclink._law.rows import DAMPING, NOISE_SHARE, row

__all__ = ["requirements_of"]

_LINKS = 9  # at which Ms and noise are measured: both are smooth over ω₀


def requirements_of(
    request: Request, solved: Solved, crossover: float
) -> tuple[Requirement, ...]:
    """Return every row with its worst value over payloads and arms.

    `crossover` is the one that is asked for, or was reached where the fastest was.
    """
    numbers = {0, *request.worst_arms(solved).values()}
    worst: dict[tuple[str, int | None], Requirement] = {}
    for number in sorted(numbers):
        for key, index, item in _measured(
            request, number, solved.controller, crossover
        ):
            known = worst.get((key, index))
            if known is None or item.slack < known.slack:
                worst[key, index] = item
    return tuple(worst.values())


def _measured(
    request: Request, number: int, controller: Controller, crossover: float
) -> Iterator[tuple[str, int | None, Requirement]]:
    """(key, number of the mode, requirement) of one arm."""
    arm = request.arms[number]
    loop, w0 = arm.loop(controller, request.rig), request.links(number, _LINKS)
    low, high = request.payloads

    def at(frequency: float) -> float:
        # the box's interval of ω₀ is no other payload
        return min(max(arm.model.payload_at(frequency), low), high)

    def row_of(
        key: str,
        wanted: float,
        achieved: float,
        frequency: float,
        index: int | None = None,
    ) -> tuple[str, int | None, Requirement]:
        item = row(key).measured(wanted, achieved, at(frequency), index)
        return key, index, item

    (slowest, at_slow), (margin, at_margin) = worst_margins(
        loop, float(w0[0]), float(w0[-1])
    )
    if request.spec.gain_crossover is not None or request.spec.settling_time is None:
        yield row_of("gain_crossover", crossover, slowest, at_slow)
    last = loop.margins(w0)[0]
    top = int(np.argmax(last))
    yield row_of("highest_crossover", request.highest, float(last[top]), float(w0[top]))
    if request.spec.settling_time is not None:
        time = 2.0 * math.pi / slowest if slowest else math.inf
        yield row_of("settling_time", request.spec.settling_time, time, at_slow)
    yield row_of("phase_margin", request.phase_margin, margin, at_margin)
    if request.max_sensitivity is not None:
        peak = np.where(loop.margins(w0)[1] > 0.0, loop.sensitivity_peak(w0), math.inf)
        top = int(np.argmax(peak))
        yield row_of(
            "max_sensitivity",
            request.max_sensitivity,
            float(peak[top]),
            float(w0[top]),
        )
    bound, grows = request.max_sensitivity, loop.gain_margin(w0)
    top = int(np.argmin(grows))
    # What Ms leaves at -180°; stability alone where only a phase margin is asked for.
    least = 1.0 if bound is None else bound / (bound - 1.0)
    yield row_of("gain_margin", least, float(grows[top]), float(w0[top]))
    late = np.where(loop.margins(w0)[1] > 0.0, loop.delay_margin(w0), 0.0)
    top = int(np.argmin(late))
    # One sample that comes a period late must not make the loop unstable.
    yield row_of("delay_margin", request.rig.period, float(late[top]), float(w0[top]))
    if request.mode_gain is not None:
        modes = request.modes(number, loop)
        for index, item in mode_requirements(modes, loop, request.mode_gain):
            yield "mode_gain", index, item
    if request.spec.noise_gain is not None:
        noise = loop.noise_gain(w0, request.rig.period)
        top = int(np.argmax(noise))
        yield row_of(
            "noise_gain", request.spec.noise_gain, float(noise[top]), float(w0[top])
        )
    if request.voltage is not None:
        shares = np.array([_voltage(request, loop, float(x)) for x in w0[[0, -1]]])
        top = int(np.argmax(shares))
        yield row_of(
            "noise_voltage", NOISE_SHARE, float(shares[top]), float(w0[[0, -1]][top])
        )
    for end in (w0[0], w0[-1]):
        found = vibration(loop, float(end))
        ratio = 1.0 if found is None else found.damping_ratio
        yield row_of("damping", DAMPING, ratio, float(end))
    if number == 0:
        light = request.model.at_payload(request.empty).natural_frequency
        kept = float(loop.margins(light)[1][0])
        assumed = request.rig.payloads.empty is None
        note = "assumed" if assumed else ""
        item = row("empty").measured(0.0, kept, request.empty, note=note)
        yield "empty", None, item


def _voltage(request: Request, loop: Loop, natural_frequency: float) -> float:
    """The share of the voltage limit that the RMS of the gauge's noise takes."""
    assert request.voltage is not None  # the rig states a noise  # noqa: S101
    w, weight = noise_points(loop, natural_frequency, request.rig.period)
    outer = np.exp(loop.outer_log(w).real) / np.abs(1.0 + loop(w, natural_frequency))
    volts = outer * voltage_share(loop, w, request.voltage)
    return math.sqrt(float(np.sum(volts**2 * weight)))
