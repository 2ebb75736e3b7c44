#include "iterated_step.h"

#include <math.h>
#include <string.h>

/* Values smaller than this part of the largest one of the system, or than that, count as these: they may be rounding. */
#define NEGLIGIBLE 1e-9
#define NEGLIGIBLE_FOR_FAILURE 1e-5
#define TINY 1e-12

/* A difference that lies in the space of newer ones up to this part of itself tells nothing new. */
#define NOTHING_NEW 1e-7

/* A trial that an FMU can't compute is drawn towards the best one by this factor, so often. */
#define DRAWN 0.1
enum { MOST_DRAWN = 6 };

/* So many iterations in a row without a smaller residual are enough. */
enum { MOST_IN_VAIN = 8 };

/* A status of FMI after which another trial may do. */
enum { DISCARDED = 2 };

static bool may_go_on(int status) { return status == DISCARDED || status == NOT_FINITE; }

static bool is_extrapolated(const Operation *op, int32_t i) {
    int32_t first = op->n - op->n_targets;
    return i < first || op->targets[i - first] == EXTRAPOLATED;
}

/* All derivatives of inputs over the step: of polynomials that go to what is ahead, and through what extrapolation goes
 * by; where the FMU that gives the input says its rates, through these at both ends. */
static int interpolate(const IteratedStep *it, const Loop *loop, const Operation *op) {
    Extrapolated *in = op->data;
    int32_t n = op->n, degree = in->degree;
    for (int32_t i = 0; i < n; i++) {
        if (!is_extrapolated(op, i)) continue; /* a signal, which is known */
        double last = in->history[i], a = it->ahead[op->first + i] - last, b = 0.0, c = 0.0;
        if (in->rates && degree >= 2) {
            double rate = in->rates[i], next_rate = loop->step_size * it->ahead[in->first_rate + i], change = a;
            a = rate;
            if (degree == 2) b = change - rate;
            else b = 3.0 * change - 2.0 * rate - next_rate, c = rate + next_rate - 2.0 * change;
        } else if (!in->rates && degree >= 2 && in->known >= 2) {
            double change = a, before = in->history[n + i] - last;
            b = 0.5 * (change + before), a = 0.5 * (change - before);
            if (degree >= 3 && in->known >= 3) {
                c = (2.0 * b - 0.5 * (in->history[2 * n + i] - last) - a) / 3.0;
                a -= c;
            }
        }
        double *derivatives = in->derivatives + i, s = loop->per_second;
        derivatives[0] = a * s;
        if (degree >= 2) derivatives[n] = 2.0 * b * s * s;
        if (degree >= 3) derivatives[2 * n] = 6.0 * c * s * s * s;
    }
    if (op->version == 3) return in->refused > 0 ? in->refused : 0;
    typedef int Derivatives2(void *, const uint32_t *, size_t, const int32_t *, const double *);
    return ((Derivatives2 *)op->function)(op->instance, op->references, (size_t)op->n_references, in->orders,
                                          in->derivatives);
}

static int perform_in(IteratedStep *it, const Loop *loop, int what, const Operation operations[],
                      const uint32_t codes[], int64_t n, int64_t point) {
    int32_t status = 0;
    it->failed_in = what;
    it->failed = loop_perform_some(loop, loop->call, operations, codes, n, point, &status);
    return it->failed < n ? status : 0;
}

/* The exchange at the end of the step, and what was found there. */
static int find(IteratedStep *it, const Loop *loop, int64_t point) {
    int status = perform_in(it, loop, EXCHANGING, it->exchange, it->codes_of_exchange, it->n_exchange, point + 1);
    if (status) return status;
    for (int32_t i = 0; i < it->n; i++) {
        double found = loop->values[it->positions[i]];
        it->found[i] = found;
        it->residuals[i] = found - it->ahead[it->positions[i]];
        it->sizes[i] = fmax(it->sizes[i], fabs(found));
    }
    return 0;
}

