"""The use of a given payload by the law: the scale of its feed-forward, and the model
of its tracking.

Without the payload the error compares the reference with a tip that lags by motor loop
and computation, and the correction opposes every move. With the payload the
feed-forward is right, the tip follows the reference as θm follows θm*, and the error is
formed with exactly this lag. Feed-forward and lag lie outside the feedback loop: its
margins, and so its certificate, do not change.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from fraclink._arm.link import LinkModel
from fraclink._arm.motor import DiscretePid, MotorConstants
from fraclink._arm.motor_loop import SampledMotorLoop
from fraclink._arm.rig import Rig
from fraclink._law.block import FORWARD_MODES, Modes, MotorModel, Tracking
from fracsys._discrete import DiscreteFits, DiscreteRational
from fracsys.checks import Complex, Real

__all__ = [
    "Following",
    "following",
    "forward_fit",
    "held_reference",
    "masses_of",
    "tracking_for",
]


# Share of the resonance: below it the flexion is less than 5 % of the motor's motion,
# and its error less than 1 %.
FLEXIBLE = 0.2
_STEPS = 4096  # length of the impulse responses
# A natural frequency this close to eq. (5) was computed from it, without the mass of
# the link; an identified one includes that mass.
COMPUTED = 1e-3
SLOWEST = 0.995  # pole of the motor model: a loop that settles in a thousand periods
# a negative pole represents a delay of a fraction of a period; beyond this limit it
# rings
FASTEST = -0.5


@dataclass(frozen=True)
class Following:
    """The tracking of the placed motor loop, and the error of its model.

    For a reference with speed and acceleration within v and a, the motor and its model
    differ by no more than ``slow v T + quick a T²``: d is the difference of their step
    responses, slow = |Σ d| [periods], quick = Σ_k |Σ_{j>k} d_j| [periods²].
    """

    model: MotorModel
    lag: float  # lag of the loop [periods]
    slow: float
    quick: float

    @classmethod
    def of(
        cls, model: MotorModel, follows: Callable[[Real], Complex], period: float
    ) -> Following:
        """Return the difference between a motor loop with the response `follows` =
        θm/θm* and its model.
        """
        # Impulse responses by FFT, long enough for the slowest pole that a model may
        # have.
        grid = np.linspace(0.0, math.pi / period, _STEPS // 2 + 1)[1:]
        back = np.exp(-1j * grid * period)
        h = model.now + model.next * back / (1 - model.keep * back)
        of_model = h * back / (1 - back + h * back)
        loop = np.fft.irfft(np.concatenate([[1.0], follows(grid)]))
        parts = np.cumsum(loop - np.fft.irfft(np.concatenate([[1.0], of_model])))
        return cls(
            model,
            lag=float(np.arange(_STEPS) @ loop),
            slow=float(abs(parts.sum())),
            quick=float(np.abs(parts.sum() - np.cumsum(parts)).sum()),
        )


@lru_cache(maxsize=16)
def following(
    resonance: float,
    period: float,
    pole: float,
    delay: int,
    motor: MotorConstants | None,
    pid: DiscretePid | None,
) -> Following:
    """Return the tracking of a motor loop: the sampled PID with its motor or, without
    these, M(s) with its `pole` [rad/s], and a `delay` of whole periods.

    `resonance` [rad/s] is that of the link: a move has little content beyond twice that
    frequency, otherwise it would ring with any law.
    """

    def follows(frequency: Real) -> Complex:
        back = np.exp(-1j * frequency * period)
        if pid is None or motor is None:
            return held_reference(pole * period, back) * back**delay
        loop = SampledMotorLoop(pid, motor, delay)
        return loop.voltage(frequency) * loop.plant(back)

    top = 2 * resonance
    # Not down to 0, where the model has a gain of 1 by its form and the weight 1/ω is
    # unbounded.
    frequency = np.linspace(0.05, 1.0, 60) * min(4 * top, 0.5 * math.pi / period)
    # 1/ω is the spectrum of the start and end of a move; beyond twice the resonance a
    # smooth move has almost no content.
    model = _fit(
        follows(frequency),
        np.exp(-1j * frequency * period),
        1 / (frequency * (1 + (frequency / top) ** 2)),
    )
    return Following.of(model, follows, period)


def tracking_for(
    link: LinkModel, feedforward: Modes, period: float, *, rig: Rig | None
) -> Tracking | None:
    """Return the data by which the law of `link` uses a payload, None if the link has
    none.
    """
    if link.payload is None:
        return None
    nominal, own = masses_of(link, rig)
    return Tracking(
        nominal=nominal * _share(link, feedforward, period),
        link=own,
        gauge_delay=link.gauge_lag,
        gauge_gain=link.gauge_gain,
    )


def masses_of(link: LinkModel, rig: Rig | None) -> tuple[float, float]:
    """Return the payload to which the link's ω₀² belongs, and the equivalent mass of
    the link at its tip [kg].

    At a payload m, ω₀² is the model's times the first mass over (m + the second). The
    payload of the link must be known.
    """
    if rig is None or link.payload is None:
        return link.payload or 0.0, 0.0
    own = rig.link.tip_mass
    # Counting the mass of the link twice would make every feed-forward too large by
    # that amount.
    computed = math.isclose(
        link.natural_frequency, rig.natural_frequency(link.payload), rel_tol=COMPUTED
    )
    return (link.payload if computed else link.payload + own), own


def _share(link: LinkModel, feedforward: Modes, period: float) -> float:
    """Magnitude of the fitted feed-forward relative to the wanted one at the resonance,
    where its error remains as vibration.

    A fit that is 1.7 % low there, as for the paper's link, is right for a payload
    lighter by as much.
    """
    resonance = link.resonance
    z = np.exp(1j * resonance * period)
    response = feedforward.direct + sum(
        gain / (z - pole)
        for pole, gain in zip(feedforward.poles, feedforward.gains, strict=True)
    )
    return float(abs(response / link.lead(resonance)))


def held_reference(reach: float, back: Complex) -> Complex:
    """Return M(s) = 1/(1 + s/p)² after a hold, exactly, for pT = `reach` at z⁻¹ =
    `back`.
    """
    keep = math.exp(-reach)
    top = (1 - keep * (1 + reach)) * back + keep * (keep - 1 + reach) * back**2
    return top / (1 - keep * back) ** 2


def _fit(follows: Complex, back: Complex, weight: Real) -> MotorModel:
    """The best model with two real poles; its DC gain is 1 by its form.

    The poles are searched on a grid, which holds only stable ones: a free fit of
    the paper's motor loop with its delay ends at a pole of 1.3.
    """
    poles = np.linspace(FASTEST, SLOWEST, 30)
    one, two, near = _best(follows, back, weight, *np.meshgrid(poles, poles))
    for reach in (0.05, 0.005):
        around = np.linspace(-reach, reach, 21)
        one, two, near = _best(
            follows, back, weight, *np.meshgrid(one + around, two + around)
        )
    # The loop closed around the model has the poles that were found; the model's
    # coefficients follow by comparing powers of z. z² + (now − 1 − keep) z + … = (z −
    # one)(z − two), with the numerator now z + …
    keep = one + two - 1 + near
    after = (1 - one) * (1 - two) - near + near * keep
    # Rounded to single precision here, like the fits of Ĉ and F: both precisions then
    # run the same model.
    return MotorModel(*(float(np.float32(value)) for value in (near, after, keep)))


def _best(
    follows: Complex, back: Complex, weight: Real, one: Real, two: Real
) -> tuple[float, float, float]:
    """The pair of poles with the smallest weighted error, and `now`, in which the error
    is linear.
    """
    one, two = (np.clip(p.ravel(), FASTEST, SLOWEST)[:, None] for p in (one, two))
    below = (1 - one * back) * (1 - two * back)
    # For given poles the model is linear in `near`, which one division determines; only
    # the poles need the grid.
    rest = (1 - one) * (1 - two) * back**2 / below - follows  # near = 0
    slope = weight * (back - back**2) / below
    near = -np.sum((np.conj(slope) * weight * rest).real, axis=1) / np.sum(
        np.abs(slope) ** 2, axis=1
    )
    error = np.sum(np.abs(slope * near[:, None] + weight * rest) ** 2, axis=1)
    best = int(np.argmin(error))
    return float(one[best, 0]), float(two[best, 0]), float(near[best])


@lru_cache(maxsize=8)
def forward_fit(link: LinkModel, period: float) -> DiscreteRational:
    """The motor angle to be added per acceleration of the reference, `LinkModel.lead`:
    it falls with s, so that no derivative of the reference has to be formed.
    """
    high = min(200.0, 0.5 * math.pi / period)
    # 0.3 dB of the feed-forward is 3.5 % of the flexion, well below the effect of an
    # unknown payload.
    return DiscreteFits(
        link.lead,
        period=period,
        band=(min(FLEXIBLE * link.resonance, 0.1 * high), high),
        tolerance_db=0.3,
        tolerance_deg=1.5,
        pairs=0,
    ).fit(highest=FORWARD_MODES)
