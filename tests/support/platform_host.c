/* An importer on Windows: loads the library of an FMU, makes 1000 steps of 1 ms in co-simulation, prints outputs.
 *
 * Usage: host VERSION LIBRARY RESOURCES TOKEN [REFERENCE=VALUE | REFERENCE]...
 * VERSION is that of FMI, 2 or 3; RESOURCES a URI for 2 and a path for 3, handed over in UTF-8 as the standards demand.
 * Inputs get their VALUE before the initialisation; the other references are printed at the end, one a line. */
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <windows.h>

#include "fmi2FunctionTypes.h"
#include "fmi3FunctionTypes.h"

enum { MOST = 64, STEPS = 1000 };

static HMODULE library;
static unsigned inputs[MOST], outputs[MOST];
static double input_values[MOST], output_values[MOST];
static size_t n_inputs, n_outputs;

static void stop(const char *what) {
    fprintf(stderr, "%s failed\n", what);
    exit(1);
}

static FARPROC find(const char *name) {
    FARPROC found = GetProcAddress(library, name);
    if (!found) stop(name);
    return found;
}

/* The types of the functions are those of the standard's headers. */
#define FUNCTION(name) ((name##TYPE *)(void (*)(void))find(#name))
#define CALL(name, ...) \
    if (FUNCTION(name)(__VA_ARGS__)) stop(#name)

static void log_fmi2(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                     fmi2String format, ...) {
    va_list arguments;
    (void)environment, (void)name, (void)status, (void)category;
    va_start(arguments, format);
    vfprintf(stderr, format, arguments);
    va_end(arguments);
    fputc('\n', stderr);
}

static void log_fmi3(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category, fmi3String message) {
    (void)environment, (void)status, (void)category;
    fprintf(stderr, "%s\n", message);
}

static void run2(const char *resources, const char *token) {
    const fmi2CallbackFunctions callbacks = {log_fmi2, calloc, free, NULL, NULL};
    fmi2Component c =
        FUNCTION(fmi2Instantiate)("x", fmi2CoSimulation, token, resources, &callbacks, fmi2False, fmi2False);
    if (!c) stop("fmi2Instantiate");
    CALL(fmi2SetReal, c, inputs, n_inputs, input_values);
    CALL(fmi2SetupExperiment, c, fmi2False, 0.0, 0.0, fmi2False, 0.0);
    CALL(fmi2EnterInitializationMode, c);
    CALL(fmi2ExitInitializationMode, c);
    for (int i = 0; i < STEPS; i++) CALL(fmi2DoStep, c, i * 1e-3, 1e-3, fmi2True);
    CALL(fmi2GetReal, c, outputs, n_outputs, output_values);
    CALL(fmi2Terminate, c);
    FUNCTION(fmi2FreeInstance)(c);
}

static void run3(const char *resources, const char *token) {
    fmi3Boolean event, terminate, early;
    fmi3Float64 time;
    fmi3Instance c = FUNCTION(fmi3InstantiateCoSimulation)("x", token, resources, fmi3False, fmi3False, fmi3False,
                                                           fmi3False, NULL, 0, NULL, log_fmi3, NULL);
    if (!c) stop("fmi3InstantiateCoSimulation");
    CALL(fmi3SetFloat64, c, inputs, n_inputs, input_values, n_inputs);
    CALL(fmi3EnterInitializationMode, c, fmi3False, 0.0, 0.0, fmi3False, 0.0);
    CALL(fmi3ExitInitializationMode, c);
    for (int i = 0; i < STEPS; i++) CALL(fmi3DoStep, c, i * 1e-3, 1e-3, fmi3True, &event, &terminate, &early, &time);
    CALL(fmi3GetFloat64, c, outputs, n_outputs, output_values, n_outputs);
    CALL(fmi3Terminate, c);
    FUNCTION(fmi3FreeInstance)(c);
}

static char *utf8(const wchar_t *text) {
    int size = WideCharToMultiByte(CP_UTF8, 0, text, -1, NULL, 0, NULL, NULL);
    char *bytes = malloc((size_t)size);
    if (!bytes || !WideCharToMultiByte(CP_UTF8, 0, text, -1, bytes, size, NULL, NULL)) stop("UTF-8");
    return bytes;
}

int wmain(int argc, wchar_t *argv[]) {
    if (argc < 5 || argc - 5 > MOST) stop("usage");
    library = LoadLibraryW(argv[2]);
    if (!library) stop("LoadLibraryW");
    char *resources = utf8(argv[3]), *token = utf8(argv[4]);
    for (int i = 5; i < argc; i++) {
        wchar_t *end;
        unsigned reference = wcstoul(argv[i], &end, 10);
        if (*end == L'=') {
            inputs[n_inputs] = reference;
            input_values[n_inputs++] = wcstod(end + 1, NULL);
        } else {
            outputs[n_outputs++] = reference;
        }
    }
    if (argv[1][0] == L'2') run2(resources, token);
    else run3(resources, token);
    for (size_t i = 0; i < n_outputs; i++) printf("%.17g\n", output_values[i]);
    free(resources), free(token);
    return !FreeLibrary(library);
}
