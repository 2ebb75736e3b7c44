#include "model_exchange.h"

#include "dormand_prince.h"

#include <float.h>
#include <math.h>
#include <string.h>

typedef int SetTime(void *, double);
typedef int Vector(void *, double *, size_t);
typedef int ChangeMode(void *);
typedef int Completed2(void *, int, int *, int *);
typedef int Completed3(void *, bool, bool *, bool *);
typedef int Update3(void *, bool *, bool *, bool *, bool *, bool *, double *);
typedef int Set2(void *, const uint32_t *, size_t, const void *);
typedef int Set3(void *, const uint32_t *, size_t, const void *, size_t);

/* fmi2EventInfo */
typedef struct {
    int needed, terminate, nominals_changed, states_changed, next_defined;
    double next;
} EventInfo2;

typedef int Update2(void *, EventInfo2 *);

/* A status of FMI. */
enum { DISCARD = 2 };

/* Updates of discrete states at one time, and events that follow each other at once, before they are taken for endless. */
enum { MOST_UPDATES = 1000, MOST_AT_ONCE = 1000 };

/* Trials in which an event is located; they shrink the interval by half every third time at least. */
enum { MOST_TRIALS = 300 };

/* How far apart times are that are the same, for rounding: a part of a communication step. */
#define SAME 1e-9

static bool failed_in(Group *g, ContinuousComponent *c, FunctionOfFmi function, int status) {
    g->status = status;
    g->failed_exchange = 0;
    g->failed_function = function;
    g->failed_at = g->time;
    g->failed_component = 0;
    while (g->components[g->failed_component] != c) g->failed_component++;
    return false;
}

/* What a function of a component has returned, and whether that is no failure. */
static bool fine(Group *g, ContinuousComponent *c, FunctionOfFmi function, int status) {
    if (!status) return true;
    if (status > 1) return failed_in(g, c, function, status);
    g->stage.loop.warned(&c->told);
    return true;
}

#define NOTE(c, function) (g->stage.loop.call->code = (c)->codes[function])

static bool take_vector(Group *g, ContinuousComponent *c, FunctionOfFmi function, double *values, int32_t n) {
    if (!n) return true;
    NOTE(c, function);
    return fine(g, c, function, ((Vector *)c->functions[function])(c->instance, values, (size_t)n));
}

static bool change_mode(Group *g, ContinuousComponent *c, FunctionOfFmi function, Mode mode) {
    NOTE(c, function);
    if (!fine(g, c, function, ((ChangeMode *)c->functions[function])(c->instance))) return false;
    c->mode = mode;
    return true;
}

#define EACH(c) \
    for (ContinuousComponent *const *at = g->components, *const *last_of = at + g->n_components, *c; \
         at < last_of && (c = *at, true); at++)

static bool set_time(Group *g, double time) {
    if (time == g->time) return true;
    EACH(c) {
        NOTE(c, SET_TIME);
        if (!fine(g, c, SET_TIME, ((SetTime *)c->functions[SET_TIME])(c->instance, time))) return false;
    }
    g->time = time;
    return true;
}

static bool get_states(Group *g) {
    EACH(c) if (!take_vector(g, c, GET_STATES, g->states + c->first_state, c->n_states)) return false;
    g->states_known = true;
    return true;
}

static bool get_rates(Group *g, double *rates) {
    EACH(c) if (!take_vector(g, c, GET_DERIVATIVES, rates + c->first_state, c->n_states)) return false;
    return true;
}

static bool get_indicators(Group *g, double *indicators) {
    EACH(c) if (!take_vector(g, c, GET_INDICATORS, indicators + c->first_indicator, c->n_indicators)) return false;
    return true;
}

