"""Margins of a loop with several inputs and outputs: det(I + L) and the smallest
singular value of I + L.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from fraclink._systems.fractional import FractionalTransferFunction
from fraclink._systems.loops import CallableLoop, FractionalLoop, SampledLoop, as_loop
from fraclink._systems.margins import unstable_closed_loop_poles
from fraclink._systems.stability import is_stable
from fraclink._systems.sweep import POINT_LIMIT, TURN, sweep, valleys
from fraclink._systems.terms import Complexes, Reals
from fraclink._systems.transfer_matrix import TransferMatrix
from fraclink._validate import Between, checked
from fraclink.errors import FieldError

# |det(I + L)| of a closed-loop pole on the imaginary axis, as `margins` has it
_ON_AXIS = 1e-12
# σ_min(I + L) beside a pole of L on the axis that det(I + L) does not show, 1e-9 in ln
# ω away from it.
_HIDDEN = 1e-7
_INDENT = 1e-6  # radius in ln s of the half circles around poles of L on the axis
# of σ over a factor e of frequency below every corner: no limit is approached, it falls
# to 0
_FALLS = 0.05
# A minimum of σ between two points of the sweep is sought where the points themselves
# come within this factor of the smallest: det(I + L), and with it σ, moves by a factor
# of 2 at most from one to the next.
_SPARE = 3.0


@dataclass(frozen=True)
class MultivariableMargins:
    """How far a loop with several channels is from instability; printed, it is four
    lines.

    Attributes
    ----------
    singular_value_margin
        inf_ω σ_min(I + L(jω)) [1]: no additive perturbation of L that is smaller,
        whatever its structure, destabilises the loop. In one channel it is the modulus
        margin.
    frequency
        Where it is reached [rad/s]; 0 or inf where it is only approached.
    determinant_margin
        inf_ω |det(I + L(jω))| [1], the distance of the generalised Nyquist curve from
        the origin.
    determinant_frequency
        Where that is reached [rad/s].
    closed_loop_poles
        Poles of the closed loop with Re s > 0, from the encirclements of the origin by
        det(I + L); None where they could not be counted.
    stable
        Whether the closed loop is stable; None where that was not decided.
    """

    singular_value_margin: float
    frequency: float
    determinant_margin: float
    determinant_frequency: float
    closed_loop_poles: int | None
    stable: bool | None

    @property
    def gain_margin(self) -> tuple[float, float]:
        """Gains between which every channel may change, all at once and each by itself
        [1].
        """
        a = self.singular_value_margin
        return 1.0 / (1.0 + a), 1.0 / (1.0 - a) if a < 1.0 else math.inf

    @property
    def phase_margin(self) -> float:
        """Phase by which every channel may change, all at once and each by itself
        [rad].
        """
        return 2.0 * math.asin(min(0.5 * self.singular_value_margin, 1.0))

    def __str__(self) -> str:
        low, high = self.gain_margin
        known = {
            True: "stable",
            False: "not stable",
            None: "not decided: give unstable_poles",
        }
        return (
            f"smallest σ(I + L)   {self.singular_value_margin:10.6g} at {self.frequency:.6g} rad/s\n"
            f"smallest |det|      {self.determinant_margin:10.6g} at {self.determinant_frequency:.6g} rad/s\n"
            f"tolerated           gain {low:.4g} … {high:.4g}, phase ±{math.degrees(self.phase_margin):.3f}°"
            f" in all channels at once\n"
            f"closed loop         {known[self.stable]}"
        )


@checked
def multivariable_margins(
    loop: TransferMatrix | Callable[[Complexes], Complexes],
    *,
    limit: Annotated[float, Between(0.0, unit="rad/s", low_open=True)] | None = None,
    unstable_poles: Annotated[int, Between(0, 1000)] | None = None,
) -> MultivariableMargins:
    """Return the margins of a square loop matrix L under unity negative feedback.

    The closed loop has Z = P + N poles in Re s > 0, where P is the number of those of L
    and N the clockwise encirclements of the origin by det(I + L(jω)). The margin is the
    smallest singular value of the return difference, inf_ω σ_min(I + L(jω)). det(I + L)
    is followed as `margins` follows a scalar loop, with no grid to choose; poles of L
    on the imaginary axis are passed on their right.

    Parameters
    ----------
    loop
        L: a square TransferMatrix, or a callable that takes s = jω (complex, shape
        (k,)) and returns shape (k, n, n), looked at from 1e-6 to 1e6 rad/s.
    limit
        Highest frequency [rad/s], > 0.
    unstable_poles
        P, the poles of L with Re s > 0 (of a minimal realisation, conjugates counted).
        Not needed for a TransferMatrix without such poles.

    Raises
    ------
    FieldError
        L is not square, `limit` ≤ 0, a callable of another shape, a response that turns
        more often than can be followed.

    References
    ----------
    MacFarlane and Postlethwaite, Int. J. Control 25 (1977) 81, for the encirclements of
    det(I + L). Lehtomaki, Sandell and Athans, IEEE Trans. Autom. Control 26 (1981) 75,
    for the gains 1/(1 ± σ) and phases 2 asin(σ/2) that the smallest singular value
    tolerates in all channels at once.

    Examples
    --------
    >>> from fraclink._systems.fractional import s
    >>> L = TransferMatrix([[2 / s, 1 / (s + 1)], [-1 / (s + 1), 4 / s**1.2]])
    >>> found = multivariable_margins(L)
    >>> found.stable, round(found.singular_value_margin, 4)
    (True, 0.8661)
    """
    if unstable_poles is None and isinstance(loop, TransferMatrix):
        unstable_poles = _none_unstable(loop)
    # Poles and zeros on the axis are infinities here and not faults.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        known = _determinant_loop(loop, limit)
        x, values, _ = sweep(known)
        sigma, frequency = _infimum(lambda at: _sigma(_matrices(loop, at)), x)
        distance, nearest = _infimum(lambda at: _modulus(_matrices(loop, at)), x)
        if isinstance(loop, TransferMatrix):
            for ahead, place in _approached(loop, limit):
                sigma, frequency = min(
                    (sigma, frequency), (float(_sigma(ahead)[0]), place)
                )
                distance, nearest = min(
                    (distance, nearest), (float(_modulus(ahead)[0]), place)
                )
            if _falls(loop, x):
                sigma, frequency = 0.0, 0.0
        left, on_axis = None, distance < _ON_AXIS or sigma < _HIDDEN
        if unstable_poles is not None and not on_axis:
            if isinstance(loop, TransferMatrix):
                turns = _clockwise(loop, x, whole=limit is None)
                left = None if turns is None else unstable_poles + turns
            else:
                left = unstable_closed_loop_poles(
                    known,
                    x,
                    values,
                    open_loop=unstable_poles,
                    ends_real=limit is not None,
                )
    stable = False if on_axis else None if left is None else left == 0
    return MultivariableMargins(sigma, frequency, distance, nearest, left, stable)


# --- det(I + L) as a scalar loop, and σ_min along it ---------------------------------------------------


def _matrices(loop: Callable[[Complexes], Complexes], x: Reals) -> Complexes:
    """I + L(j e^x), shape (k, n, n)."""
    values = np.asarray(loop(1j * np.exp(x)), dtype=complex)
    if values.ndim != 3 or len(values) != len(x) or values.shape[1] != values.shape[2]:
        allowed = f"shape ({len(x)}, n, n)"
        remedy = "return one square matrix for each s, in the order of s"
        raise FieldError(
            "loop",
            values.shape,
            "not one square matrix for each s",
            allowed=allowed,
            remedy=remedy,
        )
    return np.asarray(np.eye(values.shape[1]) + values)


def _determinant_loop(
    loop: TransferMatrix | Callable[[Complexes], Complexes], limit: float | None
) -> SampledLoop:
    """det(I + L) − 1, whose −1 is the origin of the generalised Nyquist curve."""

    def response(s: Complexes) -> Complexes:
        ahead = _matrices(loop, np.log(s.imag))
        # A pole of an entry that the sweep has hit: infinite for the sweep, which
        # then looks at both sides of it.
        finite = np.isfinite(ahead).all(axis=(1, 2))
        values = np.full(len(s), complex(math.inf))
        # By elimination at each frequency and not from `determinant()`, whose
        # uncancelled factors would be zeros and poles of their own.
        values[finite] = np.linalg.det(ahead[finite]) - 1.0
        return values

    if not isinstance(loop, TransferMatrix):
        return as_loop(response, limit)
    if loop.shape[0] != loop.shape[1]:
        allowed, remedy = (
            "as many outputs as inputs",
            "close the loop over equally many signals",
        )
        raise FieldError(
            "loop", loop.shape, "not square", allowed=allowed, remedy=remedy
        )
    parts = _parts(loop, limit) or [
        FractionalLoop.of(FractionalTransferFunction.power(0.0), limit)
    ]
    ends = [_limit(loop, limit, end) for end in (0, 1)]
    return CallableLoop(
        response,
        low=min(p.low for p in parts),
        high=max(p.high for p in parts),
        seeds=np.concatenate([p.seeds for p in parts]),
        # rounding moves det(I + L) − 1 where it is small: not to be followed there
        delayed=True,
        follow=max((p.follow for p in parts if p.delayed), default=-math.inf),
        ends=(
            complex(np.linalg.det(ends[0])) - 1.0,
            complex(np.linalg.det(ends[1])) - 1.0,
        ),
    )


def _parts(loop: TransferMatrix, limit: float | None) -> list[FractionalLoop]:
    return [
        FractionalLoop.of(g, limit) for row in loop.entries for g in row if g.numerator
    ]


def _limit(loop: TransferMatrix, limit: float | None, end: int) -> Complexes:
    """I + L at ω → 0 (end = 0) or ω → ∞ (end = 1); nan where an entry has no limit."""
    limits = [
        [FractionalLoop.of(g, limit).ends[end] if g.numerator else 0j for g in row]
        for row in loop.entries
    ]
    return np.asarray(np.eye(len(limits)) + np.array(limits))


def _none_unstable(loop: TransferMatrix) -> int | None:
    """0 where no entry has a pole with Re s > 0; None else: entries may share a pole,
    or each have it.
    """
    # The sum over the entries is an upper bound of P, and a wrong P makes a
    # wrong verdict: nothing is claimed.
    for g in (g for row in loop.entries for g in row):
        known = FractionalLoop.of(g, None).unstable_poles if g.numerator else 0
        if (is_stable(g).winding if known is None else known) != 0:
            return None
    return 0


def _finite(ahead: Complexes, of: Callable[[Complexes], NDArray[Any]]) -> Reals:
    """`of` each matrix; infinite at a pole of L, beside which it is looked at."""
    finite = np.isfinite(ahead).all(axis=(1, 2))
    values = np.full(len(ahead), math.inf)
    values[finite] = of(ahead[finite])
    return values


def _sigma(ahead: Complexes) -> Reals:
    return _finite(
        ahead, lambda matrices: np.linalg.svd(matrices, compute_uv=False)[:, -1]
    )


def _modulus(ahead: Complexes) -> Reals:
    return _finite(ahead, lambda matrices: np.abs(np.linalg.det(matrices)))


def _infimum(of: Callable[[Reals], Reals], x: Reals) -> tuple[float, float]:
    """The smallest value of a function of ln ω along the sweep, and where it is
    [rad/s].
    """
    values = of(x)
    best = int(np.argmin(values))
    smallest, at = float(values[best]), float(x[best])
    for i in valleys(values, spare=_SPARE):
        # By values and not by a root of the slope: σ has kinks where two singular
        # values meet.
        found = minimize_scalar(
            lambda place: float(of(np.array([place]))[0]),
            bounds=(float(x[i - 1]), float(x[i + 1])),
            method="bounded",
            options={"xatol": 1e-9},
        )
        if found.fun < smallest:
            smallest, at = float(found.fun), float(found.x)
    return smallest, math.exp(at)


def _approached(
    loop: TransferMatrix, limit: float | None
) -> list[tuple[Complexes, float]]:
    """I + L where it tends to at both ends of the axis, shape (1, n, n), and the
    frequency there [rad/s].
    """
    ends = [
        (_limit(loop, limit, end)[None], place)
        for end, place in ((0, 0.0), (1, math.inf))
    ]
    return [(matrix, place) for matrix, place in ends if np.isfinite(matrix).all()]


def _falls(loop: TransferMatrix, x: Reals) -> bool:
    """Whether σ falls to 0 at ω → 0: a pole of L at the origin that one direction hides
    from det(I + L).
    """
    # One factor e below the range, where every entry is its own asymptote: σ
    # there is constant, or a power of ω.
    below, here = _sigma(_matrices(loop, np.array([x[0] - 1.0, x[0]])))
    return bool(below < here * (1.0 - _FALLS))


def _clockwise(loop: TransferMatrix, x: Reals, *, whole: bool) -> int | None:
    """Turns of det(I + L) around the origin while s goes once around the right half
    plane.

    Half the contour suffices: from the positive real axis along |s| = e^x₀ to the
    imaginary axis, up that, passing the poles of L on their right, and back along the
    last circle. None where it cannot be followed: a delayed direct path, or a `limit`
    beyond which the rest may turn.
    """
    # A delayed direct path turns det(I + L) for ever: there is no last circle along
    # which it rests.
    direct = [
        g
        for row in loop.entries
        for g in row
        if g.numerator and g.relative_degree <= 0.0
    ]
    if not whole or any(
        t.delay for g in direct for t in (*g.numerator, *g.denominator)
    ):
        return None
    # A start in steps of 3°; what turns by more than `TURN` between two of them is
    # halved below.
    quarter = 1j * np.linspace(0.0, 0.5 * math.pi, 33)
    z = np.concatenate([x[0] + quarter, _indented(loop, x), x[-1] + quarter[::-1]])
    values = _determinants(loop, z)
    while (
        wide := np.flatnonzero(np.abs(np.angle(values[1:] / values[:-1])) > TURN)
    ).size:
        if z.size + wide.size > POINT_LIMIT:
            return None
        middle = 0.5 * (z[wide] + z[wide + 1])
        z, values = (
            np.insert(z, wide + 1, middle),
            np.insert(values, wide + 1, _determinants(loop, middle)),
        )
    turns = -float(np.angle(values[1:] / values[:-1]).sum()) / math.pi
    return (
        round(turns)
        if math.isfinite(turns) and abs(turns - round(turns)) < 0.2
        else None
    )


def _determinants(loop: TransferMatrix, z: Complexes) -> Complexes:
    on_axis = z.imag == 0.5 * math.pi
    s = np.where(
        on_axis, 1j * np.exp(z.real), np.exp(z)
    )  # (jω)² is −ω², without an imaginary part
    return np.asarray(np.linalg.det(np.eye(loop.shape[0]) + loop(s)))


def _indented(loop: TransferMatrix, x: Reals) -> Complexes:
    """ln s up the imaginary axis, with half circles to the right around the poles of L
    that lie on it.
    """
    zeros = [z for part in _parts(loop, None) for z in part.zeros]
    poles = sorted(z.real for z in zeros if abs(z.imag - 0.5 * math.pi) < _INDENT)
    path = np.asarray(x + 0.5j * math.pi)
    while poles:
        first = last = poles.pop(0)
        # Joints of one frequency share it but for rounding: two half circles would
        # cross each other.
        while poles and poles[0] < last + 4.0 * _INDENT:
            last = poles.pop(0)
        radius = 0.5 * (last - first) + _INDENT
        half = (
            0.5 * (first + last)
            + 0.5j * math.pi
            + radius * np.exp(1j * np.linspace(-math.pi, 0.0, 33))
        )
        # Its ends exactly on the axis, where `_determinants` forms s without a real
        # part.
        half[[0, -1]] = half[[0, -1]].real + 0.5j * math.pi
        before = path[path.real < half[0].real]
        path = np.concatenate([before, half, path[path.real > half[-1].real]])
    return path
