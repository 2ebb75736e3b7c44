/* The life of a packed system, and its communication step. */
#include "packed.h"

#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* More internal steps than this in one communication step is taken for a mistake, not for work to do. */
static const double most_internal_steps = 1e6;

/* So many points are sampled at once. */
enum { CHUNK = 64 };

/* Times nearer to each other than this part of an internal step are the same, for rounding. */
static const double same = 1e-6;

void *keep(Packed *packed, size_t size) {
    if (packed->n_memory == packed->room_for_memory) {
        size_t room = packed->room_for_memory ? 2 * packed->room_for_memory : 256;
        void **more = realloc(packed->memory, room * sizeof *more);
        if (!more) return NULL;
        packed->memory = more;
        packed->room_for_memory = room;
    }
    void *found = calloc(1, size ? size : 1);
    if (found) packed->memory[packed->n_memory++] = found;
    return found;
}

static char *copy_of(const char *text) {
    char *copy = text ? malloc(strlen(text) + 1) : NULL;
    return copy ? strcpy(copy, text) : NULL;
}

void packed_tell(Packed *packed, Status status, const char *category, const char *text) {
    HeldMessage *more =
        packed->holds_messages ? realloc(packed->held, (size_t)(packed->n_held + 1) * sizeof *more) : NULL;
    if (!more) {
        packed->forward(packed->environment, packed->name, status, category, text);
        return;
    }
    packed->held = more;
    packed->held[packed->n_held++] = (HeldMessage){status, copy_of(category), copy_of(text)};
}

/* Pass the messages on that were held back, or forget them. */
static void release_messages(Packed *packed, bool pass_on) {
    packed->holds_messages = false;
    for (int32_t i = 0; i < packed->n_held; i++) {
        HeldMessage *message = &packed->held[i];
        if (pass_on && message->text) packed_tell(packed, message->status, message->category, message->text);
        free(message->category);
        free(message->text);
    }
    free(packed->held);
    packed->held = NULL;
    packed->n_held = 0;
}

Status packed_fail(Packed *packed, Status status, const char *format, ...) {
    static const char *const categories[] = {"logAll", "logStatusWarning", "logStatusDiscard", "logStatusError"};
    char message[2048];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(message, sizeof message, format, arguments);
    va_end(arguments);
    packed_tell(packed, status, categories[status], message);
    return status;
}

bool packed_allowed(Packed *packed, int phases, const char *function) {
    if (packed->now.phase & phases) return true;
    if (packed->now.phase == FAILED)
        packed_fail(packed, FAILURE,
                    "%s can't be called after a component has failed; reset the instance, or restore a state",
                    function);
    else
        packed_fail(packed, FAILURE, "%s can't be called in this state; see the state machine of the FMI standard",
                    function);
    return false;
}

/* Making and freeing */

static void warned(const Operation *operation) {
    (void)operation;
    Packed *packed = entered(NULL);
    if (packed) packed->warned = true;
    entered(packed);
}

/* Give all operations the functions and the instances of their components. */
static bool bind(Packed *packed) {
    Operation *tables[] = {packed->at_start, packed->at_point, packed->at_step};
    int32_t sizes[] = {packed->n_at_start, packed->n_at_point, packed->n_at_step};
    for (int32_t i = 0; i < packed->n_components; i++) packed->components[i].asked = NULL;
    for (int32_t k = 0, done = 0; k < 3; done += sizes[k], k++)
        for (int32_t i = 0; i < sizes[k]; i++) {
            Operation *operation = &tables[k][i];
            Component *component = packed->owners[done + i];
            const char *name = packed->functions[done + i];
            void *function = *name ? component_function(component, name) : NULL;
            if (*name && !function) return false;
            if (operation->type == POINTER) {
                ((TextCall *)operation->instance)->function = function;
                operation->function = operation->kind == GET ? (void *)text_get : (void *)text_set;
                continue;
            }
            operation->function = function;
            operation->instance = component->instance;
            if (operation->kind == DIFFERENTIATE) {
                Rates *rates = operation->data;
                const char *directional =
                    operation->version == 3 ? "fmi3GetDirectionalDerivative" : "fmi2GetDirectionalDerivative";
                rates->function = rates->n ? component_function(component, directional) : NULL;
                if (rates->n && !rates->function) return false;
            }
            if (operation->kind == EXTRAPOLATE && operation->version == 3 && !component->asked)
                component->asked = operation; /* the others of this component stand behind it */
        }
    for (int32_t i = 0; i < packed->block.n_states; i++) {
        KeptState *state = &packed->block.states[i];
        Component *component = &packed->components[i];
        state->instance = component->instance;
        state->get = component_function(component, component->version == 3 ? "fmi3GetFMUState" : "fmi2GetFMUstate");
        state->set = component_function(component, component->version == 3 ? "fmi3SetFMUState" : "fmi2SetFMUstate");
        if (!state->get || !state->set) return false;
    }
    return true;
}

