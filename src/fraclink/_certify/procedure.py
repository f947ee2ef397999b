"""`certify`: prove that a law keeps its distance from -1 for every payload and delay,
or say where not.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Annotated

from scipy.optimize import brentq

from fraclink._arm.box import ParameterBox
from fraclink._arm.controller import Controller, closed_loop_poles
from fraclink._arm.link import LinkModel
from fraclink._arm.loop import with_payload
from fraclink._arm.rig import Rig
from fraclink._certify.enclosure import BoxLoop
from fraclink._certify.guards import check_guards
from fraclink._certify.numeric import loop_values, windings, worst_distance
from fraclink._certify.search import MarginFailure, MarginProof, prove
from fraclink._certify.statement import AXES, Certificate, Statement, state
from fraclink._law import Law, discretize_controller
from fraclink._law.design import Design
from fraclink._law.limits import JUMP
from fraclink.errors import FieldError
from fracsys.checks import Between, Ordered, Payload, checked, checked_between

__all__ = ["certify"]

PayloadRange = Annotated[tuple[Payload, Payload], Ordered()]
ModulusMargin = Annotated[float, Between(0.0, 1.0, low_open=True)]
# Least |1 + L| of a loop that is passed: 14.4° of phase and a factor of 1.33 of gain
# either way, whatever else differs from the box.
LEAST_MODULUS = 0.25
# Between what a search finds and what is claimed. Half of it costs 3 to 7 % more leaves
# on four claims, a fifth of it up to 19 %.
_ROOM = 0.005
# Nodes of the first proof, and of those with smaller claims that follow where it ends
# without one: a claim that leaves more room takes fewer, so these give up early.
_NODES = (80_000, *7 * (20_000,))


@checked
def certify(
    subject: Design | Controller | Law,
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
    stands in the way of the moves it states; tools/check_certificate.py checks it with
    other arithmetic against the files of `export_c`.

    The certificate says ``passed``, ``verdict``, and where it fails the payload, the
    frequency and what was found there.

    Parameters
    ----------
    subject
        a design; or a controller or a law, then `model` and `rig` are needed.
    model, rig
        the link and the rig; the design's own when left out.
    payloads
        (lightest, heaviest) [kg], > 0; the design's or the rig's when left out.
    delay
        (shortest, longest) computation delay [s], at most Ts apart where the law closes
        the motor loop; the last of the motor loop's periods of delay when left out.
    modulus_margin
        m, 0 < m < 1; a hundredth or two below what a search finds when left out, and
        then not below 0.25: a loop that comes closer does not pass.
    law
        the law to prove, where the design's own is not meant (double precision, another
        order).
    box
        what the arm may be; when left out the box that the design was made for, else
        ``ParameterBox.of(model, rig)``: the fit's intervals and at least the rig's
        tolerances. ``ParameterBox.at(model)`` is the model itself.
    others
        models of the same arm from other logs: the box is widened until it holds them,
        too.

    Raises
    ------
    FieldError
        a value is out of its range, or λ = 2 without damping.

    Examples
    --------
    >>> import fraclink as fl
    >>> from fraclink._certify import certify
    >>> rig = fl.Rig.named("paper-2023")
    >>> wanted = {"gain_crossover": 12.0, "phase_margin": fl.deg(50), "filter_time": 0.0}
    >>> design = fl.design(rig.model, rig, payloads=(0.020, 0.040), **wanted)
    >>> certificate = certify(design, modulus_margin=0.35)
    >>> certificate.passed
    True
    """
    claim, proper = _statement(subject, model, rig, payloads, delay, law, box, others)
    check_guards(claim)
    if modulus_margin is not None:
        claim = replace(claim, modulus=modulus_margin)
    # In plain floating point first: a loop that is unstable, or too close already, is
    # told in milliseconds, and the branch and bound would only run out of nodes on it.
    unstable = windings(claim, proper)
    if unstable is not None:
        return _unstable(claim, subject, model, unstable)
    distance, place = worst_distance(claim, proper)
    if modulus_margin is None:
        found = _largest_claim(claim, proper, distance, place)
        if found.passed and found.statement.modulus < LEAST_MODULUS:
            return _too_close(replace(claim, modulus=LEAST_MODULUS), distance, place)
        return found
    if distance <= claim.modulus:
        return _too_close(claim, distance, place)
    return _proved(claim, distance)


