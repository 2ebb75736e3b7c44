/* The face of FMI 3.0: checks the calls, translates them to the core. */
#include "fmi3Functions.h"

#include <stdlib.h>
#include <string.h>

#include "core.h"

typedef struct {
    Core core;
    fmi3LogMessageCallback logger;
    fmi3IntermediateUpdateCallback intermediate_update;
    fmi3InstanceEnvironment environment;
} Instance;

enum { RUNNING = STEP | EVENT | CONTINUOUS, ANY = INSTANTIATED | INITIALIZATION | RUNNING | OVER };

/* The status of a call. After an error the standard allows to look at values, to restore a saved state, and to reset. */
static fmi3Status done(Instance *instance, CoreStatus status) {
    if (status == CORE_ERROR) instance->core.state.phase = FAILED;
    return (fmi3Status)status;
}

/* Return fmi3Error unless the instance is there and the call is allowed now. */
#define CHECK(c, phases) \
    Instance *instance = c; \
    if (!instance) return fmi3Error; \
    if (!core_allowed(&instance->core, phases, __func__)) return done(instance, CORE_ERROR)

#define FAIL(...) done(instance, core_fail(&instance->core, CORE_ERROR, __VA_ARGS__))

#define MISSING FAIL("%s: an argument is missing", __func__)

static void forward_log(void *environment, CoreStatus status, const char *message) {
    static const char *const categories[] = {"logAll", "logStatusWarning", "logStatusDiscard", "logStatusError"};
    Instance *instance = environment;
    if (instance->logger) /* errors are logged always: who switched logging off still wants to know why a run ended */
        instance->logger(instance->environment, (fmi3Status)status, categories[status], message);
}

static void request_inputs(void *environment, double time) {
    Instance *instance = environment;
    fmi3Boolean early_return = fmi3False;
    fmi3Float64 early_return_time = time;
    instance->core.within_step = 1;
    instance->intermediate_update(instance->environment, time, fmi3True, fmi3False, fmi3False, fmi3False, &early_return,
                                  &early_return_time);
    instance->core.within_step = 0;
}

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[]) {
    (void)on, (void)n, (void)categories; /* there are error messages only, and these are logged always */
    CHECK(c, ANY);
    return fmi3OK;
}

static fmi3Instance instantiate(fmi3String name, fmi3String token, fmi3String resources, int model_exchange,
                                fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger) {
    const char *problem = !name || !*name ? "the instance has no name"
                          : !token || strcmp(token, MODEL_GUID)
                              ? "the instantiation token is not that of this FMU; don't mix files of different builds"
                          : !resources ? "the resource path is missing"
                                       : NULL;
    Instance *instance = problem ? NULL : calloc(1, sizeof *instance);
    if (instance) {
        instance->logger = logger;
        instance->environment = environment;
        if (core_init(&instance->core, resources, model_exchange, forward_log, instance) == CORE_OK) return instance;
        free(instance);
    } else if (logger) {
        logger(environment, fmi3Error, "logStatusError", problem ? problem : "no memory for an instance");
    }
    return NULL;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback logger) {
    (void)visible, (void)logging;
    return instantiate(name, token, resources, 1, environment, logger);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean event_mode, fmi3Boolean early_return,
                                         const fmi3ValueReference required[], size_t n_required,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger,
                                         fmi3IntermediateUpdateCallback intermediate_update) {
    (void)visible, (void)logging, (void)early_return, (void)required, (void)n_required;
    if (event_mode) {
        if (logger)
            logger(environment, fmi3Error, "logStatusError",
                   "this FMU has no event mode; instantiate it with eventModeUsed = false");
        return NULL;
    }
    Instance *instance = instantiate(name, token, resources, 0, environment, logger);
    if (instance && intermediate_update && n_required) {
        instance->intermediate_update = intermediate_update;
        instance->core.request_inputs = request_inputs;
    }
    return instance;
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                               fmi3Boolean visible, fmi3Boolean logging,
                                               fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger,
                                               fmi3ClockUpdateCallback clock_update, fmi3LockPreemptionCallback lock,
                                               fmi3UnlockPreemptionCallback unlock) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)clock_update, (void)lock,
        (void)unlock;
    if (logger)
        logger(environment, fmi3Error, "logStatusError",
               "this FMU has no scheduled execution; use co-simulation or model exchange");
    return NULL;
}

