"""The numbers of a campaign: draws, sizes and files, the words of the
summary, a row of a fault.
"""

from __future__ import annotations

import dataclasses
from dataclasses import replace
from pathlib import Path

import pytest

import fraclink as fl
from campaigns import small
from fraclink.errors import FieldError
from fraclink.trials import Campaign, Distribution

RIG = fl.Rig.named("paper-2023")
MODEL = RIG.model
assert MODEL is not None


# ────────────────────────────────────────────────────────────────────────────────────────────


def test_a_slow_arm_is_observed_for_five_of_its_periods() -> None:
    slow = dataclasses.replace(MODEL, natural_frequency=2.0)
    own = Campaign.of(RIG, slow, small().law, runs=10)
    assert own.duration == pytest.approx(1.0 + 5.0 * slow.vibration_period)


def test_a_campaign_follows_the_reference_that_it_is_given() -> None:
    law = small().law
    moves = [each.duration for each in small().references]
    assert (
        moves == [0.5, 0.75, 1.0]
        and small().duration == 4.0
        and small().reference is None
    )
    long = fl.smooth_step(0.7, 2.5)
    own = Campaign.of(
        RIG, MODEL, law, runs=10, reference=long, estimated=(0.02, 0.04), told=True
    )
    assert (
        own.references == (long,)
        and own.duration == 5.5
        and own.payloads == (0.02, 0.04)
    )
    assert own.draws.amplitude == Distribution("uniform", 1.0, 1.0)
    assert own.draws.payload_given == Distribution("uniform", 1.0, 1.0)
    assert (
        Campaign.of(
            RIG, MODEL, law, runs=10, reference=fl.smooth_step(0.7, 0.5)
        ).duration
        == 4.0
    )
    # One second is left after the move, and no less.
    assert replace(own, reference=fl.smooth_step(1.0, 4.5)).duration == 5.5
    with pytest.raises(FieldError, match=r"reference: too long .* <= 4.5 s"):
        replace(own, reference=fl.smooth_step(1.0, 4.51))


def test_a_campaign_comes_back_with_its_reference_and_its_payloads(
    tmp_path: Path,
) -> None:
    made = replace(
        small(),
        reference=fl.smooth_step(0.8, 0.6),
        payloads=(0.02, 0.04),
    )
    fl.save(made, tmp_path / "campaign.json")
    back = fl.load(tmp_path / "campaign.json", Campaign)
    assert (back.payloads, back.runs, back.seed) == (
        (0.02, 0.04),
        2500,
        7,
    )
    assert back == made


# ───────────────────────────────────────────────────────────────────────────────────────────────
