/* The face of FMI 2.0: checks the calls, translates them to the core. */
#include "fmi2Functions.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core.h"
#include "uri.h"

typedef struct {
    Core core;
    char *name;
    fmi2CallbackLogger logger;
    fmi2ComponentEnvironment environment;
} Instance;

enum { RUNNING = STEP | EVENT | CONTINUOUS, ANY = INSTANTIATED | INITIALIZATION | RUNNING | OVER };

/* The status of a call. After an error the standard allows to look at values, to restore a saved state, and to reset. */
static fmi2Status done(Instance *instance, CoreStatus status) {
    if (status == CORE_ERROR) instance->core.state.phase = FAILED;
    return (fmi2Status)status;
}

/* Return fmi2Error unless the instance is there and the call is allowed now. */
#define CHECK(c, phases) \
    Instance *instance = c; \
    if (!instance) return fmi2Error; \
    if (!core_allowed(&instance->core, phases, __func__)) return done(instance, CORE_ERROR)

#define FAIL(...) done(instance, core_fail(&instance->core, CORE_ERROR, __VA_ARGS__))

#define MISSING FAIL("%s: an argument is missing", __func__)

static void forward_log(void *environment, CoreStatus status, const char *message) {
    static const char *const categories[] = {"logAll", "logStatusWarning", "logStatusDiscard", "logStatusError"};
    Instance *instance = environment;
    if (instance->logger) /* errors are logged always: who switched logging off still wants to know why a run ended */
        instance->logger(instance->environment, instance->name, (fmi2Status)status, categories[status], "%s", message);
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    (void)on, (void)n, (void)categories; /* there are error messages only, and these are logged always */
    CHECK(c, ANY);
    return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    (void)visible, (void)logging;
    if (!functions || !functions->logger) return NULL;
    const char *problem = !name || !*name ? "the instance has no name"
                          : !guid || strcmp(guid, MODEL_GUID)
                              ? "the GUID is not that of this FMU; don't mix files of different builds"
                          : !resources ? "the resource location is missing"
                                       : NULL;
    if (problem) {
        functions->logger(functions->componentEnvironment, name ? name : "?", fmi2Error, "logStatusError", "%s",
                          problem);
        return NULL;
    }
    Instance *instance = calloc(1, sizeof *instance);
    char *folder = path_of_uri(resources);
    CoreStatus status = CORE_ERROR;
    if (instance && folder && (instance->name = malloc(strlen(name) + 1))) {
        strcpy(instance->name, name);
        instance->logger = functions->logger;
        instance->environment = functions->componentEnvironment;
        status = core_init(&instance->core, folder, type == fmi2ModelExchange, forward_log, instance);
    }
    free(folder);
    if (instance && status != CORE_OK) {
        free(instance->name);
        free(instance);
        return NULL;
    }
    return instance;
}

void fmi2FreeInstance(fmi2Component c) {
    Instance *instance = c;
    if (!instance) return;
    core_close(&instance->core);
    free(instance->name);
    free(instance);
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stop_defined, fmi2Real stop) {
    CHECK(c, INSTANTIATED);
    CoreStatus status = core_start_at(&instance->core, start, stop_defined, stop);
    if (status == CORE_OK && tolerance_defined) status = core_set_tolerance(&instance->core, tolerance);
    return done(instance, status);
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    CHECK(c, INSTANTIATED);
    if (!instance->core.state.set_up) return FAIL("%s: fmi2SetupExperiment must be called before", __func__);
    instance->core.state.phase = INITIALIZATION;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    CHECK(c, INITIALIZATION);
    return done(instance, core_exit_initialization(&instance->core));
}

fmi2Status fmi2Terminate(fmi2Component c) {
    CHECK(c, RUNNING | DISCARDED);
    instance->core.state.phase = TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c) {
    CHECK(c, ANY);
    return done(instance, core_reset(&instance->core));
}

