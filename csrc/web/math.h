/* The mathematics that law.c and the loop need, for a compiler without a library. Each is one instruction of
 * WebAssembly, or two comparisons; nothing comes from the browser, so that every browser gives the same bits. */
#ifndef FRACLINK_WEB_MATH_H
#define FRACLINK_WEB_MATH_H

#define fabs __builtin_fabs
#define floor __builtin_floor
#define nearbyint __builtin_nearbyint
#define copysign __builtin_copysign
#define isfinite __builtin_isfinite
#define NAN __builtin_nanf("")

double exp(double), sin(double), cos(double); /* declared for complex_pair.h, of which the loop uses products and sums */

/* As in C's library: a NaN gives way to a number. */
static inline double fmin(double a, double b)
{
    return a != a || b < a ? b : a;
}

static inline double fmax(double a, double b)
{
    return a != a || b > a ? b : a;
}

#endif
