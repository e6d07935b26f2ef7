/* What every library must have and no test calls. */
#define ABSENT(name, ...)                                                                                                      \
    fmi2Status name(__VA_ARGS__) { return fmi2Error; }
#pragma clang diagnostic ignored "-Wunused-parameter"
ABSENT(fmi2CancelStep, fmi2Component c)
ABSENT(fmi2SetRealInputDerivatives, fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[],
       const fmi2Real value[])
ABSENT(fmi2GetRealOutputDerivatives, fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[],
       fmi2Real value[])
ABSENT(fmi2GetFMUstate, fmi2Component c, fmi2FMUstate *state)
ABSENT(fmi2SetFMUstate, fmi2Component c, fmi2FMUstate state)
ABSENT(fmi2FreeFMUstate, fmi2Component c, fmi2FMUstate *state)
ABSENT(fmi2SerializedFMUstateSize, fmi2Component c, fmi2FMUstate state, size_t *size)
ABSENT(fmi2SerializeFMUstate, fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
ABSENT(fmi2DeSerializeFMUstate, fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
ABSENT(fmi2GetDirectionalDerivative, fmi2Component c, const fmi2ValueReference unknown[], size_t n,
       const fmi2ValueReference known[], size_t m, const fmi2Real known_change[], fmi2Real unknown_change[])
ABSENT(fmi2GetRealStatus, fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
ABSENT(fmi2GetIntegerStatus, fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value)
ABSENT(fmi2GetBooleanStatus, fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
ABSENT(fmi2GetStringStatus, fmi2Component c, const fmi2StatusKind kind, fmi2String *value)