/* FMI 3.0: an FMU that refused inputs during a step has them held, unless that is an error. */
static void forgive(const IteratedStep *it) {
    for (int64_t k = 0; k < it->n_steps; k++) {
        if (it->steps[k].kind != EXTRAPOLATE || it->steps[k].version != 3) continue;
        Extrapolated *in = it->steps[k].data;
        if (in->refused > 0 && !it->demanded) in->refused = -1;
    }
}

/* The first trial: all components step with extrapolated inputs, which go to what is then ahead. */
static int predict(IteratedStep *it, const Loop *loop, int64_t point) {
    forgive(it);
    int status = perform_in(it, loop, STEPPING, it->steps, it->codes_of_steps, it->n_steps, point);
    if (status) return status;
    memcpy(it->ahead, it->before, (size_t)it->n_values * sizeof *it->ahead);
    for (int64_t k = 0; k < it->n_steps; k++) {
        const Operation *op = &it->steps[k];
        if (op->kind != EXTRAPOLATE) continue;
        const Extrapolated *in = op->data;
        double step = loop->step_size;
        loop_evaluate(in, step, op->n);
        for (int32_t i = 0; i < op->n; i++) {
            if (!is_extrapolated(op, i)) continue;
            it->ahead[op->first + i] = in->buffer[i];
            double rate = 0.0;
            for (int32_t d = in->degree; d >= 1; d--) /* u' + s (u'' + s/2 u''') */
                rate = in->derivatives[(d - 1) * op->n + i] + rate * step / d;
            if (in->rates) it->ahead[in->first_rate + i] = rate;
        }
    }
    return find(it, loop, point);
}

/* Another trial: all components go back, and step with inputs that go to what is ahead. */
static int repeat(IteratedStep *it, const Loop *loop, int64_t point) {
    int32_t status = 0;
    it->failed_in = GOING_BACK;
    it->failed = go_back_to_states(loop->call, it->states, it->n_states, &status);
    if (status) return status;
    memcpy(loop->values, it->before, (size_t)it->n_values * sizeof *it->before);
    const int32_t *held = it->positions + it->n;
    for (int32_t i = 0; i < it->n_held; i++) loop->values[held[i]] = 0.5 * (it->before[held[i]] + it->ahead[held[i]]);
    status = perform_in(it, loop, SETTING, it->sets, it->codes_of_sets, it->n_sets, point);
    if (status) return status;
    for (int64_t k = 0; k < it->n_steps; k++) {
        it->failed_in = STEPPING, it->failed = k;
        if (it->steps[k].kind == EXTRAPOLATE) {
            loop->call->code = it->codes_of_steps[k];
            status = interpolate(it, loop, &it->steps[k]);
            if (status == 1) loop->warned(&it->steps[k]);
            if (status > 1) return status;
            continue;
        }
        int32_t of_step = 0;
        if (!loop_perform_some(loop, loop->call, &it->steps[k], &it->codes_of_steps[k], 1, point, &of_step))
            return of_step;
    }
    return find(it, loop, point);
}

static double size_of(const IteratedStep *it, int32_t i, double floor) { return fmax(it->sizes[i], floor) + TINY; }

static double largest_size(const IteratedStep *it) {
    double largest = 0.0;
    for (int32_t i = 0; i < it->n; i++) largest = fmax(largest, it->sizes[i]);
    return largest;
}

/* The largest residual, over the size of what it is one of. */
static double norm(const IteratedStep *it, const double *residuals, double negligible) {
    double floor = negligible * largest_size(it), largest = 0.0;
    for (int32_t i = 0; i < it->n; i++) {
        double part = fabs(residuals[i]) / size_of(it, i, floor);
        if (!(part <= largest)) largest = part; /* NaN, too */
    }
    return largest;
}

/* Note how residuals and what was found have changed from the trial before. */
static void learn(IteratedStep *it) {
    int32_t n = it->n;
    double *rows = it->differences;
    if (it->n_columns < it->columns) it->n_columns++;
    memmove(rows + 2 * n, rows, (size_t)(it->n_columns - 1) * 2 * (size_t)n * sizeof *rows);
    for (int32_t i = 0; i < n; i++) {
        rows[i] = it->residuals[i] - it->last_residuals[i];
        rows[n + i] = it->found[i] - it->last_found[i];
    }
}

