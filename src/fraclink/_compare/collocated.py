"""Collocated PD: the motor's own encoder and nothing else."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from fraclink._arm.beam import Beam
from fraclink._arm.motor import DiscretePid
from fraclink._compare.linear import Filter, NominalLoop, fine_step, sampled, tune, tustin
from fraclink._law import Drive, Law
from fraclink._simulate.arm import damping_of
from fraclink._simulate.plant import assemble

if TYPE_CHECKING:
    from fraclink._compare.rivals import Rival
    from fraclink._compare.setting import Setting

__all__ = ["collocated"]

DERIVATIVE_POLE = 300.0  # [rad/s] of the filtered derivative, about the inner loop's own filter


def _gains(setting: Setting, pole: float) -> tuple[float, float]:
    """Proportional [V/rad] and derivative gain [V·s/rad] for two hub poles at −`pole` without the link."""
    motor = setting.rig.motor
    return pole**2 / motor.gain, max(2.0 * pole - motor.decay, 0.0) / motor.gain


def _controller(setting: Setting, pole: float) -> Filter:
    proportional, derivative = _gains(setting, pole)
    c = DERIVATIVE_POLE
    return tustin(
        np.array([[-c]]),
        np.ones(1),
        np.array([-derivative * c * c]),
        proportional + derivative * c,
        setting.rig.period,
    )


def _hub(setting: Setting) -> NominalLoop:
    """Voltage to motor angle of the lumped arm on its free hub, held and delayed."""
    model, motor, period = setting.model, setting.rig.motor, setting.rig.period
    length = setting.rig.link.length
    mass = model.stiffness / (model.natural_frequency * length) ** 2
    ratio = motor.gear_ratio
    plant = assemble(
        Beam(length, model.stiffness * length / 3.0, 0.0, mass),
        damping_of(model),
        drive="motor",
        step=fine_step(period),
        hub_inertia=ratio**2 * motor.inertia,
        hub_friction=ratio**2 * motor.viscous_friction,
    )
    gain = ratio * motor.torque_constant
    held = sampled(plant, plant.outputs[0], period, setting.rig.inner.delay_samples, gain=gain)
    return NominalLoop(held, period, model.stiffness)


def collocated(setting: Setting, bare: Law) -> Rival:
    """Return the collocated PD with the hub's double pole raised until Ms is ours."""
    from fraclink._compare.rivals import Rival

    loop = _hub(setting)
    pole, controller, _ = tune(loop, lambda p: _controller(setting, p), (1.0, 300.0), setting.target)
    proportional, derivative = _gains(setting, pole)
    inner = setting.ours.drive
    assert inner is not None  # noqa: S101  # the setting's law drives a motor
    shape = inner.loop
    c = DERIVATIVE_POLE
    half = 0.5 * setting.rig.period
    weight = half / (1.0 + c * half)
    pd = DiscretePid(
        period=shape.period,
        direct=proportional,
        angle_direct=derivative * c,
        integral_gain=0.0,
        filter_gain=0.0,
        angle_filter_gain=-derivative * c * c,
        integral_now=shape.integral_now,
        integral_before=shape.integral_before,
        filter_now=weight,
        filter_before=weight,
        filter_decay=(1.0 - c * half) / (1.0 + c * half),
    )
    drive: Drive = replace(inner, loop=pd, torque_voltage=0.0)
    return Rival(
        "collocated PD",
        "encoder only; hub's double pole raised to the same Ms as ours at the motor's voltage",
        f"hub pole {pole:.4g} rad/s",
        loop.peak(controller),
        1,
        4,
        replace(bare, drive=drive),
    )
