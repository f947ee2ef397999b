"""A rival's linear loop on the twin: does it grow, and how much of it reaches the second mode."""

from __future__ import annotations

import math

import numpy as np

from fraclink._compare.linear import Filter, NominalLoop, fine_step, law_filter, sampled
from fraclink._compare.rivals import Rival
from fraclink._compare.setting import Setting
from fraclink._simulate.arm import Twin
from fraclink._simulate.damping import PowerLaw
from fraclink._simulate.plant import GAUGE_TORQUE, HUB_ANGLE, Plant, assemble

__all__ = ["linear_growth", "mode_gain"]


def _correction(rival: Rival) -> Filter | None:
    """The rival's feedback of the tip estimate as a filter, None where it has none."""
    if rival.correction is None and rival.law.correction.direct != 0.0:
        return law_filter(rival.law)
    return rival.correction


def _plant(setting: Setting, twin: Twin) -> tuple[Plant, Filter]:
    """The twin behind the ideal motor servo, and its tip estimate θm − Γ/c as the controller sees it."""
    period = setting.rig.period
    plant = assemble(
        twin.beam,
        twin.damping,
        drive="servo",
        modes=twin.modes,
        step=fine_step(period),
        servo_pole=setting.ours.inner_pole,
    )
    estimate = plant.outputs[HUB_ANGLE] - plant.outputs[GAUGE_TORQUE] / setting.model.stiffness
    return plant, sampled(plant, estimate, period, setting.rig.inner.delay_samples)


def mode_gain(setting: Setting, twin: Twin, rival: Rival) -> float:
    """Return the largest |L| around the twin's second mode; 0 without feedback of the tip estimate."""
    correction, period = _correction(rival), setting.rig.period
    plant, seen = _plant(setting, twin)
    if correction is None or plant.modes.count < 2:
        return 0.0
    mode = float(plant.modes.frequencies[1])
    # With a power law the mode is at ω^(2/λ), 25 % above ω here.
    shifted = mode ** (2.0 / twin.damping.order) if isinstance(twin.damping, PowerLaw) else mode
    frequency = np.geomspace(0.8 * mode, min(1.25 * shifted, 0.999 * np.pi / period), 600)
    z = np.exp(1j * frequency * period)
    return float(np.max(np.abs(seen.response(z) * correction.response(z))))


def linear_growth(setting: Setting, twin: Twin, rival: Rival) -> float:
    """Return how fast the rival's linear loop on the twin grows [1/s]; 0 where it is stable.

    Friction and the voltage limit are not in it: friction can hide a slow growth, a limit can bound a fast
    one, and a run of some seconds then ends well.
    """
    correction, period = _correction(rival), setting.rig.period
    if correction is None:
        return 0.0
    _, seen = _plant(setting, twin)
    radius = NominalLoop(seen, period, setting.model.stiffness).radius(correction)
    # The power law's slowest relaxation lies within 1e-9 of one.
    return math.log(radius) / period if radius > 1.0 + 1e-9 else 0.0
