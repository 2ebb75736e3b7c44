/* Start values and other numbers in the text files among the resources. */
#include "core.h"
#include "uri.h"

#include <locale.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int core_read_number(char *text, double *value) {
    char *end, *point = strchr(text, '.');
    const char *local = localeconv()->decimal_point;
    if (strchr(text, ',')) return 0;
    if (point && strlen(local) == 1) *point = *local;
    *value = strtod(text, &end);
    return end > text && !end[strspn(end, " \t\r\n")] && isfinite(*value);
}

/* Read a value of a variable that is not a real. */
static int read_other(int i, const char *text, double *value) {
#if N_TYPED > 0
    return core_read_value((size_t)i, text, value);
#else
    (void)i, (void)text, (void)value;
    return 0;
#endif
}

CoreStatus core_read_start_values(Core *core, double values[]) {
    char path[4096], line[256], buffer[4096];
    int found[N_PU + 1] = {0};
    if (snprintf(path, sizeof path, "%s/start_values.txt", core->resources) >= (int)sizeof path)
        return core_fail(core, CORE_ERROR, "the path of the resources is too long: %.100s...", core->resources);
    FILE *file = open_text(path);
    if (!file) return core_fail(core, CORE_ERROR, "start values can't be read: %s is missing or unreadable", path);
    setvbuf(file, buffer, _IOFBF, sizeof buffer); /* a buffer on the heap would come to lie between two instances */
    CoreStatus status = CORE_OK;
    while (status == CORE_OK && fgets(line, sizeof line, file)) {
        char *separator = strstr(line, " = ");
        double value;
        int i = 0, reads = 0;
        line[strcspn(line, "\r\n")] = '\0';
        if (separator) {
            *separator = '\0';
            while (i < N_PU && strcmp(line, model_names[i])) i++;
            reads = i == N_PU || IS_REAL(i) ? core_read_number(separator + 3, &value)
                                            : read_other(i, separator + 3, &value);
            *separator = ' ';
        }
        if (!reads) {
            for (char *c = line; *c; c++)
                if (*c < ' ' || *c > '~') *c = '?'; /* messages are text, whatever the file is */
            status = core_fail(core, CORE_ERROR, "start values can't be read: '%s' in %s is not 'name = %s'", line,
                               path, i == N_PU || IS_REAL(i) ? "number" : "value");
        } else if (i < N_PU) {
            values[i] = value;
            found[i] = 1;
        }
    }
    fclose(file);
    for (int i = 0; status == CORE_OK && i < N_PU; i++)
        if (!found[i])
            status =
                core_fail(core, CORE_ERROR, "start values can't be read: '%s' is missing in %s", model_names[i], path);
    return status;
}
