/* Calls of an FMU in any order, with any arguments, as bytes say: for a fuzzer, and for bytes drawn at random.
 *
 * Compile it with the sources of an FMU of FMI 2.0 or 3.0 (FMI_VERSION). `native_calls RESOURCES CALLS SEED` draws the bytes;
 * with -DFUZZER the entry is that of libFuzzer and AFL++, and the environment variable FMU_RESOURCES says where the resources are.
 * A model of the standard's state machine says which calls are forbidden: these must be errors with a message. What a call returns
 * as good must be finite. Anything else aborts, so that a fuzzer keeps the bytes, and a sanitiser's report stands alone. */
#include <math.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "model.h"
#if FMI_VERSION == 2
#include "fmi2Functions.h"
#define FMI(name) fmi2##name
#define WITH_SIZE(n)
#define GET_REAL fmi2GetReal
#define SET_REAL fmi2SetReal
typedef fmi2Component Fmu;
typedef fmi2FMUstate State;
typedef fmi2Boolean Flag;
#define GET_STATE fmi2GetFMUstate
#define SET_STATE fmi2SetFMUstate
#define FREE_STATE fmi2FreeFMUstate
#define STATE_SIZE fmi2SerializedFMUstateSize
#define STATE_TO_BYTES fmi2SerializeFMUstate
#define STATE_OF_BYTES fmi2DeSerializeFMUstate
#else
#include "fmi3Functions.h"
#define FMI(name) fmi3##name
#define WITH_SIZE(n) , n
#define GET_REAL fmi3GetFloat64
#define SET_REAL fmi3SetFloat64
typedef fmi3Instance Fmu;
typedef fmi3FMUState State;
typedef fmi3Boolean Flag;
#define GET_STATE fmi3GetFMUState
#define SET_STATE fmi3SetFMUState
#define FREE_STATE fmi3FreeFMUState
#define STATE_SIZE fmi3SerializedFMUStateSize
#define STATE_TO_BYTES fmi3SerializeFMUState
#define STATE_OF_BYTES fmi3DeserializeFMUState
#endif

enum { OK, WARNING, DISCARD, ERROR };
enum { N_VALUES = N_P + N_U + N_Y + N_X, MOST = 12, SLOTS = 3 };
/* SET_UP is after fmi2SetupExperiment. */
enum { NEW = 1, INIT = 2, STEP = 4, EVENT = 8, CONT = 16, TERM = 32, DISC = 64, FAIL = 128, SET_UP = 256 };
enum { INST = NEW | SET_UP };
enum { RUN = STEP | EVENT | CONT, OVER = TERM | DISC | FAIL, ANY = INST | INIT | RUN | OVER };
enum { SEEN = (FMI_VERSION == 2 ? 0 : INST) | INIT | RUN | OVER }; /* where values can be got */

typedef struct {
    Fmu fmu;
    bool exchange;
    int phase;
    double time;
    State slots[SLOTS];
    int slot_phase[SLOTS];
    double slot_time[SLOTS];
} Instance;

static const uint8_t *bytes;
static size_t left;
static long calls, messages;
static char last[1024];
static const char *resources;

static unsigned take(void) { return left ? (left--, *bytes++) : 0; }

static void fail(const Instance *instance, const char *call, int status, const char *why) {
    fprintf(stderr, "%s: %s (status %d, %s, phase %d; last message: %s)\n", call, why, status,
            instance->exchange ? "model exchange" : "co-simulation", instance->phase, last);
    abort();
}

#if FMI_VERSION == 2
static void logger(void *environment, const char *name, fmi2Status status, const char *category, const char *text,
                   ...) {
    (void)environment, (void)name, (void)status, (void)category;
    va_list arguments;
    va_start(arguments, text);
    vsnprintf(last, sizeof last, text, arguments);
    va_end(arguments);
    messages++;
}
static const fmi2CallbackFunctions callbacks = {logger, calloc, free, NULL, NULL};
#else
static void logger(void *environment, fmi3Status status, const char *category, const char *text) {
    (void)environment, (void)status, (void)category;
    snprintf(last, sizeof last, "%s", text);
    messages++;
}
#endif

