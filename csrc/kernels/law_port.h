/* law.c and its payload estimator, in either precision, behind an interface of doubles: their callers are compiled once. */
#ifndef FRACLINK_LAW_PORT_H
#define FRACLINK_LAW_PORT_H

#include <stdint.h>

/* One period: numbers in and out, and marks, each in this order. */
enum { PORT_REFERENCE, PORT_ACCELERATION, PORT_ANGLE, PORT_TORQUE, PORT_PAYLOAD, PORT_INPUTS };
enum { PORT_MOTOR_REFERENCE, PORT_VOLTAGE, PORT_COMPENSATION, PORT_TIP_ESTIMATE, PORT_ERROR, PORT_OUTPUTS };
enum { PORT_MODE, PORT_REASON, PORT_FLAGS, PORT_MARKS };

typedef uint32_t (*law_begin)(void *state, const void *params);

/* Pointers are to the blocks and states of the port's precision. */
typedef struct {
    law_begin begin; /* law_init */
    void (*step)(void *state, const void *params, uint32_t tick, const double *inputs, double *outputs,
                 uint32_t *marks);
    /* motor reference, mode and reason of a law that is not called; the rest is 0 */
    void (*held)(const void *state, double *outputs, uint32_t *marks);
    /* law_check_wiring of a whole log */
    uint32_t (*wiring)(const void *params, const double *angle, const double *torque, int64_t length);
    law_begin begin_estimate; /* payload_init */
    /* the payload for the law from this period's sample [kg], 0: none yet; estimate and its interval, low and high, go
     * to `interval`, and the flags to `flags`, where these are not null */
    double (*estimate)(void *state, const void *params, uint32_t tick, double angle, double torque, double *interval,
                       uint32_t *flags);
    int sizes[4]; /* bytes of law_params, law_state, payload_params, payload_state */
} law_port;

extern const law_port LAW_IN_DOUBLE, LAW_IN_SINGLE;

#endif
