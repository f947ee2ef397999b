"""The payload estimator in an export to C: its data, its self-test, and its section of
README.md.
"""

from __future__ import annotations

import math
import struct

from fraclink import __version__
from fraclink._export.data import hex_float
from fraclink._export.selftest import hash_of, noise, periods, with_tools
from fraclink._law.block import real_type
from fraclink._law.estimator import COUNTS, HEADER, MODEL, REALS, PayloadEstimator

__all__ = ["payload_files", "payload_readme"]

DATA, SELFTEST = "payload_data.h", "payload_selftest.c"


def payload_files(estimator: PayloadEstimator) -> dict[str, bytes]:
    """Return payload_data.h and payload_selftest.c by name; the C itself is the
    package's.
    """
    selftest = with_tools(_SELFTEST, "payload_selftest", _hash(estimator))
    return {DATA: _data(estimator).encode(), SELFTEST: selftest.encode()}


def _data(estimator: PayloadEstimator) -> str:
    """The block as C, every real a hex float, rounded to its precision."""
    # Four words of header and four counts, then reals in the order of the C struct. The
    # values come from the block itself, so the text cannot differ from the numbers that
    # the package uses.
    words = struct.unpack("<8I", estimator.block[:32])
    reals = struct.iter_unpack(
        f"<{real_type(estimator.precision)}", estimator.block[32:]
    )
    rows = [
        f"    .{name} = {word}U,"
        for name, word in zip((*HEADER, *COUNTS), words, strict=True)
    ]
    texts = [hex_float(x, estimator.precision) for (x,) in reals]
    rows += [
        f"    .{name} = {text},"
        for name, text in zip(REALS, texts[: len(REALS)], strict=True)
    ]
    rest = texts[len(REALS) :]
    models = (
        ", ".join(rest[i : i + len(MODEL)]) for i in range(0, len(rest), len(MODEL))
    )
    rows.append(
        "    .model = {\n"
        + ",\n".join(f"        {{{model}}}" for model in models)
        + "},"
    )
    return _DATA.format(
        version=__version__,
        digest=estimator.digest,
        negation=" !" if estimator.single else "",
        precision=estimator.precision,
        remedy="with" if estimator.single else "without",
        fields="\n".join(rows),
    )


def _hash(estimator: PayloadEstimator) -> int:
    """Run the package's own estimator on the self-test's inputs and return the hash of
    its output.
    """
    drawn, rows = noise(), []
    # As in the law's self-test: missed periods, a repeated call, and lost samples of
    # both sensors. The C code below generates the same sequence.
    for k, tick, ramp in periods():
        # A parabola up to 0.5 rad: a constant acceleration, whose torque depends on the
        # payload.
        angle = ramp * ramp / 131072 + next(drawn) / 2**24
        # ±1/16 N·m in addition, with noise of 2¹¹/2¹⁷ = 0.016 N·m. Powers of two, so
        # that no product is rounded before it reaches the estimator.
        torque = (64 if k % 512 < 256 else -64) / 1024 + next(drawn) / 2**17
        rows.append(
            (
                math.nan if 300 <= k < 303 else angle,
                math.nan if k == 350 or k >= 950 else torque,
                tick,
            )
        )
    angles, torques, ticks = zip(*rows, strict=True)
    _, columns = estimator.run(estimator.initial_state(), angles, torques, ticks=ticks)
    outputs = zip(*columns[:-1], map(int, columns[-1]), strict=True)
    return hash_of(outputs, f"4{real_type(estimator.precision)}I")


def payload_readme(estimator: PayloadEstimator) -> str:
    """Return the section of README.md on the payload estimator."""
    flag = " -DLAW_SINGLE" if estimator.single else ""
    low, high = estimator.certified
    return f"""
## Payload estimator
`payload_estimator.c` finds the payload from motor angle and gauge while the arm moves; `payload_data.h`
holds its tables. It is the file that was simulated. What is proved above is proved for every payload that the
law is given, so also for what the estimator gives; the estimator's own C is tested (with any sample and any
memory), not proved.
```
cc -std=c99 -ffp-contract=off{flag} -O2 payload_selftest.c payload_estimator.c -o payload_selftest
./payload_selftest
```
must print `hash {_hash(estimator):08X}`.
```c
#include "payload_estimator.h"
#include "payload_data.h"
static payload_state memory;
payload_output estimate;
if (payload_init(&memory, &payload_data) != LAW_OK) {{ /* give the law 0 */ }}
/* every period, before law_step: */
payload_step(&memory, &payload_data, input.tick, input.motor_angle, input.torque, &estimate);
input.payload = estimate.given;
if ((estimate.flags & PAYLOAD_CONTACT) != 0U) {{ /* the arm touched something: stop it if you want to */ }}
```
The design covers {1e3 * low:g} to {1e3 * high:g} g; `PAYLOAD_OUTSIDE` says that the payload is another.
The estimator remembers {estimator.state_size} bytes (RAM, one for each arm); its tables take
{len(estimator.block)} bytes (flash).
"""


_DATA = """\
/* Tables of the payload estimator: data only, generated by fraclink {version}.
 * estimator {digest}
 * Reals are hex floats, so that no decimal conversion can round them. */
#ifndef FRACLINK_PAYLOAD_DATA_H
#define FRACLINK_PAYLOAD_DATA_H

#include "payload_estimator.h"

#if{negation} defined(LAW_SINGLE)
#error "this block is in {precision} precision: compile it and payload_estimator.c {remedy} -DLAW_SINGLE"
#endif

static const payload_params payload_data = {{
{fields}
}};

#endif
"""

_SELFTEST = """\
/* Self-test of the payload estimator, generated by fraclink: run it once on the target, with the target's
 * own compiler and flags, as law_selftest.c. payload_selftest() returns 0 where the hash of @PERIODS@ periods
 * is the expected one; -DLAW_SELFTEST_NO_MAIN leaves main and printf out. */
#include "payload_estimator.h"
#include "payload_data.h"

@TOOLS@uint32_t payload_selftest_hash(void);
int payload_selftest(void);

uint32_t payload_selftest_hash(void)
{
    static payload_state memory;
    payload_output out;
    uint32_t hash = 0x811C9DC5U;
    uint32_t tick = 0U;
    uint32_t k;
    seed = 1U;
    if (payload_init(&memory, &payload_data) != LAW_OK) {
        return 0U;
    }
    for (k = 0U; k < PERIODS; k++) {
        const uint32_t phase = k % 512U;
        const uint32_t ramp = (phase < 256U) ? phase : (512U - phase);
        law_real angle = (law_real)(ramp * ramp) / (law_real)131072;
        law_real torque = ((phase < 256U) ? (law_real)64 : (law_real)-64) / (law_real)1024;
        angle += (law_real)noise() / (law_real)16777216;
        torque += (law_real)noise() / (law_real)131072;
        if (k == 500U) {
            tick += 4U; /* three missed periods */
        } else if (k != 520U) {
            tick += 1U; /* at 520 the same period twice */
        }
        if ((k >= 300U) && (k < 303U)) {
            angle = not_a_number();
        }
        if ((k == 350U) || (k >= 950U)) {
            torque = not_a_number();
        }
        payload_step(&memory, &payload_data, tick, angle, torque, &out);
        hash = mixed(hash, &out.given, sizeof(law_real));
        hash = mixed(hash, &out.estimate, sizeof(law_real));
        hash = mixed(hash, &out.low, sizeof(law_real));
        hash = mixed(hash, &out.high, sizeof(law_real));
        hash = mixed(hash, &out.flags, sizeof(out.flags));
    }
    return hash;
}

@MAIN@"""
