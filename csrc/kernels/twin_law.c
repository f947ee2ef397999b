/* The law around the twin; compiled once for each precision of the law, see twin_single.c. */
#include "twin.h"

#include <math.h>
#include <string.h>

#include "law.h"
#include "payload_estimator.h"

#ifndef TWIN_RUN
#define TWIN_RUN twin_run_double
#define TWIN_SIZES twin_sizes_double
#endif

void TWIN_SIZES(int sizes[4])
{
    sizes[0] = (int)sizeof(law_params);
    sizes[1] = (int)sizeof(law_state);
    sizes[2] = (int)sizeof(payload_params);
    sizes[3] = (int)sizeof(payload_state);
}

/* The payload that the law is given in this period: the inputs', or the estimate. */
static law_real payload_of(const double *input, const law_input *in, const twin_memory *memory)
{
    payload_output found;
    if (!memory->estimator) {
        return (law_real)input[TWIN_PAYLOAD];
    }
    payload_step((payload_state *)memory->estimate, (const payload_params *)memory->estimator, in->tick,
                 in->motor_angle, in->torque, &found);
    return found.given;
}

/* The law's answer of one period, and the voltage that acts: `voltage_delay` periods late, within the limit. */
static double control(const twin_rig *rig, const law_params *params, const double *input, law_state *law,
                      twin_memory *memory, double *record)
{
    const int faults = (int)input[TWIN_FAULTS];
    law_input given;
    law_output answer;
    double angle, torque;
    twin_sense(rig, memory, input, &angle, &torque);
    given.tick = memory->tick;
    given.reference = (law_real)input[TWIN_REFERENCE];
    given.reference_acceleration = (law_real)input[TWIN_ACCELERATION];
    given.motor_angle = (law_real)angle;
    given.torque = (law_real)torque;
    memory->tick++;

    double *queue = memory->voltage;
    const int last = rig->voltage_delay;
    if (faults & TWIN_TICK_MISSED) {
        /* The timer's hardware goes on with the voltage it was given last. */
        answer = (law_output){0};
        answer.motor_reference = law->motor_reference;
        answer.voltage = queue[last];
        answer.mode = law->mode & 0xFFU; /* one of the copies that law.c keeps */
        answer.reason = law->reason;
    } else {
        given.payload = payload_of(input, &given, memory);
        law_step(law, params, &given, &answer);
        if (faults & TWIN_TICK_REPEATED) {
            law_step(law, params, &given, &answer);
        }
    }
    queue[last] = answer.voltage;
    const double voltage = fmax(fmin(queue[0], rig->voltage_limit), -rig->voltage_limit);
    memmove(queue, queue + 1, sizeof(double) * (size_t)last);

    record[TWIN_OUT_REFERENCE] = input[TWIN_REFERENCE];
    record[TWIN_OUT_ENCODER] = angle;
    record[TWIN_OUT_GAUGE] = torque;
    record[TWIN_OUT_MOTOR_REFERENCE] = answer.motor_reference;
    record[TWIN_OUT_VOLTAGE] = voltage;
    record[TWIN_OUT_ASKED] = answer.voltage;
    record[TWIN_OUT_MODE] = answer.mode;
    record[TWIN_OUT_REASON] = answer.reason;
    record[TWIN_OUT_FLAGS] = answer.flags;
    record[TWIN_OUT_TIP_ESTIMATE] = (faults & TWIN_TICK_MISSED) ? NAN : (double)answer.tip_estimate;
    return voltage;
}

int TWIN_RUN(const twin_step *step, const twin_rig *rig, const twin_obstacle *obstacle, const void *params,
             int periods, const double *input, void *law, twin_memory *memory, double *record)
{
    for (int k = 0; k < periods; ++k, input += TWIN_INPUTS, record += TWIN_COLUMNS) {
        double largest = 0.0;
        record[TWIN_OUT_MOTOR_ANGLE] = memory->state[0];
        record[TWIN_OUT_MOTOR_VELOCITY] = memory->state[1];
        record[TWIN_OUT_TIP_ANGLE] = twin_output(step, 2, memory->state);
        record[TWIN_OUT_TORQUE] = twin_output(step, 3, memory->state);
        const double torque =
            rig->torque_per_volt * control(rig, (const law_params *)params, input, (law_state *)law, memory, record);
        for (int j = 0; j < rig->substeps; ++j) {
            const double push = twin_contact(step, obstacle, memory->state);
            largest = fabs(push) > largest ? fabs(push) : largest;
            twin_motor_step(step, rig, torque, push + input[TWIN_TIP_FORCE], memory);
        }
        record[TWIN_OUT_CONTACT] = largest;
        if (!(fabs(memory->state[0]) < 1e6)) {
            return k + 1; /* diverged: the numbers behind it would be infinite */
        }
    }
    return periods;
}
