/* What border.c guards: the functions of the standard that compute, under names of our own. Not inline, so that no
   compiler moves their arithmetic out of the guard. */
#ifndef BORDER_H
#define BORDER_H

#include "instance.h"

#define set_up_experiment PREFIX(set_up_experiment)
#define exit_initialization_mode PREFIX(exit_initialization_mode)
#define terminate PREFIX(terminate)
#define do_step PREFIX(do_step)
#define get_real PREFIX(get_real)
#define get_integer PREFIX(get_integer)
#define get_boolean PREFIX(get_boolean)
#define set_real PREFIX(set_real)
#define set_integer PREFIX(set_integer)
#define set_boolean PREFIX(set_boolean)
#define set_state PREFIX(set_state)
#define deserialize_state PREFIX(deserialize_state)
#define get_real_status PREFIX(get_real_status)

#if defined __GNUC__
#define GUARDED __attribute__((noinline)) fmi2Status
#else
#define GUARDED fmi2Status
#endif

BEGIN_INTERNAL

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

END_INTERNAL

#endif
