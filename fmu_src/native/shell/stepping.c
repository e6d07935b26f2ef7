/* fmi2DoStep: from t to t + h. Every sample instant in [t, t + h) jumps with the inputs set before the step, then the
   state flows to t + h. Times within a step are counted from t0 [s]. */
#include <math.h>
#include <string.h>

#include "border.h"

#define MOST_SUBSTEPS 1e6 /* in one step: nothing can interrupt them */

/* The inputs at time s within the step: as set, or extrapolated with the derivatives that were set for this step. */
static const double *inputs_at(Instance *self, double s)
{
    if (!self->run.extrapolates)
        return self->u;
    for (size_t i = 0; i < component.n_inputs; i++)
        self->u_now[i] = self->u[i] + self->du[i] * (s - self->run.clock.elapsed);
    return self->u_now;
}

/* z: the state, `other`: where the next one goes; swapped after every call, so that no function runs in place. */
typedef struct {
    double *z, *other;
} Pair;

static bool move(Instance *self, Pair *pair, Function *function, const double *u, double t, double h)
{
    self->arg[0] = pair->z;
    self->arg[1] = u;
    self->arg[2] = self->p;
    self->arg[3] = &t;
    self->arg[4] = &h; /* jump does not read it */
    self->res[0] = pair->other;
    if (call(self, function) != 0) {
        report(self, fmi2Error, LOG_ERROR, "%s: %s could not be evaluated at t = %.15g%s.", component.name,
               function == component.flow ? "the motion" : "the sample", t, plant_trouble(self));
        return false;
    }
    double *swap = pair->z == self->z ? self->scratch[1] : pair->z; /* the committed state stays as it is */
    pair->z = pair->other;
    pair->other = swap;
    return true;
}

/* Inputs that change over a substep are held over each half of it, at what they are after one and after five sixths: their integral and
   first moment are exact then, and the motion is of order 4 in the substep. */
static bool flow(Instance *self, Pair *pair, double start, double end)
{
    double substeps = fmax(1, ceil((end - start) / component.max_step - SNAP));
    double h = (end - start) / substeps, part = self->run.extrapolates ? h / 2 : h;
    for (double i = 0; i < substeps; i++) {
        double s = start + i * h, t = self->run.clock.t0 + s;
        if (!move(self, pair, component.flow, inputs_at(self, s + h / 6), t, part))
            return false;
        if (self->run.extrapolates && !move(self, pair, component.flow, inputs_at(self, s + h * 5 / 6), t + part, part))
            return false;
    }
    return true;
}

/* As flow, cut at the breaks. */
static bool flow_in_pieces(Instance *self, Pair *pair, double start, double end)
{
    for (size_t i = 0; i < component.n_breaks; i++) {
        double instant = self->breaks[i];
        if (start + 1 / NANOSECONDS < instant && instant < end - 1 / NANOSECONDS) {
            if (!flow(self, pair, start, instant))
                return false;
            start = instant;
        }
    }
    return flow(self, pair, start, end);
}

/* Moves the pair from the instance's clock to `after`. */
static bool advance(Instance *self, Pair *pair, const Clock *after)
{
    const Clock *clock = &self->run.clock;
    double now = clock->elapsed;
    int64_t end = clock_ticks(after);
    for (int64_t k = clock_ticks(clock); k < end; k++) {
        double tick = (double)k * clock->sample_time;
        if (tick > now) {
            if (!flow_in_pieces(self, pair, now, tick))
                return false;
            now = tick;
        }
        if (component.jump && !move(self, pair, component.jump, inputs_at(self, tick), clock->t0 + tick, 0))
            return false;
    }
    return flow_in_pieces(self, pair, now, after->elapsed);
}

