"""What a certificate states, in exact numbers and in one sentence, and the file that carries it."""

from __future__ import annotations

import hashlib
import json
import math
import struct
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

from fraclink._arm.link import LinkModel
from fraclink._arm.rig import Rig
from fraclink._display import displayed
from fraclink._files import read_json, write_json
from fraclink._law import Law
from fraclink._law import block as layout
from fraclink.errors import FieldError, FileFormatError, NotCertifiedError

__all__ = ["ASSUMPTIONS", "Certificate", "Statement", "linear_range", "state"]

KIND, FORMAT = "certificate", 2
# The checker knows these sentences too: they lie inside the hash, and a file with others is rejected.
ASSUMPTIONS = (
    "the link is G(s) = (1 + q μ s^α)/(1 + q s^λ + q μ s^α), q proportional to the payload",
    "gauge and encoder are linear, and gauge, second mode and motor are exactly those of the claim",
    "no sample is rejected, nothing trips and nothing saturates; there is no friction",
    "the coupling torque is compensated exactly",
    "the payload does not change during a move",
    "the period is exact and the compiled law computes in IEEE arithmetic",
)
# One sentence with every number to its last digit, so that no two claims read alike.
CLAIM = (
    "For every payload from {payload_low} to {payload_high} kg and every computation delay from {delay_low} "
    "to {delay_high} s, the loop of law {law} ({precision} precision, {real_modes} real modes and "
    "{pair_modes} pairs, period {period} s, {hold} hold, gauge compliance {compliance} rad/(N m)) with a "
    "link of stiffness {stiffness} N m/rad, order {order}, damping {damping} of order {damping_order} and "
    "1/ω₀² = {softness} times the payload (the law was made for {nominal_payload} kg), a gauge of gain "
    "{gauge_gain} and delay {gauge_delay} s, a second mode of gain {mode_gain} at {mode_frequency} rad/s "
    "with damping ratio {mode_damping}, and the {motor_loop} motor loop (pole {pole} rad/s; motor gain "
    "{gain}, rate {decay} 1/s) is stable and |1 + L| > {modulus} at every frequency; tip errors up to "
    "{linear_range} rad meet no limit of the command."
)
COMPLIANCE_TOLERANCE = 1e-6  # of 1/c: what rounding to single precision takes, six times over
LEAST_RANGE = 1e-5  # [rad]: a law whose limits act on smaller errors than 10 µrad never corrects anything
_LOWEST = (
    2.0**-20
)  # of the Nyquist frequency: 0.7 mrad/s at 4 ms, where |Ĉ| is below 1e-3 of its crossover value


