/* One core for all who compute by turns: the loop, and the processes of isolated FMUs that step one after the other.
 *
 * Whoever wakes the next one and then sleeps leaves its core to it. To wake it on another core takes an interrupt of that
 * one, and many times as long where it has been idle or others want it. So for some time the loop stays on the core that the system
 * has chosen for it, and the others come there, see channel_worker.c. */
#define _GNU_SOURCE
#include "core.h"
#include "loop.h"

#ifdef __linux__
#include <dirent.h>
#include <sched.h>
#include <stdlib.h>
#include <time.h>

static _Thread_local int kept = -1;
static _Thread_local cpu_set_t before; /* what this thread may use else */
static _Thread_local int n_threads; /* of the process, when it came to stay */

static int count_threads(void) {
    int n = 0;
    DIR *tasks = opendir("/proc/self/task");
    if (!tasks) return 0;
    for (struct dirent *task; (task = readdir(tasks));) n += task->d_name[0] != '.';
    closedir(tasks);
    return n;
}

/* Give threads that were made meanwhile what this one had: they have inherited its one core. */
static void free_the_new(int core) {
    DIR *tasks = opendir("/proc/self/task");
    if (!tasks) return;
    for (struct dirent *task; (task = readdir(tasks));) {
        cpu_set_t own;
        pid_t thread = (pid_t)strtol(task->d_name, NULL, 10);
        if (thread && !sched_getaffinity(thread, sizeof own, &own) && CPU_COUNT(&own) == 1 && CPU_ISSET(core, &own))
            sched_setaffinity(thread, sizeof before, &before);
    }
    closedir(tasks);
}

void core_stay_on(int core) {
    if (core == kept) return;
    if (core < 0) {
        int old = kept;
        kept = -1;
        sched_setaffinity(0, sizeof before, &before);
        if (count_threads() > n_threads) free_the_new(old);
        return;
    }
    if (kept < 0) {
        if (sched_getaffinity(0, sizeof before, &before)) return;
        n_threads = count_threads();
    }
    cpu_set_t one;
    CPU_ZERO(&one);
    CPU_SET(core, &one);
    if (!sched_setaffinity(0, sizeof one, &one)) kept = core;
}

int core_kept(void) { return kept; }

bool core_has_been_inherited(void) { return kept >= 0 && count_threads() > n_threads; }

/* Have the thread of the loop stay on a core: the one that the system wakes it on, for that one has time. */
EXPORT void core_keep(void) {
    nanosleep(&(struct timespec){0, 1}, NULL);
    core_stay_on(sched_getcpu());
}
#else
void core_stay_on(int core) { (void)core; }

int core_kept(void) { return -1; }

bool core_has_been_inherited(void) { return false; }

EXPORT void core_keep(void) {}
#endif

/* Let the thread of the loop be where it could be. */
EXPORT void core_release(void) { core_stay_on(-1); }
