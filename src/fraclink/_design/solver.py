"""One bounded problem: the parameters of Ĉ against every row at every arm.

k_d, β, δ and a notch at the second mode are chosen so that a goal (least noise, highest
crossover, largest margin) is best while every row is kept at every link of every arm;
arms are taken in as one of them turns out to be worse than those that are in. A slack
on what was asked for makes a request that nothing meets end at the nearest one. Figures
and gradients come from `figures`, sequential quadratic programming does the rest.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from fraclink._arm.loop import Loop
from fraclink._design.descent import Astray, Kept, Rows, descended
from fraclink._design.figures import Trial
from fraclink._design.sheet import Outer, Sheet
from fraclink._law.rows import DAMPING

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
# ln of the most that a slack may give, and how far beyond every row a search aims that
# is content with keeping them
_LARGEST, _BEYOND = 3.0, 0.02
# A search that converges measures the rows twenty to sixty times; one that does not is
# at a kink, where more trials of its line search help nothing.
_STEPS, _RUNS, _TRIALS = 60, 2, 150
# of the slack, in the scale of the goal's logarithm: far above any multiplier of a
# bound that can be met
_PENALTY = 100.0
# Runs towards the rows alone, and a move of a parameter behind which no other begins.
_PARTS, _STILL = 6, 0.02
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
    of the margin and ``modulus`` its least |1 + L|; ``noise_voltage`` the share of the
    voltage limit; ``damping`` whether the vibration must be damped.
    """

    gain_crossover: float | None
    phase_margin: float
    highest: float
    allowance: float
    modulus: float
    max_sensitivity: float | None = None
    noise_gain: float | None = None
    mode_gain: float | None = None
    noise_voltage: float | None = None
    damping: bool = False
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
    patient: bool = False  # whether it meets the rows before it looks at the goal

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
        self,
        x: Real,
        goal: float | None,
        slack: float = 0.0,
        *,
        sheet: Sheet | None = None,
    ) -> Rows:
        """Return every row at a trial Ĉ, with those of a goal where one is given.

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
        if self.goal == "margin" and goal is not None:
            kept = margin.value - goal + less - RESERVE
            table.add("goal", kept, margin.gradient, ~empty, goal=-1.0)
        kept = margin.value - _EMPTY_MARGIN
        table.add("empty", kept, margin.gradient, empty)
        # ---- the crossover, on both sides
        places = []
        if wanted.gain_crossover is not None:
            lower = math.exp(-slack) if "gain_crossover" in wanted.soft else 1.0
            places.append(("gain_crossover", lower * wanted.gain_crossover))
        if self.goal == "settling" and goal is not None:
            places.append(("goal", math.exp(goal)))
        for key, place in places:
            level, along = trial.loudest(place)
            column = {"goal": along} if key == "goal" else {"slack": -along}
            table.add(key, level.value - RESERVE, level.gradient, model, **column)
        level, _ = trial.loudest(wanted.highest)
        kept = -level.value - RESERVE
        table.add("highest_crossover", kept, -level.gradient, ~empty)
        # ---- the distance from -1
        distance = trial.distances()
        if self.patient or "law_modulus" in self.reserves:
            kept = distance.value - math.log(wanted.modulus) - RESERVE
            table.add("law_modulus", kept, distance.gradient, ~empty)
        if wanted.max_sensitivity is not None:
            soft = slack if "max_sensitivity" in wanted.soft else 0.0
            kept = distance.value + math.log(wanted.max_sensitivity) + soft - RESERVE
            table.add("max_sensitivity", kept, distance.gradient, model, slack=1.0)
        # ---- noise
        if sheet.noise_w.shape[1]:
            gain, volts = trial.noise()
            noisy = model & (sheet.weight.sum(axis=1) > 0.0)
            if self.goal == "noise" and goal is not None:
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
        if wanted.damping:
            value, gradient = self._damping(trial, sheet)
            kept = value - DAMPING * (1.0 + 20.0 * RESERVE)
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
        model = sheet.kind == MODEL
        for arm in np.unique(sheet.arm[model]):
            # the damping is least at one end of the payloads
            own = np.flatnonzero(model & (sheet.arm == arm))[[0, -1]]
            loop, d, w = self.loops[arm], distance[own], sheet.w[own]
            low, high = (
                share * np.asarray(loop.peak(sheet.natural_frequency[own]))[:, None]
                for share in (0.3, 4.0)
            )
            dent = np.zeros(d.shape, dtype=bool)
            dent[:, 1:-1] = (d[:, 1:-1] <= d[:, :-2]) & (d[:, 1:-1] < d[:, 2:])
            dent &= (w > low) & (w < high)
            # a weak loop hardly moves the link's own pole
            dent[np.arange(own.size), np.argmin(np.abs(w - low / 0.3), axis=1)] = True
            row, column = np.nonzero(dent)
            # from the table: how far beside the axis the root of 1 + 1/L is, to first
            # order
            back = np.exp(-trial.log[own][row, column])
            beside = (1.0 + back) / (back * trial.slope[own][row, column])
            beside = beside * np.minimum(1.0, 0.2 / np.maximum(np.abs(beside), 1e-300))
            root = w[row, column] * (1.0 + beside)
            w0 = sheet.natural_frequency[own][row]
            change, rate = np.full(root.size, np.inf), np.ones_like(root)
            for _ in range(8 if root.size else 0):
                step = 1e-6 * np.abs(root)
                points = np.stack([root, root + step, root - step])
                outer = np.exp(trial.outer.log(points))
                here, above, below = 1.0 / (outer * loop(points, w0))
                rate = (above - below) / (2.0 * step)
                change = (1.0 + here) / rate
                root = root - change * np.minimum(
                    1.0, 0.1 * np.abs(root) / np.maximum(np.abs(change), 1e-300)
                )
                if np.all(np.abs(change) < 1e-7 * np.abs(root)):
                    break
            size = np.abs(root)
            ratio = root.imag / size
            fine = (np.abs(change) < 1e-6 * size) & (size > low[row, 0])
            fine &= size < high[row, 0]
            # 1 + 1/L = 0: dω = -∂(1/L)/∂x / (d(1/L)/dω), and 1/L = -1
            moved = -trial.outer.gradient(root) / rate
            slope = moved.imag / size
            slope -= root.imag * (np.conj(root) * moved).real / size**3
            for k in np.flatnonzero(fine):
                link = own[row[k]]
                if ratio[k] < value[link]:
                    value[link], gradient[:, link] = ratio[k], slope[:, k]
        return value, gradient

    def merits(self, x: Real) -> Real:
        """By how much each of many Ĉ (P, M) keeps the row that it misses most, negative
        where it misses one; on the table's own points, by what matters far off.
        """
        wanted, count, ends = self.wanted, x.shape[1], len(self.sheet)
        sheet = self.sheet.rows(np.tile(np.arange(ends), count))
        trial = Trial(sheet, self.outer(np.repeat(x, ends, axis=1)))
        margin, last, distance = trial.coarse()
        least = np.where(sheet.kind == LAW, wanted.allowance, 0.0)
        kept = np.where(
            sheet.kind == EMPTY,
            margin - _EMPTY_MARGIN,
            (margin + least) / wanted.phase_margin - 1.0,
        )
        model = sheet.kind == MODEL

        def also(value: Real, which: NDArray[np.bool_]) -> None:
            np.minimum(kept, value, out=kept, where=which)

        also(np.log(wanted.highest / np.maximum(last, 1e-3)), sheet.kind != EMPTY)
        if wanted.gain_crossover is not None:
            lowest = wanted.gain_crossover * math.exp(-_LARGEST)
            also(np.log(np.maximum(last, lowest) / wanted.gain_crossover), model)
        also(distance - math.log(wanted.modulus), sheet.kind != EMPTY)
        if wanted.max_sensitivity is not None:
            also(distance + math.log(wanted.max_sensitivity), model)
        if wanted.noise_gain is not None:
            noise = trial.noise_level()
            also(math.log(wanted.noise_gain) - noise, model & (sheet.weight[:, 0] > 0))
        if wanted.mode_gain is not None:
            also(math.log(wanted.mode_gain) - trial.mode_level(), model)
        # what is asked for may be given, stability may not
        unstable = (margin <= 0.0) | (last > wanted.highest) & (sheet.kind != EMPTY)
        kept = np.where(unstable, kept - _LARGEST, kept)
        return np.min(kept.reshape(count, ends), axis=1, out=np.empty(count))

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
        return [*found, goal, (0.0, _LARGEST)]

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
        """Return where sequential quadratic programming stops from `x`; a patient one
        first goes towards the rows alone, and from there along them to the goal.
        """
        if not self.patient:
            return self._penalised(x)
        with np.errstate(all="ignore"):
            x, slack = self._towards_rows(x)
            goal = self.start_goal(x)
        if slack > 0.0:
            return Solution(x, self.filter_order, slack, goal)
        best = self._penalised(x)
        return best if best.slack == 0.0 else replace(best, x=x, slack=0.0, goal=goal)

    def _penalised(self, x: Real) -> Solution:
        """Where a search of goal and slack at once stops, the slack dear."""
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
                    raise Astray
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
                except Astray:
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

    def _towards_rows(self, x: Real) -> tuple[Real, float]:
        """(parameters, slack) that miss the rows least; the first that keep all of them
        where some do.
        """
        limits = [*self.bounds()[:-2], (-_BEYOND, _LARGEST)]
        low, high = np.array(limits).T
        x = np.clip(x, low[:-1], high[:-1])
        best, least = x, math.inf

        def judge(x: Real, found: Rows, slack: float) -> None:
            nonlocal best, least
            need = self._needed(x, found, slack)
            if need < least:
                best, least = x.copy(), need
                if least <= 0.0:
                    raise Kept

        def rows(z: Real) -> Rows:
            found = self.rows(z[:-1], None, float(z[-1]))
            judge(z[:-1], found, float(z[-1]))
            return found

        try:
            first = self.rows(x, None)
            judge(x, first, 0.0)
            if np.min(first.value[~first.soft]) < -_MISSED:
                x = self._towards_own_rows(x)
                judge(x, self.rows(x, None), 0.0)
            slack = min(least, 1.0)
            for _ in range(_PARTS):
                z = descended(np.array([*x, slack]), rows, limits, skipped=x.size)
                now = (best, least) if least < math.inf else (z[:-1], float(z[-1]))
                if np.max(np.abs(now[0] - x)) < _STILL:
                    break
                x, slack = now
        except Kept:
            return best, 0.0
        return (best, least) if least < math.inf else (x, math.inf)

    def _needed(self, x: Real, found: Rows, slack: float) -> float:
        """The slack with which parameters keep every row, infinite where none is known:
        to first order from the rows at some slack, and then measured.
        """
        rate = found.gradient[-1]
        if np.min(found.value[rate == 0.0], initial=0.0) < -_MISSED:
            return math.inf
        given = rate > 0.0
        need = slack - float(np.min(found.value[given] / rate[given], initial=math.inf))
        if need <= 0.0 and slack <= 0.0:
            return need
        need = max(need, 0.0)
        if need > _LARGEST:
            return math.inf
        kept = np.min(self.rows(x, None, need).value) >= -_MISSED
        return need if kept else math.inf

    def _towards_own_rows(self, x: Real) -> Real:
        """Parameters that miss least of what any loop needs, whatever was asked for."""
        limits = [*self.bounds()[:-2], (-_BEYOND, math.inf)]
        best, least = x, math.inf

        def rows(z: Real) -> Rows:
            nonlocal best, least
            found = self.rows(z[:-1], None)
            own = ~found.soft
            slope = found.gradient[:, own]
            slope[-1] = 1.0
            worst = -float(np.min(found.value[own]))
            if worst < least:
                best, least = z[:-1].copy(), worst
                if least <= 0.0:
                    raise Kept
            kept = found.value[own] + z[-1]
            return Rows(kept, slope, found.soft[own], found.link[own], [])

        miss = -float(np.min(self.rows(x, None).value))
        with contextlib.suppress(Kept):
            descended(np.array([*x, miss]), rows, limits, skipped=x.size)
        return best

    def with_sheet(self, sheet: Sheet) -> Problem:
        """Return the problem over other links."""
        return replace(self, sheet=sheet)