@dataclass(frozen=True)
class Statement:
    """The claim: for every payload and delay of the ranges the sampled loop is stable and |1 + L| > modulus.

    Period, gauge compliance, modes and limits are those of `block`, law.c's parameter block byte for byte.
    `softness` κ gives q = 1/ω₀² = κ m. Every number is written to the file in hexadecimal.
    """

    block: str  # hexadecimal
    digest: str  # SHA-256 of the block
    precision: layout.Precision
    hold: str  # "zero-order"
    motor_loop: str  # "ideal": M(s) with `pole`; "sampled": the block's PID on A/(s(s + B))
    stiffness: float  # c [N·m/rad]
    gauge_gain: float  # measured over true torque
    gauge_delay: float  # [s]
    mode_frequency: float  # of the second mode [rad/s]; 0 where none is known
    mode_gain: float
    mode_damping: float
    order: float  # λ
    damping: float  # μ
    damping_order: float  # α
    softness: float  # κ [1/(kg·s^-λ)]
    nominal_payload: float  # [kg], at which the link has the resonance that the block's limits were made for
    payload_low: float  # [kg]
    payload_high: float
    delay_low: float  # [s]
    delay_high: float
    pole: float  # [rad/s], of M(s); 0 for the sampled loop
    gain: float  # A [rad/(V s²)]; 0 for the ideal loop
    decay: float  # B [1/s]
    modulus: float
    lowest: float  # [rad/s]: below it |L| is bounded, above it the tree takes over
    linear_range: float  # [rad]: tip errors up to it meet none of the limits of the command

    @cached_property
    def coefficients(self) -> dict[str, Any]:
        """The numbers of the block under their names in law.h."""
        return layout.unpack(bytes.fromhex(self.block), self.precision)

    @property
    def gauge(self) -> float:
        """Deflection that the law computes over the true one: compliance · c · gauge gain [1]."""
        return float(self.coefficients["compliance"]) * self.stiffness * self.gauge_gain

    def to_json(self) -> dict[str, str]:
        """Every field as text: floats as hexadecimal, so that not one bit depends on a parser."""
        return {k: v.hex() if isinstance(v, float) else str(v) for k, v in asdict(self).items()}

    @staticmethod
    def from_json(data: object) -> Statement:
        """Read back what `to_json` wrote; FileFormatError for anything else."""
        kinds = Statement.__annotations__
        try:
            if not isinstance(data, Mapping) or set(data) != set(kinds):
                raise KeyError("other fields")
            values: dict[str, Any] = {
                k: float.fromhex(v) if kinds[k] == "float" else _text(v) for k, v in data.items()
            }
            made = Statement(**values)
            _ = made.coefficients  # a block that cannot be read is found here
        except (KeyError, TypeError, ValueError, ArithmeticError, struct.error) as error:
            raise _damaged("statement", str(error)[:80], "every field of a statement, as text") from error
        return made

    def words(self) -> str:
        """Return the statement as one sentence; tools/check_certificate.py writes it once more by itself."""
        read = {k: self.coefficients[k] for k in ("real_modes", "pair_modes", "period", "compliance")}
        return CLAIM.format(**asdict(self), **read, law=self.digest[:12])


@displayed
@dataclass(frozen=True)
class Certificate:
    """The outcome of `certify`: a proof, or the place where there is none.

    Attributes
    ----------
    statement
        what was to be proved, in exact numbers.
    passed
        whether it was proved.
    verdict
        one sentence for people.
    tree, leaves
        the proof; empty where there is none.
    payload, frequency, delay
        where it fails [kg, rad/s, s], None where it passed.
    distance
        |1 + L| found there.
    poles
        closed-loop poles of the fractional loop with M(s) at that payload [rad/s], where it is unstable.
    """

    statement: Statement
    passed: bool
    verdict: str
    tree: str = ""
    leaves: int = 0
    payload: float | None = None
    frequency: float | None = None
    delay: float | None = None
    distance: float | None = None
    poles: tuple[complex, ...] = ()

    def _hashed(self) -> dict[str, Any]:
        return {
            "claim": self.verdict,
            "form": CLAIM,
            "assumed": list(ASSUMPTIONS),
            "statement": self.statement.to_json(),
            "tree": self.tree,
        }

    @property
    def sha256(self) -> str:
        """SHA-256 over claim, assumptions, statement and tree: JSON in UTF-8, keys sorted, no spaces."""
        text = json.dumps(self._hashed(), sort_keys=True, separators=(",", ":"), ensure_ascii=False)
        return hashlib.sha256(text.encode()).hexdigest()

    def save(self, path: Path | str) -> None:
        """Write the certificate to one JSON file; NotCertifiedError where nothing was proved."""
        if not self.passed:
            raise NotCertifiedError(self.verdict, payload=self.payload, frequency=self.frequency)
        made = {"python-flint": version("python-flint"), "method": "bisection in ball arithmetic, 64 bit"}
        proof = {"leaves": self.leaves, "sha256": self.sha256, "made_with": made}
        write_json(path, KIND, FORMAT, self._hashed() | proof)

    @staticmethod
    def load(path: Path | str) -> Certificate:
        """Read a certificate back; FileFormatError where its hash does not fit. Reading is not checking.

        A file of format 1 is read with `passed` False: it does not state the gauge, so that its proof also
        holds for a law that computes another tip angle and diverges.
        """
        data = read_json(path, KIND, (1, FORMAT))
        if data["format"] == 1:
            return _first_format(data)
        statement = Statement.from_json(data.get("statement"))
        tree, leaves = data.get("tree"), data.get("leaves")
        if not isinstance(tree, str) or type(leaves) is not int:
            raise _damaged("tree", type(tree).__name__, "a text, and a whole number of leaves")
        made = Certificate(statement, True, statement.words(), tree, leaves)
        if any(data.get(key) != value for key, value in (made._hashed() | {"sha256": made.sha256}).items()):
            raise _damaged("sha256", data.get("sha256"), made.sha256)
        return made


