/* Coefficients of the identification kernel: weights of the branch cut, the pole, their derivatives. */
#include <math.h>
#include <string.h>

#include "complex_pair.h"
#include "fit.h"

#define PI 3.14159265358979323846

/* The coefficients of the formula and their derivatives with respect to each free parameter. */
typedef struct {
    double order, damping, damping_order, restoring;
    int free; /* derivatives of link parameters; the delay is treated separately */
    double d_order[4], d_damping[4], d_damping_order[4], d_restoring[4];
} formula;

/* mu and w from the damping ratio z at the resonance W: the denominator's real and imaginary parts at jW give mu = 2
 * z W^(l-a)/sin(a pi/2) and w = W^l (1 - 2 z cot(a pi/2)) for l = 2. In (mu, a, w) a fit moves along a valley; in
 * (z, a, W) the valley is an axis. */
static void make_formula(const double *shape, unsigned mask, formula *f) {
    double order = shape[FIT_ORDER], ln = shape[FIT_RESONANCE], ratio = shape[FIT_RATIO];
    double other = shape[FIT_DAMPING_ORDER];
    double sine = sin(other * PI / 2), cot = cos(other * PI / 2) / sine;
    double whole = exp(order * ln), unit = 2 * exp((order - other) * ln) / sine;
    f->order = order;
    f->damping = ratio * unit;
    f->damping_order = other;
    f->restoring = whole * (1 - 2 * ratio * cot);
    f->free = 0;
    for (int i = 0; i < FIT_DELAY; i++) {
        if (!(mask >> i & 1)) continue;
        int k = f->free++;
        f->d_order[k] = i == FIT_ORDER;
        f->d_damping_order[k] = i == FIT_DAMPING_ORDER;
        switch (i) {
        case FIT_ORDER:
            f->d_damping[k] = f->damping * ln;
            f->d_restoring[k] = f->restoring * ln;
            break;
        case FIT_RESONANCE:
            f->d_damping[k] = f->damping * (order - other);
            f->d_restoring[k] = f->restoring * order;
            break;
        case FIT_RATIO:
            f->d_damping[k] = unit;
            f->d_restoring[k] = -2 * whole * cot;
            break;
        default:
            f->d_damping[k] = -f->damping * (ln + PI / 2 * cot);
            f->d_restoring[k] = whole * ratio * PI / (sine * sine);
        }
    }
}

/* Root of s^l + mu s^a + w with positive imaginary part, by Newton's method in z = ln s, where the terms are
 * exponentials. */
static int newton(const formula *f, cx z, cx *log_pole) {
    for (int i = 0; i < 40; i++) {
        cx moving = exponential(scale(f->order, z));
        cx friction = scale(f->damping, exponential(scale(f->damping_order, z)));
        cx value = add(add(moving, friction), (cx){f->restoring, 0});
        cx slope = add(scale(f->order, moving), scale(f->damping_order, friction));
        cx step = mul(value, invert(slope));
        double size = hypot(step.re, step.im);
        if (!(size < 1e3)) return 0;
        z = add(z, scale(size > 0.3 ? -0.3 / size : -1, step));
        if (size < 1e-14) break;
        if (i == 39 && size > 1e-10) return 0;
    }
    *log_pole = z;
    return z.im > 0.02 && z.im < PI - 1e-6;
}

static int find_pole(const formula *f, const double *shape, cx *log_pole) {
    double ratio = shape[FIT_RATIO] < 0.99 ? shape[FIT_RATIO] : 0.99;
    cx z = {shape[FIT_RESONANCE], PI / f->order + (f->damping > 0 ? asin(ratio) : 0)};
    if (newton(f, z, log_pole)) return 1;
    double left = f->order - f->damping_order; /* without w: s^(l-a) + mu, where UD-FOM lies inside D-FOM */
    if (!(f->damping > 0 && left > 1)) return 0;
    return newton(f, (cx){log(f->damping) / left, PI / left}, log_pole);
}

/* Contribution of one exponential: e^{p t} after a time f of the input's interval, for held and linear inputs. */
typedef struct {
    cx rest, rest_slope;   /* e^{pf}, and d/dp */
    cx begun, begun_slope; /* response to the input of the present interval */
    cx begun_rate;         /* d/dt of the latter */
} segment;

