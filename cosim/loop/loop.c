/* The stepping loop: walks a table of operations that Python has prepared, and calls the FMUs' C functions directly.
 *
 * It allocates nothing, knows no FMU, and needs no header of FMI: of both versions it calls four functions, whose types
 * stand here. LOOP_HASH tells binding.py whether it belongs to this source. */
#ifndef _WIN32
#define _POSIX_C_SOURCE 200809L
#endif

#include "loop.h"

#include "clock.h"
#include "starting_block.h"

#ifndef WITHOUT_TEAM
#include "team.h"
#endif

#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#ifdef __GNUC__
#define PREFETCH(address) __builtin_prefetch(address)
#else
#define PREFETCH(address) (void)(address)
#endif

typedef int Exchange2(void *, const uint32_t *, size_t, void *);
typedef int Exchange3(void *, const uint32_t *, size_t, void *, size_t);
typedef int Derivatives2(void *, const uint32_t *, size_t, const int32_t *, const double *);
typedef int OutputDerivatives2(void *, const uint32_t *, size_t, const int32_t *, double *);
typedef int OutputDerivatives3(void *, const uint32_t *, size_t, const int32_t *, double *, size_t);
typedef int Directional2(void *, const uint32_t *, size_t, const uint32_t *, size_t, const double *, double *);
typedef int Directional3(void *, const uint32_t *, size_t, const uint32_t *, size_t, const double *, size_t, double *,
                         size_t);
typedef int Step2(void *, double, double, int);
typedef int Called(double);
typedef int Step3(void *, double, double, bool, bool *, bool *, bool *, double *);

/* A slot of a whole number; an unsigned one has the bits of the signed one. */
static int64_t integer_in(const double *slot) {
    int64_t value;
    memcpy(&value, slot, sizeof value);
    return value;
}

static void put_integer(double *slot, int64_t value) { memcpy(slot, &value, sizeof value); }

#define COPY_INTEGERS(TYPE, ctype) \
    case TYPE: \
        for (int64_t i = 0; i < n; i++) \
            if (to_fmu) ((ctype *)buffer)[i] = (ctype)integer_in(&slots[i]); \
            else put_integer(&slots[i], ((ctype *)buffer)[i]); \
        break

void loop_convert(int32_t type, void *buffer, double *slots, int64_t n, bool to_fmu) {
    switch (type) {
        case REAL + 4:
            for (int64_t i = 0; i < n; i++)
                if (to_fmu) ((float *)buffer)[i] = (float)slots[i];
                else slots[i] = ((float *)buffer)[i];
            break;
            COPY_INTEGERS(SIGNED + 1, int8_t);
            COPY_INTEGERS(SIGNED + 2, int16_t);
            COPY_INTEGERS(SIGNED + 4, int32_t);
            COPY_INTEGERS(UNSIGNED + 1, uint8_t);
            COPY_INTEGERS(UNSIGNED + 2, uint16_t);
            COPY_INTEGERS(UNSIGNED + 4, uint32_t);
        default: /* values of 8 bytes stand in their slots, and pointers are not passed here */
            break;
    }
}

bool loop_carry(const Conversion *conversion, const double *source, double *target) {
    if (conversion->from == REAL) { /* to a float, which rounds, but has bounds */
        *target = *source;
        return isinf((float)*source) == isinf(*source);
    }
    int64_t value = integer_in(source);
    bool negative = conversion->from == SIGNED && value < 0;
    uint64_t natural = (uint64_t)value;
    if (conversion->to >= SIGNED) {
        put_integer(target, value);
        if (negative) return value >= conversion->smallest;
        return natural <= conversion->largest &&
               (conversion->smallest <= 0 || natural >= (uint64_t)conversion->smallest);
    }
    *target = negative ? (double)value : (double)natural;
    uint64_t magnitude = negative ? 0 - natural : natural;
    int digits = conversion->to == REAL + 4 ? FLT_MANT_DIG : DBL_MANT_DIG;
    while (magnitude && !(magnitude & 1)) magnitude >>= 1;
    return magnitude >> digits == 0;
}

