"""The closed loop as a linear system of its reference, and the programme that bends a
spline for it.

As long as no limit acts, the law, its motor loop and the arm are linear and the same in
every period. Two runs of law.c on the arm without friction and noise, one for an
impulse of the reference's angle and one for an impulse of its acceleration, therefore
say what every reference does, exact at the samples.

The reference's velocity is a quadratic B-spline with a knot every few periods, so that
angle, velocity and acceleration are continuous and each coefficient c_j is a smooth
step of c_j rad in three knots. The loop is linear: tip, voltage and motor answer with
the sum of c_j times their answer to one such step, later by j knots, for every payload
at once.

    minimise e  subject to  |Σ c_j y_p(t − jh) − target(t)| <= e
                       and  |Σ c_j V_p(t − jh)| <= V             for all p, t
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from fraclink._arm.link import LinkModel
from fraclink._arm.reference import Path, Reference, SampledReference, hold, sampled
from fraclink._arm.rig import Rig
from fraclink._law import Law
from fraclink._simulate.arm import Twin
from fraclink._simulate.on_twin import with_motor_loop
from fraclink._simulate.run import Run
from fraclink._simulate.simulate import simulate
from fraclink.errors import FieldError

__all__ = [
    "SIGNALS",
    "UNITS",
    "UNLIMITED",
    "MoveBounds",
    "MoveSolution",
    "Programme",
    "Responses",
    "ShapedArm",
    "noise_of",
    "responses_of",
    "spline_path",
    "without_friction",
]

UNLIMITED = 1e4  # [V]: a law's block holds finite numbers


@dataclass(frozen=True)
class ShapedArm:
    """A twin; or, without one, the model of the link behind the rig's motor, gauge and
    encoder.
    """

    rig: Rig
    model: LinkModel
    twin: Twin | None

    def run(
        self,
        law: Law,
        reference: Reference,
        payload: float,
        duration: float,
        *,
        told: bool,
        gauge_offset: float | None = None,
        seed: int = 0,
    ) -> Run:
        """Run a law on the arm with a payload [kg] for `duration` [s]."""
        if self.twin is not None:
            own: dict[str, Any] = {"arm": self.twin.with_payload(payload)}
        else:
            own = {"rig": self.rig, "model": self.model, "payload": payload}
        return simulate(
            law,
            reference,
            **own,
            duration=duration,
            told=told,
            gauge_offset=gauge_offset,
            seed=seed,
        )

    def equipped(self, law: Law) -> Law:
        """Return the law with a motor loop for this arm."""
        if self.twin is not None:
            return with_motor_loop(law, twin=self.twin)[0]
        return with_motor_loop(law, rig=self.rig, link=self.model)[0]

    @property
    def voltage_limit(self) -> float:
        """Of the amplifier [V]."""
        return (
            self.rig.motor.voltage_limit
            if self.twin is None
            else self.twin.motor.voltage_limit
        )

    @property
    def gauge_limit(self) -> float:
        """Largest torque that the gauge shows [N·m]."""
        if self.twin is None:
            return self.rig.gauge.limit
        limit = self.twin.sensors.gauge_limit
        return math.inf if limit is None else limit

    def without_friction(self) -> ShapedArm:
        """Return the arm without friction and with an amplifier that has no limit."""
        rig = replace(
            self.rig,
            motor=replace(self.rig.motor, coulomb_torque=0.0, voltage_limit=UNLIMITED),
        )
        if self.twin is None:
            return ShapedArm(rig, self.model, None)
        motor = replace(self.twin.motor, coulomb_torque=0.0, voltage_limit=UNLIMITED)
        return ShapedArm(rig, self.model, replace(self.twin, motor=motor, stiction=0.0))

    def with_exact_sensors(self) -> ShapedArm:
        """Return the arm with sensors that neither round, limit nor add anything; a
        late gauge stays late.
        """
        gauge = replace(
            self.rig.gauge, noise=0.0, offset=0.0, quantum=0.0, limit=math.inf
        )
        encoder = replace(self.rig.encoder, counts_per_revolution=None)
        rig = replace(self.rig, gauge=gauge, encoder=encoder)
        if self.twin is None:
            return ShapedArm(rig, self.model, None)
        exact = replace(
            self.twin.sensors,
            counts_per_revolution=None,
            gauge_noise=0.0,
            gauge_offset=0.0,
        )
        exact = replace(exact, gauge_quantum=0.0, gauge_limit=None, gauge_drift=0.0)
        return ShapedArm(rig, self.model, replace(self.twin, sensors=exact))


Real = NDArray[np.float64]

# Tip angle, voltage, step of the motor reference in a period, motor speed, torque.
SIGNALS = ("tip", "voltage", "motor_step", "motor_speed", "torque")
UNITS = ("rad", "V", "rad", "rad/s", "N·m")
# Far below every guard of the law, and so far above the rounding of its doubles that
# nothing is lost.
_ANGLE, _ACCELERATION = 1e-4, 1e-2
_NOISE_TIME = 8.0  # [s]: a standard deviation from 2000 samples is known to 2 %
_DIVERGED = 1e3  # of a response that a stable loop lets die away


@dataclass(frozen=True, eq=False)
class Responses:
    """The loops around arms with P payloads [kg]: impulse responses in the rows of
    SIGNALS, (P, 2, 5, N).

    The first of the two is the response to an angle of 1 rad in one period, the second
    to an acceleration of 1 rad/s² in one period; `period` [s].
    """

    payloads: tuple[float, ...]
    period: float
    impulses: Real

    @property
    def length(self) -> int:
        """N, the samples that are known."""
        return int(self.impulses.shape[3])

    @cached_property
    def _spectra(self) -> NDArray[np.complex128]:
        return np.asarray(np.fft.rfft(self.impulses, 2 * self.length))

    def to(self, reference: Reference, names: Sequence[str] = SIGNALS) -> Real:
        """Return the signals of these names along a reference, shape (P, names, N)."""
        inputs = sampled(reference, self.period, self.length)[[0, 2]]
        found = self._spectra[:, :, [SIGNALS.index(name) for name in names]]
        # Twice the length, so that the product of spectra is the sum over the past and
        # does not come around.
        spectrum = np.einsum(
            "if,pisf->psf", np.fft.rfft(inputs, 2 * self.length), found
        )
        return np.asarray(np.fft.irfft(spectrum, 2 * self.length)[..., : self.length])


def without_friction(law: Law, arm: ShapedArm) -> tuple[Law, ShapedArm]:
    """Return the law without its compensation of friction, the arm without friction,
    neither with a limit.
    """
    drive = law.drive
    if drive is None:
        allowed, remedy = "a law with a motor loop", "shape moves for design.law()"
        raise FieldError(
            "law", "no motor loop", "without a voltage", allowed=allowed, remedy=remedy
        )
    free = replace(
        law, drive=replace(drive, coulomb_voltage=0.0, voltage_limit=UNLIMITED)
    )
    return free.in_precision("double"), arm.without_friction()


def responses_of(
    law: Law, arm: ShapedArm, payloads: Sequence[float], duration: float, *, told: bool
) -> Responses:
    """Return the responses of the loop for each payload [kg], over `duration` [s].

    FieldError where one does not die away: the loop is not stable on this arm.
    """
    free, plain = without_friction(law, arm.with_exact_sensors())
    found = []
    for payload in payloads:
        found.append(
            np.stack(
                [_impulse(free, plain, row, payload, duration, told) for row in (0, 2)]
            )
        )
        # A loop that is not stable leaves every bound and is cut, or grows: there is no
        # response to superpose.
        if found[-1].shape != found[0].shape or not np.all(
            np.abs(found[-1][0, 0]) < _DIVERGED
        ):
            problem, allowed = (
                "one with which the loop is not stable",
                "a payload that the law holds",
            )
            remedy = "narrow the range, or design for it"
            raise FieldError(
                "payloads", payload, problem, allowed=allowed, remedy=remedy
            )
    return Responses(tuple(payloads), law.period, np.stack(found))


def _impulse(
    law: Law, arm: ShapedArm, row: int, payload: float, duration: float, told: bool
) -> Real:
    size = _ACCELERATION if row else _ANGLE
    values = np.zeros((3, 4))
    # One period of the angle, or of the acceleration, alone: the law reads both, and
    # takes them for independent.
    values[row, 1] = size  # in the second period: the first one starts the law
    reference = SampledReference(law.period, values)
    # One period longer, for the one in which the law starts.
    run = arm.run(law, reference, payload, duration + law.period, told=told)
    return np.asarray(_signals(run)[:, 1:] / size)


def _signals(run: Run) -> Real:
    steps = np.diff(run.motor_reference, prepend=0.0)
    speed = run.extras.get("motor_velocity")
    if speed is None:  # the model's is not recorded
        speed = np.diff(run.motor_angle, prepend=0.0) / run.period
    return np.array([run.tip_angle, run.voltage, steps, speed, run.torque])


def noise_of(
    law: Law, arm: ShapedArm, payload: float, *, told: bool
) -> dict[str, float]:
    """Return what the sensors' noise makes of each signal where nothing moves, as a
    standard deviation.
    """
    free, quiet = without_friction(law, arm)
    run = quiet.run(free, hold(0.0), payload, _NOISE_TIME, told=told, gauge_offset=0.0)
    return dict(zip(SIGNALS, np.std(_signals(run), axis=1).tolist(), strict=True))


# Pieces of the unit step in powers of x = t/h: angle over the three knots in which it
# rises, then rest.
_STEP = np.array(
    [
        [0.0, 0.0, 0.0, 1 / 6],
        [1 / 6, 1 / 2, 1 / 2, -1 / 3],
        [5 / 6, 1 / 2, -1 / 2, 1 / 6],
        [1.0, 0.0, 0.0, 0.0],
    ]
)
_AFTER = 25  # periods after the reference's end in which a limit may still be reached
_TIP = SIGNALS.index("tip")
_FIRST = 9  # every ninth row is in the programme from the beginning
# Of a row's side, or of a thousandth of the largest one: 0.1 mrad of a move of 1 rad, 1
# mV of 8 V.
_BROKEN, _PART = 1e-4, 1e-3


@dataclass(frozen=True)
class MoveBounds:
    """Largest magnitude of each signal but the tip, and of the reference's velocity and
    acceleration.
    """

    signals: dict[str, float]
    velocity: float
    acceleration: float


@dataclass(frozen=True)
class MoveSolution:
    """Coefficients [rad] and the largest distance of the tip to its target [rad]."""

    coefficients: Real
    distance: float


@dataclass(frozen=True)
class Programme:
    """Loops for every payload, the periods between two knots, and the bounds."""

    loops: Responses
    knot: int
    bounds: MoveBounds

    @property
    def period(self) -> float:
        """Of the law [s]."""
        return self.loops.period

    @property
    def length(self) -> int:
        """Samples that are known of every response."""
        return self.loops.length

    @cached_property
    def _answers(self) -> Real:
        """To one smooth step of 1 rad: shape (payloads, signals, N)."""
        return self.loops.to(spline_path(np.ones(1), self.knot * self.period))

    def solve(
        self,
        count: int,
        target: Real,
        first: int,
        last: int,
        *,
        within: float | None = None,
    ) -> MoveSolution | None:
        """Return the spline of `count` coefficients whose tip is nearest to `target`
        from row first to last.

        The reference ends where the target ends. With `within` [rad] the tip keeps that
        distance and the acceleration varies as little as it can: of all such references
        the gentlest. None where no reference keeps the bounds.
        """
        rows, sides = self._kept(count, target, first, last)
        ends = np.append(np.ones(count), 0.0)
        free: list[tuple[float | None, float | None]] = [(None, None)] * count
        most: list[tuple[float | None, float | None]] = [(0.0, within)]
        end = [float(target[-1])]
        # The last unknown is e, the distance; nothing else costs.
        cost = np.append(np.zeros(count), 1.0)
        if within is not None:
            # Σ |differences of the acceleration| as a linear programme: each bounded by
            # an unknown of its own.
            jerk = self._jerk(count)
            extra = len(jerk)
            rows = np.block(
                [
                    [rows, np.zeros((len(rows), extra))],
                    [jerk, -np.eye(extra)],
                    [-jerk, -np.eye(extra)],
                ]
            )
            sides = np.append(sides, np.zeros(2 * extra))
            cost, ends = (
                np.append(np.zeros(count + 1), np.ones(extra)),
                np.append(ends, np.zeros(extra)),
            )
            most += [(0.0, None)] * extra
        found = _least(cost, rows, sides, ends[None, :], end, free + most)
        return (
            None if found is None else MoveSolution(found[:count], float(found[count]))
        )

    def _kept(
        self, count: int, target: Real, first: int, last: int
    ) -> tuple[Real, Real]:
        """Every inequality as rows @ (c, e) <= sides."""
        # Once the reference rests the loop only decays: its peaks lie before, or within
        # a tenth of a second.
        until = min(count * self.knot + _AFTER, self.length)
        rows, sides = [], []
        for answer in self._answers:
            moved = self._shifted(answer[_TIP], count)[first:last]
            wanted, one = target[first:last], np.ones((len(moved), 1))
            rows += [np.hstack([moved, -one]), np.hstack([-moved, -one])]
            sides += [wanted, -wanted]
            for name, most in self.bounds.signals.items():
                part = self._shifted(answer[SIGNALS.index(name)], count)[:until]
                rows += [np.pad(sign * part, ((0, 0), (0, 1))) for sign in (1.0, -1.0)]
                sides += [np.full(len(part), most)] * 2
        for own, most in self._of_reference(count):
            rows += [np.pad(sign * own, ((0, 0), (0, 1))) for sign in (1.0, -1.0)]
            sides += [np.full(len(own), most)] * 2
        return np.vstack(rows), np.concatenate(sides)

    def _shifted(self, answer: Real, count: int) -> Real:
        found = np.zeros((len(answer), count))
        for j in range(count):
            found[j * self.knot :, j] = answer[: len(answer) - j * self.knot]
        return found

    def _of_reference(self, count: int) -> tuple[tuple[Real, float], ...]:
        """Velocity and acceleration at the knots, which bound them in between."""
        step = self.knot * self.period
        return (
            (np.eye(count) / step, self.bounds.velocity),
            (self._difference(count) / step**2, self.bounds.acceleration),
        )

    @staticmethod
    def _difference(count: int) -> Real:
        return np.diff(
            np.vstack([np.zeros((1, count)), np.eye(count), np.zeros((1, count))]),
            axis=0,
        )

    def _jerk(self, count: int) -> Real:
        """Differences of the acceleration between knots over the most that it may be; a
        column for e.
        """
        second = np.pad(self._difference(count), ((1, 1), (0, 0)))
        scale = (self.knot * self.period) ** 2 * self.bounds.acceleration
        return np.pad(np.diff(second, axis=0) / scale, ((0, 0), (0, 1)))

    def path(self, solution: MoveSolution) -> Path:
        """Return the reference."""
        return spline_path(solution.coefficients, self.knot * self.period)

    def count_for(self, time: float) -> int:
        """Coefficients of a reference that goes on for two knots after `time` [s]."""
        return max(1, math.ceil(time / (self.knot * self.period) - 1e-9)) + 2


def _least(
    cost: Real,
    rows: Real,
    sides: Real,
    ends: Real,
    end: list[float],
    bounds: list[tuple[float | None, float | None]],
) -> Real | None:
    """Minimise cost @ x with rows @ x <= sides and ends @ x = end; None where nothing
    fulfils them.

    Of thousands of rows some dozens bind: the programme is solved with a few of them
    and again with all that its solution breaks, until it breaks none. That is exact,
    and takes a third of the time of all rows at once.
    """
    scale = np.maximum(np.abs(sides), _PART * np.max(np.abs(sides)))
    chosen = np.zeros(len(rows), dtype=bool)
    chosen[::_FIRST] = True
    while True:
        # presolve removes nothing from a dense programme, and costs more than the
        # solution
        found = linprog(
            cost,
            rows[chosen],
            sides[chosen],
            ends,
            end,
            bounds,
            method="highs",
            options={"presolve": False},
        )
        if found.x is None:
            return None
        broken = rows @ found.x - sides > _BROKEN * scale
        if not np.any(broken & ~chosen):
            return np.asarray(found.x)
        # with their neighbours, which are next where the peak moves to one side
        chosen |= np.convolve(broken, np.ones(5), mode="same") > 0


def spline_path(coefficients: Real, step: float) -> Path:
    """Return the sum of smooth steps of these sizes [rad], one every `step` [s]."""
    count = len(coefficients)
    pieces = np.zeros((count + 3, 4))
    for j, size in enumerate(coefficients):
        pieces[j : j + 3] += size * _STEP[:3]
        pieces[j + 3 :, 0] += size
    # From powers of t/h to powers of t.
    pieces /= step ** np.arange(4.0)
    return Path("shaped", step * np.arange(count + 3.0), pieces, step * (count + 2))
