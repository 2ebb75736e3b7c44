/* FMI 3.0 co-simulation FMU for tests, with a clock of each kind, clocked variables, and an event of its own.
 *
 * It is strict: what the standard forbids in a mode is an error, and so are values of clocked variables while none of their
 * clocks is active. A partition is computed when one of its outputs is read, or at last when the discrete states are
 * updated, and once for a tick. */

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3FunctionTypes.h"

enum { PERIODIC, TRIGGER, COUNTDOWN, CHANGING, FIXED, TUNABLE, OUT, N_CLOCKS, CLOCKS = 1000 };
enum { TICKS = 2000, TOTAL = 2010, CHANGES, ITERATIONS, TOLD };
enum { U = 3000, SUM, SAMPLE, X, GAIN, LEVEL, JUMP_AT, DELAY, PERIOD, END_AT, ENDLESS, ALARM, N_REALS };

typedef enum { INSTANTIATED, INITIALIZATION, EVENT, STEP } Mode;

typedef struct {
    Mode mode;
    bool active[N_CLOCKS], counted[N_CLOCKS], computed, event, counting, told, early_allowed, rung;
    int32_t ticks[N_CLOCKS], total, changes, iterations;
    double time, real[N_REALS - U], asked_gain;
    bool level_changed;
} Model;

static double *real(Model *m, fmi3ValueReference r) { return &m->real[r - U]; }

/* A tick of input clocks: each partition counts; that of the trigger adds u, that of the periodic clock samples x. */
static void compute(Model *m) {
    if (m->computed) return;
    m->computed = true;
    bool any = false, fresh[N_CLOCKS];
    for (int i = PERIODIC; i < OUT; i++) {
        fresh[i] = m->active[i] && !m->counted[i];
        m->counted[i] = m->active[i];
        m->ticks[i] += fresh[i];
        m->total += fresh[i];
        any |= fresh[i];
    }
    if (fresh[TRIGGER]) *real(m, SUM) += *real(m, U);
    if (fresh[PERIODIC]) *real(m, SAMPLE) = *real(m, X);
    if (fresh[PERIODIC] && m->ticks[PERIODIC] == 2) m->counting = true;
    if (any && m->total % 3 == 0 && !m->active[OUT]) {
        m->active[OUT] = true;
        m->ticks[OUT]++;
    }
}

static bool is_open(Model *m, int clock) { return m->mode == INITIALIZATION || (m->mode == EVENT && m->active[clock]); }

fmi3Status fmi3SetClock(fmi3Instance instance, const fmi3ValueReference r[], size_t n, const fmi3Clock v[]) {
    Model *m = instance;
    if (m->mode != EVENT) return fmi3Error;
    for (size_t i = 0; i < n; i++) {
        if (r[i] - CLOCKS >= OUT) return fmi3Error;
        m->active[r[i] - CLOCKS] = v[i];
    }
    m->computed = false;
    return fmi3OK;
}

fmi3Status fmi3GetClock(fmi3Instance instance, const fmi3ValueReference r[], size_t n, fmi3Clock v[]) {
    Model *m = instance;
    if (m->mode != EVENT || n != 1 || *r != CLOCKS + OUT) return fmi3Error;
    compute(m);
    *v = m->active[OUT];
    return fmi3OK;
}

