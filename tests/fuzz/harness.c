/* Reads a run of FMI calls out of libFuzzer's bytes and checks what holds for every run:

   - a call that returns fmi2Error leaves the serialised state as it was;
   - a step taken twice from the same state gives the same bits;
   - while all inputs are finite, no Real that is read with fmi2OK is NaN or infinite;
   - bytes that are not a state of this FMU are refused;
   - all memory is given back.

   fmu.h, generated from the model description, says what the FMU is called and what its variables are. A byte 0 stands for
   what an importer ordinarily does, so that a short input is an ordinary run. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#include "fmu.h"

#define CHECKSUM 24 /* where it is in a serialised state, and what it covers begins behind it */
#define PAYLOAD 32
#define MOST 8 /* variables in a call */
#define LONGEST 10000 /* sample times in a step */

typedef struct {
    fmi2Component instance;
    fmi2FMUstate state; /* taken from it */
    double now;
    int finite; /* all that was set so far is */
} Slave;

static const uint8_t *next, *end;
static uint64_t calls;
static long blocks, until_refused; /* blocks: not given back yet; until_refused: allocations, 0: none is */
static int watching; /* the harness itself asks: memory does not run out */
static Slave slaves[2];

static void stop(const char *what, const char *which) {
    fprintf(stderr, "FINDING: %s: %s\n", what, which);
    abort();
}

static unsigned byte(void) {
    return next < end ? *next++ : 0;
}

/* ---- values ------------------------------------------------------------------------------------------------------ */

