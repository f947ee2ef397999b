/* One closed loop: sensors -> law_step -> delay -> motor -> link, one period after the other.
 *
 * Within a period the motor's angle is a smooth curve whose angles, speeds and accelerations at both ends are known.
 * The quintic through them differs from it by T^6/46080 times its sixth derivative (1e-9 rad behind M(s) at 4 ms; a
 * cubic is 1e-6 off), and for a quintic the link's response is exact. This file is compiled twice, see loop_single.c. */
#include "loop.h"

#include "law.h"
#include "loop_parts.h"
#include "twin.h"

#ifndef LOOP_RUN
#define LOOP_RUN loop_run_double
#endif

static const double HEALTHY[TWIN_INPUTS] = {[TWIN_ENCODER_GAIN] = 1.0, [TWIN_GAUGE_GAIN] = 1.0};

int LOOP_RUN(const loop_link *link, const loop_rig *rig, const void *params, const loop_input *input,
             const loop_trace *trace)
{
    const law_params *const p = (const law_params *)params;
    const loop_weights w = rig->weights;
    motor_state motor = {0.0, 0.0, 0.0, 0.0};
    link_state flexible = STRAIGHT;
    gauge_line gauge;
    double pending[LOOP_DELAY];
    law_state state;
    payload_state estimate;
    law_input in;
    law_output out = {0};
    double seen_angle = 0.0, seen_torque = 0.0; /* what the sensors gave last */
    if (out_of_bounds(link, rig))
        return 1;
    set_gauge(&gauge, rig->gauge_delay);
    const int slots = rig->delay + 1;
    for (int i = 0; i < slots; i++)
        pending[i] = 0.0;
    (void)law_init(&state, p);
    begin_estimate(rig, &estimate);
    for (int64_t k = 0; k < input->length; k++) {
        const double *const fault = input->faults ? input->faults + k * TWIN_INPUTS : HEALTHY;
        const int broken = (int)fault[TWIN_FAULTS];
        const double torque = root_torque(&flexible, link, motor.angle);
        const double normal = rig->noise > 0.0 ? input->normal[k] : 0.0;
        double measured =
            gauge_reading(rig, &gauge, torque, normal, fault[TWIN_GAUGE_GAIN], fault[TWIN_GAUGE_ERROR], k);
        double angle = rounded_to(fault[TWIN_ENCODER_GAIN] * (rig->start + motor.angle) + fault[TWIN_ENCODER_ERROR],
                                  rig->encoder);
        twin_break(fault, seen_angle, seen_torque, &angle, &measured);
        seen_angle = angle;
        seen_torque = measured;
        in.tick = (uint32_t)k;
        in.reference = (law_real)input->reference[k];
        in.reference_acceleration = (law_real)input->acceleration[k];
        in.motor_angle = (law_real)angle;
        in.torque = (law_real)measured;
        if (broken & TWIN_TICK_MISSED) {
            out.flags = 0U; /* the timer's hardware goes on with the voltage it was given last */
        } else {
            in.payload = payload_of(rig, &estimate, &in);
            law_step(&state, p, &in, &out);
            if (broken & TWIN_TICK_REPEATED)
                law_step(&state, p, &in, &out);
        }
        trace->tip[k] = rig->start + flexible.tip;
        trace->motor[k] = rig->start + motor.angle;
        trace->motor_reference[k] = (double)out.motor_reference;
        trace->torque[k] = torque;
        trace->measured[k] = measured;
        trace->voltage[k] = (double)out.voltage;
        trace->tip_estimate[k] = (double)out.tip_estimate;
        trace->encoder[k] = angle;
        trace->flags[k] = out.flags;
        trace->mode[k] = out.mode;
        trace->reason[k] = out.reason;
        /* ideal: what the law adds against the coupling torque meets a coupling torque that is the same */
        const double added = rig->coupling > 0.0 ? 0.0 : (double)out.compensation;
        pending[k % slots] = rig->sampled ? (double)out.voltage - added
                                          : (double)out.motor_reference - rig->start;
        const double applied = pending[(k + 1) % slots]; /* written `delay` periods ago */
        const motor_state before = motor;
        double q[LOOP_POWERS];
        if (rig->sampled) {
            follow_voltage(&motor, rig, &w, rig->gain * applied, &flexible);
        } else {
            trace->voltage[k] = servo_voltage(&motor, rig, applied);
            follow_reference(&motor, rig, &w, applied);
        }
        quintic(&before, &motor, rig->period, q);
        move_link(&flexible, link, q);
    }
    return 0;
}

#ifndef LAW_SINGLE
/* The motor alone, from `speed`, without voltage: what a test compares with the equation's own solution. */
void loop_coast(const loop_rig *rig, double speed, double *angle, int64_t length)
{
    motor_state motor = {0.0, speed, 0.0, 0.0};
    const link_state rigid = STRAIGHT;
    for (int64_t k = 0; k < length; k++) {
        angle[k] = motor.angle;
        follow_voltage(&motor, rig, &rig->weights, 0.0, &rigid);
    }
}
#endif
