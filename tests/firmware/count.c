/* Instructions of a period on an emulated Cortex-M: SysTick under -icount counts 1.25 instructions a tick.
 * The law is included as text, so that the outer law alone (tip estimate, correction, feed-forward) can be timed;
 * the call that makes it a function here, and that law_step does not have, is subtracted. */
#include "law.c"
#include "law_data.h"

int printf(const char *format, ...); /* no header: clang for a bare machine brings none of a C library's */

#define SYST_CSR (*(volatile uint32_t *)0xE000E010U)
#define SYST_RVR (*(volatile uint32_t *)0xE000E014U)
#define SYST_CVR (*(volatile uint32_t *)0xE000E018U)
#include "payload.h" /* PAYLOAD: what the law is given [kg]; ESTIMATE: or estimated, on a swinging arm */
#ifdef ESTIMATE
#include "payload_estimator.c"
#include "payload_data.h"
static payload_state memory;
#endif

#define PERIODS 2000U

static law_state state;
static volatile law_real sink;
static volatile law_real source = (law_real)0.25F;
static law_real payload = (law_real)PAYLOAD;

__attribute__((noinline)) static law_real outer(law_state *s, const law_params *p, law_real angle)
{
    const law_real estimate = angle - (s->torque * p->compliance);
    law_real found = (law_real)0; /* the sums of a guard that is left out here */
    law_real left = (law_real)0;
    const law_real forward = feed_forward(s, p, &found, angle, &left);
    return s->reference + (forward + correct(s, p, &found, s->reference - estimate, &left));
}

__attribute__((noipa)) static law_real call(law_real angle)
{
    return angle;
}

static uint32_t now(void)
{
    return 0xFFFFFFU - SYST_CVR;
}

int main(void)
{
    law_input in = {0};
    law_output out;
    uint32_t begin;
    uint32_t empty;
    uint32_t called;
    uint32_t inner;
    uint32_t whole;
    SYST_RVR = 0xFFFFFFU;
    SYST_CVR = 0U;
    SYST_CSR = 5U;
    (void)law_init(&state, &law_data);
    begin = now();
    for (uint32_t k = 0U; k < PERIODS; k++) {
        sink = source;
    }
    empty = now() - begin;
    begin = now();
    for (uint32_t k = 0U; k < PERIODS; k++) {
        sink = call(source);
    }
    called = now() - begin;
    begin = now();
    for (uint32_t k = 0U; k < PERIODS; k++) {
        sink = outer(&state, &law_data, source);
    }
    inner = now() - begin;
    (void)law_init(&state, &law_data);
    in.motor_angle = (law_real)0;
    in.tick = 1U;
    law_step(&state, &law_data, &in, &out);
#ifdef ESTIMATE
    (void)payload_init(&memory, &payload_data);
#endif
    begin = now();
    for (uint32_t k = 0U; k < PERIODS; k++) {
        in.tick++;
        in.reference_acceleration = source;
        in.payload = payload;
#ifdef ESTIMATE
        payload_output estimate;
        in.torque = ((k & 32U) != 0U) ? source : -source; /* never frozen: every period does its whole work */
        payload_step(&memory, &payload_data, in.tick, in.motor_angle, in.torque, &estimate);
        in.payload = estimate.given;
#endif
        law_step(&state, &law_data, &in, &out);
        sink = out.voltage;
    }
    whole = now() - begin;
    (void)printf("outer %lu whole %lu mode %lu\n", (unsigned long)(((inner - called) * 5U) / (4U * PERIODS)),
                 (unsigned long)(((whole - empty) * 5U) / (4U * PERIODS)), (unsigned long)out.mode);
    return 0;
}
