"""The search behind `tune_pid` on loops whose margins and errors are known in closed
form, and its remarks.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import fraclink as fl
from fraclink.errors import FieldError, InfeasibleError
from fracsys import s

LAG = (1 / (0.4 * s**1.5 + 1)).delayed(0.05)


# --- what is refused, in words ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("plant", "given", "words"),
    [
        (0 * s, {}, "plant: zero"),
        (
            1 / (s - 1),
            {},
            "plant: unstable: it has a pole with Re s >= 0 other than at the origin",
        ),
        (-1 / (s + 1), {}, "plant: of negative gain at low frequency"),
        ((s + 2) / (s + 1), {}, r"plant: not strictly proper"),
        (
            LAG,
            {"form": "PI", "derivative_order": 0.5},
            "derivative_order: given for a PI",
        ),
        (LAG, {"form": "PD", "integral_order": 0.5}, "integral_order: given for a PD"),
        (
            LAG,
            {"form": "PI", "integral_order": 0.5},
            "asked of a PI whose order is given",
        ),
        (
            LAG,
            {"form": "PD", "derivative_order": 0.5},
            "asked of a PD whose order is given",
        ),
    ],
)
def test_bad_plants_and_requests_say_what_is_wrong(
    plant: Any, given: dict[str, Any], words: str
) -> None:
    with pytest.raises(FieldError, match=words):
        fl.tune_pid(plant, gain_crossover=2.0, **given)


def test_an_integrator_is_no_instability_and_needs_no_integral() -> None:
    made = fl.tune_pid(
        1 / (s * (0.4 * s + 1)), gain_crossover=2.3, phase_margin=fl.deg(65), form="PD"
    )
    # a steady-state error is removed by the integrator of the plant
    assert not made.findings


@pytest.mark.slow
def test_infeasible_requests_are_named_by_their_form() -> None:
    with pytest.raises(
        InfeasibleError, match="no PI controller with a flat phase with gains >= 0"
    ) as caught:
        fl.tune_pid(LAG, gain_crossover=3.0, form="PI", phase_margin=fl.deg(60))
    assert caught.value.condition == "phase_margin"
    nearest = caught.value.nearest["phase_margin"]
    assert math.degrees(nearest) % 2.5 == pytest.approx(0.0, abs=1e-9) or math.degrees(
        nearest
    ) % 2.5 == pytest.approx(2.5, abs=1e-9)
    with pytest.raises(
        InfeasibleError, match="no PID controller with gains >= 0 crosses there"
    ) as caught:
        fl.tune_pid(LAG, gain_crossover=3.0, flat_phase=False, gain_margin=900.0)
    assert caught.value.condition == "gain_crossover" and not caught.value.nearest


# --- the result ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def made() -> fl.extend.PidTuning:
    return fl.tune_pid(
        LAG,
        gain_crossover=3.0,
        gain_margin=1.5,
        max_sensitivity=3.0,
        period=0.01,
        output_limit=50.0,
        measurement_limit=5.0,
    )


def test_a_step_is_the_closed_loops(made: fl.extend.PidTuning) -> None:
    """A delay of the plant itself is inverted numerically; here is one without: C = k
    on 1/(s + 1).
    """
    bare = replace(made, period=None, gain_crossover=None, horizon=2.0)
    plain = replace(bare, plant=1 / (s + 1), controller=fl.extend.FractionalPid(3.0))
    step = plain.step(size=2.0)
    assert step.time[-1] == 2.0 and step.time.size == 1001
    answer = 2.0 * 0.75 * (1 - np.exp(-4.0 * step.time))
    assert np.allclose(step.measurement, answer, atol=1e-9)
    assert np.allclose(step.output, 3.0 * (2.0 - answer), atol=1e-8)
    assert plain.step(duration=1.0).time[-1] == 1.0
    law = fl.extend.discretize_pid(
        fl.extend.FractionalPid(3.0), 0.01, output_limit=50.0, measurement_limit=5.0
    )
    held = plain.step(law=law, duration=0.5)
    assert held.time.size == 51 and held.time[-1] == pytest.approx(0.5)
    # u of a sample acts one period later: y(k + 1) = a y(k) + (1 − a) 3 (1 − y(k − 1))
    a, y = math.exp(-0.01), [0.0, 0.0]
    for _ in range(49):
        y.append(a * y[-1] + (1 - a) * 3.0 * (1 - y[-2]))
    assert np.allclose(held.measurement, y, atol=1e-6)
    assert held.output[0] == pytest.approx(3.0) and held.output[-1] == held.output[-2]


def test_the_margins_of_the_shipped_law_count_a_period_of_computation(
    made: fl.extend.PidTuning,
) -> None:
    law = fl.extend.discretize_pid(
        fl.extend.FractionalPid(3.0), 0.1, output_limit=50.0, measurement_limit=5.0
    )
    plain = replace(
        made,
        plant=1 / (s + 1),
        controller=fl.extend.FractionalPid(3.0),
        period=0.1,
        horizon=2.0,
    )
    found = plain.sampled_margins(law)
    a = math.exp(-0.1)

    def loop(w: float) -> complex:
        z = np.exp(0.1j * w)
        return complex(3.0 * (1 - a) / (z - a) / z)

    assert abs(loop(found.gain_crossover)) == pytest.approx(1.0, rel=1e-6)
    assert found.phase_margin == pytest.approx(
        float(np.angle(-loop(found.gain_crossover))), abs=1e-6
    )
