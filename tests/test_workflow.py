"""What `design_for` assumes where request and rig are silent, and what it must never
change.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

import fraclink as fl
from fraclink._arm.link import LinkModel
from fraclink._arm.rig import DesignDefaults, Rig
from fraclink._design.completed import _margin_sentence, design_for
from fraclink.errors import FieldError, InfeasibleError

SILENT = replace(Rig.named("paper-2023"), design=None)


def gauged(**gauge: float | None) -> LinkModel:
    model = SILENT.model
    assert model is not None
    return replace(model, **gauge)


@pytest.mark.slow
def test_a_margin_that_was_stated_is_kept_or_refused() -> None:
    # Nearest to 140° at the usual crossover is 97°: less than was asked for must not
    # come back as passed.
    with pytest.raises(InfeasibleError) as refused:
        design_for(SILENT, gauged(gauge_gain=1.4), phase_margin=fl.deg(140))
    assert refused.value.nearest["phase_margin"] < fl.deg(139)


@pytest.mark.slow
def test_a_crossover_that_nobody_stated_moves_to_keep_the_margin() -> None:
    made, assumed = design_for(SILENT, gauged(gauge_gain=1.4), phase_margin=fl.deg(105))
    assert made.passed
    assert made.at(made.payloads[0]).phase_margin == pytest.approx(
        fl.deg(105), rel=1e-9
    )
    assert len(assumed) == 1
    assert "the nearest feasible to 12.2 rad/s" in assumed[0]


@pytest.mark.slow
def test_the_usual_margin_is_named_without_a_doubt() -> None:
    made, assumed = design_for(SILENT, gauged(gauge_delay=0.02))
    assert math.degrees(made.phase_margin) == pytest.approx(50.0)
    assert (
        assumed[1] == "phase margin 50°, as neither the rig nor the request states one"
    )


@pytest.mark.slow
def test_a_model_that_states_no_payload_is_taken_from_the_rig_and_that_is_said() -> (
    None
):
    wanted = {"gain_crossover": 12.0, "phase_margin": fl.deg(50), "filter_time": 0.0}
    strange = gauged(natural_frequency=20.0, payload=None)
    made, assumed = design_for(SILENT, strange, **wanted)
    own, nothing = design_for(SILENT, gauged(), **wanted)
    # √(1.56/(0.03·0.65²)) = 11.094: the frequency of the rig's nominal payload, which
    # the rig's model has.
    assert made.controller == own.controller and nothing == ()
    assert assumed == (
        "ω₀ 11.09 at 30 g, from the rig's stiffness and length, as the model's 20 belongs to a payload that "
        "it does not state",
    )
    assert design_for(SILENT, strange, filter_time=0.0)[1][0] == assumed[0]


@pytest.mark.parametrize(
    "degrees", [50.0, math.nextafter(50.0, 0.0), math.nextafter(50.0, 60.0)]
)
def test_fifty_degrees_that_came_from_radians_are_fifty(degrees: float) -> None:
    assert (
        _margin_sentence(degrees)
        == "phase margin 50°, as neither the rig nor the request states one"
    )


def test_a_smaller_margin_is_said_to_be_smaller() -> None:
    assert "phase margin 40°" in _margin_sentence(40.0)
    assert "50° is not feasible at this crossover" in _margin_sentence(40.0)


# --- what is asked of `design`, one request after the other -----------------------------------------------


class Asked:
    """Stands for `design`: answers where `feasible` says so, and keeps every request."""

    def __init__(
        self, feasible: Callable[..., bool], nearest: dict[str, float] | None = None
    ) -> None:
        self.feasible, self.nearest, self.requests = feasible, nearest or {}, []  # type: ignore[var-annotated]

    def __call__(self, link: LinkModel, rig: Rig, **asked: Any) -> Any:
        self.requests.append(
            {
                name: value
                for name, value in asked.items()
                if name not in ("law", "payloads")
            }
        )
        if not self.feasible(**asked):
            raise InfeasibleError("phase margin unreachable", "too much", self.nearest)
        made = {
            "gain_crossover": asked.get("gain_crossover", 0.0),
            "phase_margin": asked.get("phase_margin"),
        }
        return SimpleNamespace(**made)


def degrees(requests: list[dict[str, Any]]) -> list[float]:
    return [round(math.degrees(one["phase_margin"]), 6) for one in requests]


def asking(monkeypatch: pytest.MonkeyPatch, *given: Any) -> Asked:
    stand_in = Asked(*given)
    monkeypatch.setattr("fraclink._design.completed.design", stand_in)
    return stand_in


def test_margins_are_tried_from_the_usual_to_the_least(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    wanted = {"gain_crossover": 12.0}
    first = asking(monkeypatch, lambda phase_margin, **_: True)
    _, assumed = design_for(SILENT, **wanted)
    assert degrees(first.requests) == [50.0] and assumed == (_margin_sentence(50.0),)
    # A refusal takes seconds: where the least margin is refused, too, none between is
    # tried.
    none = asking(monkeypatch, lambda phase_margin, **_: False)
    with pytest.raises(InfeasibleError):
        design_for(SILENT, **wanted)
    assert degrees(none.requests) == [50.0, 30.0]
    between = asking(monkeypatch, lambda phase_margin, **_: phase_margin < fl.deg(40.1))
    made, assumed = design_for(SILENT, **wanted)
    assert degrees(between.requests) == [
        50.0,
        30.0,
        45.0,
        40.0,
    ] and made.phase_margin == fl.deg(40)
    assert (
        assumed[0].endswith("states one; 50° is not feasible at this crossover")
        and len(assumed) == 1
    )
    least = asking(monkeypatch, lambda phase_margin, **_: phase_margin < fl.deg(31))
    made, assumed = design_for(SILENT, **wanted)
    assert made.phase_margin == fl.deg(30) and assumed == (_margin_sentence(30.0),)
    assert degrees(least.requests) == [50.0, 30.0, 45.0, 40.0, 35.0]


def test_the_usual_crossover_is_above_the_resonance_of_the_heaviest_payload(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    model = gauged()
    resonance = model.at_payload(0.04).torque_resonance
    assert resonance is not None
    asking(monkeypatch, lambda **_: True)
    made, assumed = design_for(SILENT, model)
    assert made.gain_crossover == pytest.approx(1.15 * resonance)
    assert assumed[0] == (
        f"gain crossover {1.15 * resonance:.3g} rad/s: 1.15 times the torque resonance of the heaviest "
        f"payload ({resonance:.3g} rad/s), as neither the rig nor the request states one"
    )
    heavier, _ = design_for(SILENT, model, payloads=(0.02, 0.08))
    assert heavier.gain_crossover == pytest.approx(
        1.15 * (model.at_payload(0.08).torque_resonance or 0.0)
    )
    # A refusal that names a nearest crossover is followed, and the sentence says so.
    moved = asking(
        monkeypatch,
        lambda gain_crossover, **_: gain_crossover > 14.0,
        {"gain_crossover": 15.0},
    )
    made, assumed = design_for(SILENT, model, phase_margin=fl.deg(60))
    assert made.gain_crossover == 15.0 and moved.requests[-1]["phase_margin"] == fl.deg(
        60
    )
    assert assumed[0].startswith(
        f"gain crossover 15 rad/s: the nearest feasible to {1.15 * resonance:.3g} rad/s"
    )
    # ... but not one that would change what was stated
    other = {"gain_crossover": 15.0, "phase_margin": fl.deg(40)}
    asking(monkeypatch, lambda gain_crossover, **_: gain_crossover > 14.0, other)
    with pytest.raises(InfeasibleError):
        design_for(SILENT, model, phase_margin=fl.deg(60))
    made, assumed = design_for(SILENT, model)
    assert made.phase_margin == fl.deg(40) and "phase margin 40°" in assumed[1]


def test_a_loud_second_mode_gets_the_least_bound_that_works(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stated = {"gain_crossover": 12.0, "phase_margin": fl.deg(50)}
    loud = asking(
        monkeypatch, lambda mode_gain=0.5, **_: mode_gain >= 0.613, {"mode_gain": 0.613}
    )
    _, assumed = design_for(SILENT, **stated)
    assert [one.get("mode_gain") for one in loud.requests] == [None, 0.62]
    assert assumed == (
        "gain of 0.62 at the second mode, as 0.5 is not feasible with this crossover and margin",
    )
    for nearest in (
        {"mode_gain": 0.71},
        {"mode_gain": 0.6, "phase_margin": 0.8},
        {"phase_margin": 0.8},
    ):
        asking(monkeypatch, lambda mode_gain=0.5, **_: False, nearest)
        with pytest.raises(InfeasibleError):
            design_for(SILENT, **stated)
    asked = asking(monkeypatch, lambda **_: False, {"mode_gain": 0.6})
    with pytest.raises(InfeasibleError):
        design_for(SILENT, **stated, mode_gain=0.55)
    assert len(asked.requests) == 1


def test_the_rigs_own_request_completes_what_was_not_asked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig = replace(SILENT, design=DesignDefaults(13.0, 55.0, 0.01))
    said = asking(monkeypatch, lambda **_: True)
    assert design_for(rig)[1] == ()
    assert said.requests[-1] == {
        "gain_crossover": 13.0,
        "phase_margin": fl.deg(55),
        "filter_time": 0.01,
    }
    design_for(rig, settling_time=0.5)
    assert said.requests[-1] == {
        "settling_time": 0.5,
        "phase_margin": fl.deg(55),
        "filter_time": 0.01,
    }
    design_for(rig, max_sensitivity=1.5, noise_gain=1.0)
    assert said.requests[-1] == {
        "gain_crossover": 13.0,
        "max_sensitivity": 1.5,
        "noise_gain": 1.0,
    }
    design_for(rig, mode_gain=0.4, gain_crossover=None)
    assert said.requests[-1] == {
        "gain_crossover": 13.0,
        "phase_margin": fl.deg(55),
        "mode_gain": 0.4,
    }
    design_for(rig, gain_crossover=9.0, phase_margin=0.7, filter_time=0.0)
    assert said.requests[-1] == {
        "gain_crossover": 9.0,
        "phase_margin": 0.7,
        "filter_time": 0.0,
    }
    with pytest.raises(FieldError, match="model"):
        design_for(replace(SILENT, model=None))


@pytest.mark.slow
def test_a_link_without_a_torque_resonance_is_crossed_above_its_natural_frequency(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """ω₀^(2/λ) is what is left to go by where the damping has taken the peak away."""
    damped = replace(
        gauged(), order=2.0, natural_frequency=11.0, damping=60.0, payload=0.03
    )
    heavy = damped.at_payload(0.04)
    assert heavy.torque_resonance is None
    asking(monkeypatch, lambda **_: True)
    made, _ = design_for(SILENT, damped)
    assert made.gain_crossover == pytest.approx(1.15 * heavy.natural_frequency)
    fractional = replace(damped, order=1.9)
    made, _ = design_for(SILENT, fractional)
    heavy = fractional.at_payload(0.04)
    wanted = heavy.torque_resonance or heavy.natural_frequency ** (2 / 1.9)
    assert made.gain_crossover == pytest.approx(1.15 * wanted)
