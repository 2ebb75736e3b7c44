/* Components in model exchange, whose equations are coupled: their continuous states are integrated together, and inside
 * each stage of the method the outputs of one reach the inputs of the others. model_exchange.py lays the structs out once
 * more. */
#ifndef MODEL_EXCHANGE_H
#define MODEL_EXCHANGE_H

#include "loop.h"

/* Functions of FMI that are called here; their names are in model_exchange.py, in this order. */
typedef enum {
    SET_TIME,
    SET_STATES,
    GET_STATES,
    GET_DERIVATIVES,
    GET_NOMINALS,
    GET_INDICATORS,
    COMPLETED_STEP,
    ENTER_EVENT_MODE,
    UPDATE_DISCRETE_STATES,
    ENTER_CONTINUOUS_TIME_MODE,
    N_FUNCTIONS_OF_FMI
} FunctionOfFmi;

typedef enum { INITIALIZATION, EVENT_MODE, CONTINUOUS_TIME_MODE } Mode;

typedef enum { RK4, DOPRI5, CVODE } Method;

typedef struct {
    void *instance;
    void *functions[N_FUNCTIONS_OF_FMI];
    uint32_t codes[N_FUNCTIONS_OF_FMI]; /* of their calls */
    Operation told; /* what the loop is told of where one of them warns */
    double next_event; /* time of the next event that it has announced; infinite for none */
    int32_t version, mode;
    int32_t n_states, n_indicators, first_state, first_indicator;
    int32_t needs_completed_step; /* wants to know of each finished step */
    int32_t is_fed; /* from outside of the group: something may jump */
} ContinuousComponent;

/* Inputs that may be set in event mode only, in place of an instance where the loop sets them. */
typedef struct {
    ContinuousComponent *component;
    void *function, *last; /* what they were set to */
    size_t size; /* of that in bytes */
    int32_t known, padding;
} DiscreteInputs;

/* Extrapolated inputs from outside of the group: where an exchange inside a step wants them, or NONE. */
typedef struct {
    const Operation *operation;
    const int32_t *targets;
} OutsideInputs;

/* An exchange among the components of the group alone, on values of its own. */
typedef struct {
    Loop loop;
    const Operation *again; /* of at_point, what may change while the time does not */
    const uint32_t *codes_again;
    int64_t n_again;
    const OutsideInputs *inputs;
    const int32_t
        *copied; /* positions here of values that come from outside of the group, and after them those there */
    int64_t n_values;
    int32_t n_inputs, n_copied;
} GroupExchange;

typedef struct {
    ContinuousComponent *const *components;
    GroupExchange stage, event; /* in continuous-time mode, and in event mode */
    double *states, *next, *trial, *rates, *nominals; /* rates: 7 rows, of stages */
    double *indicators, *later, *tried;
    /* of CVode: its memory, vectors on `next`, on `trial` and on errors that are allowed, and its functions */
    void *cvode_memory, *cvode_states, *cvode_within, *cvode_errors;
    void *cvode_step, *cvode_begin, *cvode_allow, *cvode_stop, *cvode_look, *cvode_values;
    double *allowed; /* errors of CVode */
    double *values_before; /* as many as the system has, to see what an event changes */
    double tolerance, proposed,
        last_error; /* of the adaptive method: its next step (s), and its last error over what is allowed */
    double last_event; /* time of the last one */
    double time; /* that the components have */
    double exchanged_at; /* time of the last exchange in a stage */
    double ended_at;
    int64_t n_steps, n_rejected, n_events;
    int64_t first_again, n_again; /* operations at a communication point that an event has performed again */
    int32_t method, steps; /* steps of a fixed method in a communication step */
    int32_t n_components, n_states, n_indicators;
    int32_t exchanges_at_end; /* whether inputs are wanted at the end of a step too */
    int32_t exchanges_at_start; /* and at the start of a communication step */
    int32_t is_exchanged; /* whether inputs belong to the time and the states that the components have */
    int32_t rates_known, indicators_known, states_known;
    int32_t ended_by; /* component that ended the simulation, or NONE */
    int32_t begins; /* CVode begins anew */
    int32_t at_once; /* events that have followed each other without time passing */
    /* how it failed: a function of a component, or else an operation of an exchange */
    int32_t failed_component, failed_function, failed_exchange, status;
    int64_t failed_operation;
    double failed_at;
} Group;

/* Exchanges in which an operation failed. */
enum { IN_STAGE = 1, IN_STAGE_AGAIN, IN_EVENT, AT_POINT };

/* Statuses beyond those of the loop. */
enum { ENDLESS_UPDATES = 120, ENDLESS_EVENTS, STEP_TOO_SHORT, STATES_NOT_FINITE, CVODE_FAILED };

/* Functions of GROUP operations, in the thread of Python: before and after the exchange at a communication point, and from it to the next one. */
EXPORT int group_begin(const Loop *loop, const Operation *op, int64_t point, double time);
EXPORT int group_finish(const Loop *loop, const Operation *op, int64_t point, double time);
EXPORT int group_advance(const Loop *loop, const Operation *op, int64_t point, double time);

/* Right-hand side for CVode. */
EXPORT int group_rates(double time, void *states, void *rates, void *group);

/* In place of an FMU's function: set inputs in event mode, which the component enters if they change. */
EXPORT int set_discrete_fmi2(void *inputs, const uint32_t *references, size_t n_references, const void *values);
EXPORT int set_discrete_fmi3(void *inputs, const uint32_t *references, size_t n_references, const void *values,
                             size_t n);

#endif
