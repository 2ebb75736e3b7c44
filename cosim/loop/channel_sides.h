/* What both sides of a channel do: count up, wait, sleep. */
#ifndef CHANNEL_SIDES_H
#define CHANNEL_SIDES_H

#include "channel.h"
#include "clock.h"

#include <time.h>

#ifdef __linux__
#include <linux/futex.h>
#include <sys/syscall.h>
#include <unistd.h>
#endif

#define ALIGNED(size) (((size) + 15) & ~(uint64_t)15)

static inline uint32_t seen(const uint32_t *number) { return __atomic_load_n(number, __ATOMIC_SEQ_CST); }

static inline void rest(void) {
#if defined(__x86_64__) || defined(__i386__)
    __builtin_ia32_pause();
#elif defined(__aarch64__)
    __asm__ volatile("yield");
#endif
}

/* Sleep until a number is no longer the one given, or for so long (ns), or without a reason. */
static inline void sleep_at(uint32_t *number, uint32_t old, int64_t longest) {
    struct timespec time = {longest / 1000000000, longest % 1000000000};
#ifdef __linux__
    syscall(SYS_futex, number, FUTEX_WAIT, old, &time, NULL, 0);
#else /* no other platform lets two processes wait for memory */
    enum { SHORTEST = 20000 };
    for (int64_t part = SHORTEST; longest > 0 && seen(number) == old; longest -= part, part += part / 4) {
        time = (struct timespec){0, (long)part};
        nanosleep(&time, NULL);
    }
#endif
}

static inline void wake_at(uint32_t *number) {
#ifdef __linux__
    syscall(SYS_futex, number, FUTEX_WAKE, 1, NULL, NULL, 0);
#else
    (void)number;
#endif
}

/* Change a number, and wake who sleeps there. */
static inline void tell(uint32_t *number, uint32_t value, const uint32_t *sleeps) {
    __atomic_store_n(number, value, __ATOMIC_SEQ_CST);
    if (seen(sleeps)) wake_at(number);
}

/* For how long (ns) a side looks for the other before it sleeps: `longest`, or not at all where that has been in vain, as
 * for long steps and on cores that others want; then it is tried again now and then. */
typedef struct {
    int64_t longest;
    bool pays;
    uint32_t calls;
} Patience;

/* Look for a number to change, as long as there is patience; whether it has. */
static inline bool changes_soon(const uint32_t *number, uint32_t old, Patience *patience) {
    enum { BETWEEN = 16, TRIED_EVERY = 64 };
    if (seen(number) != old) return true;
    if (!patience->longest || (!patience->pays && ++patience->calls % TRIED_EVERY)) return false;
    for (int64_t end = nanoseconds() + patience->longest; nanoseconds() < end;)
        for (int i = 0; i < BETWEEN; i++) {
            if (seen(number) != old) return patience->pays = true;
            rest();
        }
    return patience->pays = seen(number) != old;
}

#endif
