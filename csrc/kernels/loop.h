/* Desktop only: the arm around law.c. The law is compiled in unmodified, once per precision. */
#ifndef FRACLINK_LOOP_H
#define FRACLINK_LOOP_H

#include <stdint.h>

#include "complex_pair.h"
#include "law_port.h"

#define LOOP_POWERS 6
#define LOOP_MODES 64  /* most real modes, and most pairs, of a link */
#define LOOP_DELAY 101 /* longest delay in periods, plus one */
#define LOOP_SECOND 15 /* numbers of a second mode */

/* The link from motor angle to tip angle, exact for a motor angle of degree 5 within each period:
 * tip[k+1] = sum_j first[j] q_j[k] + sum_i x_i[k+1] + Re sum_i z_i[k+1],
 * x_i[k+1] = decay_i x_i[k] + sum_j weight_ij q_j[k], the same for the pairs z.
 * A second mode is one more pair; it bends the gauge by gain theta_m + Re z and leaves the tip where it is. */
typedef struct {
    int reals;
    int pairs;
    const double *decay;     /* reals */
    const double *weight;    /* 6 x reals */
    const cx *pair;          /* pairs */
    const cx *pair_weight;   /* 6 x pairs */
    double first[LOOP_POWERS];
    double stiffness;
    const double *second; /* gain, decay (re, im), 6 weights re, 6 im; null where there is none */
} loop_link;

/* Weights of one step of the motor, the only numbers of the loop that need a math library. They are computed
 * outside of it (weights.c), so that the loop has the same bits wherever it is compiled, in a browser too. */
typedef struct {
    double keep;   /* e^(-p T) or e^(-B h) */
    double first;  /* (1 - e^(-B h))/B */
    double second; /* (h - first)/B */
} loop_weights;

typedef struct {
    int sampled;           /* 0: M(s) follows the motor reference; 1: motor under voltage, inner loop in the law */
    int substeps;          /* friction substeps in a period */
    int delay;             /* periods from sensor to actuator */
    double period;
    double pole;           /* p of M(s) [rad/s] */
    double gain;           /* A [rad/(s^2 V)] */
    double decay;          /* B [1/s] */
    double friction;       /* Coulomb deceleration [rad/s^2] */
    double encoder;        /* resolution [rad], 0 = exact */
    double offset;         /* gauge offset from the second period on [N m] */
    double noise;          /* standard deviation of a gauge sample [N m] */
    double limit;          /* largest gauge reading [N m] */
    double quantum;        /* gauge resolution [N m], 0 = exact */
    double gauge_delay;    /* age of the torque that the gauge shows, in periods, below LOOP_DELAY; 0 = none */
    double gauge_gain;     /* what the gauge shows of a torque [1] */
    double payload;        /* that the law is given [kg]; 0: none */
    double start;          /* angle at rest before the first period [rad] */
    loop_weights weights;  /* loop_weights_of this rig */
    const void *estimator; /* payload_params of the law's precision, whose estimate the law is given; null: `payload` */
} loop_rig;

/* What is recorded, one value for each period. */
enum {
    LOOP_TIP_ANGLE,
    LOOP_MOTOR_REFERENCE,
    LOOP_VOLTAGE,
    LOOP_MOTOR_ANGLE,
    LOOP_TORQUE,
    LOOP_TORQUE_MEASURED,
    LOOP_TIP_ESTIMATE,
    LOOP_MOTOR_ANGLE_MEASURED,
    LOOP_SIGNALS
};
enum { LOOP_FLAGS, LOOP_MODE, LOOP_REASON, LOOP_MARKS };

/* One arm, and what comes from outside period by period. Its reference is `amplitude` times the one here. */
typedef struct {
    loop_link link;
    loop_rig rig;
    double amplitude;
    const double *reference;
    const double *acceleration;
    const double *normal; /* standard normal numbers of the gauge's noise; not read where the rig has none */
    const double *faults; /* rows of the twin's inputs (twin.h), of which those of a fault are read; null: healthy */
    double *signal[LOOP_SIGNALS];
    uint32_t *mark[LOOP_MARKS];
} loop_arm;

/* Arms that run in step: one alone would wait, as each friction substep needs the speed of the one before; eight side
 * by side fill that time in the lanes of one vector. There are no sums over lanes, so that neither their number nor
 * the width of the machine's vectors changes a bit. */
#ifndef LOOP_LANES
#define LOOP_LANES 8
#endif

/* Run up to LOOP_LANES arms under one law, whose `params` are a law_params of its precision. Their rigs share `sampled`,
 * `substeps` and `period`. Return 0, or 1 where a bound above is exceeded. */
int loop_run(const loop_arm *arms, int count, const law_port *law, const void *params, int64_t length);

loop_weights loop_weights_of(const loop_rig *rig);

/* Standard normal numbers of counters 0 ... length - 1 of stream `seed`: the same wherever they are drawn. */
void loop_normals(uint64_t seed, double *out, int64_t length);

#endif
