/* From fmi2Instantiate to fmi2FreeInstance, and the calls that PythonFMU answers. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "relay.h"

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation, const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean loggingOn)
{
    (void)fmuResourceLocation;
    if (!functions)
        return NULL; /* and nobody to tell */
    Instance *self = calloc(1, sizeof *self);
    if (!self)
        return NULL;
    self->importer = *functions;
    self->ours = *functions;
    self->ours.logger = from_slave;
    self->ours.componentEnvironment = self;
    self->log_categories = LOG_ALL; /* what goes wrong here is logged in any case */
    snprintf(self->name, sizeof self->name, "%s", instanceName && *instanceName ? instanceName : MODEL);
    char resources[PATH_BYTES + 16], why[512] = "";
    if (!instanceName || !*instanceName)
        snprintf(why, sizeof why, "the instance name is missing");
    else if (fmuType != fmi2CoSimulation)
        snprintf(why, sizeof why, "fmuType = %d, but this is a co-simulation FMU (%d)", (int)fmuType,
                 (int)fmi2CoSimulation);
    else if (!fmuGUID || strcmp(fmuGUID, GUID) != 0)
        snprintf(why, sizeof why, "the GUID is %.64s, but this binary belongs to %s", fmuGUID ? fmuGUID : "(null)",
                 GUID);
    else if (!has_python())
        snprintf(why, sizeof why,
                 "there is no Python in this process, and this FMU runs in one; the native FMU needs none");
    else if (!(self->library = load_library(&self->pythonfmu, resources)))
        snprintf(why, sizeof why, "PythonFMU's library could not be loaded from beside this one");
    if (*why) {
        refuse(self, "fmi2Instantiate", why);
        free(self);
        return NULL;
    }
    self->slave = self->pythonfmu.fmi2Instantiate(instanceName, fmuType, fmuGUID, resources, &self->ours, visible,
                                                  fmi2True); /* categories are chosen here */
    if (!self->slave) {
        close_library(self->library);
        free(self);
        return NULL;
    }
    self->first_categories = loggingOn ? LOG_ALL : 0;
    self->log_categories = self->first_categories;
    return self;
}

void fmi2FreeInstance(fmi2Component c)
{
    Instance *self = c;
    if (!self)
        return;
    self->pythonfmu.fmi2FreeInstance(self->slave);
    close_library(self->library);
    free(self);
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories,
                               const fmi2String categories[])
{
    Instance *self = c;
    if (!self)
        return fmi2Error;
    if (nCategories > 0 && !categories)
        return refuse(self, "fmi2SetDebugLogging", "categories are announced, but the list is a null pointer");
    unsigned chosen = nCategories > 0 ? 0 : LOG_ALL;
    for (size_t k = 0; k < nCategories; k++) {
        if (!category_of(categories[k])) {
            char why[256];
            snprintf(why, sizeof why,
                     "there is no log category '%.64s'; known: logStatusError, logStatusWarning, logStatusDiscard, "
                     "logEvents, logAll",
                     categories[k] ? categories[k] : "(null)");
            return refuse(self, "fmi2SetDebugLogging", why);
        }
        chosen |= category_of(categories[k]);
    }
    self->log_categories = loggingOn ? chosen : 0;
    return fmi2OK;
}

#define HAND_ON(name, parameters, arguments)                                                                           \
    fmi2Status name parameters                                                                                         \
    {                                                                                                                  \
        Instance *self = c;                                                                                            \
        if (!self)                                                                                                     \
            return fmi2Error;                                                                                          \
        self->refused = false;                                                                                         \
        return answer(self, self->pythonfmu.name arguments);                                                           \
    }

