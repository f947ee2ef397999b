"""The rivals: every one with the rule it was tuned by, none by hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

from fraclink.compare.linear import Filter, NominalLoop, law_filter, tune
from fraclink.compare.optimal import hinf_correction, integer_mode, lqg_correction
from fraclink.compare.outer import (
    Algebraic,
    Linear,
    Outer,
    Sliding,
    gpi_correction,
    pd_correction,
    sliding_correction,
)
from fraclink.compare.shaping import shaper_impulses
from fraclink.controller import Controller
from fraclink.law import Law, Modes

if TYPE_CHECKING:
    from fraclink.link import LinkModel
    from fraclink.rig import Rig

__all__ = ["OURS", "Rival", "Setting", "builders", "servo_law"]

# Derivatives are filtered at 100 rad/s, above the motor servo (80) and below Nyquist (785).
FILTER_TIME = 0.01
ESTIMATION = 0.5  # [s] of the move for the algebraic estimator: half of it, one period of the slowest payload
OFFSET = 0.05  # [N·m], the gauge offset of the offset test
BEND = 0.1  # [rad] of bend whose acceleration the sliding mode may ask for: three times what OFFSET fakes
UNBOUNDED = 1e6
OURS = "ours"


@dataclass(frozen=True)
class Setting:
    """What every rival is told: the rig, its lumped model, and our design, whose Ms is the target."""

    rig: Rig
    model: LinkModel
    ours: Law
    controller: Controller
    loop: NominalLoop

    @property
    def target(self) -> float:
        """Ms of our design at the nominal payload, on the lumped model."""
        return self.loop.peak(law_filter(self.ours))


@dataclass(frozen=True)
class Rival:
    """One contender.

    rule: how it was tuned; knob: the value that the rule gave; peak: Ms at the nominal payload on the lumped
    model (1 without feedback of the tip); states and multiplications: of the outer controller per tick, with
    feed-forward; law: what runs in the inner loop, the whole controller where `outer` and `impulses` are
    None.
    """

    name: str
    rule: str
    knob: str
    peak: float
    states: int
    multiplications: int
    law: Law
    correction: Filter | None = None
    outer: Callable[[], Outer] | None = None
    impulses: tuple[tuple[float, ...], tuple[float, ...]] | None = None


Builder = Callable[[], Rival]


def servo_law(law: Law) -> Law:
    """Return the law with guards that never act: what is compared is control, for all rivals alike."""
    # Every threshold but the fade, which is no threshold: the numbers are angles, torques and speeds.
    limits = asdict(law.limits)
    wide = {k: UNBOUNDED for k, v in limits.items() if isinstance(v, float) and k != "fade_step"}
    limits_type = type(law.limits)
    return replace(law, limits=limits_type(**(limits | wide)))


def _bare(law: Law) -> Law:
    return replace(servo_law(law), correction=Modes(0.0), feedforward=Modes(0.0))


def _forward_cost(law: Law) -> tuple[int, int]:
    modes = law.feedforward
    return len(modes.poles), 1 + 2 * len(modes.poles)


def _law_cost(law: Law) -> tuple[int, int]:
    """States and multiplications of law.c's outer part: Ĉ, feed-forward, 1/c."""
    modes = law.correction
    states, products = _forward_cost(law)
    states += 1 + len(modes.poles) + 2 * len(modes.pair_poles)
    return states, products + 2 + 2 * len(modes.poles) + 6 * len(modes.pair_poles)


def _filter_cost(law: Law, correction: Filter) -> tuple[int, int]:
    """A filter of order n as a transfer function: n states, 2n + 1 products; feed-forward and 1/c as ours."""
    states, products = _forward_cost(law)
    return states + correction.order, products + 1 + 2 * correction.order + 1


def _by_law(name: str, rule: str, controller: Controller, setting: Setting) -> Rival:
    law = controller.discretize(setting.rig.period)
    law = servo_law(replace(law, drive=setting.ours.drive))
    c = controller
    knob = f"k_d {c.gain:.4g}, β {c.order:.4g}, δ {c.filter_time:.3g} s, n {c.filter_order}"
    states, products = _law_cost(law)
    return Rival(name, rule, knob, setting.loop.peak(law_filter(law)), states, products, law)


