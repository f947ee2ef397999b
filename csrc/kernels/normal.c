/* Gaussian noise that depends on (seed, counter) only, so that a run can be repeated in any order of the runs.
 *
 * The counter is hashed (the finaliser of SplitMix64, Steele, Lea and Flood 2014) and the uniform number goes
 * through the inverse normal distribution (Wichura 1988, algorithm AS 241, relative error 1e-16). */
#include <math.h>

#include "clones.h"
#include "loop.h"

static uint64_t mixed(uint64_t z)
{
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ULL;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBULL;
    return z ^ (z >> 31);
}

static double ratio(double r, const double *top, const double *bottom)
{
    double a = top[7];
    double b = bottom[7];
    for (int i = 6; i >= 0; i--) {
        a = a * r + top[i];
        b = b * r + bottom[i];
    }
    return a / b;
}

#define MIDDLE 0.425 /* largest |p - 1/2| for the first of the three approximations */

static const double MIDDLE_TOP[8] = {3.3871328727963666080e0,  1.3314166789178437745e+2, 1.9715909503065514427e+3,
                            1.3731693765509461125e+4, 4.5921953931549871457e+4, 6.7265770927008700853e+4,
                            3.3430575583588128105e+4, 2.5090809287301226727e+3};
static const double MIDDLE_BOTTOM[8] = {1.0,
                            4.2313330701600911252e+1,
                            6.8718700749205790830e+2,
                            5.3941960214247511077e+3,
                            2.1213794301586595867e+4,
                            3.9307895800092710610e+4,
                            2.8729085735721942674e+4,
                            5.2264952788528545610e+3};

static double middle(double q)
{
    return q * ratio(0.180625 - q * q, MIDDLE_TOP, MIDDLE_BOTTOM);
}

/* The inverse normal distribution outside of the middle. */
static double tail(double p)
{
    static const double c[8] = {1.42343711074968357734e0,  4.63033784615654529590e0,  5.76949722146069140550e0,
                                3.64784832476320460504e0,  1.27045825245236838258e0,  2.41780725177450611770e-1,
                                2.27238449892691845833e-2, 7.74545014278341407640e-4};
    static const double d[8] = {1.0,
                                2.05319162663775882187e0,
                                1.67638483018380384940e0,
                                6.89767334985100004550e-1,
                                1.48103976427480074590e-1,
                                1.51986665636164571966e-2,
                                5.47593808499534494600e-4,
                                1.05075007164441684324e-9};
    static const double e[8] = {6.65790464350110377720e0,  5.46378491116411436990e0,  1.78482653991729133580e0,
                                2.96560571828504891230e-1, 2.65321895265761230930e-2, 1.24266094738807843860e-3,
                                2.71155556874348757815e-5, 2.01033439929228813265e-7};
    static const double f[8] = {1.0,
                                5.99832206555887937690e-1,
                                1.36929880922735805310e-1,
                                1.48753612908506148525e-2,
                                7.86869131145613259100e-4,
                                1.84631831751005468180e-5,
                                1.42151175831644588870e-7,
                                2.04426310338993978564e-15};
    const double r = sqrt(-log(p < 0.5 ? p : 1.0 - p));
    const double above = r <= 5.0 ? ratio(r - 1.6, c, d) : ratio(r - 5.0, e, f);
    return p < 0.5 ? -above : above;
}

/* Uniform number from a hash: 52 bits plus one half, symmetric about 1/2, and never 0 or 1, where the quantile is
 * infinite. */
static double uniform(uint64_t stream, uint64_t counter)
{
    const uint64_t bits = mixed(stream + (counter + 1) * 0x9E3779B97F4A7C15ULL);
    return ((double)(int64_t)(bits >> 12) + 0.5) * 0x1p-52;
}

/* The approximation for the middle for all numbers in vectors, then the tails, 15 in 100, one by one. */
FRACLINK_CLONES
void loop_normals(uint64_t seed, double *out, int64_t length)
{
    enum { BLOCK = 64 };
    const uint64_t stream = mixed(seed + 0x9E3779B97F4A7C15ULL);
    double p[BLOCK];
    for (int64_t at = 0; at < length; at += BLOCK) {
        const int64_t n = length - at < BLOCK ? length - at : BLOCK;
        double *restrict row = out + at;
#pragma omp simd
        for (int64_t i = 0; i < n; i++) {
            p[i] = uniform(stream, (uint64_t)(at + i));
            row[i] = middle(p[i] - 0.5);
        }
        for (int64_t i = 0; i < n; i++)
            if (!(fabs(p[i] - 0.5) <= MIDDLE))
                row[i] = tail(p[i]);
    }
}
