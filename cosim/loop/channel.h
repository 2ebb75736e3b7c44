/* Memory by which the loop calls an FMU that lives in another process, the worker, as if its library were in this one.
 *
 * One side asks: the master puts calls, one after the other, into the area and counts `asked` up. The other answers: the
 * worker makes the calls, with pointers into the area as arguments, and counts `answered` up. Each spins for a short time
 * and then sleeps until the other's number changes. Nothing is copied but the arguments, and nothing is allocated.
 *
 * Calls have places in the area and no addresses: so they can be carried to a worker on another machine, see channel_relay.c.
 *
 * The worker may be damaged by its FMU and write anything here: the master trusts no size or place that stands here, only
 * those that it remembers itself. */
#ifndef CHANNEL_H
#define CHANNEL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* clang-format off */
/* Functions of FMI that can be called; those of FMI 1.0 begin with fmi1 here. Their numbers go over the channel. */
#define FUNCTIONS(F) \
    F(fmi1InstantiateSlave) F(fmi2Instantiate) F(fmi3InstantiateCoSimulation) F(fmi3InstantiateModelExchange) \
    F(fmi1InitializeSlave) F(fmi2SetupExperiment) F(fmi3EnterInitializationMode) \
    F(fmi1FreeSlaveInstance) F(fmi1TerminateSlave) F(fmi1ResetSlave) F(fmi1CancelStep) \
    F(fmi2FreeInstance) F(fmi2Terminate) F(fmi2Reset) F(fmi2CancelStep) F(fmi2EnterInitializationMode) \
    F(fmi2ExitInitializationMode) F(fmi2EnterEventMode) F(fmi2EnterContinuousTimeMode) \
    F(fmi3FreeInstance) F(fmi3Terminate) F(fmi3Reset) F(fmi3ExitInitializationMode) F(fmi3EnterEventMode) \
    F(fmi3EnterContinuousTimeMode) F(fmi3EnterStepMode) F(fmi3EnterConfigurationMode) F(fmi3ExitConfigurationMode) \
    F(fmi3EvaluateDiscreteStates) \
    F(fmi1DoStep) F(fmi2DoStep) F(fmi3DoStep) F(fmi3UpdateDiscreteStates) \
    F(fmi1GetStatus) F(fmi1GetRealStatus) F(fmi1GetIntegerStatus) F(fmi1GetBooleanStatus) \
    F(fmi2GetStatus) F(fmi2GetRealStatus) F(fmi2GetIntegerStatus) F(fmi2GetBooleanStatus) \
    F(fmi1GetReal) F(fmi1GetInteger) F(fmi1GetBoolean) F(fmi1GetString) \
    F(fmi1SetReal) F(fmi1SetInteger) F(fmi1SetBoolean) F(fmi1SetString) \
    F(fmi2GetReal) F(fmi2GetInteger) F(fmi2GetBoolean) F(fmi2GetString) \
    F(fmi2SetReal) F(fmi2SetInteger) F(fmi2SetBoolean) F(fmi2SetString) \
    F(fmi3GetFloat32) F(fmi3GetFloat64) F(fmi3GetInt8) F(fmi3GetUInt8) F(fmi3GetInt16) F(fmi3GetUInt16) \
    F(fmi3GetInt32) F(fmi3GetUInt32) F(fmi3GetInt64) F(fmi3GetUInt64) F(fmi3GetBoolean) F(fmi3GetString) \
    F(fmi3GetBinary) F(fmi3GetClock) \
    F(fmi3SetFloat32) F(fmi3SetFloat64) F(fmi3SetInt8) F(fmi3SetUInt8) F(fmi3SetInt16) F(fmi3SetUInt16) \
    F(fmi3SetInt32) F(fmi3SetUInt32) F(fmi3SetInt64) F(fmi3SetUInt64) F(fmi3SetBoolean) F(fmi3SetString) \
    F(fmi3SetBinary) F(fmi3SetClock) \
    F(fmi3GetIntervalDecimal) F(fmi3GetIntervalFraction) F(fmi3GetShiftDecimal) F(fmi3GetShiftFraction) \
    F(fmi3SetIntervalDecimal) F(fmi3SetIntervalFraction) F(fmi3SetShiftDecimal) F(fmi3SetShiftFraction) \
    F(fmi1SetRealInputDerivatives) F(fmi1GetRealOutputDerivatives) \
    F(fmi2SetRealInputDerivatives) F(fmi2GetRealOutputDerivatives) F(fmi3GetOutputDerivatives) \
    F(fmi2GetFMUstate) F(fmi2SetFMUstate) F(fmi2FreeFMUstate) F(fmi2SerializedFMUstateSize) F(fmi2SerializeFMUstate) \
    F(fmi2DeSerializeFMUstate) \
    F(fmi3GetFMUState) F(fmi3SetFMUState) F(fmi3FreeFMUState) F(fmi3SerializedFMUStateSize) F(fmi3SerializeFMUState) \
    F(fmi3DeserializeFMUState) \
    F(fmi2NewDiscreteStates) F(fmi2SetTime) F(fmi2SetContinuousStates) F(fmi2GetContinuousStates) \
    F(fmi2GetDerivatives) F(fmi2GetEventIndicators) F(fmi2GetNominalsOfContinuousStates) \
    F(fmi2CompletedIntegratorStep) F(fmi2GetDirectionalDerivative) \
    F(fmi3SetTime) F(fmi3SetContinuousStates) F(fmi3GetContinuousStates) F(fmi3GetContinuousStateDerivatives) \
    F(fmi3GetEventIndicators) F(fmi3GetNominalsOfContinuousStates) F(fmi3GetNumberOfEventIndicators) \
    F(fmi3GetNumberOfContinuousStates) F(fmi3CompletedIntegratorStep) F(fmi3GetDirectionalDerivative) \
    F(fmi3GetAdjointDerivative) \
    F(fmi1SetDebugLogging) F(fmi2SetDebugLogging) F(fmi3SetDebugLogging)
