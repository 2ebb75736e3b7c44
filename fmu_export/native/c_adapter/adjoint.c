/* Adjoint derivatives, which FMI 3.0 has. */
#include "core.h"

#include <math.h>

/* What the sum of outputs, locals and state derivatives, weighted by `weights`, changes by with each state, input and
 * parameter; and the same of the initial states with each parameter. They stand in model_adjoint.c. */
void model_adjoint(double t, const double *x, const double *u, const double *p, const double *weights, double *y);
void model_initial_state_adjoint(const double *p, const double *weights, double *y);

CoreStatus core_adjoint(Core *core, const unsigned unknowns[], size_t n, const double seed[], const unsigned knowns[],
                        size_t m, double result[]) {
    CoreState *s = &core->state;
    double weights[N_Y + N_X + 1] = {0}, sums[N_X + N_U + N_P + 1] = {0}, of_start[N_P + 1] = {0};
    int initial = (s->phase & INITIALIZATION) != 0;
    for (size_t i = 0; i < n; i++) {
        if (unknowns[i] < N_PU || unknowns[i] >= N_VALUES)
            return core_fail(core, CORE_ERROR,
                             "value reference %lu is not an unknown: give outputs or state derivatives",
                             (unsigned long)unknowns[i]);
        if (!isfinite(seed[i])) return core_fail(core, CORE_ERROR, "the seed has entries that are not finite");
        weights[unknowns[i] - N_PU] += seed[i];
    }
    CoreStatus status = core_have_states(core);
    if (status != CORE_OK) return status;
    model_adjoint(s->time, STATES(core), INPUTS(core), PARAMETERS(core), weights, sums);
    if (initial) model_initial_state_adjoint(PARAMETERS(core), sums, of_start);
    for (size_t i = 0; i < m; i++) {
        unsigned known = knowns[i];
        int state = known >= N_PU && known < N_VARIABLES ? model_output_states[known - N_PU] : -1;
        if (known < N_P) result[i] = sums[N_X + N_U + known] + of_start[known];
        else if (known < N_PU) result[i] = sums[N_X + known - N_P];
        else if (state >= 0) result[i] = initial ? 0.0 : sums[state];
        else
            return core_fail(core, CORE_ERROR, "value reference %lu is not a known: give states, inputs or parameters",
                             (unsigned long)known);
        if (!isfinite(result[i]))
            return core_fail(core, CORE_DISCARD, "t = %.9g s: the adjoint derivative by '%s' is not finite", s->time,
                             model_names[known]);
    }
    return CORE_OK;
}
