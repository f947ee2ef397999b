/* The control law of a flexible-link arm. See law.h for how to call it.
 *
 * Rules that trials forced, and why:
 *  - NaN is looked for by a comparison that it fails. A clamp made of "too large" and "too small" lets NaN through;
 *    `clamped`, which every output passes, asks v == v, because a prover (Frama-C 25) takes NaN out of v there and
 *    not in v >= -m && v <= m.
 *  - Whatever the state memory holds, the outputs are finite and in their limits within the same period, and a
 *    flipped bit or a wiped memory is healed in it: the sum of what a move is remembered by is kept, and a period that
 *    finds another one begins anew where the motor is. Bounds alone do not do: a reference that is half a radian off is
 *    in all of them. What is in the memory all the same is bounded where it is used, each sum that is formed from
 *    states is checked; clamping each state at every entry costs 280 instructions a period.
 *  - What decides whether the drive runs is kept so that no one or two flipped bits can decide otherwise: the mode in
 *    four copies, and a stamp that does not fit starts nothing where the mode is a trip.
 *  - A clock that stands or runs backwards trips like one that jumps: a law that waits for a new period keeps its
 *    last voltage on, whatever the arm does.
 *  - The correction works on the *change* of the error, so that a constant error, such as a gauge's offset, gives
 *    exactly zero whatever the rounding.
 *  - States that have died away are set to 0, one in each period: as denormals they would stay for ever and cost
 *    three times the period on a desktop. (Adding and taking away a constant does not do: a slow mode stops at the
 *    constant's last digit.)
 *  - The "loop unroll" comments are for the prover; a compiler does not see them.
 */
#include "law.h"

#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__) && !defined(__STRICT_ANSI__) && !defined(LAW_CONTRACT_OFF) && \
    (defined(__FMA__) || defined(__ARM_FEATURE_FMA) || defined(__riscv_flen) || defined(__FP_FAST_FMA) || \
     defined(__FP_FAST_FMAF))
/* gcc ignores the pragma and fuses a * b + c in its gnu modes: one rounding where the simulation has two. RISC-V
 * fuses wherever it has floating point (__riscv_flen); __FP_FAST_FMA is gcc's own word on every other machine. */
#error "compile law.c with -std=c99, or with -ffp-contract=off -DLAW_CONTRACT_OFF"
#endif

/* What gcc and clang know beyond C99, and what any other compiler computes alike: the absolute value and which way a
 * test usually goes, twenty-five instructions of a period on a Cortex-M4F; and a function that
 * no other one is to take in, be it for flash or for the registers of those that run in every period. */
#if defined(__GNUC__) && !defined(__FRAMAC__)
#define LAW_USUALLY(test) (__builtin_expect((test), 1) != 0)
#define LAW_APART __attribute__((noinline))
#else
#define LAW_USUALLY(test) (test)
#define LAW_APART
#endif

#define LAW_TINY ((law_real)1e-18F) /* far below any signal, and far above a denormal number */
#define LAW_LARGE ((law_real)1e6F)  /* bound of the wiring test's sums */
#define LAW_NO_PAYLOAD ((law_real)-1e6F) /* none that is given: the next one is looked at */
#define LAW_SCALES ((law_real)8)  /* no two scales of the feed-forward are farther apart */
#define LAW_RESTS ((law_real)1e-5F) /* a reference model this near to the reference has come to rest [rad] */
#define LAW_COUNT_MAX 0x7FFFFFFFU

/* `value` within +-`limit`; NaN becomes 0. */
static law_real clamped(law_real value, law_real limit)
{
    law_real result = (law_real)0;
    if (value > limit) {
        result = limit;
    } else if (value < -limit) {
        result = -limit;
    } else if (value == value) {
        result = value;
    } else {
        /* NaN */
    }
    return result;
}

/* |value|, in one instruction instead of four. */
static law_real magnitude(law_real value)
{
#if defined(__GNUC__) && !defined(__FRAMAC__) && defined(LAW_SINGLE)
    return __builtin_fabsf(value);
#elif defined(__GNUC__) && !defined(__FRAMAC__)
    return __builtin_fabs(value);
#else
    return (value < (law_real)0) ? -value : value;
#endif
}

/* Whether a value is a number within +-`limit`: NaN fails the comparison. */
static uint32_t credible(law_real value, law_real limit)
{
    return LAW_USUALLY(magnitude(value) <= limit) ? 1U : 0U;
}

/* `value` within +-`limit` where it usually is: one comparison then, against three of `clamped`. */
static law_real limited(law_real value, law_real limit)
{
    law_real result = value;
    if (credible(value, limit) == 0U) {
        result = clamped(value, limit);
    }
    return result;
}

/* A mode as the state keeps it: a copy in each byte. */
static uint32_t copied(uint32_t mode)
{
    return mode * 0x01010101U;
}

/* The mode that a word differs from by one flipped bit at most; a word that no single bit explains is no mode, and
 * the drive is off for it. Two modes differ in four bits and more: no two flips make one of another. */
