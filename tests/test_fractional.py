"""Algebra and values of fractional transfer functions."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fraclink.errors import FieldError
from fracsys import FractionalTransferFunction, Term, s

LINK = 1.56 * s**1.92 / (s**1.92 + 10.02**2)
W = np.array([0.01, 0.3, 1.0, 7.0, 90.0])


def test_str_reads_like_the_formula() -> None:
    assert str(LINK) == "1.56 s^1.92 / (s^1.92 + 100.4)"
    assert (
        str((1 - 2 * s).delayed(0.5) / (s + 1))
        == "(-2 s e^(-0.5 s) + e^(-0.5 s)) / (s + 1)"
    )
    assert str(s - s) == "0"
    assert str(1 / s**0.5) == "1 / s^0.5"


TERM = st.tuples(
    st.floats(-1e6, 1e6).filter(lambda c: abs(c) > 1e-6),
    st.floats(0, 4),
    st.sampled_from([0.0, 0.3, 1.7]),
)


@pytest.mark.slow
@given(st.lists(TERM, min_size=1, max_size=4), st.lists(TERM, min_size=1, max_size=3))
def test_repr_is_python_that_makes_an_equal_function(
    top: list[Any], bottom: list[Any]
) -> None:
    def total(terms: list[Any], delayed: bool) -> Any:
        return sum(
            ((c * s**a).delayed(d if delayed else 0.0) for c, a, d in terms), 0 * s
        )

    made = total(top, True) / (total(bottom, False) + 3 * s**5 + s**4.5)
    looped = made.feedback(0.5)  # delays in the denominator
    for function in (made, looped, made - made, 2 * s**0, LINK):
        assert eval(repr(function), {"s": s}) == function  # noqa: S307


def test_normal_form_makes_equal_functions_equal() -> None:
    assert 2 * s / (4 * s**2 + 2 * s) == 0.5 / (s + 0.5)
    assert (0 * s + 0.1) + 0.2 - 0.3 != 0  # numbers are not rounded silently
    assert s**0.1 * s**0.2 == s**0.3
    assert s**-0.5 == 1 / s**0.5
    assert 1 / (s**-0.5 + 1) == s**0.5 / (1 + s**0.5)
    assert (1 / (s**1.3 + 2)) * (s**1.3 + 2) == 1 + 0 * s
    assert (s + 1) / (2 * s + 2) == 0.5 + 0 * s
    assert hash(2 * s / (4 * s**2 + 2 * s)) == hash(0.5 / (s + 0.5))
    assert len({LINK, 1.56 * s**1.92 / (10.02**2 + s**1.92)}) == 1
    # what equals a number hashes like it
    assert {2.5, 2.5 * s / s, 0.0, 0 * s} == {2.5, 0.0}
    assert s != 1.0 and s**0.5 not in {1.0} and s != "s"
    assert s and not 0 * s


@pytest.mark.parametrize(
    ("made", "expected"),
    [
        (lambda z: (1 + LINK)(z), lambda z: 1 + LINK(z)),
        (lambda z: (LINK - 2)(z), lambda z: LINK(z) - 2),
        (lambda z: (2 - LINK)(z), lambda z: 2 - LINK(z)),
        (lambda z: (3 / LINK)(z), lambda z: 3 / LINK(z)),
        (lambda z: (LINK**3)(z), lambda z: LINK(z) ** 3),
        (lambda z: (LINK**-2)(z), lambda z: LINK(z) ** -2),
        (
            lambda z: LINK.feedback(s + 1)(z),
            lambda z: LINK(z) / (1 + LINK(z) * (z + 1)),
        ),
        (
            lambda z: LINK.feedback(0.5, sign=1)(z),
            lambda z: LINK(z) / (1 - 0.5 * LINK(z)),
        ),
        (lambda z: LINK.delayed(0.1)(z), lambda z: LINK(z) * np.exp(-0.1 * z)),
        (lambda z: (np.float64(2) * s)(z), lambda z: 2 * z),
        (lambda z: (+LINK - (-LINK))(z), lambda z: 2 * LINK(z)),
        (lambda z: ((4 * s) ** 0.5)(z), lambda z: 2 * np.sqrt(z)),
    ],
)
def test_algebra_agrees_with_values(made, expected) -> None:  # type: ignore[no-untyped-def]
    z = 1j * W
    np.testing.assert_allclose(made(z), expected(z), rtol=1e-13)


@settings(deadline=None, max_examples=60)
@given(
    a=st.floats(-3, 3),
    b=st.floats(-3, 3),
    x=st.floats(0.01, 100),
    y=st.floats(-3.1, 3.1),
)
def test_powers_are_a_semigroup(a: float, b: float, x: float, y: float) -> None:
    z = x * complex(math.cos(y), math.sin(y))
    assert (s**a * s**b)(z) == pytest.approx((s ** (a + b))(z), rel=1e-11)
    assert (s**a)(z) == pytest.approx(z**a, rel=1e-12)


def test_values_keep_shape_kind_and_sheet() -> None:
    assert isinstance(LINK(2.0), complex)
    assert isinstance(LINK(np.float64(2.0)), complex)
    grid = LINK(1j * W.reshape(5, 1))
    assert grid.shape == (5, 1)
    assert grid.dtype == np.complex128
    assert (s**0.5)(-4.0) == pytest.approx(2j)
    assert LINK(3 - 4j) == pytest.approx(LINK(3 + 4j).conjugate())
    assert LINK(np.array([], dtype=complex)).shape == (0,)


def test_values_at_the_ends() -> None:
    assert LINK(0) == 0
    assert (1 / s)(0) == complex(math.inf)
    assert (100 / (s**1.92 + 100))(0) == 1
    assert LINK(1e200j) == pytest.approx(1.56)
    assert ((s**2 + 1) / (s**2 + 2))(1e300j) == pytest.approx(1)


def test_undamped_link_has_real_values_on_the_axis() -> None:
    values = (100 / (s**2 + 100))(1j * np.array([1.0, 20.0]))
    np.testing.assert_array_equal(values.imag, 0.0)


def test_properties() -> None:
    assert LINK.is_proper
    assert LINK.relative_degree == 0.0
    assert not s.is_proper
    assert (1 / (s**1.92 + 1)).relative_degree == pytest.approx(1.92)
    assert (s - s).relative_degree == math.inf
    assert (LINK.delayed(0.3) + LINK.delayed(0.2)).delay == pytest.approx(0.2)


def test_delays_of_numerator_and_denominator_divide_out() -> None:
    late = (0 * s + 1).delayed(0.2)
    assert LINK.delayed(0.2) / late == LINK
    loop = (2 / s).delayed(0.1).feedback()
    assert [t.delay for t in loop.denominator] == [0.0, 0.1]


@pytest.mark.parametrize(
    ("call", "field"),
    [
        (lambda: Term(math.nan, 1.0), "coefficient"),
        (lambda: Term(1.0, math.inf), "order"),
        (lambda: Term(1.0, 1.0, -0.1), "delay"),
        (lambda: Term(True, 1.0), "coefficient"),
        (lambda: s**math.nan, "exponent"),
        (lambda: s ** "2", "exponent"),  # type: ignore[operator]
        (lambda: (s + 1) ** 0.5, "exponent"),
        (lambda: (-1 * s) ** 0.5, "exponent"),
        (lambda: 1 / (s - s), "denominator"),
        (lambda: FractionalTransferFunction((Term(1, 0),), ()), "denominator"),
        (
            lambda: FractionalTransferFunction((Term(1, 0),), (Term(0, 1),)),
            "denominator",
        ),
        (
            lambda: FractionalTransferFunction(
                (Term(1, 0),), (Term(1, 1), Term(1, -0.5))
            ),
            "denominator",
        ),
        (lambda: FractionalTransferFunction("1", (Term(1, 0),)), "numerator"),  # type: ignore[arg-type]
        (lambda: 1 / LINK.delayed(1.0), "delay"),
        (lambda: LINK.delayed(-1.0), "delay"),
        (lambda: LINK.feedback(sign=0), "sign"),
        (lambda: LINK.feedback("x"), "other"),  # type: ignore[arg-type]
        (lambda: LINK("x"), "s"),  # type: ignore[call-overload]
    ],
)
def test_bad_input_names_the_field(call, field: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(FieldError) as caught:
        call()
    assert caught.value.field == field


TEXTS: list[tuple[Any, str, str, str]] = [
    (-s, "-s", "-s", "-s"),
    (0 * s - 1, "-1*s**0", "-1", "-1"),
    (s**0.5 - 2, "s**0.5 - 2", "s^0.5 - 2", "s^{0.5} - 2"),
    (-2.5 * s**2 + s - 1, "-2.5*s**2 + s - 1", "-2.5 s^2 + s - 1", r"-2.5\,s^{2} + s - 1"),
    ((1 / s).delayed(0.25), "(1*s**0).delayed(0.25)/s", "e^(-0.25 s) / s", r"\frac{e^{-0.25 s}}{s}"),
    ((0 * s + 3).delayed(1.5), "(3*s**0).delayed(1.5)", "3 e^(-1.5 s)", r"3\,e^{-1.5 s}"),
    (1 / (s.delayed(0.1) + 1), "1/((s).delayed(0.1) + 1)", "1 / (s e^(-0.1 s) + 1)",
     r"\frac{1}{s\,e^{-0.1 s} + 1}"),
    (s**1.2345678901234, "s**1.2345678901234", "s^1.23456789", "s^{1.23457}"),
    (12345678 * s, "12345678*s", "1.23457e+07 s", r"1.23457 \cdot 10^{7}\,s"),
    ((s + 1) / (s**2 + 3), "(s + 1)/(s**2 + 3)", "(s + 1) / (s^2 + 3)", r"\frac{s + 1}{s^{2} + 3}"),
    (0 * s, "0*s**0", "0", "0"),
]  # fmt: skip


@pytest.mark.parametrize(("made", "python", "read", "latex"), TEXTS)
def test_a_function_is_written_as_one_would(
    made: Any, python: str, read: str, latex: str
) -> None:
    assert (repr(made), str(made), made.latex()) == (python, read, latex)
    assert made._repr_latex_() == (
        rf"$\displaystyle{latex}$" if latex.startswith(r"\frac") else f"${latex}$"
    )


def test_values_where_powers_leave_the_range_of_doubles() -> None:
    G = (3 * s**4 + s) / (2 * s**4 + s**2 + 5)
    assert G(1e200j) == pytest.approx(1.5, rel=1e-15)
    assert (s / (s**3 + 1))(1e200) == 0.0
    assert ((s**3 + 1) / s)(0) == complex(math.inf)
    # the finite value is the same as in a call of its own
    both = G(np.array([1e-3j, 1e200j]))
    assert both[0] == G(1e-3j)
    assert (s**0.5 + 2)(0) == 2 and (2 + 1 / s**0.5)(0) == complex(math.inf)


def test_gain_at_rest_zeros_and_poles() -> None:
    assert (3 / (s**0.5 + 2)).dcgain() == 1.5
    assert ((2 * s + 6).delayed(0.1) / (s**1.92 + 4)).dcgain() == 1.5
    assert (s**0.5 / (s + 1)).dcgain() == 0.0
    assert sorted(((s + 2) * (s + 3) / s**2.5).zeros().real) == pytest.approx(
        [-3.0, -2.0]
    )
    assert (LINK.delayed(0.3) + LINK).delay == 0.0
    assert (0 * s).delay == 0.0


def test_a_multiple_of_the_denominator_is_a_number_a_power_and_a_delay() -> None:
    D = s**1.3 + 2 * s**0.4 + 7
    assert 3 * D / D == 3
    assert (D * s**0.5) / D == s**0.5
    assert D / (D * s**0.5) == 1 / s**0.5
    assert (D.delayed(0.2)) / D == (0 * s + 1).delayed(0.2)
    assert (s**1.3 + 2 * s**0.4 + 7.0001) / D != 1
    assert (s**1.3 + 2 * s**0.5 + 7) / D != 1


def test_a_function_is_no_exponent() -> None:
    with pytest.raises(TypeError, match="unsupported operand"):
        s**s
    with pytest.raises(TypeError, match="unsupported operand"):
        2 ** (1 / (s + 1))  # type: ignore[operator]


def test_the_sign_and_the_operand_of_feedback() -> None:
    G, H = 2 / (s + 1), 3 / (s + 4)
    assert G.feedback(H) == 2 * (s + 4) / ((s + 1) * (s + 4) + 6)
    assert G.feedback(H, 1) == 2 * (s + 4) / ((s + 1) * (s + 4) - 6)
    for sign in (0, 2, -2):
        with pytest.raises(FieldError, match="negative feedback"):
            G.feedback(H, sign)
