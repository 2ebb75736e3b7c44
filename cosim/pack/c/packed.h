/* A whole system as one FMU: what both faces (fmi2.c, fmi3.c) need of an instance.
 *
 * The library knows no system. It reads `plan.txt` in its resources, which holds the table of operations that the master
 * has made, loads the components' libraries, and lets the loop (cosim/loop) walk the table. */
#ifndef PACKED_H
#define PACKED_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "starting_block.h"

/* The numbers of fmi2Status and fmi3Status. */
typedef enum { OK = 0, WARNING = 1, DISCARD = 2, FAILURE = 3, FATAL = 4, PENDING = 5 } Status;

typedef enum {
    INSTANTIATED = 1,
    INITIALIZATION = 2,
    STEPPING = 4,
    TERMINATED = 8,
    FAILED = 16, /* a component did not finish a step: the others may have */
    ANY = 31
} Phase;

/* Types of the variables of the packed FMU; FMI 2.0 has four of them. */
typedef enum {
    TYPE_FLOAT64, /* Real */
    TYPE_FLOAT32,
    TYPE_INT8,
    TYPE_UINT8,
    TYPE_INT16,
    TYPE_UINT16,
    TYPE_INT32, /* Integer */
    TYPE_UINT32,
    TYPE_INT64, /* FMI 3.0: also Enumeration */
    TYPE_UINT64,
    TYPE_BOOLEAN,
    TYPE_STRING
} VariableType;

struct Packed;

typedef struct {
    const Operation
        *asked; /* FMI 3.0: what answers when it asks for its inputs; must be first, see `intermediate_update` */
    struct Packed *packed;
    const char *name, *identifier, *token, *folder;
    char *resources; /* as its instantiation takes it */
    int version;
    bool resets, has_tolerance, takes_any_step;
    double tolerance;
    int32_t every; /* it steps at every so many points */
    const char **beside; /* further libraries beside its own */
    int n_beside;
    uint32_t *asks; /* FMI 3.0: inputs that it gets during a step */
    size_t n_asks;
    void *library, **further;
    void *callbacks; /* FMI 2.0: fmi2CallbackFunctions */
    void *instance;
    void *kept;  /* its state at the beginning of a starting block */
    bool broken; /* a fatal error: it must not be called again */
    char said[512]; /* its last message that was more than information */
} Component;

/* When a start value is set. */
typedef enum { STRUCTURAL, BEFORE_INITIALIZATION } When;

/* A parameter of a component, or an input that nothing feeds, with all elements. */
typedef struct {
    Component *component;
    int32_t when, code, first,
        n; /* C type of a value as in the loop; place among the start values, number of elements */
    uint32_t reference;
    const char *setter, *getter;
    bool given; /* by the system: set even if the importer sets nothing */
    bool tunable;
    bool set; /* by the importer */
} Start;

/* Where a value of the packed FMU is. */
typedef enum { EXCHANGED, COLUMN, START, DIRECT, MAX_STEP } Role;

typedef struct {
    const char *name;
    int32_t type, role, where, element; /* where: position, column, number of the start value or of the direct one */
    double smallest, largest; /* of whole numbers */
} Variable;

/* A variable that is read from its component when it is asked for: texts. */
typedef struct {
    Component *component;
    const char *getter;
    uint32_t reference;
    int32_t n;
} Direct;

/* What a column of the samples holds: an input of the packed FMU, or an element of a signal. */
typedef struct {
    int32_t signal, element; /* signal -1: an input */
    int32_t every;           /* of the component that it feeds */
    bool is_real;
    double start; /* slot */
} Column;

/* A signal as a table: held, linear between rows, or linear as numpy.interp computes it. */
typedef enum { HELD_ROWS, LINEAR_ROWS, INTERP_ROWS } Between;

typedef struct {
    int32_t between, n, size;
    const double *times, *values; /* n, and n rows of size slots */
    const double *breakpoints; /* at which it jumps, ascending */
    int32_t n_breakpoints;
} Signal;

/* A text input or output of a component, for the loop: slots hold the numbers of texts. */
typedef struct {
    Component *component;
    void *function;
    const char **buffer;
} TextCall;

/* What changes, beside `numbers`, the histories and the states of the components. */
typedef struct {
    double time;     /* of the point */
    double origin;   /* the time of a point is origin + point * step */
    double step;     /* internal communication step */
    double max_step; /* longest one */
    double stop, tolerance;
    int64_t point;
    int32_t phase;
    bool exchanged; /* values have been exchanged at this point */
    bool stale;     /* inputs have been set since */
    bool begun;     /* a step has been made, so that the grid of the points is known */
    bool has_stop, has_tolerance;
    bool set_up; /* FMI 2.0: the importer has said when the experiment starts */
    bool wants_to_end, discarded, said; /* the last step failed, and why has been said */
    double reached; /* time of the last point that the whole system has reached */
} Progress;

/* What the importer is told. */
typedef void Forward(void *environment, const char *name, Status status, const char *category, const char *text);

/* A message that is held back until it is known whether it matters. */
typedef struct {
    Status status;
    char *category, *text;
} HeldMessage;

/* FMI 3.0: asks the importer for the inputs at a time inside a step. */
typedef void AskForInputs(void *environment, double time);

