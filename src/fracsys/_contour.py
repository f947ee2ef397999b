"""Step responses at single times: the trapezoidal rule on a parabola, with an exact
correction for poles.

    f(t) = 1/(2πi) ∫ G(s)/s e^(st) ds,   s = μ (1 + iu)²,   u = kh

17 nodes give 1e-14 for singularities on the negative axis and at 0 (more nodes for
strong ones there). Any other pole p enters with its residue times 1/(1 - exp(-2πi
u_p/h)), where u_p is its place in the u-plane: 1 outside the parabola, 0 deep inside,
and exact in between. Each time has its own parabola, so the result is accurate relative
to f(t) itself. This is slow; it serves as the reference for the modes.

Source: Weideman and Trefethen, Math. Comp. 76 (2007) 1341, parabola with h = 3/N, μ =
πN/(12 t).
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from fracsys._fractional import FractionalTransferFunction
from fracsys._precision import COINCIDENT, FOLDS
from fracsys._quotient import Cluster, Quotient, singular_order
from fracsys._terms import TOGETHER
from fracsys.checks import Complex, Real
from fracsys.errors import FieldError

_BESIDE_ZERO = 0.02  # |p| t
_AROUND = np.array([[0.3], [1.0], [3.0]])  # |s| t
# Offsets of the nodes, in steps: a node at u = 0, or one on either side of it. Only
# these grids are symmetric, so that conjugate poles have conjugate weights.
GRIDS = np.array([0.0, 0.5])
_MORE = (3, 4, 5, 6, 7)  # additional nodes of the rules that a value is compared with


def step_values(quotient: Quotient, times: Real, *, more: int = 0) -> Real:
    """Return the step response at times > 0 [s], with `more` additional nodes.

    The values are accurate relative to themselves, even if the response begins like
    t^6. As long as |p| t is small for every pole, all poles lie close to 0 relative to
    the parabola, on which G equals its high-frequency power of s: more nodes are needed
    than for its order at 0.
    """
    values = np.empty(len(times))
    counts = _needed(quotient, times) if len(times) else np.empty(0, np.intp)
    size = TOGETHER if quotient.is_sparse else 1
    for nodes in sorted(set(counts.tolist())):
        place = np.flatnonzero(counts == nodes)
        for k in range(0, len(place), size):
            part = place[k : k + size]
            values[part] = _on_parabola(quotient, times[part], nodes + more)
    return values


def step_error(quotient: Quotient, times: Real, values: Real) -> float:
    """Return an estimate of the largest error of `step_values`.

    Another number of nodes means another parabola, with other truncation and rounding
    errors, which grow with the nodes: the differences from five other rules exceed the
    error. The poles are shifted by their uncertainty. The error changes slowly with
    time, so a selection of the times is enough.
    """
    sample = np.argsort(times)
    even = np.linspace(0, len(times) - 1, min(len(times), 15)).astype(int)
    early = np.geomspace(1, len(times), min(len(times), 10)).astype(int) - 1
    sample = sample[np.union1d(even, early)]
    variant = quotient.misplaced
    others = [step_values(variant, times[sample], more=more) for more in _MORE]
    return 2.0 * float(np.abs(np.array(others) - values[sample]).max())


def _needed(quotient: Quotient, times: Real) -> NDArray[np.intp]:
    """Nodes for each time, from the power of s that G/s resembles at frequencies near
    1/t.
    """
    # The error of the parabola comes from |s| t ≈ 0.7: take the slope of G there and on
    # either side.
    z = np.log(_AROUND / times).astype(np.complex128)
    # A real zero of N or D at one of these points (1/(s − 1) at t = 1 s) makes the
    # slope infinite or NaN.
    with np.errstate(divide="ignore", invalid="ignore"):
        order = (1.0 - quotient.slope(z)).max(axis=0)
    at_zero = singular_order(quotient.top, quotient.bottom) + 1.0
    # no slope exceeds this except at a zero of G
    steepest = quotient.bottom[0].order + 1.0
    order = np.fmin(np.fmax(order, at_zero), steepest)
    nodes = np.array([_nodes(0.25 * step) for step in np.ceil(4.0 * order).tolist()])
    # Five surplus nodes raise the rounding error by e^(5π/12) = 4 but save a separate
    # evaluation.
    return np.full_like(nodes, nodes.max()) if np.ptp(nodes) <= 5 else nodes


def _on_parabola(quotient: Quotient, times: Real, nodes: int) -> Real:
    # Zeros that e^(st) cannot separate at the first time (|δs| t < 0.3) have residues
    # that cancel; one circle around all of them gives their sum.
    simple, clusters = quotient.grouped(
        lambda z: 0.3 * math.exp(-z.real) / float(times[0])
    )
    simple = [z for z in simple if z.imag < math.pi - COINCIDENT]
    clusters = [c for c in clusters if c.centre.imag < math.pi - COINCIDENT]
    step, scale = 3.0 / nodes, np.log(math.pi * nodes / (12.0 * times))
    poles = np.array([*simple, *(c.centre for c in clusters)], np.complex128)
    offset = best_offset(place(poles[:, None], scale) / step)
    u = (np.arange(nodes + 2)[:, None] + offset) * step
    root = 1.0 + 1j * u
    z = 2.0 * np.log(root) + scale
    values = quotient.value(z) * np.exp(np.exp(z) * times) / root
    # The node u = 0 is its own conjugate.
    values[0] *= np.where(offset == 0.0, 0.5, 1.0)
    total: Real = 2.0 * step / math.pi * values.real.sum(axis=0)
    for pole in simple:
        weight = pole_weight(place(np.asarray(pole), scale), offset, step)
        weight = weight * np.exp(np.exp(pole) * times)
        # A pole close to the singular point 0 looks like a part of it from the
        # parabola. Its residue may be huge where the cut cancels it, and 1e-14 of that
        # residue is no correction.
        weight[math.exp(pole.real) * times < _BESIDE_ZERO] = 0.0
        share = 1.0 if pole.imag == 0.0 else 2.0
        total += (share * quotient.residue(pole) * weight).real
    for cluster in clusters:
        if math.exp(cluster.centre.real) * times[0] >= _BESIDE_ZERO:
            share = 1.0 if cluster.centre.imag == 0.0 else 2.0
            for k in range(len(times)):
                total[k] += share * _cluster(
                    quotient, cluster, scale[k], offset[k], step, times[k]
                )
    return total


@cache
def _nodes(order: float) -> int:
    """Nodes N for a transform that behaves as s^-order at 0, which is the point u = i.

    With a = `order` the error e^(-2πN/3) then carries the factor (2πN/3)^(2a-1)/Γ(2a).
    More nodes than needed raise the rounding error, e^(πN/12).
    """
    # 2.1 stands for 2π/3, and e^-32 = 1e-14. With e^-20 the contours would be too
    # coarse for test_a_contour_per_lag_where_modes_would_cancel.
    nodes, exponent = 16, max(2.0 * order - 1.0, 0.0)
    while (
        exponent * math.log(math.tau * nodes / 3.0) - math.lgamma(exponent + 1.0)
        > 2.1 * nodes - 32.0
    ):
        nodes += 1
    return nodes


def place(z: Complex, scale: Real | float) -> Complex:
    """The position of the point e^z in the u-plane of the parabola of scale μ =
    e^scale.
    """
    return np.asarray((np.exp(0.5 * (z - scale)) - 1.0) / 1j)


def pole_weight(u: Complex, offset: Real | float, step: float) -> Complex:
    """The weight with which the residue of a pole at u enters, for nodes (k + offset)
    step.
    """
    return np.asarray(1.0 / (1.0 - np.exp(-2j * np.pi * (u / step - offset))))


def best_offset(places: Complex) -> Real:
    """The offset of `GRIDS`, for each column of `places` (in steps), that keeps the
    nodes farthest from all poles; NaN stands for no pole.
    """
    gaps = places - GRIDS[:, None, None]
    gaps = np.abs(gaps - np.round(gaps.real))
    nearest = np.where(np.isnan(gaps), np.inf, gaps).min(axis=1, initial=np.inf)
    return GRIDS[np.argmax(nearest, axis=0)]


def _cluster(
    quotient: Quotient,
    cluster: Cluster,
    scale: float,
    offset: float,
    step: float,
    time: float,
) -> float:
    # Only the node nearest to the cluster counts; farther out than forty nodes e^(st)
    # is lost in rounding.
    nodes = 2.0 * np.log(1.0 + 1j * (np.arange(-40, 41) + offset) * step) + scale
    gap = float(
        min(np.abs(nodes - cluster.centre).min(), math.pi - cluster.centre.imag)
    )
    radius = math.exp(-cluster.centre.real) / time  # where e^(st) varies by a factor e
    points, weights = quotient.circle(
        cluster, radius, gap, lambda z: pole_weight(place(z, scale), offset, step)
    )
    return float((weights * np.exp(np.exp(points) * time)).sum().real)


def convolve(weights: Real, u: Real) -> Real:
    """First len(u) samples of the convolution, by FFT."""
    # Twice the length, so that the circular convolution of the FFT wraps around into
    # zeros only.
    size = 1 << max(2 * len(u) - 1, 1).bit_length()
    spectrum = np.fft.rfft(weights, size) * np.fft.rfft(u, size)
    result: Real = np.fft.irfft(spectrum, size)[: len(u)]
    return result


# --- Numerical inversion by FFT -----------------------------------------------------------------------
#
#     f(t) = e^(σt)/W · [F(σ) + 2 Re Σ_k F(σ + jkω₀) e^(jkω₀t)],   ω₀ = 2π/W,
#
# for functions without a sum of modes (delays in the denominator, poles not certified),
# by one FFT on a window W of four spans, so that e^(-σW) suppresses what wraps around.
# The delay-free part of G has an exact response and is subtracted first: what is left
# falls about twice as fast at high frequency, so that the truncated series converges.
# Its error is estimated by another inversion, with another σ and half the frequencies.
#
# Source: Dubner and Abate, J. ACM 15 (1968) 115, with the aliasing controlled as by
# Crump (1976).

WINDOW = 4  # spans in it: with two, e^(σt) would raise rounding by e^(36/2)
# Points of the inversion per sample; the one that it is compared with has half as many.
OVERSAMPLING = 8


def delay_free_part(G: FractionalTransferFunction) -> FractionalTransferFunction:
    """G without the delayed terms of its denominator, which responds like G until the
    first of them acts.
    """
    highest = G.denominator[0].order
    late = [
        term.delay for term in G.denominator if term.order == highest and term.delay
    ]
    if late:
        # The response of such a loop jumps again after every delay; at a jump the
        # truncated series is off by half its height.
        raise FieldError(
            "delay",
            max(late),
            "on the highest power of the denominator: the response jumps anew after each delay",
            "a highest power without delay",
            "add roll-off: a strictly proper loop has no jumps",
        )
    denominator = tuple(term for term in G.denominator if term.delay == 0.0)
    return FractionalTransferFunction(G.numerator, denominator)


def feedthrough(G: FractionalTransferFunction) -> FractionalTransferFunction:
    """The direct part of G, which jumps with the input and does not fall at high
    frequency.
    """
    order = G.denominator[0].order
    leading = tuple(t for t in G.numerator if t.order == order)
    return FractionalTransferFunction(leading, G.denominator[:1])


def invert(
    G: FractionalTransferFunction,
    exact: FractionalTransferFunction,
    count: int,
    period: float,
    degree: int,
) -> tuple[Real, float]:
    """Response of G - `exact` to a step (degree 1) or ramp (2) at k·period, k < count,
    and its error.
    """
    best, smallest = np.zeros(count), math.inf
    # What wraps around is lost in rounding, which e^(σt) raises by e^(36/4).
    sigma = FOLDS / (WINDOW * count * period)
    while True:
        # The wrap-around error depends on σ, the truncation error on the highest
        # frequency. The second inversion changes both, so neither error can be the same
        # in it.
        fine = _series(G, exact, count, period, degree, sigma, OVERSAMPLING)
        coarse = _series(
            G, exact, count, period, degree, 1.3 * sigma, OVERSAMPLING // 2
        )
        error = float(np.max(np.abs(fine - coarse), initial=0.0))
        if not error < smallest:
            return best, smallest
        best, smallest = fine, error
        if error <= 1e-7 * float(np.max(np.abs(fine), initial=0.0)):
            return best, smallest
        sigma *= 2.0  # for a response that grows


def _series(
    G: FractionalTransferFunction,
    exact: FractionalTransferFunction,
    count: int,
    period: float,
    degree: int,
    sigma: float,
    oversampling: int,
) -> Real:
    size = 1 << (WINDOW * count * oversampling - 1).bit_length()
    step = period / oversampling
    s = sigma + 2j * math.pi / (size * step) * np.arange(size // 2 + 1)
    spectrum = (G(s) - exact(s)) / s**degree
    values = np.fft.irfft(spectrum, size) / step
    times = np.arange(count) * period
    result: Real = values[: count * oversampling : oversampling] * np.exp(sigma * times)
    return result
