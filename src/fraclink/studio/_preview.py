"""The preview during a drag: a design, its loop and its margins in a few milliseconds,
without a verdict.
"""

from __future__ import annotations

import base64
import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from fraclink._arm.box import ParameterBox, arms_of
from fraclink._arm.controller import Controller
from fraclink._arm.link import LinkModel
from fraclink._arm.rig import Rig
from fraclink._design import Design
from fraclink._design.assess import Links, feasibility_map, phase_shares
from fraclink._design.completed import design_for
from fraclink._display import number
from fraclink._law import Law
from fraclink._law.refit import refitted
from fraclink.errors import FraclinkError
from fraclink.studio._messages import Reply, checked_request, refusal, wanted_of
from fraclink.view._loops import payloads_about
from fraclink.view._text import grams
from fracsys.checks import Complex, Real

__all__ = ["Subject", "blocks_of", "fan_of", "map_of", "preview"]


_POINTS = 280
# Limits of the fan: corners of the box, and every fourth frequency. Six intervals have
# 64 corners, which at two payloads and 280 frequencies are 36 000 numbers for a shaded
# area.
_ARMS, _SKIPPED = (
    16,
    4,
)
# Cells of the map, about 10 ms each: margins from 10° to 100° in steps of ten.
_CROSSOVERS, _MARGINS = 17, 10
# limits of the map: multiple of the lightest link's ω₀ (in rad/s), and degrees of
# margin
_FASTEST, _WIDEST = (4.0, 100.0)


@dataclass(frozen=True)
class Subject:
    """The subject of a design: rig and link; and the last exact law, whose poles a
    preview uses.
    """

    rig: Rig
    model: LinkModel
    law: Law | None = None

    @cached_property
    def key(self) -> str:
        """Digest of rig and link: drawings of another pair are outdated."""
        return hashlib.sha256(repr((self.rig, self.model)).encode()).hexdigest()[:16]

    @cached_property
    def links(self) -> Links:
        """The link at the payloads of the margin plot, from well below the rig's range to
        well above it.
        """
        span = self.rig.payloads
        payloads = payloads_about(span.low, span.high)
        return Links(self.model, self.rig, payloads)

    @cached_property
    def frequencies(self) -> Real:
        """Frequencies of the Bode plots [rad/s]: from a tenth of the slowest mode, or
        lower, to the Nyquist frequency.
        """
        slowest = float(self.links.natural_frequencies.min()) ** (
            2.0 / self.model.order
        )
        nyquist = math.pi / self.rig.period
        return np.geomspace(min(0.1 * slowest, 0.01 * nyquist), nyquist, _POINTS)

    def axes(self) -> dict[str, Any]:
        """The axes, which are fixed during a drag: axes that follow the curves would hide
        its effect.
        """
        span = self.rig.payloads
        return {
            "frequencies": self.frequencies,
            "payloads": self.links.payloads,
            "rated": [span.low, span.nominal, span.high],
        }


def preview(
    subject: Subject,
    state: object,
    *,
    fan: bool = False,
    near: Controller | None = None,
) -> tuple[Reply, Controller | None]:
    """Return design, loop and margins of `state`, or the refusal that `fraclink design`
    would print; and the controller from which the next preview of a drag starts.

    A pure function of its arguments: no file is read or written, nothing is stored. The
    law of the answer, if there is one, is `refitted`, and its figures are a preview of
    those of the exact law. With `fan` the answer also contains arms of the box.
    """
    try:
        request = checked_request(state)
        # The law, and the nearest feasible request, are searched for when the handle is
        # released.
        options = wanted_of(request) | {"law": False, "nearest": False}
        design, assumptions = design_for(
            subject.rig, subject.model, near=near, **options
        )
        reply = _shown(subject, design, assumptions)
        curves = fan_of(design, subject.frequencies) if fan else {}
        head = {**reply.head, "of": subject.key}
        return Reply(head, {**reply.curves, **curves}), design.controller
    except FraclinkError as error:
        return refusal(error), near


def _shown(subject: Subject, made: Design, assumed: tuple[str, ...]) -> Reply:
    low, high = made.payloads
    nominal = made.rig.payloads.nominal
    # Always three curves: if the nominal payload is not a third one, the middle of the
    # range is used.
    three = (low, nominal if low < nominal < high else 0.5 * (low + high), high)
    links = np.array([made.natural_frequency(mass) for mass in three])
    logs = made.loop.log(subject.frequencies, links[:, None])
    margin = subject.links.margins(made.controller)
    head = {
        "preview": True,
        "three": three,
        "names": [grams(mass) for mass in three],
        "asked": {
            "gain_crossover": made.gain_crossover,
            "phase_margin_deg": math.degrees(made.phase_margin),
        },
        "controller": _controller(made),
        "facts": _facts(made),
        "findings": made.findings,
        "assumed": f"Assumed: {'; '.join(assumed)}." if assumed else "",
        "budget": [
            (share.element, math.degrees(share.phase))
            for share in phase_shares(made, made.gain_crossover_upper, links[0])
        ],
    }
    if subject.law is not None:
        # The poles of the last exact law with newly fitted residues: less than a
        # hundredth of the time of a new law.
        head["blocks"] = blocks_of(refitted(subject.law, made.controller)[0])
    gain, phase = _drawn(logs)
    curves = {"gain": gain, "phase": phase, "margin": np.degrees(margin)}
    return Reply(head, curves)


