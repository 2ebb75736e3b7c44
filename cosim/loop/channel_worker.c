/* The worker's side of a channel: makes the calls that the master asks for, without Python, and passes on what the FMU
 * says. A process has one FMU, and one instance of it. */
#ifndef _WIN32
#define _GNU_SOURCE
#include "channel_sides.h"
#include "core.h"
#include "loop.h"

#include <pthread.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#ifdef __linux__
#include <sys/prctl.h>
#endif

typedef uintptr_t
    Word; /* integers, truth values and pointers are passed alike by all platforms that FMUs are built for */

static Channel *channel;
static uint64_t capacity; /* of its area */
static void *const *functions;
static void *instance;

/* Whether this process is a copy that the FMU has made of its own by fork(): only the first one answers. */
static bool is_copy;

static void note_copy(void) { is_copy = true; }

static void end_copies(void) {
    if (is_copy) _exit(0);
}

/* Messages */

static pthread_mutex_t one_speaks = PTHREAD_MUTEX_INITIALIZER;

static void write_message(const void *bytes, uint64_t size, uint64_t at) {
    uint64_t first = at % MESSAGES_SIZE, whole = MESSAGES_SIZE - first;
    if (whole > size) whole = size;
    memcpy(channel->messages + first, bytes, whole);
    memcpy(channel->messages, (const char *)bytes + whole, size - whole);
}

/* Pass a message on, from whichever thread of the FMU; where there is no room the master makes some. */
static void pass_on(void *environment, const char *name, int status, const char *category, const char *text) {
    (void)environment, (void)name;
    enum { LONGEST_CATEGORY = 255, LONGEST_TEXT = 8191 };
    Message message = {.status = status, .call = channel->at};
    message.category_size = category ? (uint32_t)strnlen(category, LONGEST_CATEGORY) : 0;
    message.text_size = text ? (uint32_t)strnlen(text, LONGEST_TEXT) : 0;
    uint64_t size = sizeof message + message.category_size + message.text_size;
    pthread_mutex_lock(&one_speaks);
    uint64_t at = channel->written;
    while (at + size - __atomic_load_n(&channel->read, __ATOMIC_SEQ_CST) > MESSAGES_SIZE) {
        wake_at(&channel->answered);
        nanosleep(&(struct timespec){0, 1000000}, NULL);
    }
    write_message(&message, sizeof message, at);
    write_message(category, message.category_size, at + sizeof message);
    write_message(text, message.text_size, at + sizeof message + message.category_size);
    __atomic_store_n(&channel->written, at + size, __ATOMIC_SEQ_CST);
    pthread_mutex_unlock(&one_speaks);
}

static void log_of_fmi3(void *environment, int status, const char *category, const char *text) {
    pass_on(environment, NULL, status, category, text);
}

/* Instances */

typedef void Logger(void *, const char *, int, const char *, const char *, ...);
typedef void UpdateOfFmi3(void *, double, bool, bool, bool, bool, bool *, double *);

typedef struct {
    Logger *logger;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void *step_finished, *environment;
} Callbacks2;

typedef struct {
    Logger *logger;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void *step_finished;
} Callbacks1;

static const Callbacks2 callbacks2 = {log_message, calloc, free, NULL, NULL};
static const Callbacks1 callbacks1 = {log_message, calloc, free, NULL};

/* What answers when the FMU asks for its inputs during a step, as intermediate_update wants it. */
static const Operation *asking;

/* A text that stays: some FMUs keep the address. */
static const char *kept(Word text) { return text ? strdup((const char *)text) : NULL; }

static bool instantiate(int function, void *make, const Word word[]) {
    const char *name = kept(word[0]), *second = kept(word[1]), *third = kept(word[2]);
    switch (function) {
        case N_fmi1InstantiateSlave:
            instance =
                ((void *(*)(const char *, const char *, const char *, const char *, double, char, char, Callbacks1,
                            char))make)(name, second, third, kept(word[3]), 0.0, 0, 0, callbacks1, 1);
            break;
        case N_fmi2Instantiate:
            instance = ((void *(*)(const char *, int, const char *, const char *, const Callbacks2 *, int, int))make)(
                name, (int)word[3], second, third, &callbacks2, 0, 1);
            break;
        case N_fmi3InstantiateCoSimulation:
            instance =
                ((void *(*)(const char *, const char *, const char *, bool, bool, bool, bool, const uint32_t *, size_t,
                            void *, void (*)(void *, int, const char *, const char *), UpdateOfFmi3 *))make)(
                    name, second, third, false, true, word[3], word[3], (const uint32_t *)word[4], word[5], &asking,
                    log_of_fmi3, word[5] ? intermediate_update : NULL);
            break;
        default:
            instance = ((void *(*)(const char *, const char *, const char *, bool, bool, void *,
                                   void (*)(void *, int, const char *, const char *)))make)(name, second, third, false,
                                                                                            true, &asking, log_of_fmi3);
    }
    return instance != NULL;
}

/* Calls */

