/* The payload estimated while the arm moves. See payload_estimator.h for how to call it.
 *
 * Reasons for its structure:
 *  - Each model reads the torque through a filter that forgets within half a vibration, so that its error is linear
 *    in the gauge's gain and offset: two least-squares equations per model, no covariance matrices, and every filter
 *    is stable for any data. A joint estimate of frequency, gain and offset would need an observer of the vibration
 *    that is right before the frequency is known.
 *  - The models use means over a few periods and are updated in turn: a vibration of 20 rad/s does not need 250
 *    samples per second, and the work of a sample is spread over the periods until the next.
 *  - Evidence fades only while the arm moves. Once the best model has failed in two consecutive samples, the payload
 *    has changed: the evidence is halved in every sample until the best model fits again, or has failed in ten.
 *  - Bounds do not find damaged memory: an error no larger than what one move adds to a sum is within every bound, and
 *    takes many moves to fade. What the estimate is computed from in later periods has checksums instead; a mismatch
 *    restarts the estimate, and NaN never matches.
 */
#include "payload_estimator.h"

#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__) && !defined(__STRICT_ANSI__) && !defined(LAW_CONTRACT_OFF) && \
    (defined(__FMA__) || defined(__ARM_FEATURE_FMA) || defined(__riscv_flen) || defined(__FP_FAST_FMA) || \
     defined(__FP_FAST_FMAF))
#error "compile payload_estimator.c with -std=c99, or with -ffp-contract=off -DLAW_CONTRACT_OFF"
#endif

#define PAYLOAD_TWICE 2U /* consecutive samples: a single one may be a sensor fault */
#define PAYLOAD_FADES 10U /* such samples that fade the evidence; with more, a wrong offset could never be learnt */
#define PAYLOAD_DEVIATION ((law_real)1) /* largest relative standard deviation that is reported */
#define PAYLOAD_NEAR 7U /* models whose costs give the estimate */
#define PAYLOAD_NONE ((law_real)1e30F)  /* larger than any cost */

/* Whether a value is a number within +-`limit`: NaN fails the comparison, and so does the square of infinity. */
static uint32_t sound(law_real value, law_real limit)
{
    return ((value * value) <= (limit * limit)) ? 1U : 0U;
}

/* Whether two sums are the same number. */
static uint32_t same(law_real one, law_real other)
{
    return ((one <= other) && (one >= other)) ? 1U : 0U;
}

static uint32_t one_more(uint32_t count)
{
    return (count < 0x7FFFFFFFU) ? (count + 1U) : count;
}

/* Checksum of what is kept between periods apart from the models and the means: the inputs of the models and what the
 * estimate rests on. */
static law_real lasting(const payload_state *s)
{
    return (((s->angle + s->change) + (s->torque + s->offset)) + ((s->offset_variance + s->shift) + (s->drift + s->samples))) +
           (((s->keep + s->remaining) + (s->spread + s->white)) + (s->carried[0] + (s->carried[1] + s->carried[2])));
}

/* The same for a model. */
static law_real remembered(const payload_memory *m)
{
    return (((m->torque[0] + m->torque[1]) + (m->torque[2] + m->angle[0])) + ((m->angle[1] + m->angle[2]) + (m->ee + m->ev))) +
           ((m->vv + m->e) + m->v);
}

/* The same for the means that are being formed. */
static law_real begun(const payload_state *s)
{
    return (s->angle_sum + s->torque_sum) + (law_real)s->count;
}

/* Clear all knowledge. */
static void know_nothing(payload_state *s)
{
    const law_real zero = (law_real)0;
    uint32_t i;
    uint32_t j;
    s->stamp = 0U;
    s->tick = 0U;
    s->count = 0U;
    s->next = PAYLOAD_MODELS;
    s->gap = 0U;
    s->quiet = 0U;
    s->odd = 0U;
    s->touched = 0U;
    s->best = 0U;
    s->flags = 0U;
    /*@ loop unroll 14; */
    for (i = 0U; i < PAYLOAD_MODELS; i++) {
        payload_memory *const m = &s->model[i];
        /*@ loop unroll 3; */
        for (j = 0U; j < 3U; j++) {
            m->torque[j] = zero;
            m->angle[j] = zero;
        }
        m->ee = zero;
        m->ev = zero;
        m->vv = zero;
        m->e = zero;
        m->v = zero;
    }
    s->angle_sum = zero;
    s->torque_sum = zero;
    s->last_angle = zero;
    s->last_torque = zero;
    s->angle = zero;
    s->change = zero;
    s->torque = zero;
    s->offset = zero;
    s->offset_variance = zero;
    s->shift = zero;
    s->drift = zero;
    s->samples = zero;
    s->keep = zero;
    s->best_cost = zero;
    s->best_told = zero;
    s->best_error = zero;
    s->before_left = zero;
    for (i = 0U; i < 3U; i++) {
        s->left[i] = zero;
        s->carried[i] = zero;
    }
    s->remaining = zero;
    s->spread = zero;
    s->white = zero;
    s->sum = zero;
    s->means = zero;
    s->models = zero;
    s->models_found = zero;
    s->models_left = zero;
    s->least = zero;
    s->deviation = PAYLOAD_DEVIATION;
    s->estimate = zero;
    s->low = zero;
    s->high = zero;
}

