"""The inputs of the WebAssembly engine (csrc/web/engine.c), which runs loop and twin:
the numbers of an arm in its order.

The engine has no mathematics library. Whatever needs one is computed here, by the
functions and kernels that `simulate` uses, so that a run in a page is identical to the
bit with a run in Python.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files

import numpy as np

from fraclink import _kernels
from fraclink._arm.beam import residual_inertia
from fraclink._arm.link import LinkModel
from fraclink._arm.rig import Rig
from fraclink._law import Law
from fraclink._simulate.arm import Twin
from fraclink._simulate.kernel import SUBSTEPS, twin_numbers
from fraclink._simulate.links import link_weights
from fraclink._simulate.plant import resolved
from fracsys.checks import Real

__all__ = [
    "LONGEST",
    "TWIN_MODES",
    "EngineLink",
    "EngineTwin",
    "engine_bytes",
    "engine_link",
    "engine_noise",
    "engine_rig",
    "engine_twin",
    "twin_noise",
]


# periods: capacity of the engine's buffers; 16 s at 4 ms show a move and its residual
# vibration
LONGEST = 4001
# limits of the twin: states and two inputs; steps of gauge delay
MOST_ROWS, MOST_GAUGE = (96, 1024)
# A third mode would double the time of a run and change the tip by at most 1.3 mrad in
# a move of 1 rad.
TWIN_MODES = 2


def engine_bytes() -> bytes:
    """Return the engine in the package, built by tools/build_engine.py.

    >>> engine_bytes()[:4]
    b'\\x00asm'
    """
    # Read from the package instead of being built: a user has no compiler for it. A test
    # compiles csrc and compares.
    return (files("fraclink._simulate") / "engine.wasm").read_bytes()


@dataclass(frozen=True)
class EngineLink:
    """A link in the form of the engine: how many real modes and pairs it has, and its
    values in sequence.
    """

    reals: int
    pairs: int
    second: bool
    numbers: Real


def engine_link(model: LinkModel, period: float, span: float) -> EngineLink:
    """Return the link's recursion at `period` [s], valid for `span` [s].

    >>> engine_link(LinkModel(1.56, 11.094, order=2.0), 0.004, 4.0).numbers.size
    36
    """
    # Two periods at least, as in `simulate`, with which the page must agree to the bit.
    weights = link_weights(model, period, max(span, 2 * period))
    second = weights.second.ravel()
    parts = (
        model.stiffness,
        weights.first,
        # Always fifteen numbers: the engine locates the next ones by counts alone.
        second if second.size else np.zeros(15),
        weights.decay,
        weights.weight,
        weights.pair.view(np.float64),
        weights.pair_weight.view(np.float64),
    )
    numbers = np.concatenate([np.ravel(part) for part in parts])
    return EngineLink(
        weights.decay.shape[1], weights.pair.shape[1], bool(second.size), numbers
    )


def engine_rig(rig: Rig, law: Law, model: LinkModel) -> dict[str, float]:
    """Return the numbers of the rig for the model as in `simulate`, in the order of
    loop_rig; a page may change delay, offset, noise and payload.
    """
    motor, gauge = rig.motor, rig.gauge
    weights = _kernels.loop_weights(motor.decay, law.period, SUBSTEPS)
    return {
        "sampled": 1.0,
        "substeps": float(SUBSTEPS),
        "delay": float(rig.motor_loop.delay_samples),
        "period": law.period,
        "pole": law.motor_loop_pole,
        "gain": motor.gain,
        "decay": motor.decay,
        "friction": motor.coulomb_torque / (motor.inertia * motor.gear_ratio),
        "encoder": rig.encoder.resolution,
        "offset": gauge.offset,
        "noise": gauge.noise,
        "limit": gauge.limit,
        "quantum": gauge.quantum,
        # In periods, as the kernel counts.
        "gauge_delay": model.gauge_lag / law.period,
        "gauge_gain": model.gauge_gain,
        "payload": 0.0,
        "start": 0.0,
        **dict(zip(("keep", "first", "second"), weights, strict=True)),
    }


@dataclass(frozen=True)
class EngineTwin:
    """A twin in the form from which a page assembles it, with the operations of
    `assemble` in the same order.

    rig: twin_rig of twin.h. material: step [s], length [m], spring, dashpot and hub
    friction, then weights and rates of the Maxwell elements. arms: for every payload
    the hub's inertia, then ω², Γ and tip of each mode.
    """

    rig: Real
    material: Real
    arms: Real
    elements: int
    modes: int


def engine_twin(
    rig: Rig, model: LinkModel, payloads: Sequence[float], link_mass: float
) -> EngineTwin | None:
    """Return the twins of `Twin.from_rig` with two modes; None if they do not fit into
    the engine.

    >>> rig = Rig.named("paper-2023-geared")
    >>> found = engine_twin(rig, rig.model, [0.020, 0.030], 0.00735)
    >>> found.modes, found.elements, found.arms.shape
    (2, 24, (2, 7))
    """
    # The twin of the first payload gives the common parts: motor, sensors, material.
    twin = Twin.from_rig(
        rig, model=model, payload=payloads[0], link_mass=link_mass, modes=TWIN_MODES
    )
    numbers = twin_numbers(twin, rig.period)
    fine = rig.period / numbers[0]
    plant = twin.plant(fine)
    # Two more rows than states: the matrix of the exponential includes the inputs.
    if plant.order + 2 > MOST_ROWS or numbers[2] >= MOST_GAUGE:
        return None
    chain, arms = plant.chain, []
    for beam in map(twin.beam.with_payload, payloads):
        modes = resolved(beam, TWIN_MODES, fine)
        each = zip(modes.frequencies, modes.participation, modes.tip, strict=True)
        inertia = twin.hub_inertia + residual_inertia(beam, modes)
        arms.append(
            [
                inertia,
                *(number for w, load, tip in each for number in (w**2, load, tip)),
            ]
        )
    friction = twin.motor.gear_ratio**2 * twin.motor.viscous_friction
    material = [
        fine,
        twin.beam.length,
        chain.spring,
        chain.dashpot,
        friction,
        *chain.weights,
        *chain.rates,
    ]
    return EngineTwin(
        numbers,
        np.array(material),
        np.array(arms),
        chain.rates.size,
        plant.modes.frequencies.size,
    )


def twin_noise(seed: int, count: int) -> Real:
    """Return the standard normal numbers of the twin's gauge, shape (count,): those of
    `healthy_inputs`.
    """
    return np.random.default_rng(seed).standard_normal(count)


def engine_noise(seed: int, count: int) -> Real:
    """Return the standard normal numbers of the gauge's noise, shape (count,).

    >>> engine_noise(0, 3).shape
    (3,)
    """
    return _kernels.loop_normals(seed, count)