def _first_format(data: Mapping[str, Any]) -> Certificate:
    """What a file of format 1 stated; what it left out is as it had to be for its proof to mean anything."""
    old = data.get("statement")
    if not isinstance(old, Mapping) or not isinstance(old.get("block"), str):
        raise _damaged("statement", type(old).__name__, "every field of a statement, as text")
    exact = {"gauge_gain": 1.0, "linear_range": LEAST_RANGE, "stiffness": 1.0}
    zero = dict.fromkeys(
        ("gauge_delay", "mode_frequency", "mode_gain", "mode_damping", "nominal_payload"), 0.0
    )
    renamed = {"motor_loop" if key == "inner" else key: value for key, value in old.items()}
    added = {key: value.hex() for key, value in (exact | zero).items()} | {"hold": "zero-order"}
    statement = Statement.from_json(added | renamed)
    statement = replace(statement, stiffness=1.0 / float(statement.coefficients["compliance"]))
    text = json.dumps({"statement": old, "tree": data.get("tree")}, sort_keys=True, separators=(",", ":"))
    if data.get("sha256") != hashlib.sha256(text.encode()).hexdigest():
        raise _damaged("sha256", data.get("sha256"), "the hash of statement and tree")
    verdict = "Not certified: a certificate of format 1 does not state the gauge; certify again"
    return Certificate(statement, False, verdict, str(data["tree"]), str(data["tree"]).count("."))


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise TypeError("a field is not text")
    return value


def _damaged(field: str, value: object, allowed: str) -> FileFormatError:
    remedy = "make the certificate again"
    return FileFormatError(field, value, "not that of a certificate", allowed=allowed, remedy=remedy)


def linear_range(coefficients: Mapping[str, Any]) -> float:
    """Return the tip error [rad] up to which no limit of the command acts, rounded down to two digits.

    For |e| ≤ X a state of mode p stays within X (1 + |1 − p|/(1 − |p|)) and the correction within X times
    2|d| + Σ|g| (1 + |1 − p|/(1 − |p|)): l1 norms, term by term. FieldError where a limit leaves less than
    `LEAST_RANGE`: such a law is not the filter that its modes describe.
    """
    c = coefficients
    real, pair = c["real"], c["pair"]
    modes = [(complex(p), abs(g)) for p, g in zip(real[::2], real[1::2], strict=True)]
    modes += [
        (complex(p, y), math.hypot(g, x)) for p, y, g, x in zip(*(pair[k::4] for k in range(4)), strict=True)
    ]
    norms = [(1 + abs(1 - p) / (1 - abs(p)) if abs(p) < 1 else math.inf, g) for p, g in modes if g]
    gain = 2 * abs(c["direct"]) + sum(norm * g for norm, g in norms)
    command = min(c["sum_limit"], c["motor_limit"], c["motor_step"] / 2) / max(gain, 1e-300)
    reach = min(command, c["correction_limit"] / max([norm for norm, _ in norms] + [1.0])) * (1 - 1e-9)
    if not (math.isfinite(reach) and reach >= LEAST_RANGE):
        allowed = f"limits that errors of {LEAST_RANGE:g} rad do not meet"
        raise FieldError(
            "law.limits",
            reach,
            "too narrow for the correction",
            allowed=allowed,
            remedy="use the derived limits",
        )
    digit = 10.0 ** (math.floor(math.log10(reach)) - 1)
    return float(f"{math.floor(reach / digit) * digit:.2g}")


