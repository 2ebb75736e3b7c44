#include "core.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

CoreStatus core_init(Core *core, const char *resources, int model_exchange, CoreLogger *logger, void *environment) {
    core->model_exchange = model_exchange;
    core->logger = logger;
    core->environment = environment;
    core->resources = malloc(strlen(resources) + 1);
    if (!core->resources) return core_fail(core, CORE_ERROR, "no memory for an instance");
    strcpy(core->resources, resources);
#ifdef N_TABLES
    core->has_tables = 0;
    CoreStatus status = core_open_tables(core);
    if (status == CORE_OK) status = core_reset(core);
#else
    CoreStatus status = core_reset(core);
#endif
    if (status != CORE_OK) core_close(core);
    return status;
}

void core_close(Core *core) {
#ifdef N_TABLES
    core_close_tables(core);
#endif
    free(core->resources);
    core->resources = NULL;
}

CoreStatus core_fail(Core *core, CoreStatus status, const char *format, ...) {
    char message[1024];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(message, sizeof message, format, arguments);
    va_end(arguments);
    core->logger(core->environment, status, message);
    return status;
}

CoreStatus core_reset(Core *core) {
    CoreState state;
    memset(&state, 0, sizeof state);
    state.phase = INSTANTIATED;
    CoreStatus status = core_read_start_values(core, state.values);
    if (status != CORE_OK) return status;
    memcpy(&core->state, &state, sizeof state);
    core->stop = INFINITY;
    return CORE_OK;
}

/* Checks */

static CoreStatus check_limits(Core *core, size_t parameter, double value, CoreStatus status) {
    double lower = model_limits[parameter][0], upper = model_limits[parameter][1];
    if (!(lower <= value && value <= upper))
        return core_fail(core, status, "parameter '%s' is %.17g; it must be between %.17g and %.17g",
                         model_names[parameter], value, lower, upper);
    return CORE_OK;
}

static CoreStatus check_parameters(Core *core) {
    double margins[N_START_REQUIREMENTS + 1];
    for (int i = 0; i < N_P; i++) {
        CoreStatus status = check_limits(core, (size_t)i, PARAMETERS(core)[i], CORE_ERROR);
        if (status != CORE_OK) return status;
    }
    model_start_margins(PARAMETERS(core), margins);
    for (int i = 0; i < N_START_REQUIREMENTS; i++)
        if (!(margins[i] > 0.0)) return core_fail(core, CORE_ERROR, "%s", model_start_requirements[i]);
    return CORE_OK;
}

CoreStatus core_check_margins(Core *core, double time, const double margins[], CoreStatus status) {
    for (int i = 0; i < N_STEP_REQUIREMENTS; i++)
        if (!(margins[i] > 0.0) && !(core->model_exchange && model_of_integration[i]))
            return core_fail(core, status, "t = %.9g s: %s", time, model_step_requirements[i]);
    return CORE_OK;
}

void core_have_rates(Core *core) {
    CoreState *s = &core->state;
    if (!(s->valid & RATES_VALID)) model_rates(s->time, STATES(core), INPUTS(core), PARAMETERS(core), RATES(core));
    s->valid |= RATES_VALID;
}

static CoreStatus check_now(Core *core, CoreStatus status) {
    core_have_rates(core);
    return core_check_margins(core, core->state.time, RATES(core) + N_X, status);
}

/* Whether references are those of all inputs or of all outputs in their order, as most importers have them: what is
 * done for a number of values that the compiler knows takes a fraction of the time. */
static int are_all(unsigned first, unsigned number, const unsigned references[], size_t n) {
    unsigned others = 0;
    if (!n || n != number) return 0;
    for (unsigned i = 0; i < number; i++) others |= references[i] ^ (first + i);
    return !others;
}

/* Life cycle */

CoreStatus core_start_at(Core *core, double time, int has_stop, double stop) {
    if (!isfinite(time)) return core_fail(core, CORE_ERROR, "start time %g is not a finite number", time);
    if (has_stop && isnan(stop)) return core_fail(core, CORE_ERROR, "stop time %g is not a number", stop);
    core->stop = has_stop ? stop : INFINITY;
    core->state.time = time;
    core->state.set_up = 1;
#if ADAPTIVE
    core->state.tolerance = 0.0; /* an importer that has one says it next */
#endif
    core->state.valid = 0;
    return CORE_OK;
}

