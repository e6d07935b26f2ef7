/* From fmi2Instantiate to fmi2FreeInstance. All memory of an instance is one block, taken here through the importer's
   callbacks. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "border.h"

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

/* Carve `bytes` out of the block after the first `*used`; with a null block only count. Aligned for any type. */
static void *carve(char *block, size_t *used, size_t bytes)
{
    void *here = block ? block + *used : NULL;
    *used += (bytes + 15) / 16 * 16;
    return here;
}

/* Lay the instance out in `block`, or with a null pointer say how many bytes it needs. */
static size_t lay_out(char *block, Instance *self, size_t name_bytes)
{
    size_t used = 0;
    const Component *k = &component;
    size_t n_values = k->n_inputs + k->n_parameters + k->n_outputs + k->n_constants;
    carve(block, &used, sizeof *self);
    self->name = carve(block, &used, name_bytes);
    self->values = carve(block, &used, n_values * sizeof(double));
    self->du = carve(block, &used, k->n_inputs * sizeof(double));
    self->u_now = carve(block, &used, k->n_inputs * sizeof(double));
    self->z = carve(block, &used, k->n_states * sizeof(double));
    self->scratch[0] = carve(block, &used, k->n_states * sizeof(double));
    self->scratch[1] = carve(block, &used, k->n_states * sizeof(double));
    self->breaks = carve(block, &used, k->n_breaks * sizeof(double));
    self->counts = carve(block, &used, k->n_counters * sizeof(double));
    self->arg = carve(block, &used, k->sz_arg * sizeof(double *));
    self->res = carve(block, &used, k->sz_res * sizeof(double *));
    self->w = carve(block, &used, k->sz_w * sizeof(double));
    self->iw = carve(block, &used, k->sz_iw * sizeof(int));
    return used;
}

static void pass_on(void *listener, fmi2Status status, const char *text)
{
    Category category = status == fmi2OK        ? LOG_EVENTS
                        : status == fmi2Warning ? LOG_WARNING
                        : status == fmi2Discard ? LOG_DISCARD
                                                : LOG_ERROR;
    report(listener, status, category, "%s", text);
}

/* The plant, if the component is made for one. */
static bool open_plant(Instance *self, fmi2String resources)
{
    if (!component.plant)
        return true;
    char words[512] = "";
    self->plant = component.plant->open(resources, self->name, &self->callbacks, self->first_categories != 0, pass_on, self,
                                        words, sizeof words);
    if (!self->plant)
        report(self, fmi2Error, LOG_ERROR, "fmi2Instantiate: the plant in %s cannot be used: %s.", component.name, words);
    return self->plant != NULL;
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation, const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean loggingOn)
{
    (void)visible;
    if (!functions)
        return NULL; /* and nobody to tell */
    /* A stand-in that can report: what goes wrong here is logged whether logging is on or not, nobody gets an instance
       to turn it on. */
    Instance draft;
    memset(&draft, 0, sizeof draft);
    draft.callbacks = *functions;
    draft.log_categories = LOG_ALL;
    draft.name = (char *)(uintptr_t)(instanceName ? instanceName : component.name); /* only read */
    if (!instanceName || !*instanceName) {
        report(&draft, fmi2Error, LOG_ERROR, "fmi2Instantiate: the instance name is missing.");
        return NULL;
    }
    if (fmuType != fmi2CoSimulation) {
        report(&draft, fmi2Error, LOG_ERROR, "fmi2Instantiate: fmuType = %d, but this is a co-simulation FMU (%d).",
               (int)fmuType, (int)fmi2CoSimulation);
        return NULL;
    }
    if (!fmuGUID || strcmp(fmuGUID, component.guid) != 0) {
        report(&draft, fmi2Error, LOG_ERROR, "fmi2Instantiate: the GUID is %s, but this binary belongs to %s.",
               fmuGUID ? fmuGUID : "(null)", component.guid);
        return NULL;
    }
    /* Importers without a memory manager of their own hand in two null pointers: then the C library's. */
    if (!functions->allocateMemory && !functions->freeMemory) {
        draft.callbacks.allocateMemory = calloc;
        draft.callbacks.freeMemory = free;
    } else if (!functions->allocateMemory || !functions->freeMemory) {
        report(&draft, fmi2Error, LOG_ERROR,
               "fmi2Instantiate: of allocateMemory and freeMemory one is a null pointer.");
        return NULL;
    }
    size_t name_bytes = strlen(instanceName) + 1;
    Instance layout = draft;
    size_t bytes = lay_out(NULL, &layout, name_bytes);
    char *block = draft.callbacks.allocateMemory(1, bytes);
    if (!block) {
        report(&draft, fmi2Error, LOG_ERROR, "fmi2Instantiate: allocateMemory refused %lu bytes.",
               (unsigned long)bytes);
        return NULL;
    }
    memset(block, 0, bytes);
    Instance *self = (Instance *)(void *)block;
    *self = draft;
    lay_out(block, self, name_bytes);
    memcpy(self->name, instanceName, name_bytes);
    self->u = self->values;
    self->p = self->u + component.n_inputs;
    self->y = self->p + component.n_parameters;
    self->first_categories = loggingOn ? LOG_ALL : 0;
    if (!open_plant(self, fmuResourceLocation)) {
        draft.callbacks.freeMemory(block);
        return NULL;
    }
    set_defaults(self);
    return self;
}

