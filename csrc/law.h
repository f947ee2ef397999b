/* The control law of a flexible-link arm: the file that is simulated is the file that is shipped.
 *
 * ISO C99. No heap, no library, no clock, no static data: parameters are a const block the caller owns,
 * state is a struct the caller owns, and every call works on what it is given.
 *
 *   law_state state;
 *   reason = law_init(&state, &law_data);       once; anything but LAW_OK means: do not enable the drive
 *   every control period:  law_step(&state, &law_data, &input, &output);
 *
 * Angles in rad at the gear's output, torque in N m, voltage in V, time in s.
 */
#ifndef FRACLINK_LAW_H
#define FRACLINK_LAW_H

#include <stdint.h>

/* Fast-math lets a compiler assume that NaN does not exist, and then it removes the tests for NaN below:
 * with clang -Ofast one NaN sample moved the output. Refusing is the only safe answer. */
#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && (__FINITE_MATH_ONLY__ != 0))
#error "law.c must not be compiled with -ffast-math, -Ofast or -ffinite-math-only: its NaN tests would be removed"
#endif
/* Wider intermediates (x87) round differently, so that board and simulation part in the last bit. */
#if defined(__FLT_EVAL_METHOD__) && (__FLT_EVAL_METHOD__ != 0)
#error "law.c needs FLT_EVAL_METHOD 0 (on 32-bit x86: -msse2 -mfpmath=sse)"
#endif

/* Single precision is the default of simulation, proof and export alike; double is for boards that have it. */
#ifdef LAW_SINGLE
typedef float law_real;
#else
typedef double law_real;
#endif

#define LAW_VERSION 4U
/* The package compiles law.c with room for every design. A board may compile it for one design alone: the README of
 * an export gives the flags. Loops then have fixed lengths and the arrays no spare places; the
 * arithmetic, and so every bit of the outputs, stays the same. A block made for other lengths is refused by its size. */
#ifdef LAW_REALS
#define LAW_EXACT
#define LAW_REAL_MODES LAW_REALS
#define LAW_FORWARD_MODES LAW_FORWARDS
#ifdef LAW_PAIRS
#define LAW_PAIR_MODES LAW_PAIRS
#else
#define LAW_PAIR_MODES 0U
#endif
#else
#define LAW_REAL_MODES 8U    /* most real modes of the correction */
#define LAW_PAIR_MODES 2U    /* most complex pairs of the correction */
#define LAW_FORWARD_MODES 8U /* most real modes of the feed-forward */
#endif

/* Options of the parameter block. */
#define LAW_WITH_INNER 1U /* the law closes the motor loop and gives a voltage */
#define LAW_LATE_GAUGE 2U /* the gauge has a delay or a gain that the reference model counts on */
#define LAW_STOP_RINGING 4U /* a vibration that does not decay trips, and is not only flagged */

/* Modes, in the order of severity. */
#define LAW_IDLE 0U     /* not started: no valid encoder sample yet, or the parameters are refused */
#define LAW_RUN 1U      /* everything works */
#define LAW_DEGRADED 2U /* gauge given up: correction faded out, feed-forward goes on */
#define LAW_HOLD 3U     /* tripped: last motor reference held, motor loop closed */
#define LAW_OFF 4U      /* tripped: motor loop cannot be trusted, voltage 0, switch the drive off */

/* Reasons of a refusal, a degradation or a trip; the first one is kept. */
#define LAW_OK 0U
#define LAW_BAD_VERSION 1U
#define LAW_BAD_SIZE 2U
#define LAW_BAD_CRC 3U
#define LAW_BAD_COUNTS 4U
#define LAW_BAD_ENCODER 5U /* not a number, out of range or jumping, too long */
#define LAW_BAD_GAUGE 6U   /* not a number, out of range or jumping, too long */
#define LAW_GAUGE_STUCK 7U /* gauge does not move where the model says it must */
#define LAW_RESIDUAL 8U    /* motor angle far from the motor model: encoder stuck or wrong, or drive failed */
#define LAW_MISSED 9U      /* more periods missed, or calls without a new one, than good periods make up for */
#define LAW_OVERLOAD 10U   /* coupling torque above its limit: link blocked */

#define LAW_GAUGE_REVERSED 11U /* wiring test: torque falls where it must rise */
#define LAW_GAUGE_DEAD 12U     /* wiring test: torque does not answer the motor */
#define LAW_NOT_MOVED 13U      /* wiring test: too little motion to tell */

#define LAW_RINGING 14U /* the tip vibrates, and the vibration does not decay */
#define LAW_RAILED 15U  /* held, and the voltage goes from one limit to the other: the motor loop is not stable */

