"""The twin as one linear system, stepped exactly: hub, modes and the material's Maxwell elements.

States: hub angle θm and velocity v, then for every mode the absolute coordinate pi = qi + Γi θm, its
velocity, and one state zj per Maxwell element of the damping:

    fi  = ωi² (e0 qi + d q̇i + Σj wj zj)          modal force of the material
    żj  = q̇i − rj zj
    p̈i  = −fi + φi(L) F                          F: a force on the tip [N]
    hub (motor):       (J + I_res) v̇ = τ − ν v + Σ Γi fi     I_res = I − Σ Γi²: what the modes leave out
    hub (servo):       v̇ = p²(θ* − θm) − 2 p v               M(s) of equation (21)
    hub (prescribed):  v given, constant over a step

Between two steps the inputs are constant and the step is the exact matrix exponential.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fraclink.errors import FieldError
from fraclink.twin.beam import Beam, Modes
from fraclink.twin.damping import Chain, Damping

__all__ = ["Plant", "StepMatrices", "assemble"]

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Drive = Literal["motor", "servo", "prescribed"]

TOLERANCE = 1e-7  # of D(jω); the lumped limit then agrees with the exact response to 1e-7
LONGEST_STEP = 1e-3  # [s]; longer steps would hold the hub's force or speed over a quarter of mode 2


@dataclass(frozen=True)
class Plant:
    """The assembled twin: ẋ = A x + B u, its outputs and its energy.

    Inputs u: (hub input, tip force [N]); the hub input is the net motor torque [N·m], the servo's reference
    [rad] or the hub's velocity [rad/s]. Outputs of `outputs @ x`: hub angle, hub velocity, tip angle, gauge
    torque −EI w''(0), tip velocity, moment of the material on the hub.
    """

    beam: Beam
    modes: Modes
    chain: Chain
    drive: Drive
    inertia: float
    dynamics: Matrix
    inputs: Matrix
    outputs: Matrix
    energy_matrix: Matrix

    @property
    def order(self) -> int:
        """Number of states."""
        return int(self.dynamics.shape[0])

    def energy(self, state: Vector) -> float:
        """Kinetic plus stored energy of hub and link [J]; input-free it can only fall."""
        return float(state @ self.energy_matrix @ state)

    def discretise(self, step: float) -> StepMatrices:
        """Return the exact step of length `step` [s] for inputs held over it."""
        from scipy.linalg import expm

        n, m = self.inputs.shape
        block = np.zeros((n + m, n + m))
        block[:n, :n], block[:n, n:] = self.dynamics * step, self.inputs * step
        exact = expm(block)
        stride = -(-n // 8) * 8
        columns = np.zeros((n, stride))
        columns[:, :n] = exact[:n, :n].T
        drives = np.zeros((m, stride))
        drives[:, :n] = exact[:n, n:].T
        outputs = np.zeros((self.outputs.shape[0], stride))
        outputs[:, :n] = self.outputs
        for array in (columns, drives, outputs):
            array.flags.writeable = False
        return StepMatrices(step, n, columns, drives[0], drives[1], outputs)


@dataclass(frozen=True)
class StepMatrices:
    """x⁺ = A x + b u, y = C x over `step` seconds, laid out for the kernel.

    Row j of `transition` is column j of A, padded with zeros to a whole number of vectors; `hub` and `tip` are
    the columns of b, `outputs` is C, padded alike.
    """

    step: float
    order: int
    transition: Matrix
    hub: Vector
    tip: Vector
    outputs: Matrix

    @property
    def arrays(self) -> tuple[Matrix, Vector, Vector, Matrix]:
        """What the kernel takes first."""
        return self.transition, self.hub, self.tip, self.outputs

    def rest(self) -> Vector:
        """Return the state of a straight link at rest with its hub at 0."""
        return np.zeros(self.hub.size)


def _resolved(beam: Beam, modes: int | None, step: float) -> Modes:
    """The modes that a step resolves; an explicit number that it does not is refused."""
    if isinstance(step, bool) or not isinstance(step, int | float) or not 0.0 < step <= LONGEST_STEP:
        raise FieldError(
            "step", step, "out of range", allowed=f"0 < step <= {LONGEST_STEP} s", remedy="use 0.001 s"
        )
    found = beam.modes(3 if modes is None else modes)
    # Four steps per period: with fewer the input held over a step cannot follow the mode at all.
    fit = int(np.count_nonzero(found.frequencies * step <= np.pi / 2))
    if modes is not None and fit < found.count:
        raise FieldError(
            "modes",
            modes,
            f"more than the step resolves (mode {fit + 1} is at {found.frequencies[fit]:.4g} rad/s)",
            allowed=f"frequency x step <= pi/2, here {fit} modes",
            remedy=f"take {max(fit, 1)} modes or a step of {0.5 * np.pi / found.frequencies[-1]:.2g} s",
        )
    return beam.modes(max(fit, 1))


def assemble(
    beam: Beam,
    damping: Damping,
    *,
    drive: Drive,
    modes: int | None = None,
    step: float = LONGEST_STEP,
    hub_inertia: float = 0.0,
    hub_friction: float = 0.0,
    servo_pole: float = 80.0,
) -> Plant:
    """Assemble the linear twin.

    Parameters
    ----------
    drive: what moves the hub, see the module's equations
    modes: number of modes; default as many of the first three as `step` resolves
    step: longest step that will be taken [s]
    hub_inertia: J of motor and hub at the link's side [kg·m²], drive "motor" only
    hub_friction: ν [N·m·s/rad], drive "motor" only
    servo_pole: p of M(s) = 1/(1 + s/p)² [rad/s], drive "servo" only
    """
    kept = _resolved(beam, modes, step)
    chain = damping.chain(TOLERANCE)
    width = 2 + chain.rates.size
    n = 2 + kept.count * width
    a, b = np.zeros((n, n)), np.zeros((n, 2))
    y = np.zeros((6, n))
    energy = np.zeros((n, n))
    residual = beam.inertia - float(np.sum(kept.participation**2))
    inertia = hub_inertia + max(residual, 0.0)

    if drive != "prescribed":
        a[0, 1] = 1.0
    else:
        b[0, 0] = 1.0
    y[0, 0] = y[1, 1] = 1.0
    y[2, 0] = 1.0
    for i in range(kept.count):
        omega, load, tip = kept.frequencies[i], kept.participation[i], kept.tip[i]
        at = 2 + i * width
        elements = slice(at + 2, at + width)
        force = np.zeros(n)  # fi as a row over the states
        speed = np.zeros(n)  # q̇i
        place = np.zeros(n)  # qi
        place[at], place[0] = 1.0, -load
        speed[at + 1] = 1.0
        if drive != "prescribed":
            speed[1] = -load
        force += omega**2 * (chain.spring * place + chain.dashpot * speed)
        force[elements] = omega**2 * chain.weights
        a[at, at + 1] = 1.0
        a[at + 1] -= force
        b[at + 1, 1] = tip * beam.length
        a[elements] = speed
        a[elements, elements] -= np.diag(chain.rates)
        if drive == "prescribed":
            b[elements, 0] = -load
            b[at + 1, 0] = omega**2 * chain.dashpot * load
        y[2] += tip * place
        y[3] -= omega**2 * load * place
        y[4] += tip * speed
        y[5] += load * force
        energy[at + 1, at + 1] += 0.5
        energy += 0.5 * omega**2 * chain.spring * np.outer(place, place)
        energy[elements, elements] += 0.5 * omega**2 * np.diag(chain.weights)
    if drive != "prescribed":
        y[4, 1] += 1.0
    if drive == "motor":
        if not inertia > 0.0:
            raise FieldError(
                "hub_inertia", hub_inertia, "not positive", allowed="> 0 kg·m²", remedy="give the motor's J"
            )
        a[1] = y[5] / inertia
        a[1, 1] -= hub_friction / inertia
        b[1, 0] = 1.0 / inertia
        energy[1, 1] += 0.5 * inertia
    elif drive == "servo":
        a[1, 0], a[1, 1], b[1, 0] = -(servo_pole**2), -2.0 * servo_pole, servo_pole**2
    for array in (a, b, y, energy):
        array.flags.writeable = False
    return Plant(beam, kept, chain, drive, inertia, a, b, y, energy)
