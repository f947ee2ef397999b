"""What a tuning stores, prints and repeats, and what counts as a change: the rules
around the stages.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import pytest

import fraclink as fl
from fraclink.findings import Scope
from fraclink.lab import Change, FirstMove, Watch
from tuned_arms import LIMITS

if sys.platform != "linux":
    pytest.skip("the real-time loop is Linux's", allow_module_level=True)

MOVE = FirstMove(
    0.3, 0.5, 0.6, 0.62, *(0.001,) * 2, 0.006, *(0.001,) * 2, payload=0.030
)
STATE = fl.lab.Tuning(LIMITS, 0.030, (0.0225, 0.04), 0.004)


# --- what is kept ----------------------------------------------------------------------------------------


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
                moves=(replace(MOVE, promised_settling=2.3, measured_settling=2.3),),
            ),
            ("passed",) * 3,
        ),
        (
            replace(
                law,
                moves=(replace(MOVE, promised_settling=2.9, measured_settling=2.9),),
            ),
            ("passed", "failed", "passed"),
        ),
        (
            replace(law, moves=(replace(MOVE, measured_settling=2.0), MOVE)),
            ("passed", "passed", "failed"),
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


# --- watch -----------------------------------------------------------------------------------------------


def test_a_retune_is_due_for_what_changed_or_for_what_nothing_explains() -> None:
    same, other = Change("a", 1.0, 1.0, 0.1, False), Change("b", 1.0, 2.0, 0.1, True)
    for changes, residual, due in (
        ((same,), 0.014, ()),
        ((same,), 0.015, ("unexplained motion",)),
        ((same, other), 0.9, ("b",)),
    ):
        seen = Watch(changes, residual, 0.01, 9.0)
        assert seen.due == due and seen.passed is (not due)
