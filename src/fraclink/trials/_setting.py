"""What every rival is tuned on: the rig, fraclink's design and its Ms, and the nominal
loop at the period.

All rivals that use the tip estimate have the form of the corrected equation (22),

    θm* = θt* + F(z) θ̈t* + Ĉ(z) e,   e = θt* − (θm − Γ/c),

with one feed-forward F for all and a correction Ĉ of their own. The nominal loop is the
one a designer knows: L = Ĉ(z) z^−d ZOH{M G} with the lumped model of the nominal
payload.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, minimize_scalar

from fraclink._arm.beam import DEFAULT_MASS, Beam
from fraclink._arm.controller import Controller
from fraclink._arm.link import LinkModel
from fraclink._arm.rig import Rig
from fraclink._design import design
from fraclink._law import Law, discretize
from fraclink._simulate.arm import Twin, damping_of, geared
from fraclink._simulate.on_twin import with_motor_loop
from fraclink._simulate.plant import LONGEST_STEP, Plant, assemble
from fraclink.errors import FieldError, NotConvergedError

__all__ = [
    "Filter",
    "NominalLoop",
    "Setting",
    "fine_step",
    "law_filter",
    "prepare",
    "sampled",
    "tune",
    "tustin",
]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class Filter:
    """A discrete filter x⁺ = A x + b u, y = c x + d u."""

    a: Real
    b: Real
    c: Real
    d: float

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.b)

    def response(self, z: Complex) -> Complex:
        """Return the transfer function at z, shape kept."""
        if self.order == 0:
            return np.full(np.shape(z), self.d, dtype=np.complex128)
        points = np.ravel(z)
        # 3000 points are 400 MB of matrices for the 90 states of a beam; a megabyte of
        # them stays cached.
        blocks = np.array_split(points, 1 + points.size * self.order**2 // 65_536)
        found = np.concatenate([self._at(block) for block in blocks])
        return np.asarray(found.reshape(np.shape(z)), dtype=np.complex128)

    def _at(self, points: Complex) -> Complex:
        # Solved and not inverted: near a pole z − A is nearly singular.
        matrix = points[:, None, None] * np.eye(self.order) - self.a
        column = np.broadcast_to(self.b[:, None], (*matrix.shape[:-1], 1))
        return np.asarray(
            np.linalg.solve(matrix, column)[..., 0] @ self.c + self.d,
            dtype=np.complex128,
        )

    def after(self, first: Filter) -> Filter:
        """Return this filter behind `first`."""
        n, m = first.order, self.order
        a = np.zeros((n + m, n + m))
        a[:n, :n], a[n:, n:], a[n:, :n] = first.a, self.a, np.outer(self.b, first.c)
        return Filter(
            a,
            np.concatenate([first.b, self.b * first.d]),
            np.concatenate([self.d * first.c, self.c]),
            self.d * first.d,
        )


def tustin(a: Real, b: Real, c: Real, d: float, period: float) -> Filter:
    """Discretise ẋ = a x + b u, y = c x + d u by Tustin's rule at `period` [s]."""
    half = 0.5 * period
    # Tustin's rule keeps the order, and a pole is stable after it exactly if it was
    # before.
    left = np.linalg.inv(np.eye(len(b)) - half * a)
    # The state is scaled so that the discrete b is left·b·T: no square roots of the
    # period are needed.
    return Filter(
        left @ (np.eye(len(b)) + half * a),
        period * (left @ b),
        c @ left,
        float(d + half * c @ left @ b),
    )


def law_filter(law: Law) -> Filter:
    """Return the correction Ĉ(z) of a law: (1 − z⁻¹)(direct + Σ gain/(z − pole)), as
    law.c computes it.
    """
    modes = law.correction
    reals = len(modes.poles)
    size = 1 + reals + 2 * len(modes.pair_poles)
    a, b, c = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    # State 0 is the last error; every mode is driven by its change and read before its
    # update.
    b[0], c[0] = 1.0, -modes.direct
    for i, (pole, gain) in enumerate(
        zip(modes.poles, modes.gains, strict=True), start=1
    ):
        a[i, i], a[i, 0], b[i], c[i] = pole, -1.0, 1.0, gain
    for j, (turn, weight) in enumerate(
        zip(modes.pair_poles, modes.pair_gains, strict=True)
    ):
        re = 1 + reals + 2 * j
        a[re, re], a[re, re + 1], a[re, 0], b[re] = turn.real, -turn.imag, -1.0, 1.0
        a[re + 1, re], a[re + 1, re + 1] = turn.imag, turn.real
        c[re], c[re + 1] = weight.real, -weight.imag
    return Filter(a, b, c, modes.direct)


