/* The coefficients of Dormand and Prince's RK5(4)7M, for FMUs that integrate by it and for the loop, which integrates FMUs.
 * After Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, table II.5.2. */
#ifndef DORMAND_PRINCE_H
#define DORMAND_PRINCE_H

enum { STAGES = 7 };

static const double TIMES[STAGES] = {0.0, 1.0 / 5, 3.0 / 10, 4.0 / 5, 8.0 / 9, 1.0, 1.0};

/* The states of each stage; those of the last one are those at the end of the step. */
static const double STATE[STAGES][STAGES - 1] = {
    {0.0},
    {1.0 / 5},
    {3.0 / 40, 9.0 / 40},
    {44.0 / 45, -56.0 / 15, 32.0 / 9},
    {19372.0 / 6561, -25360.0 / 2187, 64448.0 / 6561, -212.0 / 729},
    {9017.0 / 3168, -355.0 / 33, 46732.0 / 5247, 49.0 / 176, -5103.0 / 18656},
    {35.0 / 384, 0.0, 500.0 / 1113, 125.0 / 192, -2187.0 / 6784, 11.0 / 84},
};

/* The difference of the two methods. */
static const double ERROR[STAGES] = {71.0 / 57600,      0.0,        -71.0 / 16695, 71.0 / 1920,
                                     -17253.0 / 339200, 22.0 / 525, -1.0 / 40};

#endif
