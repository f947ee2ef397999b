"""What a user asks a finished design: where the phase goes, how margins move, what it tolerates."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink._design.loop import OpenLoop
from fraclink._design.measure import measure
from fraclink._design.plan import Design, Requirement, open_loop
from fraclink._design.request import checked_axis
from fraclink._validate import checked_between, checked_choice, checked_noun
from fraclink.errors import FieldError

__all__ = [
    "MarginCurve",
    "PhaseShare",
    "Tolerances",
    "VibrationMode",
    "margin_curve",
    "phase_budget",
    "spillover",
    "tolerances",
]

Real = NDArray[np.float64]


@dataclass(frozen=True)
class PhaseShare:
    """The phase [rad] that one element gives at the gain crossover; negative is lag."""

    element: str
    phase: float


def phase_budget(design: Design, payload: float) -> tuple[PhaseShare, ...]:
    """Return what each element of the loop gives at the upper gain crossover, at `payload` [kg] > 0.

    The shares and the half turn of feedback add up to the phase margin of the loop with everything inside.

    >>> import fraclink as fl
    >>> from fraclink._design.assess import phase_budget
    >>> rig = fl.Rig.named("paper-2023")
    >>> wanted = {"gain_crossover": 12.0, "phase_margin": fl.deg(50), "filter_time": 0.0}
    >>> design = fl.design(rig.model, rig, payloads=(0.020, 0.040), **wanted)
    >>> shares = phase_budget(design, 0.020)
    >>> print(f"{sum(share.phase for share in shares) + 3.141592653589793:.4f}")
    0.8727
    """
    checked_noun("plan", design, Design, remedy="fl.design makes one")
    loop = open_loop(design.controller, design.model, design.rig, margins="loop")
    pi = design.natural_frequency(payload)
    crossings = loop.crossings(pi, highest=math.pi / design.rig.period).frequency
    if crossings.size == 0:
        allowed, remedy = "a payload at which |L| crosses one", "give the mass in kg"
        raise FieldError("payload", payload, "without a gain crossover", allowed=allowed, remedy=remedy)
    w = float(np.max(crossings))
    inner = 0.0 if loop.correction is None else float(loop.correction(np.asarray(w)).imag)
    return (
        PhaseShare("link", float(loop.link().log(w, pi).imag)),
        PhaseShare("derivative", 0.5 * math.pi * loop.order),
        PhaseShare("filter", -loop.filter_order * math.atan(loop.filter_time * w)),
        *(() if loop.lead is None else (PhaseShare("lead", float(loop.lead.log(w).imag)),)),
        PhaseShare("motor loop", -2.0 * math.atan(loop.lag * w) + inner),
        PhaseShare("hold", -0.5 * design.rig.period * w),
        PhaseShare("computation delay", -(loop.delay - 0.5 * design.rig.period) * w),
    )


@dataclass(frozen=True)
class MarginCurve:
    """Margins against payload (Fig. 10): arrays of shape (N,) in kg, rad/s, rad and 1.

    ``phase_margin`` is the smallest over all gain crossings, below zero where the loop is unstable.
    """

    kind: str
    payload: Real
    gain_crossover: Real
    phase_margin: Real
    modulus_margin: Real


def margin_curve(design: Design, payloads: ArrayLike, *, kind: str = "loop") -> MarginCurve:
    """Return the margins of a design against payload (Fig. 10).

    Parameters
    ----------
    payloads
        masses at the tip [kg], > 0, shape (N,).
    kind
        "ideal" (the paper's L), "motor" (its LM, with M(s) and the filter), "loop" (hold and delay too) or
        "sampled" (the law that is shipped, in the exactly sampled loop).
    """
    checked_noun("plan", design, Design, remedy="fl.design makes one")
    masses = checked_axis("payloads", payloads)
    for value in masses:
        checked_between("payloads", float(value), 0.0, 1e4, "kg", open_low=True)
    checked_choice("kind", kind, ("ideal", "motor", "loop", "sampled"), remedy="say 'loop'")
    if kind == "sampled":
        found = [design.sampled_at(float(m)) for m in masses]
        size = np.array([abs(f.phase_margin) for f in found])
        return MarginCurve(
            kind,
            masses,
            np.array([f.gain_crossover for f in found]),
            np.where([bool(f.stable) for f in found], size, -size),
            np.array([f.modulus_margin for f in found]),
        )
    whole = open_loop(design.controller, design.model, design.rig, margins="loop")
    loops = {
        "ideal": open_loop(design.controller, design.model, design.rig, margins="ideal"),
        "motor": replace(whole, delay=0.0, correction=None),
        "loop": whole,
    }
    pi = np.array([design.natural_frequency(float(m)) for m in masses])
    got = measure(loops[kind], pi, design.rig.period, highest=math.pi / design.rig.period)
    return MarginCurve(kind, masses, got.gain_crossover, got.phase_margin, 1.0 / got.sensitivity_peak)


@dataclass(frozen=True)
class Tolerances:
    """How far one thing may be wrong before the loop is unstable at some payload of the design.

    ``delay`` [s] more than assumed; ``payload_low`` and ``payload_high`` [kg], the lightest and heaviest
    stable payload (0 and infinity where there is no limit within a factor of 49); ``stiffness_low`` and
    ``stiffness_high``, true over assumed stiffness; ``motor_pole`` [rad/s], the slowest motor loop.
    """

    delay: float
    payload_low: float
    payload_high: float
    stiffness_low: float
    stiffness_high: float
    motor_pole: float


def _edge(stable: Callable[[float], bool], start: float, end: float) -> float | None:
    """The value between `start` (stable) and `end` where stability is lost; None where it never is."""
    steps = np.geomspace(start, end, 60)
    bad = next((float(x) for x in steps[1:] if not stable(float(x))), None)
    if bad is None:
        return None
    good = float(steps[int(np.argmax(steps == bad)) - 1])
    for _ in range(40):
        middle = math.sqrt(good * bad)
        good, bad = (middle, bad) if stable(middle) else (good, middle)
    return good


def tolerances(design: Design) -> Tolerances:
    """Return how much delay, payload, stiffness and motor-pole error the loop that runs tolerates."""
    checked_noun("plan", design, Design, remedy="fl.design makes one")
    loop = open_loop(design.controller, design.model, design.rig, margins="loop")
    low, high = design.natural_frequencies
    grid = np.geomspace(low, high, 9)
    nyquist = math.pi / design.rig.period
    found = loop.crossings(grid, highest=nyquist)
    falling = found.slope < 0.0
    delay = float(np.min(np.remainder(found.phase_margin[falling], 2 * math.pi) / found.frequency[falling]))

    def at(changed: OpenLoop, pi: Real) -> bool:
        return all(changed.encirclements(float(p), highest=nyquist) == 0 for p in pi)

    light = _edge(lambda p: at(loop, np.array([p])), high, 7.0 * high)
    heavy = _edge(lambda p: at(loop, np.array([p])), low, low / 7.0)
    slow = None
    if loop.lag:
        slow = _edge(lambda p: at(replace(loop, lag=1.0 / p), grid), 1.0 / loop.lag, 0.02 / loop.lag)

    def with_stiffness(ratio: float) -> bool:
        return all(_stiffness_holds(loop, float(p), ratio, nyquist) for p in grid[[0, 4, 8]])

    soft, stiff = _edge(with_stiffness, 1.0, 0.05), _edge(with_stiffness, 1.0, 20.0)
    return Tolerances(
        delay=delay,
        payload_low=design.payload(light) if light else 0.0,
        payload_high=design.payload(heavy) if heavy else math.inf,
        stiffness_low=soft or 0.0,
        stiffness_high=stiff or math.inf,
        motor_pole=slow or 0.0,
    )


def _stiffness_holds(loop: OpenLoop, pi: float, ratio: float, nyquist: float) -> bool:
    """Stable where the true stiffness is `ratio` times the one in the tip estimate and in the design.

    The estimate is then ``θm - Γ/c = θm (1 - ratio s^λ/(s^λ + ratio ω₀²))`` and the mode moves with it.
    """
    true = pi * math.sqrt(ratio)
    w = np.unique(np.concatenate([loop.peak(true) * np.geomspace(0.02, 50.0, 3000), [nyquist]]))
    w = w[w <= nyquist]
    inertia = np.exp(loop.link_order * np.log(1j * w))
    drag = loop.damping * np.exp(loop.damping_order * np.log(1j * w))
    seen = ((1.0 - ratio) * inertia + drag + true**2) / (drag + true**2)
    turned = np.unwrap(np.angle(1.0 + loop(w, true) * seen))
    return bool(round((turned[-1] - turned[0]) / math.pi) == 0)


@dataclass(frozen=True)
class VibrationMode:
    """A higher mode of a distributed link: ω_i [rad/s], damping ratio, static share in the tip estimate."""

    frequency: float
    damping_ratio: float
    share: float = 1.0


def spillover(
    design: Design, modes: Sequence[VibrationMode], *, limit: float = 0.5
) -> tuple[Requirement, ...]:
    """Return the loop gain at each higher mode against `limit`: below one it cannot be destabilised by phase.

    A mode adds ``share/(1 - (ω/ω_i)² + 2jζω/ω_i)`` to the tip estimate, ``share/(2ζ)`` at its peak; the loop
    gain there is ``|Ĉ M| share/(2ζ)``.
    """
    checked_noun("plan", design, Design, remedy="fl.design makes one")
    checked_between("limit", limit, 0.0, 1e3, "", open_low=True)
    loop = open_loop(design.controller, design.model, design.rig, margins="loop")
    link = loop.link()
    pi = design.natural_frequencies[1]
    found = []
    for number, mode in enumerate(modes, start=2):
        w = checked_between("mode.frequency", mode.frequency, 0.0, 1e6, "rad/s", open_low=True)
        zeta = checked_between("mode.damping_ratio", mode.damping_ratio, 0.0, 1.0, "", open_low=True)
        rest = float(np.exp(loop.level(w, pi) - link.level(w, pi)))
        value = rest * abs(mode.share) / (2.0 * zeta)
        found.append(Requirement.at_most(f"loop gain at mode {number}", limit, value, "", design.payloads[0]))
    return tuple(found)
