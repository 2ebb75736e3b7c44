/* Lookup tables, which instances read from resources/tables. Without state: all instances share them. */
#ifndef TABLE_H
#define TABLE_H

#include <stddef.h>

#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility push(hidden)
#endif

/* Values (n[0], n[1]) at breakpoints; over one variable n[1] is 1 and there are no breakpoints y. All in one block. */
typedef struct Table {
    size_t n[2];
    double *x, *y, *values;
} Table;

/* Of the table with this number, over one variable: the value at x as numpy's interp computes it, and its derivative. */
double table_value(double table, double x);
double table_slope(double table, double x);

/* Of a table over two variables: the value at (x, y), and its change along (dx, dy). */
double table_value_2(double table, double x, double y);
double table_change_2(double table, double x, double y, double dx, double dy);

#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility pop
#endif

#endif
