/* Starting blocks: at the start, and after what jumps, the steps that a polynomial needs before it knows enough are computed
 * together, again and again, until its inputs go through what comes out at all their ends. starting_block.py lays the struct
 * out once more. */
#ifndef STARTING_BLOCK_H
#define STARTING_BLOCK_H

#include "kept_states.h"

typedef struct StartingBlock {
    KeptState *states;
    const Extrapolated
        *first; /* of those that are a part of it: knows nothing where something else than a signal jumped */
    double *rows,
        *before; /* all n_values at the points of the block: steps + 1 rows, of this trial and of the last one */
    int32_t *known, *refused; /* of all that is extrapolated, before the block */
    int64_t n_values;
    int32_t n_states, steps;
    int64_t n_blocks, n_not_found, n_trials; /* of the run */
    int32_t failed, status; /* the instance that could not go back, and what it said; -1 where none has */
} StartingBlock;

/* Whether a step is the first one of those of which inputs know nothing but their present values. */
bool starts_anew(const Loop *loop, int64_t point);

/* Have inputs know how they go over the steps from a point on; false, with the reason in `loop`, where an instance can't go
 * back. Where no such block is found all is as before. */
bool start_block(Loop *loop, int64_t point);

#endif
