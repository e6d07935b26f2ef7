/* The whole state of an instance as one block of bytes: taken, put back, and serialised for another process.

   Header, then doubles. Everything is eight bytes wide, and a serialised state says to which FMU it belongs, how long
   it is and what it must add up to; so it can be resumed bit for bit wherever the same FMU runs, and nothing else is
   taken for one. A checksum is no proof: what the state holds must be what an instance can hold. */
#include <math.h>
#include <string.h>

#include "border.h"

#define MAGIC UINT64_C(0x323053554d46534f) /* "OSFMUS02" on a little-endian machine */

typedef struct {
    uint64_t magic, guid, bytes, checksum;
    Run run;
} Header;

typedef struct {
    double *values;
    size_t n;
} Section;

#define N_SECTIONS 5

static void list_sections(const Instance *self, Section sections[N_SECTIONS])
{
    sections[0] = (Section){self->z, component.n_states};
    sections[1] = (Section){self->values, component.n_inputs + component.n_parameters};
    sections[2] = (Section){self->du, component.n_inputs};
    sections[3] = (Section){self->breaks, component.n_breaks};
    sections[4] = (Section){self->counts, component.n_counters};
}

static size_t state_bytes(void)
{
    return sizeof(Header) + sizeof(double) * (component.n_states + 2 * component.n_inputs + component.n_parameters +
                                              component.n_breaks + component.n_counters);
}

/* FNV-1a, 64 bits. */
static uint64_t hash(const void *data, size_t bytes)
{
    const unsigned char *byte = data;
    uint64_t value = UINT64_C(14695981039346656037);
    for (size_t i = 0; i < bytes; i++)
        value = (value ^ byte[i]) * UINT64_C(1099511628211);
    return value;
}

static uint64_t payload_checksum(const void *block)
{
    return hash((const char *)block + offsetof(Header, run), state_bytes() - offsetof(Header, run));
}

/* The block behind *state, allocated if there is none yet. NULL after a message. */
static void *provide(Instance *self, const char *function, fmi2FMUstate *state)
{
    if (!state) {
        report(self, fmi2Error, LOG_ERROR, "%s: FMUstate is a null pointer.", function);
        return NULL;
    }
    if (!*state) {
        *state = self->callbacks.allocateMemory(1, state_bytes());
        if (!*state)
            report(self, fmi2Error, LOG_ERROR, "%s: allocateMemory refused %lu bytes.", function,
                   (unsigned long)state_bytes());
    }
    return *state;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    Instance *self = c;
    if (!allowed(self, "fmi2GetFMUstate", ANY_STATE))
        return fmi2Error;
    char *block = provide(self, "fmi2GetFMUstate", FMUstate);
    if (!block)
        return fmi2Error;
    Header header = {MAGIC, hash(component.guid, strlen(component.guid)), state_bytes(), 0, self->run};
    memcpy(block, &header, sizeof header);
    block += sizeof header;
    Section sections[N_SECTIONS];
    list_sections(self, sections);
    for (size_t i = 0; i < N_SECTIONS; i++) {
        memcpy(block, sections[i].values, sections[i].n * sizeof(double));
        block += sections[i].n * sizeof(double);
    }
    return fmi2OK;
}

/* Is this a state of this FMU? */
static bool is_ours(Instance *self, const char *function, const void *block)
{
    if (!block) {
        report(self, fmi2Error, LOG_ERROR, "%s: the state is a null pointer.", function);
        return false;
    }
    Header header;
    memcpy(&header, block, sizeof header);
    if (header.magic != MAGIC || header.guid != hash(component.guid, strlen(component.guid)) ||
        header.bytes != state_bytes()) {
        report(self, fmi2Error, LOG_ERROR, "%s: the state does not belong to %s with the GUID %s.", function,
               component.name, component.guid);
        return false;
    }
    return true;
}

static bool is_flag(int64_t value)
{
    return value == 0 || value == 1;
}

static bool is_sound_run(const Run *run)
{
    return (run->lifecycle == INSTANTIATED || run->lifecycle == INITIALIZATION || run->lifecycle == STEP_COMPLETE ||
            run->lifecycle == TERMINATED) &&
           is_flag(run->is_set_up) && (run->is_set_up || run->lifecycle == INSTANTIATED) &&
           is_flag(run->stop_time_defined) && is_flag(run->extrapolates) &&
           (!run->stop_time_defined || run->stop_time >= run->clock.t0) && clock_is_sound(&run->clock);
}

/* The i-th of the doubles after the header; serialised bytes need not be aligned. */
static double number(const char *block, size_t i)
{
    double value;
    memcpy(&value, block + sizeof(Header) + i * sizeof value, sizeof value);
    return value;
}

/* u and p: whole numbers where the type asks for them, parameters within their bounds. */
static bool are_sound_values(const char *block)
{
    for (size_t i = 0; i < component.n_inputs + component.n_parameters; i++) {
        const Variable *variable = &component.variables[i];
        double value = number(block, component.n_states + i);
        if ((variable->type != REAL && value != rint(value)) || (variable->type == BOOLEAN && value != 0 && value != 1))
            return false;
        if (variable->role != INPUT && !(isfinite(value) && variable->min <= value && value <= variable->max))
            return false;
    }
    return true;
}

