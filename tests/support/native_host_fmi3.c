/* A host that walks every function of FMI 3.0 in every state, with arguments good and bad.
 *
 * Usage: host FOLDER, where good/, broken/, "a b"/, "ü"/, %zz/ and 50%/ each hold an intact start_values.txt.
 * The program must be linked with the sources of an FMU.
 * Prints what was not as expected, then the number of calls; the exit code is 0 if all was. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3Functions.h"
#include "model.h"

enum { N_PU = N_P + N_U, N_VALUES = N_PU + N_Y + N_X };
/* FAIL is after an error; a discarded step leaves the instance as it was. */
enum { INST = 1, INIT = 2, STEP = 4, EVENT = 8, CONT = 16, TERM = 32, FAIL = 128, NOTHING = 0 };
enum { RUN = STEP | EVENT | CONT, OVER = TERM | FAIL, ANY = INST | INIT | RUN | OVER, SAME = 0 };

static const int phases[] = {INST, INIT, STEP, EVENT, CONT, TERM, FAIL};

#include "native_host.h"

static void logger(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category, fmi3String message) {
    int length = snprintf(last_message, sizeof last_message, "%s", message);
    messages++;
    expect(length > 0, "an empty message", "logger", 0, status);
    expect(percent_allowed || !strchr(last_message, '%'), "an unexpanded percent sign", "logger", 0, status);
    for (const char *c = last_message; *c; c++)
        expect((*c >= ' ' && *c <= '~') || (foreign_allowed && *c < 0), "a character that is not a text", "logger", 0,
               status);
    expect(environment == &calls, "another environment", "logger", 0, status);
    expect((status == fmi3Error && !strcmp(category, "logStatusError")) ||
               (status == fmi3Discard && !strcmp(category, "logStatusDiscard")) ||
               (status == fmi3Warning && !strcmp(category, "logStatusWarning")),
           "a wrong category", "logger", 0, status);
}

typedef enum { fmi3ModelExchange, fmi3CoSimulation } Type;

static char folder[2048], good[4096];
static fmi3Boolean flag, flag2;
static double moment;

static fmi3Instance instantiate(Type type, const char *name, const char *resources) {
    calls++;
    if (type == fmi3ModelExchange)
        return fmi3InstantiateModelExchange(name, MODEL_GUID, resources, fmi3False, fmi3True, &calls, logger);
    return fmi3InstantiateCoSimulation(name, MODEL_GUID, resources, fmi3False, fmi3True, fmi3False, fmi3False, NULL, 0,
                                       &calls, logger, NULL);
}

static void legal(fmi3Status status, const char *what) {
    calls++;
    expect(status == fmi3OK, "the legal path is barred", what, 0, status);
}

#define LEGAL(call) legal(call, #call)

/* A new instance in a phase, by the legal path. */
static fmi3Instance at(int phase, Type type, const char *name) {
    fmi3Instance c = instantiate(type, name, good);
    if (!c) {
        expect(0, "no instance", "at", phase, 0);
        exit(1);
    }
    if (phase == INST) return c;
    LEGAL(fmi3EnterInitializationMode(c, fmi3False, 0.0, 0.0, fmi3False, 0.0));
    if (phase == INIT) return c;
    LEGAL(fmi3ExitInitializationMode(c));
    if (phase == CONT) {
        LEGAL(fmi3UpdateDiscreteStates(c, &flag, &flag, &flag, &flag, &flag, &moment));
        LEGAL(fmi3EnterContinuousTimeMode(c));
    }
    if (phase == TERM) LEGAL(fmi3Terminate(c));
    if (phase == FAIL) expect(fmi3Terminate(c) == fmi3OK && fmi3Terminate(c) == fmi3Error, "no error", "at", phase, 0);
    return c;
}

/* Arguments; heap blocks of exact sizes show what reads or writes beyond them. */
static fmi3ValueReference *all, parameter[] = {0}, fixed[] = {0}, input[] = {N_P}, output[] = {N_PU},
                                state_variable[] = {N_PU}, derivative[] = {N_PU + N_Y}, timing[] = {N_VALUES};
static fmi3ValueReference beyond[] = {N_VALUES + 1 + N_EVENTS}, huge[] = {0xFFFFFFFFu}, mixed[] = {0, 0xFFFFFFFFu};
static double *x, *bad_x, *values, *seeds, *sensitivities, one_value[] = {0.25}, not_a_number[2], infinite[2],
                                                           two[2] = {1.0, 1.0};
static fmi3ValueReference *computed; /* outputs and derivatives */
static int order1[] = {1}, order2[] = {2}, integers[1];
static const char *strings[] = {"text"};
static fmi3Byte *bytes, *damaged;
static size_t size;
static fmi3FMUState state; /* of an instance in the phase of the test */
static size_t count;
static fmi3Float32 float32[1];
static fmi3Int8 int8[1];
static fmi3UInt8 uint8[1];
static fmi3Int16 int16[1];
static fmi3UInt16 uint16[1];
static fmi3UInt32 uint32[1];
static fmi3Int64 int64[1];
static fmi3UInt64 uint64[2];
static fmi3Boolean boolean[1];
static fmi3Clock clocks[1];
static fmi3Binary binary[1];
static size_t sizes[2];
static fmi3IntervalQualifier qualifiers[1];
static fmi3DependencyKind kinds[1];
static const double step_of_ages = 1e300;

/* Sets an output that is not a state, where there is one. */
static fmi3Status set_output(fmi3Instance c) {
    if (model_output_states[output[0] - N_PU] >= 0) return fmi3Error;
    return fmi3SetFloat64(c, output, 1, one_value, 1);
}

