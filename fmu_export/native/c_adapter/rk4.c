/* The classical Runge-Kutta method of order 4 with a fixed step; the export writes its formula with the model. */
#include "core.h"

#if N_X > 0
CoreStatus method_step(Core *core, double time, double h, const double x[], const double u[], const double u_rate[],
                       const double rates[], double next[], double *error) {
    *error = 0.0;
    model_linear_step(time, x, u, PARAMETERS(core), h, u_rate, rates, next);
    return CORE_OK;
}
#endif
