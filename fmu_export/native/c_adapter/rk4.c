/* The classical Runge-Kutta method of order 4 with a fixed step; the export writes its formula with the model. */
#include "core.h"

#if N_X > 0
/* The step with the inputs in its middle and at its end, which are not on a line with those at its beginning. */
static void curved_step(Core *core, double t, double h, const double x[], const double k1[], double next[]) {
    const double *p = PARAMETERS(core), *middle = core->u_at[0], *end = core->u_at[1];
    double at[N_X], k2[N_X + N_STEP_REQUIREMENTS], k3[N_X + N_STEP_REQUIREMENTS], k4[N_X + N_STEP_REQUIREMENTS];
    for (int i = 0; i < N_X; i++) at[i] = x[i] + h / 2.0 * k1[i];
    model_rates(t + h / 2.0, at, middle, p, k2);
    for (int i = 0; i < N_X; i++) at[i] = x[i] + h / 2.0 * k2[i];
    model_rates(t + h / 2.0, at, middle, p, k3);
    for (int i = 0; i < N_X; i++) at[i] = x[i] + h * k3[i];
    model_rates(t + h, at, end, p, k4);
    for (int i = 0; i < N_X; i++) next[i] = x[i] + h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]);
}

CoreStatus method_step(Core *core, double time, double h, const double x[], const double u[], const double u_rate[],
                       const double rates[], double next[], double *error) {
    *error = 0.0;
    if (core->curved) curved_step(core, time, h, x, rates, next);
    else model_linear_step(time, x, u, PARAMETERS(core), h, u_rate, rates, next);
    return CORE_OK;
}
#endif
