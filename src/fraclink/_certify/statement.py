"""The statement of a certificate in exact numbers and in one sentence, and its file."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from fraclink._arm.box import ParameterBox, outward
from fraclink._arm.link import LinkModel
from fraclink._arm.rig import Rig
from fraclink._display import (
    Overview,
    Row,
    Table,
    displayed,
    number,
    rows_of,
    span,
    state_of,
)
from fraclink._files import Saved, digest_of, document
from fraclink._law import Law
from fraclink._law import block as layout
from fraclink._law.block import linear_range, modes_of
from fraclink.errors import FieldError, NotCertifiedError

__all__ = [
    "ASSUMPTIONS",
    "PARAMETERS",
    "Certificate",
    "Statement",
    "state",
]

# The parameters of an arm: "softness" is q = 1/ω₀², "loss" is η = μ/ω₀² of the material,
# "motor" is p or A.
PARAMETERS = (
    "softness",
    "delay",
    "gauge_gain",
    "gauge_delay",
    "order",
    "loss",
    "motor",
    "mode_frequency",
    "mode_gain",
)
# Aliases included in L with their phase, at ω + 2πn/Ts, from this fraction of the
# Nyquist frequency on. Without a filter |L| near the Nyquist frequency is arbitrarily
# large; there the nearest alias is as large as L, and those that are not included add up
# to 0.04 of it. At lower frequencies the nearest alias is below (1/9)³ of L, and bounds
# of the moduli suffice.
ALIASES = (-1, 1, -2, 2, -3)
ALIASES_FROM = 0.2
# The checker contains the same sentences: they are part of the hash, and a file with
# other sentences is rejected.
ASSUMPTIONS = (
    "the link is G(s) = (1 + η s^α)/(1 + q s^λ + η s^α), q proportional to the payload and η the same for all",
    "gauge and encoder are linear, and gauge, second mode and motor lie within the intervals of the claim",
    "no sample is rejected, nothing trips and nothing saturates; there is no friction",
    "the coupling torque is compensated exactly",
    "neither the payload nor any other parameter changes during a move",
    "the period is exact and the compiled law computes in IEEE arithmetic",
)
# One sentence with all digits of every number, so that different claims have different
# sentences.
CLAIM = (
    "For every payload from {payload_low} to {payload_high} kg and every computation delay from {delay_low} "
    "to {delay_high} s, every link with 1/ω₀² from {softness_low} to {softness_high} times the payload, "
    "order from {order_low} to {order_high}, damping μ/ω₀² from {loss_low} to {loss_high} of order "
    "{damping_order} and stiffness {stiffness} N m/rad (the law was made for {nominal_payload} kg), every "
    "gauge of gain from {gauge_gain_low} to {gauge_gain_high} and delay from {gauge_delay_low} to "
    "{gauge_delay_high} s, every "
    "second mode of gain from {mode_gain_low} to {mode_gain_high} at {mode_frequency_low} to "
    "{mode_frequency_high} rad/s with damping ratio {mode_damping}, and every {motor_loop} motor loop (pole "
    "from {pole_low} to {pole_high} rad/s; motor gain from {gain_low} to {gain_high}, rate {decay} 1/s), the "
    "loop of law {law} ({precision} precision, {real_modes} real modes and {pair_modes} pairs, period "
    "{period} s, {hold} hold, gauge compliance {compliance} rad/(N m)) is stable and |1 + L| > {modulus} at "
    "every frequency; tip errors up to {linear_range} rad meet no limit of the command, and moves up to {angle} rad, "
    "{velocity} rad/s and {acceleration} rad/s² none of a sensor or of the motor (friction {friction} V, coupling "
    "{coupling} V/(N m))."
)
# [rad per sample] From 0 to here |L| is bounded: 2^-20 of the Nyquist frequency, 0.75
# mrad/s at 4 ms, where |Ĉ| is about 1e-3 of its value at the crossover; or a twentieth
# of the rate of the slowest mode, if that is less.
_LOWEST, _SLOWEST = 2.0**-20 * math.pi, 0.05


@displayed
@dataclass(frozen=True)
class Statement:
    """The claim: everywhere in a box of parameters the sampled loop is stable and |1 +
    L| > modulus.

    Period, gauge compliance, modes and limits are those of `block`, law.c's parameter
    block byte for byte. `softness` κ gives q = 1/ω₀² = κ m. Every number is written to
    the file in hexadecimal.
    """

    __made_by__ = "certify(design).statement"

    block: str  # hexadecimal
    digest: str  # SHA-256 of the block
    precision: layout.Precision
    hold: str  # "zero-order"
    motor_loop: (
        str  # "ideal": M(s) with its pole; "sampled": the block's PID on A/(s(s + B))
    )
    stiffness: float  # c [N·m/rad]
    damping_order: float  # α
    mode_damping: float  # ζ of the second mode
    # [kg], of the model; at it, the middle link has the resonance from which the limits
    # were derived
    nominal_payload: float
    decay: float  # B [1/s]; 0 for the ideal loop
    payload_low: float  # [kg]
    payload_high: float
    delay_low: float  # computation delay [s]
    delay_high: float
    softness_low: float  # κ [1/(kg·s^-λ)]
    softness_high: float
    order_low: float  # λ
    order_high: float
    loss_low: float  # η = μ/ω₀² [s^α]
    loss_high: float
    # gain of measured over true torque, including the error of the stiffness
    gauge_gain_low: float
    gauge_gain_high: float
    gauge_delay_low: float  # [s]
    gauge_delay_high: float
    mode_frequency_low: float  # of the second mode [rad/s]; 0 where none is known
    mode_frequency_high: float
    mode_gain_low: float
    mode_gain_high: float
    pole_low: float  # [rad/s], of M(s); 0 for the sampled loop
    pole_high: float
    gain_low: float  # A [rad/(V s²)]; 0 for the ideal loop
    gain_high: float
    modulus: float
    lowest: float  # [rad/s]: below it |L| is bounded, above it the tree applies
    linear_range: (
        float  # [rad]: tip errors up to it stay below all limits of the command
    )
    angle: float  # [rad]: moves up to this and the two limits below trip no guard
    velocity: float  # [rad/s]
    acceleration: float  # [rad/s²]
    friction: float  # Coulomb friction of the motor [V]
    coupling: float  # 1/(K n), the compensation of the coupling torque [V/(N·m)]

    @property
    def clearance(self) -> str:
        """The distance to −1, and the margins that it leaves.

        |1 + L| > m leaves a phase margin above 2 asin(m/2) and a gain margin above
        1/(1 − m).
        """
        # Rounded downwards: rounding up would claim more than is proved.
        modulus = math.floor(1e3 * self.modulus + 1e-9) / 1e3
        angle = math.degrees(2.0 * math.asin(min(1.0, 0.5 * modulus)))
        factor = (
            math.floor(100.0 / (1.0 - modulus)) / 100.0 if modulus < 1.0 else math.inf
        )
        return (
            f"distance to −1 above {number(modulus)}, which is at least "
            f"{math.floor(10.0 * angle) / 10.0:.1f}° of phase margin and a gain margin of "
            f"{number(factor)}"
        )

    @property
    def sentence(self) -> str:
        """The claim in units that a person reads; its box of arms is the table
        `intervals`.
        """
        return (
            f"proved stable for every payload from {span(self.payload_low, self.payload_high, 'g')}, "
            f"every computation delay from {span(self.delay_low, self.delay_high, 'ms')} and "
            f"every arm of the stated box; {self.clearance}"
        )

    def overview(self) -> Overview:
        """What is claimed, and for which arms."""
        return Overview(self.sentence, "", (), (self.intervals,))

    @property
    def intervals(self) -> Table:
        """Least and largest value of everything that the claim is about."""
        quantities = (
            ("payload", "payload", "g"),
            ("delay", "computation delay", "ms"),
            ("order", "order λ", ""),
            ("softness", "1/ω₀² over the payload", "1/(kg·s^−λ)"),
            ("loss", "damping μ/ω₀²", "s^α"),
            ("gauge_gain", "gain of the gauge", ""),
            ("gauge_delay", "delay of the gauge", "ms"),
            ("mode_frequency", "second mode", "rad/s"),
            ("mode_gain", "gain of the second mode", ""),
            ("pole", "pole of the motor loop", "rad/s"),
            ("gain", "gain of the motor", "rad/(V·s²)"),
        )
        ends = [
            (
                name,
                words,
                unit,
                getattr(self, f"{name}_low"),
                getattr(self, f"{name}_high"),
            )
            for name, words, unit in quantities
        ]
        return Table.of(
            "box",
            (
                (
                    Row("name", "inside the proof", words),
                    Row("low", "from", low, unit),
                    Row("high", "to", high, unit),
                )
                for name, words, unit, low, high in ends
                if low or high
            ),
        )

    @cached_property
    def coefficients(self) -> dict[str, Any]:
        """The numbers of the block under their names in law.h."""
        return layout.unpack(bytes.fromhex(self.block), self.precision)

    @property
    def whole(self) -> int:
        """Whole periods of the computation delay, without the last part of a period."""
        period = float(self.coefficients["period"])
        return max(math.ceil(self.delay_high / period * (1 - 1e-9)) - 1, 0)

    @property
    def softness(self) -> float:
        """κ in the middle of its interval."""
        return 0.5 * (self.softness_low + self.softness_high)

    @property
    def link(self) -> LinkModel:
        """The link in the middle of the box, with the nominal payload."""
        spring = 1.0 / (self.softness * self.nominal_payload)
        return LinkModel(
            stiffness=self.stiffness,
            natural_frequency=math.sqrt(spring),
            order=0.5 * (self.order_low + self.order_high),
            damping=0.5 * (self.loss_low + self.loss_high) * spring,
            damping_order=self.damping_order,
            payload=self.nominal_payload,
            gauge_delay=self.gauge_delay_low,
        )

    @property
    def box(self) -> tuple[dict[str, float], dict[str, float]]:
        """Lower and upper ends of every parameter; q is widened by the rounding of its
        product.
        """
        motor = "pole" if self.motor_loop == "ideal" else "gain"
        low, high = (
            {
                name: getattr(self, f"{motor if name == 'motor' else name}_{end}")
                for name in PARAMETERS
            }
            for end in ("low", "high")
        )
        low["softness"] = math.nextafter(self.softness_low * self.payload_low, 0.0)
        high["softness"] = math.nextafter(
            self.softness_high * self.payload_high, math.inf
        )
        if not self.mode_gain_high:
            low["mode_frequency"] = high["mode_frequency"] = 0.0
        return low, high

    def words(self) -> str:
        """Return the statement as one sentence; tools/check_certificate.py forms it
        independently.
        """
        figures = {
            k: self.coefficients[k]
            for k in ("real_modes", "pair_modes", "period", "compliance")
        }
        return CLAIM.format(**asdict(self), **figures, law=self.digest[:12])


# Fields on the place where the proof fails; a saved certificate has none.
_UNSTORED = {"stored": False}


def _claimed(certificate: Certificate) -> dict[str, object]:
    """What a file says besides the numbers; NotCertifiedError where nothing was
    proved.
    """
    if not certificate.passed:
        raise NotCertifiedError(
            certificate.verdict,
            payload=certificate.payload,
            frequency=certificate.frequency,
        )
    return {
        "claim": certificate.verdict,
        "form": CLAIM,
        "assumed": list(ASSUMPTIONS),
    }


@displayed
@document("certificate", version=6, hex_floats=True, summary=_claimed)
@dataclass(frozen=True)
class Certificate(Saved):
    """The outcome of `certify`: a proof, or the place where there is none.

    Only a proof can be saved, and reading one back is not checking it.

    Attributes
    ----------
    statement
        what was to be proved, in exact numbers.
    tree, leaves
        the proof; empty where there is none.
    refusal
        one sentence on why there is none; empty where it passed.
    payload, frequency, delay
        where it fails [kg, rad/s, s], None where it passed.
    distance
        |1 + L| found there.
    place
        every parameter there by name: λ as "order", q as "softness", and so on.
    """

    __made_by__ = "fraclink.certify(design)"

    statement: Statement
    tree: str = ""
    leaves: int = 0
    refusal: str = field(default="", metadata=_UNSTORED)
    payload: float | None = field(default=None, metadata=_UNSTORED)
    frequency: float | None = field(default=None, metadata=_UNSTORED)
    delay: float | None = field(default=None, metadata=_UNSTORED)
    distance: float | None = field(default=None, metadata=_UNSTORED)
    place: tuple[tuple[str, float], ...] = field(default=(), metadata=_UNSTORED)

    @property
    def passed(self) -> bool:
        """Whether it was proved."""
        return bool(self.tree)

    @property
    def verdict(self) -> str:
        """One sentence for people: the exact claim, or why it was not proved."""
        return self.statement.words() if self.passed else self.refusal

    @property
    def sentence(self) -> str:
        """What was proved, in units that a person reads, or where the proof fails."""
        return self.statement.sentence if self.passed else self.verdict

    def overview(self) -> Overview:
        """What was proved, and for which arms; the exact claim is its `verdict`."""
        rows = rows_of(
            self,
            "verdict",
            "payload",
            "frequency",
            Row("modulus", "", self.statement.modulus if self.passed else None),
            Row("sha256", "", self.sha256 if self.passed else None),
        )
        return Overview(
            # The sign before the headline already says "failed".
            self.sentence.removeprefix("Not certified: "),
            state_of(self.passed),
            rows,
            (self.statement.intervals,) if self.passed else (),
        )

    @property
    def sha256(self) -> str:
        """SHA-256 of its file: of claim, assumptions, statement and tree."""
        return digest_of(self)


def _check_law(law: Law, model: LinkModel) -> None:
    """FieldError if the law's gauge compliance does not belong to the link of the
    claim.
    """
    c = law.coefficients
    deflection = float(c["compliance"]) * model.stiffness  # type: ignore[arg-type]
    off = min(abs(deflection - 1), abs(deflection * model.gauge_gain - 1))
    # The compliance 1/c is rounded to single precision.
    if not off <= np.finfo(np.float32).eps:
        raise FieldError(
            "law.stiffness",
            law.stiffness,
            "not the link's: the law would compute another tip angle than the claim",
            f"{model.stiffness:g} N·m/rad",
            "discretise the controller with this link",
        )


def _check_provable(law: Law, model: LinkModel, rig: Rig, box: ParameterBox) -> None:
    """FieldError where the formulas of the proof do not describe the arm, with the
    remedy.
    """
    if box.order[1] >= 2.0 and not box.damping[0]:
        raise FieldError(
            "model.order",
            box.order[1],
            "2 or more without damping: the link's pole lies on the stability boundary",
            "λ < 2, or damping > 0",
            "certify with the identified damping, which every real link has",
        )
    if law.motor_loop and not rig.motor.decay > 0.0:
        raise FieldError(
            "motor.viscous_friction",
            rig.motor.viscous_friction,
            "no friction: the motor's pole lies on the stability boundary",
            "> 0 N·m·s",
            "state the motor's viscous friction, which every motor has",
        )
    if box.gauge_delay[0] < 0:
        raise FieldError(
            "model.gauge_delay",
            box.gauge_delay[0],
            "negative",
            ">= 0 s",
            "certify with the gauge's true delay",
        )
    if box.gauge_gain[0] <= 0:
        raise FieldError(
            "model.gauge_gain",
            box.gauge_gain[0],
            "not positive",
            "> 0",
            "certify with the gauge's true sign",
        )


def state(
    law: Law,
    model: LinkModel,
    rig: Rig,
    *,
    box: ParameterBox,
    payloads: tuple[float, float],
    delay: tuple[float, float],
    modulus: float,
) -> Statement:
    """Return the statement about `law` over `box`, around `model` with a known payload.

    A law that closes the motor loop is proved with its own PID on the rig's motor; a
    law for a drive with its own position servo is proved with M(s).
    """
    _check_provable(law, model, rig, box)
    _check_law(law, model)
    # A pole outside the unit circle is rejected when the proof begins.
    gaps = [1 - abs(p) for p, _ in modes_of(law.coefficients) if abs(p) < 1]
    ideal, ratio = law.motor_loop is None, box.motor_ratio
    motor_loop = "ideal" if ideal else "sampled"
    soft = [1.0 / (w0**2 * model.payload) for w0 in reversed(box.natural_frequency)]  # type: ignore[operator]
    motor = outward(*(law.motor_loop_pole * x for x in ratio)) if ideal else (0.0, 0.0)
    gain = (0.0, 0.0) if ideal else outward(*(rig.motor.gain * x for x in ratio))
    intervals = {
        "payload": (float(payloads[0]), float(payloads[1])),
        "delay": (float(delay[0]), float(delay[1])),
        "softness": outward(*soft),
        "loss": outward(
            *(
                mu / w0**2
                for mu, w0 in zip(
                    box.damping, reversed(box.natural_frequency), strict=True
                )
            )
        ),
        "pole": motor,
        "gain": gain,
    }
    intervals |= {
        name: outward(*getattr(box, name))
        for name in (
            "order",
            "gauge_gain",
            "gauge_delay",
            "mode_frequency",
            "mode_gain",
        )
    }
    ends = {
        f"{name}_{end}": pair[k]
        for name, pair in intervals.items()
        for k, end in enumerate(("low", "high"))
    }
    return Statement(
        block=law.block.hex(),
        digest=law.digest,
        precision=law.precision,
        hold="zero-order",
        motor_loop=motor_loop,
        stiffness=float(model.stiffness),
        damping_order=float(model.damping_order),
        mode_damping=0.0
        if model.second_mode is None
        else float(model.second_mode.damping_ratio),
        nominal_payload=float(model.payload),  # type: ignore[arg-type]
        decay=0.0 if ideal else float(rig.motor.decay),
        modulus=float(modulus),
        lowest=min([_LOWEST, *(_SLOWEST * gap for gap in gaps)]) / law.period,
        linear_range=linear_range(law.coefficients),
        **_moves(model, rig),
        friction=rig.motor.coulomb_torque / rig.motor.torque_constant,
        coupling=1 / (rig.motor.torque_constant * rig.motor.gear_ratio),
        **ends,
    )


def _moves(model: LinkModel, rig: Rig) -> dict[str, float]:
    """Two thirds of the largest move for which the guards were derived; the rest is a
    margin for payloads and vibration. The torque stays within the limits of the gauge
    and of the user.
    """
    moves, bend = rig.moves, float(abs(model.lead(model.resonance)))
    torque = min(0.87 * rig.gauge.limit, moves.torque)
    most = torque / (2 * model.stiffness * bend)
    return {
        "angle": 2 / 3 * moves.angle,
        "velocity": 2 / 3 * moves.velocity,
        "acceleration": min(2 / 3 * moves.acceleration, most),
    }
