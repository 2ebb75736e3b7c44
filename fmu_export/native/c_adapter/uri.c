#include "uri.h"

#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#include <windows.h>

FILE *open_text(const char *path) {
    /* fopen would take the path for text in the code page of the system, but FMI's strings are UTF-8 */
    wchar_t wide[4096];
    return MultiByteToWideChar(CP_UTF8, MB_ERR_INVALID_CHARS, path, -1, wide, 4096) ? _wfopen(wide, L"r") : NULL;
}
#else
FILE *open_text(const char *path) { return fopen(path, "r"); }
#endif

static int hexadecimal(char c) {
    if (c >= '0' && c <= '9') return c - '0';
    if (c >= 'a' && c <= 'f') return c - 'a' + 10;
    if (c >= 'A' && c <= 'F') return c - 'A' + 10;
    return -1;
}

char *path_of_uri(const char *uri) {
    int escaped = !strncmp(uri, "file:", 5);
    if (escaped) {
        uri += 5;
        if (!strncmp(uri, "//", 2)) {
            uri += 2;
            while (*uri && *uri != '/') uri++; /* the host, which is this one */
        }
    }
    char *path = malloc(strlen(uri) + 1), *end = path;
    if (!path) return NULL;
    while (*uri) {
        int high = escaped && *uri == '%' ? hexadecimal(uri[1]) : -1;
        int low = high >= 0 ? hexadecimal(uri[2]) : -1;
        if (low >= 0 && high + low > 0) { /* %00 would end the path */
            *end++ = (char)(16 * high + low);
            uri += 3;
        } else {
            *end++ = *uri++;
        }
    }
    *end = '\0';
#ifdef _WIN32
    if (escaped && path[0] == '/' && path[1] && (path[2] == ':' || path[2] == '|')) { /* /C:/... */
        path[2] = ':';
        memmove(path, path + 1, strlen(path));
    }
#endif
    return path;
}
