#include "starting_block.h"

#include <math.h>
#include <string.h>

/* A block is found when a trial changes it by this part of the largest magnitude; it is taken where the last trial changed
 * it by the second, or by a hundredth of what the first one did. */
#define FOUND 1e-11
#define ACCEPTABLE 1e-9
#define CONTRACTED 0.01

/* Values smaller than this part of the largest one count as these. */
#define NEGLIGIBLE 1e-9
#define TINY 1e-30

enum { MOST_TRIALS = 10 };

bool starts_anew(const Loop *loop, int64_t point) {
    return point == 0 || !loop->start->first->known || loop_jumps_within(loop, point - 1, point);
}

static bool is_part(const Operation *op) { return op->kind == EXTRAPOLATE && ((const Extrapolated *)op->data)->ahead; }

/* All derivatives of inputs over the steps of the block: of polynomials through its values, and where they are known, rates. */
static void prescribe(const Loop *loop, const StartingBlock *block, const double *rows) {
    int64_t size = block->n_values;
    double s = loop->per_second, h = loop->step_size;
    for (int64_t o = 0; o < loop->n_at_step; o++) {
        const Operation *op = &loop->at_step[o];
        if (!is_part(op)) continue;
        Extrapolated *in = op->data;
        int32_t n = op->n, degree = in->degree;
        in->left = block->steps;
        for (int32_t k = 0; k < block->steps; k++) {
            double *to = in->ahead + (int64_t)(block->steps - 1 - k) * degree * n;
            int32_t first = k < block->steps - degree ? k : block->steps - degree;
            double x = in->rates ? 0.0 : k - first;
            const double *row = rows + (in->rates ? k : first) * size;
            for (int32_t i = 0; i < n; i++) {
                const double *value = row + op->first + i;
                double one = 0.0, two = 0.0, three = 0.0; /* the derivatives, times powers of the step */
                if (in->rates) {
                    const double *rate = row + in->first_rate + i;
                    double change = value[size] - value[0], begin = h * rate[0], end = h * rate[size];
                    one = begin;
                    if (degree == 2) two = 2.0 * (change - begin);
                    else two = 2.0 * (3.0 * change - 2.0 * begin - end), three = 6.0 * (begin + end - 2.0 * change);
                } else { /* Newton's form, by differences forward */
                    double a = value[size] - value[0], b = value[2 * size] - value[size], c = b - a, d = 0.0;
                    if (degree == 3) d = value[3 * size] - value[2 * size] - b - c;
                    one = a + c * (x - 0.5) + d * ((3.0 * x - 6.0) * x + 2.0) / 6.0;
                    two = c + d * (x - 1.0);
                    three = d;
                }
                to[i] = one * s;
                to[n + i] = two * s * s;
                if (degree == 3) to[2 * n + i] = three * s * s * s;
            }
        }
    }
}

/* What is extrapolated as it was before the block, for it to begin; `steps` of those of the block are prescribed. */
static void rewind(const Loop *loop, const StartingBlock *block) {
    for (int64_t o = 0, i = 0; o < loop->n_at_step; o++) {
        if (loop->at_step[o].kind != EXTRAPOLATE) continue;
        Extrapolated *in = loop->at_step[o].data;
        in->known = block->known[i];
        in->refused = block->refused[i++];
    }
}

static void forget(const Loop *loop) {
    for (int64_t o = 0; o < loop->n_at_step; o++)
        if (is_part(&loop->at_step[o])) ((Extrapolated *)loop->at_step[o].data)->left = 0;
}

static bool is_refused(const Loop *loop, const StartingBlock *block) {
    for (int64_t o = 0, i = 0; o < loop->n_at_step; o++) {
        if (loop->at_step[o].kind != EXTRAPOLATE) continue;
        if (((const Extrapolated *)loop->at_step[o].data)->refused > 0 && block->refused[i] <= 0) return true;
        i++;
    }
    return false;
}

/* All steps of the block, with what inputs then do; false where a component fails. */
static bool try_block(Loop *loop, StartingBlock *block, int64_t point) {
    int32_t status = 0;
    size_t size = (size_t)block->n_values;
    for (int32_t k = 0; k < block->steps; k++) {
        if (loop_perform_some(loop, loop->call, loop->at_step, loop->codes_at_step, loop->n_at_step, point + k,
                              &status) < loop->n_at_step)
            return false;
        if (loop_perform_some(loop, loop->call, loop->at_point, loop->codes_at_point, loop->n_at_point, point + k + 1,
                              &status) < loop->n_at_point)
            return false;
        memcpy(block->rows + (size_t)(k + 1) * size, loop->values, size * sizeof *loop->values);
    }
    block->n_trials++;
    return !is_refused(loop, block);
}

