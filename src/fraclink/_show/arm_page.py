"""The arm in a page: one HTML file in which the law of a study moves its model, with the package's bits."""

from __future__ import annotations

import base64
import hashlib
import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.link import LinkModel
from fraclink._arm.reference import smooth_step
from fraclink._design import Design
from fraclink._files import write_text
from fraclink._law import MODES, REASONS, Law
from fraclink._show import tables
from fraclink._show.pages import rendered, template_text
from fraclink._show.text import grams, number
from fraclink._simulate.engine import (
    LONGEST,
    EngineLink,
    engine_bytes,
    engine_link,
    engine_noise,
    engine_rig,
)
from fraclink._simulate.simulate import with_motor_loop
from fraclink._workflow import Study
from fraclink.errors import FieldError

__all__ = ["render_arm_page", "write_arm_page"]

Real = NDArray[np.float64]

_LARGEST = 150_000  # bytes of a page
_MOST_PAYLOADS = 24
_LIGHTEST, _HEAVIEST = 0.4, 2.0  # of the payloads designed for: 8 to 80 g for 20 to 40 g
_SCRIPTS = ("arm_engine.js", "arm_drawing.js", "arm_page.js")
SEED = 0
# The move goes there in the first half of the run and back in the second, so that the picture has no jump.
_TIMES = np.round(np.arange(0.2, 1.51, 0.05), 2)


def write_arm_page(study: Study, path: Path | str, *, title: str | None = None) -> Path:
    """Write the arm of `study` as a page that moves, one HTML file that asks nobody, and return its path.

    The page runs the law of the design on the identified model, compiled from the package's own C to
    WebAssembly: a run in it equals `simulate` in every bit. Payload, move, noise, gauge offset and delay are
    sliders, faults are buttons. What was promised, and for which payloads, stands in it as text.

    Parameters
    ----------
    study
        what `run` returned or `load_study` read. Its design is needed; verdict and certificate are shown.
    path
        of the HTML file; it is written whole or not at all.
    title
        of the page; the rig's name where it is left out.

    Raises
    ------
    FieldError
        the study has no design. MissingExtraError where jinja2 is not installed.

    Examples
    --------
    >>> import tempfile
    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023")
    >>> design = fl.design(rig.model, rig, payloads=(0.020, 0.040), gain_crossover=12.0,
    ...                    phase_margin=fl.deg(50))
    >>> page = fl.write_arm_page(fl.Study(rig=rig, design=design), tempfile.mkdtemp() + "/arm.html")
    >>> page.name, page.stat().st_size < 150_000
    ('arm.html', True)
    """
    write_text(path, render_arm_page(study, title=title))
    return Path(path)


def render_arm_page(study: Study, *, title: str | None = None) -> str:
    """Return the page as HTML; the same study gives the same bytes."""
    if study.design is None:
        raise FieldError(
            "design",
            study.stopped or "none",
            "missing: there is no controller to move an arm with",
            allowed="a study with a design",
            remedy="make one: `fraclink run`, or `fraclink design` with --out design.json in the folder",
        )
    design = study.design
    script = "(() => {\n'use strict';\n" + "".join(_squeezed(name) for name in _SCRIPTS) + "})();\n"
    style = _squeezed("arm.css")
    low, high = design.payloads
    said: dict[str, Any] = {
        "title": title or design.rig.name,
        "script": script,
        "style": style,
        "script_hash": _hash(script),
        "style_hash": _hash(style),
        "design": design,
        "zone": f"{number(1e3 * low)} to {number(1e3 * high)} g",
        "verdict": study.verdict,
        "headline": tables.verdict_sentence(study.verdict),
        "scopes": tables.scopes(study.verdict),
        "certificate": study.certificate,
        "requirements": tables.requirements_table(design.requirements),
        "margins": tables.margins_table(design, sorted({*design.payloads, design.rig.payloads.nominal})),
        "simulated": _simulated(design),
        "not_simulated": _not_simulated(design),
    }
    law = _law(study, design)
    count = _MOST_PAYLOADS
    while True:
        page = rendered("arm.html", data=_json(_data(design, law, count)), **said)
        excess = len(page.encode()) - _LARGEST
        if excess <= 0 or count <= 5:
            return page
        count -= 1 + excess // 4000  # a link takes 2 to 4 kB


def _squeezed(name: str) -> str:
    """A script or style without indentation and lines of comment: 5 kB, room for two more payloads."""
    lines = (line.strip() for line in template_text(name).splitlines())
    return "".join(f"{line}\n" for line in lines if line and not line.startswith(("//", "/*")))


