"""The table of a tournament: who wins which figure and by how much, in words; what each
rival costs.
"""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import fraclink as fl
from fraclink._arm.shapers import shaper_impulses
from fraclink._campaign import rivals as rivals_module
from fraclink._campaign import tournament as module
from fraclink._campaign.rival_controllers import Linear, Seen, integer_mode
from fraclink._campaign.rival_published import QUIETER, corrected, printed, quieter
from fraclink._campaign.rival_runs import (
    _plant,
    feed_forward,
    linear_growth,
    mode_gain,
    run_rival,
)
from fraclink._campaign.rivals import (
    FRACLINK,
    Rival,
    _law_cost,
    builders,
    collocated,
    servo_law,
)
from fraclink._campaign.setting import (
    Filter,
    NominalLoop,
    Setting,
    fine_step,
    prepare,
    tune,
)
from fraclink._campaign.tournament import Standing, Tournament, compare
from fraclink._law import Modes
from fraclink._simulate import MoveVerdict, Twin, geared
from fraclink.errors import FieldError, InfeasibleError, NotConvergedError

RIG = geared(fl.Rig.named("paper-2023"))
PERIOD = 0.004


def standing(name: str = FRACLINK, **own: Any) -> Standing:
    made = Standing(
        name,
        "a rule",
        "k 1",
        True,
        "settled in 1 s",
        1.0,
        0.02,
        0.004,
        0.003,
        0.002,
        0.0,
        0.04,
        1.5,
        0.25,
        0.0,
        1.6,
        5,
        12,
    )
    return replace(made, **own)


def tournament(
    *standings: Standing, notes: tuple[str, ...] = ("a note",)
) -> Tournament:
    return Tournament(standings, notes, {})


@pytest.fixture(scope="module")
def setting() -> Setting:
    return prepare(
        RIG, None, 0.0, gain_crossover=12.0, phase_margin=fl.deg(50), filter_time=None
    )[0]


# ── who wins
# ────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize(
    ("figure", "floor"),
    [
        ("settling_time", 0.01), ("overshoot", 0.001), ("residual_vibration", 1e-4), ("offset_error", 1e-4),
        ("motor_reference_noise", 1e-4), ("saturated", 0.001), ("worst_settling", 0.01), ("mode_gain", 1e-3),
        ("states", 0.0), ("multiplications", 0.0),
    ],
)  # fmt: skip
def test_equal_is_who_differs_by_two_percent_and_a_floor(
    figure: str, floor: float
) -> None:
    best = 100 if floor == 0.0 else 0.5
    edge = best * 1.02 + floor
    rivals = [
        standing(f"r{k}", **{figure: value})
        for k, value in enumerate((best, edge * 0.9999, edge * 1.0001))
    ]
    assert tournament(*rivals).winners()[figure] == ("r0", "r1")


def test_only_the_sound_win_and_all_share_what_none_reaches() -> None:
    quick, growing, failed = (
        standing("a", settling_time=2.0),
        standing("b", growth=0.1),
        standing("c", passed=False),
    )
    assert quick.sound and not growing.sound and not failed.sound
    found = tournament(quick, growing, failed).winners()
    assert list(found) == list(module._FIGURES) and set(found.values()) == {("a",)}
    endless = tournament(
        standing("a", settling_time=math.inf), standing("b", settling_time=math.inf)
    )
    assert endless.winners()["settling_time"] == ("a", "b")
    assert tournament(growing, failed).winners() == {}


def test_a_verdict_is_a_sentence_for_each_figure_in_its_unit() -> None:
    ours = standing(
        settling_time=0.5, residual_vibration=0.00123, mode_gain=0.25, states=7
    )
    other = standing(
        "PD", settling_time=0.8, overshoot=0.013, residual_vibration=0.0005, saturated=0.25, states=3,
        worst_settling=math.inf, motor_reference_noise=1e-10,
    )  # fmt: skip
    said = dict(
        sentence.split(": ", 1) for sentence in tournament(ours, other).verdicts()
    )
    assert said["settling time"] == "fraclink is best (0.5 s)"
    assert said["overshoot"] == "better than fraclink: PD (1.3 % against 2 %)"
    assert (
        said["residual vibration"]
        == "better than fraclink: PD (0.5 mrad against 1.23 mrad)"
    )
    assert (
        said["motor reference noise"]
        == "better than fraclink: PD (0 mrad against 2 mrad)"
    )
    assert said["offset error"] == "fraclink is best (3 mrad), with PD"
    assert said["saturated"] == "fraclink is best (0 %)"
    assert said["worst settling"] == "fraclink is best (1.5 s)"
    assert said["states"] == "better than fraclink: PD (3 against 7)"
    assert said["mode gain"] == "fraclink is best (0.25), with PD" and len(said) == 10
    never = tournament(replace(ours, settling_time=math.inf), other).verdicts()
    assert "settling time: better than fraclink: PD (0.8 s against never)" in never


