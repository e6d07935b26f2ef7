/* States: what the slave says of itself as bytes, in a block that says whose it is and what it must add up to. */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "relay.h"

#define MAGIC UINT64_C(0x323059504d46534f) /* "OSFMPY02" on a little-endian machine */

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
    if (!self || !is_ours(self, "fmi2SerializedFMUstateSize", FMUstate, &header))
        return fmi2Error;
    if (!size)
        return refuse(self, "fmi2SerializedFMUstateSize", "the place for the size is a null pointer");
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
