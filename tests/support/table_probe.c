/* Lets tests call the lookup of tables for many places at once. */
#include "core.h"
#include "table.h"

#include <string.h>

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

static Core cores[2];

static void keep(void *environment, CoreStatus status, const char *message) {
    (void)status;
    strcpy(environment, message);
}

/* Open the tables of a folder as one of two instances; `message` gets what is wrong. */
EXPORT int probe_open(int which, const char *folder, char *message) {
    static char paths[2][1000];
    cores[which].resources = strcpy(paths[which], folder);
    cores[which].logger = keep;
    cores[which].environment = message;
    return core_open_tables(&cores[which]);
}

EXPORT void probe_close(int which) { core_close_tables(&cores[which]); }

EXPORT void probe_1(double table, long n, const double x[], double values[], double slopes[]) {
    for (long i = 0; i < n; i++) {
        values[i] = table_value(table, x[i]);
        slopes[i] = table_slope(table, x[i]);
    }
}

EXPORT void probe_2(double table, long n, const double x[], const double y[], double values[], double by_x[],
                    double by_y[]) {
    for (long i = 0; i < n; i++) {
        values[i] = table_value_2(table, x[i], y[i]);
        by_x[i] = table_change_2(table, x[i], y[i], 1.0, 0.0);
        by_y[i] = table_change_2(table, x[i], y[i], 0.0, 1.0);
    }
}

void model_adjoint(double t, const double *x, const double *u, const double *p, const double *dy, double *y);

EXPORT void probe_adjoint(const double x[], const double u[], const double p[], const double weights[], double sums[]) {
    model_adjoint(0.0, x, u, p, weights, sums);
}
