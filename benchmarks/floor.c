/* What a filter costs at least: the extended and the unscented Kalman filter as one would write them in plain C for one model, with fixed
   sizes and nothing beside the estimate. No gate, no test of the innovations, no missing measurement, no bounds, no restart.

   floor SAMPLES RUNS
   floor SAMPLES 0

   SAMPLES: a file of doubles, measurements of the output. Prints the nanoseconds per sample of each of the RUNS, then the last
   estimate; with 0 runs it reads the file only, so that instructions can be counted.

   Compile with -DCHAIN=n (n / 2 oscillators in a row, n states) or -DDUFFING (the oscillator of Gong, Ross & Kang 2007 and its unknown forcing, three states), with
   -DSAMPLE_TIME=h, -DSTEPS=k (of Runge-Kutta in a sample), and -DUNSCENTED for the unscented filter. */
#define _POSIX_C_SOURCE 200809L
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#if defined DUFFING
#define N 3
#define MOVING 2 /* states that have a rate; the others are parameters */
static const double start[N] = {2, 1, 0.4};

static void rate(double t, const double *x, double *dx)
{
    dx[0] = x[1];
    dx[1] = -0.25 * x[1] + x[0] * (1 - x[0] * x[0]) + x[2] * cos(t);
}

static double seen(const double *x)
{
    return x[0] + 0.5 * x[1];
}
#else
#define N CHAIN
#define MOVING N
static const double start[N] = {0};

static double seen(const double *x)
{
    return x[0];
}

static void rate(double t, const double *x, double *dx)
{
    (void)t;
    const double *q = x, *v = x + N / 2;
    for (int i = 0; i < N / 2; ++i) {
        const double left = i ? q[i - 1] : 0, right = i + 1 < N / 2 ? q[i + 1] : 0;
        dx[i] = v[i];
        dx[i + N / 2] = left - 2 * q[i] + right - 0.1 * v[i] - q[i] * q[i] * q[i];
    }
}

#if !defined UNSCENTED
static void jacobian(const double *x, double A[N][N])
{
    memset(A, 0, N * sizeof *A);
    for (int i = 0, k = N / 2; i < N / 2; ++i, ++k) {
        A[i][k] = 1;
        if (i)
            A[k][i - 1] = 1;
        if (i + 1 < N / 2)
            A[k][i + 1] = 1;
        A[k][i] = -2 - 3 * x[i] * x[i];
        A[k][k] = -0.1;
    }
}
#endif
#endif

static double process[N], spread[N]; /* variances: of the noise a sample, of the guess */
static const double noise = 0.01;    /* variance of a sample */

static void move(double t, double *x)
{
    const double h = SAMPLE_TIME / STEPS;
    for (int step = 0; step < STEPS; ++step, t += h) {
        double k1[N], k2[N], k3[N], k4[N], y[N];
        rate(t, x, k1);
        for (int i = 0; i < MOVING; ++i)
            y[i] = x[i] + h / 2 * k1[i];
        for (int i = MOVING; i < N; ++i)
            y[i] = x[i];
        rate(t + h / 2, y, k2);
        for (int i = 0; i < MOVING; ++i)
            y[i] = x[i] + h / 2 * k2[i];
        rate(t + h / 2, y, k3);
        for (int i = 0; i < MOVING; ++i)
            y[i] = x[i] + h * k3[i];
        rate(t + h, y, k4);
        for (int i = 0; i < MOVING; ++i)
            x[i] += h / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]);
    }
}

#if !defined UNSCENTED
typedef struct {
    double x[N], P[N][N];
} Filter;

static void begin(Filter *f)
{
    memset(f, 0, sizeof *f);
    memcpy(f->x, start, sizeof start);
    for (int i = 0; i < N; ++i)
        f->P[i][i] = spread[i];
}

static void multiply(double A[N][N], double B[N][N], double C[N][N])
{
    memset(C, 0, N * sizeof *C);
    for (int i = 0; i < N; ++i)
        for (int k = 0; k < N; ++k)
            for (int j = 0; j < N; ++j)
                C[i][j] += A[i][k] * B[k][j];
}

static void sample(Filter *f, double t, double y)
{
    double A[N][N], B[N][N], F[N][N], K[N];
    const double S = f->P[0][0] + noise, nu = y - seen(f->x);
    for (int i = 0; i < N; ++i) {
        K[i] = f->P[i][0] / S;
        f->x[i] += K[i] * nu;
    }
    for (int i = 0; i < N; ++i)
        for (int j = 0; j < N; ++j)
            f->P[i][j] -= K[i] * K[j] * S;
    /* F = exp(h A) to second order, P = F P F' + Q */
    jacobian(f->x, A);
    multiply(A, A, B);
    for (int i = 0; i < N; ++i)
        for (int j = 0; j < N; ++j)
            F[i][j] = (i == j) + SAMPLE_TIME * A[i][j] + SAMPLE_TIME * SAMPLE_TIME / 2 * B[i][j];
    multiply(F, f->P, A);
    for (int i = 0; i < N; ++i)
        for (int j = 0; j < N; ++j)
            B[i][j] = F[j][i];
    multiply(A, B, f->P);
    for (int i = 0; i < N; ++i)
        f->P[i][i] += process[i];
    move(t, f->x);
}
#else
#define POINTS (2 * N + 1)