/* Call the function of an operation that gets or sets values. */
static int call(const Operation *op, void *data) {
    if (op->version < 3)
        return ((Exchange2 *)op->function)(op->instance, op->references, (size_t)op->n_references, data);
    return ((Exchange3 *)op->function)(op->instance, op->references, (size_t)op->n_references, data, (size_t)op->n);
}

static int set(const Operation *op, double *values) {
    double *part = values + op->first;
    if (!op->data) return call(op, part);
    loop_convert(op->type, op->data, part, op->n, true);
    return call(op, op->data);
}

static int get(const Operation *op, double *values) {
    double *part = values + op->first;
    if (!op->data) return call(op, part);
    int status = call(op, op->data);
    loop_convert(op->type, op->data, part, op->n, false);
    return status;
}

/* Whether all values at these positions are finite: v - v is 0 for a finite v, of whichever sign, and else NaN, which has more bits. */
static bool all_finite(const double *values, const int32_t *positions, int32_t n) {
    uint64_t bits = 0;
    for (int32_t i = 0; i < n; i++) {
        union {
            double value;
            uint64_t bits;
        } difference = {values[positions[i]] - values[positions[i]]};
        bits |= difference.bits;
    }
    return bits << 1 == 0;
}

/* Whether something jumps in (t_first, t_last], by the numbers of the points. */
bool loop_jumps_within(const Loop *loop, int64_t first, int64_t last) {
    for (int64_t i = first + 1; i <= last; i++) {
        int64_t row = i - loop->first_sample;
        if (row >= 0 && row < loop->n_rows && loop->jumps[row]) return true;
    }
    return false;
}

/* Add to n sums, or begin them with, a weight times values. */
static void add(double *restrict sums, double weight, const double *restrict values, int32_t n, bool begin) {
    if (begin)
        for (int32_t i = 0; i < n; i++) sums[i] = weight * values[i];
    else
        for (int32_t i = 0; i < n; i++) sums[i] += weight * values[i];
}

/* Put the newest of n values before those of earlier points. */
static void push(double *history, const double *now, int32_t points, int32_t n) {
    if (points > 2) memmove(history + n, history, (size_t)(points - 2) * (size_t)n * sizeof *history);
    memcpy(history, now, (size_t)n * sizeof *history);
}

/* All derivatives of n inputs, and the history with the values of `now`; `rates` are those times the step, NULL for none. */
static void go_on(const Extrapolated *in, const double *restrict now, const double *restrict rates, double per_second,
                  int32_t n) {
    int64_t size = (int64_t)in->degree * in->points;
    const double *weights = in->weights + (in->known - 1) * size, *of_rates = weights + in->points * size;
    double *restrict history = in->history, *restrict derivative = in->derivatives;
    if (in->points == 2 && in->known == 2 && !rates) { /* linear in one go; the general case costs twice the time */
        double w0 = weights[0], w1 = weights[1];
        for (int32_t i = 0; i < n; i++) {
            double value = now[i];
            derivative[i] = (w0 * value + w1 * history[i]) * per_second;
            history[i] = value;
        }
        return;
    }
    double scale = 1.0;
    if (in->points == 3 && in->known == 3 && rates) { /* the sums below in one go, in their order: half the time */
        const double *before = in->rates + n, *earlier = before + n;
        for (int32_t d = 0; d < in->degree; d++, weights += 3, of_rates += 3, derivative += n) {
            double w0 = weights[0], w1 = weights[1], w2 = weights[2];
            double r0 = of_rates[0], r1 = of_rates[1], r2 = of_rates[2];
            scale *= per_second;
            for (int32_t i = 0; i < n; i++)
                derivative[i] = (w0 * now[i] + w1 * history[i] + w2 * history[n + i] + r0 * rates[i] + r1 * before[i] +
                                 r2 * earlier[i]) *
                                scale;
        }
        push(history, now, 3, n);
        push(in->rates + n, rates, 3, n);
        return;
    }
    for (int32_t d = 0; d < in->degree; d++, weights += in->points, of_rates += in->points, derivative += n) {
        scale *= per_second;
        if (d + 1 >= in->known && !rates) { /* no polynomial of this degree goes through so few points */
            memset(derivative, 0, (size_t)n * sizeof *derivative);
            continue;
        }
        add(derivative, weights[0], now, n, true);
        for (int32_t j = 1; j < in->known; j++) add(derivative, weights[j], history + (j - 1) * n, n, false);
        if (rates) add(derivative, of_rates[0], rates, n, false);
        for (int32_t j = 1; rates && j < in->known; j++) add(derivative, of_rates[j], in->rates + j * n, n, false);
        for (int32_t i = 0; i < n; i++) derivative[i] *= scale;
    }
    push(history, now, in->points, n);
    if (rates && in->points > 1) push(in->rates + n, rates, in->points, n);
}