def _drawn(logs: Complex) -> tuple[Real, Real]:
    """Gain [dB] and phase [°] of the logarithms of a loop.

    An undamped mode has a pole on the axis: clipped far outside every plot, since
    float32 would carry infinities.
    """
    gain, phase = 20.0 * logs.real / math.log(10.0), np.degrees(logs.imag)
    return np.clip(gain, -300.0, 300.0), np.clip(phase, -7200.0, 7200.0)


def _controller(made: Design) -> dict[str, Any]:
    c = made.controller
    return {
        "k_d": c.derivative_gain,
        "beta": c.derivative_order,
        "delta": c.filter_time,
        "upper": made.gain_crossover_upper,
    }


def _facts(made: Design) -> list[tuple[str, str]]:
    """The key figures of a design, as a page shows and compares them."""
    c = made.controller
    return [
        ("ω_c", f"{number(made.gain_crossover)} rad/s"),
        ("φ_m", f"{number(math.degrees(made.phase_margin))}°"),
        ("k_d", number(c.derivative_gain)),
        ("β", number(c.derivative_order)),
        ("δ", f"{number(1e3 * c.filter_time, 3)} ms" if c.filter_time else "none"),
        ("n", str(c.filter_order)),
        ("ω̄_c", f"{number(made.gain_crossover_upper)} rad/s"),
    ]


def blocks_of(law: Law) -> list[str]:
    """Return the parameter blocks of `law` in both precisions for the engine in the
    page.
    """
    return [
        base64.b64encode(law.in_precision(name).block).decode()
        for name in ("double", "single")
    ]


# --- beside the loop: feasible requests, and arms of a box -------------------------------


def map_of(
    subject: Subject, state: object, going: Callable[[], object] = lambda: None
) -> dict[str, Any]:
    """Return the feasible pairs of crossover and margin: the noise gain of each cell,
    −1 if infeasible.

    It takes seconds: `going` is called before each cell, and may wait or raise.
    """
    request = checked_request(state)
    # ω₀ has the unit s^(−λ/2); ω₀^(2/λ) is the corresponding frequency [rad/s].
    slowest, fastest = (
        float(frequency) ** (2.0 / subject.model.order)
        for frequency in (
            subject.links.natural_frequencies.min(),
            subject.links.natural_frequencies.max(),
        )
    )
    crossovers = np.geomspace(0.5 * slowest, _FASTEST * fastest, _CROSSOVERS)
    margins = np.linspace(10.0, _WIDEST, _MARGINS)
    names = ("payloads", "filter_time")
    options = {name: request[name] for name in names if request[name] is not None}
    if "payloads" not in options:
        options["payloads"] = (subject.rig.payloads.low, subject.rig.payloads.high)
    noise = np.full((margins.size, crossovers.size), -1.0)
    feasible = margins.size
    for column, crossover in enumerate(crossovers):
        for row, margin in enumerate(margins[:feasible]):
            going()
            cell = feasibility_map(
                subject.model,
                subject.rig,
                gain_crossovers=[crossover],
                phase_margins=[math.radians(margin)],
                filter_order=request["filter_order"] or 1,
                **options,
            )
            if not cell.feasible.all():
                # what is infeasible remains so for every faster loop
                feasible = row
                break
            noise[row, column] = cell.noise_gain[0, 0]
    return {"crossovers": crossovers, "margins": margins, "noise": noise}


def fan_of(made: Design, frequencies: Real) -> dict[str, Real]:
    """Return gain [dB] and phase [°] of arms at the corners of the box of fit and rig,
    at both payloads.

    Every row is one arm; of more than sixteen corners, sixteen spread over them.
    """
    box = made.box if made.box is not None else ParameterBox.of(made.model, made.rig)
    arms = arms_of(box, made.model)
    sample = [
        arms[k] for k in np.unique(np.linspace(0, len(arms) - 1, _ARMS).astype(int))
    ]
    w = frequencies[::_SKIPPED]
    links = np.array([made.natural_frequency(mass) for mass in made.payloads])
    logs = np.concatenate(
        [arm.loop(made.controller, made.rig).log(w, links[:, None]) for arm in sample]
    )
    gain, phase = _drawn(logs)
    return {"fan_gain": gain, "fan_phase": phase}