typedef struct Packed {
    char *name, *folder;
    const char *token;
    Forward *forward;
    AskForInputs *ask_for_inputs;
    void *environment;
    bool logging;
    Progress now;
    bool warned, within_step;
    bool holds_messages; /* of an attempt that may be repeated */
    HeldMessage *held;
    int32_t n_held;

    Component *components;
    Start *starts;
    Variable *variables;
    Direct *directs;
    Column *columns;
    Signal *signals;
    int32_t n_components, n_values, n_starts, n_variables, n_directs, n_columns, n_signals, n_breakpoints;
    int32_t n_start_slots;
    int32_t reach, cycle; /* by how many points the loop looks back or ahead; after how many all components step */
    bool follows_other_steps; /* inputs go on with their last slopes when the internal step becomes another one */
    bool parallel; /* an exchange at a point can't be repeated */
    double default_step;
    double *breakpoints; /* of all signals, ascending, each once */
    const char **value_names;

    double *numbers; /* values, inputs, their rates, start values: all that changes */
    double *values, *inputs, *rates, *start_slots, *default_starts;
    int64_t n_numbers;
    int32_t *text_slots; /* of the numbers, those that are texts */
    int32_t n_text_slots;
    Operation *at_start, *at_point, *at_step;
    int32_t n_at_start, n_at_point, n_at_step;
    const char **functions; /* names of the functions of the operations: at the start, at a point, at a step */
    Component **owners;
    Extrapolated **extrapolated;
    int32_t *n_extrapolated_inputs;
    int32_t n_extrapolated;
    Loop loop;
    StartingBlock block; /* without steps: there is none */
    CurrentCall call; /* nobody reads it here, so the codes of the operations are all 0 */
    uint32_t *no_codes;
    double *samples; /* rows of columns */
    double *inside;  /* rows of columns with two values each, inside the step ahead */
    uint8_t *jumps;
    char **texts;
    int32_t n_texts, room_for_texts;
    void **memory; /* all that is kept until the end */
    size_t n_memory, room_for_memory;
} Packed;

/* packed.c */
Packed *packed_new(const char *name, const char *token, const char *resources, Forward *forward, void *environment,
                   bool logging);
void packed_free(Packed *packed);
Status packed_reset(Packed *packed);
bool packed_allowed(Packed *packed, int phases, const char *function);
/* Pass a message on, or hold it back. */
void packed_tell(Packed *packed, Status status, const char *category, const char *text);
Status packed_fail(Packed *packed, Status status, const char *format, ...);
double packed_told_stop(const Component *component);
Status packed_enter_initialization(Packed *packed, bool has_tolerance, double tolerance, double start, bool has_stop,
                                   double stop);
Status packed_exit_initialization(Packed *packed);
Status packed_terminate(Packed *packed);
Status packed_do_step(Packed *packed, double time, double step);
/* A component ends the simulation: that is no failure, but the others may stand at another time. */
Status component_ends(Component *component, double time);
/* Fails for a component; its last message is a part of the text. */
Status component_failed(Component *component, Status status, const char *function);
void *keep(Packed *packed, size_t size);

/* values.c: of one variable, whose type is that of the function that the importer called */
Status packed_prepare_get(Packed *packed);
Status packed_get(Packed *packed, uint32_t reference, VariableType type, double *slot, const char **text);
Status packed_set(Packed *packed, uint32_t reference, VariableType type, double slot, const char *text);
Status packed_set_rate(Packed *packed, uint32_t reference, double rate);
int32_t text_number(Packed *packed, const char *text);
const char *text_of(const Packed *packed, double slot);
int64_t integer_of(double slot);
double slot_of(int64_t integer);
Status pass_start(Packed *packed, const Start *start, bool set);
/* For the loop, as functions of FMI 3.0 whatever the component's version is. */
int text_get(void *call, const uint32_t references[], size_t n_references, double slots[], size_t n);
int text_set(void *call, const uint32_t references[], size_t n_references, const double slots[], size_t n);

/* unfinished.c: finish the step in which the loop got stuck at a component; false, as the loop, where that can't be. */
bool finish_step(Packed *packed);

/* samples.c */
void sample(Packed *packed, int64_t first, int64_t end, int64_t now, const double next_inputs[]);

/* plan.c */
bool read_plan(Packed *packed);

/* components.c */
bool component_load(Component *component);
void component_unload(Component *component);
bool component_instantiate(Component *component);
void component_free(Component *component);
Status component_reset(Component *component);
void *component_function(Component *component, const char *name);
Status component_configure(Component *component, bool begin);
Status component_set_up(Component *component);
Status component_enter_initialization(Component *component);
Status component_exit_initialization(Component *component);
Status component_terminate(Component *component);
typedef int Plain(void *);
Status component_call(Component *component, const char *function2, const char *function3);
/* The instance whose call is going on in this thread, so that a message finds its component; returns the one before. */
Packed *entered(Packed *packed);

/* states.c */
typedef struct State State;
Status state_get(Packed *packed, State **state);
Status state_set(Packed *packed, const State *state);
void state_free(Packed *packed, State *state);
Status state_size(Packed *packed, const State *state, size_t *size);
Status state_serialize(Packed *packed, const State *state, char bytes[], size_t size);
Status state_deserialize(Packed *packed, const char bytes[], size_t size, State **state);

#endif
