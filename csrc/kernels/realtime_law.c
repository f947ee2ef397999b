/* One period of law.c behind a type without its precision; compiled once for each, see realtime_law_single.c. */
#include "law.h"
#include "payload_estimator.h"
#include "realtime.h"

#ifndef REALTIME_LAW
#define REALTIME_LAW realtime_law_double
#define REALTIME_ESTIMATE realtime_estimate_double
#endif

void REALTIME_LAW(void *state, const void *params, uint32_t tick, const double *inputs, double *outputs,
                  uint32_t *marks)
{
    const law_input in = {tick, (law_real)inputs[0], (law_real)inputs[1], (law_real)inputs[2], (law_real)inputs[3],
                          (law_real)inputs[4]};
    law_output out;
    law_step((law_state *)state, (const law_params *)params, &in, &out);
    outputs[0] = (double)out.motor_reference;
    outputs[1] = (double)out.voltage;
    outputs[2] = (double)out.compensation;
    outputs[3] = (double)out.tip_estimate;
    outputs[4] = (double)out.error;
    marks[0] = out.mode;
    marks[1] = out.reason;
    marks[2] = out.flags;
}

double REALTIME_ESTIMATE(void *state, const void *params, uint32_t tick, double motor_angle, double torque)
{
    payload_output found;
    payload_step((payload_state *)state, (const payload_params *)params, tick, (law_real)motor_angle, (law_real)torque,
                 &found);
    return (double)found.given;
}
