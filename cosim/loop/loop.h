/* The table of operations that the stepping loop walks, and its functions; binding.py lays `Operation` and `Loop` out once
 * more. The loop is compiled into a library for Python, and into FMUs that hold a whole system (cosim/pack). */
#ifndef LOOP_H
#define LOOP_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "loop_hash.h" /* LOOP_HASH; where the loop is a part of something, also EXPORT, empty: so it comes first */

#include "current_calls.h"

typedef enum { SAMPLE, SET, GET, EXTRAPOLATE, STEP, TRANSFORM, CALL, CONVERT, GROUP, DIFFERENTIATE } Kind;

/* A C type of values is its class and its size in bytes: REAL + 4 is a float. A value stands in a slot of 8 bytes, real
 * ones as a double, whole ones as an integer; so `values`, an array of slots, is one of doubles by name only. */
enum { REAL = 0, SIGNED = 16, UNSIGNED = 32, POINTER = 64 };

/* Where the derivatives of an input come from: from its values at this and at earlier points (extrapolation), or, for a
 * signal, which is known beforehand, from those at this and at the next point (interpolation): then its column of the samples. */
enum { EXTRAPOLATED = -1, HELD = -2 };

enum { NONE = -1 };

/* How n inputs of an FMU change over a step: polynomials of a degree, by their values, or also their rates, at so many
 * points. */
typedef struct {
    double
        *history; /* points rows of n: values at this point (before it is reached: at the last one), before it, ... */
    double *rates; /* the same of their rates, times the step; NULL where none are used */
    double *derivatives; /* degree rows of n: by time, the first, the second, ... */
    double
        *watched; /* four rows of n: what was predicted for this point, by the polynomials and by lines through the last
                        two values, and how wrong both have been lately; NULL where polynomials are used however that is */
    double *buffer; /* FMI 3.0: n values during the step */
    double
        *ahead; /* derivatives over the steps that a starting block has found, those of the last one first; NULL where
                      none is looked for */
    const int32_t *orders; /* of the derivatives, as fmi2SetRealInputDerivatives wants them */
    const double
        *weights; /* for 1, 2, ... points known values: degree rows of points, times the step^-order; then, where
                              rates are used, as many for these */
    double time; /* of this point */
    int32_t points, degree, known;
    int32_t refused; /* FMI 3.0: status with which the FMU refused a value during a step; -1 once that was told */
    int32_t first_rate; /* position of the first of n rates */
    int32_t left; /* so many steps of the block are left */
} Extrapolated;

/* What rates of outputs depend on besides time and states: the rates of inputs with direct feedthrough. */
typedef struct {
    void
        *function; /* fmi2GetDirectionalDerivative or fmi3GetDirectionalDerivative; NULL where nothing is fed through */
    const uint32_t *knowns;
    const int32_t *positions; /* of their rates */
    const int32_t *orders; /* 1 for each output */
    double *seed, *change;
    int32_t n;
} Rates;

/* What a connection between two types may carry: slots of REAL, SIGNED or UNSIGNED, to a C type with these bounds. */
typedef struct {
    int64_t smallest;
    uint64_t largest;
    int32_t from, to;
} Conversion;

typedef struct {
    uint8_t kind, type, version; /* type of C that the function takes; version of FMI: 1, 2 or 3 */
    uint8_t more; /* EXTRAPOLATE: whether the next operation has more of the same instance */
    int32_t every; /* takes part in the communication points whose number is a multiple of this */
    void *function, *instance;
    const uint32_t *references;
    void *data; /* SET, GET: buffer for values in the type of the function; NULL where that is the type of the slots.
                   EXTRAPOLATE: its Extrapolated. STEP: a double, the time at which the FMU stopped.
                   TRANSFORM: factors and, after them, offsets. CONVERT: a Conversion each. DIFFERENTIATE: its Rates.
                   GROUP: what its function works on. */
    const int32_t *targets; /* positions, and after them, as many:
                               SET, TRANSFORM, CONVERT: positions of the sources; TRANSFORM: then of what is added, or NONE.
                               SAMPLE: columns.
                               GET: only positions, of what must be finite.
                               EXTRAPOLATE: only columns, EXTRAPOLATED or HELD, of the last of its values;
                               those before are EXTRAPOLATED. */
    int32_t n_references, first, n, n_targets; /* first, n: the values that it gets or sets, contiguous */
} Operation; /* 64 bytes: with many FMUs the loop is as fast as the processor's cache */

/* What connected inputs were predicted to be at a point that is measured, against what they are there. */
typedef struct {
    const Operation *steps; /* those that extrapolate inputs are among them */
    int64_t n_steps;
    const int32_t *positions; /* of n inputs */
    double *values; /* all n_values: what is predicted */
    double *squares, *sizes; /* n sums of the squares of errors, and n largest magnitudes */
    int64_t n_values, n_points, n;
    int64_t is_predicted; /* whether something is predicted for the point ahead */
} Predicted;

/* How long operations take: measured at one point in so many, in ns since then, of each one. */
typedef struct {
    int64_t every;
    int64_t *at_point, *at_step;
    int64_t n_points, n_steps; /* that were measured */
    Predicted *predicted; /* NULL: nothing is */
} Profile;

