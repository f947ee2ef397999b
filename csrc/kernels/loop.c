/* Closed loops: sensors -> law_step -> delay -> motor -> link, one period after the other.
 *
 * Within a period the motor's angle is a smooth curve whose angles, speeds and accelerations at both ends are known.
 * The quintic through them differs from it by T^6/46080 times its sixth derivative (1e-9 rad behind M(s) at 4 ms; a
 * cubic is 1e-6 off), and for a quintic the link's response is exact. */
#include "loop.h"

#include <math.h>

#include "clones.h"
#include "law.h"
#include "payload_estimator.h"
#include "twin.h"

#define EACH_LANE(l) for (int l = 0; l < LOOP_LANES; l++)

/* The motors and their loop_weights, in step. */
typedef struct {
    double angle[LOOP_LANES]; /* from the start angle [rad] */
    double speed[LOOP_LANES];
    double early[LOOP_LANES]; /* acceleration at the beginning and at the end of the last period [rad/s^2] */
    double late[LOOP_LANES];
    double held[LOOP_LANES];
    double keep[LOOP_LANES];
    double first[LOOP_LANES];
    double second[LOOP_LANES];
    double decay[LOOP_LANES];
    double impulse[LOOP_LANES];
} motor_lanes;

typedef struct {
    double real[LOOP_MODES];
    cx pair[LOOP_MODES];
    double tip;
    cx second;
} link_state;

static double rounded_to(double value, double quantum)
{
    return quantum > 0.0 ? nearbyint(value / quantum) * quantum : value;
}

/* M(s) = 1/(1 + s/p)^2 under a held reference, exactly: a double pole at -p. Returns the voltage that begins this
 * move, with coupling torque and friction compensated, by equation (1). */
static double follow_reference(motor_lanes *m, int l, const loop_rig *rig, double reference)
{
    const double p = rig->pole;
    const double pt = p * rig->period;
    const double e = m->angle[l] - reference;
    const double v = m->speed[l];
    const double voltage = (p * p * (reference - m->angle[l]) + (rig->decay - 2.0 * p) * v) / rig->gain;
    m->early[l] = -p * (p * e + 2.0 * v);
    m->angle[l] = reference + m->keep[l] * ((1.0 + pt) * e + rig->period * v);
    m->speed[l] = m->keep[l] * ((1.0 - pt) * v - p * pt * e);
    m->late[l] = -p * (p * (m->angle[l] - reference) + 2.0 * m->speed[l]);
    return voltage;
}

/* Real modes in lanes of SUM_LANES: each lane adds up its own modes, and the lanes are added in one order, so that the
 * sum has the same bits whatever the width of the machine's vectors (a reduction clause would follow that width). */
#define SUM_LANES 8