def test_the_table_shows_every_figure_in_its_unit_and_who_failed() -> None:
    ours = standing(worst_payload=0.008, saturated=0.125, overshoot=0.0213)
    lost = standing(
        "wild", passed=False, settling_time=math.inf, worst_settling=math.inf, offset_error=math.inf,
        peak=math.inf, growth=0.25,
    )  # fmt: skip
    held = standing("held", growth=0.5, saturated=0.25)
    stuck = standing("stuck", growth=0.5)
    text = tournament(ours, lost, held, stuck, notes=("one", "two")).markdown()
    lines = text.splitlines()
    assert lines[2] == (
        "| fraclink | 1.00 | 2.1 | 4.0 | 3 | 2.0 | 12.5 | 8 g: 1.50 s | 0.250 | stable | 1.60 | 5 | 12 |"
    )
    assert lines[3] == (
        "| wild (failed) | never | 2.0 | 4.0 | never | 2.0 | 0.0 | 40 g: never | 0.250 | grows 0.25/s "
        "| unstable | 5 | 12 |"
    )
    assert lines[0].count("|") == lines[1].count("|") == lines[2].count("|") == 14
    hidden = [line for line in lines if "linear loop on the twin is unstable" in line]
    assert len(hidden) == 2 and "e-fold in 2 s" in hidden[0]
    assert "the voltage limit, reached in 25 % of the periods, bounds it" in hidden[0]
    assert "friction holds the oscillation while it is small" in hidden[1]
    assert lines[-2:] == ["- one", "- two"] and "- held: a rule (k 1)" in lines
    assert "Unstable linear loop" not in tournament(ours).markdown()


# ── one standing
# ────────────────────────────────────────────────────────────────────────────────────────────


def fake_run(
    settling: float, *, passed: bool = True, reason: str = "settled", **own: Any
) -> Any:
    metrics = SimpleNamespace(
        settling_time=settling,
        overshoot=0.1,
        residual_vibration=0.2,
        motor_reference_noise=0.3,
        saturated=0.4,
    )
    time, error = (
        PERIOD * np.arange(1501),
        np.r_[np.full(1251, 9.0), np.full(250, -0.03)],
    )
    return SimpleNamespace(
        metrics=metrics,
        verdict=MoveVerdict(passed, reason),
        time=time,
        error=error,
        finished=True,
        **own,
    )


@pytest.mark.parametrize(
    ("settling", "passed", "found"),
    [
        (1.0, True, 1.0),
        (5.0, True, 5.0),
        (5.01, True, math.inf),
        (1.0, False, math.inf),
    ],
)
def test_settled_is_who_stays_in_the_band_for_the_last_second(
    settling: float, passed: bool, found: float
) -> None:
    assert module._settled(fake_run(settling, passed=passed)) == found


