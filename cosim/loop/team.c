/* A team of threads that steps the components of a system at the same time.
 *
 * Between two communication points components know nothing of each other, so whoever steps them, and in which order, the
 * bits are the same. Threads take components one by one. Who has to wait looks for what it waits for a while, as long as
 * a step may take, and then sleeps: looking is faster, but takes a core from others. */
#ifndef _WIN32
#define _POSIX_C_SOURCE 200809L
#endif

#include "clock.h"
#include "team.h"

#include <stdlib.h>
#include <string.h>

#ifdef __GNUC__ /* clang and zig, too; others get no team */

#ifdef _WIN32
#include <windows.h>
typedef SRWLOCK Mutex;
typedef CONDITION_VARIABLE Condition;
typedef HANDLE Thread;
#define mutex_new(mutex) InitializeSRWLock(mutex)
#define mutex_lock(mutex) AcquireSRWLockExclusive(mutex)
#define mutex_unlock(mutex) ReleaseSRWLockExclusive(mutex)
#define condition_new(condition) InitializeConditionVariable(condition)
#define condition_wait(condition, mutex) SleepConditionVariableSRW(condition, mutex, INFINITE, 0)
#define condition_wait_a_while(condition, mutex) SleepConditionVariableSRW(condition, mutex, A_WHILE, 0)
#define condition_tell(condition) WakeAllConditionVariable(condition)
#else
#include <pthread.h>
#include <signal.h>
typedef pthread_mutex_t Mutex;
typedef pthread_cond_t Condition;
typedef pthread_t Thread;
#define mutex_new(mutex) pthread_mutex_init(mutex, NULL)
#define mutex_lock(mutex) pthread_mutex_lock(mutex)
#define mutex_unlock(mutex) pthread_mutex_unlock(mutex)
#define condition_new(condition) pthread_cond_init(condition, NULL)
#define condition_wait(condition, mutex) pthread_cond_wait(condition, mutex)
#define condition_tell(condition) pthread_cond_broadcast(condition)
#endif

/* So often (ms) the thread of Python is let look for Ctrl-C while it waits. */
enum { A_WHILE = 50 };

#ifndef _WIN32
static void condition_wait_a_while(Condition *condition, Mutex *mutex) {
    struct timespec until;
    clock_gettime(CLOCK_REALTIME, &until);
    until.tv_nsec += A_WHILE * 1000000L;
    if (until.tv_nsec >= 1000000000L) {
        until.tv_sec++;
        until.tv_nsec -= 1000000000L;
    }
    pthread_cond_timedwait(condition, mutex, &until);
}
#endif

/* For so long (ns) somebody looks for what it waits for, at least and at most, before it sleeps. */
enum { SHORTEST_LOOK = 1000, LONGEST_LOOK = 100000 };

/* An automatic team measures blocks of steps, one mode after the other, so many of each; a block has so many steps, or takes so long (ns). */
enum { N_BLOCKS = 3, BLOCK_STEPS = 64, BLOCK_TIME = 500000 };

/* Then the faster mode is kept for so many times the steps that were measured; twice as many each time that it is still
 * the faster one, up to a limit. */
enum { KEPT_FOR = 64, MOST_DOUBLINGS = 6 };

/* Together must be faster by a little, or one after the other it is, which leaves the other cores alone. */
static const double CLEARLY = 0.95;

typedef enum { ONE_BY_ONE, TOGETHER, N_MODES } Mode;

/* The operations first ... end - 1 at_step; the one that failed, or -1, and with which status. */
typedef struct {
    int64_t first, end, failed;
    int32_t status;
    bool stays;
} Unit;

