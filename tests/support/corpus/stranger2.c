/* FMI 2.0 co-simulation FMU that does what its GUID says: "what@where", as abort@step; any other GUID does no harm.
 *
 * It keeps a real number for each value reference below 64; y (2) follows u (1) as y' = u. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <fenv.h>
#include <locale.h>
#include <math.h>
#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/time.h>
#include <unistd.h>

#include "fmi2Functions.h"

enum { U = 1, Y = 2, MOST = 64 };

typedef struct {
    double values[MOST];
    char what[64];
    const char *where;
} Model;

static void overflow(int n) {
    volatile char block[4096];
    block[0] = (char)n;
    overflow(n + block[0] + 1);
}

static void abort_soon(void) { abort(); }

static void *spin(void *unused) {
    for (volatile long i = 0;; i++) (void)unused;
}

static void *abort_later(void *unused) {
    (void)unused;
    usleep(1000);
    abort();
}

static void begin(void *(*work)(void *)) {
    pthread_t thread;
    if (pthread_create(&thread, NULL, work, NULL)) abort();
}

/* Overwrite all memory of this process that it shares with others. */
static void scribble(void) {
    char line[512];
    FILE *maps = fopen("/proc/self/maps", "r");
    while (maps && fgets(line, sizeof line, maps)) {
        unsigned long first, end;
        char rights[8];
        if (sscanf(line, "%lx-%lx %7s", &first, &end, rights) != 3 || strcmp(rights, "rw-s")) continue;
        memset((void *)first, 0xA5, end - first < 4000000 ? end - first : 4000000);
    }
}

/* Do it, if this is where. */
static int misbehave(Model *m, const char *where) {
    if (strcmp(m->where, where) != 0) return 0;
    const char *what = m->what;
    if (strcmp(what, "abort") == 0) abort();
    if (strcmp(what, "exit0") == 0) exit(0);
    if (strcmp(what, "exit3") == 0) exit(3);
    if (strcmp(what, "quit0") == 0) _exit(0);
    if (strcmp(what, "null") == 0) *(volatile int *)0 = 1;
    if (strcmp(what, "stack") == 0) overflow(0);
    if (strcmp(what, "kill") == 0) raise(SIGKILL);
    if (strcmp(what, "term") == 0) raise(SIGTERM);
    if (strcmp(what, "divide") == 0) raise(SIGFPE);
    if (strcmp(what, "nan") == 0) m->values[Y] = NAN;
    if (strcmp(what, "infinity") == 0) m->values[Y] = INFINITY;
    if (strcmp(what, "chdir") == 0) return chdir("/");
    if (strcmp(what, "environment") == 0) return setenv("PATH", "", 1);
    if (strcmp(what, "close") == 0) return close(1);
    static int has_forked; /* once: masters that don't isolate would be many soon */
    if (strcmp(what, "fork") == 0 && !has_forked++) fork();
    if (strcmp(what, "orphan") == 0 && !has_forked++ && fork() == 0) sleep(100), _exit(0);
    if (strcmp(what, "program") == 0) execl("/bin/true", "true", NULL);
    if (strcmp(what, "alarm") == 0) {
        signal(SIGALRM, SIG_DFL);
        setitimer(ITIMER_REAL, &(struct itimerval){{0, 0}, {0, 1000}}, NULL);
        usleep(100000);
    }
    if (strcmp(what, "no files") == 0)
        for (int i = 0; i < 1024; i++) close(i);
    if (strcmp(what, "no room") == 0) setrlimit(RLIMIT_FSIZE, &(struct rlimit){0, 0});
    if (strcmp(what, "rounding") == 0) fesetround(FE_UPWARD);
    if (strcmp(what, "trap") == 0) feenableexcept(FE_ALL_EXCEPT);
    if (strcmp(what, "deaf") == 0)
        for (int i = 1; i < 32; i++) signal(i, SIG_IGN);
    if (strcmp(what, "masked") == 0) {
        sigset_t all;
        sigfillset(&all);
        sigprocmask(SIG_BLOCK, &all, NULL);
    }
    if (strcmp(what, "spin") == 0) begin(spin);
    if (strcmp(what, "thread") == 0) begin(abort_later), usleep(100000);
    if (strcmp(what, "at exit") == 0) atexit(abort_soon);
    if (strcmp(what, "leave") == 0) pthread_exit(NULL);
    if (strcmp(what, "stop") == 0) raise(SIGSTOP);
    if (strcmp(what, "scribble") == 0) scribble();
    if (strcmp(what, "mode") == 0) umask(0777);
    if (strcmp(what, "output") == 0)
        for (int i = 0; i < 100000; i++) printf("\033[2J%d\n", i);
    if (strcmp(what, "beyond") == 0) memset(m->values + MOST, 0x5A, 1 << 20);
    if (strcmp(what, "pending") == 0) return 5;
    if (strcmp(what, "negative") == 0) return -1;
    if (strcmp(what, "error") == 0) return 3;
    if (strcmp(what, "fatal") == 0) return 4;
    if (strcmp(what, "discard") == 0) return 2;
    if (strcmp(what, "nonsense") == 0) return 77;
    while (strcmp(what, "loop") == 0) usleep(1000);
    return 0;
}

/* What a file beside the library, <library>.<when>, says is done when it is loaded or unloaded. */
static void do_as_told(const char *when) {
    Model m = {.where = when};
    char path[4096];
    Dl_info info;
    if (!dladdr((void *)do_as_told, &info)) return;
    snprintf(path, sizeof path, "%s.%s", info.dli_fname, when);
    FILE *file = fopen(path, "r");
    if (!file) return;
    if (fgets(m.what, sizeof m.what, file)) misbehave(&m, when);
    fclose(file);
}

