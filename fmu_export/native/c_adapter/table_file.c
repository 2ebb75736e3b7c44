/* Lookup tables from their text files. */
#include "core.h"
#include "table.h"
#include "uri.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

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
                status = fail(source, number,
                              "a cell is not a finite number; write numbers with points, separated by commas");
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

CoreStatus core_read_table(Core *core, int which, Table *table) {
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