static Fmu instantiate(bool exchange) {
#if FMI_VERSION == 2
    return fmi2Instantiate("x", exchange ? fmi2ModelExchange : fmi2CoSimulation, MODEL_GUID, resources, &callbacks, 0,
                           1);
#else
    if (exchange) return fmi3InstantiateModelExchange("x", MODEL_GUID, resources, 0, 1, NULL, logger);
    return fmi3InstantiateCoSimulation("x", MODEL_GUID, resources, 0, 1, 0, 0, NULL, 0, NULL, logger, NULL);
#endif
}

/* What a call has returned, where it is allowed in some phases; the phase after it. */
static bool settle(Instance *instance, const char *call, int allowed, int status, long before) {
    calls++;
    bool forbidden = !(allowed & instance->phase);
    if (status < OK || status > ERROR) fail(instance, call, status, "no status");
    if (forbidden && status != ERROR) fail(instance, call, status, "a forbidden call is no error");
    if (status != OK && messages == before) fail(instance, call, status, "not a word of what is wrong");
    if (status == ERROR) instance->phase = FAIL;
    return status <= WARNING;
}

#define CALL(allowed, name, ...) \
    (before = messages, settle(instance, #name, allowed, (int)name(instance->fmu, __VA_ARGS__), before))
#define PLAIN(allowed, name) (before = messages, settle(instance, #name, allowed, (int)name(instance->fmu), before))

static void must_be_finite(const Instance *instance, const char *call, const double values[], size_t n) {
    for (size_t i = 0; i < n; i++)
        if (!isfinite(values[i])) fail(instance, call, OK, "a value that is not finite");
}

static double number(void) {
    static const double numbers[] = {0.0,  0.25, -0.5, 1.0,   2.0,  -3.0, 1e-3,
                                     30.0, 1e3,  -1e6, 1e300, -0.0, NAN,  INFINITY};
    unsigned which = take();
    return which < 200 ? numbers[which % 8] : numbers[which % (sizeof numbers / sizeof *numbers)];
}

static unsigned reference(void) {
    unsigned which = take() | take() << 8;
    if (which >= 65000) return which == 65535 ? 0xFFFFFFFFu : N_VALUES + which % (N_EVENTS + 3u);
    return which % N_VALUES;
}

/* References, and how many values they have: any, or neighbours such as all inputs. */
static size_t draw(unsigned references[MOST], size_t *n_values) {
    size_t n = take() % (MOST + 1), way = take() % 4;
    unsigned first = way == 0 ? N_P : way == 1 ? N_P + N_U : reference();
    if (way == 0) n = N_U < MOST ? N_U : MOST;
    if (way == 1) n = N_OUTPUTS < MOST ? N_OUTPUTS : MOST;
    *n_values = 0;
    for (size_t i = 0; i < n; i++) {
        references[i] = way < 3 ? first + (unsigned)i : reference();
#if ARRAYS
        *n_values += references[i] < N_VALUES ? model_lengths[references[i]] : 1;
#else
        *n_values += 1;
#endif
    }
#if FMI_VERSION == 3
    if (take() > 250) *n_values += 1;
#endif
    return n;
}

#define ROOM (MOST * N_VALUES + 2)

static void get_and_set(Instance *instance) {
    static double values[ROOM];
    static int32_t integers[ROOM];
    static int64_t wide[ROOM];
    static Flag flags[ROOM];
    static const char *texts[ROOM];
    unsigned references[MOST];
    size_t m, n = draw(references, &m);
    long before;
    (void)wide;
    memset(flags, 0, sizeof flags);
    for (size_t i = 0; i < m; i++) {
        values[i] = number();
        integers[i] = (int32_t)take() - 8, wide[i] = integers[i];
        flags[i] = take() % 2;
        texts[i] = take() > 250 ? NULL : "plain";
    }
    switch (take() % 10) {
        case 0:
        case 1:
        case 2:
            if (CALL(SEEN, GET_REAL, references, n, values WITH_SIZE(m))) must_be_finite(instance, "get", values, m);
            break;
        case 3:
        case 4:
        case 5:
            CALL(INST | INIT | RUN, SET_REAL, references, n, values WITH_SIZE(m));
            break;
#if FMI_VERSION == 2
        case 6:
            CALL(SEEN, fmi2GetInteger, references, n, integers);
            CALL(INST | INIT | RUN, fmi2SetInteger, references, n, integers);
            break;
        case 7:
            CALL(SEEN, fmi2GetBoolean, references, n, flags);
            CALL(INST | INIT | RUN, fmi2SetBoolean, references, n, flags);
            break;
#else
        case 6:
            CALL(SEEN, fmi3GetInt32, references, n, integers, m);
            CALL(INST | INIT | RUN, fmi3SetInt32, references, n, integers, m);
            CALL(SEEN, fmi3GetInt64, references, n, wide, m);
            CALL(INST | INIT | RUN, fmi3SetInt64, references, n, wide, m);
            break;
        case 7:
            CALL(SEEN, fmi3GetBoolean, references, n, flags, m);
            CALL(INST | INIT | RUN, fmi3SetBoolean, references, n, flags, m);
            break;
#endif
        case 8:
            if (CALL(SEEN, FMI(GetString), references, n, texts WITH_SIZE(m)))
                for (size_t i = 0; i < m; i++)
                    if (!texts[i] || strlen(texts[i]) > 10000) fail(instance, "get text", OK, "no text");
            break;
        default:
            CALL(INST | INIT | RUN, FMI(SetString), references, n, texts WITH_SIZE(m));
    }
}

static void derivatives(Instance *instance) {
    static double seeds[ROOM], results[ROOM];
    unsigned unknowns[MOST], knowns[MOST];
    size_t n_results, n_seeds, n = draw(unknowns, &n_results), m = draw(knowns, &n_seeds);
    int orders[MOST];
    long before;
    for (size_t i = 0; i < n_seeds; i++) seeds[i] = number();
    for (size_t i = 0; i < MOST; i++) orders[i] = (int)(take() % 5);
    switch (take() % 4) {
        case 0:
#if FMI_VERSION == 2
            CALL(INIT | STEP, fmi2SetRealInputDerivatives, knowns, m, orders, seeds);
            break;
#else
            if (CALL(INIT | RUN | OVER, fmi3GetAdjointDerivative, knowns, m, unknowns, n, seeds, n_seeds, results,
                     n_results))
                must_be_finite(instance, "adjoint", results, n_results);
            break;
#endif
        case 1:
            for (size_t i = 0; i < n; i++) orders[i] = orders[i] < 4 ? 1 : 2;
#if FMI_VERSION == 2
            if (CALL(STEP | OVER, fmi2GetRealOutputDerivatives, unknowns, n, orders, results))
#else
            if (CALL(STEP | OVER, fmi3GetOutputDerivatives, unknowns, n, orders, results, n_results))
#endif
                must_be_finite(instance, "output derivatives", results, n_results);
            break;
        default:
#if FMI_VERSION == 2
            if (CALL(INIT | RUN | OVER, fmi2GetDirectionalDerivative, unknowns, n, knowns, m, seeds, results))
#else
            if (CALL(INIT | RUN | OVER, fmi3GetDirectionalDerivative, unknowns, n, knowns, m, seeds, n_seeds, results,
                     n_results))
#endif
                must_be_finite(instance, "direction", results, n_results);
    }
}

static void life(Instance *instance) {
    static const double times[] = {0.0, 0.5, -1.0, NAN};
    double start = times[take() % 16 % 4 % (take() > 240 ? 4 : 3)], stop = take() > 200 ? start + 0.05 : 1e9;
    double tolerance = take() > 240 ? -1.0 : 1e-6;
    Flag has_tolerance = take() % 2, has_stop = take() % 2;
    long before;
    bool done;
    switch (take() % 8) {
        case 0:
        case 1:
        case 2:
#if FMI_VERSION == 2
            if (take() > 20 && CALL(INST, fmi2SetupExperiment, has_tolerance, tolerance, start, has_stop, stop))
                instance->time = start, instance->phase = SET_UP;
            done = PLAIN(SET_UP, fmi2EnterInitializationMode);
#else
            done = CALL(INST, fmi3EnterInitializationMode, has_tolerance, tolerance, start, has_stop, stop);
            if (done) instance->time = start;
#endif
            if (done) instance->phase = INIT;
            break;
        case 3:
        case 4:
        case 5:
            if (PLAIN(INIT, FMI(ExitInitializationMode))) instance->phase = instance->exchange ? EVENT : STEP;
            break;
        case 6:
            if (take() < 64 && PLAIN(RUN | (FMI_VERSION == 2 ? DISC : 0), FMI(Terminate))) instance->phase = TERM;
            break;
        default:
            if ((take() < 64 || instance->phase & OVER) && PLAIN(ANY, FMI(Reset)))
                instance->phase = NEW, instance->time = 0.0;
    }
}

static void states(Instance *instance) {
    int k = (int)(take() % SLOTS);
    long before;
    switch (take() % 6) {
        case 0:
        case 1:
            if (CALL(ANY, GET_STATE, &instance->slots[k]))
                instance->slot_phase[k] = instance->phase, instance->slot_time[k] = instance->time;
            break;
        case 2:
        case 3:
            if (CALL(ANY, SET_STATE, instance->slots[k]))
                instance->phase = instance->slot_phase[k], instance->time = instance->slot_time[k];
            break;
        case 4:
            CALL(ANY, FREE_STATE, &instance->slots[k]);
            break;
        default: {
            size_t size = 0, cut = take(), where = (take() | take() << 8);
            State read = NULL;
            if (!CALL(ANY, STATE_SIZE, instance->slots[k], &size)) return;
            char *data = malloc(size);
            if (CALL(ANY, STATE_TO_BYTES, instance->slots[k], (void *)data, size)) {
                if (cut > 200) data[where % size] = (char)(data[where % size] ^ (1 << cut % 8));
                if (CALL(ANY, STATE_OF_BYTES, (void *)data, cut == 199 ? size - 1 : size, &read)) {
                    if (cut > 200) fail(instance, "read a state", OK, "damaged bytes are a state");
                    if (CALL(ANY, SET_STATE, read))
                        instance->phase = instance->slot_phase[k], instance->time = instance->slot_time[k];
                }
                CALL(ANY, FREE_STATE, &read);
            }
            free(data);
        }
    }
}

static void step(Instance *instance) {
    static const double lengths[] = {1e-3, 1e-2, 0.05, 1e-6, 0.0, -1e-3, NAN, 1e308};
    unsigned which = take(), jump = take();
    double h = lengths[which < 240 ? which % 4 : which % 8], time = instance->time + (jump > 245   ? 0.3
                                                                                      : jump > 240 ? NAN
                                                                                                   : 0.0);
    long before;
#if FMI_VERSION == 2
    int status = (int)fmi2DoStep(instance->fmu, time, h, 1);
#else
    Flag flags[3];
    double reached;
    int status = (int)fmi3DoStep(instance->fmu, time, h, 1, &flags[0], &flags[1], &flags[2], &reached);
#endif
    before = status == OK ? messages : messages - 1;
    if (settle(instance, "step", STEP, status, before)) instance->time = time + h;
    if (status == OK && (jump > 240 || !(h > 0.0) || h > 1e300))
        fail(instance, "step", status, "a step that makes no sense");
    if (status == DISCARD && FMI_VERSION == 2) instance->phase = DISC;
}

static void exchange(Instance *instance) {
    static double x[N_X + N_EVENTS + 1];
    size_t n = take() > 250 ? N_X + 1 : N_X;
    Flag flags[6];
    double next;
    long before;
    switch (take() % 9) {
        case 0:
            if (PLAIN(EVENT | CONT, FMI(EnterEventMode))) instance->phase = EVENT;
            break;
        case 1:
            if (PLAIN(EVENT, FMI(EnterContinuousTimeMode))) instance->phase = CONT;
            break;
        case 2: {
#if FMI_VERSION == 2
            fmi2EventInfo info;
            (void)next;
            CALL(EVENT, fmi2NewDiscreteStates, &info);
#else
            CALL(EVENT, fmi3UpdateDiscreteStates, &flags[0], &flags[1], &flags[2], &flags[3], &flags[4], &next);
#endif
            break;
        }
        case 3:
            CALL(CONT, FMI(CompletedIntegratorStep), 1, &flags[0], &flags[1]);
            break;
        case 4: {
            double time = instance->time + (take() > 250 ? NAN : 1e-3 * take());
            if (CALL(EVENT | CONT, FMI(SetTime), time)) instance->time = time;
            break;
        }
        case 5:
            for (int i = 0; i < N_X; i++) x[i] = number();
            CALL(CONT, FMI(SetContinuousStates), x, n);
            break;
        case 6:
#if FMI_VERSION == 2
            if (CALL(EVENT | CONT | OVER, fmi2GetDerivatives, x, n))
#else
            if (CALL(INIT | EVENT | CONT | OVER, fmi3GetContinuousStateDerivatives, x, n))
#endif
                must_be_finite(instance, "derivatives", x, N_X);
            break;
        case 7:
            if (CALL(INIT | EVENT | CONT | OVER, FMI(GetContinuousStates), x, n))
                must_be_finite(instance, "states", x, N_X);
            break;
        default:
            if (CALL(INIT | EVENT | CONT | OVER, FMI(GetEventIndicators), x, N_EVENTS))
                must_be_finite(instance, "indicators", x, N_EVENTS);
    }
}

static void one_call(Instance *instance) {
    unsigned which = take();
    if (instance->phase & OVER && which % 2) { /* back into life, or most calls would be forbidden */
        states(instance);
        return;
    }
    if (which < 50) life(instance);
    else if (which < 120) get_and_set(instance);
    else if (which < 150) states(instance);
    else if (which < 175) derivatives(instance);
    else if (which < 220 && !instance->exchange) step(instance);
    else exchange(instance);
}

/* A life of two instances, as the bytes say. */
static void live(const uint8_t *data, size_t size) {
    Instance both[2] = {{.fmu = instantiate(false), .phase = NEW},
                        {.fmu = instantiate(true), .exchange = true, .phase = NEW}};
    bytes = data, left = size;
    if (!both[0].fmu || !both[1].fmu) fail(&both[0], "instantiate", ERROR, "no instance");
    while (left) one_call(&both[take() % 3 == 0]);
    for (int i = 0; i < 2; i++) {
        for (int k = 0; k < SLOTS; k++) FREE_STATE(both[i].fmu, &both[i].slots[k]);
        FMI(FreeInstance)(both[i].fmu);
    }
}

#ifdef FUZZER
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    resources = getenv("FMU_RESOURCES");
    live(data, size);
    return 0;
}
#else
int main(int argc, char *argv[]) {
    if (argc != 4) return 2;
    resources = argv[1];
    long most = atol(argv[2]);
    uint64_t random = strtoull(argv[3], NULL, 10) * 2862933555777941757u + 3037000493u;
    static uint8_t data[16384];
    while (calls < most) {
        for (size_t i = 0; i < sizeof data; i++) {
            random = random * 6364136223846793005u + 1442695040888963407u;
            data[i] = (uint8_t)(random >> 33);
        }
        live(data, sizeof data);
    }
    printf("%ld calls, %ld messages\n", calls, messages);
    return 0;
}
#endif
