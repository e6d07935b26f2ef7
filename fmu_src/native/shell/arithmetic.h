/* The floating-point environment that the component computes in: nothing traps, rounding is to nearest. The host's own
   comes back untouched, its flags included. */
#ifndef ARITHMETIC_H
#define ARITHMETIC_H

#include <fenv.h>
#include <stdbool.h>

#include "prefix.h"

#define hold_arithmetic PREFIX(hold_arithmetic)
#define restore_arithmetic PREFIX(restore_arithmetic)

typedef struct {
    fenv_t whole;
    unsigned sse; /* the control and status of SSE where that alone is exchanged */
    bool only_sse;
} Arithmetic;

BEGIN_INTERNAL

void hold_arithmetic(Arithmetic *host);
void restore_arithmetic(const Arithmetic *host);

END_INTERNAL

#endif
