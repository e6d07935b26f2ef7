/* A test tool for other machines: loads an FMU's library and makes the FMI calls that it reads from stdin, one per line.

   drive LIBRARY < calls > answers

   Doubles travel as the 16 hexadecimal digits of their bits, so that nothing is rounded on the way. A call that returns
   more than fmi2Warning is answered by "failed CALL STATUS" and ends the program with status 1; so does a misspelt call. */
#include <inttypes.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#ifdef _WIN32
#include <windows.h>
#else
#include <dlfcn.h>
#endif

#include "fmi2Functions.h"

#define MOST 64 /* value references in a line */
#define LINE 4096

#ifdef _WIN32
typedef HMODULE Library;
typedef FARPROC Any; /* any function's address */

static Library load_library(const char *path) {
    return LoadLibraryA(path);
}

static Any address_in(Library library, const char *name) {
    return GetProcAddress(library, name);
}

static void unload(Library library) {
    FreeLibrary(library);
}
#else
typedef void *Library;
typedef void (*Any)(void);

static Library load_library(const char *path) {
    return dlopen(path, RTLD_NOW | RTLD_LOCAL);
}

static Any address_in(Library library, const char *name) {
    void *found = dlsym(library, name);
    Any address;
    memcpy(&address, &found, sizeof address);
    return address;
}

static void unload(Library library) {
    dlclose(library);
}
#endif

static Library library;
static fmi2Component instance;
static fmi2FMUstate state;

static void stop(const char *what, const char *which) {
    fprintf(stderr, "%s: %s\n", what, which);
    exit(1);
}

static Any function(const char *name) {
    Any found = address_in(library, name);
    if (found == NULL) stop("not exported", name);
    return found;
}

/* The function fmi2NAME with the type that FMI's header gives it, through void(*)(void), which any function type fits. */
#define FMI(NAME) ((fmi2##NAME##TYPE *)(void (*)(void))function("fmi2" #NAME))

static void check(const char *call, fmi2Status status) {
    if (status > fmi2Warning) {
        printf("failed %s %d\n", call, (int)status);
        exit(1);
    }
}

static void logger(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                   fmi2String message, ...) {
    va_list arguments;
    (void)environment;
    printf("log %s %d %s ", name, (int)status, category);
    va_start(arguments, message);
    vprintf(message, arguments);
    va_end(arguments);
    printf("\n");
}

static const fmi2CallbackFunctions callbacks = {logger, calloc, free, NULL, NULL};

/* The next word of the line that strtok is cutting. */
static const char *word(void) {
    const char *found = strtok(NULL, " \r\n");
    if (found == NULL) stop("a word is missing in", "the line");
    return found;
}

