/* Values of the variables of the packed FMU. */
#include "packed.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef int Exchange2(void *, const uint32_t *, size_t, void *);
typedef int Exchange3(void *, const uint32_t *, size_t, void *, size_t);

int64_t integer_of(double slot) {
    int64_t integer;
    memcpy(&integer, &slot, sizeof integer);
    return integer;
}

double slot_of(int64_t integer) {
    double slot;
    memcpy(&slot, &integer, sizeof slot);
    return slot;
}

/* Texts, each kept once, under a number */

int32_t text_number(Packed *packed, const char *text) {
    if (!text) text = "";
    for (int32_t i = packed->n_texts - 1; i >= 0; i--)
        if (!strcmp(packed->texts[i], text)) return i;
    if (packed->n_texts == packed->room_for_texts) {
        int32_t room = packed->room_for_texts ? 2 * packed->room_for_texts : 16;
        char **more = realloc(packed->texts, (size_t)room * sizeof *more);
        if (!more) return -1;
        packed->texts = more;
        packed->room_for_texts = room;
    }
    char *copy = malloc(strlen(text) + 1);
    if (!copy) return -1;
    packed->texts[packed->n_texts] = strcpy(copy, text);
    return packed->n_texts++;
}

const char *text_of(const Packed *packed, double slot) {
    int64_t number = integer_of(slot);
    return number >= 0 && number < packed->n_texts ? packed->texts[number] : "";
}

/* Calls of components */

static int exchange_values(const Component *component, void *function, const uint32_t references[], size_t n_references,
                           void *values, size_t n) {
    if (component->version == 3)
        return ((Exchange3 *)function)(component->instance, references, n_references, values, n);
    return ((Exchange2 *)function)(component->instance, references, n_references, values);
}

int text_get(void *call, const uint32_t references[], size_t n_references, double slots[], size_t n) {
    TextCall *own = call;
    Packed *packed = own->component->packed;
    int status = exchange_values(own->component, own->function, references, n_references, (void *)own->buffer, n);
    for (size_t i = 0; status <= WARNING && i < n; i++) slots[i] = slot_of(text_number(packed, own->buffer[i]));
    return status;
}

int text_set(void *call, const uint32_t references[], size_t n_references, const double slots[], size_t n) {
    TextCall *own = call;
    for (size_t i = 0; i < n; i++) own->buffer[i] = text_of(own->component->packed, slots[i]);
    return exchange_values(own->component, own->function, references, n_references, (void *)own->buffer, n);
}

/* Set a start value in its component, or get it from there. */
Status pass_start(Packed *packed, const Start *start, bool set) {
    Component *component = start->component;
    const char *name = set ? start->setter : start->getter;
    void *function = component_function(component, name);
    if (!function) return FAILURE;
    double *slots = packed->start_slots + start->first;
    size_t n = (size_t)start->n;
    int status;
    if (start->code == POINTER) {
        const char **texts = malloc((n + 1) * sizeof *texts);
        if (!texts) return packed_fail(packed, FAILURE, "no memory for the texts of component '%s'", component->name);
        for (size_t i = 0; i < n; i++) texts[i] = text_of(packed, slots[i]);
        status = exchange_values(component, function, &start->reference, 1, (void *)texts, n);
        for (size_t i = 0; !set && status <= WARNING && i < n; i++) slots[i] = slot_of(text_number(packed, texts[i]));
        free(texts);
    } else if (start->code % 16 == 8) {
        status = exchange_values(component, function, &start->reference, 1, slots, n);
    } else {
        void *buffer = malloc(8 * n + 1);
        if (!buffer) return packed_fail(packed, FAILURE, "no memory for the values of component '%s'", component->name);
        if (set) loop_convert(start->code, buffer, slots, start->n, true);
        status = exchange_values(component, function, &start->reference, 1, buffer, n);
        if (!set && status <= WARNING) loop_convert(start->code, buffer, slots, start->n, false);
        free(buffer);
    }
    return component_failed(component, (Status)status, name);
}

/* Variables */

static const char *const type_names[] = {"Float64 (Real)",  "Float32", "Int8",  "UInt8",  "Int16",   "UInt16",
                                         "Int32 (Integer)", "UInt32",  "Int64", "UInt64", "Boolean", "String"};

static Variable *variable_of(Packed *packed, uint32_t reference, VariableType type) {
    if (reference >= (uint32_t)packed->n_variables) {
        packed_fail(packed, FAILURE, "no variable has the value reference %lu", (unsigned long)reference);
        return NULL;
    }
    Variable *variable = &packed->variables[reference];
    if (variable->type == (int32_t)type) return variable;
    packed_fail(packed, FAILURE, "'%s' is of type %s, not %s", variable->name, type_names[variable->type],
                type_names[type]);
    return NULL;
}

