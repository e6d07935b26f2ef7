/* Plants for model exchange, each with something of its own: which one it is says the GUID. Value references: states from 0, their
   derivatives from 100, parameters from 200, inputs from 300, outputs from 400. */
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

#define MOST 64

typedef enum { VAN_DER_POL, ROD, CHOOSES, CRASH, DELAY, DISCARD, ENDLESS, ENDS, ERROR, EXPLICIT_TIME, FAILS_TO_START, FATAL, LATE_EVENT, NO_RESET, ONCE, PENDULUM, PRINTS, RELAY, TIME_EVENT, WRITES, WRONG_SLOPES } Kind;
static const char *const KINDS[] = {"van_der_pol", "rod", "chooses", "crash", "delay", "discard", "endless", "ends", "error", "explicit_time", "fails_to_start", "fatal", "late_event", "no_reset", "once", "pendulum", "prints", "relay", "time_event", "writes", "wrong_slopes"};
#define N_KINDS (sizeof KINDS / sizeof *KINDS)

typedef enum { INSTANTIATED, INITIALIZATION, EVENT, CONTINUOUS, OVER } Mode;

typedef struct {
    const fmi2CallbackFunctions *callbacks;
    Kind kind;
    int places; /* of a rod */
    int n, calls, side;
    bool logging;
    Mode mode;
    double t, earliest, x[MOST], p[4], u[2], kept;
    int events;
} Plant;

static int alive; /* instances of kind `once` */

static void begin(Plant *m)
{
    m->mode = INSTANTIATED;
    m->t = m->earliest = m->kept = 0;
    m->calls = m->side = m->events = 0;
    memset(m->x, 0, sizeof m->x);
    memset(m->u, 0, sizeof m->u);
    m->p[0] = 1.5; /* mu; c of the pendulum; k of the rod */
    m->p[1] = 2;   /* m */
    m->x[0] = 1;
    m->x[1] = m->kind == PENDULUM ? 0.3 : 0.5;
    m->n = 2;
    if (m->kind == PENDULUM) {
        m->n = 4;
        m->p[0] = 40;
    } else if (m->kind == ROD) {
        m->n = m->places;
        for (int i = 0; i < m->n; i++)
            m->x[i] = 0;
        m->p[0] = 20;
    }
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
    (void)name;
    (void)resources;
    (void)visible;
    if (type != fmi2ModelExchange || strncmp(resources, "file:///", 8) != 0)
        return NULL;
    Plant *m = callbacks->allocateMemory(1, sizeof *m);
    if (!m)
        return NULL;
    m->callbacks = callbacks;
    m->logging = logging;
    for (size_t k = 0; k < N_KINDS; k++) /* any other name is one more van der Pol */
        if (strcmp(guid, KINDS[k]) == 0)
            m->kind = (Kind)k;
    if (strncmp(guid, "rod", 3) == 0) {
        m->kind = ROD;
        m->places = atoi(guid + 3);
    }
    if (m->kind == ONCE && alive++ > 0) {
        alive--;
        callbacks->freeMemory(m);
        return NULL;
    }
    begin(m);
    return m;
}

void fmi2FreeInstance(fmi2Component c)
{
    Plant *m = c;
    if (!m)
        return;
    if (m->kind == ONCE)
        alive--;
    m->callbacks->freeMemory(m);
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    (void)c;
    (void)on;
    (void)n;
    (void)categories;
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean has_stop, fmi2Real stop)
{
    Plant *m = c;
    (void)has_tolerance;
    (void)tolerance;
    (void)has_stop;
    (void)stop;
    m->t = m->earliest = start;
    return m->mode == INSTANTIATED ? fmi2OK : fmi2Error;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    Plant *m = c;
    if (m->mode != INSTANTIATED)
        return fmi2Error;
    m->mode = INITIALIZATION;
    return m->kind == FAILS_TO_START ? fmi2Error : fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    Plant *m = c;
    if (m->mode != INITIALIZATION)
        return fmi2Error;
    m->mode = EVENT;
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    ((Plant *)c)->mode = OVER;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    Plant *m = c;
    if (m->kind == NO_RESET)
        return fmi2Error;
    begin(m);
    return fmi2OK;
}

