"""Claims about law_step in exact IEEE arithmetic, decided by SMT solvers: slew, and all
outputs finite.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Set
from dataclasses import replace
from pathlib import Path

import numpy as np

from fraclink._export.claims import Claim
from fraclink._law import Law
from fraclink._law.block import REALS
from fraclink_prove.formulas import ZERO, Value, real_literal
from fraclink_prove.source import Unreadable, read_source
from fraclink_prove.symbolic import Symbolic
from fraclink_prove.tools import COMPILER, SOLVERS, Tool, at_most, sha256_of_text

__all__ = ["finite_claim", "slew_bound", "slew_claim"]

# Modes of a started law as stored in its state: one copy in each byte (law.c,
# `copied`).
_STARTED, _COPIES = (1, 2, 3, 4), 0x01010101
# Far below the largest number of single precision, 3.4e38, and far above any angle,
# torque or voltage.
_FINITE = 1e30
_STRUCTS = ("law_state", "law_params", "law_input", "law_output")


def slew_bound(law: Law) -> float:
    """Return the largest change of the motor reference in a period [rad], rounding
    included.

    motor_step (1 + 4u) + one unit in the last place of motor_limit: the sum of the last
    command and the step is rounded at the size of the command, which is larger than the
    step.
    """
    kind = np.float32 if law.precision == "single" else np.float64
    step, limit = kind(law.limits.motor_step), kind(law.limits.motor_limit)
    bound = float(step) * (1 + 2 * float(np.finfo(kind).eps)) + float(np.spacing(limit))
    return float(np.nextafter(kind(bound), kind(math.inf)))


def slew_claim(law: Law, folder: Path) -> Claim:
    """Prove that the commands of consecutive periods differ by at most `slew_bound`.

    law_step is followed from the text of law.c with every coefficient and every other
    state free; the state is assumed to be one that was started, that is undamaged (its
    sum is that of the last period), and that still holds the last command, within its
    range. A damaged law starts anew at the motor's angle.
    """
    bound, step = slew_bound(law), law.limits.motor_step
    claim = Claim(
        "slew",
        "for every sequence of inputs, once started and as long as the state's memory is undamaged: "
        "|motor_reference[k] - motor_reference[k-1]| ≤ "
        f"motor_step + {at_most(bound - step, 3)} rad, with motor_step = {step:.6g} rad; the rest is the "
        f"rounding of a sum in {law.precision} precision",
        "not proved",
    )

    def query(executed: Symbolic) -> list[Value]:
        before = executed.memory["before", "motor_reference"]
        after = executed.memory["law_output", "motor_reference"]
        # Rounded up and down: the exact difference of the two commands lies in between,
        # whatever its rounding.
        up, down = (executed.operated(sign, after, before) for sign in ("-up", "-down"))
        most, least = (
            Value("real", real_literal(x, law.precision)) for x in (bound, -bound)
        )
        return [executed.operated("<=", up, most), executed.operated(">=", down, least)]

    return _decided(
        claim,
        law,
        folder,
        "slew",
        query,
        tracked={("law_state", "motor_reference"), ("law_output", "motor_reference")},
    )


def finite_claim(law: Law, folder: Path) -> Claim:
    """Prove that the outputs other than the commands are finite, too, whatever is in
    the state and the inputs.
    """
    claim = Claim(
        "finite",
        "for every sequence of inputs and every content of the state's memory: tip_estimate, error and "
        "compensation are finite",
        "not proved",
    )
    outputs = ("tip_estimate", "error", "compensation")
    # The sources of the three outputs: a function that writes none of these is assumed
    # to return anything.
    sources = ("motor_angle", "torque", "reference", "track", "error")

    def query(executed: Symbolic) -> list[Value]:
        return [
            executed.at_most(executed.memory["law_output", name], _FINITE)
            for name in outputs
        ]

    # Comparisons alone keep the sources of the outputs within their ranges, whatever
    # the sums between them give.
    tracked = {("law_output", name) for name in outputs} | {
        ("law_state", name) for name in sources
    }
    return _decided(
        claim,
        law,
        folder,
        "finite",
        query,
        tracked=tracked,
        started=False,
        arithmetic=False,
    )


def _decided(
    claim: Claim,
    law: Law,
    folder: Path,
    file: str,
    query: Callable[[Symbolic], list[Value]],
    *,
    tracked: Set[tuple[str, str]],
    started: bool = True,
    arithmetic: bool = True,
) -> Claim:
    """Ask the solvers whether a negation of the claim is satisfiable: "unsat" for all
    of them proves it.
    """
    solvers = [tool for tool in SOLVERS if tool.path]
    if not solvers:
        return replace(
            claim,
            reason=" and ".join(tool.missing for tool in SOLVERS) + "; one is enough",
        )
    if COMPILER.path is None:
        return replace(claim, reason=COMPILER.missing)
    try:
        problems = _problems(
            law,
            folder,
            query,
            frozenset(tracked),
            started=started,
            arithmetic=arithmetic,
        )
    except Unreadable as error:
        return replace(
            claim, reason=f"law.c has a form that the proof does not read: {error}"
        )
    (folder / "proof").mkdir(exist_ok=True)
    logs, used = [], set()
    for number, problem in enumerate(problems, start=1):
        name = f"proof/{file}_{number}.smt2"
        (folder / name).write_text(problem, encoding="utf-8")
        logs.append((name, sha256_of_text(problem)))
        decided = _first_answer(solvers, name, folder)
        if decided is None:
            return replace(
                claim, logs=tuple(logs), reason=f"{name}: no solver decided it"
            )
        used.add(decided[0])
        if decided[1] == "sat":
            reason = f"{decided[0]} found a step that breaks it ({name})"
            return replace(claim, status="failed", logs=tuple(logs), reason=reason)
    return replace(claim, status="proved", tools=tuple(sorted(used)), logs=tuple(logs))


def _first_answer(
    solvers: list[Tool], name: str, folder: Path
) -> tuple[str, str] | None:
    """The first solver that answers, with "sat" or "unsat"; None if none does."""
    for tool in solvers:
        language = ("--lang", "smt2") if tool.program == "cvc5" else ()
        answer = tool.run((*language, name), folder).text.split("\n", 1)[0]
        if answer in ("sat", "unsat"):
            return tool.name, answer
    return None


def _problems(
    law: Law,
    folder: Path,
    query: Callable[[Symbolic], list[Value]],
    tracked: frozenset[tuple[str, str]],
    *,
    started: bool,
    arithmetic: bool,
) -> list[str]:
    single = ("-DLAW_SINGLE",) if law.precision == "single" else ()
    text = COMPILER.run(("-E", "-P", "-std=c99", *single, "law.c"), folder).text
    # Modes are left free: neither claim depends on the filter, and a proof without them
    # holds for every filter.
    names = [name for name, length in REALS if length == 1]
    values = {name: float(law.coefficients[name]) for name in names}  # type: ignore[arg-type]
    undamaged = {"damaged": ZERO} if started else {}
    executed = Symbolic(
        read_source(text),
        law.precision,
        constants=values,
        tracked=tracked,
        assumed=undamaged,
    )
    assumed = _started(executed, values["motor_limit"]) if started else []
    executed.call("law_step", tuple(Value("pointer", struct) for struct in _STRUCTS))
    problems = []
    for goal in query(executed):
        asserted = [*assumed, f"(not {goal.term})"]
        lines = [
            "(set-logic QF_BVFP)",
            *executed.relevant(asserted, arithmetic=arithmetic),
        ]
        lines += [f"(assert {line})" for line in asserted]
        problems.append("\n".join((*lines, "(check-sat)", "")))
    return problems


def _started(executed: Symbolic, limit: float) -> list[str]:
    """Assume a law that was started with these parameters and still has its last
    command in memory.
    """
    state = {
        name: executed.load(("law_state", name)) for name in ("mode", "motor_reference")
    }
    # Otherwise the state counts as that of another law, and law_step restarts.
    executed.memory["law_state", "stamp"] = executed.load(("law_params", "crc"))
    command = executed.memory["before", "motor_reference"] = state["motor_reference"]
    # Also passed to the formulas, so that comparisons with the limit are decided
    # without a solver.
    executed.bounded[command.term] = limit
    modes = (f"(= {state['mode'].term} (_ bv{mode * _COPIES} 32))" for mode in _STARTED)
    return [
        f"(or {' '.join(modes)})",
        f"(fp.leq (fp.abs {command.term}) {real_literal(limit, executed.precision)})",
    ]
