/* A host that walks every function of FMI 2.0 in every state, with arguments good and bad.
 *
 * Usage: host FOLDER, where good/, broken/, "a b"/, "ü"/, %zz/ and 50%/ each hold an intact start_values.txt.
 * The program must be linked with the sources of an FMU.
 * Prints what was not as expected, then the number of calls; the exit code is 0 if all was. */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#include "model.h"

enum { N_PU = N_P + N_U, N_VALUES = N_PU + N_Y + N_X };
/* SET_UP is after fmi2SetupExperiment, DISC after a discarded step, FAIL after an error. */
enum { NEW = 1, INIT = 2, STEP = 4, EVENT = 8, CONT = 16, TERM = 32, DISC = 64, FAIL = 128, SET_UP = 256, NOTHING = 0 };
enum { INST = NEW | SET_UP };
enum { RUN = STEP | EVENT | CONT, OVER = TERM | DISC | FAIL, ANY = INST | INIT | RUN | OVER, SAME = 0 };

static const int phases[] = {NEW, SET_UP, INIT, STEP, EVENT, CONT, TERM, DISC, FAIL};
static int phase_now; /* of the instance that is called */

#include "native_host.h"

static void logger(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                   fmi2String format, ...) {
    va_list arguments;
    va_start(arguments, format);
    int length = vsnprintf(last_message, sizeof last_message, format, arguments);
    va_end(arguments);
    messages++;
    expect(length > 0, "an empty message", "logger", 0, status);
    expect(percent_allowed || !strchr(last_message, '%'), "an unexpanded percent sign", "logger", 0, status);
    for (const char *c = last_message; *c; c++)
        expect((*c >= ' ' && *c <= '~') || (foreign_allowed && *c < 0), "a character that is not a text", "logger", 0,
               status);
    expect(environment == &calls, "another environment", "logger", 0, status);
    expect(name && (!strcmp(name, "one") || !strcmp(name, "other") || !*name || !strcmp(name, "?")), "another name",
           "logger", 0, status);
    expect((status == fmi2Error && !strcmp(category, "logStatusError")) ||
               (status == fmi2Discard && !strcmp(category, "logStatusDiscard")) ||
               (status == fmi2Warning && !strcmp(category, "logStatusWarning")),
           "a wrong category", "logger", 0, status);
}

static const fmi2CallbackFunctions callbacks = {logger, calloc, free, NULL, &calls};

static char folder[2048], good[4096];

static fmi2Component instantiate(fmi2Type type, const char *name, const char *resources) {
    calls++;
    return fmi2Instantiate(name, type, MODEL_GUID, resources, &callbacks, fmi2False, fmi2True);
}

static void legal(fmi2Status status, const char *what) {
    calls++;
    expect(status == fmi2OK, "the legal path is barred", what, 0, status);
}

#define LEGAL(call) legal(call, #call)

/* A new instance in a phase, by the legal path. */
static fmi2Component at(int phase, fmi2Type type, const char *name) {
    fmi2EventInfo info;
    fmi2Component c = instantiate(type, name, good);
    if (!c) {
        expect(0, "no instance", "at", phase, 0);
        exit(1);
    }
    if (phase & NEW) return c;
    LEGAL(fmi2SetupExperiment(c, fmi2False, 0.0, 0.0, fmi2False, 0.0));
    if (phase == SET_UP) return c;
    LEGAL(fmi2EnterInitializationMode(c));
    if (phase == INIT) return c;
    LEGAL(fmi2ExitInitializationMode(c));
    if (phase == CONT) {
        LEGAL(fmi2NewDiscreteStates(c, &info));
        LEGAL(fmi2EnterContinuousTimeMode(c));
    }
    if (phase == TERM) LEGAL(fmi2Terminate(c));
    if (phase == DISC) expect(fmi2DoStep(c, 0.0, 1e300, fmi2True) == fmi2Discard, "not discarded", "at", phase, 0);
    if (phase == FAIL) expect(fmi2Terminate(c) == fmi2OK && fmi2Terminate(c) == fmi2Error, "no error", "at", phase, 0);
    return c;
}

/* Arguments; heap blocks of exact sizes show what reads or writes beyond them. */
static fmi2ValueReference *all, parameter[] = {0}, fixed[] = {0}, input[] = {N_P}, output[] = {N_PU},
                                state_variable[] = {N_PU}, derivative[] = {N_PU + N_Y}, timing[] = {N_VALUES};
static fmi2ValueReference beyond[] = {N_VALUES + 1 + N_EVENTS}, huge[] = {0xFFFFFFFFu}, mixed[] = {0, 0xFFFFFFFFu};
static double *x, *bad_x, *values, *seeds, *sensitivities, one_value[] = {0.25}, not_a_number[2], infinite[2],
                                                           two[2] = {1.0, 1.0};
