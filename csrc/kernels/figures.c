#include "figures.h"

#include <float.h>
#include <stdlib.h>

#define PI 3.14159265358979323846
#define TAU (2.0 * PI)
#define LONGEST 0.2     /* step in ln w that stays in the valley it began in */
#define CLOSE 1e-6      /* a step after which the error, its square, is rounding */
#define NEWTON_STEPS 20 /* across the expansions, 2 ln 4.4 = 3.0 wide, and half a dozen to converge */
#define LOUDEST 50.0 /* ln of a gain next to which 1 is negligible, and whose powers do not overflow */

static double square(double a) { return a * a; }
static double power_of(cx a) { return a.re * a.re + a.im * a.im; }
static cx divided(cx a, cx b) { return mul(a, invert(b)); }
static cx difference(cx a, cx b) { return (cx){a.re - b.re, a.im - b.im}; }

/* C by its numbers rather than its parameters. */
typedef struct {
    int parameters, order;
    double exponent, lag;      /* of s, and the time constant of the filter */
    double level;              /* ln|C| on the axis, without filter and notch, is level + exponent ln w */
    double log_reference;      /* ln r */
    double lagged_reference;   /* Re of j d r/(1 + j d r) */
    int notched;
    double centre, zero, pole; /* the notch's frequency, and the decay rates of its zeros and poles [1/s] */
} second_term;

static second_term term_of(const figures_outer *outer)
{
    const double *x = outer->x;
    second_term c = {.parameters = outer->parameters, .order = outer->order, .exponent = x[1], .lag = exp(x[2])};
    const double lag_at_reference = square(c.lag * outer->reference);
    c.log_reference = log(outer->reference);
    c.lagged_reference = lag_at_reference / (1.0 + lag_at_reference);
    c.level = x[0] - x[1] * c.log_reference + 0.5 * c.order * log1p(lag_at_reference);
    c.notched = outer->parameters > 3;
    if (c.notched) {
        c.centre = exp(x[3]);
        c.pole = exp(x[4]) * c.centre;
        c.zero = exp(x[5]) * c.pole;
    }
    return c;
}

/* A frequency, its logarithm on the principal branch, and the factors of C there: 1/(1 + d s), and of the notch
 * 1/(s^2 + 2 half s + centre^2) for its zeros and its poles. */
typedef struct {
    cx s, log, filter, zeros, poles;
} point;

static cx factor_of(const second_term *c, cx s, double half)
{
    const cx shifted = mul(s, (cx){s.re + 2.0 * half, s.im});
    return invert((cx){shifted.re + square(c->centre), shifted.im});
}

static point point_at(const second_term *c, cx s, cx log_s)
{
    point p = {.s = s, .log = log_s, .filter = invert((cx){1.0 + c->lag * s.re, c->lag * s.im})};
    if (c->notched) {
        p.zeros = factor_of(c, s, c->zero);
        p.poles = factor_of(c, s, c->pole);
    }
    return p;
}

static point on_axis(const second_term *c, double w, double log_w)
{
    return point_at(c, (cx){0.0, w}, (cx){log_w, 0.5 * PI});
}

/* ln|C| on the axis */
static double log_gain(const second_term *c, const point *p)
{
    double power = 1.0;
    for (int k = 0; k < c->order; k++)
        power *= power_of(p->filter);
    if (c->notched) power *= power_of(p->poles) / power_of(p->zeros);
    return c->level + c->exponent * p->log.re + 0.5 * log(power);
}

/* The phase of C on the axis, whose notch stays within half a turn. */
static double phase(const second_term *c, const point *p)
{
    double value = 0.5 * PI * c->exponent - c->order * atan(c->lag * p->s.im);
    if (c->notched) {
        const cx notch = divided(p->poles, p->zeros);
        value += atan2(notch.im, notch.re);
    }
    return value;
}

static cx value_of(const second_term *c, const point *p)
{
    cx value = exponential((cx){fmin(c->level + c->exponent * p->log.re, LOUDEST), c->exponent * p->log.im});
    for (int k = 0; k < c->order; k++)
        value = mul(value, p->filter);
    return c->notched ? mul(value, divided(p->poles, p->zeros)) : value;
}

/* d s/(1 + d s) */
static cx lagged(const second_term *c, const point *p) { return scale(c->lag, mul(p->s, p->filter)); }

/* d ln C/d ln s */
static cx slope_of(const second_term *c, const point *p)
{
    cx value = scale(-c->order, lagged(c, p));
    value.re += c->exponent;
    if (c->notched) {
        const cx above = mul((cx){p->s.re + c->zero, p->s.im}, p->zeros);
        const cx below = mul((cx){p->s.re + c->pole, p->s.im}, p->poles);
        value = add(value, mul(scale(2.0, p->s), difference(above, below)));
    }
    return value;
}

