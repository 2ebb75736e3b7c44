/* The face of FMI 2.0 of a packed system. */
#include <stdlib.h>

#include "fmi.h"
#include "packed.h"
#include "uri.h"

typedef struct {
    Packed *packed;
    fmi2Logger *logger;
    fmi2ComponentEnvironment environment;
} Instance;

/* Return fmi2Error unless the instance is there and the call is allowed now. */
#define CHECK(c, phases) \
    Packed *packed = c ? ((Instance *)c)->packed : NULL; \
    if (!packed || !packed_allowed(packed, phases, __func__)) return fmi2Error

/* Call with this instance as the one that messages of components belong to. */
#define WITHIN(call) \
    Packed *outer = entered(packed); \
    fmi2Status status = (fmi2Status)(call); \
    entered(outer); \
    return status

#define FAIL(...) ((fmi2Status)packed_fail(packed, FAILURE, __VA_ARGS__))

#define MISSING FAIL("%s: an argument is missing", __func__)

static void forward(void *environment, const char *name, Status status, const char *category, const char *text) {
    Instance *instance = environment;
    if (instance->logger)
        instance->logger(instance->environment, name, (fmi2Status)status, category ? category : "logAll", "%s", text);
}

EXPORTED const char *fmi2GetTypesPlatform(void) { return "default"; }

EXPORTED const char *fmi2GetVersion(void) { return "2.0"; }

EXPORTED fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    (void)n, (void)categories; /* errors and warnings are told always */
    CHECK(c, ANY);
    packed->logging = on;
    return fmi2OK;
}

EXPORTED fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                                       const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                                       fmi2Boolean logging) {
    (void)visible;
    if (!functions || !functions->logger) return NULL;
    const char *problem = !name || !*name            ? "the instance has no name"
                          : type != fmi2CoSimulation ? "this FMU is for co-simulation only"
                          : !guid                    ? "the GUID is missing"
                          : !resources               ? "the resource location is missing"
                                                     : NULL;
    if (problem) {
        functions->logger(functions->environment, name ? name : "?", fmi2Error, "logStatusError", "%s", problem);
        return NULL;
    }
    Instance *instance = calloc(1, sizeof *instance);
    char *folder = path_of_uri(resources);
    if (instance && folder) {
        instance->logger = functions->logger;
        instance->environment = functions->environment;
        instance->packed = packed_new(name, guid, folder, forward, instance, logging);
    }
    free(folder);
    if (instance && instance->packed) return instance;
    free(instance);
    return NULL;
}

EXPORTED void fmi2FreeInstance(fmi2Component c) {
    Instance *instance = c;
    if (!instance) return;
    packed_free(instance->packed);
    free(instance);
}

EXPORTED fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance,
                                        fmi2Real start, fmi2Boolean stop_defined, fmi2Real stop) {
    CHECK(c, INSTANTIATED);
    packed->now.has_tolerance = tolerance_defined;
    packed->now.tolerance = tolerance;
    packed->now.time = start;
    packed->now.has_stop = stop_defined;
    packed->now.stop = stop;
    packed->now.set_up = true;
    return fmi2OK;
}

EXPORTED fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    CHECK(c, INSTANTIATED);
    const Progress now = packed->now;
    if (!now.set_up) return FAIL("%s: fmi2SetupExperiment must be called before", __func__);
    WITHIN(packed_enter_initialization(packed, now.has_tolerance, now.tolerance, now.time, now.has_stop, now.stop));
}

EXPORTED fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    CHECK(c, INITIALIZATION);
    WITHIN(packed_exit_initialization(packed));
}

EXPORTED fmi2Status fmi2Terminate(fmi2Component c) {
    CHECK(c, STEPPING | FAILED);
    WITHIN(packed_terminate(packed));
}

EXPORTED fmi2Status fmi2Reset(fmi2Component c) {
    CHECK(c, ANY);
    WITHIN(packed_reset(packed));
}

/* Values */

static Status get(Packed *packed, const fmi2ValueReference vr[], size_t n, VariableType type, void *values) {
    Status status = n ? packed_prepare_get(packed) : OK;
    for (size_t i = 0; status == OK && i < n; i++) {
        double slot = 0.0;
        const char *text = NULL;
        status = packed_get(packed, vr[i], type, &slot, &text);
        if (status != OK) break;
        if (type == TYPE_FLOAT64) ((fmi2Real *)values)[i] = slot;
        else if (type == TYPE_STRING) ((fmi2String *)values)[i] = text;
        else ((fmi2Integer *)values)[i] = (fmi2Integer)integer_of(slot);
    }
    return status;
}

