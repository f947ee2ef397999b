"""`certify`: prove that a law keeps its distance from -1 for every payload and delay,
or find where it does not.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Annotated

from scipy.optimize import brentq

from fraclink._arm.box import ParameterBox
from fraclink._arm.link import LinkModel
from fraclink._arm.loop import with_payload
from fraclink._arm.rig import Rig
from fraclink._certify.enclosure import LEAVES, BoxLoop
from fraclink._certify.guards import check_guards
from fraclink._certify.numeric import corner_loops, unstable_corner, worst_distance
from fraclink._certify.search import MarginFailure, prove
from fraclink._certify.statement import PARAMETERS, Certificate, Statement, state
from fraclink._law import Law
from fraclink._law.design import Design
from fraclink._law.limits import JUMP
from fraclink._law.requirement import LEAST_MODULUS
from fraclink.errors import FieldError
from fracsys.checks import Between, Payload, above, ascending, checked

__all__ = ["certify"]

PayloadRange = Annotated[tuple[Payload, Payload], ascending()]
# At infinite frequency the distance is one, so that no loop keeps more.
ModulusMargin = Annotated[float, above(0.0, 1.0, high_open=True)]
# Gap between the distance found by the search and the distance claimed. On four claims
# half this gap takes 3 to 7 % more leaves, and a fifth of it up to 19 % more.
_ROOM = 0.005
# Limit on the nodes for every claim but the smallest that passes.
_USUAL = 80_000
# Limit on the nodes for that one: half a gigabyte. A second mode with a damping ratio
# of 0.05 % at ±0.1 % takes half of it, and seven seconds.
_MOST = 1_000_000


@checked
def certify(
    subject: Design | Law,
    *,
    model: LinkModel | None = None,
    rig: Rig | None = None,
    payloads: PayloadRange | None = None,
    delay: tuple[float, float] | None = None,
    modulus_margin: ModulusMargin | None = None,
    law: Law | None = None,
    box: ParameterBox | None = None,
    others: Iterable[LinkModel] = (),
) -> Certificate:
    """Prove that the sampled loop is stable with ``|1 + L| > m`` for every payload,
    delay and arm of a box.

    The box holds the link's order, frequency and damping, the gauge's gain and delay,
    the second mode and the motor. The proof covers the law's exact coefficients, its
    motor loop as it is sampled, the zero-order hold and all aliases, and that no guard
    acts in the moves that the certificate states; tools/check_certificate.py checks it
    with other arithmetic against the files of `export_c`.

    The certificate contains ``passed`` and ``verdict`` and, where the proof fails, the
    payload, the frequency and the distance found there.

    Parameters
    ----------
    subject
        a design, or a law; a law needs `model` and `rig`, too.
    model, rig
        the link and the rig; the design's own when left out.
    payloads
        (lightest, heaviest) [kg], > 0; the design's or the rig's when left out.
    delay
        (shortest, longest) computation delay [s], at most Ts apart where the law closes
        the motor loop; when left out, from n − 1 to n periods for a motor loop with a
        delay of n periods, and from 0 to 1 for one without a delay.
    modulus_margin
        m, 0 < m < 1; when left out, as much as can be proved: usually within a
        hundredth of the distance that a search finds, and never below 0.25, since a
        loop that comes closer does not pass.
    law
        the law to prove, if not the design's own (double precision, another order).
    box
        the arms to cover; when left out the box that the design was made for, else
        ``ParameterBox.of(model, rig)``: the fit's intervals and at least the rig's
        tolerances. ``ParameterBox.at(model)`` is the model itself.
    others
        models of the same arm from other logs: the box is widened to include them, too.

    Raises
    ------
    FieldError
        a value is out of its range, or λ = 2 without damping.

    Examples
    --------
    >>> import fraclink as fl
    >>> from fraclink._certify import certify
    >>> rig = fl.Rig.named("paper-2023")
    >>> wanted = {"gain_crossover": 12.0, "phase_margin": fl.deg(50)}
    >>> design = fl.design(rig.model, rig, payloads=(0.020, 0.040), **wanted)
    >>> certificate = certify(design, modulus_margin=0.35)
    >>> certificate.passed
    True
    """
    claim, proper = _statement(subject, model, rig, payloads, delay, law, box, others)
    check_guards(claim)
    if modulus_margin is not None:
        claim = replace(claim, modulus=modulus_margin)
    # In plain floating point first: this detects an unstable loop, or one too close to
    # -1, in milliseconds, while branch and bound would only run out of nodes.
    loops = corner_loops(claim, proper)
    unstable = unstable_corner(loops)
    if unstable is not None:
        return _refused(claim, "unstable, as L passes left of -1", unstable)
    distance, place = worst_distance(claim, proper, loops)
    if modulus_margin is None:
        return _largest_claim(claim, distance, place)
    if distance <= claim.modulus:
        return _too_close(claim, distance, place)
    return _certificate(claim, prove(BoxLoop(claim), most=_USUAL), distance)


def _largest_claim(
    claim: Statement, distance: float, place: dict[str, float]
) -> Certificate:
    """Prove the largest claim of three digits that leaves the gap `_ROOM`, or a smaller
    one if that fails.
    """
    loop, step = BoxLoop(claim), _ROOM
    # This ends, since each refutation lowers the distance and each other failure
    # doubles the step.
    while True:
        # The proof includes only some of the aliases and bounds the rest: the claim is
        # reduced by that bound.
        margin = distance - loop.alias_at(place)
        if margin < LEAST_MODULUS + _ROOM:
            return _too_close(replace(claim, modulus=LEAST_MODULUS), distance, place)
        modulus = max(math.floor(1000.0 * (margin - step)) / 1000.0, LEAST_MODULUS)
        claim = replace(claim, modulus=modulus)
        last = modulus == LEAST_MODULUS
        outcome = prove(BoxLoop(claim), most=_MOST if last else _USUAL)
        if isinstance(outcome, str):
            break
        # If the claim is refuted, the next one follows from the distance at that place.
        # Otherwise some bounds are too wide by an unknown amount: the step is doubled.
        if outcome.refuted:
            distance, place = outcome.distance, outcome.place
        elif last:
            break
        else:
            step *= 2.0
    return _certificate(claim, outcome, distance)


def _certificate(
    claim: Statement, outcome: str | MarginFailure, distance: float
) -> Certificate:
    if isinstance(outcome, str):
        return Certificate(claim, outcome, sum(map(outcome.count, LEAVES)))
    if outcome.refuted:
        return _too_close(claim, outcome.distance, outcome.place)
    return _refused(
        claim,
        f"{outcome.reason}, while a search finds |1 + L| = {distance:.4g},",
        outcome.place,
        distance,
    )


def _too_close(
    claim: Statement, distance: float, place: dict[str, float]
) -> Certificate:
    return _refused(
        claim,
        f"|1 + L| = {distance:.4g} is not above {claim.modulus:g}",
        place,
        distance,
    )


def _refused(
    claim: Statement,
    reason: str,
    place: dict[str, float],
    distance: float | None = None,
) -> Certificate:
    """A certificate without proof, with the place of failure: payload, frequency,
    delay, and every other uncertain parameter.
    """
    # The payload and the uncertainty of ω₀ enter as one product q: of the pairs that
    # give this q, take the one whose softness is closest to the middle.
    payload = place["softness"] / claim.softness
    payload = min(max(payload, claim.payload_low), claim.payload_high)
    low, high = claim.box
    others = [
        f"{name.replace('_', ' ')} {place[name]:.4g}"
        for name in PARAMETERS[2:]
        if low[name] < high[name]
    ]
    where = (
        f"at {payload * 1e3:.4g} g, {place['frequency']:.6g} rad/s and "
        f"{place['delay'] * 1e3:.4g} ms of delay"
    )
    where += f" ({', '.join(others)})" if others else ""
    return Certificate(
        claim,
        refusal=f"Not certified: {reason} {where}",
        payload=payload,
        frequency=place["frequency"],
        delay=place["delay"],
        distance=distance,
        place=tuple(place.items()),
    )


def _statement(
    subject: Design | Law,
    model: LinkModel | None,
    rig: Rig | None,
    payloads: tuple[float, float] | None,
    delay: tuple[float, float] | None,
    law: Law | None,
    box: ParameterBox | None,
    others: Iterable[LinkModel],
) -> tuple[Statement, Law]:
    if isinstance(subject, Design):
        model, rig = model or subject.model, rig or subject.rig
        payloads, law = (
            subject.payloads if payloads is None else payloads,
            law or subject.law(),
        )
        box = subject.box if box is None else box
    if isinstance(subject, Law) and not subject.has_gauge:
        raise FieldError(
            "subject",
            "a fractional PID's law",
            "of another plant",
            "a law of an arm: the proof knows its motor, link and gauge, and no other plant",
            "PidTuning.sampled_margins computes this loop's margins, which is no proof",
        )
    if model is None or rig is None:
        raise FieldError(
            "model" if model is None else "rig",
            None,
            "missing",
            "a link model and a rig",
            "give both beside a law, or certify a design",
        )
    subject_law = law if law is not None else subject
    assert isinstance(subject_law, Law)  # a design has its own  # noqa: S101
    period = subject_law.period
    # The board may take between zero and one period to compute. The design assumed a
    # full period; any further periods of the motor loop's delay are always there.
    motor_loop = subject.motor_loop if isinstance(subject, Design) else rig.motor_loop
    whole = max(motor_loop.delay_samples - 1, 0) * period
    first, last = (whole, whole + period) if delay is None else delay
    first = Between(0.0, 8.0 * period, "s").check("delay[0]", first)
    most = 8.0 * period
    if subject_law.motor_loop is not None:
        # within one period: beyond it, the order of the sampled motor loop changes
        most = (math.floor(first / period * (1 + 1e-9)) + 1) * period
        if last == first:
            most = max(most, last)
    last = Between(first, most, "s").check("delay[1]", last)
    link = with_payload(model, rig)
    box = ParameterBox.of(link, rig) if box is None else box
    claim = state(
        subject_law,
        link,
        rig,
        box=box.with_others(others, link, rig),
        payloads=payloads or (rig.payloads.low, rig.payloads.high),
        delay=(first, last),
        # placeholder: the caller sets the claim
        modulus=0.5,
    )
    return replace(
        claim, nominal_payload=_nominal_payload(subject_law, claim.link)
    ), subject_law


def _nominal_payload(law: Law, link: LinkModel) -> float:
    """Return the payload [kg] at which `link` has the resonance that the law's limits
    were derived from.

    It ties the statement's link to the block on the board: a forged link has another
    resonance.
    """
    # The limits were derived as 1 − e^(−ω T/JUMP) from the resonance ω of the link;
    # solved for ω here.
    goal = -JUMP / law.period * math.log1p(-law.limits.reference_rate)

    def beyond(log_payload: float) -> float:
        return math.log(abs(link.at_payload(math.exp(log_payload)).pole) / goal)

    # From a milligram to ten tonnes, a range that contains the payload of any arm.
    ends = math.log(1e-6), math.log(1e4)
    if not beyond(ends[0]) > 0.0 > beyond(ends[1]):
        raise FieldError(
            "law.limits.reference_rate",
            law.limits.reference_rate,
            "not that of this link at any payload",
            "a law that was made for this link",
            "discretise the controller with this link",
        )
    # Rounded to six digits here: the file states this value, and the checker forms the
    # resonance from it.
    return float(f"{math.exp(brentq(beyond, *ends, xtol=1e-14, rtol=1e-14)):.6g}")