#define HAND_ON_ACCESS(name, type)                                                                                     \
    fmi2Status name(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, type value[])                          \
    {                                                                                                                  \
        Instance *self = c;                                                                                            \
        if (!self)                                                                                                     \
            return fmi2Error;                                                                                          \
        if (nvr > 0 && !(vr && value))                                                                                 \
            return refuse(self, #name, "variables are announced, but a list is a null pointer");                       \
        self->refused = self->warned = false;                                                                          \
        fmi2Status status = answer(self, self->pythonfmu.name(self->slave, vr, nvr, value));                           \
        return status == fmi2OK && self->warned ? fmi2Warning : status;                                                \
    }

HAND_ON_ACCESS(fmi2GetReal, fmi2Real)
HAND_ON_ACCESS(fmi2GetInteger, fmi2Integer)
HAND_ON_ACCESS(fmi2GetBoolean, fmi2Boolean)
HAND_ON_ACCESS(fmi2GetString, fmi2String)
HAND_ON_ACCESS(fmi2SetReal, const fmi2Real)
HAND_ON_ACCESS(fmi2SetInteger, const fmi2Integer)
HAND_ON_ACCESS(fmi2SetBoolean, const fmi2Boolean)
HAND_ON_ACCESS(fmi2SetString, const fmi2String)
HAND_ON(fmi2ExitInitializationMode, (fmi2Component c), (self->slave))
HAND_ON(fmi2Terminate, (fmi2Component c), (self->slave))

/* PythonFMU keeps the times and gives them to the slave in fmi2EnterInitializationMode. */
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
                               fmi2Boolean stopTimeDefined, fmi2Real stopTime)
{
    Instance *self = c;
    if (!self)
        return fmi2Error;
    if (self->entered)
        return refuse(self, "fmi2SetupExperiment", "must not be called once the instance is initialized");
    char why[128] = "";
    if (!isfinite(startTime))
        snprintf(why, sizeof why, "the start time %g is not finite", startTime);
    else if (stopTimeDefined && !(stopTime >= startTime))
        snprintf(why, sizeof why, "the stop time %.15g lies before the start time %.15g", stopTime, startTime);
    if (*why)
        return refuse(self, "fmi2SetupExperiment", why);
    self->is_set_up = true;
    return self->pythonfmu.fmi2SetupExperiment(self->slave, toleranceDefined, tolerance, startTime, stopTimeDefined,
                                               stopTime);
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    Instance *self = c;
    if (!self)
        return fmi2Error;
    if (!self->is_set_up)
        return refuse(self, "fmi2EnterInitializationMode", "fmi2SetupExperiment must be called before");
    self->refused = false;
    fmi2Status status = answer(self, self->pythonfmu.fmi2EnterInitializationMode(self->slave));
    self->entered = self->entered || status == fmi2OK;
    return status;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    Instance *self = c;
    if (!self)
        return fmi2Error;
    self->is_set_up = self->entered = false;
    self->refused = false;
    fmi2Status status = answer(self, self->pythonfmu.fmi2Reset(self->slave));
    self->log_categories = self->first_categories;
    return status;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    Instance *self = c;
    if (!self)
        return fmi2Error;
    self->refused = false;
    return answer(self, self->pythonfmu.fmi2DoStep(self->slave, currentCommunicationPoint, communicationStepSize,
                                                   noSetFMUStatePriorToCurrentPoint));
}

/* PythonFMU has no such function: the slave takes the derivative of input k for the value of reference DERIVATIVES + k. */
fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                       const fmi2Integer order[], const fmi2Real value[])
{
    static const char *const inputs[] = {INPUTS NULL};
    const size_t n_inputs = sizeof inputs / sizeof inputs[0] - 1;
    Instance *self = c;
    char why[512] = "";
    if (!self)
        return fmi2Error;
    if (nvr > 0 && !(vr && order && value))
        return refuse(self, "fmi2SetRealInputDerivatives", "variables are announced, but a list is a null pointer");
    for (size_t i = 0; i < nvr && !*why; i++) {
        if (vr[i] >= n_inputs || !inputs[vr[i]]) /* inputs have the first value references; Booleans have no name here */
            snprintf(why, sizeof why, "the value reference %u is no Real input's", vr[i]);
        else if (order[i] != 1)
            snprintf(why, sizeof why, "derivative of order %d of %.256s; only order 1 is supported", order[i],
                     inputs[vr[i]]);
    }
    if (*why)
        return refuse(self, "fmi2SetRealInputDerivatives", why);
    self->refused = false;
    for (size_t i = 0; i < nvr; i++) {
        fmi2ValueReference reference = DERIVATIVES + vr[i];
        fmi2Status status = answer(self, self->pythonfmu.fmi2SetReal(self->slave, &reference, 1, &value[i]));
        if (status != fmi2OK)
            return status;
    }
    return fmi2OK;
}