typedef struct {
    double x[N], P[N][N], points[POINTS][N];
} Filter;

/* Points around x of covariance P, by Cholesky; kappa = 1. */
static void draw(Filter *f)
{
    const double c = sqrt(N + 1.0);
    double L[N][N] = {{0}};
    for (int j = 0; j < N; ++j) {
        for (int i = j; i < N; ++i) {
            double sum = f->P[i][j];
            for (int k = 0; k < j; ++k)
                sum -= L[i][k] * L[j][k];
            L[i][j] = i == j ? sqrt(sum) : sum / L[j][j];
        }
    }
    memcpy(f->points[0], f->x, sizeof f->x);
    for (int j = 0; j < N; ++j) {
        for (int i = 0; i < N; ++i) {
            f->points[1 + j][i] = f->x[i] + c * L[i][j];
            f->points[1 + N + j][i] = f->x[i] - c * L[i][j];
        }
    }
}

static void begin(Filter *f)
{
    memset(f, 0, sizeof *f);
    memcpy(f->x, start, sizeof start);
    for (int i = 0; i < N; ++i)
        f->P[i][i] = spread[i];
    draw(f);
}

static void sample(Filter *f, double t, double y)
{
    const double w = 1 / (2.0 * (N + 1)), first = 1 / (N + 1.0);
    double mean = 0, S = noise, C[N] = {0}, at[POINTS];
    /* mean and covariance of the points, the process noise, points anew */
    for (int i = 0; i < N; ++i) {
        f->x[i] = first * f->points[0][i];
        memset(f->P[i], 0, sizeof f->P[i]);
        f->P[i][i] = process[i];
    }
    for (int k = 1; k < POINTS; ++k)
        for (int i = 0; i < N; ++i)
            f->x[i] += w * f->points[k][i];
    for (int k = 0; k < POINTS; ++k) {
        double off[N];
        for (int i = 0; i < N; ++i)
            off[i] = f->points[k][i] - f->x[i];
        for (int i = 0; i < N; ++i) {
            const double scaled = (k ? w : first) * off[i];
            for (int j = 0; j <= i; ++j)
                f->P[i][j] += scaled * off[j];
        }
    }
    draw(f);
    /* what they see, and the correction */
    for (int k = 0; k < POINTS; ++k) {
        at[k] = seen(f->points[k]);
        mean += (k ? w : first) * at[k];
    }
    for (int k = 0; k < POINTS; ++k) {
        const double off = at[k] - mean, scaled = (k ? w : first) * off;
        S += scaled * off;
        for (int i = 0; i < N; ++i)
            C[i] += scaled * (f->points[k][i] - f->x[i]);
    }
    for (int i = 0; i < N; ++i)
        for (int j = 0; j <= i; ++j)
            f->P[i][j] -= C[i] * C[j] / S;
    for (int i = 0; i < N; ++i)
        f->x[i] += C[i] / S * (y - mean);
    draw(f);
    for (int k = 0; k < POINTS; ++k)
        move(t, f->points[k]);
    for (int i = 0; i < N; ++i) {
        f->x[i] = first * f->points[0][i];
        for (int k = 1; k < POINTS; ++k)
            f->x[i] += w * f->points[k][i];
    }
}
#endif

int main(int argc, char **argv)
{
    static Filter f;
    static double samples[100000];
    FILE *file = argc == 3 ? fopen(argv[1], "rb") : NULL;
    if (file == NULL)
        return 1;
    const size_t n = fread(samples, sizeof *samples, 100000, file);
    fclose(file);
    for (int i = 0; i < N; ++i) {
        process[i] = 2.5e-7;
        spread[i] = 1;
    }
#if defined DUFFING
    process[2] = 4e-6;
#endif
    for (int run = atoi(argv[2]); run > 0; --run) {
        struct timespec before, after;
        clock_gettime(CLOCK_MONOTONIC, &before);
        begin(&f);
        for (size_t k = 0; k < n; ++k)
            sample(&f, SAMPLE_TIME * (double)k, samples[k]);
        clock_gettime(CLOCK_MONOTONIC, &after);
        printf("%.1f\n", ((double)(after.tv_sec - before.tv_sec) * 1e9 + (double)(after.tv_nsec - before.tv_nsec)) / (double)n);
    }
    for (int i = 0; i < N; ++i)
        printf("%.17g\n", f.x[i]);
    return 0;
}
