#include "algebraic_loop.h"

#include <float.h>
#include <math.h>
#include <string.h>

/* A status of FMI after which another trial may do. */
enum { DISCARDED = 2 };

/* Halvings of a step of Newton's method before another Jacobian is tried. */
enum { MOST_HALVINGS = 12 };

/* Where Newton's method finds nothing, solutions are followed: the first step and the shortest one, steps and corrections
 * in a step at most, and how near to their way. */
#define FIRST_PART 0.1
#define SHORTEST_PART 1e-5
enum { LONGEST_WAY = 500, MOST_CORRECTIONS = 8 };
#define NEAR_WAY 1e-4

/* Values smaller than this are zero beside whatever else the loop carries. */
#define NEGLIGIBLE 1e-14

/* Perform the exchange with what is assumed now; residuals are outputs less assumed values. */
static int evaluate(AlgebraicLoop *a, const Loop *loop, int64_t point, double *residuals) {
    int status = 0;
    a->n_exchanges++;
    int64_t done = loop_perform_some(loop, loop->call, a->operations, a->codes, a->n_operations, point, &status);
    a->failed_operation = done;
    if (done < a->n_operations) return status;
    for (int32_t i = 0; i < a->n; i++)
        residuals[i] = loop->values[a->positions[a->n + i]] - loop->values[a->positions[i]];
    return 0;
}

/* Root of the mean square of residuals over the size of what is carried. */
static double norm(const AlgebraicLoop *a, const double *values, const double *residuals) {
    double largest = 0.0, sum = 0.0;
    for (int32_t i = 0; i < a->n; i++) largest = fmax(largest, fabs(values[a->positions[i]]));
    for (int32_t i = 0; i < a->n; i++) {
        double size = fmax(fabs(values[a->positions[i]]), 1e-2 * largest) + NEGLIGIBLE / a->tolerance;
        sum += residuals[i] / size * (residuals[i] / size);
    }
    return sqrt(sum / a->n);
}

static void assume(const AlgebraicLoop *a, double *values, const double *from, double part) {
    for (int32_t i = 0; i < a->n; i++) values[a->positions[i]] = from[i] + (part == 0.0 ? 0.0 : part * a->step[i]);
}

/* How a change that is in a->changes goes on; false where an FMU does not say. */
static bool carry_change(const AlgebraicLoop *a, const Loop *loop, const Direction *d) {
    if (!d->function) {
        a->changes[d->to[0]] = d->factor * a->changes[d->from[0]];
        return true;
    }
    size_t n = (size_t)d->n_to, m = (size_t)d->n_from;
    for (size_t i = 0; i < m; i++) d->seed[i] = a->changes[d->from[i]];
    loop->call->code = d->code;
    int status = loop_directional_derivative(d->function, d->version, d->instance, d->unknowns, n, d->knowns, m,
                                             d->seed, d->change);
    for (size_t i = 0; i < n; i++) {
        if (status > 1 || !isfinite(d->change[i])) return false;
        a->changes[d->to[i]] = d->change[i];
    }
    return true;
}

/* The Jacobian by the chain rule through the exchange, once that has been performed with what is assumed; false where that
 * can't be had. */
static bool differentiate_directly(AlgebraicLoop *a, const Loop *loop, int64_t point) {
    assume(a, loop->values, a->assumed, 0.0);
    if (evaluate(a, loop, point, a->tried)) return false;
    for (int32_t j = 0; j < a->n; j++) {
        memset(a->changes, 0, (size_t)a->n_values * sizeof *a->changes);
        a->changes[a->positions[j]] = 1.0;
        for (int32_t k = 0; k < a->n_directions; k++)
            if (!carry_change(a, loop, &a->directions[k])) {
                a->is_directed = false;
                return false;
            }
        for (int32_t i = 0; i < a->n; i++)
            a->jacobian[i * a->n + j] = a->changes[a->positions[a->n + i]] - (i == j ? 1.0 : 0.0);
    }
    a->has_jacobian = true;
    return true;
}

