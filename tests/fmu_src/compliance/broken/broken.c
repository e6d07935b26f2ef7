/* A small co-simulation FMU without fault, into which one is brought by name: the tests write a defect's name over `defect`
   in the compiled library. Standard: FMI 2.0.4. */
#define _POSIX_C_SOURCE 200809L /* kill */
#include <fcntl.h>
#include <math.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

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

typedef enum { INSTANTIATED, INITIALIZING, STEPPING, TERMINATED } Phase;
enum { U, GAIN, START, X, LIMIT, Y, N_REALS }; /* Real: input, tunable, fixed, output, constant, output = gain u */
enum { COUNT = 10, MODE };                  /* Integer: output, tunable */
enum { ACTIVE = 20 };                       /* Boolean: input */
enum { LABEL = 30 };                        /* String: fixed parameter */

typedef struct {
    Phase phase;
    bool set_up, stop_defined;
    double time, start_time, stop_time;
    double reals[N_REALS];
    int count, mode, active;
    char label[32];
    bool changed; /* set since the last step: nothing may be read then (section 4.2.4) */
} State;

typedef struct {
    fmi2CallbackFunctions callbacks;
    char name[64];
    bool logging;
    State state;
    void *kept;
} Instance;

/* What a bad FMU keeps outside of its instances. */
static double saved;
static int alive;

static void defaults(State *state)
{
    State fresh = {0};
    fresh.reals[U] = 0.5;
    fresh.reals[GAIN] = has("start-value") ? 2.5 : 3.0;
    fresh.reals[START] = 1.0;
    fresh.reals[X] = 1.0;
    fresh.reals[LIMIT] = 100.0;
    fresh.mode = 1;
    fresh.active = fmi2True;
    strcpy(fresh.label, "label");
    if (has("reset") && state->count > 0)
        fresh.reals[X] = state->reals[X];
    *state = fresh;
}

static void say(Instance *self, fmi2Status status, const char *category, const char *text)
{
    if (self->logging || (has("silent") && status == fmi2OK))
        self->callbacks.logger(self->callbacks.componentEnvironment, has("log-messages-name") ? "someone" : self->name,
                               status, has("log-messages") ? "undeclared" : category, "%s after %d steps", text,
                               self->state.count);
}

static fmi2Status refuse(Instance *self, const char *text)
{
#ifndef _WIN32
    while (has("hangs-when-it-refuses"))
        pause();
#endif
    say(self, fmi2Error, "logStatusError", text);
    return fmi2Error;
}

/* What a bad FMU does to the process that it is loaded in. */
static void misbehave(const State *state)
{
#ifndef _WIN32
    if (has("kills-its-parent"))
        kill(getppid(), SIGKILL);
    if (has("signal"))
        raise(40);
    if (has("closes"))
        for (int file = 3; file < 300; file++)
            close(file);
    if (has("garbage"))
        for (int file = 3; file < 300; file++)
            if (fcntl(file, F_GETFD) != -1 && write(file, "garbage\n", 8) < 0)
                continue;
#endif
    if (has("hang-at-once"))
        for (volatile int i = 0;; i++)
            ;
    if (has("exits"))
        exit(0);
    if (has("prints-much") && state->count == 0)
        for (int i = 0; i < 1600; i++)
            printf("%65535d\n", i);
}

/* Is this function forbidden in this state? The defect call-order lets one of them pass; so does one that names it and
   the state: I instantiated, U set up, M in initialization mode, S initialized, T terminated. */
static bool forbidden(Instance *self, const char *function, bool legal)
{
    if (legal)
        return false;
    char passing[48];
    char state = self->state.phase == INSTANTIATED && self->state.set_up ? 'U' : "IMST"[self->state.phase];
    snprintf(passing, sizeof passing, "%s in %c", function, state);
    if (has(passing))
        return false;
    if (has("call-order") && strcmp(function, "fmi2Terminate") == 0)
        return false;
    if (has("call-order-crash") && strcmp(function, "fmi2Terminate") == 0)
        abort();
    refuse(self, function);
    return true;
}

const char *fmi2GetTypesPlatform(void)
{
    return has("types-platform") ? "special" : fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return has("version") ? "2.1" : fmi2Version;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    (void)resources, (void)visible;
    if (has("instantiate") || type != fmi2CoSimulation || (strcmp(guid, GUID) != 0 && !has("guid-mismatch")))
        return NULL;
    Instance *self = callbacks->allocateMemory(1, sizeof *self);
    if (!self)
        return NULL;
    self->callbacks = *callbacks;
    self->logging = logging;
    strncpy(self->name, name, sizeof self->name - 1);
    self->kept = has("memory") ? callbacks->allocateMemory(1, 64) : NULL;
    alive++;
    defaults(&self->state);
    return self;
}

