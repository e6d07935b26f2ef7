/* Getting and setting variables. Every entry of a call is checked before the first is read or written: a refused call
   changes nothing. */
#include <limits.h>
#include <math.h>

#include "border.h"

#define N_VARIABLES (component.n_inputs + component.n_parameters + component.n_outputs + component.n_constants)
#define SETTABLE (INSTANTIATED | INITIALIZATION | STEP_COMPLETE)

static const char *const TYPE_NAMES[] = {"Real", "Integer", "Boolean"};

/* The variable of this value reference and type, or NULL after a message. Enumerations count as Integer, as in the
   standard. */
static const Variable *find(Instance *self, const char *function, fmi2ValueReference reference, Type type)
{
    if (reference >= N_VARIABLES) {
        report(self, fmi2Error, LOG_ERROR, "%s: no variable has the value reference %u, the largest is %lu.", function,
               reference, (unsigned long)N_VARIABLES - 1);
        return NULL;
    }
    const Variable *variable = &component.variables[reference];
    if (variable->type != type) {
        report(self, fmi2Error, LOG_ERROR, "%s: %s (value reference %u) is not of type %s but %s.", function,
               variable->name, reference, TYPE_NAMES[type], TYPE_NAMES[variable->type]);
        return NULL;
    }
    return variable;
}

static bool has_pointers(Instance *self, const char *function, size_t n, const void *references, const void *values)
{
    if (n == 0 || (references && values))
        return true;
    report(self, fmi2Error, LOG_ERROR, "%s: %lu variables announced, but a list is a null pointer.", function,
           (unsigned long)n);
    return false;
}

/* Before initialization mode only what has a start value is known; after fmi2Terminate the last values remain. */
static bool can_get(Instance *self, const char *function, const fmi2ValueReference references[], size_t n,
                    const void *values, Type type)
{
    if (!allowed(self, function, ANY_STATE) || !has_pointers(self, function, n, references, values))
        return false;
    bool outputs = false;
    for (size_t i = 0; i < n; i++) {
        const Variable *variable = find(self, function, references[i], type);
        if (!variable)
            return false;
        if (variable->role != OUTPUT)
            continue;
        outputs = true;
        if (self->run.lifecycle == INSTANTIATED) {
            report(self, fmi2Error, LOG_ERROR, "%s: %s is not known before initialization mode.", function,
                   variable->name);
            return false;
        }
    }
    return !outputs || refresh_outputs(self);
}

/* An output that is not finite because an input that feeds it is not: the importer gets it, but not silently. */
static fmi2Status warn_of_value(Instance *self, fmi2ValueReference reference)
{
    double value = 0;
    const char *input = bad_input(self, &value);
    report(self, fmi2Warning, LOG_WARNING, "%s: the output %s is %g at t = %.15g, where the input %s is %g.",
           component.name, component.variables[reference].name, shown(self->values[reference]),
           clock_time(&self->run.clock), input ? input : "(none)", value);
    return fmi2Warning;
}

fmi2Status get_real(Instance *self, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[])
{
    if (!can_get(self, "fmi2GetReal", vr, nvr, value, REAL))
        return fmi2Error;
    for (size_t i = 0; i < nvr; i++)
        value[i] = self->values[vr[i]];
    for (size_t i = 0; i < nvr && !self->finite_outputs; i++)
        if (component.variables[vr[i]].role == OUTPUT && !isfinite(value[i]))
            return warn_of_value(self, vr[i]);
    return fmi2OK;
}

fmi2Status get_integer(Instance *self, const fmi2ValueReference vr[], size_t nvr, fmi2Integer value[])
{
    if (!can_get(self, "fmi2GetInteger", vr, nvr, value, INTEGER))
        return fmi2Error;
    for (size_t i = 0; i < nvr; i++) {
        double exact = self->values[vr[i]];
        if (!(exact >= INT_MIN && exact <= INT_MAX)) {
            report(self, fmi2Error, LOG_ERROR, "fmi2GetInteger: %s = %.10g lies outside [%d, %d].",
                   component.variables[vr[i]].name, exact, INT_MIN, INT_MAX);
            return fmi2Error;
        }
    }
    for (size_t i = 0; i < nvr; i++)
        value[i] = (fmi2Integer)rint(self->values[vr[i]]);
    return fmi2OK;
}

