#include "kept_states.h"

typedef int GetState(void *, void **);
typedef int SetState(void *, void *);

int32_t keep_states(CurrentCall *call, const KeptState states[], int32_t n, int32_t *status) {
    for (int32_t i = 0; i < n; i++) {
        call->code = states[i].code_of_get;
        *status = ((GetState *)states[i].get)(states[i].instance, states[i].state);
        if (*status > 1) return i; /* worse than a warning */
    }
    *status = 0;
    return n;
}

int32_t go_back_to_states(CurrentCall *call, const KeptState states[], int32_t n, int32_t *status) {
    for (int32_t i = 0; i < n; i++) {
        call->code = states[i].code_of_set;
        *status = ((SetState *)states[i].set)(states[i].instance, *states[i].state);
        if (*status > 1) return i;
    }
    *status = 0;
    return n;
}
