"""The rivals, each with its tuning rule; none is tuned by hand.

Each is a law that runs in law.c like the design: the corrected equation (22),

    θm* = θt* + F(z) θ̈t* + Ĉ(z) e,   e = θt* − (θm − Γ/c),

with the same feed-forward F for all that use the tip estimate, and their own correction
Ĉ.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cache, lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag, companion, expm, solve_discrete_are

from fraclink._arm.controller import Controller
from fraclink._arm.link import LinkModel
from fraclink._arm.reference import Reference
from fraclink._design import deg, design
from fraclink._law import Law, Modes, discretize
from fraclink._law.design import Design
from fraclink.errors import InfeasibleError, NotConvergedError
from fracsys.checks import Complex, Real

__all__ = ["FRACLINK", "Rival", "Shaped", "builders", "motor_alone"]


FRACLINK = "fraclink"
# [s] of the rivals' filtered derivative: 100 rad/s, above a usual motor loop (otherwise
# the filter would be the slowest lag of the loop), and below the Nyquist frequency
# (otherwise it would not filter).
FILTER_TIME = 0.01
KNOBS = 100  # geometric steps in the range of gains that are tried


def correction_of(a: Real, b: Real, c: Real, d: float) -> Modes:
    """Return the filter d + c (z − a)⁻¹ b, all poles simple, in the form in which law.c
    runs a correction: (1 − 1/z)(direct + Σ gain/(z − pole)).
    """
    poles, vectors = np.linalg.eig(a)
    gains = (c @ vectors) * np.linalg.solve(vectors, b)
    # Divided by 1 − 1/z = (z − 1)/z, a constant becomes a pole at 1, and each fraction
    # g/(z − p) becomes a pole at 1 with g/(1 − p) and a pole at p with −p g/(1 − p).
    constant = d + float(np.sum(gains / (1.0 - poles)).real)
    gains = -poles * gains / (1.0 - poles)
    real, upper = poles.imag == 0.0, poles.imag > 0.0
    return Modes(
        d,
        (1.0, *poles[real].real.tolist()),
        (constant, *gains[real].real.tolist()),
        tuple(poles[upper].tolist()),
        # one of each conjugate pair represents both
        tuple((2.0 * gains[upper]).tolist()),
    )


@dataclass(frozen=True)
class Rival:
    """One contender.

    rule: how it was tuned; knob: the value that the rule gave; peak: Ms at the nominal
    payload on the model (1 without feedback of the tip); law: what runs; impulses:
    times [s] and sizes of an input shaper.
    """

    rule: str
    knob: str
    peak: float
    law: Law
    impulses: tuple[tuple[float, float], ...] = ()

    def shaped(self, reference: Reference) -> Reference:
        """Return the reference that the arm follows, after the input shaper if any."""
        return Shaped(reference, self.impulses) if self.impulses else reference


class Shaped(Reference):
    """A reference convolved with impulses, exact in every derivative."""

    def __init__(
        self, reference: Reference, impulses: tuple[tuple[float, float], ...]
    ) -> None:
        self._reference, self._impulses = reference, impulses
        self.duration = float(reference.duration + impulses[-1][0])

    def derivative(self, time: ArrayLike, order: int) -> Real:
        """Return the derivative of `order` [rad/s^order] at `time` [s]."""
        parts = (
            size * self._reference.derivative(np.asarray(time) - delay, order)
            for delay, size in self._impulses
        )
        return np.asarray(sum(parts))


Builder = Callable[[], Rival]


def open_guards(law: Law) -> Law:
    """Return the law with guards that never act, so that all rivals are compared by
    their control alone.
    """
    # All real-valued limits except the rate of the fade, which is not a guard.
    thresholds = (
        name
        for name, value in asdict(law.limits).items()
        if isinstance(value, float) and name != "fade_step"
    )
    return replace(law, limits=law.limits.without(*thresholds))


def motor_alone(law: Law) -> Law:
    """Return the motor loop of the law alone: the motor follows the reference without
    any feedback from the tip.
    """
    return replace(law, correction=Modes(0.0), feedforward=Modes(0.0))


@lru_cache(maxsize=1)  # tuned once for all moves and payloads of a comparison
def builders(design: Design) -> dict[str, Builder]:
    """Return a function for every contender, by name, fraclink first; it tunes its
    rival from the design when it is first called.

    Parameters
    ----------
    design
        all rivals are tuned for its rig, its model and its Ms.
    """
    link = design.model.at_payload(design.rig.payloads.nominal)
    bare = motor_alone(open_guards(design.law()))
    request = "the request: gain crossover, phase margin, payloads"
    impulses = zv_impulses(link.resonance, link.damping_ratio)
    return {
        FRACLINK: lambda: _by_law(request, design.controller, design),
        "motor PID alone": lambda: Rival(
            "the motor follows the reference, without feedback of the tip",
            f"pole {design.rig.motor_loop.pole:.4g} rad/s",
            1.0,
            bare,
        ),
        "ZV shaping": lambda: Rival(
            "two impulses from the nominal mode and its damping; motor PID, no feedback "
            "of the tip",
            f"half a period of {impulses[-1][0]:.4g} s",
            1.0,
            bare,
            impulses,
        ),
        "PD on the tip": cache(
            lambda: _tuned(
                "zero at the nominal mode, notch at the second where it is known",
                lambda gain: pd_correction(link, gain, design.rig.period),
                # from a loop without effect to one that is unstable on every arm
                (1e-3, 10.0),
                design,
            )
        ),
        "LQG": cache(
            lambda: _tuned(
                "integer model, offset state in the Kalman filter, weight of the tip",
                lambda weight: lqg_correction(link, design, weight),
                (1e-4, 1e4),
                design,
            )
        ),
        "the paper's procedure": lambda: _published(design),
    }


def _by_law(rule: str, controller: Controller, tuned_for: Design) -> Rival:
    law = discretize(controller, tuned_for.rig.period)
    peak = sensitivity_peak(tuned_for, law.frequency_response)
    # The motor loop of fraclink's law for all rivals: they differ only in what they
    # command.
    law = open_guards(replace(law, motor_loop=tuned_for.law().motor_loop))
    c = controller
    knob = (
        f"k_d {c.derivative_gain:.4g}, β {c.derivative_order:.4g}, "
        f"δ {c.filter_time:.3g} s, n {c.filter_order}"
    )
    return Rival(rule, knob, peak, law)


def _published(tuned_for: Design) -> Rival:
    result = design(
        tuned_for.model,
        tuned_for.rig,
        payloads=tuned_for.payloads,
        gain_crossover=16.0,
        phase_margin=deg(70.0),
        filter_order=2,
        procedure="published",
        law=False,
    )
    rule = "(54)-(57): 16 rad/s, 70° for M = 1 without sampling, δ by the 10 % rule"
    return _by_law(rule, result.controller, tuned_for)


# --- one knob each, turned until Ms is that of the design -----------------------------


def sensitivity_peak(tuned_for: Design, response: Callable[[Real], Complex]) -> float:
    """Return Ms = max |1/(1 + L)| of a correction at the nominal payload on the model,
    infinite where the loop is unstable.
    """
    margins = tuned_for.sampled_at(tuned_for.rig.payloads.nominal, correction=response)
    return 1.0 / margins.modulus_margin if margins.stable else math.inf


def _tuned(
    rule: str,
    correction: Callable[[float], Modes],
    knobs: tuple[float, float],
    tuned_for: Design,
) -> Rival:
    """Return the rival with the largest knob in the first range of knobs whose Ms is at
    or below that of the design; if there is none, with the knob of the smallest Ms.

    Larger knobs that meet the target again lie beyond a range that misses it, and are
    not used.
    """
    open_law = open_guards(tuned_for.law())

    def peak(knob: float) -> float:
        law = replace(open_law, correction=correction(knob))
        return sensitivity_peak(tuned_for, law.frequency_response)

    target = 1.0 / tuned_for.sampled_at(tuned_for.rig.payloads.nominal).modulus_margin
    values = np.geomspace(*knobs, KNOBS)
    peaks = np.array([peak(value) for value in values.tolist()])
    if not np.isfinite(peaks).any():
        raise NotConvergedError(
            "tuning",
            reached=math.inf,
            wanted=1.0,
            remedy="no tuning value in the range stabilises the nominal arm",
        )
    good = np.append(peaks <= target, False)
    index, remark = int(np.argmin(peaks)), " (least Ms; the design's is out of reach)"
    if good.any():
        first = int(np.argmax(good))
        index, remark = first + int(np.argmin(good[first:])) - 1, ""
    knob = float(values[index])
    return Rival(
        f"{rule}, for the Ms of fraclink's design at the nominal payload",
        f"gain {knob:.4g}{remark}",
        float(peaks[index]),
        replace(open_law, correction=correction(knob)),
    )


def pd_correction(link: LinkModel, gain: float, period: float) -> Modes:
    """Return gain·(1 + s/ω)/(1 + T s), with a notch at the second mode if the link has
    one.
    """
    above, below = np.array([gain / link.resonance, gain]), np.array([FILTER_TIME, 1.0])
    mode = link.second_mode
    # Above the Nyquist frequency the notch would lie at an alias. From a damping ratio of
    # 1/√2 on, its poles have no peak of their own.
    if mode is not None and mode.frequency * period < math.pi:
        near, wide = (
            [1.0, 2.0 * ratio * mode.frequency, mode.frequency**2]
            for ratio in (mode.damping_ratio, math.sqrt(0.5))
        )
        above, below = np.polymul(above, near), np.polymul(below, wide)
    # Tustin's rule for the controller canonical form, direct + c (s − A)⁻¹ e₁
    one, half = np.eye(len(below) - 1), 0.5 * period * companion(below)
    solved = np.linalg.inv(one - half)
    direct = above[0] / below[0]
    c = (above - direct * below)[1:] / below[0]
    return correction_of(
        solved @ (one + half),
        period * solved[:, 0],
        c @ solved,
        direct + 0.5 * period * float(c @ solved[:, 0]),
    )


def lqg_correction(link: LinkModel, tuned_for: Design, weight: float) -> Modes:
    """Return an LQG correction with the gauge's offset as a state of its Kalman filter.

    The regulator minimises Σ tip² + u²/weight of the held and delayed arm. The filter
    assumes a motor reference noise of 10 mrad, the gauge's noise, and an offset with a
    random walk of 3 mrad in ten seconds; the controller uses the tip error, so it does
    not compensate the estimated offset.
    """
    rig = tuned_for.rig
    period, pole, delay = rig.period, rig.motor_loop.pole, rig.motor_loop.delay_samples
    # Without noise of the gauge the filter would have infinite gain; a tenth of a
    # millinewton-metre is below the step of every converter.
    noise = max(rig.gauge.noise, 1e-4) / link.stiffness
    # A model of order 2 with the link's pole.
    w, ratio = link.resonance, link.damping_ratio
    # Motor reference to tip angle: M(s) and the mode of the link, states θm, θ̇m, θt,
    # θ̇t, and the reference, which is held for a period.
    held = expm(
        period
        * np.array(
            [
                [0.0, 1.0, 0.0, 0.0, 0.0],
                [-(pole**2), -2.0 * pole, 0.0, 0.0, pole**2],
                [0.0, 0.0, 0.0, 1.0, 0.0],
                [w**2, 0.0, -(w**2), -2.0 * ratio * w, 0.0],
                [0.0, 0.0, 0.0, 0.0, 0.0],
            ]
        )
    )[:4]
    if delay > 1:
        # the controller has one pole at 0 per period of delay, and law.c only runs
        # simple poles
        raise InfeasibleError("delay_samples", f"{delay} periods, where LQG allows one")
    # The delay is a queue of held inputs; the oldest one drives the arm.
    n = 4 + delay
    queue = np.block(
        [
            [held, np.zeros((4, delay))],
            [np.zeros((delay, 5)), np.eye(delay)],
        ]
    )
    whole, enter = queue[:, :n], queue[:, n]
    row = np.eye(n)[2]
    # One knob: `weight` is the cost of the tip relative to that of the motor reference.
    cost = solve_discrete_are(
        whole, enter[:, None], np.outer(row, row), np.array([[1.0 / weight]])
    )
    gain = (enter @ cost @ whole) / (1.0 / weight + enter @ cost @ enter)

    wide = block_diag(whole, 1.0)
    output = np.append(row, 1.0)
    # 1e-12 keeps the Riccati equation well posed for states that the input does not
    # reach within one step.
    driven = np.outer(enter, enter) * 0.01**2 + 1e-12 * np.eye(n)
    # The offset is slower than any move: with a faster state the filter would take the
    # deflection of a move for an offset.
    process = block_diag(driven, 3e-3**2 * period / 10.0)
    spread = solve_discrete_are(
        wide.T, output[:, None], process, np.array([[noise**2]])
    )
    kalman = spread @ output / (noise**2 + output @ spread @ output)

    # y = tip estimate = −e. Predictor form, so that no products of direct terms arise.
    correct = np.eye(n + 1) - np.outer(kalman, output)
    state = wide @ correct
    state[:n] -= np.outer(enter, gain) @ correct[:n]
    feed = wide @ kalman
    feed[:n] -= enter * float(gain @ kalman[:n])
    # u = −gain (correct x + kalman y), y = −e
    return correction_of(state, -feed, -(gain @ correct[:n]), float(gain @ kalman[:n]))


def zv_impulses(frequency: float, ratio: float) -> tuple[tuple[float, float], ...]:
    """Return the zero-vibration shaper of a mode of `frequency` [rad/s], (1, K): after
    half a damped period, K = exp(−ζπ/√(1 − ζ²)) of a vibration remains.

    Singer and Seering, ASME J. Dyn. Sys. 112 (1990) 76.

    >>> [(round(time, 4), size) for time, size in zv_impulses(10.0, 0.0)]
    [(0.0, 0.5), (0.3142, 0.5)]
    """
    damped = math.sqrt(1.0 - ratio**2)
    decay = math.exp(-ratio * math.pi / damped)
    half = math.pi / (frequency * damped)
    return (0.0, 1.0 / (1.0 + decay)), (half, decay / (1.0 + decay))
