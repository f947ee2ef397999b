"""law_selftest.c: a thousand periods with faults, and the hash that the user's target
must print.

The inputs are integers times powers of two and the law's own outputs, so that every
machine computes them without rounding; any difference is caused by the compiler
(contraction, fast-math, wide registers).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Iterator, Sequence

from fraclink._export.data import hex_float
from fraclink._law import Law, LawInputs
from fraclink._law.block import real_type

__all__ = ["expected", "hash_of", "noise", "periods", "selftest_source", "with_tools"]

# Long enough for every reaction below to begin and to end.
PERIODS = 1000


def noise() -> Iterator[int]:
    """Yield −2048 … 2047 at random, as noise() of the generated C does."""
    seed = 1
    while True:
        # The linear congruential generator of Numerical Recipes: one line of C without
        # a library, in which every operation is exact.
        seed = (seed * 1664525 + 1013904223) % 2**32
        # The upper 12 bits, since the lower bits of such a generator have short
        # periods.
        yield (seed >> 20) - 2048


def periods() -> Iterator[tuple[int, int, int]]:
    """Yield (number, tick, triangle of 0 … 256) for each period, as the generated C
    does: three periods are missed and one is called twice, which must be bridged and
    flagged.
    """
    tick = 0
    for k in range(PERIODS):
        tick += 4 if k == 500 else 0 if k == 520 else 1
        yield k, tick, min(k % 512, 512 - k % 512)


def hash_of(rows: Iterable[Sequence[float]], layout: str) -> int:
    """Return the hash of all outputs, each row in the layout of `struct`."""
    digest = 0x811C9DC5
    # Bits, not values: −0 and 0, or two NaNs, are different words.
    words = struct.iter_unpack(
        "<I", b"".join(struct.pack(f"<{layout}", *row) for row in rows)
    )
    # FNV-1a over 32-bit words: it takes one exclusive or and one multiplication modulo
    # 2³² per word, and every later word depends on each earlier bit.
    for (word,) in words:
        digest = ((digest ^ word) * 16777619) % 2**32
    return digest


def _scale(law: Law) -> float:
    """A power of two, so that no product is rounded: within the measurement range of
    the PID, and such that its output is limited sometimes but not always.
    """
    largest = law.limits.angle_limit
    if law.motor_loop is not None:
        loop = law.motor_loop.pid
        gain = loop.direct + loop.integral_gain * loop.period
        # The output's range divided by the largest gain of a step of the error. With a
        # larger scale the output would always be at its limit, and the hash would not
        # depend on the filter.
        largest = min(
            largest,
            law.motor_loop.voltage_limit
            / (gain * (1.0 + 2.0 * abs(law.correction.direct))),
        )
    return float(2.0 ** math.floor(math.log2(largest)))


def expected(law: Law) -> int:
    """Run the package's own law.c on the self-test's inputs and return the hash of its
    outputs.
    """
    state, command, rows = law.initial_state(), 0.0, []
    drawn, scale = noise(), 1.0 if law.has_gauge else _scale(law)
    for k, tick, ramp in periods():
        acceleration = next(drawn) / 2048
        if law.has_gauge:
            # The encoder follows the command within 2048/2²² = 0.5 mrad, so that no
            # guard of the motor trips early.
            angle, torque = command + next(drawn) / 2**22, next(drawn) / 2**15
        else:
            angle, torque = next(drawn) / 4096 * scale, 0.0
        # Three lost samples are bridged (bad_limit is 5); those from 950 on are not,
        # and the drive switches off. The loss of the gauge at 850 degrades the law 100
        # periods earlier.
        angle = math.nan if 300 <= k < 303 or k >= 950 else angle
        torque = math.nan if k == 350 or k >= 850 else torque
        # Payloads up to 256/8192 = 31 g; NaN must count as "not given".
        payload = 0.0 if k < 200 else math.nan if k == 420 else ramp / 8192
        inputs = LawInputs(ramp / 512 * scale, acceleration, angle, torque, payload)
        state, outputs = law.step(state, inputs, tick=tick)
        command = outputs.motor_reference
        rows.append(outputs)
    return hash_of(rows, f"5{real_type(law.precision)}3I")


def selftest_source(law: Law) -> str:
    """Return the text of law_selftest.c for `law`, whose block is in law_data.h."""
    inputs = (
        _OF_ARM
        if law.has_gauge
        else _OF_PID.replace("@SCALE@", hex_float(_scale(law), law.precision))
    )
    source = _SOURCE.replace("@INPUTS@", inputs)
    return with_tools(source, "law_selftest", expected(law))


def with_tools(source: str, name: str, digest: int) -> str:
    """Return the source of a self-test, completed by the parts common to all self-tests
    and by the hash that it must find.
    """
    return (
        source.replace("@TOOLS@", _TOOLS)
        .replace("@MAIN@", _MAIN.replace("@NAME@", name))
        .replace("@HASH@", f"0x{digest:08X}U")
        .replace("@PERIODS@ periods", f"{PERIODS} periods")
        .replace("@PERIODS@", f"{PERIODS}U")
    )


# What every self-test needs: noise, a reading that is not a number, and the hash.
_TOOLS = """\
#include <string.h>

