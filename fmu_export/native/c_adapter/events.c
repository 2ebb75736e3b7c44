/* Events and sampling: what changes states at once, at an instant or when an indicator crosses zero. */
#include "core.h"

#include <float.h>
#include <math.h>
#include <string.h>

#if HYBRID

/* Rounds of events at one instant, and events of one kind that follow each other at once (s), before they are taken for
 * endless. */
enum { MOST_ROUNDS = 20, MOST_AT_ONCE = 20 };
#define AT_ONCE 1e-10

#if N_EVENTS > 0
/* How near to each other the ends are between which an event is located. */
static double located(double time) { return 1e-12 + 4.0 * DBL_EPSILON * fabs(time); }
#endif

/* Sampling */

#if N_SAMPLED > 0
/* `times` has period and offset of each sampler. */
static double instant(const Core *core, const double times[], int i) {
    return times[2 * i + 1] + core->state.discrete.count[i] * times[2 * i];
}

static CoreStatus start_sampling(Core *core) {
    double times[2 * N_SAMPLED], time = core->state.time;
    model_instants(PARAMETERS(core), times);
    for (int i = 0; i < N_SAMPLED; i++) {
        double period = times[2 * i], count = ceil((time - core_instant(time) - times[2 * i + 1]) / period);
        if (!(period > 0.0))
            return core_fail(core, CORE_ERROR, "the period of '%s' is %.17g s; it must be positive",
                             model_sampled_names[i], period);
        if (!(count < 9e15))
            return core_fail(core, CORE_ERROR, "the period of '%s', %.17g s, is too short to count to t = %.9g s",
                             model_sampled_names[i], period, time);
        core->state.discrete.count[i] = count > 0.0 ? count : 0.0;
    }
    return CORE_OK;
}

/* Update the discrete states by all samplers whose instant it is; each sees them as they were before. */
static CoreStatus sample(Core *core) {
    CoreState *s = &core->state;
    double times[2 * N_SAMPLED], updated[N_Z], next[N_Z], *z = DISCRETE(core);
    model_instants(PARAMETERS(core), times);
    memcpy(next, z, sizeof next);
    for (int i = 0; i < N_SAMPLED; i++) {
        double now = instant(core, times, i);
        if (now > s->time + core_instant(s->time)) continue;
        if (now < s->time - 1e-9 * (1.0 + fabs(s->time)))
            return core_fail(core, CORE_ERROR,
                             "'%s' samples at %.17g s, which is over at %.17g s; stop at each instant",
                             model_sampled_names[i], now, s->time);
        model_update(i, s->time, STATES(core), INPUTS(core), PARAMETERS(core), updated);
        if (!core_all_finite(updated, N_Z))
            return core_fail(core, CORE_DISCARD, "t = %.9g s: '%s' makes discrete states that are not finite", s->time,
                             model_sampled_names[i]);
        for (int j = 0; j < N_Z; j++)
            if (updated[j] != z[j]) next[j] = updated[j];
        s->discrete.count[i] += 1.0;
    }
    memcpy(z, next, sizeof next);
    return CORE_OK;
}
#endif

double core_next_instant(const Core *core) {
    double next = INFINITY;
#if N_SAMPLED > 0
    double times[2 * N_SAMPLED];
    model_instants(PARAMETERS(core), times);
    for (int i = 0; i < N_SAMPLED; i++) next = fmin(next, instant(core, times, i));
#else
    (void)core;
#endif
    return next;
}

/* Events */

#if N_EVENTS > 0
/* Whether an event happens when its indicator leaves this side of zero. */
static int is_armed(int event, double side) { return model_event_directions[event] != -side; }

/* Whether an indicator that was `before` has crossed zero; both are side * indicator. One that has begun at zero, or
 * below by what its location was late, crosses when it falls from there. */
static int crosses(double before, double now) { return now <= 0.0 && now < before; }

/* Whether an indicator that is zero now, or beyond by what its location was late, is to be counted as before its crossing:
 * it leaves for this side, or it rests, and something pulls it to the other. Euler steps show it, whose first has the
 * right sign for indicators that are linear. */
static int is_before(const Core *core, int event, double side, double now) {
    const CoreState *s = &core->state;
#if ADAPTIVE
    double h = s->control.proposed > 0.0 ? 1e-6 * s->control.proposed : 1e-9;
#else
    double h = 1e-3 * PARAMETERS(core)[MAX_STEP];
#endif
    double rates[N_X + N_STEP_REQUIREMENTS + 1], x[N_X + 1], u[N_U + 1], indicators[N_EVENTS], change = 0.0;
    memcpy(x, STATES(core), sizeof x);
    memcpy(u, INPUTS(core), N_U * sizeof *u);
    for (int step = 1; step <= 2; step++) {
        model_rates(s->time + (step - 1) * h, x, u, PARAMETERS(core), rates);
        for (int i = 0; i < N_X; i++) x[i] += h * rates[i];
        for (int i = 0; i < N_U; i++) u[i] += h * s->u_rate[i];
        model_indicators(s->time + step * h, x, u, PARAMETERS(core), indicators);
        change = side * (indicators[event] - now);
        if (step == 1 && change != 0.0) return change > 0.0;
    }
    return change != 0.0;
}

