/* An instance of the FMU: its memory, and its steps around law_step.
 *
 * Included by fmi3.c behind the types of the standard. Everything here is static, so that the sources of several FMUs
 * link into one program. The generated all.c includes law.c, law_data, FMU_TOKEN and FMU_PERIOD first. */
#ifndef FRACLINK_FMU_CORE_H
#define FRACLINK_FMU_CORE_H

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "law.h"

/* Value references: inputs, then outputs in the order of modelDescription.xml, then the time, then the payload. */
#define FMU_REFERENCE 0U
#define FMU_REFERENCE_ACCELERATION 1U
#define FMU_MOTOR_ANGLE 2U
#define FMU_TORQUE 3U
#define FMU_INPUTS 4U
#define FMU_MOTOR_REFERENCE 4U
#define FMU_VOLTAGE 5U
#define FMU_TIP_ESTIMATE 6U
#define FMU_REALS 7U
#define FMU_VALUES 10U /* mode, reason and flags are the marks in between */
#define FMU_TIME 10U
#define FMU_PAYLOAD 11U /* an input added later: the earlier references are the same in every release */

/* An error ends the simulation, as FMI 3 requires: it only continues after a reset, a restored state or freeing. */
#define FMU_INSTANTIATED 0U
#define FMU_INITIALIZING 1U
#define FMU_STEPPING 2U
#define FMU_TERMINATED 3U

#define FMU_MESSAGE 160U

/* All state changed by a simulation, and therefore the content of a snapshot; plain data. */
typedef struct {
    uint32_t owner; /* CRC-32 of the parameters: a snapshot of another law is rejected */
    uint32_t phase;
    uint32_t tick;
    uint32_t marks[FMU_VALUES - FMU_REALS];
    double time; /* end of the last step [s] */
    double reals[FMU_REALS];
    double payload;
    law_state law;
} fmu_memory;

/* What the importer passed. */
typedef struct {
    fmi3LogMessageCallback log;
    fmi3InstanceEnvironment environment;
    bool logging;
} fmu_host;

typedef struct {
    fmu_host host;
    fmu_memory memory;
} fmu_instance;

/* FMI 3 requires silence while logging is off: then only the status reports the error. */
static void fmu_tell(const fmu_host *host, const char *message)
{
    if (host->logging && (host->log != NULL))
        host->log(host->environment, fmi3Error, "logStatusError", message);
}

static fmi3Status fmu_refuse(fmu_instance *me, const char *message)
{
    me->memory.phase = FMU_TERMINATED;
    fmu_tell(&me->host, message);
    return fmi3Error;
}

static void fmu_restart(fmu_instance *me)
{
    memset(&me->memory, 0, sizeof me->memory); /* including padding: equal simulations serialize to equal bytes */
    me->memory.owner = law_data.crc;
    (void)law_init(&me->memory.law, &law_data);
}

static fmu_instance *fmu_instantiate(const fmu_host *host, const char *token)
{
    fmu_instance *me = NULL;
    if ((token == NULL) || (strcmp(token, FMU_TOKEN) != 0)) {
        fmu_tell(host, "modelDescription.xml and the library are not of one FMU: the tokens differ");
    } else if (law_check(&law_data) != LAW_OK) {
        fmu_tell(host, "the law refuses its parameters: the FMU is damaged");
    } else {
        me = (fmu_instance *)calloc(1U, sizeof *me); /* for the FMU; the law itself allocates nothing */
        if (me == NULL) {
            fmu_tell(host, "out of memory");
        } else {
            me->host = *host;
            fmu_restart(me);
        }
    }
    return me;
}

/* Before the first step the outputs are those of an arm at rest at the angle of its encoder, so that a drive that
 * follows motor_reference does not jump to 0 for a period. */
static void fmu_rest(fmu_memory *m)
{
    const double angle = m->reals[FMU_MOTOR_ANGLE], torque = m->reals[FMU_TORQUE];
    const double range = (double)law_data.motor_limit, push = (double)law_data.torque_limit;
    m->reals[FMU_MOTOR_REFERENCE] = ((angle >= -range) && (angle <= range)) ? angle : 0.0;
    m->reals[FMU_TIP_ESTIMATE] = m->reals[FMU_MOTOR_REFERENCE];
    if ((torque >= -push) && (torque <= push))
        m->reals[FMU_TIP_ESTIMATE] -= torque * (double)law_data.compliance;
}

/* A type that no variable has: there is nothing to read or to set. */
static fmi3Status fmu_no_variables(fmu_instance *me, size_t count)
{
    return count == 0U ? fmi3OK : fmu_refuse(me, "no variable has the type that is read or set");
}

static fmi3Status fmu_not_offered(fmu_instance *me)
{
    return fmu_refuse(me, "a function is called that modelDescription.xml does not offer");
}

static fmi3Status fmu_step(fmu_instance *me, double now, double step)
{
    fmu_memory *const m = &me->memory;
    char message[FMU_MESSAGE];
    law_input in;
    law_output out;
    if (m->phase != FMU_STEPPING)
        return fmu_refuse(me, "a step is asked for outside the simulation: initialize first, or reset after the end");
    /* importers subtract communication points; at 1e5 s the rounding is 4e-9 of a period of 4 ms */
    if (!((step > FMU_PERIOD * (1.0 - 1e-6)) && (step < FMU_PERIOD * (1.0 + 1e-6)))) {
        (void)snprintf(message, sizeof message,
                       "the law runs at its period: set the communication step to %.9g s (it was %.9g s)", FMU_PERIOD,
                       step);
        return fmu_refuse(me, message);
    }
    /* A repeated or omitted step would be another law. Either one is a whole period off, so half a period detects
     * it. */
    if ((m->tick > 0U) && !((now - m->time < 0.5 * FMU_PERIOD) && (m->time - now < 0.5 * FMU_PERIOD))) {
        (void)snprintf(message, sizeof message,
                       "steps follow each other: the last one ended at %.9g s, this one begins at %.9g s", m->time,
                       now);
        return fmu_refuse(me, message);
    }
    in.tick = m->tick; /* from 0, as in the package's simulation */
    /* a double beyond the range of float becomes infinite, as in the package, and the law rejects it */
    in.reference = (law_real)m->reals[FMU_REFERENCE];
    in.reference_acceleration = (law_real)m->reals[FMU_REFERENCE_ACCELERATION];
    in.motor_angle = (law_real)m->reals[FMU_MOTOR_ANGLE];
    in.torque = (law_real)m->reals[FMU_TORQUE];
    in.payload = (law_real)m->payload;
    law_step(&m->law, &law_data, &in, &out);
    m->reals[FMU_MOTOR_REFERENCE] = (double)out.motor_reference;
    m->reals[FMU_VOLTAGE] = (double)out.voltage;
    m->reals[FMU_TIP_ESTIMATE] = (double)out.tip_estimate;
    m->marks[0] = out.mode;
    m->marks[1] = out.reason;
    m->marks[2] = out.flags;
    m->tick++;
    m->time = now + step;
    return fmi3OK;
}

#endif
