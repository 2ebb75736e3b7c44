/* Reads the plan: words between spaces and ends of lines, in the order in which plan.py writes them. Texts begin with a
 * colon and have no spaces, by percent escapes; real numbers have the base 16, so that no locale matters. */
#include "packed.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "packed_hash.h"
#include "uri.h"

typedef struct {
    Packed *packed;
    char *next;
    bool failed;
    const char *why;
} Reader;

static char *word(Reader *in) {
    char *first = in->next + strspn(in->next, " \r\n");
    size_t length = strcspn(first, " \r\n");
    if (!length && !in->failed) in->failed = true, in->why = "it ends too early";
    in->next = first + length;
    if (*in->next) *in->next++ = '\0';
    return first;
}

static void expect(Reader *in, const char *expected) {
    const char *found = word(in);
    if (!in->failed && strcmp(found, expected)) in->failed = true, in->why = expected;
}

static int64_t integer(Reader *in) {
    char *text = word(in), *end;
    if (*text == '-') return (int64_t)strtoll(text, &end, 10);
    return (int64_t)strtoull(text, &end, 10);
}

static int32_t number(Reader *in) { return (int32_t)integer(in); }

/* A number of things, which can't be negative. */
static int32_t count(Reader *in) {
    int64_t n = integer(in);
    if ((n < 0 || n > INT32_MAX / 64) && !in->failed) in->failed = true, in->why = "a number of things is wrong";
    return in->failed ? 0 : (int32_t)n;
}

static int digit(char c) { return c >= '0' && c <= '9' ? c - '0' : c >= 'a' && c <= 'f' ? c - 'a' + 10 : -1; }

/* As Python's float.hex() writes it: -0x1.8000000000000p+3, inf. */
static double real(Reader *in) {
    const char *text = word(in);
    double sign = 1.0;
    if (*text == '-') sign = -1.0, text++;
    if (!strcmp(text, "inf")) return sign * INFINITY;
    uint64_t digits = 0;
    int exponent = 0;
    text += strlen(text) > 2 ? 2 : strlen(text);
    for (bool behind = false; *text && *text != 'p'; text++) {
        if (*text == '.') behind = true;
        else if (digit(*text) >= 0) digits = 16 * digits + (uint64_t)digit(*text), exponent -= behind ? 4 : 0;
        else in->failed = true, in->why = "a number is not a number";
    }
    if (*text == 'p') exponent += atoi(text + 1);
    return sign * ldexp((double)digits, exponent);
}

static const char *text(Reader *in) {
    char *text = word(in), *to = text;
    if (!in->failed && *text != ':') in->failed = true, in->why = "a text is missing";
    for (const char *from = text + (*text == ':'); *from; to++) {
        if (*from == '%' && digit(from[1]) >= 0 && digit(from[2]) >= 0) {
            *to = (char)(16 * digit(from[1]) + digit(from[2]));
            from += 3;
        } else {
            *to = *from++;
        }
    }
    *to = '\0';
    return text;
}

/* A slot, of the C type of its variable. */
static double slot(Reader *in, int32_t code) {
    if (code == POINTER) return slot_of(text_number(in->packed, text(in)));
    return code >= SIGNED ? slot_of(integer(in)) : real(in);
}

static void *room(Reader *in, int64_t n, size_t size) {
    void *found = in->failed ? NULL : keep(in->packed, (size_t)(n ? n : 1) * size);
    if (!found && !in->failed) in->failed = true, in->why = "there is not enough memory for it";
    return found;
}

#define ROOM(type, n) ((type *)room(in, n, sizeof(type)))

static int32_t *integers(Reader *in, int32_t n) {
    int32_t *found = ROOM(int32_t, n);
    for (int32_t i = 0; i < n && !in->failed; i++) found[i] = number(in);
    return found;
}

static uint32_t *references(Reader *in, int32_t n) {
    uint32_t *found = ROOM(uint32_t, n);
    for (int32_t i = 0; i < n && !in->failed; i++) found[i] = (uint32_t)integer(in);
    return found;
}

static double *reals(Reader *in, int64_t n) {
    double *found = ROOM(double, n);
    for (int64_t i = 0; i < n && !in->failed; i++) found[i] = real(in);
    return found;
}

static Component *component_of(Reader *in) {
    int32_t number_of = number(in);
    if (number_of < 0 || number_of >= in->packed->n_components)
        in->failed = true, in->why = "there is no such component", number_of = 0;
    return &in->packed->components[number_of];
}

