/* When the solver rk43 leaves out the estimate of its error: in communication steps that are much shorter than it allows. */
#ifndef RK43_H
#define RK43_H

#include "core.h"
#include "step_control.h"

#include <math.h>

/* Whether a communication step needs no estimate, one now and then being enough. */
static int passes_over(Core *core, double step) {
    StepControl *control = &core->state.control;
    int passes = !HYBRID && step <= MUCH_SHORTER * control->proposed && step <= PARAMETERS(core)[MAX_STEP] &&
                 control->passed_over < ONE_OF - 1;
    control->passed_over = passes ? control->passed_over + 1.0 : 0.0;
    return passes;
}

/* Whether nothing sudden has happened in such a step from `x`, where the derivatives are `k1`. */
static int was_smooth(const Core *core, double h, const double x[], const double k1[]) {
    int sudden = 0;
    for (int i = 0; i < N_X; i++)
        sudden |= !(fabs(h * (core->stages[2][i] - k1[i])) <= small_change(fabs(x[i]), model_nominals[i]));
    return !sudden;
}

#endif
