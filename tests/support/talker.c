/* FMU for tests of messages, of FMI 2.0, or of FMI 3.0 where FMI is 3: y counts its steps, and definitions choose what it says.

WARNS: a warning at each second step, with its number, and the status too. MUTE: the status alone. FAILS: two messages and
an error at the fourth step. FLOOD: so many warnings in the first step. THREADS: so many threads say a thousand each.
ODD: texts that are none. STRAY: it forgets its environment. LATE: at its first step an instance speaks through the
callbacks of the one that was freed last. REFUSES: it takes no choice of categories. STARTLESS: its initialisation fails. */

#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef THREADS
#include <pthread.h>
#endif

#if FMI == 3
#include "fmi3FunctionTypes.h"
typedef fmi3Status Status;
#define NAME(function) fmi3##function
#else
#include "fmi2FunctionTypes.h"
typedef fmi2Status Status;
#define NAME(function) fmi2##function
#endif

#define OK ((Status)0)
#define WARNING ((Status)1)
#define ERROR ((Status)3)

typedef struct {
    int steps;
    char name[64];
#if FMI == 3
    fmi3LogMessageCallback log;
    fmi3InstanceEnvironment environment;
#else
    const fmi2CallbackFunctions *callbacks;
#endif
} Model;

static Model last_freed;

static void say(const Model *m, int status, const char *category, const char *text, double number) {
#ifdef STRAY
    static int stray;
#define ENVIRONMENT(own) ((void)(own), (void *)&stray)
#else
#define ENVIRONMENT(own) (own)
#endif
#if FMI == 3
    char message[200];
    if (text) snprintf(message, sizeof message, text, number);
    m->log(ENVIRONMENT(m->environment), (Status)status, category, text ? message : NULL);
#else
    m->callbacks->logger(ENVIRONMENT(m->callbacks->componentEnvironment), m->name, (Status)status, category, text,
                         number);
#endif
}

#ifdef THREADS
static void *talk(void *m) {
    for (int i = 0; i < 1000; i++) say(m, WARNING, "logThread", "from a thread: %g", i);
    return NULL;
}
#endif

static Status step(Model *m, double time) {
    m->steps++;
    if (m->steps == 1) say(m, OK, "logEvents", "the first step, at %g s", time);
#ifdef WARNS
    if (m->steps % 2 == 0) {
        say(m, WARNING, "logTable", "%g is outside of the table", time);
        return WARNING;
    }
#endif
#ifdef MUTE
    if (m->steps % 2 == 0) return WARNING;
#endif
#ifdef FAILS
    if (m->steps == 4) {
        say(m, WARNING, "logSolver", "the step shrank to %g s", 1e-9);
        say(m, ERROR, "logSolver", "no convergence at %g s", time);
        return ERROR;
    }
#endif
#ifdef FLOOD
    for (int i = 0; m->steps == 1 && i < FLOOD; i++) say(m, WARNING, "logTable", "%g is outside of the table", i);
#endif
#ifdef THREADS
    pthread_t threads[THREADS];
    for (int i = 0; m->steps == 1 && i < THREADS; i++) pthread_create(&threads[i], NULL, talk, m);
    for (int i = 0; m->steps == 1 && i < THREADS; i++) pthread_join(threads[i], NULL);
#endif
#ifdef ODD
    if (m->steps == 1) {
        say(m, WARNING, "logOdd", "two\nlines\tand \x1b[31mred\x1b[0m", 0.0);
        say(m, WARNING, "log\xff", "no UTF-8: \xc3\x28 \xff", 0.0);
        say(m, WARNING, NULL, NULL, 0.0);
        say(m, OK, NULL, NULL, 0.0);
        say(m, 77, "logOdd", "a status that FMI does not have", 0.0);
        say(m, WARNING, "logOdd", "pressure \xc3\xbc %.3f bar, 100%%", 1.5);
    }
#endif
#ifdef LATE
    if (m->steps == 1 && last_freed.name[0]) say(&last_freed, WARNING, "logLate", "after its end", 0.0);
#endif
    return OK;
}