def _largest_claim(
    claim: Statement, law: Law, distance: float, place: dict[str, float]
) -> Certificate:
    """Prove the largest claim of three digits that leaves `_ROOM`, or a smaller one
    where that is refuted.
    """
    loop, step = BoxLoop(claim), _ROOM
    # The proof holds fewer aliases than the loop has and allows for the rest by a
    # bound: that much less is claimed.
    kept = distance - loop.alias_at(place) - _ROOM
    for most in _NODES:
        claim = replace(claim, modulus=max(math.floor(1000.0 * kept) / 1000.0, 0.001))
        if distance <= claim.modulus:
            break
        outcome = prove(BoxLoop(claim), most=most)
        if isinstance(outcome, MarginProof) or "frequency" not in outcome.place:
            return _certificate(claim, outcome, distance)
        place = outcome.place
        found = float(abs(1.0 + loop_values(claim, law, place["frequency"], place)))
        # Refuted: the next claim is what is left there. Else the bounds are too wide
        # somewhere, nobody knows by how much: each step is twice the last.
        step = step if outcome.refuted else 2.0 * step
        left = found - loop.alias_at(place) - _ROOM
        distance, kept = (
            min(distance, found),
            min(kept, left) if outcome.refuted else kept - step,
        )
    if distance > claim.modulus:
        return _certificate(claim, outcome, distance)
    return _too_close(claim, distance, place)


def _proved(claim: Statement, distance: float) -> Certificate:
    return _certificate(claim, prove(BoxLoop(claim)), distance)


def _certificate(
    claim: Statement, outcome: MarginProof | MarginFailure, distance: float
) -> Certificate:
    if isinstance(outcome, MarginProof):
        return Certificate(claim, True, claim.words(), outcome.tree, outcome.leaves)
    if outcome.refuted:
        return _too_close(claim, outcome.distance, outcome.place)
    reason = f"Not certified: {outcome.reason} {_where(claim, outcome.place)}"
    return _failed(
        claim,
        f"{reason}; a search finds |1 + L| = {distance:.4g}",
        outcome.place,
        distance,
    )


def _failed(
    claim: Statement,
    verdict: str,
    place: dict[str, float],
    distance: float | None = None,
) -> Certificate:
    return Certificate(
        claim,
        False,
        verdict,
        payload=_payload_at(claim, place),
        frequency=place["frequency"],
        delay=place["delay"],
        distance=distance,
        place=tuple(place.items()),
    )


def _payload_at(claim: Statement, place: dict[str, float]) -> float:
    """The payload [kg] of the range that has this q with a softness as close to the
    middle as there is.
    """
    # Payload and the frequency's own doubt enter as one product q: many pairs give the
    # place that was found.
    return min(
        max(place["softness"] / claim.softness, claim.payload_low), claim.payload_high
    )


def _where(claim: Statement, place: dict[str, float]) -> str:
    """Where that is: payload, frequency and delay, and whatever else is not exact."""
    words = (
        f"at {_payload_at(claim, place) * 1e3:.4g} g, {place['frequency']:.6g} rad/s and "
        f"{place['delay'] * 1e3:.4g} ms of delay"
    )
    low, high = claim.box
    names = [name for name in AXES[3:] if low[name] < high[name]]
    rest = ", ".join(f"{name.replace('_', ' ')} {place[name]:.4g}" for name in names)
    return f"{words} ({rest})" if rest else words