/* Perform operations on the values of the group, with inputs from outside as they are at a time. */
static bool exchange(Group *g, GroupExchange *e, bool same_time, double time) {
    double *values = e->loop.values;
    for (const OutsideInputs *i = e->inputs; !same_time && i < e->inputs + e->n_inputs; i++) {
        Extrapolated *in = i->operation->data;
        loop_evaluate(in, time - in->time, i->operation->n);
        for (int32_t j = 0; j < i->operation->n; j++)
            if (i->targets[j] != NONE) values[i->targets[j]] = in->buffer[j];
    }
    const Operation *operations = same_time ? e->again : e->loop.at_point;
    const uint32_t *codes = same_time ? e->codes_again : e->loop.codes_at_point;
    int64_t n = same_time ? e->n_again : e->loop.n_at_point;
    int64_t done = loop_perform_some(&e->loop, e->loop.call, operations, codes, n, e->loop.point, &g->status);
    if (done == n) return true;
    g->failed_exchange = e == &g->event ? IN_EVENT : same_time ? IN_STAGE_AGAIN : IN_STAGE;
    g->failed_operation = done;
    g->failed_at = time;
    return false;
}

/* Bring all components to a time and to states; their inputs are then old. */
static bool move(Group *g, double time, double *states) {
    if (!set_time(g, time)) return false;
    EACH(c) if (!take_vector(g, c, SET_STATES, states + c->first_state, c->n_states)) return false;
    g->is_exchanged = false;
    return true;
}

/* The same with their inputs. */
static bool move_all(Group *g, double time, double *states) {
    if (!move(g, time, states) || !exchange(g, &g->stage, time == g->exchanged_at, time)) return false;
    g->exchanged_at = time;
    g->is_exchanged = true;
    return true;
}

static bool rates_at(Group *g, double time, double *states, double *rates) {
    return move_all(g, time, states) && get_rates(g, rates);
}

/* Methods. Each goes from `states` at `time`, where the first row of rates is known, to `result` at `end`. */

static bool step_rk4(Group *g, double time, double end, double *restrict result) {
    int32_t n = g->n_states;
    double h = end - time;
    double *restrict x = g->states, *restrict y = g->trial;
    double *k1 = g->rates, *k2 = k1 + n, *k3 = k2 + n, *k4 = k3 + n;
    for (int32_t i = 0; i < n; i++) y[i] = x[i] + 0.5 * h * k1[i];
    if (!rates_at(g, time + 0.5 * h, y, k2)) return false;
    for (int32_t i = 0; i < n; i++) y[i] = x[i] + 0.5 * h * k2[i];
    if (!rates_at(g, time + 0.5 * h, y, k3)) return false;
    for (int32_t i = 0; i < n; i++) y[i] = x[i] + h * k3[i];
    if (!rates_at(g, end, y, k4)) return false;
    for (int32_t i = 0; i < n; i++) result[i] = x[i] + h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]);
    return true;
}

/* Dormand and Prince; the last stage is the result. */
static bool step_dopri5(Group *g, double time, double end, double *restrict result) {
    int32_t n = g->n_states;
    double *restrict x = g->states, *rates = g->rates, h = end - time;
    for (int s = 1; s < STAGES; s++) {
        double *y = s == STAGES - 1 ? result : g->trial;
        for (int32_t i = 0; i < n; i++) {
            double sum = 0.0;
            for (int j = 0; j < s; j++) sum += STATE[s][j] * rates[j * n + i];
            y[i] = x[i] + h * sum;
        }
        if (!rates_at(g, TIMES[s] == 1.0 ? end : time + TIMES[s] * h, y, rates + s * n)) return false;
    }
    return true;
}

typedef double *CVodeValues(void *);
typedef int CVodeStep(void *, double, void *, double *, int);
typedef int CVodeBegin(void *, double, void *);
typedef int CVodeAllow(void *, double, void *);
typedef int CVodeStop(void *, double);
typedef int CVodeLook(void *, double, int, void *);

/* One step that CVode chooses itself; and more than that, which goes on for so many tries. */
enum { ONE_STEP = 2 };