static CoreStatus check_indicators(Core *core, double time, const double indicators[]) {
    for (int i = 0; i < N_EVENTS; i++)
        if (!isfinite(indicators[i]))
            return core_fail(core, CORE_DISCARD, "t = %.9g s: the indicator of '%s' is not finite", time,
                             model_event_names[i]);
    return CORE_OK;
}

/* On which side of zero the indicators begin: what is there already has not crossed. */
static void start_indicators(Core *core) {
    Discrete *d = &core->state.discrete;
    model_indicators(core->state.time, STATES(core), INPUTS(core), PARAMETERS(core), d->indicator);
    for (int i = 0; i < N_EVENTS; i++) {
        double g = d->indicator[i];
        double side = model_event_directions[i] < 0 ? -1.0 : 1.0; /* from which it could cross, if it is zero */
        d->side[i] = g > 0.0 ? 1.0 : g < 0.0 ? -1.0 : is_before(core, i, side, g) ? side : -side;
    }
}

/* The states after an event. */
static CoreStatus happen(Core *core, int event) {
    CoreState *s = &core->state;
    Discrete *d = &s->discrete;
    double after[N_X + N_Z + 1];
    d->at_once[event] = d->at_once[event] > 0.0 && s->time - d->last[event] < AT_ONCE ? d->at_once[event] + 1.0 : 1.0;
    d->last[event] = s->time;
    if (d->at_once[event] > MOST_AT_ONCE)
        return core_fail(core, CORE_DISCARD,
                         "t = %.9g s: '%s' happens again and again without time passing (%d times within %g s each); "
                         "let its reset end that, as by a discrete state for being at rest",
                         s->time, model_event_names[event], MOST_AT_ONCE, AT_ONCE);
    model_reset(event, s->time, STATES(core), INPUTS(core), PARAMETERS(core), after);
    if (!core_all_finite(after, N_X + N_Z))
        return core_fail(core, CORE_DISCARD, "t = %.9g s: '%s' makes states that are not finite", s->time,
                         model_event_names[event]);
    memcpy(STATES(core), after, N_X * sizeof *after);
    memcpy(DISCRETE(core), after + N_X, N_Z * sizeof *after);
    return CORE_OK;
}

/* All events that have happened by now, one after the other in their order, until there is none. */
static CoreStatus react(Core *core) {
    CoreState *s = &core->state;
    Discrete *d = &s->discrete;
    double indicators[N_EVENTS];
    model_indicators(s->time, STATES(core), INPUTS(core), PARAMETERS(core), indicators);
    CoreStatus status = check_indicators(core, s->time, indicators);
    if (status != CORE_OK) return status;
    int last = -1, changed = 1;
    for (int round = 0; changed; round++) {
        if (round > MOST_ROUNDS)
            return core_fail(core, CORE_ERROR, "t = %.9g s: events set each other off without end, the last is '%s'",
                             s->time, model_event_names[last]);
        changed = 0;
        for (int i = 0; i < N_EVENTS; i++) {
            double side = d->side[i], g = side * indicators[i];
            if (is_armed(i, side) && crosses(side * d->indicator[i], g)) {
                status = happen(core, i);
                if (status != CORE_OK) return status;
                model_indicators(s->time, STATES(core), INPUTS(core), PARAMETERS(core), indicators);
                status = check_indicators(core, s->time, indicators);
                if (status != CORE_OK) return status;
                g = side * indicators[i];
                if (g < d->late[i] || (g <= 0.0 && !is_before(core, i, side, indicators[i]))) d->side[i] = -side;
                last = i, changed = 1;
            } else if (g < 0.0 && !is_armed(i, side)) {
                d->side[i] = -side;
            }
            d->indicator[i] = indicators[i], d->late[i] = 0.0;
        }
    }
    return CORE_OK;
}

/* An internal step that may be done again with another length. */
typedef struct {
    Core *core;
    double time;
    const double *x, *u, *u_rate, *rates;
    int *again; /* how often it was done */
    int curved; /* the inputs are not linear over the whole step */
} Step;