static fmi2ValueReference *computed; /* outputs and derivatives */
static int order1[] = {1}, order3[] = {3}, order4[] = {4}, integers[1];
static const char *strings[] = {"text"};
static char *bytes, *damaged;
static size_t size;
static fmi2FMUstate state; /* of an instance in the phase of the test */
static fmi2Boolean flag, flag2;
static fmi2Status status_value;
static fmi2EventInfo event_info;
static const double step_of_ages = 1e300;
static double *starts; /* of parameters and inputs */

/* Sets an output that is not a state, where there is one. */
static fmi2Status set_output(fmi2Component c) {
    if (model_output_states[output[0] - N_PU] >= 0) return fmi2Error;
    return fmi2SetReal(c, output, 1, one_value);
}

/* Sets a state to what it is; before the initialisation that is a guess, which is warned of. */
static fmi2Status set_state(fmi2Component c) {
    double value[1] = {model_guesses[0]};
    if (!(phase_now & INST) && fmi2GetReal(c, state_variable, 1, value) != fmi2OK) return fmi2Error;
    fmi2Status status = fmi2SetReal(c, state_variable, 1, value);
    if (status != fmi2Warning) return status;
    messages--;
    return fmi2OK;
}

static fmi2Status keep_and_restore(fmi2Component c) {
    fmi2FMUstate kept = NULL;
    fmi2Status status = fmi2GetFMUstate(c, &kept);
    if (status == fmi2OK) status = fmi2GetFMUstate(c, &kept); /* again, into the same place */
    if (status == fmi2OK) status = fmi2SetFMUstate(c, kept);
    if (status == fmi2OK) status = fmi2FreeFMUstate(c, &kept);
    return kept ? fmi2Fatal : status;
}

static fmi2Status write_and_read(fmi2Component c, size_t length, int damage) {
    fmi2FMUstate kept = NULL, read = NULL;
    fmi2Status status = fmi2GetFMUstate(c, &kept);
    if (status != fmi2OK) return fmi2Fatal;
    if (fmi2SerializeFMUstate(c, kept, bytes, size) != fmi2OK) return fmi2Fatal;
    char *part = malloc(length);
    memcpy(part, bytes, length < size ? length : size);
    if (damage >= 0) part[damage] = (char)(part[damage] ^ 0x15);
    status = fmi2DeSerializeFMUstate(c, part, length, &read);
    if (status == fmi2OK && fmi2SetFMUstate(c, read) != fmi2OK) status = fmi2Fatal;
    if (status != fmi2OK && read) status = fmi2Fatal; /* an error must make no state */
    free(part);
    fmi2FreeFMUstate(c, &read);
    fmi2FreeFMUstate(c, &kept);
    return status;
}

/* Samplers go by the time of the instance: no step begins elsewhere. */
static double now(fmi2Component c) {
    double time = 0.0;
    fmi2GetRealStatus(c, fmi2LastSuccessfulTime, &time);
    return time;
}

