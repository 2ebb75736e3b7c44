#include "algebraic_loop.h"

#include <float.h>
#include <math.h>
#include <string.h>

/* A status of FMI after which another trial may do. */
enum { DISCARDED = 2 };

/* Halvings of a step of Newton's method before another Jacobian is tried. */
enum { MOST_HALVINGS = 12 };

/* Parts of the way from what was assumed to the solution, where Newton's method does not find it: the first and the
 * shortest. */
#define FIRST_PART 0.1
#define SHORTEST_PART 1e-4

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
        residuals[i] = loop->values[a->positions[a->n + i]] - loop->values[a->positions[i]] - a->kept * a->offset[i];
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

/* The Jacobian by differences: one exchange for each torn value. */
static int differentiate(AlgebraicLoop *a, const Loop *loop, int64_t point) {
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

/* Solve jacobian * step = -residuals by elimination with pivots; false where the Jacobian is singular. */
static bool newton_step(AlgebraicLoop *a) {
    int32_t n = a->n;
    double *m = a->factors, *x = a->step;
    memcpy(m, a->jacobian, (size_t)n * (size_t)n * sizeof *m);
    for (int32_t i = 0; i < n; i++) x[i] = -a->residuals[i];
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

/* Begin again at what was assumed first, and follow the solutions while its residuals are taken away bit by bit. */
static int follow(AlgebraicLoop *a, const Loop *loop, int64_t point, double *origin) {
    double *values = loop->values, done = 0.0, step = FIRST_PART;
    size_t size = (size_t)a->n * sizeof(double);
    double *last = origin + a->n; /* the last solution on the way */
    memcpy(last, origin, size);
    while (done < 1.0) {
        double target = fmin(1.0, done + step);
        memcpy(a->assumed, last, size);
        assume(a, values, a->assumed, 0.0);
        a->kept = 0.0;
        int status = evaluate(a, loop, point, a->residuals);
        if (!status && done == 0.0) memcpy(a->offset, a->residuals, size);
        a->kept = 1.0 - target;
        for (int32_t i = 0; !status && i < a->n; i++) a->residuals[i] -= a->kept * a->offset[i];
        a->has_jacobian = false;
        if (!status) status = iterate(a, loop, point);
        a->kept = 0.0;
        if (status && status != NO_SOLUTION && status != DISCARDED && status != NOT_FINITE) return status;
        if (status) {
            step *= 0.5;
            if (step < SHORTEST_PART) return NO_SOLUTION;
            continue;
        }
        memcpy(last, a->assumed, size);
        done = target;
        step *= 2.0;
    }
    return 0;
}

int solve_algebraic_loop(const Loop *loop, const Operation *op, int64_t point, double time) {
    (void)time;
    AlgebraicLoop *a = op->data;
    double *values = loop->values, *origin = a->origin;
    a->n_points++;
    a->kept = 0.0;
    for (int32_t i = 0; i < a->n; i++) { /* the exchange has been performed */
        origin[i] = a->assumed[i] = values[a->positions[i]];
        a->residuals[i] = values[a->positions[a->n + i]] - a->assumed[i];
    }
    int status = iterate(a, loop, point);
    double residual = a->residual;
    if (status == NO_SOLUTION && (status = follow(a, loop, point, origin))) {
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
    FIELD(AlgebraicLoop, offset),
    FIELD(AlgebraicLoop, origin),
    FIELD(AlgebraicLoop, tolerance),
    FIELD(AlgebraicLoop, kept),
    FIELD(AlgebraicLoop, n),
    FIELD(AlgebraicLoop, most),
    FIELD(AlgebraicLoop, has_jacobian),
    FIELD(AlgebraicLoop, padding),
    FIELD(AlgebraicLoop, n_points),
    FIELD(AlgebraicLoop, n_iterations),
    FIELD(AlgebraicLoop, n_exchanges),
    FIELD(AlgebraicLoop, failed_operation),
    FIELD(AlgebraicLoop, largest_residual),
    FIELD(AlgebraicLoop, residual),
    {NULL, 0, 0},
};

EXPORT const Field *algebraic_loop_layout(void) { return layout; }
