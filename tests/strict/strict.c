/* A co-simulation FMU that refuses what FMI 2.0.4 forbids (4.2.4), and that fails in a chosen way, for tests of the master.

   y = gain * u, m = n, c = b, f = e: after a step those of the inputs set before it, in initialization mode at once. */
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "fmi2Functions.h"

#define UNUSED(x) (void)(x)

enum { U, Y, GAIN, FAIL_TIME, N_REALS };
enum { N, M, FAILURE, E, F, N_INTEGERS };
enum { B, C, N_BOOLEANS };
enum { NONE, EXIT, CRASH, ENDLESS, PENDING_FOR_EVER, PENDING_ONCE, ABORT_AT_GET, SET_FOR_EVER, NOISE, REPORT_TOLERANCE,
       GARBLE, LOSE, LOG_FOR_EVER, OBEY_ME, READ_STDIN };

typedef enum { INSTANTIATED, INITIALIZING, STEPPING, TERMINATED } Phase;

typedef struct {
    fmi2CallbackFunctions callbacks;
    char name[64];
    Phase phase;
    bool inputs_set; /* since the last step */
    double reals[N_REALS], time, tolerance;
    int integers[N_INTEGERS], booleans[N_BOOLEANS], polls;
} Instance;

static fmi2Status say(Instance *self, fmi2Status status, const char *text)
{
    self->callbacks.logger(self->callbacks.componentEnvironment, self->name, status, "logStatusError", text);
    return status;
}

static fmi2Status refuse(Instance *self, const char *text) { return say(self, fmi2Error, text); }

static void follow(Instance *self)
{
    self->reals[Y] = self->reals[GAIN] * self->reals[U];
    self->integers[M] = self->integers[N];
    self->integers[F] = self->integers[E];
    self->booleans[C] = self->booleans[B];
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    UNUSED(type), UNUSED(guid), UNUSED(resources), UNUSED(visible), UNUSED(logging);
    Instance *self = callbacks->allocateMemory(1, sizeof *self);
    if (!self)
        return NULL;
    self->callbacks = *callbacks;
    strncpy(self->name, name, sizeof self->name - 1);
    self->reals[GAIN] = 1.0;
    self->integers[E] = self->integers[F] = 1;
    self->tolerance = -1.0;
    FILE *log = fopen("eventlog.txt", "a"); /* into whatever folder it finds itself in, as some do */
    if (log) {
        fputs("instantiated\n", log);
        fclose(log);
    }
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
    Instance *self = c;
    UNUSED(stop_defined), UNUSED(stop);
    if (self->phase != INSTANTIATED)
        return refuse(self, "fmi2SetupExperiment at the wrong time");
    self->time = start;
    if (tolerance_defined)
        self->tolerance = tolerance;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    Instance *self = c;
    self->phase = INITIALIZING;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    Instance *self = c;
    follow(self);
    if (self->integers[FAILURE] == REPORT_TOLERANCE)
        self->reals[Y] = self->tolerance;
    self->phase = STEPPING;
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    Instance *self = c;
    self->phase = TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    UNUSED(c);
    return fmi2Error;
}

/* May this variable be set, or read, now? */
static bool may_set(Instance *self, bool input)
{
    if (input ? self->phase == INSTANTIATED : self->phase >= STEPPING)
        return false;
    if (self->phase == STEPPING && self->integers[FAILURE] == SET_FOR_EVER)
        for (volatile int forever = 1; forever;)
            ;
    self->inputs_set = self->inputs_set || self->phase == STEPPING;
    return true;
}

static bool may_get(Instance *self)
{
    if (self->phase == INITIALIZING)
        follow(self);
    if (self->phase == STEPPING && self->integers[FAILURE] == ABORT_AT_GET && self->time >= self->reals[FAIL_TIME])
        abort();
    return (self->phase == INITIALIZING || self->phase == STEPPING) && !self->inputs_set;
}

#define ACCESS(Type, field, is_input)                                                                                          \
    fmi2Status fmi2Set##Type(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2##Type value[])               \
    {                                                                                                                          \
        Instance *self = c;                                                                                                    \
        for (size_t i = 0; i < n; i++) {                                                                                       \
            if (!may_set(self, is_input))                                                                                      \
                return refuse(self, "fmi2Set" #Type " at the wrong time");                                                     \
            self->field[vr[i]] = value[i];                                                                                     \
        }                                                                                                                      \
        return fmi2OK;                                                                                                         \
    }                                                                                                                          \
    fmi2Status fmi2Get##Type(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2##Type value[])                     \
    {                                                                                                                          \
        Instance *self = c;                                                                                                    \
        for (size_t i = 0; i < n; i++) {                                                                                       \
            if (!may_get(self))                                                                                                \
                return refuse(self, "fmi2Get" #Type " after fmi2SetXXX, without fmi2DoStep");                                  \
            value[i] = self->field[vr[i]];                                                                                     \
        }                                                                                                                      \
        return fmi2OK;                                                                                                         \
    }

ACCESS(Real, reals, vr[i] == U)
ACCESS(Integer, integers, vr[i] == N || vr[i] == E)
ACCESS(Boolean, booleans, vr[i] == B)

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[])
{
    UNUSED(c), UNUSED(vr), UNUSED(n), UNUSED(value);
    return fmi2Error;
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[])
{
    UNUSED(c), UNUSED(vr), UNUSED(n), UNUSED(value);
    return fmi2Error;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean keep)
{
    Instance *self = c;
    UNUSED(keep);
    self->inputs_set = false;
    if (t >= self->reals[FAIL_TIME])
        switch (self->integers[FAILURE]) {
        case EXIT:
            exit(0);
        case CRASH:
            *(volatile int *)8 = 1;
            break;
        case ENDLESS:
            for (volatile int forever = 1; forever;)
                ;
            break;
        case PENDING_FOR_EVER:
            return fmi2Pending;
        case GARBLE: /* whatever pipes its process has open */
            for (int i = 3; i < 32; i++)
                if (lseek(i, 0, SEEK_CUR) < 0)
                    (void)!write(i, "\xee\xee\xee\xee\xee\xee\xee\xee\xee\xee\xee\xee", 12);
            abort();
        case LOSE: /* what lies beside its folder */
            (void)!system("rm -rf ../*");
            break;
        case LOG_FOR_EVER:
            for (;;)
                say(self, fmi2Warning, "again");
        case OBEY_ME:
            return refuse(self, "a line\nand another \x1b[31m");
        case READ_STDIN: /* to its end */
            while (getchar() != EOF)
                ;
            break;
        case NOISE:
            for (int i = 0; i < 1000; i++)
                puts("a line that nobody asked for");
            abort();
        }
    follow(self);
    self->time = t + h;
    if (self->integers[FAILURE] == PENDING_ONCE) {
        self->polls = 3;
        return fmi2Pending;
    }
    return fmi2OK;
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value)
{
    Instance *self = c;
    UNUSED(kind);
    *value = self->integers[FAILURE] == PENDING_FOR_EVER || self->polls-- > 0 ? fmi2Pending : fmi2OK;
    return fmi2OK;
}

#include "absent.h"