static uint32_t corrected(uint32_t word)
{
    const uint32_t second = word >> 8U;
    const uint32_t third = word >> 16U;
    const uint32_t most = copied(((word & second) | (word & third) | (second & third)) & 0xFFU);
    const uint32_t differ = word ^ most;
    return ((most <= copied(LAW_OFF)) && ((differ & (differ - 1U)) == 0U)) ? most : copied(LAW_OFF);
}

/* Enter the mode that a reason asks for, unless a more severe one is latched; the first reason stays with its mode.
 * The motor loop lives on the encoder: without it nothing is left to hold with. The link is stable alone: without
 * the gauge the feed-forward can go on. */
static void latch(law_state *s, uint32_t reason)
{
    uint32_t mode = LAW_OFF;
    if ((reason == LAW_BAD_GAUGE) || (reason == LAW_GAUGE_STUCK)) {
        mode = LAW_DEGRADED;
    } else if ((reason == LAW_OVERLOAD) || (reason == LAW_RINGING)) {
        mode = LAW_HOLD;
    } else {
        /* encoder, motor or clock */
    }
    mode = copied(mode);
    if (s->mode < mode) {
        s->mode = mode;
        s->reason = reason;
        s->ringing = 0U; /* counts something else from now on */
        s->swing = (law_real)0;
    }
}

/* One more period of a condition, without wrapping around. */
static LAW_APART uint32_t counted(uint32_t count)
{
    uint32_t next = count;
    if (count < LAW_COUNT_MAX) {
        next = count + 1U;
    }
    return next;
}

static void empty_modes(law_state *s)
{
    const law_real zero = (law_real)0;
    uint32_t i;
    /*@ loop unroll 8; */
    for (i = 0U; i < LAW_REAL_MODES; i++) {
        s->real[i] = zero;
    }
    /*@ loop unroll 8; */
    for (i = 0U; i < LAW_FORWARD_MODES; i++) {
        s->forward[i] = zero;
    }
#if !defined(LAW_EXACT) || defined(LAW_PAIRS)
    /*@ loop unroll 4; */
    for (i = 0U; i < (2U * LAW_PAIR_MODES); i++) {
        s->pair[i] = zero;
    }
#endif
}

static void clear(law_state *s)
{
    const law_real zero = (law_real)0;
    s->stamp = 0U;
    s->mode = LAW_IDLE;
    s->reason = LAW_OK;
    s->tick = 0U;
    s->bad_encoder = 0U;
    s->bad_gauge = 0U;
    s->residual = 0U;
    s->stuck = 0U;
    s->overload = 0U;
    s->frozen = 0U;
    s->missed = 0U;
    s->ringing = 0U;
    s->tracking = 0U;
    s->given = 0U;
    empty_modes(s);
    s->error = zero;
    s->reference = zero;
    s->motor_reference = zero;
    s->motor_angle = zero;
    s->torque = zero;
    s->model_angle = zero;
    s->model_push = zero;
    s->stuck_torque = zero;
    s->encoder = zero;
    s->encoder_model = zero;
    s->input_reference = zero;
    s->payload = zero;
    s->scale = (law_real)1;
    s->track = zero;
    s->track_push = zero;
    s->late = zero;
    s->fade = (law_real)1;
    s->swing = zero;
    s->integral = zero;
    s->filter = zero;
    s->voltage = zero;
    s->sum = zero;
}

/* Begin modes anew that no input explains, and add what is left of them: called where their sum is not credible. */
static void heal(law_real limit, law_real *states, uint32_t count, law_real *left)
{
    uint32_t i;
    /*@ loop unroll 8; */
    for (i = 0U; i < count; i++) {
        if (credible(states[i], limit) == 0U) {
            states[i] = (law_real)0;
        }
        *left += states[i];
    }
}

/* 0 for a mode that has died away. */
static law_real alive(law_real mode)
{
    return (magnitude(mode) < LAW_TINY) ? (law_real)0 : mode;
}

/* Set a mode to 0 if it has died away, and look at the payload again; the period's number chooses what, the same whatever
 * room the arrays have. */
static void sweep(law_state *s)
{
    const uint32_t i = s->tick & 31U;
    if (i < LAW_REAL_MODES) {
        s->real[i] = alive(s->real[i]);
    } else if ((i - 8U) < LAW_FORWARD_MODES) {
        s->forward[i - 8U] = alive(s->forward[i - 8U]);
    } else {
#if !defined(LAW_EXACT) || defined(LAW_PAIRS)
        if ((i - 16U) < LAW_PAIR_MODES) {
            const uint32_t place = 2U * (i - 16U);
            law_real *const pair = &s->pair[place];
            if ((magnitude(pair[0]) + magnitude(pair[1])) < LAW_TINY) {
                pair[0] = (law_real)0; /* both at once: one that is left turns into the other in the next period */
                pair[1] = (law_real)0;
            }
        }
#endif
        if (i == 30U) {
            s->model_push = alive(s->model_push);
        }
        if (i == 31U) {
            s->payload = LAW_NO_PAYLOAD; /* a scale that a flipped bit has changed is found in the next look */
        }
    }
}

