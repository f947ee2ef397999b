/* The payload at the tip, estimated from motor angle and gauge while the arm moves: what `law_input.payload` takes.
 *
 * ISO C99 as law.c: no heap, no library, no clock, no static data; a const block and a state that the caller owns.
 *
 *   payload_state memory;
 *   reason = payload_init(&memory, &payload_data);      once; anything but LAW_OK means: give the law 0
 *   every control period, before law_step:
 *   payload_step(&memory, &payload_data, input.tick, input.motor_angle, input.torque, &estimate);
 *   input.payload = estimate.given;
 *
 * A bank of models, one for each of a row of payloads, predicts the torque from the motor angle; where the best of
 * them lies between its neighbours is the estimate. Each model has its gauge's gain and offset estimated along with it.
 * The law's feedback loop does not know of it: whatever stands in `given`, the law bounds it and slews towards it.
 */
#ifndef FRACLINK_PAYLOAD_ESTIMATOR_H
#define FRACLINK_PAYLOAD_ESTIMATOR_H

#include "law.h"

#define PAYLOAD_VERSION 1U
#define PAYLOAD_MODELS 14U /* payloads of the bank */

/* Flags of one period. */
#define PAYLOAD_FROZEN 1U    /* nothing moves: the estimate is that of the last motion */
#define PAYLOAD_OUTSIDE 2U   /* the whole interval lies outside the payloads that the certificate covers */
#define PAYLOAD_CONTACT 4U   /* a torque that no payload explains: the tip or the link has touched something */
#define PAYLOAD_GIVEN 8U     /* the interval is narrow: the law is given the estimate */
#define PAYLOAD_CHANGED 16U  /* the payload is not what it was: the estimator forgets and looks again */
#define PAYLOAD_SAMPLE 32U   /* a sample was rejected, and the last one taken in its place */

/* One payload's model: torque over motor angle is (1 - 1/z)(b0 + b1/z + b2/z^2)/A with A = 1 + a1/z + a2/z^2 + a3/z^3,
 * a vibration and one real mode for what a fractional order adds to it. Its error is looked at through A/C with
 * C = 1 + c1/z + c2/z^2 + c3/z^3, which forgets where a vibration began. */
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
    law_real rest; /* what of a constant torque is left in the error */
    law_real mass; /* payload, with what the link weighs at its tip [kg] */
} payload_model;

/* Everything the exporter computed. `crc` is the CRC-32 of all bytes behind it, as in law_params. */
typedef struct {
    uint32_t version;
    uint32_t size;
    uint32_t precision;
    uint32_t crc;
    uint32_t together;     /* periods whose mean is one sample of the models */
    uint32_t chunk;        /* models that are brought up to date in one period */
    uint32_t quiet_limit;  /* samples without motion until the estimate is frozen */
    uint32_t gap_limit;    /* periods without a good sample, or missed, until the estimator begins anew */
    law_real angle_limit;  /* largest encoder angle [rad] */
    law_real torque_limit; /* largest credible gauge torque [N m] */
    law_real torque_moved; /* torque, measured or predicted, above which the arm moves [N m] */
    law_real variance;     /* of a model's error where the model is right [(N m)^2] */
    law_real gain_weight;  /* `variance` over that of the gauge's gain */
    law_real offset_variance; /* of the gauge's offset before anything is known of it [(N m)^2] */
    law_real keep;         /* part of the evidence that is kept from sample to sample while the arm moves */
    law_real sum_limit;    /* largest credible sum of squares [(N m)^2] */
    law_real surprise;     /* part of the torque, squared, that a right model may err by */
    law_real contact;      /* the same for a torque that no payload explains */
    law_real link;         /* what the link weighs at its tip [kg] */
    law_real spread;       /* of a model's errors that follow each other, over that of independent ones, squared */
    law_real doubt;        /* relative variance of the mass that no evidence makes smaller */
    law_real narrow;       /* relative standard deviation up to which the law is given the estimate */
    law_real width;        /* half width of the interval in standard deviations */
    law_real payload_limit; /* largest payload [kg] */
    law_real certified_low; /* payloads that the certificate covers [kg] */
    law_real certified_high;
    payload_model model[PAYLOAD_MODELS];
} payload_params;

/* What is remembered of one model: its filter, and sums over the errors e and the predicted torques v. */
typedef struct {
    law_real torque[3];
    law_real angle[3];
    law_real ee;
    law_real ev;
    law_real vv;
    law_real e;
    law_real v;
} payload_memory;

typedef struct {
    uint32_t stamp; /* crc of the parameters it was started with */
    uint32_t tick;
    uint32_t count;   /* periods in the sample that is being made */
    uint32_t next;    /* model that is brought up to date next */
    uint32_t gap;     /* periods in a row without a good sample */
    uint32_t quiet;   /* samples in a row without motion */
    uint32_t odd;     /* samples in a row that the best model does not explain */
    uint32_t touched; /* samples in a row that no model explains */
    uint32_t best;    /* model of the smallest cost of this sample */
    uint32_t flags;
    payload_memory model[PAYLOAD_MODELS];
    law_real angle_sum;
    law_real torque_sum;
    law_real last_angle; /* last good readings */
    law_real last_torque;
    law_real angle;  /* mean angle of the sample before */
    law_real change; /* of the mean angle, and the mean torque without its offset: what the models look at */
    law_real torque;
    law_real offset;
    law_real offset_variance;
    law_real shift;      /* of the offset in this sample */
    law_real drift;      /* of the offset from there, as the best model has it */
    law_real samples;    /* in the sums, as far as they are kept */
    law_real keep;       /* part of them that is kept in this sample */
    law_real before[2];  /* costs of the two models before, of the best one and of the two on either side of it */
    law_real cost[5];
    law_real best_drift; /* of the best one: offset, predicted torque, and error over what a right model may err by */
    law_real best_told;
    law_real best_error;
    law_real least;     /* smallest excess of the error over what is no contact [(N m)^2] */
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

/* Return LAW_OK or why the parameter block must not be used. */
uint32_t payload_check(const payload_params *params);
/* Clear the state and check the parameters. */
uint32_t payload_init(payload_state *state, const payload_params *params);
/* One control period. */
void payload_step(payload_state *s, const payload_params *p, uint32_t tick, law_real motor_angle, law_real torque,
                  payload_output *output);

#endif
