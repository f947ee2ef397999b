/* The functions of FMI 3.0 for co-simulation (FMI 3.0, sections 2.2 and 4.2) around fmu_core.h.
 *
 * The standard requires every function to exist, including those of capabilities that modelDescription.xml does not
 * offer. An importer that compiles this file may include fmi3Functions.h of the standard first (-include); its
 * compiler then checks every declaration. Otherwise the declarations below apply, so that no header has to be
 * shipped. */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#if !defined(fmi3Functions_h)
typedef void *fmi3Instance;
typedef void *fmi3InstanceEnvironment;
typedef void *fmi3FMUState;
typedef uint32_t fmi3ValueReference;
typedef float fmi3Float32;
typedef double fmi3Float64;
typedef int8_t fmi3Int8;
typedef uint8_t fmi3UInt8;
typedef int16_t fmi3Int16;
typedef uint16_t fmi3UInt16;
typedef int32_t fmi3Int32;
typedef uint32_t fmi3UInt32;
typedef int64_t fmi3Int64;
typedef uint64_t fmi3UInt64;
typedef bool fmi3Boolean;
typedef char fmi3Char;
typedef const fmi3Char *fmi3String;
typedef uint8_t fmi3Byte;
typedef const fmi3Byte *fmi3Binary;
typedef bool fmi3Clock;
typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef enum {
    fmi3Independent,
    fmi3Constant,
    fmi3Fixed,
    fmi3Tunable,
    fmi3Discrete,
    fmi3Dependent
} fmi3DependencyKind;
typedef enum { fmi3IntervalNotYetKnown, fmi3IntervalUnchanged, fmi3IntervalChanged } fmi3IntervalQualifier;
typedef void (*fmi3LogMessageCallback)(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category,
                                       fmi3String message);
typedef void (*fmi3ClockUpdateCallback)(fmi3InstanceEnvironment environment);
typedef void (*fmi3IntermediateUpdateCallback)(fmi3InstanceEnvironment environment, fmi3Float64 time,
                                               fmi3Boolean set_requested, fmi3Boolean get_allowed,
                                               fmi3Boolean step_finished, fmi3Boolean can_return_early,
                                               fmi3Boolean *return_requested, fmi3Float64 *return_time);
typedef void (*fmi3LockPreemptionCallback)(void);
typedef void (*fmi3UnlockPreemptionCallback)(void);
#endif

/* Sources that are linked instead of loaded get the importer's prefix, as in fmi3Functions.h. */
#if defined(FMI3_OVERRIDE_FUNCTION_PREFIX)
#if defined(FMI3_ACTUAL_FUNCTION_PREFIX)
#define FMU_PREFIX FMI3_ACTUAL_FUNCTION_PREFIX
#endif
#elif defined(FMI3_FUNCTION_PREFIX)
#define FMU_PREFIX FMI3_FUNCTION_PREFIX
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
#define FMU_NAME(prefix, name) FMU_PASTE(prefix, fmi3, name)
#define FMI3(name) FMU_NAME(FMU_PREFIX, name)
#define FMI3_STATUS(name) FMU_EXPORT fmi3Status FMI3(name)

/* The standard fixes the parameters, also those that this FMU has no use for. */
#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif

#include "fmu_core.h"

FMU_EXPORT const char *FMI3(GetVersion)(void) { return "3.0"; }

FMI3_STATUS(SetDebugLogging)(fmi3Instance me, fmi3Boolean on, size_t count, const fmi3String categories[])
{
    fmu_instance *const instance = me;
    bool chosen = count == 0U;
    for (size_t i = 0; i < count; i++)
        chosen = chosen || (strcmp(categories[i], "logStatusError") == 0);
    instance->host.logging = on && chosen;
    return fmi3OK;
}

FMU_EXPORT fmi3Instance FMI3(InstantiateCoSimulation)(fmi3String name, fmi3String token, fmi3String resources,
                                                      fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean events,
                                                      fmi3Boolean early_return,
                                                      const fmi3ValueReference intermediate[],
                                                      size_t intermediate_count, fmi3InstanceEnvironment environment,
                                                      fmi3LogMessageCallback log,
                                                      fmi3IntermediateUpdateCallback update)
{
    /* the reason why there is no instance is always reported, since there was no way yet to switch its logging off */
    fmu_host host = {log, environment, true};
    fmu_instance *me = NULL;
    if (events || (intermediate_count > 0U)) {
        fmu_tell(&host, "this FMU has neither event mode nor intermediate updates");
        return NULL;
    }
    me = fmu_instantiate(&host, token);
    if (me != NULL)
        me->host.logging = logging;
    return me;
}

