/* Steps an observer FMU without any Python: sets a sample, steps, reads the outputs, for all samples of a file, and
   prints how long that took.

   driver LIBRARY GUID STEP RUNS SAMPLES RECORD INPUTS OUTPUTS [REFERENCE=VALUE ...]

   SAMPLES: a file of doubles, a row for each step of size STEP [s]. INPUTS: the value references that take a row, OUTPUTS:
   those of the Reals read after each step, separated by commas; the outputs of the last run are written to RECORD, a row
   of doubles for each step. REFERENCE=VALUE: Real parameters set before initialisation. Prints the nanoseconds per sample
   of each of the RUNS, which reset the instance. */
#define _POSIX_C_SOURCE 200809L
#include <dlfcn.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "fmi2Functions.h"

typedef struct {
    fmi2InstantiateTYPE *instantiate;
    fmi2SetDebugLoggingTYPE *log;
    fmi2SetupExperimentTYPE *setup;
    fmi2EnterInitializationModeTYPE *enter;
    fmi2ExitInitializationModeTYPE *leave;
    fmi2SetRealTYPE *set;
    fmi2DoStepTYPE *step;
    fmi2GetRealTYPE *get;
    fmi2ResetTYPE *reset;
    fmi2FreeInstanceTYPE *release;
} Fmu;

static void fail(const char *what, const char *which)
{
    fprintf(stderr, "driver: %s: %s\n", what, which);
    exit(1);
}

static void check(fmi2Status status, const char *function)
{
    if (status > fmi2Warning)
        fail("failed", function);
}

static void say(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status, fmi2String category,
                fmi2String message, ...)
{
    va_list arguments;
    (void)environment;
    fprintf(stderr, "%s [%d, %s]: ", instance, (int)status, category);
    va_start(arguments, message);
    vfprintf(stderr, message, arguments);
    va_end(arguments);
    fputc('\n', stderr);
}

/* Puts the address of a function of the library into `*function`; C99 has no cast from an object pointer to it. */
static void find(void *library, const char *name, void *function)
{
    void *symbol = dlsym(library, name);
    if (!symbol)
        fail("the library lacks", name);
    memcpy(function, &symbol, sizeof symbol);
}

static Fmu load(const char *path)
{
    Fmu fmu;
    void *library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (!library)
        fail("cannot load", dlerror());
    find(library, "fmi2Instantiate", &fmu.instantiate);
    find(library, "fmi2SetDebugLogging", &fmu.log);
    find(library, "fmi2SetupExperiment", &fmu.setup);
    find(library, "fmi2EnterInitializationMode", &fmu.enter);
    find(library, "fmi2ExitInitializationMode", &fmu.leave);
    find(library, "fmi2SetReal", &fmu.set);
    find(library, "fmi2DoStep", &fmu.step);
    find(library, "fmi2GetReal", &fmu.get);
    find(library, "fmi2Reset", &fmu.reset);
    find(library, "fmi2FreeInstance", &fmu.release);
    return fmu;
}

static double *read_doubles(const char *path, size_t *count)
{
    FILE *file = fopen(path, "rb");
    if (!file || fseek(file, 0, SEEK_END) != 0)
        fail("cannot read", path);
    *count = (size_t)ftell(file) / sizeof(double);
    rewind(file);
    double *values = calloc(*count + 1, sizeof(double));
    if (!values || fread(values, sizeof(double), *count, file) != *count)
        fail("cannot read", path);
    fclose(file);
    return values;
}

/* The value references in a list such as 12,13,14. */
static fmi2ValueReference *read_references(const char *list, size_t *count)
{
    fmi2ValueReference *references = calloc(strlen(list) + 1, sizeof *references);
    if (!references)
        fail("no memory for", list);
    *count = 0;
    for (const char *next = list; *next;) {
        char *end;
        references[(*count)++] = (fmi2ValueReference)strtoul(next, &end, 10);
        if (end == next || (*end != ',' && *end != '\0'))
            fail("not a list of value references", list);
        next = *end ? end + 1 : end;
    }
    return references;
}

static double nanoseconds(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return 1e9 * (double)now.tv_sec + (double)now.tv_nsec;
}

int main(int argc, char **argv)
{
    if (argc < 10)
        fail("arguments", "LIBRARY GUID STEP RUNS SAMPLES RECORD INPUTS OUTPUTS RESOURCES [REFERENCE=VALUE ...]");
    const Fmu fmu = load(argv[1]);
    const double h = strtod(argv[3], NULL);
    const long runs = strtol(argv[4], NULL, 10);
    size_t n, width, count;
    const fmi2ValueReference *inputs = read_references(argv[7], &width);
    const double *samples = read_doubles(argv[5], &n);
    if (width == 0 || n % width != 0)
        fail("not a whole number of rows", argv[5]);
    n /= width;
    const fmi2ValueReference *outputs = read_references(argv[8], &count);
    double *record = calloc(n * count + 1, sizeof *record);
    if (!record)
        fail("no memory for", argv[6]);

    const fmi2CallbackFunctions callbacks = {say, calloc, free, NULL, NULL};
    fmi2Component instance = fmu.instantiate("driven", fmi2CoSimulation, argv[2], argv[9], &callbacks, fmi2False, fmi2False);
    if (!instance)
        fail("fmi2Instantiate refused", argv[1]);
    const fmi2String errors[] = {"logStatusError"};
    check(fmu.log(instance, fmi2True, 1, errors), "fmi2SetDebugLogging");
    for (long run = 0; run < runs; run++) {
        for (int i = 10; i < argc; i++) {
            char *value;
            const fmi2ValueReference parameter = (fmi2ValueReference)strtoul(argv[i], &value, 10);
            if (*value != '=')
                fail("not of the form REFERENCE=VALUE", argv[i]);
            const double number = strtod(value + 1, NULL);
            check(fmu.set(instance, &parameter, 1, &number), "fmi2SetReal");
        }
        check(fmu.setup(instance, fmi2False, 0, 0, fmi2False, 0), "fmi2SetupExperiment");
        check(fmu.enter(instance), "fmi2EnterInitializationMode");
        check(fmu.leave(instance), "fmi2ExitInitializationMode");
        const double begin = nanoseconds();
        for (size_t k = 0; k < n; k++) {
            check(fmu.set(instance, inputs, width, samples + k * width), "fmi2SetReal");
            check(fmu.step(instance, (double)k * h, h, fmi2True), "fmi2DoStep");
            check(fmu.get(instance, outputs, count, record + k * count), "fmi2GetReal");
        }
        const double end = nanoseconds();
        printf("%.17g\n", n ? (end - begin) / (double)n : 0);
        check(fmu.reset(instance), "fmi2Reset");
    }
    fmu.release(instance);
    FILE *file = fopen(argv[6], "wb");
    if (!file || fwrite(record, sizeof *record, n * count, file) != n * count || fclose(file) != 0)
        fail("cannot write", argv[6]);
    return 0;
}
