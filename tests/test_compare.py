"""Rivals on equal terms: every rule of tuning is kept, every controller is what it
says.
"""

from __future__ import annotations

import html
import json
import math
from dataclasses import replace

import numpy as np
import pytest

import fraclink as fl
from fraclink._arm.motor_loop import MotorLoop
from fraclink._arm.reference import smooth_step
from fraclink._arm.sampled import sampled_plant
from fraclink._simulate import Twin, geared
from fraclink._simulate.on_twin import with_motor_loop
from fraclink.errors import FieldError, NotConvergedError
from fraclink.trials._rival_controllers import (
    integer_mode,
    lqg_correction,
    pd_correction,
)
from fraclink.trials._rival_runs import (
    feed_forward,
    mode_gain,
    run_rival,
)
from fraclink.trials._rivals import PUBLISHED, builders, servo_law
from fraclink.trials._setting import (
    Filter,
    NominalLoop,
    Setting,
    law_filter,
    tune,
)
from fraclink.trials._shaper import Shaped, zv_impulses
from fraclink.trials._tournament import Tournament, compare
from fracsys._margins import margins

RIG = geared(fl.Rig.named("paper-2023"))
MOVE = smooth_step(1.0, duration=1.0)


@pytest.fixture(scope="module")
def setting() -> Setting:
    design = fl.design(
        RIG.model,
        RIG,
        payloads=(0.020, 0.040),
        gain_crossover=12.0,
        phase_margin=fl.deg(50.0),
    )
    twin = Twin.from_rig(RIG, link_mass=0.00735)
    law = with_motor_loop(fl.discretize(design.controller, RIG.period), twin=twin)[0]
    loop = NominalLoop.of(RIG.model, 0.030, period=RIG.period, pole=80.0, delay=1)
    return Setting(RIG, RIG.model, law, design.controller, loop, 12.0, fl.deg(50.0))


@pytest.fixture(scope="module")
def everything() -> Tournament:
    return compare(fl.Rig.named("paper-2023"), payloads=(0.030,))


@pytest.mark.slow
def test_law_filter_is_the_law(setting):
    frequency = np.array([0.1, 1.0, 12.0, 100.0, 700.0])
    ours = law_filter(setting.law).response(np.exp(1j * frequency * RIG.period))
    assert ours == pytest.approx(setting.law.frequency_response(frequency), rel=1e-9)


@pytest.mark.slow
def test_nominal_loop_is_the_designers(setting):
    """The sampled loop of design/, made from alias sums, and ours, from a state space:
    the same Ms.
    """
    plant = sampled_plant(
        RIG.model, MotorLoop(pole=80.0, delay_samples=1), RIG.motor, RIG.period
    )
    frequency = np.array([1.0, 8.0, 12.0, 13.0, 40.0, 300.0])
    ours = setting.loop.plant.response(np.exp(1j * frequency * RIG.period))
    assert ours == pytest.approx(plant(frequency), rel=2e-6)


@pytest.mark.slow
def test_peak_is_the_modulus_margin(setting):
    correction = law_filter(setting.law)

    def loop(s):
        return correction.response(
            np.exp(s * RIG.period)
        ) * setting.loop.plant.response(np.exp(s * RIG.period))

    exact = margins(loop, limit=math.pi / RIG.period).modulus_margin
    assert setting.target == pytest.approx(1.0 / exact, rel=2e-3)


