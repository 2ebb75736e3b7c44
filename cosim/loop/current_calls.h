/* What each thread calls of an FMU at this moment, in memory that can be read when the process ends by that call. */
#ifndef CURRENT_CALLS_H
#define CURRENT_CALLS_H

#include <stdbool.h>
#include <stdint.h>

#ifndef EXPORT
#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
#endif

enum { N_CALLS = 256, N_FUNCTIONS = 256, N_COMPONENTS = 4096, FUNCTION_SIZE = 64, COMPONENT_SIZE = 256 };

/* The call of a thread. Its code is N_FUNCTIONS times the number of the component plus that of the function; 0 for none. */
typedef struct {
    uint64_t thread; /* 0: the place is free */
    double time; /* s, of the communication point; NaN outside a run */
    uint32_t code, padding;
} CurrentCall;

/* All of them, without pointers: another process may map it, too. current_calls.py lays it out once more. */
typedef struct {
    uint64_t process; /* whose calls these are */
    uint64_t told; /* whether the end of the process has been explained */
    uint64_t finished; /* whether its work is done; for the process that watches it */
    CurrentCall calls[N_CALLS];
    char functions[N_FUNCTIONS][FUNCTION_SIZE];
    char components[N_COMPONENTS][COMPONENT_SIZE];
} CurrentCalls;

/* A place for the calls of this thread, and its number; -1 if there is none left. A thread in C leaves it at its end. */
EXPORT int32_t take_place(void);
CurrentCall *call_at(int32_t place);
void leave_place(int32_t place);

/* Give this thread a stack for the handlers of signals, or take it back; a thread that watches has one. */
void have_spare_stack(bool begin);

/* Begin or end to watch for signals; calls may be nested, in any number of threads. Whether handlers are there then. */
EXPORT bool watch_calls(bool begin);

#endif
