/* An arm under law.c that shares nothing with the package's simulations: a motor with Coulomb friction behind a gear,
 * a massless link (spring and damper), a payload; a gauge with gain, delay, noise and quantum, an encoder with counts.
 * Compiled with the files of an export by bench_judge.py; everything is SI, at the gear's output. */
#include <stdint.h>
#include <string.h>

#include "law.h"
#include "payload_estimator.h"

#define SUBSTEPS 40
#define DELAYED 2048 /* substeps of a gauge's delay, at most */

typedef struct {
    double inertia, friction, coulomb, torque_per_volt, stiffness, damping, tip_inertia;
    double gauge_gain, gauge_delay, gauge_noise, gauge_quantum, encoder_step, period;
    int32_t voltage_delay; /* whole periods between the samples and their effect, 1 to 3 */
    uint32_t seed;
} arm_params;

typedef struct {
    double angle, speed, tip, tip_speed, voltage[4], torque[DELAYED];
    uint32_t place, noise;
    law_state law;
    payload_state estimator;
    law_output out;
} arm_state;

static double random_normal(uint32_t *seed)
{
    double sum = -6.0;
    for (int i = 0; i < 12; i++) {
        *seed = *seed * 1664525U + 1013904223U;
        sum += (*seed >> 8) / 16777216.0;
    }
    return sum;
}

static double rounded(double value, double step)
{
    return step > 0 ? step * (double)(int64_t)(value / step + (value < 0 ? -0.5 : 0.5)) : value;
}

/* One period under the voltage that has arrived; friction is an impulse that can only brake. */
static void move(arm_state *s, const arm_params *p)
{
    const double dt = p->period / SUBSTEPS, drive = s->voltage[p->voltage_delay] * p->torque_per_volt;
    for (int i = 0; i < SUBSTEPS; i++) {
        const double bend = p->stiffness * (s->angle - s->tip);
        const double link = bend + p->damping * (s->speed - s->tip_speed);
        const double brake = dt * p->coulomb / p->inertia;
        s->speed += dt * (drive - p->friction * s->speed - link) / p->inertia;
        s->speed = s->speed > brake ? s->speed - brake : s->speed < -brake ? s->speed + brake : 0.0;
        s->tip_speed += dt * link / p->tip_inertia;
        s->angle += dt * s->speed;
        s->tip += dt * s->tip_speed;
        s->place = (s->place + 1U) % DELAYED;
        s->torque[s->place] = p->stiffness * (s->angle - s->tip);
    }
}

static double gauge(arm_state *s, const arm_params *p)
{
    const uint32_t late = (uint32_t)(p->gauge_delay / p->period * SUBSTEPS + 0.5);
    const double torque = s->torque[(s->place + DELAYED - late) % DELAYED];
    return rounded(p->gauge_gain * torque + p->gauge_noise * random_normal(&s->noise), p->gauge_quantum);
}

static void push_voltage(arm_state *s, double voltage)
{
    memmove(&s->voltage[1], &s->voltage[0], 3 * sizeof(double));
    s->voltage[0] = voltage;
}

/* A period with its samples; the law gets the payload `given` [kg] or, if that is negative, the estimated one. */
static void control(arm_state *s, const law_params *law, const payload_params *bank, const arm_params *p, uint32_t tick,
                    double reference, double acceleration, double given, const double *stuck)
{
    law_input in;
    in.tick = tick;
    in.reference = (law_real)reference;
    in.reference_acceleration = (law_real)acceleration;
    in.motor_angle = (law_real)rounded(s->angle, p->encoder_step);
    in.torque = (law_real)(stuck ? *stuck : gauge(s, p));
    in.payload = (law_real)given;
    if (given < 0.0) {
        payload_output estimate;
        payload_step(&s->estimator, bank, tick, in.motor_angle, in.torque, &estimate);
        in.payload = estimate.given;
    }
    law_step(&s->law, law, &in, &s->out);
}

static void begin(arm_state *s, const law_params *law, const payload_params *bank, const arm_params *p)
{
    memset(s, 0, sizeof *s);
    s->noise = p->seed;
    law_init(&s->law, law);
    if (bank) {
        payload_init(&s->estimator, bank);
    }
}

/* A run. The law misses the periods in which `called` is 0; the gauge is stuck from period `stuck` on, never if that is
 * negative. */
