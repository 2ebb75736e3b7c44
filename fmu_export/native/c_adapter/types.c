/* Values of other types than real ones: integers, Booleans, enumerations, strings. In the arrays of the core each is a
 * double: a Boolean is 0 or 1, an enumeration the value of its item, a string the position of its text. */
#include "core.h"

#include <errno.h>
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#if N_TYPED > 0

static const char *const names_of_types[] = {"real", "integer", "Boolean", "enumeration", "string"};

/* Position of a text among the items, or of the item with a value; -1 if there is none. */
static int find_item(const ModelItems *items, const char *text, double value) {
    for (int i = 0; i < items->n; i++)
        if (text ? !strcmp(text, items->texts[i]) : items->values[i] == value) return i;
    return -1;
}

/* Whether a number stands for a value of the variable's type. */
static int is_value(size_t reference, double value) {
    switch (model_types[reference]) {
        case TYPE_INTEGER:
            return value == floor(value) && fabs(value) <= INT32_MAX;
        case TYPE_BOOLEAN:
            return value == 0.0 || value == 1.0;
        case TYPE_REAL:
            return isfinite(value) != 0;
        default:
            return find_item(&model_items[reference], NULL, value) >= 0;
    }
}

CoreStatus core_check_value(Core *core, size_t reference, double value, CoreStatus status) {
    if (is_value(reference, value)) return CORE_OK;
    return core_fail(core, status, "'%s' is %.17g, which is not a value of its type, %s", model_names[reference], value,
                     names_of_types[model_types[reference]]);
}

int core_read_value(size_t reference, const char *text, double *value) {
    int type = model_types[reference], item;
    char *end;
    long number;
    switch (type) {
        case TYPE_BOOLEAN:
            *value = !strcmp(text, "true") || !strcmp(text, "1");
            return *value != 0.0 || !strcmp(text, "false") || !strcmp(text, "0");
        case TYPE_STRING:
            item = find_item(&model_items[reference], text, 0.0);
            if (item >= 0) *value = model_items[reference].values[item];
            return item >= 0;
        default:
            errno = 0;
            number = strtol(text, &end, 10);
            *value = (double)number;
            return !errno && end > text && !*end && is_value(reference, *value);
    }
}

/* Which types a representation is for, as bits. */
static int types_as(Representation as) {
    switch (as) {
        case AS_DOUBLE:
            return 1 << TYPE_REAL;
        case AS_INT32:
            return 1 << TYPE_INTEGER;
        case AS_INT32_OR_ITEM:
            return 1 << TYPE_INTEGER | 1 << TYPE_ENUMERATION;
        case AS_INT64_ITEM:
            return 1 << TYPE_ENUMERATION;
        case AS_TEXT:
            return 1 << TYPE_STRING;
        default:
            return 1 << TYPE_BOOLEAN;
    }
}

CoreStatus core_check_types(Core *core, Representation as, const unsigned references[], size_t n,
                            const char *function) {
    for (size_t i = 0; i < n; i++) {
        unsigned reference = references[i];
        int type = reference < N_VALUES ? model_types[reference] : TYPE_REAL;
        if (!(types_as(as) & 1 << type))
            return core_fail(core, CORE_ERROR, "%s: '%s' is of type %s", function,
                             reference < N_VALUES ? model_names[reference] : "time", names_of_types[type]);
    }
    return CORE_OK;
}

static void write_value(Representation as, unsigned reference, double number, void *values, size_t i) {
    switch (as) {
        case AS_INT64_ITEM:
            ((int64_t *)values)[i] = (int64_t)number;
            break;
        case AS_BOOL:
            ((bool *)values)[i] = number != 0.0;
            break;
        case AS_TEXT:
            ((const char **)values)[i] = model_items[reference].texts[find_item(&model_items[reference], NULL, number)];
            break;
        default:
            ((int32_t *)values)[i] = (int32_t)number;
    }
}

CoreStatus core_get_as(Core *core, Representation as, const unsigned references[], size_t n, void *values,
                       const char *function) {
    CoreStatus status = core_check_types(core, as, references, n, function);
    for (size_t i = 0; status == CORE_OK && i < n; i++) {
        double number;
        status = core_get(core, &references[i], 1, &number);
        if (status == CORE_OK) status = core_check_value(core, references[i], number, CORE_ERROR);
        if (status == CORE_OK) write_value(as, references[i], number, values, i);
    }
    return status;
}

/* The number that stands for a value that the importer gives; NaN if there is none. */
static double read_value(Representation as, unsigned reference, const void *values, size_t i) {
    const char *text;
    int item;
    switch (as) {
        case AS_INT64_ITEM:
            return (double)((const int64_t *)values)[i];
        case AS_BOOL:
            return ((const bool *)values)[i];
        case AS_TEXT:
            text = ((const char *const *)values)[i];
            item = text ? find_item(&model_items[reference], text, 0.0) : -1;
            return item < 0 ? NAN : model_items[reference].values[item];
        default:
            return ((const int32_t *)values)[i];
    }
}

CoreStatus core_set_as(Core *core, Representation as, const unsigned references[], size_t n, const void *values,
                       const char *function) {
    double numbers[N_TYPED];
    if (n > N_TYPED)
        return core_fail(core, CORE_ERROR, "%s: %lu values; only %d variables are no reals", function, (unsigned long)n,
                         N_TYPED);
    CoreStatus status = core_check_types(core, as, references, n, function);
    for (size_t i = 0; status == CORE_OK && i < n; i++) {
        unsigned reference = references[i];
        numbers[i] = read_value(as, reference, values, i);
        if (as == AS_TEXT && isnan(numbers[i])) {
            const char *text = ((const char *const *)values)[i];
            status = core_fail(core, CORE_ERROR, "'%s' can't be '%s'; set one of its texts, such as '%s'",
                               model_names[reference], text ? text : "NULL", model_items[reference].texts[0]);
        } else {
            status = core_check_value(core, reference, numbers[i], CORE_ERROR);
        }
        if (status == CORE_OK && reference >= N_P && (core->state.phase == CONTINUOUS || core->within_step))
            status = core_fail(core, CORE_ERROR, "input '%s' is discrete and can't be set now; set it %s",
                               model_names[reference], core->model_exchange ? "in event mode" : "between two steps");
    }
    return status == CORE_OK ? core_set(core, references, n, numbers) : status;
}

#else

static CoreStatus no_such_type(Core *core, size_t n, const char *function) {
    return n ? core_fail(core, CORE_ERROR, "%s: no variable of this FMU is of this type", function) : CORE_OK;
}

CoreStatus core_get_as(Core *core, Representation as, const unsigned references[], size_t n, void *values,
                       const char *function) {
    (void)as, (void)references, (void)values;
    return no_such_type(core, n, function);
}

CoreStatus core_set_as(Core *core, Representation as, const unsigned references[], size_t n, const void *values,
                       const char *function) {
    (void)as, (void)references, (void)values;
    return no_such_type(core, n, function);
}

#endif