void fmi2FreeInstance(fmi2Component c)
{
    Instance *self = c;
    if (!self)
        return;
    if (component.plant)
        component.plant->close(self->plant);
    self->callbacks.freeMemory(self);
}

fmi2Status set_up_experiment(Instance *self, double start, bool stop_defined, double stop)
{
    if (!allowed(self, "fmi2SetupExperiment", INSTANTIATED))
        return fmi2Error;
    if (!isfinite(start)) {
        report(self, fmi2Error, LOG_ERROR, "fmi2SetupExperiment: the start time %g is not finite.", start);
        return fmi2Error;
    }
    if (stop_defined && !(stop >= start)) {
        report(self, fmi2Error, LOG_ERROR, "fmi2SetupExperiment: the stop time %.15g lies before the start time %.15g.",
               stop, start);
        return fmi2Error;
    }
    self->run.clock = clock_at(start, 0);
    self->run.stop_time_defined = stop_defined;
    self->run.stop_time = stop_defined ? stop : 0;
    self->run.is_set_up = 1;
    self->stale_start = true;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    Instance *self = c;
    if (!allowed(self, "fmi2EnterInitializationMode", INSTANTIATED))
        return fmi2Error;
    if (!self->run.is_set_up) {
        report(self, fmi2Error, LOG_ERROR, "fmi2EnterInitializationMode: fmi2SetupExperiment must be called before.");
        return fmi2Error;
    }
    self->run.lifecycle = INITIALIZATION;
    return fmi2OK;
}

fmi2Status exit_initialization_mode(Instance *self)
{
    if (!allowed(self, "fmi2ExitInitializationMode", INITIALIZATION))
        return fmi2Error;
    if (!refresh_start(self))
        return fmi2Error;
    self->run.lifecycle = STEP_COMPLETE;
    report(self, fmi2OK, LOG_EVENTS, "%s: initialized at t = %.15g, sample time %.10g.", component.name,
           self->run.clock.t0, self->run.clock.sample_time);
    return fmi2OK;
}

fmi2Status terminate(Instance *self)
{
    if (!allowed(self, "fmi2Terminate", STEP_COMPLETE))
        return fmi2Error;
    self->run.lifecycle = TERMINATED;
    report(self, fmi2OK, LOG_EVENTS, "%s: terminated at t = %.15g.", component.name, clock_time(&self->run.clock));
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    Instance *self = c;
    if (!allowed(self, "fmi2Reset", ANY_STATE))
        return fmi2Error;
    report(self, fmi2OK, LOG_EVENTS, "%s: reset.", component.name);
    set_defaults(self);
    return fmi2OK;
}