/* Fields that threads write stand in lines of the cache of their own. */
struct Team {
    Loop *loop;
    int64_t point;
    int32_t n_units, n_taken, n_helpers; /* units that helpers take stand first in `order` */
    Unit *units;
    int32_t *order;
    Thread *helpers;
    Mutex mutex;
    Condition work, done;
    bool is_together; /* the last step was made so */
    int64_t steps_together;
    /* of an automatic team */
    bool automatic, is_measuring;
    Mode mode;
    int32_t block, doublings;
    int64_t steps, kept, measured;
    int64_t time;
    double fastest[N_MODES]; /* ns a step */
    char line0[64];
    uint64_t ticket; /* round << 32, plus the next place in `order` */
    char line1[64];
    uint32_t left; /* units that helpers take and that are not done */
    char line2[64];
    uint32_t sleepers, is_waiting, ends;
    int64_t look; /* ns */
};

static void pause_a_little(void) {
#if defined(__x86_64__) || defined(__i386__)
    for (int i = 0; i < 8; i++) __builtin_ia32_pause();
#elif defined(__aarch64__)
    for (int i = 0; i < 8; i++) __asm__ volatile("yield");
#endif
}

#define LOAD(address) __atomic_load_n(address, __ATOMIC_SEQ_CST)
#define STORE(address, value) __atomic_store_n(address, value, __ATOMIC_SEQ_CST)

static void perform_unit(Team *team, Unit *unit, CurrentCall *call) {
    Loop *loop = team->loop;
    const Operation *operations = loop->at_step + unit->first;
    const uint32_t *codes = loop->codes_at_step + unit->first;
    int64_t n = unit->end - unit->first;
    int64_t done = loop_perform_some(loop, call, operations, codes, n, team->point, &unit->status);
    unit->failed = done == n ? -1 : unit->first + done;
}

/* Perform units that nobody has taken yet, until there are none. */
static void take_units(Team *team, CurrentCall *call) {
    for (;;) {
        uint64_t place = __atomic_fetch_add(&team->ticket, 1, __ATOMIC_SEQ_CST) & UINT32_MAX;
        if (place >= (uint64_t)LOAD(&team->n_taken)) return;
        perform_unit(team, &team->units[team->order[place]], call);
        call->code = 0;
        if (__atomic_sub_fetch(&team->left, 1, __ATOMIC_SEQ_CST) == 0 && LOAD(&team->is_waiting)) {
            mutex_lock(&team->mutex);
            condition_tell(&team->done);
            mutex_unlock(&team->mutex);
        }
    }
}

static uint64_t round_of(Team *team) { return LOAD(&team->ticket) >> 32; }

/* Whether a new round has begun while somebody looked for it. */
static bool sees_new_round(Team *team, uint64_t last) {
    int64_t end = nanoseconds() + LOAD(&team->look);
    do {
        for (int i = 0; i < 8; i++, pause_a_little())
            if (round_of(team) != last || LOAD(&team->ends)) return true;
    } while (nanoseconds() < end);
    return false;
}

static void help(Team *team) {
    int32_t place = take_place();
    CurrentCall nowhere = {0}, *call = place < 0 ? &nowhere : call_at(place);
    have_spare_stack(true); /* whoever runs the loop watches; a team may outlive a run */
    uint64_t last = 0;
    while (!LOAD(&team->ends)) {
        if (!sees_new_round(team, last)) {
            mutex_lock(&team->mutex);
            __atomic_add_fetch(&team->sleepers, 1, __ATOMIC_SEQ_CST);
            while (round_of(team) == last && !LOAD(&team->ends)) condition_wait(&team->work, &team->mutex);
            __atomic_sub_fetch(&team->sleepers, 1, __ATOMIC_SEQ_CST);
            mutex_unlock(&team->mutex);
        }
        last = round_of(team);
        take_units(team, call);
    }
    have_spare_stack(false);
    if (place >= 0) leave_place(place);
}

#ifdef _WIN32
static DWORD WINAPI helper(void *team) {
    help(team);
    return 0;
}
#else
static void *helper(void *team) {
    help(team);
    return NULL;
}
#endif

