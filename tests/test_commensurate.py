"""Base orders, and the state space against Mittag-Leffler functions of scalars and of
matrices.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import mpmath
import numpy as np
import pytest

import fraclink as fl

s = fl.s


@pytest.mark.parametrize(
    ("system", "order"),
    [
        (1 / (s**1.5 + s**0.9 + 1), Fraction(3, 10)),
        (1 / (s**1.92 + 100), Fraction(48, 25)),
        (s**0.65 / (s**1.92 + 1), Fraction(1, 100)),
        (1 / (s ** (1 / 3) + s**0.5 + 1), Fraction(1, 6)),
        (1 / (s ** (0.1 + 0.2) + 1), Fraction(3, 10)),  # 0.30000000000000004
        (1 / (s**3 + s + 1), Fraction(1)),
        (1 / (s**1.123457 + 1), Fraction(1123457, 10**6)),
        (2.5 + 0 * s, Fraction(1)),
        ((1 / (s**0.8 + 1)).delayed(0.1), Fraction(4, 5)),
        (1 / (s ** math.sqrt(2) + s + 1), None),
        (1 / (s**math.pi + 1), None),
        (1 / (s**1.1234567 + 1), None),
    ],
)
def test_commensurate_order(
    system: fl.FractionalTransferFunction, order: Fraction | None
) -> None:
    assert fl.commensurate_order(system) == order


def of_matrix(matrix: Any, times: Any, q: float, beta: float) -> np.ndarray:
    """E_{q,β}(A t^q) by its series, at each time; mpmath with digits for its largest
    term.
    """
    a, values = mpmath.matrix(np.asarray(matrix).tolist()), []
    with mpmath.workdps(60):
        for t in times:
            x, power, total, k = (
                a * mpmath.mpf(t) ** mpmath.mpf(q),
                mpmath.eye(len(matrix)),
                0 * a,
                0,
            )
            while (
                k < 400 and mpmath.norm(power, 1) * mpmath.rgamma(q * k + beta) > 1e-30
            ):
                total, power, k = (
                    total + power * mpmath.rgamma(mpmath.mpf(q) * k + beta),
                    power * x,
                    k + 1,
                )
            values.append(np.array(total.tolist(), dtype=float))
    return np.array(values)


@pytest.mark.parametrize("q", [0.5, 0.8, 1.0, 1.4, 1.9])
def test_scalar_response_is_mittag_lefflers(q: float) -> None:
    t = np.arange(80) * 0.1
    system = fl.FractionalStateSpace([[-2.0]], [[3.0]], [[1.0]], [[0.5]], q)  # type: ignore[arg-type]
    rate = [0.4] if q > 1 else None
    result = system.response(np.ones(80), 0.1, initial=[1.7], initial_rate=rate)
    z = -2 * t**q
    exact = (
        1.7 * fl.mittag_leffler(z, q)
        + 3 * t**q * fl.mittag_leffler(z, q, beta=q + 1)
        + 0.5
    )
    exact += 0.4 * t * fl.mittag_leffler(z, q, beta=2.0) if q > 1 else 0
    assert result.output == pytest.approx(exact, abs=1e-12)
    assert np.max(np.abs(result.output - exact)) <= result.error_estimate + 1e-13


@pytest.mark.slow
@pytest.mark.parametrize(
    "matrix",
    [
        [[0.0, 1.0], [-4.0, -1.0]],
        [[-1.0, 1.0, 0.0], [0.0, -1.0, 1.0], [0.0, 0.0, -1.0]],  # defective
        [[-0.5, 0.3, 0.1], [0.2, -1.0, 0.7], [-0.4, 0.1, -2.0]],
    ],
)
@pytest.mark.parametrize("q", [0.6, 1.3])
def test_free_and_forced_response_of_matrices(
    matrix: list[list[float]], q: float
) -> None:
    n, t = len(matrix), np.arange(6) * 0.3
    rng = np.random.default_rng(2)
    b, c, d = rng.normal(size=(n, 2)), rng.normal(size=(2, n)), rng.normal(size=(2, 2))
    start, rate = rng.normal(size=n), rng.normal(size=n) * (q > 1)
    system = fl.FractionalStateSpace(matrix, b, c, d, q)  # type: ignore[arg-type]
    u = np.tile([1.0, -0.5], (6, 1))
    result = system.response(
        u, 0.3, initial=start, initial_rate=rate if q > 1 else None
    )
    powers = t[:, None, None]
    states = (
        of_matrix(matrix, t, q, 1.0) @ start
        + (powers * of_matrix(matrix, t, q, 2.0)) @ rate
    )
    states += (powers**q * of_matrix(matrix, t, q, q + 1)) @ b @ u[0]
    exact = states @ c.T + u @ d.T
    assert result.output.shape == (6, 2)
    assert result.output == pytest.approx(exact, abs=1e-11)
    assert np.max(np.abs(result.output - exact)) <= result.error_estimate + 1e-13


def test_initial_conditions_of_order_one_are_the_matrix_exponential() -> None:
    a = np.array([[0.0, 1.0], [-9.0, -0.6]])
    system = fl.FractionalStateSpace(
        a, np.zeros((2, 1)), np.eye(2), np.zeros((2, 1)), 1.0
    )
    result = system.response(np.zeros(50), 0.1, initial=[1.0, 0.0])
    w, v = np.linalg.eig(a)
    exact = [
        (v * np.exp(w * 0.1 * k) @ np.linalg.inv(v)).real @ [1.0, 0.0]
        for k in range(50)
    ]
    assert result.output == pytest.approx(np.array(exact), abs=1e-12)


@pytest.mark.slow
def test_random_matrices_agree_with_their_transfer_functions_and_with_matignon() -> (
    None
):
    rng, verdicts = np.random.default_rng(11), set()
    for _ in range(60):
        n, q = int(rng.integers(1, 6)), float(rng.uniform(0.2, 1.95))
        a, b, c, d = (
            rng.normal(size=shape) for shape in ((n, n), (n, 2), (2, n), (2, 2))
        )
        system = fl.FractionalStateSpace(a, b, c, d, q)
        z = complex(*rng.uniform(0.1, 2, 2))
        exact = c @ np.linalg.solve(z**q * np.eye(n) - a, b) + d
        for i, j in np.ndindex(2, 2):
            value = system.transfer_function(output=i, input=j)(z)
            assert value == pytest.approx(exact[i, j], rel=1e-9)
        stable = bool(np.all(np.abs(np.angle(np.linalg.eigvals(a))) > q * math.pi / 2))
        assert system.is_stable().stable is stable
        verdicts.add(stable)
    assert verdicts == {True, False}


@pytest.mark.parametrize(
    "system",
    [
        1 / (s**1.92 + 100),
        (s**0.5 + 3) / (s + 2 * s**0.5 + 5),
        (2 * s**2 + 1) / (s**2 + 3 * s**0.5 + 1),
        1 / (s**4 + s**2 + 1),
        1 / s**2.5,
        3 + 0 * s,
    ],
)
def test_there_and_back(system: fl.FractionalTransferFunction) -> None:
    made = fl.FractionalStateSpace.from_transfer_function(system)
    assert made.transfer_function() == system
    assert 0 < made.order < 2
    u = np.random.default_rng(1).normal(size=40)
    wanted = fl.time_response(system, u, 0.05).output
    assert made.response(u, 0.05).output == pytest.approx(wanted, abs=1e-12)
    halved = fl.FractionalStateSpace.from_transfer_function(
        system, order=made.order / 2
    )
    assert len(halved.A) == 2 * len(made.A)
    assert halved.transfer_function()(1 + 2j) == pytest.approx(
        system(1 + 2j), rel=1e-12
    )


def test_an_unobservable_mode_is_not_forgotten() -> None:
    system = fl.FractionalStateSpace(
        np.diag([-1.0, 2.0]),
        np.ones((2, 1)),
        np.array([[1.0, 0.0]]),
        np.zeros((1, 1)),
        0.5,
    )
    assert fl.is_stable(system.transfer_function())
    assert not system.is_stable() and "Re s > 0" in system.is_stable().reason
    integrator = fl.FractionalStateSpace(
        np.zeros((1, 1)), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1)), 0.5
    )
    assert integrator.is_stable().integrators == 0.5


ONE = {"A": [[-1.0]], "B": [[1.0]], "C": [[1.0]], "D": [[0.0]], "order": 0.5}


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"order": 2.0}, "order"),
        ({"order": 0.0}, "order"),
        ({"B": [[1.0], [1.0]]}, "B"),
        ({"C": [[1.0, 1.0]]}, "C"),
        ({"A": [[1.0, 2.0]]}, "A"),
        ({"A": [[math.nan]]}, "A"),
        ({"A": np.eye(13), "B": np.ones((13, 1)), "C": np.ones((1, 13))}, "A"),
    ],
)
def test_matrices_that_do_not_fit(change: dict[str, Any], field: str) -> None:
    with pytest.raises(fl.errors.FieldError) as refused:
        fl.FractionalStateSpace(**{**ONE, **change})
    assert refused.value.field == field and refused.value.remedy


@pytest.mark.parametrize(
    ("system", "order", "field"),
    [
        ((1 / (s + 1)).delayed(0.1), None, "system"),
        (s**1.5, None, "system"),
        (1 / (s**math.pi + 1), None, "system"),
        (s**0.65 / (s**1.92 + 1), None, "system"),  # 192 states
        (1 / (s**1.5 + 1), 1.0, "order"),
        (1 / (s**4 + 1), 2.0, "order"),
    ],
)
def test_systems_without_a_state_space(
    system: fl.FractionalTransferFunction, order: float | None, field: str
) -> None:
    with pytest.raises(fl.errors.FieldError) as refused:
        fl.FractionalStateSpace.from_transfer_function(system, order=order)
    assert refused.value.field == field and refused.value.remedy


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"initial": [1.0, 2.0]}, "initial"),
        ({"initial_rate": [1.0]}, "initial_rate"),
        ({"u": np.ones((5, 2))}, "u"),
        ({"u": np.ones((5, 1, 1))}, "u"),
        ({"period": -1.0}, "period"),
    ],
)
def test_requests_that_do_not_fit(options: dict[str, Any], field: str) -> None:
    with pytest.raises(fl.errors.FieldError) as refused:
        fl.FractionalStateSpace(**ONE).response(
            **{"u": np.ones(5), "period": 0.1, **options}
        )  # type: ignore[arg-type]
    assert refused.value.field == field
    with pytest.raises(fl.errors.FieldError, match="output"):
        fl.FractionalStateSpace(**ONE).transfer_function(output=1)  # type: ignore[arg-type]
