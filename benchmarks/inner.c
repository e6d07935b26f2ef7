/* What the plant's own functions take for an evaluation, called one after the other as an observer with it inside calls them:
   LIBRARY GUID N prints nanoseconds for each of N evaluations. */
#define _POSIX_C_SOURCE 199309L

#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "fmi2Functions.h"

#define FIND(name)                                                                                                     \
    fmi2##name##TYPE *name;                                                                                            \
    {                                                                                                                  \
        void *address = dlsym(library, "fmi2" #name);                                                                  \
        memcpy(&name, &address, sizeof name);                                                                          \
    }

static double nanoseconds(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return 1e9 * (double)now.tv_sec + (double)now.tv_nsec;
}

int main(int argc, char **argv)
{
    void *library = argc == 4 ? dlopen(argv[1], RTLD_NOW) : NULL;
    if (!library)
        return 1;
    FIND(Instantiate)
    FIND(SetupExperiment)
    FIND(EnterInitializationMode)
    FIND(ExitInitializationMode)
    FIND(NewDiscreteStates)
    FIND(EnterContinuousTimeMode)
    FIND(SetTime)
    FIND(SetContinuousStates)
    FIND(SetReal)
    FIND(GetDerivatives)
    const fmi2CallbackFunctions callbacks = {NULL, calloc, free, NULL, NULL};
    fmi2Component plant = Instantiate("inner", fmi2ModelExchange, argv[2], "file:///", &callbacks, fmi2False, fmi2False);
    fmi2EventInfo info;
    if (!plant || SetupExperiment(plant, fmi2False, 0, 0, fmi2False, 0) || EnterInitializationMode(plant) ||
        ExitInitializationMode(plant) || NewDiscreteStates(plant, &info) || EnterContinuousTimeMode(plant))
        return 1;
    const fmi2ValueReference force = 300;
    const long n = strtol(argv[3], NULL, 10);
    double x[] = {1, 0.5}, d[2], u = 0, sum = 0;
    const double begin = nanoseconds();
    for (long i = 0; i < n; i++) {
        if (SetTime(plant, 1e-3 * (double)(i % 7)) || SetContinuousStates(plant, x, 2) || SetReal(plant, &force, 1, &u) ||
            GetDerivatives(plant, d, 2))
            return 1;
        x[0] = 1 + 1e-9 * d[0];
        sum += d[1];
    }
    printf("%.3f %g\n", (nanoseconds() - begin) / (double)n, sum);
    return 0;
}
