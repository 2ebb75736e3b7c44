/* Steps components by a team of threads, and one after the other; for a build with a sanitiser of threads. */
#include "team.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { N = 5, STEPS = 3000 };

typedef struct {
    double x;
    int64_t n_steps, fails_at;
} Component;

static int do_step(void *instance, double time, double step, int unused) {
    Component *c = instance;
    (void)unused;
    for (int i = 0; i < 20; i++) c->x = sin(c->x + time * step);
    return ++c->n_steps == c->fails_at ? 3 : 0;
}

static void warned(const Operation *op) { (void)op; }

/* The sum of all states after a run, or minus the number of the operation that failed. */
static double run(int threads, bool automatic, bool first_stays, int64_t fails_at) {
    static Component components[N];
    static Operation operations[N];
    static uint32_t codes[N];
    static CurrentCall call;
    int64_t starts[N + 1];
    uint8_t stays[N] = {first_stays};
    for (int i = 0; i <= N; i++) starts[i] = i;
    for (int i = 0; i < N; i++) {
        components[i] = (Component){.x = i, .fails_at = i >= N - 2 ? fails_at : 0};
        operations[i] = (Operation){.kind = STEP, .version = 2, .every = 1 + (i == 1), .instance = &components[i]};
        int (*function)(void *, double, double, int) = do_step;
        memcpy(&operations[i].function, &function, sizeof function);
    }
    Loop loop = {.step_size = 1e-3, .last_point = STEPS, .at_step = operations, .codes_at_step = codes, .n_at_step = N};
    loop.record_every = STEPS + 1;
    loop.records = (double[1]){0.0};
    loop.call = &call;
    loop.warned = warned;
    loop.team = threads > 1 ? team_new(threads, automatic, N, starts, stays) : NULL;
    double sum = 0.0;
    if (!loop_run(&loop, 0, STEPS + 1, false)) {
        sum -= (double)loop.failed;
        if (loop_rest_of_step(&loop, loop.failed, loop.point)) sum -= 100.0;
        else sum -= 10.0 * (double)loop.failed;
    } else
        for (int i = 0; i < N; i++) sum += components[i].x;
    team_free(loop.team);
    return sum;
}

int main(void) {
    for (int i = 0; i < 100; i++)
        team_free(team_new(3, false, 2, (int64_t[]){0, 1, 2}, (uint8_t[]){0, 0})); /* without a step */
    for (int64_t fails_at = 0; fails_at <= 500; fails_at += 500) {
        double expected = run(1, false, false, fails_at);
        printf("%.17g", expected);
        for (int threads = 2; threads <= 4; threads++)
            for (int mode = 0; mode < 4; mode++) {
                double found = run(threads, mode & 1, mode & 2, fails_at);
                if (found != expected) printf(" %d threads, mode %d: %.17g", threads, mode, found);
            }
        printf("\n");
    }
    return 0;
}