CoreStatus core_set_tolerance(Core *core, double tolerance) {
#if ADAPTIVE
    double lower = model_limits[RTOL][0], upper = model_limits[RTOL][1];
    double nearest = tolerance < lower ? lower : tolerance > upper ? upper : tolerance;
    if (!(tolerance > 0.0))
        return core_fail(core, CORE_ERROR,
                         "the relative tolerance %g is not positive; leave it undefined or set it to "
                         "between %g and %g",
                         tolerance, lower, upper);
    core->state.tolerance = nearest;
    if (nearest != tolerance)
        return core_fail(core, CORE_WARNING, "the relative tolerance %g is not between %g and %g: %g is used",
                         tolerance, lower, upper, nearest);
#else
    (void)core, (void)tolerance;
#endif
    return CORE_OK;
}

static CoreStatus compute_initial_state(Core *core) {
    CoreStatus status = check_parameters(core);
    if (status != CORE_OK) return status;
    model_initial_state(PARAMETERS(core), STATES(core));
    core->state.valid = 0;
#if HYBRID
    status = core_start_discrete(core);
    if (status != CORE_OK) return status;
#endif
    return check_now(core, CORE_ERROR);
}

CoreStatus core_exit_initialization(Core *core) {
    CoreStatus status = compute_initial_state(core);
    if (status != CORE_OK) return status;
    core->state.phase = core->model_exchange ? EVENT : STEP;
    core->state.valid = 0;
    return CORE_OK;
}

/* Values */

CoreStatus core_have_states(Core *core) {
    CoreStatus status = CORE_OK;
    if (core->state.phase & (INSTANTIATED | INITIALIZATION)) status = compute_initial_state(core);
#if HYBRID
    if (status == CORE_OK) status = core_settle(core);
#endif
    return status;
}

static const char *name_of(size_t reference) { return model_names[reference]; }

/* Which state a variable is, -1 for one that is none. */
static int state_of(size_t reference) {
    return reference >= N_PU && reference < N_VARIABLES ? model_output_states[reference - N_PU] : -1;
}

/* Why a variable can't be set to a value; CORE_OK when it can. */
static CoreStatus refuse_set(Core *core, size_t reference, double value) {
    int running = !(core->state.phase & (INSTANTIATED | INITIALIZATION));
    if (reference >= INDICATORS && reference < INDICATORS + N_EVENTS)
        return core_fail(core, CORE_ERROR, "an event indicator is computed and can't be set");
    if (reference >= N_VALUES)
        return core_fail(core, CORE_ERROR, "no variable has the value reference %lu", (unsigned long)reference);
    if (reference >= N_PU) {
        int phases = INSTANTIATED | (core->model_exchange ? EVENT | CONTINUOUS : 0);
        if (state_of(reference) < 0)
            return core_fail(core, CORE_ERROR, "'%s' is computed and can't be set", name_of(reference));
        if (!(core->state.phase & phases))
            return core_fail(core, CORE_ERROR, "'%s' is a state, which is computed; only model exchange sets it, %s",
                             name_of(reference), "after the initialisation");
    }
    if (reference < N_P && running && !model_tunable[reference])
        return core_fail(core, CORE_ERROR,
                         "parameter '%s' is fixed after the initialisation; reset the instance to change it",
                         name_of(reference));
    if (reference < N_P && (core->state.phase == CONTINUOUS || core->within_step))
        return core_fail(core, CORE_ERROR, "parameter '%s' can't be set now; set it %s", name_of(reference),
                         core->model_exchange ? "in event mode" : "between two steps");
    if (!isfinite(value))
        return core_fail(core, CORE_ERROR, "'%s' can't be %g; set a finite number", name_of(reference), value);
    if (reference < N_P && running) return check_limits(core, reference, value, CORE_DISCARD);
    return CORE_OK;
}

