/* Runs the FMU whose sources it is compiled with and prints all its Real outputs after each step, as the bits of doubles.

   Compiled once for each FMU of a program, with FMI2_FUNCTION_PREFIX as its sources are, and with
   RUN (this function's name), GUID, STEP, STEPS, INPUTS and OUTPUTS (value references of Real variables). */
#include <inttypes.h>
#include <stdio.h>
#include <string.h>

#include "fmi2Functions.h"

static const fmi2ValueReference inputs[] = {INPUTS}, outputs[] = {OUTPUTS};
#define N_INPUTS (sizeof inputs / sizeof *inputs)
#define N_OUTPUTS (sizeof outputs / sizeof *outputs)

static void logger(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                   fmi2String message, ...) {
    (void)environment, (void)name, (void)status, (void)category;
    fprintf(stderr, "%s\n", message);
}

int RUN(void);
int RUN(void) {
    const fmi2CallbackFunctions callbacks = {logger, calloc, free, NULL, NULL};
    fmi2Component instance = fmi2Instantiate("instance", fmi2CoSimulation, GUID, "", &callbacks, fmi2False, fmi2True);
    if (!instance || fmi2SetupExperiment(instance, fmi2False, 0, 0, fmi2False, 0) != fmi2OK ||
        fmi2EnterInitializationMode(instance) != fmi2OK || fmi2ExitInitializationMode(instance) != fmi2OK)
        return 1;
    for (int k = 0; k < STEPS; k++) {
        fmi2Real values[N_OUTPUTS];
        for (size_t i = 0; i < N_INPUTS; i++) {
            fmi2Real value = (k + (int)i) % 7 * 0.125;
            if (fmi2SetReal(instance, &inputs[i], 1, &value) != fmi2OK)
                return 1;
        }
        if (fmi2DoStep(instance, k * STEP, STEP, fmi2True) != fmi2OK ||
            fmi2GetReal(instance, outputs, N_OUTPUTS, values) != fmi2OK)
            return 1;
        for (size_t i = 0; i < N_OUTPUTS; i++) {
            uint64_t bits;
            memcpy(&bits, &values[i], sizeof bits);
            printf("%016" PRIx64 " ", bits);
        }
    }
    printf("\n");
    fmi2FreeInstance(instance);
    return 0;
}