/* The derivatives of ln C with respect to the parameters. */
static void gradient_of(const second_term *c, const point *p, cx g[FIGURES_PARAMETERS])
{
    const cx filter = lagged(c, p);
    g[0] = (cx){1.0, 0.0};
    g[1] = (cx){p->log.re - c->log_reference, p->log.im};
    g[2] = scale(-c->order, (cx){filter.re - c->lagged_reference, filter.im});
    if (c->notched) {
        const cx above = scale(2.0 * c->zero, mul(p->s, p->zeros));
        g[4] = difference(above, scale(2.0 * c->pole, mul(p->s, p->poles)));
        g[3] = add(scale(2.0 * square(c->centre), difference(p->zeros, p->poles)), g[4]);
        g[5] = above;
    }
}

/* ln L between two columns: the cubic Hermite interpolant over ln w. */
typedef struct {
    double start, width;
    cx c[4];
} cubic;

/* A place on it: ln L and its slope over ln w. */
typedef struct {
    double w, log_w;
    cx log, slope;
} place;

static cubic cubic_between(const double *log_w, const cx *log, const cx *slope)
{
    cubic f = {.start = log_w[0], .width = log_w[1] - log_w[0]};
    const cx s0 = scale(f.width, slope[0]), s1 = scale(f.width, slope[1]), a = difference(log[1], log[0]);
    f.c[0] = log[0];
    f.c[1] = s0;
    f.c[2] = difference(scale(3.0, a), add(scale(2.0, s0), s1));
    f.c[3] = difference(add(s0, s1), scale(2.0, a));
    return f;
}

static place place_at(const cubic *f, double t)
{
    const cx *c = f->c;
    const cx value = add(c[0], scale(t, add(c[1], scale(t, add(c[2], scale(t, c[3]))))));
    const cx rise = add(c[1], scale(t, add(scale(2.0, c[2]), scale(3.0 * t, c[3]))));
    const double log_w = f->start + t * f->width;
    return (place){exp(log_w), log_w, value, scale(1.0 / (f->width > 0.0 ? f->width : 1.0), rise)};
}

static double within_one(double t) { return fmin(fmax(t, 0.0), 1.0); }

/* Where ln|L| or the phase meets a line: a secant, then two steps of Newton's method. */
static place zero_of(const cubic *f, int imaginary, double line)
{
    double c[4];
    for (int k = 0; k < 4; k++)
        c[k] = imaginary ? f->c[k].im : f->c[k].re;
    const double first = c[0] - line, last = c[0] + c[1] + c[2] + c[3] - line;
    double t = first / (first - last);
    for (int step = 0; step < 2; step++) {
        const double value = c[0] + t * (c[1] + t * (c[2] + t * c[3])) - line;
        const double rate = c[1] + t * (2.0 * c[2] + 3.0 * t * c[3]);
        t = within_one(t - value / (fabs(rate) > 1e-12 ? rate : 1.0));
    }
    return place_at(f, t);
}

/* The local minimum of |1 + L|, from half the slope of its square at both ends: a secant, then Newton's method. */
static place nearest_to_minus_one(const cubic *f, double low, double high)
{
    double t = low / (low - high);
    for (int step = 0; step < 2; step++) {
        const place p = place_at(f, t);
        const cx loop = exponential(p.log), one = {1.0 + loop.re, loop.im};
        const cx bend = scale(1.0 / square(f->width), add(scale(2.0, f->c[2]), scale(6.0 * t, f->c[3])));
        const cx back = mul((cx){one.re, -one.im}, loop);
        const double rate = power_of(mul(loop, p.slope)) + mul(back, add(mul(p.slope, p.slope), bend)).re;
        if (rate > 0.0) t = within_one(t - mul(back, p.slope).re / (rate * f->width));
    }
    return place_at(f, t);
}

/* A slope as a divisor, of modulus at least 0.01. */
static double steep(double slope) { return copysign(fmax(fabs(slope), 1e-2), slope); }

/* One link: its loop at every column, and its place in the answer. */
typedef struct {
    const figures_table *table;
    const second_term *c;
    int number;
    const double *w, *log_w;
    cx *logs, *slopes;
    double *distances; /* |1 + L|^2 */
    place *crossings;
    double *value, *gradient;
} link;

static void set(const link *l, int figure, double value, const double *gradient)
{
    const int links = l->table->links, figures = FIGURE_MODES + l->table->modes;
    l->value[figure * links + l->number] = value;
    for (int k = 0; k < l->c->parameters; k++)
        l->gradient[(k * figures + figure) * links + l->number] = gradient[k];
}