/* All as after the instantiation, but for the components. */
static void begin_anew(Packed *packed) {
    memset(&packed->now, 0, sizeof packed->now);
    memset(packed->numbers, 0, (size_t)packed->n_numbers * sizeof *packed->numbers);
    memcpy(packed->start_slots, packed->default_starts, (size_t)packed->n_start_slots * sizeof *packed->start_slots);
    for (int32_t i = 0; i < packed->n_columns; i++) packed->inputs[i] = packed->columns[i].start;
    for (int32_t i = 0; i < packed->n_starts; i++) packed->starts[i].set = false;
    for (int32_t i = 0; i < packed->n_extrapolated; i++) {
        Extrapolated *inputs = packed->extrapolated[i];
        int32_t n = packed->n_extrapolated_inputs[i];
        memset(inputs->history, 0, (size_t)inputs->points * (size_t)n * sizeof *inputs->history);
        memset(inputs->derivatives, 0, (size_t)inputs->degree * (size_t)n * sizeof *inputs->derivatives);
        if (inputs->rates) memset(inputs->rates, 0, (size_t)inputs->points * (size_t)n * sizeof *inputs->rates);
        if (inputs->watched) memset(inputs->watched, 0, 4 * (size_t)n * sizeof *inputs->watched);
        inputs->known = inputs->refused = inputs->left = 0;
        inputs->time = 0.0;
    }
    packed->block.failed = -1;
    packed->now.phase = INSTANTIATED;
    packed->now.max_step = packed->default_step;
    packed->warned = packed->within_step = false;
}

static bool make_components(Packed *packed, const bool anew[]) {
    bool made = true;
    for (int32_t i = 0; made && i < packed->n_components; i++)
        if (!anew || anew[i]) made = component_load(&packed->components[i]);
    for (int32_t i = 0; made && i < packed->n_components; i++)
        if (!anew || anew[i]) made = component_instantiate(&packed->components[i]);
    return made && bind(packed);
}

static bool begin(Packed *packed) {
    if (!read_plan(packed)) return false;
    int64_t rows = CHUNK + 2 * (int64_t)packed->reach + 2;
    packed->samples = keep(packed, (size_t)rows * (size_t)(packed->n_columns + 1) * sizeof(double));
    packed->inside = keep(packed, 2 * (size_t)rows * (size_t)(packed->n_columns + 1) * sizeof(double));
    packed->jumps = keep(packed, (size_t)rows);
    if (!packed->samples || !packed->inside || !packed->jumps) {
        packed_fail(packed, FAILURE, "no memory for an instance");
        return false;
    }
    begin_anew(packed);
    static const int32_t no_runs[2] = {0, 0};
    static double no_records[1];
    Loop *loop = &packed->loop;
    loop->last_point = INT64_MAX;
    loop->values = packed->values;
    loop->samples = packed->samples;
    loop->samples_inside = packed->inside;
    loop->jumps = packed->jumps;
    loop->n_samples = packed->n_columns;
    loop->records = no_records;
    loop->runs = no_runs;
    loop->record_every = 1;
    loop->at_point = packed->at_point;
    loop->at_step = packed->at_step;
    loop->n_at_point = packed->n_at_point;
    loop->n_at_step = packed->n_at_step;
    loop->start = packed->block.steps ? &packed->block : NULL;
    loop->warned = warned;
    loop->call = &packed->call;
    loop->codes_at_point = loop->codes_at_step = packed->no_codes;
    return true;
}

