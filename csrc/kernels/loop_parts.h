/* What one closed loop and a group of them share: motor, link and gauge within one period. Static, because
 * one of the two is compiled with each precision of the law. */
#ifndef FRACLINK_LOOP_PARTS_H
#define FRACLINK_LOOP_PARTS_H

#include <math.h>

#include "clones.h"
#include "loop.h"

typedef struct {
    double angle; /* from the start angle [rad] */
    double speed;
    double early; /* acceleration at the beginning and at the end of the last period [rad/s^2] */
    double late;
} motor_state;

typedef struct {
    double real[LOOP_MODES];
    double re[LOOP_MODES];
    double im[LOOP_MODES];
    double tip;
    double before; /* tip one period ago */
    double second_re;
    double second_im;
} link_state;

static const link_state STRAIGHT = {{0}, {0}, {0}, 0.0, 0.0, 0.0, 0.0};

static double rounded_to(double value, double quantum)
{
    return quantum > 0.0 ? nearbyint(value / quantum) * quantum : value;
}

/* M(s) = 1/(1 + s/p)^2 under a held reference, exactly: a double pole at -p. */
static void follow_reference(motor_state *m, const loop_rig *rig, const loop_weights *w, double reference)
{
    const double pt = rig->pole * rig->period;
    const double p = rig->pole;
    const double e = m->angle - reference;
    const double v = m->speed;
    m->early = -p * (p * e + 2.0 * v);
    m->angle = reference + w->keep * ((1.0 + pt) * e + rig->period * v);
    m->speed = w->keep * ((1.0 - pt) * v - p * pt * e);
    m->late = -p * (p * (m->angle - reference) + 2.0 * m->speed);
}

/* The voltage behind that move at its beginning, coupling torque and friction compensated: from the equation (1). */
static double servo_voltage(const motor_state *m, const loop_rig *rig, double reference)
{
    const double p = rig->pole;
    return (p * p * (reference - m->angle) + (rig->decay - 2.0 * p) * m->speed) / rig->gain;
}

/* Motor under a held voltage with Coulomb friction as a proximal step: the friction force of a substep is the one
 * that shortens the speed by at most its impulse and never turns it around, which includes stiction. */
static void follow_voltage(motor_state *m, const loop_rig *rig, const loop_weights *w, double held,
                           const link_state *link)
{
    const double impulse = rig->friction * w->first;
    const double h = rig->period / rig->substeps;
    for (int i = 0; i < rig->substeps; i++) {
        /* the coupling torque at the middle of the substep, with the tip on its straight line of the last period */
        const double tip = link->tip + (link->tip - link->before) * (i + 0.5) / rig->substeps;
        const double push = held - rig->coupling * (m->angle + 0.5 * h * m->speed - tip);
        const double free = w->keep * m->speed + w->first * push;
        const double left = fabs(free) - impulse;
        const double speed = copysign(left > 0.0 ? left : 0.0, free);
        const double force = push + (speed - free) / w->first;
        if (i == 0)
            m->early = force - rig->decay * m->speed;
        m->angle += w->first * m->speed + w->second * force;
        m->speed = speed;
        m->late = force - rig->decay * speed;
    }
}

/* Real modes in lanes of LOOP_LANES: each lane adds up its own modes, and the lanes are added in one order, so that the
 * sum has the same bits whatever the width of the machine's vectors (a reduction clause would follow that width). */
#define LOOP_LANES 8

FRACLINK_CLONES
static double move_reals(double *restrict x, const loop_link *link, const double q[LOOP_POWERS])
{
    const int n = link->reals;
    const double *restrict decay = link->decay;
    const double *restrict w = link->weight;
    double lane[LOOP_LANES] = {0.0};
    int i = 0;
    for (; i + LOOP_LANES <= n; i += LOOP_LANES) {
#pragma omp simd
        for (int l = 0; l < LOOP_LANES; l++) {
            const int k = i + l;
            x[k] = decay[k] * x[k] + (w[k] * q[0] + w[n + k] * q[1] + w[2 * n + k] * q[2] + w[3 * n + k] * q[3] +
                                      w[4 * n + k] * q[4] + w[5 * n + k] * q[5]);
            lane[l] += x[k];
        }
    }
    for (int l = 0; i < n; i++, l++) {
        x[i] = decay[i] * x[i] + (w[i] * q[0] + w[n + i] * q[1] + w[2 * n + i] * q[2] + w[3 * n + i] * q[3] +
                                  w[4 * n + i] * q[4] + w[5 * n + i] * q[5]);
        lane[l] += x[i];
    }
    return ((lane[0] + lane[4]) + (lane[2] + lane[6])) + ((lane[1] + lane[5]) + (lane[3] + lane[7]));
}