/* The Jacobian by differences: one exchange for each torn value. */
static int differentiate(AlgebraicLoop *a, const Loop *loop, int64_t point) {
    if (a->is_directed && differentiate_directly(a, loop, point)) return 0;
    double *values = loop->values, largest = 0.0;
    for (int32_t i = 0; i < a->n; i++) largest = fmax(largest, fabs(a->assumed[i]));
    for (int32_t j = 0; j < a->n; j++) {
        double size = fmax(fabs(a->assumed[j]), 1e-3 * largest);
        double step = sqrt(DBL_EPSILON) * (size > 0.0 ? size : 1.0);
        int status = 0;
        for (int k = 0; k < 2; k++) { /* the other way where it can't go this one */
            assume(a, values, a->assumed, 0.0);
            values[a->positions[j]] += step;
            step = values[a->positions[j]] - a->assumed[j];
            status = evaluate(a, loop, point, a->tried);
            if (!status) break;
            if (status != DISCARDED && status != NOT_FINITE) return status;
            step = -step;
        }
        if (status) return status;
        for (int32_t i = 0; i < a->n; i++) a->jacobian[i * a->n + j] = (a->tried[i] - a->residuals[i]) / step;
    }
    a->has_jacobian = true;
    return 0;
}

/* Solve m * solution = x, of n equations, by elimination with pivots, in place; false where m is singular. */
static bool eliminate(double *m, double *x, int32_t n) {
    for (int32_t k = 0; k < n; k++) {
        int32_t pivot = k;
        for (int32_t i = k + 1; i < n; i++)
            if (fabs(m[i * n + k]) > fabs(m[pivot * n + k])) pivot = i;
        if (!(fabs(m[pivot * n + k]) > DBL_MIN)) return false;
        if (pivot != k) {
            for (int32_t j = 0; j < n; j++) {
                double other = m[k * n + j];
                m[k * n + j] = m[pivot * n + j], m[pivot * n + j] = other;
            }
            double other = x[k];
            x[k] = x[pivot], x[pivot] = other;
        }
        for (int32_t i = k + 1; i < n; i++) {
            double factor = m[i * n + k] / m[k * n + k];
            for (int32_t j = k + 1; j < n; j++) m[i * n + j] -= factor * m[k * n + j];
            x[i] -= factor * x[k];
        }
    }
    for (int32_t k = n - 1; k >= 0; k--) {
        for (int32_t j = k + 1; j < n; j++) x[k] -= m[k * n + j] * x[j];
        x[k] /= m[k * n + k];
        if (!isfinite(x[k])) return false;
    }
    return true;
}

/* Solve jacobian * step = -residuals. */
static bool newton_step(AlgebraicLoop *a) {
    memcpy(a->factors, a->jacobian, (size_t)a->n * (size_t)a->n * sizeof *a->factors);
    for (int32_t i = 0; i < a->n; i++) a->step[i] = -a->residuals[i];
    return eliminate(a->factors, a->step, a->n);
}

/* Broyden's update: the smallest change of the Jacobian that explains what a part of the step has done. */
static void learn(AlgebraicLoop *a, const double *before, const double *after, double part) {
    double squares = 0.0;
    for (int32_t j = 0; j < a->n; j++) squares += part * a->step[j] * part * a->step[j];
    if (!(squares > 0.0)) return;
    for (int32_t i = 0; i < a->n; i++) {
        double missed = after[i] - before[i];
        for (int32_t j = 0; j < a->n; j++) missed -= a->jacobian[i * a->n + j] * part * a->step[j];
        for (int32_t j = 0; j < a->n; j++) a->jacobian[i * a->n + j] += missed * part * a->step[j] / squares;
    }
}

/* Newton's method from what is assumed, whose residuals are known. */
static int iterate(AlgebraicLoop *a, const Loop *loop, int64_t point) {
    double *values = loop->values, *residuals = a->residuals;
    bool is_new = false;
    double now = norm(a, values, residuals);
    for (int32_t k = 0; k < a->most && !(now <= a->tolerance); k++) {
        int status;
        if (!a->has_jacobian) {
            if ((status = differentiate(a, loop, point))) return status;
            is_new = true;
        }
        a->n_iterations++;
        double part = 1.0, next = INFINITY;
        bool solved = newton_step(a), better = false;
        for (int j = 0; solved && !better && j < MOST_HALVINGS; j++, part *= 0.5) {
            assume(a, values, a->assumed, part);
            status = evaluate(a, loop, point, a->tried);
            if (status && status != DISCARDED && status != NOT_FINITE) return status;
            next = status ? INFINITY : norm(a, values, a->tried);
            better = next <= a->tolerance || next < (1.0 - 1e-4 * part) * now;
            if (better || !is_new) break; /* an old Jacobian is not worth halving */
        }
        if (better) {
            learn(a, residuals, a->tried, part);
            if (next > 0.3 * now) a->has_jacobian = is_new = false; /* too slow: the next step has one of its own */
            memcpy(residuals, a->tried, (size_t)a->n * sizeof *residuals);
            for (int32_t i = 0; i < a->n; i++) a->assumed[i] = values[a->positions[i]];
            now = next;
            continue;
        }
        assume(a, values, a->assumed, 0.0);
        if (is_new) break; /* no part of Newton's direction is any better */
        a->has_jacobian = false;
    }
    a->residual = now;
    return now <= a->tolerance ? 0 : NO_SOLUTION;
}