/* Phases where the call is allowed, its status there, the phase after it, whether this model can make it, the call. */
#define CASES(X) \
    X(ANY, fmi2OK, SAME, 1, fmi2SetDebugLogging(c, fmi2True, 0, NULL)) \
    X(ANY, fmi2OK, SAME, 1, fmi2SetDebugLogging(c, fmi2False, 1, strings)) \
    X(INST, fmi2OK, SET_UP, 1, fmi2SetupExperiment(c, fmi2True, 1e-6, 0.0, fmi2True, 1e301)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2SetupExperiment(c, fmi2False, 0.0, 0.0, fmi2True, NAN)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2SetupExperiment(c, fmi2False, 0.0, NAN, fmi2False, 0.0)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2SetupExperiment(c, fmi2False, 0.0, -INFINITY, fmi2False, 0.0)) \
    X(SET_UP, fmi2OK, INIT, 1, fmi2EnterInitializationMode(c)) \
    X(INIT, fmi2OK, RUN, 1, fmi2ExitInitializationMode(c)) \
    X(RUN | DISC, fmi2OK, TERM, 1, fmi2Terminate(c)) \
    X(ANY, fmi2OK, NEW, 1, fmi2Reset(c)) \
    X(INIT | RUN | OVER, fmi2OK, SAME, 1, fmi2GetReal(c, all, N_VALUES + 1, values)) \
    X(INIT | RUN | OVER, fmi2OK, SAME, 1, fmi2GetReal(c, NULL, 0, NULL)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2GetReal(c, NULL, 1, values)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2GetReal(c, parameter, 1, NULL)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2GetReal(c, beyond, 1, values)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2GetReal(c, mixed, 2, values)) \
    X(INST | INIT | STEP | EVENT, fmi2OK, SAME, 1, fmi2SetReal(c, parameter, 1, starts + parameter[0])) \
    X(INST | INIT, fmi2OK, SAME, 1, fmi2SetReal(c, fixed, 1, starts + fixed[0])) \
    X(INST | INIT | RUN, fmi2OK, SAME, N_U, fmi2SetReal(c, input, 1, one_value)) \
    X(INST | INIT | RUN, fmi2OK, SAME, 1, fmi2SetReal(c, NULL, 0, NULL)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2SetReal(c, NULL, 1, one_value)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2SetReal(c, parameter, 1, NULL)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2SetReal(c, parameter, 1, not_a_number)) \
    X(NOTHING, fmi2Error, SAME, N_U, fmi2SetReal(c, input, 1, infinite)) \
    X(NOTHING, fmi2Error, SAME, 1, set_output(c)) \
    X(INST | EVENT | CONT, fmi2OK, SAME, N_X, set_state(c)) \
    X(NOTHING, fmi2Error, SAME, N_X, fmi2SetReal(c, derivative, 1, one_value)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2SetReal(c, timing, 1, one_value)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2SetReal(c, huge, 1, one_value)) \
    X(INIT | RUN | OVER, fmi2OK, SAME, 1, fmi2GetInteger(c, NULL, 0, NULL)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2GetInteger(c, parameter, 1, integers)) \
    X(INST | INIT | RUN, fmi2OK, SAME, 1, fmi2SetInteger(c, NULL, 0, NULL)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2SetInteger(c, huge, 1, integers)) \
    X(INIT | RUN | OVER, fmi2OK, SAME, 1, fmi2GetBoolean(c, NULL, 0, NULL)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2GetBoolean(c, parameter, 1, integers)) \
    X(INST | INIT | RUN, fmi2OK, SAME, 1, fmi2SetBoolean(c, NULL, 0, NULL)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2SetBoolean(c, NULL, 1, NULL)) \
    X(INIT | RUN | OVER, fmi2OK, SAME, 1, fmi2GetString(c, NULL, 0, NULL)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2GetString(c, parameter, 1, strings)) \
    X(INST | INIT | RUN, fmi2OK, SAME, 1, fmi2SetString(c, NULL, 0, NULL)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2SetString(c, parameter, 1, strings)) \
    X(INIT | STEP, fmi2OK, SAME, N_U, fmi2SetRealInputDerivatives(c, input, 1, order1, one_value)) \
    X(INIT | STEP, fmi2OK, SAME, 1, fmi2SetRealInputDerivatives(c, NULL, 0, NULL, NULL)) \
    X(INIT | STEP, fmi2OK, SAME, N_U, fmi2SetRealInputDerivatives(c, input, 1, order3, one_value)) \
    X(NOTHING, fmi2Error, SAME, N_U, fmi2SetRealInputDerivatives(c, input, 1, order4, one_value)) \
    X(NOTHING, fmi2Error, SAME, N_U, fmi2SetRealInputDerivatives(c, input, 1, order1, not_a_number)) \
    X(NOTHING, fmi2Error, SAME, N_U, fmi2SetRealInputDerivatives(c, input, 1, order1, infinite)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2SetRealInputDerivatives(c, parameter, 1, order1, one_value)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2SetRealInputDerivatives(c, output, 1, order1, one_value)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2SetRealInputDerivatives(c, huge, 1, order1, one_value)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2SetRealInputDerivatives(c, NULL, 1, order1, one_value)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2SetRealInputDerivatives(c, input, 1, NULL, one_value)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2SetRealInputDerivatives(c, input, 1, order1, NULL)) \
    X(STEP | OVER, fmi2OK, SAME, 1, fmi2GetRealOutputDerivatives(c, output, 1, order1, values)) \
    X(STEP | OVER, fmi2OK, SAME, 1, fmi2GetRealOutputDerivatives(c, NULL, 0, NULL, NULL)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2GetRealOutputDerivatives(c, output, 1, order3, values)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2GetRealOutputDerivatives(c, parameter, 1, order1, values)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2GetRealOutputDerivatives(c, output, 1, NULL, values)) \
    X(INIT | RUN | OVER, fmi2OK, SAME, 1, \
      fmi2GetDirectionalDerivative(c, computed, N_Y + N_X, all, N_VALUES, seeds, sensitivities)) \
    X(INIT | RUN | OVER, fmi2OK, SAME, 1, fmi2GetDirectionalDerivative(c, NULL, 0, NULL, 0, NULL, NULL)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2GetDirectionalDerivative(c, output, 1, parameter, 1, infinite, sensitivities)) \
    X(NOTHING, fmi2Error, SAME, 1, \
      fmi2GetDirectionalDerivative(c, parameter, 1, parameter, 1, one_value, sensitivities)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2GetDirectionalDerivative(c, timing, 1, parameter, 1, one_value, sensitivities)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2GetDirectionalDerivative(c, huge, 1, parameter, 1, one_value, sensitivities)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2GetDirectionalDerivative(c, output, 1, mixed, 2, two, sensitivities)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2GetDirectionalDerivative(c, NULL, 1, parameter, 1, one_value, sensitivities)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2GetDirectionalDerivative(c, output, 1, NULL, 1, one_value, sensitivities)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2GetDirectionalDerivative(c, output, 1, parameter, 1, NULL, sensitivities)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2GetDirectionalDerivative(c, output, 1, parameter, 1, one_value, NULL)) \
    X(ANY, fmi2OK, SAME, 1, keep_and_restore(c)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2GetFMUstate(c, NULL)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2SetFMUstate(c, NULL)) \
    X(ANY, fmi2OK, SAME, 1, fmi2FreeFMUstate(c, NULL)) \
    X(ANY, fmi2OK, SAME, 1, fmi2SerializedFMUstateSize(c, state, &size)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2SerializedFMUstateSize(c, NULL, &size)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2SerializedFMUstateSize(c, state, NULL)) \
    X(ANY, fmi2OK, SAME, 1, fmi2SerializeFMUstate(c, state, bytes, size)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2SerializeFMUstate(c, state, bytes, size - 1)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2SerializeFMUstate(c, state, NULL, size)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2SerializeFMUstate(c, NULL, bytes, size)) \
    X(ANY, fmi2OK, SAME, 1, write_and_read(c, size, -1)) \
    X(NOTHING, fmi2Error, SAME, 1, write_and_read(c, size - 1, -1)) \
    X(NOTHING, fmi2Error, SAME, 1, write_and_read(c, size + 1, -1)) \
    X(NOTHING, fmi2Error, SAME, 1, write_and_read(c, 1, -1)) \
    X(NOTHING, fmi2Error, SAME, 1, write_and_read(c, 0, -1)) \
    X(NOTHING, fmi2Error, SAME, 1, write_and_read(c, size, 0)) \
    X(NOTHING, fmi2Error, SAME, 1, write_and_read(c, size, (int)sizeof MODEL_GUID - 1)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2DeSerializeFMUstate(c, NULL, size, &state)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2DeSerializeFMUstate(c, bytes, size, NULL)) \
    X(STEP, fmi2OK, SAME, 1, fmi2DoStep(c, now(c), 1e-3, fmi2True)) \
    X(STEP, fmi2Discard, DISC, N_X && !ADAPTIVE, fmi2DoStep(c, now(c), step_of_ages, fmi2True)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2DoStep(c, now(c) + 0.5, 1e-3, fmi2True)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2DoStep(c, 0.0, 0.0, fmi2True)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2DoStep(c, 0.0, -1e-3, fmi2False)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2DoStep(c, 0.0, NAN, fmi2False)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2DoStep(c, INFINITY, 1e-3, fmi2False)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2DoStep(c, 1.7e308, 1.7e308, fmi2False)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2CancelStep(c)) \
    X(ANY, fmi2Discard, SAME, 1, fmi2GetStatus(c, fmi2DoStepStatus, &status_value)) \
    X(ANY, fmi2OK, SAME, 1, fmi2GetRealStatus(c, fmi2LastSuccessfulTime, values)) \
    X(ANY, fmi2Discard, SAME, 1, fmi2GetRealStatus(c, fmi2DoStepStatus, values)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2GetRealStatus(c, fmi2LastSuccessfulTime, NULL)) \
    X(ANY, fmi2Discard, SAME, 1, fmi2GetIntegerStatus(c, fmi2DoStepStatus, integers)) \
    X(ANY, fmi2OK, SAME, 1, fmi2GetBooleanStatus(c, fmi2Terminated, &flag)) \
    X(ANY, fmi2Discard, SAME, 1, fmi2GetBooleanStatus(c, fmi2PendingStatus, &flag)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2GetBooleanStatus(c, fmi2Terminated, NULL)) \
    X(ANY, fmi2Discard, SAME, 1, fmi2GetStringStatus(c, fmi2PendingStatus, strings)) \
    X(EVENT | CONT, fmi2OK, EVENT, 1, fmi2EnterEventMode(c)) \
    X(EVENT, fmi2OK, SAME, 1, fmi2NewDiscreteStates(c, &event_info)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2NewDiscreteStates(c, NULL)) \
    X(EVENT, fmi2OK, CONT, 1, fmi2EnterContinuousTimeMode(c)) \
    X(CONT, fmi2OK, SAME, 1, fmi2CompletedIntegratorStep(c, fmi2True, &flag, &flag2)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2CompletedIntegratorStep(c, fmi2True, NULL, &flag2)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2CompletedIntegratorStep(c, fmi2True, &flag, NULL)) \
    X(EVENT | CONT, fmi2OK, SAME, 1, fmi2SetTime(c, 0.125)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2SetTime(c, NAN)) \
    X(CONT, fmi2OK, SAME, 1, (fmi2GetContinuousStates(c, x, N_X), fmi2SetContinuousStates(c, x, N_X))) \
    X(CONT, fmi2OK, SAME, !N_X, fmi2SetContinuousStates(c, NULL, 0)) \
    X(NOTHING, fmi2Error, SAME, N_X, fmi2SetContinuousStates(c, NULL, N_X)) \
    X(NOTHING, fmi2Error, SAME, N_X, fmi2SetContinuousStates(c, bad_x, N_X)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2SetContinuousStates(c, x, N_X + 1)) \
    X(EVENT | CONT | OVER, fmi2OK, SAME, 1, fmi2GetDerivatives(c, x, N_X)) \
    X(EVENT | CONT | OVER, fmi2OK, SAME, !N_X, fmi2GetDerivatives(c, NULL, 0)) \
    X(NOTHING, fmi2Error, SAME, N_X, fmi2GetDerivatives(c, NULL, N_X)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2GetDerivatives(c, x, (size_t)-1)) \
    X(INIT | EVENT | CONT | OVER, fmi2OK, SAME, 1, fmi2GetEventIndicators(c, values, N_EVENTS)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2GetEventIndicators(c, values, N_EVENTS + 1)) \
    X(INIT | EVENT | CONT | OVER, fmi2OK, SAME, 1, fmi2GetContinuousStates(c, x, N_X)) \
    X(INIT | EVENT | CONT | OVER, fmi2OK, SAME, !N_X, fmi2GetContinuousStates(c, NULL, 0)) \
    X(NOTHING, fmi2Error, SAME, N_X, fmi2GetContinuousStates(c, NULL, N_X)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2GetContinuousStates(c, x, N_X + 1)) \
    X(EVENT | CONT | OVER, fmi2OK, SAME, 1, fmi2GetNominalsOfContinuousStates(c, x, N_X)) \
    X(EVENT | CONT | OVER, fmi2OK, SAME, !N_X, fmi2GetNominalsOfContinuousStates(c, NULL, 0)) \
    X(NOTHING, fmi2Error, SAME, N_X, fmi2GetNominalsOfContinuousStates(c, NULL, N_X)) \
    X(NOTHING, fmi2Error, SAME, 1, fmi2GetNominalsOfContinuousStates(c, x, N_X + 1))

