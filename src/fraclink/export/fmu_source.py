"""The C side of the FMU: the functions of FMI 2.0 for co-simulation around law_step.

The declarations are written from the standard (FMI 2.0.4, sections 2.1 and 4.2): no header has to be shipped.
"""

# ruff: noqa: E501 - C text, in the 120 columns of csrc/

from __future__ import annotations

__all__ = ["VARIABLES", "WRAPPER"]

# name, type, causality, unit, description; the position is the value reference
VARIABLES: tuple[tuple[str, str, str, str, str], ...] = (
    ("reference", "Real", "input", "rad", "tip reference"),
    ("reference_acceleration", "Real", "input", "rad/s2", "its acceleration"),
    ("motor_angle", "Real", "input", "rad", "encoder"),
    ("torque", "Real", "input", "N.m", "gauge: coupling torque"),
    ("motor_reference", "Real", "output", "rad", "reference of the motor"),
    ("voltage", "Real", "output", "V", "voltage of the motor"),
    ("tip_estimate", "Real", "output", "rad", "motor angle - torque / stiffness"),
    ("mode", "Integer", "output", "", "0 idle, 1 run, 2 degraded, 3 hold, 4 off"),
    ("reason", "Integer", "output", "", "why, see law.h"),
    ("flags", "Integer", "output", "", "bits, see law.h"),
)

