/* The arm's end of fraclink's messages: frames, checksum, number of the run, watchdog. See arm_link.h. */
#include "arm_link.h"

#include <string.h>

#define VERSION 2U
#define SAMPLE 1U
#define COMMAND 2U
#define MODE_IDLE 0U
#define MODE_OFF 4U
#define CHECKED (ARM_LINK_MESSAGE - 4)
/* The law bridges 5 missed periods and switches off at the 6th: a controller that is silent for 10 will not return. */
#define WATCHDOG 10U

static const uint8_t BEGIN[4] = {(uint8_t)'F', (uint8_t)'L', (uint8_t)'R', (uint8_t)'T'};

static void put(uint8_t *bytes, uint64_t value, int count)
{
    for (int i = 0; i < count; i++) {
        bytes[i] = (uint8_t)(value >> (8 * i));
    }
}

static uint64_t get(const uint8_t *bytes, int count)
{
    uint64_t value = 0U;
    for (int i = 0; i < count; i++) {
        value |= (uint64_t)bytes[i] << (8 * i);
    }
    return value;
}

/* CRC-32 of IEEE 802.3. */
static uint32_t checksum(const uint8_t *bytes)
{
    uint32_t crc = 0xFFFFFFFFU;
    for (int i = 0; i < CHECKED; i++) {
        crc ^= bytes[i];
        for (int bit = 0; bit < 8; bit++) {
            crc = (crc >> 1) ^ ((crc & 1U) != 0U ? 0xEDB88320U : 0U);
        }
    }
    return crc ^ 0xFFFFFFFFU;
}

/* binary64 of a binary32, from its bits, since `double` has 4 bytes on some boards. Subnormal numbers become 0. */
static uint64_t widened(float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof(bits));
    const uint64_t sign = (uint64_t)(bits >> 31) << 63;
    const uint32_t exponent = (bits >> 23) & 0xFFU;
    const uint64_t fraction = (uint64_t)(bits & 0x7FFFFFU) << 29;
    if (exponent == 0U) {
        return sign;
    }
    const uint64_t wide = (exponent == 0xFFU) ? 0x7FFU : (uint64_t)exponent + 896U;
    return sign | (wide << 52) | fraction;
}

/* A binary64 truncated to binary32, to 0 below 2^-126; *finite is 0 if it is too large, infinite or NaN. */
static float narrowed(uint64_t bits, int *finite)
{
    const uint32_t exponent = (uint32_t)(bits >> 52) & 0x7FFU;
    uint32_t cut = (uint32_t)(bits >> 63) << 31;
    float value;
    *finite = exponent < 1151U; /* 2^128 */
    if ((*finite != 0) && (exponent > 896U)) {
        cut |= ((exponent - 896U) << 23) | ((uint32_t)(bits >> 29) & 0x7FFFFFU);
    }
    memcpy(&value, &cut, sizeof(value));
    return value;
}

/* Forget the controller and draw the number of the next run: splitmix64 is a permutation, so no number comes twice. */
static void leave(arm_link *link)
{
    uint64_t mixed = link->seed += 0x9E3779B97F4A7C15U;
    mixed = (mixed ^ (mixed >> 30)) * 0xBF58476D1CE4E5B9U;
    mixed = (mixed ^ (mixed >> 27)) * 0x94D049BB133111EBU;
    mixed ^= mixed >> 31;
    link->former = link->run;
    link->run = (mixed != 0U) ? mixed : 1U;
    link->heard = 0U;
    link->taken = 0U;
    link->voltage = 0.0F;
}

void arm_link_begin(arm_link *link, uint32_t period_us, uint32_t seed)
{
    memset(link, 0, sizeof(*link));
    link->period_ns = 1000U * period_us;
    link->watchdog = WATCHDOG;
    link->seed = ((uint64_t)seed << 32) ^ seed;
    leave(link);
}

/* Obey a complete message if it is a new command of this run. */
static void obey(arm_link *link)
{
    const uint32_t sequence = (uint32_t)get(link->bytes + 8, 4);
    const uint32_t mode = (uint32_t)get(link->bytes + 32, 4);
    const uint64_t run = get(link->bytes + 44, 8);
    int finite;
    const float voltage = narrowed(get(link->bytes + 24, 8), &finite);
    const int off = mode == MODE_OFF;
    /* A stop is sent three times for safety; the second and third belong to a run that has ended. */
    if (off && (run != 0U) && (run == link->former)) {
        return;
    }
    /* A command that moves the arm must contain the number of the run; without it a controller may only introduce
     * itself, or stop. */
    if ((run != link->run) && ((run != 0U) || (!off && (mode != MODE_IDLE)))) {
        return;
    }
    /* The difference of the sequence numbers, so that the count may wrap around. */
    if ((link->taken != 0U) && ((sequence - link->taken == 0U) || (sequence - link->taken > 0x7FFFFFFFU))) {
        return;
    }
    link->taken = sequence;
    link->came = 1U;
    if (off) {
        leave(link);
        return;
    }
    link->heard = 1U;
    link->voltage = ((mode != MODE_IDLE) && (finite != 0)) ? voltage : 0.0F;
}

/* Drop bytes from the front until the rest may be the beginning of a message. */
static void align(arm_link *link)
{
    for (uint8_t at = 0U; at < link->held; at++) {
        const size_t seen = (size_t)(link->held - at);
        if (memcmp(link->bytes + at, BEGIN, (seen < 4U) ? seen : 4U) == 0) {
            memmove(link->bytes, link->bytes + at, seen);
            link->held = (uint8_t)seen;
            return;
        }
    }
    link->held = 0U;
}

void arm_link_take(arm_link *link, uint8_t byte)
{
    link->bytes[link->held++] = byte;
    if (link->held <= 4U) {
        align(link);
    }
    if (link->held < ARM_LINK_MESSAGE) {
        return;
    }
    if ((get(link->bytes + 4, 2) == VERSION) && (get(link->bytes + 6, 2) == COMMAND) &&
        (get(link->bytes + CHECKED, 4) == checksum(link->bytes))) {
        obey(link);
        link->held = 0U;
        return;
    }
    /* After a damaged message the next one may begin at any byte. */
    link->damaged++;
    link->held--;
    memmove(link->bytes, link->bytes + 1, link->held);
    align(link);
}

int arm_link_period(arm_link *link, float angle, float torque, float *voltage, uint8_t message[ARM_LINK_MESSAGE])
{
    if (link->came != 0U) {
        link->silent = 0U;
    } else if ((link->heard != 0U) && (++link->silent >= link->watchdog)) {
        leave(link);
    }
    link->came = 0U;
    *voltage = link->voltage;
    const uint32_t period = link->period++;
    if (link->heard == 0U) {
        return 0;
    }
    memset(message, 0, ARM_LINK_MESSAGE);
    memcpy(message, BEGIN, sizeof(BEGIN));
    put(message + 4, VERSION, 2);
    put(message + 6, SAMPLE, 2);
    put(message + 8, ++link->sent, 4);
    put(message + 12, period, 4);
    put(message + 16, widened(angle), 8);
    put(message + 24, widened(torque), 8);
    put(message + 32, link->period_ns, 4);
    put(message + 44, link->run, 8);
    put(message + CHECKED, checksum(message), 4);
    return 1;
}
