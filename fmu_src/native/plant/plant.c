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

/* Of a call that did not do what it should: false. After an error the plant is initialised anew before it is asked again; a refusal
   concerns the point only. */
bool plant_judge(Plant *self, const char *function, fmi2Status status)
{
    if (status == fmi2Discard)
        return false;
    self->usable = false;
    self->dead = self->dead || status == fmi2Fatal;
    snprintf(self->words, sizeof self->words, ": the plant answered %s with %s", function,
             status == fmi2Fatal ? "fmi2Fatal, after which it can't be asked any more" : "an error");
    return false;
}

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
        if (!JUDGED(self, fmi2NewDiscreteStates, &info))
            return false;
        if (info.terminateSimulation)
            break;
        if (!info.newDiscreteStatesNeeded) {
            self->next_event = info.nextEventTimeDefined ? info.nextEventTime : DBL_MAX;
            return JUDGED_PLAIN(self, fmi2EnterContinuousTimeMode);
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
    self->usable = JUDGED(self, fmi2SetupExperiment, fmi2False, 0, time, fmi2False, 0) &&
                   (n == 0 || JUDGED(self, fmi2SetReal, plant_tables.parameters, n, parameters)) &&
                   JUDGED_PLAIN(self, fmi2EnterInitializationMode) && JUDGED_PLAIN(self, fmi2ExitInitializationMode) && settle(self);
    return self->usable;
}

/* The tunable parameters, by an event at the time of the initialisation: so that time may go back to it ever after. */
static bool tune(Plant *self, const double *parameters)
{
    size_t n = plant_tables.n_parameters;
    if (!JUDGED(self, fmi2SetTime, self->origin) || !JUDGED_PLAIN(self, fmi2EnterEventMode))
        return false;
    self->usable = false; /* until it is back */
    for (size_t i = 0; i < n; i++)
        if (parameters[i] != self->parameters[i] && !JUDGED(self, fmi2SetReal, plant_tables.parameters + i, 1, parameters + i))
            return false;
    memcpy(self->parameters, parameters, n * sizeof *parameters);
    self->usable = settle(self);
    return self->usable;
}

/* As the point wants them; a fixed one costs an initialisation. What is no number is none. */
static bool set_parameters(Plant *self, const Point *point)
{
    size_t known = plant_tables.n_known, n = plant_tables.n_parameters;
    bool fixed = false;
    for (size_t i = 0; i < n; i++) {
        self->wanted[i] = i < known ? point->known[i] : point->unknown[i - known];
        if (!isfinite(self->wanted[i]))
            return false;
        fixed = fixed || (self->wanted[i] != self->parameters[i] && plant_tables.fixed[i]);
    }
    if (!self->usable || fixed || point->t < self->origin)
        return initialise(self, fmin(point->t, self->origin), self->wanted);
    return tune(self, self->wanted);
}

static bool has_changed(const Plant *self, const Point *point)
{
    size_t known = plant_tables.n_known, unknown = plant_tables.n_parameters - known;
    for (size_t i = 0; i < known; i++)
        if (point->known[i] != self->parameters[i])
            return true;
    for (size_t i = 0; i < unknown; i++)
        if (point->unknown[i] != self->parameters[known + i])
            return true;
    return false;
}

/* Ready to answer for this point, whose states, inputs and time are finite. */
bool plant_set(Plant *self, const Point *point)
{
    if (self->dead)
        return false;
    if ((!self->usable || point->t < self->origin || has_changed(self, point)) && !set_parameters(self, point))
        return false;
    if (point->t > self->next_event)
        return false;
    return JUDGED(self, fmi2SetTime, point->t) &&
           JUDGED(self, fmi2SetContinuousStates, point->x, plant_tables.n_states) &&
           (plant_tables.n_inputs == 0 || JUDGED(self, fmi2SetReal, plant_tables.driven + plant_tables.n_states,
                                                 plant_tables.n_inputs, point->u));
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
    size_t head = (sizeof(Plant) + 15) / 16 * 16, numbers = 2 * np + 4 * n + 3 * most;
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
    self->wanted = self->parameters + np;
    self->zeros = self->wanted + np;
    self->point = self->zeros + n;
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
