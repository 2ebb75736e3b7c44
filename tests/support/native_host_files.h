/* Files that an FMU reads, intact, broken and elsewhere: the same for both FMI versions.
 *
 * Who includes it has the phase INST, ERROR, CO_SIMULATION and MODEL_EXCHANGE, the functions instantiate, at,
 * observe_start, observe, reset and free_instance, and SCHEME, which stands before a path. */
#ifndef NATIVE_HOST_FILES_H
#define NATIVE_HOST_FILES_H

#include <locale.h>
#include <stdlib.h>

#include "native_host.h"

/* The start values file, broken */

static char *text_of_start_values(void) {
    char path[4096], *text = calloc(1, 100000);
    snprintf(path, sizeof path, "%s/good/start_values.txt", folder);
    FILE *file = fopen(path, "rb");
    if (!file || !fread(text, 1, 99999, file)) exit(2);
    fclose(file);
    return text;
}

static void try_start_values(const char *text, size_t length, int works, const char *what) {
    char path[4096], uri[4096];
    snprintf(path, sizeof path, "%s/broken/start_values.txt", folder);
    snprintf(uri, sizeof uri, "%s%s/broken", SCHEME, folder);
    FILE *file = fopen(path, "wb");
    fwrite(text, 1, length, file);
    fclose(file);
    long logged = messages;
    void *c = instantiate(CO_SIMULATION, "one", uri);
    expect(!c == !works, works ? "not read" : "read", what, 0, 0);
    expect((messages > logged) == !c, "a failure without a message, or the reverse", what, 0, 0);
    if (c && works) {
        void *reference = at(INST, CO_SIMULATION, "other");
        double a[N_PU + 1], b[N_PU + 1];
        observe_start(c, a);
        observe_start(reference, b);
        for (int i = 0; i <= N_PU; i++) expect(same(a[i], b[i]), "another value is read", what, 0, i);
        free_instance(reference);
        file = fopen(path, "wb"); /* the file breaks under a living instance */
        fclose(file);
        calls++;
        expect(reset(c) == ERROR, "reset without start values", what, 0, 0);
        observe(c, b);
        for (int i = 0; i <= N_PU; i++) expect(same(a[i], b[i]), "a failed reset changes values", what, 0, i);
    }
    free_instance(c);
}

/* The file with the number in the first line replaced, and something between the lines. */
static void try_first_value(const char *good_text, const char *value, int works, const char *what) {
    char *text = malloc(200000);
    const char *separator = strstr(good_text, " = "), *end = strchr(good_text, '\n');
    int n = snprintf(text, 200000, "%.*s = %s%s", (int)(separator - good_text), good_text, value, end);
    try_start_values(text, (size_t)n, works, what);
    free(text);
}

