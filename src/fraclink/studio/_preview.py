"""What a drag shows: a design, its loop and its margins, in a few milliseconds; no
promise is made by it.
"""

from __future__ import annotations

import base64
import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.link import LinkModel
from fraclink._arm.loop import with_payload
from fraclink._arm.rig import Rig
from fraclink._design import Design
from fraclink._design.assess import phase_budget
from fraclink._design.completed import design_for
from fraclink._display import number
from fraclink._law import Law
from fraclink._law.refit import refitted
from fraclink.errors import FieldError, FraclinkError, InfeasibleError
from fraclink.studio._messages import Reply, checked_request, refusal, wanted_of
from fraclink.studio._regions import fan_of, parted, violated
from fraclink.view._text import grams

__all__ = ["Subject", "blocks_of", "nearest", "preview"]

Real = NDArray[np.float64]

_POINTS, _PAYLOADS = 280, 49
_LIGHTER, _HEAVIER = 0.4, 2.0  # of the rig's payload range: where a margin is drawn
_DECIBELS = 20.0 / math.log(10.0)


@dataclass(frozen=True)
class Subject:
    """What is designed for: rig and link; and what a preview borrows of the last exact
    design.

    Of its `law` the poles.
    """

    rig: Rig
    model: LinkModel
    law: Law | None = None

    @cached_property
    def key(self) -> str:
        """Digest of rig and link: what is drawn of another pair is outdated."""
        return hashlib.sha256(repr((self.rig, self.model)).encode()).hexdigest()[:16]

    @cached_property
    def payloads(self) -> Real:
        """Payloads of the margin plot [kg]: the rig's range and as much again on both
        sides.
        """
        span = self.rig.payloads
        return np.geomspace(_LIGHTER * span.low, _HEAVIER * span.high, _PAYLOADS)

    @cached_property
    def link_frequencies(self) -> Real:
        """ω₀ of each of them [s^(-λ/2)]."""
        link = with_payload(self.model, self.rig)
        return np.array(
            [link.at_payload(float(mass)).natural_frequency for mass in self.payloads]
        )

    @cached_property
    def frequencies(self) -> Real:
        """Frequencies of the Bode plots [rad/s]: from a twentieth of the slowest mode
        to the Nyquist.
        """
        slowest = float(self.link_frequencies.min()) ** (2.0 / self.model.order)
        nyquist = math.pi / self.rig.period
        return np.geomspace(min(0.1 * slowest, 0.01 * nyquist), nyquist, _POINTS)

    def axes(self) -> dict[str, Any]:
        """What does not change while a hand drags: a page that scaled its axes would
        hide what it does.
        """
        span = self.rig.payloads
        return {
            "frequencies": self.frequencies,
            "payloads": self.payloads,
            "rated": [span.low, span.nominal, span.high],
        }


def preview(subject: Subject, state: object, *, fan: bool = False) -> Reply:
    """Return design, loop and margins of `state`, or the refusal that `fraclink design`
    would print.

    A plain function of its arguments: no file is read or written, nothing is
    remembered. The law of the answer, where there is one, is `refitted`, and its
    figures are a preview of those of the exact law. `state` may hold regions that the
    loop shall not enter; with `fan` the answer has arms of the box, too.
    """
    try:
        asked, regions = parted(state)
        request = checked_request(asked)
        # What is nearest to a refused request is looked for when the hand lets go.
        wanted = wanted_of(request) | {"nearest": False}
        made, assumed = design_for(subject.rig, subject.model, **wanted)
        shown = _shown(subject, made, assumed)
        entered = violated(made, regions, subject.frequencies) if regions else []
        words = [
            region.said(inside) for region, inside in zip(regions, entered, strict=True)
        ]
        head = dict(shown.head) | {
            "of": subject.key,
            "entered": entered,
            "regions": words,
        }
        return Reply(
            head,
            dict(shown.curves) | (fan_of(made, subject.frequencies) if fan else {}),
        )
    except FraclinkError as error:
        return refusal(error)


def nearest(subject: Subject, state: object) -> Reply:
    """Return the state nearest to a refused one: the offer of the refusal, which passed
    when it was followed.
    """
    request = checked_request(parted(state)[0])
    try:
        design_for(subject.rig, subject.model, **wanted_of(request))
        return Reply({"ok": True, "state": request})
    except InfeasibleError as error:
        offer = dict(error.nearest)
    if "phase_margin" in offer:
        margin = math.degrees(offer.pop("phase_margin"))
        offer["phase_margin_deg"] = float(f"{margin:.6g}")
    if offer:
        return Reply({"ok": True, "state": request | offer})
    raise FieldError(
        "state",
        "this request",
        "far from anything feasible",
        allowed="a request near one that is feasible",
        remedy="move crossover or margin by hand",
    )


