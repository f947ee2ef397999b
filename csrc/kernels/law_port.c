/* Compiled once for each precision, see law_port_single.c. */
#include "law_port.h"

#include "law.h"
#include "payload_estimator.h"

#ifndef LAW_PORT
#define LAW_PORT LAW_IN_DOUBLE
#endif

static void begin(void *state, const void *params, void *estimate, const void *bank)
{
    (void)law_init((law_state *)state, (const law_params *)params);
#ifdef WITHOUT_ESTIMATOR
    (void)estimate;
    (void)bank;
#else
    if (bank)
        (void)payload_init((payload_state *)estimate, (const payload_params *)bank);
#endif
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

#ifndef WITHOUT_ESTIMATOR
static double estimate(void *state, const void *params, uint32_t tick, double angle, double torque)
{
    payload_output found;
    payload_step((payload_state *)state, (const payload_params *)params, tick, (law_real)angle, (law_real)torque,
                 &found);
    return (double)found.given;
}
#endif

const law_port LAW_PORT = {begin,
                           step,
                           held,
#ifdef WITHOUT_ESTIMATOR
                           0,
#else
                           estimate,
#endif
                           {(int)sizeof(law_params), (int)sizeof(law_state), (int)sizeof(payload_params),
                            (int)sizeof(payload_state)}};
