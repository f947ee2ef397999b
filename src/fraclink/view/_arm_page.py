"""The arm in a page: one HTML file in which the law of a study moves its model, with
the same bits as in the package.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fraclink._design import Design
from fraclink._display import number
from fraclink._files import write_text
from fraclink._simulate.arm import Twin
from fraclink._simulate.engine import TWIN_MODES
from fraclink.errors import FieldError
from fraclink.trials._study import Study
from fraclink.view._arm_box import MOST_PAYLOADS, arm_box, assumed_mass
from fraclink.view._pages import rendered, squeezed
from fraclink.view._tables import margins_table
from fraclink.view._text import grams, grams_between

__all__ = ["write_arm_page"]

_LARGEST = 160_000  # bytes of a page


def write_arm_page(study: Study, path: Path | str) -> Path:
    """Write a page in which the arm of `study` moves, one HTML file that loads nothing
    from the network, and return its path.

    The page runs the law of the design on the identified model, compiled from the
    package's own C to WebAssembly: a run in it equals `simulate` in every bit. Payload,
    move, noise, gauge offset and delay are sliders, faults are buttons. The page states
    as text what was promised, and for which payloads.

    Parameters
    ----------
    study
        what `run` returned or `load_study` read. Its design is needed; verdict and
        certificate are shown.
    path
        of the HTML file; it is written whole or not at all.

    Raises
    ------
    FieldError
        the study has no design, or a period too long for its model.
    MissingExtraError
        jinja2 is not installed.

    Examples
    --------
    >>> import tempfile
    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023")
    >>> design = fl.design(rig.model, rig, payloads=(0.020, 0.040), gain_crossover=12.0,
    ...                    phase_margin=fl.deg(50))
    >>> page = fl.view.write_arm_page(fl.trials.Study(rig=rig, design=design), tempfile.mkdtemp() + "/arm.html")
    >>> page.name, page.stat().st_size < 160_000
    ('arm.html', True)
    """
    if study.design is None:
        raise FieldError(
            "design",
            study.missing.get("design", "none"),
            "missing: there is no controller to move an arm with",
            "a study with a design",
            "make one: `fraclink run`, or `fraclink design` with --out design.json in the folder",
        )
    design, payloads, twin = study.design, MOST_PAYLOADS, True
    texts: dict[str, Any] = {
        "title": design.rig.name,
        "zone": grams_between(*design.payloads),
        "verdict": study.verdict,
        "headline": study.sentence,
        "certificate": study.certificate,
        "requirements": design.overview().tables[0],
        "margins": margins_table(
            design, sorted({*design.payloads, design.rig.payloads.nominal})
        ),
        "simulated": _simulated(design),
        "not_simulated": _not_simulated(design),
    }
    while True:
        arm = arm_box(study, design, payloads=payloads, twin=twin)
        if arm is None:
            raise FieldError(
                "rig.period",
                design.rig.period,
                "too long: the model vibrates too fast for it with every payload of the page",
                "a few samples in a period of the vibration",
                "shorten period in the rig file and design again, or identify the model again: see its ω₀",
            )
        style = squeezed("palette.css") + squeezed("report.css") + arm.style
        page = rendered(
            "arm.html",
            arm=arm,
            style=style,
            twin=_twin_simulated(design, twin_fits=arm.has_twin),
            **texts,
        )
        excess = len(page.encode()) - _LARGEST
        if excess <= 0 or payloads <= 5:
            write_text(path, page)
            return Path(path)
        # At least one fewer in every round, so that the loop ends; every link counts with
        # the largest size, so that not too many are dropped.
        payloads -= 1 + excess // 4000  # a link takes 2 to 4 kB
        # A fine slider is more useful than the twin, whose recorded noise takes many
        # bytes at a short period: the twin is left out before payloads become few.
        if twin and payloads < MOST_PAYLOADS // 2:
            payloads, twin = MOST_PAYLOADS, False


def _simulated(design: Design) -> list[str]:
    """Sentences on the effects that a run in the page includes."""
    rig, model = design.rig, design.model
    counts = rig.encoder.counts_per_revolution
    return [
        f"the link, of order λ = {number(model.order, 4)} and stiffness "
        f"{number(model.stiffness, 4)} N·m/rad: {model.sentence}",
        "a motor with inertia, viscous and Coulomb friction, driven by the law's own motor loop",
        f"an encoder with {counts} counts per revolution"
        if counts
        else "an encoder without steps",
        f"a gauge with noise, offset and a range of ±{number(rig.gauge.limit)} N·m",
        f"the shipped law (law.c) with its guards, run every {number(1e3 * rig.period)} ms",
    ]


def _twin_simulated(design: Design, *, twin_fits: bool) -> list[str]:
    """Sentences on the effects added by the switch "twin", or why there is none."""
    mass, model = assumed_mass(design), design.model
    try:
        twin = Twin.from_rig(design.rig, model=model, link_mass=mass, modes=TWIN_MODES)
    except FieldError as error:
        return [f"there is no twin in this page: {error}"]
    if not twin_fits:
        return [
            "there is no twin in this page: at this sampling period it would be too large"
        ]
    remark = "" if design.rig.link.mass else ", assumed because the rig file gives none"
    return [
        f"a link with a mass of {grams(mass)}{remark}: its second mode moves tip and gauge",
        "the torque of the link acts on the motor, and the law compensates it from the gauge's reading",
        f"a motor that sticks: it breaks away at {number(twin.breakaway)} N·m and slides at "
        f"{number(twin.coulomb)} N·m",
        *(finding.message for finding in twin.findings),
    ]


def _not_simulated(design: Design) -> list[str]:
    """Sentences on the effects that are not simulated."""
    higher = (
        "higher modes"
        if design.model.second_mode
        else "the second and all higher modes"
    )
    return [
        f"the mass of the link, and so {higher} in the motion of the tip",
        "the link's torque on the motor: it is assumed to be compensated exactly, even without a gauge",
        "contact, gravity, play and elasticity of the gear, heat, wear",
        "anything about the arm that the log did not show",
    ]
