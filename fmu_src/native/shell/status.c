/* What an importer may ask between steps. fmi2DoStep is synchronous: no step is ever pending, so there is none to
   cancel or to report on. */
#include "border.h"

fmi2Status fmi2CancelStep(fmi2Component c)
{
    Instance *self = c;
    if (self)
        report(self, fmi2Error, LOG_ERROR,
               "fmi2CancelStep: no step is in progress, fmi2DoStep never returns fmi2Pending.");
    return fmi2Error;
}

static bool has_place(Instance *self, const char *function, const void *value)
{
    if (!value)
        report(self, fmi2Error, LOG_ERROR, "%s: the place for the value is a null pointer.", function);
    return value != NULL;
}

/* fmi2Discard is the standard's answer where the asked status does not exist. */
static fmi2Status no_such_status(Instance *self, const char *function, fmi2StatusKind kind)
{
    if (!allowed(self, function, STEP_COMPLETE | TERMINATED))
        return fmi2Error;
    report(self, fmi2Discard, LOG_DISCARD, "%s: there is no status of kind %d, fmi2DoStep never returns fmi2Pending.",
           function, (int)kind);
    return fmi2Discard;
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind s, fmi2Status *value)
{
    (void)value;
    return no_such_status(c, "fmi2GetStatus", s);
}

fmi2Status get_real_status(Instance *self, fmi2StatusKind s, fmi2Real *value)
{
    if (s != fmi2LastSuccessfulTime)
        return no_such_status(self, "fmi2GetRealStatus", s);
    if (!allowed(self, "fmi2GetRealStatus", STEP_COMPLETE | TERMINATED) || !has_place(self, "fmi2GetRealStatus", value))
        return fmi2Error;
    *value = clock_time(&self->run.clock);
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind s, fmi2Integer *value)
{
    (void)value;
    return no_such_status(c, "fmi2GetIntegerStatus", s);
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value)
{
    Instance *self = c;
    if (s != fmi2Terminated)
        return no_such_status(self, "fmi2GetBooleanStatus", s);
    if (!allowed(self, "fmi2GetBooleanStatus", STEP_COMPLETE | TERMINATED) ||
        !has_place(self, "fmi2GetBooleanStatus", value))
        return fmi2Error;
    *value = fmi2False; /* the component itself never asks to end a simulation */
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind s, fmi2String *value)
{
    (void)value;
    return no_such_status(c, "fmi2GetStringStatus", s);
}