Packed *packed_new(const char *name, const char *token, const char *resources, Forward *forward, void *environment,
                   bool logging) {
    Packed *packed = calloc(1, sizeof *packed);
    if (!packed) return NULL;
    packed->forward = forward;
    packed->environment = environment;
    packed->logging = logging;
    packed->name = malloc(strlen(name) + 1);
    packed->folder = malloc(strlen(resources) + 1);
    Packed *outer = entered(packed);
    bool made = packed->name && packed->folder;
    if (made) {
        strcpy(packed->name, name);
        strcpy(packed->folder, resources);
        size_t n = strlen(packed->folder);
        while (n > 1 && strchr("/\\", packed->folder[n - 1])) packed->folder[--n] = '\0';
        made = begin(packed);
        if (made && strcmp(token, packed->token)) {
            packed_fail(packed, FAILURE, "the token is not that of this FMU; don't mix files of different builds");
            made = false;
        }
        made = made && make_components(packed, NULL);
    }
    entered(outer);
    if (made) return packed;
    packed_free(packed);
    return NULL;
}

void packed_free(Packed *packed) {
    Packed *outer = entered(packed);
    for (int32_t i = packed->n_components - 1; packed->components && i >= 0; i--)
        component_free(&packed->components[i]);
    for (int32_t i = packed->n_components - 1; packed->components && i >= 0; i--) {
        Component *component = &packed->components[i];
        component_unload(component);
        free(component->resources);
        if (!component->broken) free(component->callbacks); /* which a broken one may still use */
    }
    entered(outer == packed ? NULL : outer);
    for (size_t i = 0; i < packed->n_memory; i++) free(packed->memory[i]);
    for (int32_t i = 0; i < packed->n_texts; i++) free(packed->texts[i]);
    free(packed->texts);
    free(packed->memory);
    free(packed->name);
    free(packed->folder);
    free(packed);
}

/* Reset the components that are known to reset completely, and make the others anew, once all old ones are gone. */
Status packed_reset(Packed *packed) {
    bool *anew = calloc((size_t)packed->n_components + 1, sizeof *anew);
    if (!anew) return packed_fail(packed, FAILURE, "no memory to reset an instance");
    packed->now.phase = FAILED; /* until all is well */
    for (int32_t i = 0; i < packed->n_components; i++) {
        Component *component = &packed->components[i];
        anew[i] = component->broken || !component->instance || !component->resets || component_reset(component) != OK;
    }
    for (int32_t i = packed->n_components - 1; i >= 0; i--)
        if (anew[i]) {
            Component *component = &packed->components[i];
            component_free(component);
            component_unload(component);
            if (component->broken) { /* what it may still use is left to it */
                component->callbacks = NULL;
                component->library = NULL;
                component->broken = false;
            }
        }
    bool made = make_components(packed, anew);
    free(anew);
    if (!made) return FAILURE;
    begin_anew(packed);
    return OK;
}

/* Initialisation */

/* Relative tolerance that a component is told which fails when it is told none. */
static const double assumed_tolerance = 1e-6;

/* The stop time that a component is told; where its last step ends later, for rounding (0.2 + 0.1 > 0.3) or since it steps at every
 * so many points, a later one. */
double packed_told_stop(const Component *component) {
    const Progress *now = &component->packed->now;
    double step = now->max_step, n = floor((now->stop - now->time) / step + 0.5);
    if (component->every > 1) return now->stop + component->every * step;
    if (n < 1.0 || fabs(now->time + n * step - now->stop) > same * step) return now->stop;
    return fmax(now->stop, now->time + (n - 1.0) * step + step);
}

/* Tell a component of the run and set its start values. */
static Status set_up(Packed *packed, Component *component) {
    Status status = OK;
    for (int32_t pass = STRUCTURAL; status == OK && pass <= BEFORE_INITIALIZATION; pass++) {
        bool configuring = false;
        if (pass == BEFORE_INITIALIZATION) status = component_set_up(component);
        for (int32_t k = 0; status == OK && k < packed->n_starts; k++) {
            Start *own = &packed->starts[k];
            if (own->component != component || own->when != pass || !(own->given || own->set)) continue;
            if (pass == STRUCTURAL && !configuring) {
                status = component_configure(component, true);
                configuring = true;
            }
            if (status == OK) status = pass_start(packed, own, true);
        }
        if (configuring && status == OK) status = component_configure(component, false);
    }
    return status;
}