/* Begin with a good reading of an arm at rest; if it moves, the errors of the models will show it. */
static void begin(payload_state *s, const payload_params *p, uint32_t tick, law_real angle, law_real torque)
{
    know_nothing(s);
    if ((payload_check(p) == LAW_OK) && (sound(angle, p->angle_limit) != 0U) && (sound(torque, p->torque_limit) != 0U)) {
        s->stamp = p->crc;
        s->tick = tick - 1U;
        s->last_angle = angle;
        s->last_torque = torque;
        s->angle = angle;
        s->offset = torque;
        s->offset_variance = p->offset_variance;
        s->sum = lasting(s);
    }
}

/* Form the next sample of the models from the means, and learn the gauge's offset while nothing moves. */
static void sample(payload_state *s, const payload_params *p)
{
    const law_real periods = (law_real)s->count;
    const law_real angle = s->angle_sum / periods;
    /* The first sample is the initial offset: a mean, since the noise of a single reading would stay in every
     * filter. */
    s->offset = (s->samples == (law_real)0) ? (s->torque_sum / periods) : s->offset;
    const law_real torque = (s->torque_sum / periods) - s->offset;
    s->change = angle - s->angle;
    s->angle = angle;
    s->torque = torque;
    s->shift = (law_real)0;
    s->angle_sum = (law_real)0;
    s->torque_sum = (law_real)0;
    s->count = 0U;
    if ((sound(s->best_told, p->torque_moved) != 0U) && (sound(torque - s->drift, p->torque_moved) != 0U)) {
        s->quiet = one_more(s->quiet);
    } else {
        s->quiet = 0U;
    }
    if (s->quiet > p->quiet_limit) {
        const law_real part = s->offset_variance / (s->offset_variance + p->variance);
        s->flags |= PAYLOAD_FROZEN;
        s->shift = part * torque;
        s->drift -= s->shift;
        s->offset += s->shift;
        s->torque -= s->shift;
        const law_real known = ((law_real)1 - part) * s->offset_variance;
        const law_real least = (law_real)0.25F * p->variance; /* drift of the gauge's zero */
        s->offset_variance = (known > least) ? known : least;
    } else {
        s->flags &= ~PAYLOAD_FROZEN;
        s->keep = (((s->flags & PAYLOAD_CHANGED) != 0U) && (s->odd < PAYLOAD_FADES)) ? (law_real)0.5F : p->keep;
        s->samples = (s->keep * s->samples) + (law_real)1;
    }
    s->sum = lasting(s);
    s->models_found = (law_real)0;
    s->models_left = (law_real)0;
    s->next = 0U;
    s->best_cost = PAYLOAD_NONE;
    s->least = PAYLOAD_NONE;
}

/* The gain and the offset of the gauge with which a model errs least, and that least error: the minimum of sum (e - x
 * v - y rest)^2 + gain_weight x^2 + offset_weight y^2. */
static inline payload_fit fitted(const payload_state *s, const payload_params *p, uint32_t i, law_real offset_weight)
{
    const payload_memory *const m = &s->model[i];
    const law_real share = p->model[i].rest;
    const law_real gain = m->vv + p->gain_weight;
    const law_real both = m->v * share;
    const law_real rest = ((s->samples * share) * share) + offset_weight;
    const law_real second = m->e * share;
    const law_real scale = (law_real)1 / ((gain * rest) - (both * both));
    payload_fit fit;
    fit.gain = ((m->ev * rest) - (second * both)) * scale;
    fit.offset = ((second * gain) - (m->ev * both)) * scale;
    fit.cost = m->ee - ((fit.gain * m->ev) + (fit.offset * second));
    return fit;
}

