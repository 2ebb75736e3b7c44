/* When the solver rk43 leaves out the estimate of its error: in communication steps that are much shorter than it allows. */
#ifndef RK43_H
#define RK43_H

#include "core.h"

#include <math.h>

/* A step of this part of what the last estimate allows has less than a hundredth of the error; of so many of them one gets an
 * estimate, which costs as much as two steps. */
#define MUCH_SHORTER 0.25
#define ONE_OF 1000

/* By how much derivatives times the step may change in such a step, of the states or of a part of their nominal values:
 * those of a state with a time constant of ten steps. */
#define SMALL_CHANGE 0.01
#define OF_NOMINAL 0.01

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
        sudden |=
            !(fabs(h * (core->stages[2][i] - k1[i])) <= SMALL_CHANGE * (OF_NOMINAL * model_nominals[i] + fabs(x[i])));
    return !sudden;
}

#endif