static void indicators_in(const Step *step, double h, const double x[], double indicators[]) {
    double u[N_U + 1];
    for (int j = 0; j < N_U; j++) u[j] = step->u[j] + h * step->u_rate[j];
    if (step->curved) {
        core_ask_for_inputs(step->core, step->time + h);
        memcpy(u, INPUTS(step->core), N_U * sizeof *u);
    }
    model_indicators(step->time + h, x, u, PARAMETERS(step->core), indicators);
}

/* The step with length h, and the indicators at its end. */
static CoreStatus step_again(const Step *step, double h, double x[], double indicators[]) {
#if N_X > 0
    double error, u_rate[N_U + 1];
    memcpy(u_rate, step->u_rate, N_U * sizeof *u_rate);
    if (step->curved) core_ask_over(step->core, step->time, h, step->time + h, step->u, u_rate);
    CoreStatus status = method_step(step->core, step->time, h, step->x, step->u, u_rate, step->rates, x, &error);
    if (status != CORE_OK) return status;
    if (!(error <= 2.0)) /* though the whole step has been accepted */
        return core_fail(step->core, CORE_DISCARD, "t = %.9g s: the way to an event can't be integrated", step->time);
#else
    x[0] = 0.0;
#endif
    ++*step->again;
    indicators_in(step, h, x, indicators);
    return CORE_OK;
}

/* Narrow (a, *b], in which an indicator comes to the other side of zero: f is side * indicator. */
static CoreStatus narrow(const Step *step, int event, double side, double a, double f_a, double *b, double f_b) {
    double x[N_X + 1], indicators[N_EVENTS], tolerance = located(step->time);
    int moved = 0; /* how often the same end has, b > 0 */
    for (int i = 0; *b - a > tolerance; i++) {
        double c = (a * f_b - *b * f_a) / (f_b - f_a); /* Illinois; now and then the middle, which always gets on */
        if (!(c >= a && c <= *b) || i % 8 == 7) c = 0.5 * (a + *b);
        c = fmin(fmax(c, a + 0.4 * tolerance), *b - 0.4 * tolerance);
        CoreStatus status = step_again(step, c, x, indicators);
        if (status != CORE_OK) return status;
        double f = side * indicators[event];
        if (f <= 0.0) {
            *b = c, f_b = f, moved = moved > 0 ? moved + 1 : 1;
            if (moved > 1) f_a *= 0.5;
        } else {
            a = c, f_a = f, moved = moved < 0 ? moved - 1 : -1;
            if (moved < -1) f_b *= 0.5;
        }
    }
    return CORE_OK;
}

/* Where in a step of length h an event happens first, with its indicator at the end and about that in the middle; at
 * INFINITY if it does not. *side becomes that from which it comes. */
static CoreStatus locate(const Step *step, int event, double h, double end, double middle, double *side, double *at) {
    double x[N_X + 1], indicators[N_EVENTS], a = 0.0, b = h, before = step->core->state.discrete.indicator[event];
    double f_a = *side * before, f_b = *side * end, f_middle = *side * middle;
    CoreStatus status = CORE_OK;
    *at = INFINITY;
    if (!is_armed(event, *side)) { /* it may come to the side from which it can happen, and back */
        if (!(f_middle < 0.0 && f_b >= 0.0)) return CORE_OK;
        a = 0.5 * h;
        status = step_again(step, a, x, indicators);
        if (status != CORE_OK || !(*side * indicators[event] < 0.0)) return status;
        *side = -*side, f_a = *side * indicators[event], f_b = -f_b;
    } else if (!crosses(f_a, f_b)) { /* it may do so twice */
        if (!crosses(f_a, f_middle)) return CORE_OK;
        b = 0.5 * h;
        status = step_again(step, b, x, indicators);
        f_b = *side * indicators[event];
        if (status != CORE_OK || !crosses(f_a, f_b)) return status;
    }
    while (!(f_a > 0.0)) { /* it begins at zero: where is it before it crosses? */
        double c = 0.5 * b;
        status = step_again(step, c, x, indicators);
        if (status != CORE_OK) return status;
        double f = *side * indicators[event];
        if (f > 0.0) {
            a = c, f_a = f;
        } else if (f < f_a && c > 0.1 * located(step->time)) {
            b = c, f_b = f;
        } else { /* nowhere */
            *at = b;
            return CORE_OK;
        }
    }
    status = narrow(step, event, *side, a, f_a, &b, f_b);
    *at = b;
    return status;
}

/* The indicators where the states have arrived, and events that wait to happen there. */
static void note_sides(Core *core, const double indicators[]) {
    Discrete *d = &core->state.discrete;
    for (int i = 0; i < N_EVENTS; i++) {
        double side = d->side[i], g = side * indicators[i];
        if (is_armed(i, side) && crosses(side * d->indicator[i], g)) continue;
        if (g < 0.0 && !is_armed(i, side)) d->side[i] = -side;
        d->indicator[i] = indicators[i];
    }
}