/* The motor loop's memory of an arm that has stood at this angle for ever. */
static void rest_motor(law_state *s, const law_params *p, law_real angle)
{
    const law_real filter = -((p->filter_angle_now + p->filter_angle_before) * angle) / ((law_real)1 - p->filter_decay);
    s->integral = (p->inner_angle * angle) - filter;
    s->filter = filter + (p->filter_angle_now * angle);
}

/* What a period leaves to the next beside modes and reference: where a flipped bit would move the arm and nothing
 * contradict it, or a good gauge be given up. */
static law_real kept(const law_state *s)
{
    return ((s->motor_reference + s->motor_angle) + (s->integral + s->torque)) +
           ((s->error + s->scale) + s->track_push);
}

/* Let the reference model rest where the reference is. */
static void rest_track(law_state *s)
{
    s->track = s->reference;
    s->track_push = (law_real)0;
    s->late = (law_real)0;
}

/* Go on from what the sensors say, as an arm that stands there: nothing of a move is known any more. */
static void rest_arm(law_state *s, const law_params *p, const law_input *in)
{
    if (credible(in->motor_angle, p->angle_limit) != 0U) {
        s->motor_angle = in->motor_angle; /* not what a damaged one made of it */
    }
    s->torque = (credible(in->torque, p->torque_limit) != 0U) ? in->torque : (law_real)0;
    empty_modes(s);
    s->reference = s->motor_angle;
    s->motor_reference = clamped(s->motor_angle, p->motor_limit);
    s->model_angle = s->motor_reference;
    s->model_push = (law_real)0;
    s->encoder_model = s->motor_reference;
    s->error = s->torque * p->compliance;
    s->scale = (law_real)2 * LAW_SCALES; /* the first payload counts at once */
    s->payload = LAW_NO_PAYLOAD;
    s->given = 0U;
    s->tracking = 0U;
    rest_track(s);
    rest_motor(s, p, s->motor_angle);
    s->sum = s->reference + kept(s);
}

/* A state that has not started, and whether these parameters may start it. */
static LAW_APART uint32_t forget(law_state *s, const law_params *p)
{
    clear(s);
    s->reason = law_check(p);
    return s->reason;
}

/* Begin at the measured angle: the first motor reference is where the motor is, the motor loop is at rest. */
static uint32_t start(law_state *s, const law_params *p, const law_input *in)
{
    uint32_t flags = LAW_FLAG_ENCODER;
    const uint32_t reason = forget(s, p);
    if ((reason == LAW_OK) && (credible(in->motor_angle, p->angle_limit) != 0U)) {
        flags = LAW_FLAG_STARTED;
        s->stamp = p->crc;
        s->mode = copied(LAW_RUN);
        s->tick = in->tick - 1U;
        s->motor_angle = in->motor_angle;
        s->encoder = in->motor_angle;
        s->input_reference = in->motor_angle;
        rest_arm(s, p, in);
    }
    return flags;
}

/* How far a signal can have moved since its last good sample: `step` in each of the periods in between. Asked for
 * only where one step is not enough, which it nearly always is. */
static law_real stretched(law_real step, uint32_t periods)
{
    return (periods > 1U) ? (step * (law_real)periods) : step;
}

/* The encoder's angle. A reading that has not changed by a single count while the motor model moved on is frozen:
 * lost samples, or a dead encoder. The motor loop would drive a strong motor away from it within ten periods; the
 * model's move since the last change is added instead, until the encoder lives again or the law trips. */
static law_real watch_encoder(law_state *s, const law_params *p, law_real reading, uint32_t *flags)
{
    law_real angle = reading;
    law_real moved = s->model_angle - s->encoder_model;
    if ((reading < s->encoder) || (reading > s->encoder)) {
        s->encoder = reading;
        s->encoder_model = s->model_angle;
        s->frozen = 0U;
    } else if ((s->frozen != 0U) || (credible(moved, p->frozen_angle) == 0U)) {
        if ((credible(moved, p->angle_limit) == 0U) || (credible(s->encoder, p->angle_limit) == 0U)) {
            s->encoder = reading; /* damaged memory: NaN is never another count */
            s->encoder_model = s->model_angle;
            moved = (law_real)0;
        }
        s->frozen = counted(s->frozen);
        if (s->frozen > 1U) { /* twice the same count is chance where noise turns the motor round */
            *flags |= LAW_FLAG_ENCODER;
            angle = reading + moved;
        }
        if (s->frozen >= p->frozen_limit) {
            latch(s, LAW_RESIDUAL);
        }
    } else {
        /* unchanged, and nothing has asked the motor to move */
    }
    return angle;
}

/* How far the motor model moves in the next period. */
static law_real model_move(const law_state *s, const law_params *p)
{
    return (p->motor_now * (s->motor_reference - s->model_angle)) + s->model_push;
}

