/* States of the packed FMU: those of the components, and what changes here. */
#include "packed.h"

#include <stdlib.h>
#include <string.h>

struct State {
    Progress now;
    double *numbers; /* and the histories behind them */
    int32_t *known; /* of each, and then how many steps of a starting block are left */
    double *times;
    bool *set;
    void **of_components;
};

typedef int OnState(void *, void *);
typedef int OnStatePointer(void *, void **);
typedef int StateSize(void *, void *, size_t *);
typedef int Serialize(void *, void *, char *, size_t);
typedef int Deserialize(void *, const char *, size_t, void **);

static const char *name_of(const Component *component, const char *function2, const char *function3) {
    return component->version == 3 ? function3 : function2;
}

static int64_t n_of_history(const Packed *packed) {
    int64_t n = 0;
    for (int32_t i = 0; i < packed->n_extrapolated; i++)
        n += (int64_t)packed->n_extrapolated_inputs[i] *
             ((packed->extrapolated[i]->rates ? 2 : 1) * packed->extrapolated[i]->points +
              packed->extrapolated[i]->degree + (packed->extrapolated[i]->watched ? 4 : 0) +
              (packed->extrapolated[i]->ahead ? packed->block.steps * packed->extrapolated[i]->degree : 0));
    return n;
}

/* Copy the histories of the inputs to or from numbers. */
static void pass_history(Packed *packed, double numbers[], bool save) {
    for (int32_t i = 0; i < packed->n_extrapolated; i++) {
        Extrapolated *inputs = packed->extrapolated[i];
        size_t n = (size_t)packed->n_extrapolated_inputs[i];
        double *arrays[] = {inputs->history, inputs->derivatives, inputs->rates, inputs->watched, inputs->ahead};
        size_t steps = (size_t)packed->block.steps;
        size_t sizes[] = {n * (size_t)inputs->points, n * (size_t)inputs->degree,
                          inputs->rates ? n * (size_t)inputs->points : 0, inputs->watched ? 4 * n : 0,
                          inputs->ahead ? n * steps * (size_t)inputs->degree : 0};
        for (int k = 0; k < 5; numbers += sizes[k], k++)
            if (!sizes[k]) continue;
            else if (save) memcpy(numbers, arrays[k], sizes[k] * sizeof *numbers);
            else memcpy(arrays[k], numbers, sizes[k] * sizeof *numbers);
    }
}

/* Free a state but for those of the components in it. */
static void free_own(State *state) {
    free(state->numbers);
    free(state->known);
    free(state->times);
    free(state->set);
    free(state->of_components);
    free(state);
}

static State *new_state(const Packed *packed) {
    State *state = calloc(1, sizeof *state);
    if (!state) return NULL;
    state->numbers = calloc((size_t)(packed->n_numbers + n_of_history(packed)) + 1, sizeof(double));
    state->known = calloc(2 * (size_t)packed->n_extrapolated + 1, sizeof(int32_t));
    state->times = calloc((size_t)packed->n_extrapolated + 1, sizeof(double));
    state->set = calloc((size_t)packed->n_starts + 1, sizeof(bool));
    state->of_components = calloc((size_t)packed->n_components + 1, sizeof(void *));
    if (state->numbers && state->known && state->times && state->set && state->of_components) return state;
    free_own(state);
    return NULL;
}

Status state_get(Packed *packed, State **state) {
    State *found = *state ? *state : new_state(packed);
    if (!found) return packed_fail(packed, FAILURE, "no memory for an FMU state");
    Status status = OK;
    for (int32_t i = 0; status == OK && i < packed->n_components; i++) {
        Component *component = &packed->components[i];
        const char *name = name_of(component, "fmi2GetFMUstate", "fmi3GetFMUState");
        OnStatePointer *get = (OnStatePointer *)component_function(component, name);
        status = get ? component_failed(component, (Status)get(component->instance, &found->of_components[i]), name)
                     : FAILURE;
    }
    if (status != OK) {
        if (!*state) state_free(packed, found);
        return FAILURE;
    }
    found->now = packed->now;
    memcpy(found->numbers, packed->numbers, (size_t)packed->n_numbers * sizeof *packed->numbers);
    pass_history(packed, found->numbers + packed->n_numbers, true);
    for (int32_t i = 0; i < packed->n_extrapolated; i++) {
        found->known[i] = packed->extrapolated[i]->known;
        found->known[packed->n_extrapolated + i] = packed->extrapolated[i]->left;
        found->times[i] = packed->extrapolated[i]->time;
    }
    for (int32_t i = 0; i < packed->n_starts; i++) found->set[i] = packed->starts[i].set;
    *state = found;
    return OK;
}

