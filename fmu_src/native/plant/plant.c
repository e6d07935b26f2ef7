/* The life of a plant: loaded, instantiated, initialised, its parameters set, ended. */
#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "plant.h"

#define MOST_ITERATIONS 100 /* of an event: one that goes on is none that ends */

THREAD_LOCAL Plant *plant_current = NULL;

static void listen(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                   fmi2String format, ...)
{
    Plant *self = environment;
    (void)name;
    (void)category;
    if (!self || !format)
        return;
    char text[900];
    va_list arguments;
    va_start(arguments, format);
    int n = snprintf(text, sizeof text, "plant %s: ", plant_tables.identifier);
    vsnprintf(text + n, sizeof text - (size_t)n, format, arguments);
    va_end(arguments);
    self->listen(self->listener, status, text);
}

/* Whether the call did what it should. After an error the plant is initialised anew before it is asked again; a refusal
   concerns the point only. */
bool plant_judge(Plant *self, const char *function, fmi2Status status)
{
    if (status == fmi2OK || status == fmi2Warning)
        return true;
    if (status == fmi2Discard)
        return false;
    self->usable = false;
    self->dead = self->dead || status == fmi2Fatal;
    snprintf(self->words, sizeof self->words, ": the plant answered %s with %s", function,
             status == fmi2Fatal ? "fmi2Fatal, after which it can't be asked any more" : "an error");
    return false;
}

#define CALL(function, ...) plant_judge(self, #function, self->call.function(self->slave, __VA_ARGS__))
#define CALL_PLAIN(function) plant_judge(self, #function, self->call.function(self->slave))

static bool instantiate(Plant *self)
{
    self->slave = self->call.fmi2Instantiate(self->name, fmi2ModelExchange, plant_tables.guid, self->location,
                                             &self->callbacks, fmi2False, self->logging ? fmi2True : fmi2False);
    self->fresh = true;
    return self->slave != NULL;
}

/* From Event Mode to Continuous-Time Mode. */
static bool settle(Plant *self)
{
    fmi2EventInfo info;
    for (int i = 0; i < MOST_ITERATIONS; i++) {
        memset(&info, 0, sizeof info);
        if (!CALL(fmi2NewDiscreteStates, &info))
            return false;
        if (info.terminateSimulation)
            break;
        if (!info.newDiscreteStatesNeeded) {
            self->next_event = info.nextEventTimeDefined ? info.nextEventTime : DBL_MAX;
            return CALL_PLAIN(fmi2EnterContinuousTimeMode);
        }
    }
    return plant_judge(self, "fmi2NewDiscreteStates", fmi2Error);
}

/* In Continuous-Time Mode at `time`, with these parameters. */
static bool initialise(Plant *self, double time, const double *parameters)
{
    self->usable = false;
    if (self->dead)
        return false;
    if (!self->fresh && self->call.fmi2Reset(self->slave) > fmi2Warning) {
        self->call.fmi2FreeInstance(self->slave); /* not every tool can reset */
        if (!instantiate(self)) {
            plant_judge(self, "fmi2Instantiate", fmi2Fatal);
            return false;
        }
    }
    self->fresh = false;
    self->origin = time;
    size_t n = plant_tables.n_parameters;
    if (n > 0)
        memcpy(self->parameters, parameters, n * sizeof *parameters);
    self->usable = CALL(fmi2SetupExperiment, fmi2False, 0, time, fmi2False, 0) &&
                   (n == 0 || CALL(fmi2SetReal, plant_tables.parameters, n, parameters)) &&
                   CALL_PLAIN(fmi2EnterInitializationMode) && CALL_PLAIN(fmi2ExitInitializationMode) && settle(self);
    return self->usable;
}

/* The tunable parameters, by an event at the time of the initialisation: so that time may go back to it ever after. */
static bool tune(Plant *self, const double *parameters)
{
    size_t n = plant_tables.n_parameters;
    if (!CALL(fmi2SetTime, self->origin) || !CALL_PLAIN(fmi2EnterEventMode))
        return false;
    self->usable = false; /* until it is back */
    for (size_t i = 0; i < n; i++)
        if (parameters[i] != self->parameters[i] && !CALL(fmi2SetReal, plant_tables.parameters + i, 1, parameters + i))
            return false;
    memcpy(self->parameters, parameters, n * sizeof *parameters);
    self->usable = settle(self);
    return self->usable;
}

static bool set_parameters(Plant *self, const double *parameters)
{
    bool changed = false;
    for (size_t i = 0; i < plant_tables.n_parameters; i++) {
        if (parameters[i] != self->parameters[i]) {
            if (plant_tables.fixed[i])
                return initialise(self, self->origin, parameters);
            changed = true;
        }
    }
    return !changed || tune(self, parameters);
}

