/* What both FMI versions need of an instance; knows no FMI header and no model by name. */
#ifndef CORE_H
#define CORE_H

#include <stddef.h>
#include <stdint.h>
#include "model.h"

#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility push(hidden) /* an FMU exports the functions of the standard only, whoever compiles it */
#endif

/* Values stand in one array: parameters, inputs, the N_Y that are computed (outputs, then locals), state derivatives,
 * and, which are no part of the interface, margins of the requirements and discrete states. The time has the value
 * reference after the derivatives; then come the event indicators. */
enum { N_PU = N_P + N_U, N_VARIABLES = N_P + N_U + N_Y, N_VALUES = N_P + N_U + N_Y + N_X, TIME = N_VALUES };
enum { INDICATORS = TIME + 1 };

/* The numbers of fmi2Status and fmi3Status. */
typedef enum { CORE_OK = 0, CORE_WARNING = 1, CORE_DISCARD = 2, CORE_ERROR = 3 } CoreStatus;

typedef enum {
    INSTANTIATED = 1,
    INITIALIZATION = 2,
    STEP = 4,        /* co-simulation, between two steps */
    EVENT = 8,       /* model exchange */
    CONTINUOUS = 16, /* model exchange */
    TERMINATED = 32,
    DISCARDED = 64, /* FMI 2.0: after a step that was discarded, until a saved state is restored */
    FAILED = 128    /* after an error, until a saved state is restored or the instance reset */
} Phase;

/* Phases in which values can be looked at, but not set. */
enum { OVER = TERMINATED | DISCARDED | FAILED };

enum { OUTPUTS_VALID = 1, RATES_VALID = 2 };

/* Derivatives of inputs are taken up to this order. */
enum { MOST_ORDER = 3 };

/* Parts of an internal step after which a method needs the inputs. */
#ifdef SOLVER_DOPRI5
#define INPUT_TIMES {1.0 / 5, 3.0 / 10, 4.0 / 5, 8.0 / 9, 1.0}
enum { N_INPUT_TIMES = 5 };
#else
#define INPUT_TIMES {0.5, 1.0}
enum { N_INPUT_TIMES = 2 };
#endif

/* The parameters that the export adds: max_step, and for methods that estimate their error rtol. */
enum { MAX_STEP = N_P - 1, RTOL = N_P - 2 };

#if ADAPTIVE
/* What a method that estimates its error keeps from step to step. */
typedef struct {
    double proposed; /* length of the next step, 0 before the first one */
    double size;     /* of the last step, 0 if that is no guide */
    double error;    /* of the last step */
#ifdef SOLVER_RK43
    double passed_over; /* steps since the last one with an estimate */
#endif
} StepControl;
#endif

/* Whether something changes states at once: events, or sampling. */
#define HYBRID (N_EVENTS + N_SAMPLED > 0)

#if HYBRID
/* What decides on the next events, apart from the states. */
typedef struct {
    double count[N_SAMPLED + 1];    /* instants of each sampler that are over */
    double side[N_EVENTS + 1];      /* of zero on which each indicator is, 1 or -1 */
    double indicator[N_EVENTS + 1]; /* where the states have arrived last */
    double late[N_EVENTS + 1];      /* what it is beyond zero where its crossing was located */
    double last[N_EVENTS + 1];      /* when each event has happened */
    double at_once[N_EVENTS + 1];   /* how often without time passing */
    double is_new;                  /* nothing has happened yet, and the indicators have no side */
} Discrete;
#endif

/* All that changes: a copy of it is the FMU state. */
typedef struct {
    double values[N_VALUES + N_STEP_REQUIREMENTS + N_Z + 1]; /* then margins of the requirements, discrete states */
    double x[2][N_X + 1];   /* states, and room for those at the end of a step */
    double u_rate[N_U + 1]; /* first derivatives of the inputs, of the next step only */
    double time;
    int phase;
    int which; /* of the two are the states */
    int valid; /* which computed values belong to the present state and inputs: OUTPUTS_VALID, RATES_VALID */
    int arrived; /* nothing has been set since the last step */
    int degree;  /* highest order of the derivatives of the inputs, 0 for linear or held ones */
    int set_up;  /* FMI 2.0: the importer has said when the experiment starts */
#if ADAPTIVE
    StepControl control;
    double tolerance; /* relative, of the importer, 0 if it gives none */
#endif
#if HYBRID
    int settled;     /* what happens at this communication point has happened, for the present inputs */
    Discrete discrete, before; /* before it happened, as are the next two: with other inputs it may be something else */
    double x_before[N_X + 1], z_before[N_Z + 1];
#endif
    /* last, since linear and held inputs don't touch them: derivatives of higher order, and the inputs and the time where
     * these polynomials begin */
    double u_higher[MOST_ORDER - 1][N_U + 1], u_start[N_U + 1], u_time;
} CoreState;

