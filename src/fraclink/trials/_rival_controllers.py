"""The rivals' corrections of the tip error: PD and LQG."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, solve_discrete_are

from fraclink._arm.link import LinkModel
from fraclink.trials._setting import Filter, tustin

__all__ = ["integer_mode", "lqg_correction", "pd_correction"]


Real = NDArray[np.float64]


def integer_mode(model: LinkModel) -> tuple[float, float]:
    """Return (frequency [rad/s], damping ratio) of the link's pole: its nearest
    integer-order model.

    >>> w, ratio = integer_mode(LinkModel(stiffness=1.56, natural_frequency=11.094, order=1.92))
    >>> round(w, 3), round(ratio, 4)
    (12.264, 0.0654)
    """
    pole = model.pole
    return abs(pole), -pole.real / abs(pole)


def _arm(model: LinkModel, pole: float) -> tuple[Real, Real, Real]:
    """Motor reference to tip angle: M(s) and the link's mode, states θm, θ̇m, θt, θ̇t."""
    w, ratio = integer_mode(model)
    a = np.zeros((4, 4))
    a[0, 1] = a[2, 3] = 1.0
    a[1] = [-(pole**2), -2.0 * pole, 0.0, 0.0]
    a[3] = [w**2, 0.0, -(w**2), -2.0 * ratio * w]
    return a, np.array([0.0, pole**2, 0.0, 0.0]), np.array([0.0, 0.0, 1.0, 0.0])


def lqg_correction(
    model: LinkModel,
    *,
    period: float,
    pole: float,
    delay: int,
    noise: float,
    weight: float,
) -> Filter:
    """Return an LQG correction with the gauge's offset as a state of its Kalman filter.

    The regulator minimises Σ tip² + u²/weight of the held and delayed arm. The filter
    takes a motor reference noise of 10 mrad, the gauge's noise `noise` [rad] of the tip
    estimate, and an offset that walks 3 mrad in ten seconds; the controller works on
    the tip error, so the offset it has found is left alone.
    """

    a, b, c = _arm(model, pole)
    block = np.zeros((5, 5))
    block[:4, :4], block[:4, 4] = a * period, b * period
    exact = expm(block)
    n = 4 + delay
    held, drive, row = np.zeros((n, n)), np.zeros(n), np.zeros(n)
    held[:4, :4], row[:4] = exact[:4, :4], c
    if delay:
        # The delay is a queue of held inputs: the oldest drives the arm, the newest
        # enters at the end.
        held[:4, 4] = exact[:4, 4]
        held[4 : n - 1, 5:] = np.eye(delay - 1)
        drive[-1] = 1.0
    else:
        drive[:4] = exact[:4, 4]
    # One knob: `weight` prices the motor's reference against the tip, and the rule
    # turns it up to the same Ms.
    cost = solve_discrete_are(
        held, drive[:, None], np.outer(row, row), np.array([[1.0 / weight]])
    )
    gain = (drive @ cost @ held) / (1.0 / weight + drive @ cost @ drive)

    wide = np.eye(n + 1)
    wide[:n, :n] = held
    seen = np.append(row, 1.0)
    # A random walk of 3 mrad in ten seconds: the offset of a gauge is slower than any
    # move, and a filter that let it go faster would take the bend of a move for offset.
    walk = 3e-3**2 * period / 10.0
    process = np.zeros((n + 1, n + 1))
    # 1e-12 keeps the Riccati equation well posed for states that the input does not
    # reach at once.
    process[:n, :n] = np.outer(drive, drive) * 0.01**2 + 1e-12 * np.eye(n)
    process[n, n] = walk
    spread = solve_discrete_are(wide.T, seen[:, None], process, np.array([[noise**2]]))
    kalman = spread @ seen / (noise**2 + seen @ spread @ seen)

    # y = tip estimate = −e. Predictor form, so that no product of direct terms arises.
    correct = np.eye(n + 1) - np.outer(kalman, seen)
    state = wide @ correct
    state[:n] -= np.outer(drive, gain) @ correct[:n]
    feed = wide @ kalman
    feed[:n] -= drive * float(gain @ kalman[:n])
    # u = −gain (correct x + kalman y), y = −e
    return Filter(state, -feed, -(gain @ correct[:n]), float(gain @ kalman[:n]))


def pd_correction(
    gain: float, *, corner: float, filter_time: float, period: float
) -> Filter:
    """Return gain·(1 + s/corner)/(1 + filter_time s) by Tustin."""
    a, b = np.array([[-1.0 / filter_time]]), np.ones(1)
    # Partial fractions of gain·(1 + s/corner)/(1 + T s): a constant and one pole.
    direct = gain / (corner * filter_time)
    return tustin(a, b, np.array([(gain - direct) / filter_time]), direct, period)