KNOBS = {
    "PD on the tip estimate": lambda s: (
        lambda g: pd_correction(
            g, corner=integer_mode(s.model)[0], filter_time=0.01, period=0.004
        ),
        (1e-3, 10.0),
    ),
    "LQG": lambda s: (
        lambda q: lqg_correction(
            s.model, period=0.004, pole=80.0, delay=1, noise=0.0064, weight=q
        ),
        (1e-4, 1e4),
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", KNOBS)
def test_tuned_to_the_same_ms(setting, name):
    make, limits = KNOBS[name](setting)
    knob, correction, reached = tune(setting.loop, make, limits, setting.target)
    assert reached
    assert setting.loop.peak(correction) == pytest.approx(setting.target, rel=1e-3)
    assert (
        setting.loop.peak(make(1.1 * knob)) > setting.target
    )  # more of it would break the rule
    assert setting.loop.radius(correction) <= 1.0 + 1e-9


@pytest.mark.slow
def test_tuning_says_when_nothing_is_stable(setting):
    unstable = Filter(np.array([[1.1]]), np.ones(1), np.ones(1), 0.0)
    with pytest.raises(NotConvergedError, match="tuning"):
        tune(setting.loop, lambda _: unstable, (1.0, 2.0), setting.target)


@pytest.mark.slow
def test_offset_rejection_by_structure(setting):
    """A constant tip error leads to no constant answer: LQG by its offset state, the
    design by Ĉ(0) = 0.
    """
    one = np.array([1.0 + 1e-7j])
    for correction in (
        law_filter(setting.law),
        lqg_correction(
            setting.model, period=0.004, pole=80.0, delay=1, noise=0.006, weight=1.0
        ),
    ):
        assert abs(correction.response(one)[0]) < 1e-4
    pd = pd_correction(0.1, corner=12.0, filter_time=0.01, period=0.004)
    assert abs(pd.response(one)[0]) == pytest.approx(0.1, rel=1e-3)


@pytest.mark.slow
def test_rivals_and_the_law_run_on_the_same_arm(setting):
    """Our filter run tick by tick in Python, and law.c: the same motor reference to
    rounding.
    """

    from fraclink._law import Modes
    from fraclink.trials._rivals import Rival

    twin = Twin.from_rig(RIG, link_mass=0.00735)
    whole = servo_law(setting.law.in_precision("double"))
    bare = replace(whole, correction=Modes(0.0), feedforward=Modes(0.0))
    correction = law_filter(setting.law)
    python = Rival(
        "python",
        "",
        "",
        1.0,
        0,
        0,
        bare,
        correction=correction,
    )
    shipped = Rival("law.c", "", "", 1.0, 0, 0, whole)
    quiet = replace(twin, sensors=replace(twin.sensors, gauge_noise=0.0))
    one, two = (
        run_rival(quiet, r, MOVE, setting.law, duration=1.5) for r in (python, shipped)
    )
    assert one.tip_angle == pytest.approx(two.tip_angle, abs=1e-6)
    same = fl.simulate(whole, MOVE, arm=quiet, duration=1.5)
    assert np.array_equal(two.tip_angle, same.tip_angle)


@pytest.mark.slow
def test_feed_forward_is_the_laws(setting):
    """The law without correction at a motor that stands at the reference asks for
    reference and F θ̈t*.
    """

    from fraclink._law import LawInputs, Modes

    law = replace(servo_law(setting.law), correction=Modes(0.0), precision="double")
    acceleration = MOVE.acceleration(RIG.period * np.arange(200))
    state, commands = law.initial_state(), []
    for k, value in enumerate(acceleration.tolist()):
        state, outputs = law.step(state, LawInputs(0.0, value, 0.0, 0.0), tick=k + 1)
        commands.append(outputs.motor_reference)
    assert feed_forward(setting.law, acceleration) == pytest.approx(commands, abs=1e-12)


@pytest.mark.slow
def test_mode_gain_sees_only_feedback_of_the_tip(setting):
    twin = Twin.from_rig(RIG, link_mass=0.00735)
    made = builders(setting)
    assert mode_gain(setting, twin, made["ZV shaping"]()) == 0.0
    ours = mode_gain(setting, twin, made["fraclink"]())
    assert ours > 0.1
    massless = Twin.from_rig(RIG, link_mass=0.0)
    assert (
        mode_gain(setting, massless, made["fraclink"]()) == 0.0
    )  # no second mode to reach


@pytest.mark.slow
def test_every_rival_that_was_tuned_is_sound_at_the_nominal_payload(everything):
    for standing in everything.standings:
        assert standing.sound or standing.name == PUBLISHED, (
            f"{standing.name}: {standing.reason}"
        )
        assert standing.rule and standing.knob
    assert len(everything.standings) == 6


@pytest.mark.slow
def test_the_rule_of_the_same_ms_is_kept(everything):
    ours = everything.standings[0]
    for standing in everything.standings:
        if "same Ms" in standing.rule:
            assert standing.peak == pytest.approx(ours.peak, rel=2e-3), standing.name


@pytest.mark.slow
def test_verdicts_say_where_a_rival_wins(everything):
    sentences = everything.verdicts()
    assert any("better than fraclink" in s for s in sentences)
    noise = next(s for s in sentences if s.startswith("motor reference noise"))
    assert "ZV shaping" in noise and "better than fraclink" in noise
    text = everything.markdown()
    for standing in everything.standings:
        assert standing.name in text and standing.rule in text


@pytest.mark.slow
def test_no_winner_without_somebody_sound_or_somebody_else(everything):
    ours = everything.standings[0]
    alone = replace(everything, standings=(ours,))
    assert alone.verdicts() == ("fraclink ran alone: nothing to compare with",)
    growing = replace(
        everything, standings=(replace(ours, growth=0.2), replace(ours, passed=False))
    )
    assert growing.winners() == {}
    assert growing.verdicts()[0].startswith("no figure has a winner")
    assert "no figure has a winner" in growing.markdown()


@pytest.mark.slow
def test_saved_and_drawn(everything, tmp_path):
    everything.save(tmp_path / "comparison.json")
    data = json.loads((tmp_path / "comparison.json").read_text())
    assert [s["name"] for s in data["standings"]] == [
        s.name for s in everything.standings
    ]
    everything.draw(tmp_path / "comparison.svg")
    drawn = (tmp_path / "comparison.svg").read_text("utf-8")
    shown = sum(not math.isinf(s.settling_time) for s in everything.standings)
    assert drawn.count("never</text>") >= len(everything.standings) - shown
    assert all(html.escape(s.name) in drawn for s in everything.standings)
    with pytest.raises(FieldError, match=r"\.svg"):
        everything.draw(tmp_path / "comparison.png")


def test_refusals():
    rig = fl.Rig.named("paper-2023")
    with pytest.raises(FieldError, match="model"):
        compare(replace(rig, model=None))
    with pytest.raises(FieldError, match="payloads"):
        compare(rig, payloads=(0.03, -0.01))
    with pytest.raises(FieldError, match="link_mass"):
        compare(rig, link_mass=-0.001)
    with pytest.raises(
        FieldError,
        match=r"names: part of no rival's name \(got zzz\); expected fraclink, .*ZV shaping",
    ):
        compare(rig, names=["ZV shaping", "zzz"])


@pytest.mark.parametrize("field", ["payloads", "names", "seed", "reference"])
def test_what_is_no_payload_name_seed_or_reference_is_refused_by_its_field(field: str):
    for junk in (
        "12",
        b"x",
        1j,
        print,
        math.nan,
        -1.0,
        10**400,
        [None],
        [[1.0], [1.0, 2.0]],
        np.ones((3, 3)),
    ):
        with pytest.raises(FieldError, match=field):
            compare(RIG, **{"names": ["fraclink"], field: junk})


@pytest.mark.parametrize("ratio", [0.0, 0.0654, 0.2])
def test_a_shaped_reference_leaves_no_vibration_of_its_mode(ratio: float) -> None:
    times, sizes = zv_impulses(12.0, ratio)
    assert sizes.sum() == pytest.approx(1.0)
    pole = 12.0 * complex(-ratio, math.sqrt(1 - ratio**2))
    assert abs(np.sum(sizes * np.exp(-pole * times))) < 1e-12
    shaped = Shaped(
        fl.smooth_step(1.0, 1.0), tuple(times.tolist()), tuple(sizes.tolist())
    )
    t = np.linspace(0, 3, 3001)
    assert shaped.angle(t)[-1] == pytest.approx(1.0)
    assert np.gradient(shaped.angle(t), t)[1:-1] == pytest.approx(
        shaped.velocity(t)[1:-1], abs=1e-4
    )
