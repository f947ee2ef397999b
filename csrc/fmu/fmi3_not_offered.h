/* The functions of FMI 3.0 that modelDescription.xml does not offer: clocks, binary variables, event mode,
 * configuration, dependencies at run time, derivatives, model exchange, scheduled execution. Each returns an error.
 *
 * One macro for each number of arguments: a definition in C99 must name its parameters, and compilers warn about
 * unused names. */
#ifndef FRACLINK_FMI3_NOT_OFFERED_H
#define FRACLINK_FMI3_NOT_OFFERED_H

#define FMI3_REFUSED_0(name) \
    FMI3_STATUS(name)(fmi3Instance me) { return fmu_not_offered(me); }
#define FMI3_REFUSED_1(name, A)             \
    FMI3_STATUS(name)(fmi3Instance me, A a) \
    {                                       \
        (void)a;                            \
        return fmu_not_offered(me);         \
    }
#define FMI3_REFUSED_2(name, A, B)               \
    FMI3_STATUS(name)(fmi3Instance me, A a, B b) \
    {                                            \
        (void)a, (void)b;                        \
        return fmu_not_offered(me);              \
    }
#define FMI3_REFUSED_3(name, A, B, C)                 \
    FMI3_STATUS(name)(fmi3Instance me, A a, B b, C c) \
    {                                                 \
        (void)a, (void)b, (void)c;                    \
        return fmu_not_offered(me);                   \
    }
#define FMI3_REFUSED_4(name, A, B, C, D)                   \
    FMI3_STATUS(name)(fmi3Instance me, A a, B b, C c, D d) \
    {                                                      \
        (void)a, (void)b, (void)c, (void)d;                \
        return fmu_not_offered(me);                        \
    }
#define FMI3_REFUSED_5(name, A, B, C, D, E)                     \
    FMI3_STATUS(name)(fmi3Instance me, A a, B b, C c, D d, E e) \
    {                                                           \
        (void)a, (void)b, (void)c, (void)d, (void)e;            \
        return fmu_not_offered(me);                             \
    }
#define FMI3_REFUSED_6(name, A, B, C, D, E, F)                       \
    FMI3_STATUS(name)(fmi3Instance me, A a, B b, C c, D d, E e, F f) \
    {                                                                \
        (void)a, (void)b, (void)c, (void)d, (void)e, (void)f;        \
        return fmu_not_offered(me);                                  \
    }
#define FMI3_REFUSED_8(name, A, B, C, D, E, F, G, H)                           \
    FMI3_STATUS(name)(fmi3Instance me, A a, B b, C c, D d, E e, F f, G g, H h) \
    {                                                                          \
        (void)a, (void)b, (void)c, (void)d, (void)e, (void)f, (void)g;         \
        (void)h;                                                               \
        return fmu_not_offered(me);                                            \
    }

/* modes that this FMU does not have */
FMI3_REFUSED_0(EnterEventMode)
FMI3_REFUSED_0(EnterStepMode)
FMI3_REFUSED_0(EnterConfigurationMode)
FMI3_REFUSED_0(ExitConfigurationMode)
FMI3_REFUSED_0(EvaluateDiscreteStates)
FMI3_REFUSED_6(UpdateDiscreteStates, fmi3Boolean *, fmi3Boolean *, fmi3Boolean *, fmi3Boolean *, fmi3Boolean *,
               fmi3Float64 *)

/* variables and dependencies */
FMI3_REFUSED_5(GetBinary, const fmi3ValueReference *, size_t, size_t *, fmi3Binary *, size_t)
FMI3_REFUSED_5(SetBinary, const fmi3ValueReference *, size_t, const size_t *, const fmi3Binary *, size_t)
FMI3_REFUSED_2(GetNumberOfVariableDependencies, fmi3ValueReference, size_t *)
FMI3_REFUSED_6(GetVariableDependencies, fmi3ValueReference, size_t *, fmi3ValueReference *, size_t *,
               fmi3DependencyKind *, size_t)

/* derivatives */
FMI3_REFUSED_8(GetDirectionalDerivative, const fmi3ValueReference *, size_t, const fmi3ValueReference *, size_t,
               const fmi3Float64 *, size_t, fmi3Float64 *, size_t)
FMI3_REFUSED_8(GetAdjointDerivative, const fmi3ValueReference *, size_t, const fmi3ValueReference *, size_t,
               const fmi3Float64 *, size_t, fmi3Float64 *, size_t)
FMI3_REFUSED_5(GetOutputDerivatives, const fmi3ValueReference *, size_t, const fmi3Int32 *, fmi3Float64 *, size_t)

/* clocks */
FMI3_REFUSED_3(GetClock, const fmi3ValueReference *, size_t, fmi3Clock *)
FMI3_REFUSED_3(SetClock, const fmi3ValueReference *, size_t, const fmi3Clock *)
FMI3_REFUSED_4(GetIntervalDecimal, const fmi3ValueReference *, size_t, fmi3Float64 *, fmi3IntervalQualifier *)
FMI3_REFUSED_5(GetIntervalFraction, const fmi3ValueReference *, size_t, fmi3UInt64 *, fmi3UInt64 *,
               fmi3IntervalQualifier *)
FMI3_REFUSED_3(GetShiftDecimal, const fmi3ValueReference *, size_t, fmi3Float64 *)
FMI3_REFUSED_4(GetShiftFraction, const fmi3ValueReference *, size_t, fmi3UInt64 *, fmi3UInt64 *)
FMI3_REFUSED_3(SetIntervalDecimal, const fmi3ValueReference *, size_t, const fmi3Float64 *)
FMI3_REFUSED_4(SetIntervalFraction, const fmi3ValueReference *, size_t, const fmi3UInt64 *, const fmi3UInt64 *)
FMI3_REFUSED_3(SetShiftDecimal, const fmi3ValueReference *, size_t, const fmi3Float64 *)
FMI3_REFUSED_4(SetShiftFraction, const fmi3ValueReference *, size_t, const fmi3UInt64 *, const fmi3UInt64 *)

/* model exchange and scheduled execution */
FMI3_REFUSED_0(EnterContinuousTimeMode)
FMI3_REFUSED_3(CompletedIntegratorStep, fmi3Boolean, fmi3Boolean *, fmi3Boolean *)
FMI3_REFUSED_1(SetTime, fmi3Float64)
FMI3_REFUSED_2(SetContinuousStates, const fmi3Float64 *, size_t)
FMI3_REFUSED_2(GetContinuousStateDerivatives, fmi3Float64 *, size_t)
FMI3_REFUSED_2(GetEventIndicators, fmi3Float64 *, size_t)
FMI3_REFUSED_2(GetContinuousStates, fmi3Float64 *, size_t)
FMI3_REFUSED_2(GetNominalsOfContinuousStates, fmi3Float64 *, size_t)
FMI3_REFUSED_1(GetNumberOfEventIndicators, size_t *)
FMI3_REFUSED_1(GetNumberOfContinuousStates, size_t *)
FMI3_REFUSED_2(ActivateModelPartition, fmi3ValueReference, fmi3Float64)

#endif
