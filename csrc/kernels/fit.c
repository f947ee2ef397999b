/* Levenberg-Marquardt on the Gram matrix; gain and offset are linear and projected out exactly. */
#include <math.h>
#include <string.h>

#include "fit.h"

#define SIDE_MAX FIT_COLUMNS_MAX

/* Solve A x = b in place by Cholesky's method for a symmetric positive definite A of order n; 0 if it is not
 * definite. */
static int solve_definite(int n, double a[SIDE_MAX][SIDE_MAX], double *b) {
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) {
            double sum = a[i][j];
            for (int k = 0; k < j; k++) sum -= a[i][k] * a[j][k];
            if (i == j) {
                if (!(sum > 1e-14 * a[i][i])) return 0;
                a[i][i] = sqrt(sum);
            } else {
                a[i][j] = sum / a[j][j];
            }
        }
    for (int i = 0; i < n; i++) {
        for (int k = 0; k < i; k++) b[i] -= a[i][k] * b[k];
        b[i] /= a[i][i];
    }
    for (int i = n - 1; i >= 0; i--) {
        for (int k = i + 1; k < n; k++) b[i] -= a[k][i] * b[k];
        b[i] /= a[i][i];
    }
    return 1;
}

/* The best gain and offset for this shape, and their cost. First rows of the Gram matrix: measured, predicted, 1. */
static double linear_part(const double *g, int side, fit_request *r) {
    double my = g[1], m1 = g[2], yy = g[side + 1], y1 = g[side + 2], n = g[2 * side + 2];
    if (r->gain_free && r->offset_free) {
        double determinant = yy * n - y1 * y1;
        r->gain = determinant > 1e-14 * yy * n ? (my * n - m1 * y1) / determinant : 0;
        r->offset = (m1 - r->gain * y1) / n;
    } else if (r->gain_free) {
        r->gain = yy > 0 ? (my - r->offset * y1) / yy : 0;
    } else if (r->offset_free) {
        r->offset = (m1 - r->gain * y1) / n;
    }
    double a = r->gain, o = r->offset;
    double cost = g[0] - 2 * a * my - 2 * o * m1 + a * a * yy + 2 * a * o * y1 + o * o * n;
    return cost > 0 ? cost : 0; /* rounding of a perfect fit */
}

/* The cost of a shape with its Gram matrix; 0 if it is not finite. */
static int evaluate(const fit_problem *problem, const double *shape, unsigned mask, fit_request *r, fit_table *t,
                    double *gram, double *cost) {
    *cost = INFINITY;
    if (!fit_make_table(problem, shape, mask, t)) return 0;
    fit_pass(problem, t, gram, NULL);
    *cost = linear_part(gram, 2 + t->outputs, r);
    return isfinite(*cost);
}

double fit_cost(const fit_problem *problem, const double *shape, fit_request *r, fit_table *work) {
    double gram[SIDE_MAX * SIDE_MAX], cost;
    return evaluate(problem, shape, 0, r, work, gram, &cost) ? cost : INFINITY;
}

/* The stiffness w in s^l + mu s^a + w must not be negative, which bounds the damping ratio. */
static void project(double *shape, const fit_request *r) {
    for (int i = 0; i < FIT_SHAPE; i++)
        if (r->mask >> i & 1) shape[i] = fmin(fmax(shape[i], r->lower[i]), r->upper[i]);
    double a = shape[FIT_DAMPING_ORDER];
    if (r->mask >> FIT_RATIO & 1) {
        double most = a < 1 ? tan(a * 1.57079632679489661923) / 2 : FIT_RATIO_MOST;
        if (shape[FIT_RATIO] > most) shape[FIT_RATIO] = most;
    }
}

