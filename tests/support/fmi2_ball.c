/* FMI 2.0 FMU for tests, model exchange and co-simulation: a ball that falls from 1 m and bounces.

Model exchange has the state event at h = 0; co-simulation uses the closed form of the flight, so that each interface is
an oracle of the other. From the time `crash_at` on, a step of co-simulation ends the process; from `nan_at` on, h is not
a number. */

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2FunctionTypes.h"

enum { H, V, DER_H, DER_V, G, E, CRASH_AT, NAN_AT, VARIABLES };

typedef struct {
    double value[VARIABLES];
    double time;
} Ball;

static void derive(Ball *b) {
    b->value[DER_H] = b->value[V];
    b->value[DER_V] = -b->value[G];
}

static void start(Ball *b) {
    memset(b, 0, sizeof *b);
    b->value[H] = 1.0, b->value[G] = 9.81, b->value[E] = 0.7, b->value[CRASH_AT] = b->value[NAN_AT] = 1e9;
}

static void fly(double *h, double *v, double g, double duration) {
    *h += (*v - 0.5 * g * duration) * duration;
    *v -= g * duration;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real v[]) {
    Ball *b = c;
    derive(b);
    for (size_t i = 0; i < n; i++) v[i] = r[i] == H && b->time >= b->value[NAN_AT] ? NAN : b->value[r[i]];
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real v[]) {
    for (size_t i = 0; i < n; i++) ((Ball *)c)->value[r[i]] = v[i];
    return fmi2OK;
}

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    (void)name, (void)type, (void)resources, (void)functions, (void)visible, (void)logging;
    Ball *b = strcmp(guid, "{ball}") ? NULL : malloc(sizeof *b);
    if (b != NULL) start(b);
    return b;
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2Reset(fmi2Component c) {
    start(c);
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real time,
                               fmi2Boolean stop_defined, fmi2Real stop) {
    (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop;
    ((Ball *)c)->time = time;
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean no_set_state) {
    (void)no_set_state;
    Ball *b = c;
    double *h = &b->value[H], *v = &b->value[V], g = b->value[G];
    if (time >= b->value[CRASH_AT]) abort();
    b->time = time + step;
    for (;;) {
        double until = (*v + sqrt(*v * *v + 2.0 * g * *h)) / g; /* the impact */
        if (until > step) break;
        fly(h, v, g, until);
        *h = 0.0, *v *= -b->value[E];
        step -= until;
    }
    fly(h, v, g, step);
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
    ((Ball *)c)->time = time;
    return fmi2OK;
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    memcpy(x, ((Ball *)c)->value, n * sizeof *x);
    return fmi2OK;
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
    memcpy(((Ball *)c)->value, x, n * sizeof *x);
    return fmi2OK;
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real x[], size_t n) {
    derive(c);
    memcpy(x, ((Ball *)c)->value + DER_H, n * sizeof *x);
    return fmi2OK;
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    (void)c;
    for (size_t i = 0; i < n; i++) x[i] = 1.0;
    return fmi2OK;
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n) {
    if (n) z[0] = ((Ball *)c)->value[H];
    return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
    Ball *b = c;
    memset(info, 0, sizeof *info);
    if (b->value[H] <= 0.0 && b->value[V] < 0.0) {
        b->value[H] = DBL_MIN, b->value[V] *= -b->value[E];
        info->valuesOfContinuousStatesChanged = fmi2True;
    }
    return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_set_state, fmi2Boolean *enter_event_mode,
                                       fmi2Boolean *terminate) {
    (void)c, (void)no_set_state;
    *enter_event_mode = *terminate = fmi2False;
    return fmi2OK;
}

#define MODE(name) \
    fmi2Status fmi2##name(fmi2Component c) { \
        (void)c; \
        return fmi2OK; \
    }
MODE(EnterInitializationMode)
MODE(ExitInitializationMode) MODE(EnterEventMode) MODE(EnterContinuousTimeMode) MODE(Terminate)

/* What no test needs: importers look for these names, but nobody calls them. */
#define UNUSED(name) \
    int fmi2##name(void) { return fmi2Error; }
    UNUSED(CancelStep) UNUSED(DeSerializeFMUstate) UNUSED(FreeFMUstate) UNUSED(GetBooleanStatus)
        UNUSED(GetDirectionalDerivative) UNUSED(GetFMUstate) UNUSED(GetIntegerStatus) UNUSED(GetRealOutputDerivatives)
            UNUSED(GetRealStatus) UNUSED(GetStatus) UNUSED(GetString) UNUSED(GetStringStatus) UNUSED(SerializeFMUstate)
                UNUSED(SerializedFMUstateSize) UNUSED(SetDebugLogging) UNUSED(SetFMUstate)
                    UNUSED(SetRealInputDerivatives) UNUSED(GetInteger) UNUSED(SetInteger) UNUSED(GetBoolean)
                        UNUSED(SetBoolean) UNUSED(SetString)