/* Sets a state to what it is; before the initialisation that is a guess, which is warned of. */
static fmi3Status set_state(fmi3Instance c) {
    double value[1];
    if (fmi3GetFloat64(c, state_variable, 1, value, 1) != fmi3OK) return fmi3Error;
    fmi3Status status = fmi3SetFloat64(c, state_variable, 1, value, 1);
    if (status != fmi3Warning) return status;
    messages--;
    return fmi3OK;
}

static fmi3Status keep_and_restore(fmi3Instance c) {
    fmi3FMUState kept = NULL;
    fmi3Status status = fmi3GetFMUState(c, &kept);
    if (status == fmi3OK) status = fmi3GetFMUState(c, &kept); /* again, into the same place */
    if (status == fmi3OK) status = fmi3SetFMUState(c, kept);
    if (status == fmi3OK) status = fmi3FreeFMUState(c, &kept);
    return kept ? fmi3Fatal : status;
}

static fmi3Status write_and_read(fmi3Instance c, size_t length, int damage) {
    fmi3FMUState kept = NULL, read = NULL;
    fmi3Status status = fmi3GetFMUState(c, &kept);
    if (status != fmi3OK) return fmi3Fatal;
    if (fmi3SerializeFMUState(c, kept, bytes, size) != fmi3OK) return fmi3Fatal;
    fmi3Byte *part = malloc(length);
    memcpy(part, bytes, length < size ? length : size);
    if (damage >= 0) part[damage] = (fmi3Byte)(part[damage] ^ 0x15);
    status = fmi3DeserializeFMUState(c, part, length, &read);
    if (status == fmi3OK && fmi3SetFMUState(c, read) != fmi3OK) status = fmi3Fatal;
    if (status != fmi3OK && read) status = fmi3Fatal; /* an error must make no state */
    free(part);
    fmi3FreeFMUState(c, &read);
    fmi3FreeFMUState(c, &kept);
    return status;
}

/* Samplers go by the time of the instance: no step begins elsewhere. */
static double now(fmi3Instance c) {
    double time = 0.0;
    fmi3GetFloat64(c, &(fmi3ValueReference){N_VALUES}, 1, &time, 1);
    return time;
}

