/* FMI 2.0 co-simulation FMU for tests: passes values of every type through, fails on demand, and keeps a journal.

From the time `fail_at` on the function that `where` names returns `status`. Each step appends its start time to the
file `journal`. */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2FunctionTypes.h"

enum { U, Y, N, N_OUT, E, E_OUT, B, B_OUT, FAIL_AT, STATUS, WHERE, JOURNAL };
enum { DO_STEP, SET_REAL, GET_REAL };

typedef struct {
    double time, u, fail_at;
    int n, e, b, status, where, stepping;
    char journal[4096];
} Model;

static void start(Model *m) {
    memset(m, 0, sizeof *m);
    m->e = 1;
    m->fail_at = 1e9;
}

static fmi2Status outcome(const Model *m, int where, double time) {
    return m->stepping && m->where == where && time >= m->fail_at ? (fmi2Status)m->status : fmi2OK;
}

static int *whole(Model *m, fmi2ValueReference reference) {
    switch (reference) {
        case N:
        case N_OUT:
            return &m->n;
        case E:
        case E_OUT:
            return &m->e;
        case B:
        case B_OUT:
            return &m->b;
        case STATUS:
            return &m->status;
        case WHERE:
            return &m->where;
        default:
            return NULL;
    }
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real v[]) {
    Model *m = c;
    for (size_t i = 0; i < n; i++) v[i] = r[i] == FAIL_AT ? m->fail_at : m->u;
    return n && r[0] == Y ? outcome(m, GET_REAL, m->time) : fmi2OK; /* parameters can always be read */
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real v[]) {
    Model *m = c;
    for (size_t i = 0; i < n; i++) *(r[i] == FAIL_AT ? &m->fail_at : &m->u) = v[i];
    return outcome(m, SET_REAL, m->time);
}

#define WHOLE(Type, boolean) \
    fmi2Status fmi2Get##Type(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2##Type v[]) { \
        for (size_t i = 0; i < n; i++) { \
            const int *value = whole(c, r[i]); \
            if (value == NULL || (r[i] == B || r[i] == B_OUT) != boolean) return fmi2Error; \
            v[i] = *value; \
        } \
        return fmi2OK; \
    } \
    fmi2Status fmi2Set##Type(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2##Type v[]) { \
        for (size_t i = 0; i < n; i++) { \
            int *value = whole(c, r[i]); \
            if (value == NULL || (r[i] == B || r[i] == B_OUT) != boolean) return fmi2Error; \
            *value = v[i]; \
        } \
        return fmi2OK; \
    }
WHOLE(Integer, 0)
WHOLE(Boolean, 1)

    fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2String v[]) {
    Model *m = c;
    if (n != 1 || r[0] != JOURNAL || strlen(v[0]) >= sizeof m->journal) return fmi2Error;
    strcpy(m->journal, v[0]);
    return fmi2OK;
}

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    (void)name, (void)type, (void)guid, (void)resources, (void)functions, (void)visible, (void)logging;
    Model *m = malloc(sizeof *m);
    if (m != NULL) start(m);
    return m;
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2Reset(fmi2Component c) {
    start(c);
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real time,
                               fmi2Boolean stop_defined, fmi2Real stop) {
    (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop;
    ((Model *)c)->time = time;
    ((Model *)c)->fail_at = 1e9; /* as some FMUs do, it forgets start values that were set before */
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    (void)c;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    ((Model *)c)->stepping = 1;
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean no_set_state) {
    (void)no_set_state;
    Model *m = c;
    FILE *file = m->journal[0] ? fopen(m->journal, "a") : NULL;
    if (file != NULL) {
        fprintf(file, "%.17g\n", time);
        fclose(file);
    }
    m->time = time + step;
    return outcome(m, DO_STEP, time);
}

fmi2Status fmi2Terminate(fmi2Component c) {
    (void)c;
    return fmi2OK;
}

/* What no test needs: importers look for these names, but nobody calls them. */
#define UNUSED(name) \
    int fmi2##name(void) { return fmi2Error; }
UNUSED(CancelStep)
UNUSED(DeSerializeFMUstate) UNUSED(FreeFMUstate) UNUSED(GetBooleanStatus) UNUSED(GetDirectionalDerivative)
    UNUSED(GetFMUstate) UNUSED(GetIntegerStatus) UNUSED(GetRealOutputDerivatives) UNUSED(GetRealStatus)
        UNUSED(GetStatus) UNUSED(GetString) UNUSED(GetStringStatus) UNUSED(SerializeFMUstate)
            UNUSED(SerializedFMUstateSize) UNUSED(SetDebugLogging) UNUSED(SetFMUstate) UNUSED(SetRealInputDerivatives)
