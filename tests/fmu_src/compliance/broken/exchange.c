/* A small model-exchange FMU without fault, into which one is brought by name, as into broken.c: a ball that bounces, and a
   switch that is thrown at t = 0.35. Standard: FMI 2.0.4. */
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

#define GUID "{8c4e810f-3df3-4a00-8276-176fa3c9f000}"

volatile const char defect[48] = "DEFECT:none..................................";

static bool has(const char *name)
{
    char chosen[sizeof defect];
    for (size_t i = 0; i < sizeof defect; i++)
        chosen[i] = defect[i];
    return strcmp(chosen + strlen("DEFECT:"), name) == 0;
}

typedef enum { INSTANTIATED, INITIALIZING, EVENT, CONTINUOUS, TERMINATED } Phase;
enum { H, V, DER_H, DER_V, G, LIFT, N_REALS }; /* Real: states, their derivatives, fixed parameter, input */
enum { THROWN = 10 };                          /* Integer: output */

typedef struct {
    Phase phase;
    bool set_up;
    double time;
    double reals[N_REALS];
    int thrown, bounces;
} State;

typedef struct {
    fmi2CallbackFunctions callbacks;
    char name[64];
    bool logging;
    State state;
} Instance;

static void defaults(State *state)
{
    State fresh = {0};
    fresh.reals[H] = 1.0;
    fresh.reals[G] = 9.81;
    *state = fresh;
}

static fmi2Status refuse(Instance *self, const char *text)
{
    if (self->logging)
        self->callbacks.logger(self->callbacks.componentEnvironment, self->name, fmi2Error, "logStatusError", "%s", text);
    return fmi2Error;
}

static double real(const State *state, fmi2ValueReference vr)
{
    if (vr == DER_H)
        return state->reals[V];
    if (vr == DER_V)
        return has("state-derivatives") && state->bounces > 0 ? NAN : state->reals[LIFT] - state->reals[G];
    return state->reals[vr];
}

static bool evaluates(const State *state)
{
    return state->phase == INITIALIZING || state->phase == EVENT || state->phase == CONTINUOUS;
}

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    (void)resources, (void)visible;
    if (type != fmi2ModelExchange || strcmp(guid, GUID) != 0)
        return NULL;
    Instance *self = callbacks->allocateMemory(1, sizeof *self);
    if (!self)
        return NULL;
    self->callbacks = *callbacks;
    self->logging = logging;
    strncpy(self->name, name, sizeof self->name - 1);
    defaults(&self->state);
    return self;
}

void fmi2FreeInstance(fmi2Component c)
{
    Instance *self = c;
    if (self)
        self->callbacks.freeMemory(self);
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    Instance *self = c;
    (void)n, (void)categories;
    self->logging = on;
    return fmi2OK;
}

static fmi2Status go(Instance *self, bool legal, Phase next)
{
    if (!legal)
        return refuse(self, "not in this state");
    self->state.phase = next;
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stopDefined, fmi2Real stop)
{
    Instance *self = c;
    (void)toleranceDefined, (void)tolerance, (void)stopDefined, (void)stop;
    if (self->state.phase != INSTANTIATED)
        return refuse(self, "not in this state");
    self->state.time = start;
    self->state.set_up = true;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    Instance *self = c;
    return go(self, self->state.phase == INSTANTIATED && self->state.set_up, INITIALIZING);
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    Instance *self = c;
    return go(self, self->state.phase == INITIALIZING, EVENT);
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    Instance *self = c;
    return go(self, self->state.phase == EVENT || self->state.phase == CONTINUOUS, TERMINATED);
}

fmi2Status fmi2Reset(fmi2Component c)
{
    Instance *self = c;
    if (has("reset-refused"))
        return refuse(self, "no way back");
    defaults(&self->state);
    return fmi2OK;
}

