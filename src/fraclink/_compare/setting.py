"""What every rival is told, and the arm they all run on."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypedDict

from fraclink._arm.controller import Controller
from fraclink._arm.link import LinkModel
from fraclink._arm.rig import Rig
from fraclink._compare.linear import NominalLoop, law_filter
from fraclink._law import Law
from fraclink._simulate.arm import Twin, damping_of, geared
from fraclink._simulate.simulate import with_motor_loop
from fraclink._validate import checked_between, checked_noun
from fraclink.errors import FieldError

__all__ = ["Request", "Setting", "prepare"]


class Request(TypedDict):
    """What our design is asked for."""

    gain_crossover: float
    phase_margin: float
    filter_time: float | None


@dataclass(frozen=True)
class Setting:
    """What every rival is told: the rig, its lumped model, and our design, whose Ms is the target."""

    rig: Rig
    model: LinkModel
    ours: Law
    controller: Controller
    loop: NominalLoop
    request: Request

    @property
    def target(self) -> float:
        """Ms of our design at the nominal payload, on the lumped model."""
        return self.loop.peak(law_filter(self.ours))


def prepare(
    rig: Rig, model: LinkModel | None, link_mass: float | None, request: Request
) -> tuple[Setting, Twin, list[str]]:
    """Return what the rivals are told, the twin they run on, and what was assumed."""
    from fraclink._design import design

    checked_noun("rig", rig, Rig, remedy="Rig.named or Rig.load make one")
    known = rig.model if model is None else checked_noun("model", model, LinkModel, remedy="fit.model")
    if known is None:
        raise FieldError("model", None, "missing", allowed="a LinkModel", remedy="identify one first")
    mass = rig.link.mass or 0.00735
    if link_mass is not None:
        mass = checked_between("link_mass", link_mass, 0.0, 1e4, "kg")
    nominal = known.at_payload(rig.payloads.nominal) if known.payload else known
    notes = [f"link of {1e3 * mass:g} g, {damping_of(nominal).label}"]
    if Twin.from_rig(rig, link_mass=mass, damping=damping_of(nominal)).findings:
        rig = geared(rig)
        notes.append("the rig's hub is too light for a sampled compensation (W601): a gear of 50:1 added")
    twin = Twin.from_rig(rig, link_mass=mass, damping=damping_of(nominal))
    result = design(
        nominal,
        rig,
        payloads=(rig.payloads.low, rig.payloads.high),
        **request,
    )
    law = with_motor_loop(result.controller.discretize(rig.period), twin=twin)[0]
    loop = NominalLoop.of(
        nominal,
        rig.payloads.nominal,
        period=rig.period,
        pole=law.inner_pole,
        delay=rig.inner.delay_samples,
    )
    setting = Setting(rig, nominal, law, result.controller, loop, request)
    notes.append(
        f"our design: crossover {request['gain_crossover']:g} rad/s, "
        f"margin {math.degrees(request['phase_margin']):g}°, δ {result.controller.filter_time:.3g} s; "
        f"its Ms at {1e3 * rig.payloads.nominal:g} g is {setting.target:.3f} on the lumped model"
    )
    return setting, twin, notes