void fmi3FreeInstance(fmi3Instance c) {
    Instance *instance = c;
    if (!instance) return;
    core_close(&instance->core);
    free(instance);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean tolerance_defined, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean stop_defined, fmi3Float64 stop) {
    CHECK(c, INSTANTIATED);
    CoreStatus status = core_start_at(&instance->core, start, stop_defined, stop);
    if (status == CORE_OK && tolerance_defined) status = core_set_tolerance(&instance->core, tolerance);
    if (status <= CORE_WARNING) instance->core.state.phase = INITIALIZATION;
    return done(instance, status);
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance c) {
    CHECK(c, INITIALIZATION);
    return done(instance, core_exit_initialization(&instance->core));
}

fmi3Status fmi3EnterEventMode(fmi3Instance c) {
    CHECK(c, EVENT | CONTINUOUS);
    instance->core.state.phase = EVENT;
    return fmi3OK;
}

fmi3Status fmi3Terminate(fmi3Instance c) {
    CHECK(c, RUNNING);
    instance->core.state.phase = TERMINATED;
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance c) {
    CHECK(c, ANY);
    return done(instance, core_reset(&instance->core));
}

/* Values */

/* References of array elements, if there are arrays; whoever gives a variable twice may give half of them twice. */
enum { MOST_ELEMENTS = ARRAYS ? 2 * N_VALUES + 64 : 1 };

/* Check references and values; the references of elements in `elements` take the place of those of arrays. */
static fmi3Status check_arrays(Instance *instance, const fmi3ValueReference **references, size_t *n, const void *values,
                               size_t n_values, fmi3ValueReference elements[], const char *function) {
    if ((*n && !*references) || (n_values && !values)) return FAIL("%s: an array is missing", function);
#if ARRAYS
    size_t total = 0;
    for (size_t i = 0; i < *n; i++) {
        unsigned reference = (*references)[i], length = reference < N_VALUES ? model_lengths[reference] : 1;
        if (!length) return FAIL("no variable has the value reference %u", reference);
        if (total + length > MOST_ELEMENTS) return FAIL("%s: too many variables at once", function);
        for (unsigned k = 0; k < length; k++) elements[total++] = reference + k;
    }
    *references = elements;
    *n = total;
#else
    (void)elements;
#endif
    if (*n != n_values)
        return FAIL("%s: %lu values for %lu %s", function, (unsigned long)n_values, (unsigned long)*n,
                    ARRAYS ? "elements of variables" : "variables, which are all scalars");
    return fmi3OK;
}

/* Before the initialisation only what has a start value has a value: parameters, inputs, states, and the time. */
static fmi3Status check_has_value(Instance *instance, const fmi3ValueReference references[], size_t n) {
    for (size_t i = 0; instance->core.state.phase == INSTANTIATED && i < n; i++) {
        unsigned reference = references[i];
        if (reference < N_PU || reference == TIME || reference >= INDICATORS + N_EVENTS) continue;
        if (reference < N_VARIABLES && model_output_states[reference - N_PU] >= 0) continue;
        return FAIL("'%s' is computed and has no value before the initialisation mode",
                    reference < N_VALUES ? model_names[reference] : "an event indicator");
    }
    return fmi3OK;
}

/* The same as a statement that returns if they are wrong. */
#define CHECK_ARRAYS(references, n, values, n_values) \
    fmi3ValueReference elements_of_##references[MOST_ELEMENTS]; \
    if (check_arrays(instance, &references, &n, values, n_values, elements_of_##references, __func__)) return fmi3Error

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference references[], size_t n, fmi3Float64 values[],
                          size_t n_values) {
    CHECK(c, ANY);
    CHECK_ARRAYS(references, n, values, n_values);
    if (!ARE_REAL(&instance->core, references, n)) return done(instance, CORE_ERROR);
    if (check_has_value(instance, references, n)) return fmi3Error;
    return done(instance, core_get(&instance->core, references, n, values));
}

fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference references[], size_t n, const fmi3Float64 values[],
                          size_t n_values) {
    CHECK(c, INSTANTIATED | INITIALIZATION | RUNNING);
    CHECK_ARRAYS(references, n, values, n_values);
    if (!ARE_REAL(&instance->core, references, n)) return done(instance, CORE_ERROR);
    return done(instance, core_set(&instance->core, references, n, values));
}

static fmi3Status no_such_type(fmi3Instance c, size_t n, const char *function) {
    CHECK(c, ANY);
    return n ? FAIL("%s: no variable of this FMU is of this type", function) : fmi3OK;
}

