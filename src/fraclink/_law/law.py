"""The discretised control law: a frozen object, saved as one file, with the parameter
block that a board gets.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

import fraclink._law.block as layout
from fraclink import _kernels
from fraclink._display import Overview, Row, Table, displayed, number, quantity, rows_of
from fraclink._files import Saved, document
from fraclink._law.block import (
    Block,
    DiscreteMotorLoop,
    Modes,
    MotorModel,
    Tracking,
    block_values,
)
from fraclink._law.limits import Limits
from fraclink.errors import FieldError
from fracsys.checks import Complex

__all__ = ["MODES", "REASONS", "Law", "LawInputs", "LawOutputs"]


MODES: tuple[str, ...] = ("idle", "run", "degraded", "hold", "off")
REASONS: tuple[str, ...] = (
    "none",
    "parameter version",
    "parameter size",
    "parameter CRC",
    "parameter counts",
    "encoder",
    "gauge",
    "gauge stuck",
    "motor away from its model",
    "missed periods",
    "link overloaded",
    "gauge reversed",
    "gauge dead",
    "not moved enough",
    "tip vibrates",
    "voltage from limit to limit",
)


class LawInputs(NamedTuple):
    """One period's inputs: reference [rad], its acceleration [rad/s²], θm [rad], Γ
    [N·m], and the payload [kg], 0 where it is not given.
    """

    reference: float
    reference_acceleration: float
    motor_angle: float
    torque: float
    payload: float = 0.0


class LawOutputs(NamedTuple):
    """One period's outputs; scalars from `Law.step`, arrays of shape (N,) from
    `Law.run`.

    motor_reference θm* [rad], voltage [V], compensation (the part of the voltage against
    the coupling torque) [V], tip_estimate θm − Γ/c [rad], error [rad], mode (index of
    MODES), reason (index of REASONS), flags (bits of law.h).
    """

    motor_reference: Any
    voltage: Any
    compensation: Any
    tip_estimate: Any
    error: Any
    mode: Any
    reason: Any
    flags: Any


def _complex_text(value: complex) -> str:
    """A pole or gain as text; for a pair, both of them."""
    if not isinstance(value, complex):
        return number(value, 5)
    return f"{number(value.real, 5)} ± {number(abs(value.imag), 4)}j"


@displayed
@document(
    "law",
    version=4,
    hex_floats=True,
    summary=lambda law: {"block": law.digest},
)
@dataclass(frozen=True)
class Law(Block, Saved):
    """A controller as it runs, discretised: every coefficient of law.c.

        θm* = θt* + F(z) θ̈t* + Ĉ(z)(θt* − θte),  θte = θm − Γ/c,    (22), (23)
        Ĉ(z) = (1 − z⁻¹)(d + Σ g/(z − p)),                          (28)

    so that Ĉ(1) = 0 exactly in any arithmetic. Made by `discretize_controller` or
    `Controller.discretize`.

    Parameters
    ----------
    period
        [s].
    precision
        "single" or "double".
    stiffness
        c [N·m/rad]; infinite for a law without a gauge.
    correction, feedforward
        Ĉ(z)/(1 − z⁻¹) and F(z).
    correction_error, band
        largest error of C = 1 + Ĉ in (decibels, degrees) on the band [rad/s].
    feedforward_error
        the same for F, from a fifth of the resonance upwards.
    motor_loop_pole
        p of M(s) [rad/s]; 0 for a law that closes no motor loop.
    motor_model
        how the motor follows its reference, for the guards and a given payload.
    motor_loop
        None for a robot that has its own position servo.
    limits
        the thresholds of the guards.
    tracking
        what the law needs to use a given payload; None if the payload of its link
        model is not known.

    >>> from fraclink._arm.controller import Controller
    >>> from fraclink._arm.link import LinkModel
    >>> from fraclink._law import discretize
    >>> link = LinkModel(stiffness=1.56, natural_frequency=11.094, order=1.92)
    >>> law = discretize(Controller(derivative_gain=0.069876, derivative_order=0.612197, link=link), 0.004, order=4)
    >>> abs(law.frequency_response(0.0)).item(), len(law.block)
    (0.0, 408)
    """

    __made_by__ = "fraclink.discretize(design)"

    period: float
    precision: layout.Precision
    stiffness: float
    correction: Modes
    feedforward: Modes
    motor_loop_pole: float
    motor_model: MotorModel
    limits: Limits
    motor_loop: DiscreteMotorLoop | None = None
    correction_error: tuple[float, float] = (math.nan, math.nan)
    feedforward_error: tuple[float, float] = (math.nan, math.nan)
    band: tuple[float, float] = (math.nan, math.nan)
    tracking: Tracking | None = None

    @property
    def order(self) -> int:
        """Number of states of Ĉ, not counting the one of its factor 1 − z⁻¹."""
        return len(self.correction.poles) + 2 * len(self.correction.pair_poles)

    def overview(self) -> Overview:
        """Poles, gains and the error of the fit, and the digest of the law."""
        motor = (
            "with its motor loop"
            if self.motor_loop
            else "for a robot with its own servo"
        )
        kind = motor if self.has_gauge else "a fractional PID"
        modes = self.correction
        parts = [
            *zip(modes.poles, modes.gains, strict=True),
            *zip(modes.pair_poles, modes.pair_gains, strict=True),
        ]
        poles = (
            (
                Row("pole", "pole p", _complex_text(pole)),
                Row("gain", "gain g", _complex_text(gain)),
                Row(
                    "rate",
                    "|ln p|/Ts",
                    float(abs(np.log(complex(pole)))) / self.period,
                    "rad/s",
                ),
            )
            for pole, gain in parts
        )
        decibel, degree = self.correction_error
        rows = rows_of(
            self,
            ("order", "states"),
            ("period", "period", "ms"),
            ("precision", "precision"),
            ("band", "band of the fit", "rad/s", 3),
            Row("correction_error_db", "error of C, gain", decibel, "dB", digits=2),
            Row(
                "correction_error",
                "error of C, phase",
                math.radians(degree),
                "rad",
                digits=2,
            ),
            Row("sha256", "", self.digest),
            Row("", "SHA-256", f"{self.digest[:16]}…"),
        )
        return Overview(
            f"{self.order} states, one step every {quantity(self.period, 'ms')}, {kind}",
            rows=rows,
            tables=(Table.of("poles", poles),),
        )

    @property
    def has_gauge(self) -> bool:
        """Whether the law reads a torque; that of a `FractionalPid` reads the plant's
        output only.
        """
        return math.isfinite(self.stiffness)

    @property
    def values(self) -> dict[str, Any]:
        """Every field of law_params but its header, not yet rounded to the law's
        precision.
        """
        return block_values(
            self.period,
            self.stiffness,
            self.motor_loop_pole,
            self.motor_model,
            self.correction,
            self.feedforward,
            self.limits,
            self.motor_loop,
            self.tracking,
        )

    @cached_property
    def block(self) -> bytes:
        """The parameter block of law.c, byte for byte."""
        block = layout.pack(self.values, self.precision)
        # The layout of the struct is defined twice, here and by the C compiler. A field
        # missing in one of them would shift all fields after it, and the CRC, computed
        # here, would not detect that.
        if len(block) != _kernels.law_sizes(self.single)[0]:
            raise AssertionError("fraclink._law.block does not match csrc/law.h")
        return block

    @property
    def coefficients(self) -> dict[str, float | list[float]]:
        """Every number of the block under its name in law.h, as the law has it (rounded
        to its precision).
        """
        return layout.unpack(self.block, self.precision)

    @cached_property
    def _filter(self) -> tuple[float, Complex, Complex, Complex, Complex]:
        """(d, p − 1, g, and p − 1 and g of the pairs) of the block, cached: a design
        evaluates the response a thousand times.
        """
        c = self.coefficients
        # Taken from the block instead of `correction`: in single precision these are
        # the numbers on the board. The block's lists are padded with zeros.
        n, m = (
            len(self.correction.poles),
            len(self.correction.pair_poles),
        )
        poles, gains = np.asarray(c["real"]).reshape(-1, 2)[:n].T
        pole, turn, gain, cross = np.asarray(c["pair"]).reshape(-1, 4)[:m].T
        return (
            float(c["direct"]),  # type: ignore[arg-type]
            poles - 1,
            gains,
            pole - 1 + 1j * turn,
            gain + 1j * cross,
        )

    def frequency_response(self, frequency: ArrayLike) -> Complex:
        """Return Ĉ(e^(jωT)) with the rounded coefficients, at ω [rad/s] of any shape."""
        w = np.asarray(frequency, float)
        direct, poles, gains, pairs, crossed = self._filter
        half = 0.5 * w * self.period
        # z − 1 without cancellation: at 0.05 rad/s and 4 ms it is 2e-4; pole − 1 is
        # exact for slow poles
        beyond = (2j * np.sin(half) * np.exp(1j * half))[..., None]
        total = direct + (gains / (beyond - poles)).sum(-1)
        total = total + 0.5 * (
            crossed / (beyond - pairs) + crossed.conj() / (beyond - pairs.conj())
        ).sum(-1)
        return 2j * np.sin(half) * np.exp(-1j * half) * total

    def initial_state(self) -> bytes:
        """Return the state before the first period; the first step starts at the
        measured angle without a bump.
        """
        state, reason = _kernels.law_init(self.block, self.single)
        if reason:
            raise FieldError(
                "law",
                REASONS[reason],
                "refused by law.c",
                "a valid block",
                "report it",
            )
        return bytes(state)

    def step(
        self, state: bytes, inputs: LawInputs, *, tick: int = 1
    ) -> tuple[bytes, LawOutputs]:
        """Run law.c for one period and return (new state, outputs); `tick` is the
        number of the period.
        """
        after, outputs = self.run(
            state, *([value] for value in inputs), first_tick=tick
        )
        return after, LawOutputs(*(column[0].item() for column in outputs))

    def run(
        self,
        state: bytes,
        reference: ArrayLike,
        reference_acceleration: ArrayLike,
        motor_angle: ArrayLike,
        torque: ArrayLike,
        payload: ArrayLike = 0.0,
        *,
        first_tick: int = 1,
        ticks: Sequence[int] | NDArray[np.uint32] | None = None,
    ) -> tuple[bytes, LawOutputs]:
        """Run law.c over whole signals, shape (N,), and return (new state, outputs of
        shape (N,)).

        `payload` [kg] may be one number; 0 where it is not given. Periods are numbered
        from `first_tick`, or by `ticks` where some were missed.
        """
        four = [
            np.asarray(x, float)
            for x in (reference, reference_acceleration, motor_angle, torque)
        ]
        if four[0].ndim != 1 or any(x.shape != four[0].shape for x in four):
            raise FieldError(
                "inputs",
                [x.shape for x in four],
                "not four signals",
                "four of one shape (N,)",
                "give arrays",
            )
        count = four[0].size
        signals = np.ascontiguousarray(
            [*four, np.broadcast_to(np.asarray(payload, float), count)]
        )
        numbers = np.arange(count) + first_tick if ticks is None else np.asarray(ticks)
        # The counter of a board wraps after 2³² periods; NumPy would not accept a
        # negative number as unsigned.
        numbers = np.ascontiguousarray(numbers.astype(np.int64) % 2**32, np.uint32)
        if numbers.shape != (count,):
            raise FieldError(
                "ticks",
                numbers.shape,
                "not one number a period",
                f"({count},)",
                "give N numbers",
            )
        outputs, marks = np.empty((5, count)), np.empty((3, count), np.uint32)
        after = _kernels.law_run(
            self.block,
            state,
            numbers,
            signals,
            outputs,
            marks,
            self.single,
        )
        return bytes(after), LawOutputs(*outputs, *marks)

    def check_wiring(self, motor_angle: ArrayLike, torque: ArrayLike) -> str:
        """Return "none", or what is wrong with the gauge's wiring: law.c's
        commissioning test on a log.

        The motor must turn by `wiring_angle` or more within a quarter of the link's
        vibration period: the tip then lags behind, and the torque [N·m] must rise with
        the motor angle [rad]; both have shape (N,), one value a period. The answers are
        "none", "gauge reversed", "gauge dead" and "not moved enough".
        """
        angle, twist = (np.ascontiguousarray(x, float) for x in (motor_angle, torque))
        if angle.ndim != 1 or angle.shape != twist.shape:
            raise FieldError(
                "torque",
                twist.shape,
                "not one value a sample",
                f"{angle.shape}",
                "give two signals",
            )
        reason = _kernels.law_wiring(self.block, angle, twist, self.single)
        return REASONS[int(reason)]

    @property
    def wiring_angle(self) -> float:
        """By how much [rad] the motor must turn in `wiring_time` for `check_wiring` to
        decide.

        Along the quintic of `smooth_step` the sum of squared steps is 10/7 θ²
        T/duration, and must reach the limits' `wiring_energy`, where the link's torque
        stands clear of the gauge's noise.

        >>> import fraclink as fl
        >>> from fraclink._law import discretize_controller
        >>> rig = fl.Rig.named("paper-2023")
        >>> controller = fl.Controller(derivative_gain=0.069876, derivative_order=0.612197, link=rig.model)
        >>> law = discretize_controller(controller, rig.period, rig=rig)
        >>> f"{law.wiring_angle:.2f} rad in {law.wiring_time:.2f} s"
        '0.26 rad in 0.13 s'
        """
        periods = self.wiring_time / self.period
        return math.sqrt(0.7 * self.limits.wiring_energy * periods)

    @property
    def wiring_time(self) -> float:
        """A quarter of the link's vibration period [s]."""
        # `block_limit` is 1.5 times half a vibration, in periods.
        return self.limits.block_limit * self.period / 3