WRAPPER = r"""
#include <stdlib.h>
#include <string.h>

#if defined(_WIN32)
#define FMU_API __declspec(dllexport)
#else
#define FMU_API __attribute__((visibility("default")))
#endif

typedef void *fmi2Component;
typedef void *fmi2ComponentEnvironment;
typedef void *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef char fmi2Char;
typedef const fmi2Char *fmi2String;
typedef char fmi2Byte;
typedef int fmi2Status; /* 0 OK, 1 warning, 2 discard, 3 error */
typedef int fmi2Type;
typedef int fmi2StatusKind;

#define OK 0
#define ERROR 3
#define INPUTS 4U
#define REALS 7U
#define ALL 10U

typedef struct {
    law_state state;
    uint32_t tick;
    double reals[REALS];
    int integers[ALL - REALS];
} instance;

FMU_API const char *fmi2GetTypesPlatform(void) { return "default"; }
FMU_API const char *fmi2GetVersion(void) { return "2.0"; }

static void restart(instance *me)
{
    memset(me, 0, sizeof(*me));
    (void)law_init(&me->state, &law_data);
}

FMU_API fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                                      const void *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    instance *me = NULL;
    (void)name; (void)resources; (void)callbacks; (void)visible; (void)logging;
    if (type == 1 && guid != NULL && strcmp(guid, "@GUID@") == 0 && law_check(&law_data) == LAW_OK) {
        me = (instance *)malloc(sizeof(*me)); /* the FMU's; the law itself allocates nothing */
        if (me != NULL)
            restart(me);
    }
    return me;
}

FMU_API void fmi2FreeInstance(fmi2Component c) { free(c); }
FMU_API fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    (void)c; (void)on; (void)n; (void)categories;
    return OK;
}
FMU_API fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean defined, fmi2Real tolerance, fmi2Real start,
                                       fmi2Boolean ends, fmi2Real stop)
{
    (void)c; (void)defined; (void)tolerance; (void)start; (void)ends; (void)stop;
    return OK;
}
FMU_API fmi2Status fmi2EnterInitializationMode(fmi2Component c) { (void)c; return OK; }
FMU_API fmi2Status fmi2ExitInitializationMode(fmi2Component c) { (void)c; return OK; }
FMU_API fmi2Status fmi2Terminate(fmi2Component c) { (void)c; return OK; }
FMU_API fmi2Status fmi2Reset(fmi2Component c) { restart((instance *)c); return OK; }

FMU_API fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real value[])
{
    const instance *me = (const instance *)c;
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= REALS)
            return ERROR;
        value[i] = me->reals[r[i]];
    }
    return OK;
}
FMU_API fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real value[])
{
    instance *me = (instance *)c;
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= INPUTS)
            return ERROR;
        me->reals[r[i]] = value[i];
    }
    return OK;
}
FMU_API fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Integer value[])
{
    const instance *me = (const instance *)c;
    for (size_t i = 0; i < n; i++) {
        if (r[i] < REALS || r[i] >= ALL)
            return ERROR;
        value[i] = me->integers[r[i] - REALS];
    }
    return OK;
}

FMU_API fmi2Status fmi2DoStep(fmi2Component c, fmi2Real now, fmi2Real step, fmi2Boolean keep)
{
    instance *me = (instance *)c;
    const double period = @PERIOD@;
    law_input in;
    law_output out;
    (void)now; (void)keep;
    if (!(step > period * (1.0 - 1e-6) && step < period * (1.0 + 1e-6)))
        return ERROR;
    me->tick++;
    in.tick = me->tick;
    in.reference = (law_real)me->reals[0];
    in.reference_acceleration = (law_real)me->reals[1];
    in.motor_angle = (law_real)me->reals[2];
    in.torque = (law_real)me->reals[3];
    law_step(&me->state, &law_data, &in, &out);
    me->reals[4] = (double)out.motor_reference;
    me->reals[5] = (double)out.voltage;
    me->reals[6] = (double)out.tip_estimate;
    me->integers[0] = (int)out.mode;
    me->integers[1] = (int)out.reason;
    me->integers[2] = (int)out.flags;
    return OK;
}

/* Not offered: each says so. */
FMU_API fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer v[])
{ (void)c; (void)r; (void)v; return n == 0 ? OK : ERROR; }
FMU_API fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Boolean v[])
{ (void)c; (void)r; (void)v; return n == 0 ? OK : ERROR; }
FMU_API fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Boolean v[])
{ (void)c; (void)r; (void)v; return n == 0 ? OK : ERROR; }
FMU_API fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2String v[])
{ (void)c; (void)r; (void)v; return n == 0 ? OK : ERROR; }
FMU_API fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2String v[])
{ (void)c; (void)r; (void)v; return n == 0 ? OK : ERROR; }
FMU_API fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *s) { (void)c; (void)s; return ERROR; }
FMU_API fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate s) { (void)c; (void)s; return ERROR; }
FMU_API fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *s) { (void)c; (void)s; return ERROR; }
FMU_API fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate s, size_t *n)
{ (void)c; (void)s; (void)n; return ERROR; }
FMU_API fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate s, fmi2Byte b[], size_t n)
{ (void)c; (void)s; (void)b; (void)n; return ERROR; }
FMU_API fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte b[], size_t n, fmi2FMUstate *s)
{ (void)c; (void)b; (void)n; (void)s; return ERROR; }
FMU_API fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference u[], size_t nu,
                                                const fmi2ValueReference k[], size_t nk, const fmi2Real d[],
                                                fmi2Real v[])
{ (void)c; (void)u; (void)nu; (void)k; (void)nk; (void)d; (void)v; return ERROR; }
FMU_API fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference r[], size_t n,
                                               const fmi2Integer o[], const fmi2Real v[])
{ (void)c; (void)r; (void)n; (void)o; (void)v; return ERROR; }
FMU_API fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference r[], size_t n,
                                                const fmi2Integer o[], fmi2Real v[])
{ (void)c; (void)r; (void)n; (void)o; (void)v; return ERROR; }
FMU_API fmi2Status fmi2CancelStep(fmi2Component c) { (void)c; return ERROR; }
FMU_API fmi2Status fmi2GetStatus(fmi2Component c, fmi2StatusKind k, fmi2Status *v)
{ (void)c; (void)k; (void)v; return ERROR; }
FMU_API fmi2Status fmi2GetRealStatus(fmi2Component c, fmi2StatusKind k, fmi2Real *v)
{ (void)c; (void)k; (void)v; return ERROR; }
FMU_API fmi2Status fmi2GetIntegerStatus(fmi2Component c, fmi2StatusKind k, fmi2Integer *v)
{ (void)c; (void)k; (void)v; return ERROR; }
FMU_API fmi2Status fmi2GetBooleanStatus(fmi2Component c, fmi2StatusKind k, fmi2Boolean *v)
{ (void)c; (void)k; (void)v; return ERROR; }
FMU_API fmi2Status fmi2GetStringStatus(fmi2Component c, fmi2StatusKind k, fmi2String *v)
{ (void)c; (void)k; (void)v; return ERROR; }
"""
