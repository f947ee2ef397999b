/* The functions of FMI 2.0 for co-simulation (FMI 2.0.4, sections 2.1 and 4.2) around fmu_core.h.
 *
 * An importer that compiles this file may put fmi2Functions.h of the standard in front (-include); its compiler then
 * compares every declaration. Without it the declarations below serve, so that no header has to be shipped. */
#include <stddef.h>

#if !defined(fmi2Functions_h)
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
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum { fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated } fmi2StatusKind;
typedef struct {
    void (*logger)(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                   fmi2String message, ...);
    void *(*allocateMemory)(size_t count, size_t size);
    void (*freeMemory)(void *memory);
    void (*stepFinished)(fmi2ComponentEnvironment environment, fmi2Status status);
    fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;
#endif

/* Sources that are linked, not loaded, get the importer's prefix, as in fmi2Functions.h. */
#if defined(FMI2_OVERRIDE_FUNCTION_PREFIX)
#if defined(FMI2_ACTUAL_FUNCTION_PREFIX)
#define FMU_PREFIX FMI2_ACTUAL_FUNCTION_PREFIX
#endif
#elif defined(FMI2_FUNCTION_PREFIX)
#define FMU_PREFIX FMI2_FUNCTION_PREFIX
#endif
#if !defined(FMU_PREFIX)
#define FMU_PREFIX
#endif
#if defined(_WIN32)
#define FMU_EXPORT __declspec(dllexport)
#else
#define FMU_EXPORT __attribute__((visibility("default")))
#endif
#define FMU_PASTE(prefix, version, name) prefix##version##name
#define FMU_NAME(prefix, name) FMU_PASTE(prefix, fmi2, name)
#define FMI2(name) FMU_NAME(FMU_PREFIX, name)
#define FMI2_STATUS(name) FMU_EXPORT fmi2Status FMI2(name)

#define FMU_NAME_LENGTH 64

typedef fmi2Status fmu_status;
#define FMU_OK fmi2OK
#define FMU_ERROR fmi2Error

typedef struct {
    const fmi2CallbackFunctions *callbacks; /* the importer keeps them until fmi2FreeInstance */
    char name[FMU_NAME_LENGTH];
} fmu_host;

#include "fmu_core.h"

/* Errors are told whether or not debug logging is on: FMI 2 lets the importer switch off debug messages only. */
static void fmu_tell(const fmu_host *host, const char *message)
{
    if ((host->callbacks != NULL) && (host->callbacks->logger != NULL))
        host->callbacks->logger(host->callbacks->componentEnvironment, host->name, fmi2Error, "logStatusError", "%s",
                                message);
}

FMU_EXPORT const char *FMI2(GetTypesPlatform)(void) { return "default"; }
FMU_EXPORT const char *FMI2(GetVersion)(void) { return "2.0"; }

FMU_EXPORT fmi2Component FMI2(Instantiate)(fmi2String name, fmi2Type type, fmi2String token, fmi2String resources,
                                           const fmi2CallbackFunctions *callbacks, fmi2Boolean visible,
                                           fmi2Boolean logging)
{
    fmu_host host;
    (void)resources;
    (void)visible;
    (void)logging;
    memset(&host, 0, sizeof host);
    host.callbacks = callbacks;
    if (name != NULL)
        (void)snprintf(host.name, sizeof host.name, "%s", name);
    if (type != fmi2CoSimulation) {
        fmu_tell(&host, "this FMU is for co-simulation, not for model exchange");
        return NULL;
    }
    return fmu_instantiate(&host, token);
}

FMU_EXPORT void FMI2(FreeInstance)(fmi2Component c) { free(c); }

FMI2_STATUS(SetDebugLogging)(fmi2Component c, fmi2Boolean on, size_t count, const fmi2String categories[])
{
    (void)c; /* there are no debug messages */
    (void)on;
    (void)count;
    (void)categories;
    return fmi2OK;
}

FMI2_STATUS(SetupExperiment)(fmi2Component c, fmi2Boolean with_tolerance, fmi2Real tolerance, fmi2Real start,
                             fmi2Boolean with_end, fmi2Real end)
{
    (void)with_tolerance;
    (void)tolerance;
    (void)with_end;
    (void)end;
    return fmu_set_start(c, start);
}

FMI2_STATUS(EnterInitializationMode)(fmi2Component c) { return fmu_enter_initialization(c); }
FMI2_STATUS(ExitInitializationMode)(fmi2Component c) { return fmu_exit_initialization(c); }
FMI2_STATUS(Terminate)(fmi2Component c) { return fmu_terminate(c); }

FMI2_STATUS(Reset)(fmi2Component c)
{
    fmu_restart(c);
    return fmi2OK;
}

FMI2_STATUS(DoStep)(fmi2Component c, fmi2Real now, fmi2Real step, fmi2Boolean no_rollback)
{
    (void)no_rollback;
    return fmu_step(c, now, step);
}

FMI2_STATUS(GetReal)(fmi2Component c, const fmi2ValueReference references[], size_t count, fmi2Real values[])
{
    return fmu_get_reals(c, references, count, values);
}

FMI2_STATUS(SetReal)(fmi2Component c, const fmi2ValueReference references[], size_t count, const fmi2Real values[])
{
    return fmu_set_reals(c, references, count, values);
}

FMI2_STATUS(GetInteger)(fmi2Component c, const fmi2ValueReference references[], size_t count, fmi2Integer values[])
{
    fmu_status status = FMU_OK;
    for (size_t i = 0; (i < count) && (status == FMU_OK); i++) {
        uint32_t value = 0U;
        status = fmu_get_mark(c, references[i], &value);
        values[i] = (fmi2Integer)value; /* the largest is 511, all flags together */
    }
    return status;
}

#define FMI2_NO_VARIABLES(access, constness, type)                                                                     \
    FMI2_STATUS(access)(fmi2Component c, const fmi2ValueReference references[], size_t count, constness type values[]) \
    {                                                                                                                  \
        (void)references;                                                                                              \
        (void)values;                                                                                                  \
        return fmu_no_variables(c, count);                                                                             \
    }
FMI2_NO_VARIABLES(SetInteger, const, fmi2Integer)
FMI2_NO_VARIABLES(GetBoolean, , fmi2Boolean)
FMI2_NO_VARIABLES(SetBoolean, const, fmi2Boolean)
FMI2_NO_VARIABLES(GetString, , fmi2String)
FMI2_NO_VARIABLES(SetString, const, fmi2String)

FMI2_STATUS(GetFMUstate)(fmi2Component c, fmi2FMUstate *state) { return fmu_save(c, state); }
FMI2_STATUS(SetFMUstate)(fmi2Component c, fmi2FMUstate state) { return fmu_restore(c, state); }

FMI2_STATUS(FreeFMUstate)(fmi2Component c, fmi2FMUstate *state)
{
    (void)c;
    free(*state);
    *state = NULL;
    return fmi2OK;
}

FMI2_STATUS(SerializedFMUstateSize)(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    (void)c;
    (void)state;
    *size = sizeof(fmu_memory);
    return fmi2OK;
}

FMI2_STATUS(SerializeFMUstate)(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    return fmu_serialize(c, state, bytes, size);
}

FMI2_STATUS(DeSerializeFMUstate)(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    return fmu_deserialize(c, bytes, size, state);
}

FMI2_STATUS(GetDirectionalDerivative)(fmi2Component c, const fmi2ValueReference unknowns[], size_t unknown_count,
                                      const fmi2ValueReference knowns[], size_t known_count, const fmi2Real seed[],
                                      fmi2Real sensitivity[])
{
    (void)unknowns;
    (void)unknown_count;
    (void)knowns;
    (void)known_count;
    (void)seed;
    (void)sensitivity;
    return fmu_not_offered(c);
}

#define FMI2_NO_DERIVATIVES(access, constness)                                                \
    FMI2_STATUS(access)(fmi2Component c, const fmi2ValueReference references[], size_t count, \
                        const fmi2Integer orders[], constness fmi2Real values[])              \
    {                                                                                         \
        (void)references;                                                                     \
        (void)count;                                                                          \
        (void)orders;                                                                         \
        (void)values;                                                                         \
        return fmu_not_offered(c);                                                            \
    }
FMI2_NO_DERIVATIVES(SetRealInputDerivatives, const)
FMI2_NO_DERIVATIVES(GetRealOutputDerivatives, )

FMI2_STATUS(CancelStep)(fmi2Component c) { return fmu_not_offered(c); }

/* A step is done when fmi2DoStep returns: nothing is ever pending. */
#define FMI2_NOTHING_PENDING(access, type)                                       \
    FMI2_STATUS(access)(fmi2Component c, const fmi2StatusKind kind, type *value) \
    {                                                                            \
        (void)kind;                                                              \
        (void)value;                                                             \
        return fmu_not_offered(c);                                               \
    }
FMI2_NOTHING_PENDING(GetStatus, fmi2Status)
FMI2_NOTHING_PENDING(GetRealStatus, fmi2Real)
FMI2_NOTHING_PENDING(GetIntegerStatus, fmi2Integer)
FMI2_NOTHING_PENDING(GetBooleanStatus, fmi2Boolean)
FMI2_NOTHING_PENDING(GetStringStatus, fmi2String)
