/* States of FMUs that are kept in memory, to go back to. iterated_step.py lays the struct out once more. */
#ifndef KEPT_STATES_H
#define KEPT_STATES_H

#include "loop.h"

typedef struct {
    void *instance;
    void *get, *set; /* fmi2GetFMUstate or fmi3GetFMUState, and what sets it */
    void **state; /* where the FMU's pointer is, NULL before the first time */
    uint32_t code_of_get, code_of_set;
} KeptState;

/* Keep the states of n instances, in place of those that were kept before, or go back to them; the number of those of
 * which that went well, and the status of the next. */
int32_t keep_states(CurrentCall *call, const KeptState states[], int32_t n, int32_t *status);
int32_t go_back_to_states(CurrentCall *call, const KeptState states[], int32_t n, int32_t *status);

#endif
