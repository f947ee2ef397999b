// One pass over the samples in blocks of BLOCK, without a horizontal sum and without a chain from sample to
// sample: per block, the outputs are
//     Toeplitz(impulse response) · inputs  +  out · state,
// vectorised over the samples of the block, and the state at its end is decay^BLOCK · state + in · inputs,
// vectorised over modes. The powers come from exp(n log d): d^n by repeated products would lose n units in
// the last place, which would limit slow modes over millions of samples.
#include "modes.h"

#include <math.h>
#include <string.h>

#include "clones.h"

enum { BLOCK = 16, LANES = 16, SETS = 2 };

static ptrdiff_t padded(const modes_system *system) {
    ptrdiff_t states = system->reals + 2 * system->pairs;
    return (states + LANES - 1) / LANES * LANES;
}

typedef struct {
    double *out;      // [state][sample of the block]: contribution of the state at the block's start
    double *in;       // [group of LANES states][sample][lane]: contribution to the state at its end
    double *toeplitz; // [input][sample]
    double *decay;    // [state], over a whole block, of the real modes
    double *turn;     // [state] the same of the pairs, (re, im)
    double *state;    // [state]
    double *next;     // [state]
} tables;

size_t modes_scratch(const modes_system *system) {
    return (size_t)padded(system) * (2 * BLOCK + 4) + BLOCK * BLOCK + 8;
}

static tables layout(const modes_system *system, double *scratch) {
    ptrdiff_t states = padded(system);
    memset(scratch, 0, modes_scratch(system) * sizeof(double));
    while ((size_t)scratch % 64) // whole cache lines: the scratch memory has 8 doubles to spare
        scratch++;
    tables t;
    t.out = scratch;
    t.in = t.out + states * BLOCK;
    t.toeplitz = t.in + states * BLOCK;
    t.decay = t.toeplitz + BLOCK * BLOCK;
    t.turn = t.decay + states;
    t.state = t.turn + states;
    t.next = t.state + states;
    return t;
}

static double *in_entry(const tables *t, ptrdiff_t state, int sample) {
    return t->in + (state / LANES * BLOCK + sample) * LANES + state % LANES;
}

// d^0 … d^BLOCK from log d: five exponentials, and at most three products for any power.
static void powers(cx log, cx *p) {
    p[0] = (cx){1.0, 0.0};
    for (int n = 1; n <= BLOCK; n *= 2) {
        p[n] = log.im == 0.0 ? (cx){exp(n * log.re), 0.0} : exponential(scale(n, log));
        for (int m = n + 1; m < 2 * n && m < BLOCK; m++)
            p[m] = mul(p[n], p[m - n]);
    }
}

static void fill(const modes_system *s, tables *t) {
    double response[BLOCK + 1] = {0.0}; // [m]: weight of lag m + 1
    cx p[2 * BLOCK];
    for (ptrdiff_t i = 0; i < s->reals; i++) {
        powers((cx){s->log_decays[i], 0.0}, p);
        for (int n = 0; n < BLOCK; n++) {
            t->out[i * BLOCK + n] = s->gains[i] * p[n].re;
            *in_entry(t, i, BLOCK - 1 - n) = p[n].re;
            response[n] += s->gains[i] * p[n].re;
        }
        t->decay[i] = p[BLOCK].re;
    }
    for (ptrdiff_t j = 0; j < s->pairs; j++) {
        const ptrdiff_t i = s->reals + 2 * j;
        powers(s->pole_log_decays[j], p);
        for (int n = 0; n < BLOCK; n++) {
            const cx weight = mul(s->pole_gains[j], p[n]);
            t->out[i * BLOCK + n] = weight.re;
            t->out[(i + 1) * BLOCK + n] = -weight.im;
            *in_entry(t, i, BLOCK - 1 - n) = p[n].re;
            *in_entry(t, i + 1, BLOCK - 1 - n) = p[n].im;
            response[n] += weight.re;
        }
        t->turn[i] = p[BLOCK].re;
        t->turn[i + 1] = p[BLOCK].im;
    }
    response[0] += s->first;
    for (int j = 0; j < BLOCK; j++) {
        t->toeplitz[j * BLOCK + j] = s->direct;
        for (int n = j + 1; n < BLOCK; n++)
            t->toeplitz[j * BLOCK + n] = response[n - j - 1];
    }
}

// Outputs of one block, then the state at its end without the pairs' part of the old state.
FRACLINK_CLONES
static void block(const tables *restrict t, ptrdiff_t states, const double *restrict u, double *restrict y) {
    _Alignas(64) double sum[SETS][BLOCK] = {{0.0}};
    for (int j = 0; j < BLOCK; j += SETS)
        for (int set = 0; set < SETS; set++)
#pragma omp simd
            for (int n = 0; n < BLOCK; n++)
                sum[set][n] += t->toeplitz[(j + set) * BLOCK + n] * u[j + set];
    for (ptrdiff_t i = 0; i < states; i += SETS)
        for (int set = 0; set < SETS; set++)
#pragma omp simd
            for (int n = 0; n < BLOCK; n++)
                sum[set][n] += t->out[(i + set) * BLOCK + n] * t->state[i + set];
#pragma omp simd
    for (int n = 0; n < BLOCK; n++)
        y[n] = sum[0][n] + sum[1][n];
    for (ptrdiff_t i = 0; i < states; i += LANES) {
        _Alignas(64) double end[LANES];
        const double *in = t->in + i * BLOCK;
#pragma omp simd
        for (int l = 0; l < LANES; l++)
            end[l] = t->decay[i + l] * t->state[i + l];
        for (int n = 0; n < BLOCK; n++)
#pragma omp simd
            for (int l = 0; l < LANES; l++)
                end[l] += in[n * LANES + l] * u[n];
#pragma omp simd
        for (int l = 0; l < LANES; l++)
            t->next[i + l] = end[l];
    }
}

void modes_response(const modes_system *s, const double *initial, const double *input, double *output,
                    ptrdiff_t n, double *scratch) {
    tables t = layout(s, scratch);
    ptrdiff_t states = padded(s);
    fill(s, &t);
    memcpy(t.state, initial, (size_t)(s->reals + 2 * s->pairs) * sizeof(double));
    double before = 0.0; // the input just before the block
    for (ptrdiff_t k = 0; k < n; k += BLOCK) {
        double u[BLOCK] = {0.0}, y[BLOCK];
        size_t count = (size_t)(n - k < BLOCK ? n - k : BLOCK);
        memcpy(u, input + k, count * sizeof(double));
        block(&t, states, u, y);
        y[0] += s->first * before;
        memcpy(output + k, y, count * sizeof(double));
        before = u[BLOCK - 1];
        for (ptrdiff_t j = 0; j < s->pairs; j++) {
            ptrdiff_t i = s->reals + 2 * j;
            t.next[i] += t.turn[i] * t.state[i] - t.turn[i + 1] * t.state[i + 1];
            t.next[i + 1] += t.turn[i + 1] * t.state[i] + t.turn[i] * t.state[i + 1];
        }
        double *swap = t.state;
        t.state = t.next;
        t.next = swap;
    }
}
