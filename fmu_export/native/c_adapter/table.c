#include "table.h"
#include "core.h"
#include "uri.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#ifdef _MSC_VER
#include <intrin.h>
#endif

/* Values (n[0], n[1]) at breakpoints; over one variable n[1] is 1 and there are no breakpoints y. All in one block. */
typedef struct {
    size_t n[2];
    double *x, *y, *values;
} Table;

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

/* Files */

typedef struct {
    Core *core;
    char path[4096];
} Source;

static CoreStatus fail(const Source *source, size_t line, const char *problem) {
    return core_fail(source->core, CORE_ERROR, "a table can't be read: %s, line %lu: %s", source->path,
                     (unsigned long)line, problem);
}

/* All of a text file, with a zero at its end; NULL without one, or without memory. */
static char *read_text(const char *path) {
    FILE *file = open_text(path);
    char *text = NULL;
    size_t size = 0, room = 0;
    if (!file) return NULL;
    for (;;) {
        if (room - size < 2) {
            char *larger = realloc(text, room = 2 * room + 65536);
            if (!larger) break;
            text = larger;
        }
        size_t n = fread(text + size, 1, room - size - 1, file);
        size += n;
        if (n == 0) {
            text[size] = '\0';
            fclose(file);
            return text;
        }
    }
    free(text);
    fclose(file);
    return NULL;
}

/* The next line of a text that is not blank, without its end; *number counts. NULL behind the last one. */
static char *next_line(char **text, size_t *number) {
    while (**text) {
        char *line = *text;
        size_t length = strcspn(line, "\n");
        *text = line + length + (line[length] == '\n');
        line[length] = '\0';
        ++*number;
        if (line[strspn(line, " \t\r")]) return line;
    }
    return NULL;
}

static size_t count_cells(const char *line) {
    size_t n = 1;
    for (; *line; line++) n += *line == ',';
    return n;
}

/* Numbers of a line; that of a cell that is none is NAN. Returns how many are none, behind the first `free` cells. */
static size_t read_cells(char *line, double cells[], size_t n, size_t free) {
    size_t bad = 0;
    for (size_t i = 0; i < n; i++) {
        size_t length = strcspn(line, ",");
        int last = !line[length];
        line[length] = '\0';
        if (!core_read_number(line, &cells[i])) {
            cells[i] = NAN;
            bad += i >= free;
        }
        line += last ? length : length + 1;
    }
    return bad;
}

static int increases(const double *points, size_t n) {
    for (size_t i = 1; i < n; i++)
        if (!(points[i - 1] < points[i])) return 0;
    return 1;
}

/* A table from the text of its file, which is changed. */
static CoreStatus parse(const Source *source, char *text, int variables, Table *table) {
    size_t number = 0, columns, rows = 0, room = 1;
    char *rest = strncmp(text, "\xef\xbb\xbf", 3) ? text : text + 3, *line = next_line(&rest, &number);
    double *cells = NULL;
    if (!line) return fail(source, 1, "the file is empty");
    columns = count_cells(line);
    if (variables == 1 ? columns != 2 : columns < 3)
        return fail(source, number,
                    variables == 1 ? "two numbers are needed, separated by a comma"
                                   : "at least three cells are needed, separated by commas");
    for (const char *c = rest; *c; c++) room += *c == '\n';
    room += 1;
    cells = malloc(room * columns * sizeof *cells);
    table->x = malloc((room + columns + room * columns) * sizeof *table->x);
    CoreStatus status = CORE_OK;
    if (!cells || !table->x) status = core_fail(source->core, CORE_ERROR, "no memory for a table");
    for (int first = 1; status == CORE_OK && line; line = next_line(&rest, &number), first = 0) {
        double *row = cells + rows * columns;
        if (count_cells(line) != columns) {
            status = fail(source, number, "it has not as many cells as the first line");
        } else {
            size_t bad = read_cells(line, row, columns, !first ? 0 : variables == 1 ? 2 : 1);
            int headings = first && variables == 1 && isnan(row[0]) && isnan(row[1]);
            if (bad || (variables == 1 && !headings && (isnan(row[0]) || isnan(row[1]))))
                status =
                    fail(source, number, "a cell is no finite number; write numbers with points, separated by commas");
            rows += !headings;
        }
    }
    if (status == CORE_OK) {
        size_t head = variables - 1, n = rows > head ? rows - head : 0;
        table->n[0] = n;
        table->n[1] = columns - 1;
        table->y = table->x + n;
        table->values = variables == 1 ? table->y : table->y + table->n[1];
        for (size_t i = 0; i < n; i++) table->x[i] = cells[(i + head) * columns];
        for (size_t j = 0; variables == 2 && j < table->n[1]; j++) table->y[j] = cells[1 + j];
        for (size_t i = 0; i < n; i++)
            for (size_t j = 0; j < table->n[1]; j++)
                table->values[i * table->n[1] + j] = cells[(i + head) * columns + 1 + j];
        if (n < 2) status = fail(source, number, "at least two breakpoints are needed");
        else if (!increases(table->x, n) || (variables == 2 && !increases(table->y, table->n[1])))
            status = fail(source, number, "breakpoints do not increase");
    }
    free(cells);
    if (status != CORE_OK) {
        free(table->x);
        memset(table, 0, sizeof *table);
    }
    return status;
}

static CoreStatus read_table(Core *core, int which, Table *table) {
    Source source = {core, ""};
    if (snprintf(source.path, sizeof source.path, "%s/tables/%s.csv", core->resources, model_tables[which]) >=
        (int)sizeof source.path)
        return core_fail(core, CORE_ERROR, "the path of the resources is too long: %.100s...", core->resources);
    char *text = read_text(source.path);
    if (!text) return core_fail(core, CORE_ERROR, "a table can't be read: %s is missing or unreadable", source.path);
    CoreStatus status = parse(&source, text, model_table_variables[which], table);
    free(text);
    return status;
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
    for (int i = 0; status == CORE_OK && i < N_TABLES; i++) status = read_table(core, i, &found[i]);
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
