/* What the adapter takes from C's library, where there is none: WebAssembly has no system below it. */
#ifndef FREESTANDING_H
#define FREESTANDING_H

#include <stdarg.h>
#include <stddef.h>

/* Numbers: each of these functions has one right result, and but for fmod is one instruction. */
typedef float float_t;
typedef double double_t;
#define INFINITY (__builtin_inf())
#define NAN (__builtin_nan(""))
#define isfinite(x) __builtin_isfinite(x)
#define isnan(x) __builtin_isnan(x)
#define signbit(x) __builtin_signbit(x)
static inline double ceil(double x) { return __builtin_ceil(x); }
static inline double copysign(double x, double y) { return __builtin_copysign(x, y); }
static inline double fabs(double x) { return __builtin_fabs(x); }
static inline double floor(double x) { return __builtin_floor(x); }
static inline double fmax(double x, double y) { return isnan(x) || x < y ? y : x; }
static inline double fmin(double x, double y) { return isnan(x) || y < x ? y : x; }
static inline double sqrt(double x) { return __builtin_sqrt(x); }
double fmod(double x, double y);

/* Bytes and texts. */
void *memcpy(void *restrict to, const void *restrict from, size_t n);
void *memmove(void *to, const void *from, size_t n);
void *memset(void *to, int value, size_t n);
int memcmp(const void *a, const void *b, size_t n);
char *strcpy(char *restrict to, const char *restrict from);
int strcmp(const char *a, const char *b);
size_t strlen(const char *text);

/* Write a text as C's function of this name does, of the conversions s, c, d, u, lu, zu, g and their precisions. */
int vsnprintf(char *restrict to, size_t size, const char *restrict format, va_list arguments);

/* Memory that is never given back: an instance is a module of its own, whose memory goes with it. */
void *malloc(size_t size);
void free(void *block);

/* Called by what reads texts, which no module keeps, as its start values are numbers. */
extern int errno;
long strtol(const char *text, char **end, int base);

#endif