def test_a_standing_is_the_nominal_run_the_offset_and_the_worst_payload(
    setting: Setting, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def run(
        twin: Any,
        rival: Any,
        move: Any,
        law: Any,
        *,
        duration: float,
        offset: float,
        seed: int,
    ) -> Any:
        payload = twin.beam.payload
        asked.append((payload, duration, offset, seed))
        return fake_run({0.03: 1.0, 0.01: 2.0, 0.04: 1.5}[payload])

    monkeypatch.setattr(module, "run_rival", run)
    monkeypatch.setattr(module, "mode_gain", lambda *_: 0.7)
    monkeypatch.setattr(module, "linear_growth", lambda *_: 0.0)
    rival = Rival("PD", "rule", "knob", 1.5, 3, 9, setting.law)
    twin = Twin.from_rig(RIG, link_mass=0.0)
    found, nominal = module._standing(
        setting, twin, rival, fl.smooth_step(1.0, 1.0), (0.03, 0.01, 0.04), 7
    )
    assert asked == [(0.03, 6.0, 0.0, 7), (0.03, 6.0, 0.05, 7)] + [
        (p, 6.0, 0.0, 7) for p in (0.03, 0.01, 0.04)
    ]
    assert found == Standing(
        "PD", "rule", "knob", True, "settled", 1.0, 0.1, 0.2, pytest.approx(0.03), 0.3, 0.4, 0.01, 2.0, 0.7,
        0.0, 1.5, 3, 9,
    )  # fmt: skip
    assert nominal.metrics.settling_time == 1.0


@pytest.mark.parametrize(
    ("reason", "passed"),
    [("unstable: grows", False), ("tripped: off", False), ("not settled", True)],
)
def test_a_standing_fails_where_the_nominal_run_is_unstable_or_tripped(
    setting: Setting, reason: str, passed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def run(*_: Any, offset: float, **__: Any) -> Any:
        found = fake_run(1.0, passed=False, reason=reason)
        found.finished = not offset
        return found

    monkeypatch.setattr(module, "run_rival", run)
    rival = Rival("PD", "rule", "knob", 1.5, 3, 9, setting.law)
    twin = Twin.from_rig(RIG, link_mass=0.0)
    found, _ = module._standing(
        setting, twin, rival, fl.smooth_step(1.0, 1.0), (0.02, 0.01), 1
    )
    assert (found.passed, found.reason, found.offset_error) == (
        passed,
        reason,
        math.inf,
    )
    assert found.worst_payload == 0.01
    assert found.worst_settling == math.inf  # of two that never settle: farther


def test_names_choose_rivals_and_one_that_cannot_be_made_is_a_note(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert module._chosen(("fraclink", "LQG", "ZV shaping", "ZVD shaping"), ["zv"]) == [
        "fraclink", "ZV shaping", "ZVD shaping",
    ]  # fmt: skip
    assert module._chosen(("fraclink", "LQG"), None) == ["fraclink", "LQG"]

    def refused() -> Rival:
        raise InfeasibleError("filter_time", "no longer filter")

    made = {"fraclink": lambda: "ours", "longer": refused, "LQG": lambda: "lqg"}
    monkeypatch.setattr(
        module, "prepare", lambda *_, **__: ("setting", "twin", ["first"])
    )
    monkeypatch.setattr(module, "builders", lambda _: made)
    monkeypatch.setattr(
        module,
        "_standing",
        lambda s, t, rival, *_: (standing(rival), f"run of {rival}"),
    )
    begun: list[str] = []
    found = compare(RIG, progress=begun.append)
    assert begun == list(made) and [s.name for s in found.standings] == ["ours", "lqg"]
    assert found.notes == ("first", "longer left out: filter_time: no longer filter")
    assert found.runs == {"fraclink": "run of ours", "LQG": "run of lqg"}


def test_a_rival_is_run_with_a_jump_of_the_gauges_offset(setting: Setting) -> None:
    """Without feedback of the gauge the run is the same; the reading is not, from 0.2 s
    on.
    """
    bare = replace(
        servo_law(setting.law), correction=Modes(0.0), feedforward=Modes(0.0)
    )
    assert bare.drive is not None
    bare = replace(bare, drive=replace(bare.drive, torque_voltage=0.0))
    twin = Twin.from_rig(RIG, link_mass=0.0)
    rival = Rival("bare", "", "", 1.0, 0, 0, bare)
    move = fl.smooth_step(0.2, 0.3)
    plain, jumped = (
        run_rival(twin, rival, move, setting.law, duration=0.6, offset=offset, seed=3)
        for offset in (0.0, 0.25)
    )
    difference = jumped.torque_measured - plain.torque_measured
    assert np.all(difference[:50] == 0.0) and difference[50:] == pytest.approx(
        0.25, abs=2e-3
    )
    assert (
        plain.about["rival"] == "bare"
        and plain.about["seed"] == 3
        and len(plain.time) == 151
    )
    assert plain.reference == pytest.approx(move.angle(plain.time))
    shaped = Rival("ZV", "", "", 1.0, 0, 0, bare, impulses=((0.0, 0.25), (0.5, 0.5)))
    run = run_rival(twin, shaped, move, setting.law, duration=0.6)
    assert run.reference == pytest.approx(
        move.angle(run.time)
    )  # judged by what was asked
    assert (
        np.abs(run.motor_reference[:25] - 0.5 * plain.motor_reference[:25]).max() < 1e-3
    )


def test_an_outer_controller_sees_reference_error_and_bend(setting: Setting) -> None:
    rows_seen: list[Seen] = []

    def outer(seen: Seen) -> float:
        rows_seen.append(seen)
        return 0.125

    bare = replace(
        servo_law(setting.law), correction=Modes(0.0), feedforward=Modes(0.0)
    )
    rival = Rival("outer", "", "", 1.0, 0, 0, bare, outer=lambda: outer)
    twin = Twin.from_rig(RIG, link_mass=0.0)
    quiet = replace(
        twin,
        sensors=replace(
            twin.sensors, gauge_noise=0.0, gauge_quantum=0.0, gauge_gain=1.0
        ),
    )
    move = fl.smooth_step(0.2, 0.3)
    run = run_rival(quiet, rival, move, setting.law, duration=0.4, seed=1)
    forward = feed_forward(setting.law, move.acceleration(run.time))
    rows = np.array(rows_seen)
    assert rows[:, 0] == pytest.approx(run.reference) and rows[:, 3] == pytest.approx(
        forward
    )
    assert rows[:, 2] == pytest.approx(run.torque_measured / 1.56, abs=1e-12)
    assert rows[:, 1] == pytest.approx(
        run.reference - run.motor_angle_measured + rows[:, 2], abs=1e-12
    )
    assert run.motor_reference[1:] == pytest.approx(
        (run.reference + forward + 0.125)[1:], abs=1e-9
    )
    lost = replace(rival, outer=lambda: lambda _: 1e9)
    assert not run_rival(quiet, lost, move, setting.law, duration=4.0).finished


# ── what a rival is
# ─────────────────────────────────────────────────────────────────────────────────────────


def test_guards_that_never_act_leave_the_fade(setting: Setting) -> None:
    law, wide = setting.law, servo_law(setting.law)
    assert wide.limits.fade_step == law.limits.fade_step
    assert (
        wide.limits.motor_step
        == wide.limits.torque_limit
        == wide.limits.residual_angle
        == 1e6
    )
    assert (
        wide.limits.bad_limit == law.limits.bad_limit
        and replace(wide, limits=law.limits) == law
    )


def test_states_and_products_are_those_of_law_and_filter(setting: Setting) -> None:
    """A mode of the law takes two products, a filter of order n as many as its 2n + 1
    coefficients.
    """
    law = setting.law
    forward, modes = len(law.feedforward.poles), len(law.correction.poles)
    pairs = len(law.correction.pair_poles)
    made = builders(setting)
    ours = made[FRACLINK]()
    assert ours.states == forward + 1 + modes + 2 * pairs
    assert ours.multiplications == 1 + 2 * forward + 2 + 2 * modes + 6 * pairs
    pd = made["PD on the tip estimate"]()
    assert (pd.states, pd.multiplications) == (forward + 1, 1 + 2 * forward + 1 + 2 + 1)
    assert ours.law.drive == law.drive and ours.law.limits == servo_law(law).limits
    assert pd.law.correction == pd.law.feedforward == Modes(0.0)
    controller = setting.controller
    assert ours.knob.startswith(f"k_d {controller.gain:.4g}, β {controller.order:.4g}")
    two = law.correction._replace(pair_poles=(0.9 + 0.1j,), pair_gains=(0.1j,))
    states, products = _law_cost(replace(law, correction=two))
    assert (states, products) == (ours.states + 2, ours.multiplications + 6)


@pytest.mark.parametrize(("kind", "count"), [("ZV", 2), ("ZVD", 3)])
def test_a_shaper_waits_for_its_last_impulse(
    setting: Setting, kind: Any, count: int
) -> None:
    rival = builders(setting)[f"{kind} shaping"]()
    times, sizes = shaper_impulses(kind, *integer_mode(setting.model))
    assert rival.impulses == (tuple(times.tolist()), tuple(sizes.tolist()))
    assert (rival.states, rival.multiplications, rival.peak) == (
        math.ceil(times[-1] / PERIOD),
        count,
        1.0,
    )
    assert rival.knob == f"half period {times[1]:.4g} s" and rival.outer is None


@pytest.mark.slow
def test_the_collocated_pd_places_the_hubs_double_pole(setting: Setting) -> None:
    """Without the link: J s² + (ν + K k_d) s + K k_p has the double pole −p; the motor
    is behind its gear.
    """
    rival = collocated(setting, servo_law(setting.law))
    assert rival.law.drive is not None
    pd = rival.law.drive.loop
    pole = float(rival.knob.split()[2])
    motor = setting.rig.motor
    derivative = 2 * pole - motor.decay
    assert motor.gain * pd.direct == pytest.approx(pole**2, rel=1e-3)
    assert motor.gain * pd.angle_direct / 300.0 == pytest.approx(derivative, rel=1e-3)
    assert pd.angle_filter_gain == pytest.approx(-300.0 * pd.angle_direct)
    half = 0.5 * PERIOD
    assert pd.filter_now == pd.filter_before == pytest.approx(half / (1 + 300 * half))
    assert (
        pd.filter_decay == pytest.approx((1 - 300 * half) / (1 + 300 * half))
        and pd.integral_gain == 0.0
    )
    assert (rival.states, rival.multiplications) == (
        1,
        4,
    ) and rival.law.drive.torque_voltage == 0.0
    assert rival.peak == pytest.approx(setting.target, rel=1e-3)


def test_the_papers_controllers_have_the_papers_numbers(setting: Setting) -> None:
    rule, found = printed(setting)
    assert (found.gain, found.order, found.filter_time, found.filter_order) == (
        0.148,
        0.65,
        0.16,
        2,
    )
    assert (
        found.link == setting.controller.link
        and found.inner == setting.controller.inner
    )
    rule, found = corrected(setting)
    wanted = fl.design(
        setting.model, RIG, payloads=(0.02, 0.04), gain_crossover=16.0, phase_margin=fl.deg(70.0),
        margins="ideal", filter_order=2, law=False,
    )  # fmt: skip
    assert found == wanted.controller and "16 rad/s, 70°" in rule


def test_the_quieter_design_is_the_quietest_of_those_that_are_feasible(
    setting: Setting, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []
    base = setting.controller.filter_time
    noise = {2: 4.0, 4: 1.5, 8: 2.5}

    def design(model: Any, rig: Any, *, filter_time: float, **wanted: Any) -> Any:
        asked.append(filter_time / base)
        assert (wanted["gain_crossover"], wanted["payloads"]) == (12.0, (0.02, 0.04))
        if round(filter_time / base) > 8:
            raise InfeasibleError(
                "filter_time", f"{filter_time / base:.0f} is too long"
            )
        return SimpleNamespace(
            controller=SimpleNamespace(response=round(filter_time / base))
        )

    monkeypatch.setattr("fraclink._campaign.rival_published.design", design)
    loop: Any = SimpleNamespace(noise=noise.get)
    rule, found = quieter(replace(setting, loop=loop))
    assert (
        asked == pytest.approx([2, 4, 8, 12, 16])
        and found.response == 4
        and "2 to 16" in rule
    )
    assert QUIETER == "fraclink, longer filter"
    short = replace(
        setting, loop=loop, controller=replace(setting.controller, filter_time=0.0)
    )
    asked.clear()
    with pytest.raises(InfeasibleError):
        quieter(
            replace(
                short, controller=replace(setting.controller, filter_time=1e6 * base)
            )
        )
    asked.clear()
    with pytest.raises((InfeasibleError, TypeError)):
        quieter(short)
    assert asked[0] * base == pytest.approx(
        2e-3
    )  # a design without a filter: from 1 ms on


# ── the loop that they are tuned on
# ─────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize(
    ("period", "step"),
    [(0.004, 0.001), (0.001, 0.001), (0.0005, 0.0005), (0.0045, 0.0009)],
)
def test_fine_steps_divide_the_period(period: float, step: float) -> None:
    assert fine_step(period) == pytest.approx(step, rel=1e-12)


def scalar(pole: float, gain: float) -> NominalLoop:
    """A plant with one pole, gain/(z − pole), as a loop to be tuned on."""
    return NominalLoop(
        Filter(np.array([[pole]]), np.ones(1), np.array([gain]), 0.0), PERIOD, 1.0
    )


def constant(k: float) -> Filter:
    return Filter(np.zeros((0, 0)), np.zeros(0), np.zeros(0), k)


def test_radius_and_peak_of_a_loop_with_one_pole() -> None:
    """1 + k/(z − a): the pole is a − k, and |S| is largest at one end of the band."""
    loop = scalar(0.5, 1.0)
    assert loop.radius(constant(0.3)) == pytest.approx(0.2)
    z = -np.exp(
        -1j * 0.001 * math.pi
    )  # the last frequency looked at, a thousandth below Nyquist
    assert loop.peak(constant(1.2)) == pytest.approx(
        abs(1 / (1 + 1.2 / (z - 0.5))), rel=1e-9
    )
    assert (
        loop.peak(constant(1.6)) == math.inf and loop.peak(constant(1.4999)) < math.inf
    )
    assert loop.frequencies[[0, -1]] == pytest.approx([0.1, 0.999 * math.pi / PERIOD])
    ratio = loop.frequencies[1:] / loop.frequencies[:-1]
    assert ratio.max() == pytest.approx(1.02, abs=0.001)


def test_noise_is_the_rms_of_the_gain_from_estimate_to_reference() -> None:
    """Ĉ/(1 + Ĉ P) = k (z − a)/(z − a + k): its energy by the residue theorem."""
    k, a = 0.7, 0.5
    b = a - k
    energy = k**2 * (1 + (b - a) ** 2 / (1 - b**2))
    assert scalar(a, 1.0).noise(constant(k)) == pytest.approx(
        math.sqrt(energy), rel=2e-3
    )
    assert scalar(a, 1.0).noise(lambda w: np.full(w.shape, k + 0j)) == pytest.approx(
        math.sqrt(energy), rel=2e-3
    )


def test_a_knob_is_turned_up_to_the_target_and_not_past_a_worse_range() -> None:
    seen: list[float] = []

    def loop(shape: Any) -> Any:
        return SimpleNamespace(peak=lambda made: (seen.append(made), shape(made))[1])  # type: ignore[func-returns-value]

    value, made, reached = tune(loop(lambda k: 1.0 + k), lambda k: k, (0.1, 10.0), 3.0)  # type: ignore[arg-type,return-value]
    assert reached and value == made == pytest.approx(2.0, rel=1e-5)
    value, _, reached = tune(loop(lambda k: 1.0), lambda k: k, (0.1, 10.0), 3.0)  # type: ignore[arg-type,return-value]
    assert reached and value == pytest.approx(10.0)  # good to the end: the end
    seen.clear()
    valley = loop(lambda k: 2.0 if 0.5 < k < 1.0 or k > 5.0 else math.inf)
    value, _, reached = tune(valley, lambda k: k, (0.1, 10.0), 3.0)  # type: ignore[arg-type,return-value]
    assert reached and value == pytest.approx(1.0, rel=1e-4) and max(seen) < 1.2
    value, _, reached = tune(
        loop(lambda k: 4.0 + math.log(k / 2.0) ** 2),
        lambda k: k,  # type: ignore[return-value]
        (0.1, 10.0),
        3.0,
    )
    assert not reached and value == pytest.approx(2.0, rel=1e-4)
    with pytest.raises(NotConvergedError, match="tuning"):
        tune(loop(lambda k: math.inf), lambda k: k, (0.1, 10.0), 3.0)  # type: ignore[arg-type,return-value]


def test_growth_is_the_logarithm_of_the_radius_in_a_second(setting: Setting) -> None:
    twin = Twin.from_rig(RIG, link_mass=0.0, payload=0.030)
    strong = Filter(np.zeros((0, 0)), np.zeros(0), np.zeros(0), 30.0)
    rival = Rival(
        "wild",
        "",
        "",
        1.0,
        0,
        0,
        setting.law,
        correction=strong,
        outer=lambda: Linear(strong),
    )
    _, seen = _plant(setting, twin)
    closed = seen.a - 30.0 * np.outer(seen.b, seen.c)
    radius = np.abs(np.linalg.eigvals(closed)).max()
    assert radius > 1 and linear_growth(setting, twin, rival) == pytest.approx(
        math.log(radius) / PERIOD
    )


@pytest.mark.slow
def test_the_gain_at_the_second_mode_is_the_largest_around_it(setting: Setting) -> None:
    twin = Twin.from_rig(RIG, link_mass=0.00735, payload=0.030)
    plant, seen = _plant(setting, twin)
    mode = float(plant.modes.frequencies[1])
    w = np.linspace(0.8 * mode, 1.25 * mode ** (2 / 1.92), 20_000)
    largest = np.abs(seen.response(np.exp(1j * w * PERIOD))).max()
    for gain in (1.0, 0.25):
        rival = Rival("flat", "", "", 1.0, 0, 0, setting.law, correction=constant(gain))
        assert mode_gain(setting, twin, rival) == pytest.approx(
            gain * largest, rel=2e-3
        )


def test_the_shortest_filter_that_is_quiet_enough_is_taken(setting: Setting) -> None:
    """10 ms · 1.25^k: with a noise of 1/time, and 60 allowed, k is 3; the rate is that
    of the least Ms.
    """
    loop: Any = SimpleNamespace(
        noise=lambda made: 60.0 if isinstance(made, Filter) else 1.0 / made.time,
        peak=lambda made: 2.0 + math.log(made.rate / 10.0) ** 2,
    )
    made: Any = lambda rate, time: SimpleNamespace(rate=rate, time=time)  # noqa: E731
    rate, time, found = rivals_module._quiet(replace(setting, loop=loop), 12.0, made)
    seen: Any = found
    assert time == pytest.approx(0.01 * 1.25**3) == seen.time and rate == pytest.approx(
        10.0, rel=1e-3
    )


def test_the_collocated_pd_is_a_filtered_derivative(setting: Setting) -> None:
    found = rivals_module._controller(setting, 25.0)
    proportional, derivative = rivals_module._gains(setting, 25.0)
    z = np.exp(1j * np.array([0.01, 0.2, 1.0, 2.5]))
    s = 2.0 / PERIOD * (z - 1) / (z + 1)
    assert found.response(z) == pytest.approx(
        proportional + derivative * s * 300.0 / (s + 300.0)
    )
    motor = setting.rig.motor
    assert proportional == pytest.approx(625.0 / motor.gain)
    assert derivative == pytest.approx((50.0 - motor.decay) / motor.gain)
    assert (
        rivals_module._gains(setting, 0.1)[1] == 0.0
    )  # a motor with more friction than that


@pytest.mark.slow
def test_what_rivals_are_tuned_from_says_what_was_assumed() -> None:
    plain = fl.Rig.named("paper-2023")
    found, twin, notes = prepare(
        plain, None, None, gain_crossover=12.0, phase_margin=fl.deg(50), filter_time=0.0
    )
    assert found.rig.motor.gear_ratio == 50.0 and twin.beam.link_mass == 0.00735
    assert (
        notes[0] == "link of 7.35 g, power law, D = s^0.08 (lambda = 1.92)"
        and "50:1" in notes[1]
    )
    assert notes[2].startswith(
        "fraclink's design: crossover 12 rad/s, margin 50°, δ 0 s; its Ms at 30 g is "
    )
    assert f"{found.target:.3f}" in notes[2] and len(notes) == 3
    _, twin, notes = prepare(
        RIG, None, 0.001, gain_crossover=12.0, phase_margin=fl.deg(50), filter_time=0.0
    )
    assert twin.beam.link_mass == 0.001 and len(notes) == 2
    heavy = replace(RIG, link=replace(RIG.link, mass=0.002))
    _, twin, _ = prepare(
        heavy, None, None, gain_crossover=12.0, phase_margin=fl.deg(50), filter_time=0.0
    )
    assert twin.beam.link_mass == 0.002
    with pytest.raises(FieldError, match="model"):
        prepare(
            replace(RIG, model=None),
            None,
            None,
            gain_crossover=12.0,
            phase_margin=0.8,
            filter_time=0.0,
        )
