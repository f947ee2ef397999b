/* Fifty thousand periods of the exported law; prints the hash of every output. */
#include <stdio.h>
#include <string.h>

#include "law.h"
#include "law_data.h"

#ifndef PERIODS
#define PERIODS 50000U
#endif

static uint32_t seed = 1U;

static int32_t noise(void)
{
    seed = (seed * 1664525U) + 1013904223U;
    return (int32_t)(seed >> 20U) - 2048;
}

int main(void)
{
    static law_state state;
    law_input in;
    law_output out;
    uint32_t hash = 0x811C9DC5U;
    if (law_init(&state, &law_data) != LAW_OK) {
        return 2;
    }
    for (uint32_t k = 0U; k < PERIODS; k++) {
        const uint32_t phase = k % 1024U;
        const uint32_t ramp = (phase < 512U) ? phase : (1024U - phase);
        in.tick = k + 1U;
        in.reference = (law_real)ramp / (law_real)1024;
        in.reference_acceleration = (law_real)noise() / (law_real)4096;
        in.motor_angle = in.reference + ((law_real)noise() / (law_real)2097152);
        in.torque = (law_real)noise() / (law_real)1048576;
        in.payload = ((k % 5000U) < 2500U) ? (law_real)0 : ((law_real)(1U + (k / 1000U)) / (law_real)1024);
        if ((k % 1000U) == 500U) { /* a lost sample of each sensor now and then */
            (void)memset(&in.torque, 0xFF, sizeof(in.torque));
        }
        if ((k % 1000U) == 700U) {
            (void)memset(&in.motor_angle, 0xFF, sizeof(in.motor_angle));
        }
        law_step(&state, &law_data, &in, &out);
        const law_real reals[5] = {out.motor_reference, out.voltage, out.compensation, out.tip_estimate, out.error};
        const uint32_t words[3] = {out.mode, out.reason, out.flags};
        uint32_t word;
        for (size_t i = 0; (i * sizeof(word)) < sizeof(reals); i++) {
            (void)memcpy(&word, (const unsigned char *)reals + (i * sizeof(word)), sizeof(word));
            hash = (hash ^ word) * 16777619U;
        }
        for (size_t i = 0; i < 3U; i++) {
            hash = (hash ^ words[i]) * 16777619U;
        }
    }
    (void)printf("hash %08lX mode %lu\n", (unsigned long)hash, (unsigned long)out.mode);
    return 0;
}
