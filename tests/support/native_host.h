/* What hosts count and expect, whatever the FMI version. */
#ifndef NATIVE_HOST_H
#define NATIVE_HOST_H

#include <stdio.h>
#include <string.h>

static long calls, failures, messages;
static int percent_allowed; /* paths may hold percent signs */
static int foreign_allowed; /* and other characters than ASCII */
static char last_message[4096];

static void expect(int holds, const char *what, const char *where, int phase, int status) {
    if (holds) return;
    failures++;
    printf("%s: %s (phase %d, status %d, last message: %s)\n", where, what, phase, status, last_message);
}

static int same(double a, double b) { return !memcmp(&a, &b, sizeof a); }

#endif
