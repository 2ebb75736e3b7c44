/* Communication steps that a component did not finish at once: as the master does it (cosim/master/unfinished_steps.py),
 * a discarded step is repeated in shorter ones, and one that is still being computed is waited for. */
#define _POSIX_C_SOURCE 199309L /* nanosleep */
#include "packed.h"

#include <math.h>

#include "fmi.h"

#ifdef _WIN32
#include <windows.h>
#else
#include <time.h>
#endif

/* A discarded step is repeated in steps that are shorter by at most 2 to this power. */
enum { MOST_HALVINGS = 10 };

/* Times nearer to each other than this part of a step are the same, for rounding. */
static const double same = 1e-9;

typedef int AskReal(void *, int, double *);
typedef int AskWhole(void *, int, int *);
typedef int SetReal(void *, const uint32_t *, size_t, const double *);
typedef int SetDerivatives(void *, const uint32_t *, size_t, const int32_t *, const double *);

/* How far a step has come. */
typedef struct {
    int code; /* status of FMI */
    bool has_ended, returned_early, gave_up;
    double reached;
} Outcome;

static void wait_a_little(void) {
#ifdef _WIN32
    Sleep(1);
#else
    struct timespec little = {0, 100000};
    nanosleep(&little, NULL);
#endif
}

static bool is_done(const Outcome *outcome) {
    return outcome->code >= OK && outcome->code <= WARNING && !outcome->has_ended && !outcome->returned_early;
}

/* What a component of FMI 2.0 says of a step that it has discarded; one that does not say has computed nothing. */
static void ask_about_discarded(Component *component, double time, Outcome *outcome) {
    AskWhole *ask_whole = (AskWhole *)component_function(component, "fmi2GetBooleanStatus");
    AskReal *ask_real = (AskReal *)component_function(component, "fmi2GetRealStatus");
    int ended = 0;
    double reached = time;
    if (!ask_whole || ask_whole(component->instance, fmi2Terminated, &ended) > WARNING) ended = 0;
    if (!ask_real || ask_real(component->instance, fmi2LastSuccessfulTime, &reached) > WARNING) reached = time;
    outcome->has_ended = ended && !component->said[0];
    outcome->gave_up = ended && component->said[0];
    outcome->reached = reached;
}

/* The outcome of a step from a time on, for a status of the loop, once the component has computed it. */
static Outcome outcome_of(Component *component, const Operation *operation, int status, double time) {
    Outcome outcome = {status, false, false, false, time};
    if (component->version == 3) {
        outcome.reached = *(const double *)operation->data;
        outcome.has_ended = status == WANTS_TO_END;
        outcome.returned_early = status == RETURNED_EARLY;
        if (outcome.has_ended || outcome.returned_early) outcome.code = OK;
        return outcome;
    }
    while (outcome.code == PENDING) {
        AskWhole *ask = (AskWhole *)component_function(component, "fmi2GetStatus");
        int code = FAILURE;
        wait_a_little();
        if (!ask || ask(component->instance, fmi2DoStepStatus, &code) > WARNING) code = FAILURE;
        outcome.code = code;
    }
    if (outcome.code == DISCARD) ask_about_discarded(component, time, &outcome);
    return outcome;
}

/* Set extrapolated inputs of a component of FMI 2.0 some time after the communication point; one of FMI 3.0 asks for them. */
static bool move_inputs(Packed *packed, Component *component, double since) {
    for (int32_t k = 0; component->version == 2 && since != 0.0 && k < packed->n_at_step; k++) {
        const Operation *operation = &packed->at_step[k];
        if (operation->kind != EXTRAPOLATE || operation->instance != component->instance) continue;
        Extrapolated *inputs = operation->data;
        size_t n = (size_t)operation->n;
        SetReal *set = (SetReal *)component_function(component, "fmi2SetReal");
        loop_evaluate_all(inputs, since, operation->n);
        if (!set || set(component->instance, operation->references, n, inputs->buffer) > WARNING) return false;
        SetDerivatives *change = (SetDerivatives *)operation->function;
        if (change(component->instance, operation->references, n * (size_t)inputs->degree, inputs->orders,
                   inputs->buffer + n) > WARNING)
            return false;
    }
    return true;
}

static bool in_short_steps(Packed *packed, Component *component, const Operation *operation, double time, double step,
                           double reached) {
    double end = time + step, length = (end - reached) / (reached <= time ? 2.0 : 1.0);
    while (end - reached > same * step) {
        length = fmin(length, end - reached);
        if (!move_inputs(packed, component, reached - time)) return false;
        Outcome outcome = outcome_of(component, operation, loop_do_step(operation, reached, length), reached);
        if (is_done(&outcome)) {
            reached += length;
        } else if (outcome.has_ended) {
            packed->now.discarded = true;
            component_ends(component, time);
            return false;
        } else if ((outcome.code != DISCARD && !outcome.returned_early) || outcome.gave_up) {
            packed->loop.status = outcome.code;
            return false;
        } else if (outcome.reached > reached + same * step) {
            reached = outcome.reached;
        } else {
            length /= 2.0;
            if (length < step / (1 << MOST_HALVINGS)) {
                packed_fail(packed, DISCARD,
                            "component '%s' did not finish the step of %.9g s from t = %.9g s on, nor steps of %.3g s; "
                            "try another max_step",
                            component->name, step, time, 2.0 * length);
                packed->now.said = packed->now.discarded = true;
                return false;
            }
        }
    }
    return true;
}

/* Finish the step of the component at which the loop stands. */
static bool finish_component(Packed *packed, Component *component, const Operation *operation) {
    double time = packed->loop.start_time + (double)packed->loop.point * packed->loop.step_size;
    double step = operation->every * packed->loop.step_size;
    Outcome outcome = outcome_of(component, operation, packed->loop.status, time);
    if (is_done(&outcome)) return true;
    packed->now.discarded = outcome.code == DISCARD || outcome.returned_early || outcome.has_ended;
    if (outcome.has_ended) {
        packed->now.reached = outcome.reached;
        component_ends(component, time);
        return false;
    }
    bool may_repeat = (outcome.code == DISCARD || outcome.returned_early) && !outcome.gave_up;
    packed->loop.status = outcome.returned_early ? DISCARD : outcome.code;
    if (!may_repeat || !component->takes_any_step) return false;
    component->said[0] = '\0';
    bool finished = in_short_steps(packed, component, operation, time, step, fmax(time, outcome.reached));
    if (finished) packed->now.discarded = false;
    return finished;
}

bool finish_step(Packed *packed) {
    if (packed->block.failed >= 0) return false;
    int64_t k = packed->loop.failed;
    int32_t before = packed->n_at_start + packed->n_at_point; /* owners stand behind those of the other tables */
    for (;;) {
        const Operation *operation = &packed->at_step[k];
        if (operation->kind != STEP || !finish_component(packed, packed->owners[before + k], operation)) return false;
        int64_t rest = packed->n_at_step - k - 1;
        if (loop_perform(&packed->loop, operation + 1, packed->no_codes, rest, packed->loop.point)) return true;
        packed->loop.failed_at_step = true;
        packed->loop.failed = k += 1 + packed->loop.failed;
    }
}
