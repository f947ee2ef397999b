"""The compiled recursions against the loops in their documentation, for every remainder
of the block length.
"""

from __future__ import annotations

import threading

import numpy as np
import pytest

from fracsys import _kernels


def system(seed: int, reals: int, pairs: int) -> dict[str, np.ndarray]:
    generator = np.random.default_rng(seed)
    return {
        "log_decays": -np.exp(generator.uniform(-9, 3.4, reals)),
        "gains": generator.normal(size=reals),
        "pole_log_decays": -generator.uniform(0.0, 0.3, pairs)
        + 1j * generator.uniform(0, 3, pairs),
        "pole_gains": generator.normal(size=pairs) + 1j * generator.normal(size=pairs),
        "initial": generator.normal(size=reals + 2 * pairs),
    }


def by_loop(
    u: np.ndarray, direct: float, first: float, modes: dict[str, np.ndarray]
) -> np.ndarray:
    reals = len(modes["gains"])
    x = modes["initial"][:reals].copy()
    z = modes["initial"][reals::2] + 1j * modes["initial"][reals + 1 :: 2]
    decays, poles, y = (
        np.exp(modes["log_decays"]),
        np.exp(modes["pole_log_decays"]),
        np.empty(len(u)),
    )
    for k in range(len(u)):
        y[k] = direct * u[k] + (first * u[k - 1] if k else 0.0)
        y[k] += modes["gains"] @ x + (modes["pole_gains"] @ z).real
        x, z = decays * x + u[k], poles * z + u[k]
    return y


@pytest.mark.parametrize(
    ("reals", "pairs"),
    [(0, 0), (1, 0), (0, 1), (7, 2), (16, 0), (14, 1), (15, 1), (40, 3)],
)
def test_against_the_loop(reals: int, pairs: int) -> None:
    modes = system(reals, reals, pairs)
    u = np.random.default_rng(1).normal(size=70)
    for count in (*range(35), 70):
        output = _kernels.modes_response(u[:count], 0.3, -0.7, **modes)
        np.testing.assert_allclose(
            output, by_loop(u[:count], 0.3, -0.7, modes), rtol=1e-12, atol=1e-12
        )


def test_slow_modes_keep_their_digits_over_a_million_samples() -> None:
    """The free decay of e^(-k·1e-6): d^k by repeated multiplication alone would be
    wrong by 1e-11.
    """
    rate, count = 1.2345678e-6, 1_000_000
    modes = {
        "log_decays": np.array([-rate]),
        "gains": np.ones(1),
        "pole_log_decays": np.array([-rate + 0.1j]),
        "pole_gains": np.zeros(1, complex),
        "initial": np.array([1.0, 1.0, 0.0]),
    }
    output = _kernels.modes_response(np.zeros(count), 0.0, 0.0, **modes)
    exact = np.exp(-rate * np.arange(count))
    assert np.max(np.abs(output / exact - 1)) < 1e-11 / 2


def test_arrays_of_different_length_are_refused() -> None:
    modes = system(0, 4, 1)
    for name in ("gains", "pole_gains", "initial"):
        with pytest.raises(ValueError, match="different length"):
            _kernels.modes_response(
                np.ones(3), 0.0, 0.0, **{**modes, name: modes[name][:-1]}
            )


def test_threads_do_not_share_state() -> None:
    modes, u = system(3, 20, 2), np.random.default_rng(2).normal(size=50_000)
    alone = _kernels.modes_response(u, 0.1, 0.2, **modes)
    results: list[np.ndarray] = []
    threads = [
        threading.Thread(
            target=lambda: results.append(_kernels.modes_response(u, 0.1, 0.2, **modes))
        )
        for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(results) == 4
    for result in results:
        np.testing.assert_array_equal(result, alone)