#define LIST(allowed, status, next, possible, call) {allowed, status, next, possible, #call},
static const struct {
    int allowed, status, next, possible;
    const char *text;
} cases[] = {CASES(LIST)};
enum { N_CASES = sizeof cases / sizeof *cases };

static fmi2Status run(int which, fmi2Component c) {
    int i = 0;
#define RUN_IT(allowed, status, next, possible, call) \
    if (which == i++) return call;
    CASES(RUN_IT)
    return fmi2Fatal;
}

/* What can be set, and the time; refused before the initialisation only. */
static void observe(fmi2Component c, double seen[]) {
    for (int i = 0; i <= N_PU; i++) seen[i] = 0.0;
    if (phase_now & INST) return;
    expect(fmi2GetReal(c, all, N_PU, seen) == fmi2OK && fmi2GetReal(c, timing, 1, seen + N_PU) == fmi2OK,
           "values can't be read", "observe", phase_now, 0);
}

/* The same of a new instance, which enters the initialisation mode for it. */
static void observe_start(fmi2Component c, double seen[]) {
    LEGAL(fmi2SetupExperiment(c, fmi2False, 0.0, 0.0, fmi2False, 0.0));
    LEGAL(fmi2EnterInitializationMode(c));
    phase_now = INIT;
    observe(c, seen);
}