CoreStatus core_find_event(Core *core, double time, double *h, const double x[], const double u[],
                           const double u_rate[], const double rates[], double next[], int last, int *found) {
    Discrete *d = &core->state.discrete;
    int again = 0;
    const Step step = {core, time, x, u, u_rate, rates, &again, core->curved};
    double middle[N_X + 1], indicators[N_EVENTS], middle_indicators[N_EVENTS], at[N_EVENTS], side[N_EVENTS];
    double first = INFINITY;
    indicators_in(&step, *h, next, indicators);
    CoreStatus status = check_indicators(core, time + *h, indicators);
    if (status != CORE_OK) return status;
    for (int i = 0; i < N_X; i++) middle[i] = 0.75 * x[i] + 0.25 * (next[i] + *h * rates[i]); /* a parabola */
    indicators_in(&step, 0.5 * *h, middle, middle_indicators);
    for (int i = 0; i < N_EVENTS; i++) {
        side[i] = d->side[i];
        status = locate(&step, i, *h, indicators[i], middle_indicators[i], &side[i], &at[i]);
        if (status != CORE_OK) return status;
        first = fmin(first, at[i]);
    }
    *found = first <= *h;
    if (first < *h - located(time))
        *h = first; /* nearer to its end there may be a sampling instant, which comes first */
    if (again) status = step_again(&step, *h, next, indicators); /* the method keeps what it did last */
    core->curved = step.curved;
    if (status != CORE_OK) return status;
    for (int i = 0; i < N_EVENTS; i++) {
        if (!(at[i] <= *h)) continue;
        if (side[i] != d->side[i]) d->side[i] = side[i], d->indicator[i] = side[i] * DBL_MIN;
        d->late[i] = fmin(side[i] * indicators[i], 0.0);
    }
    if (!*found && !last) note_sides(core, indicators);
    return CORE_OK;
}
#endif

/* Both */

/* What happens at this instant: first samplers, then events. */
static CoreStatus change(Core *core) {
    CoreStatus status = CORE_OK;
#if N_EVENTS > 0
    if (core->state.discrete.is_new > 0.0) start_indicators(core);
#endif
    core->state.discrete.is_new = 0.0;
    core->state.valid = 0;
#if N_SAMPLED > 0
    status = sample(core);
#endif
#if N_EVENTS > 0
    if (status == CORE_OK) status = react(core);
#endif
    core->state.valid = 0;
    return status;
}

CoreStatus core_start_discrete(Core *core) {
    CoreState *s = &core->state;
    memset(&s->discrete, 0, sizeof s->discrete);
    model_initial_discrete(PARAMETERS(core), DISCRETE(core));
    if (!core_all_finite(DISCRETE(core), N_Z))
        return core_fail(core, CORE_ERROR, "the initial discrete states are not finite");
    s->discrete.is_new = 1.0;
    s->settled = 0;
#if N_SAMPLED > 0
    return start_sampling(core);
#else
    return CORE_OK;
#endif
}

CoreStatus core_change(Core *core, int *states_changed) {
    double before[N_X + 1];
    memcpy(before, STATES(core), N_X * sizeof *before);
    CoreStatus status = change(core);
    *states_changed = memcmp(before, STATES(core), N_X * sizeof *before) != 0;
    return status;
}

CoreStatus core_settle(Core *core) {
    CoreState *s = &core->state;
    if (s->settled || core->model_exchange || s->phase == FAILED) return CORE_OK;
    s->before = s->discrete;
    memcpy(s->x_before, STATES(core), sizeof s->x_before);
    memcpy(s->z_before, DISCRETE(core), N_Z * sizeof *s->z_before);
    s->settled = 1;
    CoreStatus status = change(core);
    if (status != CORE_OK) core_unsettle(core);
    return status;
}

void core_unsettle(Core *core) {
    CoreState *s = &core->state;
    if (!s->settled || core->model_exchange) return;
    s->discrete = s->before;
    memcpy(STATES(core), s->x_before, sizeof s->x_before);
    memcpy(DISCRETE(core), s->z_before, N_Z * sizeof *s->z_before);
    s->settled = 0;
    s->valid = 0;
}

int core_arrive(Core *core) {
    CoreState *s = &core->state;
    int passed = core_next_instant(core) <= s->time + core_instant(s->time);
#if N_EVENTS > 0
    double indicators[N_EVENTS];
    model_indicators(s->time, STATES(core), INPUTS(core), PARAMETERS(core), indicators);
    note_sides(core, indicators);
    for (int i = 0; i < N_EVENTS; i++) passed |= s->discrete.indicator[i] != indicators[i]; /* it waits to happen */
#endif
    return passed;
}
#endif
