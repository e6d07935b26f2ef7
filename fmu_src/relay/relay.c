/* Between the importer and PythonFMU's library, which stands beside this one: every call is handed on, and what
   PythonFMU lacks is added. A call in which the slave logged an error returns fmi2Error; the GUID is compared; messages
   obey the chosen categories; null pointers are refused; without a Python in the process there is a message, where the
   bare library could not even be loaded. */
#ifndef _WIN32
#define _GNU_SOURCE /* dladdr */
#endif
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#include <windows.h>
#define LIBRARY "pythonfmu-export.dll"
#else
#include <dlfcn.h>
#define LIBRARY "libpythonfmu-export.so"
#endif

#include "fmi2Functions.h"
#include "identity.h"

#define PATH_BYTES 4096

#define EACH_FUNCTION(X)                                                                                               \
    X(fmi2Instantiate) X(fmi2FreeInstance) X(fmi2SetDebugLogging) X(fmi2SetupExperiment) X(fmi2EnterInitializationMode)\
    X(fmi2ExitInitializationMode) X(fmi2Terminate) X(fmi2Reset) X(fmi2GetReal) X(fmi2GetInteger) X(fmi2GetBoolean)     \
    X(fmi2GetString) X(fmi2SetReal) X(fmi2SetInteger) X(fmi2SetBoolean) X(fmi2SetString) X(fmi2GetFMUstate)            \
    X(fmi2SetFMUstate) X(fmi2FreeFMUstate) X(fmi2SerializedFMUstateSize) X(fmi2SerializeFMUstate)                      \
    X(fmi2DeSerializeFMUstate) X(fmi2DoStep)

typedef struct {
#define MEMBER(name) name##TYPE *name;
    EACH_FUNCTION(MEMBER)
#undef MEMBER
} Functions;

typedef enum { LOG_ERROR = 1, LOG_WARNING = 2, LOG_DISCARD = 4, LOG_EVENTS = 8 } Category;
#define LOG_ALL (LOG_ERROR | LOG_WARNING | LOG_DISCARD | LOG_EVENTS)

static const struct {
    const char *name;
    unsigned categories;
} CATEGORIES[] = {
    {"logStatusError", LOG_ERROR},     {"logStatusWarning", LOG_WARNING}, {"logStatusDiscard", LOG_DISCARD},
    {"logEvents", LOG_EVENTS},         {"logAll", LOG_ALL},
};
#define N_CATEGORIES (sizeof CATEGORIES / sizeof CATEGORIES[0])

typedef struct {
    fmi2CallbackFunctions importer; /* what the importer gave */
    fmi2CallbackFunctions ours;     /* what PythonFMU keeps a pointer to */
    Functions pythonfmu;
    void *library;
    fmi2Component slave;
    unsigned log_categories;
    bool refused; /* the slave logged an error during this call */
    bool is_set_up, entered; /* fmi2SetupExperiment and fmi2EnterInitializationMode were called */
    double last_time; /* the end of the last step */
    char name[256];
} Instance;

/* ---- messages ---- */

static unsigned category_of(const char *name)
{
    for (size_t i = 0; name && i < N_CATEGORIES; i++)
        if (strcmp(name, CATEGORIES[i].name) == 0)
            return CATEGORIES[i].categories;
    return 0;
}

static void report(Instance *self, fmi2Status status, Category category, const char *text)
{
    if (!(self->log_categories & category) || !self->importer.logger)
        return;
    char message[2048];
    snprintf(message, sizeof message, "%s", text);
    for (char *c = message; *c; c++) /* the importer takes the text for a format */
        if (*c == '%' || *c == '#')
            *c = '?';
    size_t i = 0;
    while (CATEGORIES[i].categories != (unsigned)category)
        i++;
    self->importer.logger(self->importer.componentEnvironment, self->name, status, CATEGORIES[i].name, message);
}

static fmi2Status refuse(Instance *self, const char *function, const char *why)
{
    char text[512];
    snprintf(text, sizeof text, "%s: %s.", function, why);
    report(self, fmi2Error, LOG_ERROR, text);
    return fmi2Error;
}

/* The logger that PythonFMU gets. Its own messages, of exceptions in its code, have no category. */
static void from_slave(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                       fmi2String message, ...)
{
    (void)name;
    Instance *self = environment;
    unsigned chosen = category_of(category);
    if (status >= fmi2Error)
        self->refused = true;
    report(self, status, chosen == 0 || chosen == LOG_ALL ? LOG_ERROR : (Category)chosen, message);
}

