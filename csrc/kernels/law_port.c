/* Compiled once for each precision, see law_port_single.c. */
#include "law_port.h"

#include "law.h"
#include "payload_estimator.h"

#ifndef LAW_PORT
#define LAW_PORT LAW_IN_DOUBLE
#endif

static uint32_t begin(void *state, const void *params)
{
    return law_init((law_state *)state, (const law_params *)params);
}

static void step(void *state, const void *params, uint32_t tick, const double *inputs, double *outputs,
                 uint32_t *marks)
{
    const law_input in = {tick,
                          (law_real)inputs[PORT_REFERENCE],
                          (law_real)inputs[PORT_ACCELERATION],
                          (law_real)inputs[PORT_ANGLE],
                          (law_real)inputs[PORT_TORQUE],
                          (law_real)inputs[PORT_PAYLOAD]};
    law_output out;
    law_step((law_state *)state, (const law_params *)params, &in, &out);
    outputs[PORT_MOTOR_REFERENCE] = (double)out.motor_reference;
    outputs[PORT_VOLTAGE] = (double)out.voltage;
    outputs[PORT_COMPENSATION] = (double)out.compensation;
    outputs[PORT_TIP_ESTIMATE] = (double)out.tip_estimate;
    outputs[PORT_ERROR] = (double)out.error;
    marks[PORT_MODE] = out.mode;
    marks[PORT_REASON] = out.reason;
    marks[PORT_FLAGS] = out.flags;
}

static void held(const void *state, double *outputs, uint32_t *marks)
{
    const law_state *const law = (const law_state *)state;
    for (int i = 0; i < PORT_OUTPUTS; i++)
        outputs[i] = 0.0;
    outputs[PORT_MOTOR_REFERENCE] = (double)law->motor_reference;
    marks[PORT_MODE] = law->mode & 0xFFU; /* one of the copies that law.c keeps */
    marks[PORT_REASON] = law->reason;
    marks[PORT_FLAGS] = 0U;
}

#ifdef LAW_ALONE /* without the wiring test and the estimator */
#define wiring 0
#define begin_estimate 0
#define estimate 0
#else
static uint32_t wiring(const void *params, const double *angle, const double *torque, int64_t length)
{
    law_wiring test = {0};
    uint32_t reason = LAW_OK;
    for (int64_t k = 0; k < length; k++)
        reason = law_check_wiring(&test, (const law_params *)params, (law_real)angle[k], (law_real)torque[k]);
    return reason;
}

static uint32_t begin_estimate(void *state, const void *params)
{
    return payload_init((payload_state *)state, (const payload_params *)params);
}

static double estimate(void *state, const void *params, uint32_t tick, double angle, double torque, double *interval,
                       uint32_t *flags)
{
    payload_output found;
    payload_step((payload_state *)state, (const payload_params *)params, tick, (law_real)angle, (law_real)torque,
                 &found);
    if (interval) {
        interval[0] = (double)found.estimate;
        interval[1] = (double)found.low;
        interval[2] = (double)found.high;
    }
    if (flags)
        *flags = found.flags;
    return (double)found.given;
}
#endif

const law_port LAW_PORT = {begin,
                           step,
                           held,
                           wiring,
                           begin_estimate,
                           estimate,
                           {(int)sizeof(law_params), (int)sizeof(law_state), (int)sizeof(payload_params),
                            (int)sizeof(payload_state)}};