FRACLINK_CLONES
static double move_reals(double *restrict x, const loop_link *link, const double q[LOOP_POWERS])
{
    const int n = link->reals;
    const double *restrict decay = link->decay;
    const double *restrict w = link->weight;
    double lane[SUM_LANES] = {0.0};
    int i = 0;
    for (; i + SUM_LANES <= n; i += SUM_LANES) {
#pragma omp simd
        for (int l = 0; l < SUM_LANES; l++) {
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
    double tip = move_reals(s->real, link, q);
    for (int j = 0; j < LOOP_POWERS; j++)
        tip += link->first[j] * q[j];
    for (int i = 0; i < m; i++) {
        cx z = mul(link->pair[i], s->pair[i]);
        for (int j = 0; j < LOOP_POWERS; j++)
            z = add(z, scale(q[j], link->pair_weight[j * m + i]));
        s->pair[i] = z;
        tip += z.re;
    }
    s->tip = tip;
    if (link->second) {
        const double *n = link->second;
        cx z = mul((cx){n[1], n[2]}, s->second);
        for (int j = 0; j < LOOP_POWERS; j++)
            z = add(z, scale(q[j], (cx){n[3 + j], n[3 + LOOP_POWERS + j]}));
        s->second = z;
    }
}

/* Torque at the root of the link: the angle between motor and tip, and what the second mode adds to it. */
static double root_torque(const link_state *s, const loop_link *link, double motor)
{
    const double bend = motor - s->tip;
    return link->stiffness * (link->second ? bend + (link->second[0] * motor + s->second.re) : bend);
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

/* The gauge reading of a torque, with noise from a standard normal number; `gain` and `error` of a fault: 1 and 0 for none. */
static double gauge_reading(const loop_rig *rig, gauge_line *gauge, double torque, double normal, double gain,
                            double error, int64_t k)
{
    double reading = gain * rig->gauge_gain * shown_torque(gauge, torque, k) + (k > 0 ? rig->offset : 0.0) + error;
    if (rig->noise > 0.0)
        reading += rig->noise * normal;
    reading = rounded_to(reading, rig->quantum);
    return fmin(fmax(reading, -rig->limit), rig->limit);
}

/* The quintic in (t - kT)/T with the angles, speeds and accelerations of both ends of one motor's period. */
static void quintic(const motor_lanes *from, const motor_lanes *to, int l, double period, double q[LOOP_POWERS])
{
    const double rise = to->angle[l] - from->angle[l];
    const double v0 = period * from->speed[l];
    const double v1 = period * to->speed[l];
    const double a0 = 0.5 * period * period * to->early[l];
    const double a1 = 0.5 * period * period * to->late[l];
    q[0] = from->angle[l];
    q[1] = v0;
    q[2] = a0;
    q[3] = 10.0 * rise - 6.0 * v0 - 4.0 * v1 - 3.0 * a0 + a1;
    q[4] = -15.0 * rise + 8.0 * v0 + 7.0 * v1 + 3.0 * a0 - 2.0 * a1;
    q[5] = 6.0 * rise - 3.0 * (v0 + v1) - a0 + a1;
}

static const double HEALTHY[TWIN_INPUTS] = {[TWIN_ENCODER_GAIN] = 1.0, [TWIN_GAUGE_GAIN] = 1.0};

/* What an arm and its controller remember, beside the motor. */
typedef struct {
    link_state link;
    gauge_line gauge;
    double pending[LOOP_DELAY];
    law_state law; /* room for those of either precision: these are the larger ones */
    payload_state estimate;
    double out[PORT_OUTPUTS];
    uint32_t marks[PORT_MARKS];
    double seen_angle; /* what the sensors gave last */
    double seen_torque;
} arm_state;

/* Motors under held voltages, with Coulomb friction as a proximal step: the friction force of a substep is the one that
 * reduces the speed by at most its impulse and never turns it around, which includes stiction. */
FRACLINK_CLONES
static void follow_voltages(motor_lanes *restrict m, int substeps)
{
    for (int i = 0; i < substeps; i++) {
#pragma omp simd
        EACH_LANE(l)
        {
            const double push = m->held[l];
            const double free = m->keep[l] * m->speed[l] + m->first[l] * push;
            const double left = fabs(free) - m->impulse[l];
            const double speed = copysign(left > 0.0 ? left : 0.0, free);
            const double force = push + (speed - free) / m->first[l];
            m->early[l] = i == 0 ? force - m->decay[l] * m->speed[l] : m->early[l];
            m->angle[l] += m->first[l] * m->speed[l] + m->second[l] * force;
            m->speed[l] = speed;
            m->late[l] = force - m->decay[l] * speed;
        }
    }
}

static void begin(const loop_arm *arm, const law_port *law, const void *params, arm_state *s, motor_lanes *m, int l)
{
    const loop_weights *const w = &arm->rig.weights;
    m->keep[l] = w->keep;
    m->first[l] = w->first;
    m->second[l] = w->second;
    m->decay[l] = arm->rig.decay;
    m->impulse[l] = arm->rig.friction * w->first;
    set_gauge(&s->gauge, arm->rig.gauge_delay);
    (void)law->begin(&s->law, params);
    if (arm->rig.estimator)
        (void)law->begin_estimate(&s->estimate, arm->rig.estimator);
}

/* Sensors and law of one arm; returns what it applies to the motor `delay` periods later. */
static double decide(const loop_arm *arm, const law_port *law, const void *params, arm_state *s, double motor, int64_t k)
{
    const loop_rig *const rig = &arm->rig;
    const double *const fault = arm->faults ? arm->faults + k * TWIN_INPUTS : HEALTHY;
    const int broken = (int)fault[TWIN_FAULTS];
    const double torque = root_torque(&s->link, &arm->link, motor);
    const double normal = rig->noise > 0.0 ? arm->normal[k] : 0.0;
    double measured =
        gauge_reading(rig, &s->gauge, torque, normal, fault[TWIN_GAUGE_GAIN], fault[TWIN_GAUGE_ERROR], k);
    double angle =
        rounded_to(fault[TWIN_ENCODER_GAIN] * (rig->start + motor) + fault[TWIN_ENCODER_ERROR], rig->encoder);
    twin_break(fault, s->seen_angle, s->seen_torque, &angle, &measured);
    s->seen_angle = angle;
    s->seen_torque = measured;
    if (broken & TWIN_TICK_MISSED) {
        s->marks[PORT_FLAGS] = 0U; /* the timer's hardware goes on with the voltage it was given last */
    } else {
        const double in[PORT_INPUTS] = {
            arm->amplitude * arm->reference[k], arm->amplitude * arm->acceleration[k], angle, measured,
            rig->estimator ? law->estimate(&s->estimate, rig->estimator, (uint32_t)k, angle, measured, 0, 0)
                           : rig->payload};
        for (int i = (broken & TWIN_TICK_REPEATED) ? 2 : 1; i; i--)
            law->step(&s->law, params, (uint32_t)k, in, s->out, s->marks);
    }
    arm->signal[LOOP_TIP_ANGLE][k] = rig->start + s->link.tip;
    arm->signal[LOOP_MOTOR_REFERENCE][k] = s->out[PORT_MOTOR_REFERENCE];
    arm->signal[LOOP_VOLTAGE][k] = s->out[PORT_VOLTAGE];
    arm->signal[LOOP_MOTOR_ANGLE][k] = rig->start + motor;
    arm->signal[LOOP_TORQUE][k] = torque;
    arm->signal[LOOP_TORQUE_MEASURED][k] = measured;
    arm->signal[LOOP_TIP_ESTIMATE][k] = s->out[PORT_TIP_ESTIMATE];
    arm->signal[LOOP_MOTOR_ANGLE_MEASURED][k] = angle;
    arm->mark[LOOP_FLAGS][k] = s->marks[PORT_FLAGS];
    arm->mark[LOOP_MODE][k] = s->marks[PORT_MODE];
    arm->mark[LOOP_REASON][k] = s->marks[PORT_REASON];
    if (!rig->sampled)
        return s->out[PORT_MOTOR_REFERENCE] - rig->start;
    /* ideal: the law's compensation cancels the coupling torque exactly, so neither is simulated */
    return s->out[PORT_VOLTAGE] - s->out[PORT_COMPENSATION];
}

int loop_run(const loop_arm *arms, int count, const law_port *law, const void *params, int64_t length)
{
    arm_state states[LOOP_LANES] = {0}; /* at rest, with everything zero */
    motor_lanes motor = {0};
    const int sampled = arms[0].rig.sampled;
    for (int l = 0; l < count; l++) {
        if (out_of_bounds(&arms[l].link, &arms[l].rig))
            return 1;
        begin(&arms[l], law, params, &states[l], &motor, l);
    }
    for (int64_t k = 0; k < length; k++) {
        const motor_lanes before = motor;
        for (int l = 0; l < count; l++) {
            const loop_arm *const arm = &arms[l];
            arm_state *const s = &states[l];
            const int64_t slots = arm->rig.delay + 1;
            s->pending[k % slots] = decide(arm, law, params, s, motor.angle[l], k);
            const double applied = s->pending[(k + 1) % slots]; /* written `delay` periods ago */
            motor.held[l] = arm->rig.gain * applied;
            if (!sampled)
                arm->signal[LOOP_VOLTAGE][k] = follow_reference(&motor, l, &arm->rig, applied);
        }
        if (sampled)
            follow_voltages(&motor, arms[0].rig.substeps);
        for (int l = 0; l < count; l++) {
            double q[LOOP_POWERS];
            quintic(&before, &motor, l, arms[l].rig.period, q);
            move_link(&states[l].link, &arms[l].link, q);
        }
    }
    return 0;
}
