/* The communication step of co-simulation, in internal steps of an integration method. */
#include "core.h"

#include <math.h>
#include <string.h>

#if N_X + N_EVENTS > 0 && !ADAPTIVE
/* One internal step from `x`, where the inputs are `u` and change at `u_rate`, to `next`. */
static CoreStatus internal_step(Core *core, double time, double h, const double x[], const double u[],
                                const double u_rate[], const double rates[], double next[]) {
    CoreStatus status = core_check_margins(core, time, rates + N_X, CORE_DISCARD);
#if N_X > 0
    double error;
    if (status == CORE_OK) status = method_step(core, time, h, x, u, u_rate, rates, next, &error);
#else
    (void)h, (void)x, (void)u, (void)u_rate, (void)next;
#endif
    return status;
}

/* From the states to `next`; *length becomes shorter where an event happens. */
static CoreStatus core_integrate(Core *core, double time, double *length, double next[]) {
    CoreState *s = &core->state;
    double step = *length;
    double max_step = PARAMETERS(core)[N_P - 1], exact = 1.0;
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
    if (exact == 1.0 && !core->request_inputs && N_EVENTS == 0)
        return internal_step(core, time, step, STATES(core), INPUTS(core), s->u_rate, RATES(core), next);
    int n = (int)ceil(exact - 1e-6);
    double h = step / n, x[N_X + 1], u[N_U + 1], rate[N_U + 1], rates[N_X + N_STEP_REQUIREMENTS + 1];
    const double *from = STATES(core), *k1 = RATES(core);
    for (int i = 0; i < n; i++) {
        if (core->request_inputs) { /* linear between the inputs at both ends of the internal step */
            memcpy(u, INPUTS(core), N_U * sizeof *u);
            core->request_inputs(core->environment, time + (i + 1) * h);
            for (int j = 0; j < N_U; j++) rate[j] = (INPUTS(core)[j] - u[j]) / h;
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
            for (int j = 0; core->request_inputs && j < N_U; j++) INPUTS(core)[j] = u[j] + to_event * rate[j];
            return CORE_OK;
        }
#endif
    }
    return CORE_OK;
}
#endif

/* Advance states, inputs and time by `length`, or to an event before. */
static CoreStatus advance(Core *core, double time, double length) {
    CoreState *s = &core->state;
#if N_X + N_EVENTS > 0
    double *next = s->x[!s->which]; /* a copy of what has just been written would have to wait for it */
    CoreStatus status = core_integrate(core, time, &length, next);
    if (status != CORE_OK) return status;
    if (!core_all_finite(next, N_X))
        return core_fail(core, CORE_DISCARD,
                         "step from t = %.9g s: the state is no longer finite; reduce the step, max_step (%g s) or the "
                         "inputs, or export a stiff model with solver=\"rodas4\"",
                         time, PARAMETERS(core)[MAX_STEP]);
    s->which = !s->which;
#elif HYBRID
    if (core->request_inputs) core->request_inputs(core->environment, time + length);
#endif
    for (int j = 0; j < N_U; j++) { /* where linear inputs have arrived */
        INPUTS(core)[j] += length * s->u_rate[j];
        if (!HYBRID) s->u_rate[j] = 0.0;
    }
    s->time = time + length;
    s->valid = 0;
    return CORE_OK;
}

#if HYBRID
/* The communication step in pieces that end where something happens. */
static CoreStatus advance_through_events(Core *core, double time, double step) {
    CoreState *s = &core->state;
    double end = time + step, tolerance = core_instant(end);
    if (N_SAMPLED > 0 && fabs(time - s->time) > 1e-9 * (1.0 + fabs(time)))
        return core_fail(
            core, CORE_ERROR,
            "communication step from %.17g s: this FMU is at %.17g s, and samples by its time; go on there", time,
            s->time);
    CoreStatus status = core_settle(core);
    s->time = time;
    for (int n = 0; status == CORE_OK; n++) {
        if (n > MOST_INTERNAL_STEPS)
            return core_fail(core, CORE_DISCARD,
                             "communication step %g s at %g s has more than %d events and sampling "
                             "instants; make it shorter",
                             step, time, MOST_INTERNAL_STEPS);
        double instant = core_next_instant(core), target = instant < end - tolerance ? instant : end;
        double from = s->time;
        status = advance(core, from, target - from);
        if (status != CORE_OK) break;
        if (s->time == from + (target - from)) s->time = target; /* it is there, but for rounding */
        if (s->time >= end - tolerance) s->time = end;
        core_arrive(core); /* at this very time, to the last bit */
        if (s->time == end) break; /* what happens now sees the inputs that are to come */
        int states_changed;
        status = core_change(core, &states_changed);
    }
    for (int j = 0; j < N_U; j++) s->u_rate[j] = 0.0;
    s->settled = 0;
    return status;
}
#endif

CoreStatus core_do_step(Core *core, double time, double step) {
    CoreState *s = &core->state;
    if (!isfinite(time) || !(step > 0.0 && isfinite(time + step)))
        return core_fail(core, CORE_ERROR, "communication step %g s at %g s is not positive and finite", step, time);
#if HYBRID
    CoreState before;
    memcpy(&before, s, sizeof before);
    CoreStatus status = advance_through_events(core, time, step);
    if (status != CORE_OK) memcpy(s, &before, sizeof before);
    return status;
#else
    (void)s;
    return advance(core, time, step);
#endif
}
