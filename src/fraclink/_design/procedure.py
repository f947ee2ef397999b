"""`design`: from a specification to a design, or to the reason why there is none.

The solver meets every row of the requirements at every arm that is asked for. Beside it
stands the procedure as it was published, with its closed form (section 6, (54)–(57)).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.box import ParameterBox, in_loop
from fraclink._arm.draft import doubts_of
from fraclink._arm.link import LinkModel
from fraclink._arm.loop import with_payload
from fraclink._arm.rig import Rig
from fraclink._design.box_cost import cost_of_box
from fraclink._design.measured import requirements_of
from fraclink._design.published import improper, is_published, published
from fraclink._design.request import Request, Solved
from fraclink._design.solver import RESERVE, Goal
from fraclink._law.design import Design, Requirement, Specification
from fraclink._law.rows import key_of
from fraclink.errors import FieldError, InfeasibleError
from fracsys.checks import checked_between, checked_noun

if TYPE_CHECKING:
    from fraclink._identify import Fit

__all__ = ["design", "request_of"]

Real = NDArray[np.float64]

# Rows that the engine measures a little short, or that the law loses, are asked for
# with that much more in reserve: the law's own error is nearly the same in each round.
_ROUNDS = 4
# Beyond the edge, relative, by which an offer may exceed it to pass with its law.
_LOOSER = (0.0, 0.01, 0.1)
_BOX = "ParameterBox.of(model, rig), or True for it"


def design(
    model: LinkModel | Fit,
    rig: Rig,
    *,
    payloads: tuple[float, float] | None = None,
    natural_frequencies: tuple[float, float] | None = None,
    gain_crossover: float | None = None,
    phase_margin: float | None = None,
    margins: Literal["loop", "ideal"] = "loop",
    filter_time: float | None = None,
    filter_order: int | None = None,
    inner: Literal["ideal", "sampled"] = "ideal",
    placement: Literal["tustin", "direct"] = "tustin",
    max_sensitivity: float | None = None,
    noise_gain: float | None = None,
    settling_time: float | None = None,
    mode_gain: float | None = None,
    box: ParameterBox | bool | None = None,
    goal: Goal | None = None,
    procedure: Literal["solver", "published"] = "solver",
    law: bool = True,
    nearest: bool = True,
) -> Design:
    """Design ``C(s) = 1 + k_d s^β/(1 + δs)^n`` that keeps every requirement at every
    payload of a range.

    Where no such C keeps the bound at the link's second mode, a notch there is a factor
    of its second term. k_d, β and δ are chosen so that the goal is best while every row is kept: what is
    asked for here, and what any loop needs (nothing crosses beyond the motor loop,
    moves do not ring, the empty gripper is stable, noise leaves half of the voltage,
    the law as it ships keeps the margins). Nothing asked for, the design is the fastest
    that keeps all of this at Ms <= 2, for everything that fit and rig leave open.

    The result has the controller and the table of requirements with what is achieved.
    It does not pass where the fit failed a gate, or where model or payloads contradict
    the rig (W105, W106).

    Parameters
    ----------
    model
        the link, or the fit that found it; its ``order``, ``damping`` and, where
        ``payload`` is known, its own ω₀ are used, and everything that was identified of
        the gauge.
    rig
        motor loop, sampling period, payloads and stiffness.
    payloads
        (lightest, heaviest) [kg], > 0; the rig's own when neither range is given.
    natural_frequencies
        (low, high) ω₀ [s^(-λ/2)] instead of payloads.
    gain_crossover
        smallest ω_c [rad/s], > 0; with neither it nor `settling_time` the highest is
        looked for, and nine tenths of it kept with the least noise.
    phase_margin
        smallest φ_m [rad], 0 < φ_m < π; ``deg(50)`` for 50 degrees; with neither it nor
        `max_sensitivity` Ms is 2 at most.
    margins
        "loop": filter, motor loop, half a sample of hold and the computation delay are
        part of the loop. "ideal": the paper's reading, Ĉ·G alone (published procedure).
    filter_time
        δ [s] >= 0; zero for none; chosen when left out.
    filter_order
        n, 1 or 2; chosen when left out.
    inner
        "ideal" (M(s) of eq. (21)) or "sampled" (the PID at the control period, on the
        motor). The law is judged with the sampled one in either case.
    placement
        for the sampled motor loop: "tustin" discretises (19), (20); "direct" places its
        poles in z.
    max_sensitivity
        bound on Ms = max 1/|1 + L|, > 1.
    noise_gain
        bound on the motor reference's RMS for white gauge noise of RMS one, > 0.
    settling_time
        bound on 2π/ω_c [s], > 0.
    mode_gain
        bound on the loop gain at the higher modes of the link, > 0. Below one no phase
        of the mode can destabilise it. Where the model knows a second mode or the rig
        the link's mass, the bound is 0.5 unless another is given.
    box
        arms that must keep every requirement: a `ParameterBox`; True for
        ``ParameterBox.of(model, rig)``, the fit's intervals and at least the rig's
        ``[tolerances]``; False for the model alone, which None means, too, where a
        crossover or a margin is asked for. Finding W407 says what it costs, and of
        which parameter. The design remembers it, and `certify` proves it.
    goal
        "noise": least noise at the motor reference; "settling": highest crossover;
        "margin": largest phase margin. "noise" where a crossover is asked for, else
        "settling".
    procedure
        "published": the paper's closed form instead (section 6, eqs. (54)–(57)), which
        meets the crossover at the heaviest payload and the margin at the lightest with
        equality, with a filter that costs 10 % of the margin, and knows no other
        requirement.
    law
        whether to fit the law that ships, too: its margins are requirements like any
        other. Without it nothing is said of the law.
    nearest
        False: a refusal does not look for the nearest request that passes.

    Raises
    ------
    FieldError
        a value is out of its range.
    InfeasibleError
        no controller of this form meets the request; names the requirement that is in
        the way, and the nearest request that passes.

    Examples
    --------
    >>> from fraclink._design import deg, design
    >>> from fraclink._arm.rig import Rig
    >>> rig = Rig.named("paper-2023")
    >>> wanted = {"gain_crossover": 12.0, "phase_margin": deg(50)}
    >>> found = design(rig.model, rig, payloads=(0.020, 0.040), **wanted)
    >>> round(found.controller.order, 2), found.passed
    (1.67, True)
    >>> paper = design(rig.model, rig, **wanted, filter_time=0.0, procedure="published")
    >>> round(paper.controller.gain, 6), round(paper.controller.order, 6), paper.passed
    (0.069876, 0.612197, True)
    """
    spec = Specification(
        payloads=payloads,
        natural_frequencies=natural_frequencies,
        gain_crossover=gain_crossover,
        phase_margin=phase_margin,
        margins=margins,
        filter_time=filter_time,
        filter_order=filter_order,
        inner=inner,
        placement=placement,
        max_sensitivity=max_sensitivity,
        noise_gain=noise_gain,
        settling_time=settling_time,
        mode_gain=mode_gain,
    )
    link = _link_of(model, rig)
    try:
        if is_published(procedure, spec, box):
            made = published(link, rig, spec)
            made = made.warned_of_law() if law else made
        else:
            made = _solved(link, rig, spec, box, goal, law=law, nearest=nearest)
    except InfeasibleError as error:
        # A payload in grams or the model of another arm is refused for reasons that
        # hide the cause.
        doubts = "; ".join(
            finding.message for finding in doubts_of(rig, link, payloads or ())
        )
        if not doubts:
            raise
        explanation = f"{error.explanation}; but {doubts}"
        raise InfeasibleError(error.condition, explanation, error.nearest) from error
    return made.doubted(getattr(model, "findings", ()))


# ---- the solver ---------------------------------------------------------------------------------------------


def _solved(
    link: LinkModel,
    rig: Rig,
    spec: Specification,
    box: ParameterBox | bool | None,
    goal: Goal | None,
    *,
    law: bool,
    nearest: bool,
) -> Design:
    """The design of a specification; InfeasibleError where there is none, with the
    nearest one that there is.
    """
    request = request_of(link, rig, spec, box, goal)
    made, slack = _best(request, law=law)
    if _kept(made):
        return _with_cost(made)
    condition, sentence = _in_the_way(request, made, slack)
    # where what is not the user's is missed, no other request of his is known to pass
    near = nearest and slack < math.inf
    raise InfeasibleError(
        condition, sentence, _offer(request, made, law=law) if near else {}
    )


def request_of(
    link: LinkModel,
    rig: Rig,
    spec: Specification,
    box: ParameterBox | bool | None,
    goal: Goal | None = None,
) -> Request:
    """Return what the solver is asked: every number settled, FieldError for what
    contradicts the arm.
    """
    known = with_payload(link, rig)
    speed = spec.gain_crossover is not None or spec.settling_time is not None
    margin = spec.phase_margin is not None or spec.max_sensitivity is not None
    if box is None and not speed and not margin:
        box = True  # nothing asked: what fit and rig leave open is kept, too
    arms = None
    if box:
        arms = (
            ParameterBox.of(known, rig)
            if box is True
            else checked_noun("box", box, ParameterBox, remedy=_BOX)
        )
    request = Request(
        known, rig, spec, arms, goal or ("noise" if speed else "settling")
    )
    request.check()
    return request


def _best(request: Request, *, law: bool) -> tuple[Design, float]:
    """The design of a request, with more in reserve until the engine
    and the law that ships find every row kept; the nearest one where none keeps them,
    and the slack that it needs.
    """
    solved = request.solved()
    for turn in range(_ROUNDS):
        made = _design_of(request, solved)
        if solved.solution.slack > 0.0:
            break
        made = made.with_law() if law else made
        if turn == _ROUNDS - 1:
            break
        reserves = _missed(request, made)
        if not reserves:
            break
        tighter = request.tightened(solved, reserves)
        if tighter.solution.slack > 0.0:
            break
        solved = tighter
    return made, solved.solution.slack


def _kept(made: Design) -> bool:
    """Whether every row is kept; what a fit or a rig leaves in doubt is another matter."""
    return all(item.passed for item in made.requirements)


def _missed(request: Request, made: Design) -> dict[str, float]:
    """By how much more than asked for each row that is missed has to be aimed at."""
    found: dict[str, float] = {}
    for item in made.requirements:
        if item.passed:
            continue
        key = key_of(item)
        if key == "delay_margin":
            more = -item.slack * request.highest
            found["phase_margin"] = max(found.get("phase_margin", 0.0), more)
            continue
        if key == "law_margin" or (key == "law_modulus" and item.achieved <= 0.0):
            key = "phase_margin"
        if item.unit == "rad" or key == "damping":
            found[key] = max(found.get(key, 0.0), -1.05 * item.slack + RESERVE)
        elif item.achieved > 0.0 and math.isfinite(item.achieved):
            ratio = abs(math.log(item.achieved / item.wanted))
            found[key] = max(found.get(key, 0.0), 1.5 * ratio + RESERVE)
    return found


def _design_of(request: Request, solved: Solved) -> Design:
    """The design of a solution, with every row as the engine measures it."""
    controller, (low, high) = solved.controller, request.natural_frequencies
    loop = request.arms[0].loop(controller, request.rig)
    reached = solved.problem.wanted.gain_crossover
    if reached is None:
        reached = float(loop.margins([low])[0][0])
    if request.gain_crossover is None:
        reached = _floored(reached)
    findings = doubts_of(request.rig, request.model, request.payloads)
    if not controller.is_strictly_proper:
        findings = (*findings, improper(controller))
    return Design(
        model=request.model,
        rig=request.rig,
        controller=controller,
        requirements=requirements_of(request, solved, reached),
        margins_kind="loop",
        payloads=request.payloads,
        natural_frequencies=(low, high),
        gain_crossover=reached,
        phase_margin=request.phase_margin,
        chi=controller.gain * reached**controller.order,
        gain_crossover_upper=float(loop.margins([high])[0][0]),
        findings=findings,
        box=request.box,
    )


def _with_cost(made: Design) -> Design:
    """The design with what its box costs."""
    if made.box is None:
        return made
    cost = cost_of_box(
        made.model, made.rig, made.controller, made.natural_frequencies, made.box
    )
    return replace(made, findings=(*made.findings, cost))


def _in_the_way(request: Request, made: Design, slack: float) -> tuple[str, str]:
    """(the row that is missed by most, the sentence that says by how much).

    The nearest controller gives of everything that was asked for, so that its figure is
    the best one only together with what the other rows give.
    """
    failed = [item for item in made.requirements if not item.passed]
    worst = max(failed, key=lambda item: abs(item.slack) / max(abs(item.wanted), 1e-3))
    wanted, achieved = worst.shown
    most = "at most" if worst.bound == "at least" else "at least"
    if slack == math.inf:
        most = "no controller was found with more than"
        if worst.bound == "at most":
            most = "no controller was found with less than"
    given = [
        f"{item.name} of {item.shown[1]} instead of {item.shown[0]}"
        for item in failed
        if item is not worst and _own_key(request, item) is not None
    ]
    even = f", even with a {' and a '.join(given)}" if given else ""
    late = made.model.gauge_delay
    crossing = made.gain_crossover_upper
    why = ""
    if late > 0.0 and math.degrees(late * crossing) > 5.0:
        why = (
            f": the gauge is {1e3 * late:.3g} ms late, which costs "
            f"{math.degrees(late * crossing):.0f}° at {crossing:.3g} rad/s"
        )
    return worst.name, (
        f"at {1e3 * worst.at_payload:.3g} g {most} {achieved} where {wanted} is asked for{even}{why}"
    )


def _offer(request: Request, made: Design, *, law: bool) -> dict[str, float]:
    """The nearest request in the user's own quantities, rounded inwards to three
    digits; empty where none near passes when it is followed.
    """
    for share in _LOOSER:
        values: dict[str, Any] = {}
        for item in made.requirements:
            key = _own_key(request, item)
            if key is None or not math.isfinite(item.achieved) or item.achieved <= 0.0:
                continue
            if item.passed and share == 0.0:
                continue
            asked = item.bound == "at least"
            if item.passed and key not in values and item.slack > share * item.wanted:
                continue
            edge = (
                min(item.achieved, item.wanted)
                if asked
                else max(item.achieved, item.wanted)
            )
            value = _rounded(
                key, edge * (1.0 - share if asked else 1.0 + share), down=asked
            )
            known = values.get(key)
            worse = known is None or (value < known if asked else value > known)
            if worse:
                values[key] = value
        if not values:
            continue
        try:
            spec = replace(request.spec, **values)
            trial, _ = _best(request.asking(spec), law=law)
        except FieldError:
            return {}
        if _kept(trial):
            return values
    return {}


def _own_key(request: Request, item: Requirement) -> str | None:
    """The user's own quantity behind a requirement, None where there is none."""
    key = key_of(item)
    if key == "phase_margin" and request.spec.phase_margin is None:
        return None
    if key == "gain_crossover" and request.gain_crossover is None:
        return None
    return key if key in (*request.soft, "settling_time") else None