/* Advance the filters of a model by one sample, in transposed direct form: a state is what the samples so far
 * contribute to a later one. */
static void pass_on(const payload_state *s, const payload_model *c, payload_memory *m, law_real seen, law_real told)
{
    m->torque[0] = ((c->a1 * s->torque) - (c->c1 * seen)) + m->torque[1];
    m->torque[1] = ((c->a2 * s->torque) - (c->c2 * seen)) + m->torque[2];
    m->torque[2] = (c->a3 * s->torque) - (c->c3 * seen);
    m->angle[0] = ((c->b1 * s->change) - (c->c1 * told)) + m->angle[1];
    m->angle[1] = ((c->b2 * s->change) - (c->c2 * told)) + m->angle[2];
    m->angle[2] = -(c->c3 * told);
}

/* Add the error of a model in this sample to its sums, and keep it if the model is the best so far or the next one. */
static void look(payload_state *s, const payload_params *p, uint32_t i, law_real e, law_real told, law_real offset_weight)
{
    payload_memory *const m = &s->model[i];
    const law_real swing = s->torque - s->drift;
    m->ee = (s->keep * m->ee) + (e * e);
    m->ev = (s->keep * m->ev) + (e * told);
    m->vv = (s->keep * m->vv) + (told * told);
    m->e = (s->keep * m->e) + e;
    m->v = (s->keep * m->v) + told;
    const payload_fit fit = fitted(s, p, i, offset_weight);
    const law_real left = e - ((fit.gain * told) + (fit.offset * p->model[i].rest));
    const law_real error = left * left;
    /* for a payload between two models of the bank, even the right model has an error proportional to the torque */
    const law_real size = (told * told) + (swing * swing);
    const law_real excess = error - (p->contact * size);
    s->least = (excess < s->least) ? excess : s->least;
    if (fit.cost < s->best_cost) {
        s->left[0] = s->before_left;
        s->left[1] = left;
        s->left[2] = left; /* until the next model */
        s->best = i;
        s->best_cost = fit.cost;
        s->best_told = told;
        s->best_error = error - (p->surprise * size);
    } else if ((i - s->best) == 1U) {
        s->left[2] = left;
    } else {
        /* one of the others */
    }
    s->before_left = left;
}

/* A model while nothing moves: its filter runs on, and its sums keep what they held, corrected for the new offset. */
static void stand(payload_state *s, const payload_params *p, uint32_t i, law_real told)
{
    payload_memory *const m = &s->model[i];
    const law_real step = s->shift * p->model[i].rest;
    if (sound(told, (law_real)1e-15F) != 0U) { /* they would remain as denormals for ever */
        m->angle[0] = (law_real)0;
        m->angle[1] = (law_real)0;
        m->angle[2] = (law_real)0;
    }
    if (i == s->best) {
        s->best_told = told;
    }
    m->ee = (m->ee - (((law_real)2 * step) * m->e)) + ((s->samples * step) * step);
    m->ev -= step * m->v;
    m->e -= s->samples * step;
}

/* Whether the estimate is accurate enough for the law. */
static uint32_t usable(const payload_state *s, const payload_params *p)
{
    return (((s->deviation > (law_real)0) && (s->deviation <= p->narrow)) && (s->estimate <= p->payload_limit)) ? 1U : 0U;
}

/* Whether the last samples are explained by the best model, or by any. */
static void judge(payload_state *s, const payload_params *p)
{
    /* four and eight standard deviations */
    s->odd = (s->best_error > ((law_real)16 * p->variance)) ? one_more(s->odd) : 0U;
    s->touched = (s->least > ((law_real)64 * p->variance)) ? one_more(s->touched) : 0U;
    s->flags &= ~(PAYLOAD_CONTACT | PAYLOAD_CHANGED);
    s->flags |= (s->odd >= PAYLOAD_TWICE) ? PAYLOAD_CHANGED : 0U;
    s->flags |= (s->touched >= PAYLOAD_TWICE) ? PAYLOAD_CONTACT : 0U;
}

/* Noise moves the estimate in proportion to the sum of `slope` e over the samples: slope is the change of the remaining
 * error from model to model, and the filter of the model correlates consecutive errors e. Returns the variance of that
 * sum relative to its variance for independent errors; the uncertainty of the gauge's gain adds to it. */