def _statement(
    subject: Design | Controller | Law,
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
        allowed = "a law of an arm: the proof knows its motor, link and gauge, and no other plant"
        remedy = (
            "PidTuning.sampled_margins computes this loop's margins, which is no proof"
        )
        given = "a fractional PID's law"
        raise FieldError(
            "subject", given, "of another plant", allowed=allowed, remedy=remedy
        )
    if model is None or rig is None:
        raise FieldError(
            "model" if model is None else "rig",
            None,
            "missing",
            allowed="a link model and a rig",
            remedy="give both beside a controller or a law, or certify a design",
        )
    if isinstance(subject, Controller):
        law = law or discretize_controller(subject, rig.period, link=model, rig=rig)
    chosen = law if law is not None else subject
    # both branches above gave a law
    assert not isinstance(chosen, (Design, Controller))  # noqa: S101
    period = chosen.period
    # From none to a whole period is what a board may take to compute; the design
    # counted on one of them, and on whole periods of delay before it.
    inner = subject.motor_loop if isinstance(subject, Design) else rig.motor_loop
    whole = max(inner.delay_samples - 1, 0) * period
    first, last = (whole, whole + period) if delay is None else delay
    first = checked_between("delay[0]", first, 0.0, 8.0 * period, "s")
    most = 8.0 * period
    if chosen.drive is not None:
        # within one period: between two the sampled motor loop has another order
        most = (math.floor(first / period * (1 + 1e-9)) + 1) * period
        if last == first:
            most = max(most, last)
    last = checked_between("delay[1]", last, first, most, "s")
    link = with_payload(model, rig)
    box = ParameterBox.of(link, rig) if box is None else box
    claim = state(
        chosen,
        link,
        rig,
        box=box.with_others(others, link, rig),
        payloads=payloads or (rig.payloads.low, rig.payloads.high),
        nominal_payload=0.0,
        delay=(first, last),
        # A placeholder: the caller puts what is to be claimed.
        modulus=0.5,
    )
    return replace(
        claim, nominal_payload=_nominal_payload(chosen, _middle(claim, link))
    ), chosen


def _middle(claim: Statement, link: LinkModel) -> LinkModel:
    """The link in the middle of the claim's intervals, as the checker takes it."""
    payload = _known(link.payload)
    return replace(
        link,
        natural_frequency=(claim.softness * payload) ** -0.5,
        order=0.5 * (claim.order_low + claim.order_high),
        damping=0.5 * (claim.damping_low + claim.damping_high),
    )


def _known(payload: float | None) -> float:
    assert payload is not None  # with_payload gave it one  # noqa: S101
    return payload


def _nominal_payload(law: Law, link: LinkModel) -> float:
    """Return the payload [kg] at which `link` has the resonance that the law's limits
    were derived from.

    It ties the statement's link to the block on the board: a forged link has another
    resonance.
    """
    # The limits were derived as 1 − e^(−ω T/JUMP) of the link's resonance ω: solved for
    # it here.
    wanted = -JUMP / law.period * math.log1p(-law.limits.reference_rate)

    def beyond(log_payload: float) -> float:
        return math.log(abs(link.at_payload(math.exp(log_payload)).pole) / wanted)

    try:
        # From a milligram to ten tonnes: whatever arm a link model stands for lies
        # between.
        payload = math.exp(
            brentq(beyond, math.log(1e-6), math.log(1e4), xtol=1e-14, rtol=1e-14)
        )
        # Six digits are written into the statement; the checker forms the resonance
        # from what is written, not from what was found.
        return float(f"{payload:.6g}")
    except ValueError as error:
        raise FieldError(
            "law.limits.reference_rate",
            law.limits.reference_rate,
            "not that of this link at any payload",
            allowed="a law that was made for this link",
            remedy="discretise the controller with this link",
        ) from error


def _unstable(
    claim: Statement,
    subject: Design | Controller | Law,
    model: LinkModel | None,
    place: dict[str, float],
) -> Certificate:
    poles: tuple[complex, ...] = ()
    controller = subject.controller if isinstance(subject, Design) else subject
    link = subject.model if isinstance(subject, Design) else model
    text = ""
    if isinstance(controller, Controller) and link is not None:
        at = replace(
            link,
            natural_frequency=place["softness"] ** -0.5,
            order=place["order"],
            damping=place["damping"],
        )
        ideal = claim.motor_loop == "ideal"
        pole = (
            place["motor"]
            if ideal
            else (controller.inner.pole if controller.inner else 80.0)
        )
        poles = tuple(
            complex(p) for p in closed_loop_poles(controller, at, inner_pole=pole)
        )
        if poles and poles[0].real > 0.0:
            text = f"; poles {poles[0].real:+.3f} ± {abs(poles[0].imag):.2f}j rad/s without hold and delay"
    payload = _payload_at(claim, place)
    verdict = (
        f"Not certified: unstable at {payload * 1e3:.4g} g with {place['delay'] * 1e3:.3g} ms of delay; "
        f"L passes left of -1 near {place['frequency']:.4g} rad/s{text}"
    )
    return replace(_failed(claim, verdict, place), poles=poles)


def _too_close(
    claim: Statement, distance: float, place: dict[str, float]
) -> Certificate:
    verdict = f"Not certified: |1 + L| = {distance:.4g} is not above {claim.modulus:g} {_where(claim, place)}"
    return _failed(claim, verdict, place, distance)
