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
from scipy import linalg, signal

import fraclink as fl
from fraclink._arm.motor_loop import MotorLoop
from fraclink._arm.reference import smooth_step
from fraclink._arm.sampled import sampled_plant
from fraclink._campaign.rival_controllers import (
    Algebraic,
    Linear,
    Seen,
    Sliding,
    gpi_correction,
    hinf_correction,
    integer_mode,
    lqg_correction,
    pd_correction,
    sliding_correction,
)
from fraclink._campaign.rival_published import CORRECTED, INTEGER, PRINTED, integer_twin
from fraclink._campaign.rival_runs import (
    feed_forward,
    linear_growth,
    mode_gain,
    run_rival,
)
from fraclink._campaign.rivals import builders, servo_law
from fraclink._campaign.setting import (
    Filter,
    NominalLoop,
    Setting,
    law_filter,
    sampled,
    tune,
    tustin,
)
from fraclink._campaign.tournament import Tournament, compare
from fraclink._simulate import Twin, geared
from fraclink._simulate.on_twin import with_motor_loop
from fraclink._systems.margins import margins
from fraclink.errors import FieldError, NotConvergedError

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
    "H∞": lambda s: (
        lambda k: hinf_correction(s.model, period=0.004, pole=80.0, delay=1, gain=k),
        (1e-2, 1e2),
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
@pytest.mark.parametrize("name", ["sliding mode", "algebraic estimator + GPI"])
def test_structures_that_cannot_reach_the_ms_get_our_noise(setting, name):
    rival = builders(setting)[name]()
    ours = law_filter(setting.law)
    assert rival.peak > setting.target and rival.peak < 2.0
    assert setting.loop.noise(rival.correction) <= setting.loop.noise(ours)
    w, _ = integer_mode(setting.model)
    for make in (
        lambda r: sliding_correction(r, w, filter_time=0.01, period=0.004),
        lambda r: gpi_correction(r, w, filter_time=0.01, period=0.004),
    ):
        knob, correction, reached = tune(
            setting.loop, make, (0.3 * w, 20 * w), setting.target
        )
        assert not reached
        least = setting.loop.peak(correction)
        assert all(
            setting.loop.peak(make(knob * f)) >= least for f in (0.8, 0.95, 1.05, 1.25)
        )


@pytest.mark.slow
def test_noise_is_what_white_noise_becomes(setting):
    """The closed loop marched with white noise on the tip estimate, against the
    integral of |Ĉ S|².
    """
    correction, plant = law_filter(setting.law), setting.loop.plant
    x, k = np.zeros(plant.order), np.zeros(correction.order)
    noise = np.random.default_rng(5).standard_normal(20000)
    commands = np.empty(20000)
    for i, n in enumerate(noise.tolist()):
        error = -(plant.c @ x) - n
        commands[i] = correction.c @ k + correction.d * error
        k = correction.a @ k + correction.b * error
        x = plant.a @ x + plant.b * commands[i]
    assert setting.loop.noise(correction) == pytest.approx(
        commands[500:].std(), rel=0.03
    )


@pytest.mark.slow
def test_tuning_says_when_nothing_is_stable(setting):
    unstable = Filter(np.array([[1.1]]), np.ones(1), np.ones(1), 0.0)
    with pytest.raises(NotConvergedError, match="tuning"):
        tune(setting.loop, unstable.scaled, (1.0, 2.0), setting.target)


@pytest.mark.slow
def test_offset_rejection_by_structure(setting):
    """A constant tip error leads to no constant answer: H∞ by its weight, LQG by its
    offset state, ours.
    """
    one = np.array([1.0 + 1e-7j])
    for correction in (
        law_filter(setting.law),
        hinf_correction(setting.model, period=0.004, pole=80.0, delay=1, gain=1.0),
        lqg_correction(
            setting.model, period=0.004, pole=80.0, delay=1, noise=0.006, weight=1.0
        ),
    ):
        assert abs(correction.response(one)[0]) < 1e-4
    pd = pd_correction(0.1, corner=12.0, filter_time=0.01, period=0.004)
    assert abs(pd.response(one)[0]) == pytest.approx(0.1, rel=1e-3)


def test_tustin_and_chaining():
    first = tustin(np.array([[-3.0]]), np.ones(1), np.array([3.0]), 0.0, 0.01)
    s = 2 / 0.01 * (np.exp(0.05j) - 1) / (np.exp(0.05j) + 1)
    assert first.response(np.exp(np.array([0.05j])))[0] == pytest.approx(3 / (s + 3))
    both = first.after(first.scaled(2.0))
    assert both.response(np.exp(np.array([0.05j])))[0] == pytest.approx(
        2 * (3 / (s + 3)) ** 2
    )


@pytest.mark.slow
def test_lqg_against_separate_pieces(setting):
    """The closed loop of plant and LQG has the regulator's and the filter's poles:
    separation holds.
    """
    correction = lqg_correction(
        setting.model, period=0.004, pole=80.0, delay=1, noise=0.0064, weight=1.0
    )
    assert correction.order == 4 + 1 + 1  # arm, delay, offset
    assert setting.loop.radius(correction) <= 1.0 + 1e-9


def test_sliding_mode_is_linear_inside_its_layer():
    sliding = Sliding(10.0, 12.0, 1e9, filter_time=0.01, period=0.004)
    linear = Linear(sliding_correction(10.0, 12.0, filter_time=0.01, period=0.004))
    bounded = Sliding(10.0, 12.0, 1e-3, filter_time=0.01, period=0.004)
    generator = np.random.default_rng(0)
    for _ in range(50):
        seen = Seen(0.0, float(generator.normal(0, 0.01)), 0.0, 0.0)
        inside, outside = sliding(seen), bounded(seen)
        assert inside == pytest.approx(linear(seen), rel=1e-9, abs=1e-12)
    assert inside != outside


@pytest.mark.parametrize("true", [9.0, 12.0, 16.0])
def test_algebraic_estimator_finds_the_frequency(true):
    """θ̈t = ω²δ for a move that is known exactly: t³ has the second derivative 6t."""
    estimator = Algebraic(10.0, 12.0, filter_time=0.01, period=0.001, until=0.5)
    for k in range(600):
        t = 0.001 * k
        estimator(Seen(t**3, 0.0, 6 * t / true**2, 0.0))
    assert estimator.square == pytest.approx(true**2, rel=1e-3)


def test_gpi_places_four_poles():
    rate, w, period = 5.0, 12.0, 1e-4
    c = gpi_correction(
        rate, w, filter_time=1e-3 * period, period=period
    )  # a filter that filters nothing
    for s in (1j, 3 + 4j):
        z = np.exp(np.array([s * period]))
        value = c.response(z)[0] + 1.0
        # 1 + C ω²/s² = (s + r)⁴/(s³(s + 4r))
        assert 1 + value * w**2 / s**2 == pytest.approx(
            (s + rate) ** 4 / (s**3 * (s + 4 * rate)), rel=1e-3
        )


@pytest.mark.slow
def test_a_longer_filter_keeps_the_request_and_quietens(setting):
    """δ inside (55) costs β, not margin: what the 10 % rule leaves on the table."""
    from fraclink._campaign.rival_published import quieter

    _, controller = quieter(setting)
    assert controller.filter_time > 2 * setting.controller.filter_time
    noise = setting.loop.noise
    assert noise(controller.response) < 0.5 * noise(setting.controller.response)
    design = fl.design(
        RIG.model,
        RIG,
        payloads=(0.020, 0.040),
        gain_crossover=12.0,
        phase_margin=fl.deg(50.0),
        filter_time=controller.filter_time,
    )
    assert design.passed and design.controller.gain == pytest.approx(controller.gain)


@pytest.mark.slow
def test_integer_twin_goes_through_our_crossing(setting):
    from fraclink._campaign.rival_published import _nominal_crossing

    crossover, margin = _nominal_crossing(setting)
    _, controller = integer_twin(setting)
    mode, _ = integer_mode(setting.model)
    s = 1j * crossover
    loop = (
        controller.response(crossover) * mode**2 / (s**2 + mode**2) / (1 + s / 80) ** 2
    )
    loop *= np.exp(-s * 1.5 * RIG.period)
    assert abs(loop) == pytest.approx(1.0, rel=1e-9)
    assert np.angle(-loop) == pytest.approx(margin, rel=1e-6)


@pytest.mark.slow
def test_rivals_and_the_law_run_on_the_same_arm(setting):
    """Our filter run tick by tick in Python, and law.c: the same motor reference to
    rounding.
    """

    from fraclink._campaign.rivals import Rival
    from fraclink._law import Modes

    twin = Twin.from_rig(RIG, link_mass=0.00735)
    whole = servo_law(setting.law)
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
        outer=lambda: Linear(correction),
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

    law = replace(servo_law(setting.law), correction=Modes(0.0))
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
def test_sampled_delay_is_a_delay(setting):
    from fraclink._simulate.plant import assemble

    twin = Twin.from_rig(RIG, link_mass=0.0)
    plant = assemble(twin.beam, twin.damping, drive="servo")
    z = np.exp(1j * np.array([0.02, 0.3, 1.5]))
    now, late = (sampled(plant, plant.outputs[2], 0.004, d).response(z) for d in (0, 3))
    assert late == pytest.approx(now * z**-3, rel=1e-12)


@pytest.mark.slow
def test_every_rival_that_was_tuned_is_sound_at_the_nominal_payload(everything):
    published = {
        INTEGER,
        PRINTED,
        CORRECTED,
    }  # taken as the paper has them, whatever comes of it
    for standing in everything.standings:
        assert standing.sound or standing.name in published, (
            f"{standing.name}: {standing.reason}"
        )
        assert standing.rule and standing.knob
    assert len(everything.standings) == 13


@pytest.mark.slow
def test_a_rival_that_friction_holds_is_told_from_a_sound_one(everything):
    printed = next(s for s in everything.standings if s.name == PRINTED)
    assert printed.growth == pytest.approx(0.17, abs=0.03) and not printed.sound
    assert all(PRINTED not in names for names in everything.winners().values())
    if printed.passed:
        assert (
            f"{PRINTED}: the linear loop on the twin is unstable"
            in everything.markdown()
        )


@pytest.mark.slow
def test_linear_growth_is_that_of_the_loops_eigenvalues(setting):
    twin = Twin.from_rig(RIG, link_mass=0.0, payload=0.030)
    made = builders(setting)
    assert linear_growth(setting, twin, made["fraclink"]()) == 0.0
    assert linear_growth(setting, twin, made["ZV shaping"]()) == 0.0
    # Without hold and delay (58) has poles at +0.106 ± 12.89j; hold and delay cost a
    # little more.
    assert linear_growth(setting, twin, made[PRINTED]()) == pytest.approx(
        0.13, abs=0.06
    )


@pytest.mark.slow
def test_the_rule_of_the_same_ms_is_kept(everything):
    ours = everything.standings[0]
    for standing in everything.standings:
        if "same Ms" in standing.rule:
            assert standing.peak == pytest.approx(ours.peak, rel=2e-3), standing.name
    printed = next(s for s in everything.standings if "printed" in s.name)
    assert math.isinf(
        printed.peak
    )  # (58) as printed is unstable on the paper's own model


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
    assert "inf" in {s["peak"] for s in data["standings"]}
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


def lumped(model: fl.LinkModel, pole: float, s: np.ndarray) -> np.ndarray:
    """M(s) G(s) of the nearest integer-order link, written out."""
    w, ratio = integer_mode(model)
    return (pole / (s + pole)) ** 2 * w**2 / (s**2 + 2.0 * ratio * w * s + w**2)


@pytest.mark.parametrize(("delay", "gain"), [(0, 0.2), (1, 0.4), (2, 1.0)])
def test_loop_shaping_bears_the_coprime_uncertainty_that_its_gamma_says(
    delay: int, gain: float
) -> None:
    """min |1 + PK|/√((1 + |P|²)(1 + |K|²)) over ω is at least 1/γ, and γ is 1.1 times
    the best there is.
    """
    period, pole, model = 0.004, 80.0, RIG.model
    w0, ratio = integer_mode(model)
    made = hinf_correction(model, period=period, pole=pole, delay=delay, gain=gain)
    w = np.geomspace(0.01, 600.0, 20000)
    s, corner, rate = 1j * w, w0 / 10.0, 2.0 / ((delay + 0.5) * period)
    weight = gain * s / (s + corner)
    plant = weight * (rate - s) / (rate + s) * lumped(model, pole, s)
    # Tustin's map takes jω to this point of the unit circle, so that the continuous
    # controller is seen.
    z = (1.0 + s * period / 2.0) / (1.0 - s * period / 2.0)
    central = made.response(z) / weight
    margin = np.abs(1.0 + plant * central) / np.sqrt(
        (1.0 + np.abs(plant) ** 2) * (1.0 + np.abs(central) ** 2)
    )
    # The best margin from Hankel's singular value of the normalised factors, by a
    # realisation of its own.
    arm = signal.TransferFunction(
        gain * w0**2 * pole**2 * np.polymul([1.0, 0.0], [-1.0, rate]),
        np.polymul(
            np.polymul([1.0, corner], [1.0, rate]),
            np.polymul(
                np.polymul([1.0, pole], [1.0, pole]), [1.0, 2.0 * ratio * w0, w0**2]
            ),
        ),
    ).to_ss()
    x = linalg.solve_continuous_are(arm.A, arm.B, arm.C.T @ arm.C, np.eye(1))
    y = linalg.solve_continuous_are(arm.A.T, arm.C.T, arm.B @ arm.B.T, np.eye(1))
    best = 1.0 / math.sqrt(1.0 + float(np.abs(np.linalg.eigvals(x @ y)).max()))
    assert best / 1.1 * (1 - 1e-6) <= margin.min() <= best * (1 + 1e-3)


@pytest.mark.parametrize(("delay", "weight"), [(0, 1.0), (1, 4.0), (3, 0.3)])
def test_the_lqg_loop_has_the_poles_of_regulator_and_filter(
    delay: int, weight: float
) -> None:
    """Separation, with both Riccati equations solved for another realisation of the
    arm.
    """
    period, pole, noise = 0.004, 80.0, 0.0064
    w, ratio = integer_mode(RIG.model)
    denominator = np.polymul(
        np.polymul([1.0, pole], [1.0, pole]), [1.0, 2.0 * ratio * w, w**2]
    )
    arm = signal.TransferFunction([w**2 * pole**2], denominator).to_ss()
    a, b, c, *_ = signal.cont2discrete((arm.A, arm.B, arm.C, arm.D), period)
    n = 4 + delay
    held, drive, row = np.zeros((n, n)), np.zeros((n, 1)), np.zeros((1, n))
    held[:4, :4], row[:, :4] = a, c
    if delay:
        held[:4, 4:5] = b
        held[4 : n - 1, 5:] = np.eye(delay - 1)
        drive[-1] = 1.0
    else:
        drive[:4] = b
    cost = linalg.solve_discrete_are(
        held, drive, row.T @ row, np.array([[1.0 / weight]])
    )
    regulator = held - drive @ np.linalg.solve(
        1.0 / weight + drive.T @ cost @ drive, drive.T @ cost @ held
    )
    made = lqg_correction(
        RIG.model, period=period, pole=pole, delay=delay, noise=noise, weight=weight
    )
    loop = np.block(
        [
            [held - made.d * drive @ row, drive @ made.c[None, :]],
            [-made.b[:, None] @ row, made.a],
        ]
    )
    # The filter: a noise of 10 mrad on the motor reference, an offset that walks by 3
    # mrad in ten seconds.
    wide = linalg.block_diag(held, 1.0)
    seen = np.hstack([row, [[1.0]]])
    process = linalg.block_diag(0.01**2 * drive @ drive.T, 3e-3**2 * period / 10.0)
    spread = linalg.solve_discrete_are(
        wide.T, seen.T, process + 1e-26 * np.eye(n + 1), np.array([[noise**2]])
    )
    kalman = spread @ seen.T / (noise**2 + seen @ spread @ seen.T)
    found, wanted = np.linalg.eigvals(loop), np.linalg.eigvals(regulator)
    slowest = np.abs(np.linalg.eigvals(wide @ (np.eye(n + 1) - kalman @ seen))).max()
    assert (
        np.abs(np.abs(found) - slowest).min() < 1e-8 and slowest > 0.99
    )  # the offset's
    for one in wanted:  # the regulator's poles are among those of the loop
        assert np.abs(found - one).min() < 1e-4
    assert np.abs(found).max() <= 1.0 + 1e-9
