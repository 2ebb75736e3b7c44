/* Sine and cosine of many angles at once, with the same bits from every compiler: sums and products only, and no
 * branches, so that compilers compute several angles in one instruction. Both are within 1 ulp. */
#ifndef SINES_H
#define SINES_H

#include <stdint.h>
#include <string.h>

/* Once in a program: as many copies as callers would take longer to compile and no less to run. */
#if defined(__GNUC__)
#define SINES_APART __attribute__((noinline))
#else
#define SINES_APART
#endif

static inline uint64_t bits_of(double x) {
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}

static inline double from_bits(uint64_t bits) {
    double x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

/* Sine and cosine of quarter * pi/2 + r - d, where |r| is at most pi/4, and d less than the last digit of 1.
 * The coefficients of both polynomials are the minimax ones of their relative errors, 0.04 ulp and less. */
static inline void sine_and_cosine(uint64_t quarter, double r, double d, double *s, double *c) {
    double z = r * r, zz = z * z, half = 0.5 * z, rest = 1.0 - half;
    double p = 0x1.5555555555548p-3 + z * -0x1.111111110f755p-7;
    p += zz * (0x1.a01a019bf0d57p-13 + z * -0x1.71de355dd2fbcp-19 +
               zz * (0x1.ae5e53835df3cp-26 + z * -0x1.5d8df1fe4ede8p-33));
    double q = 0x1.555555555554bp-5 + z * -0x1.6c16c16c15014p-10;
    q += zz * (0x1.a01a019c8ef76p-16 + z * -0x1.27e4f7f16370bp-22 +
               zz * (0x1.1ee9dba86e836p-29 + z * -0x1.8fa66d3c32877p-37));
    uint64_t sine = bits_of(r - (r * (z * p) + d * rest));
    uint64_t cosine = bits_of(rest + ((1.0 - rest) - half + (zz * q + r * d)));
    uint64_t odd = 0 - (quarter & 1), swapped = (sine ^ cosine) & odd;
    *s = from_bits(sine ^ swapped ^ (quarter & 2) << 62);
    *c = from_bits(cosine ^ swapped ^ ((quarter + 1) & 2) << 62);
}

/* Of one angle of any size: its quarter turns are a product of integers, as Payne and Hanek 1983 proposed. */
SINES_APART static void sine_and_cosine_of_large(double x, double *s, double *c) {
    /* 64 zeros, then the digits of 2/pi after the point */
    static const uint32_t digits[] = {
        0x00000000, 0x00000000, 0xa2f9836e, 0x4e441529, 0xfc2757d1, 0xf534ddc0, 0xdb629599, 0x3c439041, 0xfe5163ab,
        0xdebbc561, 0xb7246e3a, 0x424dd2e0, 0x06492eea, 0x09d1921c, 0xfe1deb1c, 0xb129a73e, 0xe88235f5, 0x2ebb4484,
        0xe99c7026, 0xb45f7e41, 0x3991d639, 0x835339f4, 0x9c845f8b, 0xbdf9283b, 0x1ff897ff, 0xde05980f, 0xef2f118b,
        0x5a0a6d1f, 0x6d367ecf, 0x27cb09b7, 0x4f463f66, 0x9e5fea2d, 0x7527bac7, 0xebe5f17b, 0x3d0739f7, 0x8a5292ea,
        0x6bfb5fb1, 0x1f8d5d08, 0x56033046, 0xfc7b6bab, 0xf0cfbc20, 0x9af4361d};
    const double pi_half = 0x1.921fb54442d18p+0, pi_more = 0x1.1a62633145c07p-54;
    const double pi_high = 0x1.921fb58p+0, pi_low = -0x1.dde974p-27; /* pi_half in two parts of few digits */
    uint64_t bits = bits_of(x), mantissa = (bits & 0xfffffffffffff) | 0x10000000000000, carry = 0, product;
    int exponent = (int)(bits >> 52 & 0x7ff);
    if (exponent == 0x7ff) {
        *s = *c = x - x;
        return;
    }
    /* |x| = mantissa * 2^(exponent - 1075); digits that stand for whole turns are left out */
    int from = exponent - 1075 + 62, word = from >> 5, shift = from & 31;
    uint32_t low = (uint32_t)mantissa, high = (uint32_t)(mantissa >> 32), turns[6];
    for (int k = 5; k >= 0; k--) {
        uint64_t two = (uint64_t)digits[word + k] << 32 | digits[word + k + 1];
        product = (uint64_t)(uint32_t)(two << shift >> 32) * low + carry;
        turns[k] = (uint32_t)product;
        carry = product >> 32;
    }
    carry = 0;
    for (int k = 5; k > 0; k--) {
        uint64_t two = (uint64_t)digits[word + k] << 32 | digits[word + k + 1];
        product = (uint64_t)(uint32_t)(two << shift >> 32) * high + turns[k - 1] + carry;
        turns[k - 1] = (uint32_t)product;
        carry = product >> 32;
    }
    /* two binary digits of quarter turns, then a part of one; from one half on it counts from the next */
    double part[5];
    for (int k = 0; k < 5; k++) part[k] = (double)(uint32_t)(turns[k] << 2 | turns[k + 1] >> 30);
    uint64_t quarter = (turns[0] >> 30) + (turns[0] >> 29 & 1);
    if (part[0] >= 0x1p31) part[0] -= 0x1p32;
    double first = part[0] * 0x1p-32, second = part[1] * 0x1p-64, both = first + second;
    double f = both + ((second - (both - first)) + (part[2] * 0x1p-96 + (part[3] * 0x1p-128 + part[4] * 0x1p-160)));
    double more =
        (both - f) + ((second - (both - first)) + (part[2] * 0x1p-96 + (part[3] * 0x1p-128 + part[4] * 0x1p-160)));
    /* f * pi/2 with what its rounding loses, after Dekker 1971 */
    double f_high = 134217729.0 * f, r = f * pi_half;
    f_high = f_high - (f_high - f);
    double f_low = f - f_high;
    double d = (((r - f_high * pi_high) - f_high * pi_low) - f_low * pi_high) - f_low * pi_low;
    d -= f * pi_more + more * pi_half;
    if (bits >> 63) {
        r = -r;
        d = -d;
        quarter = 0 - quarter;
    }
    sine_and_cosine(quarter & 3, r, d, s, c);
}

/* Sines s and cosines c of n angles a. */
SINES_APART static void sines(int n, const double a[], double s[], double c[]) {
    const double shift = 0x1.8p52; /* after its addition the last digits of a sum are whole numbers */
    uint64_t large = 0;
    for (int i = 0; i < n; i++) {
        /* pi/2 has three parts, of which two have few enough digits for exact products (Cody and Waite 1980) */
        double x = a[i], turns = x * 0x1.45f306dc9c883p-1 + shift, k = turns - shift;
        double near = x - k * 0x1.921fb5444p+0, part = k * 0x1.68c234c4cp-39, r = near - part;
        double lost = (near - (r - (r - near))) - (part + (r - near));
        sine_and_cosine(bits_of(turns) & 3, r, k * 0x1.98a2e03707345p-77 - lost, &s[i], &c[i]);
        large |= bits_of(0x1p15) - (bits_of(x) & 0x7fffffffffffffff);
    }
    if (large >> 63)
        for (int i = 0; i < n; i++)
            if ((bits_of(0x1p15) - (bits_of(a[i]) & 0x7fffffffffffffff)) >> 63)
                sine_and_cosine_of_large(a[i], &s[i], &c[i]);
}

#endif