def _hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _json(data: Mapping[str, Any]) -> str:
    """JSON that no parser of HTML takes for the end of its element."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False, ensure_ascii=True)
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _law(study: Study, design: Design) -> Law:
    """The law of the study where it has one: to make it again takes seconds."""
    law = study.law or design.law()
    return with_motor_loop(law, rig=design.rig, link=design.model)[0]


def _base64(parts: Iterable[Real]) -> str:
    return base64.b64encode(
        np.concatenate([np.ravel(part) for part in parts]).astype("<f8").tobytes()
    ).decode()


def _data(design: Design, law: Law, count: int) -> dict[str, Any]:
    """Everything that the script reads; `count`: how many payloads the slider has."""
    rig, model, period = design.rig, design.model, law.period
    swing = 2 * math.pi / max(abs(model.pole.imag), 1e-3)
    periods = min(LONGEST - 1, 2 * round(max(2.0, 3.5 * swing) / period))
    half = 0.5 * periods * period
    payloads, links = _links(design, period, periods * period, count)
    times = [float(time) for time in _TIMES if time <= 0.75 * half]
    noise = max(0.05, 5 * rig.gauge.noise)
    return {
        "engine": base64.b64encode(engine_bytes()).decode(),
        "blocks": [base64.b64encode(law.in_precision(name).block).decode() for name in ("double", "single")],
        # rig, noise, moves, then the links behind one another
        "numbers": _base64(
            [
                engine_rig(rig, law, model),
                engine_noise(SEED, periods + 1),
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
        "largest": {"noise": float(f"{noise:.1g}"), "offset": 0.3 * _torque(design), "delay": 20},
        "length": rig.link.length,
        "torque": _torque(design),
        "voltage": rig.motor.voltage_limit if math.isfinite(rig.motor.voltage_limit) else 0.0,
        "told": law.tracking is not None,
        "modes": list(MODES),
        "reasons": list(REASONS),
        "seed": SEED,
    }


def _torque(design: Design) -> float:
    """A round torque [N·m] that the model's moves stay below: its stiffness times a bend of 0.5 rad."""
    return float(f"{0.5 * design.model.stiffness:.1g}")


def _nearest(values: list[float], wanted: float) -> int:
    return int(np.argmin(np.abs(np.array(values) - wanted)))


def _move(time: float, half: float) -> Real:
    """Breaks of the move there and back, and the powers of its time that its coefficients are divided by.

    The page makes the reference from them by the operations of `Path.derivative`, in their order.
    """
    there = smooth_step(1.0, time)
    back = there.then(smooth_step(-1.0, time, start=half - time))
    return np.array([*back.breaks[1:], time**3, time**4, time**5])


def _links(design: Design, period: float, span: float, count: int) -> tuple[list[float], list[EngineLink]]:
    """Payloads from light to heavy [kg], round in grams, those designed for among them; and their links."""
    low, high = design.payloads
    model = design.model
    own = {low, high, model.payload or design.rig.payloads.nominal}
    spread = np.geomspace(_LIGHTEST * low, _HEAVIEST * high, max(count - len(own), 2))
    wanted = sorted(own | {float(f"{value:.2g}") for value in spread})
    payloads, links = [], []
    for payload in wanted:
        try:
            links.append(engine_link(_at(model, design, payload), period, span))
        except FieldError:
            continue  # too light a payload vibrates too fast for the period; the slider starts above it
        payloads.append(payload)
    return payloads, links


def _at(model: LinkModel, design: Design, payload: float) -> LinkModel:
    return model if payload == model.payload else model.at_payload(payload)


def _simulated(design: Design) -> list[str]:
    """Sentences on what a run in the page contains."""
    rig, model = design.rig, design.model
    link = f"the model of the link: λ = {number(model.order, 4)}, ω₀ = {number(model.natural_frequency, 4)}"
    if model.payload is not None:
        link += f" at {grams(model.payload)}"
    link += f", stiffness {number(model.stiffness, 4)} N·m/rad"
    if model.second_mode is not None:
        link += f", and a second mode at {number(model.second_mode.frequency, 4)} rad/s in the gauge"
    counts = rig.encoder.counts_per_revolution
    gauge = f"a gauge with noise, offset and a range of ±{number(rig.gauge.limit)} N·m"
    if model.gauge_delay > 0:
        gauge += f", {number(1e3 * model.gauge_delay, 2)} ms late"
    return [
        link,
        "a motor with inertia, viscous and Coulomb friction under the law's own motor loop",
        f"an encoder with {counts} counts per revolution" if counts else "an encoder without steps",
        gauge,
        f"the law that is shipped (law.c), one period every {number(1e3 * rig.period)} ms, with its guards",
    ]


def _not_simulated(design: Design) -> list[str]:
    """Sentences on what it leaves out."""
    missing = [
        "the torque of the link on the motor: it is taken as compensated without error, a lost gauge or not",
        "contact, gravity, play and elasticity of the gear, heat, wear",
        "whatever the log did not show of the arm",
    ]
    higher = "higher modes" if design.model.second_mode else "the second mode and all above"
    return [f"the mass of the link, and with it {higher} in the motion of the tip", *missing]
