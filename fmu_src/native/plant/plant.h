/* A plant that exists only as an FMU for model exchange: loaded, initialised and evaluated for one instance of the
   observer that calls it.

   Between its events such a plant is a function of states, inputs, parameters and time, and that is all that is asked of
   it: nothing is ever integrated in it, so that a point may be asked for after any other. */
#ifndef PLANT_H
#define PLANT_H

#include <stdbool.h>
#include <stddef.h>

#include "fmi2Functions.h"
#include "prefix.h"

#define plant_tables PREFIX(plant_tables)
#define plant_open PREFIX(plant_open)
#define plant_begin PREFIX(plant_begin)
#define plant_enter PREFIX(plant_enter)
#define plant_close PREFIX(plant_close)
#define plant_words PREFIX(plant_words)
#define plant_current PREFIX(plant_current)
#define plant_set PREFIX(plant_set)
#define plant_judge PREFIX(plant_judge)
#define plant_library_open PREFIX(plant_library_open)
#define plant_library_symbol PREFIX(plant_library_symbol)
#define plant_library_close PREFIX(plant_library_close)
#define plant_library_path PREFIX(plant_library_path)
#define plant_folder PREFIX(plant_folder)
#define plant_location PREFIX(plant_location)
#define plant_rate PREFIX(plant_rate)
#define plant_measure PREFIX(plant_measure)
#define fwd1_plant_rate PREFIX(fwd1_plant_rate)
#define fwd1_plant_measure PREFIX(fwd1_plant_measure)

#if defined _MSC_VER
#define THREAD_LOCAL __declspec(thread)
#else
#define THREAD_LOCAL __thread
#endif

/* What the plant's description says, generated. Value references, in the order of the functions' arguments; known
   parameters come before the unknown ones. */
typedef struct {
    const char *identifier;
    const char *guid;
    size_t n_states, n_inputs, n_known, n_parameters, n_outputs;
    const fmi2ValueReference *driven; /* states, then inputs */
    const fmi2ValueReference *derivatives, *parameters, *outputs;
    const unsigned char *fixed;           /* whether a parameter can be set at an initialisation only */
    const double *starts;                 /* of the parameters */
    const double *nominals;               /* of states, inputs, parameters */
    int directional_rate, directional_measure; /* whether the plant differentiates these by states and inputs itself */
} PlantTables;

/* Every function of the standard that is called. */
#define EACH_PLANT_FUNCTION(X)                                                                                         \
    X(fmi2Instantiate) X(fmi2FreeInstance) X(fmi2SetupExperiment) X(fmi2EnterInitializationMode)                       \
    X(fmi2ExitInitializationMode) X(fmi2Reset) X(fmi2GetReal) X(fmi2SetReal) X(fmi2EnterEventMode)                     \
    X(fmi2NewDiscreteStates) X(fmi2EnterContinuousTimeMode) X(fmi2SetTime) X(fmi2SetContinuousStates)                  \
    X(fmi2GetDerivatives) X(fmi2GetDirectionalDerivative)

typedef struct {
#define MEMBER(name) name##TYPE *name;
    EACH_PLANT_FUNCTION(MEMBER)
#undef MEMBER
} PlantFunctions;

/* Whom the plant's messages go to. */
typedef void PlantListener(void *listener, fmi2Status status, const char *text);

typedef struct {
    fmi2CallbackFunctions callbacks;
    PlantListener *listen;
    void *listener;
    bool logging;
    char *folder, *location, *name;
    void *library;
    PlantFunctions call;
    fmi2Component slave;
    bool usable;         /* initialised, and without an error since */
    bool fresh;          /* nothing was called since it was instantiated or reset */
    bool dead;           /* after fmi2Fatal nothing may be called any more */
    double origin;       /* the time of the initialisation, and of every event since [s] */
    double next_event;   /* from here on it would be another function [s] */
    double *parameters;  /* as they are set */
    double *wanted;      /* as they are to be */
    double *zeros;       /* for arguments that are none */
    double *point;       /* states, inputs, parameters at which a derivative is asked for */
    double *seeds;       /* their direction */
    double *moved;       /* as they are handed in */
    double *beside;      /* results there: as many as the longer of states and outputs, three times */
    char words[160];     /* what failed last */
} Plant;

/* What is asked for: states, inputs, known and unknown parameters, time [s]. */
typedef struct {
    const double *x, *u, *known, *unknown;
    double t;
} Point;

BEGIN_INTERNAL

extern const PlantTables plant_tables;
extern THREAD_LOCAL Plant *plant_current;

/* plant.c: the life of a plant. */
void *plant_open(const char *resources, const char *name, const fmi2CallbackFunctions *callbacks, bool logging,
                 PlantListener *listen, void *listener, char *words, size_t n_words);
bool plant_begin(void *plant, double t0);
void plant_enter(void *plant);
void plant_close(void *plant);
const char *plant_words(const void *plant);
bool plant_set(Plant *self, const Point *point);
bool plant_judge(Plant *self, const char *function, fmi2Status status);

/* Whether a function of the plant did what it should. */
#define JUDGED(self, function, ...) plant_is_good(self, #function, (self)->call.function((self)->slave, __VA_ARGS__))
#define JUDGED_PLAIN(self, function) plant_is_good(self, #function, (self)->call.function((self)->slave))
static inline bool plant_is_good(Plant *self, const char *function, fmi2Status status)
{
    return status == fmi2OK || status == fmi2Warning || plant_judge(self, function, status);
}

/* plant_library.c: the platform's loader. The path is in UTF-8; `words` takes the loader's. */
void *plant_library_open(const char *path, char *words, size_t n_words);
void *plant_library_symbol(void *library, const char *name);
void plant_library_close(void *library);
const char *plant_library_path(void);

/* plant_location.c: a URI or a path, and back. The strings are from `allocate`; NULL where there is no memory. */
char *plant_folder(const char *resources, fmi2CallbackAllocateMemory allocate);
char *plant_location(const char *folder, const char *inside, fmi2CallbackAllocateMemory allocate);

/* plant_functions.c: what CasADi's code calls, (x, u, known p, unknown p, t) -> derivatives or outputs, and the derivative
   of these in a direction. Non-zero: the plant can't be asked any more. */
int plant_rate(const double **arguments, double **results, int *iw, double *w, int memory);
int plant_measure(const double **arguments, double **results, int *iw, double *w, int memory);
int fwd1_plant_rate(const double **arguments, double **results, int *iw, double *w, int memory);
int fwd1_plant_measure(const double **arguments, double **results, int *iw, double *w, int memory);

END_INTERNAL

#endif