/* Errors are forgotten at this rate from point to point, and a polynomial is used while its own are below this part of
 * those of a line: then it can't be the cause of an oscillation that a line would damp. */
#define FORGETTING 0.95
#define BETTER 0.25

/* How wrong was what was predicted for this point; at the start and after a jump, with less to go by, nothing counts. */
static void look_back(const Extrapolated *in, const double *restrict now, int32_t n, bool counts) {
    const double *restrict predicted = in->watched;
    double *restrict errors = in->watched + 2 * n;
    if (!counts) memset(errors, 0, 2 * (size_t)n * sizeof *errors);
    for (int32_t which = 0; counts && which < 2; which++, predicted += n, errors += n)
        for (int32_t i = 0; i < n; i++) {
            double error = fabs(predicted[i] - now[i]), before = FORGETTING * errors[i];
            errors[i] = error > before ? error : before;
        }
}

/* Predict the values at the end of a step, and let inputs go straight whose polynomials have been no better than lines. */
static void choose(const Extrapolated *in, const double *restrict now, double step, double per_second, int32_t n) {
    const double *restrict before = in->history + n, *errors = in->watched + 2 * n;
    double *restrict predicted = in->watched, *restrict derivatives = in->derivatives;
    for (int32_t i = 0; i < n; i++) predicted[i] = 0.0;
    for (int32_t d = in->degree; d >= 1; d--) {
        double part = step / d;
        for (int32_t i = 0; i < n; i++) predicted[i] = (derivatives[(d - 1) * n + i] + predicted[i]) * part;
    }
    for (int32_t i = 0; i < n; i++) {
        double slope = in->known > 1 ? now[i] - before[i] : 0.0;
        predicted[i] = now[i] + predicted[i];
        predicted[n + i] = now[i] + slope;
        if (errors[i] <= BETTER * errors[n + i]) continue;
        for (int32_t d = 1; d < in->degree; d++) derivatives[d * n + i] = 0.0;
        derivatives[i] = slope * per_second;
    }
}

/* All derivatives of a signal over the step ahead: of the cubic through its values at both ends and after a third and two
 * thirds of it, or of the parabola without the first of these. Differences, lest a constant has derivatives by rounding. */
static void interpolate(const Loop *loop, int64_t row, int64_t next, int32_t column, double per_second, int32_t degree,
                        double *derivatives, int32_t n) {
    double from = loop->samples[row * loop->n_samples + column];
    const double *inside = loop->samples_inside + 2 * (row * loop->n_samples + column);
    double first = inside[0] - from, second = inside[1] - from,
           end = loop->samples[next * loop->n_samples + column] - from;
    double scaled[3] = {end, 0.0, 0.0}; /* where the signal can't be had inside */
    if (degree == 2 && !isnan(second)) {
        scaled[0] = 4.5 * second - 2.0 * end;
        scaled[1] = 6.0 * end - 9.0 * second;
    } else if (degree > 2 && !isnan(first) && !isnan(second)) {
        scaled[0] = 9.0 * first - 4.5 * second + end;
        scaled[1] = 36.0 * second - 45.0 * first - 9.0 * end;
        scaled[2] = 27.0 * (3.0 * (first - second) + end);
    }
    for (int32_t d = 0; d < degree; d++) {
        double scale = per_second;
        for (int32_t k = 0; k < d; k++) scale *= per_second;
        derivatives[d * n] = scaled[d] * scale;
    }
}

