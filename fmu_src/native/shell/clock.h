/* The clock of a run: a position in units of the sample time, or of one second where there is none. */
#ifndef CLOCK_H
#define CLOCK_H

#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stdint.h>

#include "prefix.h"

#define clock_at PREFIX(clock_at)
#define clock_after PREFIX(clock_after)
#define clock_error PREFIX(clock_error)
#define clock_is_sound PREFIX(clock_is_sound)

#define NANOSECONDS 1e9 /* times between sample instants are counted in these */
#define SNAP 1e-6       /* relative: steps closer than this are the same; of a sample time or of a second: instants are */
#define SHORTEST_SAMPLE_TIME 1e-6    /* [s]; 1000 nanoseconds: below, their rounding is no longer small */
#define RESOLUTION (4 * DBL_EPSILON) /* of a time: what two importers' sums for it may differ by */
#define COARSE 0.01                  /* of a sample time: where RESOLUTION exceeds this, instants cannot be told apart */

/* Eight bytes each, so that a serialised state has no padding. */
typedef struct {
    int64_t whole;      /* units since t0 */
    int64_t steps;      /* taken so far */
    double t0;          /* [s] */
    double sample_time; /* [s], the unit; 0: the unit is 1 s */
    double label;       /* the t that the importer's next step should have [s] */
    double phase;       /* of the next unit, in [0, 1) */
    double carry;       /* what the end of the last step was moved by [units] */
    double step;        /* length of the last step [s] */
    double elapsed;     /* since t0 [s], to whole nanoseconds between sample instants: what whole and phase say */
} Clock;

BEGIN_INTERNAL

Clock clock_at(double t0, double sample_time);

/* [s] */
static inline double clock_time(const Clock *clock)
{
    return clock->t0 + clock->elapsed;
}

/* Sample instants before this one: the next is t0 + ticks * sample_time. */
static inline int64_t clock_ticks(const Clock *clock)
{
    if (clock->sample_time == 0)
        return 0;
    return clock->phase > 0 ? clock->whole + 1 : clock->whole;
}

/* The clock after a step of h that the importer says begins at t. False where it does not count that far. */
bool clock_after(const Clock *clock, double t, double h, Clock *after);

/* By how many steps of h the label t is wrong; 0 if it is not. */
double clock_error(const Clock *clock, double t, double h);

/* Can this be a clock? Bytes that claim to be one may hold anything. */
bool clock_is_sound(const Clock *clock);

END_INTERNAL

#endif
