"""The searches behind a design, on figures whose edge is known: bounds, offers, aims
over a box, trials.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import fraclink as fl
from fraclink._arm.box import ParameterBox
from fraclink._design import nearest, optimisation
from fraclink._design.bounds import edge, first_within, reach
from fraclink._design.equations import ClosedForm, Task, task_of
from fraclink._design.nearest import boundary, missed_bounds, offered, refuse
from fraclink._design.optimisation import OptimumSearch
from fraclink._design.over_box import OverBox, at_arm
from fraclink._law.design import Requirement, Specification
from fraclink.errors import FieldError, InfeasibleError

RIG = fl.Rig.named("paper-2023")
MODEL = RIG.model
assert MODEL is not None
SPEC = Specification(
    payloads=(0.020, 0.040), gain_crossover=12.0, phase_margin=fl.deg(50)
)


def task(**changes: object) -> Task:
    return task_of(MODEL, RIG, replace(SPEC, **changes))


# --- edges ----------------------------------------------------------------------------------------------


def test_an_edge_is_the_last_value_within_the_bound() -> None:
    asked: list[float] = []

    def figure(value: float) -> float:
        asked.append(value)
        return 8.0 / value

    found = edge(figure, 2.0, 100.0, 1.0)
    assert found == pytest.approx(4.0, rel=1e-9) and figure(found) <= 2.0
    assert len(asked) < 30
    # from the other side, where the figure rises
    assert edge(lambda x: x, 2.0, 0.1, 50.0) == pytest.approx(2.0, rel=1e-9)
    assert edge(lambda x: x, 2.0, 0.1, 2.0) == 2.0  # the bound itself is kept


def test_an_edge_may_be_where_there_is_no_controller_any_more() -> None:
    """The figure is within its bound as soon as there is one: the border of the
    infinite is the edge.
    """
    found = edge(lambda x: 1.0 if x > 3.0 else math.inf, 2.0, 10.0, 1.0)
    assert found == pytest.approx(3.0, rel=1e-8) and found > 3.0
    # or behind it, where the figure is finite and beyond the bound at first
    assert edge(
        lambda x: 8.0 / x if x > 3.0 else math.inf, 2.0, 10.0, 1.0
    ) == pytest.approx(4.0, rel=1e-9)


def test_the_first_within_is_looked_for_at_every_fourth_value_before_the_others() -> (
    None
):
    asked: list[float] = []

    def figure(value: float) -> float:
        asked.append(value)
        return 10.0 - value

    values = np.arange(1.0, 13.0)
    ends, least = first_within(figure, 3.0, 0.5, values)
    assert ends == (8.0, 4.0) and least == 2.0 and asked == [4.0, 8.0]
    # a dip between two of these is found in the second pass, with the value before it
    ends, least = first_within(lambda x: 1.0 if x == 6.0 else 9.0, 3.0, 0.5, values)
    assert ends == (6.0, 5.0) and least == 1.0
    ends, least = first_within(lambda x: 1.0 if x == 1.0 else 9.0, 3.0, 0.5, values)
    assert ends == (1.0, 0.5)
    assert first_within(lambda x: x, 0.9, 0.5, values) == (None, 1.0)
    assert first_within(lambda x: 3.0, 3.0, 0.5, values)[0] == (4.0, 0.5)


def test_a_boundary_is_halved_to_from_the_feasible_side() -> None:
    assert boundary(lambda x: x < 5.0, 1.0, 20.0) == pytest.approx(5.0, rel=1e-8)
    assert boundary(lambda x: x < 5.0, 1.0, 20.0) < 5.0
    assert boundary(
        lambda x: x >= 0.0, 1.0, -1.0, log=False, halvings=40
    ) == pytest.approx(0.0, abs=1e-11)
    assert (
        boundary(lambda x: x < 5.0, 1.0, 16.0, halvings=1) == 4.0
    )  # the geometric middle
    assert boundary(lambda x: x < 5.0, 1.0, 7.0, halvings=1, log=False) == 4.0


# --- the filter and the margin that a bound needs -------------------------------------------------------


def solution(**changes: float) -> ClosedForm:
    plain = {"order": 0.5, "gain": 1.0, "upper": 20.0, "chi": 1.0, "filter_time": 0.0}
    return ClosedForm(**(plain | {"slope_low": -1.0, "slope_high": -1.0} | changes))


@pytest.mark.parametrize(
    ("changes", "link_order", "condition"),
    [
        ({}, 1.92, None),
        ({"order": 0.0}, 1.92, "β > 0"),
        ({"order": 1.92}, 1.92, "β < λ"),
        ({"order": 1.91}, 1.92, None),
        ({"order": 2.0}, 2.0, "β < 2"),
        (
            {"slope_low": 0.0},
            1.92,
            "gain crossover right of the peak at the heaviest payload",
        ),
        (
            {"slope_high": 0.0},
            1.92,
            "gain crossover right of the peak at the lightest payload",
        ),
    ],
)
def test_conditions_of_theorem_1_by_name(
    changes: dict[str, float], link_order: float, condition: str | None
) -> None:
    assert solution(**changes).violated(link_order) == condition


def test_a_margin_that_ms_asks_for_is_the_least_that_it_allows() -> None:
    """|1 + L| >= 1/Ms on the unit circle: 2 sin(φ/2) = 1/Ms."""
    found = task(phase_margin=None, max_sensitivity=1.7)
    assert 2.0 * math.sin(0.5 * found.phase_margin) == pytest.approx(1 / 1.7)
    slow = task(gain_crossover=None, settling_time=0.5)
    assert slow.gain_crossover == pytest.approx(4 * math.pi)


def test_bandwidth_is_refused_at_the_limit_itself() -> None:
    assert task(gain_crossover=79.9).gain_crossover == 79.9
    with pytest.raises(FieldError, match="above the motor loop's bandwidth"):
        task(gain_crossover=80.0)
    with pytest.raises(FieldError, match="above the Nyquist frequency"):
        task(gain_crossover=math.pi / 0.004)
    assert task(gain_crossover=2000.0, margins="ideal").gain_crossover == 2000.0


def test_payloads_and_frequencies_are_the_same_range() -> None:
    by_mass = task(payloads=(0.010, 0.040))
    assert (by_mass.low, by_mass.high) == pytest.approx(
        tuple(RIG.natural_frequency(m) for m in (0.040, 0.010))
    )
    by_frequency = task(payloads=None, natural_frequencies=(by_mass.low, by_mass.high))
    assert by_frequency.payloads == pytest.approx((0.010, 0.040))
    assert task(payloads=None).payloads == (0.020, 0.040)


class Ladder:
    """A controller for every task; its figures fall with filter and margin by rules of
    their own.
    """

    def __init__(
        self, noise: Callable[[float], float], margin_limit: float = math.pi
    ) -> None:
        self.noise, self.margin_limit = noise, margin_limit

    def attempt(self, task: Task) -> tuple[ClosedForm, int] | None:
        order = task.filter_order or 1
        return None if task.phase_margin > self.margin_limit else (solution(), order)


def test_a_noise_bound_lengthens_the_filter_to_its_edge(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With a noise gain of (5 + n) ms/δ the bound 1 asks for 6 ms of one pole, 7 ms of
    two: one lags less.
    """
    monkeypatch.setattr(
        "fraclink._design.bounds._noise",
        lambda task, controller: (
            1e-3 * (5 + controller.filter_order) / (task.filter_time or 1e-4)
        ),
    )
    ladder = Ladder(lambda time: time)
    spec = replace(SPEC, noise_gain=1.0)
    found = reach(task(noise_gain=1.0), spec, ladder.attempt)
    assert (found.filter_order, found.filter_time) == (1, pytest.approx(6e-3, rel=1e-6))
    assert found.filter_time >= 6e-3 * (1 - 1e-12)
    given = replace(spec, filter_order=2)
    assert reach(
        task(noise_gain=1.0, filter_order=2), given, ladder.attempt
    ).filter_time == pytest.approx(7e-3, rel=1e-6)
    fixed = replace(spec, filter_time=1e-3)
    assert (
        reach(task(noise_gain=1.0, filter_time=1e-3), fixed, ladder.attempt).filter_time
        == 1e-3
    )


