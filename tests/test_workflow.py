"""What `design_for` assumes where request and rig are silent, and what it must never change."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

import fraclink as fl
from fraclink._arm.link import LinkModel
from fraclink._arm.rig import Rig
from fraclink._design.completed import _margin_sentence, design_for
from fraclink.errors import InfeasibleError

SILENT = replace(Rig.named("paper-2023"), design=None)


def gauged(**gauge: float) -> LinkModel:
    model = SILENT.model
    assert model is not None
    return replace(model, **gauge)


def test_a_margin_that_was_stated_is_kept_or_refused() -> None:
    # Nearest to 140° at the usual crossover is 97°: less than was asked for must not come back as passed.
    with pytest.raises(InfeasibleError) as refused:
        design_for(SILENT, gauged(gauge_gain=1.4), phase_margin=fl.deg(140))
    assert refused.value.nearest["phase_margin"] < fl.deg(139)


def test_a_crossover_that_nobody_stated_moves_to_keep_the_margin() -> None:
    made, assumed = design_for(SILENT, gauged(gauge_gain=1.4), phase_margin=fl.deg(105))
    assert made.passed
    assert made.at(made.payloads[0]).phase_margin == pytest.approx(fl.deg(105), rel=1e-9)
    assert len(assumed) == 1
    assert "the nearest feasible to 12.2 rad/s" in assumed[0]


@pytest.mark.slow
def test_the_usual_margin_is_named_without_a_doubt() -> None:
    made, assumed = design_for(SILENT, gauged(gauge_delay=0.02))
    assert math.degrees(made.phase_margin) == pytest.approx(50.0)
    assert assumed[1] == "phase margin 50°, as neither the rig nor the request states one"


@pytest.mark.parametrize("degrees", [50.0, math.nextafter(50.0, 0.0), math.nextafter(50.0, 60.0)])
def test_fifty_degrees_that_came_from_radians_are_fifty(degrees: float) -> None:
    assert _margin_sentence(degrees) == "phase margin 50°, as neither the rig nor the request states one"


def test_a_smaller_margin_is_said_to_be_smaller() -> None:
    assert "phase margin 40°" in _margin_sentence(40.0)
    assert "50° is not feasible at this crossover" in _margin_sentence(40.0)
