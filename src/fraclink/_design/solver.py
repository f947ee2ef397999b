"""One bounded problem: the parameters of Ĉ against every row at every arm.

k_d, β, δ and a notch at the second mode are chosen so that a goal (least noise, highest
crossover, largest margin) is best while every row is kept at every link of every arm;
arms are taken in as one of them turns out to be worse than those that are in. A slack
on what was asked for makes a request that nothing meets end at the nearest one. Figures
and gradients come from `figures`, sequential quadratic programming does the rest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from fraclink._arm.loop import Loop
from fraclink._design.figures import Trial
from fraclink._design.sheet import Outer, Sheet

__all__ = ["EMPTY", "LAW", "MODEL", "Goal", "Problem", "Rows", "Solution", "Wanted"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Goal = Literal["noise", "settling", "margin"]

# What a link of a sheet has to keep: everything; the margins less the law's tolerance,
# as its motor loop runs sampled; stability alone, as the gripper is empty.
MODEL, LAW, EMPTY = 0, 1, 2

# What is aimed at beyond each row: the table's cubics and the solver's own tolerance
# must not cost a row that the engine measures afterwards.
RESERVE = 2e-4
_EMPTY_MARGIN = math.radians(2.0)  # aimed at where stability is all that is asked
# of the slack, in the scale of the goal's logarithm: far above any multiplier of a
# bound that can be met
_PENALTY = 100.0
# A search that converges measures the rows twenty to sixty times; one that does not is
# at a kink, where more trials of its line search help nothing.
_STEPS, _RUNS, _TRIALS = 60, 2, 150
_MISSED = 1e-4  # of a row: half of what is kept in reserve
# ln δ [s]: ten periods of the slowest arm, and below every control period
_LONGEST, _SHORTEST = math.log(1.0), math.log(1e-4)
_WIDTH, _DEPTH = 0.3, 0.1  # of a notch to begin from: ζ of its poles, and of its zeros
_LEAST_ORDER = 0.05  # β → 0 is a constant Ĉ, which (28) forbids


@dataclass(frozen=True)
class Wanted:
    """What a problem asks of its loops; frequencies in rad/s, angles in radians, None
    for what is not asked.

    ``highest`` is where nothing may cross any more; ``allowance`` what the law may cost
    of the margin; ``noise_voltage`` the share of the voltage limit; ``damping`` the
    least damping ratio of the vibration.
    """

    gain_crossover: float | None
    phase_margin: float
    highest: float
    allowance: float
    max_sensitivity: float | None = None
    noise_gain: float | None = None
    mode_gain: float | None = None
    noise_voltage: float | None = None
    damping: float | None = None
    filter_time: float | None = None
    link_order: float = 2.0
    # the user's own: what the slack may give
    soft: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Solution:
    """Where the solver stopped: parameters, n, slack (0 where every row is kept), goal."""

    x: Real
    filter_order: int
    slack: float
    goal: float


@dataclass(frozen=True, eq=False)
class Rows:
    """Values that must not be negative (M,), their gradients over x, goal and slack
    (P + 2, M), which of them the slack may give, and the link and the key of each.
    """

    value: Real
    gradient: Real
    soft: NDArray[np.bool_]
    link: NDArray[np.int64]
    key: list[str]


class _Astray(Exception):
    """A search measured the rows more often than one that converges."""


class _Table:
    """Rows as they are gathered."""

    def __init__(self, problem: Problem, links: int) -> None:
        self.problem, self.links = problem, links
        self.parts: list[tuple[Real, Real, NDArray[np.int64]]] = []
        self.keys: list[str] = []

    def add(
        self,
        key: str,
        value: Real,
        gradient: Real,
        which: NDArray[np.bool_],
        *,
        goal: Real | float = 0.0,
        slack: Real | float = 0.0,
    ) -> None:
        """Add the rows `key` of the links `which`; values (K,) or (K, count)."""
        count, size = value[which].size, gradient.shape[0]
        if not count:
            return
        full = np.zeros((size + 2, count))
        full[:size] = gradient[:, which].reshape(size, count)
        soft = key in self.problem.wanted.soft
        for place, column in ((size, goal), (size + 1, slack if soft else 0.0)):
            wide = np.reshape(
                column, np.shape(column) + (1,) * (value.ndim - np.ndim(column))
            )
            full[place] = np.broadcast_to(wide, value.shape)[which].ravel()
        ids = np.flatnonzero(which)
        kept = value[which].ravel() - self.problem.reserves.get(key, 0.0)
        self.parts.append((kept, full, np.repeat(ids, count // ids.size)))
        self.keys += count * [key]

    def rows(self) -> Rows:
        """Return what was gathered."""
        value, gradient, link = zip(*self.parts, strict=True)
        soft = np.array([key in self.problem.wanted.soft for key in self.keys])
        return Rows(
            np.concatenate(value),
            np.concatenate(gradient, axis=1),
            soft,
            np.concatenate(link),
            self.keys,
        )


@dataclass(frozen=True, eq=False)
class Problem:
    """Rows over a sheet of loops; `loops` are those of the sheet's arms, k = 1 and β =
    0.
    """

    sheet: Sheet
    loops: Sequence[Loop]
    wanted: Wanted
    goal: Goal
    reference: float
    filter_order: int
    notch: tuple[float, float] | None = None  # interval of its frequency [rad/s]
    reserves: dict[str, float] = field(default_factory=dict)

    def outer(self, x: Real) -> Outer:
        """Return Ĉ of the parameters."""
        return Outer(np.asarray(x), self.reference, self.filter_order)

    def widened(self, x: Real) -> Real:
        """Return parameters to begin from, with those of a notch where one is sought:
        in the middle of its interval, a tenth deep and a third wide.
        """
        if self.notch is None or x.size == self.size:
            return x
        centre = 0.5 * (math.log(self.notch[0]) + math.log(self.notch[1]))
        return np.array([*x, centre, math.log(_WIDTH), math.log(_DEPTH)])

    @property
    def size(self) -> int:
        """Number of parameters of Ĉ."""
        return 3 if self.notch is None else 6

    def rows(
        self, x: Real, goal: float, slack: float = 0.0, *, sheet: Sheet | None = None
    ) -> Rows:
        """Return every row at a trial Ĉ.

        The slack lowers what was asked for by e^−slack, or raises it by e^slack.
        """
        sheet = self.sheet if sheet is None else sheet
        wanted, table = self.wanted, _Table(self, len(sheet))
        trial = Trial(sheet, self.outer(x))
        model, empty = sheet.kind == MODEL, sheet.kind == EMPTY
        less = np.where(sheet.kind == LAW, wanted.allowance, 0.0)[:, None]
        # ---- the margins at the crossings
        margin, _ = trial.margins()
        share = math.exp(-slack) if "phase_margin" in wanted.soft else 1.0
        least = share * wanted.phase_margin
        kept = margin.value - least + less - RESERVE
        table.add("phase_margin", kept, margin.gradient, ~empty, slack=least)
        if self.goal == "margin":
            kept = margin.value - goal + less - RESERVE
            table.add("goal", kept, margin.gradient, ~empty, goal=-1.0)
        kept = margin.value - _EMPTY_MARGIN
        table.add("empty", kept, margin.gradient, empty)
        # ---- the crossover, on both sides
        places = []
        if wanted.gain_crossover is not None:
            lower = math.exp(-slack) if "gain_crossover" in wanted.soft else 1.0
            places.append(("gain_crossover", lower * wanted.gain_crossover))
        if self.goal == "settling":
            places.append(("goal", math.exp(goal)))
        for key, place in places:
            level, along = trial.loudest(place)
            column = {"goal": along} if key == "goal" else {"slack": -along}
            table.add(key, level.value - RESERVE, level.gradient, model, **column)
        level, _ = trial.loudest(wanted.highest)
        kept = -level.value - RESERVE
        table.add("highest_crossover", kept, -level.gradient, ~empty)
        # ---- the distance from -1
        if wanted.max_sensitivity is not None:
            distance = trial.distances()
            soft = slack if "max_sensitivity" in wanted.soft else 0.0
            kept = distance.value + math.log(wanted.max_sensitivity) + soft - RESERVE
            table.add("max_sensitivity", kept, distance.gradient, model, slack=1.0)
        # ---- noise
        if sheet.noise_w.shape[1]:
            gain, volts = trial.noise()
            noisy = model & (sheet.weight.sum(axis=1) > 0.0)
            if self.goal == "noise":
                table.add("goal", goal - gain.value, -gain.gradient, noisy, goal=1.0)
            for key, bound, figure in (
                ("noise_gain", wanted.noise_gain, gain),
                ("noise_voltage", wanted.noise_voltage, volts),
            ):
                if bound is not None:
                    soft = slack if key in wanted.soft else 0.0
                    kept = math.log(bound) + soft - figure.value - RESERVE
                    table.add(key, kept, -figure.gradient, noisy, slack=1.0)
        # ---- higher modes
        if wanted.mode_gain is not None and sheet.modes_w.shape[1]:
            loud = trial.modes()
            soft = slack if "mode_gain" in wanted.soft else 0.0
            kept = math.log(wanted.mode_gain) + soft - loud.value - RESERVE
            # the modes of an arm are the same for each of its links
            first = model & (np.diff(sheet.arm, prepend=-1) != 0)
            table.add("mode_gain", kept, -loud.gradient, first, slack=1.0)
        # ---- ringing
        if wanted.damping is not None:
            value, gradient = self._damping(trial, sheet)
            kept = value - wanted.damping * (1.0 + 20.0 * RESERVE)
            table.add("damping", kept, gradient, model)
        return table.rows()

    def _damping(self, trial: Trial, sheet: Sheet) -> tuple[Real, Real]:
        """The damping ratio of the least damped vibration of each link near its
        resonance, 1 where none is.
        """
        value, gradient = np.ones(len(sheet)), np.zeros((self.size, len(sheet)))
        distance = np.abs(
            1.0 + np.exp(np.minimum(trial.log.real, 50.0) + 1j * trial.log.imag)
        )
        for k in np.flatnonzero(sheet.kind == MODEL):
            loop, w0 = self.loops[sheet.arm[k]], float(sheet.natural_frequency[k])
            mode = float(loop.peak(w0))
            d, w = distance[k], sheet.w[k]
            dent = (
                np.flatnonzero(
                    (d[1:-1] <= d[:-2])
                    & (d[1:-1] < d[2:])
                    & (w[1:-1] > 0.3 * mode)
                    & (w[1:-1] < 4.0 * mode)
                )
                + 1
            )
            if not dent.size:
                continue
            root = w[dent].astype(complex)
            for _ in range(12):
                step = 1e-6 * np.abs(root)
                points = np.stack([root, root + step, root - step])
                here, above, below = np.exp(trial.outer.log(points)) * loop(points, w0)
                rate = (above - below) / (2.0 * step)
                change = (1.0 + here) / rate
                root = root - change * np.minimum(
                    1.0, 0.1 * np.abs(root) / np.maximum(np.abs(change), 1e-300)
                )
                if np.all(np.abs(change) < 1e-9 * np.abs(root)):
                    break
            ratio = root.imag / np.abs(root)
            fine = (
                (np.abs(change) < 1e-6 * np.abs(root))
                & (np.abs(root) > 0.3 * mode)
                & (np.abs(root) < 4.0 * mode)
            )
            if not fine.any():
                continue
            best = int(np.argmin(np.where(fine, ratio, 2.0)))
            # 1 + L = 0: dω = -∂L/∂x / (dL/dω), and L = -1
            at = root[best]
            moved = trial.outer.gradient(np.atleast_1d(at))[:, 0] / rate[best]
            value[k] = ratio[best]
            size = abs(at)
            gradient[:, k] = (
                moved.imag / size - at.imag * (np.conj(at) * moved).real / size**3
            )
        return value, gradient

    # ---- the problem itself

    def bounds(self) -> list[tuple[float, float]]:
        """Return the interval of every parameter, the goal's and the slack's last."""
        highest = min(self.wanted.link_order, float(self.filter_order)) - 0.02
        if self.wanted.filter_time == 0.0:
            highest = min(self.wanted.link_order, 2.0) - 0.02
        delta = (
            (_SHORTEST, _LONGEST)
            if self.wanted.filter_time is None
            else (math.log(max(self.wanted.filter_time, 1e-12)),) * 2
        )
        found = [(-16.0, 16.0), (_LEAST_ORDER, highest), delta]
        if self.notch is not None:
            low, high = self.notch
            found += [
                (math.log(low), math.log(high)),
                (math.log(0.05), math.log(1.0)),
                (math.log(1e-2), 0.0),
            ]
        goal = {
            "noise": (-14.0, 14.0),
            "settling": (math.log(1e-3), math.log(self.wanted.highest)),
            "margin": (0.0, math.pi),
        }[self.goal]
        return [*found, goal, (0.0, 3.0)]

    def start_goal(self, x: Real) -> float:
        """The goal that parameters have."""
        trial = Trial(self.sheet, self.outer(x))
        if self.goal == "noise":
            return float(
                np.max(trial.noise()[0].value[self.sheet.weight.sum(axis=1) > 0])
            )
        margin, last = trial.margins()
        if self.goal == "margin":
            return max(float(np.min(margin.value)), 0.0)
        return math.log(max(float(np.min(last[self.sheet.kind == MODEL])), 1e-2))

    def solve(self, x: Real) -> Solution:
        """Return where sequential quadratic programming stops from `x`."""
        limits = self.bounds()
        low, high = np.array(limits).T
        x = np.clip(x, low[:-2], high[:-2])
        with np.errstate(all="ignore"):
            goal = float(np.clip(self.start_goal(x), low[-2], high[-2]))
            first = self.rows(x, goal)
            miss = max(0.0, -float(np.min(first.value[first.soft], initial=0.0)))
        free = np.flatnonzero(high > low)
        direction = np.zeros(low.size)
        direction[-2:] = 1.0 if self.goal == "noise" else -1.0, _PENALTY
        z0 = np.clip(np.array([*x, goal, min(miss, 1.0)]), low, high)
        last: dict[bytes, Rows] = {}
        trials = 0

        def rows(part: Real) -> Rows:
            nonlocal trials
            key = part.tobytes()
            if key not in last:
                trials += 1
                if trials > _TRIALS:
                    raise _Astray
                last.clear()
                z = z0.copy()
                z[free] = part
                last[key] = self.rows(z[:-2], float(z[-2]), float(z[-1]))
            return last[key]

        z, least = z0.copy(), -math.inf
        # Trial steps may go far astray; what comes of them is judged afterwards. A
        # second run, with a curvature of its own, where the first left a slack.
        with np.errstate(all="ignore"):
            for _ in range(_RUNS):
                try:
                    found = minimize(
                        lambda part: (
                            float(np.dot(direction[free], part)),
                            direction[free],
                        ),
                        z[free],
                        jac=True,
                        bounds=[limits[i] for i in free],
                        constraints={
                            "type": "ineq",
                            "fun": lambda part: rows(part).value,
                            "jac": lambda part: rows(part).gradient[free].T,
                        },
                        method="SLSQP",
                        options={"maxiter": _STEPS, "ftol": 1e-6},
                    )
                except _Astray:
                    break
                z[free] = found.x
                z = np.clip(z, low, high)
                goal, slack = float(z[-2]), float(z[-1])
                least = float(np.min(self.rows(z[:-2], goal, slack).value))
                if least >= -_MISSED and slack <= _MISSED:
                    break
        if not least >= -_MISSED:  # a row is missed that the slack may not give
            slack = math.inf
        elif slack <= _MISSED:
            slack = 0.0
        return Solution(z[:-2], self.filter_order, slack, goal)

    def with_sheet(self, sheet: Sheet) -> Problem:
        """Return the problem over other links."""
        return replace(self, sheet=sheet)