def fine_step(period: float) -> float:
    """Return the longest step of at most 1 ms that divides the period [s]."""
    return period / max(1, math.ceil(period / LONGEST_STEP - 1e-9))


def sampled(
    plant: Plant, row: Real, period: float, delay: int, *, gain: float = 1.0
) -> Filter:
    """Return gain·z^−delay·ZOH of an output `row` of a plant, exactly; the delay adds
    states.
    """
    step = fine_step(period)
    exact, n = plant.discretise(step), plant.order
    single, drive = exact.transition[:, :n].T, gain * exact.hub[:n]
    a, b = np.eye(n), np.zeros(n)
    for _ in range(round(period / step)):
        # The period is a whole number of fine steps with one held input: exact, as the
        # plant's own steps are.
        a, b = single @ a, single @ b + drive
    held = Filter(a, b, row, 0.0)
    if delay == 0:
        return held
    return held.after(
        Filter(np.eye(delay, k=1), np.eye(delay)[-1], np.eye(delay)[0], 0.0)
    )


@dataclass(frozen=True, eq=False)
class NominalLoop:
    """The lumped model behind M(s), held and delayed, at the control period: what the
    designer knows.

    `plant` is ZOH{M G} with the delay as extra states, from a motor reference to the
    tip angle.
    """

    plant: Filter
    period: float
    stiffness: float

    @staticmethod
    def of(
        model: LinkModel, payload: float, *, period: float, pole: float, delay: int
    ) -> NominalLoop:
        """Return the loop of a lumped model with its payload [kg] (both exact, no link
        mass).
        """
        # A massless beam is the lumped model; its length is free, the frequency fixes m
        # L². Of unit length: m = c/ω₀². Neither L nor m by itself is seen in θt/θm.
        mass = model.stiffness / model.natural_frequency**2
        beam = Beam(1.0, model.stiffness / 3.0, 0.0, mass)
        step = fine_step(period)
        plant = assemble(
            beam, damping_of(model), drive="servo", step=step, servo_pole=pole
        )
        return NominalLoop(
            sampled(plant, plant.outputs[2], period, delay), period, model.stiffness
        )

    @cached_property
    def frequencies(self) -> Real:
        """The grid [rad/s] on which the sensitivity is looked at: 2 % steps from 0.1
        rad/s to Nyquist.
        """
        # Steps of 2 %: a grid that is even in ω would miss the resonance or waste its
        # points beyond it.
        nyquist = math.pi / self.period
        return np.asarray(
            np.geomspace(0.1, 0.999 * nyquist, int(50 * math.log(nyquist / 0.1)))
        )

    @cached_property
    def response(self) -> Complex:
        """The plant on that grid."""
        return self.plant.response(np.exp(1j * self.frequencies * self.period))

    def loop(self, correction: Filter, frequency: Real) -> Complex:
        """Return L = Ĉ P on the unit circle."""
        z = np.exp(1j * np.asarray(frequency) * self.period)
        return np.asarray(correction.response(z) * self.plant.response(z))

    def radius(self, correction: Filter) -> float:
        """Return the spectral radius of the closed loop: stable below 1."""
        p, k = self.plant, correction
        n = p.order
        # The states of plant and controller side by side, e = −y: its eigenvalues are
        # the loop's poles, those of the delay included, and no root of a polynomial of
        # high degree is asked for.
        closed = np.zeros((n + k.order, n + k.order))
        closed[:n, :n] = p.a - k.d * np.outer(p.b, p.c)
        closed[:n, n:] = np.outer(p.b, k.c)
        closed[n:, :n] = -np.outer(k.b, p.c)
        closed[n:, n:] = k.a
        return float(np.abs(np.linalg.eigvals(closed)).max())

    def peak(self, correction: Filter) -> float:
        """Return Ms = max |1/(1 + L)|, infinite where the loop is unstable."""
        # The power-law link itself has a relaxation slower than any move: a pole at 1
        # to eleven digits.
        if self.radius(correction) > 1.0 + 1e-9:
            return math.inf
        z = np.exp(1j * self.frequencies * self.period)
        return float(np.max(1.0 / np.abs(1.0 + correction.response(z) * self.response)))