Status packed_enter_initialization(Packed *packed, bool has_tolerance, double tolerance, double start, bool has_stop,
                                   double stop) {
    Progress *now = &packed->now;
    if (!isfinite(start)) return packed_fail(packed, FAILURE, "start time %g is not a finite number", start);
    now->time = now->reached = start;
    now->has_tolerance = has_tolerance;
    now->tolerance = tolerance;
    now->has_stop = has_stop;
    now->stop = stop;
    now->phase = FAILED;
    Status status = OK;
    for (int32_t i = 0; status == OK && i < packed->n_components; i++) {
        Component *component = &packed->components[i];
        packed->holds_messages = !now->has_tolerance && !component->has_tolerance;
        status = set_up(packed, component);
        if (status == OK) status = component_enter_initialization(component);
        bool again = status != OK && packed->holds_messages && !component->broken;
        release_messages(packed, !again);
        if (!again) continue;
        /* some need a tolerance without saying so */
        component->has_tolerance = true;
        component->tolerance = assumed_tolerance;
        component_free(component);
        component_unload(component);
        if (!component_load(component) || !component_instantiate(component) || !bind(packed)) return FAILURE;
        status = set_up(packed, component);
        if (status == OK) status = component_enter_initialization(component);
    }
    if (status != OK) return FAILURE;
    now->phase = INITIALIZATION;
    return OK;
}

Status component_ends(Component *component, double time) {
    Packed *packed = component->packed;
    packed->now.wants_to_end = true;
    if (packed->logging)
        packed_fail(packed, OK, "component '%s' ends the simulation in the step from t = %.9g s on", component->name,
                    time);
    return DISCARD;
}

/* How an operation has failed, in words. */
static Status loop_failed(Packed *packed, const Operation operations[], int32_t done) {
    const Loop *loop = &packed->loop;
    const Operation *operation = &operations[loop->failed];
    Component *component = packed->owners[done + loop->failed];
    const char *function = packed->functions[done + loop->failed];
    double time = loop->start_time + (double)loop->point * loop->step_size;
    if (packed->block.failed >= 0) {
        component = &packed->components[packed->block.failed];
        function = component->version == 3 ? "fmi3SetFMUState" : "fmi2SetFMUstate";
        return component_failed(component, (Status)packed->block.status, function);
    }
    switch (loop->status) {
        case NOT_FINITE:
            for (int32_t i = 0; i < operation->n_targets; i++)
                if (!isfinite(packed->values[operation->targets[i]]))
                    return packed_fail(packed, FAILURE, "t = %.9g s: output '%s' is not finite", time,
                                       packed->value_names[operation->targets[i]]);
            return FAILURE;
        case DOES_NOT_FIT:
            for (int32_t i = 0; i < operation->n_targets; i++) {
                const int32_t *targets = operation->targets;
                double carried;
                if (!loop_carry((const Conversion *)operation->data + i,
                                &packed->values[targets[operation->n_targets + i]], &carried))
                    return packed_fail(packed, FAILURE, "t = %.9g s: the value that feeds '%s' does not fit its type",
                                       time, packed->value_names[targets[i]]);
            }
            return FAILURE;
        default:
            break;
    }
    Status status = component_failed(component, (Status)loop->status, function);
    if (operation->kind == EXTRAPOLATE)
        packed_fail(packed, FAILURE,
                    "component '%s' refuses what its inputs do during a step, which it says it takes; %s",
                    component->name, "pack the system with --extrapolation hold");
    return status;
}

/* Exchange values in the initialisation mode, if something has been set since. */
static Status exchange_at_start(Packed *packed) {
    Progress *now = &packed->now;
    if (now->exchanged) return OK;
    packed->loop.start_time = now->time;
    packed->loop.step_size = now->max_step;
    packed->loop.per_second = 1.0 / now->max_step;
    sample(packed, 0, 1, 0, NULL);
    if (!loop_perform(&packed->loop, packed->at_start, packed->no_codes, packed->n_at_start, 0)) {
        now->phase = FAILED;
        loop_failed(packed, packed->at_start, 0);
        return FAILURE;
    }
    now->exchanged = true;
    return OK;
}