void fmi2FreeInstance(fmi2Component c)
{
    Instance *self = c;
    if (!self) {
        if (has("free"))
            abort();
        return;
    }
    alive--;
    self->callbacks.freeMemory(self);
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    Instance *self = c;
    (void)categories;
    if (has("debug-logging") && n > 0)
        return refuse(self, "no categories here");
    self->logging = on;
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stopDefined, fmi2Real stop)
{
    Instance *self = c;
    (void)toleranceDefined, (void)tolerance;
    if (forbidden(self, "fmi2SetupExperiment", self->state.phase == INSTANTIATED))
        return fmi2Error;
    self->state.time = self->state.start_time = start;
    self->state.stop_defined = stopDefined;
    self->state.stop_time = stop;
    self->state.set_up = true;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    Instance *self = c;
    if (forbidden(self, "fmi2EnterInitializationMode", self->state.phase == INSTANTIATED && self->state.set_up))
        return fmi2Error;
    self->state.phase = INITIALIZING;
    return has("legal-call") ? refuse(self, "not today") : fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    Instance *self = c;
    if (forbidden(self, "fmi2ExitInitializationMode", self->state.phase == INITIALIZING))
        return fmi2Error;
    if (!(has("reset") && self->state.reals[X] != 1.0))
        self->state.reals[X] = self->state.reals[START];
    self->state.phase = STEPPING;
    say(self, fmi2OK, "logEvents", "initialized");
    if (has("prints"))
        printf("initialized\n");
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    Instance *self = c;
    if (forbidden(self, "fmi2Terminate", self->state.phase == STEPPING))
        return fmi2Error;
    self->state.phase = TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    Instance *self = c;
    if (has("reset-refused"))
        return refuse(self, "no way back");
    defaults(&self->state);
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean noSetState)
{
    Instance *self = c;
    State *state = &self->state;
    (void)noSetState;
    if (forbidden(self, "fmi2DoStep", state->phase == STEPPING))
        return fmi2Error;
    if (!(h > 0) && !(has("step-size") && h == 0))
        return refuse(self, "the step size is not positive");
    if (!(fabs(t - state->time) < 1e-9) && !has("communication-point"))
        return refuse(self, "not the current time");
    if (state->stop_defined && t + h > state->stop_time + 1e-9 && !has("stop-time"))
        return refuse(self, "beyond the stop time");
    if (has("step-variation") && fabs(h - 0.1) > 1e-9)
        return refuse(self, "only 0.1");
    if (has("nan-input") && isnan(state->reals[U]))
        abort();
    if (has("hang") && isinf(state->reals[U]))
        for (volatile int i = 0;; i++)
            ;
    misbehave(state);
    if (has("pending"))
        return fmi2Pending;
    state->changed = false;
    double noise = has("noise") ? (double)getpid() : has("two-instances") && alive > 1 ? 1 : 0;
    state->reals[X] += h * (state->active ? state->reals[GAIN] * state->reals[U] - state->reals[X] + noise : 0);
    state->time = t + h;
    state->count++;
    return fmi2OK;
}

static bool known(const fmi2ValueReference vr[], size_t n, unsigned first, unsigned end)
{
    for (size_t i = 0; i < n; i++)
        if (vr[i] < first || vr[i] >= end)
            return false;
    return true;
}