fmi2Status fmi2EnterEventMode(fmi2Component c)
{
    Instance *self = c;
    return go(self, self->state.phase == CONTINUOUS || (has("call-order") && self->state.phase == EVENT), EVENT);
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info)
{
    Instance *self = c;
    State *state = &self->state;
    if (state->phase != EVENT)
        return refuse(self, "not in event mode");
    bool bounces = state->reals[H] <= 0 && state->reals[V] < 0;
    if (bounces) {
        state->reals[V] = -0.7 * state->reals[V];
        state->bounces++;
    }
    if (state->time >= 0.35)
        state->thrown = 1;
    memset(info, 0, sizeof *info);
    info->newDiscreteStatesNeeded = (has("event-mode") && state->time > 0) ? fmi2True : fmi2False;
    info->valuesOfContinuousStatesChanged = bounces;
    info->nextEventTimeDefined = !state->thrown;
    info->nextEventTime = 0.35;
    return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c)
{
    Instance *self = c;
    return go(self, self->state.phase == EVENT, CONTINUOUS);
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean noSetState, fmi2Boolean *enter, fmi2Boolean *end)
{
    Instance *self = c;
    (void)noSetState;
    if (self->state.phase != CONTINUOUS)
        return refuse(self, "not in continuous-time mode");
    *enter = *end = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time)
{
    Instance *self = c;
    if (self->state.phase != EVENT && self->state.phase != CONTINUOUS)
        return refuse(self, "no time to be set");
    self->state.time = time;
    return fmi2OK;
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n)
{
    Instance *self = c;
    if (n != 2 || self->state.phase != CONTINUOUS)
        return refuse(self, "two states, in continuous-time mode");
    self->state.reals[H] = x[0];
    self->state.reals[V] = has("continuous-states") ? (double)(float)x[1] : x[1];
    return fmi2OK;
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n)
{
    Instance *self = c;
    if (n != 2 || !evaluates(&self->state))
        return refuse(self, "two states");
    x[0] = self->state.reals[H];
    x[1] = self->state.reals[V];
    return fmi2OK;
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real slopes[], size_t n)
{
    Instance *self = c;
    if (n != 2 || !evaluates(&self->state))
        return refuse(self, "two states");
    slopes[0] = real(&self->state, DER_H);
    slopes[1] = real(&self->state, DER_V);
    return fmi2OK;
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n)
{
    Instance *self = c;
    if (n != 1 || !evaluates(&self->state))
        return refuse(self, "one indicator");
    z[0] = self->state.reals[H];
    return fmi2OK;
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real nominals[], size_t n)
{
    if (n != 2)
        return refuse(c, "two states");
    nominals[0] = has("continuous-states-nominal") ? 0 : 1;
    nominals[1] = 1;
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[])
{
    Instance *self = c;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] >= N_REALS)
            return refuse(self, "no such Real");
        value[i] = real(&self->state, vr[i]);
    }
    return fmi2OK;
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer value[])
{
    Instance *self = c;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] != THROWN)
            return refuse(self, "no such Integer");
        value[i] = self->state.thrown;
    }
    return fmi2OK;
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Boolean value[])
{
    (void)vr, (void)value;
    return n ? refuse(c, "no such Boolean") : fmi2OK;
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[])
{
    (void)vr, (void)value;
    return n ? refuse(c, "no such String") : fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[])
{
    Instance *self = c;
    Phase phase = self->state.phase;
    for (size_t i = 0; i < n; i++) {
        bool initial = phase == INSTANTIATED || phase == INITIALIZING;
        bool legal = vr[i] == LIFT ? phase != TERMINATED : (vr[i] == H || vr[i] == V || vr[i] == G) && initial;
        if (!legal)
            return refuse(self, "no such Real, or not to be set now");
        self->state.reals[vr[i]] = value[i];
    }
    return fmi2OK;
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer value[])
{
    (void)vr, (void)value;
    return n ? refuse(c, "no Integer can be set") : fmi2OK;
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Boolean value[])
{
    (void)vr, (void)value;
    return n ? refuse(c, "no such Boolean") : fmi2OK;
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[])
{
    (void)vr, (void)value;
    return n ? refuse(c, "no such String") : fmi2OK;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    Instance *self = c;
    if (!*state)
        *state = self->callbacks.allocateMemory(1, sizeof(State));
    memcpy(*state, &self->state, sizeof(State));
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    Instance *self = c;
    memcpy(&self->state, state, sizeof(State));
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    Instance *self = c;
    if (*state)
        self->callbacks.freeMemory(*state);
    *state = NULL;
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    (void)c, (void)state;
    *size = sizeof(State);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    (void)c;
    memcpy(bytes, state, size);
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    Instance *self = c;
    if (!*state)
        *state = self->callbacks.allocateMemory(1, size);
    memcpy(*state, bytes, size);
    return fmi2OK;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t nUnknown,
                                        const fmi2ValueReference knowns[], size_t nKnown, const fmi2Real dvKnown[],
                                        fmi2Real dvUnknown[])
{
    (void)c;
    for (size_t i = 0; i < nUnknown; i++) {
        dvUnknown[i] = 0;
        for (size_t j = 0; j < nKnown; j++)
            if ((unknown[i] == DER_H && knowns[j] == V) || (unknown[i] == DER_V && knowns[j] == LIFT) ||
                (unknown[i] == knowns[j] && knowns[j] <= V))
                dvUnknown[i] += has("directional-derivative") ? -dvKnown[j] : dvKnown[j];
    }
    return fmi2OK;
}
