/* Messages to the importer, silent until logging is on, and what those of the slave mean for the call. */
#include <stdio.h>
#include <string.h>

#include "relay.h"

static const struct {
    const char *name;
    unsigned categories;
} CATEGORIES[] = {
    {"logStatusError", LOG_ERROR},     {"logStatusWarning", LOG_WARNING}, {"logStatusDiscard", LOG_DISCARD},
    {"logEvents", LOG_EVENTS},         {"logAll", LOG_ALL},
};
#define N_CATEGORIES (sizeof CATEGORIES / sizeof CATEGORIES[0])

unsigned category_of(const char *name)
{
    for (size_t i = 0; name && i < N_CATEGORIES; i++)
        if (strcmp(name, CATEGORIES[i].name) == 0)
            return CATEGORIES[i].categories;
    return 0;
}

void report(Instance *self, fmi2Status status, Category category, const char *text)
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

fmi2Status refuse(Instance *self, const char *function, const char *why)
{
    char text[512];
    snprintf(text, sizeof text, "%s: %s.", function, why);
    report(self, fmi2Error, LOG_ERROR, text);
    return fmi2Error;
}

/* The logger that PythonFMU gets. Its own messages, of exceptions in its code, have no category. */
void from_slave(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                       fmi2String message, ...)
{
    (void)name;
    Instance *self = environment;
    unsigned chosen = category_of(category);
    if (status >= fmi2Error)
        self->refused = true;
    if (status == fmi2Warning)
        self->warned = true;
    report(self, status, chosen == 0 || chosen == LOG_ALL ? LOG_ERROR : (Category)chosen, message);
}

/* What the importer gets for a call that PythonFMU answered with `status`. */
fmi2Status answer(const Instance *self, fmi2Status status)
{
    return self->refused && status < fmi2Error ? fmi2Error : status;
}