FMU_EXPORT fmi3Instance FMI3(InstantiateModelExchange)(fmi3String name, fmi3String token, fmi3String resources,
                                                       fmi3Boolean visible, fmi3Boolean logging,
                                                       fmi3InstanceEnvironment environment,
                                                       fmi3LogMessageCallback log)
{
    const fmu_host host = {log, environment, true};
    fmu_tell(&host, "this FMU is for co-simulation, not for model exchange");
    return NULL;
}

FMU_EXPORT fmi3Instance FMI3(InstantiateScheduledExecution)(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3ClockUpdateCallback update,
    fmi3LockPreemptionCallback lock, fmi3UnlockPreemptionCallback unlock)
{
    const fmu_host host = {log, environment, true};
    fmu_tell(&host, "this FMU is for co-simulation, not for scheduled execution");
    return NULL;
}

FMU_EXPORT void FMI3(FreeInstance)(fmi3Instance me) { free(me); }

FMI3_STATUS(EnterInitializationMode)(fmi3Instance me, fmi3Boolean with_tolerance, fmi3Float64 tolerance,
                                     fmi3Float64 start, fmi3Boolean with_end, fmi3Float64 end)
{
    fmu_memory *const m = &((fmu_instance *)me)->memory;
    if (m->phase != FMU_INSTANTIATED)
        return fmu_refuse(me, "initialization is entered once, right after instantiation or a reset");
    m->time = start;
    m->phase = FMU_INITIALIZING;
    return fmi3OK;
}

FMI3_STATUS(ExitInitializationMode)(fmi3Instance me)
{
    fmu_memory *const m = &((fmu_instance *)me)->memory;
    if (m->phase != FMU_INITIALIZING)
        return fmu_refuse(me, "initialization is left without having been entered");
    m->phase = FMU_STEPPING;
    return fmi3OK;
}

FMI3_STATUS(Terminate)(fmi3Instance me)
{
    fmu_memory *const m = &((fmu_instance *)me)->memory;
    if (m->phase != FMU_STEPPING)
        return fmu_refuse(me, "only a simulation that runs can be terminated");
    m->phase = FMU_TERMINATED;
    return fmi3OK;
}

FMI3_STATUS(Reset)(fmi3Instance me)
{
    fmu_restart(me);
    return fmi3OK;
}

FMI3_STATUS(DoStep)(fmi3Instance me, fmi3Float64 now, fmi3Float64 step, fmi3Boolean no_rollback, fmi3Boolean *events,
                    fmi3Boolean *terminate, fmi3Boolean *early_return, fmi3Float64 *reached)
{
    const fmi3Status status = fmu_step(me, now, step);
    *events = false;
    *terminate = false;
    *early_return = false;
    *reached = ((const fmu_instance *)me)->memory.time;
    return status;
}

static fmi3Status not_scalar(fmu_instance *me)
{
    return fmu_refuse(me, "every variable is a scalar: one value for each reference");
}

FMI3_STATUS(GetFloat64)(fmi3Instance me, const fmi3ValueReference references[], size_t count, fmi3Float64 values[],
                        size_t value_count)
{
    const fmu_memory *const m = &((const fmu_instance *)me)->memory;
    if (value_count != count)
        return not_scalar(me);
    for (size_t i = 0; i < count; i++) {
        if (references[i] < FMU_REALS) {
            values[i] = m->reals[references[i]];
        } else if (references[i] == FMU_TIME) {
            values[i] = m->time;
        } else if (references[i] == FMU_PAYLOAD) {
            values[i] = m->payload;
        } else {
            return fmu_refuse(me, "a value reference is read that is no real number; see modelDescription.xml");
        }
    }
    return fmi3OK;
}

FMI3_STATUS(SetFloat64)(fmi3Instance me, const fmi3ValueReference references[], size_t count,
                        const fmi3Float64 values[], size_t value_count)
{
    fmu_memory *const m = &((fmu_instance *)me)->memory;
    if (value_count != count)
        return not_scalar(me);
    if (m->phase == FMU_TERMINATED)
        return fmu_refuse(me, "an input is set after the end; reset the FMU first");
    for (size_t i = 0; i < count; i++) {
        if (references[i] < FMU_INPUTS) {
            m->reals[references[i]] = values[i];
        } else if (references[i] == FMU_PAYLOAD) {
            m->payload = values[i];
        } else {
            return fmu_refuse(me, "a value reference is set that is no input; see modelDescription.xml");
        }
    }
    if (m->phase != FMU_STEPPING)
        fmu_rest(m);
    return fmi3OK;
}