/* Make one call, compare its status and what it changed; return the phase after it. */
static int check(int which, fmi2Component c, int phase, fmi2Type type) {
    double before[N_PU + 1], after[N_PU + 1];
    if (!cases[which].possible) return phase;
    phase_now = phase;
    int expected = cases[which].allowed & phase ? cases[which].status : fmi2Error;
    observe(c, before);
    long logged = messages;
    int status = run(which, c);
    calls++;
    expect(status == expected, "an unexpected status", cases[which].text, phase, status);
    if (status == fmi2Error) expect(messages > logged, "an error without a message", cases[which].text, phase, status);
    if (status == fmi2OK && !strchr(cases[which].text, ','))
        expect(messages == logged, "a message without an error", cases[which].text, phase, status);
    if (status != fmi2OK) {
        observe(c, after);
        for (int i = 0; i <= N_PU; i++)
            expect(same(before[i], after[i]), "a refused call has changed a value", cases[which].text, phase, status);
    }
    if (status == fmi2Error) return FAIL;
    int next = cases[which].next;
    return next == SAME ? phase : next == RUN ? (type == fmi2CoSimulation ? STEP : EVENT) : next;
}

static int belongs(int phase, fmi2Type type) {
    /* a method that chooses its steps arrives, and a sampler takes ages until it gives up */
    if (phase == DISC && (!N_X || ADAPTIVE || N_SAMPLED)) return 0;
    return !(phase & (type == fmi2CoSimulation ? EVENT | CONT : STEP | DISC));
}

