/* A co-simulation FMU of any number of inputs u_j and outputs y_k, j, k = 1, 2, ..., with direct feedthrough, for tests of the master:

   s = 1 u_1 + 2 u_2 + ..., x_k' = drive + pull s / k - x_k by one Euler step, y_k = x_k + direct s, of the end of the step. */
#include <string.h>

#include "fmi2Functions.h"

#define UNUSED(x) (void)(x)

enum { MOST = 32, U = 0, Y = MOST, DRIVE = 2 * MOST, PULL, DIRECT, N_REALS };

typedef struct {
    fmi2CallbackFunctions callbacks;
    double reals[N_REALS], states[MOST];
    int integers[MOST], booleans[MOST];
} Instance;

static double sum(const Instance *self)
{
    double s = 0.0;
    for (int j = 0; j < MOST; j++)
        s += (j + 1) * self->reals[U + j];
    return s;
}

static void show(Instance *self)
{
    for (int k = 0; k < MOST; k++)
        self->reals[Y + k] = self->states[k] + self->reals[DIRECT] * sum(self);
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    UNUSED(name), UNUSED(type), UNUSED(guid), UNUSED(resources), UNUSED(visible), UNUSED(logging);
    Instance *self = callbacks->allocateMemory(1, sizeof *self);
    if (self)
        self->callbacks = *callbacks;
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
    UNUSED(c), UNUSED(on), UNUSED(n), UNUSED(categories);
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stop_defined, fmi2Real stop)
{
    UNUSED(c), UNUSED(tolerance_defined), UNUSED(tolerance), UNUSED(start), UNUSED(stop_defined), UNUSED(stop);
    return fmi2OK;
}

#define NOTHING_TO_DO(name)                                                                                                    \
    fmi2Status name(fmi2Component c)                                                                                           \
    {                                                                                                                          \
        show(c);                                                                                                               \
        return fmi2OK;                                                                                                         \
    }
NOTHING_TO_DO(fmi2EnterInitializationMode)
NOTHING_TO_DO(fmi2ExitInitializationMode)
NOTHING_TO_DO(fmi2Terminate)
NOTHING_TO_DO(fmi2Reset)

#define ACCESS(Type, field)                                                                                                    \
    fmi2Status fmi2Set##Type(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2##Type value[])               \
    {                                                                                                                          \
        for (size_t i = 0; i < n; i++)                                                                                         \
            ((Instance *)c)->field[vr[i]] = value[i];                                                                          \
        return fmi2OK;                                                                                                         \
    }                                                                                                                          \
    fmi2Status fmi2Get##Type(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2##Type value[])                     \
    {                                                                                                                          \
        for (size_t i = 0; i < n; i++)                                                                                         \
            value[i] = ((Instance *)c)->field[vr[i]];                                                                          \
        return fmi2OK;                                                                                                         \
    }
ACCESS(Real, reals)
ACCESS(Integer, integers)
ACCESS(Boolean, booleans)

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[])
{
    UNUSED(c), UNUSED(vr), UNUSED(n), UNUSED(value);
    return fmi2OK;
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[])
{
    UNUSED(c), UNUSED(vr);
    for (size_t i = 0; i < n; i++)
        value[i] = "";
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean keep)
{
    Instance *self = c;
    UNUSED(t), UNUSED(keep);
    for (int k = 0; k < MOST; k++)
        self->states[k] += h * (self->reals[DRIVE] + self->reals[PULL] * sum(self) / (k + 1) - self->states[k]);
    show(self);
    return fmi2OK;
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value)
{
    UNUSED(c), UNUSED(kind);
    *value = fmi2OK;
    return fmi2OK;
}

#include "absent.h"
