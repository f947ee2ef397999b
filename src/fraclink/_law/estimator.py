"""The payload estimator: the tables of csrc/payload_estimator.c, and its run over
signals.

A bank of models, one for each of a row of payloads, predicts the torque from the motor
angle. Model k is a vibration and one real mode, B_k(z)(1 − z⁻¹)/A_k(z), fitted to the
fractional Γ/θm over the frequencies that a move excites; its error is filtered by
A_k/C_k, whose C_k forgets within half a vibration. For a gauge of gain 1 + x and offset
y the error is e = u − v − x v − y w with u = (A_k/C_k)Γ, v = (B_k/C_k)(1 − z⁻¹)θm and
w = A_k(1)/C_k(1): least squares over x and y, with the rig's uncertainty of the gain,
gives the cost of the model. The curve through the costs of seven neighbouring models gives the payload,
since the bank is too coarse for a parabola. The variance of the estimate follows from
the variance that the gauge's gain and its noise, which A_k/C_k correlates, cause in the
same sum of errors.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink import _kernels
from fraclink._arm.beam import Beam, modal_shares
from fraclink._arm.link import LinkModel
from fraclink._arm.rig import Rig
from fraclink._law.block import Block, Precision, framed, real_type
from fraclink._law.law import REASONS, Law
from fraclink._law.tracking import masses_of
from fraclink.errors import FieldError
from fracsys.checks import Real, checked

__all__ = [
    "COUNTS",
    "HEADER",
    "MODEL",
    "REALS",
    "Estimates",
    "PayloadEstimator",
    "payload_estimator",
]

VERSION, MODELS = 3, 14
# Names in the order of payload_estimator.h; a test compares them with that file.
HEADER = ("version", "size", "precision", "crc")
COUNTS = ("together", "chunk", "quiet_limit", "gap_limit")
REALS = (
    "angle_limit",
    "torque_limit",
    "torque_moved",
    "variance",
    "gain_weight",
    "offset_variance",
    "keep",
    "surprise",
    "contact",
    "link",
    "narrow",
    "width",
    "payload_limit",
    "certified_low",
    "certified_high",
)
MODEL = (
    *("a1", "a2", "a3", "b0", "b1", "b2", "c1", "c2", "c3"),
    *("rest", "power", "echo0", "echo1", "echo2", "mass"),
)

# The following values were determined on the twin of the geared rig, 8 to 80 g
# (benchmarks/bench_estimator.py).

# Relative to the lightest payload of the design, and to the largest of the law.
LIGHTEST, HEAVIEST = (0.25, 1.15)
# samples per vibration of the lightest payload
PER_VIBRATION = 10
# Damping ratio of C; 0.25 is hardly more accurate and takes longer to forget a start in
# motion.
FORGETTING = 0.35
# Weight of the encoder's quantisation in the fit of the models. Without it the third
# pole of a viscous link, which two poles describe exactly, could lie anywhere.
NOISE_GAIN = 0.003
# Least standard deviation of the gauge's gain: strain gauges and their bridges are not
# known better over months, whatever the interval of one fit.
GAIN_DOUBT = 0.03
# noise of a gauge if the rig states none, relative to the largest credible torque
NOT_STATED = 0.01
# offset before the arm has stood still, relative to the largest credible torque
OFFSET_DOUBT = 0.1
MOVED = 4.0  # standard deviations of a sample: a larger torque counts as motion
# Limit on the square of the torque's relative error, for an error of about a fifth: the
# right model never exceeds it, one for half or twice the payload does.
SURPRISE = 0.05
# Largest relative standard deviation at which an estimate is better for the law than
# none.
NARROW = 0.09
CIRCLE = 1024  # samples after which a filter C has forgotten everything
QUIET = 0.12  # [s] without motion before the estimate is frozen


class Estimates(NamedTuple):
    """The output of the estimator for each period, shape (N,): payload for the law (0:
    none), estimate and its 95 % interval [kg], and the flags of payload_estimator.h.
    """

    given: Real
    estimate: Real
    low: Real
    high: Real
    flags: NDArray[np.uint32]


@dataclass(frozen=True)
class PayloadEstimator(Block):
    """The payload estimator of one arm: every number that payload_estimator.c needs.
    Made by `payload_estimator`.

    Parameters
    ----------
    period
        of the law [s].
    precision
        "single" or "double", as the law's.
    together, chunk
        periods per sample of the models; models updated per period.
    quiet_limit, gap_limit
        samples without motion until the estimate is frozen; periods without a sensor
        until it begins anew.
    values, models
        the reals of payload_params in their order, and one row for each payload of the
        bank.
    """

    period: float
    precision: Precision
    together: int
    chunk: int
    quiet_limit: int
    gap_limit: int
    values: tuple[float, ...]
    models: tuple[tuple[float, ...], ...]

    @cached_property
    def block(self) -> bytes:
        """The parameter block of payload_estimator.c, byte for byte."""
        code = real_type(self.precision)
        counts = (self.together, self.chunk, self.quiet_limit, self.gap_limit)
        flat = [*self.values, *(x for row in self.models for x in row)]
        body = struct.pack(f"<{len(counts)}I{len(flat)}{code}", *counts, *flat)
        block = framed(VERSION, body, self.precision)
        if len(block) != _kernels.payload_sizes(self.single)[0]:
            raise AssertionError(
                "fraclink._law.estimator does not match csrc/payload_estimator.h"
            )
        return block

    @property
    def state_size(self) -> int:
        """Bytes that the estimator remembers."""
        return int(_kernels.payload_sizes(self.single)[1])

    @property
    def certified(self) -> tuple[float, float]:
        """Payloads that the design covers (low, high) [kg]."""
        return self.values[REALS.index("certified_low")], self.values[
            REALS.index("certified_high")
        ]

    def initial_state(self) -> bytes:
        """Return the state before the first period."""
        state, reason = _kernels.payload_init(self.block, self.single)
        if reason:
            raise FieldError(
                "estimator",
                REASONS[reason],
                "refused by payload_estimator.c",
                "a valid block",
                "report it",
            )
        return bytes(state)

    def run(
        self,
        state: bytes,
        motor_angle: ArrayLike,
        torque: ArrayLike,
        *,
        ticks: ArrayLike | None = None,
    ) -> tuple[bytes, Estimates]:
        """Run payload_estimator.c over the sensors of whole signals and return (new
        state, estimates).

        Parameters
        ----------
        state
            from `initial_state`, or from an earlier call.
        motor_angle, torque
            of encoder [rad] and gauge [N·m], one value a period, shape (N,); NaN for a
            lost sample.
        ticks
            numbers of the periods, by default from 1; a number that is skipped is a missed
            period.
        """
        angle, twist = (np.ascontiguousarray(x, float) for x in (motor_angle, torque))
        numbers = np.arange(1, angle.size + 1) if ticks is None else np.asarray(ticks)
        if angle.ndim != 1 or not angle.shape == twist.shape == numbers.shape:
            raise FieldError(
                "torque",
                (angle.shape, twist.shape, numbers.shape),
                "of another length",
                "one value a period",
                "cut or extend",
            )
        numbers = np.ascontiguousarray(numbers.astype(np.int64) % 2**32, np.uint32)
        out, flags = np.empty((4, angle.size)), np.empty(angle.size, np.uint32)
        after = _kernels.payload_run(
            self.block,
            state,
            numbers,
            angle,
            twist,
            out,
            flags,
            self.single,
        )
        return bytes(after), Estimates(out[0], out[1], out[2], out[3], flags)


@checked
def payload_estimator(
    link: LinkModel,
    rig: Rig,
    law: Law,
    payloads: tuple[float, float],
) -> PayloadEstimator:
    """Return the payload estimator for a law and the link that it was designed for.

    Parameters
    ----------
    link
        with a known payload; its order, gauge delay, gauge gain and second mode are in
        the tables. The gain's standard deviation follows from its interval, and is at least 3 %.
    rig
        with the noise of the gauge and the mass of the link.
    law
        which receives the estimate: its period, precision and limits.
    payloads
        that the design covers (low, high) [kg]. The bank reaches from a quarter of the
        first to 1.15 times the law's largest payload.

    Raises
    ------
    FieldError
        a link whose payload is not known, a law that knows no payload.

    Examples
    --------
    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023-geared")
    >>> design = fl.design(rig.model, rig, payloads=(0.02, 0.04), gain_crossover=11.7,
    ...                    phase_margin=fl.deg(45))
    >>> bank = payload_estimator(rig.model, rig, design.law(), design.payloads)
    >>> len(bank.models), bank.together, bank.in_precision("single").state_size
    (14, 5, 800)
    """
    if link.payload is None or law.limits.payload_limit <= 0.0:
        raise FieldError(
            "payload",
            link.payload,
            "not known to the law",
            "> 0 kg",
            "fit or design with the payload at which the link's frequency was found",
        )
    # A 95 % interval is 3.92 standard deviations wide.
    low, high = link.interval("gauge_gain") or (0.0, 0.0)
    gain_doubt = max(GAIN_DOUBT, (high - low) / 3.92 / abs(link.gauge_gain))
    nominal, own = masses_of(link, rig)
    # Evenly spaced in ln m, since the frequency varies with m^(−1/2): the ratio between
    # neighbours is constant, and so is the relative error of the interpolation.
    masses = np.geomspace(
        LIGHTEST * payloads[0] + own, HEAVIEST * law.limits.payload_limit + own, MODELS
    )
    # Shares of the first mode in the torque at the root. An identified gauge gain
    # includes the share at the payload of its log; a computed link has no mass.
    *beams, usual = (
        modal_shares(Beam.from_rig(rig, payload=payload))
        for payload in (*(masses - own).tolist(), link.payload)
    )
    known = rig.link.stiffness if nominal == link.payload else usual[1][0]
    links = [
        replace(
            link.with_mass(m / nominal),
            gauge_gain=float(link.gauge_gain * shares[0] / known),
        )
        for m, (_, shares) in zip(masses, beams, strict=True)
    ]
    # The lightest payload vibrates fastest; its vibration limits how many periods may
    # be combined into one sample.
    corner = links[0].resonance
    together = max(1, int(math.tau / (corner * PER_VIBRATION * law.period)))
    sample = together * law.period
    # Over less than one vibration a swing cannot be told from an offset, and damping by
    # another law than the model's shifts the estimate: evidence fades over two vibrations
    # of the heaviest payload, one for each of two moves.
    keep = math.exp(-sample * links[-1].resonance / (4 * math.pi))
    # The best model is at most half a step of the bank away from the payload, and its
    # torque errs by no more than that.
    contact = (0.5 * math.log(masses[1] / masses[0])) ** 2
    values = _values(rig, law, together, gain_doubt, keep, contact, own, payloads)
    return PayloadEstimator(
        period=law.period,
        precision=law.precision,
        together=together,
        # Rounded up: all models are up to date when the next sample is complete, and
        # the work is the same in every period.
        chunk=-(-MODELS // together),
        quiet_limit=max(2, round(QUIET / sample)),
        gap_limit=max(2 * together, 8),
        values=tuple(values[name] for name in REALS),
        models=tuple(
            (*_model(one, *beam, corner, sample), float(m))
            for one, beam, m in zip(links, beams, masses, strict=True)
        ),
    )


def _values(
    rig: Rig,
    law: Law,
    together: int,
    gain_doubt: float,
    keep: float,
    contact: float,
    own: float,
    payloads: Sequence[float],
) -> dict[str, float]:
    limit = law.limits.torque_limit
    # The rounding of a converter is a noise of its step/√12 in addition to the gauge's
    # own.
    noise = (
        math.hypot(rig.gauge.noise, rig.gauge.quantum / math.sqrt(12))
        or NOT_STATED * limit
    )
    variance = noise**2 / together
    return {
        "angle_limit": law.limits.angle_limit,
        "torque_limit": limit,
        "torque_moved": MOVED * math.sqrt(variance),
        "variance": variance,
        "gain_weight": variance / gain_doubt**2,
        # Wide on purpose: until the arm has stood still the offset is unknown, and it
        # must not be taken for a payload.
        "offset_variance": (OFFSET_DOUBT * limit) ** 2,
        "keep": keep,
        "surprise": SURPRISE,
        "contact": contact,
        "link": own,
        "narrow": NARROW,
        # two-sided 95 % of a normal distribution
        "width": 1.96,
        "payload_limit": law.limits.payload_limit,
        "certified_low": payloads[0],
        "certified_high": payloads[1],
    }


def _model(
    link: LinkModel, frequencies: Real, shares: Real, corner: float, sample: float
) -> tuple[float, ...]:
    """One row of the bank without its mass: A, B and C at samples of `sample` [s], A(1)/C(1)
    and the covariances of white noise filtered by A/C.

    frequencies, shares: of the modes of its beam (`modal_shares`). Those above the first
    hardly vibrate in a move, but their inertia is in the torque. corner: corner frequency
    of the spectrum of a move [rad/s], with which the frequencies are weighted. A and B are
    the linear least squares solution of B/C = (A/C) Γ/θm.
    """
    pole = link.pole
    fast = np.exp(
        abs(pole) * complex(-FORGETTING, math.sqrt(1 - FORGETTING**2)) * sample
    )
    # C filters both sides: the effect of the start, and of an earlier payload, decays
    # with its poles. Without it the equation would be fitted to noise that A
    # differentiates.
    below = np.convolve(
        [1.0, -2 * fast.real, abs(fast) ** 2], [1.0, -math.exp(-abs(pole) * sample)]
    )
    higher, parts = frequencies[1:], shares[1:] / shares[0]
    if link.second_mode is not None:
        higher = np.array([link.second_mode.frequency])
        parts = np.array([link.second_mode.gain])
    # Beyond the Nyquist frequency of the samples the table would be fitted to an alias;
    # from half its frequency on, a higher mode is more than its inertia.
    top = min([0.9 * math.pi / sample, *(0.5 * higher[:1])])
    w = np.geomspace(0.05 * abs(pole), top, 300)
    inertia = parts * w[:, None] ** 2 / (w[:, None] ** 2 - higher**2)
    torque = (
        (link.torque()(1j * w) + link.stiffness * inertia.sum(axis=1))
        * link.gauge_gain
        * np.exp(-1j * w * link.gauge_lag)
    )
    back, high = (
        np.exp(-1j * w * sample),
        np.exp(-1j * np.linspace(0, math.pi, 100)[1:]),
    )
    # Points whose distance grows with the frequency, weighted by the spectrum of a move,
    # which is as fast as the lightest payload allows, whatever the arm carries.
    weight = (
        np.sqrt(corner / w) / (1 + (w / corner) ** 2) / np.polyval(below[::-1], back)
    )
    # B has a zero at z = 1: a motor at rest causes no torque, whatever its angle.
    noise = NOISE_GAIN * (1 - high) / np.polyval(below[::-1], high)
    columns = [
        np.concatenate([(1 - back) * back**i * weight, noise * high**i])
        for i in range(3)
    ]
    columns += [
        np.concatenate([-torque * back**i * weight, 0 * high]) for i in (1, 2, 3)
    ]
    both, target = (
        np.stack(columns, axis=1),
        np.concatenate([torque * weight, 0 * high]),
    )
    b0, b1, b2, *above = np.linalg.lstsq(
        np.vstack([both.real, both.imag]),
        np.concatenate([target.real, target.imag]),
        rcond=None,
    )[0]
    # The autocovariance of white noise filtered by A/C; its covariance with the
    # filter's state follows by the filter's recursion.
    power, *later = np.fft.irfft(
        abs(np.fft.rfft([1.0, *above], CIRCLE) / np.fft.rfft(below, CIRCLE)) ** 2
    )[:4]
    rest = (1 + sum(above)) / below.sum()
    return (
        *map(float, (*above, b0, b1, b2, *below[1:], rest, power)),
        *np.convolve(later, below[:3])[:3].tolist(),
    )
