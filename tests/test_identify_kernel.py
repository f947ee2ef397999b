"""The identification kernel against an independent solution, and its derivatives."""

from __future__ import annotations

import numpy as np
import pytest

from fraclink import Experiment, LinkModel, identify
from fraclink._identify.shape import Window, embedded, shape_of
from fraclink.extend import simulated_torque
from fracsys import time_response
from identify_cases import PERIOD, TRUTH, smooth_pulse

LINKS = [
    TRUTH,
    LinkModel(1.56, 10.0),
    LinkModel(1.56, 10.2, damping=1.3),
    LinkModel(1.56, 10.5, damping=1.37, damping_order=0.9),
    LinkModel(1.56, 9.0, damping=0.8, damping_order=1.5),
    LinkModel(1.0, 4.0, order=1.4),
]


@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize("link", LINKS, ids=lambda link: link.structure)
def test_prediction_is_the_exact_response(link: LinkModel, hold: str) -> None:
    angle = smooth_pulse(PERIOD * np.arange(3000))
    exact = time_response(link.torque(), angle, PERIOD, hold=hold).output
    found = simulated_torque(link, angle, PERIOD, hold=hold)  # type: ignore[arg-type]
    assert np.max(np.abs(found - exact)) < 3e-7 * link.stiffness


def test_delay_of_whole_and_broken_samples() -> None:
    fine = PERIOD / 8
    angle = smooth_pulse(fine * np.arange(16000), rise=0.2)
    whole = simulated_torque(TRUTH, angle, fine)
    for steps in (1, 3, 8, 13):
        late = simulated_torque(TRUTH, angle, fine, delay=steps * fine)
        assert np.max(np.abs(late[steps:] - whole[:-steps])) < 1e-9
    # Between samples the input is linear: the same as in a fine log that is linear
    # there.
    coarse = angle[::8]
    straight = np.interp(
        fine * np.arange(coarse.size * 8 - 7), PERIOD * np.arange(coarse.size), coarse
    )
    reference = simulated_torque(TRUTH, straight, fine, hold="first")
    for steps in (1, 3, 5):
        late = simulated_torque(TRUTH, coarse, PERIOD, delay=steps * fine, hold="first")
        assert (
            np.max(np.abs(late[1:] - reference[8 - steps :: 8][: late.size - 1])) < 1e-8
        )


@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize("delay", [0.0, 0.3 * PERIOD])
@pytest.mark.parametrize(
    "link", [LINKS[i] for i in (0, 2, 3, 4)], ids=lambda link: link.structure
)
def test_derivatives_are_those_of_the_prediction(
    link: LinkModel, delay: float, hold: str
) -> None:
    angle = smooth_pulse(PERIOD * np.arange(2000))
    window = Window(angle, np.zeros_like(angle), PERIOD, hold)  # type: ignore[arg-type]
    kernel = window.kernel(abs(link.pole), longest_delay=0.1)
    shape = shape_of(link, delay=delay)
    # Where the input jumps or bends at a sample, the derivative by the delay is one-sided.
    fixed = {2, 3} if link.damping == 0 else set()
    fixed |= {4} if delay == 0.0 else set()
    free = [i for i in range(5) if i not in fixed]
    mask = sum(1 << i for i in free)
    if link.order == 2:
        # away from the limit, where only a one-sided difference is possible
        shape[0] = 1.99
    columns = kernel.columns(shape, mask)
    assert columns is not None
    for column, i in zip(columns[1:], free, strict=True):
        step = 1e-6 * (1 if i < 4 else 0.01)
        up, down = shape.copy(), shape.copy()
        up[i] += step
        down[i] -= step
        numeric = (kernel.columns(up, 0)[0] - kernel.columns(down, 0)[0]) / (2 * step)  # type: ignore[index]
        assert np.max(np.abs(column - numeric)) < 3e-7 * np.max(np.abs(column)) + 1e-9