static double real(void) {
    static const double special[] = {0,    -0.0, 1,     -1,     0.1,     1e-3,     1e-6, 1e-9,  5e-324, 1e3,
                                     1e6,  1e9,  1e15,  1e100,  1e300,   -1e300,   2,    10,    -10,    0.5,
                                     1e17, -1e6, 1e-15, 1.0 / 3, INFINITY, -INFINITY, NAN, 1e154, -1e154};
    unsigned how = byte();
    if (how < 64)
        return how / 32.0 - 1;
    if (how < 192)
        return special[how % (sizeof special / sizeof *special)];
    uint64_t bits = 0;
    for (int i = 0; i < 8; i++)
        bits = bits << 8 | byte();
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static double step_size(void) {
    unsigned how = byte();
    if (how < 128)
        return STEP;
    if (how < 160)
        return STEP / (1 + how % 32);
    if (how < 176)
        return STEP * (1 + 1e-8 * ((int)how - 168)); /* the sum of somebody's rounding */
    if (how < 184)
        return rint(STEP * 1e9) / 1e9;
    if (how < 192)
        return STEP * (how - 183);
    double value = real();
    return value > LONGEST * STEP && how < 250 ? STEP : value;
}

/* The time that an importer calls the current one. */
static double time_of(const Slave *slave) {
    unsigned how = byte();
    if (how < 128)
        return slave->now;
    if (how < 160)
        return rint(slave->now * 1e9) / 1e9;
    if (how < 192)
        return rint(slave->now * 1e6) / 1e6;
    if (how < 224)
        return slave->now + STEP * ((int)how - 208);
    return real();
}

/* ---- callbacks --------------------------------------------------------------------------------------------------- */

static void logger(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                   fmi2String message, ...) {
    (void)environment;
    if (!name || !category || !message || status > fmi2Pending)
        stop("logger", "a null pointer or no status");
    if (strpbrk(message, "%#") || strlen(message) < 3)
        stop("logger", message);
}

static void *allocate(size_t count, size_t size) {
    if (!watching && until_refused > 0 && --until_refused == 0)
        return NULL;
    void *block = calloc(count, size);
    blocks += block != NULL;
    return block;
}

static void give_back(void *block) {
    blocks -= block != NULL;
    free(block);
}

static const fmi2CallbackFunctions callbacks = {logger, allocate, give_back, NULL, NULL};

/* ---- what is watched --------------------------------------------------------------------------------------------- */

typedef struct {
    size_t size;
    char *bytes;
} Bytes;

/* The serialised state, or nothing where the instance cannot say. */
static Bytes serialised(fmi2Component instance) {
    Bytes found = {0, NULL};
    fmi2FMUstate state = NULL;
    if (!instance)
        return found;
    watching = 1;
    if (fmi2GetFMUstate(instance, &state) == fmi2OK &&
        fmi2SerializedFMUstateSize(instance, state, &found.size) == fmi2OK) {
        found.bytes = malloc(found.size);
        if (fmi2SerializeFMUstate(instance, state, found.bytes, found.size) != fmi2OK)
            stop("fmi2SerializeFMUstate", "refuses a state that was just taken");
    }
    if (state)
        fmi2FreeFMUstate(instance, &state);
    watching = 0;
    return found;
}

static void same(Bytes one, Bytes two, const char *claim, const char *call) {
    if (one.size != two.size || (one.size && memcmp(one.bytes, two.bytes, one.size) != 0))
        stop(claim, call);
}

/* Make a call; where it returns fmi2Error or worse, the state must be as before. */
#define TRY(instance, status, call)                                                                                    \
    do {                                                                                                               \
        Bytes before = serialised(instance);                                                                           \
        calls++;                                                                                                       \
        status = call;                                                                                                 \
        if (status > fmi2Pending)                                                                                      \
            stop("no status", #call);                                                                                  \
        if (status >= fmi2Error) {                                                                                     \
            Bytes after = serialised(instance);                                                                        \
            same(before, after, "state changed by a refused call", #call);                                             \
            free(after.bytes);                                                                                         \
        }                                                                                                              \
        free(before.bytes);                                                                                            \
    } while (0)

/* ---- the calls --------------------------------------------------------------------------------------------------- */

static size_t references(fmi2ValueReference *into) {
    size_t n = byte() % (MOST + 1);
    for (size_t i = 0; i < n; i++) {
        unsigned which = byte();
        into[i] = which == 255 ? 4000000000u : which % (N_VARIABLES + 1);
    }
    return n;
}

static void instantiate(Slave *slave) {
    static const fmi2CallbackFunctions half = {logger, allocate, NULL, NULL, NULL}, quiet = {NULL, allocate, give_back, NULL, NULL};
    unsigned how = byte();
    if (slave->instance)
        return;
    calls++;
    slave->instance = fmi2Instantiate(how == 255 ? NULL : how == 254 ? "" : "%n instance", how == 253 ? fmi2ModelExchange : fmi2CoSimulation,
                                      how == 252 ? NULL : how == 251 ? "{}" : GUID, how == 250 ? NULL : RESOURCES,
                                      how == 249 ? NULL : how == 248 ? &half : how == 247 ? &quiet : &callbacks, fmi2False,
                                      how % 2 == 0);
    slave->now = 0;
    slave->finite = 1;
    if (slave->instance && how > 250)
        stop("fmi2Instantiate", "accepts what it must refuse");
}

static void drop_state(Slave *slave) {
    if (slave->state)
        fmi2FreeFMUstate(slave->instance, &slave->state);
    slave->state = NULL;
}

static void free_instance(Slave *slave) {
    if (slave->instance)
        drop_state(slave);
    calls++;
    fmi2FreeInstance(slave->instance);
    slave->instance = NULL;
}

static void set_up(Slave *slave) {
    unsigned how = byte();
    double start = how < 128 ? 0 : real(), until = how % 2 ? real() : 0;
    fmi2Status status;
    TRY(slave->instance, status, fmi2SetupExperiment(slave->instance, how % 3 == 1, 1e-6, start, how % 2, until));
    if (status == fmi2OK)
        slave->now = start;
}

/* The inputs that come after an error of the arithmetic are finite again, but what they met may not be: only a reset or
   another state makes the slave one whose inputs were finite. */
static void set_real(Slave *slave) {
    fmi2ValueReference vr[MOST];
    fmi2Real values[MOST];
    size_t n = references(vr);
    fmi2Status status;
    for (size_t i = 0; i < n; i++)
        values[i] = real();
    TRY(slave->instance, status, fmi2SetReal(slave->instance, vr, n, values));
    for (size_t i = 0; i < n && status == fmi2OK; i++)
        slave->finite &= isfinite(values[i]) != 0;
}

static void get_real(Slave *slave) {
    fmi2ValueReference vr[MOST];
    fmi2Real values[MOST];
    size_t n = references(vr);
    fmi2Status status;
    TRY(slave->instance, status, fmi2GetReal(slave->instance, vr, n, values));
    for (size_t i = 0; i < n && status == fmi2OK; i++)
        if (slave->finite && !isfinite(values[i]))
            stop("not finite after finite inputs", NAMES[vr[i]]);
}

static void access_whole_numbers(Slave *slave, unsigned kind) {
    fmi2ValueReference vr[MOST];
    fmi2Integer values[MOST];
    size_t n = references(vr);
    fmi2Status status;
    for (size_t i = 0; i < n; i++) {
        unsigned how = byte();
        values[i] = how < 250 ? (int)how % 8 : how == 250 ? INT32_MAX : how == 251 ? INT32_MIN : -1;
    }
    switch (kind) {
    case 0: TRY(slave->instance, status, fmi2SetInteger(slave->instance, vr, n, values)); break;
    case 1: TRY(slave->instance, status, fmi2GetInteger(slave->instance, vr, n, values)); break;
    case 2: TRY(slave->instance, status, fmi2SetBoolean(slave->instance, vr, n, values)); break;
    default: TRY(slave->instance, status, fmi2GetBoolean(slave->instance, vr, n, values));
    }
}

static void null_pointers(Slave *slave) {
    fmi2ValueReference vr[1] = {0};
    fmi2Status status, answer;
    fmi2Real number;
    fmi2String text = NULL;
    switch (byte() % 10) {
    case 0: TRY(slave->instance, status, fmi2SetReal(slave->instance, vr, 1, NULL)); break;
    case 1: TRY(slave->instance, status, fmi2GetReal(slave->instance, NULL, 1, &number)); break;
    case 2: TRY(slave->instance, status, fmi2GetInteger(slave->instance, vr, 1, NULL)); break;
    case 3: TRY(slave->instance, status, fmi2SetRealInputDerivatives(slave->instance, vr, 1, NULL, &number)); break;
    case 4: TRY(slave->instance, status, fmi2GetFMUstate(slave->instance, NULL)); break;
    case 5: TRY(slave->instance, status, fmi2SetFMUstate(slave->instance, NULL)); break;
    case 6: TRY(slave->instance, status, fmi2GetRealStatus(slave->instance, fmi2LastSuccessfulTime, NULL)); break;
    case 7: TRY(slave->instance, status, fmi2GetBooleanStatus(slave->instance, fmi2Terminated, NULL)); break;
    case 8: TRY(slave->instance, status, fmi2SetString(slave->instance, vr, 1, &text)); break;
    default: TRY(NULL, status, fmi2DoStep(NULL, 0, STEP, fmi2True));
    }
    if (status < fmi2Discard)
        stop("accepted", "a null pointer");
    fmi2GetStatus(slave->instance, (fmi2StatusKind)(byte() % 5), &answer);
}

static void derivatives(Slave *slave) {
    fmi2ValueReference vr[MOST];
    fmi2Integer order[MOST];
    fmi2Real values[MOST];
    size_t n = references(vr);
    fmi2Status status;
    for (size_t i = 0; i < n; i++) {
        order[i] = byte() < 250 ? 1 : 2;
        values[i] = real();
    }
    TRY(slave->instance, status, fmi2SetRealInputDerivatives(slave->instance, vr, n, order, values));
    for (size_t i = 0; i < n && status == fmi2OK; i++)
        slave->finite &= isfinite(values[i]) != 0;
}

static void step(Slave *slave) {
    double h = step_size(), t = time_of(slave);
    fmi2Status status;
    TRY(slave->instance, status, fmi2DoStep(slave->instance, t, h, fmi2True));
    if (status == fmi2OK)
        slave->now = t + h;
}

/* One step, twice from the same state: the same answer and the same bits. */
static void step_back_and_again(Slave *slave) {
    double h = step_size(), t = time_of(slave);
    fmi2FMUstate start = NULL;
    fmi2Status first, second;
    watching = 1;
    int taken = slave->instance && fmi2GetFMUstate(slave->instance, &start) == fmi2OK;
    watching = 0;
    if (!taken)
        return;
    TRY(slave->instance, first, fmi2DoStep(slave->instance, t, h, fmi2False));
    Bytes one = serialised(slave->instance);
    watching = 1;
    if (fmi2SetFMUstate(slave->instance, start) != fmi2OK)
        stop("fmi2SetFMUstate", "refuses a state that was just taken");
    watching = 0;
    TRY(slave->instance, second, fmi2DoStep(slave->instance, t, h, fmi2False));
    Bytes two = serialised(slave->instance);
    if (first != second)
        stop("rollback", "the step returned otherwise");
    same(one, two, "rollback", "the step went otherwise");
    free(one.bytes);
    free(two.bytes);
    fmi2FreeFMUstate(slave->instance, &start);
    if (first == fmi2OK)
        slave->now = t + h;
}

static void take_state(Slave *slave) {
    fmi2Status status;
    TRY(slave->instance, status, fmi2GetFMUstate(slave->instance, &slave->state));
}

static void set_state(Slave *slave, const Slave *from) {
    fmi2Status status;
    double now;
    TRY(slave->instance, status, fmi2SetFMUstate(slave->instance, from->state));
    if (status != fmi2OK)
        return;
    slave->finite = 0; /* it may be from a run whose inputs were not */
    if (fmi2GetRealStatus(slave->instance, fmi2LastSuccessfulTime, &now) == fmi2OK)
        slave->now = now;
}

static uint64_t fnv(const char *bytes, size_t n) {
    uint64_t value = UINT64_C(14695981039346656037);
    for (size_t i = 0; i < n; i++)
        value = (value ^ (unsigned char)bytes[i]) * UINT64_C(1099511628211);
    return value;
}

/* Bytes that were a state once: cut, damaged, of another FMU, or forged with a right checksum. */
static void deserialise(Slave *slave) {
    Bytes state = serialised(slave->instance);
    unsigned how = byte() % 8;
    int genuine = 1;
    fmi2FMUstate made = NULL;
    fmi2Status status;
    if (!state.bytes)
        return;
    size_t size = state.size;
    if (how == 1) {
        size = size * byte() / 256;
        genuine = 0;
    }
    for (unsigned n = how == 2 || how >= 4 ? 1 + byte() % 8 : 0; n > 0; n--) {
        size_t at = (byte() * 256 + byte()) % state.size;
        unsigned flip = byte();
        if (how >= 4) /* where the run is, or a number */
            at = PAYLOAD + at % (at % 2 ? state.size - PAYLOAD : 88);
        state.bytes[at] ^= (char)flip;
        genuine &= flip == 0 || how >= 4;
    }
    if (how == 3) {
        state.bytes[8 + byte() % 8] ^= 1;
        genuine = 0;
    }
    if (how >= 4) {
        uint64_t sum = fnv(state.bytes + PAYLOAD, state.size - PAYLOAD);
        memcpy(state.bytes + CHECKSUM, &sum, sizeof sum);
    }
    /* A copy of exactly `size` bytes, so that the sanitizer sees who reads on. */
    char *bytes = malloc(size ? size : 1);
    memcpy(bytes, state.bytes, size);
    TRY(slave->instance, status, fmi2DeSerializeFMUstate(slave->instance, bytes, size, &made));
    if (status == fmi2OK && !genuine) {
        Bytes now = serialised(slave->instance); /* flips can cancel out */
        if (size != now.size || memcmp(bytes, now.bytes, size) != 0)
            stop("fmi2DeSerializeFMUstate", "took what is no state of this FMU");
        free(now.bytes);
    }
    if (status == fmi2OK) {
        TRY(slave->instance, status, fmi2SetFMUstate(slave->instance, made));
        if (status == fmi2OK && how >= 4)
            slave->finite = 0;
    }
    if (made)
        fmi2FreeFMUstate(slave->instance, &made);
    free(bytes);
    free(state.bytes);
}

static void foreign_state(Slave *slave) {
    static char nonsense[1 << 16];
    fmi2Status status;
    for (size_t i = 0; i < 32; i++)
        nonsense[i] = (char)byte();
    TRY(slave->instance, status, fmi2SetFMUstate(slave->instance, nonsense));
    if (status == fmi2OK)
        stop("fmi2SetFMUstate", "took nonsense");
}

static void choose_log(Slave *slave) {
    static const char *const categories[] = {"logAll", "logStatusError", "logEvents", "%s", NULL};
    fmi2String chosen[2] = {categories[byte() % 5], categories[byte() % 5]};
    size_t n = byte() % 3;
    fmi2Status status;
    TRY(slave->instance, status, fmi2SetDebugLogging(slave->instance, byte() % 2, n, n ? chosen : NULL));
}

static void ask_status(Slave *slave) {
    fmi2StatusKind kind = (fmi2StatusKind)(byte() % 5);
    fmi2Real number;
    fmi2Integer whole;
    fmi2Boolean truth;
    fmi2Status status, answer;
    fmi2String text;
    switch (byte() % 6) {
    case 0: TRY(slave->instance, status, fmi2GetRealStatus(slave->instance, kind, &number)); break;
    case 1: TRY(slave->instance, status, fmi2GetIntegerStatus(slave->instance, kind, &whole)); break;
    case 2: TRY(slave->instance, status, fmi2GetBooleanStatus(slave->instance, kind, &truth)); break;
    case 3: TRY(slave->instance, status, fmi2GetStringStatus(slave->instance, kind, &text)); break;
    case 4: TRY(slave->instance, status, fmi2GetStatus(slave->instance, kind, &answer)); break;
    default: TRY(slave->instance, status, fmi2CancelStep(slave->instance));
    }
}

/* Instantiated, set up and initialised, as most runs begin. */
static void begin(Slave *slave) {
    fmi2Status status;
    instantiate(slave);
    set_up(slave);
    TRY(slave->instance, status, fmi2EnterInitializationMode(slave->instance));
    TRY(slave->instance, status, fmi2ExitInitializationMode(slave->instance));
}

static void reset(Slave *slave) {
    fmi2Status status;
    TRY(slave->instance, status, fmi2Reset(slave->instance));
    if (status == fmi2OK)
        slave->finite = 1;
}

static void call(Slave *slave, Slave *other) {
    fmi2Status status;
    switch (byte() % 32) {
    case 0: case 20: case 21: case 22: case 23: step(slave); break;
    case 1: begin(slave); break;
    case 2: instantiate(slave); break;
    case 3: set_up(slave); break;
    case 4: TRY(slave->instance, status, fmi2EnterInitializationMode(slave->instance)); break;
    case 5: TRY(slave->instance, status, fmi2ExitInitializationMode(slave->instance)); break;
    case 6: case 24: case 25: set_real(slave); break;
    case 7: case 26: case 27: get_real(slave); break;
    case 8: access_whole_numbers(slave, byte() % 4); break;
    case 9: derivatives(slave); break;
    case 10: case 28: step_back_and_again(slave); break;
    case 11: take_state(slave); break;
    case 12: set_state(slave, slave); break;
    case 13: if (slave->instance && other->instance) set_state(slave, other); break;
    case 14: case 29: deserialise(slave); break;
    case 15: foreign_state(slave); break;
    case 16: choose_log(slave); break;
    case 17: ask_status(slave); break;
    case 18: null_pointers(slave); break;
    case 19: until_refused = byte() % 4; break;
    case 30: reset(slave); break;
    default:
        if (byte() < 200) TRY(slave->instance, status, fmi2Terminate(slave->instance));
        else free_instance(slave);
    }
}

static void say(void) {
    fprintf(stderr, "calls: %llu\n", (unsigned long long)calls);
}

int LLVMFuzzerInitialize(int *count, char ***arguments);
int LLVMFuzzerInitialize(int *count, char ***arguments) {
    (void)count, (void)arguments;
    return atexit(say);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    next = data;
    end = data + size;
    until_refused = 0;
    while (next < end) {
        unsigned which = *next >= 224; /* mostly the first */
        call(&slaves[which], &slaves[!which]);
    }
    for (int i = 0; i < 2; i++)
        free_instance(&slaves[i]);
    if (blocks != 0)
        stop("memory", "was not given back");
    return 0;
}
