/* The values that follow from others: the start state from the parameters, the outputs from the state. */
#include <math.h>
#include <string.h>

#include "instance.h"

/* Everything as it is right after fmi2Instantiate. */
void set_defaults(Instance *self)
{
    size_t n = component.n_inputs + component.n_parameters + component.n_outputs + component.n_constants;
    for (size_t i = 0; i < n; i++)
        self->values[i] = component.variables[i].start;
    self->log_categories = self->first_categories;
    memset(&self->run, 0, sizeof self->run);
    self->run.lifecycle = INSTANTIATED;
    memset(self->du, 0, component.n_inputs * sizeof *self->du);
    memset(self->z, 0, component.n_states * sizeof *self->z);
    memset(self->breaks, 0, component.n_breaks * sizeof *self->breaks);
    memset(self->counts, 0, component.n_counters * sizeof *self->counts);
    self->stale_start = true; /* and the outputs with it */
}

/* The function on self->arg and self->res; non-zero where it could not be evaluated. */
int call(Instance *self, Function *function)
{
    if (component.plant)
        component.plant->enter(self->plant);
    return function(self->arg, self->res, self->iw, self->w, 0);
}

/* For the end of a message: what the plant failed in, if it is one that can fail. */
const char *plant_trouble(const Instance *self)
{
    return component.plant ? component.plant->words(self->plant) : "";
}

/* A number is not finite where all eleven bits of its exponent are set, so that one more overflows into the sign: without
   branches compilers look at several numbers at once. */
bool all_finite(const double *values, size_t n)
{
    const uint64_t exponent = UINT64_C(0x7ff0000000000000), one = UINT64_C(0x0010000000000000);
    uint64_t overflow = 0;
    for (size_t i = 0; i < n; i++) {
        uint64_t bits;
        memcpy(&bits, values + i, sizeof bits);
        overflow |= (bits & exponent) + one;
    }
    return !(overflow >> 63);
}

/* Whether the component says that its motion cannot go on; see component.h. */
bool has_failed(const double *z)
{
    return component.n_failures > 0 && z[component.n_states - 3] != 0;
}

void report_failure(Instance *self, const double *z, const char *occasion)
{
    const double *last = z + component.n_states - 3;
    if (!(last[0] >= 1 && last[0] <= (double)component.n_failures)) { /* none of the component's own */
        report(self, fmi2Error, LOG_ERROR, "%s: the motion ended with the unknown code %g%s.", component.name, last[0],
               occasion);
        return;
    }
    const Failure *failure = component.failures + (size_t)last[0] - 1;
    report(self, fmi2Error, LOG_ERROR, "%s: %s at t = %.10g, where %s is %.4g%s.", component.name, failure->what,
           last[1], failure->measure, last[2], occasion);
}

/* The clock and z = start(p, t0), unless they already follow from the parameters. False, with z as it was and a
   message, where start fails or the sample time is impossible. */
bool refresh_start(Instance *self)
{
    Run *run = &self->run;
    if (!self->stale_start)
        return true;
    int named = component.sample_time_parameter;
    double sample_time = named >= 0 ? self->p[named] : component.sample_time;
    if (!(sample_time == 0 || (sample_time >= SHORTEST_SAMPLE_TIME && isfinite(sample_time)))) {
        report(self, fmi2Error, LOG_ERROR, "%s: %s = %.10g must be 0 or finite and at least %g s.", component.name,
               named >= 0 ? component.variables[component.n_inputs + (size_t)named].name : "the sample time",
               sample_time, SHORTEST_SAMPLE_TIME);
        return false;
    }
    if (component.plant && !component.plant->begin(self->plant, run->clock.t0)) {
        report(self, fmi2Error, LOG_ERROR, "%s: the plant cannot be initialized at t = %.15g%s.", component.name,
               run->clock.t0, plant_trouble(self));
        return false;
    }
    self->arg[0] = self->p;
    self->arg[1] = &run->clock.t0;
    self->res[0] = self->scratch[0];
    int unevaluated = call(self, component.start);
    if (unevaluated == 0 && has_failed(self->scratch[0])) {
        report_failure(self, self->scratch[0], ", for the start values");
        return false;
    }
    if (unevaluated != 0 || !all_finite(self->scratch[0], component.n_states)) {
        report(self, fmi2Error, LOG_ERROR, "%s: the start values give no finite state at t = %.15g%s.", component.name,
               run->clock.t0, unevaluated ? plant_trouble(self) : "");
        return false;
    }
    double *z = self->z;
    self->z = self->scratch[0];
    self->scratch[0] = z;
    run->clock = clock_at(run->clock.t0, sample_time);
    for (size_t i = 0; i < component.n_breaks; i++) { /* insertion sort: a handful of times, once */
        double instant = self->p[component.breaks[i]] - run->clock.t0;
        size_t k = i;
        for (; k > 0 && self->breaks[k - 1] > instant; k--)
            self->breaks[k] = self->breaks[k - 1];
        self->breaks[k] = instant;
    }
    self->stale_start = false;
    self->stale_outputs = true;
    return true;
}

/* The value as messages show it: the sign of what is no number is chance. */
double shown(double value)
{
    return isnan(value) ? fabs(value) : value;
}

/* The name and value of an input that is not finite, or NULL. */
const char *bad_input(const Instance *self, double *value)
{
    for (size_t i = 0; i < component.n_inputs; i++) {
        if (!isfinite(self->u[i])) {
            *value = shown(self->u[i]);
            return component.variables[i].name;
        }
    }
    return NULL;
}

/* y = output(z, u, p, time). False, with a message, where it cannot be evaluated or is not finite though all inputs are;
   an input that is not may show in an output that it feeds. */
bool evaluate_outputs(Instance *self, const double *z, double time)
{
    self->arg[0] = z;
    self->arg[1] = self->u;
    self->arg[2] = self->p;
    self->arg[3] = &time;
    self->res[0] = self->y;
    self->stale_outputs = true; /* y is half written until it is not */
    if (call(self, component.output) != 0) {
        report(self, fmi2Error, LOG_ERROR, "%s: the outputs could not be evaluated at t = %.15g%s.", component.name,
               time, plant_trouble(self));
        return false;
    }
    double value;
    self->finite_outputs = all_finite(self->y, component.n_outputs);
    if (!self->finite_outputs && !bad_input(self, &value)) {
        size_t i = 0;
        while (isfinite(self->y[i]))
            i++;
        report(self, fmi2Error, LOG_ERROR, "%s: the output %s is %g at t = %.15g.", component.name,
               component.variables[component.n_inputs + component.n_parameters + i].name, shown(self->y[i]), time);
        return false;
    }
    self->stale_outputs = false;
    return true;
}

/* The outputs at the current time, unless they are up to date. */
bool refresh_outputs(Instance *self)
{
    return refresh_start(self) && (!self->stale_outputs || evaluate_outputs(self, self->z, clock_time(&self->run.clock)));
}