CoreStatus core_set(Core *core, const unsigned references[], size_t n, const double values[]) {
    CoreState *s = &core->state;
    s->valid = s->arrived = 0;
#if HYBRID
    if (s->phase == STEP && !core->within_step) core_unsettle(core);
#endif
    if (are_all(N_P, N_U, references, n) && core_all_finite(values, N_U)) {
        memcpy(INPUTS(core), values, N_U * sizeof *values);
        for (int i = 0; i < N_U; i++) s->u_rate[i] = 0.0;
        s->degree = 0;
        return CORE_OK;
    }
    for (size_t i = 0; i < n; i++) {
        size_t reference = references[i];
        if (reference >= N_P && reference < N_PU && isfinite(values[i])) continue; /* a good value for an input */
        CoreStatus status = refuse_set(core, reference, values[i]);
        if (status != CORE_OK) return status;
    }
    size_t guess = 0;
    for (size_t i = 0; i < n; i++) {
        size_t reference = references[i];
        if (reference >= N_PU) {
            int state = state_of(reference), parameter = model_state_parameters[state];
            if (s->phase != INSTANTIATED) STATES(core)[state] = values[i];
            else if (parameter < 0) guess = reference;
            /* the guess of the model description says nothing: tools set it, too, after the parameter */
            else if (values[i] != model_guesses[state]) s->values[parameter] = values[i];
            continue;
        }
        s->values[reference] = values[i];
        if (reference < N_P) continue;
        s->u_rate[reference - N_P] = 0.0;
        for (int k = 0; s->degree > 1 && k < MOST_ORDER - 1; k++) s->u_higher[k][reference - N_P] = 0.0;
    }
    if (guess)
        return core_fail(core, CORE_WARNING,
                         "the value of '%s' is a guess that is not needed: the initialisation computes it from the "
                         "parameters, which set it",
                         name_of(guess));
    return CORE_OK;
}

/* Derivatives of all inputs, order by order, as masters set them at each step. */
static int set_all_derivatives(Core *core, const unsigned references[], size_t n, const int orders[],
                               const double values[]) {
    CoreState *s = &core->state;
    double *const places[MOST_ORDER] = {s->u_rate, s->u_higher[0], s->u_higher[1]};
    size_t of_order = N_U, degree = n / (of_order ? of_order : 1);
    int others = N_TYPED || degree < 1 || degree > MOST_ORDER || n != degree * of_order || !core_all_finite(values, n);
    for (size_t k = 0; !others && k < degree; k++) {
        others = !are_all(N_P, N_U, references + k * of_order, of_order);
        for (size_t i = 0; i < of_order; i++) others |= orders[k * of_order + i] ^ (int)(k + 1);
    }
    if (others || !of_order) return 0;
    for (size_t k = 0; k < MOST_ORDER; k++)
        if (k < degree) memcpy(places[k], values + k * of_order, of_order * sizeof *values);
        else if (degree > 1) memset(places[k], 0, of_order * sizeof *values);
    s->degree = degree > 1 ? (int)degree : 0;
    return 1;
}

CoreStatus core_set_input_derivatives(Core *core, const unsigned references[], size_t n, const int orders[],
                                      const double values[]) {
    CoreState *s = &core->state;
    if (set_all_derivatives(core, references, n, orders, values)) return CORE_OK;
    for (size_t i = 0; i < n; i++) {
        size_t reference = references[i];
        if (orders[i] < 1 || orders[i] > MOST_ORDER)
            return core_fail(core, CORE_ERROR, "input derivatives of order %d are not used, only of orders 1 to %d",
                             orders[i], MOST_ORDER);
        if (!(reference >= N_P && reference < N_PU))
            return core_fail(core, CORE_ERROR, "value reference %lu is not an input and has no derivative to set",
                             (unsigned long)reference);
        if (!IS_REAL(reference))
            return core_fail(core, CORE_ERROR, "input '%s' is discrete and has no derivative to set",
                             name_of(reference));
        if (!isfinite(values[i]))
            return core_fail(core, CORE_ERROR, "the derivative of '%s' can't be %g", name_of(reference), values[i]);
        if (orders[i] == 1) {
            s->u_rate[reference - N_P] = values[i];
            continue;
        }
        if (s->degree < 2) memset(s->u_higher, 0, sizeof s->u_higher);
        if (orders[i] > s->degree) s->degree = orders[i];
        s->u_higher[orders[i] - 2][reference - N_P] = values[i];
    }
    return CORE_OK;
}

