/* Couples FMUs in a fixed-step loop by the C functions of FMI alone, without Python in the process.
 *
 * Compiled once with -DFMI=2 and once with -DFMI=3 against the headers of the standard.
 * Usage: host CASE RESULT. The case has one item a line, fields separated by tabs, in this order:
 *   fmu      NAME  LIBRARY  TOKEN  RESOURCES   (RESOURCES: a URI for FMI 2.0, a path for FMI 3.0)
 *   start    FMU   REFERENCE  VALUE            (FMUs are numbered from 0)
 *   connect  FMU   REFERENCE  FMU  REFERENCE   (output and input, in the order of exchange)
 *   record   FMU   REFERENCE
 *   run      STEPS STEP_SIZE
 * The result is a sequence of doubles: seconds of the loop and of all, then the recorded values at each communication
 * point. Exit code 1, with one line on standard error, where a call does not return OK. */
#define _POSIX_C_SOURCE 200809L
#include <dlfcn.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#if FMI == 2
#include "fmi2Functions.h"
#define CALL(name) fmi2##name##TYPE *name
#define SYMBOL(name) "fmi2" #name
typedef fmi2Component Instance;
typedef fmi2ValueReference Reference;
#else
#include "fmi3Functions.h"
#define CALL(name) fmi3##name##TYPE *name
#define SYMBOL(name) "fmi3" #name
typedef fmi3Instance Instance;
typedef fmi3ValueReference Reference;
#endif

enum { MOST_FMUS = 16, MOST_ITEMS = 4096 };

typedef struct {
    Instance instance;
    CALL(EnterInitializationMode);
    CALL(ExitInitializationMode);
    CALL(DoStep);
    CALL(Terminate);
    CALL(FreeInstance);
#if FMI == 2
    CALL(SetupExperiment);
    CALL(GetReal);
    CALL(SetReal);
#else
    CALL(GetFloat64);
    CALL(SetFloat64);
#endif
} Fmu;

typedef struct {
    int from, to;
    Reference output, input;
} Connection;

static Fmu fmus[MOST_FMUS];
static Connection connections[MOST_ITEMS], records[MOST_ITEMS];
static int n_fmus, n_connections, n_records;

static void stop(const char *what, const char *which) {
    fprintf(stderr, "%s: %s\n", what, which);
    exit(1);
}

static void must(int status, const char *call) {
    if (status != 0) stop("does not return OK", call);
}

static void *symbol(void *library, const char *name) {
    void *found = dlsym(library, name);
    if (!found) stop("the library has no function", name);
    return found;
}

#define LOAD(fmu, library, name) *(void **)(&(fmu)->name) = symbol(library, SYMBOL(name))

