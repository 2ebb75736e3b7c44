/* The master's side of a channel: functions that are called as those of an FMU, with a `Remote` in place of the instance.
 *
 * Each comes as isolated_<name>, and those that only set values also as deferred_<name>: they wait in the area until a
 * call comes whose result is wanted, and go over the channel together with it. Steps and what reads values come also as
 * foreseen_<name>: what has been read right after the same call before is asked for together with it, and the answers
 * kept until they are wanted; what is neither comes as from_loop_<name> where the loop calls it between these. So the FMU
 * sees the same calls in the same order. */
#ifndef _WIN32
#define _GNU_SOURCE
#include "channel_sides.h"
#include "core.h"
#include "loop.h"

#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

/* Statuses beyond those of FMI: the worker is gone; a call that was deferred has failed; the arguments are too large. */
enum { LOST = 110, FAILED_BEFORE, TOO_LARGE, NOT_MADE };

enum { MOST_CALLS = 128, MOST_FORESEEN = 16, MOST_LEADING = 8, LOOK = 20000000 /* ns */ };

/* Called while a call takes long, and has taken so many seconds; whether the worker is to be given up. */
typedef int GiveUp(double seconds);
typedef void Take(int status, const char *category, const char *text);
typedef void WarnedOf(int function);

/* A call that reads values, or derivatives of these orders; `at` is where its answer is, and `place` where the values
 * are. */
typedef struct {
    FunctionNumber function;
    const uint32_t *references;
    const int32_t *orders;
    size_t n_references, n;
    uint64_t size, at, place;
    void *values;
} Reading;

/* A step, or the first reading after something was set, and what is read right after it. */
typedef struct {
    Reading first; /* of a step only the function */
    Reading then[MOST_FORESEEN];
    int32_t n;
} Readings;

/* An FMU in another process. */
typedef struct {
    Channel *channel;
    uint64_t capacity; /* bytes of its area */
    GiveUp *gives_up;
    Take *take;
    WarnedOf *warned;
    void *const *asking; /* FMI 3.0: points to a pointer to the operation that answers when the FMU asks for inputs */
    Patience patience;
    uint64_t used, read; /* bytes of the calls in the area, and of messages */
    uint64_t starts[MOST_CALLS], last; /* of the calls; of the last one that was made */
    uint32_t n_calls, asked;
    int32_t failed, status; /* the deferred function that failed, and how */
    bool is_lost;
    Readings foreseen[MOST_LEADING];
    Readings *current; /* since its first call nothing was called but what is read after it; NULL for none */
    int32_t n_foreseen, n_ready, n_taken; /* how many are known; of the current one have been answered; and taken */
    uint32_t heard; /* messages of later calls are not wanted yet */
    void *values; /* what the FMU gave: pointers, and then the texts and binary values that they point to */
} Remote;

/* An argument as the caller has it. */
typedef struct {
    Passing passing;
    uint64_t value;
    const void *pointer;
    uint64_t size, n;
} Passed;

static Passed integer(int64_t value) { return (Passed){.passing = INTEGER, .value = (uint64_t)value}; }

static Passed real(double value) {
    Passed passed = {.passing = DOUBLE};
    memcpy(&passed.value, &value, sizeof value);
    return passed;
}

static Passed given(const void *bytes, uint64_t size) {
    return (Passed){.passing = bytes ? GIVEN : ABSENT, .pointer = bytes, .size = bytes ? size : 0};
}

static Passed filled(void *bytes, uint64_t size) {
    return (Passed){.passing = bytes ? FILLED : ABSENT, .pointer = bytes, .size = bytes ? size : 0};
}

static Passed text(const char *text) { return given(text, text ? strlen(text) + 1 : 0); }

static Passed texts(const char *const texts[], uint64_t n) {
    uint64_t size = 0;
    for (uint64_t i = 0; i < n; i++) size += (texts[i] ? strlen(texts[i]) : 0) + 1;
    return (Passed){.passing = texts ? TEXTS : ABSENT, .pointer = texts, .size = size, .n = n};
}

static Passed blobs(const void *const values[], const size_t sizes[], uint64_t n) {
    uint64_t size = 0;
    for (uint64_t i = 0; i < n; i++) size += sizes[i];
    return (Passed){.passing = BLOBS, .pointer = values, .size = size, .n = n};
}

static Passed given_back(Passing passing, void *values, uint64_t n) {
    return (Passed){.passing = passing, .pointer = values, .n = n};
}

/* Messages */

static void read_message(const Remote *r, void *bytes, uint64_t size, uint64_t at) {
    uint64_t first = at % MESSAGES_SIZE, whole = MESSAGES_SIZE - first;
    if (whole > size) whole = size;
    memcpy(bytes, r->channel->messages + first, whole);
    memcpy((char *)bytes + whole, r->channel->messages, size - whole);
}

