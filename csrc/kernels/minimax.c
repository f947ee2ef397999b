/* See minimax.h. Reason for the p-norm: each norm is a smooth problem whose solution is a good start for the next,
 * and at p = 128 its worst error is within ln(rows)/128, 4 %, of the smallest possible. A method for the maximum
 * itself (exchange, linear programs) jumps between vertices while poles move, and its steps have to be bounded by
 * hand. */
#include "minimax.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clones.h"

enum {
    LANES = 8,        /* sums are formed in eight lanes on every machine: identical bits with any vector width */
    STEPS = 12,       /* Newton steps per power; quadratic convergence needs 4 to 8 */
    TRIALS = 8,       /* tenfold increases of the damping before a step is given up */
    MOST_TURNS = 200, /* turns of the power iteration; each reduces the error by (second/largest eigenvalue)^2 */
    SIDE = MINIMAX_PARAMETERS
};

static const double HALF_PI = 1.57079632679489661923;

typedef struct {
    const minimax_target *target;
    int reals, pairs, linear, side; /* linear: 1 + reals + 2 pairs parameters come before those of the poles */
    ptrdiff_t rows, half;           /* half: `count` rounded up to a multiple of LANES, the rest zero; rows = 2 half */
    /* s/(x + s) of each real pole, then q/(x + q) of each pair, then that of each conjugate pole; half rows each */
    double *shape_re, *shape_im;
    double *sum_re, *sum_im;        /* R/P */
    double *columns;                /* side x rows: weighted derivatives of the error */
    double *weight;                 /* |e/peak|^(p/2 - 1) */
} minimax_work;

static double *shape_of(double *all, const minimax_work *work, int pole)
{
    return all + pole * work->half;
}

/* q/(jW + q) for q = a + jb, b = 0 for a real pole: the rows of one pole. */
FRACLINK_CLONES
static void shape(const double *restrict omega, ptrdiff_t count, double a, double b, double *restrict re,
                  double *restrict im)
{
#pragma omp simd
    for (ptrdiff_t k = 0; k < count; k++) {
        const double t = omega[k] + b;
        const double scale = 1.0 / (a * a + t * t);
        re[k] = (a * a + b * t) * scale;
        im[k] = (a * b - a * t) * scale;
    }
}

/* Adds (gain_re + j gain_im) times a shape to R/P. */
FRACLINK_CLONES
static void add(const double *restrict re, const double *restrict im, ptrdiff_t count, double gain_re, double gain_im,
                double *restrict sum_re, double *restrict sum_im)
{
#pragma omp simd
    for (ptrdiff_t k = 0; k < count; k++) {
        sum_re[k] += gain_re * re[k] - gain_im * im[k];
        sum_im[k] += gain_re * im[k] + gain_im * re[k];
    }
}

/* Shapes and R/P at `parameters`, and the weighted error in `error` (rows). */
static void evaluate(minimax_work *work, const double *parameters, double *error)
{
    const minimax_target *t = work->target;
    const int n = work->reals, m = work->pairs;
    const double *gains = parameters + 1, *theta = parameters + work->linear, *eta = theta + n + m;
    for (ptrdiff_t k = 0; k < t->count; k++) {
        work->sum_re[k] = parameters[0];
        work->sum_im[k] = 0.0;
    }
    for (int i = 0; i < n + 2 * m; i++) {
        double *re = shape_of(work->shape_re, work, i), *im = shape_of(work->shape_im, work, i);
        const int pair = i < n ? 0 : (i - n) % m;
        const double size = exp(theta[i < n ? i : n + pair]), mirror = i < n + m ? 1.0 : -1.0;
        const double angle = i < n ? 0.0 : HALF_PI * tanh(eta[pair]);
        shape(t->omega, t->count, size * cos(angle), mirror * size * sin(angle), re, im);
        if (i < n)
            add(re, im, t->count, gains[i], 0.0, work->sum_re, work->sum_im);
        else
            add(re, im, t->count, 0.5 * gains[n + pair], 0.5 * mirror * gains[n + m + pair], work->sum_re, work->sum_im);
    }
    const double *sr = work->sum_re, *si = work->sum_im;
    for (ptrdiff_t k = 0; k < t->count; k++) {
        error[k] = t->real[0][k] * sr[k] + t->real[1][k] * si[k] - t->wanted[k];
        error[work->half + k] = t->imag[0][k] * sr[k] + t->imag[1][k] * si[k] - t->wanted[t->count + k];
    }
}

