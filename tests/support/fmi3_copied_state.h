/* The functions of FMI 3.0 about states, for an FMU whose state is a copy of its `Model`; include it behind that type. */

#include <stdlib.h>
#include <string.h>

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *state) {
    if (*state == NULL) *state = malloc(sizeof(Model));
    if (*state == NULL) return fmi3Error;
    memcpy(*state, instance, sizeof(Model));
    return fmi3OK;
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState state) {
    memcpy(instance, state, sizeof(Model));
    return fmi3OK;
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *state) {
    (void)instance;
    free(*state);
    *state = NULL;
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState state, size_t *size) {
    (void)instance, (void)state;
    *size = sizeof(Model);
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState state, fmi3Byte bytes[], size_t size) {
    (void)instance;
    memcpy(bytes, state, size);
    return fmi3OK;
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte bytes[], size_t size, fmi3FMUState *state) {
    (void)instance;
    *state = malloc(sizeof(Model));
    if (*state == NULL || size != sizeof(Model)) return fmi3Error;
    memcpy(*state, bytes, size);
    return fmi3OK;
}
