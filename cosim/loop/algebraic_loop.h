/* Algebraic loops: outputs that depend on themselves at the same instant. Some connections are torn, so that the exchange
 * can be performed in order; what they carry is found by iteration. algebraic_loop.py lays the struct out once more. */
#ifndef ALGEBRAIC_LOOP_H
#define ALGEBRAIC_LOOP_H

#include "loop.h"

/* A part of how a change goes through an exchange: through an FMU, from inputs to outputs by its directional derivative, or,
 * without a function, through a connection. */
typedef struct {
    void *function, *instance; /* fmi2GetDirectionalDerivative or fmi3GetDirectionalDerivative; NULL for a connection */
    const uint32_t *unknowns, *knowns;
    const int32_t *to, *from; /* positions of n_to outputs and n_from inputs, or of both ends of a connection */
    double *seed, *change;
    double factor; /* of the connection */
    int32_t n_to, n_from, version;
    uint32_t code;
} Direction;

typedef struct {
    const Operation *operations; /* an exchange, in which the torn connections carry what was assumed */
    const uint32_t *codes;
    int64_t n_operations;
    const int32_t *positions; /* of the n assumed values, and after them of the outputs that they stand for */
    double *jacobian; /* n rows: of outputs less assumed values by assumed values */
    double *factors, *residuals, *tried, *step, *assumed; /* n * n, and n each */
    double *outputs, *origin; /* n outputs, and n values that were assumed, before the iterations */
    double *way; /* room for following solutions: n * (n + 1) + (n + 1) * (n + 1) + 5 * (n + 1) */
    const Direction *directions; /* in the order of the exchange; NULL where the Jacobian comes from differences */
    double *changes; /* all n_values */
    double tolerance; /* relative, of what is carried */
    int64_t n_values;
    int32_t n_directions, is_directed; /* whether all FMUs have given their directional derivatives up to now */
    int32_t n, most; /* iterations at a point */
    int32_t has_jacobian, follows; /* whether solutions may be followed */
    int64_t n_points, n_iterations, n_exchanges, failed_operation;
    double largest_residual, residual; /* over the size of what is carried; of the run, of the last point */
} AlgebraicLoop;

/* Statuses beyond those of the loop. */
enum { NO_SOLUTION = 130 };

/* Function of a GROUP operation behind the exchange: repeats it until torn connections carry what comes out. */
EXPORT int solve_algebraic_loop(const Loop *loop, const Operation *op, int64_t point, double time);

#endif