static Status set(Packed *packed, const fmi2ValueReference vr[], size_t n, VariableType type, const void *values) {
    Status status = OK;
    for (size_t i = 0; status == OK && i < n; i++) {
        double slot = 0.0;
        const char *text = NULL;
        if (type == TYPE_FLOAT64) slot = ((const fmi2Real *)values)[i];
        else if (type == TYPE_STRING) text = ((const fmi2String *)values)[i];
        else if (type == TYPE_BOOLEAN) slot = slot_of(((const fmi2Boolean *)values)[i] != fmi2False);
        else slot = slot_of(((const fmi2Integer *)values)[i]);
        status = packed_set(packed, vr[i], type, slot, text);
    }
    return status;
}

#define VALUES(Type, type) \
    EXPORTED fmi2Status fmi2Get##Type(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2##Type value[]) { \
        CHECK(c, ANY); \
        if (n && (!vr || !value)) return MISSING; \
        WITHIN(get(packed, vr, n, type, value)); \
    } \
    EXPORTED fmi2Status fmi2Set##Type(fmi2Component c, const fmi2ValueReference vr[], size_t n, \
                                      const fmi2##Type value[]) { \
        CHECK(c, INSTANTIATED | INITIALIZATION | STEPPING); \
        if (n && (!vr || !value)) return MISSING; \
        WITHIN(set(packed, vr, n, type, value)); \
    }

VALUES(Real, TYPE_FLOAT64)
VALUES(Integer, TYPE_INT32)
VALUES(Boolean, TYPE_BOOLEAN)
VALUES(String, TYPE_STRING)

EXPORTED fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                                const fmi2Integer order[], const fmi2Real value[]) {
    CHECK(c, INITIALIZATION | STEPPING);
    if (n && (!vr || !order || !value)) return MISSING;
    for (size_t i = 0; i < n; i++) {
        if (order[i] != 1) return FAIL("input derivatives of order %d are not used, only of order 1", (int)order[i]);
        if (packed_set_rate(packed, vr[i], value[i]) != OK) return fmi2Error;
    }
    return fmi2OK;
}

EXPORTED fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                                 const fmi2Integer order[], fmi2Real value[]) {
    (void)vr, (void)n, (void)order, (void)value;
    CHECK(c, ANY);
    return FAIL("output derivatives are not provided (maxOutputDerivativeOrder is 0)");
}

EXPORTED fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t n,
                                                 const fmi2ValueReference known[], size_t m,
                                                 const fmi2Real known_change[], fmi2Real unknown_change[]) {
    (void)unknown, (void)n, (void)known, (void)m, (void)known_change, (void)unknown_change;
    CHECK(c, ANY);
    return FAIL("directional derivatives are not provided");
}

/* FMU states */

EXPORTED fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
    CHECK(c, ANY);
    if (!state) return MISSING;
    WITHIN(state_get(packed, (State **)state));
}

EXPORTED fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
    CHECK(c, ANY);
    if (!state) return FAIL("there is no FMU state to set");
    WITHIN(state_set(packed, state));
}

EXPORTED fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
    CHECK(c, ANY);
    if (!state || !*state) return fmi2OK;
    Packed *outer = entered(packed);
    state_free(packed, *state);
    entered(outer);
    *state = NULL;
    return fmi2OK;
}

EXPORTED fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) {
    CHECK(c, ANY);
    if (!state || !size) return FAIL("there is no FMU state to serialise");
    WITHIN(state_size(packed, state, size));
}

EXPORTED fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
    CHECK(c, ANY);
    if (!state || !bytes) return FAIL("there is no FMU state to serialise");
    WITHIN(state_serialize(packed, state, bytes, size));
}

EXPORTED fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
    CHECK(c, ANY);
    if (!state || !bytes) return FAIL("there are no bytes to read an FMU state from");
    WITHIN(state_deserialize(packed, bytes, size, (State **)state));
}

/* Co-simulation */

EXPORTED fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean no_state_before) {
    (void)no_state_before;
    CHECK(c, STEPPING);
    WITHIN(packed_do_step(packed, time, step));
}

EXPORTED fmi2Status fmi2CancelStep(fmi2Component c) {
    CHECK(c, ANY);
    return FAIL("steps are synchronous; there is none to cancel");
}

static fmi2Status no_status(fmi2Component c) {
    CHECK(c, ANY);
    return fmi2Discard;
}

EXPORTED fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) {
    (void)kind, (void)value;
    return no_status(c);
}

EXPORTED fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    if (kind != fmi2LastSuccessfulTime) return no_status(c);
    CHECK(c, ANY);
    if (!value) return MISSING;
    *value = packed->now.reached;
    return fmi2OK;
}

EXPORTED fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value) {
    (void)kind, (void)value;
    return no_status(c);
}

EXPORTED fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    if (kind != fmi2Terminated) return no_status(c);
    CHECK(c, ANY);
    if (!value) return MISSING;
    /* after a discarded step the components stand at different times: only a reset or a restored state helps */
    *value = packed->now.wants_to_end || packed->now.discarded;
    return fmi2OK;
}

EXPORTED fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) {
    (void)kind, (void)value;
    return no_status(c);
}