/* Flags of one period; they do not latch. */
#define LAW_FLAG_ENCODER 1U    /* encoder sample rejected */
#define LAW_FLAG_GAUGE 2U      /* gauge sample rejected */
#define LAW_FLAG_REFERENCE 4U  /* reference sample rejected or its speed limited */
#define LAW_FLAG_MISSED 8U     /* periods were missed */
#define LAW_FLAG_REPEATED 16U  /* called twice in one period, or time ran backwards: held, off if it goes on */
#define LAW_FLAG_LIMITED 32U   /* motor reference limited in speed or range */
#define LAW_FLAG_SATURATED 64U /* voltage limited */
#define LAW_FLAG_STARTED 128U  /* started in this period, without a bump */
#define LAW_FLAG_RESIDUAL 256U /* motor angle away from the motor model in this period */
#define LAW_FLAG_PAYLOAD 512U  /* payload rejected: the law runs as if none were given */
#define LAW_FLAG_RINGING 1024U /* the tip vibrates, and the vibration does not decay */

/* A real mode gain/(z - pole). The exporter's poles are numbers of single precision, so that both precisions
 * run the same filter. */
typedef struct {
    law_real pole;
    law_real gain;
} law_mode;

#if !defined(LAW_EXACT) || defined(LAW_PAIRS)
/* A pair of modes, half of it: (gain + j cross)/(z - pole - j turn). */
typedef struct {
    law_real pole;
    law_real turn;
    law_real gain;
    law_real cross;
} law_pair;
#endif

/* Everything the exporter computed. `crc` is the CRC-32 (IEEE 802.3) of all bytes behind it, little-endian. */
typedef struct {
    uint32_t version;
    uint32_t size;
    uint32_t precision; /* sizeof(law_real) */
    uint32_t crc;
    uint32_t options;
    uint32_t real_modes;
    uint32_t pair_modes;
    uint32_t forward_modes;
    uint32_t bad_limit;      /* rejected samples in a row before the reaction */
    uint32_t missed_limit;   /* missed periods, less the good ones since, that are ridden through */
    uint32_t residual_limit; /* periods in a row with a residual above `residual_angle` */
    uint32_t stuck_limit;    /* periods in a row with an unchanged gauge while the model moves */
    uint32_t frozen_limit;   /* periods in a row with an unchanged encoder while the model moves */
    uint32_t block_limit;    /* periods in a row with a torque above `torque_block`: half a vibration and more */
    law_real period;
    law_real compliance; /* 1/c: torque to deflection [rad/(N m)] */
    /* correction (1 - 1/z)(direct + sum of modes) of the error */
    law_real direct;
    law_mode real[LAW_REAL_MODES];
#if !defined(LAW_EXACT) || defined(LAW_PAIRS)
    law_pair pair[LAW_PAIR_MODES];
#endif
    /* feed-forward: acceleration to motor angle, s^(order - 2)/natural_frequency^2 */
    law_real forward_direct;
    law_mode forward[LAW_FORWARD_MODES];
    /* limits; the exporter derives and prints them */
    law_real sum_limit;        /* largest credible output of a filter: beyond, its states are healed [rad] */
    law_real correction_limit; /* largest state of the correction */
    law_real forward_limit;    /* largest state of the feed-forward */
    law_real angle_limit;      /* largest encoder and reference angle [rad] */
    law_real angle_step;       /* largest change of the encoder in one period [rad] */
    law_real torque_limit;     /* largest credible gauge torque [N m] */
    law_real torque_step;      /* largest credible change in one period [N m] */
    law_real torque_trip;      /* torque of a blocked link [N m] */
    law_real torque_block;     /* the same where it does not swing back in `block_limit` periods [N m] */
    law_real reference_step;   /* largest change of the reference in one period [rad] */
    law_real reference_rate;   /* part of a jump of the reference that is followed in one period */
    law_real acceleration_limit; /* largest acceleration that is fed forward [rad/s^2] */
    law_real motor_limit;    /* range of the motor reference [rad] */
    law_real motor_step;     /* largest change of the motor reference in one period [rad] */
    law_real fade_step;      /* fade of the correction in one period after the gauge is given up */
    law_real residual_angle; /* largest credible distance from the motor model [rad] */
    law_real motor_now; /* the motor loop as it was placed, with its delay: H/(z - 1 + H) of the motor reference with */
    law_real motor_next; /* H = motor_now + motor_next/(z - motor_keep) */
    law_real motor_keep;
    law_real swing_angle; /* tip error that, from one side to the other, is a vibration [rad] */
    law_real frozen_angle;   /* move of the motor model at which an unchanged encoder is frozen [rad] */
    law_real stuck_torque;   /* change of the model's torque at which an unchanged gauge is stuck [N m] */
    law_real stiffness;      /* c [N m/rad], for the model's torque */
    law_real wiring_energy;  /* sum of squared motor steps from which the wiring test decides [rad^2] */
    /* inner loop: u = a2 eps - b1 angle + integral + filter, see fraclink._arm.motor */
    law_real inner_direct;
    law_real inner_angle;
    law_real integral_now; /* gains times the Tustin weights [V/rad] */
    law_real integral_before;
    law_real filter_now;
    law_real filter_before;
    law_real filter_angle_now;
    law_real filter_angle_before;
    law_real filter_decay;
    law_real wanted_limit; /* largest credible voltage before the limit: beyond, the loop's memory is wrong [V] */
    law_real voltage_limit;
    law_real torque_voltage;  /* compensation of the coupling torque [V/(N m)] */
    law_real coulomb_voltage; /* compensation of Coulomb friction [V] */
    law_real coulomb_slope;   /* 1/(change of the motor reference in a period below which it fades) [1/rad] */
    /* a payload that is given: the feed-forward times link_scale + payload_scale payload; the tip estimate then follows
     * the reference as the motor follows its own */
    law_real link_scale;
    law_real payload_scale; /* [1/kg] */
    law_real gauge_now; /* the gauge's gain and delay, as a lag, on the flexion of the feed-forward; 1 and 0 for none */
    law_real gauge_keep;
    law_real payload_limit;  /* largest credible payload [kg]; 0: the law knows no payload */
    law_real scale_step;     /* largest change of the feed-forward's scale in one period */
} law_params;

