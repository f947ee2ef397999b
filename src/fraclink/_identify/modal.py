"""A modal model with one common λ: its result, its least-squares problem, the points to
start from.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from fraclink._arm.link import LinkModel
from fraclink.errors import FieldError, NotConvergedError
from fraclink.findings import Finding
from fracsys.checks.equality import compared

Reals = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Bits = NDArray[np.bool_]

# delay in radians at the highest frequency: beyond, lines are too far apart to unwrap
# it
LONGEST = 20.0
_ORDERS = (
    1.98,
    1.9,
    1.75,
)  # λ to start from: stiff links lie close to 2, and the fit creeps over ± 0.1
_DELAYS = (0.0, 0.3, 1.0)  # in radians at the highest frequency
_LEVY_ROUNDS = 6
_SPARE = 2  # peaks and dips more than there are modes: noise may stand out like a mode
# a resonance is sought up to e^1.5 beyond the lines, so that a gate can say that it is
# there
_BEYOND = 1.5


@compared
@dataclass(frozen=True, eq=False)
class SpectrumFit:
    """A modal model with one common λ, fitted to a frequency response.

    Parameters
    ----------
    order
        λ.
    resonances, anti_resonances
        p_i, z_i ascending [rad/s].
    gain, delay
        g [unit of H at high frequency] and τ [s].
    derivative
        d.
    standard_errors
        of "order", "delay", "resonance 1", … (robust to unequal noise).
    fit
        100 (1 − ‖w(H − Ĥ)‖/‖wH‖) over the lines that were kept [%].
    outliers
        indices of the lines that were set aside.
    at_bound
        whether λ ended on 1 or 2.
    predicted
        Ĥ at all lines.
    findings
        codes W34x; one of severity "error" means that the modes are not those of the
        response.
    """

    order: float
    resonances: tuple[float, ...]
    anti_resonances: tuple[float, ...]
    gain: float
    delay: float
    derivative: int
    standard_errors: dict[str, float]
    fit: float
    outliers: tuple[int, ...]
    at_bound: bool
    predicted: Complexes = field(repr=False)
    findings: tuple[Finding, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether the response shows these modes: no finding of severity "error"."""
        return not any(finding.severity == "error" for finding in self.findings)

    def response(self, frequency: ArrayLike) -> Complexes:
        """Ĥ(jω) at `frequency` [rad/s]."""
        # The gain was fitted last and is real: a response is the basis times it.
        values = [
            self.order,
            self.delay,
            *np.log(self.resonances),
            *np.log(self.anti_resonances),
        ]
        basis = _basis(
            np.array(values),
            np.asarray(frequency, dtype=np.float64),
            len(self.resonances),
            self.derivative,
        )
        return np.asarray(self.gain * basis, dtype=np.complex128)

    def model(
        self, *, stiffness: float | None = None, payload: float | None = None
    ) -> LinkModel:
        """The link of a fit with one resonance and no anti-resonance; c is `stiffness`
        or |gain|.
        """
        if len(self.resonances) != 1 or self.anti_resonances:
            allowed, remedy = (
                "1 resonance, no anti-resonance",
                "fit one mode to make a LinkModel",
            )
            raise FieldError(
                "resonances",
                len(self.resonances),
                "no single-mode link",
                allowed=allowed,
                remedy=remedy,
            )
        # p^λ = ω₀²: a resonance is in rad/s, the model's ω₀ in s^(−λ/2).
        frequency = self.resonances[0] ** (self.order / 2)
        c = stiffness or abs(self.gain)
        return LinkModel(
            c, frequency, self.order, payload=payload, gauge_delay=self.delay
        )