def test_a_bound_that_no_filter_reaches_names_the_least(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("fraclink._design.bounds._noise", lambda task, controller: 2.5)
    with pytest.raises(
        InfeasibleError, match="no filter keeps the noise gain within 1 "
    ) as caught:
        reach(
            task(noise_gain=1.0),
            replace(SPEC, noise_gain=1.0),
            Ladder(lambda x: x).attempt,
        )
    assert caught.value.nearest == {"noise_gain": 2.5}
    assert caught.value.condition == "noise gain"
    # Without any controller at all it is not the noise that is in the way.
    hopeless = Ladder(lambda x: x, margin_limit=0.0)
    asked = task(noise_gain=1.0)
    assert reach(asked, replace(SPEC, noise_gain=1.0), hopeless.attempt) == asked


def test_a_bound_on_ms_raises_the_margin_to_its_edge(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(
        "fraclink._design.bounds._peak",
        lambda task, controller: 1.4 / task.phase_margin,
    )
    spec = replace(SPEC, phase_margin=None, max_sensitivity=1.2)
    free = task(phase_margin=None, max_sensitivity=1.2)
    found = reach(free, spec, Ladder(lambda x: x).attempt)
    assert (
        found.phase_margin == pytest.approx(1.4 / 1.2, rel=1e-6)
        and 1.4 / found.phase_margin <= 1.2
    )
    with pytest.raises(
        InfeasibleError, match=r"no phase margin at 12 rad/s brings Ms to 1\.2"
    ) as caught:
        reach(free, spec, Ladder(lambda x: x, margin_limit=1.0).attempt)
    assert caught.value.nearest["max_sensitivity"] == pytest.approx(1.4 / 1.0, rel=0.06)
    kept = task(max_sensitivity=1.2)  # beside a given margin Ms is only reported
    assert (
        reach(kept, replace(spec, phase_margin=fl.deg(50)), Ladder(lambda x: x).attempt)
        == kept
    )


# --- what a refusal offers ------------------------------------------------------------------------------


def refused(
    feasible: Callable[[float, float], bool], **changes: object
) -> InfeasibleError:
    """The refusal of a request where (crossover, margin) has a controller if `feasible`
    says so.
    """

    def tried(at: Task) -> tuple[ClosedForm, int] | None:
        return (solution(), 1) if feasible(at.gain_crossover, at.phase_margin) else None

    with pytest.raises(InfeasibleError) as caught:
        refuse(task(**changes), tried, (), fastest=80.0)
    return caught.value


def test_the_nearer_of_two_offers_is_made_and_both_are_told() -> None:
    error = refused(lambda w, phi: phi < 0.8 or w < 6.0)
    assert error.condition == "phase margin unreachable"
    assert "below the Nyquist frequency solves equation (55)" in str(error)
    assert "at 12 rad/s the largest phase margin is 45.8" in str(error)
    assert "with 50° the highest gain crossover is 5.99" in str(error)
    assert error.nearest == {
        "gain_crossover": 12.0,
        "phase_margin": pytest.approx(0.8, rel=2e-4),
    }
    assert error.nearest["phase_margin"] < 0.8  # rounded off the edge, to five digits
    other = refused(lambda w, phi: phi < 0.2 or w > 13.0)
    assert "the lowest gain crossover is 13.0" in str(other)
    assert other.nearest == {
        "phase_margin": fl.deg(50),
        "gain_crossover": pytest.approx(13.0, rel=2e-4),
    }
    assert other.nearest["gain_crossover"] > 13.0


def test_where_neither_alone_helps_both_are_lowered() -> None:
    error = refused(lambda w, phi: phi < 0.5 and 14.0 < w < 16.0)
    assert error.nearest["phase_margin"] == pytest.approx(fl.deg(25))
    assert 14.0 < error.nearest["gain_crossover"] < 14.1
    assert "with 25° and 14.0" in str(error) and "there is a controller" in str(error)
    none = refused(lambda w, phi: False)
    assert none.nearest == {}
    assert "no smaller margin at another crossover has a controller either" in str(none)


@pytest.mark.parametrize(
    ("found", "condition", "words"),
    [
        (
            (solution(order=2.2),),
            "phase margin unreachable (β < λ)",
            "asks for β = 2.2",
        ),
        (
            (solution(order=-0.1), solution(order=0.4)),
            "phase margin at the other gain crossing",
            "β = 0.4 ",
        ),
        (
            (solution(slope_low=0.3),),
            "right of the peak at the heaviest",
            "12 rad/s lies left of the peak",
        ),
    ],
)
def test_a_refusal_names_what_is_hit(
    found: tuple[ClosedForm, ...], condition: str, words: str
) -> None:
    with pytest.raises(InfeasibleError) as caught:
        refuse(task(), lambda at: None, found, 80.0, nearest=False)
    assert condition in caught.value.condition and words in str(caught.value)
    assert caught.value.nearest == {}


def test_offers_are_rounded_off_the_edge() -> None:
    assert nearest._shortened(12.345678, away=True) == pytest.approx(12.346)
    assert nearest._shortened(12.345678, away=False) == pytest.approx(12.345)
    assert nearest._shortened(0.00123456, away=True) == pytest.approx(0.0012346)


def test_missed_bounds_are_those_of_the_request() -> None:
    rows = (
        Requirement.at_least("gain crossover", 12.0, 11.0, "rad/s", 0.02),
        Requirement.at_most("noise gain", 1.0, 1.5, "", 0.02),
        Requirement.at_most("loop gain at mode 2", 0.5, 0.6, "", 0.02),
        Requirement.at_most("loop gain at mode 3", 0.5, 0.9, "", 0.02),
        Requirement.at_most("settling time", 0.5, 0.4, "s", 0.02),
        Requirement.at_most("sensitivity peak", 1.5, 1.6, "", 0.02),
    )
    assert missed_bounds(rows) == {
        "noise_gain": 1.5,
        "mode_gain": 0.9,
        "max_sensitivity": 1.6,
    }


def test_an_offer_is_tried_as_a_whole_and_loosened_until_it_works() -> None:
    spec = replace(SPEC, noise_gain=1.0)

    def misses(trial: Specification) -> dict[str, float] | None:
        """The margin costs noise: 2 times itself."""
        assert trial.phase_margin is not None and trial.noise_gain is not None
        needed = 2.0 * trial.phase_margin
        return None if trial.noise_gain >= needed else {"noise_gain": needed}

    found = offered({"phase_margin": 0.8, "gain_crossover": 12.0}, spec, misses)
    assert found == {"phase_margin": 0.8, "gain_crossover": 12.0, "noise_gain": 1.6}
    # A miss that no bound explains: what differs from the request is moved on, what
    # does not stays.
    stubborn = offered(
        {"phase_margin": 0.8, "gain_crossover": 12.0},
        spec,
        lambda trial: None if trial.phase_margin < 0.78 else {},
    )
    assert stubborn["gain_crossover"] == 12.0
    assert 0.779 < stubborn["phase_margin"] < 0.78
    assert offered({"phase_margin": 0.8}, spec, lambda trial: {}) == {}
    assert offered({}, spec, lambda trial: None) == {}


def test_an_offer_is_in_the_words_of_the_request() -> None:
    timed = Specification(settling_time=0.5, phase_margin=fl.deg(50))
    slower = offered(
        {"gain_crossover": 10.0, "phase_margin": fl.deg(50)}, timed, lambda trial: None
    )
    assert (
        slower["settling_time"] == pytest.approx(0.62832)
        and "gain_crossover" not in slower
    )
    kept = offered(
        {"gain_crossover": 4 * math.pi, "phase_margin": 0.6}, timed, lambda trial: None
    )
    assert kept == {"settling_time": 0.5, "phase_margin": 0.6}
    peaked = Specification(gain_crossover=12.0, max_sensitivity=1.5)
    by_peak = offered({"phase_margin": 0.5}, peaked, lambda trial: None)
    assert by_peak == {"max_sensitivity": pytest.approx(0.5 / math.sin(0.25))}
    assert offered({"phase_margin": 1.0}, peaked, lambda trial: None) == {
        "max_sensitivity": 1.5
    }


# --- aims over a box ------------------------------------------------------------------------------------


def rows(
    crossover: float, margin: float, noise: float, mode: float
) -> list[Requirement]:
    return [
        Requirement.at_least("gain crossover", 12.0, crossover, "rad/s", 0.04),
        Requirement.at_least("phase margin", fl.deg(50), margin, "rad", 0.02),
        Requirement.at_most("noise gain", 1.0, noise, "", 0.02),
        Requirement.at_most("loop gain at mode 2", 0.5, mode, "", 0.02),
    ]


def over(**changes: object) -> OverBox:
    spec = replace(SPEC, noise_gain=1.0, mode_gain=0.5, **changes)
    return OverBox(
        spec, ParameterBox.at(MODEL), task(), lambda aim: None, lambda *given: ()
    )


def test_the_aim_is_moved_by_what_the_worst_corner_is_short_of() -> None:
    search, middle = over(), 0.5 * math.radians(0.2)
    aim = search._corrected(search.spec, task(), rows(11.0, fl.deg(45), 1.25, 0.8))
    assert aim.gain_crossover == pytest.approx(12.0 * 1.0005 * 12.0 / 11.0)
    assert aim.phase_margin == pytest.approx(fl.deg(55) + middle)
    assert aim.noise_gain == pytest.approx(0.998 / 1.25)
    assert aim.mode_gain == pytest.approx(0.998 * 0.5 * 0.5 / 0.8)
    assert aim.max_sensitivity is None
    # What is kept with room to spare is not aimed at any more, nor below what was
    # asked.
    spare = search._corrected(search.spec, task(), rows(14.0, fl.deg(58), 0.5, 0.2))
    assert (spare.gain_crossover, spare.noise_gain, spare.mode_gain) == (12.0, 1.0, 0.5)
    assert spare.phase_margin == fl.deg(50)
    high = search._corrected(
        search.spec, task(phase_margin=fl.deg(60)), rows(14.0, fl.deg(54), 0.5, 0.2)
    )
    assert high.phase_margin == pytest.approx(fl.deg(56) + middle)
    none = search._corrected(search.spec, task(), rows(0.0, -0.1, 1.0, 0.5))
    assert none.gain_crossover == pytest.approx(12.0 * 1.0005 * 1.1)
    far = search._corrected(search.spec, task(), rows(1.0, fl.deg(50), 1.0, 0.5))
    assert far.gain_crossover == pytest.approx(18.0)


def test_what_was_given_is_only_reported() -> None:
    worst: Any = [(item, None) for item in rows(11.0, 0.8, 1.25, 0.8)]
    worst += [(Requirement.at_most("sensitivity peak", 1.5, 1.6, "", 0.02), None)]
    assert [item.name for item in over()._missed(worst)] == [
        "gain crossover",
        "phase margin",
        "noise gain",
        "loop gain at mode 2",
    ]
    assert [item.name for item in over(filter_time=0.01)._missed(worst)] == [
        "gain crossover",
        "phase margin",
    ]
    bound_by_peak = over(phase_margin=None, max_sensitivity=1.5)
    assert "sensitivity peak" in [item.name for item in bound_by_peak._missed(worst)]


def test_a_bound_on_ms_counts_as_the_margin_that_it_allows() -> None:
    search = over(phase_margin=None, max_sensitivity=1.5)
    item = Requirement.at_most("sensitivity peak", 1.5, 2.0, "", 0.02)
    (margin,) = search._margins([item])
    assert margin.slack == pytest.approx(2 * math.asin(0.25) - 2 * math.asin(1 / 3))
    assert (
        not margin.passed and search._margins([replace(item, achieved=1.4)])[0].passed
    )
    assert over()._margins([item]) == []
    eased = search._eased(0.5)
    assert eased.spec.max_sensitivity == 2.0
    assert eased.asked.phase_margin == pytest.approx(2 * math.asin(0.25))
    less = over()._eased(0.8)
    assert (
        less.spec.phase_margin == less.asked.phase_margin == pytest.approx(fl.deg(40))
    )


def test_rounds_halve_an_aim_that_has_no_controller_and_keep_the_last_that_passed() -> (
    None
):
    """One corner, whose margin is 5° below the model's; above 56° at the model there is
    no controller.
    """
    aims: list[float] = []

    def solve(aim: Specification) -> tuple[Task, Any] | None:
        assert aim.phase_margin is not None
        aims.append(math.degrees(aim.phase_margin))
        return (
            (task(phase_margin=aim.phase_margin), None)
            if aim.phase_margin < fl.deg(56)
            else None
        )

    def measure(
        at: Task, controller: Any, spec: Specification
    ) -> tuple[Requirement, ...]:
        return tuple(rows(12.5, fl.deg(aims[-1] - 5.0), 0.5, 0.2))[:2]

    search = OverBox(SPEC, ParameterBox.at(MODEL), task(), solve, measure)
    aim, kept = search.aimed()
    assert (
        math.degrees(aim.phase_margin or 0.0) == pytest.approx(55.1) and kept[1].passed
    )
    assert aims == pytest.approx([50.0, 55.1])

    def short(
        at: Task, controller: Any, spec: Specification
    ) -> tuple[Requirement, ...]:
        wanted = spec.phase_margin or 0.0
        return (
            Requirement.at_least(
                "phase margin", wanted, fl.deg(aims[-1] - 5), "rad", 0.02
            ),
        )

    more, asked = replace(SPEC, phase_margin=fl.deg(52)), task(phase_margin=fl.deg(52))
    with pytest.raises(
        InfeasibleError, match="largest phase margin that every arm keeps is 50"
    ) as caught:
        OverBox(more, ParameterBox.at(MODEL), asked, solve, short).aimed()
    assert caught.value.nearest["phase_margin"] == pytest.approx(
        fl.deg(50.9), abs=fl.deg(0.4)
    )
    assert caught.value.nearest["gain_crossover"] == 12.0


def test_a_box_widens_the_range_of_frequencies_by_its_own() -> None:
    box = replace(
        ParameterBox.at(MODEL), natural_frequency=(0.9 * 11.094, 1.2 * 11.094)
    )
    known = replace(MODEL, natural_frequency=11.094)
    at = replace(task(), model=known)
    arm = SimpleNamespace(model=known, motor_ratio=1.1)
    wide = at_arm(at, box, arm)  # type: ignore[arg-type]
    assert (wide.low, wide.high) == pytest.approx((0.9 * at.low, 1.2 * at.high))
    assert wide.motor_ratio == 1.1


# --- trials of an optimisation --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def made() -> fl.Design:
    return fl.design(
        MODEL,
        RIG,
        payloads=(0.02, 0.04),
        gain_crossover=12.0,
        phase_margin=0.8,
        law=False,
    )


def test_an_objective_is_none_of_what_breaks_a_bound(made: fl.Design) -> None:
    own = made.full_loop.achieved(
        np.geomspace(*made.natural_frequencies, 9), RIG.period
    )
    peak, noise = float(np.max(own.sensitivity_peak)), float(np.max(own.noise_gain))

    def value(
        goal: Any,
        asked: tuple[float | None, ...],
        controller: fl.Controller | None = None,
    ) -> float:
        return OptimumSearch.of(made, goal, asked).objective(
            controller or made.controller
        )

    assert value("noise", (None, None, None, None)) == pytest.approx(noise)
    assert value("crossover", (None, None, None, None)) == pytest.approx(12.0)
    assert math.isnan(value("noise", (0.99 * peak, None, None, None)))
    assert math.isnan(value("noise", (None, 12.01, None, None)))
    assert math.isnan(value("crossover", (None, None, 0.99 * noise, None)))
    # the figure that is the goal has no bound
    assert value("noise", (None, None, 0.5 * noise, None)) == pytest.approx(noise)
    assert value("crossover", (None, 20.0, None, None)) == pytest.approx(12.0)
    louder = replace(made.controller, gain=20.0 * made.controller.gain)
    assert math.isnan(value("crossover", (100.0, None, 1e5, None), louder))  # unstable


def test_a_second_try_asks_for_as_much_less_as_the_first_was_too_much(
    made: fl.Design,
) -> None:
    own = made.full_loop.achieved(
        np.geomspace(*made.natural_frequencies, 9), RIG.period
    )
    peak, noise = float(np.max(own.sensitivity_peak)), float(np.max(own.noise_gain))
    over_by = 1.01
    search = OptimumSearch.of(
        made, "noise", (peak / over_by, 12.0 * over_by, None, None)
    )
    again = search._tightened(search.bounds, made.controller)
    assert again.max_sensitivity == pytest.approx(peak / over_by**2, rel=2e-6)
    assert again.gain_crossover == pytest.approx(12.0 * over_by**2, rel=2e-6)
    fast = OptimumSearch.of(
        made, "crossover", (peak * 1.1, None, noise / over_by, None)
    )
    again = fast._tightened(fast.bounds, made.controller)
    assert again.max_sensitivity == pytest.approx(peak * 1.1)  # kept: not drawn in
    assert again.noise_gain == pytest.approx(noise / over_by**2, rel=2e-6)
    far = OptimumSearch.of(made, "noise", (0.5 * (peak + 1.0), None, None, None))
    drawn = far._tightened(far.bounds, made.controller).max_sensitivity
    assert drawn == pytest.approx(
        0.5 * (peak + 1.0) / 1.02, rel=2e-6
    )  # 2 % a round at most


def test_steeper_starts_keep_the_gain_at_the_crossover(made: fl.Design) -> None:
    own = made.controller
    steep = optimisation._steeper(own, (0.4, 0.2), 12.0)
    assert (steep.order, steep.filter_time, steep.filter_order) == (
        pytest.approx(own.order + 0.4),
        pytest.approx(0.2 / 12.0),
        2,
    )
    assert abs(steep.response(12.0)) == pytest.approx(
        abs(own.response(12.0)), rel=1e-12
    )
    assert (
        optimisation._steeper(replace(own, order=1.8), (0.8, 0.4), 12.0).order == 1.95
    )


def test_an_offer_that_is_loosened_is_rounded_away_from_what_was_asked() -> None:
    spec = replace(SPEC, noise_gain=1.0)
    down = nearest._loosened("phase_margin", 0.8123456, 0.01, spec)
    assert down == pytest.approx(0.80422) and down <= 0.8123456 * 0.99
    up = nearest._loosened("noise_gain", 1.2345678, 0.1, spec)
    assert up == pytest.approx(1.3581) and up >= 1.2345678 * 1.1
    higher = nearest._loosened(
        "gain_crossover", 13.123456, 0.0, spec
    )  # more than was asked: on upwards
    assert higher == pytest.approx(13.124)
    assert (
        nearest._loosened("gain_crossover", 12.0, 0.25, spec) == 12.0
    )  # as it was asked
    assert nearest._loosened("max_sensitivity", 1.51, 0.0, spec) == pytest.approx(1.51)


@pytest.mark.slow
def test_a_refusal_with_an_offer_does_not_say_that_there_is_none() -> None:
    asked = {"payloads": (0.02, 0.04), "law": False}
    with pytest.raises(InfeasibleError) as caught:
        fl.design(MODEL, RIG, gain_crossover=12.0, phase_margin=fl.deg(110), **asked)
    assert caught.value.nearest and "but no request near" not in str(caught.value)
    assert caught.value.condition == "phase margin at the other gain crossing"
    with pytest.raises(InfeasibleError) as caught:
        fl.design(
            MODEL,
            RIG,
            gain_crossover=12.0,
            phase_margin=fl.deg(110),
            nearest=False,
            **asked,
        )
    assert caught.value.nearest == {} and "; but" not in str(caught.value)
    # A payload in grams is named beside the condition that it broke.
    with pytest.raises(
        InfeasibleError, match="a payload of 20 kg is 500 times the heaviest"
    ):
        fl.design(
            MODEL,
            RIG,
            payloads=(20.0, 40.0),
            gain_crossover=12.0,
            phase_margin=2.0,
            nearest=False,
            law=False,
        )