def test_gram_matrix_is_that_of_the_columns() -> None:
    angle = smooth_pulse(PERIOD * np.arange(1237))  # not a multiple of any block length
    output = np.sin(np.arange(1237) / 7)
    kernel = Window(angle, output, PERIOD, "first").kernel(10.0, longest_delay=0.1)
    shape = shape_of(LINKS[3], delay=0.0123)
    columns, gram = (
        kernel.columns(shape, 0b11110),
        kernel.grams(shape[None], 0b11110)[0],
    )
    assert columns is not None
    full = np.vstack([output, columns[:1], np.ones(1237), columns[1:]])
    assert np.allclose(gram, full @ full.T, rtol=1e-11, atol=1e-11 * np.abs(gram).max())


def test_a_search_says_whether_it_converged() -> None:
    angle = smooth_pulse(PERIOD * np.arange(2000))
    output = simulated_torque(TRUTH, angle, PERIOD)
    kernel = Window(angle, output, PERIOD, "first").kernel(10.0, longest_delay=0.1)
    start, open_ends = shape_of(LINKS[1]), (np.full(5, -9.0), np.full(5, 9.0))
    open_ends[0][0], open_ends[1][0] = 1.01, 2.0
    for rounds, done in ((0, False), (1, False), (100, True)):
        converged, *_, cost, _ = kernel.solve(
            start, 0b00011, *open_ends, np.nan, np.nan, rounds
        )
        assert converged is done
    assert cost < 1e-9 * np.sum(output**2)
    too_late = shape_of(LINKS[1], delay=50.0)
    converged, *_, cost, _ = kernel.solve(
        too_late, 0b00011, *open_ends, np.nan, np.nan, 100
    )
    assert not converged and cost == np.inf


def test_fractional_link_is_the_edge_of_the_damped_one() -> None:
    angle = smooth_pulse(PERIOD * np.arange(2000))
    kernel = Window(angle, angle, PERIOD, "first").kernel(10.0, longest_delay=0.1)
    one, other = shape_of(TRUTH), embedded(shape_of(TRUTH), "D-FOM")
    first, second = kernel.columns(one, 0), kernel.columns(other, 0)
    assert first is not None
    assert second is not None
    assert np.max(np.abs(first[0] - second[0])) < 1e-7


def test_a_negative_delay_looks_ahead() -> None:
    angle = smooth_pulse(PERIOD * np.arange(2000))
    early = simulated_torque(TRUTH, angle, PERIOD, delay=-5 * PERIOD)
    assert np.allclose(
        early[:-5], simulated_torque(TRUTH, angle, PERIOD)[5:], atol=1e-9
    )


def test_hold_is_seen_in_the_angle() -> None:
    time = PERIOD * np.arange(2000)
    angles = {
        "first": (smooth_pulse(time), np.round(smooth_pulse(time) * 300) / 300),
        "zero": (np.where((time > 1) & (time < 5), 1.0, 0.0),),
    }
    for hold, shapes in angles.items():
        for angle in shapes:
            torque = simulated_torque(TRUTH, angle, PERIOD)
            log = Experiment(PERIOD, angle, torque)
            assert identify(log, "UD-FOM", details=False).hold == hold


@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize("before", [1, 7, 8, 450])
@pytest.mark.parametrize("delay", [-0.021, 0.0, 0.0173, 0.3])
def test_samples_before_the_first_output_move_the_link(
    delay: float, before: int, hold: str
) -> None:
    """The columns of a cut log equal those of the whole log from the cut on, for any
    delay.
    """
    angle = smooth_pulse(PERIOD * np.arange(900))
    shape = shape_of(TRUTH, delay)
    whole = Window(angle, angle, PERIOD, hold)  # type: ignore[arg-type]
    cut = Window(angle, angle[before:], PERIOD, hold)  # type: ignore[arg-type]
    assert cut.samples == angle.size - before
    expected = whole.kernel(5.0, longest_delay=0.4).columns(shape, 0b10111)
    found = cut.kernel(5.0, longest_delay=0.4).columns(shape, 0b10111)
    assert expected is not None and found is not None
    scale = np.max(np.abs(expected), axis=1, keepdims=True)
    assert np.max(np.abs(found - expected[:, before:]) / scale) < 1e-12
