/* Components: their libraries, loaded by full path, and their instances of FMI 2.0 or 3.0. */
#include "packed.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi.h"
#include "uri.h"

#ifdef _WIN32
#include <windows.h>
#define PLATFORM_2 "win64"
#define SUFFIX ".dll"
#define SEPARATOR "\\"
#define THREAD_LOCAL __declspec(thread)
#elif defined(__APPLE__)
#include <dlfcn.h>
#define PLATFORM_2 "darwin64"
#define SUFFIX ".dylib"
#define SEPARATOR "/"
#define THREAD_LOCAL __thread
#else
#include <dlfcn.h>
#define PLATFORM_2 "linux64"
#define SUFFIX ".so"
#define SEPARATOR "/"
#define THREAD_LOCAL __thread
#endif

#if defined(__aarch64__) || defined(_M_ARM64)
#define PROCESSOR "aarch64-"
#else
#define PROCESSOR "x86_64-"
#endif

#ifdef _WIN32
#define PLATFORM_3 PROCESSOR "windows"
#elif defined(__APPLE__)
#define PLATFORM_3 PROCESSOR "darwin"
#else
#define PLATFORM_3 PROCESSOR "linux"
#endif

enum { LONGEST_PATH = 4096 };

/* Messages */

static THREAD_LOCAL Packed *current;

Packed *entered(Packed *packed) {
    Packed *before = current;
    current = packed;
    return before;
}

/* The component that a message is from: many FMUs pass what they were given, some only their name. */
static Component *speaker(void *environment, const char *name) {
    if (!current) return environment; /* from another thread */
    for (int32_t i = 0; i < current->n_components; i++)
        if (environment == &current->components[i]) return environment;
    for (int32_t i = 0; name && i < current->n_components; i++)
        if (!strcmp(current->components[i].name, name)) return &current->components[i];
    return NULL;
}

static void take(void *environment, const char *name, int status, const char *category, const char *text) {
    Component *component = speaker(environment, name);
    if (!text) text = "";
    if (!component) {
        if (current) packed_tell(current, (Status)status, category, text);
        return;
    }
    Packed *packed = component->packed;
    if (status > OK && status < PENDING) snprintf(component->said, sizeof component->said, "%s", text);
    if ((status <= OK || status >= PENDING) && !packed->logging) return;
    size_t length = strlen(component->name) + strlen(text) + 3;
    char *whole = malloc(length);
    if (!whole) return;
    snprintf(whole, length, "%s: %s", component->name, text);
    packed_tell(packed, (Status)status, category, whole);
    free(whole);
}

static void take_3(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category, fmi3String text) {
    take(environment, NULL, (int)status, category, text);
}

/* Libraries */

static void *open_library(const char *path) {
#ifdef _WIN32
    wchar_t wide[LONGEST_PATH];
    if (!MultiByteToWideChar(CP_UTF8, 0, path, -1, wide, LONGEST_PATH)) return NULL;
    for (wchar_t *c = wide; *c; c++)
        if (*c == L'/') *c = L'\\';
    return (void *)LoadLibraryExW(wide, NULL, LOAD_WITH_ALTERED_SEARCH_PATH);
#else
    return dlopen(path, RTLD_NOW | RTLD_LOCAL);
#endif
}

static void close_library(void *library) {
#ifdef _WIN32
    FreeLibrary((HMODULE)library);
#else
    dlclose(library);
#endif
}

static void *symbol(void *library, const char *name) {
#ifdef _WIN32
    return (void *)GetProcAddress((HMODULE)library, name);
#else
    return dlsym(library, name);
#endif
}

/* Why the last library could not be loaded. */
static void explain(char text[], size_t size) {
#ifdef _WIN32
    snprintf(text, size, "Windows error %lu", (unsigned long)GetLastError());
#else
    const char *why = dlerror();
    snprintf(text, size, "%s", why ? why : "the system does not say why");
#endif
}

static bool exists(const char *path) {
    FILE *file = open_text(path);
    if (file) fclose(file);
    return file != NULL;
}

/* The folder of its library for this machine, with a separator at its end; false where there is none. */
static bool folder_of_library(const Component *component, char path[]) {
    const char *platforms[] = {component->version == 3 ? PLATFORM_3 : PLATFORM_2,
                               component->version == 3 ? PLATFORM_2 : PLATFORM_3};
    for (int i = 0; i < 2; i++) {
        char library[LONGEST_PATH];
        int n = snprintf(path, LONGEST_PATH, "%s/%s/binaries/%s/", component->packed->folder, component->folder,
                         platforms[i]);
        if (n < LONGEST_PATH &&
            snprintf(library, sizeof library, "%s%s" SUFFIX, path, component->identifier) < LONGEST_PATH &&
            exists(library))
            return true;
    }
    return false;
}

