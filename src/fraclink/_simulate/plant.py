"""The linear part of the twin with exact steps: its hub and the modes of its link.

Hub angle θm and velocity v, then for every mode the absolute coordinate pi = qi + Γi
θm, its velocity, and one state zj per Maxwell element of the damping:

    fi  = ωi² (e qi + d q̇i + Σj wj zj)           modal force of the material, e spring, d dashpot
    żj  = q̇i − rj zj
    p̈i  = −fi + φi(L) F                           F: a force on the tip [N]
    hub:               (J + I_res) v̇ = τ − ν v + Σ Γi fi     I_res = I − Σ Γi²: the inertia that the modes leave out

Between two steps the inputs are constant and the step is the exact matrix exponential.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from fraclink import _kernels
from fraclink._arm.beam import Beam, BeamModes, residual_inertia
from fraclink._simulate.damping import Chain, Damping
from fraclink.errors import FieldError
from fracsys.checks import Between, Period, Positive, Real, checked

__all__ = [
    "LONGEST_STEP",
    "Plant",
    "StepMatrices",
    "assemble",
    "resolved",
    "substeps",
]


# Relative error of D(jω), the same for all modes, so that the elements keep their
# meaning when the payload, and with it the mode shapes, change. At λ = 1.92 the
# resonance amplifies this error about 50 times in the tip angle.
TOLERANCE = 3e-8
# [s] for which the hub's inputs are held: a tenth of the period of mode 3 of the paper's
# arm
LONGEST_STEP = 1e-3
Step = Annotated[
    float, Between(1e-6, LONGEST_STEP, "s", remedy="1 ms is exact for three modes")
]

# Rows of the outputs.
HUB_ANGLE, HUB_VELOCITY, TIP_ANGLE, GAUGE_TORQUE, TIP_VELOCITY, HUB_MOMENT = range(6)


@dataclass(frozen=True)
class StepMatrices:
    """x⁺ = A x + b u, y = C x over `step` seconds, laid out for the kernel.

    Row j of `transition` is column j of A, padded with zeros to a whole number of
    vectors; `hub` and `tip` are the columns of b, `outputs` is C, padded alike.
    """

    order: int
    transition: Real
    hub: Real
    tip: Real
    outputs: Real


@dataclass(frozen=True)
class Plant:
    """The assembled twin: ẋ = A x + B u, y = C x.

    Inputs u: (net motor torque [N·m], tip force [N]). Outputs y: hub angle
    [rad], hub velocity [rad/s], tip angle [rad], gauge torque −EI w''(0) [N·m], tip
    velocity [rad/s], moment of the material on the hub [N·m].
    """

    beam: Beam
    modes: BeamModes
    chain: Chain
    dynamics: Real
    inputs: Real
    outputs: Real

    @property
    def order(self) -> int:
        """Number of states."""
        return int(self.dynamics.shape[0])

    def modal(self, state: Real) -> Real:
        """Return a view of the modes' part of a state, a row for each mode: its
        coordinate, its velocity, its Maxwell elements.
        """
        return state[2 : self.order].reshape(self.modes.frequencies.size, -1)

    def discretise(self, step: float) -> StepMatrices:
        """Return the exact step of length `step` [s] for inputs held over it."""
        n, m = self.inputs.shape
        block = np.zeros((n + m, n + m))
        block[:n, :n], block[:n, n:] = self.dynamics * step, self.inputs * step
        exact = _kernels.twin_exponential(block)
        # Padded to vectors of eight doubles, so that the inner loops of the kernel have
        # no remainder.
        stride = -(-n // 8) * 8
        columns, drives = np.zeros((n, stride)), np.zeros((m, stride))
        outputs = np.zeros((self.outputs.shape[0], stride))
        columns[:, :n], drives[:, :n], outputs[:, :n] = (
            exact[:n, :n].T,
            exact[:n, n:].T,
            self.outputs,
        )
        for array in (columns, drives, outputs):
            array.flags.writeable = False
        return StepMatrices(n, columns, drives[0], drives[1], outputs)


@checked
def substeps(period: Period, step: Step) -> int:
    """Return the number of steps of at most `step` [s] in one period [s]."""
    # 3 ms over steps of 0.3 ms is 10.000000000000002 in binary; this must not become
    # eleven.
    return max(1, math.ceil(period / step - 1e-9))


def resolved(beam: Beam, modes: int | None, step: float) -> BeamModes:
    """Return the modes that a step resolves; an explicit number beyond that is
    rejected.
    """
    # Three modes of the link: the third moves the tip by at most 1.3 mrad in a move of
    # 1 rad.
    candidates = beam.modes(3 if modes is None else modes)
    # At least four steps per period of a mode: with fewer, the held input cannot follow
    # it at all.
    count = int(np.count_nonzero(candidates.frequencies * step <= np.pi / 2))
    if count == 0 or (modes is not None and count < candidates.frequencies.size):
        raise FieldError(
            "modes",
            modes,
            f"more than the step resolves (mode {count + 1} is at {candidates.frequencies[count]:.4g} rad/s)",
            f"frequency x step <= pi/2, here {count} modes",
            f"take fewer modes or a step of {0.5 * np.pi / candidates.frequencies[-1]:.2g} s",
        )
    return beam.modes(count)


def _rows(
    size: int, at: int, omega: float, load: float, chain: Chain
) -> tuple[Real, Real, Real]:
    """One mode's qi, q̇i and fi as rows over the states."""
    place, speed, force = np.zeros(size), np.zeros(size), np.zeros(size)
    place[at], place[0] = 1.0, -load
    speed[at + 1], speed[1] = 1.0, -load
    force += omega**2 * (chain.spring * place + chain.dashpot * speed)
    force[at + 2 : at + 2 + chain.rates.size] = omega**2 * chain.weights
    return place, speed, force


