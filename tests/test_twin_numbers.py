"""The numbers passed from a rig to the compiled arm: sensors, inputs of a run, the
twin, the engine of the page.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import fraclink as fl
from fraclink import LinkModel, SecondMode, Twin
from fraclink._simulate import damping_of
from fraclink._simulate.links import link_weights, second_mode_weights
from fraclink.errors import FieldError
from fraclink.extend import (
    FractionalKelvinVoigt,
    KelvinVoigt,
    PowerLaw,
    geared,
)

PERIOD = 0.004
RIG = fl.Rig.named("paper-2023")
GEARED = geared(RIG)
MODEL = RIG.model
assert MODEL is not None


# ──────────────────────────────────────────────────────────────────────────────────


def test_a_light_hub_is_a_finding_with_its_numbers() -> None:
    """Below a tenth of the arm's own inertia, the compensation of the coupling torque
    begins to feed back on itself.
    """
    arm = 0.030 * 0.65**2
    for share, codes in ((0.0999, ["W601"]), (0.1001, [])):
        rig = replace(RIG, motor=replace(RIG.motor, inertia=share * arm))
        assert [f.code for f in Twin.from_rig(rig, link_mass=0.0).findings] == codes
    (finding,) = Twin.from_rig(RIG, link_mass=0.0).findings
    assert (
        finding.severity == "warning"
        and "is 0.54 % of the arm's 0.0127 kg·m²" in finding.message
    )
    assert finding.evidence == {
        "hub_inertia": pytest.approx(6.87e-5),
        "arm_inertia": pytest.approx(arm),
    }
    twin = Twin.from_rig(GEARED, link_mass=0.0)
    assert twin.findings == () and twin.hub_inertia == pytest.approx(2500 * 6.87e-5)
    assert twin.coulomb == pytest.approx(1.0) and twin.breakaway == pytest.approx(1.2)
    assert (
        GEARED.motor.gear_ratio == 50.0 and geared(RIG, 100.0).motor.gear_ratio == 100.0
    )


def test_a_model_is_the_material_of_its_massless_link() -> None:
    square = 11.0**2
    assert damping_of(LinkModel(1.56, 11.0)) == KelvinVoigt(0.0)
    assert damping_of(LinkModel(1.56, 11.0, damping=0.5)) == KelvinVoigt(0.5 / square)
    fractional = LinkModel(1.56, 11.0, damping=0.5, damping_order=0.6)
    assert damping_of(fractional) == FractionalKelvinVoigt(0.5 / square, 0.6)
    assert damping_of(replace(fractional, damping=0.0)) == KelvinVoigt(0.0)
    assert damping_of(LinkModel(1.56, 11.0, order=1.9)) == PowerLaw(1.9)
    labels = [
        damping_of(fractional).label,
        KelvinVoigt(0.0125).label,
        PowerLaw(1.92).label,
    ]
    assert labels == [
        f"fractional, D = 1 + {0.5 / square:g} s^0.6",
        "viscous, D = 1 + 0.0125 s",
        "power law, D = s^0.08 (lambda = 1.92)",
    ]


@pytest.mark.parametrize(
    ("factor", "refused"), [(0.81, False), (1.19, False), (0.79, True), (1.21, True)]
)
def test_a_model_that_is_another_arm_is_refused_beyond_a_fifth(
    factor: float, refused: bool
) -> None:
    other = replace(
        MODEL, natural_frequency=factor * RIG.natural_frequency(0.030), payload=0.030
    )
    if refused:
        with pytest.raises(
            FieldError, match=r"model\.natural_frequency: contradicting .* within 20 %"
        ):
            Twin.from_rig(RIG, model=other)
    else:
        assert Twin.from_rig(RIG, model=other).damping == PowerLaw(1.92)
    # a stated material needs no question
    Twin.from_rig(RIG, model=other, damping=KelvinVoigt(0.0))
    assert Twin.from_rig(RIG, model=replace(other, payload=None)).beam.payload == 0.030


# ────────────────────────────────────────────────────────────────────────────────────────


def test_a_link_too_fast_for_its_period_is_refused_with_the_longest_that_is_not() -> (
    None
):
    fast = LinkModel(1.56, 499.9)
    assert link_weights(fast, PERIOD, 1.0).first.shape == (1, 6)
    with pytest.raises(
        FieldError, match=r"period: too long for this link .* < 0.00399 s: 3.1 samples"
    ):
        link_weights(LinkModel(1.56, 501.0), PERIOD, 1.0)


def test_a_second_mode_answers_powers_of_time_as_its_equation_says() -> None:
    """The state after a period in which the motor moved as (t/T)^j, against quadrature
    of its equation.
    """
    mode = SecondMode(frequency=150.0, gain=0.2, damping_ratio=0.1)
    (row,) = second_mode_weights(mode, PERIOD)
    pole = 150.0 * complex(-0.1, math.sqrt(0.99))
    size = 0.2 * complex(1.0, 0.1 / math.sqrt(0.99))
    assert row[0] == 0.2 and complex(row[1], row[2]) == pytest.approx(
        np.exp(pole * PERIOD)
    )
    x, w = np.polynomial.legendre.leggauss(20)
    x, w = 0.5 * (x + 1.0), 0.5 * w
    for j in range(6):
        # z' = p z + g p θ with θ = x^j, over the period
        answer = (
            size * pole * PERIOD * np.sum(w * x**j * np.exp(pole * PERIOD * (1.0 - x)))
        )
        assert complex(row[3 + j], row[9 + j]) == pytest.approx(answer, rel=1e-12)
    assert second_mode_weights(None, PERIOD).shape == (0, 15)
