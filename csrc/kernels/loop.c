/* One closed loop: sensors -> law_step -> delay -> motor -> link, one period after the other.
 *
 * Between two periods the motor's angle is a smooth curve of known end angles and end speeds; the cubic through
 * them differs from it by T^4/384 times its fourth derivative (1e-9 rad at 4 ms), and for a cubic the link's
 * response is exact. This file is compiled twice, see loop_single.c. */
#include "loop.h"

#include <math.h>

#include "law.h"

#ifndef LOOP_RUN
#define LOOP_RUN loop_run_double
#endif

typedef struct {
    double angle; /* from the start angle [rad] */
    double speed;
} motor_state;

typedef struct {
    double real[LOOP_MODES];
    double re[LOOP_MODES];
    double im[LOOP_MODES];
    double tip;
} link_state;

/* Weights of one motor (sub)step, computed once. */
typedef struct {
    double keep;   /* e^(-p T) or e^(-B h) */
    double first;  /* (1 - e^(-B h))/B */
    double second; /* (h - first)/B */
} motor_weights;

static double rounded_to(double value, double quantum)
{
    return quantum > 0.0 ? nearbyint(value / quantum) * quantum : value;
}

static motor_weights weights_of(const loop_rig *rig)
{
    motor_weights w;
    if (!rig->sampled) {
        w.keep = exp(-rig->pole * rig->period);
        w.first = w.second = 0.0;
        return w;
    }
    const double h = rig->period / rig->substeps;
    const double bh = rig->decay * h;
    w.keep = exp(-bh);
    w.first = bh > 0.0 ? -expm1(-bh) / rig->decay : h;
    /* below 1e-4 the difference h - first has lost its digits; its series has not */
    w.second = bh > 1e-4 ? (h - w.first) / rig->decay : h * h * (0.5 - bh / 6.0 + bh * bh / 24.0);
    return w;
}

/* M(s) = 1/(1 + s/p)^2 under a held reference, exactly: a double pole at -p. */
static void follow_reference(motor_state *m, const loop_rig *rig, const motor_weights *w, double reference)
{
    const double pt = rig->pole * rig->period;
    const double e = m->angle - reference;
    const double v = m->speed;
    m->angle = reference + w->keep * ((1.0 + pt) * e + rig->period * v);
    m->speed = w->keep * ((1.0 - pt) * v - rig->pole * pt * e);
}

/* The voltage behind that move at its beginning, coupling torque and friction compensated: from the equation (1). */
static double servo_voltage(const motor_state *m, const loop_rig *rig, double reference)
{
    const double p = rig->pole;
    return (p * p * (reference - m->angle) + (rig->decay - 2.0 * p) * m->speed) / rig->gain;
}

/* Motor under a held voltage with Coulomb friction as a proximal step: the friction force of a substep is the one
 * that shortens the speed by at most its impulse and never turns it around, which includes stiction. */
static void follow_voltage(motor_state *m, const loop_rig *rig, const motor_weights *w, double push)
{
    const double impulse = rig->friction * w->first;
    for (int i = 0; i < rig->substeps; i++) {
        const double free = w->keep * m->speed + w->first * push;
        const double left = fabs(free) - impulse;
        const double speed = copysign(left > 0.0 ? left : 0.0, free);
        const double force = push + (speed - free) / w->first;
        m->angle += w->first * m->speed + w->second * force;
        m->speed = speed;
    }
}