/* Take the messages that have come. */
EXPORT void channel_hear(Remote *r) {
    enum { LONGEST = 8192 };
    char category[LONGEST], text[LONGEST];
    uint64_t written = __atomic_load_n(&r->channel->written, __ATOMIC_SEQ_CST);
    while (r->read != written) {
        Message message = {0};
        uint64_t left = written - r->read;
        if (left <= MESSAGES_SIZE && left >= sizeof message) read_message(r, &message, sizeof message, r->read);
        if (message.call > r->heard) break;
        uint64_t at = r->read + sizeof message, size = (uint64_t)message.category_size + message.text_size;
        if (left > MESSAGES_SIZE || left < sizeof message + size || message.category_size >= LONGEST ||
            message.text_size >= LONGEST) {
            r->read = written; /* what stands there is none of the worker's */
            break;
        }
        read_message(r, category, message.category_size, at);
        read_message(r, text, message.text_size, at + message.category_size);
        category[message.category_size] = text[message.text_size] = 0;
        r->read = at + size;
        r->take(message.status, category, text);
    }
    __atomic_store_n(&r->channel->read, r->read, __ATOMIC_SEQ_CST);
}

/* Calls */

/* Wait until what was asked for is done; false where the worker is given up. */
static bool is_answered(Remote *r) {
    Channel *channel = r->channel;
    uint32_t before = r->asked - 1;
    if (!changes_soon(&channel->answered, before, &r->patience)) {
        int64_t began = nanoseconds(), looked = began;
        while (seen(&channel->answered) == before) {
            __atomic_store_n(&channel->master_sleeps, 1, __ATOMIC_SEQ_CST);
            if (seen(&channel->answered) == before) sleep_at(&channel->answered, before, LOOK);
            __atomic_store_n(&channel->master_sleeps, 0, __ATOMIC_SEQ_CST);
            if (r->channel->written - r->read > MESSAGES_SIZE / 2) r->heard = UINT32_MAX; /* it may wait for room */
            channel_hear(r);
            int64_t now = nanoseconds();
            if (now - looked < LOOK || seen(&channel->answered) != before) continue;
            looked = now;
            if (!r->gives_up(1e-9 * (double)(now - began))) continue;
            r->is_lost = true;
            return false;
        }
    }
    if (__atomic_load_n(&channel->written, __ATOMIC_SEQ_CST) != r->read) channel_hear(r);
    return true;
}

static Call *call_in(const Remote *r, uint64_t start) { return (Call *)(r->channel->area + start); }

/* Have the calls made that stand in the area; LOST, FAILED_BEFORE where one of the first failed, or 0. */
static int have_made(Remote *r, uint32_t n_before) {
    Channel *channel = r->channel;
    channel->n_calls = r->n_calls;
    channel->used = r->used;
    channel->core = core_kept();
    tell(&channel->asked, ++r->asked, &channel->worker_sleeps);
    bool made = is_answered(r);
    r->n_calls = 0;
    r->used = 0;
    if (!made) return LOST;
    for (uint32_t k = 0; k < n_before; k++) {
        const Call *call = call_in(r, r->starts[k]);
        int status = call->status;
        if (status == 1) r->warned((int)call->function);
        else if (status) {
            r->failed = (int32_t)call->function;
            r->status = status;
            return FAILED_BEFORE;
        }
    }
    return 0;
}

static void put(Remote *r, const Passed *passed, uint64_t at) {
    char *to = (char *)r->channel->area + at;
    if (passed->passing == TEXTS)
        for (uint64_t i = 0; i < passed->n; i++) {
            const char *text = ((const char *const *)passed->pointer)[i];
            size_t size = (text ? strlen(text) : 0) + 1;
            memcpy(to, text ? text : "", size);
            to += size;
        }
    else if (passed->passing == BLOBS) {
        const size_t *sizes = passed[-1].pointer;
        for (uint64_t i = 0; i < passed->n; to += sizes[i], i++)
            if (sizes[i]) memcpy(to, ((const void *const *)passed->pointer)[i], sizes[i]);
    } else if (passed->size) memcpy(to, passed->pointer, passed->size);
}

/* Texts or binary values from behind a call to memory of our own; false where they are not as they should be. */
static bool take_back(Remote *r, const Passed *passed, uint64_t at) {
    uint64_t size, bytes = 0, n = passed->n, from = at;
    for (uint64_t i = 0; i < n; i++) {
        if (from + sizeof size > r->capacity) return false;
        memcpy(&size, r->channel->area + from, sizeof size);
        if (size > r->capacity - from - sizeof size) return false;
        from += sizeof size + size;
        bytes += size + 1;
    }
    free(r->values);
    char *to = r->values = malloc(bytes + 1);
    if (!to) return false;
    for (uint64_t i = 0; i < n; i++) {
        memcpy(&size, r->channel->area + at, sizeof size);
        if (size + 1 > bytes) return false; /* it has changed meanwhile */
        memcpy(to, r->channel->area + at + sizeof size, size);
        to[size] = 0;
        ((char **)passed->pointer)[i] = to;
        if (passed->passing == BLOBS_BACK) ((size_t *)passed[-1].pointer)[i] = size;
        at += sizeof size + size;
        to += size + 1;
        bytes -= size + 1;
    }
    return true;
}

/* What comes now is not what was foreseen. */
static void stop_foreseeing(Remote *r) {
    if (r->current && r->n_taken < r->n_ready) r->current->n = r->n_taken;
    r->n_ready = r->n_taken = 0;
    r->current = NULL;
    r->heard = UINT32_MAX;
    channel_hear(r);
}