/* Take the encoder's angle if it is credible, else go on from the last one as the motor's model does. */
static uint32_t read_encoder(law_state *s, const law_params *p, const law_input *in, uint32_t periods)
{
    uint32_t flags = 0U;
    const law_real angle = watch_encoder(s, p, in->motor_angle, &flags);
    if ((credible(angle, p->angle_limit) != 0U) &&
        ((credible(angle - s->motor_angle, p->angle_step) != 0U) ||
         (credible(angle - s->motor_angle, stretched(p->angle_step, periods + s->bad_encoder + s->frozen)) != 0U) ||
         (credible(s->motor_angle, p->angle_limit) == 0U))) {
        s->motor_angle = angle;
        s->bad_encoder = 0U;
    } else {
        flags |= LAW_FLAG_ENCODER;
        s->motor_angle = clamped(s->motor_angle + model_move(s, p), p->angle_limit);
        s->bad_encoder = counted(s->bad_encoder);
        if (s->bad_encoder >= p->bad_limit) {
            latch(s, LAW_BAD_ENCODER);
        }
    }
    return flags;
}

/* Take the gauge's sample if it is credible, else keep the last one. */
static uint32_t read_gauge(law_state *s, const law_params *p, const law_input *in, uint32_t periods)
{
    uint32_t flags = 0U;
    if ((credible(in->torque, p->torque_limit) != 0U) &&
        ((credible(in->torque - s->torque, p->torque_step) != 0U) ||
         (credible(in->torque - s->torque, stretched(p->torque_step, periods + s->bad_gauge)) != 0U) ||
         (credible(s->torque, p->torque_limit) == 0U))) {
        s->torque = in->torque;
        s->bad_gauge = 0U;
    } else {
        flags = LAW_FLAG_GAUGE;
        s->torque = clamped(s->torque, p->torque_limit);
        s->bad_gauge = counted(s->bad_gauge);
        if (s->bad_gauge >= p->bad_limit) {
            latch(s, LAW_BAD_GAUGE);
        }
    }
    return flags;
}

/* Give up a gauge that stands still while the torque of the move, `model`, does not, in periods in which the motor
 * has turned from `stood`: friction holds a motor, and with it the torque, long after a slow move has begun. Called
 * before read_gauge. */
static void watch_gauge(law_state *s, const law_params *p, const law_input *in, law_real model, law_real stood)
{
    if (credible(in->torque - s->torque, (law_real)0) == 0U) {
        s->stuck = 0U;
        s->stuck_torque = model;
    } else if ((credible(model - s->stuck_torque, p->stuck_torque) == 0U) &&
               (credible(in->motor_angle - stood, (law_real)0) == 0U)) {
        s->stuck = counted(s->stuck);
        if (s->stuck >= p->stuck_limit) {
            latch(s, LAW_GAUGE_STUCK);
        }
    } else {
        /* unchanged, and the model does not ask for more */
    }
}

/* Trip on a blocked link and on a motor that is not where its model is. */
static uint32_t watch(law_state *s, const law_params *p)
{
    uint32_t flags = 0U;
    const law_real push = s->motor_reference - s->model_angle;
    s->model_angle += (p->motor_now * push) + s->model_push;
    s->model_push = (p->motor_next * push) + (p->motor_keep * s->model_push);
    if (credible(s->motor_angle - s->model_angle, p->residual_angle) != 0U) {
        s->residual = 0U;
    } else {
        flags = LAW_FLAG_RESIDUAL;
        if ((credible(s->model_push, p->motor_limit) == 0U) || (credible(s->model_angle, p->motor_limit) == 0U)) {
            s->model_angle = clamped(s->motor_angle, p->motor_limit); /* damaged memory: begin where the motor is */
            s->model_push = (law_real)0;
        }
        s->residual = counted(s->residual);
        if (s->residual >= p->residual_limit) {
            latch(s, LAW_RESIDUAL);
        }
    }
    if ((s->mode == copied(LAW_DEGRADED)) || (credible(s->torque, p->torque_block) != 0U)) {
        s->overload = 0U;
    } else {
        s->overload = counted(s->overload);
        if ((s->overload >= p->block_limit) ||
            ((s->overload >= p->bad_limit) && (credible(s->torque, p->torque_trip) == 0U))) {
            latch(s, LAW_OVERLOAD);
        }
    }
    return flags;
}

/* Real modes, one period on, driven by `input`; returns `direct` plus their sum. The states are added to `found` as
 * the period finds them, and to `left` as it leaves them. */
static law_real run_modes(law_real direct, law_real *states, law_real input, const law_mode *modes, law_real *found,
                          uint32_t count, law_real *left)
{
    law_real sum = direct;
    law_real before = *found;
    law_real after = *left;
    uint32_t i;
#if defined(LAW_EXACT) && defined(__GNUC__) && !defined(__clang__)
#pragma GCC unroll 8
#else
    /*@ loop unroll 8; */
#endif
    for (i = 0U; i < count; i++) {
        const law_real value = states[i];
        const law_real next = (modes[i].pole * value) + input;
        sum += modes[i].gain * value;
        states[i] = next;
        before += value;
        after += next;
    }
    *found = before;
    *left = after;
    return sum;
}