/* The same if it is less than the present value. */
static void set_less(const link *l, int figure, double value, const double *gradient)
{
    if (!(l->value[figure * l->table->links + l->number] <= value)) set(l, figure, value, gradient);
}

/* A figure whose slope over x is Re(factor d ln C/dx). */
static void set_moved(const link *l, int figure, double value, double w, double log_w, cx factor)
{
    cx g[FIGURES_PARAMETERS];
    double slope[FIGURES_PARAMETERS];
    const point p = on_axis(l->c, w, log_w);
    gradient_of(l->c, &p, g);
    for (int k = 0; k < l->c->parameters; k++)
        slope[k] = mul(factor, g[k]).re;
    set_less(l, figure, value, slope);
}

static cubic interval(const link *l, int i) { return cubic_between(l->log_w + i, l->logs + i, l->slopes + i); }

static int above_one(const link *l, int i) { return l->logs[i].re > 0.0; }

static void level_figures(const link *l)
{
    const figures_table *table = l->table;
    const double *band = table->band + 2 * l->number, resonance = table->resonance[l->number];
    const double level = l->logs[table->column[l->number]].re, log_resonance = log(resonance);
    set_moved(l, FIGURE_LEVEL, level, resonance, log_resonance, (cx){1.0, 0.0});
    set_moved(l, FIGURE_REACH, log_resonance + fmin(level, 0.0), resonance, log_resonance, (cx){1.0, 0.0});
    int loudest = -1;
    for (int i = 0; i < table->columns; i++) {
        const int judged = l->w[i] >= table->highest[l->number] && !(l->w[i] > band[0] && l->w[i] < band[1]);
        if (judged && (loudest < 0 || l->logs[i].re > l->logs[loudest].re)) loudest = i;
    }
    if (loudest < 0) return;
    set_moved(l, FIGURE_QUIET, -l->logs[loudest].re, l->w[loudest], l->log_w[loudest], (cx){-1.0, 0.0});
}

static void crossing_figures(const link *l)
{
    const double *band = l->table->band + 2 * l->number;
    const int first_rises = !above_one(l, 0), count = l->c->parameters;
    int number = 0, beyond = 0;
    for (int i = 0; i + 1 < l->table->columns; i++)
        if (above_one(l, i) != above_one(l, i + 1)) {
            const cubic f = interval(l, i);
            l->crossings[number++] = zero_of(&f, 0, 0.0);
        }
    for (int i = 0; i < number; i++) {
        const place p = l->crossings[i];
        const point at = on_axis(l->c, p.w, p.log_w);
        const int rises = first_rises == !(i & 1), partner = rises ? i + 1 : i - 1;
        /* |L| > 1 between a rising and the next falling crossing: the loop is stable where both lie in one band of 2 pi
         * about a multiple of it. At the ends of the table there is no partner. */
        const double alone = rises ? p.log.im : l->logs[0].im;
        const int paired = partner >= 0 && partner < number;
        const double middle = paired ? 0.5 * (p.log.im + l->crossings[partner].log.im) : alone;
        const double offset = p.log.im - TAU * nearbyint(middle / TAU), room = offset + PI;
        cx g[FIGURES_PARAMETERS];
        double moved[FIGURES_PARAMETERS], margin[FIGURES_PARAMETERS], delay[FIGURES_PARAMETERS];
        gradient_of(l->c, &at, g);
        for (int k = 0; k < count; k++) {
            moved[k] = -g[k].re / steep(p.slope.re);
            const double turn = g[k].im + moved[k] * p.slope.im;
            margin[k] = offset > 0.0 ? -turn : turn;
            delay[k] = (turn - room * moved[k]) / p.w;
        }
        set_less(l, FIGURE_MARGIN, PI - fabs(offset), margin);
        set_less(l, FIGURE_DELAY, room / p.w, delay);
        if (p.w > l->table->resonance[l->number] && !beyond++ && !rises) {
            set(l, FIGURE_CROSSOVER, p.log_w, moved);
            set(l, FIGURE_REACH, p.log_w, moved);
        }
        if (p.w <= band[0] || p.w >= band[1]) set(l, FIGURE_LAST, p.log_w, moved);
    }
}