static double largest(const double *values, ptrdiff_t count)
{
    double most = 0.0;
    for (ptrdiff_t k = 0; k < count; k++)
        most = fabs(values[k]) > most || isnan(values[k]) ? fabs(values[k]) : most;
    return most;
}

/* Sum of |error/peak|^power; infinite if an error exceeds ten peaks, so that no power overflows a double. */
static double norm(const double *error, ptrdiff_t rows, double peak, int power)
{
    double sum = 0.0;
    for (ptrdiff_t k = 0; k < rows; k++) {
        double value = fabs(error[k] / peak);
        if (!(value <= 10.0))
            return INFINITY;
        for (int p = 1; p < power; p *= 2)
            value *= value;
        sum += value;
    }
    return sum;
}

/* A column of the weighted Jacobian: gains times f(shapes), through the target's coefficients. */
typedef struct {
    double a_re, a_im, b_re, b_im; /* a f(first) + b f(second) */
    int first, second;             /* shapes; first = -1: the constant 1, second = -1: none */
    int slope;                     /* f(v) = v (1 - v) = q x/(x + q)^2 instead of f(v) = v */
} minimax_column;

FRACLINK_CLONES
static void column(const minimax_work *work, const minimax_column *c, double *restrict out)
{
    const minimax_target *t = work->target;
    const double *restrict weight = work->weight;
    const double *restrict r0 = t->real[0], *restrict r1 = t->real[1];
    const double *restrict i0 = t->imag[0], *restrict i1 = t->imag[1];
    const ptrdiff_t half = work->half;
    for (int part = 0; part < 2; part++) {
        const int which = part ? c->second : c->first;
        if (which < 0 && part)
            break;
        const double gr = part ? c->b_re : c->a_re, gi = part ? c->b_im : c->a_im;
        const double *restrict re = work->shape_re + (which < 0 ? 0 : which) * half;
        const double *restrict im = work->shape_im + (which < 0 ? 0 : which) * half;
#pragma omp simd
        for (ptrdiff_t k = 0; k < t->count; k++) {
            double vr = which < 0 ? 1.0 : re[k], vi = which < 0 ? 0.0 : im[k];
            if (c->slope) {
                const double ur = vr * (1.0 - vr) + vi * vi;
                vi = vi * (1.0 - 2.0 * vr);
                vr = ur;
            }
            const double yr = gr * vr - gi * vi, yi = gr * vi + gi * vr;
            const double up = (r0[k] * yr + r1[k] * yi) * weight[k];
            const double down = (i0[k] * yr + i1[k] * yi) * weight[half + k];
            out[k] = part ? out[k] + up : up;
            out[half + k] = part ? out[half + k] + down : down;
        }
    }
}

static void jacobian(const minimax_work *work, const double *parameters)
{
    const int n = work->reals, m = work->pairs;
    const double *gains = parameters + 1, *eta = parameters + work->linear + n + m;
    int at = 0;
    minimax_column list[MINIMAX_PARAMETERS];
    list[at++] = (minimax_column){.a_re = 1.0, .first = -1, .second = -1};
    for (int i = 0; i < n; i++)
        list[at++] = (minimax_column){.a_re = 1.0, .first = i, .second = -1};
    for (int j = 0; j < m; j++)
        list[at++] = (minimax_column){.a_re = 0.5, .b_re = 0.5, .first = n + j, .second = n + m + j};
    for (int j = 0; j < m; j++)
        list[at++] = (minimax_column){.a_im = 0.5, .b_im = -0.5, .first = n + j, .second = n + m + j};
    for (int i = 0; i < n; i++)
        list[at++] = (minimax_column){.a_re = gains[i], .first = i, .second = -1, .slope = 1};
    for (int j = 0; j < m; j++) {
        const double re = 0.5 * gains[n + j], im = 0.5 * gains[n + m + j];
        list[at++] = (minimax_column){re, im, re, -im, n + j, n + m + j, 1};
    }
    for (int j = 0; j < m; j++) {
        const double turn = HALF_PI / (cosh(eta[j]) * cosh(eta[j]));
        const double re = 0.5 * turn * gains[n + j], im = 0.5 * turn * gains[n + m + j];
        list[at++] = (minimax_column){-im, re, -im, -re, n + j, n + m + j, 1};
    }
    for (int i = 0; i < at; i++)
        column(work, &list[i], work->columns + i * work->rows);
}

