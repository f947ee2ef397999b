"""How a design is completed: by the request, then by the rig, then by the fastest
crossover that keeps every requirement.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

import fraclink as fl
from fraclink import Rig
from fraclink._design.completed import design_for
from fraclink.errors import FieldError, InfeasibleError

SILENT = replace(Rig.named("paper-2023"), design=None)
MODEL = SILENT.model
assert MODEL is not None


def test_what_was_stated_is_kept_or_refused() -> None:
    stated = {"gain_crossover": 12.0, "phase_margin": fl.deg(140)}
    with pytest.raises(InfeasibleError):
        design_for(SILENT, MODEL, **stated)
    made, assumed = design_for(SILENT, MODEL, **stated | {"phase_margin": fl.deg(40)})
    assert made.passed and made.phase_margin == fl.deg(40) and assumed == ()


def test_the_rig_completes_a_request_and_yields_to_it() -> None:
    stated = Rig.named("paper-2023").design
    defaults = replace(stated, gain_crossover=11.5, phase_margin_deg=45.0)
    rig = replace(SILENT, design=defaults)
    made, assumed = design_for(rig, MODEL)
    assert (made.gain_crossover, made.phase_margin) == (11.5, pytest.approx(fl.deg(45)))
    assert assumed == () and made.box is None
    other, _ = design_for(rig, MODEL, gain_crossover=12.0)
    assert (other.gain_crossover, other.phase_margin) == (
        12.0,
        pytest.approx(fl.deg(45)),
    )


def test_without_a_margin_the_sensitivity_is_bounded() -> None:
    made, (sentence,) = design_for(SILENT, MODEL, gain_crossover=12.0)
    rows = {item.name: item.wanted for item in made.requirements}
    assert rows["sensitivity peak"] == 2.0 and "sensitivity peak of 2" in sentence


@pytest.mark.slow
def test_nothing_stated_is_the_fastest_over_the_box() -> None:
    made, assumed = design_for(SILENT, MODEL)
    assert made.passed and made.box is not None and len(assumed) == 2
    assert f"{made.gain_crossover:.3g} rad/s" in assumed[0]


def test_an_unknown_payload_is_told() -> None:
    stranger = replace(MODEL, payload=None, natural_frequency=9.0)
    _, assumed = design_for(
        SILENT, stranger, gain_crossover=12.0, phase_margin=fl.deg(45)
    )
    assert "belongs to a payload that it does not state" in assumed[0]


def test_without_a_model_the_field_is_named() -> None:
    with pytest.raises(FieldError, match="model"):
        design_for(replace(SILENT, model=None))
