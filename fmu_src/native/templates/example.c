/* MODEL without FMI, as a micro-controller runs it: all memory is static, sample() is what it calls each sample time.
   This program feeds a made-up signal to the first input and prints all outputs of 20 samples.

   cc -std=c99 -O2 -ffp-contract=off example.c ../functions.c -lm

   Where parameters hold times at which the motion changes (jump times of a plant), cut the flow there. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "model.h"

static casadi_real z[2][MODEL_ROOM(MODEL_N_Z)]; /* the state and the next one: no function runs in place */
static casadi_real u[MODEL_ROOM(MODEL_N_U)], p[MODEL_ROOM(MODEL_N_P)], y[MODEL_ROOM(MODEL_N_Y)];
static const casadi_real *arg[MODEL_SZ_ARG];
static casadi_real *res[MODEL_SZ_RES], w[MODEL_ROOM(MODEL_SZ_W)];
static casadi_int iw[MODEL_ROOM(MODEL_SZ_IW)];
static int now; /* which of z is the state */

typedef int Function(const casadi_real **, casadi_real **, casadi_int *, casadi_real *, int);

/* result = function(z, u, p, t, h); of these it reads as many as it has. */
static int evaluate(Function *function, casadi_real *result, casadi_real t, casadi_real h)
{
    arg[0] = z[now];
    arg[1] = u;
    arg[2] = p;
    arg[3] = &t;
    arg[4] = &h;
    res[0] = result;
    return function(arg, res, iw, w, 0);
}

/* The next state becomes the state, unless it is none: then the last one remains. */
static int move(Function *function, casadi_real t, casadi_real h)
{
    int failed = evaluate(function, z[!now], t, h);
    for (int i = 0; i < MODEL_N_Z; i++)
        failed |= !isfinite(z[!now][i]);
    if (!failed)
        now = !now;
    return failed;
}

static int start(void)
{
    casadi_real t = 0;
    memcpy(u, MODEL_u_start, sizeof u);
    memcpy(p, MODEL_p_start, sizeof p);
    arg[0] = p;
    arg[1] = &t;
    res[0] = z[now];
    return MODEL_start(arg, res, iw, w, 0);
}

/* The inputs of time t are taken, the state moves to `end`, and y is put out there. */
static int sample(casadi_real t, casadi_real end)
{
#ifdef MODEL_jump_SZ_W
    if (move(MODEL_jump, t, 0))
        return 1;
#endif
    int substeps = (int)fmax(1, ceil((end - t) / MODEL_MAX_STEP - 1e-6));
    casadi_real h = (end - t) / substeps;
    for (int i = 0; i < substeps; i++)
        if (move(MODEL_flow, t + i * h, h))
            return 1;
    return evaluate(MODEL_output, y, end, 0);
}

int main(void)
{
    if (start())
        return 1;
    for (int k = 0; k < 20; k++) {
        u[0] = MODEL_u_start[0] + (casadi_real)0.125 * (k % 7);
        if (sample(k * MODEL_STEP(p), (k + 1) * MODEL_STEP(p)))
            return 1;
        for (int i = 0; i < MODEL_N_Y; i++)
            printf("%.17g ", (double)y[i]);
        printf("\n");
    }
    return 0;
}