static bool can_set(Instance *self, const char *function, fmi2ValueReference reference, Type type, double value)
{
    const Variable *variable = find(self, function, reference, type);
    if (!variable)
        return false;
    switch (variable->role) {
    case INPUT: /* anything may come out of a sensor, NaN included: what it means is the component's decision */
        return true;
    case FIXED_PARAMETER:
        if (self->run.lifecycle == STEP_COMPLETE) {
            report(self, fmi2Error, LOG_ERROR, "%s: %s is a fixed parameter, %.10g cannot be set after initialization.",
                   function, variable->name, value);
            return false;
        }
        break;
    case TUNABLE_PARAMETER:
        break;
    case OUTPUT:
    case CONSTANT:
        report(self, fmi2Error, LOG_ERROR, "%s: %s is %s, it cannot be set (to %.10g).", function, variable->name,
               variable->role == OUTPUT ? "an output" : "a constant", value);
        return false;
    }
    if (isinf(value)) {
        report(self, fmi2Error, LOG_ERROR, "%s: %s = %g must be finite.", function, variable->name, value);
        return false;
    }
    /* what is no number is found without an arithmetic comparison, which would trap in a host that traps */
    if (all_finite(&value, 1) && variable->min <= value && value <= variable->max)
        return true;
    report(self, fmi2Error, LOG_ERROR, "%s: %s = %.10g lies outside [%.10g, %.10g].", function, variable->name, value,
           variable->min, variable->max);
    return false;
}

static void was_set(Instance *self)
{
    if (self->run.lifecycle == STEP_COMPLETE)
        self->stale_outputs = true;
    else
        self->stale_start = true;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Real value[])
{
    Instance *self = c;
    if (!allowed(self, "fmi2SetReal", SETTABLE) || !has_pointers(self, "fmi2SetReal", nvr, vr, value))
        return fmi2Error;
    for (size_t i = 0; i < nvr; i++)
        if (!can_set(self, "fmi2SetReal", vr[i], REAL, value[i]))
            return fmi2Error;
    for (size_t i = 0; i < nvr; i++)
        self->values[vr[i]] = value[i];
    was_set(self);
    return fmi2OK;
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer value[])
{
    Instance *self = c;
    if (!allowed(self, "fmi2SetInteger", SETTABLE) || !has_pointers(self, "fmi2SetInteger", nvr, vr, value))
        return fmi2Error;
    for (size_t i = 0; i < nvr; i++)
        if (!can_set(self, "fmi2SetInteger", vr[i], INTEGER, value[i]))
            return fmi2Error;
    for (size_t i = 0; i < nvr; i++)
        self->values[vr[i]] = value[i];
    was_set(self);
    return fmi2OK;
}

fmi2Status get_boolean(Instance *self, const fmi2ValueReference vr[], size_t nvr, fmi2Boolean value[])
{
    if (!can_get(self, "fmi2GetBoolean", vr, nvr, value, BOOLEAN))
        return fmi2Error;
    for (size_t i = 0; i < nvr; i++)
        value[i] = self->values[vr[i]] != 0 ? fmi2True : fmi2False;
    return fmi2OK;
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Boolean value[])
{
    Instance *self = c;
    if (!allowed(self, "fmi2SetBoolean", SETTABLE) || !has_pointers(self, "fmi2SetBoolean", nvr, vr, value))
        return fmi2Error;
    for (size_t i = 0; i < nvr; i++)
        if (!can_set(self, "fmi2SetBoolean", vr[i], BOOLEAN, value[i]))
            return fmi2Error;
    for (size_t i = 0; i < nvr; i++)
        self->values[vr[i]] = value[i] != fmi2False;
    was_set(self);
    return fmi2OK;
}

/* No component has String variables: an empty call is fine, any value reference is of the wrong type. */
static fmi2Status no_such_type(Instance *self, const char *function, unsigned lifecycles, const fmi2ValueReference vr[],
                               size_t nvr, const void *value)
{
    if (!allowed(self, function, lifecycles) || !has_pointers(self, function, nvr, vr, value))
        return fmi2Error;
    if (nvr == 0)
        return fmi2OK;
    if (vr[0] < N_VARIABLES)
        report(self, fmi2Error, LOG_ERROR, "%s: %s (value reference %u) is of type %s.", function,
               component.variables[vr[0]].name, vr[0], TYPE_NAMES[component.variables[vr[0]].type]);
    else
        report(self, fmi2Error, LOG_ERROR, "%s: no variable has the value reference %u, the largest is %lu.", function,
               vr[0], (unsigned long)N_VARIABLES - 1);
    return fmi2Error;
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2String value[])
{
    return no_such_type(c, "fmi2GetString", ANY_STATE, vr, nvr, value);
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2String value[])
{
    return no_such_type(c, "fmi2SetString", SETTABLE, vr, nvr, value);
}