int group_rates(double time, void *states, void *rates, void *group) {
    Group *g = group;
    CVodeValues *values = (CVodeValues *)g->cvode_values;
    if (rates_at(g, time, values(states), values(rates))) return 0;
    return g->status == DISCARD || g->status == NOT_FINITE ? 1 : -1; /* a shorter step may be possible, or not */
}

/* States within the last step of CVode. */
static bool look(Group *g, double time, double *result) {
    if (((CVodeLook *)g->cvode_look)(g->cvode_memory, time, 0, g->cvode_within)) return false;
    memcpy(result, g->trial, (size_t)g->n_states * sizeof *result);
    return true;
}

static bool step_to(Group *g, double time, double end, double *result) {
    if (g->method == CVODE) return look(g, end, result);
    return g->method == DOPRI5 ? step_dopri5(g, time, end, result) : step_rk4(g, time, end, result);
}

/* Error of the last step over what is allowed: the root of the mean of the squares; NaN where states are not finite. */
static double error_of_step(const Group *g, double h) {
    int32_t n = g->n_states;
    double sum = 0.0;
    for (int32_t i = 0; i < n; i++) {
        double error = 0.0;
        for (int s = 0; s < STAGES; s++) error += ERROR[s] * g->rates[s * n + i];
        double size = fmax(g->nominals[i], fmax(fabs(g->states[i]), fabs(g->next[i])));
        double part = h * error / (g->tolerance * size);
        sum += part * part;
    }
    return n ? sqrt(sum / n) : 0.0;
}

static bool all_finite(const double *values, int32_t n) {
    for (int32_t i = 0; i < n; i++)
        if (!isfinite(values[i])) return false;
    return true;
}

/* A first step for the adaptive method, after Hairer, Norsett and Wanner, II.4: it makes a small explicit Euler step. */
static double first_step(const Group *g, double longest) {
    double states = 0.0, rates = 0.0;
    for (int32_t i = 0; i < g->n_states; i++) {
        double size = g->tolerance * fmax(g->nominals[i], fabs(g->states[i]));
        states += g->states[i] / size * (g->states[i] / size);
        rates += g->rates[i] / size * (g->rates[i] / size);
    }
    double h = states > 1e-10 && rates > 1e-10 ? 0.01 * sqrt(states / rates) : 1e-3 * longest;
    return fmin(h, longest);
}

static bool fail(Group *g, int status, double time) {
    g->status = status;
    g->failed_exchange = 0;
    g->failed_component = NONE;
    g->failed_at = time;
    return false;
}

static bool step_cvode(Group *g, double time, double stop, double *reached) {
    size_t size = (size_t)g->n_states * sizeof *g->next;
    if (g->begins) {
        memcpy(g->next, g->states, size);
        for (int32_t i = 0; i < g->n_states; i++) g->allowed[i] = g->tolerance * g->nominals[i];
        if (((CVodeBegin *)g->cvode_begin)(g->cvode_memory, time, g->cvode_states) ||
            ((CVodeAllow *)g->cvode_allow)(g->cvode_memory, g->tolerance, g->cvode_errors))
            return fail(g, CVODE_FAILED, time);
        g->begins = false;
    }
    ((CVodeStop *)g->cvode_stop)(g->cvode_memory, stop);
    g->status = 0;
    int status = ((CVodeStep *)g->cvode_step)(g->cvode_memory, stop, g->cvode_states, reached, ONE_STEP);
    g->n_steps++;
    if (status >= 0) return all_finite(g->next, g->n_states) || fail(g, STATES_NOT_FINITE, time);
    return g->status ? false : fail(g, CVODE_FAILED, time);
}

