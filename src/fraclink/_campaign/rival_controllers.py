"""The rivals' controllers: PD, LQG, H∞ loop shaping, sliding mode, GPI, collocated PD."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, solve_continuous_are, solve_discrete_are

from fraclink._arm.link import LinkModel
from fraclink._campaign.setting import Filter, tustin

__all__ = [
    "Algebraic",
    "Linear",
    "Outer",
    "Seen",
    "Sliding",
    "gpi_control",
    "gpi_correction",
    "hinf_correction",
    "integer_mode",
    "lqg_correction",
    "pd_correction",
    "sliding_correction",
]


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


def hinf_correction(
    model: LinkModel, *, period: float, pole: float, delay: int, gain: float
) -> Filter:
    """Return an H∞ loop-shaping correction (normalised coprime factors, γ = 1.1 γ_min).

    The shaped plant is gain · s/(s + ω/10) · M(s) G(s) with a first-order Padé
    approximation of the delay of d + ½ periods; the weight's zero at s = 0 keeps the
    gauge's offset out of the tip, like Ĉ(0) = 0. Source: McFarlane and Glover (1992);
    Skogestad and Postlethwaite (2005), section 9.4.1.
    """

    w, _ = integer_mode(model)
    arm, b_arm, c_arm = _arm(model, pole)
    rate = 2.0 / ((delay + 0.5) * period)  # Padé: (rate − s)/(rate + s)
    # A decade below the mode, where the weight is one but for 6° of lead.
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
    # The coprime factors are normalised, so both Riccati equations have unit weights.
    one = np.eye(1)
    x = solve_continuous_are(a, b[:, None], np.outer(c, c), one)
    z = solve_continuous_are(a.T, c[:, None], np.outer(b, b), one)
    # At γ_min the matrix to be inverted is singular; a tenth more is the textbook's
    # choice.
    level = 1.1 * math.sqrt(1.0 + float(np.abs(np.linalg.eigvals(x @ z)).max()))
    inner = np.linalg.inv(((1.0 - level**2) * np.eye(6) + x @ z).T)
    feed = level**2 * inner @ z @ c
    robust = a - np.outer(b, b @ x) + np.outer(feed, c)
    # The textbook's loop has positive feedback; on e = −y the output changes sign
    # twice.
    central = tustin(robust, feed, b @ x, 0.0, period)
    weight = tustin(
        np.array([[-corner]]), np.ones(1), np.array([-gain * corner]), gain, period
    )
    return weight.after(central).scaled(-1.0)


class Seen(NamedTuple):
    """What an outer controller gets in one tick, all in radians: θt*, e, Γ/c, F θ̈t*."""

    reference: float
    error: float
    deflection: float
    feed_forward: float


class Outer(Protocol):
    """One tick of an outer controller: what it adds to θt* + F θ̈t* [rad]."""

    def __call__(self, seen: Seen) -> float:
        """Return the addition [rad]."""
        ...


class Linear:
    """A filter on the tip error; one object for one run."""

    def __init__(self, correction: Filter) -> None:
        self._filter = correction
        self._state = np.zeros(correction.order)

    def __call__(self, seen: Seen) -> float:
        """Return Ĉ e."""
        f, error = self._filter, seen.error
        # Read before the update, as law.c does: the output may depend on this tick's
        # error.
        output = float(f.c @ self._state) + f.d * error
        self._state = f.a @ self._state + f.b * error
        return output


def pd_correction(
    gain: float, *, corner: float, filter_time: float, period: float
) -> Filter:
    """Return gain·(1 + s/corner)/(1 + filter_time s) by Tustin."""
    a, b = np.array([[-1.0 / filter_time]]), np.ones(1)
    # Partial fractions of gain·(1 + s/corner)/(1 + T s): a constant and one pole.
    direct = gain / (corner * filter_time)
    return tustin(a, b, np.array([(gain - direct) / filter_time]), direct, period)


def sliding_correction(
    rate: float, frequency: float, *, filter_time: float, period: float
) -> Filter:
    """Return what the sliding mode is inside its boundary layer: poles of the error at
    −rate, twice.

    θ̈t = ω²(θm − θt), θm = θt + (θ̈t* + Λ ė + κ (ė + Λ e))/ω² with Λ = κ = rate, so
    that with C = 1 + Ĉ Ĉ e = (rate²/ω² − 1) e + 2 rate/ω² ė.
    """
    proportional = rate**2 / frequency**2 - 1.0
    derivative = 2.0 * rate / frequency**2
    a, b = np.array([[-1.0 / filter_time]]), np.ones(1)
    direct = derivative / filter_time
    return tustin(
        a, b, np.array([-direct / filter_time]), proportional + direct, period
    )


class Sliding:
    """The sliding mode with its boundary layer: the switching term stops growing at
    `bound`.
    """

    def __init__(
        self,
        rate: float,
        frequency: float,
        bound: float,
        *,
        filter_time: float,
        period: float,
    ) -> None:
        self._rate, self._square, self._bound = rate, frequency**2, bound
        self._derivative = tustin(
            np.array([[-1.0 / filter_time]]),
            np.ones(1),
            np.array([-1.0 / filter_time**2]),
            1.0 / filter_time,
            period,
        )
        self._state = np.zeros(1)

    def __call__(self, seen: Seen) -> float:
        """Return −e + (Λ ė + sat(κ s))/ω²."""
        f, error = self._derivative, seen.error
        speed = float(f.c @ self._state) + f.d * error
        self._state = f.a @ self._state + f.b * error
        # Sliding surface κ(ė + Λe); inside the bound this is linear, and is what the
        # tuning looks at.
        surface = self._rate * (speed + self._rate * error)
        switching = math.copysign(min(abs(surface), self._bound), surface)
        return -error + (self._rate * speed + switching) / self._square


def gpi_control(
    rate: float, frequency: float, *, filter_time: float, period: float
) -> Filter:
    """Return the GPI control C of θ̈t = ω² u with four error poles at −rate, behind a
    low-pass filter.

    C = (6 r² s² + 4 r³ s + r⁴)/(ω² s (s + 4 r)); the integral replaces the velocity
    that is not measured.
    """
    r = rate
    a = np.array([[0.0, 1.0], [0.0, -4.0 * r]])
    # (6r²s² + 4r³s + r⁴)/(s² + 4rs) = 6r² + (−20r³ s + r⁴)/(s² + 4rs)
    c = np.array([r**4, -20.0 * r**3]) / frequency**2
    control = tustin(a, np.array([0.0, 1.0]), c, 6.0 * r**2 / frequency**2, period)
    # C is not strictly proper: without a low-pass the gauge's noise would reach the
    # motor at full bandwidth.
    smooth = tustin(
        np.array([[-1.0 / filter_time]]),
        np.ones(1),
        np.array([1.0 / filter_time]),
        0.0,
        period,
    )
    return control.after(smooth)


def gpi_correction(
    rate: float, frequency: float, *, filter_time: float, period: float
) -> Filter:
    """Return Ĉ = C − 1 of `gpi_control`."""
    control = gpi_control(rate, frequency, filter_time=filter_time, period=period)
    return Filter(control.a, control.b, control.c, control.d - 1.0)


class _Integral:
    """A running integral by the trapezoid rule; at 4 ms a rectangle rule would bias ω²
    by 8 %.
    """

    def __init__(self) -> None:
        self.value = 0.0
        self._last = 0.0

    def add(self, integrand: float, period: float) -> float:
        """Go on to the next sample and return the integral up to it."""
        self.value += 0.5 * period * (self._last + integrand)
        self._last = integrand
        return self.value


class Algebraic:
    """Algebraic estimate of the payload while the move begins, then GPI with the
    frequency it gives.

    From θ̈t = ω² δ, δ = Γ/c, multiplied by t² and integrated twice: ω² ∫∫ t² δ = t² θt
    − 4 ∫ t θt + 2 ∫∫ θt; both sides are fitted by least squares until `until` [s], then
    ω is fixed, within a factor of two of the nominal one. Until then ω is the nominal
    one. Source: the adaptive predecessor that the paper cites as [18]; it assumes a
    gauge without offset.
    """

    def __init__(
        self,
        rate: float,
        frequency: float,
        *,
        filter_time: float,
        period: float,
        until: float,
    ) -> None:
        self._nominal, self._period, self._until = frequency**2, period, until
        self._filter = gpi_control(
            rate, frequency, filter_time=filter_time, period=period
        )
        self._state = np.zeros(self._filter.order)
        self._integrals, self._tick = tuple(_Integral() for _ in range(7)), 0
        self.square = frequency**2  # ω² in use

    def _estimate(self, tip: float, deflection: float) -> None:
        h, t = self._period, self._tick * self._period
        bend, bend_twice, moment, angle, angle_twice, product, square = self._integrals
        right = bend_twice.add(bend.add(t * t * deflection, h), h)
        left = (
            t * t * tip
            - 4.0 * moment.add(t * tip, h)
            + 2.0 * angle_twice.add(angle.add(tip, h), h)
        )
        above, below = product.add(right * left, h), square.add(right * right, h)
        # A factor of four in ω² is a factor of four in the payload: beyond, the
        # estimate is noise.
        if t >= self._until and below > 0.0:
            self.square = min(
                max(above / below, 0.25 * self._nominal), 4.0 * self._nominal
            )
            self._until = math.inf

    def __call__(self, seen: Seen) -> float:
        """Return what GPI with the estimated ω adds, the feed-forward's change
        included.
        """
        if self._until < math.inf:
            self._estimate(seen.reference - seen.error, seen.deflection)
        self._tick += 1
        f = self._filter
        whole = float(f.c @ self._state) + f.d * seen.error
        self._state = f.a @ self._state + f.b * seen.error
        # C and the feed-forward were made for the nominal ω²; both are inversely
        # proportional to it.
        ratio = self._nominal / self.square
        return ratio * whole - seen.error + (ratio - 1.0) * seen.feed_forward