Status packed_exit_initialization(Packed *packed) {
    Progress *now = &packed->now;
    Status status = exchange_at_start(packed);
    if (status == OK && !(now->max_step > 0.0 && isfinite(now->max_step)))
        status = packed_fail(packed, FAILURE, "max_step is %g s; it must be positive and finite", now->max_step);
    for (int32_t i = 0; status == OK && i < packed->n_components; i++)
        status = component_exit_initialization(&packed->components[i]);
    if (status != OK) {
        now->phase = FAILED;
        return FAILURE;
    }
    now->phase = STEPPING;
    now->exchanged = now->stale = now->begun = false;
    now->point = 0;
    now->origin = now->time;
    now->step = now->max_step;
    return OK;
}

Status packed_terminate(Packed *packed) {
    Status status = OK;
    packed->now.phase = TERMINATED;
    for (int32_t i = 0; i < packed->n_components; i++)
        if (!packed->components[i].broken && component_terminate(&packed->components[i]) != OK) status = WARNING;
    return status; /* what has been computed is as good when one fails in that */
}

/* Steps */

/* Where the loop stands. */
static void place_loop(Packed *packed) {
    packed->loop.start_time = packed->now.origin;
    packed->loop.step_size = packed->now.step;
    packed->loop.per_second = 1.0 / packed->now.step;
}

/* Exchange at the present point; a second time, after inputs have been set, as far as the order allows. */
static Status exchange(Packed *packed) {
    Progress *now = &packed->now;
    if (now->exchanged && !now->stale) return OK;
    place_loop(packed);
    sample(packed, now->point, now->point + 1, now->point, NULL);
    bool done = true;
    if (!now->exchanged || !packed->parallel) {
        done = loop_perform(&packed->loop, packed->at_point, packed->no_codes, packed->n_at_point, now->point);
    } else { /* outputs were read before inputs were set, and stay so */
        for (int32_t k = 0; done && k < packed->n_at_point; k++) {
            if (packed->at_point[k].kind == GET) continue;
            done = loop_perform(&packed->loop, &packed->at_point[k], packed->no_codes, 1, now->point);
            packed->loop.failed += k;
        }
    }
    if (!done) {
        now->phase = FAILED;
        loop_failed(packed, packed->at_point, packed->n_at_start);
        return FAILURE;
    }
    now->exchanged = true;
    now->stale = false;
    return OK;
}

Status packed_prepare_get(Packed *packed) {
    switch (packed->now.phase) {
        case INITIALIZATION:
            return exchange_at_start(packed);
        case STEPPING:
            return packed->within_step ? OK : exchange(packed);
        default:
            return OK;
    }
}

/* Length of n internal steps in a communication step. Importers subtract times, which are rounded: a length that is that
 * of the steps before, or max_step, but for this, is meant to be. */
static double without_rounding(const Packed *packed, double time, double step, int n) {
    const Progress *now = &packed->now;
    double h = step / n, error = 1e-9 * h + 4.0 * DBL_EPSILON * (fabs(time) + step) / n;
    if (now->begun && fabs(h - now->step) <= error) return now->step;
    return fabs(h - now->max_step) <= error ? now->max_step : h;
}

/* Number the points from a time on, for internal steps of a length; histories go on where the steps are as long. */
static void go_on_from(Packed *packed, double time, double step) {
    Progress *now = &packed->now;
    bool on_grid = fabs(now->origin + (double)now->point * now->step - time) <= same * step;
    if (!now->begun) {
        now->origin = time;
    } else if (step != now->step || !on_grid) {
        /* components with longer steps count points: the remainder stays */
        now->point = packed->cycle + now->point % packed->cycle;
        now->origin = time - (double)now->point * step;
        if (step != now->step && !packed->follows_other_steps)
            for (int32_t i = 0; i < packed->n_extrapolated; i++)
                packed->extrapolated[i]->known = packed->extrapolated[i]->left = 0;
    }
    now->step = step;
    now->begun = true;
}

/* Let the slopes of connected inputs be those of the step before, which was longer or shorter; the samples of the next
 * point, whose slopes the loop takes by the same length, are moved accordingly. */
static void follow_step(Packed *packed, double before, double step) {
    int64_t row = packed->now.point - packed->loop.first_sample;
    double *now = packed->samples + row * packed->n_columns, *next = now + packed->n_columns;
    packed->loop.per_second = 1.0 / before;
    for (int32_t c = 0; c < packed->n_columns; c++)
        if (packed->columns[c].is_real) next[c] = now[c] + (next[c] - now[c]) * (before / step);
}