static void walk_systematically(fmi2Type type) {
    for (size_t k = 0; k < sizeof phases / sizeof *phases; k++)
        for (int i = 0; belongs(phases[k], type) && i < N_CASES; i++) {
            fmi2Component c = at(phases[k], type, "one");
            int phase = check(i, c, phases[k], type);
            if (phase != FAIL ||
                phases[k] & ~(INST | INIT)) /* else nothing has been computed that could be looked at */
                phase = check(i, c, phase, type); /* again, from where that led */
            LEGAL(fmi2Reset(c));
            fmi2FreeInstance(c);
        }
}

/* Two instances by turns, calls drawn at random; each must behave as its own phase says. After most errors a state from before
 * the call is restored. */
static void walk_at_random(fmi2Type type, int n) {
    fmi2Component c[2] = {at(NEW, type, "one"), at(NEW, fmi2CoSimulation, "other")};
    fmi2Type types[2] = {type, fmi2CoSimulation};
    int phase[2] = {NEW, NEW};
    unsigned random = 12345u;
    for (int i = 0; i < n; i++) {
        random = random * 1664525u + 1013904223u;
        int k = (int)(random >> 31), which = (int)((random >> 8) % N_CASES), before = phase[k];
        fmi2FMUstate kept = NULL;
        LEGAL(fmi2GetFMUstate(c[k], &kept));
        phase[k] = check(which, c[k], before, types[k]);
        if (phase[k] & OVER && (before & (INST | INIT) || random % 8)) {
            LEGAL(fmi2SetFMUstate(c[k], kept));
            phase[k] = before;
        }
        LEGAL(fmi2FreeFMUstate(c[k], &kept));
    }
    fmi2FreeInstance(c[0]);
    fmi2FreeInstance(c[1]);
}

static void walk_without_instance(void) {
    for (int i = 0; i < N_CASES; i++) {
        if (strstr(cases[i].text, "_and_re")) continue; /* they need the bytes of a state */
        int status = run(i, NULL);
        calls++;
        expect(status == fmi2Error, "no error without an instance", cases[i].text, 0, status);
    }
    fmi2FreeInstance(NULL);
    expect(!strcmp(fmi2GetVersion(), "2.0") && !strcmp(fmi2GetTypesPlatform(), "default"), "a wrong version",
           "fmi2GetVersion", 0, 0);
}

/* Initial states are there as soon as the initialisation mode is. */
static void check_initial_states(void) {
    double before[N_X + 1], after[N_X + 1], rate_after[N_X + 1];
    fmi2Component c = at(INIT, fmi2ModelExchange, "one");
    LEGAL(fmi2GetContinuousStates(c, before, N_X));
    LEGAL(fmi2ExitInitializationMode(c));
    LEGAL(fmi2GetContinuousStates(c, after, N_X));
    LEGAL(fmi2GetDerivatives(c, rate_after, N_X));
    for (int i = 0; i < N_X; i++)
        expect(same(before[i], after[i]) && isfinite(rate_after[i]), "other initial states", "check_initial_states",
               INIT, i);
    fmi2FreeInstance(c);
}

