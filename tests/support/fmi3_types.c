/* FMI 3.0 co-simulation FMU for tests: for each type an input array of 2 values and an output array that is equal to it.

The input of the type with number k has the value reference 2 k + 1, the output 2 k + 2. Two outputs more are the largest
integers of 64 bits. A function for a type refuses variables of another one. A text, a vector of two texts and a binary
value have outputs that are equal to them, too. */

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3FunctionTypes.h"

enum { Float32, Float64, Int8, UInt8, Int16, UInt16, Int32, UInt32, Int64, UInt64, Boolean, N_TYPES };
enum { LENGTH = 2, BYTES = 8, LARGEST_INT64 = 2 * N_TYPES + 1, LARGEST_UINT64 };
enum { TEXT = 101, TEXT_OUT, WORDS, WORDS_OUT, BINARY, BINARY_OUT, LONGEST = 1 << 17 };

typedef struct {
    char values[N_TYPES + 2][LENGTH * BYTES];
    char texts[3][LONGEST]; /* the text and the two words */
    uint8_t binary[LONGEST];
    size_t size;
} Model;

static char *part(Model *m, fmi3ValueReference reference, int type) {
    if (reference == LARGEST_INT64) return type == Int64 ? m->values[N_TYPES] : NULL;
    if (reference == LARGEST_UINT64) return type == UInt64 ? m->values[N_TYPES + 1] : NULL;
    return reference > 0 && (reference - 1) / 2 == (fmi3ValueReference)type ? m->values[type] : NULL;
}

#define VALUES(Type) \
    fmi3Status fmi3Get##Type(fmi3Instance m, const fmi3ValueReference r[], size_t n, fmi3##Type v[], size_t count) { \
        if (count != n * LENGTH) return fmi3Error; \
        for (size_t i = 0; i < n; i++) { \
            char *values = part(m, r[i], Type); \
            if (values == NULL) return fmi3Error; \
            memcpy(v + i * LENGTH, values, LENGTH * sizeof *v); \
        } \
        return fmi3OK; \
    } \
    fmi3Status fmi3Set##Type(fmi3Instance m, const fmi3ValueReference r[], size_t n, const fmi3##Type v[], \
                             size_t count) { \
        if (count != n * LENGTH) return fmi3Error; \
        for (size_t i = 0; i < n; i++) { \
            char *values = part(m, r[i], Type); \
            if (values == NULL || r[i] % 2 == 0 || r[i] >= LARGEST_INT64) return fmi3Error; \
            memcpy(values, v + i * LENGTH, LENGTH * sizeof *v); \
        } \
        return fmi3OK; \
    }
VALUES(Float32)
VALUES(Float64)
VALUES(Int8)
VALUES(UInt8)
VALUES(Int16) VALUES(UInt16) VALUES(Int32) VALUES(UInt32) VALUES(Int64) VALUES(UInt64) VALUES(Boolean)

    /* The first text of a variable, and how many it has. */
    static char (*texts(Model *m, fmi3ValueReference r, size_t *n)) [LONGEST] {
        *n = r == TEXT || r == TEXT_OUT ? 1 : r == WORDS || r == WORDS_OUT ? 2 : 0;
        return m->texts + (*n == 2);
    }

fmi3Status fmi3GetString(fmi3Instance m, const fmi3ValueReference r[], size_t n, fmi3String v[], size_t count) {
    for (size_t i = 0, of_one; i < n; i++) {
        char (*found)[LONGEST] = texts(m, r[i], &of_one);
        if (of_one == 0 || of_one > count) return fmi3Error;
        count -= of_one;
        for (size_t k = 0; k < of_one; k++) *v++ = found[k];
    }
    return count == 0 ? fmi3OK : fmi3Error;
}

fmi3Status fmi3SetString(fmi3Instance m, const fmi3ValueReference r[], size_t n, const fmi3String v[], size_t count) {
    for (size_t i = 0, of_one; i < n; i++) {
        char (*found)[LONGEST] = texts(m, r[i], &of_one);
        if (of_one == 0 || of_one > count || r[i] % 2 == 0) return fmi3Error;
        count -= of_one;
        for (size_t k = 0; k < of_one; k++) strncpy(found[k], *v++, LONGEST - 1);
    }
    return count == 0 ? fmi3OK : fmi3Error;
}

