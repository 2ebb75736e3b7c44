/* FMI 1.0 co-simulation FMU for tests: x' = u from x_start, y = x + direct, and values of the other types passed through.

u_at_start is the input that it has when it is initialised, stop the stop time that it is told then, or -1. Outputs can't be read before, and some calls return an error
with a message: initialisation with x_start < 0, and a step beyond x = 100. */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi1Functions.h"

#define NAME(function) tank_fmi##function

enum { X, U, Y, X_START, U_AT_START, DIRECT, N, N_OUT, B, B_OUT, TEXT, LENGTH, MODE, MODE_OUT, STOP };

typedef struct {
    double x, u, rate, x_start, u_at_start, direct, stop;
    int n, mode, initialized;
    fmi1Boolean b;
    char text[64], name[64], location[1024];
    fmi1CallbackFunctions functions;
} Model;

static void start(Model *m) {
    m->x = m->u = m->rate = m->u_at_start = m->direct = 0.0;
    m->x_start = 0.5;
    m->n = m->b = m->initialized = 0;
    m->mode = 1;
    m->text[0] = 0;
}

static fmi1Status failed(Model *m, const char *format, double value) {
    m->functions.logger(m, m->name, fmi1Error, "error", format, value);
    return fmi1Error;
}

const char *NAME(GetTypesPlatform)(void) { return "standard32"; }
const char *NAME(GetVersion)(void) { return "1.0"; }

fmi1Component NAME(InstantiateSlave)(fmi1String name, fmi1String guid, fmi1String location, fmi1String mime_type,
                                     fmi1Real timeout, fmi1Boolean visible, fmi1Boolean interactive,
                                     fmi1CallbackFunctions functions, fmi1Boolean logging) {
    (void)timeout, (void)visible, (void)interactive, (void)logging;
    if (strcmp(guid, "{fmi1-tank}") || strcmp(mime_type, "application/x-fmu-sharedlibrary")) {
        functions.logger(NULL, name, fmi1Error, "error", "wrong identity %s", guid);
        return NULL;
    }
    Model *m = functions.allocateMemory(1, sizeof *m);
    m->functions = functions;
    snprintf(m->name, sizeof m->name, "%s", name);
    snprintf(m->location, sizeof m->location, "%s", location);
    start(m);
    return m;
}

void NAME(FreeSlaveInstance)(fmi1Component c) {
    Model *m = c;
    m->functions.freeMemory(m);
}

fmi1Status NAME(InitializeSlave)(fmi1Component c, fmi1Real time, fmi1Boolean stop_defined, fmi1Real stop) {
    Model *m = c;
    if (m->initialized) return failed(m, "initialised twice, at %g", time);
    if (m->x_start < 0.0) return failed(m, "a level of %g is too low", m->x_start);
    m->x = m->x_start;
    m->u_at_start = m->u;
    m->stop = stop_defined ? stop : -1.0;
    m->initialized = 1;
    return fmi1OK;
}

fmi1Status NAME(TerminateSlave)(fmi1Component c) { return ((Model *)c)->initialized ? fmi1OK : fmi1Error; }

fmi1Status NAME(ResetSlave)(fmi1Component c) {
    start(c);
    return fmi1OK;
}

fmi1Status NAME(DoStep)(fmi1Component c, fmi1Real time, fmi1Real step, fmi1Boolean new_step) {
    Model *m = c;
    if (!m->initialized || new_step != fmi1True) return fmi1Error;
    m->x += step * (m->u + 0.5 * step * m->rate);
    m->rate = 0.0;
    return m->x > 100.0 ? failed(m, "the level is too high, at %g s", time) : fmi1OK;
}

static double *real(Model *m, fmi1ValueReference r) {
    switch (r) {
        case X:
            return &m->x;
        case U:
            return &m->u;
        case X_START:
            return &m->x_start;
        case U_AT_START:
            return &m->u_at_start;
        case STOP:
            return &m->stop;
        default:
            return &m->direct;
    }
}

fmi1Status NAME(GetReal)(fmi1Component c, const fmi1ValueReference r[], size_t n, fmi1Real v[]) {
    Model *m = c;
    if (!m->initialized) return failed(m, "outputs are read before the initialisation: %g", m->x);
    for (size_t i = 0; i < n; i++) v[i] = r[i] == Y ? m->x + m->direct : *real(m, r[i]);
    return fmi1OK;
}