/* Compute outputs or state derivatives. */
static CoreStatus compute(Core *core, int which) {
    CoreState *s = &core->state;
    CoreStatus status = core_have_states(core);
    if (status != CORE_OK) return status;
    if (which == OUTPUTS_VALID) model_everything(s->time, STATES(core), INPUTS(core), PARAMETERS(core), OUTPUTS(core));
    else core_have_rates(core);
    s->valid |= RATES_VALID;
    if (!core_all_finite(which == OUTPUTS_VALID ? OUTPUTS(core) : RATES(core), which == OUTPUTS_VALID ? N_Y : N_X)) {
        status = check_now(core, CORE_ERROR); /* a requirement says more than "not finite" */
        if (status != CORE_OK) return status;
        return core_fail(core, CORE_ERROR, "outputs at t = %.9g s are not finite; check the inputs", s->time);
    }
    if (s->arrived &&
        which == OUTPUTS_VALID) { /* where a step ends that broke a requirement, as the next one would find */
        status = core_check_margins(core, s->time, RATES(core) + N_X, CORE_ERROR);
        if (status != CORE_OK) return status;
    }
    s->valid |= which;
    return CORE_OK;
}

#if HYBRID
CoreStatus core_get_indicators(Core *core, double indicators[]) {
    CoreState *s = &core->state;
    CoreStatus status = core_have_states(core);
    if (status != CORE_OK) return status;
#if N_EVENTS > 0
    model_indicators(s->time, STATES(core), INPUTS(core), PARAMETERS(core), indicators);
#endif
    if (!core_all_finite(indicators, N_EVENTS))
        return core_fail(core, CORE_DISCARD, "event indicators at t = %.9g s are not finite", s->time);
    return CORE_OK;
}
#endif

CoreStatus core_get(Core *core, const unsigned references[], size_t n, double values[]) {
    CoreState *s = &core->state;
    int initialized = !(s->phase & (INSTANTIATED | INITIALIZATION));
    if (initialized && are_all(N_PU, N_OUTPUTS, references, n)) {
        CoreStatus status = s->valid & OUTPUTS_VALID ? CORE_OK : compute(core, OUTPUTS_VALID);
        if (status == CORE_OK) memcpy(values, OUTPUTS(core), N_OUTPUTS * sizeof *values);
        return status;
    }
#if HYBRID
    CoreStatus settled = initialized ? core_settle(core) : CORE_OK;
    if (settled != CORE_OK) return settled;
#endif
    size_t known = s->valid & OUTPUTS_VALID ? N_VARIABLES : N_PU, i = 0;
    const double *x = STATES(core);
    for (;;) {
        for (; i < n && references[i] < known; i++) values[i] = s->values[references[i]];
        if (i == n) return CORE_OK;
        size_t reference = references[i];
        int is_output = reference < N_VARIABLES;
        int state = initialized ? state_of(reference) : -1;
        if (state >= 0) { /* nothing to compute */
            values[i++] = x[state];
        } else if (reference < N_VALUES) {
            CoreStatus status = compute(core, is_output ? OUTPUTS_VALID : RATES_VALID);
            if (status != CORE_OK) return status;
            if (is_output) known = N_VARIABLES;
            else values[i++] = s->values[reference];
        } else if (reference == TIME) {
            values[i++] = s->time;
#if N_EVENTS > 0
        } else if (reference < INDICATORS + N_EVENTS) {
            double indicators[N_EVENTS];
            CoreStatus status = core_get_indicators(core, indicators);
            if (status != CORE_OK) return status;
            values[i++] = indicators[reference - INDICATORS];
#endif
        } else {
            return core_fail(core, CORE_ERROR, "no variable has the value reference %lu", (unsigned long)reference);
        }
    }
}

CoreStatus core_check_output_orders(Core *core, const int orders[], size_t n) {
    for (size_t i = 0; i < n; i++)
        if (orders[i] != 1)
            return core_fail(core, CORE_ERROR,
                             "output derivatives of order %d are not provided (maxOutputDerivativeOrder is 1)",
                             orders[i]);
    return CORE_OK;
}