@checked
def assemble(
    beam: Beam,
    damping: Damping,
    *,
    hub_inertia: Positive,
    hub_friction: Annotated[float, Between(0.0)] = 0.0,
    modes: int | None = None,
    step: Step = LONGEST_STEP,
) -> Plant:
    """Assemble the linear twin.

    Parameters
    ----------
    hub_inertia
        J of motor and hub at the link's side [kg·m²]
    hub_friction
        ν [N·m·s/rad]
    modes
        number of modes; default as many of the first three as `step` resolves
    step
        longest step that will be taken [s]

    >>> from fraclink._simulate import PowerLaw
    >>> rod = Beam(0.65, 0.338, 0.0, 0.030)
    >>> plant = assemble(rod, PowerLaw(1.92), hub_inertia=0.01)
    >>> s = 12j * np.eye(len(plant.dynamics))
    >>> hub, _, tip, *_ = plant.outputs @ np.linalg.solve(s - plant.dynamics, plant.inputs[:, 0])
    >>> square = rod.stiffness / (0.030 * 0.65**2)
    >>> exact = square / (12j**1.92 + square)
    >>> bool(abs(tip / hub - exact) < 1e-6)  # the massless limit is equation (9)
    True
    """
    basis = resolved(beam, modes, step)
    # no mode has a higher frequency, whatever the payload
    chain = damping.chain(TOLERANCE, 0.5 * np.pi / step)
    size = 2 + basis.frequencies.size * (2 + chain.rates.size)
    a, b, y = np.zeros((size, size)), np.zeros((size, 2)), np.zeros((6, size))
    # The inertia of the arm that is not carried by the retained modes turns rigidly
    # with the hub; without it a heavy link would lack the inertia of its higher modes.
    inertia = hub_inertia + residual_inertia(beam, basis)
    y[HUB_ANGLE, 0] = y[HUB_VELOCITY, 1] = y[TIP_ANGLE, 0] = y[TIP_VELOCITY, 1] = 1.0

    at = 2
    for i in range(basis.frequencies.size):
        omega, load, tip = (
            basis.frequencies[i],
            basis.participation[i],
            basis.tip[i],
        )
        law = chain
        if i and damping.higher is not None:
            # The elements stay, without force, so that all modes have the same number of
            # states; the material remains as stiff as it is at that frequency.
            spring = chain(1j * omega).real
            law = Chain(
                spring, spring * damping.higher, 0.0 * chain.weights, chain.rates
            )
        place, speed, force = _rows(size, at, omega, load, law)
        elements = slice(at + 2, at + 2 + chain.rates.size)
        a[at, at + 1] = 1.0
        a[at + 1] = -force
        b[at + 1, 1] = tip * beam.length
        a[elements] = speed
        a[elements, elements] -= np.diag(chain.rates)
        y[TIP_ANGLE] += tip * place
        # EI w''(0) from the curvature of the modes at the clamp, without D(s): a gauge
        # measures strain, not stress.
        y[GAUGE_TORQUE] -= omega**2 * load * place
        y[TIP_VELOCITY] += tip * speed
        y[HUB_MOMENT] += load * force
        at = elements.stop
    a[0, 1] = 1.0
    a[1] = y[HUB_MOMENT] / inertia
    a[1, 1] -= hub_friction / inertia
    b[1, 0] = 1.0 / inertia
    for array in (a, b, y):
        array.flags.writeable = False
    return Plant(beam, basis, chain, a, b, y)