/* Put a call behind those that are in the area, and say where its arguments are; 0, LOST, FAILED_BEFORE or TOO_LARGE. */
static int append(Remote *r, FunctionNumber function, const Passed passed[], uint32_t n, uint64_t places[]) {
    uint64_t size = sizeof(Call) + n * sizeof(Argument);
    for (uint32_t i = 0; i < n; i++) {
        places[i] = size = ALIGNED(size);
        if (passed[i].size > r->capacity) return TOO_LARGE;
        size += passed[i].size;
    }
    size = ALIGNED(size);
    if (r->n_calls == MOST_CALLS || r->used + size > r->capacity) {
        int status = r->n_calls ? have_made(r, r->n_calls) : 0;
        if (status) return status;
        if (size > r->capacity) return TOO_LARGE;
    }
    uint64_t start = r->last = r->starts[r->n_calls++] = r->used;
    r->used += size;
    Call *made = call_in(r, start);
    *made = (Call){.function = function, .n_arguments = n, .status = NOT_MADE, .end = r->used};
    Argument *argument = (Argument *)(made + 1);
    for (uint32_t i = 0; i < n; i++) {
        bool is_number = passed[i].passing <= ABSENT;
        places[i] += start;
        argument[i] =
            (Argument){passed[i].passing, is_number ? passed[i].value : places[i], passed[i].size, passed[i].n};
        if (!is_number) put(r, &passed[i], places[i]);
    }
    return 0;
}

/* Have the calls in the area made, of which one is wanted now: its status, and what it gives. */
static int have_one_made(Remote *r, uint32_t number, const Passed passed[], uint32_t n, const uint64_t places[]) {
    Call *made = call_in(r, r->starts[number]);
    uint64_t end = r->used;
    int status = have_made(r, number);
    if (status) return status;
    status = made->status;
    for (uint32_t i = 0; i < n; i++) {
        if (passed[i].passing == FILLED)
            memcpy((void *)passed[i].pointer, r->channel->area + places[i], passed[i].size);
        else if (passed[i].passing == TEXTS_BACK || passed[i].passing == BLOBS_BACK)
            if (status <= 1 && !(made->result && take_back(r, &passed[i], end))) return TOO_LARGE;
    }
    return status;
}

/* Call a function of the FMU from the loop; where it need not be at once, its status is OK, and it is made before the next
 * one that must. */
static int call_in_loop(Remote *r, FunctionNumber function, bool at_once, const Passed passed[], uint32_t n) {
    if (r->is_lost) return LOST;
    if (r->current) stop_foreseeing(r);
    uint64_t places[MOST_ARGUMENTS];
    int status = append(r, function, passed, n, places);
    if (status || !at_once) return status;
    return have_one_made(r, r->n_calls - 1, passed, n, places);
}

/* The same; where it is made at once, who calls may be anybody. */
static int call(Remote *r, FunctionNumber function, bool at_once, const Passed passed[], uint32_t n) {
    if (at_once) {
        if (r->current && !r->is_lost) stop_foreseeing(r);
        r->n_foreseen = 0; /* what the loop has read may be gone */
    }
    return call_in_loop(r, function, at_once, passed, n);
}

/* The arguments of a call that reads; its values are in the last one but `n`. */
static uint32_t arguments_of(const Reading *reading, Passed arguments[]) {
    uint32_t k = 0;
    arguments[k++] = given(reading->references, reading->n_references * sizeof *reading->references);
    arguments[k++] = integer((int64_t)reading->n_references);
    if (reading->orders) arguments[k++] = given(reading->orders, reading->n_references * sizeof *reading->orders);
    arguments[k++] = filled(reading->values, reading->size);
    if (reading->n) arguments[k++] = integer((int64_t)reading->n);
    return k;
}

static bool is_same(const Reading *a, const Reading *b) {
    return a->function == b->function && a->references == b->references && a->orders == b->orders &&
           a->n_references == b->n_references && a->values == b->values && a->size == b->size;
}

/* What is read after a call; NULL where no more are remembered. */
static Readings *readings_after(Remote *r, const Reading *first) {
    for (int32_t i = 0; i < r->n_foreseen; i++)
        if (is_same(&r->foreseen[i].first, first)) return &r->foreseen[i];
    if (r->n_foreseen == MOST_LEADING) return NULL;
    Readings *added = &r->foreseen[r->n_foreseen++];
    added->first = *first;
    added->n = 0;
    return added;
}

/* Make a call, and with it what was read right after it before. */
static int lead(Remote *r, const Reading *first, const Passed passed[], uint32_t n) {
    uint64_t places[MOST_ARGUMENTS], of_reading[MOST_ARGUMENTS];
    int status = append(r, first->function, passed, n, places);
    if (status) return status;
    uint64_t start = r->last;
    uint32_t number = r->n_calls - 1;
    Readings *readings = readings_after(r, first);
    r->heard = readings ? number : UINT32_MAX;
    int32_t n_asked = 0;
    for (; readings && n_asked < readings->n && r->n_calls < MOST_CALLS; n_asked++) {
        Reading *reading = &readings->then[n_asked];
        Passed arguments[MOST_ARGUMENTS];
        uint32_t n_arguments = arguments_of(reading, arguments);
        if (r->used + reading->size + 4096 + reading->n_references * 8 > r->capacity) break;
        append(r, reading->function, arguments, n_arguments, of_reading);
        reading->at = r->last;
        reading->place = of_reading[n_arguments - (reading->n ? 2 : 1)];
    }
    r->last = start;
    status = have_one_made(r, number, passed, n, places);
    if (status == LOST || status > 1 || !readings) {
        r->heard = UINT32_MAX;
        return status;
    }
    r->current = readings;
    r->n_taken = r->n_ready = 0;
    while (r->n_ready < n_asked && call_in(r, readings->then[r->n_ready].at)->status != NOT_MADE) r->n_ready++;
    return status;
}

