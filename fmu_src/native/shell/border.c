/* The functions of the standard that compute: each in the component's floating-point environment, whatever the host's
   traps or rounds like, with the host's restored on the way out. Those that set values only compare numbers. */
#include "arithmetic.h"
#include "border.h"

#if defined __clang__
#pragma clang diagnostic ignored "-Wignored-pragmas" /* as in arithmetic.c */
#pragma STDC FENV_ACCESS ON
#endif

#define IN_OWN_ARITHMETIC(call)                                                                                        \
    {                                                                                                                  \
        Arithmetic host;                                                                                               \
        hold_arithmetic(&host);                                                                                        \
        fmi2Status status = call;                                                                                      \
        restore_arithmetic(&host);                                                                                     \
        return status;                                                                                                 \
    }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
                               fmi2Boolean stopTimeDefined, fmi2Real stopTime)
{
    (void)toleranceDefined; /* the component's max_step fixes the accuracy, no error estimate controls a step */
    (void)tolerance;
    IN_OWN_ARITHMETIC(set_up_experiment(c, startTime, stopTimeDefined != fmi2False, stopTime))
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    IN_OWN_ARITHMETIC(exit_initialization_mode(c))
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    IN_OWN_ARITHMETIC(terminate(c))
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    (void)noSetFMUStatePriorToCurrentPoint;
    IN_OWN_ARITHMETIC(do_step(c, currentCommunicationPoint, communicationStepSize))
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[])
{
    const Instance *self = c;
    if (self && !self->stale_start && !self->stale_outputs && self->finite_outputs)
        return get_real(c, vr, nvr, value); /* nothing is computed */
    IN_OWN_ARITHMETIC(get_real(c, vr, nvr, value))
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Integer value[])
{
    IN_OWN_ARITHMETIC(get_integer(c, vr, nvr, value))
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Boolean value[])
{
    IN_OWN_ARITHMETIC(get_boolean(c, vr, nvr, value))
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate)
{
    IN_OWN_ARITHMETIC(set_state(c, FMUstate))
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size,
                                   fmi2FMUstate *FMUstate)
{
    IN_OWN_ARITHMETIC(deserialize_state(c, serializedState, size, FMUstate))
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value)
{
    IN_OWN_ARITHMETIC(get_real_status(c, s, value))
}