static bool stale(const Instance *self)
{
    return self->state.phase == STEPPING && self->state.changed;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[])
{
    Instance *self = c;
    if (stale(self))
        return refuse(self, "no step since something was set");
    if (!known(vr, n, 0, N_REALS))
        return has("unknown-reference") ? fmi2OK : refuse(self, "no such Real");
    for (size_t i = 0; i < n; i++)
        value[i] = vr[i] == Y ? self->state.reals[GAIN] * self->state.reals[U] : self->state.reals[vr[i]];
    return fmi2OK;
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer value[])
{
    Instance *self = c;
    if (stale(self))
        return refuse(self, "no step since something was set");
    if (!known(vr, n, COUNT, MODE + 1))
        return refuse(self, "no such Integer");
    for (size_t i = 0; i < n; i++)
        value[i] = vr[i] == COUNT ? self->state.count : self->state.mode;
    return fmi2OK;
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Boolean value[])
{
    Instance *self = c;
    if (stale(self))
        return refuse(self, "no step since something was set");
    if (!known(vr, n, ACTIVE, ACTIVE + 1))
        return refuse(self, "no such Boolean");
    for (size_t i = 0; i < n; i++)
        value[i] = self->state.active;
    return fmi2OK;
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[])
{
    Instance *self = c;
    if (stale(self))
        return refuse(self, "no step since something was set");
    if (!known(vr, n, LABEL, LABEL + 1))
        return refuse(self, "no such String");
    for (size_t i = 0; i < n; i++)
        value[i] = self->state.label;
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[])
{
    Instance *self = c;
    Phase phase = self->state.phase;
    if (!known(vr, n, 0, N_REALS) || phase == TERMINATED)
        return refuse(self, "no such Real, or terminated");
    self->state.changed = self->state.phase == STEPPING;
    for (size_t i = 0; i < n; i++) {
        if ((vr[i] == LIMIT && !has("set-constant")) || (vr[i] == X && !has("set-calculated")) || vr[i] == Y ||
            (vr[i] == START && phase == STEPPING && !has("set-fixed")) || (vr[i] == U && phase == INSTANTIATED))
            return refuse(self, "cannot be set");
        if (!(vr[i] == GAIN && has("set-get")))
            self->state.reals[vr[i]] = value[i];
    }
    return fmi2OK;
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer value[])
{
    Instance *self = c;
    if (!known(vr, n, MODE, MODE + 1) || self->state.phase == TERMINATED)
        return refuse(self, "no such Integer, or calculated, or terminated");
    self->state.changed = self->state.phase == STEPPING;
    for (size_t i = 0; i < n; i++)
        self->state.mode = value[i];
    return fmi2OK;
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Boolean value[])
{
    Instance *self = c;
    if (!known(vr, n, ACTIVE, ACTIVE + 1) || self->state.phase == TERMINATED || self->state.phase == INSTANTIATED)
        return refuse(self, "no such Boolean, or not now");
    self->state.changed = self->state.phase == STEPPING;
    for (size_t i = 0; i < n; i++)
        self->state.active = value[i];
    return fmi2OK;
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[])
{
    Instance *self = c;
    if (!known(vr, n, LABEL, LABEL + 1) || self->state.phase >= STEPPING)
        return refuse(self, "no such String, or fixed");
    self->state.changed = self->state.phase == STEPPING;
    for (size_t i = 0; i < n; i++)
        strncpy(self->state.label, value[i], sizeof self->state.label - 1);
    return fmi2OK;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    Instance *self = c;
    if (!*state)
        *state = self->callbacks.allocateMemory(1, sizeof(State));
    memcpy(*state, &self->state, sizeof(State));
    if (has("state-restore"))
        saved = self->state.reals[X];
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    Instance *self = c;
    double x = self->state.reals[X];
    memcpy(&self->state, state, sizeof(State));
    if (has("state-restore") && saved != 0)
        self->state.reals[X] = x; /* forgotten, unless it comes from another process */
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    Instance *self = c;
    if (*state)
        self->callbacks.freeMemory(*state);
    if (!has("state-free"))
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
    if (has("state-serialize"))
        ((State *)(void *)bytes)->reals[X] = 0;
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
    Instance *self = c;
    if (has("directional-derivative-refused"))
        return refuse(c, "no derivatives");
    for (size_t i = 0; i < nUnknown; i++)
        dvUnknown[i] = 0;
    for (size_t i = 0; i < nUnknown; i++)
        for (size_t j = 0; j < nKnown; j++)
            if (unknown[i] == Y && knowns[j] == U)
                dvUnknown[i] += (has("directional-derivative") ? 1 : self->state.reals[GAIN]) * dvKnown[j];
    return fmi2OK;
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[])
{
    (void)vr, (void)n, (void)order, (void)value;
    return has("input-derivatives") ? refuse(c, "no derivatives") : fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[])
{
    (void)vr, (void)n, (void)order;
    value[0] = 0;
    return has("output-derivatives") ? refuse(c, "no derivatives") : fmi2OK;
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    return refuse(c, "nothing to cancel");
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value)
{
    (void)c, (void)kind;
    *value = fmi2Pending;
    if (has("pending"))
        return fmi2OK;
    return fmi2Discard;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    (void)c, (void)kind, (void)value;
    return fmi2Discard;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value)
{
    (void)c, (void)kind, (void)value;
    return fmi2Discard;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    (void)c, (void)kind, (void)value;
    return fmi2Discard;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value)
{
    (void)c, (void)kind, (void)value;
    return fmi2Discard;
}
