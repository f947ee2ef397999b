"""The optimised design: gradients, bounds on a fine grid, another optimiser, what is
carried.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize

import fraclink as fl
from fraclink._arm.box import ParameterBox
from fraclink._arm.rig import Rig
from fraclink._certify import certify
from fraclink._cli import main
from fraclink._design import Design, Optimised, optimise
from fraclink._design.assess import phase_budget
from fraclink._design.optimisation import Step
from fraclink._design.problem import Bounds, Problem
from fraclink.errors import FieldError, InfeasibleError

RIG = Rig.named("paper-2023")
WANTED = {
    "payloads": (0.020, 0.040),
    "gain_crossover": 12.0,
    "phase_margin": fl.deg(50),
}


@pytest.fixture(scope="module")
def design() -> Design:
    return fl.design(RIG.model, RIG, **WANTED, law=False)


@pytest.fixture(scope="module")
def quiet(design: Design) -> Optimised:
    return optimise(design)


@pytest.mark.parametrize("goal", ["noise", "crossover"])
def test_gradients_are_those_of_differences(design: Design, goal: str) -> None:
    bare = replace(design.loop, gain=1.0, order=0.0, filter_time=0.0)
    bounds = Bounds(1.6, 12.0, 1.4)
    problem = Problem(bare, design.natural_frequencies, RIG.period, 2, goal, bounds)  # type: ignore[arg-type]
    x = problem.start(design.controller)
    _, gradient = problem.constraints(x)
    for i, unit in enumerate(np.eye(x.size)):
        up, down = (problem.constraints(x + 1e-6 * sign * unit)[0] for sign in (1, -1))
        np.testing.assert_allclose(gradient[:, i], (up - down) / 2e-6, atol=1e-7)


@pytest.mark.slow
def test_the_bounds_are_kept_on_a_finer_grid_than_they_were_found_on(
    design: Design, quiet: Optimised
) -> None:
    found = quiet.design
    assert quiet.pays and found.passed
    w = np.geomspace(0.3, math.pi / RIG.period, 20_000)
    low, high = found.natural_frequencies
    start = design.loop.achieved(np.array([low, high]), RIG.period)
    peak = max(
        float(np.max(1 / np.abs(1 + found.loop(w, pi))))
        for pi in np.geomspace(low, high, 21)
    )
    assert peak <= float(np.max(start.sensitivity_peak)) * (1 + 1e-5)
    assert max(c.frequency for c in found.at(0.040).gain_crossings) >= 12.0 - 1e-6
    loud = float(np.max(found.loop.noise_gain(np.geomspace(low, high, 21), RIG.period)))
    assert loud == pytest.approx(quiet.steps[-1].value, rel=1e-6)
    assert quiet.gain == pytest.approx(
        1 - loud / float(np.max(start.noise_gain)), rel=1e-6
    )
    assert quiet.gain > 0.65


@pytest.mark.slow
def test_another_optimiser_without_gradients_finds_no_better(
    design: Design, quiet: Optimised
) -> None:
    """Nelder and Mead on the same figures with penalties, from the closed form."""
    pi = np.geomspace(*design.natural_frequencies, 5)
    bound = float(np.max(design.loop.achieved(pi, RIG.period).sensitivity_peak))

    def cost(x: np.ndarray) -> float:
        if not 0.05 < x[1] < 1.9:
            return 1e3
        loop = replace(
            design.loop,
            gain=math.exp(x[0]),
            order=x[1],
            filter_time=math.exp(x[2]),
            filter_order=2,
        )
        got = loop.achieved(pi, RIG.period)
        if np.any(got.phase_margin <= 0) or not np.all(got.gain_crossover > 0):
            return 1e2
        over = max(0.0, math.log(np.max(got.sensitivity_peak) / bound))
        slow = max(0.0, math.log(12.0 / np.min(got.gain_crossover)))
        return math.log(float(np.max(got.noise_gain))) + 30 * (over + slow)

    c = design.controller
    start = [math.log(0.01), 1.4, math.log(0.035)]
    other = minimize(
        cost,
        start,
        method="Nelder-Mead",
        options={"maxfev": 500, "xatol": 1e-4, "fatol": 1e-6},
    )
    assert c.filter_order == 1
    ours = next(
        step.value for step in quiet.steps if step.structure == "k_d, β, δ, n = 2"
    )
    assert ours <= math.exp(other.fun) * 1.02


@pytest.mark.slow
def test_the_fastest_loop_keeps_its_noise(design: Design) -> None:
    found = optimise(design, goal="crossover")
    assert found.pays and found.design.passed
    noise = next(r for r in found.design.requirements if r.name == "noise gain")
    assert noise.achieved <= noise.wanted * (1 + 1e-9)
    assert found.design.requirements[0].achieved == pytest.approx(12.977, abs=0.01)


@pytest.mark.slow
def test_a_long_filter_is_found_from_a_short_one() -> None:
    """The steps from the closed form alone go astray on the link that the bundled log
    gives.
    """
    link = replace(
        RIG.model, order=1.91974, natural_frequency=10.7828, stiffness=1.59576
    )
    found = optimise(fl.design(link, RIG, **WANTED, law=False))
    assert found.steps[2].structure.endswith("n = 2")
    assert found.steps[2].taken
    assert found.steps[2].value < 0.6 * found.steps[1].value


@pytest.mark.slow
def test_what_does_not_pay_leaves_the_closed_form(design: Design) -> None:
    found = optimise(design, goal="crossover", least=0.5)
    assert not found.pays and found.design is design and found.gain == 0.0
    assert "closed-form design is returned" in str(found)


@pytest.mark.slow
def test_a_bound_on_the_mode_is_kept() -> None:
    rig = replace(RIG, link=replace(RIG.link, mass=0.0141))
    start = fl.design(rig.model, rig, **WANTED, mode_gain=100.0, law=False)
    found = optimise(start, mode_gain=0.9)
    second = next(
        r for r in found.design.requirements if r.name == "loop gain at mode 2"
    )
    assert found.design.passed and second.achieved <= 0.9 * (1 + 1e-9)
    assert math.isnan(found.steps[0].value) and math.isnan(
        found.gain
    )  # the closed form reaches the mode


@pytest.mark.slow
def test_the_law_the_certificate_and_the_file_carry_the_design(
    quiet: Optimised, tmp_path: Path
) -> None:
    design = quiet.design
    assert math.pi + sum(
        share.phase for share in phase_budget(design, 0.020)
    ) == pytest.approx(design.at(0.020).phase_margin)
    law = design.law()
    assert law.correction_error[0] < 0.1 and law.correction_error[1] < 0.5
    shipped = design.with_law()
    assert shipped.passed
    assert certify(
        design, law=law, modulus_margin=0.5, box=ParameterBox.at(design.model)
    ).passed
    design.save(tmp_path / "design.json")
    assert Design.load(tmp_path / "design.json") == design


def test_a_saved_design_with_a_lead_is_refused() -> None:
    """Release 0.1 could add a fractional lead; without it the file would be another
    controller.
    """
    with pytest.raises(FieldError, match="lead"):
        Design.load(Path(__file__).parent / "golden" / "formats" / "design-lead.json")


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"goal": "speed"}, "goal"),
        ({"max_sensitivity": 1.0}, "max_sensitivity"),
        ({"gain_crossover": -1.0}, "gain_crossover"),
        ({"noise_gain": "1"}, "noise_gain"),
        ({"mode_gain": 0.5}, "mode_gain"),
        ({"least": 2.0}, "least"),
    ],
)
def test_bad_requests_are_refused(
    design: Design, options: dict[str, object], field: str
) -> None:
    with pytest.raises(FieldError) as caught:
        optimise(design, **options)  # type: ignore[arg-type]
    assert caught.value.field == field


def test_the_papers_reading_is_refused() -> None:
    ideal = fl.design(RIG.model, RIG, **WANTED, margins="ideal", law=False)
    with pytest.raises(FieldError, match="margins"):
        optimise(ideal)


@pytest.mark.slow
def test_bounds_that_nothing_keeps_are_infeasible(design: Design) -> None:
    with pytest.raises(InfeasibleError, match="no structure"):
        optimise(design, max_sensitivity=1.02)


@pytest.mark.slow
def test_the_verb_writes_a_design_that_other_verbs_read(
    design: Design, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    design.save(tmp_path / "design.json")
    out = tmp_path / "optimised.json"
    line = ["optimise", str(tmp_path / "design.json"), "--out", str(out)]
    assert main([*line, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["pays"]
    assert Design.load(out).controller.gain == told["controller"]["gain"]
    assert main(line) == 2  # what is there is kept without --force


def test_what_was_tried_is_listed_with_what_was_taken() -> None:
    class Made:
        def __str__(self) -> str:
            return "the design"

    steps = (
        Step("closed form", 2.5, False),
        Step("free gain", 2.0, True),
        Step("pair", float("nan"), False),
    )
    found = Optimised(Made(), "noise", steps, 0.01)  # type: ignore[arg-type]
    assert str(found).splitlines() == [
        "worst noise gain, each structure with the same bounds, taken if better by 1 %:",
        "  closed form: 2.5",
        "  free gain: 2, taken",
        "  pair: none found in the bounds",
        "the design",
    ]
    assert found.pays
    assert found.gain == pytest.approx(0.2)
    own = Optimised(
        Made(), "crossover", (Step("closed form", 12.0, True), steps[2]), 0.05
    )  # type: ignore[arg-type]
    assert str(own).splitlines()[0].startswith("smallest crossover, ") and "5 %" in str(
        own
    )
    assert str(own).splitlines()[1:] == [
        "  closed form: 12 rad/s, taken",
        "  pair: none found in the bounds",
        "nothing else pays: the closed-form design is returned as it is",
        "the design",
    ]
    assert not own.pays


# --- the smooth problem -------------------------------------------------------------------------------------


def problem_of(made: Design, goal: str = "noise", **changes: object) -> Problem:
    bare = replace(made.full_loop, gain=1.0, order=0.0, filter_time=0.0)
    given = {"filter_order": 2, "bounds": Bounds(1.6, 12.0, 1.4)} | changes
    return Problem(bare, made.natural_frequencies, RIG.period, goal=goal, **given)  # type: ignore[arg-type]


def test_the_constraints_are_the_figures_of_the_loop(design: Design) -> None:
    """ln of: Ms times each distance from −1, |L| at the crossover, the bound over the
    noise of each link.
    """
    problem, controller = problem_of(design), replace(design.controller, filter_order=2)
    x = problem.start(controller)
    assert x[:3] == pytest.approx(
        [math.log(controller.gain), controller.order, math.log(controller.filter_time)]
    )
    assert x[3] == pytest.approx(math.log(1.4))
    values, gradient = problem.constraints(x)
    assert gradient.shape == (values.size, 4) and values.size == 5 * 90 + 1 + 5
    loop, ends = (
        design.full_loop.with_controller(controller),
        np.geomspace(*design.natural_frequencies, 5),
    )
    peaks = loop.sensitivity_peak(ends)
    assert math.exp(-float(values[:450].min())) * 1.6 == pytest.approx(
        float(peaks.max()), rel=1e-2
    )
    assert values[450] == pytest.approx(
        math.log(abs(complex(loop(12.0, ends[0])))), abs=1e-9
    )
    assert values[451:] == pytest.approx(
        np.log(1.4 / loop.noise_gain(ends, RIG.period)), abs=1e-9
    )
    fast = problem_of(design, "crossover")
    y = fast.start(controller)
    assert y[3] == pytest.approx(math.log(12.0))
    y[3] = math.log(15.0)
    assert fast.constraints(y)[0][450] == pytest.approx(
        math.log(abs(complex(loop(15.0, ends[0])))), abs=1e-9
    )


def test_a_start_is_brought_into_range_with_the_same_gain_about_the_crossover(
    design: Design,
) -> None:
    one = problem_of(design, filter_order=1)
    low, high = one.box[1]
    assert (low, high) == (0.05, pytest.approx(0.98)) and problem_of(design).box[1][
        1
    ] == pytest.approx(1.90)
    assert one.box[2] == (pytest.approx(math.log(2e-4)), 0.0)
    steep = fl.Controller(gain=0.02, order=1.4, filter_time=0.01, filter_order=2)
    x = one.start(steep)
    assert x[1] == pytest.approx(0.98)
    assert math.exp(x[0]) * 24.0**0.98 == pytest.approx(
        0.02 * 24.0**1.4
    )  # |Ĉ| at twice the crossover
    assert math.exp(x[2]) == pytest.approx(
        0.02
    )  # one pole for two lags as much with twice the time
    bare = fl.Controller(gain=0.02, order=0.6)
    assert math.exp(one.start(bare)[2]) == pytest.approx(0.1 / 24.0)
    made = one.controller(x, design.controller)
    assert (made.order, made.filter_order, made.link) == (
        x[1],
        1,
        design.controller.link,
    )
    assert (made.gain, made.filter_time) == pytest.approx((math.exp(x[0]), 0.02))


@pytest.mark.slow
def test_an_optimised_design_is_the_one_of_its_bounds(
    quiet: Optimised, design: Design
) -> None:
    names = [item.name for item in quiet.design.requirements]
    assert names == ["gain crossover", "phase margin", "sensitivity peak", "noise gain"]
    own = design.full_loop.achieved(
        np.geomspace(*design.natural_frequencies, 9), RIG.period
    )
    wanted = [item.wanted for item in quiet.design.requirements]
    assert wanted[2] == pytest.approx(float(np.max(own.sensitivity_peak)))
    assert wanted[3] == pytest.approx(float(np.max(own.noise_gain)))
    assert [step.structure for step in quiet.steps] == [
        "closed form",
        "k_d, β, δ, n = 1",
        "k_d, β, δ, n = 2",
    ]
    c = quiet.design.controller
    assert quiet.design.chi == pytest.approx(c.gain * 12.0**c.order)
    light = quiet.design.full_loop.crossings(
        quiet.design.natural_frequencies[1]
    ).frequency.max()
    assert quiet.design.gain_crossover_upper == pytest.approx(light, rel=1e-9)
    assert quiet.goal == "noise" and quiet.least == 0.02 and quiet.steps[2].taken


def test_a_solution_is_quieter_and_keeps_what_was_bounded(design: Design) -> None:
    own = design.full_loop.achieved(
        np.geomspace(*design.natural_frequencies, 9), RIG.period
    )
    peak, noise = float(np.max(own.sensitivity_peak)), float(np.max(own.noise_gain))
    problem = problem_of(design, bounds=Bounds(peak, 12.0, noise))
    found = problem.solve(
        problem.start(replace(design.controller, order=1.2, filter_time=0.02))
    )
    assert problem.constraints(found)[0].min() > -1e-6
    assert (
        math.exp(found[3]) < 0.5 * noise
    )  # the last parameter is ln of the noise gain
    made = problem.controller(found, design.controller)
    loop = design.full_loop.with_controller(made)
    links = np.geomspace(*design.natural_frequencies, 5)
    assert math.exp(found[3]) == pytest.approx(
        float(loop.noise_gain(links, RIG.period).max()), rel=1e-6
    )