def tune(
    loop: NominalLoop,
    make: Callable[[float], Filter],
    knob: tuple[float, float],
    target: float,
) -> tuple[float, Filter, bool]:
    """Return the knob in [low, high] at which Ms is `target`, its filter, and whether
    Ms could be reached.

    The knob is raised in 60 geometric steps; of the first range of knobs whose Ms is at
    or below the target the upper end is taken, since more feedback is what a knob
    stands for. Larger knobs that come back under the target lie behind a worse range
    and are not taken. Where no knob reaches the target the knob of the smallest Ms is
    taken: the most careful tuning that the structure has.
    """
    values = np.geomspace(knob[0], knob[1], 60)
    peaks = []
    for value in values.tolist():
        peaks.append(loop.peak(make(value)))
        # The first good range has ended: larger knobs would be behind a range that is
        # worse.
        if peaks[-1] > target and any(p <= target for p in peaks):
            break
    good = [i for i, peak in enumerate(peaks) if peak <= target]
    if not good:
        return _least(loop, make, values, peaks)
    last = good[-1]
    if last + 1 == len(values):
        return float(values[-1]), make(float(values[-1])), True
    # Ms is infinite where the loop is unstable; brentq needs numbers, and only their
    # sign matters there.
    excess = brentq(
        lambda x: min(loop.peak(make(math.exp(x))), 1e3) - target,
        math.log(values[last]),
        math.log(values[last + 1]),
        xtol=1e-6,
    )
    value = math.exp(float(excess))
    return value, make(value), True


def _least(
    loop: NominalLoop, make: Callable[[float], Filter], values: Real, peaks: list[float]
) -> tuple[float, Filter, bool]:
    best = int(np.argmin(peaks))
    if not math.isfinite(peaks[best]):
        raise NotConvergedError(
            "tuning",
            reached=peaks[best],
            wanted=1.0,
            remedy="no knob of the range stabilises the nominal arm",
        )
    low, high = (
        float(values[max(best - 1, 0)]),
        float(values[min(best + 1, len(values) - 1)]),
    )
    # Ms has one minimum between two neighbours of the grid.
    found = minimize_scalar(
        lambda x: loop.peak(make(math.exp(x))),
        bounds=(math.log(low), math.log(high)),
        method="bounded",
        options={"xatol": 1e-5},
    )
    value = math.exp(float(found.x))
    return value, make(value), False


@dataclass(frozen=True)
class Setting:
    """Rig, lumped model and fraclink's design: what every rival is tuned from."""

    rig: Rig
    model: LinkModel
    law: Law
    controller: Controller
    loop: NominalLoop
    gain_crossover: float
    phase_margin: float

    @property
    def target(self) -> float:
        """Ms of fraclink's design at the nominal payload, on the lumped model."""
        return self.loop.peak(law_filter(self.law))


def prepare(
    rig: Rig,
    model: LinkModel | None,
    link_mass: float | None,
    *,
    gain_crossover: float,
    phase_margin: float,
    filter_time: float | None,
) -> tuple[Setting, Twin, list[str]]:
    """Return what the rivals are tuned from, the arm they run on, and what was assumed."""
    # What the designers know; the twin behind it has its link's mass on top, so that
    # all of them are wrong alike.
    known = rig.model if model is None else model
    if known is None:
        raise FieldError(
            "model", None, "missing", allowed="a LinkModel", remedy="identify one first"
        )
    mass = (rig.link.mass or DEFAULT_MASS) if link_mass is None else link_mass
    # One tuning for all payloads, at the nominal one, as a laboratory would do it; the
    # table then asks the others.
    nominal = known.at_payload(rig.payloads.nominal) if known.payload else known
    notes = [f"link of {1e3 * mass:g} g, {damping_of(nominal).label}"]
    # All rivals must fail or pass by their control and not by a compensation that no
    # law could make stable.
    if Twin.from_rig(rig, link_mass=mass, damping=damping_of(nominal)).findings:
        rig = geared(rig)
        notes.append(
            "the rig's hub is too light for a sampled compensation (W601): a gear of 50:1 added"
        )
    twin = Twin.from_rig(rig, link_mass=mass, damping=damping_of(nominal))
    result = design(
        nominal,
        rig,
        payloads=(rig.payloads.low, rig.payloads.high),
        gain_crossover=gain_crossover,
        phase_margin=phase_margin,
        filter_time=filter_time,
        law=False,
    )
    law, _ = with_motor_loop(discretize(result.controller, rig.period), twin=twin)
    loop = NominalLoop.of(
        nominal,
        rig.payloads.nominal,
        period=rig.period,
        pole=law.inner_pole,
        delay=rig.motor_loop.delay_samples,
    )
    setting = Setting(
        rig, nominal, law, result.controller, loop, gain_crossover, phase_margin
    )
    notes.append(
        f"fraclink's design: crossover {gain_crossover:g} rad/s, margin {math.degrees(phase_margin):g}°, "
        f"δ {result.controller.filter_time:.3g} s; its Ms at {1e3 * rig.payloads.nominal:g} g is "
        f"{setting.target:.3f} on the lumped model"
    )
    return setting, twin, notes
