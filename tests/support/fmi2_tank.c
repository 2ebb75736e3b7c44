/* FMI 2.0 co-simulation FMU for tests of loading: x' = u, y = scale x, with the functions that a run needs and no others.

ONCE: one instance in a process. FURTHER: the scale comes from a further library. NOWHERE: it comes from a function that
no library has. RESOURCE: it stands in the file scale.txt of the resources. GLOBAL: x is a global variable, which begins
at 0 when the library is loaded; UNIQUE: one that the loader keeps once for the process. MEDDLES: it changes what belongs
to the process, and must find its folder again. */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef MEDDLES
#include <fenv.h>
#include <locale.h>
#include <signal.h>
#include <unistd.h>
#endif

#include "fmi2Functions.h"

enum { X, U, Y };

typedef struct {
    double x, u, scale;
} Model;

#ifdef ONCE
static int instances;
#endif

#if defined GLOBAL || defined UNIQUE
double tank_level;
#define LEVEL(m) (*((void)(m), &tank_level))
#else
#define LEVEL(m) ((m)->x)
#endif

#ifdef UNIQUE
__asm__(".type tank_level, %gnu_unique_object");
#endif

#ifdef FURTHER
double further(void);
#endif

#ifdef NOWHERE
double nowhere(void);
#endif

#ifdef RESOURCE
/* The path of a file URI, its escaped characters decoded. */
static void decode(const char *uri, char *path) {
    for (uri += strlen("file://"); *uri; uri++) {
        unsigned code = 0;
        if (*uri == '%' && sscanf(uri + 1, "%2x", &code) == 1) *path++ = (char)code, uri += 2;
        else *path++ = *uri;
    }
    *path = 0;
}

static double read_scale(const char *resources) {
    char path[4096];
    double scale = 0.0;
    decode(resources, path);
    strcat(path, "/scale.txt");
    FILE *file = fopen(path, "r");
    if (file == NULL || fscanf(file, "%lf", &scale) != 1) return 0.0;
    fclose(file);
    return scale;
}
#endif

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    (void)type, (void)guid, (void)resources, (void)visible, (void)logging;
#ifdef ONCE
    if (instances) {
        functions->logger(functions->componentEnvironment, name, fmi2Error, "error", "there is one already");
        return NULL;
    }
    instances++;
#else
    (void)name, (void)functions;
#endif
#ifdef MEDDLES
    if (chdir("/") || !setlocale(LC_ALL, "C") || fesetround(FE_UPWARD)) return NULL;
    signal(SIGINT, SIG_IGN);
    signal(SIGTERM, exit);
#endif
    Model *m = calloc(1, sizeof *m);
    m->scale = 1.0;
#ifdef FURTHER
    m->scale = further();
#endif
#ifdef NOWHERE
    m->scale = nowhere();
#endif
#ifdef RESOURCE
    m->scale = read_scale(resources);
#endif
    return m;
}

void fmi2FreeInstance(fmi2Component c) {
#ifdef ONCE
    instances--;
#endif
    free(c);
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stop_defined, fmi2Real stop) {
    (void)c, (void)tolerance_defined, (void)tolerance, (void)start, (void)stop_defined, (void)stop;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return c ? fmi2OK : fmi2Error; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
#ifdef MEDDLES
    char folder[2];
    if (!getcwd(folder, sizeof folder)) return fmi2Error;
    fesetround(FE_UPWARD);
#endif
    return c ? fmi2OK : fmi2Error;
}
fmi2Status fmi2Terminate(fmi2Component c) { return c ? fmi2OK : fmi2Error; }

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real v[]) {
    const Model *m = c;
    for (size_t i = 0; i < n; i++) v[i] = r[i] == Y ? m->scale * LEVEL(m) : r[i] == U ? m->u : LEVEL(m);
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real v[]) {
    Model *m = c;
    for (size_t i = 0; i < n; i++) *(r[i] == U ? &m->u : &LEVEL(m)) = v[i];
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean no_rollback) {
    Model *m = c;
    (void)time, (void)no_rollback;
    LEVEL(m) += step * m->u;
    return fmi2OK;
}
