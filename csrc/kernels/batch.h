/* Closed loops of many arms in one call: the same law and references with a different arm in each run. A single arm
 * is a call with one run; Python has no other access to the loop. */
#ifndef FRACLINK_BATCH_H
#define FRACLINK_BATCH_H

#include <stdint.h>

#include "loop.h"

/* Columns of a run's numbers. */
enum {
    BATCH_STIFFNESS,   /* c [N m/rad] */
    BATCH_GAIN,        /* A of the motor [rad/(s^2 V)] */
    BATCH_DECAY,       /* B of the motor [1/s] */
    BATCH_FRICTION,    /* Coulomb deceleration [rad/s^2] */
    BATCH_OFFSET,      /* of the gauge [N m] */
    BATCH_NOISE,       /* standard deviation of a gauge sample [N m] */
    BATCH_DELAY,       /* whole periods */
    BATCH_AMPLITUDE,   /* amplitude of the reference [rad] */
    BATCH_GAUGE_DELAY, /* in periods, not necessarily whole */
    BATCH_GAUGE_GAIN,  /* [1] */
    BATCH_PAYLOAD,     /* payload given to the law [kg]; 0: none */
    BATCH_COLUMNS
};

/* Links of all runs, padded to the same number of real modes and pairs; layout as in loop_link, one run after the
 * other. */
typedef struct {
    int reals;
    int pairs;
    const double *decay;
    const double *weight;
    const double *pair_re;
    const double *pair_im;
    const double *weight_re;
    const double *weight_im;
    const double *first;
    const double *second; /* LOOP_SECOND numbers per run; null if no link has a second mode */
} batch_links;

/* `traces` are those of the first run; each further run has the next row of `length`. `path` holds unit references
 * (angle, acceleration) of `length` each, `chosen` the index of the one that a run follows; all runs share `rig` and
 * `faults` (as in loop_arm, null for none). `noise` has room for LOOP_LANES rows. Return 0, or 1 if a bound of
 * loop.h is exceeded. */
int batch_run(int64_t runs, int64_t length, const batch_links *links, const loop_rig *rig, const double *numbers,
              const uint64_t *seeds, const int32_t *chosen, const double *path, const double *faults,
              const law_port *law, const void *params, double *noise, const loop_trace *traces);

#endif
