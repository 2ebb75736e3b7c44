/* The face of FMI 3.0 of a packed system; all variables are scalars. */
#include <stdlib.h>

#include "fmi.h"
#include "packed.h"

typedef struct {
    Packed *packed;
    fmi3Logger *logger;
    fmi3IntermediateUpdate *intermediate_update;
    fmi3InstanceEnvironment environment;
} Instance;

/* Return fmi3Error unless the instance is there and the call is allowed now. */
#define CHECK(c, phases) \
    Packed *packed = c ? ((Instance *)c)->packed : NULL; \
    if (!packed || !packed_allowed(packed, phases, __func__)) return fmi3Error

/* Call with this instance as the one that messages of components belong to. */
#define WITHIN(call) \
    Packed *outer = entered(packed); \
    fmi3Status status = (fmi3Status)(call); \
    entered(outer); \
    return status

#define FAIL(...) ((fmi3Status)packed_fail(packed, FAILURE, __VA_ARGS__))

#define MISSING FAIL("%s: an argument is missing", __func__)

static void forward(void *environment, const char *name, Status status, const char *category, const char *text) {
    Instance *instance = environment;
    (void)name;
    if (instance->logger)
        instance->logger(instance->environment, (fmi3Status)status, category ? category : "logAll", text);
}

static void ask_for_inputs(void *environment, double time) {
    Instance *instance = environment;
    fmi3Boolean early_return = fmi3False;
    fmi3Float64 early_return_time = time;
    instance->intermediate_update(instance->environment, time, fmi3True, fmi3False, fmi3False, fmi3False, &early_return,
                                  &early_return_time);
}

EXPORTED const char *fmi3GetVersion(void) { return "3.0"; }

EXPORTED fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[]) {
    (void)n, (void)categories; /* errors and warnings are told always */
    CHECK(c, ANY);
    packed->logging = on;
    return fmi3OK;
}

EXPORTED fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                                   fmi3Boolean visible, fmi3Boolean logging,
                                                   fmi3InstanceEnvironment environment, fmi3Logger *logger) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging;
    if (logger) logger(environment, fmi3Error, "logStatusError", "this FMU is for co-simulation only");
    return NULL;
}

EXPORTED fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
                                                  fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean event_mode,
                                                  fmi3Boolean early_return, const fmi3ValueReference required[],
                                                  size_t n_required, fmi3InstanceEnvironment environment,
                                                  fmi3Logger *logger, fmi3IntermediateUpdate *intermediate_update) {
    (void)visible, (void)early_return, (void)required;
    const char *problem = !name || !*name ? "the instance has no name"
                          : !token        ? "the instantiation token is missing"
                          : !resources    ? "the resource path is missing"
                          : event_mode    ? "this FMU has no event mode; instantiate it with eventModeUsed = false"
                                          : NULL;
    Instance *instance = problem ? NULL : calloc(1, sizeof *instance);
    if (!instance) {
        if (logger) logger(environment, fmi3Error, "logStatusError", problem ? problem : "no memory for an instance");
        return NULL;
    }
    instance->logger = logger;
    instance->environment = environment;
    instance->packed = packed_new(name, token, resources, forward, instance, logging);
    if (!instance->packed) {
        free(instance);
        return NULL;
    }
    if (intermediate_update && n_required) {
        instance->intermediate_update = intermediate_update;
        instance->packed->ask_for_inputs = ask_for_inputs;
    }
    return instance;
}

EXPORTED fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                                        fmi3Boolean visible, fmi3Boolean logging,
                                                        fmi3InstanceEnvironment environment, fmi3Logger *logger,
                                                        void *clock_update, void *lock, void *unlock) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)clock_update, (void)lock,
        (void)unlock;
    if (logger) logger(environment, fmi3Error, "logStatusError", "this FMU is for co-simulation only");
    return NULL;
}

EXPORTED void fmi3FreeInstance(fmi3Instance c) {
    Instance *instance = c;
    if (!instance) return;
    packed_free(instance->packed);
    free(instance);
}

EXPORTED fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean tolerance_defined, fmi3Float64 tolerance,
                                                fmi3Float64 start, fmi3Boolean stop_defined, fmi3Float64 stop) {
    CHECK(c, INSTANTIATED);
    WITHIN(packed_enter_initialization(packed, tolerance_defined, tolerance, start, stop_defined, stop));
}