/* The correction of the error's change. */
static law_real correct(law_state *s, const law_params *p, law_real *found, law_real change, law_real *left)
{
    law_real sum;
    uint32_t count = LAW_REAL_MODES;
#ifndef LAW_EXACT
    if (p->real_modes < count) {
        count = p->real_modes;
    }
#endif
    sum = run_modes(p->direct * change, &s->real[0], change, &p->real[0], found, count, left);
#if !defined(LAW_EXACT) || defined(LAW_PAIRS)
    count = LAW_PAIR_MODES;
#ifndef LAW_EXACT
    if (p->pair_modes < count) {
        count = p->pair_modes;
    }
#endif
    /*@ loop unroll 2; */
    for (uint32_t i = 0U; i < count; i++) {
        const law_pair *const pair = &p->pair[i];
        const uint32_t place = 2U * i;
        law_real *const state = &s->pair[place];
        const law_real re = state[0];
        const law_real im = state[1];
        sum += (pair->gain * re) - (pair->cross * im);
        state[0] = ((pair->pole * re) - (pair->turn * im)) + change;
        state[1] = (pair->pole * im) + (pair->turn * re);
        *found += re;
        *found += im;
        *left += state[0];
        *left += state[1];
    }
#endif
    return sum;
}

/* The feed-forward s^(order - 2)/natural_frequency^2 of the reference's acceleration. */
static law_real feed_forward(law_state *s, const law_params *p, law_real *found, law_real acceleration,
                             law_real *left)
{
    uint32_t count = LAW_FORWARD_MODES;
#ifndef LAW_EXACT
    if (p->forward_modes < count) {
        count = p->forward_modes;
    }
#endif
    return run_modes(p->forward_direct * acceleration, &s->forward[0], acceleration, &p->forward[0], found, count, left);
}

/* Heal the correction's states; returns what is left of the correction. */
static law_real healed_correction(law_state *s, const law_params *p, law_real sum, law_real *left)
{
    *left = s->reference;
    heal(p->forward_limit, &s->forward[0], LAW_FORWARD_MODES, left);
    heal(p->correction_limit, &s->real[0], LAW_REAL_MODES, left);
#if !defined(LAW_EXACT) || defined(LAW_PAIRS)
    heal(p->correction_limit, &s->pair[0], 2U * LAW_PAIR_MODES, left);
#endif
    return clamped(sum, p->sum_limit);
}

/* The motor loop: two-degree-of-freedom PID by Tustin, with compensations, limit and anti-windup. Friction is
 * compensated by the direction in which the motor model moves in the period after this one (`change`), when the
 * voltage acts; it has none of the noise of a differentiated encoder. In hold a voltage that goes from one limit to
 * the other and back is a motor loop that is not stable: off. */
static uint32_t close_motor(law_state *s, const law_params *p, law_output *out)
{
    uint32_t flags = 0U;
    const law_real push = s->motor_reference - s->model_angle;
    const law_real change = (p->motor_next * push) + (p->motor_keep * s->model_push);
    const law_real compensation = p->torque_voltage * s->torque;
    const law_real angle = s->motor_angle;
    const law_real eps = s->motor_reference - angle;
    const law_real integral = s->integral + (p->integral_now * eps);
    const law_real filter = (s->filter + (p->filter_now * eps)) - (p->filter_angle_now * angle);
    const law_real coulomb = p->coulomb_voltage * limited(change * p->coulomb_slope, (law_real)1);
    const law_real pid = (((p->inner_direct * eps) - (p->inner_angle * angle)) + integral) + filter;
    const law_real wanted = pid + (compensation + coulomb);
    const law_real voltage = clamped(wanted, p->voltage_limit);
    const law_real excess = wanted - voltage;
    const uint32_t inside = credible(excess, (law_real)0);
    /* At the limit the integral moves only towards the inside: it would wind up there, and overshoot later. */
    if ((inside != 0U) || ((excess * eps) <= (law_real)0)) {
        s->integral = integral + (p->integral_before * eps);
    }
    s->filter = ((p->filter_decay * filter) + (p->filter_before * eps)) - (p->filter_angle_before * angle);
    s->voltage = voltage;
    out->compensation = compensation;
    if (inside == 0U) {
        flags = LAW_FLAG_SATURATED;
        if (credible(wanted, p->wanted_limit) == 0U) {
            rest_motor(s, p, angle); /* damaged memory, or wound up beyond all errors: begin anew */
        }
        if (s->mode == copied(LAW_HOLD)) {
            if ((voltage * s->swing) < (law_real)0) {
                s->ringing = counted(s->ringing);
            }
            s->swing = voltage;
            if (s->ringing >= p->bad_limit) {
                latch(s, LAW_RAILED);
                s->voltage = (law_real)0;
                out->compensation = (law_real)0;
            }
        }
    }
    return flags;
}

/* Come nearer to a reference that has left its speed limit. What little a restart leaves behind is caught up with at
 * full speed; a jump shrinks at the rate of the link's own motion, because a faster one rings; and beneath both the
 * reference's own motion goes on. */
