/* FMI 3.0 co-simulation FMU with arrays of any size: `n` (1) is a structural parameter, `a` (2) an input of n real numbers
 * and `b` (3) an output of n, twice those of `a`; `m` (4) is the matrix of n times n elements. */

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3FunctionTypes.h"

enum { N = 1, A, B };

typedef struct {
    uint64_t n;
    double *a;
} Model;

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
                                         const fmi3ValueReference required[], size_t n,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update) {
    (void)name, (void)resources, (void)visible, (void)logging, (void)events, (void)early, (void)required, (void)n;
    (void)environment, (void)log, (void)update;
    Model *m = calloc(1, sizeof *m);
    m->n = strtoull(token, NULL, 10);
    m->a = calloc(m->n + 1, sizeof *m->a);
    return m;
}

void fmi3FreeInstance(fmi3Instance instance) {
    Model *m = instance;
    if (m != NULL) free(m->a);
    free(m);
}

#define CALL(NAME) \
    fmi3Status NAME(fmi3Instance instance) { \
        (void)instance; \
        return fmi3OK; \
    }
CALL(fmi3ExitInitializationMode)
CALL(fmi3Terminate)
CALL(fmi3Reset)
CALL(fmi3EnterConfigurationMode)
CALL(fmi3ExitConfigurationMode)

const char *fmi3GetVersion(void) { return "3.0"; }

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean a, fmi3Float64 b, fmi3Float64 c,
                                       fmi3Boolean d, fmi3Float64 e) {
    (void)instance, (void)a, (void)b, (void)c, (void)d, (void)e;
    return fmi3OK;
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 time, fmi3Float64 step, fmi3Boolean last, fmi3Boolean *event,
                      fmi3Boolean *end, fmi3Boolean *early, fmi3Float64 *reached) {
    (void)instance, (void)last;
    *event = *end = *early = false;
    *reached = time + step;
    return fmi3OK;
}

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference r[], size_t n, fmi3Float64 v[],
                          size_t total) {
    Model *m = instance;
    for (size_t i = 0, place = 0; i < n; i++)
        for (uint64_t k = 0; k < m->n; k++, place++) {
            if (place >= total) return fmi3Error;
            v[place] = r[i] == B ? 2.0 * m->a[k] : m->a[k];
        }
    return fmi3OK;
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference r[], size_t n, const fmi3Float64 v[],
                          size_t total) {
    Model *m = instance;
    if (n != 1 || r[0] != A || total != m->n) return fmi3Error;
    memcpy(m->a, v, total * sizeof *v);
    return fmi3OK;
}

fmi3Status fmi3SetUInt64(fmi3Instance instance, const fmi3ValueReference r[], size_t n, const fmi3UInt64 v[],
                         size_t total) {
    Model *m = instance;
    if (n != 1 || total != 1 || r[0] != N) return fmi3Error;
    m->n = v[0];
    free(m->a);
    m->a = calloc(m->n + 1, sizeof *m->a);
    return fmi3OK;
}

fmi3Status fmi3GetUInt64(fmi3Instance instance, const fmi3ValueReference r[], size_t n, fmi3UInt64 v[], size_t total) {
    Model *m = instance;
    if (n != 1 || total != 1 || r[0] != N) return fmi3Error;
    v[0] = m->n;
    return fmi3OK;
}

/* What no run of these tests needs: importers look for these names, but nobody calls them. */
#define UNUSED(name) \
    int fmi3##name(void) { return fmi3Error; }
UNUSED(ActivateModelPartition)
UNUSED(CompletedIntegratorStep)
UNUSED(DeserializeFMUState)
UNUSED(EnterContinuousTimeMode) UNUSED(EnterEventMode) UNUSED(EnterStepMode) UNUSED(EvaluateDiscreteStates)
    UNUSED(FreeFMUState) UNUSED(GetAdjointDerivative) UNUSED(GetBinary) UNUSED(GetBoolean) UNUSED(GetClock)
        UNUSED(GetContinuousStateDerivatives) UNUSED(GetContinuousStates) UNUSED(GetDirectionalDerivative)
            UNUSED(GetEventIndicators) UNUSED(GetFMUState) UNUSED(GetFloat32) UNUSED(GetInt16) UNUSED(GetInt32)
                UNUSED(GetInt64) UNUSED(GetInt8) UNUSED(GetIntervalDecimal) UNUSED(GetIntervalFraction)
                    UNUSED(GetNominalsOfContinuousStates) UNUSED(GetNumberOfContinuousStates)
                        UNUSED(GetNumberOfEventIndicators) UNUSED(GetNumberOfVariableDependencies)
                            UNUSED(GetOutputDerivatives) UNUSED(GetShiftDecimal) UNUSED(GetShiftFraction)
                                UNUSED(GetString) UNUSED(GetUInt16) UNUSED(GetUInt32) UNUSED(GetUInt8)
                                    UNUSED(GetVariableDependencies) UNUSED(InstantiateModelExchange)
                                        UNUSED(InstantiateScheduledExecution) UNUSED(SerializeFMUState)
                                            UNUSED(SerializedFMUStateSize) UNUSED(SetBinary) UNUSED(SetBoolean)
                                                UNUSED(SetClock) UNUSED(SetContinuousStates) UNUSED(SetFMUState)
                                                    UNUSED(SetFloat32) UNUSED(SetInt16) UNUSED(SetInt32)
                                                        UNUSED(SetInt64) UNUSED(SetInt8) UNUSED(SetIntervalDecimal)
                                                            UNUSED(SetIntervalFraction) UNUSED(SetShiftDecimal)
                                                                UNUSED(SetShiftFraction) UNUSED(SetString)
                                                                    UNUSED(SetTime) UNUSED(SetUInt16) UNUSED(SetUInt32)
                                                                        UNUSED(SetUInt8) UNUSED(UpdateDiscreteStates)

                                                                            fmi3Status
    fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean on, size_t n, const fmi3String categories[]) {
    (void)instance, (void)on, (void)n, (void)categories;
    return fmi3OK;
}
