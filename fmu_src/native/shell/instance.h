/* One instance of the FMU: everything it owns, and what the shell's files offer each other.

   After a call that returns fmi2Error the instance is where it was before the call: the standard would let it enter a
   state "error" that only fmi2Reset leaves, but here nothing has changed, so the importer may correct the call and go
   on. */
#ifndef INSTANCE_H
#define INSTANCE_H

#include <stdbool.h>
#include <stdint.h>

#include "clock.h"
#include "component.h"
#include "fmi2Functions.h"

/* What the shell's files offer each other has the model's name in it; see component.h. */
#define report PREFIX(report)
#define allowed PREFIX(allowed)
#define set_defaults PREFIX(set_defaults)
#define refresh_start PREFIX(refresh_start)
#define evaluate_outputs PREFIX(evaluate_outputs)
#define refresh_outputs PREFIX(refresh_outputs)
#define all_finite PREFIX(all_finite)
#define has_failed PREFIX(has_failed)
#define report_failure PREFIX(report_failure)
#define call PREFIX(call)
#define plant_trouble PREFIX(plant_trouble)
#define bad_input PREFIX(bad_input)
#define shown PREFIX(shown)

typedef enum { INSTANTIATED = 1, INITIALIZATION = 2, STEP_COMPLETE = 4, TERMINATED = 8 } Lifecycle;
#define ANY_STATE (INSTANTIATED | INITIALIZATION | STEP_COMPLETE | TERMINATED)

typedef enum { LOG_ERROR = 1, LOG_WARNING = 2, LOG_DISCARD = 4, LOG_EVENTS = 8 } Category;
#define LOG_ALL (LOG_ERROR | LOG_WARNING | LOG_DISCARD | LOG_EVENTS)

/* Where the run is. Eight bytes each, so that a serialised state has no padding. */
typedef struct {
    int64_t lifecycle;
    int64_t is_set_up; /* fmi2SetupExperiment was called */
    int64_t stop_time_defined;
    int64_t extrapolates; /* input derivatives are set for the next step */
    double stop_time;
    Clock clock;
} Run;

typedef struct {
    fmi2CallbackFunctions callbacks;
    char *name;
    unsigned log_categories;
    unsigned first_categories; /* chosen at instantiation: those after a reset */
    Run run;
    bool stale_start;   /* z does not yet follow from the parameters (before and in initialization mode) */
    bool stale_outputs; /* y does not yet follow from z, u, p and time */
    bool finite_outputs;
    double *values;     /* by value reference: u, p, y, constants */
    double *u, *p, *y;  /* in `values` */
    double *du;         /* input derivatives */
    double *u_now;      /* inputs extrapolated to a time within the step */
    double *z;          /* the state at the clock's time */
    double *scratch[2]; /* doStep works here and swaps at its end */
    double *breaks;     /* since t0 [s], ascending */
    double *counts;     /* counters after the last step */
    void *plant;        /* where the component has one, or NULL */
    const double **arg;
    double **res;
    double *w;
    int *iw;
} Instance;

BEGIN_INTERNAL

/* logging.c */
#if defined __GNUC__
__attribute__((format(printf, 4, 5)))
#endif
void report(Instance *self, fmi2Status status, Category category, const char *format, ...);
bool allowed(Instance *self, const char *function, unsigned lifecycles);

/* evaluate.c */
int call(Instance *self, Function *function);
const char *plant_trouble(const Instance *self);
void set_defaults(Instance *self);
bool refresh_start(Instance *self);
bool evaluate_outputs(Instance *self, const double *z, double time);
bool refresh_outputs(Instance *self);
const char *bad_input(const Instance *self, double *value);
double shown(double value);
bool all_finite(const double *values, size_t n);
bool has_failed(const double *z);
void report_failure(Instance *self, const double *z, const char *occasion);

END_INTERNAL

#endif
