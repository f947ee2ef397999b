"""The box of a certificate against an independent search for the worst point, with all
aliases summed.
"""

from __future__ import annotations

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import fraclink as fl
from fraclink import ParameterBox, main
from fraclink.errors import FieldError


@pytest.fixture(scope="module")
def bench() -> ModuleType:
    """benchmarks/bench_box.py: the search, and random designs and boxes."""
    place = Path(__file__).parents[1] / "benchmarks" / "bench_box.py"
    spec = importlib.util.spec_from_file_location("bench_box", place)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look up their module
    spec.loader.exec_module(module)
    return module


# An ideal motor loop, a sampled one with a second mode, and direct placement.
@pytest.mark.slow
@pytest.mark.parametrize("number", [10, 15, 23])
def test_no_point_of_a_box_is_closer_to_minus_one_than_its_certificate_claims(
    number: int, bench: ModuleType
) -> None:
    rng = np.random.default_rng([bench.SEED, number])
    case = bench.random_case(rng)
    certificate = case.certified()
    assert certificate.passed, certificate.verdict
    truth, _ = bench.worst(case, rng, points=60, starts=2)
    assert certificate.statement.modulus < truth < certificate.statement.modulus + 0.02


@pytest.mark.slow
def test_the_models_of_other_logs_widen_the_box(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Values from another log outside the intervals of the first one are covered by the
    proof, at the same payload.
    """
    rig = fl.Rig.named("paper-2023")
    assert rig.model is not None
    wanted = {"gain_crossover": 12.0, "phase_margin": fl.deg(50)}
    design = fl.design(rig.model, rig, payloads=(0.02, 0.04), **wanted)
    order, gain = rig.model.order - 0.05, 1.08
    # The other log is of 20 g: converted to the payload of the first one, its ω₀ agrees
    # to a tenth.
    light = rig.model.at_payload(0.020)
    other = replace(
        light,
        order=order,
        gauge_gain=gain,
        natural_frequency=1.1 * light.natural_frequency,
    )
    alone, both = fl.certify(design), fl.certify(design, others=[other])
    assert alone.passed and both.passed
    assert (
        alone.statement.order_low
        > order
        == pytest.approx(both.statement.order_low, abs=1e-5)
    )
    assert (
        alone.statement.gauge_gain_high
        < gain
        == pytest.approx(both.statement.gauge_gain_high, rel=1e-5)
    )
    assert both.statement.softness_low < alone.statement.softness_low
    assert both.statement.modulus < alone.statement.modulus
    with pytest.raises(FieldError, match="others"):
        fl.certify(design, others=[design])  # type: ignore[list-item]

    design.save(tmp_path / "design.json")
    replace(design, model=other).save(tmp_path / "other.json")
    line = ["certify", "design.json", "--others", "other.json", "--out", "both.json"]
    assert (
        main(
            [str(tmp_path / word) if word.endswith(".json") else word for word in line]
        )
        == 0
    )
    capsys.readouterr()
    assert (
        fl.Certificate.load(tmp_path / "both.json").statement.order_low
        == both.statement.order_low
    )


def test_a_second_mode_that_another_log_does_not_show_may_have_no_gain() -> None:
    rig = fl.Rig.named("paper-2023")
    assert rig.model is not None
    plain, shown = (
        rig.model,
        replace(rig.model, second_mode=fl.SecondMode(150.0, 0.02, 0.02)),
    )
    alone, both = (
        ParameterBox.of(shown, rig),
        ParameterBox.of(shown, rig, others=[plain]),
    )
    assert both == replace(alone, mode_gain=(0.0, alone.mode_gain[1]))
    for model, box, inside in (
        (plain, both, True),
        (shown, both, True),
        (plain, alone, False),
    ):
        assert (box.hull(ParameterBox.at(model)) == box) is inside
    with pytest.raises(
        FieldError, match="with a second mode that the model does not know"
    ):
        ParameterBox.of(plain, rig, others=[shown])
