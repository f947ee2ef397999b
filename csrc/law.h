/* The control law of a flexible-link arm: the same source is simulated, certified and shipped.
 *
 * ISO C99. No heap, no library, no clock, no static data: the caller owns both the constant parameter block and the
 * state, and every call works on its arguments alone.
 *
 *   law_state state;
 *   reason = law_init(&state, &law_data);       once; unless it returns LAW_OK, do not enable the drive
 *   every control period:  law_step(&state, &law_data, &input, &output);
 *
 * Angles in rad at the gear's output, torque in N m, voltage in V, time in s.
 */
#ifndef FRACLINK_LAW_H
#define FRACLINK_LAW_H

#include <stdint.h>

/* With fast-math a compiler may assume that NaN does not occur and remove the tests for it in law.c: compiled by
 * clang -Ofast, a single NaN sample moved the output. */
#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && (__FINITE_MATH_ONLY__ != 0))
#error "law.c must not be compiled with -ffast-math, -Ofast or -ffinite-math-only: its NaN tests would be removed"
#endif
/* Intermediate results of extended precision (x87) round differently: board and simulation would differ in the last
 * bit. */
#if defined(__FLT_EVAL_METHOD__) && (__FLT_EVAL_METHOD__ != 0)
#error "law.c needs FLT_EVAL_METHOD 0 (on 32-bit x86: -msse2 -mfpmath=sse)"
#endif

/* Simulation, certificate and export use single precision by default; double is for boards with a double-precision
 * unit. */
#ifdef LAW_SINGLE
typedef float law_real;
#else
typedef double law_real;
#endif

#define LAW_VERSION 4U
/* The package compiles law.c with room for every design. A board may compile it for a single design, with the flags
 * given in the README of the export: loops then have fixed lengths and arrays have no unused elements, while the
 * arithmetic and every bit of the outputs stay the same. A block made for other lengths is refused by its size. */
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
#define LAW_REAL_MODES 8U    /* maximum number of real modes of the correction */
#define LAW_PAIR_MODES 2U    /* maximum number of complex pairs of the correction */
#define LAW_FORWARD_MODES 8U /* maximum number of real modes of the feed-forward */
#endif

/* Options of the parameter block. */
#define LAW_WITH_INNER 1U /* the law closes the motor loop and gives a voltage */
#define LAW_LATE_GAUGE 2U /* the reference model includes the delay and the gain of the gauge */
#define LAW_STOP_RINGING 4U /* a vibration that does not decay trips the law instead of only being flagged */

/* Modes, in increasing severity. */
#define LAW_IDLE 0U     /* not started: no valid encoder sample yet, or the parameters were refused */
#define LAW_RUN 1U      /* normal operation */
#define LAW_DEGRADED 2U /* gauge given up: the correction fades out, the feed-forward continues */
#define LAW_HOLD 3U     /* tripped: the last motor reference is held by the closed motor loop */
#define LAW_OFF 4U      /* tripped: the motor loop cannot be trusted; voltage 0, switch the drive off */

/* Reasons of a refusal, a degradation or a trip; the first one is kept. */
#define LAW_OK 0U
#define LAW_BAD_VERSION 1U
#define LAW_BAD_SIZE 2U
#define LAW_BAD_CRC 3U
#define LAW_BAD_COUNTS 4U
#define LAW_BAD_ENCODER 5U /* not a number, out of range or jumping for too many periods */
#define LAW_BAD_GAUGE 6U   /* not a number, out of range or jumping for too many periods */
#define LAW_GAUGE_STUCK 7U /* gauge reading constant while the model's torque changes */
#define LAW_RESIDUAL 8U    /* motor angle far from the motor model: encoder stuck or wrong, or drive failed */
#define LAW_MISSED 9U      /* too many periods missed, or too many calls without a new period */
#define LAW_OVERLOAD 10U   /* coupling torque above its limit: link blocked */

#define LAW_GAUGE_REVERSED 11U /* wiring test: the torque falls when it should rise */
#define LAW_GAUGE_DEAD 12U     /* wiring test: the torque does not respond to the motor */
#define LAW_NOT_MOVED 13U      /* wiring test: not enough motion for a verdict */

#define LAW_RINGING 14U /* a vibration of the tip does not decay */
#define LAW_RAILED 15U  /* in hold, the voltage switches between its limits: the motor loop is unstable */

