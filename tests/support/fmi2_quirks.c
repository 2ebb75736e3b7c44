/* FMI 2.0 co-simulation FMU for tests: integrates its input, x' = u, y = x, and has the quirks that its parameters name.

QUIRKS is a sum of the flags below; it is a macro where it must act before parameters can be set. */

#include <math.h>
#include <stdlib.h>

#include "fmi2FunctionTypes.h"

#ifndef QUIRKS
#define QUIRKS 0
#endif

enum {
    NEEDS_STOP_TIME = 1,
    NEEDS_TOLERANCE = 2,
    KEEPS_STATE = 4, /* a reset leaves the state as it is */
    KEEPS_GLOBALS = 8, /* a new instance goes on from a global variable */
    REFUSES_RESET = 16,
    FAILS_TO_TERMINATE = 32,
    IS_ASYNCHRONOUS = 64, /* a step is pending until it was asked for three times */
    COMPUTES_IN_PART = 128, /* a longer step than `longest` ends at it */
    REFUSES_TO_OVERSHOOT = 256, /* a step that ends after the stop time is an error */
    REFUSES_DERIVATIVES = 512, /* of inputs, which it says that it takes */
    LACKS_DERIVATIVES = 1024, /* the function for them */
    REFUSES_OUTPUT = 2048 /* the output stop_time */
};

enum { U, Y, STOP, TOLERANCE, END, INTERNAL, LONGEST, N_VARIABLES };

typedef struct {
    double time, v[N_VARIABLES], rate, since; /* of the input, and how long it has changed */
    int stop_defined, tolerance_defined, left, ended;
    double pending_step;
} Model;

static double kept;

static void start(Model *m) {
    double y = (QUIRKS & KEEPS_STATE) ? m->v[Y] : (QUIRKS & KEEPS_GLOBALS) ? kept : 0.0;
    *m = (Model){.v = {[Y] = y, [END] = 1e9, [LONGEST] = 1e9}};
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
    (void)name, (void)type, (void)guid, (void)resources, (void)callbacks, (void)visible, (void)logging;
    Model *m = calloc(1, sizeof *m);
    if (m) start(m);
    return m;
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2Reset(fmi2Component c) {
    start(c);
    return (QUIRKS & REFUSES_RESET) ? fmi2Error : fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start_time,
                               fmi2Boolean stop_defined, fmi2Real stop_time) {
    Model *m = c;
    m->time = start_time;
    m->stop_defined = stop_defined;
    m->tolerance_defined = tolerance_defined;
    m->v[STOP] = stop_defined ? stop_time : -1.0;
    m->v[TOLERANCE] = tolerance_defined ? tolerance : -1.0;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    const Model *m = c;
    int lacks =
        ((QUIRKS & NEEDS_STOP_TIME) && !m->stop_defined) || ((QUIRKS & NEEDS_TOLERANCE) && !m->tolerance_defined);
    return lacks ? fmi2Error : fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    (void)c;
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c) {
    (void)c;
    return (QUIRKS & FAILS_TO_TERMINATE) ? fmi2Error : fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real v[]) {
    const Model *m = c;
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= N_VARIABLES || (r[i] == STOP && (QUIRKS & REFUSES_OUTPUT))) return fmi2Error;
        v[i] = m->v[r[i]];
    }
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real v[]) {
    Model *m = c;
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= N_VARIABLES) return fmi2Error;
        m->v[r[i]] = v[i];
        if (r[i] == U) m->rate = 0.0;
    }
    return fmi2OK;
}

#if !(QUIRKS & 1024) /* LACKS_DERIVATIVES */
fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference r[], size_t n,
                                       const fmi2Integer orders[], const fmi2Real v[]) {
    if (n != 1 || r[0] != U || orders[0] != 1 || (QUIRKS & REFUSES_DERIVATIVES)) return fmi2Error;
    ((Model *)c)->rate = v[0];
    return fmi2OK;
}
#endif

/* The input is linear over a step. */
static void integrate(Model *m, double step) {
    m->v[Y] += step * (m->v[U] + 0.5 * step * m->rate);
    m->time += step;
    kept = m->v[Y];
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean no_set_state) {
    Model *m = c;
    (void)no_set_state;
    m->time = time;
    if ((QUIRKS & REFUSES_TO_OVERSHOOT) && m->stop_defined && time + step > m->v[STOP]) return fmi2Error;
    m->ended = time + step > m->v[END] * (1.0 + 1e-12);
    if (m->ended) return fmi2Discard;
    double internal = m->v[INTERNAL];
    if (internal > 0.0 && fabs(step / internal - round(step / internal)) > 1e-9) return fmi2Discard;
    if (step > m->v[LONGEST] * (1.0 + 1e-12)) {
        if (QUIRKS & COMPUTES_IN_PART) integrate(m, m->v[LONGEST]);
        return fmi2Discard;
    }
    if (QUIRKS & IS_ASYNCHRONOUS) {
        m->left = 3;
        m->pending_step = step;
        return fmi2Pending;
    }
    integrate(m, step);
    return fmi2OK;
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *status) {
    Model *m = c;
    if (kind != fmi2DoStepStatus) return fmi2Discard;
    *status = m->left > 0 && --m->left > 0 ? fmi2Pending : fmi2OK;
    if (*status == fmi2OK) integrate(m, m->pending_step);
    return fmi2OK;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
    *value = ((Model *)c)->time;
    return fmi2OK;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    if (kind != fmi2Terminated) return fmi2Discard;
    *value = ((Model *)c)->ended;
    return fmi2OK;
}
