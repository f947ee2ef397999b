"""Fractional transfer functions: quotients of sums of real powers of s, with delays.

    G(s) = Σ c_i s^(a_i) e^(-τ_i s)  /  Σ d_k s^(b_k) e^(-σ_k s)

Orders are real and need no common base. The power is the principal one, s^a = exp(a ln
s) with -π < arg s ≤ π, so a function is real for s > 0 and conjugate-symmetric
elsewhere.

>>> from fracsys._fractional import s
>>> G = 1.56 * s**1.92 / (s**1.92 + 100.4004)
>>> G
1.56*s**1.92/(s**1.92 + 100.4004)
>>> print(G)
1.56 s^1.92 / (s^1.92 + 100.4)
>>> G.is_proper, G.relative_degree
(True, 0.0)
"""

from __future__ import annotations

import math
import numbers
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import reduce
from importlib import import_module
from typing import Any, cast, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fracsys._terms import (
    LATEX,
    PLAIN,
    PYTHON,
    Term,
    as_terms,
    cancelled,
    collect,
    evaluate,
    finite,
    normal,
    product,
    scaled,
    written,
)
from fracsys.checks import Complex
from fracsys.errors import FieldError


@dataclass(frozen=True, repr=False, eq=False)
class FractionalTransferFunction:
    """A quotient of two sums of terms c·s^a·e^(-τs), always in the same normal form.

    Equal orders are merged, zeros dropped, powers and delays common to numerator and
    denominator divided out, terms sorted by falling order, and the denominator's
    leading coefficient scaled to 1. Equality and hash compare this form, and a constant
    equals its number. A numerator that is a multiple of the denominator is cancelled:
    the response from rest is the same. `repr` is Python code for an equal function,
    `str` is for reading, and a notebook shows a formula.

    `numerator`, `denominator`: terms, a single term, or a number. Raises `FieldError`
    for an empty or zero denominator, for NaN or infinite entries, for a negative order
    in a denominator and for a function that would respond before its input.

    >>> FractionalTransferFunction((Term(2, 0.5),), (Term(4, 1.5), Term(2, 0.5)))
    0.5/(s + 0.5)
    >>> (s + 1) / (2 * s + 2)
    0.5*s**0
    """

    numerator: tuple[Term, ...]
    denominator: tuple[Term, ...]

    __made_by__ = "fracsys.s, such as 100 / (s**1.92 + 100)"

    # numpy must not multiply an array by G entry by entry: an array is not a valid operand.
    __array_ufunc__ = None

    def __post_init__(self) -> None:
        top = collect(as_terms("numerator", self.numerator))
        bottom = collect(as_terms("denominator", self.denominator))
        if not bottom:
            raise FieldError(
                "denominator",
                self.denominator,
                "zero",
                "at least one nonzero term",
                "check the signs",
            )
        if bottom[-1].order < 0.0:
            remedy, lowest = (
                "multiply numerator and denominator by a power of s",
                bottom[-1].order,
            )
            raise FieldError(
                "denominator",
                lowest,
                "a negative order",
                "orders >= 0",
                remedy,
            )
        numerator, denominator = normal(top, bottom)
        object.__setattr__(self, "numerator", numerator)
        object.__setattr__(self, "denominator", denominator)

    # -- evaluation
    # -------------------------------------------------------------------------------

    @overload
    def __call__(self, s: complex) -> complex: ...
    @overload
    def __call__(self, s: NDArray[Any]) -> Complex: ...

    def __call__(self, s: complex | NDArray[Any]) -> complex | Complex:
        """Return G(s) on the principal sheet; `s` [rad/s] is a complex number or an
        array of any shape.

        On the negative real axis the value is that for arg s = +π. At a pole the value
        is infinite.

        >>> G = 1 / (FractionalTransferFunction.power(0.5) + 1)
        >>> G(4.0)
        (0.3333333333333333+0j)
        >>> G(1j * np.array([0.0, 1.0])).round(6)
        array([1. +0.j      , 0.5-0.207107j])
        """
        return evaluate(self.numerator, self.denominator, s)

    # -- algebra
    # ----------------------------------------------------------------------------------

    def __add__(self, other: object) -> FractionalTransferFunction:
        return _applied(_sum, self, other)

    def __mul__(self, other: object) -> FractionalTransferFunction:
        return _applied(_product, self, other)

    def __truediv__(self, other: object) -> FractionalTransferFunction:
        return _applied(_ratio, self, other)

    def __sub__(self, other: object) -> FractionalTransferFunction:
        return _applied(lambda a, b: _sum(a, -b), self, other)

    def __neg__(self) -> FractionalTransferFunction:
        return _build(scaled(self.numerator, -1.0), self.denominator)

    def __pos__(self) -> FractionalTransferFunction:
        return self

    def __radd__(self, other: object) -> FractionalTransferFunction:
        return self + other

    def __rmul__(self, other: object) -> FractionalTransferFunction:
        return self * other

    def __rsub__(self, other: object) -> FractionalTransferFunction:
        return -self + other

    def __rtruediv__(self, other: object) -> FractionalTransferFunction:
        return _applied(lambda a, b: _ratio(b, a), self, other)

    def __pow__(self, exponent: object) -> FractionalTransferFunction:
        """Integer power of any function, real power of a single term c·s^a with c > 0
        (s**1.92).
        """
        if isinstance(exponent, FractionalTransferFunction):
            return NotImplemented
        power = finite("exponent", exponent)
        if power.is_integer() and abs(power) <= 64:
            return self._integer_power(int(power))
        single = len(self.numerator) == len(self.denominator) == 1
        if not single or self.numerator[0].coefficient <= 0.0:
            raise FieldError(
                "exponent",
                exponent,
                f"a real power of {'a negative term' if single else 'a sum'}",
                "integers from -64 to 64, or any real power of a single term c·s^a with c > 0",
                "take a whole number, or write the power out",
            )
        top, bottom = self.numerator[0], self.denominator[0]
        order = (top.order - bottom.order) * power
        return _build(
            (Term(top.coefficient**power, max(order, 0.0), top.delay * power),),
            (Term(1.0, max(-order, 0.0)),),
        )

    def _integer_power(self, power: int) -> FractionalTransferFunction:
        one = _build((Term(1.0, 0.0),), (Term(1.0, 0.0),))
        base = self if power >= 0 else one / self
        return reduce(_product, [base] * abs(power), one)

    def delayed(self, delay: float) -> FractionalTransferFunction:
        """Return G(s)·e^(-τs) for the delay τ ≥ 0 [s].

        >>> (1 / (s + 1)).delayed(0.01)
        (1*s**0).delayed(0.01)/(s + 1)
        """
        extra = Term(1.0, 0.0, delay)
        return _build(product(self.numerator, (extra,)), self.denominator)

    def feedback(
        self, other: FractionalTransferFunction | float = 1.0, sign: int = -1
    ) -> FractionalTransferFunction:
        """Return the closed loop G/(1 - sign·G·H) with H = `other`; `sign` is -1
        (negative feedback) or +1.

        As in python-control, whose `control.feedback(G, H)` calls this.

        >>> (10 / s**0.5).feedback()
        10/(s**0.5 + 10)
        """
        if sign not in (-1, 1):
            raise FieldError(
                "sign",
                sign,
                "not a sign",
                "-1 or +1",
                "-1 is negative feedback",
            )
        right = _operand(other)
        if right is NotImplemented:
            raise FieldError(
                "other",
                other,
                "not a transfer function",
                "a function or a number",
                "build it from s",
            )
        # Built from the four sums: G/(1 + GH) would carry the denominator of G in both
        # numerator and denominator.
        loop = product(self.numerator, right.numerator)
        return _build(
            product(self.numerator, right.denominator),
            (
                *product(self.denominator, right.denominator),
                *scaled(loop, -float(sign)),
            ),
        )

    # -- properties
    # -------------------------------------------------------------------------------

    @property
    def relative_degree(self) -> float:
        """Highest order of the denominator minus highest order of the numerator
        (infinite for G = 0).
        """
        return (
            self.denominator[0].order - self.numerator[0].order
            if self.numerator
            else math.inf
        )

    @property
    def is_proper(self) -> bool:
        """True where |G| stays bounded at high frequency: the relative degree is not
        negative.
        """
        return self.relative_degree >= 0.0

    @property
    def delay(self) -> float:
        """The dead time from input to output [s]: the least delay of the numerator."""
        return min((t.delay for t in self.numerator), default=0.0)

    def dcgain(self) -> float:
        """Return G(0): finite, zero or infinite.

        >>> (3 / (FractionalTransferFunction.power(0.5) + 2)).dcgain()
        1.5
        """
        return float(self(0j).real)

    def poles(self) -> Complex:
        """Return the poles on the principal sheet [rad/s], as `fracsys.poles` does."""
        return cast(
            "NDArray[np.complex128]",
            import_module("fracsys._stability").poles(self),
        )

    def zeros(self) -> Complex:
        """Return the zeros on the principal sheet [rad/s]: the poles of 1/G.

        >>> ((FractionalTransferFunction.power(1.0) + 2) / FractionalTransferFunction.power(2.5)).zeros().real
        array([-2.])
        """
        return (1.0 / self).poles()

    def to_control(
        self, frequencies: ArrayLike | None = None, *, name: str | None = None
    ) -> Any:
        """Return the function as a response of python-control (see
        `fracsys.to_control`).
        """
        # Imported by name at call time: this module must not depend on the layers above
        # it.
        to_control = import_module("fracsys._control").to_control
        return to_control(self, frequencies, name=name)

    @staticmethod
    def power(order: float) -> FractionalTransferFunction:
        """Return s^a for any real order a.

        >>> FractionalTransferFunction.power(-0.5)
        1/s**0.5
        """
        value = finite("order", order)
        return _build((Term(1.0, max(value, 0.0)),), (Term(1.0, max(-value, 0.0)),))

    # -- comparison and text
    # ----------------------------------------------------------------------

    def __eq__(self, other: object) -> bool:
        right = _operand(other)
        if right is NotImplemented:
            return NotImplemented
        return (self.numerator, self.denominator) == (
            right.numerator,
            right.denominator,
        )

    def __hash__(self) -> int:
        if self.denominator != _ONE or len(self.numerator) > 1:
            return hash((self.numerator, self.denominator))
        # s/s equals 1, and equal objects must have equal hashes.
        only = self.numerator[0] if self.numerator else Term(0.0, 0.0)
        constant = not only.order and not only.delay
        return hash(
            only.coefficient if constant else (self.numerator, self.denominator)
        )

    def __bool__(self) -> bool:
        """False for 0."""
        return bool(self.numerator)

    def __repr__(self) -> str:
        top = written(self.numerator, PYTHON)
        if self.denominator == _ONE:
            single = all(t.order == 0.0 and not t.delay for t in self.numerator)
            return f"{top}*s**0" if single else top
        bottom = written(self.denominator, PYTHON)
        several = len(self.denominator) > 1 or self.denominator[0].delay
        top = f"({top})" if len(self.numerator) > 1 else top
        return f"{top}/({bottom})" if several else f"{top}/{bottom}"

    def __str__(self) -> str:
        top, bottom = (
            written(terms, PLAIN) for terms in (self.numerator, self.denominator)
        )
        if self.denominator == _ONE:
            return top
        top = f"({top})" if len(self.numerator) > 1 else top
        return (
            f"{top} / ({bottom})" if len(self.denominator) > 1 else f"{top} / {bottom}"
        )

    def _repr_latex_(self) -> str:
        return (
            f"${self.latex()}$"
            if self.denominator == _ONE
            else rf"$\displaystyle{self.latex()}$"
        )

    def latex(self) -> str:
        """Return the function as LaTeX, without dollar signs.

        >>> print((1 / (FractionalTransferFunction.power(0.5) + 2)).latex())
        \\frac{1}{s^{0.5} + 2}
        """
        top, bottom = (
            # Python's 1e-05 is set as 1 · 10^{-5}.
            re.sub(
                r"(?<=\d)e\+?(-?)0*(\d+)", r" \\cdot 10^{\1\2}", written(terms, LATEX)
            )
            for terms in (self.numerator, self.denominator)
        )
        return top if self.denominator == _ONE else rf"\frac{{{top}}}{{{bottom}}}"