/* FMU states go from instance to instance; damaged ones must not. */
static void check_states(void) {
    fmi2Component one = at(STEP, fmi2CoSimulation, "one"), other = at(NEW, fmi2CoSimulation, "other"),
                  exchange = at(EVENT, fmi2ModelExchange, "one");
    double before[N_VALUES + 1], after[N_VALUES + 1], last = -1.0;
    fmi2FMUstate kept = NULL, read = NULL;
    LEGAL(fmi2DoStep(one, 0.0, 1e-3, fmi2True));
    LEGAL(fmi2GetReal(one, all, N_VALUES + 1, before));
    LEGAL(fmi2GetFMUstate(one, &kept));
    LEGAL(fmi2SerializeFMUstate(one, kept, bytes, size));
    LEGAL(fmi2DoStep(one, 1e-3, 1e-3, fmi2True));
    if (N_X && !ADAPTIVE) { /* a method that chooses its steps arrives */
        calls++;
        expect(fmi2DoStep(one, 2e-3, step_of_ages, fmi2True) == fmi2Discard, "not discarded", "check_states", 0, 0);
        LEGAL(fmi2GetBooleanStatus(one, fmi2Terminated, &flag));
        expect(flag, "a discarded step does not ask for the end", "check_states", 0, 0);
    }
    LEGAL(fmi2SetFMUstate(one, kept));
    LEGAL(fmi2GetRealStatus(one, fmi2LastSuccessfulTime, &last));
    expect(same(last, 1e-3), "the last successful time is not part of the state", "fmi2SetFMUstate", STEP, 0);
    LEGAL(fmi2GetBooleanStatus(one, fmi2Terminated, &flag));
    expect(!flag, "a discarded step is remembered after rolling back", "fmi2SetFMUstate", STEP, 0);
    LEGAL(fmi2DeSerializeFMUstate(other, bytes, size, &read));
    LEGAL(fmi2SetFMUstate(other, read)); /* straight into the phase after a step */
    LEGAL(fmi2GetReal(other, all, N_VALUES + 1, after));
    for (int i = 0; i <= N_VALUES; i++)
        expect(same(before[i], after[i]), "a value is not restored", "fmi2SetFMUstate", STEP, i);
    LEGAL(fmi2DoStep(other, 1e-3, 1e-3, fmi2True));
    LEGAL(fmi2Reset(other));
    LEGAL(fmi2GetRealStatus(other, fmi2LastSuccessfulTime, &last));
    expect(same(last, 0.0), "the last successful time survives a reset", "fmi2Reset", NEW, 0);
    LEGAL(fmi2FreeFMUstate(other, &read));
    /* a state of co-simulation has no place in model exchange */
    calls++;
    fmi2Status status = fmi2DeSerializeFMUstate(exchange, bytes, size, &read);
    if (status == fmi2OK) status = fmi2SetFMUstate(exchange, read);
    expect(status == fmi2Error, "a state of the other interface is accepted", "fmi2DeSerializeFMUstate", EVENT, status);
    fmi2FreeFMUstate(exchange, &read);
    /* every byte damaged in turn: an error, or a state in which the instance still works */
    for (size_t i = 0; i < size; i++) {
        memcpy(damaged, bytes, size);
        damaged[i] = (char)~damaged[i];
        calls++;
        status = fmi2DeSerializeFMUstate(other, damaged, size, &read);
        expect(status == fmi2OK || (status == fmi2Error && !read), "damaged bytes", "fmi2DeSerializeFMUstate", NEW,
               status);
        if (status != fmi2OK) continue;
        fmi2SetFMUstate(other, read);
        fmi2DoStep(other, 0.0, 1e-3, fmi2True);
        fmi2GetReal(other, all, N_VALUES + 1, after);
        calls += 3;
        LEGAL(fmi2Reset(other)); /* no state may bar this */
        LEGAL(fmi2FreeFMUstate(other, &read));
    }
    memset(damaged, 0xFF, size);
    memcpy(damaged, MODEL_GUID, sizeof MODEL_GUID); /* all values NaN, no phase */
    calls++;
    expect(fmi2DeSerializeFMUstate(other, damaged, size, &read) == fmi2Error, "a state of ones is accepted",
           "fmi2DeSerializeFMUstate", NEW, 0);
    fmi2FreeFMUstate(other, &read);
    LEGAL(fmi2FreeFMUstate(one, &kept));
    fmi2FreeInstance(one);
    fmi2FreeInstance(other);
    fmi2FreeInstance(exchange);
}

static int reset(fmi2Component c) { return fmi2Reset(c); }

static void free_instance(fmi2Component c) { fmi2FreeInstance(c); }

#define ERROR fmi2Error
#define CO_SIMULATION fmi2CoSimulation
#define MODEL_EXCHANGE fmi2ModelExchange
#define SCHEME "file://"
#include "native_host_files.h"