static int take_step(Remote *r, FunctionNumber function, const Passed passed[], uint32_t n) {
    if (r->is_lost) return LOST;
    if (r->current) stop_foreseeing(r);
    return lead(r, &(Reading){.function = function}, passed, n);
}

/* Read values; `n` where the function wants their number. */
static int take_reading(Remote *r, Reading reading) {
    if (r->is_lost) return LOST;
    if (r->current && r->n_taken < r->n_ready) {
        const Reading *known = &r->current->then[r->n_taken];
        if (is_same(known, &reading)) {
            memcpy(reading.values, r->channel->area + known->place, reading.size);
            r->n_taken++;
            r->heard++;
            if (__atomic_load_n(&r->channel->written, __ATOMIC_SEQ_CST) != r->read) channel_hear(r);
            return call_in(r, known->at)->status;
        }
        stop_foreseeing(r);
    }
    Passed arguments[MOST_ARGUMENTS];
    uint32_t n_arguments = arguments_of(&reading, arguments);
    if (!r->current) return lead(r, &reading, arguments, n_arguments);
    r->heard = UINT32_MAX;
    uint64_t places[MOST_ARGUMENTS];
    int status = append(r, reading.function, arguments, n_arguments, places);
    if (status) return status;
    status = have_one_made(r, r->n_calls - 1, arguments, n_arguments, places);
    if (r->n_taken < MOST_FORESEEN) {
        r->current->then[r->n_taken++] = reading;
        r->current->n = r->n_ready = r->n_taken;
    }
    return status;
}

#define PASSED(...) (const Passed[]){__VA_ARGS__}, sizeof((Passed[]){__VA_ARGS__}) / sizeof(Passed)
#define CALL(name, ...) call(r, N_##name, true, PASSED(__VA_ARGS__))
#define CALL_IN_LOOP(name, ...) call_in_loop(r, N_##name, true, PASSED(__VA_ARGS__))
#define READ(name, of_orders, bytes, number) \
    take_reading(r, (Reading){.function = N_##name, \
                              .references = references, \
                              .orders = (of_orders), \
                              .n_references = n_references, \
                              .n = (number), \
                              .size = (bytes), \
                              .values = values})

/* Make new memory, all zeros, a channel: its worker is asked to load the FMU. To be done before the worker is started,
 * which may be the quicker one. */
EXPORT void channel_make(Channel *channel) {
    channel->asked = ASKED_TO_LOAD;
    channel->core = -1;
}

/* Begin to call over a channel, in memory of this size. */
EXPORT Remote *channel_begin(void *memory, uint64_t size, GiveUp *gives_up, Take *take, WarnedOf *warned) {
    Remote *r = calloc(1, sizeof *r);
    if (!r) return NULL;
    r->channel = memory;
    r->capacity = size - offsetof(Channel, area);
    r->gives_up = gives_up;
    r->take = take;
    r->warned = warned;
    r->asked = ASKED_TO_LOAD;
    r->heard = UINT32_MAX;
    return r;
}

/* How long both sides look for each other before they sleep (ns). */
EXPORT void channel_spin(Remote *r, uint32_t master, uint32_t worker) {
    r->patience.longest = master;
    r->channel->spin = worker;
}

/* Wait until the FMU is loaded, or was found not to be loadable; LOST, or 0. */
EXPORT int channel_loaded(Remote *r) { return r->is_lost || !is_answered(r) ? LOST : 0; }

/* Have the worker end; LOST, or 0. */
EXPORT int channel_end(Remote *r) {
    r->n_calls = 0;
    return r->is_lost ? LOST : have_made(r, 0);
}

EXPORT void channel_free(Remote *r) {
    free(r->values);
    free(r);
}

/* The deferred function that failed, and its status. */
EXPORT int channel_failed(const Remote *r, int *status) {
    *status = r->status;
    return r->failed;
}

/* The function that the worker is at; -1 for none. */
EXPORT int channel_current(const Remote *r) {
    uint32_t at = r->channel->at;
    return at < r->n_calls ? (int)call_in(r, r->starts[at])->function : -1;
}

#define NAME(name) #name,
static const char *const names[] = {FUNCTIONS(NAME) NULL};

/* Names of the functions, by their numbers, and NULL. */
EXPORT const char *const *channel_functions(void) { return names; }

/* Where the area begins. */
EXPORT uint64_t channel_area(void) { return offsetof(Channel, area); }

/* The functions of FMI */

typedef const uint32_t References[];

static void *made(Remote *r, int status) { return status == 0 && call_in(r, r->last)->result ? r : NULL; }

EXPORT void *isolated_fmi1InstantiateSlave(Remote *r, const char *name, const char *guid, const char *location,
                                           const char *mime) {
    return made(r, CALL(fmi1InstantiateSlave, text(name), text(guid), text(location), text(mime)));
}

EXPORT void *isolated_fmi2Instantiate(Remote *r, const char *name, int type, const char *guid, const char *resources) {
    return made(r, CALL(fmi2Instantiate, text(name), text(guid), text(resources), integer(type)));
}