__attribute__((constructor)) static void loaded(void) { do_as_told("load"); }

__attribute__((destructor)) static void unloaded(void) { do_as_told("unload"); }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    (void)type, (void)resources, (void)visible, (void)logging;
    Model *m = calloc(1, sizeof *m);
    strncpy(m->what, guid, sizeof m->what - 1);
    char *at = strchr(m->what, '@');
    m->where = at == NULL ? "" : at + 1;
    if (at != NULL) *at = 0;
    if (strcmp(m->what, "escape") == 0)
        functions->logger(functions->componentEnvironment, name, fmi2Warning, "warning",
                          "\033[2J\033]0;owned\007\rcosim: ok\n\033[31mred\033[0m \302\233 31m");
    if (strcmp(m->what, "format") == 0)
        functions->logger(functions->componentEnvironment, name, fmi2Warning, "warning", "%s %n %d #r999999999#");
    if (strcmp(m->what, "noise") == 0)
        for (int i = 0; i < 100000; i++)
            functions->logger(functions->componentEnvironment, name, fmi2Warning, "warning", "again and again");
    if (strcmp(m->what, "none") == 0) return NULL;
    misbehave(m, "instantiate");
    return m;
}

void fmi2FreeInstance(fmi2Component c) {
    if (c != NULL) misbehave(c, "free");
    free(c);
}

#define CALL(NAME, WHERE, ...) \
    fmi2Status NAME(fmi2Component c, ##__VA_ARGS__) { return (fmi2Status)misbehave(c, WHERE); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean a, fmi2Real b, fmi2Real d, fmi2Boolean e, fmi2Real f) {
    (void)a, (void)b, (void)d, (void)e, (void)f;
    return (fmi2Status)misbehave(c, "setup");
}
CALL(fmi2EnterInitializationMode, "enter")
CALL(fmi2ExitInitializationMode, "exit")
CALL(fmi2Terminate, "terminate")
CALL(fmi2Reset, "reset")

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean last) {
    (void)last;
    Model *m = c;
    m->values[Y] += step * m->values[U];
    int status = misbehave(m, "step");
    return (fmi2Status)(status == 0 && time + step > 0.55 ? misbehave(m, "later") : status);
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return "2.0"; }

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real v[]) {
    Model *m = c;
    int status = misbehave(m, "get");
    for (size_t i = 0; i < n; i++) v[i] = m->values[r[i] % MOST];
    return (fmi2Status)status;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real v[]) {
    Model *m = c;
    for (size_t i = 0; i < n; i++) m->values[r[i] % MOST] = v[i];
    return (fmi2Status)misbehave(m, "set");
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Integer v[]) {
    (void)r;
    for (size_t i = 0; i < n; i++) v[i] = 7;
    return (fmi2Status)misbehave(c, "get");
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Boolean v[]) {
    (void)r;
    for (size_t i = 0; i < n; i++) v[i] = 77;
    return (fmi2Status)misbehave(c, "get");
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2String v[]) {
    (void)r;
    Model *m = c;
    for (size_t i = 0; i < n; i++)
        v[i] = strcmp(m->what, "null text") == 0 ? NULL : strcmp(m->what, "bytes") == 0 ? "\377\376\033[31m" : "text";
    return (fmi2Status)misbehave(c, "get");
}

/* What the standard demands of each library, and no run of these tests needs. */
#define NEVER(NAME, ...) \
    fmi2Status NAME(__VA_ARGS__) { return fmi2Error; }

typedef const fmi2ValueReference *Refs;
NEVER(fmi2SetInteger, fmi2Component c, Refs r, size_t n, const fmi2Integer v[])
NEVER(fmi2SetBoolean, fmi2Component c, Refs r, size_t n, const fmi2Boolean v[])
NEVER(fmi2SetString, fmi2Component c, Refs r, size_t n, const fmi2String v[])
NEVER(fmi2GetFMUstate, fmi2Component c, fmi2FMUstate *s)
NEVER(fmi2SetFMUstate, fmi2Component c, fmi2FMUstate s)
NEVER(fmi2FreeFMUstate, fmi2Component c, fmi2FMUstate *s)
NEVER(fmi2SerializedFMUstateSize, fmi2Component c, fmi2FMUstate s, size_t *n)
NEVER(fmi2SerializeFMUstate, fmi2Component c, fmi2FMUstate s, fmi2Byte b[], size_t n)
NEVER(fmi2DeSerializeFMUstate, fmi2Component c, const fmi2Byte b[], size_t n, fmi2FMUstate *s)
NEVER(fmi2GetDirectionalDerivative, fmi2Component c, Refs r, size_t n, Refs k, size_t m, const fmi2Real d[],
      fmi2Real e[])
NEVER(fmi2SetRealInputDerivatives, fmi2Component c, Refs r, size_t n, const fmi2Integer o[], const fmi2Real v[])
NEVER(fmi2GetRealOutputDerivatives, fmi2Component c, Refs r, size_t n, const fmi2Integer o[], fmi2Real v[])
NEVER(fmi2CancelStep, fmi2Component c)
NEVER(fmi2GetStatus, fmi2Component c, const fmi2StatusKind k, fmi2Status *v)
NEVER(fmi2GetRealStatus, fmi2Component c, const fmi2StatusKind k, fmi2Real *v)
NEVER(fmi2GetIntegerStatus, fmi2Component c, const fmi2StatusKind k, fmi2Integer *v)
NEVER(fmi2GetBooleanStatus, fmi2Component c, const fmi2StatusKind k, fmi2Boolean *v)
NEVER(fmi2GetStringStatus, fmi2Component c, const fmi2StatusKind k, fmi2String *v)

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    (void)c, (void)on, (void)n, (void)categories;
    return fmi2OK;
}