bool component_load(Component *component) {
    char folder[LONGEST_PATH], path[2 * LONGEST_PATH], why[1024];
    log_to(take);
    if (!folder_of_library(component, folder)) {
        packed_fail(component->packed, FAILURE, "component '%s' has no library for this machine (%s, %s)",
                    component->name, PLATFORM_2, PLATFORM_3);
        return false;
    }
    snprintf(path, sizeof path, "%s%s" SUFFIX, folder, component->identifier);
    component->library = open_library(path);
    if (!component->library) explain(why, sizeof why);
    /* further libraries beside it are found on Windows only; elsewhere the loader takes those that are loaded already */
    for (int round = 0, loaded = 1; !component->library && loaded && round < component->n_beside; round++) {
        loaded = 0;
        for (int i = 0; i < component->n_beside; i++) {
            char beside[2 * LONGEST_PATH];
            snprintf(beside, sizeof beside, "%s%s", folder, component->beside[i]);
            if (!component->further[i] && exists(beside) && (component->further[i] = open_library(beside))) loaded = 1;
        }
        component->library = open_library(path);
    }
    if (component->library) return true;
    packed_fail(component->packed, FAILURE, "the library of component '%s' can't be loaded: %s", component->name, why);
    return false;
}

void component_unload(Component *component) {
    if (component->broken) return;
    if (component->library) close_library(component->library);
    component->library = NULL;
    for (int i = component->n_beside - 1; i >= 0; i--) {
        if (component->further[i]) close_library(component->further[i]);
        component->further[i] = NULL;
    }
}

/* A function of the library, NULL where it has none of that name. */
static void *find(Component *component, const char *name) {
    char longer[512];
    void *found = NULL;
    /* names begin with the model identifier in libraries of sources that were meant to be linked */
    if (snprintf(longer, sizeof longer, "%s_%s", component->identifier, name) < (int)sizeof longer)
        found = symbol(component->library, longer);
    return found ? found : symbol(component->library, name);
}

void *component_function(Component *component, const char *name) {
    void *found = find(component, name);
    if (!found)
        packed_fail(component->packed, FAILURE, "the library of component '%s' lacks the function %s", component->name,
                    name);
    return found;
}

/* Instances */

/* The address of its resources: a URI in FMI 2.0, a path in FMI 3.0. */
static char *resources_of(const Component *component) {
    const char *base = component->packed->folder;
    size_t room = 3 * (strlen(base) + strlen(component->folder)) + 64;
    char *found = malloc(room), *to = found;
    char *path = malloc(room);
    if (!found || !path) {
        free(found);
        free(path);
        return NULL;
    }
    if (component->version == 3) {
        snprintf(found, room, "%s" SEPARATOR "%s" SEPARATOR "resources" SEPARATOR, base, component->folder);
        free(path);
        return found;
    }
    snprintf(path, room, "%s/%s/resources", base, component->folder);
    to += snprintf(to, room, *path == '/' ? "file://" : "file:///");
    for (const char *c = path; *c; c++) {
        bool plain = (*c >= '0' && *c <= '9') || (*c >= 'a' && *c <= 'z') || (*c >= 'A' && *c <= 'Z') ||
                     strchr("-._~/", *c) || (*c == ':' && c == path + 1);
        if (plain) *to++ = *c;
        else if (*c == '\\') *to++ = '/';
        else to += snprintf(to, 4, "%%%02X", (unsigned)(unsigned char)*c);
    }
    *to = '\0';
    free(path);
    return found;
}

static void *instantiate_2(Component *component) {
    fmi2CallbackFunctions *callbacks = component->callbacks;
    if (!callbacks && !(callbacks = component->callbacks = malloc(sizeof *callbacks))) return NULL;
    *callbacks = (fmi2CallbackFunctions){(fmi2Logger *)log_message, calloc, free, NULL, component};
    fmi2Make *make = (fmi2Make *)component_function(component, "fmi2Instantiate");
    return make ? make(component->name, fmi2CoSimulation, component->token, component->resources, callbacks, fmi2False,
                       fmi2True)
                : NULL;
}

