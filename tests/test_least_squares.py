"""Least squares from many starts, with projected parameters and profiled intervals,
against closed forms.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from fraclink._identify.least_squares import (
    QUANTILE,
    Interval,
    descend,
    differences,
    interval_end,
    project,
)

Array = NDArray[np.float64]
WIDE = np.full(2, -10.0), np.full(2, 10.0)


def valley(places: Array) -> Array:
    """Rosenbrock's residuals: zero at (1, 1), along a curved valley."""
    x, y = places.T
    return np.stack([10.0 * (y - x**2), 1.0 - x], axis=1)


def test_every_start_ends_at_the_optimum() -> None:
    starts = np.array([[-1.2, 1.0], [3.0, -2.0], [0.9, 0.9]])
    found = descend(valley, starts, *WIDE, iterations=200)
    assert found.places == pytest.approx(np.ones((3, 2)), abs=1e-4)
    assert found.costs.max() < 1e-8
    assert found.evaluations > 3 * 3
    short = descend(valley, starts, *WIDE, iterations=1)
    assert not short.converged.any()
    assert np.all(short.costs <= np.einsum("mr,mr->m", valley(starts), valley(starts)))


def test_a_limit_holds_one_coordinate_and_frees_the_other() -> None:
    """With x <= 0.5 the least of 100 (y − x²)² + (1 − x)² is 0.25, at (0.5, 0.25)."""
    found = descend(
        valley,
        np.array([[-1.2, 1.0]]),
        np.full(2, -10.0),
        np.array([0.5, 10.0]),
        iterations=100,
    )
    assert found.places[0] == pytest.approx([0.5, 0.25], abs=1e-5)
    assert found.costs[0] == pytest.approx(0.25, rel=1e-6)
    assert found.converged[0]
    # From below, and with a start outside of the box.
    found = descend(
        valley,
        np.array([[9.0, 1.0]]),
        np.array([2.0, -10.0]),
        np.array([3.0, 10.0]),
        iterations=100,
    )
    assert found.places[0] == pytest.approx([2.0, 4.0], abs=1e-5)
    assert found.costs[0] == pytest.approx(1.0, rel=1e-6)


def test_a_straight_problem_takes_one_step_and_says_so() -> None:
    matrix, right = (
        np.array([[2.0, 1.0], [1.0, 3.0], [0.5, -1.0]]),
        np.array([1.0, 2.0, 3.0]),
    )
    wanted, rest, *_ = np.linalg.lstsq(matrix, right, rcond=None)
    found = descend(
        lambda x: x @ matrix.T - right, np.zeros((1, 2)), *WIDE, iterations=30
    )
    assert found.places[0] == pytest.approx(wanted, abs=1e-6)
    assert found.costs[0] == pytest.approx(float(rest[0]), rel=1e-9)
    assert found.converged[0]
    assert found.evaluations < 30
    # In sheared coordinates the valley lies along an axis; the end is the same one.
    shear = np.array([[1.0, 0.7], [0.0, 1.0]])
    other = descend(
        lambda x: x @ matrix.T - right,
        np.zeros((1, 2)),
        *WIDE,
        iterations=30,
        shear=shear,
    )
    assert other.places[0] == pytest.approx(wanted, abs=1e-6)


def test_a_start_without_a_value_is_left_where_it_is() -> None:
    def broken(places: Array) -> Array:
        return np.where(places[:, :1] > 5.0, np.nan, valley(places))

    found = descend(broken, np.array([[6.0, 1.0], [0.5, 0.5]]), *WIDE, iterations=100)
    assert (found.places[0].tolist(), found.costs[0]) == ([6.0, 1.0], math.inf)
    assert found.converged.tolist() == [False, True]


def test_nothing_to_move_is_an_end() -> None:
    found = descend(
        lambda x: np.ones((len(x), 3)),
        np.zeros((2, 0)),
        np.zeros(0),
        np.zeros(0),
        iterations=9,
    )
    assert (found.costs.tolist(), found.converged.tolist(), found.evaluations) == (
        [3.0, 3.0],
        [True, True],
        2,
    )


def test_differences_stay_inside_the_box_and_leave_a_domain_backwards() -> None:
    places = np.array([[1.0, 2.0], [10.0, 10.0]])
    found = differences(valley, places, valley(places), *WIDE)
    for (x, _), slopes in zip(places, found, strict=True):
        assert slopes == pytest.approx(
            np.array([[-20.0 * x, -1.0], [10.0, 0.0]]), abs=2e-4
        )

    def root(x: Array) -> Array:
        with np.errstate(invalid="ignore"):
            return np.asarray(np.sqrt(1.0 - x))

    edge = np.array([[1.0 - 1e-7]])  # a step up leaves the domain of the root
    slope = differences(root, edge, root(edge), np.array([-5.0]), np.array([5.0]))
    assert slope[0, 0, 0] < 0.0
    assert np.isfinite(slope).all()
    held = differences(
        root, edge, root(edge), edge[0], edge[0]
    )  # a box without room has no slope
    assert held.tolist() == [[[0.0]]]