static Status get_direct(Packed *packed, const Variable *variable, const char **text) {
    const Direct *direct = &packed->directs[variable->where];
    if (!(packed->now.phase & (INITIALIZATION | STEPPING | TERMINATED))) {
        *text = "";
        return OK;
    }
    Component *component = direct->component;
    void *function = component_function(component, direct->getter);
    const char **texts = function ? malloc((size_t)(direct->n + 1) * sizeof *texts) : NULL;
    if (!texts) return FAILURE;
    int status = exchange_values(component, function, &direct->reference, 1, (void *)texts, (size_t)direct->n);
    if (status <= WARNING) *text = texts[variable->element];
    free(texts);
    return component_failed(component, (Status)status, direct->getter);
}

Status packed_get(Packed *packed, uint32_t reference, VariableType type, double *slot, const char **text) {
    const Variable *variable = variable_of(packed, reference, type);
    if (!variable) return FAILURE;
    switch ((Role)variable->role) {
        case EXCHANGED:
            *slot = packed->values[variable->where];
            break;
        case COLUMN:
            *slot = packed->inputs[variable->where];
            break;
        case START: {
            const Start *start = &packed->starts[variable->where];
            if (packed->now.phase & (INITIALIZATION | STEPPING | TERMINATED)) {
                Status status = pass_start(packed, start, false);
                if (status != OK) return status;
            }
            *slot = packed->start_slots[start->first + variable->element];
            break;
        }
        case DIRECT:
            return get_direct(packed, variable, text);
        case MAX_STEP:
            *slot = packed->now.max_step;
            break;
    }
    if (type == TYPE_STRING) *text = text_of(packed, *slot);
    return OK;
}

static bool is_real(VariableType type) { return type == TYPE_FLOAT64 || type == TYPE_FLOAT32; }

static Status set_start(Packed *packed, const Variable *variable, double slot) {
    Start *start = &packed->starts[variable->where];
    int phase = packed->now.phase;
    if (phase == STEPPING && !start->tunable)
        return packed_fail(packed, FAILURE, "'%s' is fixed after the initialisation; reset the instance to change it",
                           variable->name);
    if (packed->within_step)
        return packed_fail(packed, FAILURE, "'%s' can't be set now; set it between two steps", variable->name);
    if (start->n > 1 && phase != INSTANTIATED) { /* the other elements are what they are */
        Status status = pass_start(packed, start, false);
        if (status != OK) return status;
    }
    packed->start_slots[start->first + variable->element] = slot;
    start->set = true;
    if (phase == INSTANTIATED) return OK;
    if (start->when == STRUCTURAL)
        return packed_fail(packed, FAILURE, "'%s' can be set before the initialisation only", variable->name);
    return pass_start(packed, start, true);
}

Status packed_set(Packed *packed, uint32_t reference, VariableType type, double slot, const char *text) {
    const Variable *variable = variable_of(packed, reference, type);
    if (!variable) return FAILURE;
    if (type == TYPE_STRING) slot = slot_of(text_number(packed, text));
    else if (is_real(type) && !isfinite(slot))
        return packed_fail(packed, FAILURE, "'%s' can't be %g; set a finite number", variable->name, slot);
    else if (!is_real(type) && type != TYPE_UINT64) {
        double value = (double)integer_of(slot);
        if (value < variable->smallest || value > variable->largest)
            return packed_fail(packed, FAILURE, "'%s' can't be %.17g; it must be between %.17g and %.17g",
                               variable->name, value, variable->smallest, variable->largest);
    }
    switch ((Role)variable->role) {
        case COLUMN:
            packed->inputs[variable->where] = slot;
            packed->rates[variable->where] = 0.0;
            break;
        case START: {
            Status status = set_start(packed, variable, slot);
            if (status != OK) return status;
            break;
        }
        case MAX_STEP:
            if (!(slot > 0.0))
                return packed_fail(packed, FAILURE, "'%s' can't be %g s; it must be positive", variable->name, slot);
            packed->now.max_step = slot;
            return OK;
        default:
            return packed_fail(packed, FAILURE, "'%s' is computed and can't be set", variable->name);
    }
    if (packed->within_step) return OK;
    if (packed->now.phase == STEPPING) packed->now.stale = packed->now.exchanged;
    else packed->now.exchanged = false;
    return OK;
}

Status packed_set_rate(Packed *packed, uint32_t reference, double rate) {
    const Variable *variable = reference < (uint32_t)packed->n_variables ? &packed->variables[reference] : NULL;
    if (!variable || variable->role != COLUMN || !is_real((VariableType)variable->type))
        return packed_fail(packed, FAILURE, "value reference %lu is not a real input and has no derivative to set",
                           (unsigned long)reference);
    if (!isfinite(rate))
        return packed_fail(packed, FAILURE, "the derivative of '%s' can't be %g", variable->name, rate);
    packed->rates[variable->where] = rate;
    return OK;
}