Status state_set(Packed *packed, const State *state) {
    Status status = OK;
    for (int32_t i = 0; status == OK && i < packed->n_components; i++) {
        Component *component = &packed->components[i];
        const char *name = name_of(component, "fmi2SetFMUstate", "fmi3SetFMUState");
        OnState *set = (OnState *)component_function(component, name);
        status = set ? component_failed(component, (Status)set(component->instance, state->of_components[i]), name)
                     : FAILURE;
    }
    if (status != OK) {
        packed->now.phase = FAILED;
        return FAILURE;
    }
    packed->now = state->now;
    memcpy(packed->numbers, state->numbers, (size_t)packed->n_numbers * sizeof *packed->numbers);
    pass_history(packed, state->numbers + packed->n_numbers, false);
    for (int32_t i = 0; i < packed->n_extrapolated; i++) {
        packed->extrapolated[i]->known = state->known[i];
        packed->extrapolated[i]->left = state->known[packed->n_extrapolated + i];
        packed->extrapolated[i]->time = state->times[i];
    }
    for (int32_t i = 0; i < packed->n_starts; i++) packed->starts[i].set = state->set[i];
    return OK;
}

void state_free(Packed *packed, State *state) {
    for (int32_t i = 0; i < packed->n_components; i++) {
        Component *component = &packed->components[i];
        const char *name = name_of(component, "fmi2FreeFMUstate", "fmi3FreeFMUState");
        OnStatePointer *release = component->broken ? NULL : (OnStatePointer *)component_function(component, name);
        if (release && state->of_components[i]) release(component->instance, &state->of_components[i]);
    }
    free_own(state);
}

/* Serialised states: the token, own data, texts, the states of the components, and a checksum over all of them. */

typedef struct {
    char *bytes; /* NULL: only count */
    const char *from;
    size_t n, room;
    bool failed;
} Stream;

static void put(Stream *to, const void *data, size_t n) {
    if (to->bytes && to->n + n <= to->room) memcpy(to->bytes + to->n, data, n);
    else if (to->bytes) to->failed = true;
    to->n += n;
}

static void take_from(Stream *in, void *data, size_t n) {
    if (in->failed || n > in->room - in->n) {
        in->failed = true;
        memset(data, 0, n);
        return;
    }
    memcpy(data, in->from + in->n, n);
    in->n += n;
}

static uint64_t checksum(const char bytes[], size_t n) { /* FNV-1a */
    uint64_t hash = 14695981039346656037u;
    for (size_t i = 0; i < n; i++) hash = (hash ^ (unsigned char)bytes[i]) * 1099511628211u;
    return hash;
}

static Status write_state(Packed *packed, const State *state, Stream *to) {
    put(to, packed->token, strlen(packed->token) + 1);
    Progress now;
    memset(&now, 0, sizeof now); /* equal states have equal bytes */
    now.time = state->now.time, now.origin = state->now.origin, now.step = state->now.step;
    now.max_step = state->now.max_step, now.stop = state->now.stop, now.tolerance = state->now.tolerance;
    now.point = state->now.point, now.phase = state->now.phase, now.exchanged = state->now.exchanged;
    now.stale = state->now.stale, now.begun = state->now.begun, now.has_stop = state->now.has_stop;
    now.has_tolerance = state->now.has_tolerance, now.set_up = state->now.set_up;
    now.wants_to_end = state->now.wants_to_end, now.discarded = state->now.discarded, now.reached = state->now.reached;
    put(to, &now, sizeof now);
    put(to, state->numbers, (size_t)(packed->n_numbers + n_of_history(packed)) * sizeof(double));
    put(to, state->known, 2 * (size_t)packed->n_extrapolated * sizeof(int32_t));
    put(to, state->times, (size_t)packed->n_extrapolated * sizeof(double));
    put(to, state->set, (size_t)packed->n_starts * sizeof(bool));
    for (int32_t i = 0; i < packed->n_text_slots; i++) {
        const char *text = text_of(packed, state->numbers[packed->text_slots[i]]);
        put(to, text, strlen(text) + 1);
    }
    for (int32_t i = 0; i < packed->n_components; i++) {
        Component *component = &packed->components[i];
        const char *sized = name_of(component, "fmi2SerializedFMUstateSize", "fmi3SerializedFMUStateSize");
        const char *written = name_of(component, "fmi2SerializeFMUstate", "fmi3SerializeFMUState");
        StateSize *size_of = (StateSize *)component_function(component, sized);
        Serialize *serialize = (Serialize *)component_function(component, written);
        size_t size = 0;
        if (!size_of || !serialize ||
            component_failed(component, (Status)size_of(component->instance, state->of_components[i], &size), sized))
            return FAILURE;
        uint64_t said = size;
        put(to, &said, sizeof said);
        if (to->bytes && to->n + size <= to->room) {
            int status = serialize(component->instance, state->of_components[i], to->bytes + to->n, size);
            if (component_failed(component, (Status)status, written)) return FAILURE;
        }
        to->n += size;
    }
    return OK;
}

