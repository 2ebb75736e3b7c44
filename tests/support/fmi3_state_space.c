/* FMI 3.0 co-simulation FMU for tests: der(x) = A x + B u, y = C x + D u, whose sizes m (inputs), n (states) and r (outputs)
 * are structural parameters. They can be set in the configuration mode only, and no size is taken for another.
 *
 * A step is one of Euler's method. */

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3FunctionTypes.h"

enum { M = 1, N, R, A, B, C, D, X0, U, Y, X, MOST = 5 };

typedef enum { INSTANTIATED, CONFIGURATION, INITIALIZATION, STEP } Mode;

typedef struct {
    Mode mode;
    uint64_t size[R + 1];
    double values[X + 1][MOST * MOST];
} Model;

/* Rows and columns of a variable. */
static size_t count(const Model *m, fmi3ValueReference r) {
    const uint64_t *s = m->size;
    switch (r) {
        case A:
            return s[N] * s[N];
        case B:
            return s[N] * s[M];
        case C:
            return s[R] * s[N];
        case D:
            return s[R] * s[M];
        case U:
            return s[M];
        case Y:
            return s[R];
        case X0:
        case X:
            return s[N];
        default:
            return 0;
    }
}

static void product(double *y, const double *matrix, const double *x, size_t rows, size_t columns) {
    for (size_t i = 0; i < rows; i++)
        for (size_t j = 0; j < columns; j++) y[i] += matrix[i * columns + j] * x[j];
}

/* Start values for the sizes: unit matrices, inputs 1, 2, 3 ... */
static void begin(Model *m) {
    memset(m->values, 0, sizeof m->values);
    const size_t columns[] = {[A] = m->size[N], [B] = m->size[M], [C] = m->size[N], [D] = m->size[M]};
    for (int r = A; r <= D; r++)
        for (size_t i = 0; columns[r] > 0 && i < count(m, r); i += columns[r] + 1)
            m->values[r][i] = i % columns[r] == i / columns[r];
    for (size_t i = 0; i < m->size[M]; i++) m->values[U][i] = (double)i + 1.0;
}

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference r[], size_t n, fmi3Float64 v[],
                          size_t total) {
    Model *m = instance;
    for (size_t i = 0; i < n; i++) {
        size_t size = count(m, r[i]);
        if (m->mode < INITIALIZATION || size > total) return fmi3Error;
        if (r[i] == Y) {
            memset(m->values[Y], 0, sizeof m->values[Y]);
            product(m->values[Y], m->values[C], m->values[X], m->size[R], m->size[N]);
            product(m->values[Y], m->values[D], m->values[U], m->size[R], m->size[M]);
        }
        if (r[i] == X && m->mode == INITIALIZATION) memcpy(m->values[X], m->values[X0], sizeof m->values[X]);
        memcpy(v, m->values[r[i]], size * sizeof *v);
        v += size;
        total -= size;
    }
    return total == 0 ? fmi3OK : fmi3Error;
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference r[], size_t n, const fmi3Float64 v[],
                          size_t total) {
    Model *m = instance;
    if (m->mode == CONFIGURATION) return fmi3Error;
    for (size_t i = 0; i < n; i++) {
        size_t size = count(m, r[i]);
        if (size > total || (r[i] != U && (m->mode == STEP || r[i] > X0))) return fmi3Error;
        memcpy(m->values[r[i]], v, size * sizeof *v);
        v += size;
        total -= size;
    }
    return total == 0 ? fmi3OK : fmi3Error;
}

fmi3Status fmi3GetUInt64(fmi3Instance instance, const fmi3ValueReference r[], size_t n, fmi3UInt64 v[], size_t total) {
    if (n != total) return fmi3Error;
    for (size_t i = 0; i < n; i++) v[i] = ((Model *)instance)->size[r[i]];
    return fmi3OK;
}

fmi3Status fmi3SetUInt64(fmi3Instance instance, const fmi3ValueReference r[], size_t n, const fmi3UInt64 v[],
                         size_t total) {
    Model *m = instance;
    if (n != total || m->mode != CONFIGURATION) return fmi3Error;
    for (size_t i = 0; i < n; i++) {
        if (r[i] > R || v[i] > MOST) return fmi3Error;
        m->size[r[i]] = v[i];
    }
    return fmi3OK;
}

static fmi3Status enter(Model *m, Mode from, Mode to) {
    if (m->mode != from) return fmi3Error;
    m->mode = to;
    return fmi3OK;
}

fmi3Status fmi3EnterConfigurationMode(fmi3Instance m) { return enter(m, INSTANTIATED, CONFIGURATION); }

fmi3Status fmi3ExitConfigurationMode(fmi3Instance m) {
    begin(m);
    return enter(m, CONFIGURATION, INSTANTIATED);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance m, fmi3Boolean tolerance_defined, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean stop_defined, fmi3Float64 stop) {
    (void)tolerance_defined, (void)tolerance, (void)start, (void)stop_defined, (void)stop;
    return enter(m, INSTANTIATED, INITIALIZATION);
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance) {
    Model *m = instance;
    memcpy(m->values[X], m->values[X0], sizeof m->values[X]);
    return enter(m, INITIALIZATION, STEP);
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 t, fmi3Float64 h, fmi3Boolean no_set_state, fmi3Boolean *event,
                      fmi3Boolean *end, fmi3Boolean *early, fmi3Float64 *last) {
    (void)no_set_state;
    Model *m = instance;
    double rate[MOST] = {0};
    product(rate, m->values[A], m->values[X], m->size[N], m->size[N]);
    product(rate, m->values[B], m->values[U], m->size[N], m->size[M]);
    for (size_t i = 0; i < m->size[N]; i++) m->values[X][i] += h * rate[i];
    *event = *end = *early = false;
    *last = t + h;
    return m->mode == STEP ? fmi3OK : fmi3Error;
}

fmi3Status fmi3Terminate(fmi3Instance instance) {
    (void)instance;
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance instance) {
    Model *m = instance;
    m->mode = INSTANTIATED;
    for (int i = M; i <= R; i++) m->size[i] = 3;
    begin(m);
    return fmi3OK;
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
                                         const fmi3ValueReference required[], size_t n,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)events, (void)early;
    (void)required, (void)n, (void)environment, (void)log, (void)update;
    Model *m = calloc(1, sizeof *m);
    if (m != NULL) fmi3Reset(m);
    return m;
}

void fmi3FreeInstance(fmi3Instance instance) { free(instance); }
