/* What border.c guards: the functions of the standard that compute, under names of our own. Not inline, so that no
   compiler moves their arithmetic out of the guard. */
#ifndef BORDER_H
#define BORDER_H

#include "instance.h"

#if defined __GNUC__
#define GUARDED __attribute__((noinline)) fmi2Status
#else
#define GUARDED fmi2Status
#endif

GUARDED set_up_experiment(Instance *self, double start, bool stop_defined, double stop);
GUARDED exit_initialization_mode(Instance *self);
GUARDED terminate(Instance *self);
GUARDED do_step(Instance *self, double t, double h);
GUARDED get_real(Instance *self, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[]);
GUARDED get_integer(Instance *self, const fmi2ValueReference vr[], size_t nvr, fmi2Integer value[]);
GUARDED get_boolean(Instance *self, const fmi2ValueReference vr[], size_t nvr, fmi2Boolean value[]);
GUARDED set_state(Instance *self, const char *block);
GUARDED deserialize_state(Instance *self, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state);
GUARDED get_real_status(Instance *self, fmi2StatusKind kind, fmi2Real *value);

#endif
