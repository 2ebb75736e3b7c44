/* A last line on stderr where an FMU ends the process that it runs in: by a crash, or by exit().
 *
 * Handlers of signals are there only while `watch_calls` says so. They say what they know and then put the one before
 * them back and have the signal delivered again, so that core dumps, faulthandler and the exit status stay what they are. */
#ifndef _WIN32
#define _XOPEN_SOURCE 700
#endif

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#include <io.h>
#include <process.h>
#include <windows.h>
#define getpid _getpid
#define write(file, text, size) _write(file, text, (unsigned)(size))
#else
#include <pthread.h>
#include <signal.h>
#include <unistd.h>
#endif

#include "current_calls.h"

/* Exit status of a process that an FMU has ended by exit(): an internal error, by sysexits.h. */
enum { STATUS_OF_EXIT = 70 };

/* What follows every last line, and what an FMU has called; on Windows abort() ends as exit() does. */
#ifdef _WIN32
#define REMEDY "ask its supplier"
#define ENDING "exit() or abort()"
#else
#define REMEDY "ask its supplier; isolated FMUs leave what was recorded (--isolated, isolate=True)"
#define ENDING "exit()"
#endif

static CurrentCalls own;
static CurrentCalls *all = &own;
static int (*python_runs)(void);

static uint64_t this_thread(void) {
#ifdef _WIN32
    return GetCurrentThreadId();
#else
    pthread_t own = pthread_self();
    uint64_t number = 0;
    memcpy(&number, &own, sizeof own < sizeof number ? sizeof own : sizeof number);
    return number;
#endif
}

/* The call that is going on in this thread, else one of another thread if `any`, else NULL. */
static const CurrentCall *current_call(const CurrentCalls *calls, uint64_t thread, bool any) {
    const CurrentCall *other = NULL;
    for (int i = 0; i < N_CALLS; i++) {
        const CurrentCall *call = &calls->calls[i];
        if (!call->thread || !call->code) continue;
        if (call->thread == thread) return call;
        other = call;
    }
    return any ? other : NULL;
}

/* Write a line that says by which call the process ends, and how; its length. */
static size_t say(const CurrentCalls *calls, const CurrentCall *call, const char *what, const char *how, char *text,
                  size_t size) {
    char when[64] = "";
    if (isfinite(call->time)) snprintf(when, sizeof when, " at t = %.9g s", call->time);
    const char *function = calls->functions[call->code % N_FUNCTIONS];
    const char *component = calls->components[call->code / N_FUNCTIONS % N_COMPONENTS];
    int n = snprintf(text, size, "cosim: %s %s in %s%s: %s\n", *component ? component : "an FMU", what,
                     *function ? function : "a call", when, how);
    return n < 0 ? 0 : (size_t)n < size ? (size_t)n : size - 1;
}

static void explain(const CurrentCall *call, const char *what, const char *how) {
    char text[1024];
    size_t n = say(all, call, what, how, text, sizeof text);
    all->told = 1;
    if (write(2, text, n) < 0) return; /* there is nowhere to say it */
}

/* For a process that has mapped the calls of one that has ended without a word: the line, empty if it called no FMU. */
EXPORT size_t say_how_it_ended(const CurrentCalls *calls, const char *what, const char *how, char *text, size_t size) {
    const CurrentCall *call = current_call(calls, 0, true);
    *text = 0;
    return call && !calls->told ? say(calls, call, what, how, text, size) : 0;
}

static void end_at_once(void) {
#ifdef _WIN32 /* where _exit(), within the end of the process, would wait for itself */
    TerminateProcess(GetCurrentProcess(), STATUS_OF_EXIT);
#else
    _exit(STATUS_OF_EXIT);
#endif
}

/* exit() while a thread is in a call: it comes from the FMU, and is no success whatever status it has. */
static void exiting(void) {
    if (all->process != (uint64_t)getpid() || !python_runs()) return; /* a child of the FMU; a usual end */
    const CurrentCall *call = current_call(all, this_thread(), false);
    if (!call) return;
    explain(call, "ended the process", "it called " ENDING ", which an FMU must not do; " REMEDY);
    fflush(NULL);
    end_at_once();
}

/* Begin to note calls, in other memory than that of this library if there is some; it must last as long as the process. */
EXPORT CurrentCalls *note_calls(CurrentCalls *elsewhere, int (*python_is_running)(void)) {
    if (!python_runs) atexit(exiting);
    python_runs = python_is_running;
    if (elsewhere) all = elsewhere;
    return all;
}

/* A place for the calls of this thread, and its number; -1 if there is none left. */
EXPORT int32_t take_place(void) {
    for (int32_t i = 0; i < N_CALLS; i++) {
        CurrentCall *call = &all->calls[i];
        uint64_t nobody = 0;
#ifdef __GNUC__
        if (!__atomic_compare_exchange_n(&call->thread, &nobody, this_thread(), false, __ATOMIC_SEQ_CST,
                                         __ATOMIC_SEQ_CST))
            continue;
#else
        if (InterlockedCompareExchange64((volatile LONG64 *)&call->thread, (LONG64)this_thread(), (LONG64)nobody))
            continue;
#endif
        call->code = 0;
        call->time = NAN;
        return i;
    }
    return -1;
}

CurrentCall *call_at(int32_t place) { return &all->calls[place]; }

void leave_place(int32_t place) {
    all->calls[place].code = 0;
#ifdef __GNUC__
    __atomic_store_n(&all->calls[place].thread, 0, __ATOMIC_SEQ_CST);
#else
    InterlockedExchange64((volatile LONG64 *)&all->calls[place].thread, 0);
#endif
}

