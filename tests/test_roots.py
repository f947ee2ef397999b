"""Zeros of fractional polynomials against polynomial roots, closed forms and 40-digit
Newton iterations.
"""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fraclink.errors import NotConvergedError
from fracsys._exponential import ExponentialSum, count_strip
from fracsys._roots import log_zeros

PI = math.pi


def polished(coefficients: list[float], orders: list[float], z: complex) -> complex:
    """The zero closest to z, to 40 digits."""
    with mpmath.workdps(40):
        a = [mpmath.mpf(c) for c in coefficients]
        nu = [mpmath.mpf(o) for o in orders]
        f = lambda x: mpmath.fsum(  # noqa: E731
            c * mpmath.exp(o * x) for c, o in zip(a, nu, strict=True)
        )
        return complex(mpmath.findroot(f, mpmath.mpc(z)))


@pytest.mark.slow
@given(st.lists(st.floats(0.05, 20) | st.floats(-20, -0.05), min_size=2, max_size=9))
@settings(max_examples=150, deadline=None)
def test_integer_orders_agree_with_polynomial_roots(coefficients: list[float]) -> None:
    degree = len(coefficients) - 1
    expected = np.roots(coefficients)
    found = np.exp(log_zeros(coefficients, range(degree, -1, -1), angle=PI))
    both = np.concatenate(
        [found, found[np.abs(found.imag) > 1e-9 * np.abs(found)].conj()]
    )
    assert len(both) == degree
    for root in expected:  # clusters are accurate to ε^(1/m) in both methods
        assert np.min(np.abs(both - root)) < 2e-4 * max(abs(root), 1e-3)


@pytest.mark.parametrize(
    ("coefficients", "orders", "count"),
    [
        ([1, 10.02**2], [1.92, 0], 1),
        ([1, 2.2, 110.25], [1.37, 0.9, 0], 1),
        ([1, 0.02, 100], [2, 1, 0], 1),
        ([1, 160, 9600, 30, 7e5], [3.92, 2.92, 1.92, 0.65, 0], 2),
        ([1, -3, 1], [math.sqrt(2), math.sqrt(0.5), 0], 2),
        ([1, 2e-5, 100], [1.999, 1, 0], 1),
        ([1e-9, 1, 1e9], [2.5, 1.1, 0], 1),
    ],
)
def test_zeros_are_right_to_rounding(
    coefficients: list[float], orders: list[float], count: int
) -> None:
    z = log_zeros(coefficients, orders, angle=PI)
    assert len(z) == count
    for value in z:
        exact = polished(coefficients, orders, complex(value))
        assert abs(value - exact) < 4e-15 * max(1.0, abs(exact))


def test_two_terms_by_hand_on_many_sheets() -> None:
    z = log_zeros([1.0, 5.0], [0.7, 0.0], angle=30.0)
    expected = [complex(math.log(5) / 0.7, PI * (2 * m + 1) / 0.7) for m in range(3)]
    np.testing.assert_allclose(z, expected, rtol=1e-15)


def test_one_term_has_no_zero() -> None:
    assert log_zeros([3.0], [1.5], angle=PI).size == 0
    assert log_zeros([3.0, -1.0], [1.5, 1.5], angle=PI).size == 0


def test_zeros_on_the_positive_axis_are_real_and_on_the_cut_exactly_there() -> None:
    z = log_zeros([1, -3, 2], [2, 1, 0], angle=PI)
    assert np.all(z.imag == 0.0)
    np.testing.assert_allclose(np.exp(z.real), [1, 2], rtol=1e-15)
    # (s + 1)(√s + 1): −1 lies on the cut, and the zero of √s + 1 on the next sheet.
    z = log_zeros([1, 1, 1, 1], [1.5, 1, 0.5, 0], angle=PI)
    assert z.tolist() == [complex(z[0].real, PI)]
    assert abs(z[0].real) < 1e-15


@pytest.mark.parametrize("multiplicity", [2, 3, 4])
@pytest.mark.parametrize(("order", "constant"), [(1.0, 2.0), (1.1, 1.0), (1.92, 100.0)])
def test_multiple_zeros_stand_together(
    multiplicity: int, order: float, constant: float
) -> None:
    powers = np.arange(multiplicity + 1)
    coefficients = [
        math.comb(multiplicity, int(k)) * constant ** (multiplicity - k) for k in powers
    ]
    z = log_zeros(coefficients, order * powers, angle=PI)
    exact = complex(math.log(constant) / order, PI / order)
    assert len(z) == multiplicity
    assert len(set(z.tolist())) == 1
    assert abs(z[0] - exact) < 1e-13


@pytest.mark.parametrize("multiplicity", [5, 6, 7, 8])
def test_zeros_of_high_multiplicity_are_counted_and_found(multiplicity: int) -> None:
    # Rounding moves the points of an eightfold zero by ε^(1/8), a hundredth of its
    # modulus or more.
    powers = np.arange(multiplicity + 1)
    coefficients = [
        math.comb(multiplicity, int(k)) * 3.0 ** (multiplicity - k) for k in powers
    ]
    z = log_zeros(coefficients, 1.5 * powers, angle=PI)
    assert len(z) == multiplicity
    np.testing.assert_allclose(
        z, complex(math.log(3.0) / 1.5, PI / 1.5), rtol=0, atol=1e-12
    )


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_cluster_of_real_zeros_is_found_whole(sign: float) -> None:
    # Distinct zeros, so none is multiple; rounding moves each off the axis by 1e-11,
    # which must not lose any.
    wanted = sign * np.array([1.0, 1.02, 1.05, 1.08])
    z = log_zeros(np.poly(wanted), [4, 3, 2, 1, 0], angle=PI)
    np.testing.assert_allclose(
        np.sort(sign * np.exp(z.real)), np.sort(wanted), rtol=1e-8
    )


