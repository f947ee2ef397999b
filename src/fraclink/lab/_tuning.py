"""The plan of a tuning and its results so far: every completed stage, in one file."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated

from fraclink._arm.rig import Rig
from fraclink._display import Overview, Row, Table, displayed, rows_of
from fraclink._files import document
from fraclink.errors import FieldError
from fraclink.findings import Scope, Verdict
from fraclink.lab._machine import PERIOD
from fraclink.lab._tune_causes import domain
from fraclink.lab._tune_guard import PLANNED, WINDOW, MotionLimits
from fraclink.lab._tune_link import LinkResult
from fraclink.lab._tune_motor import FIRST, MotorResult
from fraclink.lab._tune_moves import AFTER, FirstMove
from fraclink.lab._tune_wiring import MOST, STRONGEST, Wiring
from fracsys.checks import Payload, checked, checked_noun

__all__ = ["FILES", "Tuning", "TuningPlan", "measured"]

# removed if the law fails on the arm
LAW_FILES = ("design.json", "law.json", "certificate.json")
FILES = ("tuning.json", "rig.toml", "model.json", *LAW_FILES, "log.npz")

# [rad] at the transfer: 1.1°, which is visible; with a bumpless transfer the law moves
# the motor by its noise alone
_JUMP = 0.02


@checked
@dataclass(frozen=True)
class TuningPlan:
    """The request for a tuning: the limits, the payload that the arm carries, and the
    range that it is to carry.

    Parameters
    ----------
    limits
        of angle, speed, torque and voltage.
    payload
        at the tip during the tuning [kg]; it cannot be determined from motion.
    payloads
        (lightest, heaviest) that the law is for [kg]; default: from three quarters of
        the payload to a third more.
    period
        of the arm [s]; None for an arm that states its own.
    rig
        what is known of the arm: scales are compared with its motor and link; the
        gauge's range and the requests for the design come from it.

    Examples
    --------
    >>> limits = MotionLimits(angle=0.5, speed=3.0, torque=2.0, voltage=5.0)
    >>> plan = TuningPlan(limits, payload=0.030)
    >>> plan.range
    (0.0225, 0.04)
    >>> print(plan.text.splitlines()[1])
    limits: 28.6° to each side of where the arm stands, 3 rad/s, 2 N·m at the gauge, 5 V
    """

    limits: MotionLimits
    payload: Payload
    payloads: tuple[float, float] | None = None
    period: Annotated[float, PERIOD] | None = None
    rig: Rig | None = None

    def __post_init__(self) -> None:
        checked_noun(
            "limits",
            self.limits,
            MotionLimits,
            remedy="MotionLimits(angle, speed, torque, voltage)",
        )
        if self.payloads is not None:
            low, high = self.payloads
            if not 0 < low <= self.payload <= high:
                raise FieldError(
                    "payloads",
                    self.payloads,
                    "the tuning payload is not in the range",
                    f"low <= {self.payload:g} <= high [kg]",
                    "tune with a payload in the range",
                )

    @property
    def range(self) -> tuple[float, float]:
        """(lightest, heaviest) payload that the law is for [kg]."""
        if self.payloads is not None:
            return self.payloads
        # The range of a rig only applies if it contains this payload; otherwise it
        # belongs to another tool at the tip.
        if (
            self.rig is not None
            and self.rig.payloads.low <= self.payload <= self.rig.payloads.high
        ):
            return self.rig.payloads.low, self.rig.payloads.high
        # By the same factor in both directions: the measured payload is the geometric
        # mean of the ends, and ω₀ ∝ 1/√m.
        return 0.75 * self.payload, float(f"{4 / 3 * self.payload:.6g}")

    @property
    def text(self) -> str:
        """What will move, how far, how hard and how long."""
        limits, part = self.limits, round(100 * PLANNED)
        low, high = (1e3 * payload for payload in self.range)
        return "\n".join(
            (
                "The motor will move the arm: nobody may be within its reach, and a hand stays at the "
                "emergency stop.",
                f"limits: {math.degrees(limits.angle):.3g}° to each side of where the arm stands, "
                f"{limits.speed:g} rad/s, {limits.torque:g} N·m at the gauge, {limits.voltage:g} V",
                domain(self.period),
                "1 wiring: short pulses that grow until the motor turns by 1°; they move it over "
                f"{math.degrees(2.0 * MOST):.2g}° at most and keep the speed limit, even with dead sensors if the "
                f"motor accelerates by no more than {STRONGEST:g} rad/s²; no loop is closed; 8 s",
                f"2 motor: slow moves within ±{math.degrees(min(FIRST, PLANNED * limits.angle)):.2g}°, "
                f"growing to {part} % of the limits where that is needed; 5 to 15 s",
                f"3 link: a random sequence within ±6.9°, growing to {part} % of the limits where that is "
                "needed, and a random voltage for 2 s; 8 to 25 s",
                f"4 the drive is off: model, design for {low:.3g} to {high:.3g} g, proof, law; a few seconds",
                f"5 first moves: up to {math.degrees(PLANNED * limits.angle):.3g}°, at a tenth of the speed and "
                "twice at full speed; 11 to 17 s for each law, three at most",
            )
        )


@displayed
@document(
    "tuning",
    summary=lambda tuning: {"passed": tuning.passed, "stopped": tuning.stopped},
)
@dataclass(frozen=True, eq=False)
class Tuning:
    """A tuning: what each stage found, None where it was not reached.

    Parameters
    ----------
    limits, payload, payloads, period
        as requested [kg], [s].
    wiring, motor, link
        what was measured.
    certified
        the verdict of the proof; empty where there is none.
    design_passed
        whether the design keeps its requirements over the box.
    reasons
        why there is no law.
    planned
        amplitude [rad] and duration [s] of the fastest move within the limits that
        passes in the simulation.
    moves
        the first moves, promised and measured.
    stopped
        why the tuning ended early; empty where it did not.
    arm_time, computing
        how long the arm was moved, and how long the computations took [s].
    folder
        where the files are.
    rig
        what was stated of the arm, None where nothing was.
    """

    __made_by__ = "fraclink.tune(connection, limits=…, payload=…)"

    limits: MotionLimits
    payload: float
    payloads: tuple[float, float]
    period: float
    wiring: Wiring | None = None
    motor: MotorResult | None = None
    link: LinkResult | None = None
    certified: str = ""
    design_passed: bool = False
    reasons: tuple[str, ...] = ()
    planned: tuple[float, float] | None = None
    moves: tuple[FirstMove, ...] = ()
    stopped: str = ""
    arm_time: float = 0.0
    computing: float = 0.0
    folder: str = ""
    rig: Rig | None = None

    @property
    def verdict(self) -> Verdict:
        """The scopes: the proof, the model's moves, the arm's own."""
        if self.certified and self.design_passed:
            promise = Scope("passed")
        elif self.reasons or self.stopped:
            # Reasons are findings against a law; a stop alone leaves open whether there
            # is one.
            promise = Scope(
                "failed" if self.reasons else "not run", self.reasons or (self.stopped,)
            )
        else:
            promise = Scope("not run")
        if not self.moves:
            return Verdict(
                promise,
                Scope("not run"),
                Scope("not run"),
                Scope("not run", (self.stopped,) if self.stopped else ()),
            )
        # Judged by the promised settling time instead of the arm's, since this scope is
        # that of the model: a move that still vibrates leaves the band again in the last
        # window, and so settles within that.
        last = {move.payload: move for move in self.moves}
        model = (
            Scope("passed")
            if all(
                move.promised_settling <= move.duration + AFTER - WINDOW
                for move in last.values()
            )
            else Scope("failed", ("the model's move does not settle",))
        )
        return Verdict(promise, model, Scope("not run"), self._arm())

    @property
    def next_move(self) -> tuple[float, float, float] | None:
        """Amplitude [rad] and duration [s] of a move that was simulated and stays within
        the limits from where the tuning has left the arm, and its payload [kg].
        """
        if self.moves:
            # In the opposite direction: the last move went towards the middle and
            # beyond.
            last = self.moves[-1]
            return -last.amplitude, last.duration, last.payload
        return None if self.planned is None else (*self.planned, self.payload)

    def _arm(self) -> Scope:
        off = [str(move) for move in self.moves if not move.kept]
        off += [
            f"jump of {move.jump:.2g} rad at the hand-over"
            for move in self.moves
            if move.jump > _JUMP
        ]
        if self.stopped:
            off.append(self.stopped)
        return Scope("failed", tuple(off)) if off else Scope("passed")

    @property
    def passed(self) -> bool:
        """Whether law, proof and the arm's own moves passed."""
        return self.verdict.passed

    @property
    def has_law(self) -> bool:
        """Whether there is a law whose design and proof passed."""
        return bool(self.certified) and self.design_passed

    def overview(self) -> Overview:
        """The measured values with their errors, the first moves, and the scopes."""
        verdict = self.verdict
        time = f"{self.arm_time:.0f} s on the arm, {self.computing:.1f} s of computing"
        moves = Table.of("moves", self.moves)
        rows = rows_of(self, "stopped", "reasons", "verdict", *self._measured())
        return Overview(
            f"stopped: {self.stopped}" if self.stopped else time,
            verdict.state,
            rows,
            (*((moves,) if self.moves else ()), *verdict.overview().tables),
            notes=self.wiring.evidence if self.wiring else (),
        )

    def _measured(self) -> Iterator[Row]:
        """The fits of motor and link, and their figures with standard errors."""
        for part, stage in (("motor", self.motor), ("link", self.link)):
            if stage is not None:
                yield Row(part, "", stage.fit)
                yield from (replace(row, key="") for row in stage.fit.rows)
        if self.motor is not None:
            yield Row("motor_pole", "motor loop", self.motor.loop.pole, "rad/s")
        if self.link is not None and (mode := self.link.fit.model.second_mode):
            yield Row("second_mode", "second mode", mode.frequency, "rad/s")


def measured(tuning: Tuning) -> tuple[Wiring, MotorResult, LinkResult]:
    """Wiring, motor and link of a tuning; FieldError if one is missing."""
    if tuning.wiring is None or tuning.motor is None or tuning.link is None:
        raise FieldError(
            "tuning",
            tuning.stopped or "unfinished",
            "without a model",
            "a tuning that has a model",
            "tune it: `fraclink tune`",
        )
    return tuning.wiring, tuning.motor, tuning.link
