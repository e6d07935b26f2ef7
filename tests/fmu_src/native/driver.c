/* Drives an FMU's instance at the speed of C: for tests of long runs, and of hosts with another floating-point
   environment. Functions of the FMU come as pointers. */
#define _GNU_SOURCE /* feenableexcept */
#include <fenv.h>
#include <math.h>
#include <stddef.h>
#include <string.h>
#include <xmmintrin.h>

typedef int Step(void *instance, double t, double h, int no_set_state);
typedef int Set(void *instance, const unsigned *references, size_t n, const double *values);
typedef int Get(void *instance, const unsigned *references, size_t n, double *values);

enum { ADDED, MULTIPLIED, NANOSECONDS, MICROSECONDS, DIFFERENCES, NANOSECOND_DIFFERENCES, FAST, SLOW };

static double time_of(int way, double t0, double h, double k)
{
    if (way == NANOSECONDS || way == NANOSECOND_DIFFERENCES)
        return t0 + rint(k * h * 1e9) / 1e9;
    if (way == MICROSECONDS)
        return t0 + rint(k * h * 1e6) / 1e6;
    return t0 + k * h;
}

/* Steps from number `first` to `last`, the input set before each; *sum is the time of an importer that adds up. The number of
   calls that did not return fmi2OK. */
__attribute__((visibility("default"))) long drive(Step *step, Set *set, void *instance, unsigned input, double t0,
                                                  double h, long first, long last, int way, double *sum)
{
    long failed = 0;
    for (long k = first; k < last; k++) {
        double value = (double)(k * 37 % 101) / 101, t = time_of(way, t0, h, (double)k), size = h;
        if (way == DIFFERENCES || way == NANOSECOND_DIFFERENCES)
            size = time_of(way, t0, h, (double)k + 1) - t;
        if (way == FAST || way == SLOW)
            size = h * (way == FAST ? 1 + 9e-7 : 1 - 9e-7);
        if (way == ADDED || way == FAST || way == SLOW)
            t = *sum;
        *sum += size;
        failed += set(instance, &input, 1, &value) != 0;
        failed += step(instance, t, size, 1) != 0;
    }
    return failed;
}

enum { PLAIN, TRAPS, UPWARD, DOWNWARD, TOWARD_ZERO, FLUSH_TO_ZERO, SHORT_X87 };

static void become(int host)
{
    unsigned short control = 0x027f; /* x87: 53 bits */
    if (host == TRAPS) {
        feclearexcept(FE_ALL_EXCEPT);
        feenableexcept(FE_INVALID | FE_DIVBYZERO | FE_OVERFLOW);
    }
    if (host == UPWARD || host == DOWNWARD || host == TOWARD_ZERO)
        fesetround(host == UPWARD ? FE_UPWARD : host == DOWNWARD ? FE_DOWNWARD : FE_TOWARDZERO);
    if (host == FLUSH_TO_ZERO)
        _mm_setcsr(_mm_getcsr() | 0x8040);
    if (host == SHORT_X87)
        __asm__ volatile("fldcw %0" : : "m"(control));
}

static int changed(const fenv_t *before, unsigned csr)
{
    fenv_t now;
    fegetenv(&now);
    return now.__control_word != before->__control_word || now.__status_word != before->__status_word ||
           _mm_getcsr() != csr;
}

/* `n` steps in a host of this kind, the values of the input in `inputs`, the outputs into `values`. The number of calls that left
   the host's environment changed, plus 1000000 for each step that was refused. */
__attribute__((visibility("default"))) long visit(Step *step, Set *set, Get *get, void *instance, int host, double h,
                                                  long n, unsigned input, size_t has_input, const double *inputs,
                                                  const unsigned *outputs, size_t n_outputs, double *values)
{
    long bad = 0;
    fenv_t ours, theirs;
    fegetenv(&ours);
    become(host);
    fegetenv(&theirs);
    unsigned csr = _mm_getcsr();
    /* t without arithmetic that rounds otherwise: h is a power of two */
    for (long k = 0; k < n; k++) {
        double t = (double)k * h;
        csr = _mm_getcsr();
        if (has_input)
            set(instance, &input, 1, &inputs[k]);
        bad += changed(&theirs, csr);
        bad += 1000000 * (step(instance, t, h, 1) != 0);
        bad += changed(&theirs, csr);
        bad += 1000000 * (get(instance, outputs, n_outputs, values + (size_t)k * n_outputs) != 0);
        bad += changed(&theirs, csr);
    }
    fesetenv(&ours);
    return bad;
}
