"""`optimise`: k_d, β, δ, n and a lead for the worst payload, started from the closed-form design.

The closed procedure answers with the one controller that has this crossover and this margin with the filter
of the rule. Of all controllers that stay as far from -1 and cross as high, another may reach the motor with
less noise, or cross higher with the same noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from fraclink._design.plan import Design
from fraclink._design.problem import Goal
from fraclink._design.search import Search
from fraclink._validate import checked_between, checked_noun
from fraclink.errors import InfeasibleError

__all__ = ["Optimised", "Step", "optimise"]

PAYS = 0.02  # of the objective: a gain below it is within what the fit of the law makes of a controller
CLOSED = "closed form"


@dataclass(frozen=True)
class Step:
    """One structure that was tried: its objective, and whether it was taken.

    ``value`` is the worst noise gain or the smallest crossover [rad/s] over the payloads; NaN where no
    controller of this structure was found that keeps the bounds.
    """

    structure: str
    value: float
    taken: bool


@dataclass(frozen=True)
class Optimised:
    """The answer of `optimise`: a design like any other, and what it gained.

    ``design`` is the accepted design, the closed form itself where nothing pays; ``goal`` "noise" or
    "crossover"; ``steps`` every structure that was tried, the closed form first; ``least`` the part of the
    objective by which a structure must be better than the simpler one to be taken.
    """

    design: Design
    goal: Goal
    steps: tuple[Step, ...]
    least: float

    @property
    def pays(self) -> bool:
        """Whether another structure than the closed form was taken."""
        return not self.steps[0].taken

    @property
    def gain(self) -> float:
        """Part of the closed form's objective that was gained; NaN where it does not keep the bounds."""
        return _gain(self.goal, self.steps[0].value, next(s.value for s in self.steps if s.taken))

    def __str__(self) -> str:
        word, unit = ("worst noise gain", "") if self.goal == "noise" else ("smallest crossover", " rad/s")
        lines = [f"{word}, each structure with the same bounds, taken if better by {100 * self.least:g} %:"]
        for step in self.steps:
            value = "none found in the bounds" if math.isnan(step.value) else f"{step.value:.4g}{unit}"
            lines.append(f"  {step.structure}: {value}{', taken' if step.taken else ''}")
        if not self.pays:
            lines.append("nothing else pays: the closed-form design is returned as it is")
        return "\n".join([*lines, str(self.design)])


def optimise(
    design: Design,
    *,
    goal: Goal = "noise",
    max_sensitivity: float | None = None,
    gain_crossover: float | None = None,
    noise_gain: float | None = None,
    mode_gain: float | None = None,
    lead: bool = True,
    least: float = PAYS,
) -> Optimised:
    """Return the best ``C = 1 + k_d s^β/(1 + δs)^n`` for the worst payload, with a lead where it pays.

    Started from the closed-form `design`; n = 1 and 2 are tried, then both with a `Lead`
    ``(1 + (a s)^ν)/(1 + (b s)^ν)``, a lag where a < b. All keep ``C(0) = 1`` and so reject the gauge's
    offset. A pure fractional integrator is not offered: it would take the *estimate* to the reference and
    leave the whole of the offset, Γ₀/c, in the tip. β < n, so that Ĉ stays strictly proper (32).

    Parameters
    ----------
    design
        a design with ``margins="loop"``, on any motor loop.
    goal
        "noise": least noise at the motor reference; "crossover": highest crossover of the heaviest payload.
    max_sensitivity
        bound on the worst Ms, > 1; the design's own when left out.
    gain_crossover
        bound on the smallest crossover [rad/s], > 0, for the goal "noise"; the design's when left out.
    noise_gain
        bound on the worst noise gain, > 0, for the goal "crossover"; the design's own when left out.
    mode_gain
        bound on the loop gain at modes 2 and 3 of a link with mass, > 0; none when left out.
    lead
        whether a lead is tried.
    least
        part of the objective by which a structure must be better than the simpler one, 0 … 1.

    Returns
    -------
    Optimised
        its ``design`` is certified, saved and shipped like any other; its requirements are the bounds.

    Raises
    ------
    FieldError
        a value out of its range, or a design with ``margins="ideal"``.
    InfeasibleError
        no structure keeps the bounds, the closed form included.

    Examples
    --------
    >>> import fraclink as fl
    >>> from fraclink._design import optimise
    >>> rig = fl.Rig.named("paper-2023")
    >>> design = fl.design(rig.model, rig, gain_crossover=12.0, phase_margin=fl.deg(50))
    >>> better = optimise(design, lead=False)
    >>> better.pays, better.design.passed, better.gain > 0.5
    (True, True, True)
    """
    checked_noun("plan", design, Design, remedy="fl.design makes one")
    search = Search.of(design, goal, (max_sensitivity, gain_crossover, noise_gain, mode_gain))
    needed = checked_between("least", least, 0.0, 1.0)
    closed = search.kept(design.controller)
    found = [(CLOSED, design.controller, closed), *search.simple(design.controller)]
    if lead:
        found += search.widened(found[1:])
    best = 0
    for i, (_, _, value) in enumerate(found):
        before = found[best][2]
        if not math.isnan(value) and (math.isnan(before) or _gain(goal, before, value) >= max(needed, 1e-9)):
            best = i
    if math.isnan(found[best][2]):
        raise InfeasibleError("bounds of the optimisation", "no structure keeps all of them; loosen one")
    steps = tuple(Step(name, value, i == best) for i, (name, _, value) in enumerate(found))
    return Optimised(design if best == 0 else search.design(found[best][1]), goal, steps, needed)


def _gain(goal: Goal, before: float, after: float) -> float:
    return 1.0 - after / before if goal == "noise" else after / before - 1.0
