"""`tune`: from an unknown arm to a law in stages; each result is saved before the next
stage begins.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from fraclink._design import Design
from fraclink._files import load, output_path, save
from fraclink._law import Law
from fraclink._simulate.metrics import BAND
from fraclink.errors import FieldError, FraclinkError
from fraclink.extend import LOST_SHARE
from fraclink.lab._connections import Connection
from fraclink.lab._line import Stopped, open_line
from fraclink.lab._machine import measure_wake_ups, signals_held
from fraclink.lab._tune_build import Built, built_laws, measured_rig, planned_move
from fraclink.lab._tune_causes import causes, unexplained
from fraclink.lab._tune_guard import PLANNED, Guard, LimitReached
from fraclink.lab._tune_link import LinkResult, experiment_of, tune_link
from fraclink.lab._tune_motion import LawTripped
from fraclink.lab._tune_motor import MotorResult, tune_motor
from fraclink.lab._tune_moves import first_moves
from fraclink.lab._tune_wiring import FAR, Wiring, check_wiring
from fraclink.lab._tuning import FILES, LAW_FILES, Tuning, TuningPlan, measured
from fraclink.lab._watch import changed_link
from fracsys.checks import Between, checked

__all__ = ["tune"]


@checked
def tune(
    connection: Connection,
    plan: TuningPlan,
    *,
    out: Path = Path("tuned"),
    resume: bool = False,
    force: bool = False,
    moves: bool = True,
    begin: Callable[[str], None] = lambda stage: None,
    clock: Any = None,
) -> Tuning:
    """Tune an arm: wiring, motor, link, design, proof, law and first moves, within
    limits that are kept.

    Every stage is written to `out` when it is complete. A limit, a wrong sign, a lost link
    or a signal switches the drive off and ends the tuning; its reason is in the result,
    its record in ``log.npz``.

    Parameters
    ----------
    connection
        how the arm is reached, e.g. ``parse_connection("udp:127.0.0.1:5005")``.
    plan
        limits, payload, and what else is known; ``plan.text`` says what will happen.
    out
        folder for the results.
    resume
        try the law in `out` with a payload within its range: the wiring is checked
        again, and the first moves are made.
    force
        overwrite an earlier tuning.
    moves
        whether to make the first moves under the new law.
    begin
        called with a sentence as each stage begins, and with its results.
    clock
        "none" for a `SimulatedArm`, which only advances when called; or that of a test,
        as for `run_realtime`.

    Raises
    ------
    FieldError
        a value out of its range, an arm that does not answer, existing files, nothing
        to resume.

    Examples
    --------
    >>> import tempfile
    >>> import fraclink as fl
    >>> arm = fl.lab.SimulatedArm(fl.Twin.from_rig(fl.Rig.named("paper-2023-geared")), 0.004, seed=1)
    >>> limits = fl.MotionLimits(angle=0.6, speed=4.0, torque=2.0, voltage=10.0)
    >>> plan = fl.TuningPlan(limits, payload=0.030, period=0.004)
    >>> tuned = fl.tune(arm.callback, plan, out=tempfile.mkdtemp(), moves=False, clock="none")
    >>> tuned.has_law, round(tuned.link.fit.model.order, 2)
    (True, 1.92)
    """
    before = _resumed(out, plan) if resume else None
    if not resume:
        # Checked before the arm moves: a minute of motion must not end at a file that
        # cannot be written.
        for name in FILES:
            output_path(out / name, force=force)
    out.mkdir(parents=True, exist_ok=True)
    line = partial(open_line, connection, plan.period, clock=clock)
    # Signals are held until the record is saved, not only while the arm moves: closing a
    # terminal sends a second one, and a signal during a computation ends the tuning at
    # the next motion, or after the last one.
    with signals_held() as obeyed:
        # Before there is a session there is no state to save: an error goes to the
        # caller.
        guard = Guard(line, plan.limits)
        if clock is None:
            # After the first sample, which states the period of the arm, and before
            # anything moves: a machine that misses periods would lose the arm in
            # mid-motion.
            guard.release()
            awake = measure_wake_ups(guard.period)
            begin(f"  {awake}")
            awake.check()
        state = before or Tuning(
            plan.limits, plan.payload, plan.range, guard.period, rig=plan.rig
        )
        # The limits may be changed on resuming: they belong to the present user of the
        # arm.
        state = replace(state, stopped="", folder=str(out), limits=plan.limits)
        session = _Session(guard, plan, out, moves, begin, before, state)
        try:
            session.go()
        # Every failure within a stage ends with a saved state.
        except (FraclinkError, OSError, KeyboardInterrupt) as error:
            if isinstance(error, Stopped):
                obeyed.set()
            reason = str(error) or "stopped by Ctrl-C; the drive is off"
            session.end(reason + _lateness(guard))
        finally:
            guard.release()
            session.keep()
    return session.state


def _resumed(out: Path, plan: TuningPlan) -> Tuning:
    place = out / FILES[0]
    before: Tuning | None = load(place, Tuning) if place.is_file() else None
    if before is None or not before.has_law:
        raise FieldError(
            "resume",
            str(out),
            "without a law to try",
            "the folder of a tuning that ended with a law",
            "leave --resume out",
        )
    # Another payload means another ω₀, and a law is proved for its own range of
    # payloads only.
    Between(*before.payloads, "kg").check("payload", plan.payload)
    return before


@dataclass
class _Session:
    """The state of a running tuning. Internal, mutable."""

    guard: Guard
    plan: TuningPlan
    out: Path
    moves: bool
    begin: Callable[[str], None]
    before: Tuning | None
    state: Tuning
    _began: float = field(default_factory=time.process_time)

    def go(self) -> None:
        """Run all stages that are not complete yet."""
        self.begin("wiring")
        wiring = check_wiring(self.guard, self.plan.rig, self._tell)
        if self.before is not None:
            self._same_arm(self.before, wiring)
        # From the first guess on, so that moves of the motor cannot exceed the speed
        # limit.
        self.guard.learn(wiring.gain, wiring.delay)
        self._tell(*wiring.evidence)
        if self.before is not None:
            self._carry()
            return
        self._write(wiring=wiring)
        self.begin("motor")
        motor = tune_motor(self.guard, wiring, self._tell)
        self._tell(str(motor))
        self._write(motor=motor)
        self.guard.learn(motor.fit.gain, motor.fit.delay)
        link, first, laws = self._link(wiring, motor)
        if first.passed and self.moves:
            self._move(link, itertools.chain((first,), laws))

    def _carry(self) -> None:
        """Try the existing law with the present payload of the arm."""
        design = load(self.out / LAW_FILES[0], Design)
        law = load(self.out / LAW_FILES[1], Law)
        _, motor, _ = measured(self.state)
        self.guard.learn(motor.fit.gain, motor.fit.delay)
        move, why = planned_move(design, law, self.plan.limits, motor)
        built = Built(design.rig, design, law, None, (), move=move)
        if why := why or self._refusal(built):
            self._withhold(why)
            self._tell(*self.state.reasons)

    def _move(self, link: LinkResult, laws: Iterator[Built]) -> None:
        """First moves under the law; a law that fails on the arm is withdrawn, and the
        next one is tried.
        """
        for number, candidate in enumerate(laws):
            if number:
                self.begin(
                    "that law failed on the arm and is withheld; writing the next one"
                )
                self._wrote(candidate, link)
            why = self._refusal(candidate)
            if not why:
                return
            self._withhold(why)

    def _refusal(self, built: Built) -> str:
        """Make the first moves, and return the reason why the law fails on the arm, ""
        if it does not.
        """
        assert built.design and built.law and built.move  # passed  # noqa: S101
        _, motor, _ = measured(self.state)
        self.begin("first moves")
        try:
            moves = first_moves(
                self.guard,
                built.design,
                built.law,
                motor,
                self.plan.payload,
                built.move,
            )
        except LimitReached as error:
            self._withhold(str(error))
            raise
        except LawTripped as error:
            return str(error)
        finally:
            self.guard.release()
        self._tell(*map(str, moves))
        # Moves with other payloads are kept, so that the verdict covers the whole range
        # that was tried.
        others = tuple(
            move for move in self.state.moves if move.payload != self.plan.payload
        )
        self._write(moves=others + moves)
        return "; ".join(self.state.verdict.arm.reasons)

    def _withhold(self, why: str) -> None:
        """Withdraw the law that failed on the arm: delete its files and its verdict."""
        for name in LAW_FILES:
            # Also delete the files, because `run-realtime` would take the design.json
            # as it is.
            (self.out / name).unlink(missing_ok=True)
        _, _, link = measured(self.state)
        fit, payload = link.fit, self.plan.payload
        reasons = self._causes() + self._unexplained(0.0)
        # If the arm carries the payload with which it was measured, a change of the arm is
        # the reason, whatever else is visible; a move that was stopped at once shows too
        # little to tell.
        if fit.model.payload == payload:
            with suppress(FraclinkError):
                moves = experiment_of(self.guard.record(self.guard.starts[-1]), payload)
                reasons = changed_link(moves, fit) or reasons
        self._write(
            certified="",
            design_passed=False,
            reasons=(f"the arm's own moves fail: {why}", *reasons),
        )

    def _link(
        self, wiring: Wiring, motor: MotorResult
    ) -> tuple[LinkResult, Built, Iterator[Built]]:
        """The experiments on the link, and the law."""
        plan = self.plan
        self.begin("link")
        link = tune_link(self.guard, wiring, motor, plan.payload, self._tell)
        motor = link.motor
        self._tell(
            *str(link.fit).splitlines(), f"motor, with the link's torque: {motor}"
        )
        self._write(link=link, motor=motor)
        self.guard.learn(motor.fit.gain, motor.fit.delay)
        self.begin("design, proof and law")
        rig = measured_rig(
            wiring,
            link,
            plan.limits,
            plan.range,
            plan.payload,
            self.guard.period,
            centre=self.guard.origin,
            rest_torque=self.guard.offset,
            stated=plan.rig,
            name=self.out.name[:100] or "arm",
        )
        laws = built_laws(rig, link, plan.limits)
        first = next(laws)
        self._wrote(first, link)
        return link, first, laws

    def _causes(self) -> tuple[str, ...]:
        """Causes found in the record that prevent a law."""
        state = self.state
        if state.wiring is None:
            return ()
        return causes(
            self.guard.record(),
            state.wiring,
            state.motor,
            None if state.link is None else state.link.fit,
            self.plan.limits.voltage,
            any(move.hunts for move in state.moves),
        )

    def _unexplained(self, least: float) -> tuple[str, ...]:
        """What the model of the link does not explain, beyond `least` [rad]."""
        wiring, _, link = measured(self.state)
        return unexplained(
            link.residual, link.fit.model, self.guard.record(), wiring, least
        )

    def _wrote(self, built: Built, link: LinkResult) -> None:
        """Save the results based on the model, each part to its own file."""
        hints = self._causes()
        move = built.move or (PLANNED * self.plan.limits.angle, 0.0)
        rest = self._unexplained(BAND * move[0])
        # causes seen in the record may explain what the model does not
        if built.reasons or rest:
            built = replace(built, reasons=built.reasons + hints + rest)
        else:
            built = replace(built, assumptions=built.assumptions + hints)
        place = self.out
        built.rig.save(place / "rig.toml")
        link.fit.save(place / "model.json")
        parts = (built.design, built.law, built.certificate)
        for name, part in zip(LAW_FILES, parts, strict=True):
            if built.passed and part is not None:
                part.save(place / name)
            else:  # a failed result must not be left where it could be run
                (place / name).unlink(missing_ok=True)
        proof = built.certificate
        self._write(
            certified=proof.verdict if proof is not None and proof.passed else "",
            design_passed=built.design is not None and built.passed,
            reasons=built.reasons,
            planned=built.move,
            moves=(),
        )
        self._tell(*(built.assumptions if built.passed else built.reasons))

    def _same_arm(self, before: Tuning, wiring: Wiring) -> None:
        """Raise an error if this is not the arm that was measured before."""
        names = ("gain", "stiffness", "natural_frequency")
        # Another payload within the range changes ω₀ only.
        for name in names if self.plan.payload == before.payload else names[:2]:
            was, now = getattr(before.wiring, name), getattr(wiring, name)
            if not 1.0 / FAR < now / was < FAR:
                raise FraclinkError(
                    f"cannot resume: {name} was {was:.3g} and is {now:.3g}: another arm, payload or wiring; "
                    "tune anew"
                )

    def _write(self, **parts: Any) -> None:
        self.state = replace(
            self.state,
            **parts,
            arm_time=self.guard.count * self.guard.period,
            computing=time.process_time() - self._began,
        )
        save(self.state, self.out / FILES[0], force=True)

    def end(self, reason: str) -> None:
        """Save the reason of the end, and the findings in the record."""
        hints = self._causes()
        if self.state.link is not None:
            least = BAND * PLANNED * self.plan.limits.angle
            hints += self._unexplained(least)
        self.state = replace(self.state, stopped="; ".join((reason, *hints)))
        self._tell(reason, *hints)

    def keep(self) -> None:
        """Save the state and the whole record."""
        self._write()
        record = self.guard.record()
        # A single sample has no period and makes no log.
        if record.angle.size > 1:
            payload = self.plan.payload
            # A resumed tuning keeps the record of the arm that was measured.
            more = "" if self.before is None else f"-{1e3 * payload:g}g"
            save(
                experiment_of(record, payload),
                self.out / f"log{more}.npz",
                force=True,
            )

    def _tell(self, *lines: str) -> None:
        for line in lines:
            self.begin(f"  {line}")


def _lateness(guard: Guard) -> str:
    """A note on lost samples, to be added to the reason for stopping: a busy machine
    spoils the measurements.
    """
    if guard.lost <= LOST_SHARE * guard.count:
        return ""
    return (
        f" (of {guard.count} samples {guard.lost} did not come in time: this machine, or the link, is too "
        f"busy for a period of {1e3 * guard.period:.3g} ms, which spoils the measurements)"
    )