static law_real spread(payload_state *s, const payload_params *p, uint32_t inside, law_real gain)
{
    const payload_model *const c = &p->model[s->best];
    const law_real slope = (inside != 0U) ? ((law_real)0.5F * (s->left[2] - s->left[0])) : (law_real)0;
    const law_real first = s->keep * s->carried[0];
    s->spread = ((s->keep * s->keep) * s->spread) + (slope * (((law_real)2 * first) + (slope * c->power)));
    s->white = (s->keep * s->white) + (slope * slope);
    s->carried[0] = ((s->keep * s->carried[1]) - (c->c1 * first)) + (slope * c->echo0);
    s->carried[1] = ((s->keep * s->carried[2]) - (c->c2 * first)) + (slope * c->echo1);
    s->carried[2] = (slope * c->echo2) - (c->c3 * first);
    return (s->spread + (p->gain_weight * (gain * gain))) / s->white;
}

/* The minimum of the curve through the costs of seven models, and its curvature there. The search starts at the best
 * model, which is the middle one + `start`; the minimum is returned relative to that model, in models. */
static law_real lowest(const payload_fit fit[PAYLOAD_NEAR], law_real start, law_real *bend)
{
    law_real odd[3];
    law_real even[3];
    law_real at = start;
    uint32_t i;
    /*@ loop unroll 3; */
    for (i = 0U; i < 3U; i++) {
        const law_real above = fit[4U + i].cost - fit[3].cost;
        const law_real below = fit[2U - i].cost - fit[3].cost;
        odd[i] = (law_real)0.5F * (above - below);
        even[i] = (law_real)0.5F * (above + below);
    }
    /* coefficients of the slope, from the constant to that of the fifth power */
    const law_real slope[6] = {
        ((((law_real)45 * odd[0]) - ((law_real)9 * odd[1])) + odd[2]) / (law_real)30,
        ((((law_real)270 * even[0]) - ((law_real)27 * even[1])) + ((law_real)2 * even[2])) / (law_real)90,
        ((((law_real)8 * odd[1]) - ((law_real)13 * odd[0])) - odd[2]) / (law_real)8,
        ((((law_real)12 * even[1]) - ((law_real)39 * even[0])) - even[2]) / (law_real)18,
        ((((law_real)5 * odd[0]) - ((law_real)4 * odd[1])) + odd[2]) / (law_real)24,
        ((((law_real)15 * even[0]) - ((law_real)6 * even[1])) + even[2]) / (law_real)60,
    };
    /*@ loop unroll 3; */
    for (i = 0U; i < 3U; i++) { /* Newton's method, starting at the best model */
        law_real fall = slope[5];
        uint32_t k;
        *bend = (law_real)0;
        /*@ loop unroll 5; */
        for (k = 5U; k > 0U; k--) { /* Horner's rule, for the slope and its derivative */
            *bend = (*bend * at) + fall;
            fall = (fall * at) + slope[k - 1U];
        }
        at -= fall / *bend;
    }
    return at - start;
}

/* The squared error of this sample for the model that is `at` models from the best one, between those of the bank. The
 * fit of gain, offset and mass includes this sample and so makes its error smaller than that of a prediction, by the
 * sample's own share in the fit; this is corrected. */
static law_real unexplained(payload_state *s, const payload_params *p, law_real at, law_real bend)
{
    const payload_memory *const m = &s->model[s->best];
    const law_real rest = p->model[s->best].rest;
    const law_real told = s->best_told;
    const law_real step = (law_real)0.5F * (s->left[2] - s->left[0]);
    const law_real bow = (s->left[2] - s->left[1]) - (s->left[1] - s->left[0]);
    const law_real left = s->left[1] + (at * (step + ((law_real)0.5F * (at * bow))));
    const law_real gain = m->vv + p->gain_weight;
    const law_real both = m->v * rest;
    const law_real still = ((s->samples * rest) * rest) + (p->variance / s->offset_variance);
    const law_real known = (((told * told) * still) + (rest * ((rest * gain) - (((law_real)2 * told) * both)))) / ((gain * still) - (both * both));
    const law_real mass = (bend > (law_real)0) ? ((((law_real)2 * step) * step) / bend) : (law_real)0;
    const law_real new = (law_real)1 - (known + mass);
    const law_real error = left * left;
    s->least = (error < s->least) ? error : s->least;
    return (new > (law_real)0) ? (error / new) : (law_real)0;
}