/* The derivatives that a starting block has found for the step ahead; signals have their own. */
static void take_from_block(const Operation *op) {
    Extrapolated *in = op->data;
    int32_t n = op->n, first = n - op->n_targets;
    const double *found = in->ahead + (int64_t)--in->left * in->degree * n;
    for (int32_t i = 0; i < n; i++)
        for (int32_t d = 0; d < in->degree && (i < first || op->targets[i - first] == EXTRAPOLATED); d++)
            in->derivatives[d * n + i] = found[d * n + i];
}

/* How inputs of an FMU change over its next step. */
static int extrapolate(const Loop *loop, const Operation *op, int64_t point, double time) {
    Extrapolated *in = op->data;
    int32_t n = op->n;
    const double *restrict now = loop->values + op->first;
    double per_second = op->every == 1 ? loop->per_second : 1.0 / (op->every * loop->step_size);
    int64_t next = point + op->every, row = next - loop->first_sample;
    bool fresh = point == 0 || loop_jumps_within(loop, point - op->every, point); /* what was before says nothing */
    bool ahead = row < loop->n_rows && !loop_jumps_within(loop, point, next);
    bool knew_all = in->known == in->points;
    in->known = fresh ? 1 : in->known < in->points ? in->known + 1 : in->points;
    if (in->rates) {
        double step = op->every * loop->step_size;
        for (int32_t i = 0; i < n; i++) in->rates[i] = step * loop->values[in->first_rate + i];
    }
    int32_t first = n - op->n_targets;
    for (int32_t i = first; in->rates && i < n; i++) /* signals have no rates: before a jump they go straight */
        in->buffer[i] = in->known > 1 ? (now[i] - in->history[i]) * per_second : 0.0;
    if (in->watched) look_back(in, now, n, knew_all && !fresh);
    go_on(in, now, in->rates, per_second, n);
    if (in->watched) choose(in, now, op->every * loop->step_size, per_second, n);
    for (int32_t i = first; i < n; i++) {
        int32_t column = op->targets[i - first];
        if (column == EXTRAPOLATED || (column != HELD && !ahead && !in->rates)) continue;
        if (column != HELD && ahead && in->degree > 1 && loop->samples_inside) {
            interpolate(loop, row - op->every, row, column, per_second, in->degree, in->derivatives + i, n);
            continue;
        }
        for (int32_t d = 0; d < in->degree; d++) in->derivatives[d * n + i] = 0.0;
        if (column != HELD && !ahead) in->derivatives[i] = in->buffer[i];
        else if (column != HELD)
            in->derivatives[i] = (loop->samples[row * loop->n_samples + column] - now[i]) * per_second;
    }
    if (in->left) take_from_block(op);
    in->time = time;
    if (op->version == 3) { /* the FMU asks for its inputs during the step */
        if (point == 0) in->refused = 0;
        return in->refused > 0 ? in->refused : 0;
    }
    return ((Derivatives2 *)op->function)(op->instance, op->references, (size_t)op->n_references, in->orders,
                                          in->derivatives);
}

int loop_directional_derivative(void *function, int32_t version, void *instance, const uint32_t unknowns[], size_t n,
                                const uint32_t knowns[], size_t m, const double seed[], double change[]) {
    return version < 3 ? ((Directional2 *)function)(instance, unknowns, n, knowns, m, seed, change)
                       : ((Directional3 *)function)(instance, unknowns, n, knowns, m, seed, m, change, n);
}

/* Rates of n outputs, as functions of time, and of inputs with direct feedthrough. */
static int differentiate(const Operation *op, double *values) {
    const Rates *rates = op->data;
    double *part = values + op->first;
    size_t n = (size_t)op->n, m = (size_t)rates->n;
    int status = op->version < 3
                     ? ((OutputDerivatives2 *)op->function)(op->instance, op->references, n, rates->orders, part)
                     : ((OutputDerivatives3 *)op->function)(op->instance, op->references, n, rates->orders, part, n);
    if (status > 1 || !rates->function) return status;
    for (size_t i = 0; i < m; i++) rates->seed[i] = values[rates->positions[i]];
    int also = loop_directional_derivative(rates->function, op->version, op->instance, op->references, n, rates->knowns,
                                           m, rates->seed, rates->change);
    if (also <= 1)
        for (size_t i = 0; i < n; i++) part[i] += rates->change[i];
    return also > status ? also : status;
}