static segment over(cx p, double time, int hold) {
    segment s;
    s.rest = exponential(scale(time, p));
    s.rest_slope = scale(time, s.rest);
    if (hold == 0) {
        s.begun = s.rest;
        s.begun_slope = s.rest_slope;
        s.begun_rate = mul(p, s.rest);
        return s;
    }
    cx inverse = invert(p);
    s.begun_rate = s.rest;
    if (hypot(p.re, p.im) * time < 1e-2) { /* the quotient would lose digits */
        cx x = scale(time, p), sum = {0, 0}, slope = {0, 0}, power = {1, 0};
        double factor = 1;
        for (int n = 0; n < 8; n++) { /* time * sum x^n/(n+1)!, derivative time^2 * sum (n+1) x^n/(n+2)! */
            factor /= n + 1;
            sum = add(sum, scale(factor, power));
            slope = add(slope, scale(factor * (n + 1) / (n + 2), power));
            power = mul(power, x);
        }
        s.begun = scale(time, sum);
        s.begun_slope = scale(time * time, slope);
        return s;
    }
    s.begun = mul(add(s.rest, (cx){-1, 0}), inverse);
    s.begun_slope = mul(add(s.rest_slope, scale(-1, s.begun)), inverse);
    return s;
}

/* Add one contribution k * e^{pt} (and, for derivatives, k2 * d/dp) of the pole pair to a column. */
static void pole_column(fit_table *t, int column, cx k, cx k2, cx p, double period, const segment *part,
                        const segment *full, int rate) {
    int at = t->modes;
    double(*gain)[FIT_LANES] = t->state_gain[column];
    cx step = full->rest, reach = part->rest, reach_slope = part->rest_slope;
    cx first = rate ? part->begun_rate : part->begun;
    if (rate) { /* time derivative: one more factor p */
        reach = mul(p, reach);
        reach_slope = add(part->rest, mul(p, reach_slope));
    }
    cx now = add(mul(k, first), mul(k2, rate ? (cx){0, 0} : part->begun_slope));
    for (int j = 0; j < FIT_LANES; j++) t->input_gain[column][j][j] += 2 * now.re;
    for (int j = 0; j < FIT_LANES; j++) {
        cx on_state = add(mul(k, reach), mul(k2, reach_slope)), on_slope = mul(k2, reach);
        gain[at][j] = 2 * on_state.re;
        gain[at + 1][j] = -2 * on_state.im;
        gain[at + 2][j] = 2 * on_slope.re;
        gain[at + 3][j] = -2 * on_slope.im;
        cx past = add(mul(on_state, full->begun), mul(on_slope, full->begun_slope));
        for (int l = 0; l + j + 1 < FIT_LANES; l++) t->input_gain[column][l][l + j + 1] += 2 * past.re;
        reach_slope = add(mul(reach_slope, step), scale(period, mul(reach, step)));
        reach = mul(reach, step);
    }
}

static void pole_update(cx step, cx slope, double out[4][4]) {
    double m[4][4] = {{step.re, step.im, slope.re, slope.im}, /* [from][to] */
                      {-step.im, step.re, -slope.im, slope.re},
                      {0, 0, step.re, step.im},
                      {0, 0, -step.im, step.re}};
    memcpy(out, m, sizeof m);
}

