"""`design`: from a specification to a design, or to the reason why none exists.

The solver meets every row of the requirements at every requested arm. The procedure as
published (section 6, (54)–(57)) is available alongside it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, Unpack

from fraclink._arm.box import ParameterBox, arms_of, in_loop
from fraclink._arm.controller import Controller
from fraclink._arm.draft import doubts_of
from fraclink._arm.link import LinkModel
from fraclink._arm.loop import with_payload
from fraclink._arm.rig import Rig
from fraclink._design.box_cost import arm_in_words, cost_of_box
from fraclink._design.published import published
from fraclink._design.request import Request
from fraclink._design.rows import RESERVE, specification
from fraclink._design.search import Solution, beside, solved
from fraclink._law.design import Design, Requirement, Specification
from fraclink.errors import InfeasibleError
from fracsys.checks import above, checked_choice, checked_noun

if TYPE_CHECKING:
    from fraclink._identify import Fit

__all__ = ["design", "link_of", "request_of", "sketched"]

Goal = Literal["noise", "settling", "margin"]

# In each round, the sampled law's cost to a row is added to the row's reserve; the cost
# is nearly the same every time.
_ROUNDS = 4
# Share of the fastest crossover or of the largest margin: the last tenth costs most,
# since the fastest loop has no filter at all. (The published procedure also leaves a
# tenth to its filter.)
_SHARES = 0.9, 0.75, 0.5
# Shares by which the offered request is below what the nearest controller achieves, so
# that its law also passes.
_LOOSER = (0.0, 0.01, 0.1)


def design(
    model: LinkModel | Fit,
    rig: Rig,
    *,
    box: ParameterBox | bool | None = None,
    goal: Goal | None = None,
    procedure: Literal["solver", "published"] = "solver",
    law: bool = True,
    nearest: bool = True,
    **wanted: Unpack[Specification],
) -> Design:
    """Design ``C(s) = 1 + k_d s^β/(1 + δs)^n`` that keeps every requirement at every
    payload of a range.

    Where no such C keeps the bound at the link's second mode, its second term gets a
    notch there. k_d, β and δ are chosen so that noise is least while every row is
    kept: what is asked for here, and what any loop needs (nothing crosses beyond the
    motor loop, moves do not ring, the empty gripper is stable, noise leaves half of the
    voltage, the law as it ships keeps the margins). Without a request, the design is the
    fastest that keeps all of this at Ms <= 2, over the whole uncertainty of fit and rig.

    The result has the controller and the table of requirements with what is achieved;
    it passes if every row does. Where the fit failed a gate, or model or payloads
    contradict the rig (W105, W106), ``doubts`` says so, and the design does not pass.

    Parameters
    ----------
    model
        the link, or the fit that found it; its ``order``, ``damping``, gauge and, where
        ``payload`` is known, its own ω₀ are used.
    rig
        motor loop, sampling period, payloads and stiffness.
    box
        arms that must keep every requirement: a `ParameterBox`; True for
        ``ParameterBox.of(model, rig)``, the fit's intervals and at least the rig's
        ``[tolerances]``; False for the model alone; None means False if a speed or a
        margin is asked for, else True. Finding W407 says what the box costs, and which
        parameter costs most. The design meets every row over the box, and `certify` proves it.
    goal
        "settling": the highest crossover, if none is asked for; "margin": the largest
        phase margin; a tenth of either is traded for less noise. "noise": the least
        noise that keeps what is asked for.
    procedure
        "published": the paper's closed form instead (section 6, eqs. (54)–(57)), which
        considers Ĉ·G alone, meets the crossover at the heaviest payload and the margin at
        the lightest with equality, with a filter that costs 10 % of the margin, and
        knows no other requirement.
    law
        whether to fit the law that ships, too: its margins are requirements like any
        other. Without it nothing is said about the law.
    nearest
        whether a refusal names the nearest request that passes, which takes a search.
    wanted
        what is asked for, by the names of `Specification`, such as ``gain_crossover``
        [rad/s] and ``phase_margin`` [rad].

    Raises
    ------
    FieldError
        a value is out of its range.
    InfeasibleError
        no controller of this form meets the request; names the limiting requirement and
        the nearest request that passes. A contradiction between the rig and the model
        or the payloads is named instead, without such a request.

    Examples
    --------
    >>> from fraclink._design import deg, design
    >>> from fraclink._arm.rig import Rig
    >>> rig = Rig.named("paper-2023")
    >>> wanted = {"gain_crossover": 12.0, "phase_margin": deg(50)}
    >>> made = design(rig.model, rig, payloads=(0.020, 0.040), **wanted)
    >>> round(made.controller.derivative_order, 1), made.passed
    (1.7, True)
    >>> paper = design(rig.model, rig, **wanted, filter_time=0.0, procedure="published")
    >>> round(paper.controller.derivative_order, 3), paper.margins_kind
    (0.237, 'ideal')
    """
    spec = specification(wanted)
    checked_choice(
        "procedure",
        procedure,
        ("solver", "published"),
        remedy="leave it out for a design that keeps every row",
    )
    link = link_of(model, rig)
    # No design with a doubt passes, so no nearest request is searched for. Payloads in
    # grams, or the model of another arm, would be refused for reasons that hide the cause.
    doubts = doubts_of(rig, link, spec.get("payloads", ()))
    try:
        if procedure == "published":
            result = published(link, rig, spec, box)
            result = result.with_law() if law else result
        else:
            request = request_of(link, rig, spec, box)
            default: Goal = "noise" if request.speed is not None else "settling"
            offers = nearest and not doubts
            result = _solved(request, goal or default, law, offers)
    except InfeasibleError as error:
        if not doubts:
            raise
        causes = "; ".join(f"{one.message} ({one.remedy})" for one in doubts)
        sentence = f"{causes}; and so {error.condition}: {error.explanation}"
        raise InfeasibleError("contradiction", sentence) from error
    return result.doubted(getattr(model, "findings", ()))


def request_of(
    link: LinkModel,
    rig: Rig,
    spec: Mapping[str, Any],
    box: ParameterBox | bool | None,
) -> Request:
    """Return the request to the solver with all numbers resolved; FieldError for values
    that contradict the arm.
    """
    payload_model = with_payload(link, rig)
    goals = {"gain_crossover", "settling_time", "phase_margin", "max_sensitivity"}
    if box is None and not goals & set(spec):
        box = True  # nothing requested: also cover the uncertainty of fit and rig
    arms = ParameterBox.of(payload_model, rig) if box is True else None
    if box and arms is None:
        arms = checked_noun(
            "box",
            box,
            ParameterBox,
            remedy="ParameterBox.of(model, rig), or True for it",
        )
    return Request.of(payload_model, rig, spec, arms)


def sketched(
    model: LinkModel,
    rig: Rig,
    near: Controller,
    *,
    box: ParameterBox | bool | None = None,
    **wanted: Unpack[Specification],
) -> Design | None:
    """Return a quick design to show while a slider is dragged, from one search that
    starts at the controller `near`; no requirement is measured and no vibration checked.
    None if the search misses a row, if no speed is asked for, or if there is a box.
    """
    request = request_of(link_of(model, rig), rig, specification(wanted), box)
    one_search = request.box is None and request.speed is not None
    for attempt in _attempts(request) if one_search else ():
        solution = beside(attempt, near)
        if solution.kept:
            return _design_of(solution, requirements=())
    return None


def _solved(request: Request, goal: Goal, law: bool, nearest: bool) -> Design:
    """The design of a request; if there is none, InfeasibleError with the nearest
    feasible request.
    """
    result, solution = _best(request, goal, law)
    if not result.missed:
        costs = () if result.box is None else (cost_of_box(result, solution),)
        return replace(result, findings=(*result.findings, *costs))
    condition, sentence = _in_the_way(solution, result)
    # if a requirement is missed that the user did not state, no other request is known
    # to pass
    offer = _offer(request, solution, goal) if nearest and not solution.missed else {}
    raise InfeasibleError(condition, sentence, offer)


def _attempts(request: Request) -> Iterator[Request]:
    """The request with a gain-stabilised second mode, then with a phase-stabilised one."""
    yield request
    # `loud` needs a known second mode that the user does not bound
    known = request.model.second_mode is not None and "mode_gain" not in request.spec
    if known and not request.loud:
        yield replace(request, loud=True)


def _best(request: Request, goal: Goal, law: bool) -> tuple[Design, Solution]:
    """The design of a request and the solution of its search."""
    for attempt in _attempts(request):
        result, solution = _reserved(attempt, goal, law)
        if not result.missed:
            break
    return result, solution


def _reserved(request: Request, goal: Goal, law: bool) -> tuple[Design, Solution]:
    """The design of a request, with reserves increased until the law that ships also
    meets every row; the nearest design if none does.
    """
    refused: list[Design] = []
    for attempt, near in _attempts_at_goal(request, goal):
        solution = solved(attempt, near)
        result = _design_of(solution)
        for _ in range(_ROUNDS if law and solution.kept else 0):
            result = result.with_law()
            refused.append(result)
            reserves = _lost_by_law(result)
            tighter = solution.tightened(reserves) if reserves else solution
            if not reserves or not tighter.kept:
                break
            solution, result = tighter, _design_of(tighter)
        if not result.missed:
            return result, solution
    # A further reserve may have made the law worse: the design whose law stays farthest
    # from -1 says what is in the way.
    return (
        max(refused, key=lambda made: made.requirements[-1].achieved, default=result),
        solution,
    )


def _attempts_at_goal(
    request: Request, goal: Goal
) -> list[tuple[Request, Solution | None]]:
    """The requests to try, each with the solution to start from: nine tenths of the
    highest feasible crossover or margin, first from the solution that reaches it, then
    from none; then smaller shares, in case the law does not keep it. Without such a goal,
    or if no loop meets the other rows, only the request itself.
    """
    if goal == "noise":
        return [(request, None)]
    key, most, unit, least = (
        ("phase_margin", math.pi, math.radians(1.0), 0.0)
        if goal == "margin"
        else ("gain_crossover", request.arms.highest, 1.0, request.arms.resonance)
    )
    best = solved(request.aiming(key, most))
    # a crossover is eased on a logarithmic scale
    eased = 1.0 - best.easing if goal == "margin" else math.exp(-best.easing)
    highest = most / unit * eased
    if best.missed or highest <= least:
        return [(request, best)]
    # below the resonance there is no crossover to ask for
    values = dict.fromkeys(_floored(max(share * highest, least)) for share in _SHARES)
    requests = [request.asking(**{key: unit * value}) for value in values]
    return [(requests[0], best), *((one, None) for one in requests)]


def _lost_by_law(made: Design) -> dict[str, float]:
    """The relative reserve to add to each row that the law misses."""
    margin, modulus = made.requirements[-2:]
    lost: dict[str, float] = {}
    if not margin.passed:
        lost["phase_margin"] = abs(margin.slack / made.phase_margin)
    if not modulus.passed and modulus.achieved > 0.0:
        lost["max_sensitivity"] = math.log(modulus.wanted / modulus.achieved)
    # A twentieth more, since the next law may cost that much more than this one.
    return {key: 1.05 * share + RESERVE for key, share in lost.items()}


def _design_of(
    solution: Solution, requirements: tuple[Requirement, ...] | None = None
) -> Design:
    """The design of a solution, with every row where none is given."""
    if requirements is None:
        requirements = tuple(item for _, item in solution.measured)
    request, controller = solution.search.request, solution.controller
    lowest, upper = solution.crossovers
    crossover = request.speed or _floored(lowest)
    return Design(
        model=request.model,
        rig=request.rig,
        controller=controller,
        requirements=requirements,
        margins_kind="loop",
        payloads=request.payloads,
        natural_frequencies=request.natural_frequencies,
        gain_crossover=crossover,
        phase_margin=request.phase_margin,
        chi=controller.derivative_gain * crossover**controller.derivative_order,
        gain_crossover_upper=upper,
        findings=doubts_of(request.rig, request.model, request.payloads),
        box=request.box,
    )


def _in_the_way(solution: Solution, made: Design) -> tuple[str, str]:
    """The name of the row that is missed by most, and a sentence that says how far.

    The nearest controller eases every requested row, so its figure is the best only
    together with the eased values of the other rows.
    """
    implied = [item for row, item in solution.measured if row.implied]
    missed = [item for item in made.missed if item not in implied] or made.missed
    worst = max(missed, key=lambda item: abs(item.slack) / max(abs(item.wanted), 1e-3))
    goal, achieved = worst.shown
    resonance = solution.search.request.arms.resonance
    more, most = (
        ("more", "at most") if worst.bound == "at least" else ("less", "at least")
    )
    sentence = f"{most} {achieved}"
    # A law whose loop is unstable has neither a margin nor a distance from -1, and the
    # rows of the law are not among those of the search.
    searched = [item for _, item in solution.measured]
    unstable = [x for x in missed if x not in searched and x.achieved <= 0.0]
    if worst in unstable:
        sentence = "the loop is unstable with the law that ships,"
    elif worst.name == "gain crossover" and not worst.achieved:
        sentence = f"no loop was found that crosses beyond the resonance ({resonance:.3g} rad/s at the heaviest)"
    elif solution.missed:
        sentence = f"no controller was found with {more} than {achieved}"
    others = [
        f"{item.name} of {item.shown[1]} instead of {item.shown[0]}"
        for item in missed
        if item is not worst and item not in unstable and not solution.missed
    ]
    even = f", even with a {' and a '.join(others)}" if others else ""
    late, crossing = made.model.gauge_delay, made.gain_crossover_upper or resonance
    cost = math.degrees(late * crossing)
    why = (
        f": the gauge is {1e3 * late:.3g} ms late, which costs {cost:.0f}° at {crossing:.3g} rad/s"
        if cost > 5.0
        else ""
    )
    return worst.name, (
        f"at {1e3 * worst.at_payload:.3g} g{_arm_of_box(solution, made, worst)} {sentence} "
        f"where {goal} is asked for{even}{why}"
    )


def _arm_of_box(solution: Solution, made: Design, worst: Requirement) -> str:
    """The arm at which a requirement is worst, if it is one of a box, in brackets."""
    rows = [row for row, item in solution.measured if item is worst]
    if made.box is None or not rows or rows[0].implied:
        return ""
    arm, corners = solution.worst_arm(rows[0].key), arms_of(made.box, made.model)
    return f" ({arm_in_words(arm, made.box)})" if arm in corners else ""


def _offer(request: Request, solution: Solution, goal: Goal) -> dict[str, float]:
    """The nearest request in the user's own quantities, rounded to three digits towards
    the less demanding side; empty if no such request passes with the law that ships.
    """
    # The bound on the gain at a mode is not eased: above a gain of one, only the phase of
    # the mode would keep the loop from -1.
    soft = request.soft - {"mode_gain"}
    values: dict[str, float] = {}
    for share in _LOOSER:
        for row, item in solution.measured:
            implied = row.key == "phase_margin" and row.key not in request.spec
            near = not item.passed or item.slack < share * item.wanted
            known = 0.0 < item.achieved < math.inf
            if row.key in soft and near and known and not implied:
                values[row.key] = _eased(item, share)
        if not values:
            continue
        request = replace(
            request.asking(**values),
            # a request that passes with a phase-stabilised mode needs no search with a
            # gain-stabilised one
            loud=solution.search.request.loud,
        )
        trial, ended = _best(request, goal, law=True)
        if not trial.missed:
            return values
        # other rows than those that the first search eased may be in the way
        solution = solution if ended.kept else ended
    return {}


def _eased(item: Requirement, share: float) -> float:
    """The achieved or the wanted value, whichever demands less, eased by a share and
    rounded to three digits, an angle in degrees.
    """
    sign, less = (1.0, min) if item.bound == "at least" else (-1.0, max)
    unit = math.radians(1.0) if item.unit == "rad" else 1.0
    edge = less(item.achieved, item.wanted) / unit
    return unit * sign * _floored(sign * edge * (1.0 - sign * share))


def _floored(value: float) -> float:
    """`value` rounded down to three significant digits.

    >>> _floored(11.567), _floored(-0.12345)
    (11.5, -0.124)
    """
    if not value:
        return 0.0
    digit = 10.0 ** (2 - math.floor(math.log10(abs(value))))
    whole = math.floor(value * digit * (1.0 + math.copysign(1e-12, value)))
    return float(f"{whole / digit:.3g}")


def link_of(model: LinkModel | Fit, rig: Rig) -> LinkModel:
    """The link of a model or a fit, with the gauge as part of the control loop."""
    checked_noun("rig", rig, Rig, remedy="Rig.named or Rig.load make one")
    # A fit knows its own doubts; any other model is trusted.
    content = (
        model.loop_model(rig)
        if hasattr(model, "loop_model")
        else getattr(model, "model", model)
    )
    link = checked_noun(
        "model", content, LinkModel, remedy="give a fit, fit.model, or rig.model"
    )
    above(1.0, 2.0, "(λ)", remedy="λ is 2 for a classical link").check(
        "order", link.order
    )
    return in_loop(link, rig)