/* What inputs shall go to: what was found, less what the differences explain of its residuals, by least squares. Those that
 * tell nothing new beside newer ones are left out. */
static void propose(IteratedStep *it) {
    int32_t n = it->n, m = it->columns, used = 0;
    double floor = NEGLIGIBLE * largest_size(it), *rest = it->room, *triangle = it->weights + m;
    for (int32_t i = 0; i < n; i++) {
        it->ahead[it->positions[i]] = it->found[i];
        rest[i] = it->residuals[i] / size_of(it, i, floor);
    }
    for (int32_t k = 0; k < it->n_columns; k++) {
        const double *of_residuals = it->differences + (int64_t)k * 2 * n;
        double *own = it->basis + (int64_t)used * n, *coefficients = triangle + (int64_t)used * m, before = 0.0,
               after = 0.0;
        for (int32_t i = 0; i < n; i++) {
            own[i] = of_residuals[i] / size_of(it, i, floor);
            before += own[i] * own[i];
        }
        for (int twice = 0; twice < 2; twice++)
            for (int32_t j = 0; j < used; j++) {
                const double *other = it->basis + (int64_t)j * n;
                double along = 0.0;
                for (int32_t i = 0; i < n; i++) along += other[i] * own[i];
                for (int32_t i = 0; i < n; i++) own[i] -= along * other[i];
                coefficients[j] = along + (twice ? coefficients[j] : 0.0);
            }
        for (int32_t i = 0; i < n; i++) after += own[i] * own[i];
        if (!(after > NOTHING_NEW * NOTHING_NEW * before)) continue;
        coefficients[used] = sqrt(after);
        for (int32_t i = 0; i < n; i++) own[i] /= coefficients[used];
        double along = 0.0;
        for (int32_t i = 0; i < n; i++) along += own[i] * rest[i];
        for (int32_t i = 0; i < n; i++) rest[i] -= along * own[i];
        it->weights[used] = along;
        it->chosen[used++] = k;
        if (used == n) break;
    }
    for (int32_t j = used - 1; j >= 0; j--) { /* the triangle, from its end */
        for (int32_t k = j + 1; k < used; k++) it->weights[j] -= triangle[(int64_t)k * m + j] * it->weights[k];
        it->weights[j] /= triangle[(int64_t)j * m + j];
        const double *of_found = it->differences + (int64_t)it->chosen[j] * 2 * n + n;
        for (int32_t i = 0; i < n; i++) it->ahead[it->positions[i]] -= it->weights[j] * of_found[i];
    }
}

static void note_best(IteratedStep *it) {
    for (int32_t i = 0; i < it->n; i++) it->best[i] = it->ahead[it->positions[i]];
}

static void draw_to_best(IteratedStep *it, double part) {
    for (int32_t i = 0; i < it->n; i++) {
        double *ahead = &it->ahead[it->positions[i]];
        *ahead = it->best[i] + part * (*ahead - it->best[i]);
    }
}

