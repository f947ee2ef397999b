// One pass over the samples in blocks of BLOCK, without a horizontal sum and without a chain from sample to
// sample: per block, the outputs are
//     Toeplitz(impulse response) · inputs  +  out · state,
// vectorised over the samples of the block, and the state at its end is decay^BLOCK · state + in · inputs,
// vectorised over modes. The powers come from exp(n log d): d^n by repeated products would lose n units in
// the last place, which is what limits slow modes over millions of samples.
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

// d^0 … d^BLOCK from log d: four exponentials and at most three products each.
static void powers(double log_size, double angle, double (*p)[2]) {
    p[0][0] = 1.0;
    p[0][1] = 0.0;
    for (int n = 1; n <= BLOCK; n *= 2) {
        double size = exp(n * log_size);
        p[n][0] = angle == 0.0 ? size : size * cos(n * angle);
        p[n][1] = angle == 0.0 ? 0.0 : size * sin(n * angle);
        for (int m = n + 1; m < 2 * n && m < BLOCK; m++) {
            const double *q = p[m - n];
            p[m][0] = p[n][0] * q[0] - p[n][1] * q[1];
            p[m][1] = p[n][0] * q[1] + p[n][1] * q[0];
        }
    }
}

static void fill(const modes_system *s, tables *t) {
    double response[BLOCK + 1] = {0.0}; // [m]: weight of lag m + 1
    double p[2 * BLOCK][2];
    for (ptrdiff_t i = 0; i < s->reals; i++) {
        powers(s->log_decays[i], 0.0, p);
        for (int n = 0; n < BLOCK; n++) {
            t->out[i * BLOCK + n] = s->gains[i] * p[n][0];
            *in_entry(t, i, BLOCK - 1 - n) = p[n][0];
            response[n] += s->gains[i] * p[n][0];
        }
        t->decay[i] = p[BLOCK][0];
    }
    for (ptrdiff_t j = 0; j < s->pairs; j++) {
        ptrdiff_t i = s->reals + 2 * j;
        double gr = s->pole_gains[2 * j], gi = s->pole_gains[2 * j + 1];
        powers(s->pole_log_decays[2 * j], s->pole_log_decays[2 * j + 1], p);
        for (int n = 0; n < BLOCK; n++) {
            t->out[i * BLOCK + n] = gr * p[n][0] - gi * p[n][1];
            t->out[(i + 1) * BLOCK + n] = -(gr * p[n][1] + gi * p[n][0]);
            *in_entry(t, i, BLOCK - 1 - n) = p[n][0];
            *in_entry(t, i + 1, BLOCK - 1 - n) = p[n][1];
            response[n] += gr * p[n][0] - gi * p[n][1];
        }
        t->turn[i] = p[BLOCK][0];
        t->turn[i + 1] = p[BLOCK][1];
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
