/* The face of a WebAssembly module: one instance of the model. Its host writes start values, arguments and what is set into
 * the module's memory, and reads there what is computed. */
#include "core.h"
#ifdef N_TABLES
#include "table.h"
#endif

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define EXPORT(name) __attribute__((export_name(#name)))

static Core core;
static double start_values[N_PU + 1];
static char message[1024];

static void keep_message(void *environment, CoreStatus status, const char *text) {
    (void)environment, (void)status;
    size_t n = strlen(text);
    if (n >= sizeof message) n = sizeof message - 1;
    memcpy(message, text, n);
    message[n] = '\0';
}

CoreStatus core_read_start_values(Core *c, double values[]) {
    for (int i = 0; i < N_PU; i++) {
        if (!isfinite(start_values[i]))
            return core_fail(c, CORE_ERROR, "the start value of '%s' is %g; it must be a finite number", model_names[i],
                             start_values[i]);
#if N_TYPED > 0
        CoreStatus status = core_check_value(c, (size_t)i, start_values[i], CORE_ERROR);
        if (status != CORE_OK) return status;
#endif
    }
    memcpy(values, start_values, N_PU * sizeof *values);
    return CORE_OK;
}

/* What the last message said; a status other than 0 has one. */
EXPORT(message) const char *module_message(void) { return message; }

/* Memory for the host, which stays its own. */
EXPORT(allocate) void *module_allocate(size_t size) { return malloc(size); }

/* The start values of parameters and inputs, to be written before the instance is made or reset. */
EXPORT(startValues) double *module_start_values(void) { return start_values; }

#ifdef N_TABLES
static Table given[N_TABLES];

/* Room for the data of a table with n times m values, one behind the other: breakpoints (n), those of the second variable
 * (m) if there is one, values. NULL if there is no memory. */
EXPORT(tableData) double *module_table_data(int which, size_t n, size_t m) {
    Table *table = &given[which];
    int two = model_table_variables[which] == 2;
    table->x = malloc((n + m * two + n * m) * sizeof *table->x);
    table->n[0] = n;
    table->n[1] = m;
    table->y = table->x + n;
    table->values = table->y + m * two;
    return table->x;
}

CoreStatus core_read_table(Core *c, int which, Table *table) {
    if (!given[which].x) return core_fail(c, CORE_ERROR, "table '%s' has no data", model_tables[which]);
    *table = given[which];
    return CORE_OK;
}
#endif

/* The functions of an FMU; all but those that ask for a value return a status. */

EXPORT(instantiate) CoreStatus module_instantiate(void) { return core_init(&core, "", 0, keep_message, NULL); }

EXPORT(reset) CoreStatus module_reset(void) { return core_reset(&core); }

EXPORT(set) CoreStatus module_set(const unsigned references[], size_t n, const double values[]) {
#if N_TYPED > 0
    for (size_t i = 0; i < n; i++) {
        CoreStatus status =
            references[i] < N_VALUES ? core_check_value(&core, references[i], values[i], CORE_ERROR) : CORE_OK;
        if (status != CORE_OK) return status;
    }
#endif
    return core_set(&core, references, n, values);
}

EXPORT(get) CoreStatus module_get(const unsigned references[], size_t n, double values[]) {
    return core_get(&core, references, n, values);
}

/* Between `instantiate` or `reset` and the first step; a tolerance of 0 is none. */
EXPORT(initialize) CoreStatus module_initialize(double time, double tolerance) {
    if (!core_allowed(&core, INSTANTIATED, "initialize")) return CORE_ERROR;
    CoreStatus status = core_start_at(&core, time, 0, 0.0);
    if (status == CORE_OK && tolerance != 0.0) status = core_set_tolerance(&core, tolerance);
    if (status > CORE_WARNING) return status;
    core.state.phase = INITIALIZATION;
    CoreStatus initial = core_exit_initialization(&core);
    return initial == CORE_OK ? status : initial;
}

EXPORT(step) CoreStatus module_step(double time, double size) {
    return core_allowed(&core, STEP, "step") ? core_do_step(&core, time, size) : CORE_ERROR;
}

/* Several steps.
 *
 * Point i is at start + i size. From point `first` on, n steps are made; at each of the n + 1 points the inputs are set, whose
 * row is `inputs[i - first]`, and then the recorded variables got: the one with number k at point i goes to
 * `columns[k * stride + i]`. Without rows the inputs stay. With `linear` they go on linearly to their next row. Returns how
 * many points are complete, which are fewer than n + 1 only where something failed. */
EXPORT(run)
size_t module_run(double start, double size, size_t first, size_t n, const double *inputs, int linear,
                  const unsigned recorded[], size_t n_recorded, double row[], double *columns, size_t stride) {
    unsigned references[N_U + 1];
    const int order = 1;
    for (int j = 0; j < N_U; j++) references[j] = (unsigned)(N_P + j);
    for (size_t i = 0; i <= n; i++) {
        const double *u = inputs ? inputs + i * N_U : NULL;
        if (u && module_set(references, N_U, u) > CORE_WARNING) return i;
        if (core_get(&core, recorded, n_recorded, row) > CORE_WARNING) return i;
        for (size_t k = 0; k < n_recorded; k++) columns[k * stride + first + i] = row[k];
        if (i == n) break;
        for (int j = 0; linear && u && j < N_U; j++) {
            double rate = (u[N_U + j] - u[j]) / size;
            if (IS_REAL(N_P + j) && core_set_input_derivatives(&core, &references[j], 1, &order, &rate) > CORE_WARNING)
                return i + 1;
        }
        if (module_step(start + (double)(first + i) * size, size) > CORE_WARNING) return i + 1;
    }
    return n + 1;
}