def _build(top: Iterable[Term], bottom: Iterable[Term]) -> FractionalTransferFunction:
    return FractionalTransferFunction(tuple(top), tuple(bottom))


def _sum(
    a: FractionalTransferFunction, b: FractionalTransferFunction
) -> FractionalTransferFunction:
    # Otherwise 1/D + 1/D would be 2D/D², with every pole doubled and one of each pair
    # cancelled by a zero.
    if a.denominator == b.denominator:
        return _build((*a.numerator, *b.numerator), a.denominator)
    top = (*product(a.numerator, b.denominator), *product(b.numerator, a.denominator))
    return _build(top, product(a.denominator, b.denominator))


def _product(
    a: FractionalTransferFunction, b: FractionalTransferFunction
) -> FractionalTransferFunction:
    return _crosswise(a.numerator, a.denominator, b.numerator, b.denominator)


def _ratio(
    a: FractionalTransferFunction, b: FractionalTransferFunction
) -> FractionalTransferFunction:
    if not b.numerator:
        raise FieldError(
            "denominator",
            0.0,
            "zero",
            "a nonzero function",
            "do not divide by zero",
        )
    return _crosswise(a.numerator, a.denominator, b.denominator, b.numerator)


def _crosswise(
    top: Sequence[Term],
    bottom: Sequence[Term],
    other_top: Sequence[Term],
    other_bottom: Sequence[Term],
) -> FractionalTransferFunction:
    """(top/bottom)·(other_top/other_bottom) with equal sums cancelled crosswise:
    (1/D)·D is 1, not D/D.
    """
    top, other_bottom = cancelled(top, other_bottom)
    other_top, bottom = cancelled(other_top, bottom)
    return _build(product(top, other_top), product(bottom, other_bottom))


_ONE = (Term(1.0, 0.0),)


def _applied(
    operation: Callable[
        [FractionalTransferFunction, FractionalTransferFunction],
        FractionalTransferFunction,
    ],
    function: FractionalTransferFunction,
    other: object,
) -> FractionalTransferFunction:
    """The operation with a function or a number; NotImplemented for anything else."""
    right = _operand(other)
    return right if right is NotImplemented else operation(function, right)


def _operand(value: object) -> Any:
    if isinstance(value, FractionalTransferFunction):
        return value
    if hasattr(value, "ninputs") and hasattr(value, "dt"):  # a system of python-control
        return import_module("fracsys._control").from_control(value)
    if isinstance(value, numbers.Real) and not isinstance(
        value, bool
    ):  # a Fraction as well
        return _build((Term(float(value), 0.0),), (Term(1.0, 0.0),))
    return NotImplemented


s: FractionalTransferFunction = FractionalTransferFunction.power(1.0)
"""The Laplace variable [rad/s]: `G = 100 / (s**1.92 + 100)`."""