void loop_evaluate(const Extrapolated *in, double since, int32_t n) {
    const double *restrict last = in->history;
    double *restrict now = in->buffer;
    if (in->degree == 1) {
        const double *restrict rate = in->derivatives;
        for (int32_t i = 0; i < n; i++) now[i] = last[i] + since * rate[i];
        return;
    }
    for (int32_t i = 0; i < n; i++) now[i] = 0.0;
    for (int32_t d = in->degree; d >= 1; d--) /* Horner's scheme: u + s (u' + s/2 (u'' + s/3 (...))) */
        for (int32_t i = 0; i < n; i++) now[i] = (in->derivatives[(d - 1) * n + i] + now[i]) * (since / d);
    for (int32_t i = 0; i < n; i++) now[i] += last[i];
}

void loop_evaluate_all(const Extrapolated *in, double since, int32_t n) {
    loop_evaluate(in, since, n);
    for (int32_t of = 1; of <= in->degree; of++) {
        double *now = in->buffer + of * n;
        for (int32_t i = 0; i < n; i++) now[i] = 0.0;
        for (int32_t d = in->degree; d > of; d--)
            for (int32_t i = 0; i < n; i++) now[i] = (in->derivatives[(d - 1) * n + i] + now[i]) * (since / (d - of));
        for (int32_t i = 0; i < n; i++) now[i] += in->derivatives[(of - 1) * n + i];
    }
}

EXPORT void intermediate_update(void *environment, double time, bool set_requested, bool get_allowed,
                                bool step_finished, bool can_return_early, bool *return_early, double *return_time) {
    (void)get_allowed, (void)step_finished, (void)can_return_early;
    const Operation *op = environment ? *(const Operation **)environment : NULL;
    *return_early = false;
    *return_time = time;
    if (!set_requested || !op) return;
    do {
        Extrapolated *in = op->data;
        loop_evaluate(in, time - in->time, op->n);
        int status = ((Exchange3 *)op->function)(op->instance, op->references, (size_t)op->n_references, in->buffer,
                                                 (size_t)op->n);
        if (status > 1 && !in->refused) in->refused = status;
    } while (op++->more);
}

int loop_do_step(const Operation *op, double time, double step) {
    if (op->version < 3) return ((Step2 *)op->function)(op->instance, time, step, 1);
    bool event = false, terminate = false, early = false;
    double last_time = time;
    int status = ((Step3 *)op->function)(op->instance, time, step, true, &event, &terminate, &early, &last_time);
    *(double *)op->data = last_time; /* for the report of an early return */
    return status > 1 ? status : terminate ? WANTS_TO_END : early ? RETURNED_EARLY : status;
}

static int perform(const Loop *loop, const Operation *op, int64_t point, double time) {
    double *values = loop->values;
    const int32_t *targets = op->targets, *sources = targets + op->n_targets;
    switch ((Kind)op->kind) {
        case SAMPLE: {
            const double *row = loop->samples + (point - loop->first_sample) * loop->n_samples;
            for (int32_t i = 0; i < op->n_targets; i++) values[targets[i]] = row[sources[i]];
            return 0;
        }
        case SET:
            for (int32_t i = 0; i < op->n_targets; i++) values[targets[i]] = values[sources[i]];
            return set(op, values);
        case GET: {
            int status = get(op, values);
            return status <= 1 && !all_finite(values, targets, op->n_targets) ? NOT_FINITE : status;
        }
        case EXTRAPOLATE:
            return extrapolate(loop, op, point, time);
        case DIFFERENTIATE: {
            int status = differentiate(op, values);
            return status <= 1 && !all_finite(values, targets, op->n_targets) ? NOT_FINITE : status;
        }
        case TRANSFORM:
            for (int32_t i = 0, n = op->n_targets; i < n; i++) {
                const double *factors = op->data, *offsets = factors + n;
                int32_t added = sources[n + i];
                values[targets[i]] =
                    factors[i] * values[sources[i]] + offsets[i] + (added == NONE ? 0.0 : values[added]);
            }
            return 0;
        case CONVERT:
            for (int32_t i = 0; i < op->n_targets; i++)
                if (!loop_carry((const Conversion *)op->data + i, &values[sources[i]], &values[targets[i]]))
                    return DOES_NOT_FIT;
            return 0;
        case STEP:
            return loop_do_step(op, time, op->every * loop->step_size);
        case CALL:
            return ((Called *)op->function)(time);
        case GROUP:
            return ((OfGroup *)op->function)(loop, op, point, time);
    }
    return 0;
}

