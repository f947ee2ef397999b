// Response of a sum of real and complex exponential modes to a held input.
#ifndef FRACLINK_MODES_H
#define FRACLINK_MODES_H
#include <stddef.h>

#include "complex_pair.h"

// y[k] = direct u[k] + first u[k-1] + sum gains_i x_i[k] + Re sum pole_gains_j z_j[k],
// x_i[k+1] = exp(log_decays_i) x_i[k] + u[k], the same for z.
typedef struct {
    double direct, first;
    ptrdiff_t reals, pairs;
    const double *log_decays, *gains;
    const cx *pole_log_decays, *pole_gains;
} modes_system;

// Scratch memory [doubles] that modes_response needs: tables and state, independent of n.
size_t modes_scratch(const modes_system *system);

// `initial` holds x (reals), then z (pairs: re, im), before the first sample.
void modes_response(const modes_system *system, const double *initial, const double *input, double *output,
                    ptrdiff_t n, double *scratch);
#endif