/* Residuals on the way: of part * outputs + (1 - part) * origin less assumed values, all over `size`; those of the loop in
 * a->residuals. */
static int residuals_on_way(AlgebraicLoop *a, const Loop *loop, int64_t point, const double *origin, double size,
                            const double *at, double *h) {
    int32_t n = a->n;
    for (int32_t i = 0; i < n; i++) loop->values[a->positions[i]] = a->assumed[i] = size * at[i];
    int status = evaluate(a, loop, point, a->residuals);
    if (status) return status;
    for (int32_t i = 0; i < n; i++)
        h[i] = (at[n] * a->residuals[i] + (1.0 - at[n]) * (origin[i] - a->assumed[i])) / size;
    return 0;
}

/* The derivatives (n, n + 1) of these residuals, by differences, at the place where they were computed last. */
static int slopes_on_way(AlgebraicLoop *a, const Loop *loop, int64_t point, const double *origin, double size,
                         double part, double *slopes) {
    int32_t n = a->n;
    int status = differentiate(a, loop, point);
    if (status) return status;
    for (int32_t i = 0; i < n; i++) {
        for (int32_t j = 0; j < n; j++)
            slopes[i * (n + 1) + j] = part * a->jacobian[i * n + j] - (1.0 - part) * (i == j);
        slopes[i * (n + 1) + n] = (a->residuals[i] + a->assumed[i] - origin[i]) / size;
    }
    return 0;
}

static bool may_go_on(int status) { return !status || status == DISCARDED || status == NOT_FINITE; }

/* Follow the solutions of part * outputs + (1 - part) * origin = assumed from part = 0, where what was assumed first is
 * one, to part = 1. The way may turn back for a while: it is followed by its length. */
static int follow(AlgebraicLoop *a, const Loop *loop, int64_t point, const double *origin) {
    int32_t n = a->n, m = n + 1;
    double *slopes = a->way, *matrix = slopes + n * m, *at = matrix + m * m, *next = at + m, *direction = next + m,
           *ahead = direction + m, *h = ahead + m, size = 0.0, length = FIRST_PART;
    for (int32_t i = 0; i < n; i++) size = fmax(size, fmax(fabs(origin[i]), fabs(a->outputs[i])));
    if (!(size > 0.0)) size = 1.0;
    for (int32_t i = 0; i < n; i++) at[i] = origin[i] / size, direction[i] = 0.0;
    at[n] = 0.0, direction[n] = 1.0;
    int status = residuals_on_way(a, loop, point, origin, size, at, h);
    for (int32_t k = 0; k < LONGEST_WAY; k++) {
        if (!status) status = slopes_on_way(a, loop, point, origin, size, at[n], slopes);
        if (status) return status;
        /* the direction of the way: along it nothing changes, and it does not turn round */
        memcpy(matrix, slopes, (size_t)(n * m) * sizeof *matrix);
        memcpy(matrix + n * m, direction, (size_t)m * sizeof *matrix);
        for (int32_t i = 0; i < n; i++) ahead[i] = 0.0;
        ahead[n] = 1.0;
        if (!eliminate(matrix, ahead, m)) return NO_SOLUTION;
        double squares = 0.0;
        for (int32_t i = 0; i < m; i++) squares += ahead[i] * ahead[i];
        for (int32_t i = 0; i < m; i++) direction[i] = ahead[i] / sqrt(squares);
        bool is_there = false, found = false;
        for (; !found && length >= SHORTEST_PART; length *= found ? 1.0 : 0.5) {
            double taken = length;
            is_there = direction[n] > 0.0 && at[n] + length * direction[n] >= 1.0;
            if (is_there) taken = (1.0 - at[n]) / direction[n];
            for (int32_t i = 0; i < m; i++) next[i] = at[i] + taken * direction[i];
            double last = INFINITY;
            for (int j = 0; j < MOST_CORRECTIONS && !found; j++) { /* back to the way, across its direction */
                status = residuals_on_way(a, loop, point, origin, size, next, h);
                if (!may_go_on(status)) return status;
                if (status) break;
                double largest = 0.0;
                for (int32_t i = 0; i < n; i++) largest = fmax(largest, fabs(h[i]));
                found = largest <= NEAR_WAY;
                if (found || !(largest < 0.8 * last)) break;
                last = largest;
                memcpy(matrix, slopes, (size_t)(n * m) * sizeof *matrix);
                for (int32_t i = 0; i < m; i++) matrix[n * m + i] = is_there ? i == n : direction[i];
                for (int32_t i = 0; i < n; i++) ahead[i] = -h[i];
                ahead[n] = 0.0;
                if (!eliminate(matrix, ahead, m)) break;
                for (int32_t i = 0; i < m; i++) next[i] += ahead[i];
            }
        }
        if (!found) return NO_SOLUTION;
        memcpy(at, next, (size_t)m * sizeof *at);
        if (is_there) break;
        length *= 1.5;
        if (at[n] < -1.0) return NO_SOLUTION;
    }
    if (at[n] < 1.0 - NEAR_WAY) return NO_SOLUTION;
    a->has_jacobian = false;
    return iterate(a, loop, point);
}