void arm_run(const law_params *law, const payload_params *bank, const arm_params *p, int32_t count,
             const double *reference, const double *acceleration, double given, const uint8_t *called, int32_t stuck,
             double *tip, double *voltage, uint8_t *mode, uint8_t *reason)
{
    static arm_state s;
    double last = 0.0;
    begin(&s, law, bank, p);
    for (int32_t k = 0; k < count; k++) {
        const int frozen = stuck >= 0 && k >= stuck;
        tip[k] = s.tip;
        if (called[k]) {
            if (!frozen) {
                last = gauge(&s, p);
            }
            control(&s, law, bank, p, (uint32_t)k + 1U, reference[k], acceleration[k], given, &last);
        }
        push_voltage(&s, s.out.voltage);
        voltage[k] = s.voltage[0];
        mode[k] = (uint8_t)s.out.mode;
        reason[k] = (uint8_t)s.out.reason;
        move(&s, p);
    }
}

/* Flip the bits from `first` to before `last` of the memory (the law's, then the estimator's), one bit in each run, in
 * every second period from `from` to before `to`, and follow the arm for `rest` periods. A run in which the law
 * switches off within ten periods is not judged. worst[w]: largest distance [rad] of the tip from that of the clean
 * arm, over the judged flips in word w; counts[0]: all runs, counts[1]: judged runs that exceed `bound`. */
void arm_flips(const law_params *law, const payload_params *bank, const arm_params *p, int32_t count,
               const double *reference, const double *acceleration, double given, int32_t from, int32_t to,
               int32_t rest, int32_t first, int32_t last, double bound, double *worst, int64_t *counts)
{
    static arm_state clean, s;
    static double tip[100000];
    begin(&clean, law, bank, p);
    for (int32_t k = 0; k < count; k++) { /* the clean arm first */
        tip[k] = clean.tip;
        control(&clean, law, bank, p, (uint32_t)k + 1U, reference[k], acceleration[k], given, 0);
        push_voltage(&clean, clean.out.voltage);
        move(&clean, p);
    }
    begin(&clean, law, bank, p);
    for (int32_t k = 0; k < to; k++) {
        for (int32_t bit = first; k >= from && (k - from) % 2 == 0 && bit < last; bit++) {
            const int32_t words = (int32_t)(sizeof(law_state) / 4U), word = bit / 32;
            uint32_t *memory = word < words ? (uint32_t *)&s.law + word : (uint32_t *)&s.estimator + (word - words);
            double far = 0.0;
            int off = 0;
            s = clean;
            *memory ^= 1U << (bit % 32);
            for (int32_t i = k; i < k + rest && i < count && !off; i++) {
                const double away = s.tip > tip[i] ? s.tip - tip[i] : tip[i] - s.tip;
                far = away > far ? away : far;
                control(&s, law, bank, p, (uint32_t)i + 1U, reference[i], acceleration[i], given, 0);
                push_voltage(&s, s.out.voltage);
                off = s.out.mode == LAW_OFF && i < k + 10;
                move(&s, p);
            }
            counts[0]++;
            if (!off) {
                worst[word] = far > worst[word] ? far : worst[word];
                counts[1] += far > bound;
            }
        }
        control(&clean, law, bank, p, (uint32_t)k + 1U, reference[k], acceleration[k], given, 0);
        push_voltage(&clean, clean.out.voltage);
        move(&clean, p);
    }
}

/* A log for an identification: the motor follows `reference` under a PD loop of `gain` [V/rad], `rate` [V s/rad]. */
void arm_record(const arm_params *p, int32_t count, const double *reference, double gain, double rate, double limit,
                double *angle, double *torque, double *voltage)
{
    static arm_state s;
    memset(&s, 0, sizeof s);
    s.noise = p->seed;
    for (int32_t k = 0; k < count; k++) {
        double wanted;
        angle[k] = rounded(s.angle, p->encoder_step);
        torque[k] = gauge(&s, p);
        wanted = gain * (reference[k] - angle[k]) - rate * (angle[k] - (k ? angle[k - 1] : angle[k])) / p->period;
        voltage[k] = wanted > limit ? limit : wanted < -limit ? -limit : wanted;
        push_voltage(&s, voltage[k]);
        move(&s, p);
    }
}

int32_t state_words(void) { return (int32_t)(sizeof(law_state) / 4U); }
int32_t estimator_words(void) { return (int32_t)(sizeof(payload_state) / 4U); }
