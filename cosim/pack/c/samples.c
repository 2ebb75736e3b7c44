/* Samples of the signals and of the inputs from outside, at internal communication points. */
#include "packed.h"

#include <math.h>

/* Number of times that are not after t, as numpy.searchsorted(times, t, side="right"). */
static int32_t not_after(const double times[], int32_t n, double t) {
    int32_t low = 0, high = n;
    while (low < high) {
        int32_t middle = low + (high - low) / 2;
        if (times[middle] <= t) low = middle + 1;
        else high = middle;
    }
    return low;
}

/* A time, moved to a breakpoint where it lies before it by rounding: what comes after the jump counts. */
static double at_breakpoint(const Signal *signal, double t, double tolerance) {
    int32_t next = not_after(signal->breakpoints, signal->n_breakpoints, t);
    if (next == signal->n_breakpoints) return t;
    double following = signal->breakpoints[next];
    return t > following - tolerance ? following : t;
}

/* An element of a signal at a time; the formulas are those of the signals in Python, to the last bit. */
static double value_at(const Signal *signal, int32_t element, double t) {
    const double *times = signal->times, *values = signal->values + element;
    int32_t size = signal->size, last = signal->n - 1;
    int32_t left = not_after(times, signal->n, t) - 1;
    if (signal->between == INTERP_ROWS) { /* numpy.interp */
        if (left < 0) return values[0];
        if (left >= last || times[left] == t) return values[(left < last ? left : last) * size];
        double slope = (values[(left + 1) * size] - values[left * size]) / (times[left + 1] - times[left]);
        return slope * (t - times[left]) + values[left * size];
    }
    if (left < 0) left = 0;
    if (signal->between == HELD_ROWS) return values[left * size];
    int32_t right = left < last ? left + 1 : last;
    double span = times[right] - times[left];
    double share = span > 0.0 ? (t - times[left]) / span : 0.0;
    share = share < 0.0 ? 0.0 : share > 1.0 ? 1.0 : share;
    return values[left * size] + share * (values[right * size] - values[left * size]);
}

/* What the loop needs inside the step from a time on, so many points after the present one. */
static void sample_inside(const Packed *packed, int32_t c, double t, double since, const double next_inputs[],
                          double values[2]) {
    const Column *column = &packed->columns[c];
    double step = packed->loop.step_size;
    for (int k = 0; k < 2; k++) {
        double part = (k + 1.0) / 3.0 * column->every;
        if (!column->is_real) continue;
        if (column->signal >= 0) {
            values[k] = value_at(&packed->signals[column->signal], column->element, t + part * step);
        } else {
            double change = next_inputs ? next_inputs[c] - packed->inputs[c] : step * packed->rates[c];
            values[k] = packed->inputs[c] + (since + part) * change;
        }
    }
}

/* Have samples for the points first ... end - 1, and for as many around them as the loop looks at. Inputs have their
 * present values at the point `now` and move at their rates, or to `next_inputs` at the point after it. */
void sample(Packed *packed, int64_t first, int64_t end, int64_t now, const double next_inputs[]) {
    const Loop *loop = &packed->loop;
    double step = loop->step_size, tolerance = 1e-6;
    int64_t from = first - packed->reach < 0 ? 0 : first - packed->reach, to = end + packed->reach;
    for (int64_t point = from; point < to; point++) {
        double t = loop->start_time + (double)point * step;
        double *row = packed->samples + (point - from) * packed->n_columns;
        for (int32_t c = 0; c < packed->n_columns && point >= first; c++) {
            const Column *column = &packed->columns[c];
            if (column->signal >= 0) {
                const Signal *signal = &packed->signals[column->signal];
                row[c] = value_at(signal, column->element, at_breakpoint(signal, t, tolerance * step));
            } else if (point == now || !column->is_real) {
                row[c] = packed->inputs[c];
                if (next_inputs && point > now) row[c] = next_inputs[c];
            } else if (next_inputs) {
                row[c] = packed->inputs[c] + (double)(point - now) * (next_inputs[c] - packed->inputs[c]);
                if (point == now + 1) row[c] = next_inputs[c];
            } else {
                row[c] = packed->inputs[c] + (double)(point - now) * step * packed->rates[c];
            }
        }
        for (int32_t c = 0; c < packed->n_columns && point >= first; c++)
            sample_inside(packed, c, t, (double)(point - now), next_inputs,
                          packed->inside + 2 * (row + c - packed->samples));
        int32_t before = not_after(packed->breakpoints, packed->n_breakpoints, t - (1.0 - tolerance) * step);
        int32_t until = not_after(packed->breakpoints, packed->n_breakpoints, t + tolerance * step);
        packed->jumps[point - from] = until > before;
    }
    packed->loop.first_sample = from;
    packed->loop.n_rows = to - from;
}
