"""What the loop takes as WebAssembly (csrc/web/engine.c): the numbers of an arm in the engine's order.

The engine has no library of mathematics. Whatever takes one is computed here, by the functions and kernels
that `simulate` uses, so that a run in a page has the bits of a run in Python.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from fraclink import _kernels
from fraclink._arm.link import LinkModel
from fraclink._arm.rig import Rig
from fraclink._law import Law
from fraclink._simulate.kernel import SUBSTEPS
from fraclink._simulate.plant import link_weights

__all__ = [
    "LONGEST",
    "RIG_NUMBERS",
    "EngineLink",
    "engine_bytes",
    "engine_link",
    "engine_noise",
    "engine_rig",
]

Real = NDArray[np.float64]

LONGEST = 4001  # periods: room in the engine's buffers

# The rig's numbers in the order of engine.c. A page changes delay, offset, noise, payload and stiffness.
RIG_NUMBERS = (
    "sampled",
    "substeps",
    "delay",
    "period",
    "pole",
    "gain",
    "decay",
    "friction",
    "coupling",
    "encoder",
    "offset",
    "noise",
    "limit",
    "quantum",
    "gauge_delay",
    "gauge_gain",
    "payload",
    "start",
    "keep",
    "first",
    "second",
    "stiffness",
)


def engine_bytes() -> bytes:
    """Return the engine that the package holds, built by tools/build_engine.py.

    >>> engine_bytes()[:4]
    b'\\x00asm'
    """
    return (files("fraclink._simulate") / "engine.wasm").read_bytes()


@dataclass(frozen=True)
class EngineLink:
    """A link as the engine reads it: counts of real modes and pairs, and its numbers behind one another."""

    reals: int
    pairs: int
    second: bool
    numbers: Real


def engine_link(model: LinkModel, period: float, span: float) -> EngineLink:
    """Return the link's recursion at `period` [s], valid for `span` [s].

    >>> engine_link(LinkModel(1.56, 11.094, order=2.0), 0.004, 4.0).numbers.size
    35
    """
    weights = link_weights(model, period, max(span, 2 * period))
    second = weights.second.ravel()
    pair = (weights.pair.real, weights.pair.imag, weights.pair_weight.real, weights.pair_weight.imag)
    parts = (weights.first, second if second.size else np.zeros(15), weights.decay, weights.weight, *pair)
    numbers = np.concatenate([np.ravel(part) for part in parts])
    return EngineLink(weights.decay.shape[1], weights.pair.shape[1], bool(second.size), numbers)


def engine_rig(rig: Rig, law: Law, model: LinkModel) -> Real:
    """Return the rig's numbers as `simulate` has them for the model: the rig's own delay, offset, noise."""
    motor, gauge = rig.motor, rig.gauge
    numbers = {
        "sampled": 1.0,
        "substeps": float(SUBSTEPS),
        "delay": float(rig.motor_loop.delay_samples),
        "period": law.period,
        "pole": law.inner_pole,
        "gain": motor.gain,
        "decay": motor.decay,
        "friction": motor.coulomb_torque / (motor.inertia * motor.gear_ratio),
        "coupling": 0.0,
        "encoder": rig.encoder.resolution,
        "offset": gauge.offset,
        "noise": gauge.noise,
        "limit": gauge.limit,
        "quantum": gauge.quantum,
        "gauge_delay": max(model.gauge_delay, 0.0) / law.period,
        "gauge_gain": model.gauge_gain,
        "payload": 0.0,
        "start": 0.0,
        "stiffness": model.stiffness,
    }
    weights = _kernels.loop_weights(motor.decay, law.period, SUBSTEPS)
    numbers |= dict(zip(("keep", "first", "second"), weights, strict=True))
    return np.array([numbers[name] for name in RIG_NUMBERS])


def engine_noise(seed: int, count: int) -> Real:
    """Return the standard normal numbers of the gauge's noise, shape (count,).

    >>> engine_noise(0, 3).shape
    (3,)
    """
    return np.array([_kernels.loop_normal(seed, k) for k in range(count)])
