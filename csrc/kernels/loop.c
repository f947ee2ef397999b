/* One closed loop: sensors -> law_step -> delay -> motor -> link, one period after the other.
 *
 * Within a period the motor's angle is a smooth curve whose angles, speeds and accelerations at both ends are known.
 * The quintic through them differs from it by T^6/46080 times its sixth derivative (1e-9 rad behind M(s) at 4 ms; a
 * cubic is 1e-6 off), and for a quintic the link's response is exact. */
#include "loop.h"

#include "law.h"
#include "loop_parts.h"
#include "payload_estimator.h"
#include "twin.h"

static const double HEALTHY[TWIN_INPUTS] = {[TWIN_ENCODER_GAIN] = 1.0, [TWIN_GAUGE_GAIN] = 1.0};

int loop_run(const loop_link *link, const loop_rig *rig, const law_port *law, const void *params,
             const loop_input *input, const loop_trace *trace)
{
    const loop_weights w = rig->weights;
    motor_state motor = {0.0, 0.0, 0.0, 0.0};
    link_state flexible = STRAIGHT;
    gauge_line gauge;
    double pending[LOOP_DELAY];
    law_state state; /* room for those of either precision: these are the larger ones */
    payload_state estimate;
    double in[PORT_INPUTS], out[PORT_OUTPUTS] = {0.0};
    uint32_t marks[PORT_MARKS] = {0U};
    double seen_angle = 0.0, seen_torque = 0.0; /* what the sensors gave last */
    if (out_of_bounds(link, rig))
        return 1;
    set_gauge(&gauge, rig->gauge_delay);
    const int slots = rig->delay + 1;
    for (int i = 0; i < slots; i++)
        pending[i] = 0.0;
    law->begin(&state, params, &estimate, rig->estimator);
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
        in[PORT_REFERENCE] = input->reference[k];
        in[PORT_ACCELERATION] = input->acceleration[k];
        in[PORT_ANGLE] = angle;
        in[PORT_TORQUE] = measured;
        in[PORT_PAYLOAD] = rig->payload;
        if (broken & TWIN_TICK_MISSED) {
            marks[PORT_FLAGS] = 0U; /* the timer's hardware goes on with the voltage it was given last */
        } else {
            if (rig->estimator)
                in[PORT_PAYLOAD] = law->estimate(&estimate, rig->estimator, (uint32_t)k, angle, measured);
            for (int i = (broken & TWIN_TICK_REPEATED) ? 2 : 1; i; i--)
                law->step(&state, params, (uint32_t)k, in, out, marks);
        }
        trace->tip[k] = rig->start + flexible.tip;
        trace->motor[k] = rig->start + motor.angle;
        trace->motor_reference[k] = out[PORT_MOTOR_REFERENCE];
        trace->torque[k] = torque;
        trace->measured[k] = measured;
        trace->voltage[k] = out[PORT_VOLTAGE];
        trace->tip_estimate[k] = out[PORT_TIP_ESTIMATE];
        trace->encoder[k] = angle;
        trace->flags[k] = marks[PORT_FLAGS];
        trace->mode[k] = marks[PORT_MODE];
        trace->reason[k] = marks[PORT_REASON];
        /* ideal: what the law adds against the coupling torque meets a coupling torque that is the same */
        const double added = rig->coupling > 0.0 ? 0.0 : out[PORT_COMPENSATION];
        pending[k % slots] = rig->sampled ? out[PORT_VOLTAGE] - added : out[PORT_MOTOR_REFERENCE] - rig->start;
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
