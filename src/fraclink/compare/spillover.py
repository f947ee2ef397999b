"""How much of a rival's loop reaches the second mode of the link, which no designer was told of."""

from __future__ import annotations

import numpy as np

from fraclink.compare.linear import fine_step, law_filter, sampled
from fraclink.compare.rivals import Rival
from fraclink.compare.setting import Setting
from fraclink.twin.arm import Twin
from fraclink.twin.damping import PowerLaw
from fraclink.twin.plant import GAUGE_TORQUE, HUB_ANGLE, assemble

__all__ = ["mode_gain"]


def mode_gain(setting: Setting, twin: Twin, rival: Rival) -> float:
    """Return the largest |L| around the twin's second mode; 0 without feedback of the tip estimate.

    L is the sampled loop of the rival's correction with the twin behind the ideal motor servo and the tip
    estimate θm − Γ/c, as the controller sees it.
    """
    correction = rival.correction
    if correction is None and rival.law.correction.direct != 0.0:
        correction = law_filter(rival.law)
    period = setting.rig.period
    plant = assemble(
        twin.beam,
        twin.damping,
        drive="servo",
        modes=twin.modes,
        step=fine_step(period),
        servo_pole=setting.ours.inner_pole,
    )
    if correction is None or plant.modes.count < 2:
        return 0.0
    mode = float(plant.modes.frequencies[1])
    # With a power law the mode is at ω^(2/λ), 25 % above ω here.
    shifted = mode ** (2.0 / twin.damping.order) if isinstance(twin.damping, PowerLaw) else mode
    frequency = np.geomspace(0.8 * mode, min(1.25 * shifted, 0.999 * np.pi / period), 600)
    estimate = plant.outputs[HUB_ANGLE] - plant.outputs[GAUGE_TORQUE] / setting.model.stiffness
    seen = sampled(plant, estimate, period, setting.rig.inner.delay_samples)
    z = np.exp(1j * frequency * period)
    return float(np.max(np.abs(seen.response(z) * correction.response(z))))
