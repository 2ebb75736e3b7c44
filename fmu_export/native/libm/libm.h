/* What the files of musl in this folder need of musl's header of this name; written for this project.
 *
 * Functions get names of their own: a compiler takes the standard's names for functions that it knows, and may
 * compute them itself. Square roots, absolute values and the like are exact everywhere and stay those of the platform.
 * No fused multiply-add, on whatever machine: results are the same everywhere. */
#ifndef LIBM_H
#define LIBM_H

#include <float.h>
#include <math.h>
#include <stdint.h>

#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(_MSC_VER)
#pragma fp_contract(off)
#endif
#undef __FP_FAST_FMA

#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wparentheses"
#endif

#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility push(hidden)
#endif

#define acos libm_acos
#define acosh libm_acosh_from_one /* see acosh_domain */
#define asin libm_asin
#define asinh libm_asinh
#define atan libm_atan
#define atan2 libm_atan2
#define atanh libm_atanh
#define cosh libm_cosh
#define exp libm_exp
#define expm1 libm_expm1
#define hypot libm_hypot
#define log libm_log
#define log1p libm_log1p
#define pow libm_pow
#define sinh libm_sinh
#define tan libm_tan
#define tanh libm_tanh
#define __cos libm_cos_kernel
#define __exp_data libm_exp_data
#define __expo2 libm_expo2
#define __log_data libm_log_data
#define __math_divzero libm_divzero
#define __math_invalid libm_invalid
#define __math_oflow libm_oflow
#define __math_uflow libm_uflow
#define __math_xflow libm_xflow
#define __pow_log_data libm_pow_log_data
#define __rem_pio2 libm_rem_pio2
#define __rem_pio2_large libm_rem_pio2_large
#define __tan libm_tan_kernel

double acos(double), acosh(double), asin(double), asinh(double), atan(double), atan2(double, double), atanh(double);
double cosh(double), exp(double), expm1(double), hypot(double, double), log(double), log1p(double);
double pow(double, double), sinh(double), tan(double), tanh(double);
double __expo2(double, double), __tan(double, double, int);
double __math_divzero(uint32_t), __math_invalid(double), __math_oflow(uint32_t), __math_uflow(uint32_t);
double __math_xflow(uint32_t, double);
int __rem_pio2(double, double *), __rem_pio2_large(double *, double *, int, int, int);

#define hidden
#define WANT_ROUNDING 1
#define TOINT_INTRINSICS 0
#define issignaling_inline(x) 0
#define predict_true(x) (x)
#define predict_false(x) (x)

union libm_word {
    double value;
    uint64_t bits;
};

static inline uint64_t asuint64(double value) {
    union libm_word word;
    word.value = value;
    return word.bits;
}

static inline double asdouble(uint64_t bits) {
    union libm_word word;
    word.bits = bits;
    return word.value;
}

static inline double eval_as_double(double value) { return value; }

static inline double fp_barrier(double value) {
    volatile double kept = value;
    return kept;
}

static inline void fp_force_eval(double value) {
    volatile double kept = value;
    (void)kept;
}

#define FORCE_EVAL(x) fp_force_eval((double)(x))
#define GET_HIGH_WORD(high, x) ((high) = (uint32_t)(asuint64(x) >> 32))
#define GET_LOW_WORD(low, x) ((low) = (uint32_t)asuint64(x))
#define EXTRACT_WORDS(high, low, x) (GET_HIGH_WORD(high, x), GET_LOW_WORD(low, x))
#define INSERT_WORDS(x, high, low) ((x) = asdouble((uint64_t)(high) << 32 | (uint32_t)(low)))
#define SET_HIGH_WORD(x, high) INSERT_WORDS(x, high, (uint32_t)asuint64(x))
#define SET_LOW_WORD(x, low) ((x) = asdouble((asuint64(x) & 0xffffffff00000000) | (uint32_t)(low)))

#endif
