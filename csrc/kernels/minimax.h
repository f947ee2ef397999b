/* Newton's method for partial fractions whose weighted error has the smallest p-norm, p doubling step by step.
 *
 *     R(x) = P(x) [ d + sum r_i s_i/(x + s_i) + 1/2 sum (c_j q_j/(x + q_j) + conjugate poles and gains) ],  x = jW,
 *
 * with s = exp(theta) and q = exp(theta + j psi), psi = (pi/2) tanh(eta): every parameter is free, every pole stable. */
#ifndef FRACLINK_MINIMAX_H
#define FRACLINK_MINIMAX_H
#include <stddef.h>

enum { MINIMAX_ORDER_MOST = 12, MINIMAX_PARAMETERS = 1 + 2 * MINIMAX_ORDER_MOST };

/* The errors are 2 `count` real rows: real[0] Re v + real[1] Im v - wanted[k], and the same with imag and
 * wanted[count + k], where v is R/P at W_k: P, the turn of the error and the weights are in the four coefficients. */
typedef struct {
    ptrdiff_t count;
    const double *omega;
    const double *real[2], *imag[2];
    const double *wanted;
} minimax_target;

/* `parameters`: d, r (reals), Re c (pairs), Im c (pairs), theta (reals), theta (pairs), eta (pairs); start and result.
 * `powers` are powers of two. Returns 0, or 1 where there is no memory. */
int minimax_improve(const minimax_target *target, int reals, int pairs, const int *powers, int ladder, double *parameters);

#endif
