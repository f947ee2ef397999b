/* One pass over the data: states at the block's start, outputs and derivatives of eight samples, Gram matrix. */
#include <string.h>

#include "clones.h"
#include "fit.h"

#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC optimize("fp-contract=fast") /* half the instructions; no bit of a fit is promised across machines */
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

/* Vectors of four, always: the compilers' own vectoriser shuffles these loops instead of broadcasting, and
 * vectors of eight spill where the machine has only AVX2. */
typedef double quad __attribute__((vector_size(32), aligned(8), may_alias));
#define AT(array, index) (*(quad *)&(array)[index])
#define CONST_AT(array, index) (*(const quad *)&(array)[index])

/* Outputs of FIT_GROUP blocks at once: every coefficient is loaded once and used for each of them. */
static inline __attribute__((always_inline)) void group_outputs(const fit_table *restrict t,
                                                                const pass_state *restrict s,
                                                                const double *restrict v,
                                                                double (*restrict out)[GROUP * L]) {
    int modes = t->modes;
    for (int c = 0; c < t->outputs; c++) {
        const double(*restrict gain)[L] = t->state_gain[c];
        const double(*restrict direct)[L] = t->input_gain[c];
        quad low[GROUP], high[GROUP];
        for (int g = 0; g < GROUP; g++) {
            low[g] = CONST_AT(gain[modes + 4], 0) * s[g].previous;
            high[g] = (quad){0};
        }
        for (int i = 0; i < modes; i++)
            for (int g = 0; g < GROUP; g++) {
                low[g] += CONST_AT(gain[i], 0) * s[g].mode[i];
                high[g] += CONST_AT(gain[i], 4) * s[g].mode[i];
            }
        for (int k = 0; k < 4; k++)
            for (int g = 0; g < GROUP; g++) {
                low[g] += CONST_AT(gain[modes + k], 0) * s[g].pole[k];
                high[g] += CONST_AT(gain[modes + k], 4) * s[g].pole[k];
            }
        for (int l = 0; l < 4; l++) /* an input acts from its own sample on: the first half never sees the second */
            for (int g = 0; g < GROUP; g++) {
                low[g] += CONST_AT(direct[l], 0) * v[g * L + l];
                high[g] += CONST_AT(direct[l], 4) * v[g * L + l];
                high[g] += CONST_AT(direct[l + 4], 4) * v[g * L + l + 4];
            }
        for (int g = 0; g < GROUP; g++) {
            AT(out[c], g * L) = low[g];
            AT(out[c], g * L + 4) = high[g];
        }
    }
}

static inline __attribute__((always_inline)) void block_update(const fit_table *restrict t,
                                                               const pass_state *restrict s,
                                                               pass_state *restrict to,
                                                               const double *restrict v) {
    for (int i = 0; i < t->modes; i += 4) {
        quad x = CONST_AT(t->decay_block, i) * CONST_AT(s->mode, i), y = {0};
        for (int l = 0; l < L; l += 2) {
            x += CONST_AT(t->drive_block[l], i) * v[l];
            y += CONST_AT(t->drive_block[l + 1], i) * v[l + 1];
        }
        AT(to->mode, i) = x + y;
    }
    quad next = {0};
    for (int c = 0; c < 4; c++) next += CONST_AT(t->pole_block[c], 0) * s->pole[c];
    for (int l = 0; l < L; l++) next += CONST_AT(t->pole_drive_block[l], 0) * v[l];
    AT(to->pole, 0) = next;
    to->previous = v[L - 1];
}

/* Upper triangle of the products of all columns, summed over the group. */
static inline __attribute__((always_inline)) void add_products(int side, double (*restrict out)[GROUP * L],
                                                               double (*restrict sums)[4]) {
    for (int a = 0; a < side; a++)
        for (int b = 0; b <= a; b++, sums++) {
            quad x = AT(*sums, 0), y = {0};
            for (int j = 0; j < GROUP * L; j += 8) {
                x += AT(out[a], j) * AT(out[b], j);
                y += AT(out[a], j + 4) * AT(out[b], j + 4);
            }
            AT(*sums, 0) = x + y;
        }
}

FRACLINK_CLONES
void fit_pass(const fit_problem *problem, const fit_table *table, double *gram, double *columns) {
    double out[FIT_COLUMNS_MAX][GROUP * L], sums[FIT_COLUMNS_MAX * (FIT_COLUMNS_MAX + 1) / 2][4] = {{0}};
    int side = 2 + table->outputs;
    pass_state state[GROUP + 1] = {{{0}, {0}, 0}};
    const double *v = problem->input - table->shift;
    /* What acts before the first output: the inputs before the log, and with a negative delay some of its own. */
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
        } else { /* samples past the end count nothing */
            for (int c = 1; c < side; c++)
                for (int j = (int)left; j < GROUP * L; j++) out[c][j] = 0;
            for (int j = (int)left; j < GROUP * L; j++) out[0][j] = 0;
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
