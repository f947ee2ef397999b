/* One pass over the data: states at the block's start, outputs and derivatives of eight samples, Gram matrix. */
#include <string.h>

#include "clones.h"
#include "fit.h"

#define L FIT_LANES

typedef struct {
    double mode[FIT_MODES_MAX], pole[4], previous;
} pass_state;

static void single_step(const fit_table *t, pass_state *s, double v) {
    for (int i = 0; i < t->modes; i++) s->mode[i] = t->decay[i] * s->mode[i] + t->drive[i] * v;
    double next[4];
    for (int r = 0; r < 4; r++) {
        next[r] = t->pole_drive[r] * v;
        for (int c = 0; c < 4; c++) next[r] += t->pole_step[r][c] * s->pole[c];
    }
    memcpy(s->pole, next, sizeof next);
    s->previous = v;
}

static inline __attribute__((always_inline)) void block_outputs(const fit_table *restrict t,
                                                                const pass_state *restrict s,
                                                                const double *restrict v,
                                                                double (*restrict out)[L]) {
    int modes = t->modes;
    for (int c = 0; c < t->outputs; c++) {
        const double(*restrict gain)[L] = t->state_gain[c];
        double even[L], odd[L]; /* two chains hide the latency of the additions */
        for (int j = 0; j < L; j++) even[j] = gain[modes + 4][j] * s->previous, odd[j] = 0;
        for (int k = 0; k < 4; k++)
            for (int j = 0; j < L; j++) odd[j] += gain[modes + k][j] * s->pole[k];
        int i = 0;
        for (; i + 1 < modes; i += 2) {
            for (int j = 0; j < L; j++) even[j] += gain[i][j] * s->mode[i];
            for (int j = 0; j < L; j++) odd[j] += gain[i + 1][j] * s->mode[i + 1];
        }
        if (i < modes)
            for (int j = 0; j < L; j++) even[j] += gain[i][j] * s->mode[i];
        for (int l = 0; l < L; l += 2) {
            for (int j = 0; j < L; j++) even[j] += t->input_gain[c][l][j] * v[l];
            for (int j = 0; j < L; j++) odd[j] += t->input_gain[c][l + 1][j] * v[l + 1];
        }
        for (int j = 0; j < L; j++) out[c][j] = even[j] + odd[j];
    }
}

static inline __attribute__((always_inline)) void block_update(const fit_table *restrict t,
                                                               pass_state *restrict s,
                                                               const double *restrict v) {
    int modes = t->modes;
    for (int i = 0; i < modes; i++) {
        double x = t->decay_block[i] * s->mode[i], y = 0;
        for (int l = 0; l < L; l += 2) {
            x += t->drive_block[l][i] * v[l];
            y += t->drive_block[l + 1][i] * v[l + 1];
        }
        s->mode[i] = x + y;
    }
    double next[4] = {0};
    for (int c = 0; c < 4; c++)
        for (int r = 0; r < 4; r++) next[r] += t->pole_block[r][c] * s->pole[c];
    for (int l = 0; l < L; l++)
        for (int r = 0; r < 4; r++) next[r] += t->pole_drive_block[l][r] * v[l];
    memcpy(s->pole, next, sizeof next);
    s->previous = v[L - 1];
}

FRACLINK_CLONES
void fit_pass(const fit_problem *problem, const fit_table *table, double *gram, double *columns) {
    double out[FIT_COLUMNS_MAX][L], sums[FIT_COLUMNS_MAX * (FIT_COLUMNS_MAX + 1) / 2][L] = {{0}};
    int side = 2 + table->outputs;
    pass_state state = {{0}, {0}, 0};
    const double *v = problem->input - table->shift;
    for (ptrdiff_t k = table->shift; k < 0; k++) single_step(table, &state, problem->input[k - table->shift]);
    double(*model)[L] = &out[2]; /* out: measured, one, predicted, derivatives; reordered at the end */
    for (ptrdiff_t base = 0; base < problem->count; base += L) {
        ptrdiff_t left = problem->count - base < L ? problem->count - base : L;
        block_outputs(table, &state, v + base, model);
        block_update(table, &state, v + base);
        for (int j = 0; j < L; j++) {
            out[0][j] = j < left ? problem->output[base + j] : 0;
            out[1][j] = j < left ? 1 : 0;
        }
        if (left < L)
            for (int c = 2; c < side; c++)
                for (int j = (int)left; j < L; j++) out[c][j] = 0;
        if (columns)
            for (int c = 0; c < table->outputs; c++)
                memcpy(columns + c * problem->count + base, model[c], (size_t)left * sizeof(double));
        int at = 0;
        for (int a = 0; a < side; a++)
            for (int b = 0; b <= a; b++, at++)
                for (int j = 0; j < L; j++) sums[at][j] += out[a][j] * out[b][j];
    }
    int at = 0;
    for (int a = 0; a < side; a++)
        for (int b = 0; b <= a; b++, at++) {
            double sum = 0;
            for (int j = 0; j < L; j++) sum += sums[at][j];
            int row = a == 1 ? 2 : a == 2 ? 1 : a, col = b == 1 ? 2 : b == 2 ? 1 : b;
            gram[row * side + col] = gram[col * side + row] = sum;
        }
}