/* The clock after the step, if the step is legal. */
static bool legal_step(Instance *self, double t, double h, Clock *after)
{
    const Clock *clock = &self->run.clock;
    const char *name = component.name;
    double ts = clock->sample_time, stop = self->run.stop_time;
    if (!(isfinite(h) && h > 0)) {
        report(self, fmi2Error, LOG_ERROR, "%s: step size h = %.10g must be positive.", name, h);
        return false;
    }
    double off = clock_error(clock, t, h);
    if (off != 0) {
        report(self, fmi2Error, LOG_ERROR,
               "%s: step from t = %.15g, but the current time is %.15g (%.15g by the count of steps): off by %.3g steps "
               "of %.10g.",
               name, t, clock->label, clock_time(clock), off, h);
        return false;
    }
    double rounding = RESOLUTION * fabs(t + h);
    if (component.samples_inputs && ts > 0 && h > ts * (1 + SNAP) + rounding) {
        report(self, fmi2Error, LOG_ERROR, "%s: step size h = %.10g exceeds the sample time %.10g.", name, h, ts);
        return false;
    }
    bool blurs_ticks = ts > 0 && rounding > COARSE * ts;
    if (blurs_ticks || rounding > h / 2) {
        report(self, fmi2Error, LOG_ERROR, "%s: at t = %.15g times are exact to %.2g s only, too coarse for the %s %.10g.",
               name, t + h, rounding, blurs_ticks ? "sample time" : "step size", blurs_ticks ? ts : h);
        return false;
    }
    if (!clock_after(clock, t, h, after)) {
        report(self, fmi2Error, LOG_ERROR, "%s: a step to t = %.15g is impossible from the current time %.15g.", name,
               t + h, clock_time(clock));
        return false;
    }
    if (self->run.stop_time_defined) {
        double end = fmin(t + h, clock_time(after));
        if (end > stop + fmax(fmax(SNAP * fmin(ts, 1), 1 / NANOSECONDS), RESOLUTION * fabs(stop))) {
            report(self, fmi2Error, LOG_ERROR, "%s: the step from t = %.15g to %.15g goes beyond the stop time %.15g.",
                   name, t, end, stop);
            return false;
        }
    }
    double needed = h / component.max_step + (double)(clock_ticks(after) - clock_ticks(clock));
    if (needed > MOST_SUBSTEPS) {
        report(self, fmi2Error, LOG_ERROR,
               "%s: a step of h = %.10g takes %.3g substeps (max_step = %.10g, sample time %.10g), and no more than "
               "%.0f are taken at once: nothing could interrupt them.",
               name, h, needed, component.max_step, ts, MOST_SUBSTEPS);
        return false;
    }
    return true;
}

/* One warning for each counter that rose in the step. The step is fine and returns fmi2OK: importers stop at less. */
static void warn_of_counters(Instance *self)
{
    for (size_t i = 0; i < component.n_counters; i++) {
        double count = self->y[component.counters[i]];
        if (count == self->counts[i])
            continue;
        if (count > self->counts[i])
            report(self, fmi2Warning, LOG_WARNING, "%s: %s rose to %.10g at t = %.15g.", component.name,
                   component.variables[component.n_inputs + component.n_parameters + component.counters[i]].name, count,
                   clock_time(&self->run.clock));
        self->counts[i] = count;
    }
}

/* Says why the state after the step is none. */
static void report_state(Instance *self, const double *z, double t, double end)
{
    double value;
    const char *input = bad_input(self, &value);
    if (input)
        report(self, fmi2Error, LOG_ERROR,
               "%s: the state is not finite after the step from t = %.15g to %.15g, where the input %s is %g.",
               component.name, t, end, input, value);
    else if (has_failed(z))
        report_failure(self, z, "");
    else if (component.max_step < DBL_MAX)
        report(self, fmi2Error, LOG_ERROR,
               "%s: the state is not finite after the step from t = %.15g to %.15g; a model that is stiff there wants a "
               "smaller max_step than %.10g.",
               component.name, t, end, component.max_step);
    else
        report(self, fmi2Error, LOG_ERROR, "%s: the state is not finite after the step from t = %.15g to %.15g.",
               component.name, t, end);
}

fmi2Status do_step(Instance *self, double t, double h)
{
    if (!allowed(self, "fmi2DoStep", STEP_COMPLETE))
        return fmi2Error;
    Run *run = &self->run;
    Clock after;
    if (!legal_step(self, t, h, &after))
        return fmi2Error;
    Pair pair = {self->z, self->scratch[0]};
    if (!advance(self, &pair, &after))
        return fmi2Error;
    double end = clock_time(&after);
    if (has_failed(pair.z) || !all_finite(pair.z, component.n_states)) {
        report_state(self, pair.z, t, end);
        return fmi2Error;
    }
    if (!evaluate_outputs(self, pair.z, end))
        return fmi2Error;
    self->scratch[0] = self->z; /* commit: pair.z is one of the scratch vectors, pair.other the other */
    self->scratch[1] = pair.other;
    self->z = pair.z;
    run->clock = after;
    if (run->extrapolates) {
        memset(self->du, 0, component.n_inputs * sizeof *self->du);
        run->extrapolates = 0;
    }
    warn_of_counters(self);
    return fmi2OK;
}