/* ---- PythonFMU's library ---- */

static const int here = 0; /* an address in this library */

#ifdef _WIN32
static bool own_path(char path[PATH_BYTES])
{
    HMODULE module;
    return GetModuleHandleExA(GET_MODULE_HANDLE_EX_FLAG_FROM_ADDRESS | GET_MODULE_HANDLE_EX_FLAG_UNCHANGED_REFCOUNT,
                              (LPCSTR)&here, &module) &&
           GetModuleFileNameA(module, path, PATH_BYTES) < PATH_BYTES;
}

static void *open_library(const char *path)
{
    return LoadLibraryA(path);
}

static void *symbol(void *library, const char *name)
{
    void *found;
    FARPROC address = GetProcAddress(library, name);
    memcpy(&found, &address, sizeof found);
    return found;
}

static void close_library(void *library)
{
    FreeLibrary(library);
}

static bool has_python(void)
{
    return true; /* PythonFMU's DLL loads Python's by itself */
}
#else
static bool own_path(char path[PATH_BYTES])
{
    Dl_info info;
    char *full = dladdr(&here, &info) ? realpath(info.dli_fname, NULL) : NULL;
    bool fits = full && strlen(full) < PATH_BYTES;
    if (fits)
        strcpy(path, full);
    free(full);
    return fits;
}

static void *open_library(const char *path)
{
    return dlopen(path, RTLD_NOW | RTLD_LOCAL);
}

static void *symbol(void *library, const char *name)
{
    return dlsym(library, name);
}

static void close_library(void *library)
{
    dlclose(library);
}

static bool has_python(void)
{
    return dlsym(RTLD_DEFAULT, "Py_IsInitialized") != NULL;
}
#endif

/* Cut the path behind its last separator, which stays. */
static bool cut(char *path)
{
    char *end = path + strlen(path);
    while (end > path && end[-1] != '/' && end[-1] != '\\')
        end--;
    *end = 0;
    return end > path;
}

/* The library beside this one; `resources` becomes the FMU's folder of that name, found from here: PythonFMU itself
   decodes nothing but spaces in the URI that the importer hands in. NULL where there is none. */
static void *load(Functions *functions, char resources[PATH_BYTES + 16])
{
    char path[PATH_BYTES + sizeof LIBRARY];
    if (!own_path(path) || !cut(path))
        return NULL;
    strcpy(resources, path);
    strcat(path, LIBRARY);
    void *library = open_library(path);
    if (!library)
        return NULL;
    bool complete = true;
#define FIND(name)                                                                                                     \
    {                                                                                                                  \
        void *address = symbol(library, #name);                                                                        \
        memcpy(&functions->name, &address, sizeof address);                                                            \
        complete = complete && address;                                                                                \
    }
    EACH_FUNCTION(FIND)
#undef FIND
    for (int i = 0; i < 2 && complete; i++) { /* binaries/<platform>/ */
        resources[strlen(resources) - 1] = 0;
        complete = cut(resources);
    }
    strcat(resources, "resources");
    if (!complete) {
        close_library(library);
        return NULL;
    }
    return library;
}

/* ---- the life of an instance ---- */

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation, const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean loggingOn)
{
    (void)fmuResourceLocation;
    if (!functions)
        return NULL; /* and nobody to tell */
    Instance *self = calloc(1, sizeof *self);
    if (!self)
        return NULL;
    self->importer = *functions;
    self->ours = *functions;
    self->ours.logger = from_slave;
    self->ours.componentEnvironment = self;
    self->log_categories = LOG_ALL; /* what goes wrong here is logged in any case */
    snprintf(self->name, sizeof self->name, "%s", instanceName && *instanceName ? instanceName : MODEL);
    char resources[PATH_BYTES + 16], why[512] = "";
    if (!instanceName || !*instanceName)
        snprintf(why, sizeof why, "the instance name is missing");
    else if (fmuType != fmi2CoSimulation)
        snprintf(why, sizeof why, "fmuType = %d, but this is a co-simulation FMU (%d)", (int)fmuType,
                 (int)fmi2CoSimulation);
    else if (!fmuGUID || strcmp(fmuGUID, GUID) != 0)
        snprintf(why, sizeof why, "the GUID is %.64s, but this binary belongs to %s", fmuGUID ? fmuGUID : "(null)",
                 GUID);
    else if (!has_python())
        snprintf(why, sizeof why,
                 "there is no Python in this process, and this FMU runs in one; the native FMU needs none");
    else if (!(self->library = load(&self->pythonfmu, resources)))
        snprintf(why, sizeof why, "PythonFMU's library %s could not be loaded from beside this one", LIBRARY);
    if (*why) {
        refuse(self, "fmi2Instantiate", why);
        free(self);
        return NULL;
    }
    self->slave = self->pythonfmu.fmi2Instantiate(instanceName, fmuType, fmuGUID, resources, &self->ours, visible,
                                                  fmi2True); /* categories are chosen here */
    if (!self->slave) {
        close_library(self->library);
        free(self);
        return NULL;
    }
    self->log_categories = loggingOn ? LOG_ALL : 0;
    return self;
}