int step_iterated(const Loop *loop, const Operation *op, int64_t point, double time) {
    (void)time;
    IteratedStep *it = op->data;
    int32_t status = 0;
    it->failed_in = KEEPING;
    it->failed = keep_states(loop->call, it->states, it->n_states, &status);
    if (status) return status;
    memcpy(it->before, loop->values, (size_t)it->n_values * sizeof *it->before);
    if ((status = predict(it, loop, point))) return status;
    it->n_points++;
    if (loop_jumps_within(loop, point, point + 1)) { /* inputs do not go to what they jump to */
        it->residual = 0.0;
        return 0;
    }
    double now = norm(it, it->residuals, NEGLIGIBLE), least = now,
           for_failure = norm(it, it->residuals, NEGLIGIBLE_FOR_FAILURE);
    note_best(it);
    int32_t taken = 0, in_vain = 0;
    for (; taken < it->most && !(now <= it->tolerance) && in_vain < MOST_IN_VAIN; taken++) {
        memcpy(it->last_residuals, it->residuals, (size_t)it->n * sizeof *it->residuals);
        memcpy(it->last_found, it->found, (size_t)it->n * sizeof *it->found);
        propose(it);
        status = repeat(it, loop, point);
        for (int k = 0; may_go_on(status) && k < MOST_DRAWN; k++) {
            draw_to_best(it, DRAWN);
            status = repeat(it, loop, point);
        }
        if (status) return status;
        learn(it);
        now = norm(it, it->residuals, NEGLIGIBLE);
        in_vain = now < least ? 0 : in_vain + 1;
        if (!(now < least)) continue;
        least = now;
        for_failure = norm(it, it->residuals, NEGLIGIBLE_FOR_FAILURE);
        note_best(it);
    }
    it->n_iterations += taken;
    if (taken > it->most_taken) it->most_taken = taken;
    if (now > least) {
        draw_to_best(it, 0.0);
        if ((status = repeat(it, loop, point))) return status;
        it->n_iterations++;
    }
    it->residual = least;
    it->largest_residual = fmax(it->largest_residual, least);
    if (least > it->tolerance) it->n_unsolved++;
    return it->must_converge && !(for_failure <= it->acceptable) ? NOT_CONVERGED : 0;
}

#define STRUCT(type) {#type, 0, sizeof(type)}
#define FIELD(type, field) {#type "." #field, offsetof(type, field), sizeof(((type *)0)->field)}

static const Field layout[] = {
    STRUCT(KeptState),
    FIELD(KeptState, instance),
    FIELD(KeptState, get),
    FIELD(KeptState, set),
    FIELD(KeptState, state),
    FIELD(KeptState, code_of_get),
    FIELD(KeptState, code_of_set),
    STRUCT(IteratedStep),
    FIELD(IteratedStep, steps),
    FIELD(IteratedStep, exchange),
    FIELD(IteratedStep, sets),
    FIELD(IteratedStep, codes_of_steps),
    FIELD(IteratedStep, codes_of_exchange),
    FIELD(IteratedStep, codes_of_sets),
    FIELD(IteratedStep, n_steps),
    FIELD(IteratedStep, n_exchange),
    FIELD(IteratedStep, n_sets),
    FIELD(IteratedStep, states),
    FIELD(IteratedStep, positions),
    FIELD(IteratedStep, before),
    FIELD(IteratedStep, ahead),
    FIELD(IteratedStep, found),
    FIELD(IteratedStep, residuals),
    FIELD(IteratedStep, best),
    FIELD(IteratedStep, sizes),
    FIELD(IteratedStep, last_found),
    FIELD(IteratedStep, last_residuals),
    FIELD(IteratedStep, differences),
    FIELD(IteratedStep, basis),
    FIELD(IteratedStep, weights),
    FIELD(IteratedStep, room),
    FIELD(IteratedStep, chosen),
    FIELD(IteratedStep, tolerance),
    FIELD(IteratedStep, acceptable),
    FIELD(IteratedStep, n_values),
    FIELD(IteratedStep, n),
    FIELD(IteratedStep, n_held),
    FIELD(IteratedStep, n_states),
    FIELD(IteratedStep, most),
    FIELD(IteratedStep, columns),
    FIELD(IteratedStep, n_columns),
    FIELD(IteratedStep, must_converge),
    FIELD(IteratedStep, demanded),
    FIELD(IteratedStep, failed_in),
    FIELD(IteratedStep, most_taken),
    FIELD(IteratedStep, n_points),
    FIELD(IteratedStep, n_iterations),
    FIELD(IteratedStep, n_unsolved),
    FIELD(IteratedStep, failed),
    FIELD(IteratedStep, largest_residual),
    FIELD(IteratedStep, residual),
    {NULL, 0, 0},
};

EXPORT const Field *iterated_step_layout(void) { return layout; }