static void move_link(link_state *s, const loop_link *link, const double q[LOOP_POWERS])
{
    const int m = link->pairs;
    const double *a = link->weight_re;
    const double *b = link->weight_im;
    double tip = move_reals(s->real, link, q);
    for (int j = 0; j < LOOP_POWERS; j++)
        tip += link->first[j] * q[j];
    for (int i = 0; i < m; i++) {
        double re = link->pair_re[i] * s->re[i] - link->pair_im[i] * s->im[i];
        double im = link->pair_re[i] * s->im[i] + link->pair_im[i] * s->re[i];
        for (int j = 0; j < LOOP_POWERS; j++) {
            re += a[j * m + i] * q[j];
            im += b[j * m + i] * q[j];
        }
        s->re[i] = re;
        s->im[i] = im;
        tip += re;
    }
    s->before = s->tip;
    s->tip = tip;
    if (link->second) {
        const double *n = link->second;
        double re = n[1] * s->second_re - n[2] * s->second_im;
        double im = n[1] * s->second_im + n[2] * s->second_re;
        for (int j = 0; j < LOOP_POWERS; j++) {
            re += n[3 + j] * q[j];
            im += n[3 + LOOP_POWERS + j] * q[j];
        }
        s->second_re = re;
        s->second_im = im;
    }
}

/* Torque at the root of the link: the angle between motor and tip, and what the second mode adds to it. */
static double root_torque(const link_state *s, const loop_link *link, double motor)
{
    const double bend = motor - s->tip;
    return link->stiffness * (link->second ? bend + (link->second[0] * motor + s->second_re) : bend);
}

/* The torques of the last periods, for a gauge that shows an older one. A delay between two samples is interpolated by
 * the cubic through the four around it: at 20 samples a vibration a straight line would damp it by 0.6 %, which a
 * lightly damped loop feels, the cubic by 1e-4. The arm is at rest before it starts, so the memory starts with zeros. */
#define GAUGE_MEMORY 128 /* a power of two that holds LOOP_DELAY + 2 */

typedef struct {
    int immediate;
    int youngest; /* age of the youngest of the four, in periods */
    double weight[4];
    double torque[GAUGE_MEMORY];
} gauge_line;

static void set_gauge(gauge_line *g, double delay)
{
    g->immediate = delay == 0.0;
    g->youngest = delay >= 1.0 ? (int)floor(delay) - 1 : 0;
    const double at = delay - g->youngest;
    for (int i = 0; i < 4; i++) {
        g->weight[i] = 1.0; /* Lagrange's polynomials; exactly 0 and 1 where the delay is whole */
        for (int j = 0; j < 4; j++)
            if (j != i)
                g->weight[i] *= (at - j) / (i - j);
    }
    for (int i = 0; i < GAUGE_MEMORY; i++)
        g->torque[i] = 0.0;
}

static double shown_torque(gauge_line *g, double torque, int64_t k)
{
    if (g->immediate)
        return torque;
    double sum = 0.0;
    g->torque[k & (GAUGE_MEMORY - 1)] = torque;
    for (int i = 0; i < 4; i++)
        sum += g->weight[i] * g->torque[(k - g->youngest - i) & (GAUGE_MEMORY - 1)];
    return sum;
}

static int out_of_bounds(const loop_link *link, const loop_rig *rig)
{
    return link->reals > LOOP_MODES || link->pairs > LOOP_MODES || rig->delay < 0 || rig->delay >= LOOP_DELAY ||
           !(rig->gauge_delay >= 0.0 && rig->gauge_delay < LOOP_DELAY);
}

/* What the gauge says of a torque, from a standard normal number; `gain` and `error` are a fault's, 1 and 0 for none. */
static double gauge_reading(const loop_rig *rig, gauge_line *gauge, double torque, double normal, double gain,
                            double error, int64_t k)
{
    double reading = gain * rig->gauge_gain * shown_torque(gauge, torque, k) + (k > 0 ? rig->offset : 0.0) + error;
    if (rig->noise > 0.0)
        reading += rig->noise * normal;
    reading = rounded_to(reading, rig->quantum);
    return fmin(fmax(reading, -rig->limit), rig->limit);
}

/* The quintic in (t - kT)/T with the angles, speeds and accelerations of both ends. */
static void quintic(const motor_state *from, const motor_state *to, double period, double q[LOOP_POWERS])
{
    const double rise = to->angle - from->angle;
    const double v0 = period * from->speed;
    const double v1 = period * to->speed;
    const double a0 = 0.5 * period * period * to->early;
    const double a1 = 0.5 * period * period * to->late;
    q[0] = from->angle;
    q[1] = v0;
    q[2] = a0;
    q[3] = 10.0 * rise - 6.0 * v0 - 4.0 * v1 - 3.0 * a0 + a1;
    q[4] = -15.0 * rise + 8.0 * v0 + 7.0 * v1 + 3.0 * a0 - 2.0 * a1;
    q[5] = 6.0 * rise - 3.0 * (v0 + v1) - a0 + a1;
}

#endif
