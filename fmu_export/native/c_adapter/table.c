#include "table.h"
#include "core.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#ifdef _MSC_VER
#include <intrin.h>
#endif

static Table tables[N_TABLES];
static int users; /* instances that have opened them */
static volatile long locked;

/* Instances may be made in several threads. */
static void lock(void) {
#ifdef _MSC_VER
    while (_InterlockedExchange(&locked, 1)) continue;
#else
    while (__sync_lock_test_and_set(&locked, 1)) continue;
#endif
}

static void unlock(void) {
#ifdef _MSC_VER
    _InterlockedExchange(&locked, 0);
#else
    __sync_lock_release(&locked);
#endif
}

static int equal(const Table *a, const Table *b) {
    if (a->n[0] != b->n[0] || a->n[1] != b->n[1]) return 0;
    size_t n = (size_t)(a->values - a->x) + a->n[0] * a->n[1];
    return !memcmp(a->x, b->x, n * sizeof *a->x);
}

static void forget(Table some[]) {
    for (int i = 0; i < N_TABLES; i++) free(some[i].x);
    memset(some, 0, N_TABLES * sizeof *some);
}

CoreStatus core_open_tables(Core *core) {
    Table found[N_TABLES];
    CoreStatus status = CORE_OK;
    memset(found, 0, sizeof found);
    for (int i = 0; status == CORE_OK && i < N_TABLES; i++) status = core_read_table(core, i, &found[i]);
    lock();
    for (int i = 0; status == CORE_OK && users && i < N_TABLES; i++)
        if (!equal(&found[i], &tables[i]))
            status = core_fail(core, CORE_ERROR,
                               "%s/tables/%s.csv is not what other instances in this process have read; free them, or "
                               "take a process of its own",
                               core->resources, model_tables[i]);
    if (status == CORE_OK && !users) {
        memcpy(tables, found, sizeof found);
        memset(found, 0, sizeof found);
    }
    if (status == CORE_OK) {
        users++;
        core->has_tables = 1;
    }
    unlock();
    forget(found);
    return status;
}

void core_close_tables(Core *core) {
    if (!core->has_tables) return;
    lock();
    if (--users == 0) forget(tables);
    unlock();
    core->has_tables = 0;
}

/* Interpolation */

/* The interval in which v is, the first one before all breakpoints, the last one after all. Without branches, since where
 * v is can't be guessed. */
static size_t interval(const double *points, size_t n, double v) {
    const double *first = points;
    for (size_t left = n - 1; left > 1;) {
        size_t half = left / 2;
        first += first[half] <= v ? half : 0;
        left -= half;
    }
    return (size_t)(first - points);
}

static int is_inside(const double *points, size_t n, double v) { return points[0] <= v && v < points[n - 1]; }

double table_value(double table, double v) {
    const Table *t = &tables[(int)table];
    const double *x = t->x, *y = t->values;
    size_t n = t->n[0];
    if (isnan(v)) return v;
    if (v >= x[n - 1]) return y[n - 1];
    if (v <= x[0]) return y[0];
    size_t i = interval(x, n, v);
    if (x[i] == v) return y[i];
    double slope = (y[i + 1] - y[i]) / (x[i + 1] - x[i]), value = slope * (v - x[i]) + y[i];
    if (isnan(value)) { /* where the slope overflows */
        value = slope * (v - x[i + 1]) + y[i + 1];
        if (isnan(value) && y[i] == y[i + 1]) value = y[i];
    }
    return value;
}

double table_slope(double table, double v) {
    const Table *t = &tables[(int)table];
    const double *x = t->x, *y = t->values;
    if (!is_inside(x, t->n[0], v)) return 0.0 * (v - v);
    size_t i = interval(x, t->n[0], v);
    return (y[i + 1] - y[i]) / (x[i + 1] - x[i]);
}

/* A cell of a table over two variables: values at its corners, where in it a place is, and its sizes. */
typedef struct {
    const double *low, *high; /* at both breakpoints x, from the first breakpoint y on */
    double s, r, width, height;
} Cell;

static double clipped(const double *points, size_t n, double v) {
    return v < points[0] ? points[0] : v > points[n - 1] ? points[n - 1] : v;
}

static Cell cell_of(const Table *t, double x, double y) {
    Cell cell;
    size_t i = interval(t->x, t->n[0], x), j = interval(t->y, t->n[1], y);
    cell.low = t->values + i * t->n[1] + j;
    cell.high = cell.low + t->n[1];
    cell.width = t->x[i + 1] - t->x[i];
    cell.height = t->y[j + 1] - t->y[j];
    cell.s = (clipped(t->x, t->n[0], x) - t->x[i]) / cell.width;
    cell.r = (clipped(t->y, t->n[1], y) - t->y[j]) / cell.height;
    return cell;
}

double table_value_2(double table, double x, double y) {
    Cell c = cell_of(&tables[(int)table], x, y);
    return (1.0 - c.s) * ((1.0 - c.r) * c.low[0] + c.r * c.low[1]) + c.s * ((1.0 - c.r) * c.high[0] + c.r * c.high[1]);
}

double table_change_2(double table, double x, double y, double dx, double dy) {
    const Table *t = &tables[(int)table];
    Cell c = cell_of(t, x, y);
    double rise = ((1.0 - c.r) * c.high[0] + c.r * c.high[1]) - ((1.0 - c.r) * c.low[0] + c.r * c.low[1]);
    double by_x = is_inside(t->x, t->n[0], x) ? rise / c.width : 0.0;
    rise = (1.0 - c.s) * (c.low[1] - c.low[0]) + c.s * (c.high[1] - c.high[0]);
    double by_y = is_inside(t->y, t->n[1], y) ? rise / c.height : 0.0;
    return by_x * dx + by_y * dy + 0.0 * (x - x + (y - y));
}
