"""What a certificate states: the sampled loop in exact numbers, and the ranges over which it is proved."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from fraclink.errors import FieldError

if TYPE_CHECKING:
    from fraclink._arm.link import LinkModel
    from fraclink._arm.rig import Rig
    from fraclink._law import Law

__all__ = ["ASSUMPTIONS", "Statement", "canonical", "digest_of"]

ASSUMPTIONS = (
    "the link is G(s) = (1 + q μ s^α)/(1 + q s^λ + q μ s^α), q proportional to the payload: one mode",
    "the motor loop is what the statement says: M(s), or motor and PID without friction or saturation",
    "the coupling torque and the friction are compensated exactly; encoder and gauge are linear",
    "the payload does not change during a move",
    "the period is exact and the compiled law computes in IEEE arithmetic",
)


@dataclass(frozen=True)
class Statement:
    """The claim: for every payload and delay of the ranges the sampled loop is stable and |1 + L| > modulus.

    ``softness`` κ gives q = 1/ω₀² = κ m; ``inner`` is "ideal" (M(s) with `pole`) or "sampled" (the motor
    `gain`/(s(s+`decay`)) with the PID in the law's block). Floats are written in hexadecimal.
    """

    block: str  # law.c's parameter block, hexadecimal
    digest: str  # SHA-256 of the block
    precision: str
    order: float  # λ
    damping: float  # μ
    damping_order: float  # α
    softness: float  # κ [1/(kg·s^-λ)]
    payload_low: float  # [kg]
    payload_high: float
    delay_low: float  # [s]
    delay_high: float
    inner: str
    pole: float  # [rad/s], of M(s); 0 for the sampled loop
    gain: float  # A [rad/(V s²)]; 0 for the ideal loop
    decay: float  # B [1/s]
    modulus: float
    lowest: float  # [rad/s]: below it |L| is bounded, above it the tree takes over

    def to_json(self) -> dict[str, str]:
        """Every field as text: floats as hexadecimal, so that not one bit depends on a parser."""
        return {k: v.hex() if isinstance(v, float) else str(v) for k, v in asdict(self).items()}

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> Statement:
        """Read back what `to_json` wrote; FieldError for anything else."""
        kinds = Statement.__annotations__
        if set(data) != set(kinds) or not all(isinstance(v, str) for v in data.values()):
            raise FieldError(
                "statement",
                sorted(map(str, data))[:3],
                "not a statement",
                allowed=", ".join(kinds),
                remedy="make it again",
            )
        values: dict[str, Any] = {k: float.fromhex(v) if kinds[k] == "float" else v for k, v in data.items()}
        return Statement(**values)

    def words(self) -> str:
        """The statement as a sentence."""
        motor = f"M(s) with p = {self.pole:g} rad/s" if self.inner == "ideal" else "the sampled motor loop"
        payload = f"{self.payload_low * 1e3:g} to {self.payload_high * 1e3:g} g"
        delay = f"{self.delay_low * 1e3:g} to {self.delay_high * 1e3:g} ms"
        return (
            f"For every payload from {payload} and every delay from {delay}, with {motor} and λ = "
            f"{self.order:g}, the loop that the law {self.digest[:12]} closes is stable and |1 + L| > "
            f"{self.modulus:g} at every frequency."
        )


def canonical(statement: Statement, tree: str) -> bytes:
    """The bytes that a certificate's own hash covers: statement and tree, keys sorted, no spaces."""
    return json.dumps(
        {"statement": statement.to_json(), "tree": tree}, sort_keys=True, separators=(",", ":")
    ).encode()


def digest_of(statement: Statement, tree: str) -> str:
    """SHA-256 of `canonical`, 64 hexadecimal digits."""
    return hashlib.sha256(canonical(statement, tree)).hexdigest()


def state(
    law: Law,
    model: LinkModel,
    rig: Rig,
    *,
    payloads: tuple[float, float],
    natural_frequency: float,
    at_payload: float,
    delay: tuple[float, float],
    inner: str,
    modulus: float,
) -> Statement:
    """Return the statement about `law` on `model`; ω₀ is `natural_frequency` at `at_payload` [kg]."""
    if model.order >= 2.0 and not model.damping:
        raise FieldError(
            "model.order",
            model.order,
            "two without damping: the link's pole lies on the stability boundary",
            allowed="λ < 2, or damping > 0",
            remedy="certify with the identified damping, which every real link has",
        )
    if inner == "sampled" and not (law.drive and rig.motor.decay > 0.0):
        raise FieldError(
            "inner",
            inner,
            "without a motor loop in the law or friction in the motor",
            allowed="a law with its inner loop, B > 0",
            remedy="make the law with Design.law()",
        )
    return Statement(
        block=law.block.hex(),
        digest=law.digest,
        precision=law.precision,
        order=float(model.order),
        damping=float(model.damping),
        damping_order=float(model.damping_order),
        softness=1.0 / (natural_frequency**2 * at_payload),
        payload_low=float(payloads[0]),
        payload_high=float(payloads[1]),
        delay_low=float(delay[0]),
        delay_high=float(delay[1]),
        inner=inner,
        pole=float(law.inner_pole) if inner == "ideal" else 0.0,
        gain=float(rig.motor.gain) if inner == "sampled" else 0.0,
        decay=float(rig.motor.decay) if inner == "sampled" else 0.0,
        modulus=float(modulus),
        lowest=_LOWEST * math.pi / law.period,
    )


_LOWEST = (
    2.0**-20
)  # of the Nyquist frequency: 0.7 mrad/s at 4 ms, where |Ĉ| is below 1e-3 of its crossover value