/* The damped step for the current Gram matrix; returns the predicted decrease of the cost, or -1 if it is singular. */
static double make_step(const double *g, int side, const double *shape, const fit_request *r, double damping,
                        double *step) {
    int place[FIT_SHAPE], n = 0, column = 3;
    double a[SIDE_MAX][SIDE_MAX], b[SIDE_MAX], slopes[SIDE_MAX];
    int from[SIDE_MAX];
    for (int i = 0; i < FIT_SHAPE; i++) {
        step[i] = 0;
        if (!(r->mask >> i & 1)) continue;
        int c = column++;
        double slope = r->gain * (g[c] - r->gain * g[side + c] - r->offset * g[2 * side + c]);
        if ((slope < 0 && shape[i] <= r->lower[i]) || (slope > 0 && shape[i] >= r->upper[i])) continue;
        place[n] = i;
        from[n] = c;
        b[n++] = slope;
    }
    int shapes = n;
    if (r->gain_free) from[n++] = 1;
    if (r->offset_free) from[n++] = 2;
    for (int i = shapes; i < n; i++) b[i] = 0; /* gain and offset are already optimal */
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            double scale = (i < shapes ? r->gain : 1) * (j < shapes ? r->gain : 1);
            a[i][j] = scale * g[from[i] * side + from[j]];
        }
    memcpy(slopes, b, sizeof slopes);
    for (int i = 0; i < shapes; i++) a[i][i] *= 1 + damping;
    if (shapes && !solve_definite(n, a, b)) return -1;
    double predicted = 0;
    for (int i = 0; i < shapes; i++) {
        step[place[i]] = b[i];
        predicted += b[i] * slopes[i];
    }
    return predicted;
}

/* Well below a step of one in ln(resonance), or of half the range of another shape parameter: there the slopes fail. */
static void limit_step(double *step, double period_seconds) {
    const double most[FIT_SHAPE] = {0.25, 0.35, 0.2, 0.3, 0.15 * period_seconds};
    double worst = 1;
    for (int i = 0; i < FIT_SHAPE; i++) worst = fmax(worst, fabs(step[i]) / most[i]);
    for (int i = 0; i < FIT_SHAPE; i++) step[i] /= worst;
}

static int negligible(const double *step, double period_seconds) {
    const double scale[FIT_SHAPE] = {1, 1, 0.1, 1, period_seconds};
    for (int i = 0; i < FIT_SHAPE; i++)
        if (fabs(step[i]) > 1e-11 * scale[i]) return 0;
    return 1;
}

int fit_solve(const fit_problem *problem, double *shape, fit_request *r, fit_table *work) {
    double *gram = r->gram, trial[FIT_SHAPE], step[FIT_SHAPE], cost, trial_cost, damping = 1e-3;
    project(shape, r);
    r->cost = INFINITY;
    if (!evaluate(problem, shape, r->mask, r, work, gram, &cost)) return 0;
    int side = 2 + work->outputs, converged = 0;
    for (int i = 0; i < r->iterations_max; i++) {
        double period = 6.283185307179586 / exp(shape[FIT_RESONANCE]);
        double predicted = make_step(gram, side, shape, r, damping, step);
        if (predicted >= 0) {
            limit_step(step, period);
            for (int k = 0; k < FIT_SHAPE; k++) trial[k] = shape[k] + step[k];
            project(trial, r);
            double moved[FIT_SHAPE];
            for (int k = 0; k < FIT_SHAPE; k++) moved[k] = trial[k] - shape[k];
            if (negligible(moved, period) || predicted < 1e-10 * cost) {
                converged = 1;
                break;
            }
            double gain = r->gain, offset = r->offset, next[SIDE_MAX * SIDE_MAX];
            if (evaluate(problem, trial, r->mask, r, work, next, &trial_cost) && trial_cost < cost) {
                damping = trial_cost < cost - 0.25 * predicted ? damping * 0.1 : damping * 0.5;
                if (damping < 1e-12) damping = 1e-12;
                memcpy(shape, trial, sizeof trial);
                memcpy(gram, next, sizeof next);
                cost = trial_cost;
                continue;
            }
            r->gain = gain; /* the rejected trial replaced both */
            r->offset = offset;
        }
        damping = fmax(8 * damping, 1e-6);
        if (damping > 1e12) { /* no step improves the cost: it is as low as the arithmetic can resolve */
            converged = predicted >= 0;
            break;
        }
    }
    r->cost = cost;
    return converged;
}