EXPORTED fmi3Status fmi3ExitInitializationMode(fmi3Instance c) {
    CHECK(c, INITIALIZATION);
    WITHIN(packed_exit_initialization(packed));
}

EXPORTED fmi3Status fmi3Terminate(fmi3Instance c) {
    CHECK(c, STEPPING | FAILED);
    WITHIN(packed_terminate(packed));
}

EXPORTED fmi3Status fmi3Reset(fmi3Instance c) {
    CHECK(c, ANY);
    WITHIN(packed_reset(packed));
}

/* Values */

#define VALUES(Type, type, TO_SLOT, FROM_SLOT) \
    EXPORTED fmi3Status fmi3Get##Type(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3##Type values[], \
                                      size_t n_values) { \
        CHECK(c, ANY); \
        if (n != n_values) return FAIL("%s: all variables are scalars; give one value for each", __func__); \
        if (n && (!vr || !values)) return MISSING; \
        Packed *outer = entered(packed); \
        Status status = n ? packed_prepare_get(packed) : OK; \
        for (size_t i = 0; status == OK && i < n; i++) { \
            double slot = 0.0; \
            const char *text = NULL; \
            status = packed_get(packed, vr[i], type, &slot, &text); \
            if (status == OK) values[i] = FROM_SLOT; \
        } \
        entered(outer); \
        return (fmi3Status)status; \
    } \
    EXPORTED fmi3Status fmi3Set##Type(fmi3Instance c, const fmi3ValueReference vr[], size_t n, \
                                      const fmi3##Type values[], size_t n_values) { \
        CHECK(c, INSTANTIATED | INITIALIZATION | STEPPING); \
        if (n != n_values) return FAIL("%s: all variables are scalars; give one value for each", __func__); \
        if (n && (!vr || !values)) return MISSING; \
        Packed *outer = entered(packed); \
        Status status = OK; \
        for (size_t i = 0; status == OK && i < n; i++) status = packed_set(packed, vr[i], type, TO_SLOT); \
        entered(outer); \
        return (fmi3Status)status; \
    }

