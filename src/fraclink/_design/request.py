"""A specification with all numbers resolved for an arm: the loops to be evaluated, and
the requirements on each.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from fraclink._arm.beam import model_at
from fraclink._arm.box import Arm, ParameterBox, arms_of
from fraclink._arm.controller import Controller
from fraclink._arm.link import LinkModel
from fraclink._arm.loop import Loop
from fraclink._arm.motor_loop import MotorLoop
from fraclink._arm.rig import Rig
from fraclink._design.rows import ROWS, SENSITIVITY, Row
from fraclink._design.table import Table, stacked, tabulated
from fraclink._law.modes import MODE_LIMIT, HigherModes, higher_modes
from fraclink._law.requirement import PAYLOADS, least_modulus
from fraclink.errors import FieldError
from fracsys.checks import Real

__all__ = ["Request"]


# Mass of a gripper without its load, as a share of the lightest payload, if none is
# stated.
_EMPTY_SHARE = 0.4


@dataclass(frozen=True, eq=False)
class Case:
    """One arm at some payloads [kg], with ω₀ of each; `empty` for the empty gripper."""

    arm: Arm
    natural_frequencies: Real
    payloads: Real
    empty: bool = False


@dataclass(frozen=True)
class Arms:
    """The loops of a request and their tables: those of a model, of the arms of a box,
    and of the empty gripper.

    ``payloads`` (lightest, heaviest) [kg], ``natural_frequencies`` of the heaviest and
    of the lightest. Modes with a number above ``modes_above`` are judged by their gain;
    None if there are none.
    """

    model: LinkModel
    rig: Rig
    box: ParameterBox | None
    payloads: tuple[float, float]
    natural_frequencies: tuple[float, float]
    motor_loop: MotorLoop
    modes_above: int | None

    @cached_property
    def cases(self) -> tuple[Case, ...]:
        """The model at its payloads, the empty gripper, and the corners of the box."""
        low, high = self.natural_frequencies
        w0 = np.geomspace(low, high, PAYLOADS)
        light, heavy = self.payloads
        inner = [self.model.payload_at(float(w)) for w in w0[1:-1]]
        masses = np.array([heavy, *inner, light])
        if self.model.second_mode is None or self.rig.link.mass <= 0.0:
            cases = [Case(Arm(self.model), w0, masses)]
        else:  # the second mode varies with the payload
            cases = [
                Case(
                    Arm(model_at(self.model, self.rig, mass)),
                    w0[k : k + 1],
                    masses[k : k + 1],
                )
                for k, mass in enumerate(masses)
            ]
        empty = self.rig.payloads.empty or _EMPTY_SHARE * light
        alone = model_at(self.model, self.rig, empty)
        own, mass = np.array([[alone.natural_frequency], [empty]])
        cases.append(Case(Arm(alone), own, mass, empty=True))
        if self.box is not None:
            # the box's own interval of ω₀ widens the range of the payloads
            wider = np.array(self.box.natural_frequency) / self.model.natural_frequency
            ends = np.array([low, high]) * wider, np.array([heavy, light])
            cases += [Case(arm, *ends) for arm in arms_of(self.box, self.model)]
        return tuple(cases)

    @cached_property
    def loops(self) -> tuple[Loop, ...]:
        """The loop without Ĉ of every case."""
        unit = Controller(
            derivative_gain=1.0,
            derivative_order=1.0,
            motor_loop=self.motor_loop,
            period=self.rig.period,
        )
        return tuple(
            replace(case.arm.loop(unit, self.rig), gain=1.0, order=0.0, filter_time=0.0)
            for case in self.cases
        )

    @cached_property
    def table(self) -> Table:
        """The loops without Ĉ of every link."""
        motor = self.rig.motor
        return stacked(
            tabulated(
                loop,
                case.natural_frequencies,
                self.rig.period,
                arm=number,
                highest=self.highest,
                motor=(motor.gain, motor.decay),
                modes=modes,
                empty=case.empty,
            )
            for number, (case, loop, modes) in enumerate(
                zip(self.cases, self.loops, self.modes, strict=True)
            )
        )

    @cached_property
    def modes(self) -> tuple[HigherModes | None, ...]:
        """The higher modes of every case that are judged by their gain."""
        return tuple(map(self._modes, self.cases))

    def _modes(self, case: Case) -> HigherModes | None:
        if self.modes_above is None or case.empty:
            return None
        modes = higher_modes(case.arm, self.rig, self.motor_loop, case.payloads)
        return None if modes is None else modes.above(self.modes_above)

    @cached_property
    def payloads_at(self) -> Real:
        """The payload of every link [kg]."""
        return np.concatenate([case.payloads for case in self.cases])

    @property
    def highest(self) -> float:
        """The highest allowed crossing: the pole of the motor loop, and at most 0.9 of
        the Nyquist frequency.
        """
        return min(self.rig.motor_loop.pole, 0.9 * math.pi / self.rig.period)

    @cached_property
    def resonance(self) -> float:
        """The resonance of the heaviest payload [rad/s]."""
        return float(self.loops[0].peak(self.natural_frequencies[0]))


@lru_cache(maxsize=8)
def _same(arms: Arms) -> Arms:
    """The cached arms that are equal to these and already have their tables."""
    return arms


@dataclass(frozen=True, eq=False)
class Request:
    """A specification on one arm, or on every arm of a box; frequencies in rad/s.

    ``soft`` names the rows that may be eased: the requested ones, or their defaults.
    ``loud`` allows a known second mode to have a large gain if its phase keeps it from
    -1.
    """

    model: LinkModel  # with a known payload
    rig: Rig
    spec: Mapping[str, Any]
    box: ParameterBox | None
    soft: frozenset[str]
    loud: bool = False
    # a row with an unreachable goal, which the search approaches as closely as possible
    aim: tuple[str, float] | None = None

    @staticmethod
    def of(
        model: LinkModel, rig: Rig, spec: Mapping[str, Any], box: ParameterBox | None
    ) -> Request:
        """Return a request; FieldError for values that contradict the arm."""
        soft = {"phase_margin", "mode_gain"}.union(spec)
        if "phase_margin" not in spec:
            soft.add("max_sensitivity")
        request = Request(model, rig, spec, box, frozenset(soft))
        request.check()
        return request

    def asking(self, **wanted: Any) -> Request:
        """Return the request with other values."""
        return replace(self, spec={**self.spec, **wanted}, aim=None)

    def aiming(self, key: str, value: float) -> Request:
        """Return the request for one row as close to a value as possible."""
        return replace(self, aim=(key, value), soft=frozenset({key}))

    def check(self) -> None:
        """Raise FieldError for values that contradict the arm."""
        has_mode = self.rig.link.mass > 0.0 or self.model.second_mode is not None
        if not has_mode and "mode_gain" in self.spec:
            raise FieldError(
                "mode_gain",
                self.spec["mode_gain"],
                "asked for on a massless link, which has one mode",
                "a rig that states the mass of its link, or a model that knows its second mode",
                "state mass_kg in [link] (--link-mass on the command line)",
            )
        if "natural_frequencies" in self.spec and "payloads" in self.spec:
            raise FieldError(
                "natural_frequencies",
                self.spec["natural_frequencies"],
                "given together with payloads",
                "one of the two",
                "leave one out",
            )
        if self.motor_loop.kind == "sampled":
            # fails at once if its poles cannot be placed
            self.motor_loop.sampled(self.rig.motor, self.rig.period)
        # nothing crosses above the Nyquist frequency; above the pole of the motor loop,
        # its lag alone exceeds 90°
        for limit, problem, remedy in (
            (
                math.pi / self.rig.period,
                "above the Nyquist frequency",
                "ask for a slower loop or sample faster",
            ),
            (
                self.rig.motor_loop.pole,
                "above the motor loop's bandwidth",
                "ask for a slower loop or a faster motor loop",
            ),
        ):
            if (self.speed or 0.0) >= limit:
                raise FieldError(
                    "gain_crossover",
                    self.speed,
                    problem,
                    f"< {limit:.6g} rad/s",
                    remedy,
                )

    # ---- what is wanted

    @property
    def speed(self) -> float | None:
        """The requested crossover; ``2π/t_s`` (section 6) for a settling time."""
        time = self.spec.get("settling_time")
        return self.spec.get("gain_crossover") or (math.tau / time if time else None)

    @property
    def gain_crossover(self) -> float | None:
        """The least gain crossover: the resonance of the heaviest payload if no speed
        is requested, since a loop that crosses below it does not affect the vibration.
        """
        return self.spec.get("gain_crossover") or (
            None if self.speed else self.arms.resonance
        )

    @property
    def phase_margin(self) -> float:
        """The least phase margin [rad]: the one implied by Ms if none is requested."""
        margin = self.spec.get("phase_margin")
        most = self.spec.get("max_sensitivity") or SENSITIVITY
        return margin or 2.0 * math.asin(0.5 / most)

    @property
    def max_sensitivity(self) -> float:
        """The bound on Ms: the customary one if no margin is requested, and with a
        margin one over the distance from -1 that the law has to keep.
        """
        limit = self.spec.get("max_sensitivity")
        if limit is None and "phase_margin" in self.spec:
            return 1.0 / least_modulus(self.phase_margin)
        return limit or SENSITIVITY

    @property
    def mode_gain(self) -> float | None:
        """The bound on the loop gain at the higher modes, if one is judged by it."""
        if self.rig.link.mass <= 0.0 and (self.model.second_mode is None or self.loud):
            return None
        return self.spec.get("mode_gain") or MODE_LIMIT

    @cached_property
    def wanted(self) -> list[tuple[Row, float]]:
        """Every row of the table with its wanted value."""
        aims = dict([self.aim] if self.aim else [])
        pairs = [(row, aims.get(row.key, row.wanted(self))) for row in ROWS]
        return [(row, goal) for row, goal in pairs if goal is not None]

    # ---- the loops to be evaluated

    @cached_property
    def payloads(self) -> tuple[float, float]:
        """(lightest, heaviest) [kg]."""
        w0 = self.spec.get("natural_frequencies")
        if w0 is not None:
            return self.model.payload_at(w0[1]), self.model.payload_at(w0[0])
        own = self.rig.payloads
        return self.spec.get("payloads") or (own.low, own.high)

    @cached_property
    def natural_frequencies(self) -> tuple[float, float]:
        """ω₀ of the heaviest and of the lightest payload."""
        light, heavy = (
            self.model.at_payload(mass).natural_frequency for mass in self.payloads
        )
        return self.spec.get("natural_frequencies") or (heavy, light)

    @cached_property
    def motor_loop(self) -> MotorLoop:
        """The motor loop that the design assumes."""
        settings = self.rig.motor_loop
        return MotorLoop(
            settings.pole,
            int(settings.delay_samples),
            self.spec.get("motor_loop", "sampled"),
            self.spec.get("placement", "direct"),
        )

    @cached_property
    def arms(self) -> Arms:
        """The loops to be evaluated."""
        above = None if self.mode_gain is None else 2 if self.loud else 1
        low, high = self.payloads
        return _same(
            Arms(
                self.model,
                self.rig,
                self.box,
                (float(low), float(high)),
                self.natural_frequencies,
                self.motor_loop,
                above,
            )
        )

    @property
    def reference(self) -> float:
        """ω_r: the requested crossover, or a frequency just above the heaviest
        payload's resonance.
        """
        return self.speed or 1.1 * self.arms.resonance

    @property
    def first_links(self) -> tuple[int, ...]:
        """The heaviest payload, the middle one, the lightest, and the empty gripper."""
        return 0, PAYLOADS // 2, PAYLOADS - 1, PAYLOADS

    @property
    def filter_orders(self) -> tuple[int, ...]:
        """The values of n to try: with a free δ, two poles are at least as good as one."""
        time, order = self.spec.get("filter_time"), self.spec.get("filter_order")
        if order is not None:
            return (order,)
        return (2,) if time is None else (1,) if time == 0.0 else (1, 2)

    @property
    def notches(self) -> tuple[tuple[float, float] | None, ...]:
        """The intervals of a notch to try: none first, then, if the second mode lies
        below half of the Nyquist frequency, one about it (above it if it may be loud).
        """
        second = self.model.second_mode
        if second is not None:
            mode = second.frequency
        elif self.mode_gain is not None:
            modes = self.arms.modes[0]
            assert modes is not None  # noqa: S101
            mode = float(np.median(modes.frequency[modes.number == 2]))
        else:
            return (None,)
        # the law follows Ĉ up to half of the Nyquist frequency
        top, apart = (
            0.5 * math.pi / self.rig.period,
            math.sqrt(mode / self.arms.resonance),
        )
        # a notch above the mode turns its phase away from -1
        low = mode if self.loud else mode / apart
        # a mode below the resonance comes from a log with another payload
        return (
            (None, (low, min(mode * apart, top)))
            if self.arms.resonance < mode < top
            else (None,)
        )