static Model *made(const char *name) {
    Model *m = calloc(1, sizeof *m);
    if (m) snprintf(m->name, sizeof m->name, "%s", name);
    return m;
}

static Status chosen(const Model *m, size_t n, const void *categories) {
#ifdef REFUSES
    (void)m, (void)n, (void)categories;
    return ERROR;
#else
    const char *const *names = categories;
    char text[200] = "asked for:";
    for (size_t i = 0; i < n; i++) snprintf(text + strlen(text), sizeof text - strlen(text), " %s", names[i]);
    if (n == 0) strcat(text, " everything");
    say(m, OK, n ? names[0] : "logEvents", text, 0.0);
    return OK;
#endif
}

const char *NAME(GetVersion)(void) { return FMI == 3 ? "3.0" : "2.0"; }

void NAME(FreeInstance)(void *instance) {
    last_freed = *(Model *)instance;
    free(instance);
}

Status NAME(ExitInitializationMode)(void *m) {
#ifdef STARTLESS
    say(m, ERROR, "logSolver", "no initial state: %g residuals", 3.0);
    return ERROR;
#endif
    return m ? OK : ERROR;
}

Status NAME(Terminate)(void *m) { return m ? OK : ERROR; }

#if FMI == 3
fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
                                         const fmi3ValueReference required[], size_t n,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update) {
    (void)token, (void)resources, (void)visible, (void)logging, (void)events, (void)early;
    (void)required, (void)n, (void)update;
    Model *m = made(name);
    m->log = log;
    m->environment = environment;
    return m;
}

fmi3Status fmi3SetDebugLogging(fmi3Instance m, fmi3Boolean on, size_t n, const fmi3String categories[]) {
    return on ? chosen(m, n, categories) : ERROR;
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance m, fmi3Boolean tolerance_defined, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean stop_defined, fmi3Float64 stop) {
    (void)tolerance_defined, (void)tolerance, (void)start, (void)stop_defined, (void)stop;
    return m ? fmi3OK : fmi3Error;
}

fmi3Status fmi3GetFloat64(fmi3Instance m, const fmi3ValueReference r[], size_t n, fmi3Float64 v[], size_t count) {
    (void)r;
    for (size_t i = 0; i < n && i < count; i++) v[i] = ((Model *)m)->steps;
    return fmi3OK;
}

fmi3Status fmi3DoStep(fmi3Instance m, fmi3Float64 t, fmi3Float64 h, fmi3Boolean no_set_state, fmi3Boolean *event,
                      fmi3Boolean *end, fmi3Boolean *early, fmi3Float64 *last) {
    (void)no_set_state;
    *event = *end = *early = false;
    *last = t + h;
    return step(m, t);
}
#else
const char *fmi2GetTypesPlatform(void) { return "default"; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
    (void)type, (void)guid, (void)resources, (void)visible, (void)logging;
    Model *m = made(name);
    m->callbacks = callbacks;
    return m;
}

fmi2Status fmi2SetDebugLogging(fmi2Component m, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    return on ? chosen(m, n, categories) : ERROR;
}

fmi2Status fmi2SetupExperiment(fmi2Component m, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stop_defined, fmi2Real stop) {
    (void)tolerance_defined, (void)tolerance, (void)start, (void)stop_defined, (void)stop;
    return m ? fmi2OK : fmi2Error;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component m) { return m ? fmi2OK : fmi2Error; }

fmi2Status fmi2GetReal(fmi2Component m, const fmi2ValueReference r[], size_t n, fmi2Real v[]) {
    (void)r;
    for (size_t i = 0; i < n; i++) v[i] = ((Model *)m)->steps;
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component m, fmi2Real t, fmi2Real h, fmi2Boolean no_set_state) {
    (void)h, (void)no_set_state;
    return step(m, t);
}
#endif