static void read_component(Reader *in, Component *component) {
    expect(in, "component");
    component->packed = in->packed;
    component->name = text(in);
    component->version = number(in);
    component->identifier = text(in);
    component->folder = text(in);
    component->token = text(in);
    component->resets = number(in);
    component->takes_any_step = number(in);
    component->has_tolerance = number(in);
    component->tolerance = real(in);
    component->n_asks = (size_t)count(in);
    component->asks = references(in, (int32_t)component->n_asks);
    component->n_beside = count(in);
    component->beside = ROOM(const char *, component->n_beside);
    component->further = ROOM(void *, component->n_beside);
    for (int i = 0; i < component->n_beside && !in->failed; i++) component->beside[i] = text(in);
}

static void read_start(Reader *in, Start *start, int32_t *first) {
    expect(in, "start");
    start->component = component_of(in);
    start->when = number(in);
    start->given = number(in);
    start->tunable = number(in);
    start->code = number(in);
    start->setter = text(in);
    start->getter = text(in);
    start->reference = (uint32_t)integer(in);
    start->n = count(in);
    start->first = *first;
    *first += start->n;
    if (*first > in->packed->n_start_slots) in->failed = true, in->why = "there are more start values than it says";
    for (int32_t i = 0; i < start->n && !in->failed; i++)
        in->packed->default_starts[start->first + i] = slot(in, start->code);
}

static void read_variable(Reader *in, Variable *variable) {
    expect(in, "variable");
    variable->name = text(in);
    variable->type = number(in);
    variable->role = number(in);
    variable->where = number(in);
    variable->element = number(in);
    variable->smallest = real(in);
    variable->largest = real(in);
}

static void read_column(Reader *in, Column *column) {
    expect(in, "column");
    column->signal = number(in);
    column->element = number(in);
    int32_t code = number(in);
    column->is_real = code < SIGNED;
    column->every = number(in);
    column->start = slot(in, code);
}

static void read_signal(Reader *in, Signal *signal) {
    expect(in, "signal");
    signal->between = number(in);
    int32_t code = number(in);
    signal->size = count(in);
    signal->n_breakpoints = count(in);
    signal->breakpoints = reals(in, signal->n_breakpoints);
    signal->n = count(in);
    signal->times = reals(in, signal->n);
    int64_t n = (int64_t)signal->n * signal->size;
    double *values = ROOM(double, n);
    for (int64_t i = 0; i < n && !in->failed; i++) values[i] = slot(in, code);
    signal->values = values;
}

static TextCall *exchanged_text(Reader *in, Component *component, int32_t n) {
    TextCall *call = ROOM(TextCall, 1);
    if (!call) return NULL;
    call->component = component;
    call->buffer = ROOM(const char *, n);
    return call;
}

static void read_extrapolated(Reader *in, Operation *operation) {
    Packed *packed = in->packed;
    Extrapolated *inputs = ROOM(Extrapolated, 1);
    if (!inputs) return;
    inputs->degree = count(in);
    inputs->points = count(in);
    int32_t uses_rates = number(in), is_watched = number(in), is_in_block = number(in);
    inputs->first_rate = number(in);
    inputs->orders = integers(in, operation->n_references);
    inputs->weights = reals(in, (uses_rates ? 2 : 1) * (int64_t)inputs->points * inputs->degree * inputs->points);
    if (uses_rates) inputs->rates = ROOM(double, (int64_t)inputs->points * operation->n);
    if (is_watched) inputs->watched = ROOM(double, 4 * (int64_t)operation->n);
    if (is_in_block) inputs->ahead = ROOM(double, (int64_t)packed->block.steps * inputs->degree * operation->n);
    if (is_in_block && !packed->block.first) packed->block.first = inputs;
    inputs->history = ROOM(double, (int64_t)inputs->points * operation->n);
    inputs->derivatives = ROOM(double, (int64_t)inputs->degree * operation->n);
    inputs->buffer =
        ROOM(double, ((int64_t)inputs->degree + 1) * operation->n); /* derivatives, too; see loop_evaluate_all */
    packed->n_extrapolated_inputs[packed->n_extrapolated] = operation->n;
    packed->extrapolated[packed->n_extrapolated++] = inputs;
    operation->data = inputs;
}

static Rates *read_rates(Reader *in, int32_t n) {
    Rates *rates = ROOM(Rates, 1);
    if (!rates) return NULL;
    rates->orders = integers(in, n);
    rates->n = count(in);
    rates->knowns = references(in, rates->n);
    rates->positions = integers(in, rates->n);
    rates->seed = ROOM(double, rates->n);
    rates->change = ROOM(double, n);
    return rates;
}