/* What follows once the run has started: the clock's unit and the breaks from the parameters, numbers in z and counts. */
static bool is_sound_motion(const Run *run, const char *block)
{
    size_t p = component.n_states + component.n_inputs, breaks = p + component.n_parameters + component.n_inputs;
    int named = component.sample_time_parameter;
    if (run->clock.sample_time != (named >= 0 ? number(block, p + (size_t)named) : component.sample_time))
        return false;
    for (size_t i = 0; i < component.n_states; i++)
        if (!isfinite(number(block, i)))
            return false;
    if (component.n_failures > 0 && number(block, component.n_states - 3) != 0)
        return false;
    for (size_t i = 0; i < component.n_counters; i++)
        if (!isfinite(number(block, breaks + component.n_breaks + i)))
            return false;
    for (size_t i = 0; i < component.n_breaks; i++) {
        double instant = number(block, breaks + i);
        size_t k = 0;
        while (k < component.n_breaks && number(block, p + component.breaks[k]) - run->clock.t0 != instant)
            k++;
        if (k == component.n_breaks || (i > 0 && number(block, breaks + i - 1) > instant))
            return false;
    }
    return true;
}

/* Can an instance be in this state of ours? */
static bool is_sound(Instance *self, const char *function, const char *block)
{
    Header header;
    memcpy(&header, block, sizeof header);
    bool started = header.run.lifecycle == STEP_COMPLETE || header.run.lifecycle == TERMINATED;
    if (is_sound_run(&header.run) && are_sound_values(block) && (!started || is_sound_motion(&header.run, block)))
        return true;
    report(self, fmi2Error, LOG_ERROR, "%s: the state holds what no instance of %s can hold.", function,
           component.name);
    return false;
}

fmi2Status set_state(Instance *self, const char *block)
{
    if (!allowed(self, "fmi2SetFMUstate", ANY_STATE) || !is_ours(self, "fmi2SetFMUstate", block) ||
        !is_sound(self, "fmi2SetFMUstate", block))
        return fmi2Error;
    Header header;
    memcpy(&header, block, sizeof header);
    block += sizeof header;
    self->run = header.run;
    Section sections[N_SECTIONS];
    list_sections(self, sections);
    for (size_t i = 0; i < N_SECTIONS; i++) {
        memcpy(sections[i].values, block, sections[i].n * sizeof(double));
        block += sections[i].n * sizeof(double);
    }
    self->stale_outputs = true;
    self->stale_start = self->run.lifecycle == INSTANTIATED || self->run.lifecycle == INITIALIZATION;
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    Instance *self = c;
    if (!self)
        return fmi2Error;
    if (FMUstate && *FMUstate) {
        self->callbacks.freeMemory(*FMUstate);
        *FMUstate = NULL;
    }
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size)
{
    Instance *self = c;
    if (!allowed(self, "fmi2SerializedFMUstateSize", ANY_STATE) ||
        !is_ours(self, "fmi2SerializedFMUstateSize", FMUstate))
        return fmi2Error;
    if (!size) {
        report(self, fmi2Error, LOG_ERROR, "fmi2SerializedFMUstateSize: the place for the size is a null pointer.");
        return fmi2Error;
    }
    *size = state_bytes();
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[], size_t size)
{
    Instance *self = c;
    if (!allowed(self, "fmi2SerializeFMUstate", ANY_STATE) || !is_ours(self, "fmi2SerializeFMUstate", FMUstate))
        return fmi2Error;
    if (!serializedState || size != state_bytes()) {
        report(self, fmi2Error, LOG_ERROR, "fmi2SerializeFMUstate: the buffer holds %lu bytes, the state has %lu.",
               serializedState ? (unsigned long)size : 0ul, (unsigned long)state_bytes());
        return fmi2Error;
    }
    memcpy(serializedState, FMUstate, size);
    uint64_t checksum = payload_checksum(FMUstate);
    memcpy(serializedState + offsetof(Header, checksum), &checksum, sizeof checksum);
    return fmi2OK;
}

fmi2Status deserialize_state(Instance *self, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    if (!allowed(self, "fmi2DeSerializeFMUstate", ANY_STATE))
        return fmi2Error;
    if (size != state_bytes()) {
        report(self, fmi2Error, LOG_ERROR, "fmi2DeSerializeFMUstate: %lu bytes, but a state of %s has %lu.",
               (unsigned long)size, component.name, (unsigned long)state_bytes());
        return fmi2Error;
    }
    if (!is_ours(self, "fmi2DeSerializeFMUstate", bytes))
        return fmi2Error;
    Header header;
    memcpy(&header, bytes, sizeof header);
    if (header.checksum != payload_checksum(bytes)) {
        report(self, fmi2Error, LOG_ERROR, "fmi2DeSerializeFMUstate: the bytes are damaged, their checksum differs.");
        return fmi2Error;
    }
    if (!is_sound(self, "fmi2DeSerializeFMUstate", bytes))
        return fmi2Error;
    void *block = provide(self, "fmi2DeSerializeFMUstate", state);
    if (!block)
        return fmi2Error;
    memcpy(block, bytes, size);
    return fmi2OK;
}