def _check_law(law: Law, model: LinkModel) -> None:
    """FieldError where the law's gauge or its limits are not those of the link that the claim is about."""
    c = law.coefficients
    deflection = float(c["compliance"]) * model.stiffness  # type: ignore[arg-type]
    if not min(abs(deflection - 1), abs(deflection * model.gauge_gain - 1)) <= COMPLIANCE_TOLERANCE:
        raise FieldError(
            "law.stiffness",
            law.stiffness,
            "not the link's: the law would compute another tip angle than the claim",
            allowed=f"{model.stiffness:g} N·m/rad",
            remedy="discretise the controller with this link",
        )
    names = [name for name, _ in layout.REALS]
    for name in (*layout.COUNTS[4:], *names[names.index("sum_limit") : names.index("inner_direct")]):
        if not float(c[name]) > 0:  # type: ignore[arg-type]
            remedy = "use the derived limits"
            raise FieldError(f"law.limits.{name}", c[name], "not positive", allowed="> 0", remedy=remedy)


def state(
    law: Law,
    model: LinkModel,
    rig: Rig,
    *,
    payloads: tuple[float, float],
    softness: float,
    nominal_payload: float,
    delay: tuple[float, float],
    motor_loop: str,
    modulus: float,
) -> Statement:
    """Return the statement about `law` on `model`, with q = `softness` · payload."""
    if model.order >= 2.0 and not model.damping:
        raise FieldError(
            "model.order",
            model.order,
            "two without damping: the link's pole lies on the stability boundary",
            allowed="λ < 2, or damping > 0",
            remedy="certify with the identified damping, which every real link has",
        )
    if motor_loop == "sampled" and not (law.drive and rig.motor.decay > 0.0):
        raise FieldError(
            "inner",
            motor_loop,
            "without a motor loop in the law or friction in the motor",
            allowed="a law with its motor loop, B > 0",
            remedy="make the law with Design.law()",
        )
    if model.gauge_delay < 0 or model.gauge_gain <= 0:
        remedy = "certify with the gauge's true sign and delay"
        raise FieldError("model.gauge_delay", model.gauge_delay, "negative", allowed=">= 0 s", remedy=remedy)
    _check_law(law, model)
    mode = model.second_mode
    ideal = motor_loop == "ideal"
    return Statement(
        block=law.block.hex(),
        digest=law.digest,
        precision=law.precision,
        hold="zero-order",
        motor_loop=motor_loop,
        stiffness=float(model.stiffness),
        gauge_gain=float(model.gauge_gain),
        gauge_delay=float(model.gauge_delay),
        mode_frequency=0.0 if mode is None else float(mode.frequency),
        mode_gain=0.0 if mode is None else float(mode.gain),
        mode_damping=0.0 if mode is None else float(mode.damping_ratio),
        order=float(model.order),
        damping=float(model.damping),
        damping_order=float(model.damping_order),
        softness=softness,
        nominal_payload=nominal_payload,
        payload_low=float(payloads[0]),
        payload_high=float(payloads[1]),
        delay_low=float(delay[0]),
        delay_high=float(delay[1]),
        pole=float(law.inner_pole) if ideal else 0.0,
        gain=0.0 if ideal else float(rig.motor.gain),
        decay=0.0 if ideal else float(rig.motor.decay),
        modulus=float(modulus),
        lowest=_LOWEST * math.pi / law.period,
        linear_range=linear_range(law.coefficients),
    )
