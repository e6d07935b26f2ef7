/* See arithmetic.h. C's own functions exchange the x87's environment, too, which takes 130 ns on x86-64; there doubles
   are computed by SSE, on Linux in the C library as well, and where the x87 neither traps nor rounds otherwise its part
   is left alone: 10 ns. (On Windows the C library's functions do use the x87.) */
#include "arithmetic.h"

#if defined __clang__
#pragma clang diagnostic ignored "-Wignored-pragmas" /* where clang has nothing to do for it, as on 32-bit ARM */
#pragma STDC FENV_ACCESS ON
#endif

#if defined __x86_64__ && defined __linux__ && defined __GNUC__
#define HAS_SSE_ONLY 1
#else
#define HAS_SSE_ONLY 0
#endif

#if HAS_SSE_ONLY
#define SSE_DEFAULT 0x1f80u /* all exceptions masked, to nearest, no flush to zero, no flags */

static bool x87_is_harmless(void)
{
    unsigned short control;
    __asm__ volatile("fnstcw %0" : "=m"(control));
    return (control & 0x0c3f) == 0x003f; /* all masked, to nearest */
}

void hold_arithmetic(Arithmetic *host)
{
    host->only_sse = x87_is_harmless();
    if (host->only_sse) {
        unsigned ours = SSE_DEFAULT;
        __asm__ volatile("stmxcsr %0\n\tldmxcsr %1" : "=m"(host->sse) : "m"(ours) : "memory");
        return;
    }
    feholdexcept(&host->whole);
    fesetround(FE_TONEAREST);
}

void restore_arithmetic(const Arithmetic *host)
{
    if (host->only_sse)
        __asm__ volatile("ldmxcsr %0" : : "m"(host->sse) : "memory");
    else
        fesetenv(&host->whole);
}
#else
void hold_arithmetic(Arithmetic *host)
{
    host->only_sse = false;
    feholdexcept(&host->whole);
    fesetround(FE_TONEAREST);
}

void restore_arithmetic(const Arithmetic *host)
{
    fesetenv(&host->whole);
}
#endif