typedef void CoreLogger(void *environment, CoreStatus status, const char *message);

/* Asks the importer for the inputs at a time inside a step; it answers by setting them. */
typedef void CoreInputRequest(void *environment, double time);

typedef struct {
    CoreState state;
    CoreLogger *logger;
    CoreInputRequest *request_inputs; /* NULL where the importer can't answer */
    void *environment;
    int model_exchange;
    double
        stop; /* no step goes past it, INFINITY if the importer defines none; of the experiment, and so of no saved state */
    int within_step; /* the importer is being asked for inputs */
    int curved; /* the inputs are not linear over the internal step that is being tried, but those below */
    char *resources; /* folder */
#ifdef N_TABLES
    int has_tables; /* it is among the instances that use them */
#endif
#if ADAPTIVE /* of the step that is being tried */
    int violated; /* requirement that forbids the end of the step, -1 for none */
#ifndef SOLVER_RK43
    double stages[7][N_X]; /* of the method; on the stack of a small thread there may be no room */
#else
    double stages[3][N_X + N_STEP_REQUIREMENTS];
#endif
#endif
#ifdef SOLVER_DOPRI5
    double arrival[N_X + N_STEP_REQUIREMENTS + 1]; /* derivatives and margins at its end */
#endif
#ifdef SOLVER_RODAS4
    double jacobian[N_JACOBIAN + 1], factors[N_FACTORS];
#endif
    double u_at[N_INPUT_TIMES][N_U + 1];
} Core;

#define PARAMETERS(core) ((core)->state.values)
#define INPUTS(core) ((core)->state.values + N_P)
#define STATES(core) ((core)->state.x[(core)->state.which])
#define OUTPUTS(core) ((core)->state.values + N_PU)
#define DISCRETE(core) ((core)->state.values + MODEL_Z)
#define RATES(core) ((core)->state.values + N_VARIABLES) /* state derivatives, then margins */

/* Initialise a core, which stands inside its instance, so that all of an instance that a step touches lies together. */
CoreStatus core_init(Core *core, const char *resources, int model_exchange, CoreLogger *logger, void *environment);
void core_close(Core *core);

/* Log a message in printf format and return the status. */
CoreStatus core_fail(Core *core, CoreStatus status, const char *format, ...);

/* Read the start values of all parameters and inputs, which are data beside the code. */
CoreStatus core_read_start_values(Core *core, double values[]);

/* Read a number and nothing after it, whatever decimal point the locale of the importer has; the text is changed. */
int core_read_number(char *text, double *value);

#ifdef N_TABLES
struct Table;
/* Read the table with this number; after a failure it has no data. */
CoreStatus core_read_table(Core *core, int which, struct Table *table);

/* Read the lookup tables, unless other instances have; they stay until the last instance closes them. */
CoreStatus core_open_tables(Core *core);
void core_close_tables(Core *core);
#endif

/* Whether `function` may be called in the current phase; logs when it may not. */
static inline int core_allowed(Core *core, int phases, const char *function) {
    int phase = core->state.phase;
    if (phase & phases) return 1;
    core_fail(core, CORE_ERROR, "%s can't be called %s", function,
              phase == FAILED ? "after an error; restore a saved FMU state, or reset the instance"
              : phase == DISCARDED
                  ? "after a discarded step; restore the FMU state from before the step, or reset the instance"
                  : "in this state; see the state machine of the FMI standard");
    return 0;
}

/* Have the states of the present time and inputs. */
CoreStatus core_have_states(Core *core);

/* Have the derivatives and margins of the present state and inputs. */
void core_have_rates(Core *core);

/* Whether the requirements of a step hold whose margins these are. */
CoreStatus core_check_margins(Core *core, double time, const double margins[], CoreStatus status);

