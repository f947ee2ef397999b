/* One pass over the data: states at the block's start, outputs and derivatives of eight samples, Gram matrix. */
#include <string.h>

#include "clones.h"
#include "fit.h"

#if defined(__GNUC__) && !defined(__clang__)
/* half the instructions; a fit need not be bit-identical across machines */
#pragma GCC optimize("fp-contract=fast")
#endif

#define L FIT_LANES
#define GROUP FIT_GROUP

typedef struct {
    double mode[FIT_MODES_MAX], pole[4], previous;
} pass_state;

static void single_step(const fit_table *t, pass_state *s, double v) {
    for (int i = 0; i < t->modes; i++) s->mode[i] = t->decay[i] * s->mode[i] + t->drive[i] * v;
    double next[4];
    for (int r = 0; r < 4; r++) {
        next[r] = t->pole_drive[r] * v;
        for (int c = 0; c < 4; c++) next[r] += t->pole_step[c][r] * s->pole[c];
    }
    memcpy(s->pole, next, sizeof next);
    s->previous = v;
}

/* Always vectors of four: the compilers' own vectoriser shuffles these loops instead of broadcasting, and vectors of
 * eight spill where the machine only has AVX2. A compiler without vector types gets plain loops. */
#if defined(__GNUC__) || defined(__clang__)
#define INLINE static inline __attribute__((always_inline))
typedef double quad __attribute__((vector_size(32), aligned(8), may_alias));

INLINE void add_scaled(quad *sum, const double *a, double factor) { *sum += *(const quad *)a * factor; }
INLINE void add_product(quad *sum, const double *a, const double *b) {
    *sum += *(const quad *)a * *(const quad *)b;
}
INLINE void add(quad *sum, const quad *other) { *sum += *other; }
INLINE void store(double *to, const quad *sum) { *(quad *)to = *sum; }
#else
#define INLINE static inline
typedef struct {
    double lane[4];
} quad;

INLINE void add_scaled(quad *sum, const double *a, double factor) {
    for (int j = 0; j < 4; j++) sum->lane[j] += a[j] * factor;
}
INLINE void add_product(quad *sum, const double *a, const double *b) {
    for (int j = 0; j < 4; j++) sum->lane[j] += a[j] * b[j];
}
INLINE void add(quad *sum, const quad *other) { add_scaled(sum, other->lane, 1); }
INLINE void store(double *to, const quad *sum) { memcpy(to, sum->lane, sizeof sum->lane); }
#endif

/* Outputs of FIT_GROUP blocks at once: every coefficient is loaded once and used for each of them. */
INLINE void group_outputs(const fit_table *restrict t, const pass_state *restrict s, const double *restrict v,
                          double (*restrict out)[GROUP * L]) {
    int modes = t->modes;
    for (int c = 0; c < t->outputs; c++) {
        const double(*restrict gain)[L] = t->state_gain[c];
        const double(*restrict direct)[L] = t->input_gain[c];
        quad low[GROUP], high[GROUP];
        for (int g = 0; g < GROUP; g++) {
            low[g] = high[g] = (quad){0};
            add_scaled(&low[g], gain[modes + 4], s[g].previous);
        }
        for (int i = 0; i < modes; i++)
            for (int g = 0; g < GROUP; g++) {
                add_scaled(&low[g], gain[i], s[g].mode[i]);
                add_scaled(&high[g], gain[i] + 4, s[g].mode[i]);
            }
        for (int k = 0; k < 4; k++)
            for (int g = 0; g < GROUP; g++) {
                add_scaled(&low[g], gain[modes + k], s[g].pole[k]);
                add_scaled(&high[g], gain[modes + k] + 4, s[g].pole[k]);
            }
        /* an input acts from its own sample on: the first half does not depend on the second */
        for (int l = 0; l < 4; l++)
            for (int g = 0; g < GROUP; g++) {
                add_scaled(&low[g], direct[l], v[g * L + l]);
                add_scaled(&high[g], direct[l] + 4, v[g * L + l]);
                add_scaled(&high[g], direct[l + 4] + 4, v[g * L + l + 4]);
            }
        for (int g = 0; g < GROUP; g++) {
            store(out[c] + g * L, &low[g]);
            store(out[c] + g * L + 4, &high[g]);
        }
    }
}