/* The estimate, between the best model and those on either side of it, and its interval. */
static void conclude(payload_state *s, const payload_params *p)
{
    const uint32_t i = s->best;
    const uint32_t inside = ((i > 0U) && (i < (PAYLOAD_MODELS - 1U))) ? 1U : 0U;
    const law_real weight = p->variance / s->offset_variance;
    /* seven models, the best one in their middle or as near to it as the bank allows */
    const uint32_t middle = (i < 3U) ? 3U : ((i > (PAYLOAD_MODELS - 4U)) ? (PAYLOAD_MODELS - 4U) : i);
    const uint32_t place = (i + 3U) - middle;
    payload_fit fit[PAYLOAD_NEAR];
    uint32_t k;
    /*@ loop unroll 7; */
    for (k = 0U; k < PAYLOAD_NEAR; k++) {
        fit[k] = fitted(s, p, (middle + k) - 3U, weight);
    }
    law_real gain = (law_real)0;
    law_real bend = (law_real)0;
    law_real at = (law_real)0;
    uint32_t found = inside;
    if (inside != 0U) {
        gain = (law_real)0.5F * (fit[place + 1U].gain - fit[place - 1U].gain);
        at = lowest(fit, (law_real)i - (law_real)middle, &bend);
    }
    const law_real share = spread(s, p, inside, gain);
    if ((sound(at, (law_real)1) == 0U) || !(bend > (law_real)0)) {
        found = 0U;
        at = (law_real)0;
    }
    s->remaining = (s->keep * s->remaining) + unexplained(s, p, at, bend);
    s->drift = fit[place].offset;
    judge(s, p);
    if ((s->flags & PAYLOAD_CHANGED) == 0U) {
        const law_real before = s->deviation;
        s->deviation = PAYLOAD_DEVIATION; /* beyond the bank */
        if (found != 0U) {
            const law_real here = p->model[i].mass;
            const law_real rise = (law_real)0.5F * (p->model[i + 1U].mass - p->model[i - 1U].mass);
            const law_real curve = (law_real)0.5F * ((p->model[i + 1U].mass - here) - (here - p->model[i - 1U].mass));
            const law_real mass = here + (at * (rise + (at * curve)));
            const law_real slope = (rise + (((law_real)2 * at) * curve)) / mass;
            /* the fit of the mass uses up one degree of freedom: one sample of the stated noise replaces it */
            const law_real noise = ((s->remaining / p->model[i].power) + p->variance) / s->samples;
            const law_real variance = ((((law_real)2 * share) * noise) / bend) * (slope * slope);
            if (variance <= (PAYLOAD_DEVIATION * PAYLOAD_DEVIATION)) {
                law_real deviation = ((before > (law_real)0) && (before <= PAYLOAD_DEVIATION)) ? before : PAYLOAD_DEVIATION;
                /* Newton's square root converges from above and is never too small; the next samples refine it. */
                deviation = (law_real)0.5F * (deviation + (variance / deviation));
                deviation = (law_real)0.5F * (deviation + (variance / deviation));
                deviation = (law_real)0.5F * (deviation + (variance / deviation));
                const law_real half = (p->width * deviation) * mass;
                s->deviation = deviation;
                s->estimate = mass - p->link;
                s->low = s->estimate - half;
                s->high = s->estimate + half;
            }
        }
    }
}

/* Update the next models; after the last one the result of the sample is complete, unless memory was damaged in it:
 * the estimator then restarts in the next period. */
static void work(payload_state *s, const payload_params *p, uint32_t models)
{
    const uint32_t frozen = s->flags & PAYLOAD_FROZEN;
    const law_real weight = p->variance / s->offset_variance;
    uint32_t i;
    /*@ loop unroll 14; */
    for (i = 0U; i < models; i++) {
        if (s->next < PAYLOAD_MODELS) {
            const payload_model *const c = &p->model[s->next];
            payload_memory *const m = &s->model[s->next];
            const law_real seen = s->torque + m->torque[0];
            const law_real told = (c->b0 * s->change) + m->angle[0];
            s->models_found += remembered(m);
            pass_on(s, c, m, seen, told);
            if (frozen != 0U) {
                stand(s, p, s->next, told);
            } else {
                look(s, p, s->next, seen - told, told, weight);
            }
            s->models_left += remembered(m);
            s->next++;
            if (s->next == PAYLOAD_MODELS) {
                if ((s->best >= PAYLOAD_MODELS) || (same(s->models_found, s->models) == 0U) ||
                    (same(lasting(s), s->sum) == 0U)) {
                    s->stamp = 0U;
                } else if (frozen == 0U) {
                    conclude(s, p);
                    s->sum = lasting(s);
                } else {
                    /* the estimate is that of the last motion */
                }
                s->models = s->models_left;
            }
        }
    }
}