int solve_algebraic_loop(const Loop *loop, const Operation *op, int64_t point, double time) {
    (void)time;
    AlgebraicLoop *a = op->data;
    double *values = loop->values, *origin = a->origin;
    a->n_points++;
    for (int32_t i = 0; i < a->n; i++) { /* the exchange has been performed */
        origin[i] = a->assumed[i] = values[a->positions[i]];
        a->outputs[i] = values[a->positions[a->n + i]];
        a->residuals[i] = a->outputs[i] - a->assumed[i];
    }
    int status = iterate(a, loop, point);
    double residual = a->residual;
    if (status == NO_SOLUTION && a->follows && (status = follow(a, loop, point, origin))) {
        a->residual = residual;
        a->has_jacobian = false;
    }
    if (status) return status;
    a->largest_residual = fmax(a->largest_residual, a->residual);
    return 0;
}

#define STRUCT(type) {#type, 0, sizeof(type)}
#define FIELD(type, field) {#type "." #field, offsetof(type, field), sizeof(((type *)0)->field)}

static const Field layout[] = {
    STRUCT(Direction),
    FIELD(Direction, function),
    FIELD(Direction, instance),
    FIELD(Direction, unknowns),
    FIELD(Direction, knowns),
    FIELD(Direction, to),
    FIELD(Direction, from),
    FIELD(Direction, seed),
    FIELD(Direction, change),
    FIELD(Direction, factor),
    FIELD(Direction, n_to),
    FIELD(Direction, n_from),
    FIELD(Direction, version),
    FIELD(Direction, code),
    STRUCT(AlgebraicLoop),
    FIELD(AlgebraicLoop, operations),
    FIELD(AlgebraicLoop, codes),
    FIELD(AlgebraicLoop, n_operations),
    FIELD(AlgebraicLoop, positions),
    FIELD(AlgebraicLoop, jacobian),
    FIELD(AlgebraicLoop, factors),
    FIELD(AlgebraicLoop, residuals),
    FIELD(AlgebraicLoop, tried),
    FIELD(AlgebraicLoop, step),
    FIELD(AlgebraicLoop, assumed),
    FIELD(AlgebraicLoop, outputs),
    FIELD(AlgebraicLoop, origin),
    FIELD(AlgebraicLoop, way),
    FIELD(AlgebraicLoop, directions),
    FIELD(AlgebraicLoop, changes),
    FIELD(AlgebraicLoop, tolerance),
    FIELD(AlgebraicLoop, n_values),
    FIELD(AlgebraicLoop, n_directions),
    FIELD(AlgebraicLoop, is_directed),
    FIELD(AlgebraicLoop, n),
    FIELD(AlgebraicLoop, most),
    FIELD(AlgebraicLoop, has_jacobian),
    FIELD(AlgebraicLoop, follows),
    FIELD(AlgebraicLoop, n_points),
    FIELD(AlgebraicLoop, n_iterations),
    FIELD(AlgebraicLoop, n_exchanges),
    FIELD(AlgebraicLoop, failed_operation),
    FIELD(AlgebraicLoop, largest_residual),
    FIELD(AlgebraicLoop, residual),
    {NULL, 0, 0},
};

EXPORT const Field *algebraic_loop_layout(void) { return layout; }
