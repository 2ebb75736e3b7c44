/* A team of threads that steps the components of a system at the same time. */
#ifndef TEAM_H
#define TEAM_H

#include "loop.h"

typedef struct Team Team;

/* A team of so many threads, that of the loop included, for operations at_step of which unit i has those from starts[i] to
 * starts[i + 1] - 1, and is left to the thread of the loop if stays[i]. An automatic one steps one component after the
 * other where that is measured to be faster. NULL where there are no threads to be had. */
EXPORT Team *team_new(int32_t threads, bool automatic, int32_t units, const int64_t *starts, const uint8_t *stays);

EXPORT void team_free(Team *team);

/* How many steps were made at the same time. */
EXPORT int64_t team_steps_together(const Team *team);

/* A step from a communication point, in place of the operations at_step one by one. */
EXPORT bool team_step(Loop *loop, int64_t point);

/* What is left of that step once the operation that failed has been dealt with: as loop_rest_of_step. */
EXPORT bool team_rest_of_step(Loop *loop, int64_t failed, int64_t point);

#endif
