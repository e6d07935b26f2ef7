/* What time it is in a run: counted in sample times, whatever the importer calls it; in the arithmetic of
   observers/clock.py, which says why, operation for operation. */
#include <float.h>
#include <math.h>

#include "clock.h"

#define ROUNDING 1e-10                /* of a unit: what sums of fractions of it may be off by */
#define SIMPLE 1e4                    /* the largest product of numerator and denominator of a simple fraction */
#define LARGEST 9007199254740992.0    /* units, 2^53: beyond, doubles do not count */

Clock clock_at(double t0, double sample_time)
{
    Clock clock = {0, 0, t0, sample_time, t0, 0, 0, 0, 0};
    return clock;
}

static double unit_of(const Clock *clock)
{
    return clock->sample_time > 0 ? clock->sample_time : 1;
}

static double elapsed(const Clock *clock)
{
    double unit = unit_of(clock), last = (double)clock->whole * unit;
    if (clock->phase == 0)
        return last;
    double rounded = rint(((double)clock->whole + clock->phase) * unit * NANOSECONDS) / NANOSECONDS;
    return fmin(fmax(rounded, last), (double)(clock->whole + 1) * unit);
}

/* How far the end of a step may lie from a sample instant and still be it, whatever the size of times [units]. */
static double slack(const Clock *clock)
{
    double ts = clock->sample_time;
    return ts > 0 ? fmax(fmin(SNAP, SNAP / ts), ROUNDING) : ROUNDING;
}

/* The first convergent of x's continued fraction within the tolerance, if it is a simple fraction; else 0. */
static double simplest(double x, double tolerance)
{
    double p = 1, q = 0, before_p = 0, before_q = 1, rest = x;
    for (;;) {
        double whole = floor(rest), next_p = whole * p + before_p, next_q = whole * q + before_q;
        before_p = p, before_q = q, p = next_p, q = next_q;
        if (p * q > SIMPLE)
            return 0;
        if (fabs(x - p / q) <= tolerance)
            return p / q;
        if (rest == whole)
            return 0;
        rest = 1 / (rest - whole);
    }
}

/* h in units, rounded to what it most likely means. */
static double share_of(const Clock *clock, double t, double h)
{
    bool sampled = clock->sample_time > 0;
    double unit = unit_of(clock), x = h / unit;
    if (sampled && fabs(x - 1) <= SNAP * x)
        return 1; /* what `simplest` says, sooner */
    double noise = RESOLUTION / 2 * fabs(t + h) / unit; /* h may be a difference of times, each a rounded sum */
    double simple = simplest(x, sampled ? SNAP * x : fmin(SNAP * x, 1 / NANOSECONDS + noise));
    if (simple > 0)
        return simple;
    double near;
    if (sampled) {
        near = x >= 1 ? rint(x) : 1 / rint(1 / x);
    } else {
        near = rint(x * NANOSECONDS) / NANOSECONDS;
        noise = fmin(SNAP * x, noise);
    }
    return fabs(x - near) <= noise ? near : x;
}

bool clock_after(const Clock *clock, double t, double h, Clock *after)
{
    double share = share_of(clock, t, h), sum = clock->phase + clock->carry + share;
    if (!(fabs((double)clock->whole + sum) < LARGEST))
        return false;
    double near = rint(sum), rest = sum - near, unit = unit_of(clock);
    *after = *clock;
    after->steps++;
    after->label = t + h;
    after->step = h;
    if (rest == 0) { /* nearly always: on an instant */
        after->whole += (int64_t)near;
        after->phase = after->carry = 0;
        after->elapsed = (double)after->whole * unit;
        return true;
    }
    double carried = clock->sample_time > 0 ? RESOLUTION * fabs(t) / unit : 0;
    if (fabs(rest) <= fmin(fmax(slack(clock), carried), share / 2)) {
        after->whole += (int64_t)near;
        after->phase = 0;
        after->carry = fabs(rest) > slack(clock) ? rest : 0;
    } else {
        double whole = floor(sum);
        after->whole += (int64_t)whole;
        after->phase = sum - whole;
        after->carry = 0;
    }
    after->elapsed = elapsed(after);
    return true;
}

double clock_error(const Clock *clock, double t, double h)
{
    double known = clock->steps > 0 ? fmin(h, clock->step) : h, rounding = RESOLUTION * fabs(t);
    double off = t - clock->label;
    if (!(fabs(off) <= fmax(fmax(known / 2, 1 / NANOSECONDS), rounding)))
        return off / h;
    off = t - clock_time(clock);
    if (!(fabs(off) <= fmax(h / 2, 1 / NANOSECONDS) + SNAP * clock->elapsed + (double)(clock->steps + 1) * rounding))
        return off / h;
    return 0;
}

bool clock_is_sound(const Clock *clock)
{
    return clock->steps >= 0 && (double)clock->steps < LARGEST && clock->whole >= 0 && (double)clock->whole < LARGEST &&
           clock->phase >= 0 && clock->phase < 1 && fabs(clock->carry) <= COARSE && isfinite(clock->t0) &&
           isfinite(clock->label) && isfinite(clock->step) && clock->step >= 0 &&
           (clock->step > 0) == (clock->steps > 0) &&
           (clock->sample_time == 0 || (clock->sample_time >= SHORTEST_SAMPLE_TIME && isfinite(clock->sample_time))) &&
           clock->elapsed == elapsed(clock) && isfinite(clock_time(clock));
}
