/* Folder behind the resource location of an FMU. */
#ifndef URI_H
#define URI_H

/* Decode a file URI (file:///path, file:/path, percent escapes) or take a plain path; NULL when out of memory. */
char *path_of_uri(const char *uri);

#endif