static void read_operation(Reader *in, Operation *operation, Component **owner, const char **function) {
    expect(in, "operation");
    operation->kind = (uint8_t)number(in);
    operation->type = (uint8_t)number(in);
    operation->version = (uint8_t)number(in);
    operation->more = (uint8_t)number(in);
    operation->every = number(in);
    Component *component = *owner = component_of(in);
    if (operation->kind == STEP && component) component->every = operation->every;
    *function = text(in);
    operation->first = number(in);
    operation->n = count(in);
    operation->n_references = count(in);
    operation->references = references(in, operation->n_references);
    operation->n_targets = count(in);
    operation->targets = integers(in, count(in));
    size_t buffer = (size_t)count(in);
    if (in->failed) return;
    switch ((Kind)operation->kind) {
        case SET:
        case GET:
            if (operation->type == POINTER) operation->instance = exchanged_text(in, component, operation->n);
            else if (buffer) operation->data = room(in, (int64_t)buffer, 1);
            break;
        case EXTRAPOLATE:
            read_extrapolated(in, operation);
            break;
        case STEP:
            operation->data = ROOM(double, 1);
            break;
        case TRANSFORM:
            operation->data = reals(in, 2 * operation->n_targets);
            break;
        case CONVERT: {
            Conversion *conversions = ROOM(Conversion, operation->n_targets);
            for (int32_t i = 0; i < operation->n_targets && !in->failed; i++) {
                conversions[i].from = number(in);
                conversions[i].to = number(in);
                conversions[i].smallest = integer(in);
                conversions[i].largest = (uint64_t)integer(in);
            }
            operation->data = conversions;
            break;
        }
        case DIFFERENTIATE:
            operation->data = read_rates(in, operation->n);
            break;
        case SAMPLE:
        case CALL:
        case GROUP:
            break;
    }
}

/* All breakpoints, ascending, each once. */
static int ascending(const void *a, const void *b) {
    double difference = *(const double *)a - *(const double *)b;
    return (difference > 0.0) - (difference < 0.0);
}

static void gather_breakpoints(Reader *in) {
    Packed *packed = in->packed;
    int64_t n = 0;
    for (int32_t i = 0; i < packed->n_signals; i++) n += packed->signals[i].n_breakpoints;
    if (!(packed->breakpoints = ROOM(double, n))) return;
    n = 0;
    for (int32_t i = 0; i < packed->n_signals; i++)
        for (int32_t j = 0; j < packed->signals[i].n_breakpoints; j++)
            packed->breakpoints[n++] = packed->signals[i].breakpoints[j];
    qsort(packed->breakpoints, (size_t)n, sizeof(double), ascending);
    for (int64_t i = 0; i < n; i++)
        if (!packed->n_breakpoints || packed->breakpoints[i] != packed->breakpoints[packed->n_breakpoints - 1])
            packed->breakpoints[packed->n_breakpoints++] = packed->breakpoints[i];
}

/* Room for a starting block; its functions come with the components. */
static void read_block(Reader *in) {
    Packed *packed = in->packed;
    StartingBlock *block = &packed->block;
    block->n_values = packed->n_values;
    block->n_states = packed->n_components;
    block->states = ROOM(KeptState, packed->n_components);
    block->rows = ROOM(double, (int64_t)(block->steps + 1) * packed->n_values);
    block->before = ROOM(double, (int64_t)(block->steps + 1) * packed->n_values);
    block->known = ROOM(int32_t, packed->n_extrapolated);
    block->refused = ROOM(int32_t, packed->n_extrapolated);
    for (int32_t i = 0; i < packed->n_components && !in->failed; i++)
        block->states[i].state = &packed->components[i].kept;
    if (!block->first && !in->failed) in->failed = true, in->why = "nothing is in its starting block";
}

