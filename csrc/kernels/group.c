/* See group.h. Compiled once for each precision, see group_single.c. */
#include "group.h"

#include "law.h"
#include "loop_parts.h"
#include "payload_estimator.h"

#ifndef GROUP_RUN
#define GROUP_RUN group_run_double
#endif

#define EACH_LANE(l) for (int l = 0; l < GROUP_LANES; l++)

/* The motors of the group, field by field what motor_state and motor_weights are for one. */
typedef struct {
    double angle[GROUP_LANES];
    double speed[GROUP_LANES];
    double early[GROUP_LANES];
    double late[GROUP_LANES];
    double held[GROUP_LANES];
    double keep[GROUP_LANES];
    double first[GROUP_LANES];
    double second[GROUP_LANES];
    double decay[GROUP_LANES];
    double impulse[GROUP_LANES];
} motor_lanes;

/* follow_voltage without coupling, whose push is the same in all substeps. */
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

static motor_state motor_of(const motor_lanes *m, int l)
{
    const motor_state one = {m->angle[l], m->speed[l], m->early[l], m->late[l]};
    return one;
}

static void set_motor(motor_lanes *m, int l, const motor_state *one)
{
    m->angle[l] = one->angle;
    m->speed[l] = one->speed;
    m->early[l] = one->early;
    m->late[l] = one->late;
}

/* Sensors and law of one loop; returns what it applies to the motor `delay` periods later. */
static double decide(const group_loop *loop, const law_params *p, law_state *state, payload_state *estimate,
                     gauge_line *gauge, const link_state *link, double motor, int64_t k)
{
    const loop_rig *rig = &loop->rig;
    law_input in;
    law_output out;
    in.tick = (uint32_t)k;
    in.reference = (law_real)(loop->amplitude * loop->angle[k]);
    in.reference_acceleration = (law_real)(loop->amplitude * loop->acceleration[k]);
    in.motor_angle = (law_real)rounded_to(rig->start + motor, rig->encoder);
    const double normal = rig->noise > 0.0 ? loop->noise[k] : 0.0;
    in.torque = (law_real)gauge_reading(rig, gauge, root_torque(link, &loop->link, motor), normal, 1.0, 0.0, k);
    in.payload = (law_real)rig->payload;
    if (rig->estimator) {
        payload_output found;
        payload_step(estimate, (const payload_params *)rig->estimator, in.tick, in.motor_angle, in.torque, &found);
        in.payload = found.given;
    }
    law_step(state, p, &in, &out);
    loop->trace.tip[k] = rig->start + link->tip;
    loop->trace.motor_reference[k] = (double)out.motor_reference;
    loop->trace.voltage[k] = (double)out.voltage;
    loop->trace.flags[k] = out.flags;
    loop->trace.mode[k] = out.mode;
    loop->trace.reason[k] = out.reason;
    if (!rig->sampled)
        return (double)out.motor_reference - rig->start;
    return (double)out.voltage - (rig->coupling > 0.0 ? 0.0 : (double)out.compensation);
}

/* Motors that are no lanes of one vector: behind the ideal motor loop, or pushed by their links. */
static void follow_one_by_one(const group_loop *loops, motor_lanes *m, const link_state *links, const double *applied,
                              int64_t k)
{
    EACH_LANE(l)
    {
        const loop_rig *rig = &loops[l].rig;
        motor_state one = motor_of(m, l);
        if (rig->sampled) {
            follow_voltage(&one, rig, &rig->weights, rig->gain * applied[l], &links[l]);
        } else {
            loops[l].trace.voltage[k] = servo_voltage(&one, rig, applied[l]);
            follow_reference(&one, rig, &rig->weights, applied[l]);
        }
        set_motor(m, l, &one);
    }
}

int GROUP_RUN(const group_loop loops[GROUP_LANES], const void *params, int64_t length)
{
    const law_params *const p = (const law_params *)params;
    motor_lanes motor = {{0.0}, {0.0}, {0.0}, {0.0}, {0.0}, {0.0}, {0.0}, {0.0}, {0.0}, {0.0}};
    link_state links[GROUP_LANES];
    law_state states[GROUP_LANES];
    payload_state estimates[GROUP_LANES];
    gauge_line gauges[GROUP_LANES];
    double pending[GROUP_LANES][LOOP_DELAY];
    int in_lanes = 1;
    EACH_LANE(l)
    {
        if (out_of_bounds(&loops[l].link, &loops[l].rig))
            return 1;
        set_gauge(&gauges[l], loops[l].rig.gauge_delay);
        links[l] = STRAIGHT;
        const loop_weights *const w = &loops[l].rig.weights;
        motor.keep[l] = w->keep;
        motor.first[l] = w->first;
        motor.second[l] = w->second;
        motor.decay[l] = loops[l].rig.decay;
        motor.impulse[l] = loops[l].rig.friction * w->first;
        in_lanes = in_lanes && loops[l].rig.sampled && loops[l].rig.coupling == 0.0;
        for (int i = 0; i <= loops[l].rig.delay; i++)
            pending[l][i] = 0.0;
        (void)law_init(&states[l], p);
        if (loops[l].rig.estimator)
            (void)payload_init(&estimates[l], (const payload_params *)loops[l].rig.estimator);
    }
    for (int64_t k = 0; k < length; k++) {
        const motor_lanes before = motor;
        double applied[GROUP_LANES];
        EACH_LANE(l)
        {
            const int64_t slots = loops[l].rig.delay + 1;
            pending[l][k % slots] =
                decide(&loops[l], p, &states[l], &estimates[l], &gauges[l], &links[l], motor.angle[l], k);
            applied[l] = pending[l][(k + 1) % slots]; /* written `delay` periods ago */
            motor.held[l] = loops[l].rig.gain * applied[l];
        }
        if (in_lanes)
            follow_voltages(&motor, loops[0].rig.substeps);
        else
            follow_one_by_one(loops, &motor, links, applied, k);
        EACH_LANE(l)
        {
            const motor_state from = motor_of(&before, l);
            const motor_state to = motor_of(&motor, l);
            double q[LOOP_POWERS];
            quintic(&from, &to, loops[l].rig.period, q);
            move_link(&links[l], &loops[l].link, q);
        }
    }
    return 0;
}