static void catch_up(law_state *s, const law_params *p, const law_input *in, uint32_t periods)
{
    const law_real reference = in->reference;
    law_real moved = reference - s->input_reference;
    law_real behind = reference - s->reference;
    if ((credible(s->reference, p->angle_limit) == 0U) ||
        (credible(behind, stretched(p->reference_step, periods)) != 0U)) {
        s->reference = reference; /* damaged memory, or periods that were missed */
    } else {
        if (credible(moved, stretched(p->reference_step, periods)) == 0U) {
            moved = (law_real)0;
        }
        behind -= moved;
        if (credible(behind, (law_real)2 * p->reference_step) == 0U) {
            behind *= p->reference_rate;
        }
        s->reference = clamped(s->reference + (moved + clamped(behind, p->reference_step)), p->angle_limit);
    }
}

/* Follow the reference at no more than its largest speed and return its acceleration; an unusable sample holds. */
static law_real follow(law_state *s, const law_params *p, const law_input *in, uint32_t periods, uint32_t *flags)
{
    law_real acceleration = (law_real)0;
    if (credible(in->reference, p->angle_limit) != 0U) {
        const law_real change = in->reference - s->reference;
        acceleration = limited(in->reference_acceleration, p->acceleration_limit);
        if (credible(change, p->reference_step) != 0U) {
            s->reference = in->reference; /* not reference + change: that would round */
        } else {
            *flags |= LAW_FLAG_REFERENCE;
            catch_up(s, p, in, periods);
        }
        s->input_reference = in->reference;
    } else {
        *flags |= LAW_FLAG_REFERENCE;
        s->reference = clamped(s->reference, p->angle_limit);
    }
    return acceleration;
}

/* The motor reference: reference + feed-forward + correction, limited in range and speed. */
static uint32_t command(law_state *s, const law_params *p, law_real offset)
{
    uint32_t flags = 0U;
    const law_real before = s->motor_reference;
    const law_real wanted = s->reference + offset;
    const law_real change = wanted - before;
    if (credible(change, p->motor_step) != 0U) {
        s->motor_reference = clamped(wanted, p->motor_limit); /* not before + change: that would round */
    } else {
        flags = LAW_FLAG_LIMITED;
        s->motor_reference = clamped(before + clamped(change, p->motor_step), p->motor_limit);
    }
    return flags;
}

/* What is left of the correction: all of it, or less and less once the gauge is given up. */
static law_real faded(law_state *s, const law_params *p, law_real correction)
{
    law_real left = correction;
    if (s->mode == copied(LAW_DEGRADED)) {
        s->fade = clamped(s->fade - p->fade_step, (law_real)1);
        if (s->fade < (law_real)0) {
            s->fade = (law_real)0;
        }
        left = s->fade * correction;
    }
    return left;
}

/* Look at a payload that is not the one that was looked at before, and move the feed-forward's scale towards what it
 * makes of 1/natural_frequency^2: no faster than `scale_step` in a period, because in the middle of a move a jump of
 * the feed-forward rings the link. One that cannot be is as one that is not given: NaN fails all three comparisons. */
static uint32_t weigh(law_state *s, const law_params *p, law_real payload)
{
    uint32_t flags = 0U;
    law_real wanted = (law_real)1;
    law_real change;
    s->given = 0U;
    if ((payload > (law_real)0) && (payload <= p->payload_limit)) {
        wanted = p->link_scale + (p->payload_scale * payload);
        s->given = 1U;
    } else if (credible(payload, (law_real)0) == 0U) {
        flags = LAW_FLAG_PAYLOAD;
    } else {
        /* none is given */
    }
    change = wanted - s->scale;
    if ((credible(change, p->scale_step) != 0U) || (credible(change, LAW_SCALES) == 0U)) {
        s->scale = wanted; /* there, just started, or damaged memory */
        s->payload = (flags == 0U) ? payload : LAW_NO_PAYLOAD;
    } else {
        s->scale += clamped(change, p->scale_step);
        s->payload = LAW_NO_PAYLOAD; /* on its way, and no payload stands for where it is */
    }
    return flags;
}

/* What the tip estimate shall be now. Without a payload it is the reference itself. With one, the feed-forward is
 * right, and the tip follows the reference as the motor follows its own, late: the error is formed with just that
 * lateness, and the correction does not fight it. A gauge that is late or has a gain of its own shows another flexion
 * than the arm has: the difference goes through the same motor loop.
 * The model outlasts its payload until it stands where the reference stands, so that no switch bumps the error. */
static law_real expected(law_state *s, const law_params *p, law_real forward)
{
    law_real angle = s->reference;
    if (s->given != 0U) {
        if (s->tracking == 0U) {
            rest_track(s);
            s->tracking = 1U;
        }
    } else if ((s->tracking != 0U) && (credible(s->track - angle, LAW_RESTS) != 0U)) {
        s->tracking = 0U;
    } else {
        /* goes on */
    }
    if (s->tracking != 0U) {
        law_real track = s->track;
        law_real push;
        if (credible(track, p->angle_limit) == 0U) {
            rest_track(s); /* damaged memory */
            track = angle;
        }
        push = angle - track;
        if ((p->options & LAW_LATE_GAUGE) != 0U) {
            s->late = (p->gauge_now * forward) + (p->gauge_keep * s->late);
            push += forward - s->late;
        }
        s->track = track + ((p->motor_now * push) + s->track_push);
        s->track_push = (p->motor_next * push) + (p->motor_keep * s->track_push);
        angle = track;
    }
    return angle;
}

