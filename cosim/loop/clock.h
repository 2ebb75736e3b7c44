/* A clock that only goes on. */
#ifndef CLOCK_H
#define CLOCK_H

#include <stdint.h>

#ifdef _WIN32
#include <windows.h>

/* ns, from some moment on. */
static inline int64_t nanoseconds(void) {
    LARGE_INTEGER count, frequency;
    QueryPerformanceCounter(&count);
    QueryPerformanceFrequency(&frequency);
    return (int64_t)((double)count.QuadPart / (double)frequency.QuadPart * 1e9);
}
#else
#include <time.h>

static inline int64_t nanoseconds(void) {
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (int64_t)time.tv_sec * 1000000000 + time.tv_nsec;
}
#endif

#endif
