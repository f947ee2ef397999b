"""Step and ramp responses at single times: trapezoid on a parabola, with exact
correction of its poles.

    f(t) = 1/(2πi) ∫ G(s) s^(-n) e^(st) ds,   s = μ (1 + iu)²,   u = kh

17 nodes give 1e-14 for singularities on the negative axis and at 0 (more nodes for
strong ones there). A pole p elsewhere enters with the weight 1/(1 - exp(-2πi u_p/h)) of
its residue, u_p its place in the u-plane: 1 outside the parabola, 0 deep inside, and
exact in between. Every time has a parabola of its own, so that the result is accurate
relative to f(t) itself: slow, and the judge of the modes.

Source: Weideman and Trefethen, Math. Comp. 76 (2007) 1341, parabola with h = 3/N, μ =
πN/(12 t).
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from fracsys._fractional import FractionalTransferFunction
from fracsys._quotient import Cluster, Quotient
from fracsys._terms import Complexes, Reals
from fracsys.errors import FieldError

_BESIDE_ZERO = 0.02  # |p| t
_EPS = float(np.finfo(float).eps)
_TRUNCATION = (
    2e-14  # of the integrand: what is left beyond the last node and between the nodes
)
_AROUND = np.array([[0.3], [1.0], [3.0]])  # |s| t
_CHUNK = 1024  # times together: about 20 nodes each
_GRIDS = np.array([0.0, 0.5])[
    :, None, None
]  # a node at u = 0, or one on either side of it


def careful_response(
    quotient: Quotient, times: Reals, power: int, *, bounded: bool = True
) -> tuple[Reals, float]:
    """Return the inverse Laplace transform of G(s)/s^power at times > 0 [s], and a
    bound of its error.

    `power` is 1 for a step, 2 for a ramp, 0 for an impulse. The values are accurate
    relative to themselves, also where the response begins like t^6. The bound is 0
    unless `bounded`.

    As long as |p| t is small for every pole, the poles lie beside 0 for the parabola
    and G is to it the power of s that it is at high frequency: more nodes are needed
    than for its order at 0. The bound adds what five more nodes change to the rounding
    that is followed through every node and residue.
    """
    if not len(times):
        return np.empty(0), 0.0
    values, needed = np.empty(len(times)), _needed(quotient, times, power)
    bound, size = 0.0, _CHUNK if quotient.is_sparse else 1
    for nodes in sorted(set(needed.tolist())):
        place = np.flatnonzero(needed == nodes)
        for k in range(0, len(place), size):
            part = place[k : k + size]
            values[part] = _on_parabola(quotient, times[part], power, nodes)[0]
        if not bounded:
            continue
        # The bound changes slowly with the time: some forty of many times show its
        # largest value.
        chosen = place[np.argsort(times[place])]
        even = np.linspace(0, len(place) - 1, min(len(place), 25)).astype(int)
        early = np.geomspace(1, len(place), min(len(place), 15)).astype(int) - 1
        for index in chosen[np.union1d(even, early)]:
            at = times[index : index + 1]
            rounding = _on_parabola(quotient, at, power, nodes, noise=True)[1]
            other = _on_parabola(quotient, at, power, nodes + 5)[0]
            bound = max(
                bound,
                float(rounding[0]) + 2.0 * abs(float(other[0]) - float(values[index])),
            )
    return values, bound


def _needed(quotient: Quotient, times: Reals, power: int) -> NDArray[np.intp]:
    """Nodes for each time, from the power of s that G/s^n resembles at frequencies near
    1/t.
    """
    # The parabola's error comes from |s| t of about 0.7; G's slope there, and on either
    # side of it.
    z = np.log(_AROUND / times).astype(np.complex128)
    # A real zero of N or D at one of these points, as of 1/(s − 1) at 1 s, has a slope
    # that is no number.
    with np.errstate(divide="ignore", invalid="ignore"):
        order = (power - quotient.slope(z)).max(axis=0)
    at_zero = quotient.bottom[-1].order - quotient.top[-1].order + float(power)
    steepest = (
        quotient.bottom[0].order + power
    )  # no slope exceeds it but at a zero of G
    order = np.fmin(np.fmax(order, at_zero), steepest)
    nodes = np.array([_nodes(0.25 * step) for step in np.ceil(4.0 * order).tolist()])
    # Five nodes too many raise the rounding error by e^(5π/12) = 4 and save an
    # evaluation of their own.
    return np.full_like(nodes, nodes.max()) if np.ptp(nodes) <= 5 else nodes


def _on_parabola(
    quotient: Quotient, times: Reals, power: int, nodes: int, *, noise: bool = False
) -> tuple[Reals, Reals]:
    """The response, and with `noise` a bound of its error (zeros without)."""
    # Zeros that e^(st) does not tell apart at the first time, |δs| t < 0.3, have
    # residues that cancel: one circle around them all gives their sum.
    found, packed = quotient.grouped(
        lambda z: 0.3 * math.exp(-z.real) / float(times[0])
    )
    simple = np.array([z for z in found if z.imag < math.pi - 1e-9], np.complex128)
    clusters = [c for c in packed if c.centre.imag < math.pi - 1e-9]
    step, scale = 3.0 / nodes, np.log(math.pi * nodes / (12.0 * times))
    poles = (
        np.concatenate((simple, [c.centre for c in clusters])) if clusters else simple
    )
    offset = _offset(poles, scale, step)
    u = (np.arange(nodes + 2)[:, None] + offset) * step
    root = 1.0 + 1j * u
    z = 2.0 * np.log(root) + scale
    exponent = np.exp(z) * times
    if power != 1:
        exponent += z * (1 - power)
    values = quotient.value(z) * np.exp(exponent) / root
    values[0] *= np.where(
        offset == 0.0, 0.5, 1.0
    )  # the node u = 0 is its own conjugate
    total: Reals = 2.0 * step / math.pi * values.real.sum(axis=0)
    error = np.zeros(len(times))
    if noise:
        units = (
            _TRUNCATION / _EPS
            + quotient.condition(z)
            + _exponent_error(z, times, power)
        )
        error += 2.0 * step / math.pi * _EPS * (np.abs(values) * units).sum(axis=0)
    for pole in simple:
        point = np.full(len(times), pole)
        weight = _kernel(point, scale, offset, step) * np.exp(
            (1 - power) * pole + np.exp(pole) * times
        )
        # A pole beside the singular point 0 is seen from the parabola as a part of it,
        # and its residue may be huge where the cut cancels it: 1e-14 of that is not a
        # correction.
        weight[math.exp(pole.real) * times < _BESIDE_ZERO] = 0.0
        part = np.asarray(
            (1.0 if pole.imag == 0.0 else 2.0)
            * quotient.residue(complex(pole))
            * weight
        )
        total += part.real
        if noise:
            place, own = quotient.pole_error(complex(pole))
            # A moved pole is weighted and exponentiated at its moved place.
            turned = np.abs(
                (1.0 - _kernel(point, scale, offset, step)) * _place_slope(point, scale)
            )
            moved = place * (
                np.exp(pole.real) * times
                + abs(1 - power)
                + 2.0 * math.pi / step * turned
            )
            error += (
                _EPS
                * np.abs(part)
                * (own + moved + _exponent_error(point, times, power))
            )
    for cluster in (
        c for c in clusters if math.exp(c.centre.real) * times[0] >= _BESIDE_ZERO
    ):
        share = 1.0 if cluster.centre.imag == 0.0 else 2.0
        for k in range(len(times)):
            value, bound = _cluster(
                quotient, cluster, scale[k], offset[k], step, times[k], power
            )
            total[k] += share * value
            error[k] += share * bound
    return total, error


def _exponent_error(z: Complexes, times: Reals, power: int) -> Reals:
    """Relative error of exp((1 - n) z + e^z t) in units of rounding: the absolute one
    of its exponent.
    """
    return np.asarray(
        4.0 + np.abs((1 - power) * z) + np.exp(z.real) * times * (1.0 + np.abs(z))
    )


@cache
def _nodes(order: float) -> int:
    """Nodes N for a transform that is s^-order at 0, which the parabola passes at Im u
    = 1.

    The error e^(-2πN/3) then carries the factor (2πN/3)^(2a-1)/Γ(2a). More nodes than
    needed raise the rounding error, e^(πN/12).
    """
    # 2.1 for 2π/3, and e^-32 = 1e-14. With e^-20 a contour per lag misses what it
    # promises: test_a_contour_per_lag_where_modes_would_cancel.
    nodes, exponent = 16, max(2.0 * order - 1.0, 0.0)
    while (
        exponent * math.log(2.0 * math.pi * nodes / 3.0) - math.lgamma(exponent + 1.0)
        > 2.1 * nodes - 32.0
    ):
        nodes += 1
    return nodes


def _place(z: Complexes, scale: Reals) -> Complexes:
    """Where the point e^z lies in the u-plane of the parabola of scale μ = e^scale."""
    return np.asarray((np.exp(0.5 * (z - scale)) - 1.0) / 1j)


def _place_slope(z: Complexes, scale: Reals) -> Complexes:
    return np.asarray(0.5 * np.exp(0.5 * (z - scale)))


def _kernel(z: Complexes, scale: Reals, offset: Reals, step: float) -> Complexes:
    exponent = -2j * np.pi * (_place(z, scale) / step - offset)
    return np.asarray(1.0 / (1.0 - np.exp(exponent)))


def _offset(poles: Complexes, scale: Reals, step: float) -> Reals:
    """0 or 1/2 for each time: the grid that is farther from the poles.

    Only these two grids are symmetric, so that conjugate poles have conjugate weights.
    """
    if not poles.size:
        return np.zeros(len(scale))
    places = _place(poles[:, None], scale[None, :]) / step - _GRIDS
    gaps = np.abs(places - np.round(places.real)).min(axis=1)
    return np.where(gaps[0] >= gaps[1], 0.0, 0.5)


def _cluster(
    quotient: Quotient,
    cluster: Cluster,
    scale: float,
    offset: float,
    step: float,
    time: float,
    power: int,
) -> tuple[float, float]:
    # Only the node nearest to the cluster counts, and a parabola has less than forty on
    # either side.
    nodes = 2.0 * np.log(1.0 + 1j * (np.arange(-40, 41) + offset) * step) + scale
    gap = float(
        min(np.abs(nodes - cluster.centre).min(), math.pi - cluster.centre.imag)
    )
    at = np.array([scale]), np.array([offset])
    radius = math.exp(-cluster.centre.real) / time  # where e^(st) varies by a factor e
    points, weights = quotient.circle(
        cluster, radius, gap, lambda z: _kernel(z, *at, step)
    )
    parts = weights * np.exp((1 - power) * points + np.exp(points) * time)
    units = quotient.condition(points) + _exponent_error(
        points, np.array([time]), power
    )
    return float(parts.sum().real), _EPS * float((np.abs(parts) * units).sum())


# --- Held responses by one weight per lag, each from a contour of its own -----------------------------
#
# O(N log N) and a few microseconds per lag: for the functions whose modes cancel (poles
# and singular powers that are much slower than the whole span), where relative accuracy
# needs a contour that grows with time.


def sample_response(
    quotient: Quotient, times: Reals, power: int, start: float
) -> tuple[Reals, float]:
    """Step (power 1), ramp (2) or impulse (0) response at any times, and a bound of its
    error.

    It is `start` at 0 and nothing before.
    """
    values, later, bound = np.where(times == 0.0, start, 0.0), times > 0.0, 0.0
    if later.any():
        values[later], bound = careful_response(quotient, times[later], power)
    return values, bound


def respond_by_weights(
    quotient: Quotient,
    direct: float,
    u: Reals,
    period: float,
    hold: str,
    lag: int,
    ahead: float,
) -> tuple[Reals, float]:
    """Response to u delayed by `lag` periods, seen `ahead` [s] after its samples; a
    bound of its error.
    """
    output, count = np.zeros(len(u)), len(u) - lag
    if count <= 0:
        return output, 0.0
    times = np.arange(count, dtype=np.float64) * period + ahead
    step, noise = sample_response(quotient, times, 1, direct)
    if hold == "zero":
        output[lag:] = convolve(np.diff(step, prepend=0.0), u[:count])
        return output, noise * _raised(u)
    ramp, ramp_noise = sample_response(quotient, times, 2, 0.0)
    slopes = np.diff(u[: count + 1]) / period
    slopes = np.concatenate((slopes, np.zeros(count - len(slopes))))
    output[lag:] = u[0] * step + convolve(np.diff(ramp, prepend=0.0), slopes)
    return output, noise * abs(float(u[0])) + ramp_noise * _raised(slopes)


def _raised(u: Reals) -> float:
    """How much a convolution with differences of a step response raises that response's
    errors.

    What is common to neighbouring lags enters once with the largest input, what is not
    with the root of the sum of squares of the input's changes, here at four standard
    deviations.
    """
    changes = float(np.linalg.norm(np.diff(u, prepend=0.0)))
    return 2.0 * float(np.max(np.abs(u), initial=0.0)) + 4.0 * changes


def convolve(weights: Reals, u: Reals) -> Reals:
    """First len(u) samples of the convolution, by FFT."""
    # Twice the length: the circular convolution of an FFT then wraps around into zeros
    # only.
    size = 1 << max(2 * len(u) - 1, 1).bit_length()
    spectrum = np.fft.rfft(weights, size) * np.fft.rfft(u, size)
    result: Reals = np.fft.irfft(spectrum, size)[: len(u)]
    return result


# --- Numerical inversion by FFT -----------------------------------------------------------------------
#
#     f(t) = e^(σt)/W · [F(σ) + 2 Re Σ_k F(σ + jkω₀) e^(jkω₀t)],   ω₀ = 2π/W,
#
# for functions without a sum of modes (delays in the denominator, poles not certified),
# by one FFT on a window W of four spans, so that e^(-σW) kills what wraps around. The
# delay-free part of G has an exact response and is taken off first: what is left falls
# about twice as fast at high frequency, so that the truncated series converges. Its
# error is estimated by another inversion, another σ and half the frequencies.
#
# Source: Dubner and Abate, J. ACM 15 (1968) 115, with the aliasing controlled as by
# Crump (1976).

_WINDOW = 4
_OVERSAMPLING = 8
# σW: what wraps around is e^-32 = 1e-14 of the response; rounding is raised by e^(32/4)
_DECAY = 32.0
_SHIFTS = (
    0.0,
    4.0,
    8.0,
    16.0,
)  # tried in turn, in units of 1/span, for responses that grow


def delay_free_part(G: FractionalTransferFunction) -> FractionalTransferFunction:
    """G without the delayed terms of its denominator: its response until the first of
    them acts.
    """
    highest = G.denominator[0].order
    late = [
        term.delay for term in G.denominator if term.order == highest and term.delay
    ]
    if late:
        # Its response jumps again after every delay, and a truncated series misses a
        # jump by half of it.
        problem = "on the highest power of the denominator: the response jumps anew after each delay"
        allowed, remedy = (
            "a highest power without delay",
            "add roll-off: a strictly proper loop has no jumps",
        )
        raise FieldError("delay", max(late), problem, allowed=allowed, remedy=remedy)
    kept = tuple(term for term in G.denominator if term.delay == 0.0)
    return FractionalTransferFunction(G.numerator, kept)


def feedthrough(G: FractionalTransferFunction) -> FractionalTransferFunction:
    """The direct part of G, which jumps with the input: what of G does not fall at high
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
) -> tuple[Reals, float]:
    """Response of G - `exact` to a step (degree 1) or ramp (2) at k·period, k < count,
    and its error.
    """
    best, smallest = np.zeros(count), math.inf
    for shift in _SHIFTS:
        sigma = _DECAY / (_WINDOW * count * period) + shift / (count * period)
        # What wraps around depends on σ, what the cut of the series leaves on the
        # highest frequency: the second inversion changes both, so that neither error
        # can be the same in it.
        fine = _series(G, exact, count, period, degree, sigma, _OVERSAMPLING)
        coarse = _series(
            G, exact, count, period, degree, 1.3 * sigma, _OVERSAMPLING // 2
        )
        error = float(np.max(np.abs(fine - coarse), initial=0.0))
        if error < smallest:
            best, smallest = fine, error
        if error <= 1e-7 * float(np.max(np.abs(fine), initial=0.0)):
            break
    return best, smallest


def _series(
    G: FractionalTransferFunction,
    exact: FractionalTransferFunction,
    count: int,
    period: float,
    degree: int,
    sigma: float,
    oversampling: int,
) -> Reals:
    size = 1 << (_WINDOW * count * oversampling - 1).bit_length()
    step = period / oversampling
    s = sigma + 2j * math.pi / (size * step) * np.arange(size // 2 + 1)
    spectrum = (G(s) - exact(s)) / s**degree
    values = np.fft.irfft(spectrum, size) / step
    times = np.arange(count) * period
    result: Reals = values[: count * oversampling : oversampling] * np.exp(
        sigma * times
    )
    return result