/* Internal steps from the present point on, after one of the length `before`; false where a component fails. */
static bool step_internally(Packed *packed, int n, double step, double before) {
    Progress *now = &packed->now;
    double next[1], *asked = next;
    bool asks = packed->ask_for_inputs && packed->n_columns;
    if (asks && !(asked = malloc((size_t)packed->n_columns * sizeof *asked))) return false;
    bool done = true;
    for (int i = 0, chunk; done && i < n; i += chunk) {
        bool other = before != step && packed->follows_other_steps && i == 0;
        chunk = asks || other ? 1 : n - i < CHUNK ? n - i : CHUNK;
        if (asks) { /* linear between the inputs at both ends of the internal step */
            size_t size = (size_t)packed->n_columns * sizeof *asked;
            memcpy(asked, packed->inputs, size);
            packed->within_step = true;
            packed->ask_for_inputs(packed->environment, now->origin + (double)(now->point + 1) * step);
            packed->within_step = false;
            for (int32_t c = 0; c < packed->n_columns; c++) {
                double new_one = packed->inputs[c];
                packed->inputs[c] = asked[c];
                asked[c] = new_one;
            }
        }
        sample(packed, now->point, now->point + chunk, now->point, asks ? asked : NULL);
        if (other) {
            if (!now->exchanged && exchange(packed) != OK) {
                done = false;
                break;
            }
            sample(packed, now->point, now->point + 1, now->point, asks ? asked : NULL);
            follow_step(packed, before, step);
        }
        int64_t from = now->point, end = from + chunk;
        done = loop_run(&packed->loop, from, end, now->exchanged);
        while (!done && packed->loop.failed_at_step && finish_step(packed)) { /* the others go on from there */
            from = packed->loop.point + 1;
            done = loop_run(&packed->loop, from, end, false);
        }
        packed->loop.per_second = 1.0 / step;
        int64_t reached = done ? end : packed->loop.point;
        for (int32_t c = 0; c < packed->n_columns; c++) { /* where linear inputs have arrived */
            if (asks) packed->inputs[c] = asked[c];
            else if (packed->columns[c].is_real && packed->rates[c] != 0.0)
                packed->inputs[c] += (double)(reached - now->point) * step * packed->rates[c];
        }
        now->point = reached;
        now->exchanged = false;
        now->reached = now->origin + (double)reached * step;
    }
    if (asked != next) free(asked);
    return done;
}

Status packed_do_step(Packed *packed, double time, double step) {
    Progress *now = &packed->now;
    now->discarded = now->wants_to_end = now->said = false;
    if (!isfinite(time) || !(step > 0.0 && isfinite(time + step)))
        return packed_fail(packed, FAILURE, "communication step %g s at %g s is not positive and finite", step, time);
    double exact = step / now->max_step;
    if (!(step > now->max_step * (1.0 + same))) exact = 1.0; /* longer by rounding only: that stays one step */
    if (exact > most_internal_steps)
        return packed_fail(
            packed, DISCARD,
            "communication step %g s needs %.4g internal steps; make it shorter, or max_step (%g s) longer", step,
            exact, now->max_step);
    int n = (int)ceil(exact - same);
    double h = without_rounding(packed, time, step, n), before = now->begun ? now->step : h;
    go_on_from(packed, time, h);
    if (now->exchanged && now->stale) { /* by the grid that the exchange was made on */
        Status status = exchange(packed);
        if (status != OK) return status;
    }
    place_loop(packed);
    packed->warned = false;
    if (!step_internally(packed, n, h, before)) {
        if (now->phase == FAILED) return FAILURE; /* it has been said */
        Status status = DISCARD;
        if (now->said || now->wants_to_end) status = now->discarded ? DISCARD : FAILURE;
        else if (packed->loop.failed_at_step)
            status = loop_failed(packed, packed->at_step, packed->n_at_start + packed->n_at_point);
        else status = loop_failed(packed, packed->at_point, packed->n_at_start);
        now->phase = FAILED;
        now->discarded = status == DISCARD;
        return status;
    }
    for (int32_t c = 0; c < packed->n_columns; c++) packed->rates[c] = 0.0;
    now->time = now->reached = time + step;
    now->stale = false;
    return packed->warned ? WARNING : OK;
}