static void check_start_values(void) {
    char *text = text_of_start_values(), *other = malloc(300000), *line = strchr(text, '\n') + 1, first[256],
         value[300];
    size_t n = strlen(text), m = 0;
    sprintf(first, "%.*s", (int)(line - 1 - strstr(text, " = ") - 3), strstr(text, " = ") + 3);
    try_start_values(text, n, 1, "an intact file");
    try_start_values(text, 0, 0, "an empty file");
    try_start_values(text, n - 1, 1, "no newline at the end");
    try_start_values(text, n / 2, 0, "half a file");
    try_start_values(line, n - (size_t)(line - text), 0, "a missing name");
    try_start_values("\n", 1, 0, "an empty line");
    for (const char *c = text; *c; c++) {
        if (*c == '\n') other[m++] = '\r';
        other[m++] = *c;
    }
    try_start_values(other, m, 1, "CRLF line ends");
    unsigned random = 1u;
    for (m = 0; m < 5000; m++) other[m] = (char)((random = random * 1664525u + 1013904223u) >> 24);
    percent_allowed = 1;
    try_start_values(other, m, 0, "binary junk");
    percent_allowed = 0;
    memset(other, 'a', 10240);
    try_start_values(other, 10240, 0, "a long line of letters");
    memset(other, 0, 4096);
    try_start_values(other, 4096, 0, "zero bytes");
    memset(other, 'a', 10240);
    other[10239] = '\n';
    memcpy(other + 10240, text, n);
    try_start_values(other, 10240 + n, 0, "a long line before the values");
    sprintf(other, "%s%s", first, "                    ");
    memset(other + strlen(other), ' ', 10240);
    other[10240] = '\0';
    try_first_value(text, other, 0, "10 kB of blanks after a number");
    memset(other, '1', 10240);
    try_first_value(text, other, 0, "a number of 10 kB");
    static const char *const wrong[] = {"nan",    "NAN", "inf",     "-inf", "1e999", "-1e999", "",       "abc",
                                        "1.5abc", "1,5", "1.5 2.5", "--1",  "%s%n",  "=",      "1.5 = 2"};
    for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
        percent_allowed = 1;
        try_first_value(text, wrong[i], 0, wrong[i]);
        percent_allowed = 0;
    }
    snprintf(value, sizeof value, "  %s \t", first);
    try_first_value(text, value, 1, "blanks around a number");
    try_first_value(text, first, 1, "the same number");
    snprintf(other, 300000, "no_such_name = 1.0\n%s", text);
    try_start_values(other, strlen(other), 1, "an unknown name"); /* a newer file in an older FMU */
    static const char *const commas[] = {"de_DE.UTF-8", "de_DE.utf8", "de_DE", "fr_FR.UTF-8",
                                         "fr_FR.utf8",  "German",     "French"};
    size_t k = 0;
    while (k < sizeof commas / sizeof *commas && !setlocale(LC_NUMERIC, commas[k])) k++;
    if (k < sizeof commas / sizeof *commas && *localeconv()->decimal_point == ',') {
        printf("with a decimal comma (%s)\n", commas[k]);
        try_first_value(text, "1,5", 0, "a decimal comma in a locale with one");
        void *c = at(INST, CO_SIMULATION, "one");
        double comma[N_PU + 1], point[N_PU + 1];
        observe_start(c, comma);
        setlocale(LC_NUMERIC, "C");
        LEGAL(reset(c));
        observe_start(c, point);
        for (int i = 0; i <= N_PU; i++)
            expect(same(comma[i], point[i]), "the locale changes start values", "setlocale", INST, i);
        free_instance(c);
    } else {
        printf("no locale with a decimal comma here\n");
    }
    free(other);
    free(text);
}

/* Resources at places good and bad */

typedef struct {
    const char *head, *tail;
    int works;
} Place;

static void try_places(const Place places[], size_t n) {
    percent_allowed = foreign_allowed = 1;
    for (size_t i = 0; i < n; i++) {
        char place[4096];
        snprintf(place, sizeof place, "%s%s%s", places[i].head, folder, places[i].tail);
        long logged = messages;
        void *c = instantiate(MODEL_EXCHANGE, "one", place);
        expect(!c == !places[i].works, "a wrong folder", place, 0, 0);
        expect((messages > logged) == !c, "a failure without a message, or the reverse", place, 0, 0);
        free_instance(c);
    }
    percent_allowed = foreign_allowed = 0;
}

/* Nowhere at all, and paths so long that buffers end. */
static void try_no_places(const char *const places[], size_t n) {
    percent_allowed = foreign_allowed = 1;
    for (size_t i = 0; i < n; i++)
        expect(!instantiate(CO_SIMULATION, "one", places[i]), "an instance from nowhere", places[i], 0, 0);
    static const int lengths[] = {4000, 4070, 4078, 4079, 4080, 4081, 4094, 4095, 4096, 5000, 100000};
    for (size_t i = 0; i < sizeof lengths / sizeof *lengths; i++) {
        static const char filling[] = {'/', 'a', '%'};
        size_t length = (size_t)lengths[i];
        char *path = malloc(length + 1);
        path[length] = '\0';
        for (size_t k = 0; k < sizeof filling; k++) {
            memset(path, filling[k], length);
            if (filling[k] == '%') memcpy(path, SCHEME, strlen(SCHEME));
            expect(!instantiate(CO_SIMULATION, "one", path), "an instance from a long path", "long path", lengths[i],
                   0);
        }
        free(path);
    }
    percent_allowed = foreign_allowed = 0;
}

#endif