/* `asking` points to a pointer to the operation that answers when the FMU asks for these inputs. */
EXPORT void *isolated_fmi3InstantiateCoSimulation(Remote *r, const char *name, const char *token, const char *resources,
                                                  bool uses_events, References inputs, size_t n, void *const *asking) {
    r->asking = asking;
    return made(r, CALL(fmi3InstantiateCoSimulation, text(name), text(token), text(resources), integer(uses_events),
                        given(inputs, n * sizeof *inputs), integer((int64_t)n)));
}

EXPORT void *isolated_fmi3InstantiateModelExchange(Remote *r, const char *name, const char *token,
                                                   const char *resources) {
    return made(r, CALL(fmi3InstantiateModelExchange, text(name), text(token), text(resources)));
}

#define ALONE(name) \
    EXPORT int isolated_##name(Remote *r) { return call(r, N_##name, true, NULL, 0); }
ALONE(fmi1FreeSlaveInstance)
ALONE(fmi1TerminateSlave)
ALONE(fmi1ResetSlave)
ALONE(fmi1CancelStep)
ALONE(fmi2FreeInstance)
ALONE(fmi2Terminate)
ALONE(fmi2Reset)
ALONE(fmi2CancelStep)
ALONE(fmi2EnterInitializationMode)
ALONE(fmi2ExitInitializationMode)
ALONE(fmi2EnterEventMode)
ALONE(fmi2EnterContinuousTimeMode)
ALONE(fmi3FreeInstance)
ALONE(fmi3Terminate)
ALONE(fmi3Reset)
ALONE(fmi3ExitInitializationMode)
ALONE(fmi3EnterEventMode)
ALONE(fmi3EnterContinuousTimeMode)
ALONE(fmi3EnterStepMode)
ALONE(fmi3EnterConfigurationMode)
ALONE(fmi3ExitConfigurationMode)
ALONE(fmi3EvaluateDiscreteStates)

EXPORT int isolated_fmi1InitializeSlave(Remote *r, double start, char has_stop, double stop) {
    return CALL(fmi1InitializeSlave, real(start), integer(has_stop), real(stop));
}

#define EXPERIMENT(name, truth) \
    EXPORT int isolated_##name(Remote *r, truth has_tolerance, double tolerance, double start, truth has_stop, \
                               double stop) { \
        return CALL(name, integer(has_tolerance), real(tolerance), real(start), integer(has_stop), real(stop)); \
    }
EXPERIMENT(fmi2SetupExperiment, int)
EXPERIMENT(fmi3EnterInitializationMode, bool)

#define STEP_ALONE(name, truth) \
    EXPORT int isolated_##name(Remote *r, double time, double step, truth is_new) { \
        return CALL(name, real(time), real(step), integer(is_new)); \
    } \
    EXPORT int foreseen_##name(Remote *r, double time, double step, truth is_new) { \
        return take_step(r, N_##name, PASSED(real(time), real(step), integer(is_new))); \
    }
STEP_ALONE(fmi1DoStep, char)
STEP_ALONE(fmi2DoStep, int)

/* The numbers of an operation that answers for inputs during a step, in memory of their own. */
static Passed beside(const Operation *op) {
    const Extrapolated *in = op->data;
    Inputs head = {op->n, op->n_references, in->degree, in->refused, in->time};
    size_t n = (size_t)op->n, values = n * sizeof(double), derivatives = (size_t)in->degree * values;
    size_t references = (size_t)op->n_references * sizeof *op->references;
    Passed passed = {.passing = BESIDE, .size = sizeof head + 2 * values + derivatives + references};
    char *bytes = malloc(passed.size);
    passed.pointer = bytes;
    if (!bytes) abort();
    memcpy(bytes, &head, sizeof head);
    memcpy(bytes += sizeof head, in->history, values);
    memcpy(bytes += values, in->derivatives, derivatives);
    memset(bytes += derivatives, 0, values); /* its buffer */
    memcpy(bytes + values, op->references, references);
    return passed;
}

static int step_of_fmi3(Remote *r, bool is_foreseen, double time, double step, bool keeps_no_state, bool *event,
                        bool *ends, bool *early, double *last) {
    enum { OWN = 7 };
    Passed passed[MOST_ARGUMENTS] = {real(time),      real(step),       integer(keeps_no_state),   filled(event, 1),
                                     filled(ends, 1), filled(early, 1), filled(last, sizeof *last)};
    uint32_t n = OWN;
    const Operation *first = r->asking ? *r->asking : NULL, *op = first;
    if (op) do
            passed[n++] = beside(op);
        while (op++->more && n < MOST_ARGUMENTS);
    int status = is_foreseen ? take_step(r, N_fmi3DoStep, passed, n) : call(r, N_fmi3DoStep, true, passed, n);
    uint64_t at = ALIGNED(sizeof(Call) + n * sizeof(Argument));
    for (uint32_t i = 0; i < n; at = ALIGNED(at + passed[i].size), i++)
        if (passed[i].passing == BESIDE) {
            Inputs head;
            memcpy(&head, r->channel->area + r->last + at, sizeof head);
            if (status != LOST && status != FAILED_BEFORE && status != TOO_LARGE)
                ((Extrapolated *)first[i - OWN].data)->refused = head.refused;
            free((void *)passed[i].pointer);
        }
    return status;
}

