/* FMI 3.0 co-simulation FMU for tests: an array gain, an integrator, and values of other types passed through.

It is strict where the standard is: no value is read before the initialisation mode, and sizes must match. */

#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3FunctionTypes.h"

#ifndef LENGTH
#define LENGTH 3 /* of the arrays */
#endif

enum { TIME, U, Y, K, V, X, N, N_OUT, B, B_OUT, F, F_OUT, FAIL_AT, FAILURE, JOURNAL };
enum { FAILS = 0, ENDS = 1, RETURNS_EARLY = 2, FAILS_AT_START = 3 };

typedef struct {
    double time, u[LENGTH], y[LENGTH], k, v, x, fail_at;
    int32_t n, failure;
    float f;
    bool b, initializing, stepping, asking;
    char journal[4096];
    fmi3LogMessageCallback log;
    fmi3InstanceEnvironment environment;
    fmi3IntermediateUpdateCallback update;
} Model;

static fmi3Status fail(Model *m, const char *message) {
    m->log(m->environment, fmi3Error, "logStatusError", message);
    return fmi3Error;
}

/* Append the name of a call to the file that the parameter `journal` names, for tests of the life cycle. */
static void record(const Model *m, const char *call) {
    FILE *file = m->journal[0] ? fopen(m->journal, "a") : NULL;
    if (file != NULL) {
        fprintf(file, "%s\n", call);
        fclose(file);
    }
}

static void *address(Model *m, fmi3ValueReference reference, size_t *count) {
    *count = 1;
    switch (reference) {
        case TIME:
            return &m->time;
        case U:
            *count = LENGTH;
            return m->u;
        case Y:
            *count = LENGTH;
            for (int i = 0; i < LENGTH; i++) m->y[i] = m->k * m->u[i];
            return m->y;
        case K:
            return &m->k;
        case V:
            return &m->v;
        case X:
            return &m->x;
        case N:
        case N_OUT:
            return &m->n;
        case B:
        case B_OUT:
            return &m->b;
        case F:
        case F_OUT:
            return &m->f;
        case FAIL_AT:
            return &m->fail_at;
        case FAILURE:
            return &m->failure;
        default:
            *count = 0;
            return NULL;
    }
}

static fmi3Status transfer(Model *m, const fmi3ValueReference r[], size_t n, char *values, size_t count, size_t size,
                           bool get) {
    if (get && !m->initializing && !m->stepping) return fail(m, "no value may be read before the initialisation mode");
#ifdef REFUSES_DURING_STEP
    if (!get && m->asking) return fmi3Error;
#endif
    size_t done = 0;
    for (size_t i = 0; i < n; i++) {
        size_t length;
        void *variable = address(m, r[i], &length);
        if (variable == NULL || done + length > count) return fail(m, "wrong value reference or number of values");
        if (get) memcpy(values + done * size, variable, length * size);
        else memcpy(variable, values + done * size, length * size);
        done += length;
    }
    return done == count ? fmi3OK : fail(m, "too many values");
}