CoreStatus core_get_output_derivatives(Core *core, const unsigned references[], size_t n, double values[]) {
    CoreState *s = &core->state;
    double computed[N_OUTPUTS + 1], of_inputs[N_Y + N_X + 1];
    int has_computed = 0, inputs_change = 0;
    for (size_t i = 0; i < n; i++)
        if (!(references[i] >= N_PU && references[i] < N_PU + N_OUTPUTS))
            return core_fail(core, CORE_ERROR, "value reference %lu is not an output and has no derivative to get",
                             (unsigned long)references[i]);
#if HYBRID
    CoreStatus settled = core_settle(core);
    if (settled != CORE_OK) return settled;
#endif
    core_have_rates(core);
    for (int j = 0; j < N_U; j++) inputs_change |= s->u_rate[j] != 0.0;
    for (size_t i = 0; i < n; i++) {
        int state = state_of(references[i]);
        if (state >= 0) { /* nothing to compute */
            values[i] = RATES(core)[state];
            continue;
        }
        if (!has_computed) {
            double dx[N_X + 1] = {0}, dp[N_P + 1] = {0};
            model_output_rates(s->time, STATES(core), INPUTS(core), PARAMETERS(core), RATES(core), computed);
            if (inputs_change)
                model_direction(s->time, STATES(core), INPUTS(core), PARAMETERS(core), dx, s->u_rate, dp, of_inputs);
            for (int k = 0; inputs_change && k < N_OUTPUTS; k++) computed[k] += of_inputs[k];
            has_computed = 1;
        }
        values[i] = computed[references[i] - N_PU];
    }
    if (!core_all_finite(values, n))
        return core_fail(core, CORE_ERROR, "derivatives of outputs at t = %.9g s are not finite", s->time);
    return CORE_OK;
}

/* Model exchange */

CoreStatus core_set_time(Core *core, double time) {
    if (!isfinite(time)) return core_fail(core, CORE_ERROR, "time %g is not a finite number", time);
    core->state.time = time;
    core->state.valid = 0;
    return CORE_OK;
}

CoreStatus core_set_states(Core *core, const double x[]) {
    if (!core_all_finite(x, N_X))
        return core_fail(core, CORE_ERROR, "continuous states at t = %.9g s are not finite", core->state.time);
    for (int i = 0; i < N_X; i++) STATES(core)[i] = x[i];
    core->state.valid = 0;
    return CORE_OK;
}

CoreStatus core_get_derivatives(Core *core, double derivatives[]) {
    int initialized = !(core->state.phase & INITIALIZATION);
    CoreStatus status = initialized ? check_now(core, CORE_DISCARD) : compute_initial_state(core);
    if (status != CORE_OK) return status;
    if (!core_all_finite(RATES(core), N_X))
        return core_fail(core, CORE_DISCARD, "derivatives at t = %.9g s are not finite", core->state.time);
    for (int i = 0; i < N_X; i++) derivatives[i] = RATES(core)[i];
    return CORE_OK;
}

CoreStatus core_get_states(Core *core, double x[]) {
    if (core->state.phase & INITIALIZATION) {
        CoreStatus status = compute_initial_state(core);
        if (status != CORE_OK) return status;
    }
    for (int i = 0; i < N_X; i++) x[i] = STATES(core)[i];
    return CORE_OK;
}

/* Directional derivatives */

CoreStatus core_direction(Core *core, const unsigned unknowns[], size_t n, const double change[], double result[],
                          CoreStatus status) {
    CoreState *s = &core->state;
    double dx[N_X + 1] = {0}, changes[N_Y + N_X + 1];
    if (!core_all_finite(change, N_VALUES))
        return core_fail(core, CORE_ERROR, "the direction has entries that are not finite");
    const double *dp = change, *du = change + N_P;
    CoreStatus states = core_have_states(core);
    if (states != CORE_OK) return states;
    if (s->phase & (INSTANTIATED | INITIALIZATION)) {
        model_initial_state_direction(PARAMETERS(core), dp, dx);
    } else {
        for (int i = 0; i < N_X; i++) dx[i] = change[N_PU + model_state_outputs[i]];
    }
    model_direction(s->time, STATES(core), INPUTS(core), PARAMETERS(core), dx, du, dp, changes);
    for (size_t i = 0; i < n; i++) {
        if (unknowns[i] < N_PU || unknowns[i] >= N_VALUES)
            return core_fail(core, CORE_ERROR,
                             "value reference %lu is not an unknown: give outputs or state derivatives",
                             (unsigned long)unknowns[i]);
        result[i] = changes[unknowns[i] - N_PU];
        if (!isfinite(result[i]))
            return core_fail(core, status, "t = %.9g s: the directional derivative of '%s' is not finite", s->time,
                             name_of(unknowns[i]));
    }
    return CORE_OK;
}

