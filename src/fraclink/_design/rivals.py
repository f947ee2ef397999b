"""The same distance from -1 for all: what the fractional order buys, and what it does not."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.controller import Controller
from fraclink._design.loop import OpenLoop
from fraclink._design.measure import measure, sensitivity_peak
from fraclink._design.plan import Design, open_loop
from fraclink._design.poles import PRINTED, match_at
from fraclink._validate import checked_between
from fraclink.errors import InfeasibleError

__all__ = ["Rival", "compare_at_equal_sensitivity", "scale_to_sensitivity"]

Real = NDArray[np.float64]


@dataclass(frozen=True)
class Rival:
    """A controller and its worst values over the payload range of a design, on the loop that runs."""

    name: str
    controller: Controller
    stable: bool
    sensitivity_peak: float
    gain_crossover: float  # smallest upper crossover [rad/s]
    phase_margin: float  # smallest [rad]
    noise_gain: float
    settling_time: float  # 2π/gain_crossover [s]


def _loop_of(design: Design, controller: Controller) -> OpenLoop:
    equipped = replace(controller, inner=design.controller.inner, period=design.rig.period)
    return open_loop(equipped, design.model, design.rig, margins="loop")


def _rate(design: Design, name: str, controller: Controller) -> Rival:
    low, high = design.natural_frequencies
    nyquist = math.pi / design.rig.period
    got = measure(
        _loop_of(design, controller), np.geomspace(low, high, 9), design.rig.period, highest=nyquist
    )
    stable = bool(np.all(got.phase_margin > 0.0))
    slowest = float(np.min(got.gain_crossover))
    return Rival(
        name=name,
        controller=controller,
        stable=stable,
        sensitivity_peak=float(np.max(got.sensitivity_peak)),
        gain_crossover=slowest,
        phase_margin=float(np.min(got.phase_margin)),
        noise_gain=float(np.max(got.noise_gain)) if stable else math.inf,
        settling_time=2.0 * math.pi / slowest if slowest else math.inf,
    )


def scale_to_sensitivity(design: Design, controller: Controller, max_sensitivity: float) -> Controller:
    """Return the controller with the largest gain whose worst Ms over the payloads is `max_sensitivity` > 1.

    Raises InfeasibleError where no gain reaches it.
    """
    bound = checked_between("max_sensitivity", max_sensitivity, 1.0, 100.0, "", open_low=True)
    loop, pi = _loop_of(design, controller), np.geomspace(*design.natural_frequencies, 9)
    nyquist = math.pi / design.rig.period
    ratios = np.geomspace(1e-2, 1e2, 240)
    holds = _rough_peaks(loop, pi, nyquist, ratios) <= bound
    if not holds.any():
        raise InfeasibleError(
            "sensitivity peak", f"no gain brings Ms to {bound:g} with β = {controller.order:g}"
        )
    last = int(np.nonzero(holds)[0][-1])
    good, bad = float(ratios[max(last - 1, 0)]), float(ratios[min(last + 1, ratios.size - 1)])
    for _ in range(36):
        middle = math.sqrt(good * bad)
        peak = float(np.max(sensitivity_peak(replace(loop, gain=middle * loop.gain), pi, nyquist)))
        good, bad = (middle, bad) if peak <= bound else (good, middle)
    return replace(controller, gain=good * controller.gain)


def _rough_peaks(loop: OpenLoop, pi: Real, nyquist: float, ratios: Real) -> Real:
    """Worst Ms for each factor on the gain, on a grid; infinite from the first factor that is unstable on.

    L is linear in the gain and keeps its phase: -1 is passed where |L| at the phase crossing reaches one.
    """
    w = np.minimum(loop.peak(pi)[:, None] * np.geomspace(0.2, 60.0, 400), nyquist)
    log = loop.log(w, pi[:, None])
    value, beyond = np.exp(log), log.imag <= -math.pi
    crossing = float(np.max(np.abs(value), where=beyond, initial=1e-300))
    peaks = np.array([float(np.max(1.0 / np.abs(1.0 + r * value))) for r in ratios])
    return np.where(ratios * crossing < 1.0, peaks, math.inf)


def compare_at_equal_sensitivity(design: Design, *, max_sensitivity: float) -> tuple[Rival, ...]:
    """Rate C, C', PD and the best β at one worst Ms, and the paper's printed controllers as they are.

    C' has the order of the integer-model design matched to the design at the nominal payload (eq. (42) with
    λ = 2); PD is β = 1. Each gets the largest gain that the bound on Ms allows, with the design's own filter.
    For matched designs the published advantage of the fractional model vanishes; this shows by how much.
    """
    own = design.controller
    nominal = design.rig.payloads.nominal
    pi = design.natural_frequency(nominal)
    loop = replace(design.loop, filter_time=0.0, lag=0.0, delay=0.0, correction=None)
    if own.lead is not None:  # C' has none: matched to a C whose lead is its gain at the crossover
        at = abs(complex(own.lead.response(design.gain_crossover_upper)))
        loop = replace(loop, lead=None, gain=loop.gain * at)
    found = loop.crossings(pi)
    upper = int(np.argmax(found.frequency))
    matched = match_at(
        replace(design.model, order=2.0, damping=0.0),
        pi,
        float(found.frequency[upper]),
        float(np.remainder(found.phase_margin[upper], 2.0 * math.pi)),
    )
    entries = [("C, fractional model", own.order), ("C', integer model", matched.order), ("PD", 1.0)]
    rivals = []
    for name, order in entries:
        start = _start(own, order, float(found.frequency[upper]))
        rivals.append(_rate(design, name, scale_to_sensitivity(design, start, max_sensitivity)))
    rivals.append(_best_order(design, max_sensitivity))
    rivals += [_rate(design, f"printed {name}", printed) for name, printed in PRINTED.items()]
    return tuple(rivals)


def _start(own: Controller, order: float, frequency: float) -> Controller:
    """The design's controller with another β, no lead, and the same gain at `frequency` [rad/s]."""
    n = max(own.filter_order, 2 if order >= 1.0 and own.filter_time else 1)
    gain = own.gain * frequency ** (own.order - order)
    return replace(own, order=order, gain=gain, filter_order=n, lead=own.lead if order == own.order else None)


def _best_order(design: Design, max_sensitivity: float) -> Rival:
    """The β, with the design's own filter, that crosses highest for the worst payload at this Ms."""
    best: Rival | None = None
    centre, width = design.controller.order, 0.35
    for _ in range(3):
        for order in centre + width * np.linspace(-1.0, 1.0, 7):
            if not 0.05 < order < min(design.model.order, 1.95):
                continue
            rival = _try(design, float(order), max_sensitivity)
            if rival is not None and (best is None or rival.gain_crossover > best.gain_crossover):
                best = rival
        centre = best.controller.order if best is not None else centre
        width /= 3.0
    if best is None:
        raise InfeasibleError("sensitivity peak", f"no order β brings Ms to {max_sensitivity:g}")
    return best


def _try(design: Design, order: float, max_sensitivity: float) -> Rival | None:
    start = _start(design.controller, order, design.gain_crossover_upper)
    try:
        return _rate(design, "best β", scale_to_sensitivity(design, start, max_sensitivity))
    except InfeasibleError:
        return None