/* One step of the method towards `stop`, into `next`; where it has come to. */
static bool step(Group *g, double time, double stop, double *reached) {
    if (!g->rates_known && g->method != CVODE) {
        if (!g->is_exchanged && !move_all(g, time, g->states)) return false;
        if (!get_rates(g, g->rates)) return false;
        g->rates_known = true;
    }
    if (g->method == RK4 || !g->n_states) {
        *reached = stop;
        g->n_steps++;
        return step_rk4(g, time, stop, g->next) &&
               (all_finite(g->next, g->n_states) || fail(g, STATES_NOT_FINITE, time));
    }
    if (g->method == CVODE) return step_cvode(g, time, stop, reached);
    double h = stop - time;
    if (!(g->proposed > 0.0)) g->proposed = first_step(g, h);
    while (true) {
        double tried = g->proposed >= h ? h : fmin(g->proposed, 0.5 * h), end = tried == h ? stop : time + tried;
        bool done = step_dopri5(g, time, end, g->next);
        if (!done && g->status != DISCARD && g->status != NOT_FINITE) return false; /* a shorter step may be possible */
        double error = done ? error_of_step(g, tried) : INFINITY;
        if (error <= 1.0) { /* proportional and integral control, after Gustafsson */
            double factor = 0.9 * pow(fmax(error, 1e-10), -0.7 / 5.0) * pow(g->last_error, 0.4 / 5.0);
            double proposed = tried * fmin(5.0, fmax(0.2, factor));
            g->proposed = tried < g->proposed ? fmax(g->proposed, proposed) : proposed;
            g->last_error = fmax(error, 1e-4);
            g->n_steps++;
            *reached = end;
            return true;
        }
        g->n_rejected++;
        g->proposed = tried * (isfinite(error) ? fmax(0.1, 0.9 * pow(error, -0.2)) : 0.25);
        if (g->proposed <= 4.0 * DBL_EPSILON * fabs(time) || g->proposed < DBL_MIN)
            return done ? fail(g, STEP_TOO_SHORT, time) : false;
    }
}

/* Events */

static bool crosses(const double *before, const double *after, int32_t n) {
    for (int32_t i = 0; i < n; i++)
        if ((before[i] > 0.0) != (after[i] > 0.0)) return true;
    return false;
}

/* Where in [low, high] the first of the indicators that cross zero would be zero if it was linear. */
static double secant(const double *before, const double *after, int32_t n, double low, double high) {
    double first = high;
    for (int32_t i = 0; i < n; i++)
        if ((before[i] > 0.0) != (after[i] > 0.0))
            first = fmin(first, low + (high - low) * (before[i] / (before[i] - after[i])));
    return fmax(low, first);
}

/* A step to the first event before `*end`, which becomes the time of the event; the components stand just behind it. */
static bool locate(Group *g, double time, double *end) {
    int32_t n = g->n_indicators;
    double low = time, high = *end, near = 4.0 * DBL_EPSILON * fabs(high) + 1e-14 * (high - low);
    double *at_low = g->tried, *at_guess = g->tried + n;
    memcpy(at_low, g->indicators, (size_t)n * sizeof *at_low);
    for (int k = 0; high - low > near && k < MOST_TRIALS; k++) {
        double middle = low + 0.5 * (high - low), guess = middle;
        if (k % 3 < 2) guess = secant(at_low, g->later, n, low, high);
        if (k % 3 == 1) { /* a little farther than the secant says, so that the root lies between */
            double further = 4.0 * fmin(guess - low, high - guess) + 0.5 * near;
            guess += guess < middle ? further : -further;
        }
        guess = fmin(fmax(guess, low + 0.25 * near), high - 0.25 * near);
        if (!step_to(g, time, guess, g->next) || !move_all(g, guess, g->next) || !get_indicators(g, at_guess))
            return false;
        bool is_before = !crosses(at_low, at_guess, n);
        memcpy(is_before ? at_low : g->later, at_guess, (size_t)n * sizeof *at_low);
        *(is_before ? &low : &high) = guess;
    }
    *end = high;
    return step_to(g, time, high, g->next) && move_all(g, high, g->next);
}