struct Team;
struct StartingBlock;

typedef struct Loop {
    double start_time, step_size, per_second; /* steps in a second, if each is one of step_size */
    int64_t last_point;
    double *values;
    /* samples of the signals, and whether something jumps at a point or since the one before; rows from first_sample on */
    const double *samples;
    const double
        *samples_inside; /* two for each, after a third and two thirds of the step to the next; NULL without any */
    const uint8_t *jumps;
    int64_t n_samples, first_sample, n_rows;
    /* what is recorded, at the points whose number is a multiple of record_every; rows from first_record on */
    double *records;
    const int32_t *runs; /* of contiguous values: position of the first, number */
    int64_t n_runs, n_recorded, record_every, first_record;
    const Operation *at_point, *at_step;
    int64_t n_at_point, n_at_step;
    const uint32_t *codes_at_point, *codes_at_step; /* of the calls that the operations make */
    CurrentCall *call; /* where they are noted: that of the thread that the loop runs in */
    struct Team *team; /* which performs the operations at_step (team.h); NULL: they are performed one by one */
    Profile *profile; /* NULL: nothing is measured */
    struct StartingBlock *start; /* how steps begin of which inputs know little; NULL: as all others */
    void (*warned)(const Operation *); /* told of each operation that returns a warning */
    void (*looks)(void); /* called now and then while it waits for its team; NULL: it only waits */
    /* where it is or was, and how it ended */
    int64_t point, failed;
    int32_t status, failed_at_step;
} Loop;

/* Function of a GROUP operation. */
typedef int OfGroup(const Loop *loop, const Operation *op, int64_t point, double time);

/* Where a field of a struct lies that Python lays out once more; a struct itself, without a field, too. */
typedef struct {
    const char *name;
    size_t offset, size;
} Field;

/* Beyond the statuses of FMI. */
enum { NOT_FINITE = 100, WANTS_TO_END, RETURNED_EARLY, DOES_NOT_FIT };

/* What takes a message of an FMU, its text without arguments. */
typedef void TakeMessage(void *environment, const char *name, int status, const char *category, const char *text);

EXPORT void log_to(TakeMessage *taker);

/* The logger of FMI 1.0 and 2.0, which formats as printf does; a text without % is as long as the FMU has it. */
EXPORT void log_message(void *environment, const char *name, int status, const char *category, const char *format, ...);

/* fmi3IntermediateUpdateCallback; the environment of the instance points to a pointer to its first EXTRAPOLATE operation, if any. */
EXPORT void intermediate_update(void *environment, double time, bool set_requested, bool get_allowed,
                                bool step_finished, bool can_return_early, bool *return_early, double *return_time);

/* Copy slots to values of a C type that are known to fit, or back. */
void loop_convert(int32_t type, void *buffer, double *slots, int64_t n, bool to_fmu);

/* Whether something jumps in (t_first, t_last], by the numbers of the points. */
bool loop_jumps_within(const Loop *loop, int64_t first, int64_t last);
/* How n unknowns of an FMU change when m knowns change by a seed, by its function of FMI 2 or 3; the status. */
int loop_directional_derivative(void *function, int32_t version, void *instance, const uint32_t unknowns[], size_t n,
                                const uint32_t knowns[], size_t m, const double seed[], double change[]);

/* Carry a value to a slot of another type; false where that can't hold it exactly. */
bool loop_carry(const Conversion *conversion, const double *source, double *target);

/* Values of n inputs some time after a communication point, into their buffer: a Taylor series. */
void loop_evaluate(const Extrapolated *in, double since, int32_t n);

/* And their derivatives, order by order, behind the values. */
EXPORT void loop_evaluate_all(const Extrapolated *in, double since, int32_t n);

/* A STEP operation of this length; the status, or one of those beyond FMI's. */
int loop_do_step(const Operation *op, double time, double step);

/* Perform operations one by one, noting their codes in a call; the number of those that went well, and the status of the next. */
int64_t loop_perform_some(const Loop *loop, CurrentCall *call, const Operation operations[], const uint32_t codes[],
                          int64_t n, int64_t point, int32_t *status);

/* Perform the operations at_step one by one; false, with the reason in `loop`, when one fails. */
bool loop_step_one_by_one(Loop *loop, int64_t point);

/* Those after the one that failed; its number is that of all of them. */
bool loop_rest_one_by_one(Loop *loop, int64_t failed, int64_t point);

/* Go on with a step after the operation that failed has been dealt with; as loop_perform. */
EXPORT bool loop_rest_of_step(Loop *loop, int64_t failed, int64_t point);

/* Perform operations with these codes once, at a communication point; false, with the reason in `loop`, when one fails. */
EXPORT bool loop_perform(Loop *loop, const Operation operations[], const uint32_t codes[], int64_t n, int64_t point);

/* Go through the communication points first ... end - 1, with a step after each but the last one of the run; at the first
 * one values may have been exchanged already. */
EXPORT bool loop_run(Loop *loop, int64_t first, int64_t end, bool exchanged);

#endif
