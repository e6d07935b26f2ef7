/* fmi2DoStep: from t to t + h. Every sample instant in [t, t + h) jumps with the inputs set before the step, then the
   state flows to t + h.

   Time is counted, never accumulated: sample instants are t0 + k Ts, and every time that the importer hands in is
   snapped first to whole nanoseconds and then to a sample instant nearby, so that importers which accumulate, multiply
   or round times get identical bits. */
#include <math.h>
#include <string.h>

#include "instance.h"

/* How far two times at about t may lie apart and still be the same. */
static double tolerance(const Run *run, double t)
{
    return fmax(fmax(SNAP * fmin(run->sample_time, 1), 1 / NANOSECONDS), RESOLUTION * fabs(t));
}

static double snap(const Run *run, double t)
{
    t = run->t0 + rint((t - run->t0) * NANOSECONDS) / NANOSECONDS;
    if (run->sample_time > 0) {
        double instant = run->t0 + rint((t - run->t0) / run->sample_time) * run->sample_time;
        if (fabs(t - instant) <= tolerance(run, t))
            return instant;
    }
    return t;
}

/* The inputs at time t within the step: as set, or extrapolated with the derivatives that were set for this step. */
static const double *inputs_at(Instance *self, double t)
{
    if (!self->run.extrapolates)
        return self->u;
    for (size_t i = 0; i < component.n_inputs; i++)
        self->u_now[i] = self->u[i] + self->du[i] * (t - self->run.time);
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
    if (function(self->arg, self->res, self->iw, self->w, 0) != 0) {
        report(self, fmi2Error, LOG_ERROR, "%s: %s could not be evaluated at t = %.15g.", component.name,
               function == component.flow ? "the motion" : "the sample", t);
        return false;
    }
    double *swap = pair->z == self->z ? self->scratch[1] : pair->z; /* the committed state stays as it is */
    pair->z = pair->other;
    pair->other = swap;
    return true;
}

static bool flow(Instance *self, Pair *pair, double start, double end)
{
    double substeps = fmax(1, ceil((end - start) / component.max_step - SNAP));
    double h = (end - start) / substeps;
    for (double i = 0; i < substeps; i++) {
        double t = start + i * h;
        if (!move(self, pair, component.flow, inputs_at(self, t + h / 2), t, h))
            return false;
    }
    return true;
}

/* Moves the pair from run.time to `end` and counts the ticks on the way. */
static bool advance(Instance *self, Pair *pair, double end, int64_t *ticks)
{
    const Run *run = &self->run;
    double now = run->time, slack = tolerance(run, end);
    for (;;) {
        double tick = run->sample_time > 0 ? run->t0 + (double)*ticks * run->sample_time : HUGE_VAL;
        bool due = tick < end - slack;
        if (due && tick <= now + slack) {
            if (component.jump && !move(self, pair, component.jump, inputs_at(self, tick), tick, 0))
                return false;
            ++*ticks;
            continue;
        }
        double until = due ? tick : end;
        for (size_t i = 0; i < component.n_breaks; i++) {
            if (now + 1 / NANOSECONDS < self->breaks[i] && self->breaks[i] < until - 1 / NANOSECONDS) {
                until = self->breaks[i];
                break;
            }
        }
        if (!flow(self, pair, now, until))
            return false;
        now = until;
        if (!due && until == end)
            return true;
    }
}

static bool legal_step(Instance *self, double t, double h, double end)
{
    const Run *run = &self->run;
    if (!(isfinite(h) && h > 0)) {
        report(self, fmi2Error, LOG_ERROR, "%s: step size h = %.10g must be positive.", component.name, h);
        return false;
    }
    if (!(fabs(t - run->time) <= tolerance(run, run->time))) {
        report(self, fmi2Error, LOG_ERROR, "%s: step from t = %.15g, but the current time is %.15g.", component.name, t,
               run->time);
        return false;
    }
    if (component.samples_inputs && run->sample_time > 0 && h > run->sample_time * (1 + SNAP)) {
        report(self, fmi2Error, LOG_ERROR, "%s: step size h = %.10g exceeds the sample time %.10g.", component.name, h,
               run->sample_time);
        return false;
    }
    if (run->stop_time_defined && end > run->stop_time + tolerance(run, run->stop_time)) {
        report(self, fmi2Error, LOG_ERROR, "%s: the step from t = %.15g to %.15g goes beyond the stop time %.15g.",
               component.name, t, end, run->stop_time);
        return false;
    }
    if (!(end >= run->time && isfinite(end))) {
        report(self, fmi2Error, LOG_ERROR, "%s: a step to t = %.15g is impossible from the current time %.15g.",
               component.name, end, run->time);
        return false;
    }
    if (run->sample_time > 0 && RESOLUTION * fabs(end) > COARSE * run->sample_time) {
        report(self, fmi2Error, LOG_ERROR,
               "%s: at t = %.15g times are exact to %.2g s only, too coarse for the sample time %.10g.", component.name,
               end, RESOLUTION * fabs(end), run->sample_time);
        return false;
    }
    return true;
}

/* One warning for each counter that rose in the step. The step is fine and returns fmi2OK: importers stop at less. */
static void warn_of_counters(Instance *self)
{
    for (size_t i = 0; i < component.n_counters; i++) {
        double count = self->y[component.counters[i]];
        if (count > self->counts[i])
            report(self, fmi2Warning, LOG_WARNING, "%s: %s rose to %.10g at t = %.15g.", component.name,
                   component.variables[component.n_inputs + component.n_parameters + component.counters[i]].name, count,
                   self->run.time);
        self->counts[i] = count;
    }
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    Instance *self = c;
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!allowed(self, "fmi2DoStep", STEP_COMPLETE))
        return fmi2Error;
    Run *run = &self->run;
    double end = snap(run, currentCommunicationPoint + communicationStepSize);
    if (!legal_step(self, currentCommunicationPoint, communicationStepSize, end))
        return fmi2Error;
    Pair pair = {self->z, self->scratch[0]};
    int64_t ticks = run->ticks;
    if (!advance(self, &pair, end, &ticks))
        return fmi2Error;
    bool failed = has_failed(pair.z);
    if (failed || !all_finite(pair.z, component.n_states)) {
        size_t i = 0;
        while (i < component.n_inputs && isfinite(self->u[i]))
            i++;
        if (i < component.n_inputs)
            report(self, fmi2Error, LOG_ERROR,
                   "%s: the state is not finite after the step from t = %.15g to %.15g, where the input %s is %g.",
                   component.name, currentCommunicationPoint, end, component.variables[i].name, self->u[i]);
        else if (failed)
            report_failure(self, pair.z, "");
        else
            report(self, fmi2Error, LOG_ERROR, "%s: the state is not finite after the step from t = %.15g to %.15g.",
                   component.name, currentCommunicationPoint, end);
        return fmi2Error;
    }
    /* The counters are looked at in every step; otherwise the outputs wait until somebody asks. */
    if (component.n_counters == 0)
        self->stale_outputs = true;
    else if (!evaluate_outputs(self, pair.z, end))
        return fmi2Error;
    self->scratch[0] = self->z; /* commit: pair.z is one of the scratch vectors, pair.other the other */
    self->scratch[1] = pair.other;
    self->z = pair.z;
    run->time = end;
    run->ticks = ticks;
    if (run->extrapolates) {
        memset(self->du, 0, component.n_inputs * sizeof *self->du);
        run->extrapolates = 0;
    }
    warn_of_counters(self);
    return fmi2OK;
}
