"""LQG and H∞ corrections for the tip error, from an integer-order model of the nominal arm."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.link import LinkModel
from fraclink._compare.linear import Filter, tustin

__all__ = ["hinf_correction", "integer_mode", "lqg_correction"]

Real = NDArray[np.float64]


def integer_mode(model: LinkModel) -> tuple[float, float]:
    """Return (frequency [rad/s], damping ratio) of the link's pole: its nearest integer-order model.

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
    model: LinkModel, *, period: float, pole: float, delay: int, noise: float, weight: float
) -> Filter:
    """Return an LQG correction with the gauge's offset as a state of its Kalman filter.

    The regulator minimises Σ tip² + u²/weight of the held and delayed arm. The filter takes a motor
    reference noise of 10 mrad, the gauge's noise `noise` [rad] of the tip estimate, and an offset that walks
    3 mrad in ten seconds; the controller works on the tip error, so the offset it has found is left alone.
    """
    from scipy.linalg import expm, solve_discrete_are

    a, b, c = _arm(model, pole)
    block = np.zeros((5, 5))
    block[:4, :4], block[:4, 4] = a * period, b * period
    exact = expm(block)
    n = 4 + delay
    held, drive, row = np.zeros((n, n)), np.zeros(n), np.zeros(n)
    held[:4, :4], row[:4] = exact[:4, :4], c
    if delay:
        held[:4, 4] = exact[:4, 4]
        held[4 : n - 1, 5:] = np.eye(delay - 1)
        drive[-1] = 1.0
    else:
        drive[:4] = exact[:4, 4]
    cost = solve_discrete_are(held, drive[:, None], np.outer(row, row), np.array([[1.0 / weight]]))
    gain = (drive @ cost @ held) / (1.0 / weight + drive @ cost @ drive)

    wide = np.eye(n + 1)
    wide[:n, :n] = held
    seen = np.append(row, 1.0)
    walk = 3e-3**2 * period / 10.0
    process = np.zeros((n + 1, n + 1))
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


def hinf_correction(model: LinkModel, *, period: float, pole: float, delay: int, gain: float) -> Filter:
    """Return an H∞ loop-shaping correction (normalised coprime factors, γ = 1.1 γ_min).

    The shaped plant is gain · s/(s + ω/10) · M(s) G(s) with a first-order Padé approximation of the delay of
    d + ½ periods; the weight's zero at s = 0 keeps the gauge's offset out of the tip, like Ĉ(0) = 0.
    Source: McFarlane and Glover (1992); Skogestad and Postlethwaite (2005), section 9.4.1.
    """
    from scipy.linalg import solve_continuous_are

    w, _ = integer_mode(model)
    arm, b_arm, c_arm = _arm(model, pole)
    rate = 2.0 / ((delay + 0.5) * period)  # Padé: (rate − s)/(rate + s)
    corner = w / 10.0
    # States: arm (4), Padé (1), weight (1), in the order weight → Padé → arm.
    a, b, c = np.zeros((6, 6)), np.zeros(6), np.zeros(6)
    a[5, 5], b[5] = -corner, 1.0  # weight: gain (1 − corner/(s + corner))
    weight_out, weight_direct = np.zeros(6), gain
    weight_out[5] = -gain * corner
    a[4] = weight_out
    a[4, 4] -= rate
    b[4] = weight_direct  # Padé: −1 + 2 rate/(s + rate)
    pade_out, pade_direct = -weight_out, -weight_direct
    pade_out[4] += 2.0 * rate
    a[:4, :4] = arm
    a[:4] += np.outer(b_arm, pade_out)
    b[:4] = b_arm * pade_direct
    c[:4] = c_arm
    one = np.eye(1)
    x = solve_continuous_are(a, b[:, None], np.outer(c, c), one)
    z = solve_continuous_are(a.T, c[:, None], np.outer(b, b), one)
    level = 1.1 * math.sqrt(1.0 + float(np.abs(np.linalg.eigvals(x @ z)).max()))
    inner = np.linalg.inv(((1.0 - level**2) * np.eye(6) + x @ z).T)
    feed = level**2 * inner @ z @ c
    robust = a - np.outer(b, b @ x) + np.outer(feed, c)
    # The textbook's loop has positive feedback; on e = −y the output changes sign twice.
    central = tustin(robust, feed, b @ x, 0.0, period)
    weight = tustin(np.array([[-corner]]), np.ones(1), np.array([-gain * corner]), gain, period)
    return weight.after(central).scaled(-1.0)
