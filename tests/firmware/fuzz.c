/* libFuzzer: bytes become the state, the inputs and the clock; the invariants of every period are the oracle. */
#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "law.h"
#include "law_data.h"

#define require(holds) \
    do { \
        if (!(holds)) { \
            (void)fprintf(stderr, "violated: %s\n", #holds); \
            abort(); \
        } \
    } while (0)

static law_real value(unsigned char kind, unsigned char scale, int16_t fine)
{
    static const law_real odd[8] = {(law_real)NAN, (law_real)INFINITY, -(law_real)INFINITY, (law_real)1e30F,
                                    (law_real)-1e30F, (law_real)1e-42F, (law_real)4, (law_real)-4};
    if (kind > 240U) {
        return odd[scale % 8U];
    }
    return (law_real)fine / (law_real)((kind > 200U) ? 64 : 65536);
}

/* The mode of a state whose four copies agree; IDLE for memory that is no state. */
static uint32_t mode_of(const law_state *state)
{
    const uint32_t mode = state->mode >> 24U;
    return ((mode <= LAW_OFF) && (state->mode == (mode * 0x01010101U))) ? mode : LAW_IDLE;
}

/* Make a state whose memory looks undamaged, whatever is in it. */
static void seal(law_state *s, const law_params *p)
{
    law_real sum = s->reference;
    for (uint32_t i = 0U; i < p->forward_modes; i++) {
        sum += s->forward[i];
    }
    for (uint32_t i = 0U; i < p->real_modes; i++) {
        sum += s->real[i];
    }
#if !defined(LAW_EXACT) || defined(LAW_PAIRS)
    for (uint32_t i = 0U; i < (2U * p->pair_modes); i++) {
        sum += s->pair[i];
    }
#endif
    /* law.c: kept */
    sum += ((s->motor_reference + s->motor_angle) + (s->integral + s->torque)) + ((s->error + s->scale) + s->track_push);
    s->sum = sum;
}

int LLVMFuzzerTestOneInput(const unsigned char *bytes, size_t size);

int LLVMFuzzerTestOneInput(const unsigned char *bytes, size_t size)
{
    law_state state;
    law_wiring wiring = {0};
    law_input in = {0};
    law_output out;
    law_output last = {0};
    uint32_t worst = LAW_IDLE;
    int started = 0;
    int foreign = 0;
    size_t i = 0;
    require(law_init(&state, &law_data) == LAW_OK);
    if ((size > sizeof(state)) && (bytes[0] > 200U)) {
        (void)memcpy(&state, bytes, sizeof(state)); /* any memory; half of the time as a state that was started */
        if (bytes[1] > 127U) {
            state.stamp = law_data.crc;
            state.mode = (state.mode % 6U) * 0x01010101U; /* most random words are no mode at all, and a large counter trips at once */
            state.bad_encoder %= 8U;
            state.bad_gauge %= 8U;
            state.residual %= 8U;
            seal(&state, &law_data);
        }
        worst = mode_of(&state);
        foreign = 1;
        i = sizeof(state);
    }
    in.tick = state.tick;
    for (; i + 16U <= size; i += 16U) {
        int16_t fine[4];
        (void)memcpy(fine, bytes + i + 8U, sizeof(fine));
        in.tick += (bytes[i] > 250U) ? bytes[i + 1U] - 100U : 1U;
        in.reference = value(bytes[i + 2U], bytes[i + 3U], fine[0]);
        in.reference_acceleration = value(bytes[i + 4U], bytes[i + 5U], fine[1]) * (law_real)64;
        in.motor_angle = value(bytes[i + 6U], bytes[i + 3U], fine[2]);
        in.torque = value(bytes[i + 7U], bytes[i + 5U], fine[3]);
        in.payload = value(bytes[i + 1U], bytes[i + 3U], fine[1]); /* often 0 … 0.5 kg, or below 0 */
        if ((state.stamp != law_data.crc) || (state.mode == LAW_IDLE)) {
            started = 0; /* not started yet, or memory that is not a state: the law starts anew, but for a trip */
            worst = (mode_of(&state) > LAW_RUN) ? mode_of(&state) : LAW_IDLE;
        }
        law_step(&state, &law_data, &in, &out);
        require(isfinite(out.motor_reference) && isfinite(out.voltage) && isfinite(out.tip_estimate));
        require(isfinite(out.error) && isfinite(out.compensation));
        require(fabs((double)out.motor_reference) <= (double)law_data.motor_limit);
        require(fabs((double)out.voltage) <= (double)law_data.voltage_limit);
        require(out.mode <= LAW_OFF);
        require(((out.flags & LAW_FLAG_STARTED) == 0U) || (out.mode >= LAW_RUN));
        require(out.mode >= worst); /* trips latch */
        worst = (out.mode > worst) ? out.mode : worst;
        if (out.mode >= LAW_OFF) {
            require(out.voltage == (law_real)0);
        }
        if ((started != 0) && (foreign == 0)) {
            require((out.flags & LAW_FLAG_STARTED) == 0U); /* a memory that nobody touches is never taken for damaged */
        }
        if ((started != 0) && ((out.flags & LAW_FLAG_STARTED) == 0U)) {
            const double step = fabs((double)out.motor_reference - (double)last.motor_reference);
            require(step <= (double)law_data.motor_step * (1.0 + 1e-6) + 1e-6);
        }
        if ((out.flags & LAW_FLAG_REPEATED) == 0U) { /* a repeated period hands out memory, whatever is in it */
            started = ((out.mode == LAW_RUN) || (out.mode == LAW_DEGRADED)) ? 1 : 0;
        }
        last = out;
        (void)law_check_wiring(&wiring, &law_data, in.motor_angle, in.torque);
        require(isfinite(wiring.cross) && isfinite(wiring.energy));
    }
    return 0;
}
