"""The moving arm as part of a page: script with its hash, style, and data."""

from __future__ import annotations

import base64
import json
import math
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fraclink._arm.beam import DEFAULT_MASS
from fraclink._arm.link import LinkModel
from fraclink._arm.reference import smooth_step
from fraclink._design import Design
from fraclink._law import MODES, REASONS, Law, equip
from fraclink._simulate.engine import (
    LONGEST,
    EngineLink,
    engine_bytes,
    engine_link,
    engine_noise,
    engine_rig,
    engine_twin,
    twin_noise,
)
from fraclink._simulate.simulate import link_at
from fraclink.errors import FieldError
from fraclink.trials._rivals import motor_alone
from fraclink.trials._study import Study
from fraclink.view._loops import payloads_about
from fraclink.view._pages import ARM_SCRIPTS, scoped, squeezed
from fracsys.checks import Real

__all__ = ["MOST_PAYLOADS", "ArmBox", "arm_box", "assumed_mass"]


MOST_PAYLOADS = 15  # on the slider: 40 kB of a page
_SEED = 0
# The move goes forward in the first half of the run and back in the second, so that the
# picture does not jump.
_TIMES = np.round(np.arange(0.2, 1.51, 0.05), 2)
_LONGEST_SHARE = 0.75  # of half a run, for the longest move: then the tip settles


@dataclass(frozen=True)
class ArmBox:
    """The data of the template `arm_box.html`; all of it comes from the package or is
    escaped.
    """

    data: str
    script: str
    style: str
    has_twin: bool


def arm_box(
    study: Study, design: Design, *, payloads: int = MOST_PAYLOADS, twin: bool = True
) -> ArmBox | None:
    """Return the arm of a design; `payloads`: their number on the slider, 2 to 4 kB
    each; with or without its twin.

    None if the model vibrates too fast for the law's period with every payload.
    """
    data = _data(design, *_law(study, design), payloads, twin)
    if not data["links"]:
        return None
    return ArmBox(
        _json(data),
        scoped("plots.js", *ARM_SCRIPTS),
        squeezed("arm_box.css"),
        data["twin"] is not None,
    )