static bool go_back(Loop *loop, StartingBlock *block) {
    int32_t status = 0, done = go_back_to_states(loop->call, block->states, block->n_states, &status);
    memcpy(loop->values, block->rows, (size_t)block->n_values * sizeof *loop->values);
    rewind(loop, block);
    if (done == block->n_states) return true;
    block->failed = done;
    block->status = loop->status = status;
    loop->failed = 0;
    loop->failed_at_step = true;
    return false;
}

/* The largest change from the last trial to this one, over the size of what changes. */
static double change_of(const Loop *loop, const StartingBlock *block) {
    double largest = 0.0, part = 0.0;
    int64_t size = block->n_values;
    for (int pass = 0; pass < 2; pass++)
        for (int64_t o = 0; o < loop->n_at_step; o++) {
            const Operation *op = &loop->at_step[o];
            if (!is_part(op)) continue;
            const Extrapolated *in = op->data;
            for (int32_t i = 0, n = in->rates ? 2 * op->n : op->n; i < n; i++) {
                int64_t at = i < op->n ? op->first + i : in->first_rate + i - op->n;
                double own = 0.0, change = 0.0;
                for (int32_t k = 0; k <= block->steps; k++) {
                    double value = block->rows[k * size + at];
                    own = fmax(own, fabs(value));
                    double by = fabs(value - block->before[k * size + at]);
                    if (!(by <= change)) change = by; /* NaN, too */
                }
                if (pass == 0) largest = fmax(largest, own);
                else if (!((change /= fmax(own, NEGLIGIBLE * largest) + TINY) <= part)) part = change;
            }
        }
    return part;
}

/* Go on from the last trial's values to those of another one, until nothing changes; whether a block has been found. */
static bool find_block(Loop *loop, StartingBlock *block, int64_t point, bool *stuck) {
    double first = INFINITY, last = INFINITY;
    size_t size = (size_t)(block->steps + 1) * (size_t)block->n_values;
    for (int trial = 0; trial < MOST_TRIALS; trial++) {
        memcpy(block->before, block->rows, size * sizeof *block->rows);
        if (!go_back(loop, block)) {
            *stuck = true;
            return false;
        }
        prescribe(loop, block, block->before);
        if (!try_block(loop, block, point)) return false;
        double change = change_of(loop, block);
        if (trial == 0) first = change;
        if (!(change < last)) break; /* by rounding, or it does not contract */
        last = change;
        if (change <= FOUND) break;
    }
    return last <= ACCEPTABLE || last <= CONTRACTED * first;
}

bool start_block(Loop *loop, int64_t point) {
    StartingBlock *block = loop->start;
    int64_t end = point + block->steps;
    forget(loop);
    if (end > loop->last_point || end - loop->first_sample >= loop->n_rows || loop_jumps_within(loop, point, end))
        return true;
    int32_t status = 0;
    if (keep_states(loop->call, block->states, block->n_states, &status) < block->n_states) return true;
    memcpy(block->rows, loop->values, (size_t)block->n_values * sizeof *loop->values);
    for (int64_t o = 0, i = 0; o < loop->n_at_step; o++) {
        if (loop->at_step[o].kind != EXTRAPOLATE) continue;
        const Extrapolated *in = loop->at_step[o].data;
        block->known[i] = in->known;
        block->refused[i++] = in->refused;
    }
    bool stuck = false;
    bool found = try_block(loop, block, point) && find_block(loop, block, point, &stuck);
    if (stuck || !go_back(loop, block)) return false;
    block->n_blocks++;
    if (found) prescribe(loop, block, block->before);
    else forget(loop), block->n_not_found++;
    return true;
}

#define STRUCT(type) {#type, 0, sizeof(type)}
#define FIELD(type, field) {#type "." #field, offsetof(type, field), sizeof(((type *)0)->field)}

static const Field layout[] = {
    STRUCT(StartingBlock),          FIELD(StartingBlock, states),
    FIELD(StartingBlock, first),    FIELD(StartingBlock, rows),
    FIELD(StartingBlock, before),   FIELD(StartingBlock, known),
    FIELD(StartingBlock, refused),  FIELD(StartingBlock, n_values),
    FIELD(StartingBlock, n_states), FIELD(StartingBlock, steps),
    FIELD(StartingBlock, n_blocks), FIELD(StartingBlock, n_not_found),
    FIELD(StartingBlock, n_trials), FIELD(StartingBlock, failed),
    FIELD(StartingBlock, status),   {NULL, 0, 0},
};

EXPORT const Field *starting_block_layout(void) { return layout; }
