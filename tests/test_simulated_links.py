"""The recursions of simulated links, one and many, against the exact step response."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import fracsys
from fraclink import LinkModel
from fraclink._simulate.links import LinkWeights, batch_links, link_weights
from fraclink.errors import FieldError

PERIOD, SPAN, POWERS = 0.004, 6.0, 6
STIFF = np.array([60.0, 123.1, 400.0])
ENDS = np.array([0, 1, 7, 80, 1499])
Real = NDArray[np.float64]


def answers(links: LinkWeights, row: int, count: int) -> Real:
    """Tip after each of `count` periods of a motor that moves as xʲ in the first and
    stands then, by the recursions of loop.h.
    """
    decay, pair = links.decay[row], links.pair[row]
    tip = np.zeros((POWERS, count))
    x = np.zeros((POWERS, len(decay)))
    z = np.zeros((POWERS, len(pair)), dtype=complex)
    moving, standing = np.eye(POWERS), np.tile(np.eye(POWERS)[0], (POWERS, 1))
    for k in range(count):
        q = standing if k else moving
        x = decay * x + q @ links.weight[row]
        z = pair * z + q @ links.pair_weight[row]
        tip[:, k] = q @ links.first[row] + x.sum(axis=1) + z.sum(axis=1).real
    return tip


def exact(model: LinkModel) -> Iterator[tuple[int, Real]]:
    """Yield each power j with the tip at ENDS: j ∫ x^(j − 1) S(t − xT) dx by Gauss's
    rule, with the step response S computed by fracsys.
    """
    nodes, sizes = np.polynomial.legendre.leggauss(40)
    # 1 − x = u⁸, as S begins like a fractional power
    u = 0.5 * (1.0 + nodes)
    x, sizes = 1.0 - u**8, 0.5 * sizes * 8.0 * u**7
    times = (ENDS[:, None] + u**8) * PERIOD
    steps = fracsys.step_response(model.tip(), times.ravel()).output
    for j in range(1, POWERS):
        yield j, steps.reshape(times.shape) @ (sizes * j * x ** (j - 1))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("order", "damping", "damping_order"),
    [(order, 0.0, 1.0) for order in (1.5, 1.9, 1.92, 1.94, 2.0)]
    + [(2.0, 0.3, 1.0), (2.0, 9.0, 1.0), (2.0, 0.5, 0.8), (2.0, 5.0, 0.5)]
    + [(2.0, 13.0, 0.9), (2.0, 4.0, 1.3), (2.0, 0.05, 1.9), (1.9, 0.5, 0.8)]
    # Overdamped: two real poles for λ = 2 and α = 1, of which the softest of the three
    # links alone has them at 22; poles close to the cut and beyond it otherwise.
    + [(2.0, 22.0, 1.0), (2.0, 60.0, 1.0), (2.0, 40.0, 0.9), (1.9, 30.0, 1.0)]
    + [(1.7, 20.0, 0.8), (1.7, 60.0, 0.8)],
)
def test_links_answer_powers_of_time_as_their_step_response_says(
    order: float, damping: float, damping_order: float
) -> None:
    model = LinkModel(
        1.56, 11.0, order=order, damping=damping, damping_order=damping_order
    )
    many = batch_links(
        model, STIFF, np.full(3, order), np.full(3, damping), PERIOD, SPAN
    )
    for row, stiff in enumerate(STIFF):
        own = replace(model, natural_frequency=math.sqrt(stiff))
        alone = answers(link_weights(own, PERIOD, SPAN), 0, ENDS[-1] + 1)[:, ENDS]
        together = answers(many, row, ENDS[-1] + 1)[:, ENDS]
        for j, wanted in exact(own):
            assert np.abs(alone[j] - wanted).max() < 5e-9
            assert np.abs(together[j] - wanted).max() < 8e-7


@pytest.mark.slow
@pytest.mark.parametrize("relative", [-1e-3, -1e-7, 0.0, 1e-7, 1e-5])
def test_a_link_damped_critically_is_as_exact_as_a_move_has_to_be(
    relative: float,
) -> None:
    """Its two poles are one, and each of their residues is infinite."""
    model = LinkModel(1.56, 11.0, order=2.0, damping=22.0 * (1.0 + relative))
    tip = answers(link_weights(model, PERIOD, SPAN), 0, 1500)
    w, t = 11.0, PERIOD * np.arange(1, 1501)
    # of the critical link, which differs from its neighbours by less than their distance
    step = 1.0 - np.exp(-w * t) * (1.0 - w * t)
    assert np.abs(tip[0] - step).max() < 1e-6 + 0.6 * abs(relative)


def test_a_link_too_fast_for_the_period_is_refused() -> None:
    with pytest.raises(FieldError, match="period"):
        link_weights(LinkModel(1.0, 3000.0, order=1.92), PERIOD, 1.0)