#define REFUSE(Type) \
    fmi3Status fmi3Get##Type(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3##Type v[], size_t m) { \
        (void)r, (void)v, (void)m; \
        return no_such_type(c, n, __func__); \
    } \
    fmi3Status fmi3Set##Type(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3##Type v[], size_t m) { \
        (void)r, (void)v, (void)m; \
        return no_such_type(c, n, __func__); \
    }

REFUSE(Float32)
REFUSE(Int8)
REFUSE(UInt8)
REFUSE(Int16)
REFUSE(UInt16)
REFUSE(UInt32)
REFUSE(UInt64)

#define TYPED(Type, as) \
    fmi3Status fmi3Get##Type(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3##Type v[], size_t m) { \
        CHECK(c, ANY); \
        CHECK_ARRAYS(r, n, v, m); \
        if (check_has_value(instance, r, n)) return fmi3Error; \
        return done(instance, core_get_as(&instance->core, as, r, n, v, __func__)); \
    } \
    fmi3Status fmi3Set##Type(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3##Type v[], size_t m) { \
        CHECK(c, INSTANTIATED | INITIALIZATION | RUNNING); \
        CHECK_ARRAYS(r, n, v, m); \
        return done(instance, core_set_as(&instance->core, as, r, n, v, __func__)); \
    }

TYPED(Int32, AS_INT32)
TYPED(Int64, AS_INT64_ITEM) /* FMI 3.0 has enumerations as Int64 */
TYPED(Boolean, AS_BOOL)
TYPED(String, AS_TEXT)

fmi3Status fmi3GetBinary(fmi3Instance c, const fmi3ValueReference r[], size_t n, size_t sizes[], fmi3Binary v[],
                         size_t m) {
    (void)r, (void)sizes, (void)v, (void)m;
    return no_such_type(c, n, __func__);
}

fmi3Status fmi3SetBinary(fmi3Instance c, const fmi3ValueReference r[], size_t n, const size_t sizes[],
                         const fmi3Binary v[], size_t m) {
    (void)r, (void)sizes, (void)v, (void)m;
    return no_such_type(c, n, __func__);
}

fmi3Status fmi3GetClock(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Clock v[]) {
    (void)r, (void)v;
    return no_such_type(c, n, __func__);
}

fmi3Status fmi3SetClock(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Clock v[]) {
    (void)r, (void)v;
    return no_such_type(c, n, __func__);
}

/* What this FMU does not offer, and says so in its model description */

#define NOT_OFFERED(c, what) \
    CHECK(c, ANY); \
    return FAIL("%s: this FMU has no %s", __func__, what)

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance c, fmi3ValueReference r, size_t *n) {
    (void)r, (void)n;
    NOT_OFFERED(c, "dependencies of array elements");
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance c, fmi3ValueReference r, size_t e[], fmi3ValueReference i[],
                                       size_t ei[], fmi3DependencyKind k[], size_t n) {
    (void)r, (void)e, (void)i, (void)ei, (void)k, (void)n;
    NOT_OFFERED(c, "dependencies of array elements");
}

fmi3Status fmi3EnterConfigurationMode(fmi3Instance c) { NOT_OFFERED(c, "structural parameters"); }

fmi3Status fmi3ExitConfigurationMode(fmi3Instance c) { NOT_OFFERED(c, "structural parameters"); }

fmi3Status fmi3GetIntervalDecimal(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Float64 i[],
                                  fmi3IntervalQualifier q[]) {
    (void)r, (void)n, (void)i, (void)q;
    NOT_OFFERED(c, "clocks");
}

fmi3Status fmi3GetIntervalFraction(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3UInt64 i[],
                                   fmi3UInt64 s[], fmi3IntervalQualifier q[]) {
    (void)r, (void)n, (void)i, (void)s, (void)q;
    NOT_OFFERED(c, "clocks");
}

fmi3Status fmi3GetShiftDecimal(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Float64 s[]) {
    (void)r, (void)n, (void)s;
    NOT_OFFERED(c, "clocks");
}

fmi3Status fmi3GetShiftFraction(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3UInt64 s[],
                                fmi3UInt64 q[]) {
    (void)r, (void)n, (void)s, (void)q;
    NOT_OFFERED(c, "clocks");
}

fmi3Status fmi3SetIntervalDecimal(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Float64 i[]) {
    (void)r, (void)n, (void)i;
    NOT_OFFERED(c, "clocks");
}

fmi3Status fmi3SetIntervalFraction(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3UInt64 i[],
                                   const fmi3UInt64 s[]) {
    (void)r, (void)n, (void)i, (void)s;
    NOT_OFFERED(c, "clocks");
}

