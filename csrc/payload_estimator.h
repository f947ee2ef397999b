/* Estimate of the payload at the tip, from motor angle and gauge while the arm moves, for `law_input.payload`.
 *
 * ISO C99, like law.c: no heap, no library, no clock, no static data; the caller owns constant block and state.
 *
 *   payload_state memory;
 *   reason = payload_init(&memory, &payload_data);      once; unless it returns LAW_OK, give the law 0
 *   every control period, before law_step:
 *   payload_step(&memory, &payload_data, input.tick, input.motor_angle, input.torque, &estimate);
 *   input.payload = estimate.given;
 *
 * A bank of models, one for each of several payloads, predicts the torque from the motor angle; the estimate is
 * interpolated between the best model and its neighbours. The gain and offset of the gauge are estimated with each
 * model. The feedback loop of the law does not depend on it: the law bounds the value in `given` and slews towards
 * it.
 */
#ifndef FRACLINK_PAYLOAD_ESTIMATOR_H
#define FRACLINK_PAYLOAD_ESTIMATOR_H

#include "law.h"

#define PAYLOAD_VERSION 3U
#define PAYLOAD_MODELS 14U /* payloads of the bank */

/* Flags of one period. */
#define PAYLOAD_FROZEN 1U    /* nothing moves: the estimate is that of the last motion */
#define PAYLOAD_OUTSIDE 2U   /* the whole interval lies outside the payloads covered by the certificate */
#define PAYLOAD_CONTACT 4U   /* a torque that no payload explains: the tip or the link has touched something */
#define PAYLOAD_GIVEN 8U     /* the interval is narrow: the law gets the estimate */
#define PAYLOAD_CHANGED 16U  /* the payload has changed: the estimator forgets and starts again */
#define PAYLOAD_SAMPLE 32U   /* a sample was rejected and replaced by the last one */

/* Model of one payload: the transfer function from motor angle to torque is (1 - 1/z)(b0 + b1/z + b2/z^2)/A with A =
 * 1 + a1/z + a2/z^2 + a3/z^3, a vibration and one real mode for the effect of a fractional order. The error is filtered
 * by A/C with C = 1 + c1/z + c2/z^2 + c3/z^3, whose poles make an initial vibration decay quickly. */
typedef struct {
    law_real a1;
    law_real a2;
    law_real a3;
    law_real b0;
    law_real b1;
    law_real b2;
    law_real c1;
    law_real c2;
    law_real c3;
    law_real rest; /* share of a constant torque that remains in the error */
    law_real power; /* for white noise of variance 1: variance of the error, its covariances with the filter state */
    law_real echo0;
    law_real echo1;
    law_real echo2;
    law_real mass; /* payload plus the link's equivalent mass at the tip [kg] */
} payload_model;

/* Everything computed by the exporter. `crc` is the CRC-32 of all bytes after it, as in law_params. */
typedef struct {
    uint32_t version;
    uint32_t size;
    uint32_t precision;
    uint32_t crc;
    uint32_t together;     /* periods averaged into one sample of the models */
    uint32_t chunk;        /* models updated in one period */
    uint32_t quiet_limit;  /* samples without motion before the estimate is frozen */
    uint32_t gap_limit;    /* missed periods or periods without a good sample before the estimator restarts */
    law_real angle_limit;  /* largest encoder angle [rad] */
    law_real torque_limit; /* largest credible gauge torque [N m] */
    law_real torque_moved; /* measured or predicted torque above which the arm counts as moving [N m] */
    law_real variance;     /* variance of the error of the correct model [(N m)^2] */
    law_real gain_weight;  /* `variance` divided by the variance of the gauge's gain */
    law_real offset_variance; /* variance of the gauge's offset before anything is known of it [(N m)^2] */
    law_real keep;         /* share of the evidence that is kept from sample to sample while the arm moves */
    law_real surprise;     /* square of the relative torque error admitted for the correct model */
    law_real contact;      /* the same for a torque that no payload explains */
    law_real link;         /* equivalent mass of the link at its tip [kg] */
    law_real narrow;       /* largest relative standard deviation at which the law gets the estimate */
    law_real width;        /* half width of the interval in standard deviations */
    law_real payload_limit; /* largest payload [kg] */
    law_real certified_low; /* payloads covered by the certificate [kg] */
    law_real certified_high;
    payload_model model[PAYLOAD_MODELS];
} payload_params;

/* State of one model: its filter, and sums over the errors e and the predicted torques v. */
typedef struct {
    law_real torque[3];
    law_real angle[3];
    law_real ee;
    law_real ev;
    law_real vv;
    law_real e;
    law_real v;
} payload_memory;

/* Gain and offset of the gauge that fit a model best, and the cost with them. */
typedef struct {
    law_real gain;
    law_real offset;
    law_real cost;
} payload_fit;

typedef struct {
    uint32_t stamp; /* crc of the parameters with which it was started */
    uint32_t tick;
    uint32_t count;   /* periods in the sample being formed */
    uint32_t next;    /* model to be updated next */
    uint32_t gap;     /* consecutive periods without a good sample */
    uint32_t quiet;   /* consecutive samples without motion */
    uint32_t odd;     /* consecutive samples that the best model does not explain */
    uint32_t touched; /* consecutive samples that no model explains */
    uint32_t best;    /* model with the smallest cost of this sample */
    uint32_t flags;
    payload_memory model[PAYLOAD_MODELS];
    law_real angle_sum;
    law_real torque_sum;
    law_real last_angle; /* last good readings */
    law_real last_torque;
    law_real angle;  /* mean angle of the previous sample */
    law_real change; /* change of the mean angle, and the mean torque without its offset: the inputs of the models */
    law_real torque;
    law_real offset;
    law_real offset_variance;
    law_real shift;      /* change of the offset in this sample */
    law_real drift;      /* further change of the offset according to the best model */
    law_real samples;    /* effective number of samples in the sums */
    law_real keep;       /* share of the sums that is kept in this sample */
    law_real best_cost;  /* best model so far: cost, predicted torque, and excess of its squared error [(N m)^2] */
    law_real best_told;
    law_real best_error;
    law_real left[3];    /* remaining errors of the best model, in the middle, and of its neighbours */
    law_real before_left; /* remaining error of the previous model */
    law_real carried[3]; /* noise of the estimate: covariance with the filter, variance, variance for white errors */
    law_real spread;
    law_real remaining; /* sum of the squares of the errors that remain [(N m)^2] */
    law_real white;
    law_real sum;       /* checksums: of the values that outlast a period, of the means being formed, of the models */
    law_real means;
    law_real models;
    law_real models_found; /* checksums of the models updated in this sample, before and after */
    law_real models_left;
    law_real least;     /* smallest excess of the error over the limit for a contact [(N m)^2] */
    law_real deviation; /* relative standard deviation of the mass */
    law_real estimate;
    law_real low;
    law_real high;
} payload_state;

typedef struct {
    law_real given;    /* for law_input.payload: 0, or the estimate while its interval is narrow [kg] */
    law_real estimate; /* [kg]; 0: none yet */
    law_real low;      /* 95 % interval [kg] */
    law_real high;
    uint32_t flags;
} payload_output;

/* Return LAW_OK, or the reason why the parameter block must not be used. */
uint32_t payload_check(const payload_params *params);
/* Clear the state and check the parameters. */
uint32_t payload_init(payload_state *state, const payload_params *params);
/* One control period. */
void payload_step(payload_state *s, const payload_params *p, uint32_t tick, law_real motor_angle, law_real torque,
                  payload_output *output);

#endif