fmi3Status fmi3GetInt32(fmi3Instance instance, const fmi3ValueReference r[], size_t n, fmi3Int32 v[], size_t count) {
    Model *m = instance;
    if (n != count) return fmi3Error;
    for (size_t i = 0; i < n; i++) {
        bool any = false;
        for (int k = PERIODIC; k < OUT; k++) any |= is_open(m, k);
        if (m->mode == EVENT) compute(m);
        if (r[i] == CHANGES) v[i] = m->changes;
        else if (r[i] == ITERATIONS) v[i] = m->iterations;
        else if (r[i] == TOLD) v[i] = m->told;
        else if (r[i] == TOTAL && any) v[i] = m->total;
        else if (r[i] < TICKS + N_CLOCKS && is_open(m, (int)r[i] - TICKS)) v[i] = m->ticks[r[i] - TICKS];
        else return fmi3Error;
    }
    return fmi3OK;
}

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference r[], size_t n, fmi3Float64 v[],
                          size_t count) {
    Model *m = instance;
    if (n != count) return fmi3Error;
    for (size_t i = 0; i < n; i++) {
        if (r[i] <= SUM && !is_open(m, TRIGGER)) return fmi3Error;
        if (r[i] == SAMPLE && !is_open(m, PERIODIC)) return fmi3Error;
        if (m->mode == EVENT) compute(m);
        v[i] = *real(m, r[i]);
    }
    return fmi3OK;
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference r[], size_t n, const fmi3Float64 v[],
                          size_t count) {
    Model *m = instance;
    if (n != count) return fmi3Error;
    for (size_t i = 0; i < n; i++) {
        bool is_parameter = r[i] >= JUMP_AT;
        if (r[i] == U && m->mode != INSTANTIATED && !is_open(m, TRIGGER)) return fmi3Error;
        if ((r[i] == GAIN || r[i] == LEVEL) && m->mode == STEP) return fmi3Error;
        if (is_parameter && m->mode > INITIALIZATION) return fmi3Error;
        if (r[i] == LEVEL && m->mode == EVENT) m->level_changed = true;
        *real(m, r[i]) = v[i];
    }
    return fmi3OK;
}

fmi3Status fmi3GetIntervalDecimal(fmi3Instance instance, const fmi3ValueReference r[], size_t n, fmi3Float64 v[],
                                  fmi3IntervalQualifier q[]) {
    Model *m = instance;
    if (n != 1 || m->mode < INITIALIZATION || m->mode == STEP) return fmi3Error;
    *q = fmi3IntervalUnchanged;
    switch (*r - CLOCKS) {
        case FIXED:
            *v = *real(m, PERIOD);
            return fmi3OK;
        case TUNABLE: /* where its description gives no interval */
            *v = 0.25 * *real(m, GAIN);
            if (*real(m, GAIN) != m->asked_gain) *q = fmi3IntervalChanged;
            m->asked_gain = *real(m, GAIN);
            return fmi3OK;
        case CHANGING: /* 1/4 s, 2/4 s, 3/4 s, ... */
            *v = 0.25 * (m->ticks[CHANGING] + 1);
            *q = fmi3IntervalChanged;
            return fmi3OK;
        case COUNTDOWN:
            *q = m->counting ? fmi3IntervalChanged : fmi3IntervalNotYetKnown;
            *v = *real(m, DELAY);
            m->counting = false;
            return fmi3OK;
        default:
            return fmi3Error;
    }
}

fmi3Status fmi3GetShiftDecimal(fmi3Instance instance, const fmi3ValueReference r[], size_t n, fmi3Float64 v[]) {
    (void)instance;
    *v = 0.0;
    return n == 1 && (*r == CLOCKS + FIXED || *r == CLOCKS + TUNABLE) ? fmi3OK : fmi3Error;
}

/* Intervals and shifts of 1/1000 s, where the description says that the FMU gives fractions. */
fmi3Status fmi3GetIntervalFraction(fmi3Instance instance, const fmi3ValueReference r[], size_t n, fmi3UInt64 counters[],
                                   fmi3UInt64 resolutions[], fmi3IntervalQualifier q[]) {
    double interval = 0.0;
    fmi3Status status = fmi3GetIntervalDecimal(instance, r, n, &interval, q);
    *counters = (fmi3UInt64)(1000.0 * interval + 0.5);
    *resolutions = 1000;
    return status;
}

fmi3Status fmi3GetShiftFraction(fmi3Instance instance, const fmi3ValueReference r[], size_t n, fmi3UInt64 counters[],
                                fmi3UInt64 resolutions[]) {
    double shift;
    *counters = 125;
    *resolutions = 1000;
    return fmi3GetShiftDecimal(instance, r, n, &shift);
}

fmi3Status fmi3SetIntervalFraction(fmi3Instance instance, const fmi3ValueReference r[], size_t n,
                                   const fmi3UInt64 counters[], const fmi3UInt64 resolutions[]) {
    Model *m = instance;
    m->told = *counters == 3 && *resolutions == 8;
    return n == 1 && *r == CLOCKS + TUNABLE && m->mode == INITIALIZATION ? fmi3OK : fmi3Error;
}