/* Values, which are there from the initialisation mode on */

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    CHECK(c, INITIALIZATION | RUNNING | OVER);
    if (n && (!vr || !value)) return MISSING;
    if (!ARE_REAL(&instance->core, vr, n)) return done(instance, CORE_ERROR);
    return done(instance, core_get(&instance->core, vr, n, value));
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    CHECK(c, INSTANTIATED | INITIALIZATION | RUNNING);
    if (n && (!vr || !value)) return MISSING;
    if (!ARE_REAL(&instance->core, vr, n)) return done(instance, CORE_ERROR);
    return done(instance, core_set(&instance->core, vr, n, value));
}

#define TYPED(Type, as) \
    fmi2Status fmi2Get##Type(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2##Type value[]) { \
        CHECK(c, INITIALIZATION | RUNNING | OVER); \
        if (n && (!vr || !value)) return MISSING; \
        return done(instance, core_get_as(&instance->core, as, vr, n, value, __func__)); \
    } \
    fmi2Status fmi2Set##Type(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2##Type value[]) { \
        CHECK(c, INSTANTIATED | INITIALIZATION | RUNNING); \
        if (n && (!vr || !value)) return MISSING; \
        return done(instance, core_set_as(&instance->core, as, vr, n, value, __func__)); \
    }

TYPED(Integer, AS_INT32_OR_ITEM)
TYPED(Boolean, AS_INT32_BOOLEAN)
TYPED(String, AS_TEXT)

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[]) {
    CHECK(c, INITIALIZATION | STEP);
    if (n && (!vr || !order || !value)) return MISSING;
    return done(instance, core_set_input_derivatives(&instance->core, vr, n, order, value));
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[]) {
    CHECK(c, STEP | OVER);
    if (n && (!vr || !order || !value)) return MISSING;
    if (!ARE_REAL(&instance->core, vr, n) || core_check_output_orders(&instance->core, order, n))
        return done(instance, CORE_ERROR);
    return done(instance, core_get_output_derivatives(&instance->core, vr, n, value));
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t n,
                                        const fmi2ValueReference known[], size_t m, const fmi2Real known_change[],
                                        fmi2Real unknown_change[]) {
    CHECK(c, INITIALIZATION | RUNNING | OVER);
    if ((n && (!unknown || !unknown_change)) || (m && (!known || !known_change))) return MISSING;
    double change[N_VALUES + 1] = {0};
    for (size_t i = 0; i < m; i++) {
        if (known[i] >= N_VALUES) return FAIL("no variable has the value reference %u", known[i]);
        change[known[i]] = known_change[i];
    }
    if (!ARE_REAL(&instance->core, known, m) || !ARE_REAL(&instance->core, unknown, n))
        return done(instance, CORE_ERROR);
    return done(instance, core_direction(&instance->core, unknown, n, change, unknown_change, CORE_ERROR));
}

/* FMU states */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
    CHECK(c, ANY);
    if (!state) return MISSING;
    if (!*state && !(*state = malloc(sizeof(CoreState)))) return FAIL("no memory for an FMU state");
    memcpy(*state, &instance->core.state, sizeof(CoreState));
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
    CHECK(c, ANY);
    if (!state) return FAIL("there is no FMU state to set");
    memcpy(&instance->core.state, state, sizeof(CoreState));
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
    CHECK(c, ANY);
    if (state) {
        free(*state);
        *state = NULL;
    }
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) {
    CHECK(c, ANY);
    if (!state || !size) return FAIL("there is no FMU state to serialise");
    *size = core_serialized_size();
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
    CHECK(c, ANY);
    if (!state || !bytes || size < core_serialized_size())
        return FAIL("an FMU state needs %lu bytes", (unsigned long)core_serialized_size());
    core_serialize(state, bytes);
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
    CHECK(c, ANY);
    if (!state || !bytes) return FAIL("there are no bytes to read an FMU state from");
    CoreState read;
    CoreStatus status = core_deserialize(&instance->core, bytes, size, &read);
    if (status != CORE_OK) return done(instance, status);
    if (!*state && !(*state = malloc(sizeof read))) return FAIL("no memory for an FMU state");
    memcpy(*state, &read, sizeof read);
    return fmi2OK;
}