/* mode, reason or flags */
FMI3_STATUS(GetUInt32)(fmi3Instance me, const fmi3ValueReference references[], size_t count, fmi3UInt32 values[],
                       size_t value_count)
{
    const fmu_memory *const m = &((const fmu_instance *)me)->memory;
    if (value_count != count)
        return not_scalar(me);
    for (size_t i = 0; i < count; i++) {
        if ((references[i] < FMU_REALS) || (references[i] >= FMU_VALUES))
            return fmu_refuse(me, "a value reference is read that is no whole number; see modelDescription.xml");
        values[i] = m->marks[references[i] - FMU_REALS];
    }
    return fmi3OK;
}

#define FMI3_NO_VARIABLES(access, constness, type)                                                                     \
    FMI3_STATUS(access)(fmi3Instance me, const fmi3ValueReference references[], size_t count, constness type values[], \
                        size_t value_count)                                                                            \
    {                                                                                                                  \
        return fmu_no_variables(me, count);                                                                            \
    }
#define FMI3_NO_ACCESS(name, type)       \
    FMI3_NO_VARIABLES(Get##name, , type) \
    FMI3_NO_VARIABLES(Set##name, const, type)
FMI3_NO_ACCESS(Float32, fmi3Float32)
FMI3_NO_ACCESS(Int8, fmi3Int8)
FMI3_NO_ACCESS(UInt8, fmi3UInt8)
FMI3_NO_ACCESS(Int16, fmi3Int16)
FMI3_NO_ACCESS(UInt16, fmi3UInt16)
FMI3_NO_ACCESS(Int32, fmi3Int32)
FMI3_NO_ACCESS(Int64, fmi3Int64)
FMI3_NO_ACCESS(UInt64, fmi3UInt64)
FMI3_NO_ACCESS(Boolean, fmi3Boolean)
FMI3_NO_ACCESS(String, fmi3String)
FMI3_NO_VARIABLES(SetUInt32, const, fmi3UInt32)

/* Room for a snapshot, where `state` is not an earlier one to overwrite. */
static bool fmu_room(fmi3FMUState *state)
{
    if (*state == NULL)
        *state = malloc(sizeof(fmu_memory));
    return *state != NULL;
}

FMI3_STATUS(GetFMUState)(fmi3Instance me, fmi3FMUState *state)
{
    if (!fmu_room(state))
        return fmu_refuse(me, "out of memory");
    memcpy(*state, &((const fmu_instance *)me)->memory, sizeof(fmu_memory));
    return fmi3OK;
}

FMI3_STATUS(SetFMUState)(fmi3Instance me, fmi3FMUState state)
{
    if (state == NULL)
        return fmu_refuse(me, "there is no state to restore");
    memcpy(&((fmu_instance *)me)->memory, state, sizeof(fmu_memory));
    return fmi3OK;
}

FMI3_STATUS(FreeFMUState)(fmi3Instance me, fmi3FMUState *state)
{
    if (state != NULL) {
        free(*state);
        *state = NULL;
    }
    return fmi3OK;
}

FMI3_STATUS(SerializedFMUStateSize)(fmi3Instance me, fmi3FMUState state, size_t *size)
{
    *size = sizeof(fmu_memory);
    return fmi3OK;
}

FMI3_STATUS(SerializeFMUState)(fmi3Instance me, fmi3FMUState state, fmi3Byte bytes[], size_t size)
{
    if ((state == NULL) || (size < sizeof(fmu_memory)))
        return fmu_refuse(me, "the room for a state is too small, or there is no state");
    memcpy(bytes, state, sizeof(fmu_memory));
    return fmi3OK;
}

FMI3_STATUS(DeserializeFMUState)(fmi3Instance me, const fmi3Byte bytes[], size_t size, fmi3FMUState *state)
{
    fmu_memory memory;
    if (size != sizeof memory)
        return fmu_refuse(me, "a serialized state has another size: it is not of this FMU");
    memcpy(&memory, bytes, sizeof memory);
    if ((memory.owner != law_data.crc) || (memory.phase > FMU_TERMINATED))
        return fmu_refuse(me, "a serialized state is of another law, or damaged");
    if (!fmu_room(state))
        return fmu_refuse(me, "out of memory");
    memcpy(*state, &memory, sizeof memory);
    return fmi3OK;
}

#include "fmi3_not_offered.h"