#ifdef _WIN32
void have_spare_stack(bool begin) { (void)begin; }

/* A crash in a thread that Python has not called comes here; in one that it has called, ctypes makes it an OSError. */
static LPTOP_LEVEL_EXCEPTION_FILTER before;
static volatile LONG n_watching;

static LONG WINAPI crashed(EXCEPTION_POINTERS *pointers) {
    char how[256];
    snprintf(how, sizeof how, "exception 0x%08lx; the fault is in the FMU, " REMEDY,
             pointers->ExceptionRecord->ExceptionCode);
    const CurrentCall *call = all->told ? NULL : current_call(all, this_thread(), true);
    if (call)
        explain(call, call->thread == this_thread() ? "crashed" : "was at work when another thread crashed,", how);
    return before ? before(pointers) : EXCEPTION_CONTINUE_SEARCH;
}

EXPORT bool watch_calls(bool begin) {
    if (begin) {
        all->process = (uint64_t)getpid();
        if (InterlockedIncrement(&n_watching) == 1) before = SetUnhandledExceptionFilter(crashed);
    } else if (InterlockedDecrement(&n_watching) == 0) SetUnhandledExceptionFilter(before);
    return n_watching > 0;
}
#else
static const struct {
    int number;
    const char *text;
} signals[] = {
    {SIGSEGV, "segmentation fault (SIGSEGV)"}, {SIGBUS, "bus error (SIGBUS)"},    {SIGFPE, "arithmetic error (SIGFPE)"},
    {SIGILL, "illegal instruction (SIGILL)"},  {SIGABRT, "it aborted (SIGABRT)"},
};
enum { N_SIGNALS = sizeof signals / sizeof *signals };

/* A stack for the handler, where a thread has run out of its own. */
enum { SPARE_SIZE = 1 << 16 };
static __thread void *spare;
static __thread int n_watching_here;

void have_spare_stack(bool begin) {
    stack_t now;
    if (begin ? n_watching_here++ : n_watching_here == 0 || --n_watching_here) return;
    sigaltstack(NULL, &now);
    if (begin && (now.ss_flags & SS_DISABLE) && (spare = malloc(SPARE_SIZE)))
        sigaltstack(&(stack_t){.ss_sp = spare, .ss_size = SPARE_SIZE}, NULL);
    else if (!begin && spare) {
        if (now.ss_sp == spare) sigaltstack(&(stack_t){.ss_flags = SS_DISABLE, .ss_size = SPARE_SIZE}, NULL);
        free(spare);
        spare = NULL;
    }
}

static struct sigaction before[N_SIGNALS];
static pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;
static int n_watching;

static void crashed(int number, siginfo_t *info, void *context) {
    (void)context;
    char how[256] = "";
    for (int i = 0; i < N_SIGNALS; i++)
        if (signals[i].number == number) {
            sigaction(number, &before[i], NULL);
            snprintf(how, sizeof how, "%s; the fault is in the FMU, " REMEDY, signals[i].text);
        }
    const CurrentCall *call = all->told ? NULL : current_call(all, this_thread(), true);
    if (call && all->process == (uint64_t)getpid())
        explain(call, call->thread == this_thread() ? "crashed" : "was at work when another thread crashed,", how);
    if (info->si_code <= 0) raise(number); /* was sent; a fault comes again by itself */
}

/* Begin or end to watch for signals; calls may be nested, in any number of threads. Whether handlers are there then. */
EXPORT bool watch_calls(bool begin) {
    have_spare_stack(begin);
    pthread_mutex_lock(&mutex);
    bool changes = begin ? n_watching++ == 0 : --n_watching == 0;
    if (begin) all->process = (uint64_t)getpid();
    for (int i = 0; changes && i < N_SIGNALS; i++) {
        struct sigaction now;
        sigaction(signals[i].number, NULL, &now);
        bool is_ours = (now.sa_flags & SA_SIGINFO) && now.sa_sigaction == crashed;
        if (begin && !is_ours && ((now.sa_flags & SA_SIGINFO) || now.sa_handler != SIG_IGN)) {
            struct sigaction ours = {.sa_flags = SA_SIGINFO | SA_ONSTACK};
            ours.sa_sigaction = crashed;
            sigemptyset(&ours.sa_mask);
            before[i] = now;
            sigaction(signals[i].number, &ours, NULL);
        } else if (!begin && is_ours) sigaction(signals[i].number, &before[i], NULL); /* and no one's who came later */
    }
    bool watching = n_watching > 0;
    pthread_mutex_unlock(&mutex);
    return watching;
}
#endif

#define SIZE(name) {#name, (size_t)name}
#define OFFSET(type, field) {#type "." #field, offsetof(type, field)}

/* Numbers that current_calls.py has once more. */
static const struct {
    const char *name;
    size_t number;
} numbers[] = {
    SIZE(N_CALLS),
    SIZE(N_FUNCTIONS),
    SIZE(N_COMPONENTS),
    SIZE(FUNCTION_SIZE),
    SIZE(COMPONENT_SIZE),
    SIZE(sizeof(CurrentCall)),
    SIZE(sizeof(CurrentCalls)),
    OFFSET(CurrentCall, time),
    OFFSET(CurrentCall, code),
    OFFSET(CurrentCalls, calls),
    OFFSET(CurrentCalls, functions),
    OFFSET(CurrentCalls, components),
    {NULL, 0},
};

EXPORT const void *current_calls_layout(void) { return numbers; }