fmi3Status fmi3SetShiftDecimal(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Float64 s[]) {
    (void)r, (void)n, (void)s;
    NOT_OFFERED(c, "clocks");
}

fmi3Status fmi3SetShiftFraction(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3UInt64 s[],
                                const fmi3UInt64 q[]) {
    (void)r, (void)n, (void)s, (void)q;
    NOT_OFFERED(c, "clocks");
}

fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance c) { NOT_OFFERED(c, "discrete states"); }

fmi3Status fmi3EnterStepMode(fmi3Instance c) { NOT_OFFERED(c, "event mode in co-simulation"); }

fmi3Status fmi3ActivateModelPartition(fmi3Instance c, fmi3ValueReference r, fmi3Float64 t) {
    (void)r, (void)t;
    NOT_OFFERED(c, "scheduled execution");
}

/* FMU states */

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state) {
    CHECK(c, ANY);
    if (!state) return FAIL("%s: there is no place for the FMU state", __func__);
    if (!*state && !(*state = malloc(sizeof(CoreState)))) return FAIL("no memory for an FMU state");
    memcpy(*state, &instance->core.state, sizeof(CoreState));
    return fmi3OK;
}

fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state) {
    CHECK(c, ANY);
    if (!state) return FAIL("there is no FMU state to set");
    memcpy(&instance->core.state, state, sizeof(CoreState));
    return fmi3OK;
}

fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *state) {
    CHECK(c, ANY);
    if (state) {
        free(*state);
        *state = NULL;
    }
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState state, size_t *size) {
    CHECK(c, ANY);
    if (!state || !size) return FAIL("there is no FMU state to serialise");
    *size = core_serialized_size();
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size) {
    CHECK(c, ANY);
    if (!state || !bytes || size < core_serialized_size())
        return FAIL("an FMU state needs %lu bytes", (unsigned long)core_serialized_size());
    core_serialize(state, (char *)bytes);
    return fmi3OK;
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *state) {
    CHECK(c, ANY);
    if (!state || !bytes) return FAIL("there are no bytes to read an FMU state from");
    CoreState read;
    CoreStatus status = core_deserialize(&instance->core, (const char *)bytes, size, &read);
    if (status != CORE_OK) return done(instance, status);
    if (!*state && !(*state = malloc(sizeof read))) return FAIL("no memory for an FMU state");
    memcpy(*state, &read, sizeof read);
    return fmi3OK;
}

/* Directional and adjoint derivatives */

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference unknowns[], size_t n,
                                        const fmi3ValueReference knowns[], size_t m, const fmi3Float64 seed[],
                                        size_t n_seed, fmi3Float64 sensitivity[], size_t n_sensitivity) {
    CHECK(c, INITIALIZATION | RUNNING | OVER);
    CHECK_ARRAYS(unknowns, n, sensitivity, n_sensitivity);
    CHECK_ARRAYS(knowns, m, seed, n_seed);
    double change[N_VALUES + 1] = {0};
    for (size_t i = 0; i < m; i++) {
        if (knowns[i] >= N_VALUES) return FAIL("no variable has the value reference %u", knowns[i]);
        change[knowns[i]] = seed[i];
    }
    if (!ARE_REAL(&instance->core, knowns, m) || !ARE_REAL(&instance->core, unknowns, n))
        return done(instance, CORE_ERROR);
    return done(instance, core_direction(&instance->core, unknowns, n, change, sensitivity, CORE_DISCARD));
}

fmi3Status fmi3GetOutputDerivatives(fmi3Instance c, const fmi3ValueReference references[], size_t n,
                                    const fmi3Int32 orders[], fmi3Float64 values[], size_t n_values) {
    CHECK(c, STEP | OVER);
    if (n && !orders) return MISSING;
    if (core_check_output_orders(&instance->core, orders, n)) return done(instance, CORE_ERROR);
    CHECK_ARRAYS(references, n, values, n_values);
    if (!ARE_REAL(&instance->core, references, n)) return done(instance, CORE_ERROR);
    return done(instance, core_get_output_derivatives(&instance->core, references, n, values));
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance c, const fmi3ValueReference unknowns[], size_t n,
                                    const fmi3ValueReference knowns[], size_t m, const fmi3Float64 seed[],
                                    size_t n_seed, fmi3Float64 sensitivity[], size_t n_sensitivity) {
    CHECK(c, INITIALIZATION | RUNNING | OVER);
    CHECK_ARRAYS(unknowns, n, seed, n_seed);
    CHECK_ARRAYS(knowns, m, sensitivity, n_sensitivity);
    if (!ARE_REAL(&instance->core, knowns, m) || !ARE_REAL(&instance->core, unknowns, n))
        return done(instance, CORE_ERROR);
    return done(instance, core_adjoint(&instance->core, unknowns, n, seed, knowns, m, sensitivity));
}