static void distance_figure(const link *l)
{
    double before = 0.0;
    for (int i = 0; i < l->table->columns; i++) {
        const cx loop = exponential((cx){fmin(l->logs[i].re, LOUDEST), l->logs[i].im}), one = {1.0 + loop.re, loop.im};
        /* half of d|1 + L|^2/d ln w, which turns positive at a local minimum */
        const double turn = mul(mul((cx){one.re, -one.im}, loop), l->slopes[i]).re;
        l->distances[i] = power_of(one);
        if (before < 0.0 && !(turn < 0.0) && fmin(l->distances[i - 1], l->distances[i]) < square(1.5)) {
            const cubic f = interval(l, i - 1);
            const place p = nearest_to_minus_one(&f, before, turn);
            const cx peak = exponential(p.log), distance = {1.0 + peak.re, peak.im};
            set_moved(l, FIGURE_DISTANCE, 0.5 * log(power_of(distance) + DBL_MIN), p.w, p.log_w, divided(peak, distance));
        }
        before = turn;
    }
}

/* A polynomial and its derivative. */
static void polynomial(const cx *coefficient, int terms, cx v, cx *value, cx *slope)
{
    *value = *slope = (cx){0.0, 0.0};
    for (int k = terms - 1; k >= 0; k--) {
        *slope = add(mul(*slope, v), *value);
        *value = add(mul(*value, v), coefficient[k]);
    }
}

/* The root of D(1 + L) = D + C R that Newton's method finds from a column: its Im ln w says how it is damped. D, the
 * denominator of the link, and R = D L/C have no pole near it, so that their expansions about the nearest of a row of
 * points hold up to `radius` from there. */
static void damping_from(const link *l, int column)
{
    const figures_table *table = l->table;
    const ptrdiff_t row = (ptrdiff_t)l->number * table->expansions;
    const double *centre = table->centre + row;
    const int last = table->expansions - 1;
    const double spacing = (centre[last] - centre[0]) / last, log_resonance = log(table->resonance[l->number]);
    cx u = {l->log_w[column], 0.0};
    for (int step = 0; step < NEWTON_STEPS; step++) {
        const double away = u.re - log_resonance;
        if (!(fabs(away) <= table->region)) return;
        const int nearest = (int)fmin(fmax(nearbyint((u.re - centre[0]) / spacing), 0.0), last);
        const cx v = {(u.re - centre[nearest]) / table->radius, u.im / table->radius};
        if (!(power_of(v) < 1.0)) return;
        const ptrdiff_t first = (row + nearest) * table->terms;
        cx plant, plant_slope, loop, loop_slope;
        polynomial(table->plant + first, table->terms, v, &plant, &plant_slope);
        polynomial(table->loop + first, table->terms, v, &loop, &loop_slope);
        const cx log_s = {u.re, u.im + 0.5 * PI};
        const point p = point_at(l->c, exponential(log_s), log_s);
        const cx outer = value_of(l->c, &p), closed = mul(outer, loop);
        const cx around = scale(1.0 / table->radius, add(plant_slope, mul(outer, loop_slope)));
        const cx rate = add(around, mul(closed, slope_of(l->c, &p)));
        const cx change = divided(add(plant, closed), rate);
        const double size = sqrt(power_of(change));
        if (size < CLOSE) {
            cx g[FIGURES_PARAMETERS];
            double slope[FIGURES_PARAMETERS];
            gradient_of(l->c, &p, g);
            for (int k = 0; k < l->c->parameters; k++)
                slope[k] = cos(u.im) * divided(mul(plant, g[k]), rate).im;
            set_less(l, FIGURE_DAMPING, sin(u.im), slope);
            return;
        }
        u = difference(u, scale(fmin(1.0, LONGEST / size), change));
    }
}

/* A weak loop hardly moves the link's own pole; any other vibration is where L comes near to -1. */
static void damping_figure(const link *l)
{
    const double *d = l->distances;
    for (int i = 1; i + 1 < l->table->columns; i++)
        if (i == l->table->column[l->number] || (d[i] <= d[i - 1] && d[i] < d[i + 1])) damping_from(l, i);
}

/* The distance from -1 implies a gain margin: no search needs its gradient. */
static void gain_margin_figure(const link *l)
{
    const double no_gradient[FIGURES_PARAMETERS] = {0.0};
    for (int i = 0; i + 1 < l->table->columns; i++) {
        const double half = floor((l->logs[i].im + PI) / TAU), next = floor((l->logs[i + 1].im + PI) / TAU);
        if (half == next) continue;
        const cubic f = interval(l, i);
        const place p = zero_of(&f, 1, PI * (2.0 * fmax(half, next) - 1.0));
        if (p.log.re < 0.0) set_less(l, FIGURE_GAIN_MARGIN, -p.log.re, no_gradient);
    }
}