def _json(data: Mapping[str, Any]) -> str:
    """JSON in which no HTML parser finds the end of its element."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False, ensure_ascii=True)
    # A rig name containing </script> would end the element, wherever it occurs in the
    # JSON.
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _law(study: Study, design: Design) -> tuple[Law, str]:
    """The law that the page runs, in double precision, and the Python code that creates
    it, identical to the bit.
    """
    if study.law is None or _is_own(study.law, design):
        law, python = study.law or design.law(), "design.law()"
    else:
        law, python = study.law, 'fl.load("law.json")'
    # The page starts in double precision, where the law equals the one that ships up to
    # rounding; single precision is a switch of the page.
    if law.precision != "double":
        law, python = law.in_precision("double"), f'{python}.in_precision("double")'
    if law.motor_loop is None:  # without it `simulate` would use an ideal motor loop
        law, python = (
            equip(law, design.rig, design.model),
            f"fl.extend.equip({python}, design.rig, design.model)",
        )
    return law, python


def _is_own(law: Law, design: Design) -> bool:
    try:
        return design.law().digest == law.digest
    # If the law of a design can no longer be created, the saved one is shown.
    except FieldError:
        return False


def _base64(parts: Iterable[Real]) -> str:
    return base64.b64encode(
        np.concatenate([np.ravel(part) for part in parts]).astype("<f8").tobytes()
    ).decode()


def _packed(data: bytes) -> str:
    """Compressed data (zlib) in base64, which the script unpacks."""
    return base64.b64encode(zlib.compress(data, 9)).decode()


def assumed_mass(design: Design) -> float:
    """Mass of the twin's link [kg]: the rig's, or an assumed one if it states none."""
    return design.rig.link.mass or DEFAULT_MASS


def _twin(
    design: Design, model: LinkModel, payloads: list[float], count: int
) -> dict[str, Any] | None:
    """The data of the twin; None if rig and model have no twin that fits into the
    engine.
    """
    mass = assumed_mass(design)
    try:
        twin = engine_twin(design.rig, model, payloads, mass) if payloads else None
    except FieldError:
        return None
    if twin is None:
        return None
    parts = [twin.rig, twin_noise(_SEED, count), twin.material, twin.arms]
    return {
        "numbers": _base64(parts),
        "elements": twin.elements,
        "modes": twin.modes,
        "mass": mass,
    }


def _data(
    design: Design, law: Law, python: str, count: int, twin: bool
) -> dict[str, Any]:
    """All data of the script; `python`: the code that creates the law; `count`: number
    of payloads.
    """
    rig, model, period = design.rig, design.model, law.period
    # 3.5 vibrations in each direction show how a move decays; at least two seconds each
    # way, so that a fast arm does not flicker, and at most the capacity of the engine's
    # buffers.
    swing = math.tau / max(abs(model.pole.imag), 1e-3)
    periods = min(LONGEST - 1, 2 * round(max(2.0, 3.5 * swing) / period))
    half = 0.5 * periods * period
    payloads, links = _links(design, period, periods * period, count)
    times = _times(half)
    # Sliders exceed the values of the rig, so that a gauge without noise can be tried
    # with noise.
    noise = max(0.05, 5 * rig.gauge.noise)
    return {
        "engine": _packed(engine_bytes()),
        # for the law, then for the motor's PID alone, which the page shows in
        # comparison
        "blocks": [
            base64.b64encode(one.in_precision(name).block).decode()
            for one in (law, motor_alone(law))
            for name in ("double", "single")
        ],
        # rig, noise and moves, then the links one after another
        "numbers": _base64(
            [
                np.array(list(engine_rig(rig, law, model).values())),
                engine_noise(_SEED, periods + 1),
                *(_move(time, half) for time in times),
                *(link.numbers for link in links),
            ]
        ),
        "periods": periods,
        "period": period,
        "half": half,
        "times": times,
        "payloads": payloads,
        "links": [[link.reals, link.pairs, int(link.second)] for link in links],
        "designed": list(design.payloads),
        "start": {
            "payload": _nearest(payloads, model.payload or rig.payloads.nominal),
            "time": _nearest(times, 0.5),
            "noise": rig.gauge.noise,
            "offset": rig.gauge.offset,
            "delay": rig.motor_loop.delay_samples,
        },
        "largest": {
            "noise": float(f"{noise:.1g}"),
            "offset": 0.3 * _torque(design),
            "delay": 20,
        },
        "length": rig.link.length,
        "torque": _torque(design),
        "voltage": rig.motor.voltage_limit
        if math.isfinite(rig.motor.voltage_limit)
        else 0.0,
        "twin": _twin(design, model, payloads, periods + 1) if twin else None,
        "law": python,
        "told": law.tracking is not None,
        "modes": list(MODES),
        "reasons": list(REASONS),
        "seed": _SEED,
    }


def _times(half: float) -> list[float]:
    """Durations of a move [s] that fit into half a run; scaled down if a run is too
    short for any of them.
    """
    longest = _LONGEST_SHARE * half
    scale = 1.0 if _TIMES[0] <= longest else longest / _TIMES[-1]
    return [
        float(f"{scale * time:.3g}")
        for time in _TIMES
        if scale * time <= longest * (1 + 1e-12)
    ]


def _torque(design: Design) -> float:
    """A round torque [N·m] above that of the model's moves: its stiffness times a
    deflection of 0.5 rad.
    """
    return float(f"{0.5 * design.model.stiffness:.1g}")


def _nearest(values: list[float], wanted: float) -> int:
    return min(
        range(len(values)), key=lambda index: abs(values[index] - wanted), default=0
    )


def _move(time: float, half: float) -> Real:
    """Breaks of the move forward and back, and the powers of its duration by which its
    coefficients are divided.

    The page computes the reference from them with the operations of `Path.derivative`
    in the same order.
    """
    there = smooth_step(1.0, time)
    back = there.then(smooth_step(-1.0, time, start=half - time))
    return np.array([*back.breaks[1:], time**3, time**4, time**5])


def _links(
    design: Design, period: float, span: float, count: int
) -> tuple[list[float], list[EngineLink]]:
    """Payloads from light to heavy [kg], round in grams, including those of the design;
    and their links.
    """
    low, high = design.payloads
    model, rig = design.model, design.rig
    own = {low, high, model.payload or rig.payloads.nominal}
    # Geometric spacing, since ω₀ varies with a power of the payload; two digits give
    # round grams. The design's payloads are always included, unrounded.
    spread = payloads_about(low, high, max(count - len(own), 2))
    masses = sorted(own | {float(f"{value:.2g}") for value in spread})
    payloads, links = [], []
    for payload in masses:
        try:
            links.append(engine_link(link_at(model, rig, payload), period, span))
        except FieldError:
            # the vibration is too fast for the period; the slider starts at a heavier
            # payload
            continue
        payloads.append(payload)
    return payloads, links
