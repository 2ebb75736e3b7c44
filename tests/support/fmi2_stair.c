/* FMI 2.0 FMU for tests, model exchange and co-simulation: a counter that goes up by a time event each second, and ends
 * the simulation when it has reached 10. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2FunctionTypes.h"

enum { END = 10 };

typedef struct {
    double time;
    int counter;
} Stair;

static void start(Stair *s) { s->time = 0.0, s->counter = 1; }

/* Count the seconds that have begun. */
static void count(Stair *s) { s->counter = 1 + (int)floor(s->time + 1e-9); }

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Integer v[]) {
    (void)r;
    for (size_t i = 0; i < n; i++) v[i] = ((Stair *)c)->counter;
    return fmi2OK;
}

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    (void)name, (void)type, (void)resources, (void)functions, (void)visible, (void)logging;
    Stair *s = strcmp(guid, "{stair}") ? NULL : malloc(sizeof *s);
    if (s != NULL) start(s);
    return s;
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2Reset(fmi2Component c) {
    start(c);
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real time,
                               fmi2Boolean stop_defined, fmi2Real stop) {
    (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop;
    ((Stair *)c)->time = time;
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean no_set_state) {
    (void)no_set_state;
    Stair *s = c;
    s->time = time + step;
    count(s);
    return s->counter < END ? fmi2OK : fmi2Discard;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    if (kind != fmi2Terminated) return fmi2Discard;
    *value = ((Stair *)c)->counter >= END;
    return fmi2OK;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
    *value = ((Stair *)c)->time;
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
    ((Stair *)c)->time = time;
    return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
    Stair *s = c;
    memset(info, 0, sizeof *info);
    count(s);
    info->terminateSimulation = s->counter >= END;
    info->nextEventTimeDefined = fmi2True;
    info->nextEventTime = s->counter;
    return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_set_state, fmi2Boolean *enter_event_mode,
                                       fmi2Boolean *terminate) {
    (void)c, (void)no_set_state;
    *enter_event_mode = *terminate = fmi2False;
    return fmi2OK;
}

#define NONE(name, type) \
    fmi2Status fmi2##name(fmi2Component c, type v[], size_t n) { \
        (void)c, (void)v, (void)n; \
        return fmi2OK; \
    }
NONE(GetContinuousStates, fmi2Real)
NONE(SetContinuousStates, const fmi2Real) NONE(GetDerivatives, fmi2Real) NONE(GetNominalsOfContinuousStates, fmi2Real)
    NONE(GetEventIndicators, fmi2Real)

#define MODE(name) \
    fmi2Status fmi2##name(fmi2Component c) { \
        (void)c; \
        return fmi2OK; \
    }
        MODE(EnterInitializationMode) MODE(ExitInitializationMode) MODE(EnterEventMode) MODE(EnterContinuousTimeMode)
            MODE(Terminate)

/* What no test needs: importers look for these names, but nobody calls them. */
#define UNUSED(name) \
    int fmi2##name(void) { return fmi2Error; }
                UNUSED(CancelStep) UNUSED(DeSerializeFMUstate) UNUSED(FreeFMUstate) UNUSED(GetReal) UNUSED(SetReal)
                    UNUSED(GetDirectionalDerivative) UNUSED(GetFMUstate) UNUSED(GetIntegerStatus)
                        UNUSED(GetRealOutputDerivatives) UNUSED(GetStatus) UNUSED(GetString) UNUSED(GetStringStatus)
                            UNUSED(SerializeFMUstate) UNUSED(SerializedFMUstateSize) UNUSED(SetDebugLogging)
                                UNUSED(SetFMUstate) UNUSED(SetRealInputDerivatives) UNUSED(SetInteger)
                                    UNUSED(GetBoolean) UNUSED(SetBoolean) UNUSED(SetString)
