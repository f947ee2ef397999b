"""Random requests to `design`, a small and quick part of benchmarks/bench_requests.py."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

import fraclink as fl
from fraclink._arm.rig import Rig
from fraclink._design.nearest import offered
from fraclink._law.design import Specification
from fraclink.errors import FieldError, InfeasibleError

RIG = Rig.named("paper-2023")
# Of the first twenty those that are answered at once: some refusals search for seconds.
SEEDS = (0, 5, 6, 7, 8, 9, 11, 12, 14, 15, 16, 17, 18, 19)
BOUNDED = {"payloads": (0.020, 0.040), "gain_crossover": 12.0}


@pytest.fixture(scope="module")
def survey() -> ModuleType:
    """The benchmark, as a module."""
    place = Path(__file__).resolve().parents[1] / "benchmarks" / "bench_requests.py"
    spec = importlib.util.spec_from_file_location("bench_requests", place)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["bench_requests"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_what_a_refusal_offers_is_feasible(survey: ModuleType, seed: int) -> None:
    request = survey.random_request(seed)
    try:
        made = fl.design(request.model, request.rig, **request.options, law=False)
    except FieldError:
        return  # a crossover beyond the motor loop's bandwidth contradicts the rig
    except InfeasibleError as error:
        if error.nearest:
            offered = fl.design(
                request.model,
                request.rig,
                **{**request.options, **error.nearest},
                law=False,
            )
            assert offered.passed, error.nearest
        return
    assert made.margins_kind == "ideal" or made.at(made.payloads[0]).stable


def test_a_motor_loop_that_cannot_be_placed_is_refused_before_anything_is_offered(
    survey: ModuleType,
) -> None:
    request = survey.random_request(
        246
    )  # in the paper's reading, which itself has no motor loop
    with pytest.raises(
        FieldError, match=r"inner\.pole: not to be placed with this delay"
    ):
        fl.design(request.model, request.rig, **request.options)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [57, 222])
def test_a_design_alone_says_that_its_law_keeps_less(
    survey: ModuleType, seed: int
) -> None:
    """What the law keeps is measured on the sampled loop with every alias summed one by
    one.
    """
    request = survey.random_request(seed)
    made = fl.design(request.model, request.rig, **request.options)
    told = [finding for finding in made.findings if finding.code == "W404"]
    lost = made.phase_margin - min(
        survey.kept(made, made.law(), payload) for payload in made.payloads
    )
    assert fl.deg(0.5) < lost < fl.deg(2.5)
    assert [finding.severity for finding in told] == ["warning"]
    assert told[0].evidence["phase_margin_rad"] == pytest.approx(
        made.phase_margin - lost, abs=fl.deg(0.1)
    )
    unasked = fl.design(request.model, request.rig, **request.options, law=False)
    assert unasked.findings == tuple(
        finding for finding in made.findings if finding.code != "W404"
    )


def test_a_settling_time_is_answered_in_seconds() -> None:
    asked = {
        "payloads": (0.020, 0.040),
        "settling_time": 0.2,
        "phase_margin": fl.deg(60),
    }
    with pytest.raises(InfeasibleError) as refused:
        fl.design(RIG.model, RIG, **asked, law=False)
    nearest = refused.value.nearest
    assert "gain_crossover" not in nearest
    assert fl.design(RIG.model, RIG, **{**asked, **nearest}, law=False).passed


@pytest.mark.slow
def test_a_bound_on_the_sensitivity_is_answered_as_one() -> None:
    asked = {**BOUNDED, "max_sensitivity": 1.02}
    with pytest.raises(InfeasibleError) as refused:
        fl.design(RIG.model, RIG, **asked, law=False)
    assert set(refused.value.nearest) == {"max_sensitivity"}
    assert fl.design(
        RIG.model, RIG, **{**asked, **refused.value.nearest}, law=False
    ).passed


@pytest.mark.slow
def test_the_loop_of_the_survey_is_that_of_the_margin_engine(
    survey: ModuleType,
) -> None:
    made = fl.design(RIG.model, RIG, **BOUNDED, phase_margin=fl.deg(50), law=False)
    law = made.law(order=1)
    # One state cannot follow Ĉ: the margin is far from the design's, and both must find
    # the same.
    engine = made.sampled_at(0.020, realisation=law.frequency_response).phase_margin
    assert engine is not None
    assert survey.kept(made, law, 0.020) == pytest.approx(abs(engine), abs=2e-4)
    assert abs(engine) > made.phase_margin + 0.1


def test_what_is_out_of_its_range_is_not_offered() -> None:
    """A bound on the mode of 1981 would be needed, and 1000 is the largest."""
    spec = Specification(gain_crossover=12.0, phase_margin=0.8, mode_gain=0.5)
    assert offered({"mode_gain": 1981.0}, spec, lambda trial: None) == {}
    assert offered({"mode_gain": 0.7}, spec, lambda trial: None) == {"mode_gain": 0.7}