# --- linear parameters inside limits ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("low", "high"),
    [((-9, -9), (9, 9)), ((0, -9), (9, 9)), ((-9, -9), (9, 0.1)), ((-9, 0), (-0.5, 9))],
)
def test_two_columns_inside_limits_are_those_of_bounded_least_squares(
    low: tuple[float, float], high: tuple[float, float]
) -> None:
    rng = np.random.default_rng(8)
    columns, measured = rng.normal(size=(5, 2, 12)), rng.normal(size=12)
    left, best = project(measured, columns, np.array(low, float), np.array(high, float))
    for k in range(5):
        wanted = lsq_linear(columns[k].T, measured, (low, high), tol=1e-14)
        assert best[k] == pytest.approx(wanted.x, abs=1e-6)
        assert left[k] == pytest.approx(measured - columns[k].T @ wanted.x, abs=1e-6)


def test_one_column_and_none() -> None:
    measured, column = np.array([1.0, 2.0, 3.0]), np.array([[[1.0, 1.0, 2.0]]])
    left, best = project(measured, column, np.array([-9.0]), np.array([9.0]))
    assert best[0, 0] == pytest.approx(9.0 / 6.0)
    assert left[0] == pytest.approx(measured - 1.5 * column[0, 0])
    assert project(measured, column, np.array([-9.0]), np.array([1.0]))[1][0, 0] == 1.0
    assert project(measured, column, np.array([2.0]), np.array([9.0]))[1][0, 0] == 2.0
    left, best = project(measured, np.zeros((4, 0, 3)), np.zeros(0), np.zeros(0))
    assert left.tolist() == [[1.0, 2.0, 3.0]] * 4
    assert best.shape == (4, 0)


# --- intervals ----------------------------------------------------------------------------------------------


@dataclass
class Curve:
    """A profile whose log-likelihood is known: n ln(cost/least) = height(value − 3)²."""

    bend: float = 0.0
    last: float = math.inf
    samples: int = 200
    least: float = 0.5
    begin: int = 0
    calls: int = 0

    def cost(self, value: float, near: int) -> tuple[float, int]:
        self.calls += 1
        if abs(value - 3.0) > self.last:
            return math.inf, near
        height = 8.0 * abs(value - 3.0) * (1.0 + self.bend * abs(value - 3.0))
        return self.least * math.exp(min(height**2 / self.samples, 700.0)), near + 1


def root(bend: float, inflation: float) -> float:
    """Where 8 x (1 + b x) is the quantile, cut higher by the inflation."""
    height = QUANTILE * math.sqrt(inflation) / 8.0
    return height if bend == 0 else (math.sqrt(1 + 4 * bend * height) - 1) / (2 * bend)


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize(
    ("bend", "inflation"), [(0.0, 1.0), (0.0, 4.0), (5.0, 1.0), (-0.5, 2.0)]
)
@pytest.mark.parametrize("guess", [0.02, 0.25, 3.0])
def test_an_end_is_where_the_likelihood_has_fallen(
    sign: int, bend: float, inflation: float, guess: float
) -> None:
    profile = Curve(bend)
    end, is_open = interval_end(profile, 3.0, sign * guess, sign * math.inf, inflation)
    if bend < 0 and guess > 1:
        return  # the curve has turned back there: no profile of a likelihood
    assert not is_open
    assert end - 3.0 == pytest.approx(sign * root(bend, inflation), rel=5e-3)
    assert profile.calls <= 12


def test_an_end_behind_a_limit_is_open() -> None:
    assert interval_end(Curve(), 3.0, 0.2, 3.1, 1.0) == (3.1, True)
    assert interval_end(Curve(), 3.0, -0.2, 2.9, 1.0) == (2.9, True)
    # A limit beyond the end does not open it.
    end, is_open = interval_end(Curve(), 3.0, 5.0, 3.5, 1.0)
    assert (round(end - 3.0, 3), is_open) == (round(QUANTILE / 8.0, 3), False)


def test_where_nothing_fits_the_interval_ends() -> None:
    """No cost at all beyond 0.1, where the likelihood has hardly fallen: the interval
    ends there.
    """
    end, is_open = interval_end(Curve(last=0.1), 3.0, 0.3, 9.0, 1.0)
    assert not is_open
    assert end == pytest.approx(3.1, abs=1e-6)


def test_an_interval_contains_its_ends() -> None:
    interval = Interval(1.0, 2.0, False, True)
    assert [interval.contains(x) for x in (0.999, 1.0, 1.5, 2.0, 2.001)] == [
        False,
        True,
        True,
        True,
        False,
    ]