EXPORT int isolated_fmi3DoStep(Remote *r, double time, double step, bool keeps_no_state, bool *event, bool *ends,
                               bool *early, double *last) {
    return step_of_fmi3(r, false, time, step, keeps_no_state, event, ends, early, last);
}

EXPORT int foreseen_fmi3DoStep(Remote *r, double time, double step, bool keeps_no_state, bool *event, bool *ends,
                               bool *early, double *last) {
    return step_of_fmi3(r, true, time, step, keeps_no_state, event, ends, early, last);
}

EXPORT int isolated_fmi3UpdateDiscreteStates(Remote *r, bool *needed, bool *ends, bool *nominals, bool *values,
                                             bool *defined, double *time) {
    return CALL(fmi3UpdateDiscreteStates, filled(needed, 1), filled(ends, 1), filled(nominals, 1), filled(values, 1),
                filled(defined, 1), filled(time, sizeof *time));
}

#define STATUS(name, size) \
    EXPORT int isolated_##name(Remote *r, int kind, void *value) { \
        return CALL(name, integer(kind), filled(value, size)); \
    }
STATUS(fmi1GetStatus, 4)
STATUS(fmi1GetRealStatus, 8)
STATUS(fmi1GetIntegerStatus, 4)
STATUS(fmi1GetBooleanStatus, 1)
STATUS(fmi2GetStatus, 4)
STATUS(fmi2GetRealStatus, 8)
STATUS(fmi2GetIntegerStatus, 4)
STATUS(fmi2GetBooleanStatus, 4)

/* Getting and setting values of a size: in FMI 1.0 and 2.0, and for clocks, as many as references; in FMI 3.0 n. */
#define REFERRED given(references, n_references * sizeof *references), integer((int64_t)n_references)
#define GET2(name, size) \
    EXPORT int isolated_##name(Remote *r, References references, size_t n_references, void *values) { \
        return CALL(name, REFERRED, filled(values, n_references * (size))); \
    }
#define SET2(side, at_once, name, size) \
    EXPORT int side##_##name(Remote *r, References references, size_t n_references, const void *values) { \
        return call(r, N_##name, at_once, PASSED(REFERRED, given(values, n_references * (size)))); \
    }
#define READ2(name, size) \
    EXPORT int foreseen_##name(Remote *r, References references, size_t n_references, void *values) { \
        return READ(name, NULL, n_references * (size), 0); \
    }
