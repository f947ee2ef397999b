"""What a tuning keeps, says and repeats; what a watch calls a change: the rules around
the stages.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import fraclink as fl
from fraclink import _kernels
from fraclink.errors import FieldError, FraclinkError
from fraclink.findings import Scope
from fraclink.lab._tune import _Session
from fraclink.lab._tune_link import LinkResult
from fraclink.lab._tune_moves import FirstMove
from fraclink.lab._watch import Change, Watch
from tuned_arms import LIMITS, RIG

if not _kernels.REALTIME:
    pytest.skip("the real-time loop is Linux's", allow_module_level=True)

PLAN = fl.TuningPlan(LIMITS, payload=0.030, period=0.004)
MOVE = FirstMove(0.3, 0.5, 0.6, 0.62, *(0.001,) * 7, payload=0.030)
STATE = fl.lab.Tuning(LIMITS, 0.030, (0.0225, 0.04), 0.004)


@pytest.fixture
def session(tmp_path: Path) -> _Session:
    """A session in an empty folder, of which every line that it says is kept in `said`."""
    said: list[str] = []
    made = _Session(None, PLAN, tmp_path / "arm", True, said.append, "none", None)  # type: ignore[arg-type]
    made.out.mkdir()
    made.state = replace(STATE, folder=str(made.out))
    made.said = said  # type: ignore[attr-defined]
    return made


# --- what is resumed -------------------------------------------------------------------------------------


# --- what is repeated ------------------------------------------------------------------------------------


def link(short: float, *, passed: bool = True) -> Any:
    """A link whose λ is known `short` times too badly."""
    fit = SimpleNamespace(
        passed=passed, model=RIG.model, gain=1.0, standard_errors={"order": 0.006 * short},
        save=lambda place: Path(place).write_text("model"),
    )  # fmt: skip
    return LinkResult(fit, SimpleNamespace(), ((0.1, 8.0, 0.001),))  # type: ignore[arg-type]


# --- the first moves -------------------------------------------------------------------------------------


# --- what is kept ----------------------------------------------------------------------------------------


def test_a_plan_says_each_stage_with_its_numbers() -> None:
    limits = fl.MotionLimits(
        angle=math.radians(50.0), speed=2.5, torque=1.5, voltage=9.0
    )
    lines = fl.TuningPlan(limits, 0.030).text.splitlines()
    assert (
        lines[1]
        == "limits: 50° to each side of where the arm stands, 2.5 rad/s, 1.5 N·m at the gauge, 9 V"
    )
    assert lines[2].startswith("domain: ")
    assert lines[3] == (
        "1 wiring: short pulses that grow until the motor turns by 1°, 2.3° at most; nothing is closed; 8 s"
    )
    assert lines[4].startswith(
        "2 motor: slow moves within ±6.9°, growing to 60 % of the limits"
    )
    assert "within ±5.7°, growing to 60 % of the limits" in lines[5]
    assert "design for 22.5 to 40 g" in lines[6] and lines[7].startswith(
        "5 first moves: 30° at a tenth"
    )
    narrow = replace(
        PLAN, limits=replace(limits, angle=math.radians(10.0))
    ).text.splitlines()
    assert narrow[4].startswith("2 motor: slow moves within ±6°")
    rig = replace(RIG, payloads=replace(RIG.payloads, low=0.030, high=0.035))
    for payload, wanted in (
        (0.030, (0.030, 0.035)),
        (0.035, (0.030, 0.035)),
        (0.036, (0.027, 0.048)),
    ):
        assert fl.TuningPlan(LIMITS, payload, rig=rig).range == pytest.approx(wanted)
    assert fl.TuningPlan(LIMITS, 0.030, (0.030, 0.030), rig=rig).range == (0.030, 0.030)
    for payloads in ((0.031, 0.04), (0.02, 0.029), (0.0, 0.04)):
        with pytest.raises(FieldError, match=r"expected low <= 0\.03 <= high"):
            fl.TuningPlan(LIMITS, 0.030, payloads)


def test_a_verdict_has_its_three_scopes_and_the_reasons_of_each() -> None:
    law = replace(STATE, certified="stable", design_passed=True)
    for state, words in (
        (STATE, ("not run", "not run", "not run")),
        (law, ("passed", "not run", "not run")),
        (replace(STATE, certified="stable"), ("not run", "not run", "not run")),
        (replace(STATE, reasons=("why",)), ("failed", "not run", "not run")),
        (replace(STATE, stopped="by hand"), ("not run", "not run", "not run")),
        (replace(law, moves=(MOVE,)), ("passed", "passed", "passed")),
        (
            replace(
                law,
                moves=(replace(MOVE, promised_settling=2.5, measured_settling=2.5),),
            ),
            ("passed",) * 3,
        ),
        (
            replace(
                law,
                moves=(replace(MOVE, promised_settling=2.51, measured_settling=2.51),),
            ),
            ("passed", "failed", "passed"),
        ),
        (
            replace(law, moves=(replace(MOVE, measured_settling=2.0), MOVE)),
            ("passed", "passed", "passed"),
        ),
        (
            replace(law, moves=(MOVE, replace(MOVE, measured_settling=2.0))),
            ("passed", "passed", "failed"),
        ),
        (
            replace(
                law, moves=(replace(MOVE, measured_settling=2.0, payload=0.02), MOVE)
            ),
            ("passed", "passed", "failed"),
        ),
        (
            replace(law, moves=(replace(MOVE, jump=0.02),)),
            ("passed", "passed", "passed"),
        ),
        (
            replace(law, moves=(replace(MOVE, jump=0.021), MOVE)),
            ("passed", "passed", "failed"),
        ),
        (
            replace(law, moves=(MOVE,), stopped="by hand"),
            ("passed", "passed", "failed"),
        ),
    ):
        verdict = state.verdict
        assert (
            verdict.promise.state,
            verdict.model.state,
            verdict.arm.state,
        ) == words, state
        assert state.passed is (words == ("passed",) * 3)
    assert replace(STATE, reasons=("why",), stopped="by hand").verdict.promise == Scope(
        "failed", ("why",)
    )
    assert replace(STATE, stopped="by hand").verdict.promise == Scope(
        "not run", ("by hand",)
    )
    jumped = replace(law, moves=(replace(MOVE, jump=0.021),)).verdict.arm
    assert jumped.reasons == ("jump of 0.021 rad at the hand-over",)
    assert (
        not STATE.has_law
        and law.has_law
        and not replace(law, design_passed=False).has_law
    )
    assert replace(law, folder="f").file("law.json") == Path("f/law.json")


# --- the link's fit --------------------------------------------------------------------------------------


# --- watch -----------------------------------------------------------------------------------------------


def test_a_retune_is_due_for_what_changed_or_for_what_nothing_explains() -> None:
    same, other = Change("a", 1.0, 1.0, 0.1, False), Change("b", 1.0, 2.0, 0.1, True)
    for changes, residual, due in (
        ((same,), 0.04, ()),
        ((same,), 0.041, ("unexplained motion",)),
        ((same, other), 0.9, ("b",)),
    ):
        seen = Watch(changes, residual, 0.01, 9.0)
        assert seen.due == due and seen.passed is (not due)


ENDS: list[tuple[Callable[[], BaseException], str]] = [
    (lambda: FraclinkError("a limit"), "a limit"),
    (KeyboardInterrupt, "stopped by Ctrl-C; the drive is off"),
    (
        lambda: OSError(28, "No space left on device"),
        "[Errno 28] No space left on device",
    ),
]