/* clang-format on */

#define NUMBERED(name) N_##name,
typedef enum { FUNCTIONS(NUMBERED) N_FUNCTIONS_OF_FMI } FunctionNumber;

/* What a place in the area means to the called function. */
typedef enum {
    INTEGER, /* an integer, a truth value, or a pointer that only the FMU knows */
    DOUBLE,
    ABSENT, /* a null pointer */
    GIVEN, /* pointer to what the function reads */
    FILLED, /* pointer to what it writes; it finds there what the caller has there */
    TEXTS, /* pointer to an array of texts that it reads, which stand one after the other with their ends */
    TEXTS_BACK, /* pointer to an array of texts that it gives */
    BLOBS, /* pointer to an array of pointers to binary values, whose sizes are the argument before */
    BLOBS_BACK, /* the same, that it gives */
    BESIDE /* no argument of the function, but data for its call */
} Passing;

typedef struct {
    uint64_t passing;
    uint64_t value; /* an integer, the bits of a double, or where in the area the bytes are */
    uint64_t size; /* in bytes */
    uint64_t n; /* of texts or binary values */
} Argument;

/* A call; its arguments and their bytes follow. */
typedef struct {
    uint32_t function, n_arguments;
    int32_t status;
    uint32_t padding;
    uint64_t end; /* where in the area the next one begins */
    uint64_t result; /* whether an instance was made; how many bytes of texts or binary values it gave: see `back` */
    uint64_t back; /* where these are, one after the other: eight bytes with the size, then the bytes */
} Call;

/* How a run extrapolates inputs of FMI 3.0, beside fmi3DoStep: one for each of its operations. */
typedef struct {
    int32_t n, n_references, degree, refused;
    double time;
} Inputs; /* then references, values, derivatives and `refused` */

enum { MESSAGES_SIZE = 1 << 18, MOST_ARGUMENTS = 48 };

/* What `asked` is first: the worker is to load its FMU. */
enum { ASKED_TO_LOAD = 1 };

/* A message of the FMU in the ring; then the category and the text, without ends. */
typedef struct {
    int32_t status;
    uint32_t call; /* that was being made */
    uint32_t category_size, text_size;
} Message;

typedef struct {
    uint32_t asked; /* changes when there are calls to make; ASKED_TO_LOAD from the beginning */
    uint32_t worker_sleeps;
    uint8_t apart0[56];
    uint32_t answered; /* becomes `asked` when they are made */
    uint32_t master_sleeps;
    uint8_t apart1[56];
    uint64_t n_calls; /* of the master: how many there are; 0 for the end */
    uint32_t spin; /* how long (ns) the worker looks for calls before it sleeps */
    uint32_t at; /* of the worker: the call that it makes now */
    uint64_t written, read; /* bytes of messages, by the worker and the master */
    uint64_t used; /* of the master: bytes of the calls */
    uint64_t reach; /* of the worker: bytes of the calls and of what they have given */
    int32_t core; /* of the master: the core that it stays on, and the worker with it; -1 for none */
    uint8_t apart2[12];
    uint8_t messages[MESSAGES_SIZE];
    uint8_t area[]; /* the calls */
} Channel;

#endif