#define EXCHANGE2(version, type, size) \
    GET2(version##Get##type, size) \
    READ2(version##Get##type, size) \
    SET2(isolated, true, version##Set##type, size) \
    SET2(deferred, false, version##Set##type, size)
EXCHANGE2(fmi1, Real, 8)
EXCHANGE2(fmi1, Integer, 4)
EXCHANGE2(fmi1, Boolean, 1)
EXCHANGE2(fmi2, Real, 8)
EXCHANGE2(fmi2, Integer, 4)
EXCHANGE2(fmi2, Boolean, 4)
GET2(fmi3GetClock, 1)
SET2(isolated, true, fmi3SetClock, 1)
GET2(fmi3GetShiftDecimal, 8)
SET2(isolated, true, fmi3SetIntervalDecimal, 8)
SET2(isolated, true, fmi3SetShiftDecimal, 8)

#define GET3(name, size) \
    EXPORT int isolated_##name(Remote *r, References references, size_t n_references, void *values, size_t n) { \
        return CALL(name, REFERRED, filled(values, n * (size)), integer((int64_t)n)); \
    }
#define SET3(side, at_once, name, size) \
    EXPORT int side##_##name(Remote *r, References references, size_t n_references, const void *values, size_t n) { \
        return call(r, N_##name, at_once, PASSED(REFERRED, given(values, n * (size)), integer((int64_t)n))); \
    }
#define READ3(name, size) \
    EXPORT int foreseen_##name(Remote *r, References references, size_t n_references, void *values, size_t n) { \
        return READ(name, NULL, n * (size), n); \
    }
#define EXCHANGE3(type, size) \
    GET3(fmi3Get##type, size) \
    READ3(fmi3Get##type, size) \
    SET3(isolated, true, fmi3Set##type, size) \
    SET3(deferred, false, fmi3Set##type, size)
EXCHANGE3(Float32, 4)
EXCHANGE3(Float64, 8)
EXCHANGE3(Int8, 1)
EXCHANGE3(UInt8, 1)
EXCHANGE3(Int16, 2)
EXCHANGE3(UInt16, 2)
EXCHANGE3(Int32, 4)
EXCHANGE3(UInt32, 4)
EXCHANGE3(Int64, 8)
EXCHANGE3(UInt64, 8)
EXCHANGE3(Boolean, 1)

#define GET_TEXTS2(name) \
    EXPORT int isolated_##name(Remote *r, References references, size_t n_references, void *values) { \
        return CALL(name, REFERRED, given_back(TEXTS_BACK, values, n_references)); \
    }
#define SET_TEXTS2(name) \
    EXPORT int isolated_##name(Remote *r, References references, size_t n_references, const char *const values[]) { \
        return CALL(name, REFERRED, texts(values, n_references)); \
    }
GET_TEXTS2(fmi1GetString)
GET_TEXTS2(fmi2GetString)
SET_TEXTS2(fmi1SetString)
SET_TEXTS2(fmi2SetString)

EXPORT int isolated_fmi3GetString(Remote *r, References references, size_t n_references, void *values, size_t n) {
    return CALL(fmi3GetString, REFERRED, given_back(TEXTS_BACK, values, n), integer((int64_t)n));
}

EXPORT int isolated_fmi3SetString(Remote *r, References references, size_t n_references, const char *const values[],
                                  size_t n) {
    return CALL(fmi3SetString, REFERRED, texts(values, n), integer((int64_t)n));
}

EXPORT int isolated_fmi3GetBinary(Remote *r, References references, size_t n_references, size_t sizes[], void *values,
                                  size_t n) {
    return CALL(fmi3GetBinary, REFERRED, filled(sizes, n * sizeof *sizes), given_back(BLOBS_BACK, values, n),
                integer((int64_t)n));
}

EXPORT int isolated_fmi3SetBinary(Remote *r, References references, size_t n_references, const size_t sizes[],
                                  const void *const values[], size_t n) {
    return CALL(fmi3SetBinary, REFERRED, given(sizes, n * sizeof *sizes), blobs(values, sizes, n), integer((int64_t)n));
}

/* Intervals and shifts of clocks. */
EXPORT int isolated_fmi3GetIntervalDecimal(Remote *r, References references, size_t n_references, double *intervals,
                                           int *qualifiers) {
    return CALL(fmi3GetIntervalDecimal, REFERRED, filled(intervals, n_references * 8),
                filled(qualifiers, n_references * sizeof *qualifiers));
}

EXPORT int isolated_fmi3GetIntervalFraction(Remote *r, References references, size_t n_references, uint64_t *counters,
                                            uint64_t *resolutions, int *qualifiers) {
    return CALL(fmi3GetIntervalFraction, REFERRED, filled(counters, n_references * 8),
                filled(resolutions, n_references * 8), filled(qualifiers, n_references * sizeof *qualifiers));
}

EXPORT int isolated_fmi3GetShiftFraction(Remote *r, References references, size_t n_references, uint64_t *counters,
                                         uint64_t *resolutions) {
    return CALL(fmi3GetShiftFraction, REFERRED, filled(counters, n_references * 8),
                filled(resolutions, n_references * 8));
}

#define SET_FRACTION(name) \
    EXPORT int isolated_##name(Remote *r, References references, size_t n_references, const uint64_t *counters, \
                               const uint64_t *resolutions) { \
        return CALL(name, REFERRED, given(counters, n_references * 8), given(resolutions, n_references * 8)); \
    }
SET_FRACTION(fmi3SetIntervalFraction)
SET_FRACTION(fmi3SetShiftFraction)

/* Derivatives of inputs and outputs. */
#define SET_DERIVATIVES(side, at_once, name) \
    EXPORT int side##_##name(Remote *r, References references, size_t n_references, const int32_t orders[], \
                             const double *values) { \
        return call(r, N_##name, at_once, \
                    PASSED(REFERRED, given(orders, n_references * sizeof *orders), given(values, n_references * 8))); \
    }
SET_DERIVATIVES(isolated, true, fmi1SetRealInputDerivatives)
SET_DERIVATIVES(deferred, false, fmi1SetRealInputDerivatives)
SET_DERIVATIVES(isolated, true, fmi2SetRealInputDerivatives)
SET_DERIVATIVES(deferred, false, fmi2SetRealInputDerivatives)

#define GET_DERIVATIVES(name) \
    EXPORT int isolated_##name(Remote *r, References references, size_t n_references, const int32_t orders[], \
                               double *values) { \
        return CALL(name, REFERRED, given(orders, n_references * sizeof *orders), filled(values, n_references * 8)); \
    } \
    EXPORT int foreseen_##name(Remote *r, References references, size_t n_references, const int32_t orders[], \
                               double *values) { \
        return READ(name, orders, n_references * 8, 0); \
    }
GET_DERIVATIVES(fmi1GetRealOutputDerivatives)
GET_DERIVATIVES(fmi2GetRealOutputDerivatives)

EXPORT int isolated_fmi3GetOutputDerivatives(Remote *r, References references, size_t n_references,
                                             const int32_t orders[], double *values, size_t n) {
    return CALL(fmi3GetOutputDerivatives, REFERRED, given(orders, n_references * sizeof *orders), filled(values, n * 8),
                integer((int64_t)n));
}

EXPORT int foreseen_fmi3GetOutputDerivatives(Remote *r, References references, size_t n_references,
                                             const int32_t orders[], double *values, size_t n) {
    return READ(fmi3GetOutputDerivatives, orders, n * 8, n);
}

/* `as_called` is CALL, or CALL_IN_LOOP. */
#define DIRECTIONAL2(side, as_called, name) \
    EXPORT int side##_##name(Remote *r, References unknowns, size_t n_unknowns, References knowns, size_t n_knowns, \
                             const double *seed, double *found) { \
        return as_called(name, given(unknowns, n_unknowns * 4), integer((int64_t)n_unknowns), \
                         given(knowns, n_knowns * 4), integer((int64_t)n_knowns), given(seed, n_knowns * 8), \
                         filled(found, n_unknowns * 8)); \
    }