/* Whether the memory is another than the last period left: its sum is. NaN is another one, too, and what is smaller
 * than `LAW_TINY` is a mode that has died away. */
static uint32_t damaged(const law_state *s, law_real sum)
{
    return (credible(sum - s->sum, LAW_TINY) != 0U) ? 0U : 1U;
}

/* Flag a vibration that does not decay, and trip on it where a limit was given. Each change of the error from beyond
 * the limit on one side to beyond it on the other counts for three half periods of the link, and each period takes one
 * off: what swings on for nine half periods is seen, and one that decays, or a row of moves, is not. */
static uint32_t watch_ringing(law_state *s, const law_params *p, law_real error)
{
    uint32_t flags = 0U;
    if (s->ringing != 0U) {
        s->ringing -= 1U;
        if (s->ringing > (12U * p->block_limit)) {
            flags = LAW_FLAG_RINGING;
            if ((p->options & LAW_STOP_RINGING) != 0U) {
                latch(s, LAW_RINGING);
            } else if (s->ringing > (16U * p->block_limit)) {
                s->ringing = 16U * p->block_limit; /* one that ends is over within sixteen half periods */
            } else {
                /* flagged */
            }
        }
    }
    if (credible(error, p->swing_angle) == 0U) {
        if ((error * s->swing) < (law_real)0) {
            s->ringing += 2U * p->block_limit;
        }
        s->swing = error;
    }
    return flags;
}

/* Everything between the clock and the outputs, for a law that is started. */
static uint32_t run(law_state *s, const law_params *p, const law_input *in, law_output *out, uint32_t periods)
{
    uint32_t flags = 0U;
    const law_real before = kept(s);
    const law_real stood = s->encoder;
    law_real found = s->reference;
    const law_real acceleration = follow(s, p, in, periods, &flags);
    law_real left = s->reference;
    law_real forward;
    law_real tip;
    law_real error;
    law_real correction;
    flags |= read_encoder(s, p, in, periods);
    sweep(s);
    if (credible(in->payload - s->payload, (law_real)0) == 0U) {
        flags |= weigh(s, p, in->payload);
    }
    forward = s->scale * feed_forward(s, p, &found, acceleration, &left);
    if (credible(forward, p->sum_limit) == 0U) {
        left = s->reference;
        heal(p->forward_limit, &s->forward[0], LAW_FORWARD_MODES, &left);
        forward = clamped(forward, p->sum_limit);
        s->payload = LAW_NO_PAYLOAD;
    }
    watch_gauge(s, p, in, p->stiffness * forward, stood);
    flags |= read_gauge(s, p, in, periods);
    flags |= watch(s, p);
    tip = s->motor_angle - (s->torque * p->compliance);
    error = expected(s, p, forward) - tip;
    correction = correct(s, p, &found, error - s->error, &left);
    if (damaged(s, found + before) != 0U) {
        flags |= LAW_FLAG_STARTED;
        rest_arm(s, p, in);
        tip = s->motor_angle - s->error;
        left = s->reference;
        forward = (law_real)0;
        correction = (law_real)0;
        error = s->error;
    } else if (credible(correction, p->sum_limit) == 0U) {
        correction = healed_correction(s, p, correction, &left);
    } else {
        /* as it should be */
    }
    s->error = error;
    out->tip_estimate = tip;
    out->error = error;
    if (s->mode == copied(LAW_RUN)) {
        flags |= watch_ringing(s, p, error);
    }
    if (s->mode <= copied(LAW_DEGRADED)) {
        flags |= command(s, p, forward + faded(s, p, correction));
    } else {
        s->motor_reference = clamped(s->motor_reference, p->motor_limit);
    }
    out->motor_reference = s->motor_reference;
    if ((s->mode <= copied(LAW_HOLD)) && ((p->options & LAW_WITH_INNER) != 0U)) {
        flags |= close_motor(s, p, out);
    } else {
        s->voltage = (law_real)0;
        out->compensation = (law_real)0;
    }
    out->voltage = s->voltage;
    s->sum = left + kept(s);
    return flags;
}

/* CRC-32 of everything behind the crc field. Bit by bit: 256 words of table cost more flash than time here. */
static uint32_t block_crc(const law_params *params)
{
    const unsigned char *bytes = (const unsigned char *)params;
    uint32_t crc = 0xFFFFFFFFU;
    uint32_t i;
    uint32_t bit;
    for (i = 16U; i < (uint32_t)sizeof(law_params); i++) {
        crc ^= (uint32_t)bytes[i];
        for (bit = 0U; bit < 8U; bit++) {
            crc = ((crc & 1U) != 0U) ? ((crc >> 1U) ^ 0xEDB88320U) : (crc >> 1U);
        }
    }
    return crc ^ 0xFFFFFFFFU;
}

