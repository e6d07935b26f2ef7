/* What is not offered. fmi2DoStep is synchronous: no step is ever pending. */
#include <stdio.h>

#include "relay.h"

static fmi2Status not_supported(Instance *self, const char *function, const char *attribute)
{
    if (!self)
        return fmi2Error;
    char why[128];
    snprintf(why, sizeof why, "is not supported: the model description says %s", attribute);
    return refuse(self, function, why);
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                        const fmi2Integer order[], fmi2Real value[])
{
    (void)vr, (void)nvr, (void)order, (void)value;
    return not_supported(c, "fmi2GetRealOutputDerivatives", "maxOutputDerivativeOrder=0");
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[], size_t nUnknown,
                                        const fmi2ValueReference vKnown_ref[], size_t nKnown, const fmi2Real dvKnown[],
                                        fmi2Real dvUnknown[])
{
    (void)vUnknown_ref, (void)nUnknown, (void)vKnown_ref, (void)nKnown, (void)dvKnown, (void)dvUnknown;
    return not_supported(c, "fmi2GetDirectionalDerivative", "providesDirectionalDerivative=false");
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    return c ? refuse(c, "fmi2CancelStep", "no step is in progress, fmi2DoStep never returns fmi2Pending") : fmi2Error;
}

static fmi2Status no_such_status(Instance *self, const char *function)
{
    if (!self)
        return fmi2Error;
    char text[128];
    snprintf(text, sizeof text, "%s: there is no such status, fmi2DoStep never returns fmi2Pending.", function);
    report(self, fmi2Discard, LOG_DISCARD, text);
    return fmi2Discard;
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind s, fmi2Status *value)
{
    (void)s, (void)value;
    return no_such_status(c, "fmi2GetStatus");
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value)
{
    Instance *self = c;
    if (!self || s != fmi2LastSuccessfulTime)
        return no_such_status(self, "fmi2GetRealStatus");
    if (!value)
        return refuse(self, "fmi2GetRealStatus", "the place for the value is a null pointer");
    fmi2ValueReference reference = TIME;
    self->refused = false;
    return answer(self, self->pythonfmu.fmi2GetReal(self->slave, &reference, 1, value));
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind s, fmi2Integer *value)
{
    (void)s, (void)value;
    return no_such_status(c, "fmi2GetIntegerStatus");
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value)
{
    Instance *self = c;
    if (!self || s != fmi2Terminated)
        return no_such_status(self, "fmi2GetBooleanStatus");
    if (!value)
        return refuse(self, "fmi2GetBooleanStatus", "the place for the value is a null pointer");
    *value = fmi2False; /* the component itself never asks to end a simulation */
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind s, fmi2String *value)
{
    (void)s, (void)value;
    return no_such_status(c, "fmi2GetStringStatus");
}
