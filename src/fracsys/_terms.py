"""Sums of terms c·s^a·e^(-τs): merging, products and the normal form of a quotient."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fracsys._precision import ROUNDING
from fracsys.checks import Complex, Real
from fracsys.errors import FieldError, SizeError


@dataclass(frozen=True, slots=True)
class Term:
    """One term c·s^a·e^(-τs) of a numerator or denominator.

    `coefficient` c, `order` a (any real number), `delay` τ ≥ 0 [s].

    >>> Term(1.56, 1.92)
    Term(coefficient=1.56, order=1.92, delay=0.0)
    """

    coefficient: float
    order: float
    delay: float = 0.0

    def __post_init__(self) -> None:
        values = (self.coefficient, self.order, self.delay)
        # The algebra creates thousands of terms from floats; these take a single test.
        if (
            all(type(value) is float for value in values)
            and math.isfinite(sum(values))
            and self.delay >= 0.0
        ):
            return
        for name in ("coefficient", "order", "delay"):
            object.__setattr__(self, name, finite(name, getattr(self, name)))
        if self.delay < 0.0:
            raise FieldError(
                "delay",
                self.delay,
                "negative",
                "≥ 0 s",
                "an output cannot precede its input",
            )


def finite(name: str, value: object) -> float:
    # `float` accepts True as 1 and "2" as 2, and numpy drops an imaginary part with
    # only a warning.
    if isinstance(value, (bool, str, bytes, complex)) or value is None:
        number = math.nan
    else:
        try:
            number = float(value)  # type: ignore[arg-type]
        except (TypeError, ValueError, OverflowError):
            number = math.nan
    if not math.isfinite(number):
        raise FieldError(
            name,
            value,
            "not a finite real number",
            "real numbers",
            "give a float",
        )
    return number


def same(a: float, b: float) -> bool:
    """Whether two orders or delays are equal but for rounding, as 0.1 + 0.2 and 0.3."""
    return abs(a - b) <= ROUNDING * max(1.0, abs(a), abs(b))


def collect(terms: Iterable[Term]) -> list[Term]:
    """Merge terms of equal order and delay, drop zeros, sort by falling order, then
    rising delay.
    """
    terms = tuple(terms)
    if len(terms) == 1:
        return [terms[0]] if terms[0].coefficient != 0.0 else []
    # Sorted by coefficient as well, and summed with `fsum` below, so that the same
    # terms in another sequence give the same function to the last bit, which `==` and
    # hashes compare.
    groups: list[list[Term]] = []
    for term in sorted(terms, key=lambda t: (-t.order, t.delay, t.coefficient)):
        # Compared with the first of each group, not by a rounded key: two orders that
        # differ by rounding may fall on different sides of a rounding boundary.
        equal = (
            g
            for g in groups
            if same(g[0].order, term.order) and same(g[0].delay, term.delay)
        )
        group = next(equal, None)
        if group is None:
            groups.append([term])
        else:
            group.append(term)
    summed = [
        Term(math.fsum(t.coefficient for t in g), g[0].order, g[0].delay)
        for g in groups
    ]
    return sorted(
        (t for t in summed if t.coefficient != 0.0), key=lambda t: (-t.order, t.delay)
    )


def shifted(
    terms: Iterable[Term], order: float, delay: float, scale: float
) -> tuple[Term, ...]:
    return tuple(
        Term(
            t.coefficient / scale,
            snap(t.order - order),
            max(0.0, snap(t.delay - delay)),
        )
        for t in terms
    )


def snap(value: float) -> float:
    """The decimal number of 12 places that equals `value` up to rounding: 1.92 - 0.92
    is 0.9999999999999999.
    """
    # Only where the decimal number is within rounding: √2 stays √2 and does not become
    # 1.414213562373.
    nearest = round(value, 12)
    return nearest if same(value, nearest) else value


def proportional(a: tuple[Term, ...], b: tuple[Term, ...]) -> bool:
    """True where a = constant · s^d · e^(-σs) · b, term by term."""
    if len(a) != len(b) or not a:
        return False
    ratio, order, delay = (
        a[0].coefficient / b[0].coefficient,
        a[0].order - b[0].order,
        a[0].delay - b[0].delay,
    )
    return all(
        abs(x.coefficient - ratio * y.coefficient) <= ROUNDING * abs(x.coefficient)
        and same(x.order, y.order + order)
        and same(x.delay, y.delay + delay)
        for x, y in zip(a, b, strict=True)
    )


def cancelled(
    top: Sequence[Term], bottom: Sequence[Term]
) -> tuple[Sequence[Term], Sequence[Term]]:
    """Both sums, or single terms with the same quotient if one sum is a multiple of the
    other.
    """
    # Single terms need no search: `normal` cancels their common factor.
    if len(bottom) < 2 or not proportional(tuple(top), tuple(bottom)):
        return top, bottom
    order, delay = top[0].order - bottom[0].order, top[0].delay - bottom[0].delay
    ratio = top[0].coefficient / bottom[0].coefficient
    return (
        (Term(ratio, max(order, 0.0), max(delay, 0.0)),),
        (Term(1.0, max(-order, 0.0), max(-delay, 0.0)),),
    )


def product(a: Iterable[Term], b: Iterable[Term]) -> list[Term]:
    right = tuple(b)
    return collect(
        Term(x.coefficient * y.coefficient, x.order + y.order, x.delay + y.delay)
        for x in a
        for y in right
    )


def as_terms(field: str, value: object) -> tuple[Term, ...]:
    if isinstance(value, Term):
        return (value,)
    if isinstance(value, (int, float)):
        return (Term(value, 0.0),)
    if isinstance(value, (tuple, list)) and all(isinstance(t, Term) for t in value):
        return tuple(value)
    raise FieldError(
        field,
        value,
        "not a sum of terms",
        "Term, a sequence of Term, or a number",
        "use Term(c, a)",
    )


def normal(
    top: list[Term], bottom: list[Term]
) -> tuple[tuple[Term, ...], tuple[Term, ...]]:
    if not top:
        return (), (Term(1.0, 0.0),)
    top, bottom = (list(x) for x in cancelled(top, bottom))
    order = min(t.order for t in (*top, *bottom))
    delay = min(t.delay for t in bottom)
    early = min(t.delay for t in top) - delay
    if early < 0.0 and not same(early, 0.0):
        raise FieldError(
            "delay",
            early,
            "negative",
            "≥ 0 s",
            "the function would respond before its input",
        )
    # Monic in the highest order, whose coefficient is never zero.
    lead = bottom[0].coefficient
    return (
        shifted(top, order, delay, lead),
        shifted(bottom, order, delay, lead),
    )


def scaled(terms: Iterable[Term], factor: float) -> tuple[Term, ...]:
    return tuple(Term(t.coefficient * factor, t.order, t.delay) for t in terms)


@dataclass(frozen=True)
class Notation:
    """Notation of a sum: the product sign, numbers, powers of s, and delayed parts."""

    product: str
    number: str
    power: str
    delayed: str


PLAIN = Notation(" ", "{:.6g}", "s^{:.10g}", "{} e^(-{:.6g} s)")
LATEX = Notation(r"\,", "{:.6g}", "s^{{{:.6g}}}", r"{}\,e^{{-{:.6g} s}}")
# Python reads this form back to the last bit, with s the Laplace variable.
PYTHON = Notation("*", "{!r}", "s**{!r}", "({}).delayed({!r})")


def written(terms: tuple[Term, ...], notation: Notation) -> str:
    """The sum as text."""
    parts: list[str] = []
    for term in terms:
        size = notation.number.format(abs(float(term.coefficient)))
        power = notation.power.format(float(term.order)).removesuffix(".0")
        factors = [size.removesuffix(".0")] if float(size) != 1.0 else []
        if term.order:
            factors.append("s" if term.order == 1.0 else power)
        body = notation.product.join(factors)
        if term.delay:
            if notation is PYTHON and not term.order:
                body = f"{body or '1'}*s**0"
            body = notation.delayed.format(body, float(term.delay))
            body = body.removeprefix(notation.product)
        sign = "-" if term.coefficient < 0 else "+"
        lead = f"{sign} " if parts else sign.removeprefix("+")
        parts.append(lead + (body or "1"))
    return " ".join(parts) or "0"


# --- Values of sums of c·s^a·e^(-τs) on arrays: the arithmetic under `FractionalTransferFunction` -----


def evaluate(
    numerator: Sequence[Term], denominator: Sequence[Term], s: Any
) -> complex | Complex:
    """Return numerator(s)/denominator(s) on the principal sheet, in the shape of `s`."""
    points = np.asarray(s)
    if points.dtype.kind not in "biufc":
        raise FieldError(
            "s",
            s,
            "not a number",
            "complex numbers or arrays of them",
            "give s in rad/s",
        )
    flat = points.astype(np.complex128).ravel()
    with np.errstate(all="ignore"):
        logs = np.log(flat)
        # The plain quotient first: the scaled sums below double the time and are needed
        # only at poles, at s = 0 and for |s| beyond 1e100.
        value = _sum(numerator, flat, logs, 0.0) / _sum(denominator, flat, logs, 0.0)
        bad = ~np.isfinite(value)
        if bad.any():
            value[bad] = _extreme(numerator, denominator, flat[bad], logs[bad])
    return value.reshape(points.shape) if points.ndim else complex(value[0])


def _sum(terms: Sequence[Term], s: Complex, logs: Complex, shift: float) -> Complex:
    total = np.zeros(s.shape, np.complex128)
    for term in terms:
        order = term.order - shift
        if order == 0.0:
            value = np.full(s.shape, term.coefficient, np.complex128)
        elif order.is_integer() and 0.0 < order <= 8.0:
            # Integer powers of small integers are exact: (2j)² must be -4, not -4 +
            # 5e-16j, since the sign of that imaginary part would turn the phase of an
            # undamped link by 360°.
            value = (term.coefficient * s ** int(order)).astype(np.complex128)
        else:
            value = (term.coefficient * np.exp(order * logs)).astype(np.complex128)
            # numpy multiplies −inf + 0j by the order as if it were complex, and 0·inf
            # gives NaN.
            value[s == 0.0] = 0.0 if order > 0.0 else np.inf
        total += value * np.exp(-term.delay * s) if term.delay else value
    return total


def _extreme(
    numerator: Sequence[Term],
    denominator: Sequence[Term],
    s: Complex,
    logs: Complex,
) -> Complex:
    """Values where the plain quotient is not finite: poles, s = 0, and |s| so large
    that powers overflow.
    """
    highest = max((t.order for t in (*numerator, *denominator)), default=0.0)
    top, bottom = _sum(numerator, s, logs, 0.0), _sum(denominator, s, logs, 0.0)
    # Divided by the highest power throughout: ∞/∞ becomes the ratio of two leading
    # coefficients.
    large = np.abs(s) > 1.0
    if large.any():
        top[large] = _sum(numerator, s[large], logs[large], highest)
        bottom[large] = _sum(denominator, s[large], logs[large], highest)
    value = top / bottom
    value[(bottom == 0.0) & (top != 0.0)] = np.inf
    return value


def largest(values: Real) -> float:
    """Largest modulus, NaN if there is a NaN; two passes without a copy."""
    return max(float(values.max()), -float(values.min())) if len(values) else 0.0


def grid(count: int, period: float) -> Real:
    """Times k·period [s], k = 0 … count - 1."""
    return period * np.arange(count, dtype=np.float64)


# Points evaluated together: about 100 complex numbers for each take 6 MB in all.
TOGETHER = 4096
# bytes per sample of a response: input, output, time and the arrays of the hold
BYTES = 40


def refuse_beyond_memory(field: str, count: float, each: int = BYTES) -> None:
    """Raise `SizeError` if `count` samples need more memory than the machine has;
    nothing is allocated.
    """
    # 8 GiB where the system does not report its memory; any machine in use for numpy
    # has that much.
    posix = hasattr(os, "sysconf")
    available = (
        os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if posix else 8 << 30
    )
    if not count * each < available:
        raise SizeError(
            field,
            count,
            f"too many samples: they need {count * each:.2g} bytes",
            f"at most {available // each:.3g} samples on this machine",
            "shorten the span or lengthen the period",
        )