/* Flags of a single period; none of them latches. */
#define LAW_FLAG_ENCODER 1U    /* encoder sample rejected */
#define LAW_FLAG_GAUGE 2U      /* gauge sample rejected */
#define LAW_FLAG_REFERENCE 4U  /* reference sample rejected, or its speed limited */
#define LAW_FLAG_MISSED 8U     /* periods were missed */
#define LAW_FLAG_REPEATED 16U  /* called twice in a period, or time ran backwards: outputs held, off if it persists */
#define LAW_FLAG_LIMITED 32U   /* motor reference limited in speed or range */
#define LAW_FLAG_SATURATED 64U /* voltage limited */
#define LAW_FLAG_STARTED 128U  /* started in this period, without a bump */
#define LAW_FLAG_RESIDUAL 256U /* motor angle too far from the motor model in this period */
#define LAW_FLAG_PAYLOAD 512U  /* payload rejected: the law runs as if none were given */
#define LAW_FLAG_RINGING 1024U /* a vibration of the tip does not decay */

/* A real mode gain/(z - pole). The exporter rounds the poles to single precision, so that the filter is the same in
 * both precisions. */
typedef struct {
    law_real pole;
    law_real gain;
} law_mode;

#if !defined(LAW_EXACT) || defined(LAW_PAIRS)
/* One of a pair of conjugate modes: (gain + j cross)/(z - pole - j turn). */
typedef struct {
    law_real pole;
    law_real turn;
    law_real gain;
    law_real cross;
} law_pair;
#endif

/* All parameters, computed by the exporter. `crc` is the CRC-32 (IEEE 802.3) of all bytes after it, little-endian. */
typedef struct {
    uint32_t version;
    uint32_t size;
    uint32_t precision; /* sizeof(law_real) */
    uint32_t crc;
    uint32_t options;
    uint32_t real_modes;
    uint32_t pair_modes;
    uint32_t forward_modes;
    uint32_t bad_limit;      /* consecutive rejected samples before the law reacts */
    uint32_t missed_limit;   /* tolerated number of missed periods, less the good periods since */
    uint32_t residual_limit; /* consecutive periods with a residual above `residual_angle` */
    uint32_t stuck_limit;    /* consecutive periods with an unchanged gauge while the model moves */
    uint32_t frozen_limit;   /* consecutive periods with an unchanged encoder while the model moves */
    uint32_t block_limit;    /* consecutive periods with a torque above `torque_block`: over half a vibration period */
    law_real period;
    law_real compliance; /* 1/c, deflection per torque [rad/(N m)] */
    /* correction from the error: (1 - 1/z)(direct + sum of the modes) */
    law_real direct;
    law_mode real[LAW_REAL_MODES];
#if !defined(LAW_EXACT) || defined(LAW_PAIRS)
    law_pair pair[LAW_PAIR_MODES];
#endif
    /* feed-forward from acceleration to motor angle: s^(order - 2)/natural_frequency^2 */
    law_real forward_direct;
    law_mode forward[LAW_FORWARD_MODES];
    /* limits, derived and printed by the exporter */
    law_real sum_limit;        /* largest credible output of a filter; above it, implausible states are cleared [rad] */
    law_real correction_limit; /* largest state of the correction */
    law_real forward_limit;    /* largest state of the feed-forward */
    law_real angle_limit;      /* largest encoder and reference angle [rad] */
    law_real angle_step;       /* largest change of the encoder in one period [rad] */
    law_real torque_limit;     /* largest credible gauge torque [N m] */
    law_real torque_step;      /* largest credible change in one period [N m] */
    law_real torque_trip;      /* torque of a blocked link [N m] */
    law_real torque_block;     /* the same for a torque that stays above it for `block_limit` periods [N m] */
    law_real reference_step;   /* largest change of the reference in one period [rad] */
    law_real reference_rate;   /* share of a jump of the reference that is followed in one period */
    law_real acceleration_limit; /* largest acceleration that is fed forward [rad/s^2] */
    law_real motor_limit;    /* range of the motor reference [rad] */
    law_real motor_step;     /* largest change of the motor reference in one period [rad] */
    law_real fade_step;      /* decrease of the correction's gain in one period after the gauge is given up */
    law_real residual_angle; /* largest credible distance from the motor model [rad] */
    law_real motor_now; /* the motor loop as placed, with its delay: from the motor reference, H/(z - 1 + H) with */
    law_real motor_next; /* H = motor_now + motor_next/(z - motor_keep) */
    law_real motor_keep;
    law_real swing_angle; /* tip error beyond which, on alternating sides, it counts as a vibration [rad] */
    law_real frozen_angle;   /* move of the motor model after which an unchanged encoder counts as frozen [rad] */
    law_real stuck_torque;   /* change of the model's torque after which an unchanged gauge counts as stuck [N m] */
    law_real stiffness;      /* c [N m/rad], for the model's torque */
    law_real wiring_energy;  /* sum of squared motor steps that the wiring test needs for a verdict [rad^2] */
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
    law_real wanted_limit; /* largest credible voltage before saturation; above it, the loop's memory is damaged [V] */
    law_real voltage_limit;
    law_real torque_voltage;  /* compensation of the coupling torque [V/(N m)] */
    law_real coulomb_voltage; /* compensation of Coulomb friction [V] */
    law_real coulomb_slope;   /* 1/(step of the motor model in a period below which it decreases) [1/rad] */
    /* A given payload multiplies the feed-forward by link_scale + payload_scale payload. The tip estimate is then
     * expected to follow the reference with the dynamics of the motor loop. */
    law_real link_scale;
    law_real payload_scale; /* [1/kg] */
    law_real gauge_now; /* the gauge's gain and delay as a first-order lag of the fed-forward flexion; 1 and 0: none */
    law_real gauge_keep;
    law_real payload_limit;  /* largest credible payload [kg]; 0: the law accepts none */
    law_real scale_step;     /* largest change of the feed-forward's scale in one period */
} law_params;