def _tuned(
    name: str,
    rule: str,
    knob: str,
    setting: Setting,
    make: Callable[[float], Filter],
    limits: tuple[float, float],
    outer: Callable[[float], Outer] | None = None,
    extra: tuple[int, int] = (0, 0),
) -> Rival:
    value, correction, reached = tune(setting.loop, make, limits, setting.target)
    states, products = _filter_cost(setting.ours, correction)
    chosen: Callable[[], Outer] = (lambda: outer(value)) if outer else (lambda: Linear(correction))
    return Rival(
        name,
        rule,
        f"{knob} {value:.4g}" + ("" if reached else " (Ms of ours out of reach: the least it can have)"),
        setting.loop.peak(correction),
        states + extra[0],
        products + extra[1],
        _bare(setting.ours),
        correction=correction,
        outer=chosen,
    )


def _feedback_rivals(setting: Setting) -> dict[str, Builder]:
    """Rivals with feedback of the tip estimate, each with one knob that is turned until Ms is ours."""
    period, model, rig = setting.rig.period, setting.model, setting.rig
    frequency, _ = integer_mode(model)
    noise = max(rig.gauge.noise, 1e-4) / model.stiffness
    bound = frequency**2 * BEND
    pole, delay = setting.ours.inner_pole, rig.inner.delay_samples
    same = "same Ms as ours at the nominal payload"

    def tuned(
        name: str,
        rule: str,
        knob: str,
        make: Callable[[float], Filter],
        limits: tuple[float, float],
        outer: Callable[[float], Outer] | None = None,
        extra: tuple[int, int] = (0, 0),
    ) -> tuple[str, Builder]:
        return name, lambda: _tuned(name, rule, knob, setting, make, limits, outer, extra)

    return dict(
        (
            tuned(
                "PD on the tip estimate",
                f"zero at the nominal mode, gain for the {same}",
                "gain",
                lambda g: pd_correction(g, corner=frequency, filter_time=FILTER_TIME, period=period),
                (1e-3, 10.0),
            ),
            tuned(
                "LQG",
                f"integer model, offset state in the Kalman filter, control weight for the {same}",
                "tip weight",
                lambda q: lqg_correction(model, period=period, pole=pole, delay=delay, noise=noise, weight=q),
                (1e-4, 1e4),
            ),
            tuned(
                "H∞ loop shaping",
                f"weight k s/(s + ω/10), γ = 1.1 γ_min, k for the {same}",
                "k",
                lambda k: hinf_correction(model, period=period, pole=pole, delay=delay, gain=k),
                (1e-2, 1e2),
            ),
            tuned(
                "sliding mode",
                f"equal error poles in the boundary layer for the {same}; bound: a bend of {BEND:g} rad",
                "rate [1/s]",
                lambda r: sliding_correction(r, frequency, filter_time=FILTER_TIME, period=period),
                (0.3 * frequency, 20 * frequency),
                outer=lambda r: Sliding(r, frequency, bound, filter_time=FILTER_TIME, period=period),
                extra=(0, 2),
            ),
            tuned(
                "algebraic estimator + GPI",
                f"four equal error poles for the {same}; ω² estimated in the first {ESTIMATION:g} s",
                "rate [1/s]",
                lambda r: gpi_correction(r, frequency, period=period),
                (0.3 * frequency, 20 * frequency),
                outer=lambda r: Algebraic(r, frequency, period=period, until=ESTIMATION),
                extra=(7, 12),
            ),
        )
    )


def _shaping(setting: Setting, name: str, derivative: bool) -> Rival:
    frequency, ratio = integer_mode(setting.model)
    times, sizes = shaper_impulses(frequency, ratio, derivative=derivative)
    return Rival(
        name,
        "impulses from the nominal mode and its damping; motor servo, no feedback of the tip",
        f"half period {times[1]:.4g} s",
        1.0,
        math.ceil(float(times[-1]) / setting.rig.period),
        len(sizes),
        _bare(setting.ours),
        impulses=(tuple(times.tolist()), tuple(sizes.tolist())),
    )


def builders(setting: Setting) -> dict[str, Builder]:
    """Return how every rival is made, ours first; tuning happens when a builder is called."""
    from fraclink.compare.collocated import collocated
    from fraclink.compare.published import CORRECTED, INTEGER, PRINTED, corrected, integer_twin, printed

    request = "the request: gain crossover, phase margin, payloads"
    return {
        OURS: lambda: _by_law(OURS, request, setting.controller, setting),
        "collocated PD": lambda: collocated(setting, _bare(setting.ours)),
        "ZV shaping": lambda: _shaping(setting, "ZV shaping", False),
        "ZVD shaping": lambda: _shaping(setting, "ZVD shaping", True),
        **_feedback_rivals(setting),
        INTEGER: lambda: _by_law(INTEGER, *integer_twin(setting), setting),
        PRINTED: lambda: _by_law(PRINTED, *printed(setting), setting),
        CORRECTED: lambda: _by_law(CORRECTED, *corrected(setting), setting),
    }