static double real(const char *text) {
    uint64_t bits = strtoull(text, NULL, 16);
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static void print_real(double value) {
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    printf(" %016" PRIx64, bits);
}

/* The references that fill the rest of the line. */
static size_t references(fmi2ValueReference *into) {
    size_t n = 0;
    for (const char *text = strtok(NULL, " \r\n"); text != NULL; text = strtok(NULL, " \r\n")) {
        if (n == MOST) stop("too many value references before", text);
        into[n++] = (fmi2ValueReference)strtoul(text, NULL, 10);
    }
    return n;
}

static void instantiate(void) {
    const char *name = word(), *guid = word(), *resources = strtok(NULL, " \r\n");
    instance = FMI(Instantiate)(name, fmi2CoSimulation, guid, resources ? resources : "", &callbacks, fmi2False, fmi2True);
    if (instance == NULL) check("instantiate", fmi2Error);
}

static void get_real(void) {
    fmi2ValueReference vr[MOST];
    fmi2Real values[MOST];
    size_t n = references(vr);
    check("getReal", FMI(GetReal)(instance, vr, n, values));
    printf("real");
    for (size_t i = 0; i < n; i++) print_real(values[i]);
    printf("\n");
}

static void get_integer(void) {
    fmi2ValueReference vr[MOST];
    fmi2Integer values[MOST];
    size_t n = references(vr);
    check("getInteger", FMI(GetInteger)(instance, vr, n, values));
    printf("integer");
    for (size_t i = 0; i < n; i++) printf(" %d", values[i]);
    printf("\n");
}

static void set_real(void) {
    fmi2ValueReference vr = (fmi2ValueReference)strtoul(word(), NULL, 10);
    fmi2Real value = real(word());
    check("setReal", FMI(SetReal)(instance, &vr, 1, &value));
}

static void set_integer(void) {
    fmi2ValueReference vr = (fmi2ValueReference)strtoul(word(), NULL, 10);
    fmi2Integer value = (fmi2Integer)strtol(word(), NULL, 10);
    check("setInteger", FMI(SetInteger)(instance, &vr, 1, &value));
}

static void set_derivative(void) {
    fmi2ValueReference vr = (fmi2ValueReference)strtoul(word(), NULL, 10);
    fmi2Integer order = 1;
    fmi2Real value = real(word());
    check("setDerivative", FMI(SetRealInputDerivatives)(instance, &vr, 1, &order, &value));
}

static void set_up(void) {
    double start = real(word()), end = real(word());
    check("setup", FMI(SetupExperiment)(instance, fmi2False, 0.0, start, fmi2True, end));
}

static void step(void) {
    double time = real(word()), size = real(word());
    check("step", FMI(DoStep)(instance, time, size, fmi2True));
}

/* The state of the instance, serialised into a file. */
static void save(void) {
    const char *path = word();
    size_t size;
    check("getState", FMI(GetFMUstate)(instance, &state));
    check("stateSize", FMI(SerializedFMUstateSize)(instance, state, &size));
    fmi2Byte *bytes = malloc(size);
    FILE *file = fopen(path, "wb");
    if (bytes == NULL || file == NULL) stop("cannot write", path);
    check("serialize", FMI(SerializeFMUstate)(instance, state, bytes, size));
    check("freeState", FMI(FreeFMUstate)(instance, &state));
    if (fwrite(bytes, 1, size, file) != size || fclose(file) != 0) stop("cannot write", path);
    free(bytes);
}

static void load(void) {
    const char *path = word();
    FILE *file = fopen(path, "rb");
    if (file == NULL || fseek(file, 0, SEEK_END) != 0) stop("cannot read", path);
    size_t size = (size_t)ftell(file);
    fmi2Byte *bytes = malloc(size);
    rewind(file);
    if (bytes == NULL || fread(bytes, 1, size, file) != size) stop("cannot read", path);
    fclose(file);
    check("deserialize", FMI(DeSerializeFMUstate)(instance, bytes, size, &state));
    check("setState", FMI(SetFMUstate)(instance, state));
    check("freeState", FMI(FreeFMUstate)(instance, &state));
    free(bytes);
}

static void exported(void) {
    printf("exported %d\n", address_in(library, word()) != NULL);
}

static void call(const char *name) {
    if (strcmp(name, "exported") == 0) exported();
    else if (strcmp(name, "version") == 0) printf("version %s %s\n", FMI(GetVersion)(), FMI(GetTypesPlatform)());
    else if (strcmp(name, "instantiate") == 0) instantiate();
    else if (strcmp(name, "logging") == 0) check(name, FMI(SetDebugLogging)(instance, fmi2True, 0, NULL));
    else if (strcmp(name, "setup") == 0) set_up();
    else if (strcmp(name, "enter") == 0) check(name, FMI(EnterInitializationMode)(instance));
    else if (strcmp(name, "exit") == 0) check(name, FMI(ExitInitializationMode)(instance));
    else if (strcmp(name, "getReal") == 0) get_real();
    else if (strcmp(name, "getInteger") == 0) get_integer();
    else if (strcmp(name, "setReal") == 0) set_real();
    else if (strcmp(name, "setInteger") == 0) set_integer();
    else if (strcmp(name, "setDerivative") == 0) set_derivative();
    else if (strcmp(name, "step") == 0) step();
    else if (strcmp(name, "save") == 0) save();
    else if (strcmp(name, "load") == 0) load();
    else if (strcmp(name, "reset") == 0) check(name, FMI(Reset)(instance));
    else if (strcmp(name, "terminate") == 0) check(name, FMI(Terminate)(instance));
    else if (strcmp(name, "free") == 0) FMI(FreeInstance)(instance);
    else stop("unknown call", name);
}

int main(int count, char **arguments) {
    char line[LINE];
    if (count != 2) stop("usage", "drive LIBRARY");
    library = load_library(arguments[1]);
    if (library == NULL) stop("cannot load", arguments[1]);
    while (fgets(line, sizeof line, stdin) != NULL) {
        const char *name = strtok(line, " \r\n");
        if (name != NULL) call(name);
    }
    unload(library);
    return 0;
}
