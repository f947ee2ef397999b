/* Figures of the loops L of many links, and their slopes over the parameters x of the second term C of a controller:
 *
 *     ln C = x0 + x1 ln(s/r) - n (ln(1 + d s) - ln|1 + j d r|) + ln N(s),   d = exp(x2),
 *
 * with a notch N of frequency exp(x3), whose poles have the damping ratio exp(x4) and whose zeros exp(x4 + x5). */
#ifndef FRACLINK_FIGURES_H
#define FRACLINK_FIGURES_H
#include <stddef.h>
#include <stdint.h>

#include "complex_pair.h"

enum { FIGURES_PARAMETERS = 6 };

/* The loops beside C, one row per link; frequencies in rad/s. */
typedef struct {
    int links, columns, noise_points, modes, mode_points, expansions, terms;
    const double *w, *log_w;             /* links x columns: the frequencies, and ln of them */
    const cx *rest, *slope;              /* ln of the loop beside C, and its slope over ln w */
    const double *noise_w, *noise_log_w; /* links x noise_points */
    const double *weight;                /* of the noise integral; zeros where a link has none */
    const cx *noise_rest;                /* the loop beside C there */
    const double *voltage;               /* from motor reference to voltage [V/rad] */
    const double *modes_w, *modes_log_w; /* links x modes x mode_points, about each of the higher modes */
    const cx *modes_level;               /* ln of the loop beside C there, its imaginary part NaN where no phase counts */
    double doubt;                        /* of that phase */
    const double *centre;                /* links x expansions: where D and R are expanded, ln w in even steps */
    const cx *plant, *loop;              /* links x expansions x terms: D and R over (ln w - centre)/radius */
    double radius;
    double region;                       /* how far from the resonance roots are looked for, in ln w */
    const double *resonance, *highest;   /* links: the first mode, and from where on |L| must be < 1 */
    const double *band;                  /* links x 2: the ends of the second mode's band */
    const int64_t *column;               /* links: the column of the resonance */
} figures_table;

typedef struct {
    int parameters; /* 3, or 6 with a notch */
    int order;      /* n */
    double reference, x[FIGURES_PARAMETERS];
} figures_outer;

/* One row per figure, with the least or the only value of each link; NaN where it has none. */
enum {
    FIGURE_CROSSOVER,   /* ln w where |L| first falls to 1 beyond the resonance; later falls are lobes of a late gauge */
    FIGURE_REACH,       /* the same; without it ln of the resonance, plus ln|L| there if it is negative */
    FIGURE_LEVEL,       /* ln|L| at the resonance */
    FIGURE_LAST,        /* ln w of the last crossing, except at the second mode */
    FIGURE_QUIET,       /* -ln|L| at its largest beyond `highest`, except at the second mode */
    FIGURE_MARGIN,      /* distance of a crossing from the edges of its band [rad], negative on the wrong side */
    FIGURE_DELAY,       /* the delay that takes its phase to the lower edge [s] */
    FIGURE_DISTANCE,    /* ln of the local minima of |1 + L| */
    FIGURE_GAIN_MARGIN, /* ln of the factor by which |L| < 1 may grow where the phase passes -180 degrees */
    FIGURE_DAMPING,     /* damping ratio of the roots of 1 + L near the axis, within the region */
    FIGURE_NOISE,       /* ln of the RMS of C/(1 + L) over the noise integral */
    FIGURE_VOLTAGE,     /* the same for the voltage */
    FIGURE_MODES        /* ln of the part of the gain at a higher mode that points to -1, a row for each mode */
};

/* `value`: (FIGURE_MODES + modes) x links; `gradient`: parameters x (FIGURE_MODES + modes) x links.
 * Returns 0, or 1 where there is no memory. */
int figures_of(const figures_table *table, const figures_outer *outer, double *value, double *gradient);

#endif