static bool thread_new(Thread *thread, Team *team) {
#ifdef _WIN32
    *thread = CreateThread(NULL, 0, helper, team, 0, NULL);
    return *thread != NULL;
#else
    /* signals that are sent are for the thread of Python; those of a fault come to the thread that has it */
    sigset_t all, before;
    sigfillset(&all);
    int faults[] = {SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGABRT};
    for (size_t i = 0; i < sizeof faults / sizeof *faults; i++) sigdelset(&all, faults[i]);
    pthread_sigmask(SIG_SETMASK, &all, &before);
    bool done = pthread_create(thread, NULL, helper, team) == 0;
    pthread_sigmask(SIG_SETMASK, &before, NULL);
    return done;
#endif
}

static void thread_join(Thread thread) {
#ifdef _WIN32
    WaitForSingleObject(thread, INFINITE);
    CloseHandle(thread);
#else
    pthread_join(thread, NULL);
#endif
}

void team_free(Team *team) {
    if (!team) return;
    mutex_lock(&team->mutex);
    STORE(&team->ends, 1);
    condition_tell(&team->work);
    mutex_unlock(&team->mutex);
    for (int32_t i = 0; i < team->n_helpers; i++) thread_join(team->helpers[i]);
    free(team->helpers);
    free(team->order);
    free(team->units);
    free(team);
}

Team *team_new(int32_t threads, bool automatic, int32_t units, const int64_t *starts, const uint8_t *stays) {
    Team *team = calloc(1, sizeof *team);
    if (!team) return NULL;
    mutex_new(&team->mutex);
    condition_new(&team->work);
    condition_new(&team->done);
    team->units = calloc((size_t)units + 1, sizeof *team->units);
    team->order = calloc((size_t)units + 1, sizeof *team->order);
    team->helpers = calloc((size_t)threads + 1, sizeof *team->helpers);
    if (!team->units || !team->order || !team->helpers) {
        team_free(team);
        return NULL;
    }
    team->n_units = units;
    for (int32_t i = 0; i < units; i++) {
        team->units[i] = (Unit){.first = starts[i], .end = starts[i + 1], .failed = -1, .stays = stays[i]};
        if (!stays[i]) team->order[team->n_taken++] = i;
    }
    team->ticket = (uint64_t)team->n_taken; /* nothing is to be done yet */
    team->look = LONGEST_LOOK;
    team->automatic = automatic;
    team->is_measuring = true;
    team->mode = automatic ? ONE_BY_ONE : TOGETHER;
    while (team->n_helpers < threads - 1 && thread_new(&team->helpers[team->n_helpers], team)) team->n_helpers++;
    return team;
}

int64_t team_steps_together(const Team *team) { return team->steps_together; }

static void wait_for_helpers(Team *team) {
    int64_t end = 0;
    while (LOAD(&team->left)) {
        for (int i = 0; i < 8 && LOAD(&team->left); i++) pause_a_little();
        int64_t time = nanoseconds();
        if (!end) end = time + team->look;
        if (time < end) continue;
        mutex_lock(&team->mutex);
        STORE(&team->is_waiting, 1);
        while (LOAD(&team->left)) {
            condition_wait_a_while(&team->done, &team->mutex);
            if (!team->loop->looks) continue;
            mutex_unlock(&team->mutex);
            team->loop->looks();
            mutex_lock(&team->mutex);
        }
        STORE(&team->is_waiting, 0);
        mutex_unlock(&team->mutex);
    }
}

/* Report the first unit from one on whose operations failed, if there is one: then false. */
static bool report(const Team *team, Loop *loop, int32_t from) {
    for (int32_t i = from; i < team->n_units; i++) {
        const Unit *unit = &team->units[i];
        if (unit->failed < 0) continue;
        loop->failed = unit->failed;
        loop->status = unit->status;
        loop->failed_at_step = true;
        return false;
    }
    return true;
}

