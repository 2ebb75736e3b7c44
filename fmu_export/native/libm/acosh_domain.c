/* musl's acosh has finite values for large negative numbers, where it should have none; written for this project. */
#include "libm.h"

double libm_acosh(double x);
double libm_acosh(double x) { return x >= 1.0 ? acosh(x) : (x - x) / (x - x); }