/* Update the discrete states of all components, which are in event mode; whether one needs another update. */
static bool update_all(Group *g, double time, bool *needed) {
    *needed = false;
    EACH(c) {
        int status;
        NOTE(c, UPDATE_DISCRETE_STATES);
        bool again = false, ends = false, nominals = false, states = false, defined = false;
        double next = 0.0;
        if (c->version == 2) {
            EventInfo2 info = {0};
            status = ((Update2 *)c->functions[UPDATE_DISCRETE_STATES])(c->instance, &info);
            again = info.needed, ends = info.terminate, defined = info.next_defined, next = info.next;
        } else
            status = ((Update3 *)c->functions[UPDATE_DISCRETE_STATES])(c->instance, &again, &ends, &nominals, &states,
                                                                       &defined, &next);
        if (!fine(g, c, UPDATE_DISCRETE_STATES, status)) return false;
        c->next_event = defined ? next : INFINITY;
        *needed |= again;
        if (ends && g->ended_by == NONE) {
            g->ended_by = (int32_t)(at - g->components);
            g->ended_at = time;
        }
    }
    return true;
}

static bool enter_event_mode(Group *g) {
    EACH(c) if (c->mode == CONTINUOUS_TIME_MODE && !change_mode(g, c, ENTER_EVENT_MODE, EVENT_MODE)) return false;
    return true;
}

static bool leave_event_mode(Group *g) {
    EACH(c) if (!change_mode(g, c, ENTER_CONTINUOUS_TIME_MODE, CONTINUOUS_TIME_MODE)) return false;
    if (g->method != RK4) {
        EACH(c)
        if (c->functions[GET_NOMINALS] && !take_vector(g, c, GET_NOMINALS, g->nominals + c->first_state, c->n_states))
            return false;
        for (int32_t i = 0; i < g->n_states; i++)
            g->nominals[i] = isfinite(g->nominals[i]) && g->nominals[i] != 0.0 ? fabs(g->nominals[i]) : 1.0;
    }
    g->begins = true;
    g->exchanged_at = NAN;
    g->is_exchanged = true;
    g->rates_known = g->indicators_known = false;
    g->proposed = 0.0;
    g->last_error = 1.0;
    return get_states(g);
}

/* An event within a step: the components of the group update their discrete states until nothing changes any more. */
static bool happen(Group *g, double time) {
    double *values = g->event.loop.values;
    size_t size = (size_t)g->event.n_values * sizeof *values;
    g->n_events++;
    g->at_once = time - g->last_event <= 1e-10 * g->stage.loop.step_size ? g->at_once + 1 : 0;
    g->last_event = time;
    if (g->at_once > MOST_AT_ONCE) return fail(g, ENDLESS_EVENTS, time);
    if (!enter_event_mode(g) || !exchange(g, &g->event, false, time)) return false;
    for (int k = 0; k < MOST_UPDATES; k++) {
        bool needed;
        memcpy(g->values_before, values, size);
        if (!update_all(g, time, &needed) || !exchange(g, &g->event, true, time)) return false;
        if (!needed && !memcmp(g->values_before, values, size)) return leave_event_mode(g);
    }
    return fail(g, ENDLESS_UPDATES, time);
}

static bool completed_step(Group *g, bool *enter_event_mode) {
    EACH(c) {
        if (!c->needs_completed_step) continue;
        NOTE(c, COMPLETED_STEP);
        int status;
        bool enter = false, ends = false;
        if (c->version == 2) {
            int enter2 = 0, ends2 = 0;
            status = ((Completed2 *)c->functions[COMPLETED_STEP])(c->instance, 1, &enter2, &ends2);
            enter = enter2, ends = ends2;
        } else status = ((Completed3 *)c->functions[COMPLETED_STEP])(c->instance, true, &enter, &ends);
        if (!fine(g, c, COMPLETED_STEP, status)) return false;
        *enter_event_mode |= enter;
        if (ends && g->ended_by == NONE) {
            g->ended_by = (int32_t)(at - g->components);
            g->ended_at = g->time;
        }
    }
    return true;
}