DIRECTIONAL2(isolated, CALL, fmi2GetDirectionalDerivative)
DIRECTIONAL2(from_loop, CALL_IN_LOOP, fmi2GetDirectionalDerivative)

#define DIRECTIONAL3(side, as_called, name) \
    EXPORT int side##_##name(Remote *r, References unknowns, size_t n_unknowns, References knowns, size_t n_knowns, \
                             const double *seed, size_t n_seed, double *found, size_t n_found) { \
        return as_called(name, given(unknowns, n_unknowns * 4), integer((int64_t)n_unknowns), \
                         given(knowns, n_knowns * 4), integer((int64_t)n_knowns), given(seed, n_seed * 8), \
                         integer((int64_t)n_seed), filled(found, n_found * 8), integer((int64_t)n_found)); \
    }
DIRECTIONAL3(isolated, CALL, fmi3GetDirectionalDerivative)
DIRECTIONAL3(from_loop, CALL_IN_LOOP, fmi3GetDirectionalDerivative)
DIRECTIONAL3(isolated, CALL, fmi3GetAdjointDerivative)

/* States of the FMU, whose addresses only it knows. */
#define STATES(get, set, release, measure, serialise, read) \
    EXPORT int isolated_##get(Remote *r, void **state) { return CALL(get, filled(state, sizeof *state)); } \
    EXPORT int isolated_##release(Remote *r, void **state) { return CALL(release, filled(state, sizeof *state)); } \
    EXPORT int isolated_##set(Remote *r, void *state) { return CALL(set, integer((intptr_t)state)); } \
    EXPORT int isolated_##measure(Remote *r, void *state, size_t *size) { \
        return CALL(measure, integer((intptr_t)state), filled(size, sizeof *size)); \
    } \
    EXPORT int isolated_##serialise(Remote *r, void *state, void *bytes, size_t size) { \
        return CALL(serialise, integer((intptr_t)state), filled(bytes, size), integer((int64_t)size)); \
    } \
    EXPORT int isolated_##read(Remote *r, const void *bytes, size_t size, void **state) { \
        return CALL(read, given(bytes, size), integer((int64_t)size), filled(state, sizeof *state)); \
    }
STATES(fmi2GetFMUstate, fmi2SetFMUstate, fmi2FreeFMUstate, fmi2SerializedFMUstateSize, fmi2SerializeFMUstate,
       fmi2DeSerializeFMUstate)
STATES(fmi3GetFMUState, fmi3SetFMUState, fmi3FreeFMUState, fmi3SerializedFMUStateSize, fmi3SerializeFMUState,
       fmi3DeserializeFMUState)

/* Model exchange. */
#define SET_TIME(name) \
    EXPORT int isolated_##name(Remote *r, double time) { return CALL(name, real(time)); }
SET_TIME(fmi2SetTime)
SET_TIME(fmi3SetTime)

#define FILL(name) \
    EXPORT int isolated_##name(Remote *r, double *values, size_t n) { \
        return CALL(name, filled(values, n * 8), integer((int64_t)n)); \
    }
FILL(fmi2GetContinuousStates)
FILL(fmi2GetDerivatives)
FILL(fmi2GetEventIndicators)
FILL(fmi2GetNominalsOfContinuousStates)
FILL(fmi3GetContinuousStates)
FILL(fmi3GetContinuousStateDerivatives)
FILL(fmi3GetEventIndicators)
FILL(fmi3GetNominalsOfContinuousStates)

#define GIVE(name) \
    EXPORT int isolated_##name(Remote *r, const double *values, size_t n) { \
        return CALL(name, given(values, n * 8), integer((int64_t)n)); \
    }
GIVE(fmi2SetContinuousStates)
GIVE(fmi3SetContinuousStates)

#define COUNT(name) \
    EXPORT int isolated_##name(Remote *r, size_t *n) { return CALL(name, filled(n, sizeof *n)); }
COUNT(fmi3GetNumberOfEventIndicators)
COUNT(fmi3GetNumberOfContinuousStates)

EXPORT int isolated_fmi2NewDiscreteStates(Remote *r, void *event_info) {
    enum { SIZE = 32 }; /* five truth values and a double */
    return CALL(fmi2NewDiscreteStates, filled(event_info, SIZE));
}

EXPORT int isolated_fmi2CompletedIntegratorStep(Remote *r, int keeps_no_state, int *event, int *ends) {
    return CALL(fmi2CompletedIntegratorStep, integer(keeps_no_state), filled(event, sizeof *event),
                filled(ends, sizeof *ends));
}

EXPORT int isolated_fmi3CompletedIntegratorStep(Remote *r, bool keeps_no_state, bool *event, bool *ends) {
    return CALL(fmi3CompletedIntegratorStep, integer(keeps_no_state), filled(event, 1), filled(ends, 1));
}

/* What FMUs say */

EXPORT int isolated_fmi1SetDebugLogging(Remote *r, char on) { return CALL(fmi1SetDebugLogging, integer(on)); }

#define SET_DEBUG_LOGGING(name, truth) \
    EXPORT int isolated_##name(Remote *r, truth on, size_t n, const char *const categories[]) { \
        return CALL(name, integer(on), integer((int64_t)n), texts(categories, n)); \
    }
SET_DEBUG_LOGGING(fmi2SetDebugLogging, int)
SET_DEBUG_LOGGING(fmi3SetDebugLogging, bool)
#endif