@dataclass(frozen=True, eq=False)
class ModalProblem:
    """Lines of a response with their weights, and how many modes are to be found in
    them.

    A full vector is (λ, τ, ln p…, ln z…); a free one leaves out what is known of λ and
    τ.
    """

    frequency: Reals
    response: Complexes
    weight: Reals
    resonances: int
    anti_resonances: int
    derivative: int
    order: float | None
    delay: float | None

    @property
    def moving(self) -> Bits:
        """Which entries of a full vector are free."""
        places = self.resonances + self.anti_resonances
        return np.array([self.order is None, self.delay is None, *[True] * places])

    def full(self, free: Reals) -> Reals:
        """All parameters from the free ones."""
        moving = self.moving
        result = np.zeros(moving.size)
        result[:2] = self.order or 0.0, self.delay or 0.0
        result[moving] = free
        return result

    def fitted(self, full: Reals, kept: Bits) -> tuple[float, Complexes]:
        """The best gain for the lines that are kept, and Ĥ at all of them."""
        basis = _basis(full, self.frequency, self.resonances, self.derivative)
        a, b = (self.weight * basis)[kept], (self.weight * self.response)[kept]
        # The gain is real: a complex one would swallow the phase by which a delay and λ
        # are told apart.
        gain = float(np.real(np.vdot(a, b)) / np.real(np.vdot(a, a)))
        return gain, gain * basis

    def errors(self, full: Reals, kept: Bits) -> Reals:
        """Weighted errors of the kept lines, real parts first."""
        error = (self.weight * (self.response - self.fitted(full, kept)[1]))[kept]
        return np.concatenate([error.real, error.imag])

    def solve(self, kept: Bits, start: Reals | None, *, loss: str) -> Reals:
        """The best free vector, from `start` or from points that need no guess."""
        # The loss turns at f_scale: measured by the median line, not by a resonance
        # that is a hundred times higher.
        scale = float(np.median(np.abs((self.weight * self.response)[kept])))
        # After the first fit a start is there: setting lines aside moves the optimum a
        # little, and no new valley is looked for.
        starts = (
            [start]
            if start is not None
            else [x[self.moving] for x in _starting_points(self, kept)]
        )
        low, high = self._limits()
        best, least = None, math.inf
        for point in starts:
            found = least_squares(
                lambda x: self.errors(self.full(x), kept) / scale,
                # least_squares refuses a start on its own bounds.
                np.clip(point, low + 1e-9, high - 1e-9),
                bounds=(low, high),
                loss=loss,
                # of the median line: what errs more than 5 % of it is doubted
                f_scale=0.05,
                x_scale="jac",
                xtol=1e-12,
                ftol=1e-12,
                gtol=1e-12,
                max_nfev=300,
            )
            if found.cost < least:
                best, least = np.asarray(found.x, dtype=np.float64), float(found.cost)
        if best is None:
            remedy = "fit fewer modes or a narrower band"
            raise NotConvergedError(
                "the frequency fit", reached=math.inf, wanted=0.0, remedy=remedy
            )
        return best

    def _limits(self) -> tuple[Reals, Reals]:
        # In logarithms a step is a ratio: 1 % at 1 rad/s and at 100.
        low, high = (
            math.log(self.frequency.min()) - _BEYOND,
            math.log(self.frequency.max()) + _BEYOND,
        )
        longest = LONGEST / self.frequency.max()
        places = self.resonances + self.anti_resonances
        # A delay may come out negative: a table whose phase was measured the other way
        # round is told by a gate.
        ends = np.array(
            [[1.0, -longest, *[low] * places], [2.0, longest, *[high] * places]]
        )
        return ends[0, self.moving], ends[1, self.moving]

    def result(self, free: Reals, kept: Bits) -> SpectrumFit:
        """The fit with its errors."""
        full = self.full(free)
        gain, predicted = self.fitted(full, kept)
        places = np.exp(full[2:])
        whole = (self.weight * self.response)[kept]
        return SpectrumFit(
            order=float(full[0]),
            resonances=tuple(np.sort(places[: self.resonances]).tolist()),
            anti_resonances=tuple(np.sort(places[self.resonances :]).tolist()),
            gain=gain,
            delay=float(full[1]),
            derivative=self.derivative,
            standard_errors=self._standard_errors(free, kept),
            fit=100
            * (
                1
                - float(np.linalg.norm(self.errors(full, kept)) / np.linalg.norm(whole))
            ),
            outliers=tuple(np.flatnonzero(~kept).tolist()),
            at_bound=self.order is None and not 1 + 1e-6 < full[0] < 2 - 1e-6,
            predicted=predicted,
        )

    def _standard_errors(self, free: Reals, kept: Bits) -> dict[str, float]:
        """White's sandwich: lines near a resonance err more than others, and in their
        own way.
        """
        # Central differences of numbers of order one: their error, 1e-12 by the step
        # and 1e-10 by rounding, is none.
        full, step = self.full(free), 1e-6
        units = step * np.eye(full.size)[self.moving]
        ends = [
            (self.errors(full + unit, kept), self.errors(full - unit, kept))
            for unit in units
        ]
        jacobian, error = (
            np.array([(b - a) / (2 * step) for b, a in ends]).T,
            self.errors(full, kept),
        )
        # Two modes that meet make the matrix singular: the pseudo-inverse then gives
        # what is known, the gates the rest.
        inverse = np.linalg.pinv(jacobian.T @ jacobian)
        meat = (jacobian * error[:, None]).T @ (jacobian * error[:, None])
        spread = np.zeros(full.size)
        spread[self.moving] = np.sqrt(np.maximum(np.diag(inverse @ meat @ inverse), 0))
        result = {
            name: float(spread[i])
            for i, name in enumerate(("order", "delay"))
            if self.moving[i]
        }
        places, own = np.exp(full[2:]), spread[2:] * np.exp(full[2:])
        for kind, rows in (
            ("resonance", slice(0, self.resonances)),
            ("anti-resonance", slice(self.resonances, None)),
        ):
            # The fit may cross two modes; resonance 1 is the lowest in every result.
            ascending = np.argsort(places[rows])
            result |= {
                f"{kind} {rank + 1}": float(own[rows][i])
                for rank, i in enumerate(ascending)
            }
        return result


