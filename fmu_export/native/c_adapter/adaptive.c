/* Internal steps as long as the tolerance allows, for methods that estimate their error. */
#include "core.h"
#include "step_control.h"

#include <float.h>
#include <math.h>
#include <string.h>

#ifndef SOLVER_RK43
/* Of the tolerance, what one step may use. With this share the sum stays below the tolerance for models that forget, as most
 * stiff ones. */
#define SHARE 0.02
#endif

#ifdef SOLVER_RODAS4
#define ADVICE ", or export a model that is not stiff with solver=\"dopri5\""
#else
#define ADVICE ", or export a stiff model with solver=\"rodas4\""
#endif

static double relative_tolerance(const Core *core) {
    return core->state.tolerance > 0.0 ? core->state.tolerance : PARAMETERS(core)[RTOL];
}

double core_scaled(const Core *core, const double v[], const double x[], const double next[]) {
    double rtol = relative_tolerance(core), largest = 0.0;
    for (int i = 0; i < N_X; i++) {
        double size = fabs(x[i]) > fabs(next[i]) ? fabs(x[i]) : fabs(next[i]);
        double scaled = fabs(v[i]) / allowance(size, model_nominals[i], rtol, SHARE);
        if (!(scaled <= largest)) largest = scaled;
        if (isnan(scaled)) break;
    }
    return largest;
}

int core_usable_rates(Core *core, double time, const double x[], const double u[], double rates[]) {
    model_rates(time, x, u, PARAMETERS(core), rates);
    return core_usable(core, rates);
}

int core_usable(Core *core, const double rates[]) {
    core->violated = -1;
    for (int i = N_STEP_REQUIREMENTS - 1; i >= 0; i--)
        if (!(rates[N_X + i] > 0.0)) core->violated = i;
    return core->violated < 0 && core_all_finite(rates, N_X);
}

#ifdef SOLVER_RK43
#define first_size(core, x, rates, longest) (longest) /* which is tried: most communication steps are short enough */
#else
/* A first step so short that an explicit Euler step would change the states by a hundredth. */
static double first_size(const Core *core, const double x[], const double rates[], double longest) {
    double size = core_scaled(core, x, x, x), speed = core_scaled(core, rates, x, x);
    double h = 0.01 * (size > 1.0 ? size : 1.0) / speed;
    return h < longest ? h : longest;
}
#endif

#ifdef SOLVER_RODAS4 /* the stages of other methods have the inputs of their times */
/* Add what the inputs inside a step change that are not linear between its ends, by Simpson's rule; its size. */
static double correct_for_inputs(Core *core, double time, double h, const double x[], double next[], const double u[],
                                 const double u_rate[], const double u_middle[]) {
    double middle[N_X], linear[N_U + 1], change[N_X + N_STEP_REQUIREMENTS + 1], without[N_X + N_STEP_REQUIREMENTS + 1];
    for (int j = 0; j < N_U; j++) linear[j] = u[j] + 0.5 * h * u_rate[j];
    for (int i = 0; i < N_X; i++) middle[i] = 0.5 * (x[i] + next[i]);
    if (!core_usable_rates(core, time + 0.5 * h, middle, u_middle, change)) return NAN;
    if (!core_usable_rates(core, time + 0.5 * h, middle, linear, without)) return NAN;
    for (int i = 0; i < N_X; i++) change[i] = 2.0 / 3.0 * h * (change[i] - without[i]);
    method_damp(core, h, change);
    double size = core_scaled(core, change, x, next);
    for (int i = 0; i < N_X; i++) next[i] += change[i];
    return size;
}
#endif

/* One step tried, with the inputs that the importer gives inside it, if it does. */
static CoreStatus try_step(Core *core, double time, double h, const double x[], const double u[], double u_rate[],
                           const double rates[], double next[], double *error) {
    if (core_inputs_are_asked_for(core)) core_ask_over(core, time, h, time + h, u, u_rate);
    CoreStatus status = method_step(core, time, h, x, u, u_rate, rates, next, error);
    if (status != CORE_OK) return status;
    if (!(*error > 1.0) && !core_all_finite(next, N_X)) *error = NAN;
#ifdef SOLVER_RODAS4
    if (core->curved && *error <= 1.0) {
        double of_inputs = correct_for_inputs(core, time, h, x, next, u, u_rate, core->u_at[0]);
        if (!(of_inputs <= *error)) *error = of_inputs;
    }
#endif
    return CORE_OK;
}

/* Why no step from a time is short enough. */
static CoreStatus fail_to_shorten(Core *core, double time, double error) {
    if (isnan(error) && core->violated >= 0)
        return core_fail(core, CORE_DISCARD, "t = %.9g s: %s", time, model_step_requirements[core->violated]);
    if (isnan(error))
        return core_fail(
            core, CORE_DISCARD,
            "t = %.9g s: the derivatives are not finite, however short the internal step; check inputs and "
            "parameters",
            time);
    return core_fail(core, CORE_DISCARD,
                     "t = %.9g s: no internal step is short enough for the relative tolerance %g: a state jumps or "
                     "grows without bound; check inputs and parameters, or set rtol higher",
                     time, relative_tolerance(core));
}