/* Everything the law remembers. */
typedef struct {
    uint32_t stamp; /* crc of the parameters it was started with; anything else starts anew, but no trip */
    uint32_t mode;  /* in each of its four bytes, so that one flipped bit is outvoted */
    uint32_t reason;
    uint32_t tick;
    uint32_t bad_encoder;
    uint32_t bad_gauge;
    uint32_t residual;
    uint32_t stuck;
    uint32_t overload;
    uint32_t frozen;
    uint32_t missed;      /* periods missed and calls that were no new period, less the good periods since */
    uint32_t ringing;     /* a vibration's changes of side, less the periods since; in hold the voltage's */
    uint32_t tracking;    /* a payload is given, or the reference model has not come to rest since */
    uint32_t given;       /* whether a payload is; fourteenth word: an even number of them keeps the reals aligned */
    law_real real[LAW_REAL_MODES]; /* states of the modes */
    law_real forward[LAW_FORWARD_MODES];
#if !defined(LAW_EXACT) || defined(LAW_PAIRS)
    law_real pair[2U * LAW_PAIR_MODES]; /* real part, imaginary part, real part ... */
#endif
    law_real error;
    law_real reference;
    law_real motor_reference;
    law_real motor_angle;
    law_real torque;
    law_real model_angle; /* motor model: its angle, and what pushes it on in the next period */
    law_real model_push;
    law_real stuck_torque; /* model torque when the gauge last moved */
    law_real encoder;      /* last reading, and motor model when it last changed */
    law_real encoder_model;
    law_real input_reference; /* last one that was a number in range */
    law_real payload;    /* that was looked at last [kg] */
    law_real scale;      /* of the feed-forward for it */
    law_real track;      /* reference model: its angle, and what pushes it on in the next period */
    law_real track_push;
    law_real late;       /* flexion of the feed-forward as the gauge will show it */
    law_real fade;
    law_real swing;      /* last error beyond `swing_angle`; in hold the last voltage at its limit */
    law_real integral;
    law_real filter;
    law_real voltage;
    law_real sum; /* of the modes, references, motor angle, integral, torque, error and scale: any other one is damage */
} law_state;

typedef struct {
    uint32_t tick; /* number of this period; the timer counts it, so that missed periods are seen */
    law_real reference;
    law_real reference_acceleration;
    law_real motor_angle;
    law_real torque;
    law_real payload; /* mass at the tip [kg]; 0: not given */
} law_input;

typedef struct {
    law_real motor_reference;
    law_real voltage;
    law_real compensation; /* part of the voltage that compensates the coupling torque [V] */
    law_real tip_estimate;
    law_real error;
    uint32_t mode;
    uint32_t reason;
    uint32_t flags;
} law_output;

/* The wiring test's memory; all zeros before the first period. */
typedef struct {
    uint32_t started;
    law_real motor_angle;
    law_real torque;
    law_real cross;  /* sum of motor step times torque step */
    law_real energy; /* sum of squared motor steps */
} law_wiring;

/* Return LAW_OK or why the parameter block must not be used. */
uint32_t law_check(const law_params *params);
/* Clear the state and check the parameters; the first law_step starts from the measured angle without a bump. */
uint32_t law_init(law_state *state, const law_params *params);
/* One control period. */
void law_step(law_state *state, const law_params *params, const law_input *input, law_output *output);
/* Commissioning: turn the motor within a quarter of the link's vibration period by the angle that the export's
 * README states, feed every period's samples, and read the answer: LAW_OK, or one of LAW_GAUGE_REVERSED,
 * LAW_GAUGE_DEAD, LAW_NOT_MOVED. */
uint32_t law_check_wiring(law_wiring *test, const law_params *params, law_real motor_angle, law_real torque);

#endif