void fmi2FreeInstance(fmi2Component c)
{
    Instance *self = c;
    if (!self)
        return;
    self->pythonfmu.fmi2FreeInstance(self->slave);
    close_library(self->library);
    free(self);
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories,
                               const fmi2String categories[])
{
    Instance *self = c;
    if (!self)
        return fmi2Error;
    if (nCategories > 0 && !categories)
        return refuse(self, "fmi2SetDebugLogging", "categories are announced, but the list is a null pointer");
    unsigned chosen = nCategories > 0 ? 0 : LOG_ALL;
    for (size_t k = 0; k < nCategories; k++) {
        if (!category_of(categories[k])) {
            char why[256];
            snprintf(why, sizeof why,
                     "there is no log category '%.64s'; known: logStatusError, logStatusWarning, logStatusDiscard, "
                     "logEvents, logAll",
                     categories[k] ? categories[k] : "(null)");
            return refuse(self, "fmi2SetDebugLogging", why);
        }
        chosen |= category_of(categories[k]);
    }
    self->log_categories = loggingOn ? chosen : 0;
    return fmi2OK;
}

/* ---- calls that are handed on ---- */

static fmi2Status answer(const Instance *self, fmi2Status status)
{
    return self->refused && status < fmi2Error ? fmi2Error : status;
}

#define HAND_ON(name, parameters, arguments)                                                                           \
    fmi2Status name parameters                                                                                         \
    {                                                                                                                  \
        Instance *self = c;                                                                                            \
        if (!self)                                                                                                     \
            return fmi2Error;                                                                                          \
        self->refused = false;                                                                                         \
        return answer(self, self->pythonfmu.name arguments);                                                           \
    }

#define HAND_ON_ACCESS(name, type)                                                                                     \
    fmi2Status name(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, type value[])                          \
    {                                                                                                                  \
        Instance *self = c;                                                                                            \
        if (!self)                                                                                                     \
            return fmi2Error;                                                                                          \
        if (nvr > 0 && !(vr && value))                                                                                 \
            return refuse(self, #name, "variables are announced, but a list is a null pointer");                       \
        self->refused = false;                                                                                         \
        return answer(self, self->pythonfmu.name(self->slave, vr, nvr, value));                                        \
    }

HAND_ON_ACCESS(fmi2GetReal, fmi2Real)
HAND_ON_ACCESS(fmi2GetInteger, fmi2Integer)
HAND_ON_ACCESS(fmi2GetBoolean, fmi2Boolean)
HAND_ON_ACCESS(fmi2GetString, fmi2String)
HAND_ON_ACCESS(fmi2SetReal, const fmi2Real)
HAND_ON_ACCESS(fmi2SetInteger, const fmi2Integer)
HAND_ON_ACCESS(fmi2SetBoolean, const fmi2Boolean)
HAND_ON_ACCESS(fmi2SetString, const fmi2String)
HAND_ON(fmi2ExitInitializationMode, (fmi2Component c), (self->slave))
HAND_ON(fmi2Terminate, (fmi2Component c), (self->slave))

/* PythonFMU keeps the times and gives them to the slave in fmi2EnterInitializationMode. */
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
                               fmi2Boolean stopTimeDefined, fmi2Real stopTime)
{
    Instance *self = c;
    if (!self)
        return fmi2Error;
    if (self->entered)
        return refuse(self, "fmi2SetupExperiment", "must not be called once the instance is initialized");
    char why[128] = "";
    if (!isfinite(startTime))
        snprintf(why, sizeof why, "the start time %g is not finite", startTime);
    else if (stopTimeDefined && !(stopTime >= startTime))
        snprintf(why, sizeof why, "the stop time %.15g lies before the start time %.15g", stopTime, startTime);
    if (*why)
        return refuse(self, "fmi2SetupExperiment", why);
    self->is_set_up = true;
    self->last_time = startTime;
    return self->pythonfmu.fmi2SetupExperiment(self->slave, toleranceDefined, tolerance, startTime, stopTimeDefined,
                                               stopTime);
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    Instance *self = c;
    if (!self)
        return fmi2Error;
    if (!self->is_set_up)
        return refuse(self, "fmi2EnterInitializationMode", "fmi2SetupExperiment must be called before");
    self->refused = false;
    fmi2Status status = answer(self, self->pythonfmu.fmi2EnterInitializationMode(self->slave));
    self->entered = self->entered || status == fmi2OK;
    return status;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    Instance *self = c;
    if (!self)
        return fmi2Error;
    self->is_set_up = self->entered = false;
    self->refused = false;
    return answer(self, self->pythonfmu.fmi2Reset(self->slave));
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    Instance *self = c;
    if (!self)
        return fmi2Error;
    self->refused = false;
    fmi2Status status = answer(self, self->pythonfmu.fmi2DoStep(self->slave, currentCommunicationPoint,
                                                                communicationStepSize,
                                                                noSetFMUStatePriorToCurrentPoint));
    if (status == fmi2OK)
        self->last_time = currentCommunicationPoint + communicationStepSize;
    return status;
}

