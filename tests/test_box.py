"""The box of a certificate against an own search for the worst point, with every alias summed."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest


@pytest.fixture(scope="module")
def bench() -> ModuleType:
    """benchmarks/bench_box.py: the search, and random designs and boxes."""
    place = Path(__file__).parents[1] / "benchmarks" / "bench_box.py"
    spec = importlib.util.spec_from_file_location("bench_box", place)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


# An ideal motor loop; a sampled one with a second mode; direct placement.
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
