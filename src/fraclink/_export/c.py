"""Export the law to C: law.h and law.c as simulated, the data, a self-test and a
README.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

from fraclink import _kernels
from fraclink._certify import Certificate
from fraclink._design import Design
from fraclink._export.claims import Proof, claims_text
from fraclink._export.data import (
    data_header,
    exact_flags,
    exact_sizes,
    law_source,
)
from fraclink._export.payload import payload_files, payload_readme
from fraclink._export.selftest import expected, selftest_source
from fraclink._files import atomic_write, output_path
from fraclink._law import Law
from fraclink._law.block import Precision
from fraclink._law.estimator import PayloadEstimator
from fraclink._simulate.estimates import estimator_for
from fraclink.errors import FieldError, MissingExtraError
from fracsys.checks import checked

__all__ = ["export_c", "readme"]


@checked
def export_c(
    law: Law | Design,
    folder: Path | str,
    *,
    precision: Precision | None = None,
    prove: bool = False,
    certificate: Certificate | None = None,
    estimator: PayloadEstimator | None = None,
    force: bool = False,
) -> tuple[Path, ...]:
    """Write the law as C99 to `folder` and return the paths written.

    law.h and law.c are the files that were simulated, to the byte; law_data.h holds the
    coefficients as hex floats; law_selftest.c prints a hash to compare on the target;
    law.json is the law itself; README.md states the call sequence, memory in [B],
    limits in [rad], [N·m] and [V], and what is claimed.

    Parameters
    ----------
    law
        From `discretize`; a design stands for its `law()`. With the motor loop of a
        rig (`equip`) it closes the motor loop too.
    folder
        Created if it is missing; an existing one that is not empty needs `force`.
    precision
        Arithmetic of the law, by default its own.
    prove
        Prove what can be proved about these very files with the provers that are
        installed (Debian's frama-c-base, z3 or cvc5, gappa; python-flint): README.md
        then claims what was proved and nothing else, proof.json lists it
        (`Proof.load`), proof/ holds the logs. Half a minute on a desktop. Needs the
        package fraclink-prove (folder prove/ of the repository).
    certificate
        From `certify`, for the loop of the exported law; with `prove` it becomes a
        claim.
    estimator
        From `Design.estimator`: adds payload_estimator.c and .h, its tables and its own
        self-test, in the precision of the law, and README.md says how to call it. It is
        tested, not proved.
    force
        Overwrite the files in an existing folder.

    Raises
    ------
    FieldError
        a folder that is not empty, unless `force` is given.
    MissingExtraError
        `prove` without fraclink-prove.

    >>> import tempfile
    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023")
    >>> controller = fl.Controller(derivative_gain=0.069876, derivative_order=0.612197, link=rig.model)
    >>> law = fl.discretize(controller, rig.period, order=4)
    >>> folder = Path(tempfile.mkdtemp())
    >>> [path.name for path in export_c(law, folder, precision="single")]
    ['law.h', 'law.c', 'law_data.h', 'law_selftest.c', 'README.md', 'law.json']
    """
    law = law.law() if isinstance(law, Design) else law
    place = Path(folder)
    if place.is_file() or (place.is_dir() and any(place.iterdir()) and not force):
        raise FieldError(
            "out",
            str(place),
            "already there",
            "a new or an empty folder",
            "choose another name or add --force",
        )
    # fails before any work if the folder cannot be made
    output_path(place / "law.c", force=True)
    # From here on everything refers to the law in the precision that ships: limits and
    # coefficients are rounded once, here, and self-test, bounds and proof use the
    # rounded numbers.
    shipped = law if precision is None else law.in_precision(precision)
    files: dict[str, bytes] = {
        "law.h": law_source("law.h"),
        "law.c": law_source("law.c"),
        "law_data.h": data_header(shipped).encode(),
        "law_selftest.c": selftest_source(shipped).encode(),
    }
    proof, logs = _proved(shipped, files, certificate) if prove else (None, {})
    page = readme(shipped, proof=proof)
    # The estimator in the law's precision: both include the same law.h, with one
    # law_real.
    bank = None if estimator is None else estimator_for(shipped, estimator)
    if bank is not None:
        files |= {
            file: law_source(file)
            for file in ("payload_estimator.h", "payload_estimator.c")
        }
        files |= payload_files(bank)
        page += payload_readme(bank)
    # README.md comes last, since it describes the files before it.
    files["README.md"] = page.encode()
    files |= logs
    # Everything is prepared before anything is written, so that an error above leaves
    # no incomplete folder.
    place.mkdir(parents=True, exist_ok=True)
    # an earlier proof in this folder does not apply to the new files
    (place / "proof.json").unlink(missing_ok=True)
    for file, content in files.items():
        with atomic_write(place / file, "wb") as stream:
            stream.write(content)
    # no compiled file reads it
    shipped.save(place / "law.json")
    paths = [*(place / file for file in files), place / "law.json"]
    if proof is not None:
        proof.save(place / "proof.json")
        paths.append(place / "proof.json")
    return tuple(paths)


def _proved(
    law: Law,
    files: Mapping[str, bytes],
    certificate: Certificate | None,
) -> tuple[Proof, dict[str, bytes]]:
    """Prove in a temporary folder, so that a failure leaves nothing behind."""
    try:
        from fraclink_prove import prove as prove_folder
    except ImportError as error:
        raise MissingExtraError("fraclink-prove", "prove", install="./prove") from error
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for file, content in files.items():
            (folder / file).write_bytes(content)
        proof = prove_folder(law, folder, certificate=certificate)
        logs = {
            f"proof/{path.name}": path.read_bytes()
            for path in sorted((folder / "proof").glob("*"))
        }
    return proof, logs


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


# The guards of a PID that can act; the others belong to motor, gauge and link.
_OF_PID = (
    "angle_limit",
    "sum_limit",
    "correction_limit",
    "motor_limit",
    "bad_limit",
    "missed_limit",
)
# The header is the only place where the meanings are written.
_FIELD = re.compile(r"^    \w+ (\w+); +/\* (.+?) \*/$", re.MULTILINE)


def _limit_rows(law: Law) -> list[str]:
    parameters = law_source("law.h").decode().partition("} law_params;")[0]
    meanings = dict(_FIELD.findall(parameters))
    return [
        f"| `{key}` | {value:.6g} | {meanings[key]} |"
        for key, value in asdict(law.limits).items()
        if key in meanings and (law.has_gauge or key in _OF_PID)
    ]


def _connected(law: Law) -> str:
    if law.motor_loop is None:
        return "no motor loop: `motor_reference` goes to the drive's own position servo, `voltage` stays 0"
    if law.has_gauge:
        return f"motor loop closed by the law, voltage within ±{law.motor_loop.voltage_limit:g} V"
    return f"fractional PID, output within ±{law.motor_loop.voltage_limit:g}, integral with anti-windup"


def _called(law: Law) -> str:
    """The instructions for a caller of law_step."""
    if not law.has_gauge:
        return """\
`input.reference` is the reference r, `input.motor_angle` the measurement y and `output.voltage` the
controller's output u = C(z) (r − y): the names are those of the arm that law.c was written for. Leave
`reference_acceleration`, `torque` and `payload` at 0; they have no effect on the output. The first
`law_step` with a credible measurement starts with an empty filter and u = 0 for no error. The tuning counts
on an output that takes effect one period after the samples. A trip is left by `law_init` only.
`law_check_wiring` is about a gauge: there is none here. Where this page says rad and V it means the units of
the measurement and of the output."""
    return f"""\
The first `law_step` with a credible encoder starts at the measured angle, without a bump. Outputs take
effect one period after the samples (the design counts on it). A trip is left by `law_init` only. Before
the first enabling, run the wiring test `law_check_wiring` (see law.h) while the motor turns by
{law.wiring_angle:.2f} rad or more within {law.wiring_time:.2f} s: a gauge wired
backwards destabilises the arm, and no other check finds it."""


def _forward_row(law: Law) -> str:
    if not law.has_gauge:
        return ""
    decibels, angle = law.feedforward_error
    return (
        "| feed-forward against s^(λ−2)/ω₀², from a fifth of the resonance on | "
        f"{decibels:.3f} dB, {angle:.3f}° |\n"
    )


def readme(law: Law, *, proof: Proof | None = None) -> str:
    """Return the text of the exported README.md; with `proof`, its claims are about
    this folder.
    """
    params, state = _kernels.law_sizes(law.single)
    flag = " -DLAW_SINGLE" if law.single else ""
    limits = "\n".join(_limit_rows(law))
    return f"""# Control law, period {law.period * 1e3:g} ms, {law.precision} precision

Law `{law.digest}`.
`law.h` and `law.c` are the files that were simulated; `law_data.h` holds this design's numbers. Order
{law.order}; {_connected(law)}.

## Build and check
```
cc -std=c99 -ffp-contract=off{
        flag
    } -O2 law_selftest.c law.c -o law_selftest && ./law_selftest
```
must print `hash {
        expected(
            law
        ):08X}`. Run it on the target too, with the target's compiler and flags.
{
        _for_one_design(law)
    }Never use `-ffast-math` (refused) and never let the compiler fuse multiply and add: both change what was
proved and simulated.

## Call
```c
#include "law.h"
#include "law_data.h"
static law_state state;
if (law_init(&state, &law_data) != LAW_OK) {{ /* keep the drive off */ }}
/* every period, from the timer that counts `input.tick`: */
law_step(&state, &law_data, &input, &output);
if (output.mode == LAW_OFF) {{ /* switch the drive off */ }}
```
{_called(law)}

| memory | bytes |
|---|---|
| state (RAM, one for each arm) | {state} |
| parameters (flash) | {params} |

## Limits, computed from the largest move and the sensors
| field | value | meaning |
|---|---|---|
{limits}

## How exact
| what | value |
|---|---|
| C = 1 + Ĉ against the design, {law.band[0]:g} to {law.band[1]:g} rad/s | {
        law.correction_error[0]:.3f} dB, {law.correction_error[1]:.3f}° |
{_forward_row(law)}| Ĉ at constant input | exactly 0 |

{claims_text(law, proof)}"""
