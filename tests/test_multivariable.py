"""Loops with several channels against eigenvalues, Matignon's sectors, rotations and
scalar loops.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import fraclink as fl
from fraclink.errors import FieldError

s = fl.s
ONE = fl.FractionalTransferFunction.power(0.0)


def realised(
    A: NDArray[Any], B: NDArray[Any], C: NDArray[Any], order: float = 1.0
) -> fl.TransferMatrix:
    """C (s^a − A)⁻¹ B as functions, by Faddeev's and Le Verrier's recursion."""
    size, x = len(A), s**order
    adjugate, coefficients, top = np.eye(size), [1.0], []
    for k in range(1, size + 1):
        top.append(C @ adjugate @ B)
        coefficients.append(-float(np.trace(A @ adjugate)) / k)
        adjugate = A @ adjugate + coefficients[-1] * np.eye(size)

    def polynomial(rising: list[float]) -> Any:
        return sum((c * x**k for k, c in enumerate(rising)), 0 * s)

    bottom = polynomial(coefficients[::-1])
    rows, columns = len(C), B.shape[1]
    return fl.TransferMatrix(
        [
            [
                polynomial([float(m[i, k]) for m in top[::-1]]) / bottom
                for k in range(columns)
            ]
            for i in range(rows)
        ]
    )


def random_system(seed: int) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    g = np.random.default_rng(seed)
    size, channels = int(g.integers(2, 5)), int(g.integers(2, 4))
    A = g.normal(size=(size, size))
    A -= (np.linalg.eigvals(A).real.max() + g.uniform(0.05, 1.0)) * np.eye(size)
    return (
        A,
        g.normal(size=(size, channels)),
        g.normal(size=(channels, size)) * g.uniform(0.2, 3.0),
    )


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_closed_loop_poles_and_margin_of_a_state_space(seed: int) -> None:
    A, B, C = random_system(seed)
    known = int((np.linalg.eigvals(A - B @ C).real > 0).sum())

    def response(at: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(
            C @ np.linalg.solve(at[:, None, None] * np.eye(len(A)) - A, B[None])
        )

    found = fl.multivariable_margins(realised(A, B, C))
    assert (found.closed_loop_poles, found.stable) == (known, known == 0)
    ahead = np.eye(len(C)) + response(1j * np.logspace(-4, 4, 20_001))
    grid = float(np.linalg.svd(ahead, compute_uv=False)[:, -1].min())
    assert grid * (1 - 1e-4) < found.singular_value_margin <= grid * (1 + 1e-12)
    modulus = float(np.abs(np.linalg.det(ahead)).min())
    assert modulus * (1 - 1e-4) < found.determinant_margin <= modulus * (1 + 1e-12)
    # A callable knows neither its poles nor what it tends to: at the ends of its range
    # it is 1e-6 away.
    blind = fl.multivariable_margins(response, unstable_poles=0)
    assert blind.closed_loop_poles == known
    assert blind.singular_value_margin == pytest.approx(
        found.singular_value_margin, rel=1e-5
    )
    assert fl.multivariable_margins(response).stable is None


@pytest.mark.slow
@pytest.mark.parametrize("order", [0.6, 1.3, 1.7])
def test_closed_loop_poles_of_a_commensurate_system_lie_in_matignons_sector(
    order: float,
) -> None:
    counts = set()
    for seed in range(6):
        A, B, C = random_system(20 + seed)
        A = A - 3.0 * np.eye(len(A))  # far enough left for the wider sectors
        if (np.abs(np.angle(np.linalg.eigvals(A))) <= 0.5 * math.pi * order).any():
            continue
        closed = np.linalg.eigvals(A - 3.0 * B @ C)
        known = int((np.abs(np.angle(closed)) < 0.5 * math.pi * order).sum())
        found = fl.multivariable_margins(realised(A, B, 3.0 * C, order))
        assert found.closed_loop_poles == known
        counts.add(known)
    assert len(counts) > 1


@pytest.mark.slow
@pytest.mark.parametrize("gain", [0.05, 0.148, 2.0])
def test_a_rotated_diagonal_keeps_the_margins_of_its_channels(gain: float) -> None:
    slow, fast = (
        3 / (s * (0.1 * s + 1)),
        (gain * s**0.65 * 100 / (s**1.92 + 100)).delayed(0.01),
    )
    c, r = math.cos(0.7), math.sin(0.7)
    turn = fl.TransferMatrix([[c, -r], [r, c]])
    back = fl.TransferMatrix([[c, r], [-r, c]])
    found = fl.multivariable_margins(
        turn @ fl.TransferMatrix.diagonal(slow, fast) @ back
    )
    alone = [fl.margins(g) for g in (slow, fast)]
    assert found.stable is all(m.stable for m in alone)
    nearest = min(alone, key=lambda m: m.modulus_margin)
    assert found.singular_value_margin == pytest.approx(
        nearest.modulus_margin, rel=1e-9
    )
    assert found.frequency == pytest.approx(nearest.modulus_frequency, rel=1e-4)


def test_one_channel_is_a_scalar_loop() -> None:
    loop = (10 * s**0.5 / (s**1.9 + 3)).delayed(0.02)
    found, scalar = (
        fl.multivariable_margins(fl.TransferMatrix([[loop]])),
        fl.margins(loop),
    )
    assert found.singular_value_margin == pytest.approx(
        scalar.modulus_margin, rel=1e-12
    )
    assert found.determinant_margin == pytest.approx(scalar.modulus_margin, rel=1e-12)
    assert found.stable is scalar.stable


@pytest.mark.parametrize("coupling", [0.3, 3.0, 4.9, 5.1, -7.0])
def test_undamped_joints_that_share_a_frequency(coupling: float) -> None:
    """det(I + L) has a double pole on the axis; the closed loop is M q̈ + D q̇ + K q =
    0.
    """
    arm = 1 / (s**2 + 4)
    loop = fl.TransferMatrix(
        [[arm * (1 + s), coupling * arm], [coupling * arm, arm * (1 + 2 * s)]]
    )
    stiffness = np.array([[5.0, coupling], [coupling, 5.0]])
    state = np.block(
        [[np.zeros((2, 2)), np.eye(2)], [-stiffness, -np.diag([1.0, 2.0])]]
    )
    known = int((np.linalg.eigvals(state).real > 0).sum())
    assert fl.multivariable_margins(loop).closed_loop_poles == known


@pytest.mark.parametrize(("delay", "poles"), [(0.31, 0), (0.32, 2)])
def test_the_delay_that_a_loop_bears(delay: float, poles: int) -> None:
    """k/s e^(−τs) is stable for kτ < π/2: 0.3142 s at k = 5."""
    loop = fl.TransferMatrix(
        [[(5 / s).delayed(delay), 0.4 / (s + 1)], [0, 1 / (s + 3)]]
    )
    assert fl.multivariable_margins(loop).closed_loop_poles == poles


def test_every_gain_and_phase_within_the_margins_is_borne() -> None:
    A, B, C = random_system(3)
    loop = realised(A, B, 0.3 * C)
    found = fl.multivariable_margins(loop)
    assert found.stable
    low, high = found.gain_margin
    a = found.singular_value_margin
    assert (low, found.phase_margin) == pytest.approx(
        (1 / (1 + a), 2 * math.asin(min(0.5 * a, 1.0)))
    )
    for gains in (
        (low, high),
        (high, low),
        (low, low),
        (min(high, 50.0), min(high, 50.0)),
    ):
        size = len(C)
        changed = loop @ fl.TransferMatrix.diagonal(
            *[gains[k % 2] for k in range(size)]
        )
        assert fl.multivariable_margins(changed).stable


def test_a_pole_that_the_determinant_hides_is_found() -> None:
    """det(I + L) = 1, and yet the integrator stays in the closed loop."""
    found = fl.multivariable_margins(
        fl.TransferMatrix([[1 / s, 1 / s], [-1 / s, -1 / s]])
    )
    assert (found.stable, found.singular_value_margin, found.frequency) == (
        False,
        0.0,
        0.0,
    )
    assert found.determinant_margin == pytest.approx(1.0)


def test_what_cannot_be_decided_is_not_claimed() -> None:
    unstable = fl.TransferMatrix([[3 / (s - 1), 0], [0, 1]])
    assert fl.multivariable_margins(unstable).stable is None
    found = fl.multivariable_margins(unstable, unstable_poles=1)
    assert (found.stable, found.closed_loop_poles) == (True, 0)
    neutral = fl.TransferMatrix([[ONE.delayed(1.0) * 0.5, 0], [0, 1 / s]])
    assert fl.multivariable_margins(neutral, limit=20.0).stable is None
    assert "not decided" in str(fl.multivariable_margins(neutral, limit=20.0))


def test_algebra_is_that_of_the_values() -> None:
    g = fl.TransferMatrix(
        [[1 / (s + 1), s**0.5 / (s + 2)], [2, (1 / s**0.7).delayed(0.1)]]
    )
    h = fl.TransferMatrix([[0.0, 1 / s], [s / (s + 4), -1.0]])
    at = np.array([0.3j, 2.0 + 1j, 40j])
    assert g(at).shape == (3, 2, 2)
    assert g.shape == (2, 2)
    np.testing.assert_allclose((g @ h)(at), g(at) @ h(at), rtol=1e-12)
    np.testing.assert_allclose((g + h)(at), g(at) + h(at), rtol=1e-12)
    np.testing.assert_allclose((g - h)(at), g(at) - h(at), rtol=1e-12)
    np.testing.assert_allclose(
        (2 / s * g)(at), (2 / at)[:, None, None] * g(at), rtol=1e-12
    )
    three = realised(*random_system(1))
    np.testing.assert_allclose(
        three.determinant()(at), np.linalg.det(three(at)), rtol=1e-9
    )
    np.testing.assert_allclose(g.determinant()(at), np.linalg.det(g(at)), rtol=1e-12)
    row = fl.TransferMatrix([[1 / s, 0]])
    assert repr(row) == "TransferMatrix([[1/s, 0]])"
    assert str(row) == "[1 / s,  0]"
    assert (
        row._repr_latex_()
        == r"$\displaystyle\begin{bmatrix}\frac{1}{s} & 0\end{bmatrix}$"
    )


BAD: list[tuple[Any, str]] = [
    (lambda: fl.TransferMatrix([]), "not rows"),
    (lambda: fl.TransferMatrix([[s], [s, s]]), "different lengths"),
    (lambda: fl.TransferMatrix([["s"]]), "neither a transfer function"),  # type: ignore[list-item]
    (lambda: fl.TransferMatrix([[True]]), "neither a transfer function"),
    (lambda: fl.TransferMatrix([[s, s]]) @ fl.TransferMatrix([[s, s]]), "inputs"),
    (lambda: fl.TransferMatrix([[s, s]]) + fl.TransferMatrix([[s]]), "another shape"),
    (lambda: fl.TransferMatrix([[s, s]]).determinant(), "no determinant"),
    (
        lambda: fl.multivariable_margins(fl.TransferMatrix([[1 / s, 1 / s]])),
        "not square",
    ),
    (lambda: fl.multivariable_margins(lambda at: 1 / at), "not one square matrix"),
    (
        lambda: fl.multivariable_margins(fl.TransferMatrix([[1 / s]]), limit=-1.0),
        "limit",
    ),
]


@pytest.mark.parametrize(("call", "match"), BAD)
def test_refusals(call: Any, match: str) -> None:
    with pytest.raises(FieldError, match=match):
        call()


def test_the_four_printed_lines() -> None:
    loop = fl.TransferMatrix([[2 / s, 1 / (s + 1)], [-1 / (s + 1), 4 / s**1.2]])
    found = fl.multivariable_margins(loop)
    w = np.geomspace(0.1, 1e3, 20_001)
    ahead = np.eye(2) + loop(1j * w)
    sigma, modulus = (
        np.linalg.svd(ahead, compute_uv=False)[:, -1],
        np.abs(np.linalg.det(ahead)),
    )
    first, second, third, last = str(found).splitlines()
    assert (
        first
        == f"smallest σ(I + L)   {sigma.min():10.6g} at {found.frequency:.6g} rad/s"
    )
    assert found.frequency == pytest.approx(w[sigma.argmin()], rel=1e-3)
    assert (
        second
        == f"smallest |det|      {modulus.min():10.6g} at {found.determinant_frequency:.6g} rad/s"
    )
    assert found.determinant_frequency == pytest.approx(w[modulus.argmin()], rel=1e-3)
    a = sigma.min()
    phase = math.degrees(2 * math.asin(a / 2))
    assert third == (
        f"tolerated           gain {1 / (1 + a):.4g} … {1 / (1 - a):.4g}, phase ±{phase:.3f}°"
        " in all channels at once"
    )
    assert last == "closed loop         stable"


def test_margins_of_one_and_more_bear_every_larger_gain() -> None:
    def of(margin: float) -> fl.MultivariableMargins:
        return fl.MultivariableMargins(margin, 1.0, margin, 1.0, 0, True)

    assert of(1.0).gain_margin == (0.5, math.inf) and of(
        1.0
    ).phase_margin == pytest.approx(math.pi / 3)
    assert of(0.5).gain_margin == (pytest.approx(1 / 1.5), 2.0)
    assert of(2.0).phase_margin == of(2.5).phase_margin == math.pi


def test_what_is_only_approached_has_no_place_on_the_axis() -> None:
    """σ(I + L) falls to that of I + L(0) from above, or to that of I + L(∞)."""
    slow = fl.multivariable_margins(
        fl.TransferMatrix([[-0.5 / (s + 1), 0], [0, 1 / (s + 2)]])
    )
    assert (slow.singular_value_margin, slow.frequency) == (pytest.approx(0.5), 0.0)
    assert (slow.determinant_margin, slow.determinant_frequency) == (
        pytest.approx(0.75),
        0.0,
    )
    fast = fl.multivariable_margins(
        fl.TransferMatrix([[(1 - 0.4 * s) / (s + 1), 0], [0, 2]])
    )
    assert (fast.singular_value_margin, fast.frequency) == (
        pytest.approx(0.6),
        math.inf,
    )
    assert (fast.determinant_margin, fast.determinant_frequency) == (
        pytest.approx(1.8),
        math.inf,
    )


def test_a_limit_below_the_minimum_does_not_see_it() -> None:
    loop = fl.TransferMatrix([[4 / (s * (s + 1) * (s + 2)), 0], [0.3, 1 / (s + 1)]])
    whole, seen = (
        fl.multivariable_margins(loop),
        fl.multivariable_margins(loop, limit=0.8),
    )
    at = np.eye(2) + loop(np.array([0.8j]))
    assert seen.singular_value_margin == pytest.approx(
        float(np.linalg.svd(at, compute_uv=False)[0, -1]), rel=1e-6
    )
    assert seen.frequency == pytest.approx(0.8) and seen.stable is None
    assert whole.frequency > 1.0 and whole.stable is True
    # A callable is held up to its limit for what there is: its curve is closed there.
    assert (
        fl.multivariable_margins(
            lambda at: loop(at), limit=50.0, unstable_poles=0
        ).stable
        is True
    )


def test_the_determinant_of_six_channels_and_of_no_more() -> None:
    six = fl.TransferMatrix(
        [[(i + 2 * k) % 5 + int(i == k) * s for k in range(6)] for i in range(6)]
    )
    assert six.determinant()(0.7j) == pytest.approx(np.linalg.det(six(0.7j)), rel=1e-12)
    seven = fl.TransferMatrix.diagonal(*[s] * 7)
    with pytest.raises(FieldError, match="6 × 6"):
        seven.determinant()
    assert fl.TransferMatrix.diagonal(s, 2.0, 1 / s).determinant() == 2.0
    assert fl.TransferMatrix([[0, s], [s, 0]]).determinant() == -(s**2)


def test_matrices_keep_out_what_is_none() -> None:
    g = fl.TransferMatrix([[1 / s, 2], [0, s]])
    for junk in (g * 1, 3.0 * g):
        assert isinstance(junk, fl.TransferMatrix)
    for wrong in (lambda: g @ 2, lambda: g + 1, lambda: g - 1, lambda: g * g):
        with pytest.raises(TypeError):
            wrong()  # type: ignore[no-untyped-call]
    for rows in ([], [[]], "s", [s, s], [[s], []], [[None]], [[1j]]):
        with pytest.raises(FieldError) as refused:
            fl.TransferMatrix(rows)  # type: ignore[arg-type]
        assert refused.value.field == "entries" and "g11" in refused.value.remedy
    wide = fl.TransferMatrix([[s, 2, 3]])
    assert wide.shape == (1, 3)
    assert (wide @ fl.TransferMatrix([[1], [s], [0]])).entries == ((3 * s,),)
    with pytest.raises(FieldError, match=r"3 rows"):
        wide @ g
    assert (-g).entries[0] == (-1 / s, -2 + 0 * s)
    assert wide(2j).tolist() == [[2j, 2, 3]]
    assert str(g).splitlines() == ["[1 / s,  2]", "[0,  s]"]


def test_margins_of_one_channel_send_a_matrix_to_those_of_several() -> None:
    with pytest.raises(FieldError, match="Use multivariable_margins"):
        fl.margins(fl.TransferMatrix([[1 / s]]))
