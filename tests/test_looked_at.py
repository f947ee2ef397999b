"""Pictures of a fit: responses with their coherence, and the error around the best
point.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import fraclink as fl
from fraclink._identify.looked_at import error_map, welch_response


@pytest.fixture(scope="module")
def log() -> fl.Experiment:
    """A sweep of the motor, and the torque of a known link; noise hides it far above
    the resonance.
    """
    time = 0.004 * np.arange(6000)
    shaken = 0.002 * np.random.default_rng(1).normal(size=time.size)
    angle = 0.3 * np.sin(0.5 * time + 0.6 * time**2) + shaken
    torque = fl.extend.simulated_torque(
        fl.LinkModel(1.56, 10.02, order=1.92), angle, 0.004
    )
    noise = np.random.default_rng(0).normal(0, 0.05, torque.size)
    rough = noise - np.convolve(noise, np.ones(15) / 15, "same")
    return fl.Experiment(period=0.004, motor_angle=angle, output=torque + rough)


@pytest.fixture(scope="module")
def fit(log: fl.Experiment) -> fl.Fit:
    return fl.identify(log, "UD-FOM", details=False)


def test_the_response_is_that_of_the_link_where_the_log_is_coherent(log, fit) -> None:
    found = welch_response(log, fit)
    inside = (found.frequency > 16.0) & (
        found.frequency < 25.0
    )  # beside the resonance: no leakage
    s = (1j * found.frequency[inside]) ** 1.92
    truth = 1.56 * s / (s + 10.02**2)
    assert np.abs(found.measured[inside] / truth - 1.0).max() < 0.05
    assert found.coherence[inside].min() > 0.99
    assert np.median(found.coherence[found.frequency > 200.0]) < 0.5
    # the model goes through the same windows: there is no bias between the two
    assert np.abs(found.measured[inside] / found.predicted[inside] - 1.0).max() < 0.02


def test_the_error_is_the_one_of_a_fit_at_that_point(log, fit) -> None:
    found = error_map(log, fit)
    count = fit.fitted_samples
    fine = found.ratio[3, 20], found.ratio[12, 12]
    for ratio, (row, column) in zip(fine, ((3, 20), (12, 12)), strict=True):
        order, resonance = float(found.order[row]), float(found.resonance[column])
        link = replace(
            fit.model, order=order, natural_frequency=resonance ** (order / 2.0)
        )
        unit = fl.extend.simulated_torque(
            link, log.motor_angle, 0.004, delay=fit.delay
        )[:count]
        columns = np.stack([unit, np.ones(count)], axis=1)
        _, rest, *_ = np.linalg.lstsq(columns, log.output[:count], rcond=None)
        assert ratio == pytest.approx(float(rest[0]) / (fit.mse * count), rel=2e-3)
    assert math.isclose(float(found.ratio.min()), 1.0)
    assert 1.2 < float(found.ratio[12, 0]) < 3.0  # the edges show a valley, not a plane