static void derivatives(Plant *m, double d[])
{
    const double *x = m->x, *p = m->p;
    if (m->kind == PENDULUM) { /* a mass on a spring that swings: r, phi, v, w */
        d[0] = x[2];
        d[1] = x[3];
        d[2] = x[0] * x[3] * x[3] + 9.81 * cos(x[1]) - p[0] / p[1] * (x[0] - 1) + m->u[0] / p[1];
        d[3] = -(9.81 * sin(x[1]) + 2 * x[2] * x[3]) / x[0];
    } else if (m->kind == ROD) { /* heated at its left end, losing heat at each place */
        for (int i = 0; i < m->n; i++) {
            double left = i > 0 ? x[i - 1] : m->u[0], right = i < m->n - 1 ? x[i + 1] : x[i];
            d[i] = p[0] * (left - 2 * x[i] + right) - 0.1 * x[i] * x[i];
        }
    } else { /* van der Pol */
        d[0] = x[1];
        d[1] = p[0] * (1 - x[0] * x[0]) * x[1] - x[0] + m->u[0];
    }
    if (m->kind == RELAY) {
        if (x[0] > 0.2)
            m->side = 1;
        if (x[0] < -0.2)
            m->side = -1;
        d[1] += m->side;
    }
    if (m->kind == DELAY)
        d[1] += m->kept;
    if (m->kind == EXPLICIT_TIME)
        d[1] += sin(3 * m->t);
    if (m->kind == WRITES)
        m->x[0] += 1e-3;
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real d[], size_t n)
{
    Plant *m = c;
    if (m->mode != CONTINUOUS || n != (size_t)m->n)
        return fmi2Error;
    m->calls++;
    if (m->kind == CRASH && m->calls == 3)
        abort();
    if (m->kind == PRINTS) {
        printf("called %d times\n", m->calls);
        m->callbacks->logger(m->callbacks->componentEnvironment, "plant", fmi2OK, "said", "whether asked or not");
    }
    if (m->x[0] > 2.5 && m->kind == DISCARD)
        return fmi2Discard;
    if (m->x[0] > 2.5 && m->kind == ERROR) {
        m->mode = OVER;
        if (m->logging)
            m->callbacks->logger(m->callbacks->componentEnvironment, "plant", fmi2Error, "error", "too far: 100%% of %g", 2.5);
        return fmi2Error;
    }
    if (m->x[0] > 2.5 && m->kind == FATAL) {
        m->mode = OVER;
        return fmi2Fatal;
    }
    derivatives(m, d);
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[])
{
    Plant *m = c;
    double d[MOST];
    if (m->mode != INITIALIZATION && m->mode != EVENT && m->mode != CONTINUOUS)
        return fmi2Error;
    derivatives(m, d);
    for (size_t i = 0; i < n; i++) {
        unsigned group = vr[i] / 100, k = vr[i] % 100;
        if (group == 4)
            value[i] = k == 0 ? m->x[0] : k == 1 ? m->x[m->n / 2] : m->x[0] * m->x[0] + m->u[0];
        else
            value[i] = group == 0 ? m->x[k] : group == 1 ? d[k] : group == 2 ? m->p[k] : m->u[k];
    }
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[])
{
    Plant *m = c;
    for (size_t i = 0; i < n; i++) {
        unsigned group = vr[i] / 100, k = vr[i] % 100;
        if (group == 2 && m->mode == CONTINUOUS)
            return fmi2Error;
        if (group == 2 && k == 1 && m->mode == EVENT) /* m is fixed */
            return fmi2Error;
        if (group == 0)
            m->x[k] = value[i];
        else if (group == 2)
            m->p[k] = value[i];
        else
            m->u[k] = value[i];
    }
    return fmi2OK;
}