Status state_size(Packed *packed, const State *state, size_t *size) {
    Stream counted = {NULL, NULL, 0, 0, false};
    Status status = write_state(packed, state, &counted);
    *size = counted.n + sizeof(uint64_t);
    return status;
}

Status state_serialize(Packed *packed, const State *state, char bytes[], size_t size) {
    Stream to = {bytes, NULL, 0, size, false};
    Status status = write_state(packed, state, &to);
    if (status != OK) return status;
    if (to.failed || to.n + sizeof(uint64_t) > size)
        return packed_fail(packed, FAILURE, "an FMU state needs %lu bytes", (unsigned long)(to.n + sizeof(uint64_t)));
    uint64_t sum = checksum(bytes, to.n);
    memcpy(bytes + to.n, &sum, sizeof sum);
    return OK;
}

Status state_deserialize(Packed *packed, const char bytes[], size_t size, State **state) {
    uint64_t sum = 0;
    size_t checked = size >= sizeof sum ? size - sizeof sum : 0, length = strlen(packed->token) + 1;
    if (checked) memcpy(&sum, bytes + checked, sizeof sum);
    if (checked < length || sum != checksum(bytes, checked) || memcmp(bytes, packed->token, length) != 0)
        return packed_fail(packed, FAILURE, "the FMU state is damaged or belongs to another FMU");
    State *found = new_state(packed);
    if (!found) return packed_fail(packed, FAILURE, "no memory for an FMU state");
    Stream in = {NULL, bytes, length, checked, false};
    take_from(&in, &found->now, sizeof found->now);
    take_from(&in, found->numbers, (size_t)(packed->n_numbers + n_of_history(packed)) * sizeof(double));
    take_from(&in, found->known, 2 * (size_t)packed->n_extrapolated * sizeof(int32_t));
    take_from(&in, found->times, (size_t)packed->n_extrapolated * sizeof(double));
    take_from(&in, found->set, (size_t)packed->n_starts * sizeof(bool));
    for (int32_t i = 0; i < packed->n_text_slots && !in.failed; i++) {
        const char *text = bytes + in.n, *end = memchr(text, '\0', checked - in.n);
        if (!end) {
            in.failed = true;
            break;
        }
        found->numbers[packed->text_slots[i]] = slot_of(text_number(packed, text));
        in.n += (size_t)(end - text) + 1;
    }
    Status status = in.failed ? FAILURE : OK;
    for (int32_t i = 0; status == OK && i < packed->n_components; i++) {
        Component *component = &packed->components[i];
        const char *name = name_of(component, "fmi2DeSerializeFMUstate", "fmi3DeserializeFMUState");
        Deserialize *read = (Deserialize *)component_function(component, name);
        uint64_t n = 0;
        take_from(&in, &n, sizeof n);
        if (!read || in.failed || n > checked - in.n) {
            status = FAILURE;
            break;
        }
        status = component_failed(
            component, (Status)read(component->instance, bytes + in.n, (size_t)n, &found->of_components[i]), name);
        in.n += (size_t)n;
    }
    if (status != OK) {
        state_free(packed, found);
        return packed_fail(packed, FAILURE, "the FMU state is damaged or belongs to another FMU");
    }
    if (*state) state_free(packed, *state);
    *state = found;
    return OK;
}
