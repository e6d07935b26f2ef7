/* Messages to the importer: four categories, silent until logging is on. */
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "instance.h"

static const struct {
    const char *name;
    unsigned categories;
} CATEGORIES[] = {
    {"logStatusError", LOG_ERROR},
    {"logStatusWarning", LOG_WARNING},
    {"logStatusDiscard", LOG_DISCARD},
    {"logEvents", LOG_EVENTS},
    {"logAll", LOG_ALL},
};
#define N_CATEGORIES (sizeof CATEGORIES / sizeof CATEGORIES[0])

void report(Instance *self, fmi2Status status, Category category, const char *format, ...)
{
    if (!(self->log_categories & category) || !self->callbacks.logger)
        return;
    char message[1024];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(message, sizeof message, format, arguments);
    va_end(arguments);
    /* The importer takes the text for a format in which '%' and '#' are special: text that it handed in itself must not
       become one. */
    for (char *c = message; *c; c++)
        if (*c == '%' || *c == '#')
            *c = '?';
    size_t i = 0;
    while (CATEGORIES[i].categories != (unsigned)category)
        i++;
    self->callbacks.logger(self->callbacks.componentEnvironment, self->name, status, CATEGORIES[i].name, message);
}

bool allowed(Instance *self, const char *function, unsigned lifecycles)
{
    if (!self)
        return false;
    if ((unsigned)self->run.lifecycle & lifecycles)
        return true;
    const char *state = self->run.lifecycle == INSTANTIATED     ? "instantiated"
                        : self->run.lifecycle == INITIALIZATION ? "in initialization mode"
                        : self->run.lifecycle == STEP_COMPLETE  ? "initialized"
                                                                : "terminated";
    report(self, fmi2Error, LOG_ERROR, "%s must not be called while the instance is %s.", function, state);
    return false;
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories,
                               const fmi2String categories[])
{
    Instance *self = c;
    if (!allowed(self, "fmi2SetDebugLogging", ANY_STATE))
        return fmi2Error;
    if (nCategories > 0 && !categories) {
        report(self, fmi2Error, LOG_ERROR,
               "fmi2SetDebugLogging: %lu categories announced, but the list is a null pointer.",
               (unsigned long)nCategories);
        return fmi2Error;
    }
    unsigned chosen = nCategories > 0 ? 0 : LOG_ALL;
    for (size_t k = 0; k < nCategories; k++) {
        size_t i = 0;
        while (i < N_CATEGORIES && !(categories[k] && strcmp(categories[k], CATEGORIES[i].name) == 0))
            i++;
        if (i == N_CATEGORIES) {
            report(self, fmi2Error, LOG_ERROR,
                   "fmi2SetDebugLogging: there is no log category '%s'; known: logStatusError, logStatusWarning, "
                   "logStatusDiscard, logEvents, logAll.",
                   categories[k] ? categories[k] : "(null)");
            return fmi2Error;
        }
        chosen |= CATEGORIES[i].categories;
    }
    self->log_categories = loggingOn ? chosen : 0;
    return fmi2OK;
}