static CoreStatus fail_to_arrive(Core *core, double time, double step, double h) {
    return core_fail(
        core, CORE_DISCARD,
        "communication step %g s needs more than %d internal steps (at t = %.9g s they have %.3g s, at most "
        "max_step = %g s); make it shorter, or set rtol higher" ADVICE,
        step, MOST_INTERNAL_STEPS, time, h, PARAMETERS(core)[MAX_STEP]);
}

/* What the next step should be after a good one of length h, or after one that was too long. */
static void plan(StepControl *control, double h, double error, int good, int rejected) {
    int cut_short = good && h < control->proposed; /* by the end of the communication step, or max_step */
    double bounded = error > LEAST_ERROR ? error : LEAST_ERROR, most = rejected ? 1.0 : MOST_GROWTH;
    double factor = isfinite(error) ? method_factor(good && !cut_short ? control : NULL, h, bounded) : RETREAT;
    if (isfinite(error)) factor = factor > most ? most : factor < MOST_SHRINKAGE ? MOST_SHRINKAGE : factor;
    if (!cut_short || factor < 1.0 || h * factor > control->proposed) control->proposed = h * factor;
    if (good) { /* a step that was cut short says nothing of how the error changes from step to step */
        control->size = cut_short ? 0.0 : h;
        control->error = error > 1e-2 ? error : 1e-2;
    }
}

static CoreStatus integrate(Core *core, double time, double *length, double next[]) {
    CoreState *s = &core->state;
    double max_step = PARAMETERS(core)[MAX_STEP], step = *length, done = 0.0, error = 0.0;
    double x[N_X], u[N_U + 1], u_rate[N_U + 1], rates[N_X + N_STEP_REQUIREMENTS + 1];
    StepControl control = s->control;
    int arrived = 1, rejected = 0;
    if (RATES_DEPEND_ON_TIME && time != s->time) s->valid = 0; /* by rounding: importers count time in their own way */
    s->time = time;
    core_have_rates(core);
    memcpy(x, STATES(core), sizeof x);
    memcpy(u, INPUTS(core), N_U * sizeof *u);
    memcpy(u_rate, s->u_rate, N_U * sizeof *u_rate);
    memcpy(rates, RATES(core), sizeof rates);
    if (!(control.proposed > 0.0)) control.proposed = first_size(core, x, rates, step);
    for (int tries = 0; done < step; tries++) {
        double now = time + done, rest = step - done, h = control.proposed < max_step ? control.proposed : max_step;
        if (arrived) {
            CoreStatus status = core_check_margins(core, now, rates + N_X, CORE_DISCARD);
            if (status != CORE_OK) return status;
            if (!core_all_finite(rates, N_X)) return fail_to_shorten(core, now, NAN);
            method_prepare(core, now, x, u);
        }
        if (tries == MOST_INTERNAL_STEPS) return fail_to_arrive(core, now, step, h);
        if (h < LEAST_STEP * fabs(now) || h < DBL_MIN) return fail_to_shorten(core, now, error);
        int last = h * (1.0 + 1e-6) >= rest;
        h = last ? rest : 2.0 * h > rest ? 0.5 * rest : h;
        CoreStatus status = try_step(core, now, h, x, u, u_rate, rates, next, &error);
        if (status != CORE_OK) return status;
        arrived = error <= 1.0;
        plan(&control, h, error, arrived, rejected);
        rejected = !arrived;
        if (rejected) continue;
#if N_EVENTS > 0
        double to_event = h;
        int found;
        status = core_find_event(core, now, &to_event, x, u, u_rate, rates, next, last, &found);
        if (status != CORE_OK) return status;
        if (found) {
            if (!last || to_event < h) *length = done + to_event;
            core_arrive_with_inputs(core, now, to_event, u, u_rate);
            control.size = 0.0; /* what the error was says nothing of what comes */
            break;
        }
#endif
        if (last) break;
        done += h;
        memcpy(x, next, sizeof x);
        for (int j = 0; j < N_U; j++)
            u[j] = core_inputs_are_asked_for(core) ? INPUTS(core)[j] : INPUTS(core)[j] + done * u_rate[j];
        method_arrive(core, time + done, x, u, rates);
    }
    s->control = control;
    return CORE_OK;
}

CoreStatus core_integrate_adaptive(Core *core, double time, double *length, double next[]) {
    CoreState *s = &core->state;
    double before = s->time, u[N_U + 1], u_rate[N_U + 1];
    memcpy(u, INPUTS(core), N_U * sizeof *u);
    memcpy(u_rate, s->u_rate, N_U * sizeof *u_rate);
    CoreStatus status = integrate(core, time, length, next);
    if (status == CORE_OK) return CORE_OK;
    memcpy(INPUTS(core), u, N_U * sizeof *u); /* the importer may have set them inside the step */
    memcpy(s->u_rate, u_rate, N_U * sizeof *u_rate);
    s->time = before;
    s->valid = 0;
    return status;
}