/* A variable of a component that is not an FMU but a function in Python: its values, of whichever type. */
typedef struct {
    void *address;
    size_t size;
} Cell;

/* Get and set the cells of an instance, an array of them with the value references as indices, as the functions of FMI 3.0
 * get and set variables. */
EXPORT int cells_get(void *instance, const uint32_t *references, size_t n_references, void *values, size_t n) {
    (void)n;
    const Cell *cells = instance;
    char *to = values;
    for (size_t i = 0; i < n_references; to += cells[references[i]].size, i++)
        memcpy(to, cells[references[i]].address, cells[references[i]].size);
    return 0;
}

EXPORT int cells_set(void *instance, const uint32_t *references, size_t n_references, const void *values, size_t n) {
    (void)n;
    const Cell *cells = instance;
    const char *from = values;
    for (size_t i = 0; i < n_references; from += cells[references[i]].size, i++)
        memcpy(cells[references[i]].address, from, cells[references[i]].size);
    return 0;
}

static TakeMessage *take_message;

EXPORT void log_to(TakeMessage *taker) { take_message = taker; }

EXPORT void log_message(void *environment, const char *name, int status, const char *category, const char *format,
                        ...) {
    char text[4096];
    if (format && strchr(format, '%')) {
        va_list arguments;
        va_start(arguments, format);
        if (vsnprintf(text, sizeof text, format, arguments) >= 0) format = text;
        va_end(arguments);
    }
    take_message(environment, name, status, category, format);
}

/* So many operations before it is called an instance is fetched into the cache. */
enum { AHEAD = 4 };

int64_t loop_perform_some(const Loop *loop, CurrentCall *call, const Operation operations[], const uint32_t codes[],
                          int64_t n, int64_t point, int32_t *status) {
    double time = loop->start_time + (double)point * loop->step_size;
    call->time = time;
    for (int64_t k = 0; k < n; k++) {
        if (k + AHEAD < n) PREFETCH(operations[k + AHEAD].instance);
        if (operations[k].every > 1 && point % operations[k].every) continue; /* a division costs more than a call */
        call->code = codes[k];
        *status = perform(loop, &operations[k], point, time);
        if (!*status) continue;
        if (*status != 1) return k; /* worse than a warning */
        loop->warned(&operations[k]);
    }
    return n;
}

/* Perform operations at a communication point; false, with the reason in `loop`, when one fails. */
static bool perform_all(Loop *loop, const Operation operations[], const uint32_t codes[], int64_t n, int64_t point,
                        bool at_step) {
    loop->point = point;
    int64_t done = loop_perform_some(loop, loop->call, operations, codes, n, point, &loop->status);
    if (done == n) return true;
    loop->failed = done;
    loop->failed_at_step = at_step;
    return false;
}

bool loop_step_one_by_one(Loop *loop, int64_t point) {
    return perform_all(loop, loop->at_step, loop->codes_at_step, loop->n_at_step, point, true);
}

/* Perform operations one by one, and add what each takes (ns); otherwise as perform_all. */
static bool perform_measured(Loop *loop, const Operation operations[], const uint32_t codes[], int64_t n, int64_t point,
                             bool at_step, int64_t times[]) {
    int64_t began = nanoseconds();
    for (int64_t k = 0; k < n; k++) {
        if (!perform_all(loop, operations + k, codes + k, 1, point, at_step)) {
            loop->failed = k;
            return false;
        }
        int64_t now = nanoseconds();
        times[k] += now - began;
        began = now;
    }
    return true;
}

static bool is_measured(const Loop *loop, int64_t point) { return loop->profile && point % loop->profile->every == 0; }

