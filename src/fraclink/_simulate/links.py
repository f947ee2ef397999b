"""The lumped links of a model, one or many: the response of their tips to the motor
angle between two samples.

Between two samples the motor's angle is Σ qⱼ xʲ with x = (t − kT)/T. The response of
the link to each power is exact: at the end of its own period by the power series of G =
θt/θm, later by the modes of the step response, a sum of exponentials.

In the link's own time x = Ω t, Ω = ω₀^(2/λ), and with M = μ Ω^(α−λ) the step response of
``G = (M z^α + 1)/(z^λ + M z^α + 1)`` is, with its pole p,

``S = 1 − 2 Re p^λ/(λ p^λ + α M p^α) e^(x p) + (1/π) ∫ Im G(e^(v + iπ)) e^(−x e^v) dv``,

and the trapezoidal rule errs by the residues of the integrand's own poles, which are
those of G on both sides of the cut: each is a further exponential, whose weight passes
from one to zero as the pole crosses the cut. One sum holds for damping of any size.

One grid in v = ln(r/Ω) serves every payload (homothety of Lemma 1), and only
exponentials remain to be computed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from fraclink._arm.link import LinkModel, SecondMode
from fraclink.errors import FieldError
from fracsys.checks import Complex, Real

__all__ = ["LinkWeights", "batch_links", "link_weights", "second_mode_weights"]


# Degree 5: angle, speed and acceleration of the motor at both ends of a period are six
# conditions.
POWERS = 6
# |pole|·T [rad]: beyond it, at three samples per vibration, the terms of the power
# series cancel, and no loop passes.
LONGEST = 2.0
# Truncation of the step response, as e^(−x): three digits below the accuracy promised
# for a move; for a campaign, whose metrics are accurate to 1e-4, three digits below
# that.
ALONE, MANY = 21.0, 15.0
# Relative distance of M from 2, below which the poles p of a link with α = λ/2 coincide
# in double precision: there the roots are known to 1e-13, and their residues to 1e-7.
DOUBLE = 1e-6


@dataclass(frozen=True)
class LinkWeights:
    """Decays and weights of the recursions of R links; see loop.h for the formula.

    decay (R, n), weight (R, 6, n), pair (R, m), pair_weight (R, 6, m), first (R, 6),
    and second (R, 15), or (0, 15) where no link has a second mode.
    """

    decay: Real
    weight: Real
    pair: Complex
    pair_weight: Complex
    first: Real
    second: Real

    def rows(self, rows: slice | NDArray[np.intp]) -> LinkWeights:
        """Return the recursions of the links at the given indices."""
        # Every array has one row per link: a field added later must not be forgotten
        # here.
        own = {field.name: getattr(self, field.name) for field in fields(self)}
        # An empty array: no link has a second mode, so there are no rows to select.
        return LinkWeights(
            **{
                name: value[rows] if len(value) else value
                for name, value in own.items()
            }
        )


def link_weights(model: LinkModel, period: float, span: float) -> LinkWeights:
    """Return the recursion of one link's tip at `period` [s], valid for `span` [s].

    >>> weights = link_weights(LinkModel(1.56, 11.094, order=2.0), 0.004, 10.0)
    >>> weights.decay.shape, weights.pair.shape
    ((1, 0), (1, 1))
    """
    own = (model.natural_frequency**2, model.order, model.damping)
    stiff, order, damping = (np.array([value]) for value in own)
    return batch_links(model, stiff, order, damping, period, span, ALONE)


def second_mode_weights(mode: SecondMode | None, period: float) -> Real:
    """Return the kernel's row of a second mode, shape (1, 15); (0, 15) if there is
    none.

    Its step response is Re(g₀ e^(pt)) with g₀ = gain (1 + jζ/√(1 − ζ²)): a state z' = p
    z + g₀ p θm, which adds the angle gain θm + Re z to the deflection; exact at the
    samples, even above the Nyquist frequency.
    """
    if mode is None:
        return np.zeros((0, 15))
    # The step response of gain s²/(s² + 2ζωs + ω²): it starts at the gain with the
    # slope −2ζω, relative to the gain.
    damped = math.sqrt(1.0 - mode.damping_ratio**2)
    z = mode.frequency * period * complex(-mode.damping_ratio, damped)
    step = mode.gain * complex(1.0, mode.damping_ratio / damped) * np.expm1(z)
    weights = _answers(step, np.array([z]))[:, 0]
    decay = np.exp(z)
    return np.concatenate(
        [[mode.gain, decay.real, decay.imag], weights.real, weights.imag]
    )[None]


def _answers(step: NDArray[Any], log_decay: NDArray[Any]) -> NDArray[Any]:
    """Responses to the powers x^j at the end of one period, for modes e^(zt/T), z =
    `log_decay`, whose response to a unit step is `step`: an axis of length 6 before the
    last.

    The response of a mode to x^j is proportional to φ_j(z) = ∫₀¹ x^j e^(z(1 − x)) dx.
    Where |z| is large φ_j = (j φ_(j-1) − 1)/z; digits cancel for small |z|, where the
    series j! Σ zⁿ/(n + j + 1)! is used.
    """
    # Five steps of the recursion multiply its rounding by 5!/|z|⁵, to 1e-14 at |z| = 1;
    # below, the series ends with 1/20! = 4e-19.
    near = np.abs(log_decay) < 1.0
    small, large = np.where(near, log_decay, 0.0), np.where(near, 1.0, log_decay)
    rows = []
    by_recursion = np.expm1(large) / large
    for j in range(POWERS):
        by_series = np.zeros_like(small)
        for n in range(19, -1, -1):
            by_series = (
                math.factorial(j) / math.factorial(n + j + 1) + small * by_series
            )
        if j:
            by_recursion = (j * by_recursion - 1.0) / large
        rows.append(np.where(near, by_series, by_recursion))
    return np.stack([step * (row / rows[0]) for row in rows], axis=-2)


def _log_poles(order: Real, alpha: float, ratio: Real) -> Complex:
    """Return ln of each link's vibration pole over Ω = ω₀^(2/λ), and of the pole that
    meets it at critical damping, shape (2, R); imaginary parts are arguments.

    Both are roots of w ↦ e^(λw) + M e^(αw) + 1, the second one beyond the cut arg = π
    until the link is overdamped. Newton's method follows them from M = 0.
    """
    log_poles = 1j * np.pi * np.array([[1.0], [3.0]]) / order
    if not np.any(ratio):
        return log_poles
    # The poles meet at an M of argument π(1 − 2α/λ) and size above one: they are
    # followed along complex M on the other side of that argument, then to the real M.
    side = np.where(2.0 * alpha >= order, 1j, -1j) * np.minimum(ratio, 1.0)
    steps = math.ceil(6.0 * math.log1p(ratio.max()))
    growing = [(k / steps, 1.0) for k in range(1, steps + 1)]
    # Where the poles nearly meet, each iteration only halves the error.
    turning = [(1.0, turn) for turn in (0.8, 0.6, 0.4, 0.2, 0.0, 0.0, 0.0)]
    for share, turn in growing + turning:
        size = np.expm1(share * np.log1p(ratio)) * np.exp(turn * side)
        for _ in range(5):
            moving = np.exp(order * log_poles)
            friction = size * np.exp(alpha * log_poles)
            log_poles = log_poles - (moving + friction + 1.0) / (
                order * moving + alpha * friction
            )
    return log_poles


def batch_links(
    model: LinkModel,
    stiff: Real,
    order: Real,
    damping: Real,
    period: float,
    span: float,
    digits: float = MANY,
) -> LinkWeights:
    """Return the recursions of links ``G = (μ s^α + ω₀²)/(s^λ + μ s^α + ω₀²)`` at
    `period` [s] for a motor angle of degree 5.

    Parameters
    ----------
    model
        gives the damping's order α and the second mode of all the links: a log shows
        that mode at one payload only, and not how it changes with the payload.
    stiff
        ω₀² of each run [s^−λ], shape (R,), > 0.
    order
        λ of each run, shape (R,), 1 < λ ≤ 2.
    damping
        μ of each run [s^(α−λ)], shape (R,), >= 0.
    period
        control period [s]; |pole|·period < 2, since beyond that no loop passes.
    span
        time for which the recursions are valid [s].
    digits
        x, where the recursions are accurate to e^(−x).

    Raises
    ------
    FieldError
        a link too fast for the period.

    >>> import numpy as np
    >>> model, two = LinkModel(1.56, 11.1, damping=0.4), np.ones(2)
    >>> links = batch_links(model, np.array([123.1, 184.6]), 2 * two, 0.4 * two, 0.004, 4.0)
    >>> links.weight.shape[:2], links.pair_weight.shape
    ((2, 6), (2, 6, 1))
    """
    speed, alpha = stiff ** (1.0 / order), model.damping_order
    ratio = damping * speed ** (alpha - order)
    ratio = np.where(np.abs(ratio - 2.0) < DOUBLE, 2.0 + DOUBLE, ratio)
    log_poles = _log_poles(order, alpha, ratio)
    fastest = float(np.max(speed * np.exp(log_poles.real)))
    reach = speed * period
    # An arm that cannot be simulated is an error of the draw, and reported as such;
    # leaving it out would falsify the campaign's share of failures.
    if fastest * period >= LONGEST:
        raise FieldError(
            "period",
            period,
            "too long for this link",
            f"< {LONGEST / fastest:.3g} s: {math.tau / LONGEST:.2g} samples a vibration",
            "simulate at a shorter period, or a heavier payload",
        )
    # One grid for all: the smallest exponent needs the widest one at both ends.
    damped = bool(np.any(damping))
    slowest = min(float(order.min()), alpha) if damped else float(order.min())
    # The integrand decays within π/2 of the cut, and its poles there are part of the sum;
    # the error of the trapezoidal rule is e^(−2π distance/step).
    width = np.pi**2 / digits
    # Integer exponents have no branch cut, and poles on it only where overdamped.
    whole = (
        bool(np.all(order == 2.0))
        and (not damped or alpha == 1.0)
        and float(log_poles[0].imag.max()) < np.pi - DOUBLE
    )
    log_poles = log_poles[: 1 if whole or not damped else 2]
    inside = log_poles.imag < 1.5 * np.pi
    grid: Real = np.zeros(0)
    if not whole:
        # The density falls like e^(−λ|v|). Very slow modes hardly move within the span;
        # very fast ones have decayed within a period. At either end the stricter of the
        # two limits is sufficient.
        still = (digits + math.log(speed.max() * span)) / (1.0 + slowest)
        over = math.log(digits / float(reach.min()))
        ends = -min(digits / slowest, still), min(digits / slowest, over)
        first, last = (math.floor(end / width) for end in ends)
        grid = width * (np.arange(first, last + 2, dtype=np.float64) + 0.5)
    restoring = 1.0 + ratio[:, None] * np.exp(alpha * (grid + 1j * np.pi))
    density = (
        restoring / (np.exp(order[:, None] * (grid + 1j * np.pi)) + restoring)
    ).imag / np.pi
    log_decay = -reach[:, None] * np.exp(grid)
    pole = np.where(inside, reach * np.exp(log_poles), 0.0).T
    swing: Complex = np.exp(order * log_poles)
    residue = swing / (order * swing + alpha * ratio * np.exp(alpha * log_poles))
    pair = np.where(inside, -2.0 * residue, 0.0)
    if not whole:
        # The trapezoidal rule already contains a share of a pole's exponential, which
        # depends on the distance of the pole from the grid and on its side of the cut:
        # the pair adds the rest.
        turns = (float(grid[0]) - log_poles + 1j * np.pi) / width
        pair = pair * (1.0 / (1.0 - np.exp(2j * np.pi * turns)))
    # The weight of e^(−r t) in S is `width` times the density; over one period the mode
    # responds to a step with −(1 − e^(−rT)) of it.
    weight = _answers(width * density * np.expm1(log_decay), log_decay)
    pair_weight = _answers(pair.T * np.expm1(pole), pole)
    at_end = _powers_at_end(stiff, order, damping, alpha, period)
    first = at_end - weight.sum(axis=2) - pair_weight.sum(axis=2).real
    return LinkWeights(
        decay=np.exp(log_decay),
        weight=np.ascontiguousarray(weight),
        pair=np.exp(pole),
        pair_weight=np.ascontiguousarray(pair_weight),
        first=np.ascontiguousarray(first),
        second=np.repeat(
            second_mode_weights(model.second_mode, period), len(stiff), axis=0
        ),
    )


def _powers_at_end(
    stiff: Real, order: Real, damping: Real, damping_order: float, period: float
) -> Real:
    """Response of G to x^j at x = 1, shape (R, 6): the terms of G = −Σ (−X)ⁿ, X = (μ
    s^α + ω₀²)/s^λ, as t^q/Γ(q + 1).
    """
    power = np.arange(POWERS)[:, None]
    spring = np.log(stiff * period**order)[:, None, None]
    with np.errstate(divide="ignore"):  # without damping its powers are e^−∞ = 0
        damper = np.log(damping * period ** (order - damping_order))[:, None, None]
    total = np.zeros((len(stiff), POWERS))
    # X at the end of the period is below LONGEST^λ ≤ 4, and Γ(λn + 1) grows faster than
    # 4ⁿ: fewer than thirty terms suffice. Logarithms, because the highest Γ overflows.
    for n in range(1, 100):
        k = np.arange(n + 1 if np.any(damping) else 1)
        exponent = order[:, None, None] * n - damping_order * k + power
        ways = gammaln(n + 1.0) - gammaln(k + 1.0) - gammaln(n - k + 1.0)
        dampers = np.where(k > 0, k * damper, 0.0) if k.size > 1 else 0.0
        size = ways + dampers + (n - k) * spring - gammaln(exponent + 1.0)
        part = np.exp(size + gammaln(power + 1.0)).sum(axis=2)
        total -= (-1.0) ** n * part
        if np.all(part < 1e-18 * np.abs(total)):
            break
    return total
