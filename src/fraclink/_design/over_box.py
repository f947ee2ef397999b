"""Design over a box of parameters: every requirement is kept at the worst arm, not at
the model alone.

The equations of the closed procedure know one link. They are solved for it again and
again, each time for as much more as the worst corner of the box was short of, until
that corner has what was asked.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NoReturn

from fraclink._arm.box import Arm, ParameterBox, arms_of
from fraclink._arm.controller import Controller
from fraclink._arm.loop import worst_margins
from fraclink._design.equations import Task
from fraclink._design.nearest import boundary
from fraclink._law.design import Requirement, Specification
from fraclink.errors import InfeasibleError
from fraclink.findings import Finding

__all__ = ["OverBox", "at_arm", "cost_of_box"]

# Each round leaves some per cent of what was missing: four are the rule, and twelve are
# enough near the edge.
_ROUNDS = 12
# of the interval between a feasible margin and one that is not: to a degree or so
_HALVINGS = 5
_SPARE = math.radians(0.2)  # of margin; less of it is not worth a round
_AIMED = ("gain_crossover", "phase_margin", "noise_gain", "mode_gain")
_SHARES = (
    0.8,
    0.6,
    0.4,
    0.2,
    0.05,
)  # of the margin asked for, tried where it is not feasible


def at_arm(task: Task, box: ParameterBox, arm: Arm) -> Task:
    """The task on one arm of the box, its range of ω₀ widened by what the box leaves
    open of ω₀.
    """
    low, high = (end / task.model.natural_frequency for end in box.natural_frequency)
    return replace(
        task,
        model=arm.model,
        low=task.low * low,
        high=task.high * high,
        motor_ratio=arm.motor_ratio,
    )


@dataclass(frozen=True)
class OverBox:
    """A specification that every arm of a box has to keep.

    ``solve`` gives the task and the controller of a specification for the model alone,
    None where there is none; ``measure`` the requirements of a task with what a
    controller achieves.
    """

    spec: Specification
    box: ParameterBox
    asked: Task
    solve: Callable[[Specification], tuple[Task, Controller] | None]
    measure: Callable[[Task, Controller, Specification], tuple[Requirement, ...]]

    def aimed(
        self, *, nearest: bool = True
    ) -> tuple[Specification, tuple[Requirement, ...]]:
        """Return what to ask for at the model, and what is then achieved over the whole
        box.

        Raises InfeasibleError; with `nearest`, it names the nearest request that is
        feasible over the box.
        """
        found = self._aimed()
        if found is None:
            if not nearest:
                raise InfeasibleError(
                    "requirements over the box", "not kept by every arm of the box", {}
                )
            self._refuse()
        return found

    def _aimed(self) -> tuple[Specification, tuple[Requirement, ...]] | None:
        arms = arms_of(self.box, self.asked.model)
        near, aim, last = arms, self.spec, self.spec
        kept: tuple[Specification, tuple[Requirement, ...]] | None = None
        # A fixed-point iteration on the aim. It need not converge to the edge: every
        # aim that passes is kept, and the last of them returned.
        for _ in range(_ROUNDS):
            made = self.solve(aim)
            if made is None:
                if kept is not None or aim == last:
                    break
                aim = _between(
                    last, aim
                )  # crossover and margin were raised at once, which was too much
                continue
            # The few corners that were ever worst first, and all of them only when
            # these pass: a box of six open parameters has 64, and each costs a scan of
            # 17 links.
            worst = self._worst(*made, near)
            if near is not arms and not self._missed(worst):
                worst = self._worst(*made, arms)
            if not self._missed(worst):
                kept = aim, tuple(item for item, _ in worst)
                if self._close(worst):
                    break
            # Few corners are ever the worst of anything: only these are looked at until
            # they pass.
            seen = () if near is arms else near
            near = tuple(dict.fromkeys((*seen, *(arm for _, arm in worst))))
            last, aim = aim, self._corrected(aim, made[0], [item for item, _ in worst])
        return kept

    def _worst(
        self, task: Task, controller: Controller, arms: tuple[Arm, ...]
    ) -> list[tuple[Requirement, Arm]]:
        """Every requirement at the arm where it is worst, and that arm."""
        # `task` is the one aimed at; what is wanted stays what was asked.
        told = replace(
            task,
            gain_crossover=self.asked.gain_crossover,
            phase_margin=self.asked.phase_margin,
        )
        rows = [
            (arm, self.measure(at_arm(told, self.box, arm), controller, self.spec))
            for arm in arms
        ]
        light, heavy = task.payloads
        found = []
        for column in range(len(rows[0][1])):
            item, arm = min(
                ((row[column], arm) for arm, row in rows),
                key=lambda pair: pair[0].slack,
            )
            # A softer link at the end of the range looks like a heavier payload.
            found.append(
                (replace(item, at_payload=min(max(item.at_payload, light), heavy)), arm)
            )
        return found

    def _missed(self, worst: list[tuple[Requirement, Arm]]) -> list[Requirement]:
        """What is missed and can be aimed at: beside a given margin Ms is only
        reported, beside a δ noise.
        """
        spec, missed = self.spec, [item for item, _ in worst if not item.passed]
        if spec.phase_margin is not None:
            missed = [item for item in missed if item.name != "sensitivity peak"]
        if spec.filter_time is not None:
            missed = [
                item
                for item in missed
                if item.name != "noise gain" and "mode" not in item.name
            ]
        return missed

    def _close(self, worst: list[tuple[Requirement, Arm]]) -> bool:
        """Whether no more was spent on the margin than `_SPARE`: it would be paid for
        with gain and noise.
        """
        return any(
            item.slack < _SPARE for item in self._margins([item for item, _ in worst])
        )

    def _margins(self, items: list[Requirement]) -> list[Requirement]:
        """What the phase margin of the model is raised for; Ms as the margin that it
        allows.
        """
        bound_peak = self.spec.phase_margin is None
        found = [item for item in items if item.name == "phase margin"]
        for item in items:
            if item.name == "sensitivity peak" and bound_peak:
                wanted, achieved = (
                    2.0 * math.asin(0.5 / max(peak, 0.5))
                    for peak in (item.wanted, item.achieved)
                )
                found.append(
                    replace(item, wanted=wanted, achieved=achieved, bound="at least")
                )
        return found

    def _corrected(
        self, aim: Specification, task: Task, items: list[Requirement]
    ) -> Specification:
        """The aim moved by what each requirement is short of, or has to spare, at its
        worst arm.
        """
        # Aimed at the middle of the band of `_SPARE`: at its lower edge rounding
        # decides whether the corner passes.
        slack = min(item.slack for item in self._margins(items)) - 0.5 * _SPARE
        # Never below what was asked: the model itself is one of the arms.
        margin = min(
            max(task.phase_margin - slack, self.asked.phase_margin), 0.999 * math.pi
        )
        aim = replace(aim, phase_margin=margin, max_sensitivity=None)
        for item in items:
            # A corner without any crossing has no ratio: a tenth more, and the next
            # round sees one.
            ratio = item.wanted / item.achieved if item.achieved > 0.0 else 1.1
            if item.name == "gain crossover":
                # 0.05 % beyond, since the worst corner moves with the aim; half again
                # at most, as a corner that hardly crosses would send the aim beyond the
                # motor loop.
                crossover = task.gain_crossover * min(1.0005 * ratio, 1.5)
                aim = replace(
                    aim, gain_crossover=max(crossover, self.asked.gain_crossover)
                )
            elif (
                item.name == "noise gain"
                and aim.noise_gain is not None
                and not item.passed
            ):
                # Only tightened, and by 0.2 % more than was missed: a noise bound that
                # is let out again would oscillate with the margin.
                aim = replace(aim, noise_gain=0.998 * ratio * aim.noise_gain)
            elif "mode" in item.name and aim.mode_gain is not None and not item.passed:
                aim = replace(aim, mode_gain=0.998 * ratio * aim.mode_gain)
        return aim

    def _refuse(self) -> NoReturn:
        """Raise InfeasibleError with the largest margin, or the smallest Ms, that every
        arm keeps.
        """
        good = next(
            (share for share in _SHARES if self._eased(share)._aimed() is not None),
            None,
        )
        if good is None:
            raise InfeasibleError(
                "requirements over the box",
                "no smaller margin is kept by every arm of the box either; a narrower box, or a narrower "
                "range of payloads, may have a controller",
            )
        bad = min(good + 0.2, 1.0)
        share = boundary(
            lambda x: self._eased(x)._aimed() is not None,
            good,
            bad,
            halvings=_HALVINGS,
            log=False,
        )
        best = self._eased(share).spec
        nearest: dict[str, float] = {"gain_crossover": self.asked.gain_crossover}
        if best.phase_margin is not None:
            reason = f"the largest phase margin that every arm keeps is {math.degrees(best.phase_margin):.4g}°"
            nearest["phase_margin"] = best.phase_margin
        else:
            assert best.max_sensitivity is not None  # one of the two was given  # noqa: S101
            reason = (
                f"the smallest Ms that every arm keeps is {best.max_sensitivity:.4g}"
            )
            nearest["max_sensitivity"] = best.max_sensitivity
        raise InfeasibleError("requirements over the box", reason, nearest)

    def _eased(self, share: float) -> OverBox:
        """The same with a share of the margin, or with Ms as much farther from one."""
        if self.spec.phase_margin is not None:
            margin = share * self.spec.phase_margin
            spec, asked = (
                replace(self.spec, phase_margin=margin),
                replace(self.asked, phase_margin=margin),
            )
            return replace(self, spec=spec, asked=asked)
        assert self.spec.max_sensitivity is not None  # one of the two was given  # noqa: S101
        peak = 1.0 + (self.spec.max_sensitivity - 1.0) / share
        asked = replace(self.asked, phase_margin=2.0 * math.asin(0.5 / peak))
        return replace(self, spec=replace(self.spec, max_sensitivity=peak), asked=asked)


def _between(first: Specification, second: Specification) -> Specification:
    """The specification half way from one that has a controller to one that has none."""
    pairs = {name: (getattr(first, name), getattr(second, name)) for name in _AIMED}
    halves = {
        name: 0.5 * (a + b)
        for name, (a, b) in pairs.items()
        if a is not None and b is not None
    }
    return replace(second, **halves)


# ---- what the box costs -----------------------------------------------------------------------------------

# What the box calls a parameter: its words, and what makes its interval narrower.
_WORDS = {
    "order": ("λ", "a longer log, or several logs of the arm,"),
    "natural_frequency": ("ω₀", "a longer log, or weighing the payload,"),
    "damping": ("μ", "a longer log that ends at rest"),
    "gauge_gain": ("the gauge's gain", "calibrating the gauge with known weights"),
    "gauge_delay": (
        "the gauge's delay",
        "measuring the delay that the controller sees",
    ),
    "motor_ratio": ("the motor", "identifying the motor"),
    "mode_frequency": ("the second mode", "a log that excites the second mode"),
}


def cost_of_box(task: Task, controller: Controller, box: ParameterBox) -> Finding:
    """W407: the phase margin that the box costs, and what each of its intervals would
    give back.

    At the worst corner one parameter after the other is taken as the model has it, and
    then half way there.
    """

    def margin(box: ParameterBox, arm: Arm) -> float:
        here = at_arm(task, box, arm)
        return worst_margins(here.loop(controller), here.low, here.high)[1][0]

    exact = ParameterBox.at(task.model)
    nominal = margin(exact, Arm(task.model))
    worst, arm = min(
        ((margin(box, arm), arm) for arm in arms_of(box, task.model)),
        key=lambda pair: pair[0],
    )
    gains: dict[str, tuple[float, float]] = {}
    for name in _WORDS:
        low, high = getattr(box, name)
        if low < high:
            point = getattr(exact, name)[0]
            # Half as wide is what a log four times as long gives; the exact parameter
            # is what no log can.
            known, half = (
                margin(*_shrunk(box, arm, name, point, share)) - worst
                for share in (0.0, 0.5)
            )
            gains[name] = known, half
    evidence: dict[str, float] = {"nominal_rad": nominal, "worst_rad": worst}
    evidence |= {f"{name}_rad": known for name, (known, _) in gains.items()}
    if not gains:
        return Finding(
            "W407",
            "info",
            "the box is a single arm and costs nothing",
            evidence,
            "give box=True for what fit and rig leave open",
        )
    top = max(gains, key=lambda name: gains[name][0])
    known, half = (math.degrees(value) for value in gains[top])
    low, high = getattr(box, top)
    word, remedy = _WORDS[top]
    return Finding(
        "W407",
        "info",
        f"the box costs {math.degrees(nominal - worst):.1f}° of phase margin, most of it {word} from "
        f"{low:.4g} to {high:.4g}: exactly known it would give back {known:.1f}°, half as wide {half:.1f}°",
        evidence,
        f"{remedy} narrows the interval",
    )


def _shrunk(
    box: ParameterBox, arm: Arm, name: str, point: float, share: float
) -> tuple[ParameterBox, Arm]:
    """(box, arm) with one parameter moved towards the model, to `share` of its
    distance.
    """

    def moved(value: float) -> float:
        return point + share * (value - point)

    link = arm.model
    if name == "natural_frequency":
        low, high = box.natural_frequency
        return replace(box, natural_frequency=(moved(low), moved(high))), arm
    if name == "motor_ratio":
        return box, replace(arm, motor_ratio=moved(arm.motor_ratio))
    if name == "mode_frequency":
        assert link.second_mode is not None  # its interval has a width  # noqa: S101
        second = replace(link.second_mode, frequency=moved(link.second_mode.frequency))
        return box, replace(arm, model=replace(link, second_mode=second))
    changed: dict[str, Any] = {name: moved(getattr(link, name))}
    return box, replace(arm, model=replace(link, **changed))