static int call_with_integers(void *f, int n, const Word w[]) {
    switch (n) {
        case 0:
            return ((int (*)(void *))f)(instance);
        case 1:
            return ((int (*)(void *, Word))f)(instance, w[0]);
        case 2:
            return ((int (*)(void *, Word, Word))f)(instance, w[0], w[1]);
        case 3:
            return ((int (*)(void *, Word, Word, Word))f)(instance, w[0], w[1], w[2]);
        case 4:
            return ((int (*)(void *, Word, Word, Word, Word))f)(instance, w[0], w[1], w[2], w[3]);
        case 5:
            return ((int (*)(void *, Word, Word, Word, Word, Word))f)(instance, w[0], w[1], w[2], w[3], w[4]);
        case 6:
            return ((int (*)(void *, Word, Word, Word, Word, Word, Word))f)(instance, w[0], w[1], w[2], w[3], w[4],
                                                                            w[5]);
        default:
            return ((int (*)(void *, Word, Word, Word, Word, Word, Word, Word, Word))f)(instance, w[0], w[1], w[2],
                                                                                        w[3], w[4], w[5], w[6], w[7]);
    }
}

/* Call a function with n arguments after the instance; in `doubles` the bit of each that is one. */
static int call_with(void *f, int n, uint32_t doubles, const Word w[], const double d[]) {
    enum { TIME = 1, STEP_FROM = 3, FROM_TO = 5, TOLERANCE_FROM_TO = 22 };
    switch (doubles) {
        case TIME:
            return ((int (*)(void *, double))f)(instance, d[0]);
        case STEP_FROM:
            if (n == 3) return ((int (*)(void *, double, double, Word))f)(instance, d[0], d[1], w[2]);
            return ((int (*)(void *, double, double, Word, Word, Word, Word, Word))f)(instance, d[0], d[1], w[2], w[3],
                                                                                      w[4], w[5], w[6]);
        case FROM_TO:
            return ((int (*)(void *, double, Word, double))f)(instance, d[0], w[1], d[2]);
        case TOLERANCE_FROM_TO:
            return ((int (*)(void *, Word, double, double, Word, double))f)(instance, w[0], d[1], d[2], w[3], d[4]);
        default:
            return call_with_integers(f, n, w);
    }
}

/* Pointers to texts or binary values, which no more than one argument of a function is. */
static void **pointers(uint64_t n) {
    static void **room;
    static uint64_t size;
    if (n > size) {
        room = realloc(room, n * sizeof *room);
        if (!room) abort();
        size = n;
    }
    memset(room, 0, n * sizeof *room);
    return room;
}

static void **texts_at(char *bytes, uint64_t n) {
    void **texts = pointers(n);
    for (uint64_t i = 0; i < n; bytes += strlen(bytes) + 1, i++) texts[i] = bytes;
    return texts;
}

static void **blobs_at(char *bytes, const size_t sizes[], uint64_t n) {
    void **blobs = pointers(n);
    for (uint64_t i = 0; i < n; bytes += sizes[i], i++) blobs[i] = bytes;
    return blobs;
}

/* Put what the FMU has given behind the call; false where there is no room. */
static bool give_back(uint64_t at, void **values, const size_t sizes[], uint64_t n) {
    for (uint64_t i = 0; i < n; i++) {
        uint64_t size = !values[i] ? 0 : sizes ? sizes[i] : strlen(values[i]);
        if (size > capacity || at + sizeof size + size > capacity) return false;
        memcpy(channel->area + at, &size, sizeof size);
        memcpy(channel->area + at + sizeof size, values[i] ? values[i] : "", size);
        at += sizeof size + size;
    }
    channel->reach = at;
    return true;
}

/* What answers for inputs during a step: operations on the numbers beside its call. */
static void answer_for(uint8_t *bytes[], int n, Extrapolated inputs[], Operation operations[]) {
    for (int k = 0; k < n; k++) {
        const Inputs *given = (const Inputs *)bytes[k];
        double *numbers = (double *)(bytes[k] + sizeof *given);
        inputs[k] = (Extrapolated){.time = given->time, .degree = given->degree, .refused = given->refused};
        inputs[k].history = numbers;
        inputs[k].derivatives = numbers + given->n;
        inputs[k].buffer = inputs[k].derivatives + (int64_t)given->degree * given->n;
        operations[k] = (Operation){.kind = EXTRAPOLATE, .version = 3, .more = k + 1 < n, .n = given->n};
        operations[k].n_references = given->n_references;
        operations[k].references = (const uint32_t *)(inputs[k].buffer + given->n);
        operations[k].function = functions[N_fmi3SetFloat64];
        operations[k].instance = instance;
        operations[k].data = &inputs[k];
    }
    asking = n ? operations : NULL;
}

