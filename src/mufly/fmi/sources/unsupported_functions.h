/* Functions of the standard for what this unit does not have: other types of variables, clocks, events, derivatives, model
   exchange and scheduled execution. The model description says so; a call is an error with a message. */

#define NO_VALUES_1(f, A) \
    FMI3_EXPORT fmi3Status f(fmi3Instance instance, const fmi3ValueReference *references, size_t count, A a) { return count == 0 ? fmi3OK : refuse_call(instance, #f); }
#define NO_VALUES_2(f, A, B) \
    FMI3_EXPORT fmi3Status f(fmi3Instance instance, const fmi3ValueReference *references, size_t count, A a, B b) { return count == 0 ? fmi3OK : refuse_call(instance, #f); }
#define NO_VALUES_3(f, A, B, C) \
    FMI3_EXPORT fmi3Status f(fmi3Instance instance, const fmi3ValueReference *references, size_t count, A a, B b, C c) { return count == 0 ? fmi3OK : refuse_call(instance, #f); }

#define REFUSE_0(f) \
    FMI3_EXPORT fmi3Status f(fmi3Instance instance) { return refuse_call(instance, #f); }
#define REFUSE_1(f, A) \
    FMI3_EXPORT fmi3Status f(fmi3Instance instance, A a) { return refuse_call(instance, #f); }
#define REFUSE_2(f, A, B) \
    FMI3_EXPORT fmi3Status f(fmi3Instance instance, A a, B b) { return refuse_call(instance, #f); }
#define REFUSE_3(f, A, B, C) \
    FMI3_EXPORT fmi3Status f(fmi3Instance instance, A a, B b, C c) { return refuse_call(instance, #f); }
#define REFUSE_4(f, A, B, C, D) \
    FMI3_EXPORT fmi3Status f(fmi3Instance instance, A a, B b, C c, D d) { return refuse_call(instance, #f); }
#define REFUSE_5(f, A, B, C, D, E) \
    FMI3_EXPORT fmi3Status f(fmi3Instance instance, A a, B b, C c, D d, E e) { return refuse_call(instance, #f); }
#define REFUSE_6(f, A, B, C, D, E, F) \
    FMI3_EXPORT fmi3Status f(fmi3Instance instance, A a, B b, C c, D d, E e, F f) { return refuse_call(instance, #f); }
#define REFUSE_8(f, A, B, C, D, E, F, G, H) \
    FMI3_EXPORT fmi3Status f(fmi3Instance instance, A a, B b, C c, D d, E e, F f, G g, H h) { return refuse_call(instance, #f); }

NO_VALUES_2(fmi3GetFloat32, fmi3Float32 *, size_t)
NO_VALUES_2(fmi3GetInt8, fmi3Int8 *, size_t)
NO_VALUES_2(fmi3GetUInt8, fmi3UInt8 *, size_t)
NO_VALUES_2(fmi3GetInt16, fmi3Int16 *, size_t)
NO_VALUES_2(fmi3GetUInt16, fmi3UInt16 *, size_t)
NO_VALUES_2(fmi3GetInt32, fmi3Int32 *, size_t)
NO_VALUES_2(fmi3GetUInt32, fmi3UInt32 *, size_t)
NO_VALUES_2(fmi3GetInt64, fmi3Int64 *, size_t)
NO_VALUES_2(fmi3GetUInt64, fmi3UInt64 *, size_t)
NO_VALUES_2(fmi3GetBoolean, fmi3Boolean *, size_t)
NO_VALUES_2(fmi3GetString, fmi3String *, size_t)
NO_VALUES_3(fmi3GetBinary, size_t *, fmi3Binary *, size_t)
NO_VALUES_1(fmi3GetClock, fmi3Clock *)
NO_VALUES_2(fmi3SetFloat32, const fmi3Float32 *, size_t)
NO_VALUES_2(fmi3SetInt8, const fmi3Int8 *, size_t)
NO_VALUES_2(fmi3SetUInt8, const fmi3UInt8 *, size_t)
NO_VALUES_2(fmi3SetInt16, const fmi3Int16 *, size_t)
NO_VALUES_2(fmi3SetUInt16, const fmi3UInt16 *, size_t)
NO_VALUES_2(fmi3SetInt32, const fmi3Int32 *, size_t)
NO_VALUES_2(fmi3SetUInt32, const fmi3UInt32 *, size_t)
NO_VALUES_2(fmi3SetInt64, const fmi3Int64 *, size_t)
NO_VALUES_2(fmi3SetUInt64, const fmi3UInt64 *, size_t)
NO_VALUES_2(fmi3SetBoolean, const fmi3Boolean *, size_t)
NO_VALUES_2(fmi3SetString, const fmi3String *, size_t)
NO_VALUES_3(fmi3SetBinary, const size_t *, const fmi3Binary *, size_t)
NO_VALUES_1(fmi3SetClock, const fmi3Clock *)

REFUSE_0(fmi3EnterEventMode)
REFUSE_2(fmi3GetNumberOfVariableDependencies, fmi3ValueReference, size_t *)
REFUSE_6(fmi3GetVariableDependencies, fmi3ValueReference, size_t *, fmi3ValueReference *, size_t *, fmi3DependencyKind *, size_t)
REFUSE_8(fmi3GetDirectionalDerivative, const fmi3ValueReference *, size_t, const fmi3ValueReference *, size_t, const fmi3Float64 *, size_t, fmi3Float64 *, size_t)
REFUSE_8(fmi3GetAdjointDerivative, const fmi3ValueReference *, size_t, const fmi3ValueReference *, size_t, const fmi3Float64 *, size_t, fmi3Float64 *, size_t)
REFUSE_0(fmi3EnterConfigurationMode)
REFUSE_0(fmi3ExitConfigurationMode)
REFUSE_4(fmi3GetIntervalDecimal, const fmi3ValueReference *, size_t, fmi3Float64 *, fmi3IntervalQualifier *)
REFUSE_5(fmi3GetIntervalFraction, const fmi3ValueReference *, size_t, fmi3UInt64 *, fmi3UInt64 *, fmi3IntervalQualifier *)
REFUSE_3(fmi3GetShiftDecimal, const fmi3ValueReference *, size_t, fmi3Float64 *)
REFUSE_4(fmi3GetShiftFraction, const fmi3ValueReference *, size_t, fmi3UInt64 *, fmi3UInt64 *)
REFUSE_3(fmi3SetIntervalDecimal, const fmi3ValueReference *, size_t, const fmi3Float64 *)
REFUSE_4(fmi3SetIntervalFraction, const fmi3ValueReference *, size_t, const fmi3UInt64 *, const fmi3UInt64 *)
REFUSE_3(fmi3SetShiftDecimal, const fmi3ValueReference *, size_t, const fmi3Float64 *)
REFUSE_4(fmi3SetShiftFraction, const fmi3ValueReference *, size_t, const fmi3UInt64 *, const fmi3UInt64 *)
REFUSE_0(fmi3EvaluateDiscreteStates)
REFUSE_6(fmi3UpdateDiscreteStates, fmi3Boolean *, fmi3Boolean *, fmi3Boolean *, fmi3Boolean *, fmi3Boolean *, fmi3Float64 *)
REFUSE_0(fmi3EnterContinuousTimeMode)
REFUSE_3(fmi3CompletedIntegratorStep, fmi3Boolean, fmi3Boolean *, fmi3Boolean *)
REFUSE_1(fmi3SetTime, fmi3Float64)
REFUSE_2(fmi3SetContinuousStates, const fmi3Float64 *, size_t)
REFUSE_2(fmi3GetContinuousStateDerivatives, fmi3Float64 *, size_t)
REFUSE_2(fmi3GetEventIndicators, fmi3Float64 *, size_t)
REFUSE_2(fmi3GetContinuousStates, fmi3Float64 *, size_t)
REFUSE_2(fmi3GetNominalsOfContinuousStates, fmi3Float64 *, size_t)
REFUSE_1(fmi3GetNumberOfEventIndicators, size_t *)
REFUSE_1(fmi3GetNumberOfContinuousStates, size_t *)
REFUSE_0(fmi3EnterStepMode)
REFUSE_5(fmi3GetOutputDerivatives, const fmi3ValueReference *, size_t, const fmi3Int32 *, fmi3Float64 *, size_t)
REFUSE_2(fmi3ActivateModelPartition, fmi3ValueReference, fmi3Float64)