/* The state of the law between two periods. */
typedef struct {
    uint32_t stamp; /* crc of the parameters at the start; with another value the law starts anew, but trips remain */
    uint32_t mode;  /* a copy in each of its four bytes, so that one flipped bit is outvoted */
    uint32_t reason;
    uint32_t tick;
    uint32_t bad_encoder;
    uint32_t bad_gauge;
    uint32_t residual;
    uint32_t stuck;
    uint32_t overload;
    uint32_t frozen;
    uint32_t missed;      /* missed periods and calls without a new period, less the good periods since */
    uint32_t ringing;     /* sign changes of a vibration, weighted, less the periods since; in hold, of the voltage */
    uint32_t tracking;    /* whether a payload is given, or was and the reference model is not yet at rest */
    uint32_t given;       /* whether a payload is given; the number of words is even to keep the reals aligned */
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
    law_real model_angle; /* motor model: its angle, and the part of its next move that is already determined */
    law_real model_push;
    law_real stuck_torque; /* the model's torque when the gauge reading last changed */
    law_real encoder;      /* last reading, and the motor model's angle when the reading last changed */
    law_real encoder_model;
    law_real input_reference; /* last valid reference sample */
    law_real payload;    /* last payload that was evaluated [kg] */
    law_real scale;      /* scale of the feed-forward for this payload */
    law_real track;      /* reference model: its angle, and the part of its next move that is already determined */
    law_real track_push;
    law_real late;       /* fed-forward flexion, delayed as the gauge will show it */
    law_real fade;
    law_real swing;      /* last error beyond `swing_angle`; in hold, the last voltage at its limit */
    law_real integral;
    law_real filter;
    law_real voltage;
    law_real sum; /* checksum of modes, references, motor angle, integral, torque, error and scale */
} law_state;

typedef struct {
    uint32_t tick; /* number of this period, counted by the timer, so that missed periods are noticed */
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

/* State of the wiring test; all zeros before the first period. */
typedef struct {
    uint32_t started;
    law_real motor_angle;
    law_real torque;
    law_real cross;  /* sum of motor step times torque step */
    law_real energy; /* sum of squared motor steps */
} law_wiring;

/* Return LAW_OK, or the reason why the parameter block must not be used. */
uint32_t law_check(const law_params *params);
/* Clear the state and check the parameters; the first law_step starts from the measured angle without a bump. */
uint32_t law_init(law_state *state, const law_params *params);
/* One control period. */
void law_step(law_state *state, const law_params *params, const law_input *input, law_output *output);
/* Wiring test for commissioning: turn the motor by the angle given in the README of the export, within a quarter of
 * the link's vibration period, and call this with the samples of every period. Returns LAW_OK, LAW_GAUGE_REVERSED,
 * LAW_GAUGE_DEAD or LAW_NOT_MOVED. */
uint32_t law_check_wiring(law_wiring *test, const law_params *params, law_real motor_angle, law_real torque);

#endif