static bool step_together(Team *team, Loop *loop, int64_t point) {
    team->loop = loop;
    team->point = point;
    loop->point = point;
    STORE(&team->left, (uint32_t)team->n_taken);
    STORE(&team->ticket, (round_of(team) + 1) << 32);
    if (LOAD(&team->sleepers)) {
        mutex_lock(&team->mutex);
        condition_tell(&team->work);
        mutex_unlock(&team->mutex);
    }
    for (int32_t i = 0; i < team->n_units; i++)
        if (team->units[i].stays) perform_unit(team, &team->units[i], loop->call);
    take_units(team, loop->call);
    wait_for_helpers(team);
    team->steps_together++;
    team->is_together = true;
    return report(team, loop, 0);
}

static bool step_in_mode(Team *team, Loop *loop, int64_t point, Mode mode) {
    if (mode == TOGETHER) return step_together(team, loop, point);
    team->is_together = false;
    return loop_step_one_by_one(loop, point);
}

/* The time for which somebody looks, by that which a step takes (ns). */
static void look_for(Team *team, double step) {
    double look = 2.0 * step;
    STORE(&team->look, look < SHORTEST_LOOK ? SHORTEST_LOOK : look > LONGEST_LOOK ? LONGEST_LOOK : (int64_t)look);
}

/* After a block of steps in one mode: measure another one, or choose. */
static void block_done(Team *team) {
    double step = (double)team->time / (double)team->steps;
    Mode mode = team->mode;
    if (team->block < N_MODES || step < team->fastest[mode]) team->fastest[mode] = step;
    team->measured += team->steps;
    team->steps = team->time = 0;
    if (!team->automatic) { /* the times of its steps have been measured to know for how long to look */
        look_for(team, step);
        team->is_measuring = false;
        team->kept = INT64_MAX;
        return;
    }
    if (mode == ONE_BY_ONE) look_for(team, team->fastest[mode]);
    if (++team->block < N_MODES * N_BLOCKS) {
        team->mode = mode == TOGETHER ? ONE_BY_ONE : TOGETHER;
        return;
    }
    Mode faster = team->fastest[TOGETHER] < CLEARLY * team->fastest[ONE_BY_ONE] ? TOGETHER : ONE_BY_ONE;
    if (team->doublings < MOST_DOUBLINGS) team->doublings++;
    team->kept = team->measured * KEPT_FOR << team->doublings;
    team->mode = faster;
    team->is_measuring = false;
}

bool team_step(Loop *loop, int64_t point) {
    Team *team = loop->team;
    if (!team->is_measuring) {
        if (team->kept-- > 0) return step_in_mode(team, loop, point, team->mode);
        team->is_measuring = true;
        team->block = 0;
        team->measured = 0;
        team->mode = ONE_BY_ONE;
    }
    int64_t began = nanoseconds();
    bool done = step_in_mode(team, loop, point, team->mode);
    team->time += nanoseconds() - began;
    if (++team->steps == BLOCK_STEPS || team->time > BLOCK_TIME) block_done(team);
    return done;
}

bool team_rest_of_step(Loop *loop, int64_t failed, int64_t point) {
    Team *team = loop->team;
    if (!team->is_together) return loop_rest_one_by_one(loop, failed, point);
    int32_t i = 0;
    while (failed >= team->units[i].end) i++;
    Unit rest = team->units[i];
    rest.first = failed + 1;
    perform_unit(team, &rest, loop->call);
    team->units[i].failed = rest.failed;
    team->units[i].status = rest.status;
    return report(team, loop, i);
}

#else

Team *team_new(int32_t threads, bool automatic, int32_t units, const int64_t *starts, const uint8_t *stays) {
    (void)threads, (void)automatic, (void)units, (void)starts, (void)stays;
    return NULL;
}
void team_free(Team *team) { (void)team; }
int64_t team_steps_together(const Team *team) {
    (void)team;
    return 0;
}
bool team_step(Loop *loop, int64_t point) { return loop_step_one_by_one(loop, point); }
bool team_rest_of_step(Loop *loop, int64_t failed, int64_t point) { return loop_rest_one_by_one(loop, failed, point); }

#endif