def _shown(subject: Subject, made: Design, assumed: tuple[str, ...]) -> Reply:
    low, high = made.payloads
    nominal = made.rig.payloads.nominal
    # Three curves whatever the range: where the nominal payload is no third one, the
    # middle of the range is.
    three = (low, nominal if low < nominal < high else 0.5 * (low + high), high)
    links = np.array([made.natural_frequency(mass) for mass in three])
    logs = made.loop.log(subject.frequencies, links[:, None])
    crossover, margin = made.loop.margins(subject.link_frequencies)
    head = {
        "ok": True,
        "preview": True,
        "three": three,
        "names": [grams(mass) for mass in three],
        "asked": {
            "gain_crossover": made.gain_crossover,
            "phase_margin_deg": math.degrees(made.phase_margin),
        },
        "controller": _controller(made),
        "facts": _facts(made),
        "requirements": made.requirements,
        "findings": made.findings,
        "assumed": f"Assumed: {'; '.join(assumed)}." if assumed else "",
        "budget": _budget(made, low),
        "passed": made.passed,
        "said": described(made, subject.payloads, margin),
    }
    if subject.law is not None:
        # The poles of the last exact law with residues fitted anew: a fiftieth of the
        # time of a new law.
        head |= _quick(subject.law, made)
    curves = {
        # An undamped mode has a pole on the axis: clipped far outside of every plot, or
        # float32 would carry infinities.
        "gain": np.clip(_DECIBELS * logs.real, -300.0, 300.0),
        "phase": np.clip(np.degrees(logs.imag), -7200.0, 7200.0),
        "crossover": crossover,
        "margin": np.degrees(margin),
    }
    return Reply(head, curves)


def _controller(made: Design) -> dict[str, Any]:
    c = made.controller
    return {
        "k_d": c.derivative_gain,
        "beta": c.derivative_order,
        "delta": c.filter_time,
        "n": c.filter_order,
        "upper": made.gain_crossover_upper,
        "formula": c.formula,
    }


def _facts(made: Design) -> list[tuple[str, str]]:
    """What a design is known by, as a page shows it, and lays beside that of another
    one.
    """
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


def _budget(made: Design, payload: float) -> list[tuple[str, float]]:
    try:
        return [
            (share.element, math.degrees(share.phase))
            for share in phase_budget(made, payload)
        ]
    except FieldError:  # without a gain crossover there is no phase to share out
        return []


def _quick(law: Law, made: Design) -> Mapping[str, Any]:
    quick, error = refitted(law, made.controller)
    return {"blocks": blocks_of(quick), "law_error": error}


def blocks_of(law: Law) -> list[str]:
    """Return the parameter blocks of `law` in both precisions, as the engine in the
    page takes them.
    """
    return [
        base64.b64encode(law.in_precision(name).block).decode()
        for name in ("double", "single")
    ]


def described(made: Design, payloads: Real, margin: Real) -> str:
    """Return what the plot of margins shows, in a sentence for those who do not see it."""
    low, high = made.payloads
    # The plot's points are fixed while a hand drags the range: a narrow one may lie
    # between two of them.
    inside = (payloads >= low) & (payloads <= high)
    if not inside.any() or math.isnan(float(margin[inside].min())):
        return "No payload of the plot lies within the range designed for."
    ends = np.degrees(np.interp([low, high], payloads, margin))
    stable = payloads[margin > 0.0]
    rest = (
        "; stable from {:.3g} to {:.3g} g of the plot".format(*(1e3 * stable[[0, -1]]))
        if stable.size
        else ""
    )
    # A twentieth of a degree below the smaller end counts: less is the points' spacing.
    least = math.degrees(float(margin[inside].min()))
    # The points of the plot need not include the ends: said only where the middle is
    # worse than both.
    middle = f", least {least:.1f}° between" if least < ends.min() - 0.05 else ""
    both = f"{ends[0]:.1f}° at {1e3 * low:.3g} g, {ends[1]:.1f}° at {1e3 * high:.3g} g"
    return f"Phase margin {both}{middle}{rest}."