/* ---- states: what the slave says of itself as bytes, in a block that says whose it is and what it must add up to ---- */

#define MAGIC UINT64_C(0x313059504d46534f) /* "OSFMPY01" on a little-endian machine */

typedef struct {
    uint64_t magic, guid, bytes, checksum; /* bytes: of what follows */
} Header;

/* FNV-1a, 64 bits. */
static uint64_t hash(const void *data, size_t bytes)
{
    const unsigned char *byte = data;
    uint64_t value = UINT64_C(14695981039346656037);
    for (size_t i = 0; i < bytes; i++)
        value = (value ^ byte[i]) * UINT64_C(1099511628211);
    return value;
}

/* Is this a state of this FMU? */
static bool is_ours(Instance *self, const char *function, const void *block, Header *header)
{
    if (!block) {
        refuse(self, function, "the state is a null pointer");
        return false;
    }
    memcpy(header, block, sizeof *header);
    if (header->magic == MAGIC && header->guid == hash(GUID, strlen(GUID)))
        return true;
    refuse(self, function, "the state does not belong to " MODEL " with the GUID " GUID);
    return false;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    if (!c)
        return fmi2Error;
    if (FMUstate) {
        free(*FMUstate);
        *FMUstate = NULL;
    }
    return fmi2OK;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    Instance *self = c;
    if (!self)
        return fmi2Error;
    if (!FMUstate)
        return refuse(self, "fmi2GetFMUstate", "FMUstate is a null pointer");
    self->refused = false;
    fmi2FMUstate taken = NULL;
    size_t bytes = 0;
    fmi2Status status = answer(self, self->pythonfmu.fmi2GetFMUstate(self->slave, &taken));
    if (status != fmi2OK)
        return status;
    char *block = NULL;
    status = self->pythonfmu.fmi2SerializedFMUstateSize(self->slave, taken, &bytes);
    if (status == fmi2OK && !(block = malloc(sizeof(Header) + bytes)))
        status = refuse(self, "fmi2GetFMUstate", "there is no memory for the state");
    if (status == fmi2OK)
        status = self->pythonfmu.fmi2SerializeFMUstate(self->slave, taken, block + sizeof(Header), bytes);
    self->pythonfmu.fmi2FreeFMUstate(self->slave, &taken);
    if (status != fmi2OK) {
        free(block);
        return status;
    }
    Header header = {MAGIC, hash(GUID, strlen(GUID)), bytes, hash(block + sizeof(Header), bytes)};
    memcpy(block, &header, sizeof header);
    free(*FMUstate);
    *FMUstate = block;
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate)
{
    Instance *self = c;
    Header header;
    if (!self || !is_ours(self, "fmi2SetFMUstate", FMUstate, &header))
        return fmi2Error;
    fmi2FMUstate given = NULL;
    self->refused = false;
    fmi2Status status = self->pythonfmu.fmi2DeSerializeFMUstate(self->slave, (char *)FMUstate + sizeof header,
                                                                (size_t)header.bytes, &given);
    if (status != fmi2OK)
        return status;
    status = answer(self, self->pythonfmu.fmi2SetFMUstate(self->slave, given));
    self->pythonfmu.fmi2FreeFMUstate(self->slave, &given);
    if (status == fmi2OK) { /* from here on the slave alone knows */
        self->is_set_up = true;
        self->entered = false;
    }
    return status;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size)
{
    Instance *self = c;
    Header header;
    if (!self || !is_ours(self, "fmi2SerializedFMUstateSize", FMUstate, &header) || !size)
        return fmi2Error;
    *size = sizeof header + (size_t)header.bytes;
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[], size_t size)
{
    Instance *self = c;
    Header header;
    if (!self || !is_ours(self, "fmi2SerializeFMUstate", FMUstate, &header))
        return fmi2Error;
    if (!serializedState || size != sizeof header + header.bytes)
        return refuse(self, "fmi2SerializeFMUstate", "the buffer is not of the state's size");
    memcpy(serializedState, FMUstate, size);
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size,
                                   fmi2FMUstate *FMUstate)
{
    Instance *self = c;
    Header header;
    const char *function = "fmi2DeSerializeFMUstate";
    if (!self)
        return fmi2Error;
    if (!FMUstate || size < sizeof header)
        return refuse(self, function, "FMUstate is a null pointer, or the bytes are too few");
    if (!is_ours(self, function, serializedState, &header))
        return fmi2Error;
    if (size != sizeof header + header.bytes ||
        header.checksum != hash(serializedState + sizeof header, size - sizeof header))
        return refuse(self, function, "the bytes are damaged, their number or checksum differs");
    void *block = malloc(size);
    if (!block)
        return refuse(self, function, "there is no memory for the state");
    memcpy(block, serializedState, size);
    free(*FMUstate);
    *FMUstate = block;
    return fmi2OK;
}