#define VALUES(Type) \
    fmi3Status fmi3Get##Type(fmi3Instance m, const fmi3ValueReference r[], size_t n, fmi3##Type v[], size_t count) { \
        return transfer(m, r, n, (char *)v, count, sizeof(fmi3##Type), true); \
    } \
    fmi3Status fmi3Set##Type(fmi3Instance m, const fmi3ValueReference r[], size_t n, const fmi3##Type v[], \
                             size_t count) { \
        return transfer(m, r, n, (char *)(uintptr_t)v, count, sizeof(fmi3##Type), false); \
    }
VALUES(Float32)
VALUES(Float64) VALUES(Int8) VALUES(UInt8) VALUES(Int16) VALUES(UInt16) VALUES(Int32) VALUES(UInt32) VALUES(Int64)
    VALUES(UInt64) VALUES(Boolean)

        fmi3Status
    fmi3SetString(fmi3Instance instance, const fmi3ValueReference r[], size_t n, const fmi3String v[], size_t count) {
    Model *m = instance;
    if (n != 1 || count != 1 || r[0] != JOURNAL || strlen(v[0]) >= sizeof m->journal) return fail(m, "wrong text");
    strcpy(m->journal, v[0]);
    return fmi3OK;
}

const char *fmi3GetVersion(void) { return "3.0"; }

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
                                         const fmi3ValueReference required[], size_t n,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update) {
    (void)name, (void)resources, (void)visible, (void)logging, (void)events, (void)early;
    (void)required, (void)n;
    Model *m = calloc(1, sizeof *m);
    if (m == NULL) return NULL;
    m->log = log;
    m->environment = environment;
    m->update = update;
    if (strcmp(token, "{fmi3-gain}") != 0) {
        fail(m, "the instantiation token is wrong");
        free(m);
        return NULL;
    }
    m->u[0] = 1.0, m->u[1] = 10.0, m->u[2] = 100.0;
    m->k = 2.0;
    m->fail_at = 1e9;
    return m;
}

void fmi3FreeInstance(fmi3Instance instance) {
    record(instance, "free");
    free(instance);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean tolerance_defined, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean stop_defined, fmi3Float64 stop) {
    (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop;
    Model *m = instance;
    m->time = start;
    m->initializing = true;
    record(m, "initialize");
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance) {
    Model *m = instance;
    if (m->failure == FAILS_AT_START) return fail(m, "the start is 100% wrong");
    m->initializing = false;
    m->stepping = true;
    return fmi3OK;
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 t, fmi3Float64 h, fmi3Boolean no_set_state, fmi3Boolean *event,
                      fmi3Boolean *end, fmi3Boolean *early, fmi3Float64 *last) {
    (void)no_set_state;
    Model *m = instance;
    *event = *end = *early = false;
    *last = t + h;
    if (!m->stepping) return fail(m, "not in step mode");
    if (t >= m->fail_at) {
        if (m->failure == FAILS) return fail(m, "the gain is 100% worn out");
        *end = m->failure == ENDS;
        *early = m->failure == RETURNS_EARLY;
        *last = t + h / 2;
        return fmi3OK;
    }
    if (m->update) { /* the mean of a linear input is that of the middle */
        bool want_early;
        double early_time;
        m->asking = true;
        m->update(m->environment, t + h / 2, true, false, false, false, &want_early, &early_time);
        m->asking = false;
    }
    m->x += h * m->v;
    m->time = t + h;
    return fmi3OK;
}

fmi3Status fmi3Terminate(fmi3Instance instance) {
    record(instance, "terminate");
    return fmi3OK;
}

/* What no test needs: importers look for these names, but nobody calls them. */
#define UNUSED(name) \
    int fmi3##name(void) { return fmi3Error; }
UNUSED(ActivateModelPartition)
UNUSED(CompletedIntegratorStep) UNUSED(DeserializeFMUState) UNUSED(EnterConfigurationMode)
    UNUSED(EnterContinuousTimeMode) UNUSED(EnterEventMode) UNUSED(EnterStepMode) UNUSED(EvaluateDiscreteStates)
        UNUSED(ExitConfigurationMode) UNUSED(FreeFMUState) UNUSED(GetAdjointDerivative) UNUSED(GetBinary)
            UNUSED(GetClock) UNUSED(GetContinuousStateDerivatives) UNUSED(GetContinuousStates)
                UNUSED(GetDirectionalDerivative) UNUSED(GetEventIndicators) UNUSED(GetFMUState)
                    UNUSED(GetIntervalDecimal) UNUSED(GetIntervalFraction) UNUSED(GetNominalsOfContinuousStates)
                        UNUSED(GetNumberOfContinuousStates) UNUSED(GetNumberOfEventIndicators)
                            UNUSED(GetNumberOfVariableDependencies) UNUSED(GetOutputDerivatives) UNUSED(GetShiftDecimal)
                                UNUSED(GetShiftFraction) UNUSED(GetString) UNUSED(GetVariableDependencies) UNUSED(Reset)
                                    UNUSED(SerializeFMUState) UNUSED(SerializedFMUStateSize) UNUSED(SetBinary)
                                        UNUSED(SetClock) UNUSED(SetContinuousStates) UNUSED(SetDebugLogging)
                                            UNUSED(SetFMUState) UNUSED(SetIntervalDecimal) UNUSED(SetIntervalFraction)
                                                UNUSED(SetShiftDecimal) UNUSED(SetShiftFraction) UNUSED(SetTime)
                                                    UNUSED(UpdateDiscreteStates) UNUSED(InstantiateModelExchange)
                                                        UNUSED(InstantiateScheduledExecution)