static void make_call(Call *call) {
    const Argument *argument = (const Argument *)(call + 1);
    Word word[MOST_ARGUMENTS];
    double number[MOST_ARGUMENTS];
    uint32_t doubles = 0;
    int n = 0, n_beside = 0;
    uint8_t *beside[MOST_ARGUMENTS];
    void **given_back = NULL;
    const size_t *sizes = NULL;
    uint64_t n_given_back = 0;
    for (uint32_t i = 0; i < call->n_arguments; i++, argument++) {
        uint8_t *bytes = channel->area + argument->value;
        word[n] = (Word)bytes;
        switch ((Passing)argument->passing) {
            case INTEGER:
                word[n] = (Word)argument->value;
                break;
            case DOUBLE:
                memcpy(&number[n], &argument->value, sizeof(double));
                doubles |= 1u << n;
                break;
            case ABSENT:
                word[n] = 0;
                break;
            case GIVEN:
            case FILLED:
                break;
            case TEXTS:
                word[n] = (Word)texts_at((char *)bytes, argument->n);
                break;
            case BLOBS:
                word[n] = (Word)blobs_at((char *)bytes, (const size_t *)word[n - 1], argument->n);
                break;
            case TEXTS_BACK:
            case BLOBS_BACK:
                given_back = pointers(argument->n);
                n_given_back = argument->n;
                sizes = argument->passing == BLOBS_BACK ? (const size_t *)word[n - 1] : NULL;
                word[n] = (Word)given_back;
                break;
            case BESIDE:
                beside[n_beside++] = bytes;
                continue;
        }
        n++;
    }
    void *function = functions[call->function];
    if (call->function <= N_fmi3InstantiateModelExchange) {
        bool made = instantiate((int)call->function, function, word);
        end_copies();
        call->result = made;
        call->status = 0;
        return;
    }
    Extrapolated inputs[MOST_ARGUMENTS];
    Operation operations[MOST_ARGUMENTS];
    if (n_beside) answer_for(beside, n_beside, inputs, operations);
    int status = call_with(function, n, doubles, word, number);
    end_copies();
    call->status = status;
    asking = NULL;
    for (int k = 0; k < n_beside; k++) ((Inputs *)beside[k])->refused = inputs[k].refused;
    if (call->function == N_fmi1FreeSlaveInstance || call->function == N_fmi2FreeInstance ||
        call->function == N_fmi3FreeInstance)
        call->status = 0; /* they return nothing */
    if (given_back) call->result = give_back(call->end, given_back, sizes, n_given_back);
}

static void make_calls(uint64_t n) {
    Call *call = (Call *)channel->area;
    for (uint64_t k = 0; k < n; k++) {
        channel->at = (uint32_t)k;
        make_call(call);
        if (call->status < 0 || call->status > 1) return; /* worse than a warning */
        call = (Call *)(channel->area + call->end);
    }
}

/* Be where the master is. Threads that the FMU makes meanwhile would have to stay there, too: then this is given up. */
static void be_with_master(void) {
    enum { LOOKED_AT_EVERY = 4096 };
    static bool is_given_up;
    static uint32_t calls;
    if (core_kept() >= 0 && ++calls % LOOKED_AT_EVERY == 0 && core_has_been_inherited()) is_given_up = true;
    core_stay_on(is_given_up ? -1 : channel->core);
}

/* Tell the master that what it asked for first, the loading of the FMU, is done. */
EXPORT void channel_answer(Channel *own) { tell(&own->answered, own->asked, &own->master_sleeps); }

/* Make the calls that come over a channel with an area of this size, until there are to be no more. */
EXPORT void channel_serve(Channel *own, uint64_t size, void *const functions_of_fmu[]) {
    channel = own;
    capacity = size;
    functions = functions_of_fmu;
    log_to(pass_on);
    pthread_atfork(NULL, NULL, note_copy);
    uint32_t before = channel->asked;
    Patience patience = {0};
    channel_answer(channel);
    for (;;) {
        patience.longest = channel->spin; /* the master may say so after this has begun */
        if (!changes_soon(&channel->asked, before, &patience)) {
            __atomic_store_n(&channel->worker_sleeps, 1, __ATOMIC_SEQ_CST);
            while (seen(&channel->asked) == before) sleep_at(&channel->asked, before, (int64_t)1000000000);
            __atomic_store_n(&channel->worker_sleeps, 0, __ATOMIC_SEQ_CST);
        }
        before = seen(&channel->asked);
        uint64_t n = channel->n_calls;
        be_with_master();
        channel->reach = channel->used;
        if (n) make_calls(n);
        tell(&channel->answered, before, &channel->master_sleeps);
        if (!n) return;
    }
}

static void *wait_for_end(void *file) {
    char byte;
    while (read((int)(intptr_t)file, &byte, 1) > 0) continue;
    kill(-getpid(), SIGKILL); /* with what the FMU has started: this process leads a group */
    kill(getpid(), SIGKILL);
    return NULL;
}

/* Have this process end with the one that holds the other end of a pipe; false where that can't be. */
EXPORT bool channel_end_with(int file) {
    pthread_t thread;
    sigset_t all, before;
    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &before); /* signals are for the thread of the FMU */
    bool made = !pthread_create(&thread, NULL, wait_for_end, (void *)(intptr_t)file) && !pthread_detach(thread);
    pthread_sigmask(SIG_SETMASK, &before, NULL);
    return made;
}
#endif