#define REALS(Type, type) VALUES(Type, type, (double)values[i] COMMA NULL, ((void)text, (fmi3##Type)slot))
#define INTEGERS(Type, type) \
    VALUES(Type, type, slot_of((int64_t)values[i]) COMMA NULL, ((void)text, (fmi3##Type)integer_of(slot)))
#define COMMA ,

REALS(Float64, TYPE_FLOAT64)
REALS(Float32, TYPE_FLOAT32)
INTEGERS(Int8, TYPE_INT8)
INTEGERS(UInt8, TYPE_UINT8)
INTEGERS(Int16, TYPE_INT16)
INTEGERS(UInt16, TYPE_UINT16)
INTEGERS(Int32, TYPE_INT32)
INTEGERS(UInt32, TYPE_UINT32)
INTEGERS(Int64, TYPE_INT64)
INTEGERS(UInt64, TYPE_UINT64)
VALUES(Boolean, TYPE_BOOLEAN, slot_of(values[i] ? 1 : 0) COMMA NULL, ((void)text, integer_of(slot) != 0))
VALUES(String, TYPE_STRING, 0.0 COMMA values[i], text)

EXPORTED fmi3Status fmi3GetBinary(fmi3Instance c, const fmi3ValueReference r[], size_t n, size_t sizes[],
                                  fmi3Binary v[], size_t m) {
    (void)r, (void)sizes, (void)v, (void)m;
    CHECK(c, ANY);
    return n ? FAIL("this FMU has no binary variables") : fmi3OK;
}

EXPORTED fmi3Status fmi3SetBinary(fmi3Instance c, const fmi3ValueReference r[], size_t n, const size_t sizes[],
                                  const fmi3Binary v[], size_t m) {
    (void)r, (void)sizes, (void)v, (void)m;
    CHECK(c, ANY);
    return n ? FAIL("this FMU has no binary variables") : fmi3OK;
}

EXPORTED fmi3Status fmi3GetClock(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Clock v[]) {
    (void)r, (void)v;
    CHECK(c, ANY);
    return n ? FAIL("this FMU has no clocks") : fmi3OK;
}

EXPORTED fmi3Status fmi3SetClock(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Clock v[]) {
    (void)r, (void)v;
    CHECK(c, ANY);
    return n ? FAIL("this FMU has no clocks") : fmi3OK;
}

/* What this FMU does not offer, and says so in its model description */

#define NOT_OFFERED(c, what) \
    CHECK(c, ANY); \
    return FAIL("%s: this FMU has no %s", __func__, what)

EXPORTED fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance c, fmi3ValueReference r, size_t *n) {
    (void)r, (void)n;
    NOT_OFFERED(c, "dependencies of array elements");
}

EXPORTED fmi3Status fmi3GetVariableDependencies(fmi3Instance c, fmi3ValueReference r, size_t e[],
                                                fmi3ValueReference i[], size_t ei[], int k[], size_t n) {
    (void)r, (void)e, (void)i, (void)ei, (void)k, (void)n;
    NOT_OFFERED(c, "dependencies of array elements");
}

EXPORTED fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference u[], size_t nu,
                                                 const fmi3ValueReference k[], size_t nk, const fmi3Float64 s[],
                                                 size_t ns, fmi3Float64 r[], size_t nr) {
    (void)u, (void)nu, (void)k, (void)nk, (void)s, (void)ns, (void)r, (void)nr;
    NOT_OFFERED(c, "directional derivatives");
}

EXPORTED fmi3Status fmi3GetAdjointDerivative(fmi3Instance c, const fmi3ValueReference u[], size_t nu,
                                             const fmi3ValueReference k[], size_t nk, const fmi3Float64 s[], size_t ns,
                                             fmi3Float64 r[], size_t nr) {
    (void)u, (void)nu, (void)k, (void)nk, (void)s, (void)ns, (void)r, (void)nr;
    NOT_OFFERED(c, "adjoint derivatives");
}

EXPORTED fmi3Status fmi3EnterConfigurationMode(fmi3Instance c) { NOT_OFFERED(c, "structural parameters"); }

EXPORTED fmi3Status fmi3ExitConfigurationMode(fmi3Instance c) { NOT_OFFERED(c, "structural parameters"); }

EXPORTED fmi3Status fmi3GetIntervalDecimal(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Float64 i[],
                                           int q[]) {
    (void)r, (void)n, (void)i, (void)q;
    NOT_OFFERED(c, "clocks");
}

EXPORTED fmi3Status fmi3GetIntervalFraction(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3UInt64 i[],
                                            fmi3UInt64 s[], int q[]) {
    (void)r, (void)n, (void)i, (void)s, (void)q;
    NOT_OFFERED(c, "clocks");
}

EXPORTED fmi3Status fmi3GetShiftDecimal(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Float64 s[]) {
    (void)r, (void)n, (void)s;
    NOT_OFFERED(c, "clocks");
}

EXPORTED fmi3Status fmi3GetShiftFraction(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3UInt64 s[],
                                         fmi3UInt64 q[]) {
    (void)r, (void)n, (void)s, (void)q;
    NOT_OFFERED(c, "clocks");
}

EXPORTED fmi3Status fmi3SetIntervalDecimal(fmi3Instance c, const fmi3ValueReference r[], size_t n,
                                           const fmi3Float64 i[]) {
    (void)r, (void)n, (void)i;
    NOT_OFFERED(c, "clocks");
}

EXPORTED fmi3Status fmi3SetIntervalFraction(fmi3Instance c, const fmi3ValueReference r[], size_t n,
                                            const fmi3UInt64 i[], const fmi3UInt64 s[]) {
    (void)r, (void)n, (void)i, (void)s;
    NOT_OFFERED(c, "clocks");
}

EXPORTED fmi3Status fmi3SetShiftDecimal(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Float64 s[]) {
    (void)r, (void)n, (void)s;
    NOT_OFFERED(c, "clocks");
}

EXPORTED fmi3Status fmi3SetShiftFraction(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3UInt64 s[],
                                         const fmi3UInt64 q[]) {
    (void)r, (void)n, (void)s, (void)q;
    NOT_OFFERED(c, "clocks");
}

EXPORTED fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance c) { NOT_OFFERED(c, "event mode"); }

EXPORTED fmi3Status fmi3EnterEventMode(fmi3Instance c) { NOT_OFFERED(c, "event mode"); }