static void noise_figures(const link *l)
{
    const figures_table *table = l->table;
    const ptrdiff_t first = (ptrdiff_t)l->number * table->noise_points;
    const int count = l->c->parameters;
    double power[2] = {0.0}, slope[2][FIGURES_PARAMETERS] = {{0.0}};
    for (ptrdiff_t i = first; i < first + table->noise_points; i++) {
        const point p = on_axis(l->c, table->noise_w[i], table->noise_log_w[i]);
        const cx value = value_of(l->c, &p), loop = mul(value, table->noise_rest[i]);
        const cx back = invert((cx){1.0 + loop.re, loop.im});
        const double noise = table->weight[i] * power_of(mul(value, back));
        const double share[2] = {noise, noise * square(table->voltage[i])};
        cx g[FIGURES_PARAMETERS];
        gradient_of(l->c, &p, g);
        for (int part = 0; part < 2; part++) {
            power[part] += share[part];
            for (int k = 0; k < count; k++)
                slope[part][k] += share[part] * mul(g[k], back).re;
        }
    }
    for (int part = 0; part < 2 && power[part] > 0.0; part++) {
        for (int k = 0; k < count; k++)
            slope[part][k] /= power[part];
        set(l, FIGURE_NOISE + part, 0.5 * log(power[part]), slope[part]);
    }
}

/* About a lightly damped mode L runs round a circle through 0 and its peak P, whose distance to -1 is
 * |1 + P/2| - |P|/2: the gain that points there is one minus that, or |P| where the phase is in doubt by too much. */
static void mode_figures(const link *l)
{
    const figures_table *table = l->table;
    for (int mode = 0; mode < table->modes; mode++) {
        const ptrdiff_t first = ((ptrdiff_t)l->number * table->modes + mode) * table->mode_points;
        ptrdiff_t top = first;
        double most = -INFINITY;
        for (ptrdiff_t i = first; i < first + table->mode_points; i++) {
            const point p = on_axis(l->c, table->modes_w[i], table->modes_log_w[i]);
            const double gain = log_gain(l->c, &p) + table->modes_level[i].re;
            if (gain > most) most = gain, top = i;
        }
        const point p = on_axis(l->c, table->modes_w[top], table->modes_log_w[top]);
        const double angle = remainder(phase(l->c, &p) + table->modes_level[top].im, TAU);
        const double radius = 0.5 * exp(fmin(most, LOUDEST)), turned = fabs(angle) + table->doubt;
        double gain = 2.0 * radius, by_gain = gain, by_phase = 0.0;
        if (turned < PI) {
            const cx one = {1.0 + radius * cos(turned), radius * sin(turned)};
            const double apart = sqrt(power_of(one) + DBL_MIN);
            gain = 1.0 + radius - apart;
            by_gain = radius * (1.0 - (cos(turned) + radius) / apart);
            by_phase = copysign(one.im / apart, angle);
        }
        gain = fmax(gain, DBL_EPSILON);
        const cx factor = {by_gain / gain, -by_phase / gain};
        set_moved(l, FIGURE_MODES + mode, log(gain), table->modes_w[top], table->modes_log_w[top], factor);
    }
}

int figures_of(const figures_table *table, const figures_outer *outer, double *value, double *gradient)
{
    const second_term c = term_of(outer);
    const int columns = table->columns, entries = (FIGURE_MODES + table->modes) * table->links;
    link l = {.table = table, .c = &c, .value = value, .gradient = gradient};
    l.logs = malloc(columns * (2 * sizeof(cx) + sizeof(place) + sizeof(double)));
    if (!l.logs) return 1;
    l.slopes = l.logs + columns;
    l.crossings = (place *)(l.slopes + columns);
    l.distances = (double *)(l.crossings + columns);
    for (int i = 0; i < entries; i++)
        value[i] = NAN;
    for (int i = 0; i < entries * c.parameters; i++)
        gradient[i] = 0.0;
    for (l.number = 0; l.number < table->links; l.number++) {
        const ptrdiff_t row = (ptrdiff_t)l.number * columns;
        l.w = table->w + row;
        l.log_w = table->log_w + row;
        for (int i = 0; i < columns; i++) {
            const point p = on_axis(&c, l.w[i], l.log_w[i]);
            const cx own = {log_gain(&c, &p), phase(&c, &p)};
            l.logs[i] = add(own, table->rest[row + i]);
            l.slopes[i] = add(slope_of(&c, &p), table->slope[row + i]);
        }
        level_figures(&l);
        crossing_figures(&l);
        distance_figure(&l);
        damping_figure(&l);
        gain_margin_figure(&l);
        noise_figures(&l);
        mode_figures(&l);
    }
    free(l.logs);
    return 0;
}
