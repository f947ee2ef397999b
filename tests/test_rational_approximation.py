"""Oustaloup's filter against its formula, and the minimax rational function against
Oustaloup's filter.
"""

from __future__ import annotations

import math
from dataclasses import replace

import control
import numpy as np
import pytest

from fraclink.errors import FieldError
from fracsys import FractionalTransferFunction, RationalApproximation, approximate, s

BAND = (1e-2, 700.0)


def filter_of(
    fraction: float, points: np.ndarray, band: tuple[float, float], n: int
) -> np.ndarray:
    """Oustaloup's product for s^fraction, written out."""
    value = np.full(points.shape, band[1] ** fraction, dtype=complex)
    for k in range(n):
        up = band[0] * (band[1] / band[0]) ** ((k + 0.5 - 0.5 * fraction) / n)
        down = band[0] * (band[1] / band[0]) ** ((k + 0.5 + 0.5 * fraction) / n)
        value *= (points + up) / (points + down)
    return value


def substituted(
    system: FractionalTransferFunction, points: np.ndarray, n: int
) -> np.ndarray:
    sides = []
    for terms in (system.numerator, system.denominator):
        total = np.zeros(points.shape, dtype=complex)
        for t in terms:
            whole = math.floor(t.order)
            rest = t.order - whole
            power = filter_of(rest, points, BAND, n) if rest else 1.0
            total += t.coefficient * points**whole * power
        sides.append(total)
    return sides[0] / sides[1]


@pytest.mark.parametrize(
    "system",
    [
        s**0.65,
        1 / s**0.4,
        1.56 * s**1.92 / (s**1.92 + 100),
        100 / (s**1.92 + 100),
        s**0.65 / (1 + 0.16 * s) ** 2,
        (s + 3) / (s**2 + 2 * s**1.3 + 3 * s**0.5 + 4),
        1 / (s**0.5 + 2 * s**0.3 + 1),
        1 / (s**2.7 + 2 * s**1.7 + s**0.7),
    ],
)
@pytest.mark.parametrize("order", [1, 4, 9])
def test_oustaloup_is_the_product_formula(
    system: FractionalTransferFunction, order: int
) -> None:
    made = approximate(system, BAND, order)
    w = np.geomspace(1e-3, 1e4, 301)
    np.testing.assert_allclose(
        made(1j * w), substituted(system, 1j * w, order), rtol=2e-6
    )


def test_known_error_of_the_best_oustaloup_filter() -> None:
    """Band 1e-3 … 1e5 and N = 7 (15 pairs): 0.9 % on the link between 0.1 and 1000
    rad/s.
    """
    link = 1.56 * s**1.92 / (s**1.92 + 10.02**2)
    made = approximate(link, (1e-3, 1e5), 15)
    w = np.geomspace(0.1, 1000, 2000)
    error = np.max(np.abs(made(1j * w) / link(1j * w) - 1))
    assert 0.005 < error < 0.02
    assert made.order == 16


@pytest.mark.slow
@pytest.mark.parametrize(
    "system",
    [
        s**0.65,
        1 / s**0.4,
        100 / (s**1.92 + 100),
        1.56 * s**1.92 / (s**1.92 + 100),
        1 / (s**0.5 + 2 * s**0.3 + 1),
    ],
)
def test_minimax_beats_oustaloup_at_the_same_order(
    system: FractionalTransferFunction,
) -> None:
    usual = approximate(system, BAND, 5)
    best = approximate(system, BAND, 5, method="minimax")
    assert best.order == 5 <= usual.order
    assert best.error_db < 0.7 * usual.error_db
    assert best.error_deg < 0.35 * usual.error_deg
    assert np.all(best.poles.real < 0)


@pytest.mark.parametrize(
    "made",
    [
        approximate(s**0.65 / (1 + 0.16 * s) ** 2, BAND, 5),
        approximate(100 / (s**1.92 + 100), BAND, 4, method="minimax"),
    ],
)
def test_the_state_space_is_the_same_function(made: RationalApproximation) -> None:
    points = 1j * np.geomspace(0.01, 1e3, 50)
    a, b, c, d = made.state_space()
    assert a.shape == (made.order, made.order) and a.dtype == float
    value = [
        (c @ np.linalg.solve(p * np.eye(len(a)) - a, b) + d).item() for p in points
    ]
    np.testing.assert_allclose(value, made(points), rtol=1e-7)
    system = control.ss(a, b, c, d)
    np.testing.assert_allclose(system(points[20]), made(points[20]), rtol=1e-7)


@pytest.mark.slow
def test_reported_error_is_the_error() -> None:
    system = 1 / (s**0.5 + 1)
    made = approximate(system, BAND, 4, method="minimax")
    w = np.geomspace(*BAND, 5003)
    ratio = made(1j * w) / system(1j * w)
    assert made.error_db == pytest.approx(
        np.max(np.abs(20 * np.log10(np.abs(ratio)))), rel=0.01
    )
    assert made.error_deg == pytest.approx(
        np.max(np.abs(np.degrees(np.angle(ratio)))), rel=0.01
    )