static void pole_part(const fit_problem *q, const formula *f, cx log_pole, double fraction, int delay_free,
                      fit_table *t, double *unit) {
    cx p = exponential(log_pole), b = exponential(scale(f->damping_order - f->order, log_pole));
    cx residue = invert(add((cx){f->order, 0}, scale(f->damping * f->damping_order, b)));
    /* the trapezoidal rule is affected by the pole near its path: exact correction */
    double turn = -2 * PI / q->grid_step;
    cx away = {log_pole.re - q->grid_start, log_pole.im - PI};
    cx image = exponential((cx){-turn * away.im, turn * away.re});
    cx factor = invert(add((cx){1, 0}, scale(-1, image)));
    cx k = mul(residue, factor), inverse = invert(p);
    segment part = over(p, fraction * q->period, q->hold), full = over(p, q->period, q->hold);
    pole_column(t, 0, k, (cx){0, 0}, p, q->period, &part, &full, 0);
    unit[0] += 2 * k.re;
    cx moving = exponential(scale(f->order, log_pole)), friction = exponential(scale(f->damping_order, log_pole));
    cx slope = mul(add(scale(f->order, moving), scale(f->damping * f->damping_order, friction)), inverse);
    for (int i = 0; i < f->free; i++) {
        cx change = scale(f->d_order[i], mul(moving, log_pole));
        change = add(change, scale(f->d_damping[i], friction));
        change = add(change, scale(f->damping * f->d_damping_order[i], mul(friction, log_pole)));
        change = add(change, (cx){f->d_restoring[i], 0});
        cx dp = scale(-1, mul(change, invert(slope))), relative = mul(dp, inverse);
        cx db = add(scale(f->d_damping_order[i] - f->d_order[i], log_pole),
                    scale(f->damping_order - f->order, relative));
        db = scale(f->damping * f->damping_order, mul(b, db));
        db = add(db, scale(f->damping_order * f->d_damping[i] + f->damping * f->d_damping_order[i], b));
        cx dresidue = scale(-1, mul(mul(residue, residue), add((cx){f->d_order[i], 0}, db)));
        cx dimage = mul(image, mul((cx){0, turn}, relative)), dfactor = mul(mul(factor, factor), dimage);
        cx dk = add(mul(dresidue, factor), mul(residue, dfactor));
        pole_column(t, 1 + i, dk, mul(k, dp), p, q->period, &part, &full, 0);
        unit[1 + i] += 2 * dk.re;
    }
    if (delay_free) pole_column(t, 1 + f->free, scale(-1, k), (cx){0, 0}, p, q->period, &part, &full, 1);
    pole_update(full.rest, full.rest_slope, t->pole_step);
    cx drive = full.begun, drive_slope = full.begun_slope, power = {1, 0}, power_slope = {0, 0};
    for (int l = FIT_LANES - 1; l >= 0; l--) {
        cx on = mul(power, drive), on_slope = add(mul(power_slope, drive), mul(power, drive_slope));
        double row[4] = {on.re, on.im, on_slope.re, on_slope.im};
        memcpy(t->pole_drive_block[l], row, sizeof row);
        power_slope = add(mul(power_slope, full.rest), mul(power, full.rest_slope));
        power = mul(power, full.rest);
    }
    memcpy(t->pole_drive, t->pole_drive_block[FIT_LANES - 1], sizeof t->pole_drive);
    pole_update(power, power_slope, t->pole_block);
}

/* Weights of one rate of the branch cut: (h/pi) Im of s^l/(s^l + mu s^a + w) at s = rate e^{j pi}, and derivatives. */
static void cut_weights(const formula *f, cx turn_order, cx turn_damping, double step, double ln, double *weight) {
    cx moving = scale(exp(f->order * ln), turn_order), log_s = {ln, PI};
    cx friction = scale(exp(f->damping_order * ln), turn_damping);
    cx restoring = add(scale(f->damping, friction), (cx){f->restoring, 0});
    cx inverse = invert(add(moving, restoring)), ratio = mul(moving, inverse), base = mul(ratio, inverse);
    cx friction_log = scale(f->damping, mul(friction, log_s)), moving_log = mul(restoring, log_s);
    weight[0] = step / PI * ratio.im;
    for (int i = 0; i < f->free; i++) {
        cx d = add(scale(f->d_order[i], moving_log), scale(-f->d_damping[i], friction));
        d = add(d, scale(-f->d_damping_order[i], friction_log));
        weight[1 + i] = step / PI * mul(base, add(d, (cx){-f->d_restoring[i], 0})).im;
    }
}

/* One real mode: its weights times e^{-r t} at the eight outputs of the block, and its response to the inputs of the
 * block. */