static void read_all(Reader *in) {
    Packed *packed = in->packed;
    expect(in, "cosim-pack");
    expect(in, "1");
    packed->token = text(in);
    packed->n_components = count(in);
    packed->n_values = count(in);
    packed->n_columns = count(in);
    packed->n_starts = count(in);
    packed->n_start_slots = count(in);
    packed->n_variables = count(in);
    packed->n_directs = count(in);
    packed->n_signals = count(in);
    int32_t *n_operations[] = {&packed->n_at_start, &packed->n_at_point, &packed->n_at_step};
    int32_t n_of_all = 0, n_texts;
    for (int k = 0; k < 3; k++) n_of_all += *n_operations[k] = count(in);
    packed->n_text_slots = n_texts = count(in);
    packed->default_step = real(in);
    packed->reach = count(in);
    packed->cycle = count(in);
    packed->block.steps = count(in);
    packed->parallel = number(in);
    packed->n_numbers = (int64_t)packed->n_values + 2 * (int64_t)packed->n_columns + packed->n_start_slots;
    packed->numbers = ROOM(double, packed->n_numbers);
    packed->values = packed->numbers;
    packed->inputs = packed->values + packed->n_values;
    packed->rates = packed->inputs + packed->n_columns;
    packed->start_slots = packed->rates + packed->n_columns;
    packed->default_starts = ROOM(double, packed->n_start_slots);
    packed->components = ROOM(Component, packed->n_components);
    packed->starts = ROOM(Start, packed->n_starts);
    packed->variables = ROOM(Variable, packed->n_variables);
    packed->directs = ROOM(Direct, packed->n_directs);
    packed->columns = ROOM(Column, packed->n_columns);
    packed->signals = ROOM(Signal, packed->n_signals);
    packed->functions = ROOM(const char *, n_of_all);
    packed->owners = ROOM(Component *, n_of_all);
    packed->no_codes = ROOM(uint32_t, n_of_all);
    packed->extrapolated = ROOM(Extrapolated *, n_of_all);
    packed->n_extrapolated_inputs = ROOM(int32_t, n_of_all);
    packed->value_names = ROOM(const char *, packed->n_values);
    if (in->failed) return;
    for (int32_t i = 0; i < packed->n_components && !in->failed; i++) read_component(in, &packed->components[i]);
    for (int32_t i = 0, first = 0; i < packed->n_starts && !in->failed; i++) read_start(in, &packed->starts[i], &first);
    for (int32_t i = 0; i < packed->n_columns && !in->failed; i++) read_column(in, &packed->columns[i]);
    for (int32_t i = 0; i < packed->n_signals && !in->failed; i++) read_signal(in, &packed->signals[i]);
    for (int32_t i = 0; i < packed->n_directs && !in->failed; i++) {
        Direct *direct = &packed->directs[i];
        expect(in, "direct");
        direct->component = component_of(in);
        direct->getter = text(in);
        direct->reference = (uint32_t)integer(in);
        direct->n = count(in);
    }
    for (int32_t i = 0; i < packed->n_variables && !in->failed; i++) read_variable(in, &packed->variables[i]);
    for (int32_t i = 0; i < packed->n_values && !in->failed; i++) packed->value_names[i] = text(in);
    packed->text_slots = integers(in, n_texts);
    Operation **operations[] = {&packed->at_start, &packed->at_point, &packed->at_step};
    for (int32_t k = 0, done = 0; k < 3 && !in->failed; done += *n_operations[k], k++) {
        *operations[k] = ROOM(Operation, *n_operations[k]);
        for (int32_t i = 0; i < *n_operations[k] && !in->failed; i++)
            read_operation(in, &(*operations[k])[i], &packed->owners[done + i], &packed->functions[done + i]);
    }
    expect(in, "end");
    if (packed->block.steps) read_block(in);
    packed->follows_other_steps = packed->reach == 1;
    for (int32_t i = 0; i < packed->n_extrapolated; i++)
        if (packed->extrapolated[i]->points > 2 || packed->extrapolated[i]->rates) packed->follows_other_steps = false;
    gather_breakpoints(in);
}

bool read_plan(Packed *packed) {
    char path[4096];
    if (snprintf(path, sizeof path, "%s/plan.txt", packed->folder) >= (int)sizeof path) {
        packed_fail(packed, FAILURE, "the path of the resources is too long: %.100s...", packed->folder);
        return false;
    }
    FILE *file = open_text(path);
    if (!file) {
        packed_fail(packed, FAILURE, "the plan of the system can't be read: %s is missing or unreadable", path);
        return false;
    }
    size_t room = 1 << 16, n = 0, got;
    char *all = malloc(room + 1);
    while (all && (got = fread(all + n, 1, room - n, file))) {
        n += got;
        if (n == room) {
            char *more = realloc(all, 2 * room + 1);
            if (!more) free(all);
            all = more;
            room *= 2;
        }
    }
    fclose(file);
    if (!all) {
        packed_fail(packed, FAILURE, "no memory for the plan of the system");
        return false;
    }
    all[n] = '\0';
    char *kept = keep(packed, n + 1); /* texts stay where they are */
    memcpy(kept, all, n + 1);
    free(all);
    Reader in = {packed, kept, false, NULL};
    read_all(&in);
    if (in.failed && in.why)
        packed_fail(packed, FAILURE, "the plan of the system, %s, is damaged or not for this library (%s): %s", path,
                    PACKED_HASH, in.why);
    return !in.failed;
}