@pytest.mark.parametrize(
    ("system", "options", "field"),
    [
        (s**0.5, {"method": "matsuda"}, "method"),
        (s**0.5, {"order": 0}, "order"),
        (s**0.5, {"order": 41}, "order"),
        (s**0.5, {"order": 13, "method": "minimax"}, "order"),
        (s**0.5, {"band": (1.0, 0.1)}, "band"),
        (s**0.5, {"band": (1.0, math.inf)}, "band[1]"),
        (s**0.5, {"band": (1.0, 10**400)}, "band[1]"),
        (s**0.5, {"band": ("1", 10.0)}, "band[0]"),
        (s**0.5, {"band": (1.0,)}, "band"),
        (s**0.5, {"band": 10.0}, "band"),
        ((1 / (s + 1)).delayed(0.1), {}, "system"),
        (s**1.65, {}, "system"),
        (1 / (s**0.5 - 1), {"method": "minimax"}, "system"),
    ],
)
def test_bad_input(
    system: FractionalTransferFunction, options: dict[str, object], field: str
) -> None:
    arguments = {"band": (0.1, 100.0), "order": 3, **options}
    with pytest.raises(FieldError) as caught:
        approximate(system, **arguments)  # type: ignore[arg-type]
    assert caught.value.field == field


def test_orders_at_their_bounds() -> None:
    assert approximate(s**0.5, (1.0, 100.0), 40).order == 40
    assert approximate(s**0.5, (1.0, 100.0), 1).order == 1
    assert (
        len(approximate(s**0.99, (1.0, 10.0), 2).zeros) == 2
    )  # improper by less than one order
    with pytest.raises(FieldError, match="> -1"):
        approximate(s**1.5 / (s**0.5 + 1), (1.0, 10.0), 2)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5])
def test_sections_in_series_are_the_product_of_their_roots(count: int) -> None:
    """Real roots and pairs, odd and even in number, with fewer zeros than poles."""
    rng = np.random.default_rng(count)
    for pairs in range(count // 2 + 1):
        poles = np.concatenate(
            [-rng.uniform(0.1, 50, count - 2 * pairs), np.zeros(0)]
        ).astype(complex)
        for _ in range(pairs):
            p = complex(-rng.uniform(0.1, 5), rng.uniform(1, 30))
            poles = np.append(poles, [p, p.conjugate()])
        for missing in range(count + 1):
            zeros = -rng.uniform(0.1, 50, count - missing).astype(complex)
            made = RationalApproximation(zeros, poles, 2.5, (1.0, 2.0), "by hand")
            a, b, c, d = made.state_space()
            assert a.shape == (count, count) and d[0, 0] == (
                2.5 if not missing else 0.0
            )
            for z in (0.3j, 7.0 + 2j):
                value = (c @ np.linalg.solve(z * np.eye(count) - a, b) + d).item()
                assert value == pytest.approx(
                    2.5 * np.prod(z - zeros) / np.prod(z - poles), rel=1e-9
                )


def test_zero_has_no_relative_error_and_is_refused() -> None:
    for method in ("oustaloup", "minimax"):
        with pytest.raises(FieldError, match="zero at every frequency") as refused:
            approximate(0 * s, (0.1, 10.0), 3, method=method)  # type: ignore[arg-type]
        assert refused.value.field == "system"


BAND = (0.05, 200.0)
GRID = np.geomspace(*BAND, 4000)


def _worst(made: RationalApproximation, system: FractionalTransferFunction) -> float:
    """The largest error in units of 0.1 dB and 0.5°: the norm that the minimax fit
    reduces.
    """
    error = made(1j * GRID) / system(1j * GRID) - 1.0
    decibels = 20.0 / math.log(10.0) * np.abs(error.real).max()
    return float(max(decibels / 0.1, np.degrees(np.abs(error.imag).max()) / 0.5))


def _moved(made: RationalApproximation, step: float) -> list[RationalApproximation]:
    """The same with the gain, or one root and its conjugate, changed by a fraction
    `step`.
    """
    others = [replace(made, gain=made.gain * (1.0 + step))]
    for name in ("zeros", "poles"):
        roots = getattr(made, name)
        for root in roots[roots.imag >= 0.0]:
            # A pair can be rotated as well as scaled.
            for by in (step, 1j * step)[: 1 + (root.imag > 0.0)]:
                moved = np.where(roots == root, roots * (1.0 + by), roots)
                pair = (roots == root.conjugate()) & (roots != root)
                moved = np.where(pair, roots * (1.0 + np.conj(by)), moved)
                others.append(replace(made, **{name: moved}))
    return others


@pytest.mark.parametrize("order", [3, 5])
def test_no_root_lowers_the_worst_error_of_the_minimax_fit(order: int) -> None:
    system = s**0.5 / (1.0 + s**1.8 / 9.0)
    made = approximate(system, BAND, order, method="minimax")
    reached = _worst(made, system)
    lowest = min(
        _worst(each, system) for step in (3e-3, -3e-3) for each in _moved(made, step)
    )
    # The grid of the fit is coarser than this one: the maxima between its points are
    # higher by up to a percent.
    assert lowest > 0.99 * reached


def test_a_rational_of_the_same_order_is_found_as_it_is() -> None:
    exact = (s + 0.3) * (s + 8.0) / ((s + 1.0) * (s**2 + 2.0 * s + 40.0))
    made = approximate(exact, BAND, 3, method="minimax")
    assert _worst(made, exact) < 1e-3
    assert np.sort(made.zeros.real)[-2:] == pytest.approx([-8.0, -0.3], rel=1e-3)