/* Co-simulation */

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 step, fmi3Boolean no_state_before,
                      fmi3Boolean *event, fmi3Boolean *terminate, fmi3Boolean *early_return, fmi3Float64 *last_time) {
    (void)no_state_before;
    CHECK(c, STEP);
    if (!event || !terminate || !early_return || !last_time) return MISSING;
    *event = *terminate = *early_return = fmi3False;
    CoreStatus status = core_do_step(&instance->core, time, step);
    *last_time = status == CORE_OK ? time + step : instance->core.state.time;
    return done(instance, status);
}

/* Model exchange */

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *terminate,
                                    fmi3Boolean *nominals_changed, fmi3Boolean *values_changed,
                                    fmi3Boolean *next_event_defined, fmi3Float64 *next_event) {
    CHECK(c, EVENT);
    if (!again || !terminate || !nominals_changed || !values_changed || !next_event_defined || !next_event)
        return MISSING;
    *again = *terminate = *nominals_changed = *values_changed = *next_event_defined = fmi3False;
    *next_event = 0.0;
#if HYBRID
    int states_changed;
    CoreStatus status = core_change(&instance->core, &states_changed);
    if (status != CORE_OK) return done(instance, CORE_ERROR); /* there is no shorter step that could help */
    *values_changed = states_changed != 0;
    *next_event_defined = N_SAMPLED > 0;
    *next_event = core_next_instant(&instance->core);
#endif
    return fmi3OK;
}

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c) {
    CHECK(c, EVENT);
    instance->core.state.phase = CONTINUOUS;
    return fmi3OK;
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean no_state_before, fmi3Boolean *enter_event_mode,
                                       fmi3Boolean *terminate) {
    (void)no_state_before;
    CHECK(c, CONTINUOUS);
    if (!enter_event_mode || !terminate) return MISSING;
    *enter_event_mode = *terminate = fmi3False;
#if HYBRID
    *enter_event_mode = core_arrive(&instance->core) != 0;
#endif
    return fmi3OK;
}

fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 time) {
    CHECK(c, EVENT | CONTINUOUS);
    return done(instance, core_set_time(&instance->core, time));
}

static fmi3Status check_states(Instance *instance, const double x[], size_t n, const char *function) {
    if (n == N_X && n && !x) return FAIL("%s: the array is missing", function);
    return n == N_X ? fmi3OK : FAIL("%s: this FMU has %d continuous states, not %lu", function, N_X, (unsigned long)n);
}

fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n) {
    CHECK(c, CONTINUOUS);
    if (check_states(instance, x, n, __func__)) return fmi3Error;
    return done(instance, core_set_states(&instance->core, x));
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 derivatives[], size_t n) {
    CHECK(c, INITIALIZATION | EVENT | CONTINUOUS | OVER);
    if (check_states(instance, derivatives, n, __func__)) return fmi3Error;
    return done(instance, core_get_derivatives(&instance->core, derivatives));
}

fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 indicators[], size_t n) {
    CHECK(c, INITIALIZATION | EVENT | CONTINUOUS | OVER);
    if (n != N_EVENTS)
        return FAIL("%s: this FMU has %d event indicators, not %lu", __func__, N_EVENTS, (unsigned long)n);
    if (n && !indicators) return MISSING;
#if HYBRID
    return done(instance, core_get_indicators(&instance->core, indicators));
#else
    return fmi3OK;
#endif
}

fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) {
    CHECK(c, INITIALIZATION | EVENT | CONTINUOUS | OVER);
    if (check_states(instance, x, n, __func__)) return fmi3Error;
    return done(instance, core_get_states(&instance->core, x));
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 nominals[], size_t n) {
    CHECK(c, INITIALIZATION | EVENT | CONTINUOUS | OVER);
    if (check_states(instance, nominals, n, __func__)) return fmi3Error;
    for (size_t i = 0; i < n; i++) nominals[i] = model_nominals[i];
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n) {
    CHECK(c, ANY);
    if (!n) return MISSING;
    *n = N_EVENTS;
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n) {
    CHECK(c, ANY);
    if (!n) return MISSING;
    *n = N_X;
    return fmi3OK;
}