/* Predict all values for the point after this one: inputs are extrapolated, and the others are held. */
static void predict_inputs(const Loop *loop, Predicted *told, int64_t point) {
    told->is_predicted = !loop_jumps_within(loop, point, point + 1);
    memcpy(told->values, loop->values, (size_t)told->n_values * sizeof *told->values);
    for (int64_t k = 0; k < told->n_steps; k++) {
        const Operation *op = &told->steps[k];
        if (op->kind != EXTRAPOLATE || op->every > 1) continue;
        const Extrapolated *in = op->data;
        loop_evaluate(in, loop->step_size, op->n);
        memcpy(told->values + op->first, in->buffer, (size_t)op->n * sizeof *in->buffer);
    }
}

static void compare_with_predicted(const Loop *loop, Predicted *told) {
    if (!told->is_predicted) return;
    told->is_predicted = false;
    told->n_points++;
    for (int64_t i = 0; i < told->n; i++) {
        double value = loop->values[told->positions[i]], error = value - told->values[told->positions[i]];
        told->squares[i] += error * error;
        told->sizes[i] = fmax(told->sizes[i], fabs(value));
    }
}

static bool exchange(Loop *loop, int64_t point) {
    if (!is_measured(loop, point))
        return perform_all(loop, loop->at_point, loop->codes_at_point, loop->n_at_point, point, false);
    loop->profile->n_points++;
    bool done = perform_measured(loop, loop->at_point, loop->codes_at_point, loop->n_at_point, point, false,
                                 loop->profile->at_point);
    if (done && loop->profile->predicted) compare_with_predicted(loop, loop->profile->predicted);
    return done;
}

bool loop_rest_one_by_one(Loop *loop, int64_t failed, int64_t point) {
    int64_t first = failed + 1;
    bool done =
        perform_all(loop, loop->at_step + first, loop->codes_at_step + first, loop->n_at_step - first, point, true);
    if (!done) loop->failed += first;
    return done;
}

static bool step(Loop *loop, int64_t point) {
    if (loop->start && starts_anew(loop, point) && !start_block(loop, point)) return false;
    if (is_measured(loop, point)) {
        loop->profile->n_steps++;
        return perform_measured(loop, loop->at_step, loop->codes_at_step, loop->n_at_step, point, true,
                                loop->profile->at_step);
    }
#ifndef WITHOUT_TEAM
    if (loop->team) return team_step(loop, point);
#endif
    return loop_step_one_by_one(loop, point);
}

static bool rest_of_step(Loop *loop, int64_t failed, int64_t point) {
#ifndef WITHOUT_TEAM
    if (loop->team && !is_measured(loop, point)) return team_rest_of_step(loop, failed, point);
#endif
    return loop_rest_one_by_one(loop, failed, point);
}

EXPORT const char *loop_hash(void) { return LOOP_HASH; }

#define STRUCT(type) {#type, 0, sizeof(type)}
#define FIELD(type, field) {#type "." #field, offsetof(type, field), sizeof(((type *)0)->field)}