/* Co-simulation */

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean no_state_before) {
    (void)no_state_before;
    CHECK(c, STEP);
    CoreStatus status = core_do_step(&instance->core, time, step);
    if (status == CORE_DISCARD) instance->core.state.phase = DISCARDED;
    return done(instance, status);
}

fmi2Status fmi2CancelStep(fmi2Component c) {
    CHECK(c, ANY);
    return FAIL("steps are synchronous; there is none to cancel");
}

static fmi2Status no_status(fmi2Component c) {
    CHECK(c, ANY);
    return fmi2Discard;
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) {
    (void)kind, (void)value;
    return no_status(c);
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    if (kind != fmi2LastSuccessfulTime) return no_status(c);
    CHECK(c, ANY);
    if (!value) return MISSING;
    *value = instance->core.state.time;
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value) {
    (void)kind, (void)value;
    return no_status(c);
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    if (kind != fmi2Terminated) return no_status(c);
    CHECK(c, ANY);
    if (!value) return MISSING;
    *value =
        instance->core.state.phase == DISCARDED; /* a discarded step would fail again: the inputs must change first */
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) {
    (void)kind, (void)value;
    return no_status(c);
}

/* Model exchange */

fmi2Status fmi2EnterEventMode(fmi2Component c) {
    CHECK(c, CONTINUOUS | EVENT);
    instance->core.state.phase = EVENT;
    return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
    CHECK(c, EVENT);
    if (!info) return MISSING;
    memset(info, 0, sizeof *info);
#if HYBRID
    int states_changed;
    CoreStatus status = core_change(&instance->core, &states_changed);
    if (status != CORE_OK) return done(instance, CORE_ERROR); /* there is no shorter step that could help */
    info->valuesOfContinuousStatesChanged = states_changed;
    info->nextEventTime = core_next_instant(&instance->core);
    info->nextEventTimeDefined = N_SAMPLED > 0;
#endif
    return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) {
    CHECK(c, EVENT);
    instance->core.state.phase = CONTINUOUS;
    return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_state_before, fmi2Boolean *enter_event_mode,
                                       fmi2Boolean *terminate) {
    (void)no_state_before;
    CHECK(c, CONTINUOUS);
    if (!enter_event_mode || !terminate) return MISSING;
    *enter_event_mode = *terminate = fmi2False;
#if HYBRID
    *enter_event_mode = core_arrive(&instance->core);
#endif
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
    CHECK(c, EVENT | CONTINUOUS);
    return done(instance, core_set_time(&instance->core, time));
}

static fmi2Status check_states(Instance *instance, const double x[], size_t n, const char *function) {
    if (n == N_X && (x || !n)) return fmi2OK;
    if (n == N_X) return FAIL("%s: the array is missing", function);
    return FAIL("%s: this FMU has %d continuous states, not %lu", function, N_X, (unsigned long)n);
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
    CHECK(c, CONTINUOUS);
    if (check_states(instance, x, n, __func__)) return fmi2Error;
    return done(instance, core_set_states(&instance->core, x));
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t n) {
    CHECK(c, EVENT | CONTINUOUS | OVER);
    if (check_states(instance, derivatives, n, __func__)) return fmi2Error;
    return done(instance, core_get_derivatives(&instance->core, derivatives));
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real indicators[], size_t n) {
    CHECK(c, INITIALIZATION | EVENT | CONTINUOUS | OVER);
    if (n != N_EVENTS)
        return FAIL("%s: this FMU has %d event indicators, not %lu", __func__, N_EVENTS, (unsigned long)n);
    if (n && !indicators) return MISSING;
#if HYBRID
    return done(instance, core_get_indicators(&instance->core, indicators));
#else
    return fmi2OK;
#endif
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    CHECK(c, INITIALIZATION | EVENT | CONTINUOUS | OVER);
    if (check_states(instance, x, n, __func__)) return fmi2Error;
    return done(instance, core_get_states(&instance->core, x));
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real nominals[], size_t n) {
    CHECK(c, EVENT | CONTINUOUS | OVER);
    if (check_states(instance, nominals, n, __func__)) return fmi2Error;
    for (size_t i = 0; i < n; i++) nominals[i] = model_nominals[i];
    return fmi2OK;
}
