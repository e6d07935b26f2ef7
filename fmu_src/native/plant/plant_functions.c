/* What CasADi's code calls: rates and outputs of the plant at a point, and their derivatives in a direction.

   A point that the plant refuses, or that is no number, gives NaN: the observer takes it as it takes a model that is not
   defined there. */
#include <math.h>
#include <string.h>

#include "plant.h"

#define STEP 6e-6 /* of a value, or of its nominal one: the cube root of the rounding error */
#define ALIKE 100 /* variables whose steps are within this factor of each other can move together */

typedef enum { X, U, KNOWN, UNKNOWN, TIME, RESULT, SEED_X, SEED_U, SEED_KNOWN, SEED_UNKNOWN, SEED_TIME } Argument;

typedef struct {
    size_t n;                     /* results */
    const fmi2ValueReference *of; /* what a directional derivative is asked of */
    bool directional;
    bool is_rate;
} Result;

static Result rate_result(void)
{
    Result result = {plant_tables.n_states, plant_tables.derivatives, plant_tables.directional_rate != 0, true};
    return result;
}

static Result measure_result(void)
{
    Result result = {plant_tables.n_outputs, plant_tables.outputs, plant_tables.directional_measure != 0, false};
    return result;
}

static void fill(double *values, size_t n, double value)
{
    for (size_t i = 0; i < n; i++)
        values[i] = value;
}

/* CasADi hands in a null pointer for a vector of zeros. */
static void copy(double *to, const double *from, size_t n)
{
    if (n > 0 && from)
        memcpy(to, from, n * sizeof *to);
    else
        fill(to, n, 0);
}

static bool are_finite(const double *values, size_t n)
{
    double sum = 0;
    for (size_t i = 0; i < n; i++)
        sum += 0 * values[i];
    return sum == 0;
}

/* The results there; NaN where there are none. */
static void answer(Plant *self, const Result *result, const Point *point, double *to)
{
    double t = point->t;
    bool good = are_finite(point->x, plant_tables.n_states) && are_finite(point->u, plant_tables.n_inputs) && are_finite(&t, 1) &&
                plant_set(self, point);
    if (good && result->is_rate)
        good = JUDGED(self, fmi2GetDerivatives, to, result->n);
    else if (good)
        good = JUDGED(self, fmi2GetReal, result->of, result->n, to);
    if (!good)
        fill(to, result->n, NAN);
}

/* At states, inputs and parameters that follow each other. */
static Point point_of(const double *v, double t)
{
    const PlantTables *k = &plant_tables;
    const double *u = v + k->n_states, *known = u + k->n_inputs;
    Point point = {v, u, known, known + k->n_known, t};
    return point;
}

static int evaluate(const Result *result, const double **arguments, double *to)
{
    Plant *self = plant_current;
    if (!self || self->dead)
        return 1;
    if (!to)
        return 0;
    Point point = {arguments[X], arguments[U], arguments[KNOWN], arguments[UNKNOWN],
                   arguments[TIME] ? *arguments[TIME] : 0};
    const double **groups[] = {&point.x, &point.u, &point.known, &point.unknown};
    for (int i = 0; i < 4; i++)
        if (!*groups[i])
            *groups[i] = self->zeros;
    answer(self, result, &point, to);
    return self->dead;
}

/* One direction of a derivative by differences: the variable `only`, or with n all that have a seed. */
typedef struct {
    const double *point, *seed;
    size_t first, end; /* the variables that move */
    double step;
} Direction;

static void beside(Plant *self, const Result *result, const Direction *d, double t, double step, double *to)
{
    size_t n = plant_tables.n_states + plant_tables.n_inputs + plant_tables.n_parameters;
    memcpy(self->moved, d->point, n * sizeof(double));
    for (size_t i = d->first; i < d->end; i++)
        self->moved[i] += step * d->seed[i];
    Point point = point_of(self->moved, t);
    answer(self, result, &point, to);
}

/* Central where both sides have results, else to the side that has. */
static void add_difference(Plant *self, const Result *result, const Direction *d, double t, const double *here,
                           double *sum)
{
    double *above = self->beside, *below = above + result->n;
    beside(self, result, d, t, d->step, above);
    beside(self, result, d, t, -d->step, below);
    bool up = are_finite(above, result->n), down = are_finite(below, result->n);
    for (size_t i = 0; i < result->n; i++) {
        double high = up ? above[i] : here[i], low = down ? below[i] : here[i];
        sum[i] += up || down ? (high - low) / ((up && down ? 2 : 1) * d->step) : NAN;
    }
}