#define PERIODS @PERIODS@
#define EXPECTED @HASH@

static uint32_t seed = 1U;

static int32_t noise(void)
{
    seed = (seed * 1664525U) + 1013904223U;
    return (int32_t)(seed >> 20U) - 2048;
}

static law_real not_a_number(void)
{
    law_real value;
    (void)memset(&value, 0xFF, sizeof(value));
    return value;
}

static uint32_t mixed(uint32_t hash, const void *value, size_t size)
{
    uint32_t word;
    size_t i;
    for (i = 0U; i < size; i += sizeof(word)) {
        (void)memcpy(&word, (const unsigned char *)value + i, sizeof(word));
        hash = (hash ^ word) * 16777619U;
    }
    return hash;
}

"""
_MAIN = """\
int @NAME@(void)
{
    return (@NAME@_hash() == EXPECTED) ? 0 : 1;
}

#ifndef LAW_SELFTEST_NO_MAIN
#include <stdio.h>

int main(void)
{
    const uint32_t hash = @NAME@_hash();
    const int failed = (hash == EXPECTED) ? 0 : 1;
    (void)printf("@NAME@: hash %08lX, ", (unsigned long)hash);
    (void)printf("expected %08lX: %s\\n", (unsigned long)EXPECTED, (failed == 0) ? "passed" : "FAILED");
    return failed;
}
#endif
"""
# Inputs for a law of the arm: the motor follows, the gauge shows noise.
_OF_ARM = """\
    in->reference = (law_real)ramp / (law_real)512;
    in->reference_acceleration = (law_real)noise() / (law_real)2048;
    in->motor_angle = motor_reference + ((law_real)noise() / (law_real)4194304);
    in->torque = (law_real)noise() / (law_real)32768;
"""
# Inputs for a PID: a measurement that is noise over its whole range.
_OF_PID = """\
    (void)motor_reference;
    in->reference = ((law_real)ramp / (law_real)512) * @SCALE@;
    in->reference_acceleration = (law_real)noise() / (law_real)2048;
    in->motor_angle = ((law_real)noise() / (law_real)4096) * @SCALE@;
    in->torque = (law_real)0;
"""

_SOURCE = """\
/* Self-test of the control law, generated by fraclink: run it once on the target, with the target's own
 * compiler and flags. It prints a hash of @PERIODS@ periods; anything but the expected one means that this
 * build does not compute what was simulated (look for contraction of multiply and add, fast-math or wide
 * registers).
 * law_selftest() returns 0 where everything agrees; -DLAW_SELFTEST_NO_MAIN leaves main and printf out. */
#include "law.h"
#include "law_data.h"

@TOOLS@static uint32_t tick = 0U;

static void next_input(uint32_t k, law_real motor_reference, law_input *in)
{
    const uint32_t phase = k % 512U;
    const uint32_t ramp = (phase < 256U) ? phase : (512U - phase);
    if (k == 500U) {
        tick += 4U; /* three missed periods */
    } else if (k != 520U) {
        tick += 1U; /* at 520 the same period twice */
    }
    in->tick = tick;
@INPUTS@    if (((k >= 300U) && (k < 303U)) || (k >= 950U)) {
        in->motor_angle = not_a_number();
    }
    if ((k == 350U) || (k >= 850U)) {
        in->torque = not_a_number();
    }
    in->payload = (k < 200U) ? (law_real)0 : ((law_real)ramp / (law_real)8192);
    if (k == 420U) {
        in->payload = not_a_number();
    }
}

uint32_t law_selftest_hash(void);
int law_selftest(void);

uint32_t law_selftest_hash(void)
{
    law_state state;
    law_input in;
    law_output out;
    uint32_t hash = 0x811C9DC5U;
    uint32_t k;
    law_real command = (law_real)0;
    seed = 1U;
    tick = 0U;
    if (law_init(&state, &law_data) != LAW_OK) {
        return 0U;
    }
    for (k = 0U; k < PERIODS; k++) {
        next_input(k, command, &in);
        law_step(&state, &law_data, &in, &out);
        command = out.motor_reference;
        hash = mixed(hash, &out.motor_reference, sizeof(law_real));
        hash = mixed(hash, &out.voltage, sizeof(law_real));
        hash = mixed(hash, &out.compensation, sizeof(law_real));
        hash = mixed(hash, &out.tip_estimate, sizeof(law_real));
        hash = mixed(hash, &out.error, sizeof(law_real));
        hash = mixed(hash, &out.mode, sizeof(out.mode));
        hash = mixed(hash, &out.reason, sizeof(out.reason));
        hash = mixed(hash, &out.flags, sizeof(out.flags));
    }
    return hash;
}

@MAIN@"""
