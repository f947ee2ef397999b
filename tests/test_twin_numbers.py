"""The numbers passed from a rig to the compiled arm: sensors, inputs of a run, the
twin, the engine of the page.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import fraclink as fl
from fraclink import LinkModel, Twin
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


def material(model: LinkModel) -> Any:
    return Twin.from_rig(RIG, model=model).damping


def test_a_model_is_the_material_of_its_massless_link() -> None:
    square = 11.0**2
    assert material(LinkModel(1.56, 11.0)) == KelvinVoigt(0.0)
    assert material(LinkModel(1.56, 11.0, damping=0.5)) == KelvinVoigt(0.5 / square)
    fractional = LinkModel(1.56, 11.0, damping=0.5, damping_order=0.6)
    assert material(fractional) == FractionalKelvinVoigt(0.5 / square, 0.6)
    assert material(replace(fractional, damping=0.0)) == KelvinVoigt(0.0)
    assert material(LinkModel(1.56, 11.0, order=1.9)) == PowerLaw(1.9)
    labels = [
        material(fractional).label,
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
    law = fl.discretize(fl.Controller(0.07, 0.6, link=MODEL), PERIOD)

    def run(frequency: float) -> fl.Run:
        fast = LinkModel(1.56, frequency)
        move = fl.smooth_step(1.0, 0.5)
        return fl.simulate(replace(law, motor_loop=None), move, rig=RIG, model=fast)

    assert np.all(np.isfinite(run(499.9).tip_angle))
    with pytest.raises(
        FieldError, match=r"period: too long for this link .* < 0.00399 s: 3.1 samples"
    ):
        run(501.0)