static double seconds(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static double get(int fmu, Reference reference) {
    double value;
    Fmu *f = &fmus[fmu];
#if FMI == 2
    must(f->GetReal(f->instance, &reference, 1, &value), "GetReal");
#else
    must(f->GetFloat64(f->instance, &reference, 1, &value, 1), "GetFloat64");
#endif
    return value;
}

static void set(int fmu, Reference reference, double value) {
    Fmu *f = &fmus[fmu];
#if FMI == 2
    must(f->SetReal(f->instance, &reference, 1, &value), "SetReal");
#else
    must(f->SetFloat64(f->instance, &reference, 1, &value, 1), "SetFloat64");
#endif
}

#if FMI == 2
static void logger(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                   fmi2String format, ...) {
    va_list arguments;
    (void)environment, (void)status, (void)category;
    va_start(arguments, format);
    fprintf(stderr, "%s: ", name);
    vfprintf(stderr, format, arguments);
    fputc('\n', stderr);
    va_end(arguments);
}
static const fmi2CallbackFunctions callbacks = {logger, calloc, free, NULL, NULL};
#else
static void logger(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category, fmi3String message) {
    (void)environment, (void)status, (void)category;
    fprintf(stderr, "%s\n", message);
}
#endif

static void load(const char *name, const char *path, const char *token, const char *resources) {
    if (n_fmus == MOST_FMUS) stop("too many FMUs", name);
    Fmu *f = &fmus[n_fmus++];
    void *library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (!library) stop("can't load", dlerror());
    LOAD(f, library, EnterInitializationMode);
    LOAD(f, library, ExitInitializationMode);
    LOAD(f, library, DoStep);
    LOAD(f, library, Terminate);
    LOAD(f, library, FreeInstance);
#if FMI == 2
    CALL(Instantiate);
    *(void **)(&Instantiate) = symbol(library, SYMBOL(Instantiate));
    LOAD(f, library, SetupExperiment);
    LOAD(f, library, GetReal);
    LOAD(f, library, SetReal);
    f->instance = Instantiate(name, fmi2CoSimulation, token, resources, &callbacks, fmi2False, fmi2False);
#else
    CALL(InstantiateCoSimulation);
    *(void **)(&InstantiateCoSimulation) = symbol(library, SYMBOL(InstantiateCoSimulation));
    LOAD(f, library, GetFloat64);
    LOAD(f, library, SetFloat64);
    f->instance = InstantiateCoSimulation(name, token, resources, 0, 0, 0, 0, NULL, 0, NULL, logger, NULL);
#endif
    if (!f->instance) stop("can't instantiate", name);
}

static void exchange(void) {
    for (int i = 0; i < n_connections; i++) {
        const Connection *c = &connections[i];
        set(c->to, c->input, get(c->from, c->output));
    }
}

static void record(FILE *out) {
    for (int i = 0; i < n_records; i++) {
        double value = get(records[i].from, records[i].output);
        fwrite(&value, sizeof value, 1, out);
    }
}

static void run(long steps, double step_size, double began, FILE *out) {
    for (int i = 0; i < n_fmus; i++) {
        Fmu *f = &fmus[i];
#if FMI == 2
        must(f->SetupExperiment(f->instance, 0, 0.0, 0.0, 1, (double)steps * step_size), "SetupExperiment");
        must(f->EnterInitializationMode(f->instance), "EnterInitializationMode");
#else
        must(f->EnterInitializationMode(f->instance, 0, 0.0, 0.0, 1, (double)steps * step_size),
             "EnterInitializationMode");
#endif
    }
    exchange();
    for (int i = 0; i < n_fmus; i++) must(fmus[i].ExitInitializationMode(fmus[i].instance), "ExitInitializationMode");
    double loop_began = seconds(), taken[2] = {0.0, 0.0};
    fwrite(taken, sizeof taken, 1, out);
    record(out);
    for (long k = 0; k < steps; k++) {
        for (int i = 0; i < n_fmus; i++) {
            Fmu *f = &fmus[i];
            double t = (double)k * step_size;
#if FMI == 2
            must(f->DoStep(f->instance, t, step_size, 1), "DoStep");
#else
            bool event, terminate, early;
            double last;
            must(f->DoStep(f->instance, t, step_size, true, &event, &terminate, &early, &last), "DoStep");
#endif
        }
        exchange();
        record(out);
    }
    taken[0] = seconds() - loop_began;
    for (int i = 0; i < n_fmus; i++) {
        must(fmus[i].Terminate(fmus[i].instance), "Terminate");
        fmus[i].FreeInstance(fmus[i].instance);
    }
    taken[1] = seconds() - began;
    rewind(out);
    fwrite(taken, sizeof taken, 1, out);
}

int main(int argc, char **argv) {
    double began = seconds();
    if (argc != 3) stop("usage", "host CASE RESULT");
    FILE *in = fopen(argv[1], "r"), *out = fopen(argv[2], "wb");
    if (!in || !out) stop("can't open", argv[in ? 2 : 1]);
    static char line[16384], *field[6];
    while (fgets(line, sizeof line, in)) {
        int n = 0;
        line[strcspn(line, "\n")] = '\0';
        for (char *f = strtok(line, "\t"); f && n < 6; f = strtok(NULL, "\t")) field[n++] = f;
        if (n == 0) continue;
        if (!strcmp(field[0], "fmu") && n == 5) {
            load(field[1], field[2], field[3], field[4]);
        } else if (!strcmp(field[0], "start") && n == 4) {
            set(atoi(field[1]), (Reference)strtoul(field[2], NULL, 10), strtod(field[3], NULL));
        } else if (!strcmp(field[0], "connect") && n == 5 && n_connections < MOST_ITEMS) {
            Connection c = {atoi(field[1]), atoi(field[3]), (Reference)strtoul(field[2], NULL, 10),
                            (Reference)strtoul(field[4], NULL, 10)};
            connections[n_connections++] = c;
        } else if (!strcmp(field[0], "record") && n == 3 && n_records < MOST_ITEMS) {
            Connection c = {atoi(field[1]), 0, (Reference)strtoul(field[2], NULL, 10), 0};
            records[n_records++] = c;
        } else if (!strcmp(field[0], "run") && n == 3) {
            run(strtol(field[1], NULL, 10), strtod(field[2], NULL), began, out);
        } else {
            stop("not an item of a case", field[0]);
        }
    }
    return fclose(out) != 0;
}
