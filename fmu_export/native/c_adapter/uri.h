/* Where importers say that the resources are, and how to open a file there. */
#ifndef URI_H
#define URI_H

#include <stdio.h>

#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility push(hidden) /* an FMU exports the functions of the standard only, whoever compiles it */
#endif

/* Decode a file URI (file:///path, file:/path, percent escapes) or take a plain path; NULL when out of memory. */
char *path_of_uri(const char *uri);

/* Open a file for reading; its path is UTF-8. */
FILE *open_text(const char *path);

#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility pop
#endif

#endif
