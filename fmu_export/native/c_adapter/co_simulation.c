/* The communication step of co-simulation: what happens in it, and the inputs inside it. */
#include "core.h"
#if N_X + N_EVENTS > 0 && (!ADAPTIVE || defined(SOLVER_RK43))
#include "fixed_step.h"
#endif
#ifdef SOLVER_RK43
#include "rk43.h"
#endif

#include <float.h>
#include <math.h>
#include <string.h>

void core_ask_for_inputs(Core *core, double time) {
    CoreState *s = &core->state;
    if (core->request_inputs) {
        core->request_inputs(core->environment, time);
        return;
    }
    double since = time - s->u_time, *u = INPUTS(core);
    for (int j = 0; j < N_U; j++) { /* Horner's scheme, as whoever is asked by an FMU of FMI 3.0 does it */
        double change = s->u_higher[1][j] * (since / 3.0);
        change = (s->u_higher[0][j] + change) * (since / 2.0);
        u[j] = s->u_start[j] + (s->u_rate[j] + change) * since;
    }
}

#if N_X + N_EVENTS > 0
void core_ask_over(Core *core, double time, double h, double end_time, const double u[], double u_rate[]) {
    static const double times[N_INPUT_TIMES] = INPUT_TIMES;
    for (int k = 0; k < N_INPUT_TIMES; k++) {
        core_ask_for_inputs(core, times[k] == 1.0 ? end_time : time + times[k] * h);
        memcpy(core->u_at[k], INPUTS(core), N_U * sizeof *u);
    }
    const double *end = INPUTS(core);
    for (int j = 0; j < N_U; j++) u_rate[j] = (end[j] - u[j]) / h;
    core->curved = 0;
    for (int k = 0; k < N_INPUT_TIMES - 1; k++)
        for (int j = 0; j < N_U; j++) { /* linear but for rounding, also of the time? */
            double off = core->u_at[k][j] - (u[j] + times[k] * h * u_rate[j]);
            double size = fabs(u[j]) + fabs(end[j]) + fabs(time) * fabs(u_rate[j]);
            core->curved |= !(fabs(off) <= 8.0 * DBL_EPSILON * size);
        }
}
#endif

#if N_X + N_EVENTS > 0
/* From the states to `next`; *length becomes shorter where an event happens. */
static CoreStatus core_integrate(Core *core, double time, double *length, double next[]) {
#ifdef SOLVER_RK43
    if (method_is_fixed(core)) return integrate_fixed(core, time, length, next);
    if (passes_over(core, *length)) {
        double u[N_U + 1], u_rate[N_U + 1];
        int asked = core_inputs_are_asked_for(core);
        if (asked) memcpy(u, INPUTS(core), N_U * sizeof *u), memcpy(u_rate, core->state.u_rate, N_U * sizeof *u_rate);
        CoreStatus status = integrate_fixed(core, time, length, next);
        if (status != CORE_OK || was_smooth(core, *length, STATES(core), RATES(core))) return status;
        if (asked) memcpy(INPUTS(core), u, N_U * sizeof *u), memcpy(core->state.u_rate, u_rate, N_U * sizeof *u_rate);
        core->state.control.passed_over = 0.0;
        core->curved = 0;
    }
#endif
#if ADAPTIVE
    return core_integrate_adaptive(core, time, length, next);
#else
    return integrate_fixed(core, time, length, next);
#endif
}
#endif

/* Advance states, inputs and time by `length`, or to an event before. */
static CoreStatus advance(Core *core, double time, double length) {
    CoreState *s = &core->state;
    core->curved = 0;
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
#else
    if (core_inputs_are_asked_for(core)) core_ask_for_inputs(core, time + length);
#endif
    if (s->degree < 2) /* where linear inputs have arrived; others are there */
        for (int j = 0; j < N_U; j++) INPUTS(core)[j] += length * s->u_rate[j];
    s->time = time + length;
    s->valid = 0;
    return CORE_OK;
}

#if HYBRID
/* The communication step in pieces that end where something happens. */
static CoreStatus advance_through_events(Core *core, double time, double step) {
    CoreState *s = &core->state;
    double end = time + step, tolerance = core_instant(end);
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
    s->settled = 0;
    return status;
}
#endif

/* Whether a step of this length may begin at this time. Importers count time in their own way, so that it differs from that of
 * the FMU by rounding, and that of the last step by the rounding of all. */
static CoreStatus check_step(Core *core, double time, double step) {
    double now = core->state.time, size = 1.0 + fabs(time), end = time + step;
    if (!isfinite(time) || !(step > 0.0 && isfinite(end)))
        return core_fail(core, CORE_ERROR, "communication step %g s at %g s is not positive and finite", step, time);
    if (fabs(time - now) > fmin(1e-9 * size, 1e-2 * step) + 4.0 * DBL_EPSILON * size)
        return core_fail(
            core, CORE_ERROR,
            "communication step from %.17g s: this FMU is at %.17g s; go on there, or restore an FMU state", time, now);
    if (end > core->stop + 1e-9 * size + 1e-3 * step)
        return core_fail(
            core, CORE_ERROR,
            "communication step %g s from %.9g s goes past %.9g s, which is the stop time of the experiment; "
            "define a later one, or none",
            step, time, core->stop);
    return CORE_OK;
}

CoreStatus core_do_step(Core *core, double time, double step) {
    CoreState *s = &core->state;
    CoreStatus allowed = check_step(core, time, step);
    if (allowed != CORE_OK) return allowed;
    if (s->degree > 1) {
        s->u_time = time;
        memcpy(s->u_start, INPUTS(core), N_U * sizeof *s->u_start);
    }
#if HYBRID
    CoreState before;
    memcpy(&before, s, sizeof before);
    CoreStatus status = advance_through_events(core, time, step);
    before.phase = s->phase; /* the importer may have erred when it was asked for inputs */
    if (status != CORE_OK) memcpy(s, &before, sizeof before);
#else
    CoreStatus status = advance(core, time, step);
    if (status != CORE_OK && s->degree > 1) memcpy(INPUTS(core), s->u_start, N_U * sizeof *s->u_start);
#endif
    if (status != CORE_OK) return status;
    for (int j = 0; j < N_U; j++) s->u_rate[j] = 0.0;
    s->degree = 0;
    s->arrived = 1;
    return CORE_OK;
}