static const Field layout[] = {
    STRUCT(Cell),
    FIELD(Cell, address),
    FIELD(Cell, size),
    STRUCT(Extrapolated),
    FIELD(Extrapolated, history),
    FIELD(Extrapolated, rates),
    FIELD(Extrapolated, derivatives),
    FIELD(Extrapolated, watched),
    FIELD(Extrapolated, buffer),
    FIELD(Extrapolated, ahead),
    FIELD(Extrapolated, orders),
    FIELD(Extrapolated, weights),
    FIELD(Extrapolated, time),
    FIELD(Extrapolated, points),
    FIELD(Extrapolated, degree),
    FIELD(Extrapolated, known),
    FIELD(Extrapolated, refused),
    FIELD(Extrapolated, first_rate),
    FIELD(Extrapolated, left),
    STRUCT(Rates),
    FIELD(Rates, function),
    FIELD(Rates, knowns),
    FIELD(Rates, positions),
    FIELD(Rates, orders),
    FIELD(Rates, seed),
    FIELD(Rates, change),
    FIELD(Rates, n),
    STRUCT(Conversion),
    FIELD(Conversion, smallest),
    FIELD(Conversion, largest),
    FIELD(Conversion, from),
    FIELD(Conversion, to),
    STRUCT(Operation),
    FIELD(Operation, kind),
    FIELD(Operation, type),
    FIELD(Operation, version),
    FIELD(Operation, more),
    FIELD(Operation, every),
    FIELD(Operation, function),
    FIELD(Operation, instance),
    FIELD(Operation, references),
    FIELD(Operation, data),
    FIELD(Operation, targets),
    FIELD(Operation, n_references),
    FIELD(Operation, first),
    FIELD(Operation, n),
    FIELD(Operation, n_targets),
    STRUCT(Predicted),
    FIELD(Predicted, steps),
    FIELD(Predicted, n_steps),
    FIELD(Predicted, positions),
    FIELD(Predicted, values),
    FIELD(Predicted, squares),
    FIELD(Predicted, sizes),
    FIELD(Predicted, n_values),
    FIELD(Predicted, n_points),
    FIELD(Predicted, n),
    FIELD(Predicted, is_predicted),
    STRUCT(Profile),
    FIELD(Profile, every),
    FIELD(Profile, at_point),
    FIELD(Profile, at_step),
    FIELD(Profile, n_points),
    FIELD(Profile, n_steps),
    FIELD(Profile, predicted),
    STRUCT(Loop),
    FIELD(Loop, start_time),
    FIELD(Loop, step_size),
    FIELD(Loop, per_second),
    FIELD(Loop, last_point),
    FIELD(Loop, values),
    FIELD(Loop, samples),
    FIELD(Loop, samples_inside),
    FIELD(Loop, jumps),
    FIELD(Loop, n_samples),
    FIELD(Loop, first_sample),
    FIELD(Loop, n_rows),
    FIELD(Loop, records),
    FIELD(Loop, runs),
    FIELD(Loop, n_runs),
    FIELD(Loop, n_recorded),
    FIELD(Loop, record_every),
    FIELD(Loop, first_record),
    FIELD(Loop, at_point),
    FIELD(Loop, at_step),
    FIELD(Loop, n_at_point),
    FIELD(Loop, n_at_step),
    FIELD(Loop, codes_at_point),
    FIELD(Loop, codes_at_step),
    FIELD(Loop, call),
    FIELD(Loop, team),
    FIELD(Loop, profile),
    FIELD(Loop, start),
    FIELD(Loop, warned),
    FIELD(Loop, looks),
    FIELD(Loop, point),
    FIELD(Loop, failed),
    FIELD(Loop, status),
    FIELD(Loop, failed_at_step),
    {NULL, 0, 0},
};

EXPORT const Field *loop_layout(void) { return layout; }

EXPORT bool loop_perform(Loop *loop, const Operation operations[], const uint32_t codes[], int64_t n, int64_t point) {
    uint32_t around = loop->call->code;
    bool done = perform_all(loop, operations, codes, n, point, false);
    loop->call->code = around;
    return done;
}

EXPORT bool loop_rest_of_step(Loop *loop, int64_t failed, int64_t point) {
    uint32_t around = loop->call->code;
    bool done = rest_of_step(loop, failed, point);
    loop->call->code = around;
    return done;
}

static bool go_through(Loop *loop, int64_t first, int64_t end, bool exchanged) {
    for (int64_t point = first; point < end; point++) {
        if (!(exchanged && point == first) && !exchange(loop, point)) return false;
        if (loop->record_every == 1 || point % loop->record_every == 0) {
            int64_t record = loop->record_every == 1 ? point : point / loop->record_every;
            double *row = loop->records + (record - loop->first_record) * loop->n_recorded;
            const int32_t *run = loop->runs;
            for (int64_t k = 0; k < loop->n_runs; row += run[1], run += 2, k++)
                if (run[1] == 1) *row = loop->values[*run];
                else memcpy(row, loop->values + *run, (size_t)run[1] * sizeof *row);
        }
        if (point >= loop->last_point) continue;
        if (!step(loop, point)) return false;
        if (loop->profile && loop->profile->predicted && is_measured(loop, point + 1))
            predict_inputs(loop, loop->profile->predicted, point);
    }
    return true;
}

EXPORT bool loop_run(Loop *loop, int64_t first, int64_t end, bool exchanged) {
    uint32_t around = loop->call->code;
    bool done = go_through(loop, first, end, exchanged);
    loop->call->code = around;
    return done;
}