static void move_link(link_state *s, const loop_link *link, const double q[4])
{
    double tip = link->first[0] * q[0] + link->first[1] * q[1] + link->first[2] * q[2] + link->first[3] * q[3];
    const int n = link->reals;
    const int m = link->pairs;
    const double *w = link->weight;
    double sum = 0.0;
#pragma omp simd reduction(+ : sum)
    for (int i = 0; i < n; i++) {
        s->real[i] = link->decay[i] * s->real[i] +
                     (w[i] * q[0] + w[n + i] * q[1] + w[2 * n + i] * q[2] + w[3 * n + i] * q[3]);
        sum += s->real[i];
    }
    for (int i = 0; i < m; i++) {
        const double *a = link->weight_re;
        const double *b = link->weight_im;
        const double re = s->re[i];
        const double im = s->im[i];
        s->re[i] = link->pair_re[i] * re - link->pair_im[i] * im +
                   (a[i] * q[0] + a[m + i] * q[1] + a[2 * m + i] * q[2] + a[3 * m + i] * q[3]);
        s->im[i] = link->pair_re[i] * im + link->pair_im[i] * re +
                   (b[i] * q[0] + b[m + i] * q[1] + b[2 * m + i] * q[2] + b[3 * m + i] * q[3]);
        tip += s->re[i];
    }
    s->tip = tip + sum;
}

static double gauge_reading(const loop_rig *rig, double torque, int64_t k)
{
    double reading = torque + (k > 0 ? rig->offset : 0.0);
    if (rig->noise > 0.0)
        reading += rig->noise * loop_normal(rig->seed, (uint64_t)k);
    reading = rounded_to(reading, rig->quantum);
    return fmin(fmax(reading, -rig->limit), rig->limit);
}

static void cubic(const motor_state *from, const motor_state *to, double period, double q[4])
{
    const double rise = to->angle - from->angle;
    const double v0 = period * from->speed;
    const double v1 = period * to->speed;
    q[0] = from->angle;
    q[1] = v0;
    q[2] = 3.0 * rise - 2.0 * v0 - v1;
    q[3] = v0 + v1 - 2.0 * rise;
}

int LOOP_RUN(const loop_link *link, const loop_rig *rig, const void *params, const loop_reference *reference,
             const loop_trace *trace)
{
    const law_params *const p = (const law_params *)params;
    const motor_weights w = weights_of(rig);
    motor_state motor = {0.0, 0.0};
    link_state flexible = {{0}, {0}, {0}, 0.0};
    double pending[LOOP_DELAY];
    law_state state;
    law_input in;
    law_output out;
    if (link->reals > LOOP_MODES || link->pairs > LOOP_MODES || rig->delay >= LOOP_DELAY)
        return 1;
    const int slots = rig->delay + 1;
    for (int i = 0; i < slots; i++)
        pending[i] = 0.0;
    (void)law_init(&state, p);
    for (int64_t k = 0; k < reference->length; k++) {
        const double torque = link->stiffness * (motor.angle - flexible.tip);
        const double measured = gauge_reading(rig, torque, k);
        in.tick = (uint32_t)k;
        in.reference = (law_real)reference->reference[k];
        in.reference_velocity = (law_real)reference->velocity[k];
        in.reference_acceleration = (law_real)reference->acceleration[k];
        in.motor_angle = (law_real)rounded_to(rig->start + motor.angle, rig->encoder);
        in.torque = (law_real)measured;
        law_step(&state, p, &in, &out);
        trace->tip[k] = rig->start + flexible.tip;
        trace->motor[k] = rig->start + motor.angle;
        trace->motor_reference[k] = (double)out.motor_reference;
        trace->torque[k] = torque;
        trace->measured[k] = measured;
        trace->voltage[k] = (double)out.voltage;
        trace->tip_estimate[k] = (double)out.tip_estimate;
        trace->flags[k] = out.flags;
        trace->mode[k] = out.mode;
        trace->reason[k] = out.reason;
        pending[k % slots] = rig->sampled ? (double)out.voltage - (double)out.compensation
                                          : (double)out.motor_reference - rig->start;
        const double applied = pending[(k + 1) % slots]; /* written `delay` periods ago */
        const motor_state before = motor;
        double q[4];
        if (rig->sampled) {
            follow_voltage(&motor, rig, &w, rig->gain * applied);
        } else {
            trace->voltage[k] = servo_voltage(&motor, rig, applied);
            follow_reference(&motor, rig, &w, applied);
        }
        cubic(&before, &motor, rig->period, q);
        move_link(&flexible, link, q);
    }
    return 0;
}