/* Whether all values are finite: v - v is 0 for a finite v, of whichever sign, and else NaN, which has more bits set. */
static inline int core_all_finite(const double v[], size_t n) {
    uint64_t bits = 0;
    for (size_t i = 0; i < n; i++) {
        union {
            double value;
            uint64_t bits;
        } difference = {v[i] - v[i]};
        bits |= difference.bits;
    }
    return bits << 1 == 0;
}

CoreStatus core_reset(Core *core);

/* Begin an experiment at a time, which may have a defined end. */
CoreStatus core_start_at(Core *core, double time, int has_stop, double stop);

/* Take the relative tolerance that an importer gives for a run, which methods of fixed step don't need. */
CoreStatus core_set_tolerance(Core *core, double tolerance);
CoreStatus core_exit_initialization(Core *core);

/* Of n variables by value reference; after a failure none is set. */
CoreStatus core_set(Core *core, const unsigned references[], size_t n, const double values[]);
CoreStatus core_get(Core *core, const unsigned references[], size_t n, double values[]);

/* How the functions of an FMI version have the values of a type in memory. */
typedef enum {
    AS_DOUBLE,
    AS_INT32,
    AS_INT32_OR_ITEM,
    AS_INT64_ITEM,
    AS_INT32_BOOLEAN,
    AS_BOOL,
    AS_TEXT
} Representation;

/* Of n variables of the types that have this representation; `function` asks. */
CoreStatus core_get_as(Core *core, Representation as, const unsigned references[], size_t n, void *values,
                       const char *function);
CoreStatus core_set_as(Core *core, Representation as, const unsigned references[], size_t n, const void *values,
                       const char *function);

#if N_TYPED > 0
enum { TYPE_REAL, TYPE_INTEGER, TYPE_BOOLEAN, TYPE_ENUMERATION, TYPE_STRING }; /* in `model_types` */
/* Whether n variables are of the types that have this representation. */
CoreStatus core_check_types(Core *core, Representation as, const unsigned references[], size_t n, const char *function);
/* Whether a number stands for a value of the variable's type. */
CoreStatus core_check_value(Core *core, size_t reference, double value, CoreStatus status);
/* Read the text of a value that is not a real; 0 if it is none of the type. */
int core_read_value(size_t reference, const char *text, double *value);
#define ARE_REAL(core, references, n) (core_check_types(core, AS_DOUBLE, references, n, __func__) == CORE_OK)
#define IS_REAL(reference) (model_types[reference] == TYPE_REAL)
#else
#define ARE_REAL(core, references, n) 1
#define IS_REAL(reference) 1
#endif

/* Derivatives of inputs by time, of orders from 1 on, which hold over the next step. */
CoreStatus core_set_input_derivatives(Core *core, const unsigned references[], size_t n, const int orders[],
                                      const double values[]);

/* First derivatives of outputs by time; inputs change as their derivatives say that have been set. */
CoreStatus core_get_output_derivatives(Core *core, const unsigned references[], size_t n, double values[]);

/* Whether derivatives of outputs of these orders are provided. */
CoreStatus core_check_output_orders(Core *core, const int orders[], size_t n);

CoreStatus core_do_step(Core *core, double time, double step);

/* Whether inputs are asked for inside a step: of the importer, or of their polynomials. */
static inline int core_inputs_are_asked_for(const Core *core) { return core->request_inputs || core->state.degree > 1; }

/* Have the inputs of a time inside the step. */
void core_ask_for_inputs(Core *core, double time);

/* Ask for the inputs over an internal step of length h to `end_time` that begins with `u`; those at its end stay. `u_rate` becomes their
 * mean rate, and `core->curved` says whether they are linear. */
void core_ask_over(Core *core, double time, double h, double end_time, const double u[], double u_rate[]);

/* Have the inputs of an event after this length of an internal step. */
static inline void core_arrive_with_inputs(Core *core, double time, double to_event, const double u[],
                                           const double u_rate[]) {
    if (core->curved) core_ask_for_inputs(core, time + to_event);
    else if (core_inputs_are_asked_for(core))
        for (int j = 0; j < N_U; j++) INPUTS(core)[j] = u[j] + to_event * u_rate[j];
}