fmi3Status fmi3SetIntervalDecimal(fmi3Instance instance, const fmi3ValueReference r[], size_t n,
                                  const fmi3Float64 v[]) {
    Model *m = instance;
    if (*r == CLOCKS + TUNABLE) m->told = *v == 0.5;
    return n == 1 && (*r == CLOCKS + FIXED || *r == CLOCKS + TUNABLE) && m->mode == INITIALIZATION ? fmi3OK : fmi3Error;
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *need, fmi3Boolean *end, fmi3Boolean *nominals,
                                    fmi3Boolean *states, fmi3Boolean *defined, fmi3Float64 *next) {
    Model *m = instance;
    if (m->mode != EVENT) return fmi3Error;
    compute(m);
    memset(m->active, 0, sizeof m->active);
    memset(m->counted, 0, sizeof m->counted);
    *need = m->level_changed || *real(m, ENDLESS) > 0.0; /* the change counts in a second iteration */
    m->changes += m->level_changed;
    m->level_changed = false;
    if (m->event) *real(m, X) = 0.0;
    m->event = false;
    m->iterations++;
    *end = m->time >= *real(m, END_AT);
    *nominals = *states = false;
    *defined = m->time < *real(m, ALARM);
    *next = *real(m, ALARM);
    if (!*defined && !m->rung) m->changes += 100;
    m->rung = !*defined;
    return fmi3OK;
}

static fmi3Status enter(Model *m, Mode from, Mode to) {
    if (m->mode != from) return fmi3Error;
    m->mode = to;
    return fmi3OK;
}

fmi3Status fmi3EnterEventMode(fmi3Instance instance) {
    ((Model *)instance)->computed = true;
    return enter(instance, STEP, EVENT);
}

fmi3Status fmi3EnterStepMode(fmi3Instance instance) { return enter(instance, EVENT, STEP); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean tolerance_defined, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean stop_defined, fmi3Float64 stop) {
    (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop;
    ((Model *)instance)->time = start;
    return enter(instance, INSTANTIATED, INITIALIZATION);
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance) {
    ((Model *)instance)->computed = true;
    return enter(instance, INITIALIZATION, EVENT);
}

/* x grows at the rate `gain`; at `jump_at` it falls to 0, which is an event. */
fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 t, fmi3Float64 h, fmi3Boolean no_set_state, fmi3Boolean *event,
                      fmi3Boolean *end, fmi3Boolean *early, fmi3Float64 *last) {
    (void)no_set_state;
    Model *m = instance;
    double jump = *real(m, JUMP_AT);
    if (m->mode != STEP || h <= 0.0 || t - m->time > 1e-9 || m->time - t > 1e-9) return fmi3Error;
    *event = t < jump && t + h >= jump;
    *early = *event && jump < t + h && m->early_allowed;
    *end = false;
    *last = *early ? jump : t + h;
    *real(m, X) += *real(m, GAIN) * (*last - m->time);
    m->event = *event;
    m->time = *last;
    return fmi3OK;
}

fmi3Status fmi3Terminate(fmi3Instance instance) {
    (void)instance;
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance instance) {
    (void)instance;
    return fmi3Error; /* so that each run has an instance of its own */
}

const char *fmi3GetVersion(void) { return "3.0"; }

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
                                         const fmi3ValueReference required[], size_t n,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)required, (void)n;
    (void)environment, (void)log, (void)update;
    Model *m = events ? calloc(1, sizeof *m) : NULL;
    if (m == NULL) return NULL;
    m->early_allowed = early;
    *real(m, GAIN) = 1.0;
    *real(m, JUMP_AT) = *real(m, END_AT) = *real(m, ALARM) = 1e9;
    *real(m, DELAY) = 0.25;
    *real(m, PERIOD) = 0.5;
    return m;
}

void fmi3FreeInstance(fmi3Instance instance) { free(instance); }

#include "fmi3_copied_state.h"
