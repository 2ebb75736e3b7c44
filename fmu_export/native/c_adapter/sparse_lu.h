/* LU factors of a sparse matrix, shift I - J, by index tables that the export computed: along the diagonal, in an order
 * with little fill. Rows are never exchanged, so `lu_residual` tells whether a solution can be trusted. Rows and columns
 * of the factors are in the order of elimination; the diagonal is stored inverted. */
#ifndef SPARSE_LU_H
#define SPARSE_LU_H

#include "model.h"

static void lu_factorise(const double jacobian[], double shift, double factors[]) {
    double row[N_X] = {0.0};
    for (int k = 0; k < N_FACTORS; k++) factors[k] = 0.0;
    for (int k = 0; k < N_JACOBIAN; k++) factors[model_jacobian_places[k]] = -jacobian[k];
    for (int i = 0; i < N_X; i++) {
        int first = model_factor_rows[i], end = model_factor_rows[i + 1], diagonal = model_factor_diagonal[i];
        factors[diagonal] += shift;
        for (int k = first; k < end; k++) row[model_factor_columns[k]] = factors[k];
        for (int k = first; k < diagonal; k++) {
            int pivot = model_factor_columns[k], at = model_factor_diagonal[pivot];
            double multiple = row[pivot] *= factors[at];
            for (int j = at + 1; j < model_factor_rows[pivot + 1]; j++)
                row[model_factor_columns[j]] -= multiple * factors[j];
        }
        for (int k = first; k < end; k++) factors[k] = row[model_factor_columns[k]];
        factors[diagonal] = 1.0 / factors[diagonal];
    }
}

static void lu_solve(const double factors[], const double b[], double x[]) {
    double y[N_X] = {0.0};
    for (int i = 0; i < N_X; i++) {
        double sum = b[model_pivots[i]];
        for (int k = model_factor_rows[i]; k < model_factor_diagonal[i]; k++)
            sum -= factors[k] * y[model_factor_columns[k]];
        y[i] = sum;
    }
    for (int i = N_X - 1; i >= 0; i--) {
        double sum = y[i];
        for (int k = model_factor_diagonal[i] + 1; k < model_factor_rows[i + 1]; k++)
            sum -= factors[k] * y[model_factor_columns[k]];
        y[i] = sum * factors[model_factor_diagonal[i]];
    }
    for (int i = 0; i < N_X; i++) x[model_pivots[i]] = y[i];
}

/* What a solution leaves of the right-hand side: b - (shift I - J) x. */
static void lu_residual(const double jacobian[], double shift, const double b[], const double x[], double residual[]) {
    for (int i = 0, k = 0; i < N_X; i++) {
        double sum = b[model_pivots[i]] - shift * x[model_pivots[i]];
        for (; k < N_JACOBIAN && model_jacobian_places[k] < model_factor_rows[i + 1]; k++)
            sum += jacobian[k] * x[model_pivots[model_factor_columns[model_jacobian_places[k]]]];
        residual[model_pivots[i]] = sum;
    }
}

#endif