uint32_t law_check(const law_params *params)
{
    uint32_t reason = LAW_OK;
    if (params->version != LAW_VERSION) {
        reason = LAW_BAD_VERSION;
    } else if ((params->size != (uint32_t)sizeof(law_params)) || (params->precision != (uint32_t)sizeof(law_real))) {
        reason = LAW_BAD_SIZE;
    } else if (params->crc != block_crc(params)) {
        reason = LAW_BAD_CRC;
    } else if ((params->real_modes > LAW_REAL_MODES) || (params->pair_modes > LAW_PAIR_MODES) ||
               (params->forward_modes > LAW_FORWARD_MODES)) {
        reason = LAW_BAD_COUNTS;
    } else {
        /* usable */
    }
    return reason;
}

uint32_t law_init(law_state *state, const law_params *params)
{
    return forget(state, params);
}

/* What a call puts out that has computed nothing. */
static void say_nothing(law_output *out)
{
    out->compensation = (law_real)0;
    out->tip_estimate = (law_real)0;
    out->error = (law_real)0;
}

/* A call that is not a new period: hold the outputs, and trip once that lasts as long as periods may be missed. A
 * clock that was set back goes on from where it is: to wait for it keeps the last voltage on for longer. */
static void repeat(law_state *s, const law_params *p, law_output *out, uint32_t tick)
{
    s->tick = tick;
    s->missed = counted(s->missed);
    if (s->missed > p->missed_limit) {
        latch(s, LAW_MISSED);
    }
    if (s->mode > copied(LAW_HOLD)) {
        s->voltage = (law_real)0;
    }
    out->motor_reference = clamped(s->motor_reference, p->motor_limit);
    out->voltage = clamped(s->voltage, p->voltage_limit);
    say_nothing(out);
}

/* Make the state fit the parameters: begin anew, or stay tripped where the stamp alone is damaged. */
static LAW_APART uint32_t restart(law_state *s, const law_params *p, const law_input *in)
{
    uint32_t flags = 0U;
    const uint32_t mode = corrected(s->mode);
    const uint32_t differ = s->mode ^ mode;
    if ((mode > copied(LAW_RUN)) && ((differ & (differ - 1U)) == 0U) && (law_check(p) == LAW_OK)) {
        s->stamp = p->crc;
        s->mode = mode;
    } else {
        flags = start(s, p, in);
    }
    return flags;
}

void law_step(law_state *state, const law_params *params, const law_input *input, law_output *output)
{
    uint32_t flags = 0U;
    uint32_t periods;
    if (state->stamp != params->crc) { /* the exporter gives out no block with crc 0, the stamp of a cleared state */
        flags |= restart(state, params, input);
    }
    if (state->mode != copied(LAW_RUN)) {
        state->mode = corrected(state->mode);
    }
    periods = input->tick - state->tick;
    if (state->mode == LAW_IDLE) {
        state->stamp = 0U;
        output->motor_reference = (law_real)0;
        output->voltage = (law_real)0;
        say_nothing(output);
    } else if ((periods == 0U) || (periods > LAW_COUNT_MAX)) {
        flags |= LAW_FLAG_REPEATED;
        repeat(state, params, output, input->tick);
    } else {
        state->tick = input->tick;
        if (periods > 1U) {
            flags |= LAW_FLAG_MISSED;
            state->missed += periods - 1U;
            if (state->missed > params->missed_limit) {
                latch(state, LAW_MISSED);
            }
        } else if (state->missed != 0U) {
            state->missed -= 1U; /* not in a row: every third period called is as bad as a row that never ends */
        } else {
            /* on time */
        }
        flags |= run(state, params, input, output, periods);
    }
    output->mode = state->mode >> 24U;
    output->reason = state->reason;
    output->flags = flags;
}

uint32_t law_check_wiring(law_wiring *test, const law_params *params, law_real motor_angle, law_real torque)
{
    uint32_t reason = LAW_NOT_MOVED;
    const law_real angle = clamped(motor_angle, params->angle_limit);
    const law_real twist = clamped(torque, params->torque_limit);
    if (test->started != 0U) {
        /* While the tip has not moved yet, a step of the motor bends the link: torque step = c times motor step. */
        const law_real step = clamped(angle - test->motor_angle, params->angle_limit);
        test->cross = clamped(test->cross + (step * clamped(twist - test->torque, params->torque_limit)), LAW_LARGE);
        test->energy = clamped(test->energy + (step * step), LAW_LARGE);
    } else {
        test->cross = (law_real)0;
        test->energy = (law_real)0;
    }
    test->started = 1U;
    test->motor_angle = angle;
    test->torque = twist;
    if (test->energy >= params->wiring_energy) {
        const law_real bound = (law_real)0.25F * (params->stiffness * test->energy);
        if (test->cross > bound) {
            reason = LAW_OK;
        } else if (test->cross < -bound) {
            reason = LAW_GAUGE_REVERSED;
        } else {
            reason = LAW_GAUGE_DEAD;
        }
    }
    return reason;
}