/* Variables [first, end) of the point, each by itself or, where their steps are alike, together. */
static void add_differences(Plant *self, const Result *result, Direction d, double t, const double *here, double *sum)
{
    double least = 0, most = 0;
    for (size_t i = d.first; i < d.end; i++) {
        if (d.seed[i] != 0) {
            double step = STEP * fmax(fabs(d.point[i]), plant_tables.nominals[i]) / fabs(d.seed[i]);
            least = least == 0 ? step : fmin(least, step);
            most = fmax(most, step);
        }
    }
    if (most == 0)
        return;
    if (most <= ALIKE * least) {
        d.step = least;
        add_difference(self, result, &d, t, here, sum);
        return;
    }
    for (size_t i = d.first, end = d.end; i < end; i++) {
        if (d.seed[i] == 0)
            continue;
        d.first = i;
        d.end = i + 1;
        d.step = STEP * fmax(fabs(d.point[i]), plant_tables.nominals[i]) / fabs(d.seed[i]);
        add_difference(self, result, &d, t, here, sum);
    }
}

/* By time, which must not go behind the beginning: there to the later side, of second order too. */
static void add_time(Plant *self, const Result *result, const double *point, double t, double seed, const double *here,
                     double *sum)
{
    double step = STEP * fmax(fabs(t), 1);
    double *one = self->beside, *two = one + result->n;
    bool central = t - step >= self->origin;
    Point later = point_of(point, t + step), other = point_of(point, central ? t - step : t + 2 * step);
    answer(self, result, &later, one);
    answer(self, result, &other, two);
    for (size_t i = 0; i < result->n; i++)
        sum[i] += seed * (central ? one[i] - two[i] : 4 * one[i] - 3 * here[i] - two[i]) / (2 * step);
}

/* By the plant itself, in the direction of the seeds of states and inputs. */
static void add_directional(Plant *self, const Result *result, const double *point, double t, double *sum)
{
    const PlantTables *k = &plant_tables;
    size_t driven = k->n_states + k->n_inputs;
    double *to = self->beside;
    Point at = point_of(point, t);
    bool good = are_finite(point, driven) && are_finite(&t, 1) && plant_set(self, &at);
    if (good)
        good = JUDGED(self, fmi2GetDirectionalDerivative, result->of, result->n, k->driven, driven, self->seeds, to);
    for (size_t i = 0; i < result->n; i++)
        sum[i] += good ? to[i] : NAN;
}

static int differentiate(const Result *result, const double **arguments, double *to)
{
    Plant *self = plant_current;
    const PlantTables *k = &plant_tables;
    if (!self || self->dead)
        return 1;
    if (!to)
        return 0;
    size_t driven = k->n_states + k->n_inputs, n = driven + k->n_parameters;
    double *point = self->point, *seed = self->seeds;
    const size_t sizes[] = {k->n_states, k->n_inputs, k->n_known, k->n_parameters - k->n_known};
    for (size_t i = 0, first = 0; i < 4; first += sizes[i], i++) {
        copy(point + first, arguments[X + i], sizes[i]);
        copy(seed + first, arguments[SEED_X + i], sizes[i]);
    }
    double t = arguments[TIME] ? *arguments[TIME] : 0, seed_t = arguments[SEED_TIME] ? *arguments[SEED_TIME] : 0;
    double *here = self->beside + 2 * result->n;
    fill(to, result->n, 0);
    bool moves = false;
    for (size_t i = 0; i < driven; i++)
        moves = moves || seed[i] != 0;
    if (moves && result->directional)
        add_directional(self, result, point, t, to);
    /* The result at the point, which CasADi has. */
    copy(here, arguments[RESULT], result->n);
    Direction d = {point, seed, result->directional ? driven : 0, n, 0};
    add_differences(self, result, d, t, here, to);
    if (seed_t != 0)
        add_time(self, result, point, t, seed_t, here, to);
    return self->dead;
}

int plant_rate(const double **arguments, double **results, int *iw, double *w, int memory)
{
    (void)iw;
    (void)w;
    (void)memory;
    Result result = rate_result();
    return evaluate(&result, arguments, results[0]);
}

int plant_measure(const double **arguments, double **results, int *iw, double *w, int memory)
{
    (void)iw;
    (void)w;
    (void)memory;
    Result result = measure_result();
    return evaluate(&result, arguments, results[0]);
}

int fwd1_plant_rate(const double **arguments, double **results, int *iw, double *w, int memory)
{
    (void)iw;
    (void)w;
    (void)memory;
    Result result = rate_result();
    return differentiate(&result, arguments, results[0]);
}

int fwd1_plant_measure(const double **arguments, double **results, int *iw, double *w, int memory)
{
    (void)iw;
    (void)w;
    (void)memory;
    Result result = measure_result();
    return differentiate(&result, arguments, results[0]);
}