static double next_event(const Group *g) {
    double next = INFINITY;
    EACH(c) next = fmin(next, c->next_event);
    return next;
}

/* An event at a time that the components have, and what the indicators are after it. */
static bool happen_at(Group *g, double time) { return happen(g, time) && get_indicators(g, g->indicators); }

/* Integrate from `*time` to `target`, events included; to an earlier time if a component ends the simulation. */
static bool integrate(Group *g, double *time, double target, double same) {
    while (*time < target && g->ended_by == NONE) {
        double event = next_event(g);
        if (event <= *time + same && event < target - same) {
            if (!set_time(g, fmax(*time, event)) || !happen_at(g, *time)) return false;
            continue;
        }
        double stop = event < target - same ? event : target, reached = stop;
        if (!step(g, *time, stop, &reached)) return false;
        bool is_first = g->method == DOPRI5; /* its last stage is the first one of the next step */
        if (is_first) g->rates_known = true;
        else if (g->exchanges_at_end || reached < target ? !move_all(g, reached, g->next) : !move(g, reached, g->next))
            return false;
        bool happens = false;
        if (g->n_indicators && !get_indicators(g, g->later)) return false;
        if (crosses(g->indicators, g->later, g->n_indicators)) {
            if (!locate(g, *time, &reached)) return false;
            happens = true;
        } else memcpy(g->indicators, g->later, (size_t)g->n_indicators * sizeof *g->later);
        memcpy(g->states, g->next, (size_t)g->n_states * sizeof *g->states);
        if (is_first && !happens) memcpy(g->rates, g->rates + 6 * g->n_states, (size_t)g->n_states * sizeof *g->rates);
        else g->rates_known = false;
        *time = reached;
        if (!completed_step(g, &happens)) return false;
        if ((happens || (reached == event && event < target - same)) && !happen_at(g, reached)) return false;
    }
    return true;
}

static void copy_from_outside(GroupExchange *e, const Loop *loop) {
    const int32_t *here = e->copied, *there = here + e->n_copied;
    for (int32_t i = 0; i < e->n_copied; i++) e->loop.values[here[i]] = loop->values[there[i]];
}

static Group *group_of(const Loop *loop, const Operation *op, int64_t point) {
    Group *g = op->data;
    GroupExchange *exchanges[] = {&g->stage, &g->event};
    for (int i = 0; i < 2; i++) {
        exchanges[i]->loop.call = loop->call;
        exchanges[i]->loop.warned = loop->warned;
        exchanges[i]->loop.start_time = loop->start_time;
        exchanges[i]->loop.step_size = loop->step_size;
        exchanges[i]->loop.point = point;
    }
    return g;
}

int group_advance(const Loop *loop, const Operation *op, int64_t point, double time) {
    Group *g = group_of(loop, op, point);
    double start = time, end = loop->start_time + (double)(point + 1) * loop->step_size;
    double same = SAME * loop->step_size;
    if (g->ended_by != NONE) return WANTS_TO_END;
    copy_from_outside(&g->stage, loop);
    copy_from_outside(&g->event, loop);
    bool due = false;
    EACH(c) due |= c->mode == EVENT_MODE;
    if (!set_time(g, time) || (due && !happen(g, time)) || (!g->states_known && !get_states(g))) return g->status;
    EACH(c) g->begins |= c->is_fed; /* inputs from outside may jump, or change their slopes */
    g->is_exchanged = true;
    g->rates_known = false;
    g->exchanged_at = NAN;
    if (g->exchanges_at_start && !exchange(g, &g->stage, false, time)) return g->status;
    if (g->n_indicators) { /* inputs may have jumped at this communication point */
        if (!get_indicators(g, g->later)) return g->status;
        bool crossed = g->indicators_known && crosses(g->indicators, g->later, g->n_indicators);
        memcpy(g->indicators, g->later, (size_t)g->n_indicators * sizeof *g->later);
        if (crossed && !happen_at(g, time)) return g->status;
    }
    for (int32_t i = 1; i <= g->steps && g->ended_by == NONE; i++) {
        double target = i == g->steps ? end : start + i * (end - start) / g->steps;
        if (!integrate(g, &time, target, same)) return g->status;
    }
    g->indicators_known = true;
    return g->ended_by == NONE ? 0 : WANTS_TO_END;
}

