/* RODAS: a Rosenbrock method of order 4 with an estimate of order 3, L-stable and stiffly accurate, for stiff models.
 * After Hairer, Wanner, Solving Ordinary Differential Equations II, section VI.4, in the form without products by the
 * Jacobian, (IV.7.25), for models that depend on time. */
#include "core.h"
#include "sparse_lu.h"
#include "step_control.h"

#include <math.h>

enum { STAGES = 6 };

static const double GAMMA = 0.25;
static const double TIMES[STAGES] = {0.0, 0.386, 0.21, 0.63, 1.0, 1.0};
static const double TIME_DERIVATIVE[STAGES] = {0.25, -0.1043, 0.1035, -0.0362, 0.0, 0.0};
/* The states of each stage, then those at the end of the step. */
static const double STATE[STAGES + 1][STAGES] = {
    {0.0},
    {1.544},
    {0.9466785280815826, 0.2557011698983284},
    {3.314825187068521, 2.896124015972201, 0.9986419139977817},
    {1.221224509226641, 6.019134481288629, 12.53708332932087, -0.687886036105895},
    {1.221224509226641, 6.019134481288629, 12.53708332932087, -0.687886036105895, 1.0},
    {1.221224509226641, 6.019134481288629, 12.53708332932087, -0.687886036105895, 1.0, 1.0},
};
static const double RATE[STAGES][STAGES] = {
    {0.0},
    {-5.6688},
    {-2.430093356833875, -0.2063599157091915},
    {-0.1073529058151375, -9.594562251023355, -20.47028614809616},
    {7.496443313967647, -10.24680431464352, -33.99990352819905, 11.7089089320616},
    {8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136, -6.058818238834054},
};

/* Of the tolerance, what elimination without exchange of rows may cost. */
#define MOST_LOSS 0.1
/* An estimate for which the step is halved. */
#define HALVING 16.0

/* Derivatives of a derivative that are infinite, as that of a square root at 0, are left out: then the estimate of the
 * error alone keeps the step short. */
static void leave_out_infinite(double v[], int n) {
    for (int i = 0; i < n; i++)
        if (!isfinite(v[i])) v[i] = 0.0;
}

void method_prepare(Core *core, double time, const double x[], const double u[]) {
#if N_COLOURS > 0
    double dx[N_X], change[N_X];
    for (int colour = 0; colour < N_COLOURS; colour++) {
        for (int i = 0; i < N_X; i++) dx[i] = model_colours[i] == colour;
        model_rates_direction(time, x, u, PARAMETERS(core), dx, change);
        for (int i = 0, k = 0; i < N_X; i++)
            for (; k < N_JACOBIAN && model_jacobian_places[k] < model_factor_rows[i + 1]; k++) {
                int column = model_pivots[model_factor_columns[model_jacobian_places[k]]];
                if (model_colours[column] == colour) core->jacobian[k] = change[model_pivots[i]];
            }
    }
#else
    model_jacobian(time, x, u, PARAMETERS(core), core->jacobian);
#endif
    leave_out_infinite(core->jacobian, N_JACOBIAN);
}

void method_arrive(Core *core, double time, const double x[], const double u[], double rates[]) {
    model_rates(time, x, u, PARAMETERS(core), rates);
}

CoreStatus method_step(Core *core, double time, double h, const double x[], const double u[], const double u_rate[],
                       const double rates[], double next[], double *error) {
    double (*k)[N_X] = core->stages, change[N_X], b[N_X], loss[N_X], at_u[N_U + 1],
           at_rates[N_X + N_STEP_REQUIREMENTS + 1];
    double shift = 1.0 / (GAMMA * h);
    int lossy = 0;
    lu_factorise(core->jacobian, shift, core->factors);
    model_time_derivative(time, x, u, PARAMETERS(core), u_rate, change);
    leave_out_infinite(change, N_X);
    for (int stage = 0; stage < STAGES; stage++) {
        if (stage > 0) {
            for (int i = 0; i < N_X; i++) next[i] = x[i];
            for (int j = 0; j < stage; j++)
                for (int i = 0; i < N_X; i++) next[i] += STATE[stage][j] * k[j][i];
            for (int i = 0; i < N_U; i++) at_u[i] = u[i] + TIMES[stage] * h * u_rate[i];
            if (!core_usable_rates(core, time + TIMES[stage] * h, next, at_u, at_rates))
                return *error = lossy ? HALVING : NAN, CORE_OK;
            rates = at_rates;
        }
        for (int i = 0; i < N_X; i++) b[i] = rates[i] + TIME_DERIVATIVE[stage] * h * change[i];
        for (int j = 0; j < stage; j++)
            for (int i = 0; i < N_X; i++) b[i] += RATE[stage][j] / h * k[j][i];
        lu_solve(core->factors, b, k[stage]);
        if (stage == 0) { /* the change by one step of iterative refinement is what the first solution lacks */
            lu_residual(core->jacobian, shift, b, k[0], b);
            lu_solve(core->factors, b, loss);
            lossy = !(core_scaled(core, loss, x, x) <= MOST_LOSS);
        }
    }
    for (int i = 0; i < N_X; i++) next[i] = x[i];
    for (int j = 0; j < STAGES; j++)
        for (int i = 0; i < N_X; i++) next[i] += STATE[STAGES][j] * k[j][i];
    *error = lossy ? HALVING : core_scaled(core, k[STAGES - 1], x, next);
    return CORE_OK;
}

void method_damp(const Core *core, double h, double change[]) {
    double damped[N_X];
    lu_solve(core->factors, change, damped);
    for (int i = 0; i < N_X; i++) change[i] = damped[i] / (GAMMA * h);
}

/* The smaller of what this estimate and what its change since the step before predict (Gustafsson, (IV.8.25)). */
double method_factor(const StepControl *last, double h, double error) {
    double factor = factor_of(error);
    if (last && last->size > 0.0) {
        double predicted = factor * (h / last->size) * sqrt(sqrt(last->error / error));
        if (predicted < factor) factor = predicted;
    }
    return factor;
}
