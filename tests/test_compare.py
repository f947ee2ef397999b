"""Rivals on equal terms: every tuning rule is kept, every controller is what it claims
to be, and the table states where one of them is better.
"""

from __future__ import annotations

import html
import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import fraclink as fl
import fraclink.view
from fraclink._law import Modes
from fraclink.errors import FieldError
from fraclink.trials import Standing, Tournament, compare
from fraclink.trials._rivals import (
    Shaped,
    builders,
    correction_of,
    integer_mode,
    lqg_correction,
    pd_correction,
    zv_impulses,
)

Real = NDArray[np.float64]
RIG = fl.Rig.named("paper-2023-geared")
MOVE = fl.smooth_step(1.0, duration=1.0)


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


def answer(
    design: fl.Design, correction: Modes, frequency: Real
) -> NDArray[np.complex128]:
    law = replace(design.law(), correction=correction)
    return law.frequency_response(frequency)


# ── how each is tuned
# ─────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.slow
@pytest.mark.parametrize("name", ["PD on the tip", "LQG"])
def test_tuned_to_the_same_ms(design: fl.Design, name: str) -> None:
    rival = builders(design)[name]()
    target = 1.0 / design.sampled_at(0.030).modulus_margin
    assert 0.95 * target < rival.peak <= target
    knob = float(rival.knob.split()[1])
    # any more would break the rule
    link = design.model.at_payload(0.030)
    more = (
        pd_correction(link, 1.3 * knob, RIG.period)
        if name.startswith("PD")
        else lqg_correction(link, design, 1.3 * knob)
    )
    beyond = design.sampled_at(0.030, realisation=lambda w: answer(design, more, w))
    assert not beyond.stable or 1.0 / beyond.modulus_margin > target


def test_a_constant_tip_error_leads_to_no_constant_answer_of_lqg(
    design: fl.Design,
) -> None:
    """Because of its offset state, which acts like Ĉ(0) = 0 in the design; a PD
    controller does respond.
    """
    link = design.model
    lqg, pd = lqg_correction(link, design, 1.0), pd_correction(link, 0.1, RIG.period)
    assert abs(answer(design, lqg, 1e-5)) < 1e-4
    assert abs(answer(design, pd, 1e-5)) == pytest.approx(0.1, rel=1e-5)


def test_a_correction_is_the_filter_in_the_form_of_the_law(design: fl.Design) -> None:
    rng = np.random.default_rng(5)
    a = np.diag([0.9, 0.6, 0.3]) + 0.1 * rng.standard_normal((3, 3))
    b, c, d = rng.standard_normal(3), rng.standard_normal(3), 0.7
    for w in (0.5, 12.0, 300.0):
        z = np.exp(1j * w * RIG.period)
        exact = d + c @ np.linalg.solve(z * np.eye(3) - a, b)
        assert answer(design, correction_of(a, b, c, d), w) == pytest.approx(
            exact, rel=1e-4
        )


def test_a_second_mode_that_is_known_is_notched(design: fl.Design) -> None:
    mode = fl.SecondMode(frequency=180.0, gain=0.1, damping_ratio=0.02)
    link = replace(design.model, second_mode=mode)
    plain = pd_correction(design.model, 0.1, RIG.period)
    notched = pd_correction(link, 0.1, RIG.period)
    # Tustin's rule warps the axis
    w = 2.0 / RIG.period * math.atan(180.0 * RIG.period / 2.0)
    one, other = (abs(answer(design, each, w)) for each in (notched, plain))
    assert one == pytest.approx(0.02 / 0.7 * other, rel=1e-3)
    first, second = (answer(design, each, 2.0) for each in (notched, plain))
    assert first == pytest.approx(second, rel=0.03)


@pytest.mark.parametrize("ratio", [0.0, 0.0654, 0.2])
def test_a_shaper_leaves_nothing_of_its_mode(ratio: float) -> None:
    def left(impulses: tuple[tuple[float, float], ...], frequency: float) -> float:
        """Vibration of an undriven mode relative to that after one impulse."""
        pole = frequency * complex(-ratio, math.sqrt(1 - ratio**2))
        return abs(sum(size * np.exp(-pole * time) for time, size in impulses))

    zv = zv_impulses(12.0, ratio)
    assert sum(size for _, size in zv) == pytest.approx(1.0)
    assert left(zv, 12.0) < 1e-12
    shaped = Shaped(MOVE, zv)
    t = np.linspace(0, 3, 3001)
    assert shaped.angle(t)[-1] == pytest.approx(1.0)
    slope = np.gradient(shaped.angle(t), t)[1:-1]
    assert slope == pytest.approx(shaped.velocity(t)[1:-1], abs=1e-4)


def test_the_nearest_mode_of_integer_order_is_the_links_pole() -> None:
    frequency, ratio = integer_mode(RIG.model)
    pole = frequency * complex(-ratio, math.sqrt(1 - ratio**2))
    assert abs(pole**RIG.model.order + RIG.model.natural_frequency**2) < 1e-9


# ── the table
# ─────────────────────────────────────────────────────────────────────────────────────────────────────


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
def test_verdicts_say_first_where_a_rival_is_better(everything: Tournament) -> None:
    sentences = everything.verdicts()
    better = ["better than fraclink" in sentence for sentence in sentences]
    assert any(better) and better == sorted(better, reverse=True)
    noise = next(s for s in sentences if s.startswith("motor reference noise"))
    assert "ZV shaping" in noise and "better than fraclink" in noise
    notes = everything.overview().notes
    assert notes[: len(sentences)] == sentences
    for standing in everything.standings:
        assert any(standing.rule in note for note in notes)


@pytest.mark.slow
def test_no_winner_without_somebody_who_passes_or_somebody_else(
    everything: Tournament,
) -> None:
    ours: Standing = everything.standings[0]
    alone = replace(everything, standings=(ours,))
    assert alone.verdicts() == ("fraclink ran alone: nothing to compare with",)
    failing = replace(everything, standings=(replace(ours, passed=False),) * 2)
    assert failing.winners() == {}
    assert failing.verdicts()[0].startswith("no figure has a winner")


@pytest.mark.slow
def test_all_rivals_are_drawn(everything: Tournament, tmp_path) -> None:
    fl.view.draw(everything, tmp_path / "comparison.svg")
    drawn = (tmp_path / "comparison.svg").read_text("utf-8")
    shown = sum(not math.isinf(s.settling_time) for s in everything.standings)
    assert drawn.count("never</text>") >= len(everything.standings) - shown
    assert all(html.escape(each.name) in drawn for each in everything.standings)


def test_refusals(design: fl.Design) -> None:
    with pytest.raises(FieldError, match="payloads"):
        compare(design, payloads=(0.03, -0.01))
    with pytest.raises(FieldError, match="link_mass"):
        compare(design, link_mass=-0.001)
    with pytest.raises(
        FieldError,
        match=r"names: part of no rival's name \(got zzz\); expected fraclink, .*ZV shaping",
    ):
        compare(design, names=["ZV shaping", "zzz"])
    for field in ("payloads", "names", "seed", "reference"):
        with pytest.raises(FieldError, match=field):
            compare(design, **{"names": ["fraclink"], field: 1j})
