#include "freestanding.h"

#include <stdint.h>

/* Bytes and texts. Compilers make one instruction of the first three. */

void *memcpy(void *restrict to, const void *restrict from, size_t n) { return __builtin_memcpy(to, from, n); }

void *memmove(void *to, const void *from, size_t n) { return __builtin_memmove(to, from, n); }

void *memset(void *to, int value, size_t n) { return __builtin_memset(to, value, n); }

int memcmp(const void *a, const void *b, size_t n) {
    const unsigned char *left = a, *right = b;
    for (; n; n--, left++, right++)
        if (*left != *right) return *left - *right;
    return 0;
}

size_t strlen(const char *text) {
    const char *end = text;
    while (*end) end++;
    return (size_t)(end - text);
}

char *strcpy(char *restrict to, const char *restrict from) { return memcpy(to, from, strlen(from) + 1); }

int strcmp(const char *a, const char *b) {
    for (; *a && *a == *b; a++, b++) continue;
    return (unsigned char)*a - (unsigned char)*b;
}

/* Memory */

extern unsigned char __heap_base; /* the linker's: where the module's own data end */
static uintptr_t end;             /* of what has been given */

void *malloc(size_t size) {
    const uintptr_t page = 65536;
    if (!end) end = ((uintptr_t)&__heap_base + 15) & ~(uintptr_t)15;
    uintptr_t block = end, room = __builtin_wasm_memory_size(0) * page;
    if (size > UINTPTR_MAX - page - 15 - block) return NULL;
    size = (size + 15) & ~(size_t)15;
    if (block + size > room && __builtin_wasm_memory_grow(0, (block + size - room + page - 1) / page) == (size_t)-1)
        return NULL;
    end = block + size;
    return (void *)block;
}

void free(void *block) { (void)block; }

/* Numbers */

/* Long division, in which each difference is exact. */
double fmod(double x, double y) {
    double rest = fabs(x), divisor = fabs(y), part = divisor;
    if (!isfinite(x) || isnan(y) || divisor == 0.0) return NAN;
    if (!isfinite(y)) return x;
    while (part <= rest - part) part += part;
    for (; part >= divisor; part *= 0.5)
        if (rest >= part) rest -= part;
    return copysign(rest, x);
}

enum { LIMBS = 90, LIMB = 1000000000, MOST_DIGITS = 9 * LIMBS };

/* Times a small number. */
static void multiply(uint32_t limbs[], int *n, uint32_t factor) {
    uint64_t carry = 0;
    for (int i = 0; i < *n; i++) {
        carry += (uint64_t)limbs[i] * factor;
        limbs[i] = (uint32_t)(carry % LIMB);
        carry /= LIMB;
    }
    if (carry) limbs[(*n)++] = (uint32_t)carry;
}

/* All digits of a finite positive number, which is 0.d d d ... times the power of ten that is returned. */
static int all_digits(double value, char digits[], int *n) {
    union {
        double value;
        uint64_t bits;
    } word = {value};
    int exponent = (int)(word.bits >> 52 & 0x7ff), size = 2, point = 0;
    uint64_t mantissa = word.bits & 0xfffffffffffff;
    if (exponent) mantissa |= 0x10000000000000;
    else exponent = 1;
    uint32_t limbs[LIMBS] = {(uint32_t)(mantissa % LIMB), (uint32_t)(mantissa / LIMB)};
    for (exponent -= 1075; exponent > 0; exponent--) multiply(limbs, &size, 2);
    for (; exponent < 0; exponent++, point--) multiply(limbs, &size, 5); /* a half is five tenths */
    *n = 0;
    for (int i = size - 1; i >= 0; i--)
        for (uint32_t unit = LIMB / 10; unit; unit /= 10) {
            char digit = (char)(limbs[i] / unit % 10);
            if (*n || digit) digits[(*n)++] = digit;
        }
    return point + *n;
}

/* Keep so many digits, rounded half to even; returns how many are left, without zeros at the end. */
static int round_digits(char digits[], int n, int kept, int *point) {
    if (n > kept) {
        int up = digits[kept] > 5 || (digits[kept] == 5 && kept > 0 && digits[kept - 1] & 1);
        for (int i = kept + 1; digits[kept] == 5 && i < n; i++) up |= digits[i] > 0;
        n = kept;
        if (up) {
            while (n && digits[n - 1] == 9) n--;
            if (n) digits[n - 1]++;
            else digits[n++] = 1, ++*point;
        }
    }
    while (n > 1 && !digits[n - 1]) n--;
    return n;
}

typedef struct {
    char *to;
    size_t size, length;
} Text;

static void put(Text *text, char c) {
    if (text->length + 1 < text->size) text->to[text->length] = c;
    text->length++;
}

static void put_text(Text *text, const char *c, int most) {
    for (; *c && most; c++, most--) put(text, *c);
}

static void put_whole(Text *text, unsigned long number, int least) {
    char digits[24];
    int n = 0;
    for (; number || n < least; number /= 10) digits[n++] = (char)('0' + number % 10);
    while (n) put(text, digits[--n]);
}

/* As the conversion g does. */
static void put_number(Text *text, double value, int precision) {
    char digits[MOST_DIGITS] = {0};
    int n = 1, point = 1;
    if (signbit(value)) put(text, '-');
    if (!isfinite(value)) {
        put_text(text, isnan(value) ? "nan" : "inf", -1);
        return;
    }
    if (precision == 0) precision = 1;
    if (value != 0.0) {
        point = all_digits(fabs(value), digits, &n);
        n = round_digits(digits, n, precision, &point);
    }
    int power = point - 1, scientific = power < -4 || power >= precision;
    int whole = scientific ? 1 : point, after = n - whole;
    if (whole <= 0) put(text, '0');
    for (int i = 0; i < whole; i++) put(text, (char)('0' + (i < n ? digits[i] : 0)));
    if (after > 0) put(text, '.');
    for (int i = whole; i < n; i++) put(text, (char)('0' + (i < 0 ? 0 : digits[i])));
    if (scientific) {
        put(text, 'e');
        put(text, power < 0 ? '-' : '+');
        put_whole(text, (unsigned long)(power < 0 ? -power : power), 2);
    }
}

int vsnprintf(char *restrict to, size_t size, const char *restrict format, va_list arguments) {
    Text text = {to, size, 0};
    for (const char *c = format; *c; c++) {
        if (*c != '%') {
            put(&text, *c);
            continue;
        }
        int precision = -1;
        if (*++c == '.')
            for (precision = 0; *++c >= '0' && *c <= '9';) precision = 10 * precision + (*c - '0');
        while (*c == 'l' || *c == 'z') c++; /* all of them have the size of an int here */
        if (*c == 's') {
            put_text(&text, va_arg(arguments, const char *), precision);
        } else if (*c == 'c') {
            put(&text, (char)va_arg(arguments, int));
        } else if (*c == 'd') {
            int number = va_arg(arguments, int);
            if (number < 0) put(&text, '-');
            put_whole(&text, number < 0 ? 0ul - (unsigned long)number : (unsigned long)number, 1);
        } else if (*c == 'u') {
            put_whole(&text, va_arg(arguments, unsigned), 1);
        } else if (*c == 'g') {
            put_number(&text, va_arg(arguments, double), precision < 0 ? 6 : precision);
        } else {
            put(&text, *c);
        }
    }
    if (size) to[text.length < size ? text.length : size - 1] = '\0';
    return (int)text.length;
}