fmi2Status fmi2EnterEventMode(fmi2Component c)
{
    Plant *m = c;
    if (m->mode != CONTINUOUS)
        return fmi2Error;
    m->mode = EVENT;
    m->earliest = m->t;
    m->events++;
    return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info)
{
    Plant *m = c;
    if (m->mode != EVENT)
        return fmi2Error;
    memset(info, 0, sizeof *info);
    if (m->kind == TIME_EVENT || (m->kind == LATE_EVENT && m->events > 0)) {
        info->nextEventTimeDefined = fmi2True;
        info->nextEventTime = m->kind == LATE_EVENT ? 15 : m->t + 1;
    }
    info->terminateSimulation = m->kind == ENDS;
    info->newDiscreteStatesNeeded = m->kind == ENDLESS;
    return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c)
{
    Plant *m = c;
    if (m->mode != EVENT)
        return fmi2Error;
    m->mode = CONTINUOUS;
    return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_set, fmi2Boolean *event, fmi2Boolean *end)
{
    Plant *m = c;
    (void)no_set;
    if (m->mode != CONTINUOUS)
        return fmi2Error;
    m->kept = m->x[0];
    m->earliest = m->t;
    *event = m->kind == CHOOSES ? fmi2True : fmi2False;
    *end = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time)
{
    Plant *m = c;
    if (time < m->earliest || (m->mode != CONTINUOUS && m->mode != EVENT))
        return fmi2Error;
    m->t = time;
    return fmi2OK;
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n)
{
    Plant *m = c;
    if (m->mode != CONTINUOUS || n != (size_t)m->n)
        return fmi2Error;
    memcpy(m->x, x, n * sizeof *x);
    return fmi2OK;
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n)
{
    Plant *m = c;
    if (m->mode != CONTINUOUS || n != (size_t)m->n)
        return fmi2Error;
    memcpy(x, m->x, n * sizeof *x);
    return fmi2OK;
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n)
{
    (void)c;
    for (size_t i = 0; i < n; i++)
        x[i] = 1;
    return fmi2OK;
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n)
{
    (void)c;
    for (size_t i = 0; i < n; i++)
        z[i] = 1;
    return fmi2OK;
}

/* What is never asked of a plant is there all the same, as the standard wants it. */
fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer value[])
{
    (void)c;
    (void)vr;
    for (size_t i = 0; i < n; i++)
        value[i] = 1;
    return fmi2OK;
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Boolean value[])
{
    (void)c;
    (void)vr;
    (void)value;
    return n ? fmi2Error : fmi2OK;
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[])
{
    (void)c;
    (void)vr;
    (void)value;
    return n ? fmi2Error : fmi2OK;
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer value[])
{
    (void)c;
    (void)vr;
    (void)n;
    (void)value;
    return fmi2OK;
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Boolean value[])
{
    (void)c;
    (void)vr;
    (void)value;
    return n ? fmi2Error : fmi2OK;
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[])
{
    (void)c;
    (void)vr;
    (void)value;
    return n ? fmi2Error : fmi2OK;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    (void)c;
    (void)state;
    return fmi2Error;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    (void)c;
    (void)state;
    return fmi2Error;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    (void)c;
    (void)state;
    return fmi2Error;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    (void)c;
    (void)state;
    (void)size;
    return fmi2Error;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    (void)c;
    (void)state;
    (void)bytes;
    (void)size;
    return fmi2Error;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    (void)c;
    (void)bytes;
    (void)size;
    (void)state;
    return fmi2Error;
}

/* The slope of the derivative i by the state or input j, as CasADi would write it down. */
static double slope(const Plant *m, int i, unsigned reference)
{
    const double *x = m->x, *p = m->p;
    int j = reference < 100 ? (int)reference : reference == 300 ? -1 : -2;
    if (m->kind == PENDULUM) {
        if (i < 2)
            return j == i + 2;
        if (i == 2)
            return j == 0 ? x[3] * x[3] - p[0] / p[1] : j == 1 ? -(9.81 * sin(x[1])) : j == 3 ? x[0] * (x[3] + x[3]) : j == -1 ? 1 / p[1] : 0;
        return j == 0   ? (9.81 * sin(x[1]) + 2 * x[2] * x[3]) / x[0] / x[0]
               : j == 1 ? -(9.81 * cos(x[1])) / x[0]
               : j == 2 ? -(2 * x[3]) / x[0]
               : j == 3 ? -(2 * x[2]) / x[0]
                        : 0;
    }
    if (i == 0)
        return j == 1;
    return j == 0 ? -2 * x[0] * p[0] * x[1] - 1 : j == 1 ? p[0] * (1 - x[0] * x[0]) : j == -1 ? 1 : 0;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t n,
                                        const fmi2ValueReference known[], size_t n_known, const fmi2Real seed[],
                                        fmi2Real value[])
{
    Plant *m = c;
    if (m->mode != CONTINUOUS)
        return fmi2Error;
    for (size_t i = 0; i < n; i++) {
        value[i] = 0;
        for (size_t k = 0; k < n_known; k++) {
            double one = unknown[i] / 100 == 1   ? slope(m, (int)unknown[i] % 100, known[k])
                         : unknown[i] == 400     ? known[k] == 0
                         : unknown[i] / 100 == 0 ? known[k] == unknown[i]
                                                 : 0;
            value[i] += one * seed[k];
        }
        if (m->kind == WRONG_SLOPES && unknown[i] / 100 == 1)
            value[i] = -value[i];
    }
    return fmi2OK;
}