FRACLINK_CLONES
static double product(const double *restrict a, const double *restrict b, ptrdiff_t rows)
{
    double lane[LANES] = {0.0};
    for (ptrdiff_t k = 0; k < rows; k += LANES) {
#pragma omp simd
        for (int l = 0; l < LANES; l++)
            lane[l] += a[k + l] * b[k + l];
    }
    return ((lane[0] + lane[4]) + (lane[2] + lane[6])) + ((lane[1] + lane[5]) + (lane[3] + lane[7]));
}

/* Largest eigenvalue of a scaled Gram matrix, by the power iteration: it sets the scale of the damping. */
static double largest_eigenvalue(const double a[SIDE][SIDE], int side)
{
    double v[SIDE], image[SIDE], found = 0.0;
    for (int i = 0; i < side; i++)
        v[i] = 1.0 + 0.01 * i; /* not orthogonal to any eigenvector by symmetry */
    for (int turn = 0; turn < MOST_TURNS; turn++) {
        double square = 0.0, quotient = 0.0, size = 0.0;
        for (int i = 0; i < side; i++) {
            double sum = 0.0;
            for (int j = 0; j < side; j++)
                sum += a[i][j] * v[j];
            image[i] = sum;
            square += v[i] * v[i];
            quotient += v[i] * sum;
            size += sum * sum;
        }
        const double next = quotient / square;
        if (!(size > 0.0))
            return 0.0;
        for (int i = 0; i < side; i++)
            v[i] = image[i] / sqrt(size);
        if (fabs(next - found) <= 1e-15 * next)
            return next;
        found = next;
    }
    return found;
}

/* Solves (a + shift 1) x = b by Cholesky's method. A pivot lost in rounding is replaced by the shift. */
static void solve(const double a[SIDE][SIDE], int side, double shift, const double *b, double *x)
{
    double l[SIDE][SIDE];
    for (int j = 0; j < side; j++) {
        for (int i = j; i < side; i++) {
            double sum = a[i][j] + (i == j ? shift : 0.0);
            for (int k = 0; k < j; k++)
                sum -= l[i][k] * l[j][k];
            l[i][j] = i == j ? sqrt(sum > 0.0 ? sum : shift) : sum / l[j][j];
        }
    }
    for (int i = 0; i < side; i++) {
        double sum = b[i];
        for (int k = 0; k < i; k++)
            sum -= l[i][k] * x[k];
        x[i] = sum / l[i][i];
    }
    for (int i = side - 1; i >= 0; i--) {
        double sum = x[i];
        for (int k = i + 1; k < side; k++)
            sum -= l[k][i] * x[k];
        x[i] = sum / l[i][i];
    }
}

/* Newton's equations (p - 1) J'W'W J x = -J'W'W e at one point. Squaring the Jacobian loses half of its digits, but
 * none that matter: its columns are scaled to one, and the damping stays far above the rounding of the product. */
typedef struct {
    double a[SIDE][SIDE], right[SIDE], size[SIDE], scale;
} minimax_equations;

