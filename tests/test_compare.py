"""Rivals on equal terms: every tuning rule is kept, every controller is what it claims
to be, and the table states where one of them is better.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

import fraclink as fl
import fraclink.view
from fraclink.errors import FieldError
from fraclink.trials import Standing, Tournament, compare

RIG = fl.Rig.named("paper-2023-geared")


@pytest.fixture(scope="module")
def design() -> fl.Design:
    return fl.design(
        RIG.model,
        RIG,
        payloads=(0.020, 0.040),
        gain_crossover=12.0,
        phase_margin=fl.deg(50.0),
    )


@pytest.fixture(scope="module")
def everything(design: fl.Design) -> Tournament:
    return compare(design, payloads=(0.030,))


# --- how each is tuned ----------------------------------------------------------------


@pytest.mark.slow
def test_rivals_that_feed_the_tip_back_reach_the_designs_ms(
    design: fl.Design, everything: Tournament
) -> None:
    target = 1.0 / design.sampled_at(0.030).modulus_margin
    standing = {each.name: each for each in everything.standings}
    for name in ("PD on the tip", "LQG"):
        assert 0.95 * target < standing[name].peak <= target
    assert standing["ZV shaping"].peak == standing["motor PID alone"].peak == 1.0


@pytest.mark.slow
def test_each_rival_does_what_it_is_made_for(everything: Tournament) -> None:
    """A gauge's offset moves the tip under a PD, not under LQG's offset state; a shaper
    leaves little of the vibration.
    """
    standing = {each.name: each for each in everything.standings}
    lqg, pd = standing["LQG"], standing["PD on the tip"]
    assert abs(lqg.offset_error) < 0.1 * abs(pd.offset_error)
    shaped, plain = standing["ZV shaping"], standing["motor PID alone"]
    assert shaped.residual_vibration < 0.2 * plain.residual_vibration


# --- the table ------------------------------------------------------------------------


@pytest.mark.slow
def test_every_rival_has_a_rule_and_a_standing(everything: Tournament) -> None:
    assert [standing.name for standing in everything.standings] == [
        "fraclink",
        "motor PID alone",
        "ZV shaping",
        "PD on the tip",
        "LQG",
        "the paper's procedure",
    ]
    for standing in everything.standings:
        assert standing.rule and standing.knob
        assert standing.passed or standing.name == "the paper's procedure"


@pytest.mark.slow
def test_the_notes_say_who_is_best_in_each_figure(everything: Tournament) -> None:
    winners, notes = everything.winners(), everything.overview().notes
    assert "ZV shaping" in winners["motor_reference_noise"]
    assert "fraclink" not in winners["motor_reference_noise"]
    noise = next(note for note in notes if note.startswith("motor reference noise"))
    assert noise.endswith("best " + ", ".join(winners["motor_reference_noise"]))
    for standing in everything.standings:
        assert any(standing.rule in note for note in notes)


@pytest.mark.slow
def test_nobody_is_best_without_somebody_who_passes(everything: Tournament) -> None:
    ours: Standing = everything.standings[0]
    failing = replace(everything, standings=(replace(ours, passed=False),) * 2)
    assert failing.winners() == {}


def test_refusals(design: fl.Design) -> None:
    with pytest.raises(FieldError, match="payloads"):
        compare(design, payloads=(0.03, -0.01))
    with pytest.raises(
        FieldError,
        match=r"names: part of no rival's name \(got zzz\); expected fraclink, .*ZV shaping",
    ):
        compare(design, names=["ZV shaping", "zzz"])
    for field in ("payloads", "names", "reference"):
        with pytest.raises(FieldError, match=field):
            compare(design, **{"names": ["fraclink"], field: 1j})
