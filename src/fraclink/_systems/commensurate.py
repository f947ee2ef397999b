"""Systems of one base order: that order, and their state space with Caputo initial
conditions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink._systems.fractional import FractionalTransferFunction
from fraclink._systems.response import Hold, SamplePeriod, TimeResponse, time_response
from fraclink._systems.stability import StabilityVerdict, is_stable
from fraclink._systems.terms import Reals, Term
from fraclink._validate import Array, Between, checked, checked_whole
from fraclink._validate.equality import compared
from fraclink.errors import FieldError

# Orders are measured or chosen with six digits at most; a random double lies within two
# units of its last place of such a fraction once in some thousand times.
_FINEST = 10**6
_ULP = 4.0 * float(np.finfo(float).eps)
# The coefficients of det(xI − A) are exact before they are rounded, but the roots of a
# polynomial of higher degree move by more than the response's own error with that
# rounding (Wilkinson).
STATES = 12

Order = Annotated[float, Between(1e-3, 2.0, high_open=True)]


@checked
def commensurate_order(system: FractionalTransferFunction) -> Fraction | None:
    """Return the largest q of which every order of the system is a whole multiple, or
    None.

    An order counts as the rational number with a denominator up to 10⁶ that its double
    stands for: 1.92 is 48/25. The result is exact; None says that some order is no such
    number (`math.pi`). For a system without powers of s it is 1. Delays do not matter.

    Parameters
    ----------
    system
        Orders of any kind.

    Examples
    --------
    >>> from fraclink._systems.fractional import s
    >>> print(commensurate_order(1 / (s**1.5 + s**0.9 + 1)), commensurate_order(1 / (s**1.92 + 100)))
    3/10 48/25
    >>> print(commensurate_order(1 / (s**2**0.5 + s + 1)))
    None
    """
    orders = []
    for term in (*system.numerator, *system.denominator):
        nearest = Fraction(term.order).limit_denominator(_FINEST)
        if abs(float(nearest) - term.order) > _ULP * max(1.0, term.order):
            return None
        orders.append(nearest)
    shared = math.lcm(*(f.denominator for f in orders))
    whole = math.gcd(*(f.numerator * (shared // f.denominator) for f in orders))
    return Fraction(whole, shared) if whole else Fraction(1)


@checked
@compared
@dataclass(frozen=True, eq=False)
class FractionalStateSpace:
    """D^q x = A x + B u, y = C x + D u with the Caputo derivative of one order q for
    all states.

    Attributes
    ----------
    A, B, C, D
        Matrices of shapes (n, n), (n, m), (p, n), (p, m), up to 12 states; kept as
        read-only arrays.
    order
        q [1], 0.001 ≤ q < 2.

    Raises
    ------
    FieldError
        Shapes that do not fit, more than 12 states, an order out of range.

    Examples
    --------
    >>> system = FractionalStateSpace([[0, 1], [-4, -1]], [[0], [1]], [[1, 0]], [[0]], 0.8)
    >>> system.transfer_function()
    1/(s**1.6 + s**0.8 + 4)
    >>> print(system.is_stable())
    stable: no pole has Re s ≥ 0
    >>> system.response([0.0, 0.0, 0.0], 0.5, initial=[1.0, 0.0]).output.round(6)
    array([ 1.      ,  0.425426, -0.003564])
    """

    A: Annotated[Reals, Array(2)]
    B: Annotated[Reals, Array(2)]
    C: Annotated[Reals, Array(2)]
    D: Annotated[Reals, Array(2)]
    order: Order

    def __post_init__(self) -> None:
        n, (p, m) = len(self.A), self.D.shape
        for name, wanted in (("A", (n, n)), ("B", (n, m)), ("C", (p, n))):
            shape = getattr(self, name).shape
            if shape != wanted:
                remedy = "A is (n, n), B (n, m), C (p, n), D (p, m)"
                problem, allowed = "of a shape that does not fit", f"shape {wanted}"
                raise FieldError(name, shape, problem, allowed=allowed, remedy=remedy)
        if n > STATES:
            problem, remedy = (
                "too many states",
                "reduce the model, or keep it as a transfer function",
            )
            raise FieldError(
                "A",
                self.A.shape,
                problem,
                allowed=f"at most {STATES} states",
                remedy=remedy,
            )

    @classmethod
    @checked
    def from_transfer_function(
        cls, system: FractionalTransferFunction, *, order: Order | None = None
    ) -> FractionalStateSpace:
        """Return the controllable canonical form of a proper commensurate system
        without delay.

        `order` q [1] divides every order of the system; by default it is
        `commensurate_order`, or a whole part of it where that is 2 or more.

        >>> from fraclink._systems.fractional import s
        >>> made = FractionalStateSpace.from_transfer_function((s**0.5 + 3) / (s + 2 * s**0.5 + 5))
        >>> made.A.tolist(), made.C.tolist(), made.order
        ([[-2.0, -5.0], [1.0, 0.0]], [[1.0, 3.0]], 0.5)
        """
        base = _base(system, order)
        # The system is proper: no order of the numerator is higher.
        degree = round(system.denominator[0].order / base)
        if degree > STATES:
            problem = f"of {degree} states with the order {base:.6g}"
            allowed, remedy = (
                f"at most {STATES} states",
                "keep it as a transfer function: its responses are exact",
            )
            raise FieldError(
                "system", repr(system), problem, allowed=allowed, remedy=remedy
            )
        top, bottom = (
            _coefficients(side, base, degree)
            for side in (system.numerator, system.denominator)
        )
        direct = top[0]
        matrix = np.zeros((degree, degree))
        matrix[:1], matrix[range(1, degree), range(degree - 1)] = -bottom[1:], 1.0
        column = np.zeros((degree, 1))
        column[:1] = 1.0
        row = (top[1:] - direct * bottom[1:]).reshape(1, degree)
        return cls(matrix, column, row, np.array([[direct]]), base)

    def transfer_function(
        self, *, output: int = 0, input: int = 0
    ) -> FractionalTransferFunction:
        """Return C (s^q I − A)⁻¹ B + D from one input to one output, both counted from
        0.
        """
        for name, value, count in (
            ("output", output, len(self.C)),
            ("input", input, self.B.shape[1]),
        ):
            checked_whole(name, value, 0, count - 1)
        # Exact fractions: the coefficients of det(xI − A) cancel, and what rounding
        # leaves of a small one would move a pole.
        column = [Fraction(b) for b in self.B[:, input].tolist()]
        return self._quotient(
            output, column, 0.0, direct=Fraction(float(self.D[output, input]))
        )

    def is_stable(self) -> StabilityVerdict:
        """Return the verdict on D^q x = A x: every eigenvalue has |arg λ| > qπ/2
        (Matignon 1996).

        The zeros of det(s^q I − A) are counted as `is_stable` counts poles:
        unobservable ones are among them.
        """
        bottom = _adjugate(self.A)[1]
        return is_stable(
            FractionalTransferFunction((Term(1.0, 0.0),), self._terms(bottom, 0.0))
        )

    @checked
    def response(
        self,
        u: Annotated[ArrayLike, Array(None, flags=True)],
        period: SamplePeriod,
        *,
        initial: Annotated[ArrayLike, Array(1)] | None = None,
        initial_rate: Annotated[ArrayLike, Array(1)] | None = None,
        hold: Hold = "zero",
    ) -> TimeResponse:
        """Return the output for a sampled input and Caputo initial conditions, exact at
        the samples.

        y(t) = C E_q(A t^q) x₀ + C t E_{q,2}(A t^q) x₁ + ∫₀ᵗ C θ^(q−1) E_{q,q}(A θ^q) B
        u(t−θ) dθ + D u(t)

        The matrix functions are not formed: each summand is the response of a transfer
        function. The error estimate is the sum of theirs.

        Parameters
        ----------
        u
            Samples k·period, shape (N,) for one input, (N, m) for m. The output is (N,)
            or (N, p).
        period
            Sampling period, 1e-12 … 1e12 s.
        initial
            x₀ = x(0), shape (n,); 0 if absent.
        initial_rate
            x₁ = dx/dt(0) [1/s], shape (n,), where 1 < q < 2; 0 if absent.
        hold
            As for `time_response`.

        Raises
        ------
        FieldError
            Shapes that do not fit, an initial rate with q ≤ 1 (the Caputo derivative
            has no place for one), and what `time_response` refuses.
        """
        columns = self._inputs(np.asarray(u, np.float64))
        # The step responses of s^q (s^q I − A)⁻¹ x₀ and of s^(q−1) (s^q I − A)⁻¹ x₁.
        states = [(self._state("initial", initial), self.order)]
        if initial_rate is not None and self.order <= 1.0:
            problem, remedy = (
                "given with an order of 1 or less",
                "leave initial_rate out",
            )
            shown = np.asarray(initial_rate).tolist()
            raise FieldError(
                "initial_rate",
                shown,
                problem,
                allowed="an order above 1",
                remedy=remedy,
            )
        # Caputo's derivative of an order above 1 starts from a position and a velocity;
        # each state has one of both.
        states.append((self._state("initial_rate", initial_rate), self.order - 1.0))
        ones = np.ones(len(columns))
        outputs = []
        for row in range(len(self.C)):
            parts = [
                time_response(
                    self.transfer_function(output=row, input=k),
                    columns[:, k],
                    period,
                    hold=hold,
                )
                for k in range(columns.shape[1])
            ]
            # The initial states are held from the first sample on: a step, whatever
            # hold the input has.
            parts += [
                time_response(self._quotient(row, x, lift), ones, period)
                for x, lift in states
                if any(x)
            ]
            outputs.append(parts)
        values = np.stack(
            [np.sum([part.output for part in parts], axis=0) for parts in outputs],
            axis=1,
        )
        every = [part for parts in outputs for part in parts]
        return TimeResponse(
            # Copied, as the result makes its arrays read-only and the parts may share
            # them.
            every[0].time.copy(),
            values[:, 0].copy() if len(self.C) == 1 else values,
            # The least direct method of any part names the whole: its error is the one
            # to read.
            max(
                (part.method for part in every),
                key=["modes", "modes+convolution", "contour", "fft"].index,
            ),
            max(sum(part.error_estimate for part in parts) for parts in outputs),
            max(part.modes for part in every),
            period,
            hold,
        )

    def _inputs(self, u: Reals) -> Reals:
        count = self.B.shape[1]
        given = u[:, None] if u.ndim == 1 else u
        if given.ndim != 2 or given.shape[1] != count:
            problem, remedy = (
                "of a shape that does not fit",
                "give one column for each input",
            )
            raise FieldError(
                "u", u.shape, problem, allowed=f"shape (N, {count})", remedy=remedy
            )
        return np.ascontiguousarray(given)

    def _state(self, name: str, values: ArrayLike | None) -> list[Fraction]:
        state = (
            np.zeros(len(self.A)) if values is None else np.asarray(values, np.float64)
        )
        if state.shape != (len(self.A),):
            problem, remedy = (
                "of a shape that does not fit",
                "give one value for each state",
            )
            allowed = f"shape ({len(self.A)},)"
            raise FieldError(name, state.shape, problem, allowed=allowed, remedy=remedy)
        return [Fraction(x) for x in state.tolist()]

    def _quotient(
        self,
        output: int,
        column: Sequence[Fraction],
        lift: float,
        *,
        direct: Fraction = Fraction(0),
    ) -> FractionalTransferFunction:
        """C_output s^lift (s^q I − A)⁻¹ column + direct."""
        matrices, bottom = _adjugate(self.A)
        row = [Fraction(c) for c in self.C[output].tolist()]
        top = [
            sum(
                (
                    r * m * x
                    for r, line in zip(row, rows, strict=True)
                    for m, x in zip(line, column, strict=True)
                ),
                Fraction(0),
            )
            for rows in matrices
        ]
        terms = self._terms(top, lift)
        if direct:
            terms += self._terms([direct * c for c in bottom], 0.0)
        return FractionalTransferFunction(terms, self._terms(bottom, 0.0))

    def _terms(self, coefficients: Sequence[Fraction], lift: float) -> tuple[Term, ...]:
        """Σ c_k s^(q(K−k) + lift) of coefficients in falling order."""
        degree = len(coefficients) - 1
        try:
            return tuple(
                Term(float(c), self.order * (degree - k) + lift)
                for k, c in enumerate(coefficients)
                if c
            )
        except OverflowError:
            problem, remedy = (
                "with a characteristic polynomial beyond the range of doubles",
                "scale the time",
            )
            largest = float(np.abs(self.A).max())
            raise FieldError(
                "A", largest, problem, allowed="smaller entries", remedy=remedy
            ) from None


def _base(system: FractionalTransferFunction, order: float | None) -> float:
    """The order of the states of a system, which must be proper, commensurate and
    without delay.
    """
    remedy = "keep it as a transfer function: every verb takes it as it is"
    if any(t.delay for t in (*system.numerator, *system.denominator)):
        raise FieldError(
            "system", repr(system), "delayed", allowed="no delay", remedy=remedy
        )
    if not system.is_proper:
        raise FieldError(
            "system", repr(system), "improper", allowed="a proper system", remedy=remedy
        )
    if order is not None:
        powers = [t.order / order for t in (*system.numerator, *system.denominator)]
        # A given order is a decimal: 0.3333333333 has to divide 1, though 1/3 is what
        # divides it.
        if any(abs(x - round(x)) > 1e-9 for x in powers):
            problem = "does not divide every order of the system"
            allowed, advice = (
                f"a whole part of {commensurate_order(system)}",
                "leave order out",
            )
            raise FieldError("order", order, problem, allowed=allowed, remedy=advice)
        return order
    found = commensurate_order(system)
    if found is None:
        problem = "of orders without a common base"
        raise FieldError(
            "system",
            repr(system),
            problem,
            allowed="commensurate orders",
            remedy=remedy,
        )
    # Above 2 no state of D^q x = A x can be stable: the base is divided until it is
    # below.
    return float(found if found < 2 else found / math.ceil(found))


def _coefficients(terms: Sequence[Term], base: float, degree: int) -> Reals:
    """Coefficients of x^degree … x⁰, x = s^base."""
    values = np.zeros(degree + 1)
    for term in terms:
        values[degree - round(term.order / base)] += term.coefficient
    return values


def _adjugate(
    matrix: NDArray[np.float64],
) -> tuple[list[list[list[Fraction]]], list[Fraction]]:
    """M_k and c_k of (xI − A)⁻¹ = Σ M_k x^(n−1−k)/Σ c_k x^(n−k), exact (Faddeev and
    Leverrier).
    """
    n = len(matrix)
    a = [[Fraction(x) for x in row] for row in matrix.tolist()]
    coefficients, matrices = [Fraction(1)], []
    here = [[Fraction(int(i == j)) for j in range(n)] for i in range(n)]
    for k in range(1, n + 1):
        matrices.append(here)
        product = [
            [
                sum(x * y for x, y in zip(row, column, strict=True))
                for column in zip(*here, strict=True)
            ]
            for row in a
        ]
        c = -Fraction(sum(product[i][i] for i in range(n))) / k
        coefficients.append(c)
        here = [
            [Fraction(x) + (c if i == j else 0) for j, x in enumerate(row)]
            for i, row in enumerate(product)
        ]
    return matrices, coefficients
