/* Iterated steps: all components step with extrapolated inputs; then, until the values at the end of the step are those that
 * their inputs went to, they go back and step again with inputs interpolated up to there. iterated_step.py lays the struct out
 * once more. */
#ifndef ITERATED_STEP_H
#define ITERATED_STEP_H

#include "kept_states.h"

/* What an iterated step performs, and of which the number tells where it has failed. */
enum { KEEPING, GOING_BACK, STEPPING, EXCHANGING, SETTING };

typedef struct {
    /* operations of a step, of an exchange at its end, and those that set held inputs for a step that is repeated */
    const Operation *steps, *exchange, *sets;
    const uint32_t *codes_of_steps, *codes_of_exchange, *codes_of_sets;
    int64_t n_steps, n_exchange, n_sets;
    KeptState *states;
    const int32_t
        *positions; /* of n values at the end of the step: inputs that are iterated, and rates of some; then n_held
                                 of those inputs among them that are held, in a repeated step at what they are at its end */
    double *before, *ahead; /* all n_values: at this point, and what inputs go to */
    double *found, *residuals, *best, *sizes; /* n each; sizes: the largest magnitudes of the run */
    double *last_found, *last_residuals;
    double *differences; /* columns rows of 2 n: of residuals and of what was found, the newest first */
    double *basis, *weights, *room; /* columns rows of n; columns * (columns + 1); n */
    int32_t *chosen; /* columns of them */
    double tolerance, acceptable; /* residuals, relative: where the iteration ends, and which do */
    int64_t n_values;
    int32_t n, n_held, n_states, most, columns, n_columns;
    int32_t must_converge; /* a step without a solution fails */
    int32_t demanded; /* an FMU that refuses what its inputs do during a step is an error */
    int32_t failed_in, most_taken;
    int64_t n_points, n_iterations, n_unsolved, failed;
    double largest_residual, residual; /* of the run, of the last step */
} IteratedStep;

/* Status beyond those of the loop. */
enum { NOT_CONVERGED = 131 };

/* Function of a GROUP operation: all steps from a communication point to the next one. */
EXPORT int step_iterated(const Loop *loop, const Operation *op, int64_t point, double time);

#endif
