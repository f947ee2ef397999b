/* Identification kernel: predicted output of the link, its derivatives and their Gram matrix.
 *
 * The link's step response is h(t) = L^-1[s^(l-1)/(s^l + mu s^a + w)], a decaying pair of complex exponentials plus
 * an integral over real rates (the branch cut). The integral is a trapezoidal sum in ln(rate) on a grid that does
 * not depend on the parameters, so that one recursion of states serves the output and every derivative. */
#ifndef FRACLINK_FIT_H
#define FRACLINK_FIT_H

#include <stddef.h>

enum {
    FIT_LANES = 8,          /* samples per block: one AVX-512 vector of doubles */
    FIT_GROUP = 4,          /* blocks that share every load of a coefficient */
    FIT_MODES_MAX = 64,     /* real rates with a recursion */
    FIT_TAIL_MAX = 64,      /* faster rates, included in the coefficients of two inputs */
    FIT_SHAPE = 5,          /* order, ln(resonance), damping ratio, damping order, delay [s] */
    FIT_COLUMNS_MAX = 3 + FIT_SHAPE, /* measured, predicted, one, derivatives */
    FIT_STATES_MAX = FIT_MODES_MAX + 5
};

/* Viscous damping beyond this leaves hardly any vibration; from 1 on, the poles are real. */
#define FIT_RATIO_MOST 0.9

enum { FIT_ORDER, FIT_RESONANCE, FIT_RATIO, FIT_DAMPING_ORDER, FIT_DELAY };

typedef struct {
    ptrdiff_t count;      /* samples */
    double period;        /* [s] */
    int hold;             /* 0: input is held, 1: input is linear between samples */
    /* jump at sample k (hold 0) or slope after it (hold 1); readable for -before - pad <= k < count + pad */
    const double *input;
    ptrdiff_t before;     /* inputs before sample 0: they move the link, and no output is compared with them */
    ptrdiff_t pad;        /* zeros on both sides of these inputs */
    const double *output; /* measured, count */
    double grid_start, grid_step; /* ln(rate) of the first real mode, and the step */
    int modes, tail;      /* rates with a recursion, and rates above them */
} fit_problem;

/* Everything needed by the pass over the data; computed anew for every set of parameters. */
typedef struct {
    int outputs;          /* 1 + derivatives */
    int modes, states;    /* states: modes, pole (re, im), its derivative (re, im), previous input */
    ptrdiff_t shift;      /* whole samples of delay */
    double state_gain[1 + FIT_SHAPE][FIT_STATES_MAX][FIT_LANES];
    double input_gain[1 + FIT_SHAPE][FIT_LANES][FIT_LANES]; /* [input in block][output in block] */
    double decay[FIT_MODES_MAX], decay_block[FIT_MODES_MAX], drive[FIT_MODES_MAX];
    double drive_block[FIT_LANES][FIT_MODES_MAX + 4];
    double pole_block[4][4], pole_drive_block[FIT_LANES][4];
    double pole_step[4][4], pole_drive[4];
} fit_table;

/* `mask` has bit i set where shape parameter i gets a derivative column. Returns 1, or 0 for a shape that has no pole
 * or whose delay exceeds `pad`. */
int fit_make_table(const fit_problem *problem, const double *shape, unsigned mask, fit_table *table);

/* Gram matrix (row-major, side x side, side = 3 + derivatives) of [measured, predicted, 1, derivatives of
 * the predicted output for unit gain]; `columns` (outputs x count), if given, receives predicted and derivatives. */
void fit_pass(const fit_problem *problem, const fit_table *table, double *gram, double *columns);

typedef struct {
    unsigned mask;             /* free shape parameters */
    double lower[FIT_SHAPE], upper[FIT_SHAPE];
    int gain_free, offset_free;
    double gain, offset;       /* values where they are fixed, results where they are free */
    int iterations_max;
    double cost;               /* sum of squares; infinite if the start has no pole */
    double gram[FIT_COLUMNS_MAX * FIT_COLUMNS_MAX]; /* at the end, as of fit_pass */
} fit_request;

/* Sum of squares of one shape at its best gain and offset; infinite if it has no pole. */
double fit_cost(const fit_problem *problem, const double *shape, fit_request *request, fit_table *work);

/* Levenberg-Marquardt with the linear parameters (gain, offset) projected out; `shape` is start and result. Returns
 * whether it converged. */
int fit_solve(const fit_problem *problem, double *shape, fit_request *request, fit_table *work);

#endif