/* FMU states */

static const char GUID[] = MODEL_GUID;

/* GUID, state, then a checksum over both. */
enum { CHECKED = sizeof GUID + sizeof(CoreState) };

size_t core_serialized_size(void) { return CHECKED + sizeof(uint64_t); }

static uint64_t checksum(const char bytes[]) { /* FNV-1a */
    uint64_t hash = 14695981039346656037u;
    for (size_t i = 0; i < CHECKED; i++) hash = (hash ^ (unsigned char)bytes[i]) * 1099511628211u;
    return hash;
}

void core_serialize(const CoreState *state, char bytes[]) {
    memcpy(bytes, GUID, sizeof GUID);
    CoreState copy = *state; /* without what can be computed: equal states have equal bytes */
    memset(copy.x[!copy.which], 0, sizeof copy.x[0]);
    memset(copy.values + N_PU, 0, (MODEL_Z - N_PU) * sizeof *copy.values);
    copy.valid = 0;
    copy.u_time = 0.0; /* until a step begins */
    memset(copy.u_start, 0, sizeof copy.u_start);
    if (copy.degree < 2) memset(copy.u_higher, 0, sizeof copy.u_higher);
#if HYBRID
    if (copy.settled) { /* what happens at this instant follows from what was before and the inputs */
        copy.discrete = copy.before;
        memcpy(copy.x[copy.which], copy.x_before, sizeof copy.x_before);
        memcpy(copy.values + MODEL_Z, copy.z_before, N_Z * sizeof *copy.z_before);
    }
    copy.settled = 0;
    memset(&copy.before, 0, sizeof copy.before);
    memset(copy.x_before, 0, sizeof copy.x_before);
    memset(copy.z_before, 0, sizeof copy.z_before);
#endif
    memcpy(bytes + sizeof GUID, &copy, sizeof copy);
    uint64_t sum = checksum(bytes);
    memcpy(bytes + CHECKED, &sum, sizeof sum);
}

CoreStatus core_deserialize(Core *core, const char bytes[], size_t size, CoreState *state) {
    uint64_t sum = size == core_serialized_size() ? checksum(bytes) : 0;
    if (size != core_serialized_size() || memcmp(bytes, GUID, sizeof GUID) || memcmp(bytes + CHECKED, &sum, sizeof sum))
        return core_fail(core, CORE_ERROR, "the FMU state is damaged or belongs to another FMU");
    memcpy(state, bytes + sizeof GUID, sizeof *state);
    int phase = state->phase, running = core->model_exchange ? EVENT | CONTINUOUS : STEP | DISCARDED;
    if (!(phase & (INSTANTIATED | INITIALIZATION | running | TERMINATED | FAILED)) || phase & (phase - 1))
        return core_fail(core, CORE_ERROR,
                         "the FMU state is damaged or belongs to the other interface (model exchange, co-simulation)");
    if (!core_all_finite(state->values, N_PU) || state->which & ~1 || !core_all_finite(state->x[state->which], N_X) ||
        !core_all_finite(state->u_rate, N_U) || !isfinite(state->time) || state->degree < 0 ||
        state->degree > MOST_ORDER || !core_all_finite(state->u_higher[0], N_U) ||
        !core_all_finite(state->u_higher[1], N_U) || !core_all_finite(state->values + MODEL_Z, N_Z))
        return core_fail(core, CORE_ERROR, "the FMU state is damaged: it has values that are not finite");
#if ADAPTIVE
    if (!(state->tolerance >= 0.0 && state->control.proposed >= 0.0 && state->control.size >= 0.0))
        return core_fail(core, CORE_ERROR, "the FMU state is damaged: its step size or its tolerance makes no sense");
#endif
#if HYBRID
    if (!core_all_finite((const double *)&state->discrete, sizeof state->discrete / sizeof(double)) || state->settled)
        return core_fail(core, CORE_ERROR, "the FMU state is damaged: its events and samplers make no sense");
#endif
    state->valid = 0;
    return CORE_OK;
}
