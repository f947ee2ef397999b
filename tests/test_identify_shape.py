"""The coordinates of a fit, the log as the kernel sees it, and which structures contain
which.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fraclink._arm.experiment import Experiment
from fraclink._arm.link import LinkModel
from fraclink._identify import identify, identify_structure, simulated_torque
from fraclink._identify.fitting import (
    _activity,
    fitted_samples,
    make_search,
    motion_after,
)
from fraclink._identify.problem import inverted
from fraclink._identify.search import Search, Solution
from fraclink._identify.shape import (
    ALPHA_LIMITS,
    Window,
    chosen_hold,
    columns_of,
    damping_and_square,
    delayed,
    free_coordinates,
    largest_ratio,
    lowest_valleys,
    mask_of,
    model_of,
    moving_angle,
    shape_of,
    special_cases,
    undamped_as_damped,
)
from fraclink._identify.uncertainty import (
    uncertainty,
)
from fraclink.errors import LogError, NotConvergedError
from identify_cases import PERIOD, TRUTH, late_cut, made_log, smooth_pulse

LINKS = [
    LinkModel(1.0, 10.0),
    LinkModel(1.0, 10.0, order=1.7),
    LinkModel(1.0, 10.0, damping=1.3),
    LinkModel(1.0, 10.0, damping=1.3, damping_order=0.6),
    LinkModel(1.0, 10.0, damping=0.05, damping_order=1.6),
]


@pytest.mark.parametrize("link", LINKS)
def test_a_link_is_its_shape_and_back(link: LinkModel) -> None:
    shape = shape_of(link, 0.003)
    back = model_of(shape, 1.0, None)
    for name in ("natural_frequency", "order", "damping", "damping_order"):
        assert getattr(back, name) == pytest.approx(
            getattr(link, name), rel=1e-9, abs=1e-12
        )
    assert shape[4] == 0.003


@pytest.mark.parametrize("link", [link for link in LINKS if link.damping])
def test_resonance_and_ratio_are_those_of_the_denominator(link: LinkModel) -> None:
    """At s = jΩ the denominator s² + μ s^α + ω₀² is 2 j ζ Ω²: no real part, and a
    viscous link's width.
    """
    order, log_resonance, ratio, other, _ = shape_of(link)
    s = 1j * math.exp(log_resonance)
    denominator = s**order + link.damping * s**other + link.natural_frequency**2
    assert denominator == pytest.approx(2j * ratio * abs(s) ** 2, rel=1e-9)


def test_without_damping_the_resonance_is_the_poles_modulus() -> None:
    link = LINKS[1]
    assert shape_of(link)[1] == pytest.approx(math.log(10.0 ** (2 / 1.7)))
    pole = cmath.rect(10.0 ** (2 / 1.7), math.pi / 1.7)
    assert pole**1.7 + 100.0 == pytest.approx(0.0, abs=1e-9)


def test_a_square_below_what_a_double_resolves_is_zero() -> None:
    other = 0.4
    edge = np.array([2.0, math.log(10.0), largest_ratio(other), other, 0.0])
    assert damping_and_square(edge)[1] < 1e-12
    assert model_of(edge, 1.0, None).natural_frequency == 0.0
    inside = edge.copy()
    inside[2] *= 1 - 1e-6
    assert model_of(inside, 1.0, None).natural_frequency == pytest.approx(
        10.0 * 1e-3, rel=1e-3
    )
    assert model_of(np.array([2.0, 0.0, 0.0, 0.7, 0.0]), 2.0, 0.3) == LinkModel(
        2.0, 1.0, payload=0.3
    )


def test_the_undamped_link_of_fractional_order_is_one_with_fractional_damping() -> None:
    """s^λ/(s^λ + ω₀²) = s²/(s² + ω₀² s^(2−λ)), whatever s is."""
    shape = shape_of(LinkModel(1.0, 9.0, order=1.7), 0.01)
    other = model_of(undamped_as_damped(shape), 1.0, None)
    assert (other.order, other.natural_frequency) == (2.0, 0.0)
    assert other.damping == pytest.approx(81.0, rel=1e-9)
    assert other.damping_order == pytest.approx(0.3, abs=1e-12)
    assert undamped_as_damped(shape)[4] == 0.01
    # At λ = 2 there is no such link: α stays inside of its limits.
    assert undamped_as_damped(np.array([2.0, 1.0, 0.0, 1.0, 0.0]))[3] == ALPHA_LIMITS[0]


def test_the_largest_ratio() -> None:
    assert largest_ratio(0.5) == pytest.approx(0.5)
    assert [largest_ratio(x) for x in (1.0, 1.5)] == [0.9, 0.9]


def test_coordinates_and_their_bits() -> None:
    assert [
        free_coordinates(name) for name in ("UD-IOM", "D-IOM", "UD-FOM", "D-FOM")
    ] == [
        (1,),
        (1, 2),
        (0, 1),
        (1, 2, 3),
    ]
    assert [mask_of(free) for free in ((), (0,), (1, 3), (4, 0))] == [0, 1, 10, 17]


def test_columns_hold_the_output_and_its_derivatives() -> None:
    angle = smooth_pulse(PERIOD * np.arange(3000))
    window = Window(angle, np.zeros(3000), PERIOD, "first")
    shape = shape_of(LinkModel(1.0, 10.0, damping=1.3, damping_order=0.8), 0.01)
    kernel = window.kernel(8.0, longest_delay=0.02)
    columns = columns_of(kernel, shape, mask_of((1, 2, 3, 4)))
    for row, k in enumerate((1, 2, 3, 4)):
        step = 1e-5 * np.eye(5)[k]
        wanted = (
            columns_of(kernel, shape + step)[0] - columns_of(kernel, shape - step)[0]
        ) / 2e-5
        assert columns[1 + row] == pytest.approx(
            wanted, abs=1e-5 * np.abs(wanted).max()
        )
    with pytest.raises(NotConvergedError, match="the vibration pole") as caught:
        columns_of(kernel, np.array([2.0, 2.0, 1.2, 1.0, 0.0]))
    assert "0.9" in caught.value.remedy


# --- what the motor does between samples --------------------------------------------------------------------


def test_a_command_that_jumps_and_rests_is_held() -> None:
    time = np.arange(400)
    steps = np.where((time > 50) & (time < 200), 1.0, 0.0)
    assert chosen_hold(steps, "auto") == "zero"
    assert chosen_hold(steps, "first") == "first"
    assert chosen_hold(smooth_pulse(PERIOD * time), "zero") == "zero"
    assert chosen_hold(smooth_pulse(PERIOD * 10 * time), "auto") == "first"
    # An encoder that counts once in a while: forty small jumps, each of them calm on
    # both sides.
    assert chosen_hold(np.floor(time / 10.0), "auto") == "first"
    assert chosen_hold(np.floor(time / 40.0), "auto") == "zero"
    # Jumps are half of the path, and no more: the rest is a slow motion.
    assert chosen_hold(steps + 0.004 * time, "auto") == "first"
    assert chosen_hold(steps + 1e-5 * time, "auto") == "zero"
    assert chosen_hold(np.zeros(10), "auto") == "first"


def test_increments_are_jumps_or_slopes() -> None:
    angle = np.array([1.0, 1.0, 3.0, 2.5])
    held = Window(angle, np.zeros(4), 0.5, "zero")
    assert held.increments().tolist() == [0.0, 0.0, 2.0, -0.5]
    straight = Window(angle, np.zeros(4), 0.5, "first")
    assert straight.increments().tolist() == [0.0, 4.0, -1.0, 0.0]
    assert straight.samples == 4


def test_frequencies_that_a_log_can_show() -> None:
    low, high = Window(np.zeros(1001), np.zeros(1001), 0.01, "first").frequency_limits
    assert 2 * math.pi / low == pytest.approx(1001 * 0.01 / 1.5)
    assert 2 * math.pi / high == pytest.approx(6 * 0.01)


def test_an_encoders_steps_make_an_angle_rough() -> None:
    angle = smooth_pulse(PERIOD * np.arange(3000))
    assert not Window(angle, angle, PERIOD, "first").is_rough
    noisy = angle + 1e-3 * np.random.default_rng(0).normal(size=3000)
    assert Window(noisy, angle, PERIOD, "first").is_rough


# --- starts and limits --------------------------------------------------------------------------------------


def test_special_cases_of_the_structures() -> None:
    assert {
        name: special_cases(name) for name in ("UD-IOM", "D-IOM", "UD-FOM", "D-FOM")
    } == {
        "UD-IOM": [],
        "D-IOM": ["UD-IOM"],
        "UD-FOM": ["UD-IOM"],
        "D-FOM": ["UD-IOM", "D-IOM", "UD-FOM"],
    }


def test_thelowest_valleys() -> None:
    costs = np.array([1.0, 3.0, 2.0, 5.0, 5.0, 0.5, 4.0, 3.5])
    assert lowest_valleys(costs, 2).tolist() == [5, 0]
    assert lowest_valleys(costs, 9).tolist() == [5, 0, 2, 7]


def test_a_delay_as_a_part_of_the_period() -> None:
    rows = delayed(np.array([[2.0, math.log(4.0), 0.0, 1.0, 9.0]]), 0.25)
    assert rows.tolist() == [
        [2.0, math.log(4.0), 0.0, 1.0, pytest.approx(0.25 * 2 * math.pi / 4.0)]
    ]


def solution(shape: list[float], free: tuple[int, ...]) -> Solution:
    low, high = np.array([1.0, 0.0, 0.0, 0.1, 0.0]), np.array([2.0, 5.0, 0.9, 1.9, 0.1])
    return Solution(
        "D-FOM", free, np.array(shape), 1.0, 0.0, 1.0, np.eye(8), low, high, 0, 1
    )


def test_a_coordinate_on_its_limit_is_at_its_bound() -> None:
    assert solution([1.5, 2.0, 0.1, 1.0, 0.05], (0, 1, 2, 3, 4)).at_bound == ()
    assert solution([2.0, 2.0, 0.0, 1.0, 0.1], (0, 1, 2, 4)).at_bound == (0, 2, 4)
    assert solution([2.0, 2.0, 0.0, 1.0, 0.1], (1,)).at_bound == ()
    assert solution([2.0 - 0.9e-7, 2.0, 0.0, 1.0, 0.1], (0,)).at_bound == (0,)
    assert solution([2.0 - 1.1e-7, 2.0, 0.0, 1.0, 0.1], (0,)).at_bound == ()


def test_fractional_damping_may_end_without_a_natural_frequency() -> None:
    most = largest_ratio(0.5)
    assert solution([2.0, 2.0, most, 0.5, 0.0], (1, 2, 3)).on_edge
    assert solution([2.0, 2.0, (1 - 0.9e-7) * most, 0.5, 0.0], (1, 2, 3)).on_edge
    assert not solution([2.0, 2.0, (1 - 1.1e-7) * most, 0.5, 0.0], (1, 2, 3)).on_edge
    assert not solution([2.0, 2.0, 0.9, 1.0, 0.0], (1, 2, 3)).on_edge
    assert not solution([2.0, 2.0, most, 0.5, 0.0], (1, 2)).on_edge


def searched(log: Experiment, **options: object) -> Search:
    usual = {
        "heldout": 0.0,
        "stiffness": None,
        "fixed": None,
        "guess": None,
        "hold": "auto",
    }
    return make_search(log, **(usual | options))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def log() -> Experiment:
    return made_log(noise=0.05, samples=2501)


class Counted:
    """A kernel whose passes over the data are counted."""

    passes = 0

    def __init__(self, kernel: Any) -> None:
        self.kernel = kernel

    def costs(self, rows: Any, *options: Any) -> Any:
        Counted.passes += len(rows)
        return self.kernel.costs(rows, *options)

    def solve(self, *options: Any) -> Any:
        found = self.kernel.solve(*options)
        Counted.passes += found[5]
        return found


def test_evaluations_are_all_passes_of_the_search(
    log: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = Window.kernel
    monkeypatch.setattr(
        Window,
        "kernel",
        lambda self, *given, **named: Counted(made(self, *given, **named)),
    )
    monkeypatch.setattr(Counted, "passes", 0)
    search = searched(log)
    first = search.solve("UD-FOM").evaluations
    assert first == Counted.passes > 0
    # Of the others the work that they start from is a part: special cases, and a row of
    # undamped links.
    for name in ("UD-IOM", "D-FOM"):
        assert search.solve(name).evaluations == Counted.passes > first
    guess = replace(TRUTH, natural_frequency=9.0)
    monkeypatch.setattr(Counted, "passes", 0)
    assert searched(log, guess=guess).solve("UD-FOM").evaluations == Counted.passes


@pytest.mark.parametrize("name", ["UD-IOM", "D-IOM", "D-FOM"])
def test_a_link_of_order_two_keeps_it_wherever_its_fit_is_begun(
    log: Experiment, name: str
) -> None:
    search = searched(log)  # of a link of order 1.92, which is what a scan begins with
    found = search.solve(name)
    assert found.shape[0] == 2.0
    assert search._from_other_valleys(found).shape[0] == 2.0


def test_of_a_long_history_what_a_fit_can_afford_moves_the_link() -> None:
    angle = np.sin(0.011 * np.arange(370_000))

    def cut(at: int, until: int = -1) -> Experiment:
        return Experiment(
            PERIOD, angle[at:until], angle[at:until], earlier_angle=angle[:at]
        )

    assert np.array_equal(moving_angle(cut(5000, 6000)), angle[:6000])
    assert np.array_equal(moving_angle(cut(250_000, 251_000)), angle[50_000:251_000])
    assert np.array_equal(
        moving_angle(cut(290_000, 360_000)), angle[80_000:360_000]
    )  # three lengths are more
    assert (
        searched(cut(250_000, 251_000), heldout=0.4, hold="first").window.angle.size
        == 200_600
    )
    assert moving_angle(replace(cut(5000), earlier_angle=None)).size == 370_000 - 5001


@pytest.mark.parametrize("seed", [0, 2, 3, 4, 6])
def test_a_lightly_damped_link_still_swings_by_what_was_long_before_the_cut(
    seed: int,
) -> None:
    """The last 2 s of 32 s at ζ = 0.02: by 6 s before the cut alone the delay is up to
    9 ms off.
    """
    cut = late_cut(seed)
    fit = identify(cut)
    delay = fit.intervals["delay"]
    assert fit.passed and fit.structure == "D-IOM"
    assert delay.low < 0.0 < delay.high and delay.high - delay.low < 2e-3
    assert fit.model.natural_frequency == pytest.approx(10.0, rel=1e-3)


@pytest.mark.parametrize("hold", ["first", "zero"])
def test_a_ring_down_behind_a_cut_is_fitted_by_the_move_before_it(hold: Any) -> None:
    time = PERIOD * np.arange(2500)
    angle = (
        0.4 * np.clip((time - 0.1) / 0.2, 0, 1)
        if hold == "first"
        else 0.4 * (time > 0.2)
    )
    torque = simulated_torque(TRUTH, angle, PERIOD, hold=hold)
    torque += 0.01 * torque.std() * np.random.default_rng(0).standard_normal(time.size)
    cut = Experiment(PERIOD, angle[100:], torque[100:], earlier_angle=angle[:100])
    fit = identify(cut)
    # Between samples the input does what it did in the move: of an angle at rest
    # nothing is seen of that.
    assert fit.passed and fit.hold == hold
    assert fit.model.order == pytest.approx(TRUTH.order, abs=2e-3)
    assert abs(fit.delay) < 1e-3
    structured = identify_structure(cut, "k*s**a/(s**a + w)", details=False)
    assert structured.hold == hold
    assert structured.parameters["a"] == pytest.approx(TRUTH.order, abs=2e-3)
    with pytest.raises(LogError, match="motor_angle: constant over the fitted part"):
        identify(replace(cut, earlier_angle=np.full(100, 0.4)))


def test_limits_follow_the_scan(log: Experiment) -> None:
    search = searched(log)
    wave = 2 * math.pi / abs(TRUTH.pole)
    assert search.wave == pytest.approx(wave, rel=0.1)
    lower, upper = search.limits(may_lead=True)
    low, high = search.window.frequency_limits
    assert (lower[0], upper[0]) == (1.01, 2.0)
    assert (lower[1], upper[1]) == (
        pytest.approx(math.log(low) - 0.5),
        pytest.approx(math.log(high) + 0.3),
    )
    assert (lower[2], upper[2]) == (0.0, 0.9)
    assert lower[4] == pytest.approx(-0.12 * search.wave)
    assert upper[4] <= 0.35 * search.wave
    assert search.limits(may_lead=False)[0][4] == 0.0


def test_what_is_fixed_is_not_free(log: Experiment) -> None:
    assert searched(log).free("UD-FOM") == (0, 1, 4)
    assert searched(log, fixed={"delay": 0.01}).free("D-FOM") == (1, 2, 3)
    assert searched(log, fixed={"order": 1.9}).free("UD-FOM") == (1, 4)
    assert searched(log, fixed={"damping_order": 0.9}).free("D-FOM") == (1, 2, 4)
    assert math.isnan(searched(log).gain)
    assert searched(log, stiffness=1.5).gain == 1.5
    assert searched(log, stiffness=1.5, fixed={"gain": 1.4}).gain == 1.4
    deflection = replace(log, output_kind="deflection")
    assert math.isnan(searched(deflection, stiffness=1.5).gain)


def test_a_singular_matrix_is_told_and_still_inverted() -> None:
    normal = np.diag([4.0, 1e-8])
    inverse, singular = inverted(normal)
    assert np.diag(inverse) == pytest.approx([0.25, 1e8])  # small is not singular
    assert not singular
    twins = np.array([[1.0, 1.0 - 1e-11], [1.0 - 1e-11, 1.0]])
    assert inverted(twins)[1]
    assert np.isfinite(inverted(twins)[0]).all()
    assert not inverted(np.array([[1.0, 1.0 - 1e-9], [1.0 - 1e-9, 1.0]]))[1]
    assert np.isfinite(inverted(np.diag([1.0, 0.0]))[0]).all()


# --- which part is held out ---------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1200, 1237])
def test_activity_is_the_energy_that_is_still_to_come(count: int) -> None:
    signal = np.where(np.arange(count) < count / 4, 2.0, 0.0)
    found = _activity(signal)
    assert found.shape == (121,)
    assert (found[0], found[-1]) == (pytest.approx(1.0), 0.0)
    border = sum(block.size for block in np.array_split(signal, 120)[:15])
    assert found[15] == pytest.approx(1 - border / (count / 4), abs=0.005)
    assert found[32:] == pytest.approx(0.0)
    # The level of the quietest blocks is noise: a constant one has no quiet end, and is
    # shared evenly.
    assert _activity(np.ones(count)) == pytest.approx(np.linspace(1, 0, 121), abs=1e-12)


def moved(*moves: tuple[float, float], count: int = 3000) -> Experiment:
    """A motor that ramps by 1 rad within 0.2 s at these times [s], in these directions."""
    time = PERIOD * np.arange(count)
    angle = sum(sign * np.clip((time - at) / 0.2, 0, 1) for at, sign in moves)
    output = np.exp(-np.maximum(time - moves[0][0], 0.0)) * np.where(
        time > moves[0][0], np.sin(10 * time), 0
    )
    return Experiment(period=PERIOD, motor_angle=angle, output=output)


def test_the_last_two_fifths_are_held_out_where_there_is_motion() -> None:
    log = moved((1.0, 1), (3.0, -1), (9.0, 1))
    assert fitted_samples(log) == 1800
    motor, output = motion_after(log, 1800)
    assert motor == pytest.approx(1 / 3, abs=0.02)
    assert output == pytest.approx(0.0, abs=1e-3)
    assert motion_after(log, 0) == (pytest.approx(1.0), pytest.approx(1.0))


def test_the_border_moves_to_the_rest_before_the_last_moves() -> None:
    log = moved((1.0, 1), (3.0, -1), (5.0, 1))  # all of it before 7.2 s
    count = fitted_samples(log)
    assert 3.2 / PERIOD < count <= 5.0 / PERIOD
    assert motion_after(log, count)[0] == pytest.approx(1 / 3, abs=0.05)


def test_a_log_of_one_move_is_cut_in_its_ring_down() -> None:
    log = moved((1.0, 1))
    count = fitted_samples(log)
    assert 1.2 / PERIOD < count < 3.0 / PERIOD
    assert motion_after(log, count)[1] >= 0.2
    # Too short to be cut into blocks: the last two fifths, whatever moves.
    assert fitted_samples(moved((0.1, 1), count=239)) == 239 - round(0.4 * 239)


def test_too_short_and_still_logs_are_refused_with_what_is_wanted() -> None:
    log = made_log(samples=1000)
    short = Experiment(
        period=PERIOD, motor_angle=log.motor_angle[250:299], output=log.output[250:299]
    )
    with pytest.raises(LogError) as caught:
        searched(short)
    assert (caught.value.field, caught.value.value, caught.value.allowed) == (
        "output",
        49,
        ">= 50",
    )
    searched(
        Experiment(
            period=PERIOD,
            motor_angle=log.motor_angle[250:300],
            output=log.output[250:300],
        )
    )
    still = Experiment(
        period=PERIOD, motor_angle=np.full(100, 0.3), output=log.output[250:350]
    )
    with pytest.raises(LogError) as caught:
        searched(still)
    assert (caught.value.field, caught.value.value, caught.value.allowed) == (
        "motor_angle",
        0.3,
        "a motion",
    )


@pytest.mark.parametrize("part", [0.0, 0.24])
def test_the_scan_finds_the_resonance_and_about_the_delay(part: float) -> None:
    """Delays are parts of the vibration's period; without one a late log would have
    another phase.
    """
    wave = 2 * math.pi / abs(TRUTH.pole)
    search = searched(made_log(noise=0.02, samples=2501, delay=part * wave))
    order, log_resonance, ratio, other, late = search.seed
    assert log_resonance == pytest.approx(math.log(abs(TRUTH.pole)), abs=0.2)
    assert (ratio, other) == (0.0, 1.0)
    assert order in (1.85, 1.92)
    # One of those that are tried: the fit creeps the rest of the way by itself.
    assert round(late / search.wave, 9) in ((0.12, 0.24) if part else (0.0,))
    assert search.seed is search.seed  # found once
    assert search.lowest == pytest.approx(math.exp(log_resonance))
    assert search.longest_delay == pytest.approx(0.36 * search.wave)


def test_a_guess_beside_the_scan_and_in_its_place(log: Experiment) -> None:
    good = LinkModel(1.0, TRUTH.natural_frequency * 1.001, order=1.921)
    assert searched(log, guess=good).seed == pytest.approx(shape_of(good))
    poor = LinkModel(1.0, 40.0, order=1.5)
    assert searched(log, guess=poor).seed[1] == pytest.approx(
        math.log(abs(TRUTH.pole)), abs=0.15
    )
    # With the gain known there is no scan: a guess is taken at its word, three times
    # too high or not.
    alone = searched(log, guess=poor, fixed={"gain": 1.5, "delay": 0.002})
    assert alone.seed == pytest.approx(shape_of(poor, 0.002))
    assert alone.lowest == pytest.approx(math.exp(alone.seed[1]) / 3)
    assert alone.longest_delay == pytest.approx(3 * 0.36 * alone.wave)
    narrow = searched(log, guess=LinkModel(1.0, 9.0, order=1.0))
    assert narrow.start is not None and narrow.start[0] == 1.01


def test_a_known_delay_is_within_reach_of_the_kernel(log: Experiment) -> None:
    search = searched(log, fixed={"delay": 0.9})
    assert search.longest_delay == 0.9
    assert search.seed[4] == 0.9
    assert searched(log, fixed={"order": 1.7}).seed[0] == 1.7


def test_starts_of_the_structures_follow_from_those_found(log: Experiment) -> None:
    search = searched(log)
    fractional = search.solve("UD-FOM").shape
    (first,) = search._starts("UD-FOM")
    assert first == pytest.approx(
        [min(search.seed[0], 1.95), search.seed[1], 0.0, 1.0, search.seed[4]]
    )
    (viscous,) = search._starts("D-IOM")
    ratio = -math.cos(math.pi / fractional[0])
    assert viscous == pytest.approx([2.0, fractional[1], ratio, 1.0, fractional[4]])
    undamped = list(search._starts("UD-IOM"))
    assert len(undamped) == 3
    assert all((row[0], row[2], row[3]) == (2.0, 0.0, 1.0) for row in undamped)
    assert all(abs(row[1] - fractional[1]) <= 0.16 for row in undamped)
    damped = list(search._starts("D-FOM"))
    assert damped[0] == pytest.approx(search.solve("D-IOM").shape)
    assert damped[1] == pytest.approx(undamped_as_damped(fractional))
    assert [row[3] for row in damped[2:]] == [0.4, 1.5]
    assert damped[2][2] == pytest.approx(min(ratio, 0.9 * largest_ratio(0.4)))
    held = searched(log, fixed={"damping_order": 0.9})
    assert [row[3] for row in held._starts("D-FOM")] == [0.9]


def test_errors_under_white_noise_written_out(log: Experiment) -> None:
    """σ² (JᵀJ)⁻¹ of the written-out columns, for a viscous link with gain, offset and
    delay.
    """
    search = searched(log)
    solution = search.solve("D-IOM")
    found = uncertainty(search, solution, coloured=False)
    assert found.names == ("natural_frequency", "damping", "delay", "gain", "offset")
    model = model_of(solution.shape, 1.0, None)
    steps = {"natural_frequency": 1e-4, "damping": 1e-4, "delay": 1e-6}
    columns = []
    for name, step in steps.items():
        ends = []
        for sign in (1, -1):
            delay = solution.shape[4] + (sign * step if name == "delay" else 0.0)
            moved = (
                model
                if name == "delay"
                else replace(model, **{name: getattr(model, name) + sign * step})
            )
            ends.append(columns_of(search.kernel, shape_of(moved, delay))[0])
        columns.append(solution.gain * (ends[0] - ends[1]) / (2 * step))
    columns += [columns_of(search.kernel, solution.shape)[0], np.ones(log.output.size)]
    J = np.array(columns)
    variance = solution.cost / (log.output.size - 5)
    wanted = variance * np.linalg.inv(J @ J.T)
    assert found.white == pytest.approx(
        wanted, rel=2e-3, abs=1e-3 * np.sqrt(np.outer(*2 * [np.diag(wanted)])).min()
    )
    assert (found.lag, found.effective, found.singular, found.coloured) == (
        1,
        5.0,
        False,
        None,
    )
    # Of the resonance the error is relative: that of ln Ω, which viscous damping does
    # not move.
    assert found.resonance == pytest.approx(
        math.sqrt(wanted[0, 0]) / model.natural_frequency, rel=1e-2
    )
    coloured = uncertainty(search, solution, coloured=True)
    assert coloured.white == pytest.approx(found.white)
    assert coloured.coloured is not None
    assert np.diag(coloured.coloured) == pytest.approx(np.diag(wanted), rel=0.5)
    assert 3.0 < coloured.effective < 9.0