/* Output the estimate, within its limits whatever the memory contains. */
static void show(payload_state *s, const payload_params *p, payload_output *out)
{
    const law_real most = (law_real)2 * p->payload_limit;
    const uint32_t known = (((s->estimate > (law_real)0) && (s->estimate <= most)) &&
                            ((s->low <= s->estimate) && (s->estimate <= s->high)))
                               ? 1U
                               : 0U;
    const uint32_t given = ((known != 0U) && (usable(s, p) != 0U)) ? 1U : 0U;
    s->flags &= ~(PAYLOAD_GIVEN | PAYLOAD_OUTSIDE);
    s->flags |= (given != 0U) ? PAYLOAD_GIVEN : 0U;
    if ((given != 0U) && ((s->high < p->certified_low) || (s->low > p->certified_high))) {
        s->flags |= PAYLOAD_OUTSIDE;
    }
    out->given = (given != 0U) ? s->estimate : (law_real)0;
    out->estimate = (known != 0U) ? s->estimate : (law_real)0;
    out->low = ((known != 0U) && (s->low > (law_real)0)) ? s->low : (law_real)0;
    out->high = (known == 0U) ? (law_real)0 : ((s->high < most) ? s->high : most);
    out->flags = s->flags;
}

/* CRC-32 of everything after the crc field, bit by bit as in law.c. */
static uint32_t table_crc(const payload_params *params)
{
    const unsigned char *bytes = (const unsigned char *)params;
    uint32_t crc = 0xFFFFFFFFU;
    uint32_t i;
    uint32_t bit;
    for (i = 16U; i < (uint32_t)sizeof(payload_params); i++) {
        crc ^= (uint32_t)bytes[i];
        for (bit = 0U; bit < 8U; bit++) {
            crc = ((crc & 1U) != 0U) ? ((crc >> 1U) ^ 0xEDB88320U) : (crc >> 1U);
        }
    }
    return crc ^ 0xFFFFFFFFU;
}

uint32_t payload_check(const payload_params *params)
{
    uint32_t reason = (params->crc == table_crc(params)) ? LAW_OK : LAW_BAD_CRC;
    if ((params->size != (uint32_t)sizeof(payload_params)) || (params->precision != (uint32_t)sizeof(law_real))) {
        reason = LAW_BAD_SIZE;
    }
    if (params->version != PAYLOAD_VERSION) {
        reason = LAW_BAD_VERSION;
    }
    return reason;
}

uint32_t payload_init(payload_state *state, const payload_params *params)
{
    know_nothing(state);
    return payload_check(params);
}

void payload_step(payload_state *s, const payload_params *p, uint32_t tick, law_real motor_angle, law_real torque,
                  payload_output *output)
{
    uint32_t periods = tick - s->tick;
    if ((s->stamp != p->crc) || ((periods != 0U) && (periods > p->gap_limit)) || (s->gap > p->gap_limit) ||
        (same(begun(s), s->means) == 0U)) {
        begin(s, p, tick, motor_angle, torque);
        periods = tick - s->tick;
    }
    if ((s->stamp == p->crc) && (periods != 0U)) {
        const law_real weight = (law_real)periods;
        s->tick = tick;
        s->flags &= ~PAYLOAD_SAMPLE;
        if ((sound(motor_angle, p->angle_limit) != 0U) && (sound(torque, p->torque_limit) != 0U)) {
            s->last_angle = motor_angle;
            s->last_torque = torque;
            s->gap = 0U;
        } else {
            s->flags |= PAYLOAD_SAMPLE;
            s->gap += periods;
        }
        s->angle_sum += weight * s->last_angle;
        s->torque_sum += weight * s->last_torque;
        s->count += periods;
        if (s->count >= p->together) {
            work(s, p, PAYLOAD_MODELS); /* part of the last sample left by missed periods */
            s->stamp = (same(lasting(s), s->sum) != 0U) ? s->stamp : 0U;
            sample(s, p);
        }
        work(s, p, p->chunk);
        s->means = begun(s);
    }
    show(s, p, output);
}
