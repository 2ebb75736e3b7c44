/* Internal steps of equal length, at most max_step. */
#ifndef FIXED_STEP_H
#define FIXED_STEP_H

#include "core.h"

#include <math.h>
#include <string.h>

/* One internal step from `x`, where the inputs are `u` and change at `u_rate`, to `next`. */
static CoreStatus internal_step(Core *core, double time, double h, const double x[], const double u[],
                                const double u_rate[], const double rates[], double next[]) {
    CoreStatus status = core_check_margins(core, time, rates + N_X, CORE_DISCARD);
#if N_X > 0
    if (status == CORE_OK) status = method_step(core, time, h, x, u, u_rate, rates, next, NULL);
#else
    (void)h, (void)x, (void)u, (void)u_rate, (void)next;
#endif
    return status;
}

/* From the states at `time` to `next`; *length becomes shorter where an event happens. */
static CoreStatus integrate_fixed(Core *core, double time, double *length, double next[]) {
    CoreState *s = &core->state;
    double step = *length;
    double max_step = PARAMETERS(core)[MAX_STEP], exact = 1.0;
    if (step > max_step * (1.0 + 1e-6)) exact = step / max_step; /* longer by rounding only: that stays one step */
    if (exact > MOST_INTERNAL_STEPS)
        return core_fail(
            core, CORE_DISCARD,
            "communication step %g s needs %.4g internal steps; make it shorter, or max_step (%g s) longer, or export "
            "the model with solver=\"dopri5\" or, if it is stiff, \"rodas4\"",
            step, exact, max_step);
    if (RATES_DEPEND_ON_TIME && time != s->time) s->valid = 0; /* by rounding: importers count time in their own way */
    s->time = time;
    core_have_rates(core);
    int asked = core_inputs_are_asked_for(core);
    if (exact == 1.0 && !asked && N_EVENTS == 0)
        return internal_step(core, time, step, STATES(core), INPUTS(core), s->u_rate, RATES(core), next);
    int n = (int)ceil(exact - 1e-6);
    double h = step / n, x[N_X + 1], u[N_U + 1], rate[N_U + 1], rates[N_X + N_STEP_REQUIREMENTS + 1];
    const double *from = STATES(core), *k1 = RATES(core);
    for (int i = 0; i < n; i++) {
        if (asked) {
            memcpy(u, INPUTS(core), N_U * sizeof *u);
            core_ask_over(core, time + i * h, h, time + (i + 1) * h, u, rate);
        } else {
            for (int j = 0; j < N_U; j++) u[j] = INPUTS(core)[j] + i * h * s->u_rate[j];
            memcpy(rate, s->u_rate, N_U * sizeof *rate);
        }
        if (i > 0) {
            memcpy(x, next, N_X * sizeof *x);
            model_rates(time + i * h, x, u, PARAMETERS(core), rates);
            from = x, k1 = rates;
        }
        CoreStatus status = internal_step(core, time + i * h, h, from, u, rate, k1, next);
        if (status != CORE_OK) return status;
#if N_EVENTS > 0
        double to_event = h;
        int found;
        status = core_find_event(core, time + i * h, &to_event, from, u, rate, k1, next, i + 1 == n, &found);
        if (status != CORE_OK) return status;
        if (found) {
            if (i + 1 < n || to_event < h) *length = i * h + to_event;
            core_arrive_with_inputs(core, time + i * h, to_event, u, rate);
            return CORE_OK;
        }
#endif
    }
    return CORE_OK;
}

#endif