static void *instantiate_3(Component *component) {
    fmi3Make *make = (fmi3Make *)component_function(component, "fmi3InstantiateCoSimulation");
    fmi3IntermediateUpdate *ask = component->n_asks ? intermediate_update : NULL;
    return make ? make(component->name, component->token, component->resources, fmi3False, fmi3True, fmi3False,
                       fmi3False, component->asks, component->n_asks, component, take_3, ask)
                : NULL;
}

bool component_instantiate(Component *component) {
    component->said[0] = '\0';
    if (!component->resources && !(component->resources = resources_of(component))) return false;
    component->instance = component->version == 3 ? instantiate_3(component) : instantiate_2(component);
    if (!component->instance)
        packed_fail(component->packed, FAILURE, "component '%s' can't be instantiated: %s", component->name,
                    component->said[0] ? component->said : "it does not say why");
    return component->instance != NULL;
}

void component_free(Component *component) {
    if (component->instance && !component->broken) { /* after a fatal error no function may be called any more */
        void (*release)(void *) =
            (void (*)(void *))find(component, component->version == 3 ? "fmi3FreeInstance" : "fmi2FreeInstance");
        typedef int FreeState(void *, void **);
        FreeState *drop =
            (FreeState *)find(component, component->version == 3 ? "fmi3FreeFMUState" : "fmi2FreeFMUstate");
        if (component->kept && drop) drop(component->instance, &component->kept);
        if (release) release(component->instance);
    }
    component->instance = component->kept = NULL;
}

Status component_call(Component *component, const char *function2, const char *function3) {
    const char *name = component->version == 3 ? function3 : function2;
    Plain *function = (Plain *)component_function(component, name);
    if (!function) return FAILURE;
    return component_failed(component, (Status)function(component->instance), name);
}

Status component_failed(Component *component, Status status, const char *function) {
    static const char *const names[] = {"ok", "warning", "discard", "error", "fatal", "pending"};
    Packed *packed = component->packed;
    if (status == WARNING) packed->warned = true;
    if (status == OK || status == WARNING) return OK;
    if (status == FATAL) component->broken = true;
    const char *said = component->said[0] ? component->said : "";
    packed_fail(packed, status == DISCARD ? DISCARD : FAILURE, "component '%s': %s returned %s%s%s", component->name,
                function, status >= OK && status <= PENDING ? names[status] : "no status of FMI", *said ? ": " : "",
                said);
    component->said[0] = '\0';
    return status == DISCARD ? DISCARD : FAILURE;
}

Status component_reset(Component *component) { return component_call(component, "fmi2Reset", "fmi3Reset"); }

Status component_configure(Component *component, bool begin) {
    return begin ? component_call(component, "", "fmi3EnterConfigurationMode")
                 : component_call(component, "", "fmi3ExitConfigurationMode");
}

/* The tolerance that it is told: that of the importer, or else of its own default experiment. */
static double tolerance_of(const Component *component, bool *defined) {
    const Progress *now = &component->packed->now;
    *defined = now->has_tolerance || component->has_tolerance;
    return now->has_tolerance ? now->tolerance : *defined ? component->tolerance : 0.0;
}

Status component_set_up(Component *component) {
    const Progress *now = &component->packed->now;
    if (component->version == 3) return OK;
    fmi2SetUp *set_up = (fmi2SetUp *)component_function(component, "fmi2SetupExperiment");
    if (!set_up) return FAILURE;
    bool has_tolerance;
    double tolerance = tolerance_of(component, &has_tolerance);
    Status status = (Status)set_up(component->instance, has_tolerance, tolerance, now->time, now->has_stop,
                                   packed_told_stop(component));
    return component_failed(component, status, "fmi2SetupExperiment");
}

Status component_enter_initialization(Component *component) {
    const Progress *now = &component->packed->now;
    if (component->version == 2) return component_call(component, "fmi2EnterInitializationMode", "");
    fmi3EnterInitialization *enter =
        (fmi3EnterInitialization *)component_function(component, "fmi3EnterInitializationMode");
    if (!enter) return FAILURE;
    bool has_tolerance;
    double tolerance = tolerance_of(component, &has_tolerance);
    Status status = (Status)enter(component->instance, has_tolerance, tolerance, now->time, now->has_stop,
                                  packed_told_stop(component));
    return component_failed(component, status, "fmi3EnterInitializationMode");
}

Status component_exit_initialization(Component *component) {
    return component_call(component, "fmi2ExitInitializationMode", "fmi3ExitInitializationMode");
}

Status component_terminate(Component *component) { return component_call(component, "fmi2Terminate", "fmi3Terminate"); }