/* One step of length h of the integration method, from `x` at `time`, where the inputs are `u` and change at `u_rate`, or as
 * core_ask_over found, and the state derivatives are `rates`, to `next`. `error`, unless it is NULL, gets the estimated error, at most 1 for a
 * step that may be accepted. */
CoreStatus method_step(Core *core, double time, double h, const double x[], const double u[], const double u_rate[],
                       const double rates[], double next[], double *error);

#if ADAPTIVE
/* From the states at `time` to `next`, in internal steps that the tolerance allows; *length becomes shorter where an event
 * happens. */
CoreStatus core_integrate_adaptive(Core *core, double time, double *length, double next[]);

/* The largest of v, where that is 1 which the tolerance allows for a step from `x` to `next`. */
double core_scaled(const Core *core, const double v[], const double x[], const double next[]);

/* Whether derivatives and margins may be used; and those for a stage of a step. */
int core_usable(Core *core, const double rates[]);
int core_usable_rates(Core *core, double time, const double x[], const double u[], double rates[]);

/* What a method does before its steps from `x`, whatever their length, and how it gets the derivatives and margins at the
 * end of an accepted step. */
void method_prepare(Core *core, double time, const double x[], const double u[]);
void method_arrive(Core *core, double time, const double x[], const double u[], double rates[]);

#ifdef SOLVER_RODAS4
/* Of a change in the last step of length h, keep what a stiff model does not damp within it. */
void method_damp(const Core *core, double h, double change[]);
#endif

/* By what the length h of a step with this estimate should be multiplied; `last` is the step before, NULL for none. */
double method_factor(const StepControl *last, double h, double error);
#endif

#ifdef SOLVER_RK43
/* Whether the user wants steps of fixed length. */
static inline int method_is_fixed(const Core *core) { return PARAMETERS(core)[RTOL] == 0.0; }
#endif

#if HYBRID
/* Initial discrete states, and which events and sampling instants are next. */
CoreStatus core_start_discrete(Core *core);

/* Have happened what does so at this communication point: samplers whose instant it is, then events. With other inputs it
 * may be something else; before they are set it is taken back. */
CoreStatus core_settle(Core *core);
void core_unsettle(Core *core);

/* The same at any other instant. */
CoreStatus core_change(Core *core, int *states_changed);

/* Times that differ by less are one instant. */
static inline double core_instant(double time) { return 1e-12 * (1.0 + (time < 0.0 ? -time : time)); }

/* Time of the next sampling instant, INFINITY if there is none. */
double core_next_instant(const Core *core);

/* Note on which side of zero the indicators are where the states have arrived; whether something is to happen here. */
int core_arrive(Core *core);

CoreStatus core_get_indicators(Core *core, double indicators[]);
#endif
#if N_EVENTS > 0
/* Whether an event happens in an internal step from `x` at `time`, where the inputs are `u` and change at `u_rate` and
 * the state derivatives are `rates`, to `next`: *h and `next` become those of the event. After the last step of several
 * core_arrive must be called when time, states and inputs are those of its end, as after an event. */
CoreStatus core_find_event(Core *core, double time, double *h, const double x[], const double u[],
                           const double u_rate[], const double rates[], double next[], int last, int *found);
#endif

CoreStatus core_set_time(Core *core, double time);
CoreStatus core_set_states(Core *core, const double x[]);
CoreStatus core_get_states(Core *core, double x[]);
CoreStatus core_get_derivatives(Core *core, double derivatives[]);

/* Change of `unknown` along a change of knowns: `change` has N_VALUES entries, by value reference. What is not finite gets
 * `status`. */
CoreStatus core_direction(Core *core, const unsigned unknowns[], size_t n, const double change[], double result[],
                          CoreStatus status);

/* What the sum of n unknowns, weighted by `seed`, changes by with each of m knowns. */
CoreStatus core_adjoint(Core *core, const unsigned unknowns[], size_t n, const double seed[], const unsigned knowns[],
                        size_t m, double result[]);

/* FMU states as bytes that name the FMU they belong to. */
size_t core_serialized_size(void);
void core_serialize(const CoreState *state, char bytes[]);
CoreStatus core_deserialize(Core *core, const char bytes[], size_t size, CoreState *state);

#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility pop
#endif

#endif