def _rounded(key: str, value: float, *, down: bool) -> float:
    """The value with three digits, rounded to the side on which it is easier to meet;
    an angle in degrees.
    """
    if key == "phase_margin":
        return math.radians(_floored(math.degrees(value)))
    return _floored(value) if down else -_floored(-value)


def _floored(value: float) -> float:
    """The next lower number of three digits.

    >>> _floored(11.567), _floored(-0.12345)
    (11.5, -0.124)
    """
    if value == 0.0:
        return 0.0
    digit = 10.0 ** (2 - math.floor(math.log10(abs(value))))
    whole = math.floor(value * digit * (1.0 + math.copysign(1e-12, value)))
    return float(f"{whole / digit:.3g}")


def _link_of(model: LinkModel | Fit, rig: Rig) -> LinkModel:
    """The link of a model or a fit, with the gauge that the control loop has."""
    checked_noun("rig", rig, Rig, remedy="Rig.named or Rig.load make one")
    # A fit knows what it could not show; anything else that carries a model is taken at
    # its word.
    found = (
        model.loop_model(rig)
        if hasattr(model, "loop_model")
        else getattr(model, "model", model)
    )
    link = checked_noun(
        "model", found, LinkModel, remedy="give a fit, fit.model, or rig.model"
    )
    checked_between(
        "order",
        link.order,
        1.0,
        2.0,
        "(λ)",
        open_low=True,
        remedy="λ is 2 for a classical link",
    )
    return in_loop(link, rig)