fmi3Status fmi3GetBinary(fmi3Instance instance, const fmi3ValueReference r[], size_t n, size_t sizes[], fmi3Binary v[],
                         size_t count) {
    Model *m = instance;
    if (n != 1 || count != 1 || (*r != BINARY && *r != BINARY_OUT)) return fmi3Error;
    *sizes = m->size;
    *v = m->binary;
    return fmi3OK;
}

fmi3Status fmi3SetBinary(fmi3Instance instance, const fmi3ValueReference r[], size_t n, const size_t sizes[],
                         const fmi3Binary v[], size_t count) {
    Model *m = instance;
    if (n != 1 || count != 1 || *r != BINARY || *sizes > LONGEST) return fmi3Error;
    m->size = *sizes;
    memcpy(m->binary, *v, m->size);
    return fmi3OK;
}

const char *fmi3GetVersion(void) { return "3.0"; }

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
                                         const fmi3ValueReference required[], size_t n,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)events, (void)early;
    (void)required, (void)n, (void)environment, (void)log, (void)update;
    Model *m = calloc(1, sizeof *m);
    if (m == NULL) return NULL;
    strcpy(m->texts[0], "first");
    strcpy(m->texts[1], "a");
    strcpy(m->texts[2], "b");
    m->binary[1] = 0xff;
    m->size = 2;
    const int64_t largest = INT64_MAX;
    const uint64_t largest_unsigned = UINT64_MAX;
    for (int i = 0; i < LENGTH; i++) {
        memcpy(m->values[N_TYPES] + i * BYTES, &largest, BYTES);
        memcpy(m->values[N_TYPES + 1] + i * BYTES, &largest_unsigned, BYTES);
    }
    return m;
}

void fmi3FreeInstance(fmi3Instance instance) { free(instance); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean tolerance_defined, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean stop_defined, fmi3Float64 stop) {
    (void)instance, (void)tolerance_defined, (void)tolerance, (void)start, (void)stop_defined, (void)stop;
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance) {
    (void)instance;
    return fmi3OK;
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 t, fmi3Float64 h, fmi3Boolean no_set_state, fmi3Boolean *event,
                      fmi3Boolean *end, fmi3Boolean *early, fmi3Float64 *last) {
    (void)instance, (void)no_set_state;
    *event = *end = *early = false;
    *last = t + h;
    return fmi3OK;
}

fmi3Status fmi3Terminate(fmi3Instance instance) {
    (void)instance;
    return fmi3OK;
}

#include "fmi3_copied_state.h"

/* What no test needs: importers look for these names, but nobody calls them. */
#define UNUSED(name) \
    int fmi3##name(void) { return fmi3Error; }
UNUSED(ActivateModelPartition)
UNUSED(CompletedIntegratorStep)
UNUSED(EnterConfigurationMode)
UNUSED(EnterContinuousTimeMode)
UNUSED(EnterEventMode) UNUSED(EnterStepMode) UNUSED(EvaluateDiscreteStates) UNUSED(ExitConfigurationMode)
    UNUSED(GetAdjointDerivative) UNUSED(GetClock) UNUSED(GetContinuousStateDerivatives) UNUSED(GetContinuousStates)
        UNUSED(GetDirectionalDerivative) UNUSED(GetEventIndicators) UNUSED(GetIntervalDecimal)
            UNUSED(GetIntervalFraction) UNUSED(GetNominalsOfContinuousStates) UNUSED(GetNumberOfContinuousStates)
                UNUSED(GetNumberOfEventIndicators) UNUSED(GetNumberOfVariableDependencies) UNUSED(GetOutputDerivatives)
                    UNUSED(GetShiftDecimal) UNUSED(GetShiftFraction) UNUSED(GetVariableDependencies) UNUSED(Reset)
                        UNUSED(SetClock) UNUSED(SetContinuousStates) UNUSED(SetDebugLogging) UNUSED(SetIntervalDecimal)
                            UNUSED(SetIntervalFraction) UNUSED(SetShiftDecimal) UNUSED(SetShiftFraction) UNUSED(SetTime)
                                UNUSED(UpdateDiscreteStates) UNUSED(InstantiateModelExchange)
                                    UNUSED(InstantiateScheduledExecution)