int group_begin(const Loop *loop, const Operation *op, int64_t point, double time) {
    Group *g = group_of(loop, op, point);
    int64_t row = point - loop->first_sample;
    bool jump = row >= 0 && row < loop->n_rows && loop->jumps[row];
    EACH(c) {
        bool due = c->next_event <= time + SAME * loop->step_size;
        if (c->mode != CONTINUOUS_TIME_MODE || !(due || (jump && c->is_fed))) continue;
        if (!change_mode(g, c, ENTER_EVENT_MODE, EVENT_MODE)) return g->status;
        if (due && c->next_event > time) { /* by rounding: the event is at its time, and this is it */
            NOTE(c, SET_TIME);
            if (!fine(g, c, SET_TIME, ((SetTime *)c->functions[SET_TIME])(c->instance, c->next_event)))
                return g->status;
            g->time = NAN;
        }
    }
    return 0;
}

int group_finish(const Loop *loop, const Operation *op, int64_t point, double time) {
    Group *g = group_of(loop, op, point);
    size_t size = (size_t)op->n * sizeof *loop->values; /* all of them */
    bool due = false;
    EACH(c) due |= c->mode == EVENT_MODE;
    if (!due) return 0;
    g->n_events += point > 0;
    g->time = isnan(g->time) ? g->time : time;
    if (!enter_event_mode(g)) return g->status;
    for (int k = 0; k < MOST_UPDATES; k++) {
        bool needed;
        memcpy(g->values_before, loop->values, size);
        if (!update_all(g, time, &needed)) return g->status;
        int64_t done = loop_perform_some(loop, loop->call, loop->at_point + g->first_again,
                                         loop->codes_at_point + g->first_again, g->n_again, point, &g->status);
        if (done < g->n_again) {
            g->failed_exchange = AT_POINT;
            g->failed_operation = g->first_again + done;
            return g->status;
        }
        if (!needed && !memcmp(g->values_before, loop->values, size)) return leave_event_mode(g) ? 0 : g->status;
    }
    fail(g, ENDLESS_UPDATES, time);
    return g->status;
}

/* Whether inputs are as they were, outside of the initialisation; else their component has been brought into event mode. */
static bool are_set(DiscreteInputs *in, const void *values, int *status) {
    ContinuousComponent *c = in->component;
    *status = 0;
    if (c->mode == CONTINUOUS_TIME_MODE) {
        if (in->known && !memcmp(in->last, values, in->size)) return true;
        *status = ((ChangeMode *)c->functions[ENTER_EVENT_MODE])(c->instance);
        if (*status > 1) return true;
        c->mode = EVENT_MODE;
    }
    memcpy(in->last, values, in->size);
    in->known = true;
    return false;
}

int set_discrete_fmi2(void *inputs, const uint32_t *references, size_t n_references, const void *values) {
    DiscreteInputs *in = inputs;
    int status;
    if (are_set(in, values, &status)) return status;
    return ((Set2 *)in->function)(in->component->instance, references, n_references, values);
}

int set_discrete_fmi3(void *inputs, const uint32_t *references, size_t n_references, const void *values, size_t n) {
    DiscreteInputs *in = inputs;
    int status;
    if (are_set(in, values, &status)) return status;
    return ((Set3 *)in->function)(in->component->instance, references, n_references, values, n);
}