fmi1Status NAME(SetReal)(fmi1Component c, const fmi1ValueReference r[], size_t n, const fmi1Real v[]) {
    for (size_t i = 0; i < n; i++) *real(c, r[i]) = v[i];
    return fmi1OK;
}

fmi1Status NAME(SetRealInputDerivatives)(fmi1Component c, const fmi1ValueReference r[], size_t n,
                                         const fmi1Integer order[], const fmi1Real v[]) {
    for (size_t i = 0; i < n; i++) {
        if (r[i] != U || order[i] != 1) return fmi1Error;
        ((Model *)c)->rate = v[i];
    }
    return fmi1OK;
}

fmi1Status NAME(GetInteger)(fmi1Component c, const fmi1ValueReference r[], size_t n, fmi1Integer v[]) {
    Model *m = c;
    for (size_t i = 0; i < n; i++)
        v[i] = r[i] == LENGTH ? (int)strlen(m->text) : r[i] == MODE || r[i] == MODE_OUT ? m->mode : m->n;
    return fmi1OK;
}

fmi1Status NAME(SetInteger)(fmi1Component c, const fmi1ValueReference r[], size_t n, const fmi1Integer v[]) {
    Model *m = c;
    for (size_t i = 0; i < n; i++) *(r[i] == MODE ? &m->mode : &m->n) = v[i];
    return fmi1OK;
}

fmi1Status NAME(GetBoolean)(fmi1Component c, const fmi1ValueReference r[], size_t n, fmi1Boolean v[]) {
    (void)r;
    for (size_t i = 0; i < n; i++) v[i] = ((Model *)c)->b;
    return fmi1OK;
}

fmi1Status NAME(SetBoolean)(fmi1Component c, const fmi1ValueReference r[], size_t n, const fmi1Boolean v[]) {
    (void)r;
    for (size_t i = 0; i < n; i++) {
        if (v[i] != fmi1True && v[i] != fmi1False) return fmi1Error;
        ((Model *)c)->b = v[i];
    }
    return fmi1OK;
}

fmi1Status NAME(GetString)(fmi1Component c, const fmi1ValueReference r[], size_t n, fmi1String v[]) {
    (void)r;
    for (size_t i = 0; i < n; i++) v[i] = ((Model *)c)->text;
    return fmi1OK;
}

fmi1Status NAME(SetString)(fmi1Component c, const fmi1ValueReference r[], size_t n, const fmi1String v[]) {
    Model *m = c;
    (void)r;
    for (size_t i = 0; i < n; i++) snprintf(m->text, sizeof m->text, "%s", v[i]);
    return fmi1OK;
}

#ifdef COMPLETE /* for importers that want all functions */

fmi1Status NAME(SetDebugLogging)(fmi1Component c, fmi1Boolean on) {
    (void)c, (void)on;
    return fmi1Error;
}

fmi1Status NAME(CancelStep)(fmi1Component c) {
    (void)c;
    return fmi1Error;
}

fmi1Status NAME(GetRealOutputDerivatives)(fmi1Component c, const fmi1ValueReference r[], size_t n,
                                          const fmi1Integer order[], fmi1Real v[]) {
    (void)c, (void)r, (void)n, (void)order, (void)v;
    return fmi1Error;
}

fmi1Status NAME(GetStatus)(fmi1Component c, const fmi1StatusKind kind, fmi1Status *v) {
    (void)c, (void)kind, (void)v;
    return fmi1Error;
}

fmi1Status NAME(GetRealStatus)(fmi1Component c, const fmi1StatusKind kind, fmi1Real *v) {
    (void)c, (void)kind, (void)v;
    return fmi1Error;
}

fmi1Status NAME(GetIntegerStatus)(fmi1Component c, const fmi1StatusKind kind, fmi1Integer *v) {
    (void)c, (void)kind, (void)v;
    return fmi1Error;
}

fmi1Status NAME(GetBooleanStatus)(fmi1Component c, const fmi1StatusKind kind, fmi1Boolean *v) {
    (void)c, (void)kind, (void)v;
    return fmi1Error;
}

fmi1Status NAME(GetStringStatus)(fmi1Component c, const fmi1StatusKind kind, fmi1String *v) {
    (void)c, (void)kind, (void)v;
    return fmi1Error;
}

#endif
