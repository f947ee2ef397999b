"""Where Python meets the compiled arm: what the kernels take, and the two calls into them.

The lumped model (a massless beam) runs through `run_lumped`, one arm or many; the twin through `ArmState`,
which can be stopped, tampered with and continued.

Between two samples the motor's angle is Σ qⱼ xʲ with x = (t − kT)/T. The response of the lumped link to each
power is exact: at the end of its own period by the power series of G = θt/θm, later by the modes of the step
response (a sum of exponentials, see fraclink._systems.response).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fraclink import _kernels
from fraclink._arm.beam import matrices
from fraclink._arm.link import LinkModel, SecondMode
from fraclink._law import Law
from fraclink._simulate.arm import Twin
from fraclink._simulate.plant import Plant, StepMatrices, substeps
from fraclink._simulate.sensors import delay_line
from fraclink._systems.response import discretize
from fraclink.errors import FieldError

__all__ = ["ArmState", "LinkWeights", "LumpedArms", "link_weights", "run_lumped", "second_mode_weights"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Bits = NDArray[np.uint32]

POWERS = 6
# |pole|·T [rad]: beyond, three samples a vibration, the power series cancels and no loop passes.
LONGEST = 2.0
TOLERANCE = 1e-9  # of the step response: 1e-9 rad for a move of 1 rad, three digits below what is promised

# Columns of the twin's inputs and of its record (csrc/kernels/twin.h).
REFERENCE, VELOCITY, ACCELERATION, GAUGE_ERROR, TIP_FORCE, FAULT_BITS = range(6)
ENCODER_GAIN, ENCODER_ERROR, ENCODER_VALUE, GAUGE_GAIN, GAUGE_VALUE = range(6, 11)
RECORD = (
    "reference",
    "motor_angle",
    "tip_angle",
    "torque",
    "motor_angle_measured",
    "torque_measured",
    "motor_reference",
    "voltage",
    "voltage_asked",
    "mode",
    "reason",
    "flags",
    "motor_velocity",
    "contact_force",
    "tip_estimate",
)


# ── the lumped link ─────────────────────────────────────────────────────────────────────────────────────────


@dataclass(frozen=True)
class LinkWeights:
    """Decays and weights of the recursions of R links; see loop.h for the formula.

    decay (R, n), weight (R, 6, n), pair (R, m), pair_weight (R, 6, m), first (R, 6), and second (R, 15), or
    (0, 15) where no link has a second mode.
    """

    decay: Real
    weight: Real
    pair: Complex
    pair_weight: Complex
    first: Real
    second: Real

    def rows(self, rows: slice) -> LinkWeights:
        """Return the recursions of some of the links."""
        return LinkWeights(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})


def link_weights(model: LinkModel, period: float, span: float) -> LinkWeights:
    """Return the recursion of one link's tip at `period` [s], valid for `span` [s].

    >>> weights = link_weights(LinkModel(1.56, 11.094, order=2.0), 0.004, 10.0)
    >>> weights.decay.shape, weights.pair.shape
    ((1, 0), (1, 1))
    """
    reach = abs(model.pole) * period
    if not reach < LONGEST:
        raise FieldError(
            "period",
            period,
            "too long for this link",
            allowed=f"< {LONGEST / abs(model.pole):.3g} s: {2 * math.pi / LONGEST:.2g} samples a vibration",
            remedy="simulate at a shorter period",
        )
    modes = discretize(model.tip(), period, span=span, tolerance=TOLERANCE)
    at_end = [_end_of_power(model, period, j) for j in range(POWERS)]
    real = modes.gains * _relative_powers(modes.log_decays)
    pair = modes.pole_gains * _relative_powers(modes.pole_log_decays)
    first = np.array(at_end) - real.sum(axis=1) - pair.sum(axis=1).real
    second = second_mode_weights(model.second_mode, period)
    return LinkWeights(
        modes.decays[None], real[None], modes.pole_decays[None], pair[None], first[None], second
    )


def second_mode_weights(mode: SecondMode | None, period: float) -> Real:
    """Return the kernel's row of a second mode, shape (1, 15); (0, 15) where there is none.

    Its step response is Re(g₀ e^(pt)) with g₀ = gain (1 + jζ/√(1 − ζ²)): a state z' = p z + g₀ p θm, and the
    angle gain θm + Re z that it adds to the bend: exact at the samples, above the Nyquist frequency too.
    """
    if mode is None:
        return np.zeros((0, 15))
    damped = math.sqrt(1.0 - mode.damping_ratio**2)
    z = mode.frequency * period * complex(-mode.damping_ratio, damped)
    step = mode.gain * complex(1.0, mode.damping_ratio / damped) * np.expm1(z)
    weights = step * _relative_powers(np.array([z]))[:, 0]
    decay = np.exp(z)
    return np.concatenate([[mode.gain, decay.real, decay.imag], weights.real, weights.imag])[None]


def _end_of_power(model: LinkModel, period: float, power: int) -> float:
    """Response of G to xʲ at x = 1: G = Σ −(−X)ⁿ, X = (μ s^α + ω₀²)/s^λ, term by term: t^q/Γ(q + 1)."""
    stiff = model.natural_frequency**2 * period**model.order
    soft = model.damping * period ** (model.order - model.damping_order)
    total = 0.0
    for n in range(1, 100):
        part = 0.0
        for k in range(n + 1 if soft else 1):
            exponent = model.order * n - model.damping_order * k + power
            size = math.comb(n, k) * soft**k * stiff ** (n - k)
            part += size * math.exp(-math.lgamma(exponent + 1))
        total -= (-1) ** n * part
        if part < 1e-18 * abs(total):
            break
    return math.factorial(power) * total


def _relative_powers(log_decay: NDArray[Any]) -> NDArray[Any]:
    """φ_j/φ_0 for j = 0 ... 5, φ_j(z) = ∫₀¹ x^j e^(z(1 − x)) dx: a mode's answer to x^j, relative to a step.

    Where |z| is large φ_j = (j φ_(j-1) − 1)/z; that cancels for small |z|, where the series j! Σ zⁿ/(n + j
    + 1)! is used.
    """
    z = np.atleast_1d(np.asarray(log_decay))
    near = np.abs(z) < 1.0
    small = np.where(near, z, 0.0)
    large = np.where(near, 1.0, z)
    rows = []
    by_recursion = np.expm1(large) / large
    for j in range(POWERS):
        by_series = math.factorial(j) * sum(small**n / math.factorial(n + j + 1) for n in range(20))
        if j:
            by_recursion = (j * by_recursion - 1.0) / large
        rows.append(np.where(near, by_series, by_recursion))
    return np.asarray(np.array(rows) / rows[0])


# Columns of a run's numbers, in the order of batch.h.
_NUMBERS = (
    "stiffness",
    "motor_gain",
    "motor_decay",
    "friction",
    "gauge_offset",
    "noise",
    "delay_samples",
    "amplitude",
    "gauge_delay",
    "gauge_gain",
)


@dataclass(frozen=True)
class LumpedArms:
    """R arms: their links, and one value each, shape (R,), of what differs between them.

    stiffness [N·m/rad], motor_gain A [rad/(s²·V)], motor_decay B [1/s], friction [rad/s²], gauge_offset and
    noise [N·m], delay_samples [periods], amplitude of the reference [rad], gauge_delay [periods], gauge_gain
    [1], and the seed of the noise.
    """

    links: LinkWeights
    stiffness: Real
    motor_gain: Real
    motor_decay: Real
    friction: Real
    gauge_offset: Real
    noise: Real
    delay_samples: Real
    amplitude: Real
    gauge_delay: Real
    gauge_gain: Real
    seed: NDArray[np.uint64]

    def rows(self, rows: slice) -> LumpedArms:
        """Return some of the arms."""
        values = {name: getattr(self, name)[rows] for name in (*_NUMBERS, "seed")}
        return LumpedArms(links=self.links.rows(rows), **values)


def run_lumped(
    law: Law,
    shared: _kernels.LoopRig,
    arms: LumpedArms,
    path: Real,
    chosen: NDArray[np.int32],
    *,
    everything: bool = False,
) -> tuple[Real, Bits]:
    """Run R arms under one law and return their signals and marks.

    Parameters
    ----------
    shared
        what all arms have in common.
    path
        unit references: angle [rad] and acceleration [rad/s²], shape (K, 2, N).
    chosen
        which reference each arm follows, shape (R,).
    everything
        False: tip, motor reference, voltage, shape (3, R, N). True: motor, torque, measured torque and tip
        estimate too, shape (7, R, N). The marks (3, R, N) are flags, mode, reason.
    """
    runs, length = len(arms.seed), path.shape[2]
    signals = np.empty((7 if everything else 3, runs, length))
    marks = np.empty((3, runs, length), dtype=np.uint32)
    links = {
        field.name: np.ascontiguousarray(getattr(arms.links, field.name)) for field in fields(LinkWeights)
    }
    numbers = np.stack([getattr(arms, name) for name in _NUMBERS], axis=1)
    single = law.precision == "single"
    _kernels.loop_run(
        law.block, single, shared, _kernels.Links(**links), numbers, arms.seed, chosen, path, signals, marks
    )
    return signals, marks


# ── the twin ────────────────────────────────────────────────────────────────────────────────────────────────


class ArmState:
    """A twin while it runs: link, gauge queue, voltage queue, sensors, law. Internal, mutable."""

    def __init__(self, twin: Twin, period: float, law_state: bytes, *, start_angle: float = 0.0) -> None:
        self.count = substeps(period, twin.step)
        self.fine = period / self.count
        sensors = twin.sensors
        oldest, weights = delay_line(sensors.gauge_delay / self.fine)
        self.plant, self.step = _discretised(twin, self.fine)
        self.state = self.step.rest()
        self.state[0] = start_angle
        self.state += _straight(self.plant, start_angle, self.state.size)
        self.gauge = np.zeros(oldest + 1)
        self.voltage = np.zeros(twin.voltage_delay + 1)
        self.sensed = np.array([start_angle, 0.0])
        self.counters = np.array([1, 1], dtype=np.uint32)  # stuck, first tick
        self.law = np.frombuffer(bytearray(law_state), dtype=np.uint8)
        # twin_rig of twin.h
        self.rig = np.array(
            [
                self.count,
                twin.voltage_delay,
                oldest,
                twin.motor.gear_ratio * twin.motor.torque_constant,
                twin.motor.voltage_limit,
                twin.coulomb,
                twin.breakaway,
                sensors.angle_quantum,
                sensors.gauge_quantum,
                math.inf if sensors.gauge_limit is None else sensors.gauge_limit,
                sensors.gauge_gain,
                *weights,
            ]
        )
        self.obstacle = np.array([0.0, 0.0, 0.0, twin.beam.length, 1.0])
        self.twin = twin

    def run(self, block: bytes, inputs: NDArray[np.float64], *, single: bool = False) -> NDArray[np.float64]:
        """Advance by the rows of `inputs` under a law's block; returns the kernel's record."""
        return np.asarray(
            _kernels.twin_run(
                *self.step.arrays,
                self.rig,
                self.obstacle,
                block,
                single,
                np.ascontiguousarray(inputs),
                self.law,
                self.state,
                self.gauge,
                self.voltage,
                self.sensed,
                self.counters,
            )
        )

    def sense(self, inputs: Real) -> tuple[float, float]:
        """Return what encoder and gauge read now."""
        angle, torque = _kernels.twin_sense(
            self.rig,
            np.ascontiguousarray(inputs),
            self.state,
            self.gauge,
            self.voltage,
            self.sensed,
            self.counters,
        )
        return float(angle), float(torque)

    def change_payload(self, payload: float) -> None:
        """Go on with another payload: shape, speed and the material's memory stay, the modes are new."""
        twin = self.twin.with_payload(payload)
        plant, step = _discretised(twin, self.fine)
        self.state = _transfer(self.plant, plant, self.state, step)
        self.twin, self.plant, self.step = twin, plant, step