@pytest.mark.parametrize("order", [1.0, 0.83, 1.7])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("gap", [1.0, 0.1, 1 / 64])
def test_double_zeros_close_to_one_another_are_found_twice_each(
    sign: float, gap: float, order: float
) -> None:
    """Each alone is known to √ε; the closer the two, the less."""
    double = sign * np.array([1.0625, 1.0625 + gap])
    exact = (np.log(double.astype(complex)) / order).repeat(2)
    z = log_zeros(
        np.poly(double.repeat(2)), order * np.arange(4, -1, -1), angle=PI / order
    )
    np.testing.assert_allclose(np.sort(z.real), exact.real, rtol=0, atol=1e-8)
    np.testing.assert_array_equal(z.imag, exact.imag)


@pytest.mark.parametrize("apart", [1e-3, 1e-5, 1e-7])
def test_close_pairs_of_conjugates_keep_to_their_number(apart: float) -> None:
    centre = np.array([1.0625, 1.078125])
    pairs = np.concatenate([centre + 1j * apart, centre - 1j * apart])
    z = log_zeros(np.poly(pairs).real, [4, 3, 2, 1, 0], angle=PI)
    assert np.sum(np.where(z.imag == 0, 1, 2)) == 4
    np.testing.assert_allclose(z.imag, apart, rtol=1, atol=1e-5)


def test_close_zeros_stay_apart() -> None:
    # (s + 1)(s + 1.001): a cluster by distance, but two simple zeros.
    z = log_zeros([1, 2.001, 1.001], [2, 1, 0], angle=PI)
    np.testing.assert_allclose(-np.exp(z.real), [-1, -1.001], rtol=1e-11)


def random_sum(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 8))
    orders = np.sort(rng.uniform(0, rng.uniform(1, 6), n))
    coefficients = rng.normal(size=n) * 10.0 ** rng.uniform(-4, 4, n)
    return (np.abs(coefficients) if seed % 3 == 0 else coefficients), orders


# Of nearly equal orders: their zeros lie a hundred e-folds apart.
FAR = [
    ([-1.02, 0.82, 0.65, 0.52, 0.84], [0.0, 2.644, 4.233, 4.862, 4.869]),
    ([0.6, -0.98, -1.26, -0.34, 1.36, -1.82], [0.0, 2.836, 3.593, 5.587, 7.691, 7.7]),
    ([-1.12, -564.2, 753.7], [0.0, 2.294, 2.3976]),
]


@pytest.mark.parametrize(
    ("coefficients", "orders"), [*map(random_sum, range(100, 140)), *FAR]
)
def test_count_and_residues(coefficients: list[float], orders: list[float]) -> None:
    terms = ExponentialSum.of(coefficients, orders)
    z = log_zeros(coefficients, orders, angle=1.5 * PI)
    if z.size:
        values, moduli = terms.derivatives(z, 1)
        assert np.max(np.abs(values[0]) / moduli[0]) < 1e-13
    # the count in the strip against the zeros found, with their conjugates
    for angle in (
        0.7,
        1.9,
        3.3,
    ):
        inside = z[z.imag < angle]
        assert count_strip(terms, angle) == 2 * len(inside) - np.sum(inside.imag == 0)


@pytest.mark.slow
@given(st.floats(0.3, 3.0), st.floats(0.02, 50.0))
@settings(max_examples=40, deadline=None)
def test_homothety(power: float, scale: float) -> None:
    """Zeros of D(s/c) are c times those of D; orders times p divide ln s by p."""
    coefficients, orders = np.array([1.0, 0.3, 2.0]), np.array([1.9, 0.8, 0.0])
    z = log_zeros(coefficients, orders, angle=PI)
    moved = log_zeros(coefficients * scale**-orders, orders, angle=PI)
    np.testing.assert_allclose(moved, z + math.log(scale), rtol=0, atol=1e-13)
    wide = log_zeros(coefficients, orders * power, angle=PI / power)
    np.testing.assert_allclose(wide * power, z, rtol=0, atol=1e-12)


def test_conjugate_pair_close_to_the_axis_is_resolved() -> None:
    """A double real zero split by 1e-9 is counted in the right half plane and not on
    the axis.
    """
    z = log_zeros([1.0, -2.0, 1.0 + 1e-10], [2, 1, 0], angle=PI)
    assert len(z) == 1
    assert z[0].imag == pytest.approx(1e-5, rel=1e-4)


@pytest.mark.slow
def test_thousands_of_zeros_are_refused() -> None:
    with pytest.raises(NotConvergedError):
        log_zeros([1.0, 1.0, 1.0], [30_000.0, 10.0, 0.0], angle=PI)


def test_a_zero_on_the_counted_edge_is_an_error_and_not_a_guess() -> None:
    with pytest.raises(NotConvergedError):
        count_strip(ExponentialSum.of([1.0, 1.0], [1.0, 0.0]), PI)