/* Phases where the call is allowed, its status there, the phase after it, whether this model can make it, the call. */
#define CASES(X) \
    X(ANY, fmi3OK, SAME, 1, fmi3SetDebugLogging(c, fmi3True, 0, NULL)) \
    X(ANY, fmi3OK, SAME, 1, fmi3SetDebugLogging(c, fmi3False, 1, strings)) \
    X(INIT, fmi3OK, RUN, 1, fmi3ExitInitializationMode(c)) \
    X(RUN, fmi3OK, TERM, 1, fmi3Terminate(c)) \
    X(ANY, fmi3OK, INST, 1, fmi3Reset(c)) \
    X(INIT | RUN | OVER, fmi3OK, SAME, 1, fmi3GetFloat64(c, all, N_VALUES + 1, values, N_VALUES + 1)) \
    X(INIT | RUN | OVER, fmi3OK, SAME, N_X, fmi3GetFloat64(c, derivative, 1, values, 1)) \
    X(ANY, fmi3OK, SAME, 1, fmi3GetFloat64(c, all, N_PU, values, N_PU)) \
    X(ANY, fmi3OK, SAME, N_X, fmi3GetFloat64(c, state_variable, 1, values, 1)) \
    X(ANY, fmi3OK, SAME, 1, fmi3GetFloat64(c, NULL, 0, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetFloat64(c, NULL, 1, values, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetFloat64(c, parameter, 1, NULL, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetFloat64(c, beyond, 1, values, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetFloat64(c, mixed, 2, values, 2)) \
    X(INST | INIT | STEP | EVENT, fmi3OK, SAME, 1, \
      (fmi3GetFloat64(c, parameter, 1, values, 1), fmi3SetFloat64(c, parameter, 1, values, 1))) \
    X(INST | INIT, fmi3OK, SAME, 1, (fmi3GetFloat64(c, fixed, 1, values, 1), fmi3SetFloat64(c, fixed, 1, values, 1))) \
    X(INST | INIT | RUN, fmi3OK, SAME, N_U, fmi3SetFloat64(c, input, 1, one_value, 1)) \
    X(INST | INIT | RUN, fmi3OK, SAME, 1, fmi3SetFloat64(c, NULL, 0, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetFloat64(c, NULL, 1, one_value, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetFloat64(c, parameter, 1, NULL, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetFloat64(c, parameter, 1, not_a_number, 1)) \
    X(NOTHING, fmi3Error, SAME, N_U, fmi3SetFloat64(c, input, 1, infinite, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, set_output(c)) \
    X(INST | EVENT | CONT, fmi3OK, SAME, N_X, set_state(c)) \
    X(NOTHING, fmi3Error, SAME, N_X, fmi3SetFloat64(c, derivative, 1, one_value, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetFloat64(c, timing, 1, one_value, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetFloat64(c, huge, 1, one_value, 1)) \
    X(ANY, fmi3OK, SAME, 1, keep_and_restore(c)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetFMUState(c, NULL)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetFMUState(c, NULL)) \
    X(ANY, fmi3OK, SAME, 1, fmi3FreeFMUState(c, NULL)) \
    X(ANY, fmi3OK, SAME, 1, fmi3SerializedFMUStateSize(c, state, &size)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SerializedFMUStateSize(c, NULL, &size)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SerializedFMUStateSize(c, state, NULL)) \
    X(ANY, fmi3OK, SAME, 1, fmi3SerializeFMUState(c, state, bytes, size)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SerializeFMUState(c, state, bytes, size - 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SerializeFMUState(c, state, NULL, size)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SerializeFMUState(c, NULL, bytes, size)) \
    X(ANY, fmi3OK, SAME, 1, write_and_read(c, size, -1)) \
    X(NOTHING, fmi3Error, SAME, 1, write_and_read(c, size - 1, -1)) \
    X(NOTHING, fmi3Error, SAME, 1, write_and_read(c, size + 1, -1)) \
    X(NOTHING, fmi3Error, SAME, 1, write_and_read(c, 1, -1)) \
    X(NOTHING, fmi3Error, SAME, 1, write_and_read(c, 0, -1)) \
    X(NOTHING, fmi3Error, SAME, 1, write_and_read(c, size, 0)) \
    X(NOTHING, fmi3Error, SAME, 1, write_and_read(c, size, (int)sizeof MODEL_GUID - 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3DeserializeFMUState(c, NULL, size, &state)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3DeserializeFMUState(c, bytes, size, NULL)) \
    X(EVENT | CONT, fmi3OK, EVENT, 1, fmi3EnterEventMode(c)) \
    X(EVENT, fmi3OK, CONT, 1, fmi3EnterContinuousTimeMode(c)) \
    X(CONT, fmi3OK, SAME, 1, fmi3CompletedIntegratorStep(c, fmi3True, &flag, &flag2)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3CompletedIntegratorStep(c, fmi3True, NULL, &flag2)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3CompletedIntegratorStep(c, fmi3True, &flag, NULL)) \
    X(EVENT | CONT, fmi3OK, SAME, 1, fmi3SetTime(c, 0.125)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetTime(c, NAN)) \
    X(CONT, fmi3OK, SAME, 1, (fmi3GetContinuousStates(c, x, N_X), fmi3SetContinuousStates(c, x, N_X))) \
    X(CONT, fmi3OK, SAME, !N_X, fmi3SetContinuousStates(c, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, N_X, fmi3SetContinuousStates(c, NULL, N_X)) \
    X(NOTHING, fmi3Error, SAME, N_X, fmi3SetContinuousStates(c, bad_x, N_X)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetContinuousStates(c, x, N_X + 1)) \
    X(INIT | EVENT | CONT | OVER, fmi3OK, SAME, 1, fmi3GetEventIndicators(c, values, N_EVENTS)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetEventIndicators(c, values, N_EVENTS + 1)) \
    X(INIT | EVENT | CONT | OVER, fmi3OK, SAME, 1, fmi3GetContinuousStates(c, x, N_X)) \
    X(INIT | EVENT | CONT | OVER, fmi3OK, SAME, !N_X, fmi3GetContinuousStates(c, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, N_X, fmi3GetContinuousStates(c, NULL, N_X)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetContinuousStates(c, x, N_X + 1)) \
    X(INIT | EVENT | CONT | OVER, fmi3OK, SAME, 1, fmi3GetNominalsOfContinuousStates(c, x, N_X)) \
    X(INIT | EVENT | CONT | OVER, fmi3OK, SAME, !N_X, fmi3GetNominalsOfContinuousStates(c, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, N_X, fmi3GetNominalsOfContinuousStates(c, NULL, N_X)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetNominalsOfContinuousStates(c, x, N_X + 1)) \
    X(INST, fmi3OK, INIT, 1, fmi3EnterInitializationMode(c, fmi3False, 0.0, 0.0, fmi3False, 0.0)) \
    X(INST, fmi3OK, INIT, 1, fmi3EnterInitializationMode(c, fmi3True, 1e-6, 0.5, fmi3True, 1e301)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3EnterInitializationMode(c, fmi3False, 0.0, 0.0, fmi3True, NAN)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3EnterInitializationMode(c, fmi3False, 0.0, NAN, fmi3False, 0.0)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3EnterInitializationMode(c, fmi3False, 0.0, INFINITY, fmi3False, 0.0)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetFloat64(c, output, 1, values, 2)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetFloat64(c, NULL, 0, NULL, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetFloat64(c, parameter, 1, one_value, 0)) \
    X(ANY, fmi3OK, SAME, 1, fmi3GetFloat32(c, NULL, 0, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetFloat32(c, parameter, 1, float32, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetFloat32(c, huge, 1, NULL, 0)) \
    X(ANY, fmi3OK, SAME, 1, fmi3SetFloat32(c, NULL, 0, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetFloat32(c, parameter, 1, float32, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetFloat32(c, huge, 1, NULL, 0)) \
    X(ANY, fmi3OK, SAME, 1, fmi3GetInt8(c, NULL, 0, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetInt8(c, parameter, 1, int8, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetInt8(c, huge, 1, NULL, 0)) \
    X(ANY, fmi3OK, SAME, 1, fmi3SetInt8(c, NULL, 0, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetInt8(c, parameter, 1, int8, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetInt8(c, huge, 1, NULL, 0)) \
    X(ANY, fmi3OK, SAME, 1, fmi3GetUInt8(c, NULL, 0, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetUInt8(c, parameter, 1, uint8, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetUInt8(c, huge, 1, NULL, 0)) \
    X(ANY, fmi3OK, SAME, 1, fmi3SetUInt8(c, NULL, 0, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetUInt8(c, parameter, 1, uint8, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetUInt8(c, huge, 1, NULL, 0)) \
    X(ANY, fmi3OK, SAME, 1, fmi3GetInt16(c, NULL, 0, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetInt16(c, parameter, 1, int16, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetInt16(c, huge, 1, NULL, 0)) \
    X(ANY, fmi3OK, SAME, 1, fmi3SetInt16(c, NULL, 0, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetInt16(c, parameter, 1, int16, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetInt16(c, huge, 1, NULL, 0)) \
    X(ANY, fmi3OK, SAME, 1, fmi3GetUInt16(c, NULL, 0, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetUInt16(c, parameter, 1, uint16, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetUInt16(c, huge, 1, NULL, 0)) \
    X(ANY, fmi3OK, SAME, 1, fmi3SetUInt16(c, NULL, 0, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetUInt16(c, parameter, 1, uint16, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetUInt16(c, huge, 1, NULL, 0)) \
    X(ANY, fmi3OK, SAME, 1, fmi3GetInt32(c, NULL, 0, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetInt32(c, parameter, 1, integers, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetInt32(c, huge, 1, NULL, 0)) \
    X(INST | INIT | RUN, fmi3OK, SAME, 1, fmi3SetInt32(c, NULL, 0, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetInt32(c, parameter, 1, integers, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetInt32(c, huge, 1, NULL, 0)) \
    X(ANY, fmi3OK, SAME, 1, fmi3GetUInt32(c, NULL, 0, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetUInt32(c, parameter, 1, uint32, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetUInt32(c, huge, 1, NULL, 0)) \
    X(ANY, fmi3OK, SAME, 1, fmi3SetUInt32(c, NULL, 0, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetUInt32(c, parameter, 1, uint32, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetUInt32(c, huge, 1, NULL, 0)) \
    X(ANY, fmi3OK, SAME, 1, fmi3GetInt64(c, NULL, 0, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetInt64(c, parameter, 1, int64, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetInt64(c, huge, 1, NULL, 0)) \
    X(INST | INIT | RUN, fmi3OK, SAME, 1, fmi3SetInt64(c, NULL, 0, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetInt64(c, parameter, 1, int64, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetInt64(c, huge, 1, NULL, 0)) \
    X(ANY, fmi3OK, SAME, 1, fmi3GetUInt64(c, NULL, 0, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetUInt64(c, parameter, 1, uint64, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetUInt64(c, huge, 1, NULL, 0)) \
    X(ANY, fmi3OK, SAME, 1, fmi3SetUInt64(c, NULL, 0, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetUInt64(c, parameter, 1, uint64, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetUInt64(c, huge, 1, NULL, 0)) \
    X(ANY, fmi3OK, SAME, 1, fmi3GetBoolean(c, NULL, 0, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetBoolean(c, parameter, 1, boolean, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetBoolean(c, huge, 1, NULL, 0)) \
    X(INST | INIT | RUN, fmi3OK, SAME, 1, fmi3SetBoolean(c, NULL, 0, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetBoolean(c, parameter, 1, boolean, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetBoolean(c, huge, 1, NULL, 0)) \
    X(ANY, fmi3OK, SAME, 1, fmi3GetString(c, NULL, 0, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetString(c, parameter, 1, strings, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetString(c, huge, 1, NULL, 0)) \
    X(INST | INIT | RUN, fmi3OK, SAME, 1, fmi3SetString(c, NULL, 0, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetString(c, parameter, 1, strings, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetString(c, huge, 1, NULL, 0)) \
    X(ANY, fmi3OK, SAME, 1, fmi3GetBinary(c, NULL, 0, NULL, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetBinary(c, parameter, 1, sizes, binary, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetBinary(c, NULL, 1, NULL, NULL, 1)) \
    X(ANY, fmi3OK, SAME, 1, fmi3GetClock(c, NULL, 0, NULL)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetClock(c, parameter, 1, clocks)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetIntervalDecimal(c, parameter, 1, values, qualifiers)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetIntervalFraction(c, parameter, 1, uint64, uint64, qualifiers)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetShiftDecimal(c, parameter, 1, values)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetShiftFraction(c, NULL, 1, NULL, NULL)) \
    X(ANY, fmi3OK, SAME, 1, fmi3SetBinary(c, NULL, 0, NULL, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetBinary(c, parameter, 1, sizes, binary, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetBinary(c, NULL, 1, NULL, NULL, 1)) \
    X(ANY, fmi3OK, SAME, 1, fmi3SetClock(c, NULL, 0, NULL)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetClock(c, parameter, 1, clocks)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetIntervalDecimal(c, parameter, 1, values)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetIntervalFraction(c, parameter, 1, uint64, uint64)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetShiftDecimal(c, parameter, 1, values)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3SetShiftFraction(c, NULL, 1, NULL, NULL)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetNumberOfVariableDependencies(c, output[0], &count)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetNumberOfVariableDependencies(c, huge[0], NULL)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetVariableDependencies(c, output[0], sizes, parameter, sizes, kinds, 1)) \
    X(INIT | RUN | OVER, fmi3OK, SAME, 1, \
      fmi3GetAdjointDerivative(c, output, 1, parameter, 1, one_value, 1, sensitivities, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, \
      fmi3GetAdjointDerivative(c, parameter, 1, parameter, 1, one_value, 1, sensitivities, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetAdjointDerivative(c, output, 1, huge, 1, one_value, 1, sensitivities, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetAdjointDerivative(c, output, 1, parameter, 1, NULL, 1, sensitivities, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3EnterConfigurationMode(c)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3ExitConfigurationMode(c)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3EvaluateDiscreteStates(c)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3EnterStepMode(c)) \
    X(STEP | OVER, fmi3OK, SAME, 1, fmi3GetOutputDerivatives(c, output, 1, order1, values, 1)) \
    X(STEP | OVER, fmi3OK, SAME, 1, fmi3GetOutputDerivatives(c, NULL, 0, NULL, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetOutputDerivatives(c, output, 1, order2, values, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetOutputDerivatives(c, parameter, 1, order1, values, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetOutputDerivatives(c, output, 1, NULL, values, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3ActivateModelPartition(c, huge[0], 0.0)) \
    X(INIT | RUN | OVER, fmi3OK, SAME, 1, \
      fmi3GetDirectionalDerivative(c, computed, N_Y + N_X, all, N_VALUES, seeds, N_VALUES, sensitivities, N_Y + N_X)) \
    X(INIT | RUN | OVER, fmi3OK, SAME, 1, fmi3GetDirectionalDerivative(c, NULL, 0, NULL, 0, NULL, 0, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, 1, \
      fmi3GetDirectionalDerivative(c, output, 1, parameter, 1, infinite, 1, sensitivities, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, \
      fmi3GetDirectionalDerivative(c, parameter, 1, parameter, 1, one_value, 1, sensitivities, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, \
      fmi3GetDirectionalDerivative(c, timing, 1, parameter, 1, one_value, 1, sensitivities, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, \
      fmi3GetDirectionalDerivative(c, huge, 1, parameter, 1, one_value, 1, sensitivities, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetDirectionalDerivative(c, output, 1, mixed, 2, two, 2, sensitivities, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetDirectionalDerivative(c, output, 1, parameter, 1, two, 2, sensitivities, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, \
      fmi3GetDirectionalDerivative(c, output, 1, parameter, 1, one_value, 1, sensitivities, 2)) \
    X(NOTHING, fmi3Error, SAME, 1, \
      fmi3GetDirectionalDerivative(c, NULL, 1, parameter, 1, one_value, 1, sensitivities, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, \
      fmi3GetDirectionalDerivative(c, output, 1, NULL, 1, one_value, 1, sensitivities, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, \
      fmi3GetDirectionalDerivative(c, output, 1, parameter, 1, NULL, 1, sensitivities, 1)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetDirectionalDerivative(c, output, 1, parameter, 1, one_value, 1, NULL, 1)) \
    X(STEP, fmi3OK, SAME, 1, fmi3DoStep(c, now(c), 1e-3, fmi3True, &flag, &flag2, &flag2, &moment)) \
    X(STEP, fmi3Discard, SAME, N_X && !ADAPTIVE, \
      fmi3DoStep(c, now(c), step_of_ages, fmi3True, &flag, &flag2, &flag2, &moment)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3DoStep(c, now(c) + 0.5, 1e-3, fmi3True, &flag, &flag2, &flag2, &moment)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3DoStep(c, 0.0, 0.0, fmi3True, &flag, &flag2, &flag2, &moment)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3DoStep(c, 0.0, -1e-3, fmi3True, &flag, &flag2, &flag2, &moment)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3DoStep(c, 0.0, NAN, fmi3True, &flag, &flag2, &flag2, &moment)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3DoStep(c, INFINITY, 1e-3, fmi3True, &flag, &flag2, &flag2, &moment)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3DoStep(c, 1.7e308, 1.7e308, fmi3True, &flag, &flag2, &flag2, &moment)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3DoStep(c, 0.0, 1e-3, fmi3True, NULL, &flag2, &flag2, &moment)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3DoStep(c, 0.0, 1e-3, fmi3True, &flag, NULL, &flag2, &moment)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3DoStep(c, 0.0, 1e-3, fmi3True, &flag, &flag2, NULL, &moment)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3DoStep(c, 0.0, 1e-3, fmi3True, &flag, &flag2, &flag2, NULL)) \
    X(EVENT, fmi3OK, SAME, 1, fmi3UpdateDiscreteStates(c, &flag, &flag, &flag, &flag, &flag, &moment)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3UpdateDiscreteStates(c, NULL, &flag, &flag, &flag, &flag, &moment)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3UpdateDiscreteStates(c, &flag, NULL, &flag, &flag, &flag, &moment)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3UpdateDiscreteStates(c, &flag, &flag, NULL, &flag, &flag, &moment)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3UpdateDiscreteStates(c, &flag, &flag, &flag, NULL, &flag, &moment)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3UpdateDiscreteStates(c, &flag, &flag, &flag, &flag, NULL, &moment)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3UpdateDiscreteStates(c, &flag, &flag, &flag, &flag, &flag, NULL)) \
    X(INIT | EVENT | CONT | OVER, fmi3OK, SAME, 1, fmi3GetContinuousStateDerivatives(c, x, N_X)) \
    X(INIT | EVENT | CONT | OVER, fmi3OK, SAME, !N_X, fmi3GetContinuousStateDerivatives(c, NULL, 0)) \
    X(NOTHING, fmi3Error, SAME, N_X, fmi3GetContinuousStateDerivatives(c, NULL, N_X)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetContinuousStateDerivatives(c, x, (size_t)-1)) \
    X(ANY, fmi3OK, SAME, 1, fmi3GetNumberOfEventIndicators(c, &count)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetNumberOfEventIndicators(c, NULL)) \
    X(ANY, fmi3OK, SAME, 1, fmi3GetNumberOfContinuousStates(c, &count)) \
    X(NOTHING, fmi3Error, SAME, 1, fmi3GetNumberOfContinuousStates(c, NULL))

#define LIST(allowed, status, next, possible, call) {allowed, status, next, possible, #call},
static const struct {
    int allowed, status, next, possible;
    const char *text;
} cases[] = {CASES(LIST)};
enum { N_CASES = sizeof cases / sizeof *cases };

static fmi3Status run(int which, fmi3Instance c) {
    int i = 0;
#define RUN_IT(allowed, status, next, possible, call) \
    if (which == i++) return call;
    CASES(RUN_IT)
    return fmi3Fatal;
}

/* What can be set, and the time; never refused. */
static void observe(fmi3Instance c, double seen[]) {
    expect(fmi3GetFloat64(c, all, N_PU, seen, N_PU) == fmi3OK && fmi3GetFloat64(c, timing, 1, seen + N_PU, 1) == fmi3OK,
           "values can't be read", "observe", 0, 0);
}

/* Make one call, compare its status and what it changed; return the phase after it. */
static int check(int which, fmi3Instance c, int phase, Type type) {
    double before[N_PU + 1], after[N_PU + 1];
    if (!cases[which].possible) return phase;
    int expected = cases[which].allowed & phase ? cases[which].status : fmi3Error;
    observe(c, before);
    long logged = messages;
    int status = run(which, c);
    calls++;
    expect(status == expected, "an unexpected status", cases[which].text, phase, status);
    if (status == fmi3Error) expect(messages > logged, "an error without a message", cases[which].text, phase, status);
    if (status == fmi3OK && !strchr(cases[which].text, ','))
        expect(messages == logged, "a message without an error", cases[which].text, phase, status);
    if (status != fmi3OK) {
        observe(c, after);
        for (int i = 0; i <= N_PU; i++)
            expect(same(before[i], after[i]), "a refused call has changed a value", cases[which].text, phase, status);
    }
    if (status == fmi3Error) return FAIL;
    int next = cases[which].next;
    return next == SAME ? phase : next == RUN ? (type == fmi3CoSimulation ? STEP : EVENT) : next;
}

static int belongs(int phase, Type type) { return !(phase & (type == fmi3CoSimulation ? EVENT | CONT : STEP)); }

static void walk_systematically(Type type) {
    for (size_t k = 0; k < sizeof phases / sizeof *phases; k++)
        for (int i = 0; belongs(phases[k], type) && i < N_CASES; i++) {
            fmi3Instance c = at(phases[k], type, "one");
            int phase = check(i, c, phases[k], type);
            if (phase != FAIL ||
                phases[k] & ~(INST | INIT)) /* else nothing has been computed that could be looked at */
                phase = check(i, c, phase, type); /* again, from where that led */
            LEGAL(fmi3Reset(c));
            fmi3FreeInstance(c);
        }
}

/* Two instances by turns, calls drawn at random; each must behave as its own phase says. After most errors a state from before
 * the call is restored. */
static void walk_at_random(Type type, int n) {
    fmi3Instance c[2] = {at(INST, type, "one"), at(INST, fmi3CoSimulation, "other")};
    Type types[2] = {type, fmi3CoSimulation};
    int phase[2] = {INST, INST};
    unsigned random = 12345u;
    for (int i = 0; i < n; i++) {
        random = random * 1664525u + 1013904223u;
        int k = (int)(random >> 31), which = (int)((random >> 8) % N_CASES), before = phase[k];
        fmi3FMUState kept = NULL;
        LEGAL(fmi3GetFMUState(c[k], &kept));
        phase[k] = check(which, c[k], before, types[k]);
        if (phase[k] & OVER && (before & (INST | INIT) || random % 8)) {
            LEGAL(fmi3SetFMUState(c[k], kept));
            phase[k] = before;
        }
        LEGAL(fmi3FreeFMUState(c[k], &kept));
    }
    fmi3FreeInstance(c[0]);
    fmi3FreeInstance(c[1]);
}

static void walk_without_instance(void) {
    for (int i = 0; i < N_CASES; i++) {
        if (strstr(cases[i].text, "_and_re")) continue; /* they need the bytes of a state */
        int status = run(i, NULL);
        calls++;
        expect(status == fmi3Error, "no error without an instance", cases[i].text, 0, status);
    }
    fmi3FreeInstance(NULL);
    expect(!strcmp(fmi3GetVersion(), "3.0"), "a wrong version", "fmi3GetVersion", 0, 0);
}

/* Initial states are there as soon as the initialisation mode is. */
static void check_initial_states(void) {
    double before[N_X + 1], after[N_X + 1], rate[N_X + 1], rate_after[N_X + 1];
    fmi3Instance c = at(INIT, fmi3ModelExchange, "one");
    LEGAL(fmi3GetContinuousStates(c, before, N_X));
    LEGAL(fmi3GetContinuousStateDerivatives(c, rate, N_X));
    LEGAL(fmi3ExitInitializationMode(c));
    LEGAL(fmi3GetContinuousStates(c, after, N_X));
    LEGAL(fmi3GetContinuousStateDerivatives(c, rate_after, N_X));
    for (int i = 0; i < N_X; i++)
        expect(same(before[i], after[i]) && same(rate[i], rate_after[i]) && isfinite(rate_after[i]),
               "other initial states", "check_initial_states", INIT, i);
    fmi3FreeInstance(c);
}

/* FMU states go from instance to instance; damaged ones must not. */
static void check_states(void) {
    fmi3Instance one = at(STEP, fmi3CoSimulation, "one"), other = at(INST, fmi3CoSimulation, "other"),
                 exchange = at(EVENT, fmi3ModelExchange, "one");
    double before[N_VALUES + 1], after[N_VALUES + 1];
    fmi3FMUState kept = NULL, read = NULL;
    LEGAL(fmi3DoStep(one, 0.0, 1e-3, fmi3True, &flag, &flag2, &flag2, &moment));
    LEGAL(fmi3GetFloat64(one, all, N_VALUES + 1, before, N_VALUES + 1));
    LEGAL(fmi3GetFMUState(one, &kept));
    LEGAL(fmi3SerializeFMUState(one, kept, bytes, size));
    LEGAL(fmi3DoStep(one, 1e-3, 1e-3, fmi3True, &flag, &flag2, &flag2, &moment));
    if (N_X && !ADAPTIVE) { /* a method that chooses its steps arrives */
        calls++;
        expect(fmi3DoStep(one, 2e-3, step_of_ages, fmi3True, &flag, &flag2, &flag2, &moment) == fmi3Discard,
               "not discarded", "check_states", 0, 0);
        expect(same(moment, 2e-3), "a wrong last successful time", "check_states", 0, 0);
    }
    LEGAL(fmi3SetFMUState(one, kept));
    LEGAL(fmi3DeserializeFMUState(other, bytes, size, &read));
    LEGAL(fmi3SetFMUState(other, read)); /* straight into the phase after a step */
    LEGAL(fmi3GetFloat64(other, all, N_VALUES + 1, after, N_VALUES + 1));
    for (int i = 0; i <= N_VALUES; i++)
        expect(same(before[i], after[i]), "a value is not restored", "fmi3SetFMUState", STEP, i);
    LEGAL(fmi3DoStep(other, 1e-3, 1e-3, fmi3True, &flag, &flag2, &flag2, &moment));
    LEGAL(fmi3Reset(other));
    LEGAL(fmi3FreeFMUState(other, &read));
    /* a state of co-simulation has no place in model exchange */
    calls++;
    fmi3Status status = fmi3DeserializeFMUState(exchange, bytes, size, &read);
    if (status == fmi3OK) status = fmi3SetFMUState(exchange, read);
    expect(status == fmi3Error, "a state of the other interface is accepted", "fmi3DeserializeFMUState", EVENT, status);
    fmi3FreeFMUState(exchange, &read);
    /* every byte damaged in turn: an error, or a state in which the instance still works */
    for (size_t i = 0; i < size; i++) {
        memcpy(damaged, bytes, size);
        damaged[i] = (fmi3Byte)~damaged[i];
        calls++;
        status = fmi3DeserializeFMUState(other, damaged, size, &read);
        expect(status == fmi3OK || (status == fmi3Error && !read), "damaged bytes", "fmi3DeserializeFMUState", INST,
               status);
        if (status != fmi3OK) continue;
        fmi3SetFMUState(other, read);
        fmi3DoStep(other, 0.0, 1e-3, fmi3True, &flag, &flag2, &flag2, &moment);
        fmi3GetFloat64(other, all, N_VALUES + 1, after, N_VALUES + 1);
        calls += 3;
        LEGAL(fmi3Reset(other)); /* no state may bar this */
        LEGAL(fmi3FreeFMUState(other, &read));
    }
    memset(damaged, 0xFF, size);
    memcpy(damaged, MODEL_GUID, sizeof MODEL_GUID); /* all values NaN, no phase */
    calls++;
    expect(fmi3DeserializeFMUState(other, damaged, size, &read) == fmi3Error, "a state of ones is accepted",
           "fmi3DeserializeFMUState", INST, 0);
    fmi3FreeFMUState(other, &read);
    LEGAL(fmi3FreeFMUState(one, &kept));
    fmi3FreeInstance(one);
    fmi3FreeInstance(other);
    fmi3FreeInstance(exchange);
}

/* What can be set in a new instance. */
static void observe_start(fmi3Instance c, double seen[]) { observe(c, seen); }

static int reset(fmi3Instance c) { return fmi3Reset(c); }

static void free_instance(fmi3Instance c) { fmi3FreeInstance(c); }

#define ERROR fmi3Error
#define CO_SIMULATION fmi3CoSimulation
#define MODEL_EXCHANGE fmi3ModelExchange
#define SCHEME ""
#include "native_host_files.h"

static void check_resources(void) {
    static const Place places[] = {{"", "/good", 1},        {"", "/good/", 1},
                                   {"", "/a b", 1},         {"", "/a%20b", 0},
                                   {"", "/%zz", 1},         {"", "/%25zz", 0},
                                   {"", "/50%", 1},         {"", "/\xc3\xbc", 1},
                                   {"", "/nowhere", 0},     {"", "/good/start_values.txt", 0},
                                   {"file://", "/good", 0}, {"", "/%n%s%d", 0}};
    static const char *const none[] = {"", "file:///", "/", "//", "%", "%s%n"};
    try_places(places, sizeof places / sizeof *places);
    try_no_places(none, sizeof none / sizeof *none);
}

static void check_instantiation(void) {
    calls += 9;
    expect(!fmi3InstantiateModelExchange(NULL, MODEL_GUID, good, 0, 0, &calls, logger), "no name", "instantiate", 0, 0);
    expect(!fmi3InstantiateModelExchange("", MODEL_GUID, good, 0, 0, &calls, logger), "an empty name", "instantiate", 0,
           0);
    expect(!fmi3InstantiateModelExchange("one", NULL, good, 0, 0, &calls, logger), "no token", "instantiate", 0, 0);
    expect(!fmi3InstantiateModelExchange("one", "", good, 0, 0, &calls, NULL), "an empty token", "instantiate", 0, 0);
    expect(!fmi3InstantiateModelExchange("one", MODEL_GUID "x", good, 0, 0, &calls, logger), "another token",
           "instantiate", 0, 0);
    expect(!fmi3InstantiateModelExchange("one", MODEL_GUID, NULL, 0, 0, &calls, logger), "no resources", "instantiate",
           0, 0);
    expect(!fmi3InstantiateCoSimulation("one", MODEL_GUID, good, 0, 0, fmi3True, 0, NULL, 0, &calls, logger, NULL),
           "event mode", "instantiate", 0, 0);
    expect(!fmi3InstantiateCoSimulation("one", MODEL_GUID, good, 0, 0, fmi3True, 0, NULL, 0, NULL, NULL, NULL),
           "event mode", "instantiate", 0, 0);
    expect(!fmi3InstantiateScheduledExecution("one", MODEL_GUID, good, 0, 0, &calls, logger, NULL, NULL, NULL),
           "scheduled", "instantiate", 0, 0);
    fmi3Instance c = fmi3InstantiateModelExchange("one", MODEL_GUID, good, 0, 0, NULL, NULL); /* without a logger */
    calls += 2;
    expect(c && fmi3SetTime(c, 0.0) == fmi3Error, "no instance without a logger", "instantiate", 0, 0);
    fmi3FreeInstance(c);
}

/* Inputs asked for inside a step: answered, answered wrongly, and not answered. */
static fmi3Instance updated;
static double answer, last_asked;
static long asked;

static void update(fmi3InstanceEnvironment environment, fmi3Float64 time, fmi3Boolean set, fmi3Boolean get,
                   fmi3Boolean finished, fmi3Boolean can_return, fmi3Boolean *early, fmi3Float64 *early_time) {
    (void)get, (void)finished;
    expect(environment == &calls && set && !can_return && early && early_time, "wrong arguments", "intermediateUpdate",
           STEP, 0);
    expect(ADAPTIVE || N_EVENTS ? time > 0.0 && time <= 5e-3 : time > last_asked, "time does not advance",
           "intermediateUpdate", STEP, 0);
    last_asked = time;
    asked++;
    *early = fmi3True; /* not allowed, so it has no effect */
    *early_time = -1.0;
    fmi3SetFloat64(updated, input, 1, &answer, 1);
    calls++;
}

static void check_intermediate_update(void) {
    static const double answers[] = {0.0, 0.25, NAN, INFINITY, 1e308, -1e308};
    for (size_t i = 0; N_U && i < sizeof answers / sizeof *answers; i++) {
        updated = fmi3InstantiateCoSimulation("one", MODEL_GUID, good, 0, 0, fmi3False, fmi3True, input, 1, &calls,
                                              logger, update);
        calls++;
        LEGAL(fmi3EnterInitializationMode(updated, fmi3False, 0.0, 0.0, fmi3False, 0.0));
        LEGAL(fmi3ExitInitializationMode(updated));
        answer = answers[i];
        last_asked = 0.0;
        asked = 0;
        fmi3Status status = fmi3DoStep(updated, 0.0, 5e-3, fmi3True, &flag, &flag2, &flag2, &moment);
        calls++;
        expect(status == fmi3OK || (i > 1 && status == fmi3Discard), "a step with intermediate inputs", "fmi3DoStep",
               STEP, status);
        expect(asked >= 1 && ((ADAPTIVE && status != fmi3OK) || fabs(last_asked - 5e-3) < 1e-12),
               "the inputs at the end of the step are not asked for", "fmi3DoStep", STEP, (int)asked);
        LEGAL(fmi3GetFloat64(updated, input, 1, values, 1));
        expect(isfinite(values[0]), "an input is not finite", "fmi3DoStep", STEP, 0);
        LEGAL(fmi3Reset(updated));
        fmi3FreeInstance(updated);
    }
}

int main(int argc, char *argv[]) {
    if (argc != 2 || strlen(argv[1]) >= sizeof folder) return 2;
    strcpy(folder, argv[1]);
    snprintf(good, sizeof good, "%s/good", folder);
    not_a_number[0] = not_a_number[1] = NAN;
    infinite[0] = infinite[1] = -INFINITY;
    all = malloc((N_VALUES + 1) * sizeof *all);
    values = calloc(N_VALUES + 1, sizeof *values);
    seeds = malloc(N_VALUES * sizeof *seeds);
    computed = malloc((N_Y + N_X) * sizeof *computed);
    sensitivities = malloc((N_Y + N_X) * sizeof *sensitivities);
    x = calloc(N_X, sizeof *x); /* no element for a model without states */
    bad_x = calloc(N_X + 1, sizeof *bad_x);
    for (unsigned i = 0; i <= N_VALUES; i++) all[i] = i;
    if (N_X > 0) state_variable[0] = N_PU + (unsigned)model_state_outputs[0];
    for (unsigned i = 0; i + 1 < N_Y && model_output_states[output[0] - N_PU] >= 0; i++)
        output[0]++; /* one that is not a state */
    for (unsigned i = 0; i < N_P; i++)
        if (!model_tunable[i]) fixed[0] = i; /* all models have one, and the first parameter is tunable */
    for (unsigned i = 0; i < N_Y + N_X; i++) computed[i] = N_PU + i;
    for (int i = 0; i < N_VALUES; i++) seeds[i] = 0.5;
    bad_x[N_X ? N_X - 1 : 0] = NAN;
    fmi3Instance c = at(INST, fmi3CoSimulation, "one");
    LEGAL(fmi3GetFMUState(c, &state));
    LEGAL(fmi3SerializedFMUStateSize(c, state, &size));
    bytes = malloc(size);
    damaged = malloc(size);
    LEGAL(fmi3SerializeFMUState(c, state, bytes, size));

    walk_without_instance();
    walk_systematically(fmi3CoSimulation);
    walk_systematically(fmi3ModelExchange);
    walk_at_random(fmi3CoSimulation, 4000);
    walk_at_random(fmi3ModelExchange, 4000);
    check_states();
    check_initial_states();
    check_start_values();
    check_resources();
    check_instantiation();
    check_intermediate_update();

    LEGAL(fmi3FreeFMUState(c, &state));
    fmi3FreeInstance(c);
    free(all), free(values), free(seeds), free(computed), free(sensitivities), free(x), free(bad_x), free(bytes),
        free(damaged);
    printf("%ld calls, %ld messages, %ld not as expected\n", calls, messages, failures);
    return failures != 0;
}
