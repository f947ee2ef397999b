/* The functions of FMI 3.0 that modelDescription.xml does not offer: clocks, binary variables, event mode,
 * configuration, dependencies at run time, derivatives, model exchange, scheduled execution. Each returns an error. */
#ifndef FRACLINK_FMI3_NOT_OFFERED_H
#define FRACLINK_FMI3_NOT_OFFERED_H

#define FMI3_REFUSED(name, parameters) \
    FMI3_STATUS(name) parameters { return fmu_not_offered(me); }

/* modes that this FMU does not have */
FMI3_REFUSED(EnterEventMode, (fmi3Instance me))
FMI3_REFUSED(EnterStepMode, (fmi3Instance me))
FMI3_REFUSED(EnterConfigurationMode, (fmi3Instance me))
FMI3_REFUSED(ExitConfigurationMode, (fmi3Instance me))
FMI3_REFUSED(EvaluateDiscreteStates, (fmi3Instance me))
FMI3_REFUSED(UpdateDiscreteStates, (fmi3Instance me, fmi3Boolean *again, fmi3Boolean *terminate,
                                    fmi3Boolean *nominals_changed, fmi3Boolean *values_changed,
                                    fmi3Boolean *event_time_defined, fmi3Float64 *event_time))

/* variables and dependencies */
FMI3_REFUSED(GetBinary, (fmi3Instance me, const fmi3ValueReference references[], size_t count, size_t sizes[],
                         fmi3Binary values[], size_t value_count))
FMI3_REFUSED(SetBinary, (fmi3Instance me, const fmi3ValueReference references[], size_t count, const size_t sizes[],
                         const fmi3Binary values[], size_t value_count))
FMI3_REFUSED(GetNumberOfVariableDependencies, (fmi3Instance me, fmi3ValueReference reference, size_t *count))
FMI3_REFUSED(GetVariableDependencies, (fmi3Instance me, fmi3ValueReference dependent, size_t elements[],
                                       fmi3ValueReference independents[], size_t independent_elements[],
                                       fmi3DependencyKind kinds[], size_t count))

/* derivatives */
FMI3_REFUSED(GetDirectionalDerivative, (fmi3Instance me, const fmi3ValueReference unknowns[], size_t unknown_count,
                                        const fmi3ValueReference knowns[], size_t known_count,
                                        const fmi3Float64 seed[], size_t seed_count, fmi3Float64 sensitivity[],
                                        size_t sensitivity_count))
FMI3_REFUSED(GetAdjointDerivative, (fmi3Instance me, const fmi3ValueReference unknowns[], size_t unknown_count,
                                    const fmi3ValueReference knowns[], size_t known_count, const fmi3Float64 seed[],
                                    size_t seed_count, fmi3Float64 sensitivity[], size_t sensitivity_count))
FMI3_REFUSED(GetOutputDerivatives, (fmi3Instance me, const fmi3ValueReference references[], size_t count,
                                    const fmi3Int32 orders[], fmi3Float64 values[], size_t value_count))

/* clocks */
FMI3_REFUSED(GetClock, (fmi3Instance me, const fmi3ValueReference references[], size_t count, fmi3Clock values[]))
FMI3_REFUSED(SetClock, (fmi3Instance me, const fmi3ValueReference references[], size_t count,
                        const fmi3Clock values[]))
FMI3_REFUSED(GetIntervalDecimal, (fmi3Instance me, const fmi3ValueReference references[], size_t count,
                                  fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[]))
FMI3_REFUSED(GetIntervalFraction, (fmi3Instance me, const fmi3ValueReference references[], size_t count,
                                   fmi3UInt64 counters[], fmi3UInt64 resolutions[],
                                   fmi3IntervalQualifier qualifiers[]))
FMI3_REFUSED(GetShiftDecimal, (fmi3Instance me, const fmi3ValueReference references[], size_t count,
                               fmi3Float64 shifts[]))
FMI3_REFUSED(GetShiftFraction, (fmi3Instance me, const fmi3ValueReference references[], size_t count,
                                fmi3UInt64 counters[], fmi3UInt64 resolutions[]))
FMI3_REFUSED(SetIntervalDecimal, (fmi3Instance me, const fmi3ValueReference references[], size_t count,
                                  const fmi3Float64 intervals[]))
FMI3_REFUSED(SetIntervalFraction, (fmi3Instance me, const fmi3ValueReference references[], size_t count,
                                   const fmi3UInt64 counters[], const fmi3UInt64 resolutions[]))
FMI3_REFUSED(SetShiftDecimal, (fmi3Instance me, const fmi3ValueReference references[], size_t count,
                               const fmi3Float64 shifts[]))
FMI3_REFUSED(SetShiftFraction, (fmi3Instance me, const fmi3ValueReference references[], size_t count,
                                const fmi3UInt64 counters[], const fmi3UInt64 resolutions[]))

/* model exchange and scheduled execution */
FMI3_REFUSED(EnterContinuousTimeMode, (fmi3Instance me))
FMI3_REFUSED(CompletedIntegratorStep, (fmi3Instance me, fmi3Boolean no_rollback, fmi3Boolean *enter_events,
                                       fmi3Boolean *terminate))
FMI3_REFUSED(SetTime, (fmi3Instance me, fmi3Float64 time))
FMI3_REFUSED(SetContinuousStates, (fmi3Instance me, const fmi3Float64 states[], size_t count))
FMI3_REFUSED(GetContinuousStateDerivatives, (fmi3Instance me, fmi3Float64 derivatives[], size_t count))
FMI3_REFUSED(GetEventIndicators, (fmi3Instance me, fmi3Float64 indicators[], size_t count))
FMI3_REFUSED(GetContinuousStates, (fmi3Instance me, fmi3Float64 states[], size_t count))
FMI3_REFUSED(GetNominalsOfContinuousStates, (fmi3Instance me, fmi3Float64 nominals[], size_t count))
FMI3_REFUSED(GetNumberOfEventIndicators, (fmi3Instance me, size_t *count))
FMI3_REFUSED(GetNumberOfContinuousStates, (fmi3Instance me, size_t *count))
FMI3_REFUSED(ActivateModelPartition, (fmi3Instance me, fmi3ValueReference clock, fmi3Float64 time))

#endif
