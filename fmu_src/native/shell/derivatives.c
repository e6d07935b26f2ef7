/* Derivatives: of inputs, honoured to first order within the next step; of outputs and directional, not offered. */
#include "instance.h"

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                       const fmi2Integer order[], const fmi2Real value[])
{
    Instance *self = c;
    if (!allowed(self, "fmi2SetRealInputDerivatives", INSTANTIATED | INITIALIZATION | STEP_COMPLETE))
        return fmi2Error;
    if (nvr > 0 && !(vr && order && value)) {
        report(self, fmi2Error, LOG_ERROR,
               "fmi2SetRealInputDerivatives: %lu variables announced, but a list is a null pointer.",
               (unsigned long)nvr);
        return fmi2Error;
    }
    for (size_t i = 0; i < nvr; i++) {
        if (vr[i] >= component.n_inputs || component.variables[vr[i]].type != REAL) { /* inputs come first */
            report(self, fmi2Error, LOG_ERROR,
                   "fmi2SetRealInputDerivatives: the value reference %u is no Real input's.", vr[i]);
            return fmi2Error;
        }
        if (order[i] != 1) {
            report(self, fmi2Error, LOG_ERROR,
                   "fmi2SetRealInputDerivatives: derivative of order %d of %s; only order 1 is supported.", order[i],
                   component.variables[vr[i]].name);
            return fmi2Error;
        }
    }
    for (size_t i = 0; i < nvr; i++) {
        self->du[vr[i]] = value[i];
        self->run.extrapolates = 1;
    }
    return fmi2OK;
}

static fmi2Status not_supported(Instance *self, const char *function, const char *attribute)
{
    if (self)
        report(self, fmi2Error, LOG_ERROR, "%s is not supported: the model description says %s.", function, attribute);
    return fmi2Error;
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
