/* The method of Dormand and Prince, explicit, of order 5 with an estimate of order 4.
 * After Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I. */
#include "core.h"
#include "dormand_prince.h"

#include <math.h>
#include <string.h>

void method_prepare(Core *core, double time, const double x[], const double u[]) {
    (void)core, (void)time, (void)x, (void)u;
}

void method_arrive(Core *core, double time, const double x[], const double u[], double rates[]) {
    (void)time, (void)x, (void)u;
    memcpy(rates, core->arrival, sizeof core->arrival); /* the last stage has computed them */
}

CoreStatus method_step(Core *core, double time, double h, const double x[], const double u[], const double u_rate[],
                       const double rates[], double next[], double *error) {
    double (*k)[N_X] = core->stages, sum[N_X], at_u[N_U + 1];
    memcpy(k[0], rates, sizeof k[0]);
    for (int stage = 1; stage < STAGES; stage++) {
        for (int i = 0; i < N_X; i++) sum[i] = 0.0;
        for (int j = 0; j < stage; j++)
            for (int i = 0; i < N_X; i++) sum[i] += STATE[stage][j] * k[j][i];
        for (int i = 0; i < N_X; i++) next[i] = x[i] + h * sum[i];
        if (core->curved) memcpy(at_u, core->u_at[stage < STAGES - 1 ? stage - 1 : stage - 2], N_U * sizeof *at_u);
        else
            for (int i = 0; i < N_U; i++) at_u[i] = u[i] + TIMES[stage] * h * u_rate[i];
        if (!core_usable_rates(core, time + TIMES[stage] * h, next, at_u, core->arrival)) return *error = NAN, CORE_OK;
        if (stage < STAGES - 1) memcpy(k[stage], core->arrival, sizeof k[stage]);
    }
    for (int i = 0; i < N_X; i++) sum[i] = ERROR[STAGES - 1] * core->arrival[i];
    for (int j = 0; j < STAGES - 1; j++)
        for (int i = 0; i < N_X; i++) sum[i] += ERROR[j] * k[j][i];
    for (int i = 0; i < N_X; i++) sum[i] *= h;
    *error = core_scaled(core, sum, x, next);
    return CORE_OK;
}

/* The controller of section IV.2 there (volume II), proportional to error^(-3/16) and integral by error^(1/32), which
 * square roots give with equal bits everywhere. */
double method_factor(const StepControl *last, double h, double error) {
    (void)h;
    double eighth = sqrt(sqrt(sqrt(error))), factor = 0.9 / (eighth * sqrt(eighth));
    if (last && last->size > 0.0) factor *= sqrt(sqrt(sqrt(sqrt(sqrt(last->error)))));
    return factor;
}