INLINE void block_update(const fit_table *restrict t, const pass_state *restrict s, pass_state *restrict to,
                         const double *restrict v) {
    for (int i = 0; i < t->modes; i += 4) {
        quad x = {0}, y = {0};
        add_product(&x, t->decay_block + i, s->mode + i);
        for (int l = 0; l < L; l += 2) {
            add_scaled(&x, t->drive_block[l] + i, v[l]);
            add_scaled(&y, t->drive_block[l + 1] + i, v[l + 1]);
        }
        add(&x, &y);
        store(to->mode + i, &x);
    }
    quad next = {0};
    for (int c = 0; c < 4; c++) add_scaled(&next, t->pole_block[c], s->pole[c]);
    for (int l = 0; l < L; l++) add_scaled(&next, t->pole_drive_block[l], v[l]);
    store(to->pole, &next);
    to->previous = v[L - 1];
}

/* Lower triangle of the products of all columns, summed over the group. */
INLINE void add_products(int side, double (*restrict out)[GROUP * L], double (*restrict sums)[4]) {
    for (int a = 0; a < side; a++)
        for (int b = 0; b <= a; b++, sums++) {
            quad x = {0}, y = {0};
            add_scaled(&x, *sums, 1);
            for (int j = 0; j < GROUP * L; j += 8) {
                add_product(&x, out[a] + j, out[b] + j);
                add_product(&y, out[a] + j + 4, out[b] + j + 4);
            }
            add(&x, &y);
            store(*sums, &x);
        }
}

FRACLINK_CLONES
void fit_pass(const fit_problem *problem, const fit_table *table, double *gram, double *columns) {
    double out[FIT_COLUMNS_MAX][GROUP * L], sums[FIT_COLUMNS_MAX * (FIT_COLUMNS_MAX + 1) / 2][4] = {{0}};
    int side = 2 + table->outputs;
    pass_state state[GROUP + 1] = {{{0}, {0}, 0}};
    const double *v = problem->input - table->shift;
    /* The state before the first output, from the inputs before the log and, with a negative delay, from its first
     * ones. */
    for (ptrdiff_t k = -problem->before; k < -table->shift; k++) single_step(table, state, problem->input[k]);
    double(*model)[GROUP * L] = &out[2]; /* out: measured, one, predicted, derivatives; reordered at the end */
    for (int j = 0; j < GROUP * L; j++) out[1][j] = 1;
    for (ptrdiff_t base = 0; base < problem->count; base += GROUP * L) {
        ptrdiff_t left = problem->count - base;
        for (int g = 0; g < GROUP; g++) block_update(table, &state[g], &state[g + 1], v + base + g * L);
        group_outputs(table, state, v + base, model);
        state[0] = state[GROUP];
        if (left >= GROUP * L) {
            left = GROUP * L;
        } else { /* samples past the end have no weight */
            for (int c = 0; c < side; c++)
                for (int j = (int)left; j < GROUP * L; j++) out[c][j] = 0;
        }
        memcpy(out[0], problem->output + base, (size_t)left * sizeof(double));
        for (int c = 0; columns && c < table->outputs; c++)
            memcpy(columns + c * problem->count + base, model[c], (size_t)left * sizeof(double));
        add_products(side, out, sums);
    }
    int at = 0;
    for (int a = 0; a < side; a++)
        for (int b = 0; b <= a; b++, at++) {
            int row = a == 1 ? 2 : a == 2 ? 1 : a, col = b == 1 ? 2 : b == 2 ? 1 : b;
            double sum = sums[at][0] + sums[at][1] + sums[at][2] + sums[at][3];
            gram[row * side + col] = gram[col * side + row] = sum;
        }
}