#define STRUCT(type) {#type, 0, sizeof(type)}
#define FIELD(type, field) {#type "." #field, offsetof(type, field), sizeof(((type *)0)->field)}

static const Field layout[] = {
    STRUCT(ContinuousComponent),
    FIELD(ContinuousComponent, instance),
    FIELD(ContinuousComponent, functions),
    FIELD(ContinuousComponent, codes),
    FIELD(ContinuousComponent, told),
    FIELD(ContinuousComponent, next_event),
    FIELD(ContinuousComponent, version),
    FIELD(ContinuousComponent, mode),
    FIELD(ContinuousComponent, n_states),
    FIELD(ContinuousComponent, n_indicators),
    FIELD(ContinuousComponent, first_state),
    FIELD(ContinuousComponent, first_indicator),
    FIELD(ContinuousComponent, needs_completed_step),
    FIELD(ContinuousComponent, is_fed),
    STRUCT(DiscreteInputs),
    FIELD(DiscreteInputs, component),
    FIELD(DiscreteInputs, function),
    FIELD(DiscreteInputs, last),
    FIELD(DiscreteInputs, size),
    FIELD(DiscreteInputs, known),
    FIELD(DiscreteInputs, padding),
    STRUCT(OutsideInputs),
    FIELD(OutsideInputs, operation),
    FIELD(OutsideInputs, targets),
    STRUCT(GroupExchange),
    FIELD(GroupExchange, loop),
    FIELD(GroupExchange, again),
    FIELD(GroupExchange, codes_again),
    FIELD(GroupExchange, n_again),
    FIELD(GroupExchange, inputs),
    FIELD(GroupExchange, copied),
    FIELD(GroupExchange, n_values),
    FIELD(GroupExchange, n_inputs),
    FIELD(GroupExchange, n_copied),
    STRUCT(Group),
    FIELD(Group, components),
    FIELD(Group, stage),
    FIELD(Group, event),
    FIELD(Group, states),
    FIELD(Group, next),
    FIELD(Group, trial),
    FIELD(Group, rates),
    FIELD(Group, nominals),
    FIELD(Group, indicators),
    FIELD(Group, later),
    FIELD(Group, tried),
    FIELD(Group, cvode_memory),
    FIELD(Group, cvode_states),
    FIELD(Group, cvode_within),
    FIELD(Group, cvode_errors),
    FIELD(Group, cvode_step),
    FIELD(Group, cvode_begin),
    FIELD(Group, cvode_allow),
    FIELD(Group, cvode_stop),
    FIELD(Group, cvode_look),
    FIELD(Group, cvode_values),
    FIELD(Group, allowed),
    FIELD(Group, values_before),
    FIELD(Group, tolerance),
    FIELD(Group, proposed),
    FIELD(Group, last_error),
    FIELD(Group, last_event),
    FIELD(Group, time),
    FIELD(Group, exchanged_at),
    FIELD(Group, ended_at),
    FIELD(Group, n_steps),
    FIELD(Group, n_rejected),
    FIELD(Group, n_events),
    FIELD(Group, first_again),
    FIELD(Group, n_again),
    FIELD(Group, method),
    FIELD(Group, steps),
    FIELD(Group, n_components),
    FIELD(Group, n_states),
    FIELD(Group, n_indicators),
    FIELD(Group, exchanges_at_end),
    FIELD(Group, exchanges_at_start),
    FIELD(Group, is_exchanged),
    FIELD(Group, rates_known),
    FIELD(Group, indicators_known),
    FIELD(Group, states_known),
    FIELD(Group, ended_by),
    FIELD(Group, begins),
    FIELD(Group, at_once),
    FIELD(Group, failed_component),
    FIELD(Group, failed_function),
    FIELD(Group, failed_exchange),
    FIELD(Group, status),
    FIELD(Group, failed_operation),
    FIELD(Group, failed_at),
    {NULL, 0, 0},
};

EXPORT const Field *model_exchange_layout(void) { return layout; }