/* Ready to answer for this point: states x, inputs u, parameters p, time t, all finite. */
bool plant_set(Plant *self, const double *x, const double *u, const double *p, double t)
{
    if (self->dead)
        return false;
    if (!self->usable || t < self->origin) {
        if (!initialise(self, fmin(t, self->origin), p))
            return false;
    } else if (!set_parameters(self, p)) {
        return false;
    }
    if (t > self->next_event)
        return false;
    return CALL(fmi2SetTime, t) && CALL(fmi2SetContinuousStates, x, plant_tables.n_states) &&
           (plant_tables.n_inputs == 0 ||
            CALL(fmi2SetReal, plant_tables.driven + plant_tables.n_states, plant_tables.n_inputs, u));
}

static bool load(Plant *self, char *words, size_t n_words)
{
    const char *format = plant_library_path();
    size_t bytes = strlen(self->folder) + strlen(format) + strlen(plant_tables.identifier) + 1;
    char *path = self->callbacks.allocateMemory(1, bytes);
    if (!path) {
        snprintf(words, n_words, "allocateMemory refused %lu bytes", (unsigned long)bytes);
        return false;
    }
    strcpy(path, self->folder);
    snprintf(path + strlen(path), bytes - strlen(path), format, plant_tables.identifier);
    self->library = plant_library_open(path, words, n_words);
    self->callbacks.freeMemory(path);
    if (!self->library)
        return false;
#define FIND(name)                                                                                                     \
    {                                                                                                                  \
        void *address = plant_library_symbol(self->library, #name);                                                    \
        if (!address) {                                                                                                \
            snprintf(words, n_words, "its library has no %s", #name);                                                  \
            return false;                                                                                              \
        }                                                                                                              \
        memcpy(&self->call.name, &address, sizeof address);                                                            \
    }
    EACH_PLANT_FUNCTION(FIND)
#undef FIND
    return true;
}

/* The plant in `resources` of the importer, instantiated; NULL, and in `words` why, where that is not possible. */
void *plant_open(const char *resources, const char *name, const fmi2CallbackFunctions *callbacks, bool logging,
                 PlantListener *listener_function, void *listener, char *words, size_t n_words)
{
    if (!resources) {
        snprintf(words, n_words, "the importer does not say where the resources lie, and the plant is among them");
        return NULL;
    }
    size_t np = plant_tables.n_parameters, n = plant_tables.n_states + plant_tables.n_inputs + np;
    size_t most = plant_tables.n_states > plant_tables.n_outputs ? plant_tables.n_states : plant_tables.n_outputs;
    size_t head = (sizeof(Plant) + 15) / 16 * 16, numbers = np + 3 * n + 3 * most;
    size_t bytes = head + numbers * sizeof(double) + strlen(name) + 1;
    char *block = callbacks->allocateMemory(1, bytes);
    if (!block) {
        snprintf(words, n_words, "allocateMemory refused %lu bytes", (unsigned long)bytes);
        return NULL;
    }
    memset(block, 0, bytes);
    Plant *self = (Plant *)(void *)block;
    double *values = (double *)(void *)(block + head);
    self->parameters = values;
    self->point = self->parameters + np;
    self->seeds = self->point + n;
    self->moved = self->seeds + n;
    self->beside = self->moved + n;
    self->name = (char *)(values + numbers);
    strcpy(self->name, name);
    self->callbacks = (fmi2CallbackFunctions){listen, callbacks->allocateMemory, callbacks->freeMemory, NULL, self};
    self->listen = listener_function;
    self->listener = listener;
    self->logging = logging;
    self->next_event = DBL_MAX;
    self->folder = plant_folder(resources, callbacks->allocateMemory);
    self->location = self->folder ? plant_location(self->folder, "/resources", callbacks->allocateMemory) : NULL;
    if (!self->location)
        snprintf(words, n_words, "allocateMemory refused the room for a path");
    else if (load(self, words, n_words)) {
        if (instantiate(self))
            return self;
        snprintf(words, n_words, "it refuses to be instantiated");
    }
    plant_close(self);
    return NULL;
}

void plant_close(void *plant)
{
    Plant *self = plant;
    if (!self)
        return;
    if (self->slave && !self->dead)
        self->call.fmi2FreeInstance(self->slave);
    if (self->library && !self->dead) /* what ended with fmi2Fatal may still be running in a thread of its own */
        plant_library_close(self->library);
    if (plant_current == self)
        plant_current = NULL;
    fmi2CallbackFreeMemory release = self->callbacks.freeMemory;
    if (self->location)
        release(self->location);
    if (self->folder)
        release(self->folder);
    release(self);
}

/* A run begins at t0. */
bool plant_begin(void *plant, double t0)
{
    Plant *self = plant;
    return (self->usable && self->origin == t0) || initialise(self, t0, plant_tables.starts);
}

void plant_enter(void *plant)
{
    plant_current = plant;
}

/* What it last failed in, for the end of a message. */
const char *plant_words(const void *plant)
{
    return ((const Plant *)plant)->words;
}
