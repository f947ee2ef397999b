"""README.md of an exported law: how to call it, what it takes, what holds and what is not claimed."""

from __future__ import annotations

from dataclasses import asdict

from fraclink import _kernels
from fraclink._export.bounds import CommandBounds, worst_case
from fraclink._export.claims import Proof, claims_text
from fraclink._export.data import exact_flags, exact_sizes
from fraclink._export.selftest import expected
from fraclink._law import Law

__all__ = ["readme"]

_UNITS = {
    "sum_limit": "rad",
    "correction_limit": "rad",
    "forward_limit": "rad/s²",
    "angle_limit": "rad",
    "angle_step": "rad",
    "torque_limit": "N·m",
    "torque_step": "N·m",
    "torque_trip": "N·m",
    "torque_block": "N·m",
    "reference_step": "rad",
    "reference_rate": "1",
    "acceleration_limit": "rad/s²",
    "payload_limit": "kg",
    "scale_step": "1",
    "motor_limit": "rad",
    "motor_step": "rad",
    "fade_step": "1",
    "residual_angle": "rad",
    "frozen_angle": "rad",
    "stuck_torque": "N·m",
    "wiring_energy": "rad²",
    "bad_limit": "periods",
    "missed_limit": "periods",
    "residual_limit": "periods",
    "stuck_limit": "periods",
    "frozen_limit": "periods",
    "block_limit": "periods",
}
_MEANING = {
    "sum_limit": "largest credible correction and feed-forward; beyond, the states are healed",
    "correction_limit": "largest state of the correction; bounds what a flipped bit can do",
    "forward_limit": "largest state of the feed-forward",
    "angle_limit": "encoder and reference beyond it are not credible",
    "angle_step": "largest credible change of the encoder in a period",
    "torque_limit": "gauge readings beyond it are not credible",
    "torque_step": "largest credible change of the gauge in a period",
    "torque_trip": "a link that pushes more is blocked: hold",
    "torque_block": "a link that pushes more and does not swing back is blocked: hold",
    "reference_step": "the reference is followed at no more than this in a period",
    "reference_rate": "part of a jump of the reference that is followed in a period",
    "acceleration_limit": "largest acceleration that is fed forward",
    "payload_limit": "a payload beyond it is not credible, and as one that is not given",
    "scale_step": "largest change of the feed-forward's scale in a period, 1 for the nominal payload",
    "motor_limit": "range of the motor reference",
    "motor_step": "largest change of the motor reference in a period",
    "fade_step": "fade of the correction in a period, once the gauge is given up",
    "residual_angle": "motor farther from its model is a fault: off",
    "frozen_angle": "an encoder that stands still while the motor model moves this far is frozen",
    "stuck_torque": "a gauge that stands still while the model's torque moves this far is stuck",
    "wiring_energy": "sum of squared motor steps from which the wiring test decides",
    "bad_limit": "rejected samples in a row before the reaction",
    "missed_limit": "missed periods in a row that are ridden through",
    "residual_limit": "periods in a row away from the motor model before switching off",
    "stuck_limit": "periods in a row of a gauge that stands still before it is given up",
    "frozen_limit": "periods in a row of a frozen encoder before switching off",
    "block_limit": "periods in a row above `torque_block` before holding",
}


def _for_one_design(law: Law) -> str:
    flags = exact_flags(law)
    if not flags:
        return ""
    params, state = exact_sizes(law)
    return (
        f"On the board add `{' '.join(flags)}`: law.c is then compiled for this design alone, with\n"
        f"loops of fixed length and no spare places ({state} B of state, {params} B of parameters). Outputs\n"
        "and hash stay the same.\n"
    )


def _rounding(bounds: CommandBounds, proof: Proof | None) -> str:
    if proof is not None and proof["rounding"].status == "proved":
        return ""  # a sharper bound stands among the claims; two for one thing would confuse
    return f"| rounding of Ĉe for \\|e\\| ≤ {bounds.error:g} rad, all times | ≤ {bounds.rounding:.2e} rad |\n"


def readme(law: Law, *, name: str, data: str, proof: Proof | None = None) -> str:
    """Return the text of the exported README.md; with `proof`, its claims are those of this very folder."""
    bounds = worst_case(law)
    params, state = _kernels.law_sizes(law.precision == "single")
    flag = " -DLAW_SINGLE" if law.precision == "single" else ""
    made = "ball arithmetic" if bounds.rigorous else "double precision; python-flint was not installed"
    limits = "\n".join(
        f"| `{key}` | {value:.6g} | {_UNITS[key]} | {_MEANING[key]} |"
        for key, value in asdict(law.limits).items()
    )
    inner = (
        f"motor loop closed by the law, voltage within ±{law.drive.voltage_limit:g} V"
        if law.drive is not None
        else "no motor loop: `motor_reference` goes to the drive's own position servo, `voltage` stays 0"
    )
    return f"""# Control law, period {law.period * 1e3:g} ms, {law.precision} precision

Law `{law.digest}`.
`law.h` and `law.c` are the files that were simulated; `{data}` holds this design's numbers. Order
{law.order}; {inner}.

## Build and check
```
cc -std=c99 -ffp-contract=off{flag} -O2 law_selftest.c law.c -o law_selftest && ./law_selftest
```
must print `hash {expected(law).hash:08X}`. Run it on the target too, with the target's compiler and flags.
{
        _for_one_design(law)
    }Never use `-ffast-math` (refused) and never let the compiler fuse multiply and add: both change what was
proved and simulated.

## Call
```c
#include "law.h"
#include "{data}"
static law_state state;
if (law_init(&state, &{name}) != LAW_OK) {{ /* keep the drive off */ }}
/* every period, from the timer that counts `input.tick`: */
law_step(&state, &{name}, &input, &output);
if (output.mode == LAW_OFF) {{ /* switch the drive off */ }}
```
The first `law_step` with a credible encoder starts at the measured angle, without a bump. Outputs take
effect one period after the samples (the design counts on it). A trip is left by `law_init` only. Before
the first enabling, run the wiring test `law_check_wiring` (see law.h) while the motor turns by
{law.wiring_angle():.2f} rad or more within {law.limits.block_limit * law.period / 3:.2f} s: a gauge wired
backwards destabilises the arm, and no other check finds it.

| memory | bytes |
|---|---|
| state (RAM, one for each arm) | {state} |
| parameters (flash) | {params} |

## Limits, computed from the largest move and the sensors
| field | value | unit | meaning |
|---|---|---|---|
{limits}

## How exact
| what | value |
|---|---|
| C = 1 + Ĉ against the design, {law.band[0]:g} to {law.band[1]:g} rad/s | {law.correction_error[0]:.3f} dB, {
        law.correction_error[1]:.3f}° |
| feed-forward against s^(λ−2)/ω₀², from a fifth of the resonance on | {law.feedforward_error[0]:.3f} dB, {
        law.feedforward_error[1]:.3f}° |
| Ĉ at constant input | exactly 0 |
| worst-case gain, \\|Ĉe\\| ≤ gain · max\\|e\\| ({made}) | {bounds.gain:.9g} |
{_rounding(bounds, proof)}
{claims_text(law, proof)}"""