def _basis(
    full: Reals, frequency: Reals, resonances: int, derivative: int
) -> Complexes:
    """Ĥ for g = 1."""
    s = 1j * frequency
    order, delay = full[0], full[1]
    power = s**order
    value = np.exp(-delay * s) * power**derivative
    for log_zero in full[2 + resonances :]:
        value = value * (power + math.exp(order * log_zero))
    for log_pole in full[2 : 2 + resonances]:
        value = value / (power + math.exp(order * log_pole))
    return np.asarray(value, dtype=np.complex128)


# --- starting points ---------------------------------------------------------------------------------------


def _starting_points(problem: ModalProblem, kept: Bits) -> list[Reals]:
    """Full vectors to start from, the best of a small grid in λ and τ first.

    Levy's equations, H D(x) = N(x) in x = s^λ, are linear in the coefficients of D and
    N, and the roots in x are −p^λ and −z^λ where the response is what the model says.
    Where it has more modes than the model, Levy's roots pair up beside a strong one;
    its most prominent peaks and dips do not.
    """
    frequency, response, weight = (
        problem.frequency[kept],
        problem.response[kept],
        problem.weight[kept],
    )
    # The band's geometric mean as unit: powers up to s^(4λ) stay within a few decades
    # of one.
    scale = float(np.exp(np.mean(np.log(frequency))))
    orders = _ORDERS if problem.order is None else (problem.order,)
    delays = (
        [d / frequency.max() for d in _DELAYS]
        if problem.delay is None
        else [problem.delay]
    )
    found = []
    for lam in orders:
        x = np.asarray((1j * frequency / scale) ** lam, dtype=np.complex128)
        for tau in delays:
            # What is known of the model is taken off first: the rest is a plain
            # quotient of polynomials in x.
            moved = response * np.exp(1j * frequency * tau) / x**problem.derivative
            top, bottom, error = _levy(
                x, moved, weight, problem.anti_resonances, problem.resonances
            )
            places = [_places(c, lam, scale) for c in (bottom, top)]
            found.append((error, np.array([lam, tau, *places[0], *places[1]])))
    seen = [
        np.array([lam, delays[0], *spots])
        for lam in orders[:2]
        for spots in _seen(
            frequency, response, problem.resonances, problem.anti_resonances
        )
    ]
    by_eye = [
        (float(np.linalg.norm(problem.errors(full, kept))), full) for full in seen
    ]
    # Two and three: a fit from each takes tens of milliseconds, and where the table has
    # more modes than the model the best start by error is often not the best by place.
    best = (
        sorted(found, key=lambda pair: pair[0])[:2]
        + sorted(by_eye, key=lambda pair: pair[0])[:3]
    )
    return [full for _, full in best]


