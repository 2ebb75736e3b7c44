/* The classical Runge-Kutta method of order 4; the export writes its formula with the model. For the solver rk43 also what
 * is wrong with a step. */
#include "core.h"
#ifdef SOLVER_RK43
#include "step_control.h"
#endif

#include <math.h>
#include <string.h>

#if N_X > 0
#ifdef SOLVER_RK43
/* The error of a step, from its defect; inputs that are not asked for are linear. */
static double estimate(Core *core, double time, double h, const double x[], const double k1[], const double u[],
                       const double u_rate[], const double next[]) {
    double at_u[N_U + 1], defect[N_X], rates[N_X + N_STEP_REQUIREMENTS + 1];
    for (int stage = 2; stage >= 0; stage--)
        for (int i = N_STEP_REQUIREMENTS - 1; i >= 0; i--)
            if (!(core->stages[stage][N_X + i] > 0.0)) return core->violated = i, NAN;
    if (core->curved) {
        core_ask_for_inputs(core, time + 0.25 * h);
        memcpy(at_u, INPUTS(core), N_U * sizeof *at_u);
        memcpy(INPUTS(core), core->u_at[1], N_U * sizeof *at_u);
    } else
        for (int j = 0; j < N_U; j++) at_u[j] = u[j] + 0.25 * h * u_rate[j];
    model_defect(time, h, x, at_u, PARAMETERS(core), k1, core->stages[0], rates, defect);
    return core_usable(core, rates) ? core_scaled(core, defect, x, next) : NAN;
}
#endif

CoreStatus method_step(Core *core, double time, double h, const double x[], const double u[], const double u_rate[],
                       const double rates[], double next[], double *error) {
#ifdef SOLVER_RK43
    double (*stages)[N_X + N_STEP_REQUIREMENTS] = core->stages;
#else
    double stages[3][N_X + N_STEP_REQUIREMENTS];
#endif
    double line[2][N_U + 1];
    const double *middle = core->u_at[0], *end = core->u_at[1];
    if (!core->curved) {
        for (int j = 0; j < N_U; j++) line[0][j] = u[j] + h / 2.0 * u_rate[j];
        for (int j = 0; j < N_U; j++) line[1][j] = u[j] + h * u_rate[j];
        middle = line[0], end = line[1];
    }
    model_step(time, h, x, middle, end, PARAMETERS(core), rates, next, stages[0]);
#ifdef SOLVER_RK43
    if (error) *error = method_is_fixed(core) ? 0.0 : estimate(core, time, h, x, rates, u, u_rate, next);
#else
    if (error) *error = 0.0;
#endif
    return CORE_OK;
}
#endif

#ifdef SOLVER_RK43
void method_prepare(Core *core, double time, const double x[], const double u[]) {
    (void)core, (void)time, (void)x, (void)u;
}

void method_arrive(Core *core, double time, const double x[], const double u[], double rates[]) {
    model_rates(time, x, u, PARAMETERS(core), rates);
}

double method_factor(const StepControl *last, double h, double error) {
    (void)last, (void)h;
    return factor_of(error);
}
#endif
