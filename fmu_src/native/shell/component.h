/* What the shell knows of the component: tables and functions, generated for each FMU (component.c, functions.c). */
#ifndef COMPONENT_H
#define COMPONENT_H

#include <stdbool.h>
#include <stddef.h>

#include "fmi2Functions.h"
#include "prefix.h"

/* Like fmi2Functions.h does with the standard's names: so that several FMUs fit into one program. */
#define component PREFIX(component)

/* A function that CasADi wrote: columns of doubles in, columns of doubles out, never in place. Non-zero: it could not
   be evaluated. */
typedef int Function(const double **arguments, double **results, int *iw, double *w, int memory);

typedef enum { INPUT, FIXED_PARAMETER, TUNABLE_PARAMETER, OUTPUT, CONSTANT } Role;
typedef enum { REAL, INTEGER, BOOLEAN } Type;

typedef struct {
    const char *name;
    Role role;
    Type type;
    double start, min, max;
} Variable;

/* Why a motion cannot go on. */
typedef struct {
    const char *what;
    const char *measure; /* the name of the number that tells */
} Failure;

/* A plant that exists only as an FMU, which the component's functions call: what the shell does with it. */
typedef struct {
    /* The plant that lies in the importer's resources, or NULL, and why in `words`. */
    void *(*open)(const char *resources, const char *name, const fmi2CallbackFunctions *callbacks, bool logging,
                  void (*listen)(void *listener, fmi2Status status, const char *text), void *listener, char *words,
                  size_t n_words);
    bool (*begin)(void *plant, double t0);   /* a run, at t0 [s] */
    void (*enter)(void *plant);              /* the functions called next are its owner's */
    const char *(*words)(const void *plant); /* what it last failed in */
    void (*close)(void *plant);
} PlantCalls;

typedef struct {
    const char *name;
    const char *guid;
    const Variable *variables; /* by value reference: inputs, parameters, outputs, constants */
    size_t n_inputs, n_parameters, n_outputs, n_constants;
    size_t n_states;
    double sample_time;        /* [s], 0: no sample instants */
    int sample_time_parameter; /* the fixed parameter that holds it instead, or -1 */
    int samples_inputs;        /* a step longer than the sample time would lose samples */
    double max_step;           /* the longest h that flow is called with [s] */
    const size_t *breaks;      /* parameters that hold times at which flow is cut */
    size_t n_breaks;
    const size_t *counters; /* outputs that count troubles, from 0 */
    size_t n_counters;
    const Failure *failures; /* by code from 1; (code, time, measure) are then the last three states, code 0: none */
    size_t n_failures;
    const PlantCalls *plant;            /* or NULL */
    Function *start;                    /* (p, t0) -> z */
    Function *flow;                     /* (z, u, p, t, h) -> z */
    Function *jump;                     /* (z, u, p, t) -> z, or NULL */
    Function *output;                   /* (z, u, p, t) -> y */
    size_t sz_arg, sz_res, sz_iw, sz_w; /* the work space that the largest of them needs */
} Component;

BEGIN_INTERNAL
extern const Component component;
END_INTERNAL

#endif