static void equations(minimax_work *work, const double *parameters, double *error, double peak, int power,
                      minimax_equations *made)
{
    double *restrict weight = work->weight;
    for (ptrdiff_t k = 0; k < work->rows; k++) {
        double value = fabs(error[k] / peak), all = 1.0;
        for (int p = 2; p < power; p *= 2) { /* 1 + 2 + 4 ... = p/2 - 1 factors */
            all *= value;
            value *= value;
        }
        weight[k] = all;
    }
    jacobian(work, parameters);
    for (ptrdiff_t k = 0; k < work->rows; k++)
        weight[k] *= error[k] / peak;
    for (int i = 0; i < work->side; i++) {
        const double *own = work->columns + i * work->rows;
        for (int j = 0; j <= i; j++)
            made->a[i][j] = product(own, work->columns + j * work->rows, work->rows);
        made->size[i] = sqrt(made->a[i][i]) + 1e-300;
        made->right[i] = -product(own, weight, work->rows) / made->size[i] / (power - 1);
    }
    for (int i = 0; i < work->side; i++)
        for (int j = 0; j <= i; j++)
            made->a[j][i] = made->a[i][j] = made->a[i][j] / made->size[i] / made->size[j];
    made->scale = largest_eigenvalue(made->a, work->side);
}

/* `to` is `from` plus a damped step; no pole moves by more than a factor e, so that none jumps over its neighbours. */
static void stepped(const minimax_work *work, const minimax_equations *made, double damping, double peak,
                    const double *from, double *to)
{
    double step[SIDE], longest = 0.0;
    solve(made->a, work->side, (damping > 1e-12 ? damping : 1e-12) * made->scale, made->right, step);
    for (int i = 0; i < work->side; i++)
        step[i] = peak * (step[i] / made->size[i]);
    for (int i = work->linear; i < work->side; i++)
        longest = fabs(step[i]) > longest ? fabs(step[i]) : longest;
    for (int i = 0; i < work->side; i++)
        to[i] = from[i] + step[i] / (longest > 1.0 ? longest : 1.0);
}

/* Newton's method with Marquardt's damping for one power; `error` belongs to `here` on return, `next` is scratch. */
static void newton(minimax_work *work, int power, double *here, double *error, double *next)
{
    /* Little damping at first: the start is the solution of the previous norm, and Newton's step is nearly right. */
    double damping = 1e-3, there[SIDE];
    minimax_equations made;
    evaluate(work, here, error);
    for (int turn = 0; turn < STEPS; turn++) {
        const double peak = largest(error, work->rows);
        if (!(peak > 0.0))
            return;
        equations(work, here, error, peak, power, &made);
        const double old = norm(error, work->rows, peak, power);
        double reached = INFINITY;
        for (int trial = 0; trial < TRIALS; trial++) {
            stepped(work, &made, damping, peak, here, there);
            evaluate(work, there, next);
            reached = norm(next, work->rows, peak, power);
            if (reached < old)
                break;
            damping = 10.0 * (damping > 1e-9 ? damping : 1e-9);
        }
        if (!(reached < old))
            return;
        memcpy(here, there, sizeof(double) * (size_t)work->side);
        memcpy(error, next, sizeof(double) * (size_t)work->rows);
        damping *= 0.1;
        /* `norm` is the p-norm to the power p: the p-norm itself changes by less than 1e-4. */
        if (1.0 - reached / old < 1e-4 * power)
            return;
    }
}

int minimax_improve(const minimax_target *target, int reals, int pairs, const int *powers, int ladder, double *parameters)
{
    const int poles = reals + 2 * pairs;
    const ptrdiff_t half = (target->count + LANES - 1) / LANES * LANES;
    minimax_work work = {.target = target, .reals = reals, .pairs = pairs, .linear = 1 + poles, .side = 1 + 2 * poles,
                         .rows = 2 * half, .half = half};
    double *memory = calloc((size_t)(half * (2 * poles + 2 + 2 * (work.side + 3))), sizeof(double));
    if (memory == NULL)
        return 1;
    work.shape_re = memory;
    work.shape_im = work.shape_re + poles * half;
    work.sum_re = work.shape_im + poles * half;
    work.sum_im = work.sum_re + half;
    work.columns = work.sum_im + half;
    work.weight = work.columns + work.side * work.rows;
    double *error = work.weight + work.rows, *next = error + work.rows;
    for (int i = 0; i < ladder; i++)
        newton(&work, powers[i], parameters, error, next);
    free(memory);
    return 0;
}
