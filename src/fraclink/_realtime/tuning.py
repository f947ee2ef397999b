"""What a tuning has come to: every stage that is whole, in one file from which it goes on."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fraclink._arm.rig import Rig
from fraclink._files import document
from fraclink._realtime.tune_guard import MotionLimits
from fraclink._realtime.tune_link import LinkResult
from fraclink._realtime.tune_motor import MotorResult
from fraclink._realtime.tune_moves import FirstMove
from fraclink._realtime.tune_wiring import Wiring
from fraclink._validate.display import displayed
from fraclink.findings import Scope, Verdict

__all__ = ["FILES", "Tuning"]

FILES = ("tuning.json", "rig.toml", "model.json", "design.json", "law.json", "certificate.json", "log.npz")
LAW_FILES = FILES[3:6]  # that are taken back where the arm refuses the law

_LATEST = 2.0  # [s] behind the reference's end
_JUMP = 0.02  # [rad] at the hand-over


@displayed
@document("tuning", summary=lambda tuning: {"passed": tuning.passed, "stopped": tuning.stopped})
@dataclass(frozen=True, eq=False)
class Tuning:
    """A tuning: what each stage found, None where it was not reached.

    Parameters
    ----------
    limits, payload, payloads, period
        what was asked for [kg], [s].
    wiring, motor, link
        what was measured.
    certified
        the verdict of the proof; empty where there is none.
    design_passed
        whether the design keeps its requirements over the box.
    reasons
        why there is no law, or why an experiment was repeated.
    attempts
        how many experiments on the link were made for it.
    moves
        the first moves, promised and measured.
    stopped
        why the tuning ended early; empty where it did not.
    refused
        how many laws were withheld because the arm's own moves failed under them.
    arm_time, computing
        how long the arm was moved, and how long was computed [s].
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
    design_words: str = ""
    reasons: tuple[str, ...] = ()
    attempts: int = 0
    moves: tuple[FirstMove, ...] = ()
    stopped: str = ""
    arm_time: float = 0.0
    computing: float = 0.0
    folder: str = ""
    rig: Rig | None = None
    refused: int = 0

    @property
    def verdict(self) -> Verdict:
        """The three scopes: the proof, the model's moves, the arm's own."""
        if self.certified and self.design_passed:
            promise = Scope("passed")
        elif self.reasons or self.stopped:
            promise = Scope("failed" if self.reasons else "not run", self.reasons or (self.stopped,))
        else:
            promise = Scope("not run")
        if not self.moves:
            return Verdict(
                promise, Scope("not run"), Scope("not run", (self.stopped,) if self.stopped else ())
            )
        settles = all(move.promised_settling <= move.duration + _LATEST for move in self._fast)
        model = Scope("passed") if settles else Scope("failed", ("the model's move does not settle",))
        return Verdict(promise, model, self._reality())

    @property
    def _fast(self) -> tuple[FirstMove, ...]:
        """The last move with each payload; of the slow one the gauge's noise says when it has settled."""
        return tuple({move.payload: move for move in self.moves}.values())

    def _reality(self) -> Scope:
        off = [str(move) for move in self._fast if not move.kept]
        off += [f"jump of {move.jump:.2g} rad at the hand-over" for move in self.moves if move.jump > _JUMP]
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

    def file(self, name: str) -> Path:
        """The place of one of its files."""
        return Path(self.folder) / name