/* ---- what neither offers ---- */

static fmi2Status not_supported(Instance *self, const char *function)
{
    return self ? refuse(self, function, "is not supported by this FMU, as its model description says") : fmi2Error;
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                       const fmi2Integer order[], const fmi2Real value[])
{
    (void)vr, (void)nvr, (void)order, (void)value;
    return not_supported(c, "fmi2SetRealInputDerivatives");
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                        const fmi2Integer order[], fmi2Real value[])
{
    (void)vr, (void)nvr, (void)order, (void)value;
    return not_supported(c, "fmi2GetRealOutputDerivatives");
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[], size_t nUnknown,
                                        const fmi2ValueReference vKnown_ref[], size_t nKnown, const fmi2Real dvKnown[],
                                        fmi2Real dvUnknown[])
{
    (void)vUnknown_ref, (void)nUnknown, (void)vKnown_ref, (void)nKnown, (void)dvKnown, (void)dvUnknown;
    return not_supported(c, "fmi2GetDirectionalDerivative");
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    return c ? refuse(c, "fmi2CancelStep", "no step is in progress, fmi2DoStep never returns fmi2Pending") : fmi2Error;
}

static fmi2Status no_such_status(Instance *self, const char *function)
{
    if (!self)
        return fmi2Error;
    char text[128];
    snprintf(text, sizeof text, "%s: there is no such status, fmi2DoStep never returns fmi2Pending.", function);
    report(self, fmi2Discard, LOG_DISCARD, text);
    return fmi2Discard;
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind s, fmi2Status *value)
{
    (void)s, (void)value;
    return no_such_status(c, "fmi2GetStatus");
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value)
{
    Instance *self = c;
    if (!self || s != fmi2LastSuccessfulTime || !value)
        return no_such_status(self, "fmi2GetRealStatus");
    *value = self->last_time;
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind s, fmi2Integer *value)
{
    (void)s, (void)value;
    return no_such_status(c, "fmi2GetIntegerStatus");
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value)
{
    Instance *self = c;
    if (!self || s != fmi2Terminated || !value)
        return no_such_status(self, "fmi2GetBooleanStatus");
    *value = fmi2False; /* the component itself never asks to end a simulation */
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind s, fmi2String *value)
{
    (void)s, (void)value;
    return no_such_status(c, "fmi2GetStringStatus");
}
