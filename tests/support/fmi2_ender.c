/* FMI 2.0 co-simulation FMU for tests: y = 1, and it ends the whole process in the function WHERE, in the way HOW. */
#define _GNU_SOURCE

#include <fcntl.h>
#include <pthread.h>
#include <signal.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "fmi2FunctionTypes.h"

enum { LOADING, INSTANTIATING, SETTING_UP, GETTING, STEPPING, TERMINATING, FREEING, UNLOADING };
enum {
    SEGMENTATION,
    ABORT,
    DIVISION,
    TRAP,
    BUS,
    RECURSION,
    IN_THREAD,
    EXIT_0,
    EXIT_3,
    END_0,
    END_3,
    IN_CHILD,
    FOREVER,
    MEMORY,
    CLOSING, /* the standard streams, and then it writes to one */
    IGNORING /* Ctrl-C, from then on */
};

static volatile int zero;
static volatile char *volatile nowhere;

static int recurse(int n) {
    volatile char room[4096];
    room[0] = (char)n;
    return n < 0 ? room[0] : recurse(n + 1) + room[0];
}

static void *crash(void *argument) {
    *nowhere = 1;
    return argument;
}

static void at(int where) {
    if (where != WHERE) return;
    pthread_t thread;
    switch (HOW) {
        case SEGMENTATION:
            *nowhere = 1;
            break;
        case ABORT:
            abort();
        case DIVISION:
            zero = 7 / zero;
            break;
        case TRAP:
            __builtin_trap();
        case BUS:
            raise(SIGBUS);
            break;
        case RECURSION:
            zero = recurse(0);
            break;
        case IN_THREAD:
            pthread_create(&thread, NULL, crash, NULL);
            pthread_join(thread, NULL);
            break;
        case EXIT_0:
            exit(0);
        case EXIT_3:
            exit(3);
        case END_0:
            _exit(0);
        case END_3:
            _exit(3);
        case IN_CHILD:
            if (fork() == 0) exit(0);
            break;
        case FOREVER:
            close(creat("forever", 0600)); /* tells that it has begun */
            for (;;) zero++;
        case MEMORY:
            for (;;) memset(malloc(1 << 24), 1, 1 << 24);
        case CLOSING:
            for (int i = 0; i < 3; i++) close(i);
            if (write(1, "nowhere", 7) == 7) abort(); /* something else has been opened in its place */
            break;
        case IGNORING:
            if (!zero++) signal(SIGINT, SIG_IGN);
            break;
        default:
            break;
    }
}

__attribute__((constructor)) static void load(void) { at(LOADING); }
__attribute__((destructor)) static void unload(void) { at(UNLOADING); }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    (void)name, (void)type, (void)guid, (void)resources, (void)functions, (void)visible, (void)logging;
    at(INSTANTIATING);
    return calloc(1, 8);
}

void fmi2FreeInstance(fmi2Component c) {
    at(FREEING);
    free(c);
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stop_defined, fmi2Real stop) {
    (void)c, (void)tolerance_defined, (void)tolerance, (void)start, (void)stop_defined, (void)stop;
    at(SETTING_UP);
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return c ? fmi2OK : fmi2Error; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return c ? fmi2OK : fmi2Error; }

fmi2Status fmi2Terminate(fmi2Component c) {
    at(TERMINATING);
    return c ? fmi2OK : fmi2Error;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real v[]) {
    (void)c, (void)r;
    at(GETTING);
    for (size_t i = 0; i < n; i++) v[i] = 1.0;
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean no_rollback) {
    (void)c, (void)step, (void)no_rollback;
    if (time > 0.35) at(STEPPING);
#ifdef FAILS
    if (time > 0.35) return fmi2Error;
#endif
    return fmi2OK;
}
