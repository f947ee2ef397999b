"""What each fault does to a run, and what is measured of it: rows, values and limits
written out by hand.
"""

from __future__ import annotations

import math

from fraclink.trials._endurance import Upset
from fraclink.trials._fault_checks import (
    Check,
)

IDLE, RUN, DEGRADED, HOLD, OFF = range(5)
BAD_ENCODER, BAD_GAUGE = 5, 6  # reasons of law.h
NAN = math.nan


# ── one requirement
# ─────────────────────────────────────────────────────────────────────────────────────────


def test_a_check_passes_up_to_its_limit_and_not_without_a_number() -> None:
    assert (
        Check.at_most("x", 2.0, 2.0).passed
        and not Check.at_most("x", math.nextafter(2.0, 3.0), 2.0).passed
    )
    assert not Check.at_most("x", NAN, 2.0).passed
    assert str(Check.at_most("peak [rad]", 0.5, 0.4)) == "peak [rad]: 0.5 (limit 0.4)"


# ── what only one fault is measured by
# ──────────────────────────────────────────────────────────────────────


def test_a_bit_may_be_flipped_where_the_tip_stays_or_the_drive_is_off_at_once() -> None:
    assert Upset("mode", 0, 0.3, 0).passed and not Upset("mode", 0, 0.31, 0).passed
    assert Upset("mode", 0, 9.0, 1).passed and Upset("mode", 0, 9.0, 10).passed
    assert (
        not Upset("mode", 0, 9.0, 11).passed
        and not Upset("mode", 0, math.inf, 0).passed
    )
