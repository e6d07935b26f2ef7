/* Between the importer and PythonFMU's library, which stands beside this one: every call is handed on, and what
   PythonFMU lacks is added. A call in which the slave logged an error returns fmi2Error; the GUID is compared; messages
   obey the chosen categories; null pointers are refused; states say whose they are; without a Python in the process
   there is a message, where the bare library could not even be loaded. */
#ifndef RELAY_H
#define RELAY_H

#include <stdbool.h>
#include <stddef.h>

#include "fmi2Functions.h"
#include "identity.h"

/* What is taken from PythonFMU's library. */
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

typedef struct {
    fmi2CallbackFunctions importer; /* what the importer gave */
    fmi2CallbackFunctions ours;     /* what PythonFMU keeps a pointer to */
    Functions pythonfmu;
    void *library;
    fmi2Component slave;
    unsigned log_categories;
    unsigned first_categories; /* chosen at instantiation: those after a reset */
    bool refused, warned;    /* the slave logged an error, a warning during this call */
    bool is_set_up, entered; /* fmi2SetupExperiment and fmi2EnterInitializationMode were called */
    char name[256];
} Instance;

#define DERIVATIVES 0x40000000u /* value references from here on: derivatives of the inputs, between relay and slave */
#define TIME 0x50000000u        /* this one: the slave's time */

/* messages.c */
unsigned category_of(const char *name);
void report(Instance *self, fmi2Status status, Category category, const char *text);
fmi2Status refuse(Instance *self, const char *function, const char *why);
void from_slave(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                fmi2String message, ...);
fmi2Status answer(const Instance *self, fmi2Status status);

/* library.c */
#define PATH_BYTES 4096
bool has_python(void);
void *load_library(Functions *functions, char resources[PATH_BYTES + 16]);
void close_library(void *library);

#endif