@lru_cache(maxsize=64)
def _discretised(twin: Twin, step: float) -> tuple[Plant, StepMatrices]:
    # Modes and matrix exponential cost more than a run; a campaign asks for the same few arms over and over.
    plant = twin.plant(step)
    return plant, plant.discretise(step)


def _straight(plant: Plant, angle: float, size: int) -> Real:
    """The absolute modal coordinates Γi θm of a straight link whose hub stands at `angle`."""
    state = np.zeros(size)
    for i in range(plant.modes.count):
        state[plant.mode_slice(i).start] = plant.modes.participation[i] * angle
    return state


def _transfer(old: Plant, new: Plant, state: Real, step: StepMatrices) -> Real:
    """Project link, velocity and every Maxwell element of the old modes on the new ones."""
    mass, _ = matrices(new.beam)
    projection = new.modes.shapes.T @ mass @ old.modes.shapes
    result = step.rest()
    result[:2] = state[:2]
    blocks = np.array([state[old.mode_slice(i)] for i in range(old.modes.count)])
    blocks[:, 0] -= old.modes.participation * state[0]
    blocks[:, 1] -= old.modes.participation * state[1]
    moved = projection @ blocks
    moved[:, 0] += new.modes.participation * state[0]
    moved[:, 1] += new.modes.participation * state[1]
    for i in range(new.modes.count):
        result[new.mode_slice(i)] = moved[i]
    return result
