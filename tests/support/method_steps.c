/* Single steps of the integration method in an FMU's sources, without step size control, for tests. */
#include "core.h"

#include <stdlib.h>
#include <string.h>

static void no_log(void *environment, CoreStatus status, const char *message) {
    (void)environment, (void)status, (void)message;
}

/* n steps of length h from the states x, which are those at the end then; inputs begin at u and change at u_rate. The
 * estimated error of the last step comes back. */
__attribute__((visibility("default"))) double method_steps(int n, double time, double h, double x[], const double u[],
                                                           const double u_rate[], const double p[]);

double method_steps(int n, double time, double h, double x[], const double u[], const double u_rate[],
                    const double p[]) {
    Core *core = calloc(1, sizeof *core);
    double rates[N_X + N_STEP_REQUIREMENTS + 1], next[N_X], at_u[N_U + 1], error = 0.0;
    core->logger = no_log;
    memcpy(PARAMETERS(core), p, N_P * sizeof *p);
    for (int i = 0; i < n; i++) {
        double now = time + i * h;
        for (int j = 0; j < N_U; j++) at_u[j] = u[j] + i * h * u_rate[j];
        model_rates(now, x, at_u, p, rates);
        method_prepare(core, now, x, at_u);
        method_step(core, now, h, x, at_u, u_rate, rates, next, &error);
        memcpy(x, next, sizeof next);
    }
    free(core);
    return error;
}

#ifdef SOLVER_RODAS4
#include "sparse_lu.h"

/* Solve (shift I - J) x = b. */
__attribute__((visibility("default"))) void solve(const double jacobian[], double shift, const double b[], double x[],
                                                  double residual[]);

void solve(const double jacobian[], double shift, const double b[], double x[], double residual[]) {
    double *factors = malloc(N_FACTORS * sizeof *factors);
    lu_factorise(jacobian, shift, factors);
    lu_solve(factors, b, x);
    lu_residual(jacobian, shift, b, x, residual);
    free(factors);
}
#endif