EXPORTED fmi3Status fmi3EnterStepMode(fmi3Instance c) { NOT_OFFERED(c, "event mode"); }

EXPORTED fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *a, fmi3Boolean *t, fmi3Boolean *n,
                                             fmi3Boolean *v, fmi3Boolean *d, fmi3Float64 *e) {
    (void)a, (void)t, (void)n, (void)v, (void)d, (void)e;
    NOT_OFFERED(c, "event mode");
}

EXPORTED fmi3Status fmi3GetOutputDerivatives(fmi3Instance c, const fmi3ValueReference r[], size_t n,
                                             const fmi3Int32 o[], fmi3Float64 v[], size_t m) {
    (void)r, (void)n, (void)o, (void)v, (void)m;
    NOT_OFFERED(c, "output derivatives");
}

EXPORTED fmi3Status fmi3ActivateModelPartition(fmi3Instance c, fmi3ValueReference r, fmi3Float64 t) {
    (void)r, (void)t;
    NOT_OFFERED(c, "scheduled execution");
}

EXPORTED fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c) { NOT_OFFERED(c, "model exchange"); }

EXPORTED fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean n, fmi3Boolean *e, fmi3Boolean *t) {
    (void)n, (void)e, (void)t;
    NOT_OFFERED(c, "model exchange");
}

EXPORTED fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 t) {
    (void)t;
    NOT_OFFERED(c, "model exchange");
}

EXPORTED fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n) {
    (void)x, (void)n;
    NOT_OFFERED(c, "model exchange");
}

EXPORTED fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 x[], size_t n) {
    (void)x, (void)n;
    NOT_OFFERED(c, "model exchange");
}

EXPORTED fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 x[], size_t n) {
    (void)x, (void)n;
    NOT_OFFERED(c, "model exchange");
}

EXPORTED fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) {
    (void)x, (void)n;
    NOT_OFFERED(c, "model exchange");
}

EXPORTED fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) {
    (void)x, (void)n;
    NOT_OFFERED(c, "model exchange");
}

EXPORTED fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n) {
    (void)n;
    NOT_OFFERED(c, "model exchange");
}

EXPORTED fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n) {
    (void)n;
    NOT_OFFERED(c, "model exchange");
}

/* FMU states */

EXPORTED fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state) {
    CHECK(c, ANY);
    if (!state) return MISSING;
    WITHIN(state_get(packed, (State **)state));
}

EXPORTED fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state) {
    CHECK(c, ANY);
    if (!state) return FAIL("there is no FMU state to set");
    WITHIN(state_set(packed, state));
}

EXPORTED fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *state) {
    CHECK(c, ANY);
    if (!state || !*state) return fmi3OK;
    Packed *outer = entered(packed);
    state_free(packed, *state);
    entered(outer);
    *state = NULL;
    return fmi3OK;
}

EXPORTED fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState state, size_t *size) {
    CHECK(c, ANY);
    if (!state || !size) return FAIL("there is no FMU state to serialise");
    WITHIN(state_size(packed, state, size));
}

EXPORTED fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size) {
    CHECK(c, ANY);
    if (!state || !bytes) return FAIL("there is no FMU state to serialise");
    WITHIN(state_serialize(packed, state, (char *)bytes, size));
}

EXPORTED fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *state) {
    CHECK(c, ANY);
    if (!state || !bytes) return FAIL("there are no bytes to read an FMU state from");
    WITHIN(state_deserialize(packed, (const char *)bytes, size, (State **)state));
}

/* Co-simulation */

EXPORTED fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 step, fmi3Boolean no_state_before,
                               fmi3Boolean *event, fmi3Boolean *terminate, fmi3Boolean *early_return,
                               fmi3Float64 *last_time) {
    (void)no_state_before;
    CHECK(c, STEPPING);
    if (!event || !terminate || !early_return || !last_time) return MISSING;
    *event = *terminate = *early_return = fmi3False;
    Packed *outer = entered(packed);
    Status status = packed_do_step(packed, time, step);
    entered(outer);
    *last_time = packed->now.reached;
    if (!packed->now.wants_to_end) return (fmi3Status)status;
    *terminate = fmi3True; /* the components stand at different times */
    return fmi3OK;
}