def _seen(
    frequency: Reals, response: Complexes, peaks: int, dips: int
) -> list[tuple[float, ...]]:
    """ln of prominent peaks and dips of |H|, every choice of them; noise may stand out
    like a mode.
    """
    # A logarithm: a peak of ten over its saddle counts the same at any height.
    level = np.log(np.abs(response) + 1e-300)
    # A median of three: a single line of hum is a peak to a mean, and none to a median.
    smooth = np.array(
        [np.median(level[max(0, k - 1) : k + 2]) for k in range(level.size)]
    )
    ups, downs = _prominent(smooth, peaks + _SPARE), _prominent(-smooth, dips + _SPARE)
    logs = np.log(frequency)
    return [
        tuple(float(logs[k]) for k in (*up, *down))
        for up in combinations(ups, peaks)
        for down in combinations(downs, dips)
    ]


def _prominent(level: Reals, count: int) -> list[int]:
    """The `count` local maxima that stand highest over the saddle to a higher one."""
    rows = []
    for k in range(1, level.size - 1):
        if not level[k - 1] < level[k] >= level[k + 1]:
            continue
        saddles = []
        for side in (level[k::-1], level[k:]):
            # On a side without a higher point the saddle is the lowest one: the end of
            # the table bounds what is known.
            higher = np.flatnonzero(side > level[k])
            saddles.append(float(np.min(side[: higher[0]] if higher.size else side)))
        rows.append((level[k] - max(saddles), k))
    return sorted(k for _, k in sorted(rows, reverse=True)[:count])


def _levy(
    x: Complexes, response: Complexes, weight: Reals, zeros: int, poles: int
) -> tuple[Reals, Reals, float]:
    """Coefficients (highest first) of N and D with D monic, and the weighted error of
    their ratio.
    """
    divisor: Complexes = np.ones(x.size, dtype=np.complex128)
    for _ in range(_LEVY_ROUNDS):
        # Sanathanan and Koerner's weight: without it the error counts times |D|, least
        # at the very resonances.
        row = (weight / np.abs(divisor))[:, None]
        matrix = row * np.column_stack(
            [x**k for k in range(zeros, -1, -1)]
            + [-response * x**k for k in range(poles - 1, -1, -1)]
        )
        right = row[:, 0] * response * x**poles
        solution = np.linalg.lstsq(
            np.concatenate([matrix.real, matrix.imag]),
            np.concatenate([right.real, right.imag]),
            rcond=None,
        )[0]
        top, bottom = (
            solution[: zeros + 1],
            np.concatenate([[1.0], solution[zeros + 1 :]]),
        )
        divisor = np.asarray(np.polyval(bottom, x), dtype=np.complex128)
    return (
        top,
        bottom,
        float(np.linalg.norm(weight * (response - np.polyval(top, x) / divisor))),
    )


def _places(coefficients: Reals, order: float, scale: float) -> list[float]:
    """ln of the frequencies |root|^(1/λ) of a polynomial in x."""
    # A leading coefficient of zero is a root at infinity: that mode starts at the
    # band's middle instead.
    roots = np.roots(coefficients) if np.any(coefficients[:-1]) else np.zeros(0)
    missing = coefficients.size - 1 - roots.size
    sizes = np.sort(np.abs(roots)).tolist() + [1.0] * missing
    return [float(np.log(max(size, 1e-9)) / order + np.log(scale)) for size in sizes]
