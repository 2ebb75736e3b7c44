/* Where importers say that the resources are, and how to open a file there. */
#ifndef URI_H
#define URI_H

#include <stdio.h>

/* Decode a file URI (file:///path, file:/path, percent escapes) or take a plain path; NULL when out of memory. */
char *path_of_uri(const char *uri);

/* Open a file for reading; its path is UTF-8. */
FILE *open_text(const char *path);

#endif