static void check_resources(void) {
    static const Place places[] = {{"", "/good", 1},
                                   {"file:", "/good", 1},
                                   {"file://", "/good", 1},
                                   {"file://localhost", "/good", 1},
                                   {"file://", "/good/", 1},
                                   {"file://", "/%67ood", 1},
                                   {"file://", "/a%20b", 1},
                                   {"file://", "/a b", 1},
                                   {"", "/a b", 1},
                                   {"", "/a%20b", 0},
                                   {"file://", "/%zz", 1},
                                   {"file://", "/%25zz", 1},
                                   {"file://", "/50%", 1},
                                   {"file://", "/50%25", 1},
                                   {"", "/50%", 1},
                                   {"file://", "/%c3%BC", 1},
                                   {"file://", "/\xc3\xbc", 1},
                                   {"", "/\xc3\xbc", 1},
                                   {"file://", "/nowhere", 0},
                                   {"file://", "/good%00/nowhere", 0},
                                   {"file://", "/good/start_values.txt", 0},
                                   {"https://", "/good", 0},
                                   {"file://", "/%", 0},
                                   {"file://", "/%2", 0},
                                   {"file://", "/%n%s%d", 0}};
    static const char *const none[] = {"",  "file:",  "file:/",   "file://", "file:///", "file://host",
                                       "%", "file:%", "file:///%"};
    try_places(places, sizeof places / sizeof *places);
    try_no_places(none, sizeof none / sizeof *none);
}

static void check_instantiation(void) {
    fmi2CallbackFunctions mute = callbacks;
    mute.logger = NULL;
    calls += 8;
    expect(!fmi2Instantiate("one", fmi2CoSimulation, MODEL_GUID, good, NULL, 0, 0), "no callbacks", "fmi2Instantiate",
           0, 0);
    expect(!fmi2Instantiate("one", fmi2CoSimulation, MODEL_GUID, good, &mute, 0, 0), "no logger", "fmi2Instantiate", 0,
           0);
    expect(!fmi2Instantiate(NULL, fmi2CoSimulation, MODEL_GUID, good, &callbacks, 0, 0), "no name", "fmi2Instantiate",
           0, 0);
    expect(!fmi2Instantiate("", fmi2CoSimulation, MODEL_GUID, good, &callbacks, 0, 0), "an empty name",
           "fmi2Instantiate", 0, 0);
    expect(!fmi2Instantiate("one", fmi2CoSimulation, NULL, good, &callbacks, 0, 0), "no GUID", "fmi2Instantiate", 0, 0);
    expect(!fmi2Instantiate("one", fmi2CoSimulation, "", good, &callbacks, 0, 0), "an empty GUID", "fmi2Instantiate", 0,
           0);
    expect(!fmi2Instantiate("one", fmi2CoSimulation, MODEL_GUID "x", good, &callbacks, 0, 0), "another GUID",
           "fmi2Instantiate", 0, 0);
    expect(!fmi2Instantiate("one", fmi2CoSimulation, MODEL_GUID, NULL, &callbacks, 0, 0), "no resources",
           "fmi2Instantiate", 0, 0);
}

int main(int argc, char *argv[]) {
    if (argc != 2 || strlen(argv[1]) >= sizeof folder) return 2;
    strcpy(folder, argv[1]);
    snprintf(good, sizeof good, "file://%s/good", folder);
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
    fmi2Component c = at(NEW, fmi2CoSimulation, "one");
    LEGAL(fmi2GetFMUstate(c, &state));
    LEGAL(fmi2SerializedFMUstateSize(c, state, &size));
    starts = malloc((N_PU + 1) * sizeof *starts);
    fmi2Component other = at(NEW, fmi2CoSimulation, "other");
    observe_start(other, starts);
    fmi2FreeInstance(other);
    bytes = malloc(size);
    damaged = malloc(size);
    LEGAL(fmi2SerializeFMUstate(c, state, bytes, size));

    walk_without_instance();
    walk_systematically(fmi2CoSimulation);
    walk_systematically(fmi2ModelExchange);
    walk_at_random(fmi2CoSimulation, 4000);
    walk_at_random(fmi2ModelExchange, 4000);
    check_states();
    check_initial_states();
    check_start_values();
    check_resources();
    check_instantiation();

    LEGAL(fmi2FreeFMUstate(c, &state));
    fmi2FreeInstance(c);
    free(all), free(values), free(seeds), free(computed), free(sensitivities), free(x), free(bad_x), free(bytes),
        free(damaged), free(starts);
    printf("%ld calls, %ld messages, %ld not as expected\n", calls, messages, failures);
    return failures != 0;
}
