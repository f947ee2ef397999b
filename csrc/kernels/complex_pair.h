#ifndef FRACLINK_COMPLEX_PAIR_H
#define FRACLINK_COMPLEX_PAIR_H

#include <math.h>

/* Complex arithmetic of our own: C guards every product against infinities, which costs more than the product. */
typedef struct {
    double re, im;
} cx;

static inline cx add(cx a, cx b) { return (cx){a.re + b.re, a.im + b.im}; }
static inline cx mul(cx a, cx b) { return (cx){a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re}; }
static inline cx scale(double k, cx a) { return (cx){k * a.re, k * a.im}; }
static inline cx invert(cx a) {
    double n = a.re * a.re + a.im * a.im;
    return (cx){a.re / n, -a.im / n};
}
static inline cx exponential(cx a) {
    double m = exp(a.re);
    return (cx){m * cos(a.im), m * sin(a.im)};
}

#endif