static void mode_part(const fit_problem *q, const formula *f, int i, double ln, double fraction,
                      const double *weight, int outputs, double *past0, fit_table *t) {
    double rate = exp(ln), period = q->period, part = fraction * period;
    double step = exp(-rate * period), rest = exp(-rate * part);
    double full = q->hold ? -expm1(-rate * period) / rate : step;
    double begun = q->hold ? -expm1(-rate * part) / rate : rest;
    double begun_rate = q->hold ? rest : -rate * rest;
    for (int c = 0; c < outputs; c++) {
        int is_delay = c > f->free;
        double w = is_delay ? weight[0] * rate : weight[c]; /* d/d(delay) = -d/dt, and d/dt gives the factor -rate */
        t->input_gain[c][0][0] += is_delay ? -weight[0] * begun_rate : w * begun;
        double at = w * rest;
        if (i < q->modes) {
            for (int j = 0; j < FIT_LANES; j++) {
                t->state_gain[c][i][j] = at;
                past0[c * FIT_LANES + j] += at * full;
                at *= step;
            }
        } else { /* decayed after one period: only the effect of the previous input remains */
            past0[c * FIT_LANES] += at * full;
            t->state_gain[c][t->modes + 4][0] += at * full;
        }
    }
    if (i >= q->modes) return;
    t->decay[i] = step;
    t->drive[i] = full;
    double power = 1;
    for (int l = FIT_LANES - 1; l >= 0; l--) {
        t->drive_block[l][i] = power * full;
        power *= step;
    }
    t->decay_block[i] = power;
}

int fit_make_table(const fit_problem *q, const double *shape, unsigned mask, fit_table *t) {
    formula f;
    cx log_pole;
    make_formula(shape, mask, &f);
    if (!find_pole(&f, shape, &log_pole)) return 0;
    int delay_free = mask >> FIT_DELAY & 1, outputs = 1 + f.free + delay_free;
    double samples = shape[FIT_DELAY] / q->period, whole = ceil(samples - 1e-12), fraction = whole - samples;
    if (fraction < 0) fraction = 0;
    if (!(fabs(whole) + 2 * FIT_LANES < (double)q->pad)) return 0;
    t->shift = (ptrdiff_t)whole;
    t->outputs = outputs;
    t->modes = (q->modes + 3) & ~3; /* whole vectors; the added rows are zero */
    t->states = t->modes + 5;
    memset(t->decay, 0, sizeof t->decay);
    memset(t->decay_block, 0, sizeof t->decay_block);
    memset(t->drive, 0, sizeof t->drive);
    for (int l = 0; l < FIT_LANES; l++) memset(t->drive_block[l] + q->modes, 0, 4 * sizeof(double));
    for (int c = 0; c < outputs; c++) {
        memset(t->state_gain[c], 0, (size_t)t->states * sizeof *t->state_gain[c]);
        memset(t->input_gain[c], 0, sizeof t->input_gain[c]);
    }
    double past0[(1 + FIT_SHAPE) * FIT_LANES] = {0}, weight[1 + FIT_SHAPE], unit[1 + FIT_SHAPE] = {0};
    double rest[1 + FIT_SHAPE] = {1}; /* the remainder of h(0) = 1 and of its derivatives 0 */
    cx turn_order = {cos(PI * f.order), sin(PI * f.order)};
    cx turn_damping = {cos(PI * f.damping_order), sin(PI * f.damping_order)};
    int count = q->modes + q->tail;
    for (int i = 0; i < count; i++) {
        double ln = q->grid_start + i * q->grid_step;
        cut_weights(&f, turn_order, turn_damping, q->grid_step, ln, weight);
        for (int c = 0; c <= f.free; c++) rest[c] -= weight[c];
        mode_part(q, &f, i, ln, fraction, weight, outputs, past0, t);
    }
    for (int c = 0; c < outputs; c++) { /* modes are the same at every position in the block: copy along diagonals */
        double now = t->input_gain[c][0][0];
        for (int l = 0; l < FIT_LANES; l++) {
            t->input_gain[c][l][l] = now;
            for (int j = 0; l + j + 1 < FIT_LANES; j++) t->input_gain[c][l][l + j + 1] = past0[c * FIT_LANES + j];
        }
    }
    pole_part(q, &f, log_pole, fraction, delay_free, t, unit);
    /* rates beyond the grid follow a jump at once, and have decayed a sample later */
    if (q->hold == 0 && fraction == 0)
        for (int c = 0; c <= f.free; c++)
            for (int l = 0; l < FIT_LANES; l++) t->input_gain[c][l][l] += rest[c] - unit[c];
    return 1;
}
