#include "twin.h"

#include <math.h>
#include <string.h>

#include "clones.h"

/* y = transition x, by columns: every product goes into its own row, so that nothing is summed across a
 * vector and the result does not depend on the vector's length. Four columns at a time keep y in registers
 * for four products per load. */
FRACLINK_CLONES
static void advance(const twin_step *step, const double *restrict x, double *restrict y)
{
    const int stride = step->stride;
    const double *restrict column = step->transition;
    for (int i = 0; i < stride; ++i) {
        y[i] = 0.0;
    }
    int j = 0;
    for (; j + 4 <= step->states; j += 4, column += 4 * stride) {
        const double a = x[j], b = x[j + 1], c = x[j + 2], d = x[j + 3];
#pragma omp simd
        for (int i = 0; i < stride; ++i) {
            y[i] += (column[i] * a + column[stride + i] * b) +
                    (column[2 * stride + i] * c + column[3 * stride + i] * d);
        }
    }
    for (; j < step->states; ++j, column += stride) {
        const double a = x[j];
#pragma omp simd
        for (int i = 0; i < stride; ++i) {
            y[i] += column[i] * a;
        }
    }
}

static void add(int count, double factor, const double *restrict vector, double *restrict y)
{
#pragma omp simd
    for (int i = 0; i < count; ++i) {
        y[i] += factor * vector[i];
    }
}

/* Eight partial sums in a fixed order: vectorised, and the same on every machine. */
static double output(const twin_step *step, int row, const double *restrict x)
{
    const double *restrict weights = step->outputs + (long)row * step->stride;
    double part[8] = {0.0};
    for (int i = 0; i < step->stride; i += 8) {
#pragma omp simd
        for (int k = 0; k < 8; ++k) {
            part[k] += weights[i + k] * x[i + k];
        }
    }
    return ((part[0] + part[1]) + (part[2] + part[3])) + ((part[4] + part[5]) + (part[6] + part[7]));
}

void twin_march(const twin_step *step, int periods, int substeps, const double *input, double *state,
                double *scratch, double *out)
{
    for (int k = 0; k < periods; ++k) {
        for (int j = 0; j < substeps; ++j) {
            advance(step, state, scratch);
            add(step->stride, input[k], step->hub, scratch);
            memcpy(state, scratch, sizeof(double) * (size_t)step->stride);
            for (int row = 0; row < TWIN_OUTPUTS; ++row) {
                *out++ = output(step, row, state);
            }
        }
    }
}

static double quantised(double value, double quantum)
{
    return quantum > 0.0 ? floor(value / quantum + 0.5) * quantum : value;
}

static double clamped(double value, double limit)
{
    return value > limit ? limit : (value < -limit ? -limit : value);
}

void twin_sense(const twin_rig *rig, twin_memory *memory, const double *input, double *angle, double *torque)
{
    const int faults = (int)input[TWIN_FAULTS];
    double a = quantised(input[TWIN_ENCODER_GAIN] * memory->state[0] + input[TWIN_ENCODER_ERROR], rig->angle_quantum);
    double g = input[TWIN_GAUGE_GAIN] * memory->gauge[0] + input[TWIN_GAUGE_ERROR];
    g = quantised(clamped(g, rig->gauge_limit), rig->gauge_quantum);
    if (faults != 0) {
        a = (faults & TWIN_ENCODER_FROZEN) ? memory->angle : a;
        g = (faults & TWIN_GAUGE_FROZEN) ? memory->torque : g;
        a = (faults & TWIN_ENCODER_REPLACED) ? input[TWIN_ENCODER_VALUE] : a;
        g = (faults & TWIN_GAUGE_REPLACED) ? input[TWIN_GAUGE_VALUE] : g;
        if (faults & TWIN_SWAPPED) {
            const double swap = a;
            a = g;
            g = swap;
        }
    }
    memory->angle = *angle = a;
    memory->torque = *torque = g;
}

/* Push of the obstacle on the tip [N]: never a pull, whatever the damping says. */
static double contact(const twin_step *step, const twin_obstacle *obstacle, const double *state)
{
    if (!(obstacle->stiffness > 0.0)) {
        return 0.0;
    }
    const double depth = obstacle->side * obstacle->length * (output(step, 2, state) - obstacle->angle);
    if (depth <= 0.0) {
        return 0.0;
    }
    const double speed = obstacle->side * obstacle->length * output(step, 4, state);
    const double push = obstacle->stiffness * depth + obstacle->damping * speed;
    return push > 0.0 ? -obstacle->side * push : 0.0;
}

/* One step of motor and link. Friction is a constant torque over the step, the one that brings the hub to
 * rest at its end where friction can do that (it is stuck then), else the sliding friction against the
 * motion: exact stiction without a velocity threshold, and friction that can never push. */
static void motor_step(const twin_step *step, const twin_rig *rig, double torque, double force,
                       twin_memory *memory)
{
    double *restrict next = memory->scratch;
    advance(step, memory->state, next);
    add(step->stride, torque, step->hub, next);
    if (force != 0.0) {
        add(step->stride, force, step->tip, next);
    }
    const double stopping = next[1] / step->hub[1];
    const double available = memory->stuck ? rig->stiction : rig->coulomb;
    memory->stuck = fabs(stopping) <= available && available > 0.0;
    const double friction = memory->stuck ? stopping : copysign(rig->coulomb, stopping);
    add(step->stride, -friction, step->hub, next);
    memcpy(memory->state, next, sizeof(double) * (size_t)step->stride);
    if (memory->stuck) {
        memory->state[1] = 0.0; /* rounding of the line above would count as a crawl */
    }
    memmove(memory->gauge, memory->gauge + 1, sizeof(double) * (size_t)rig->gauge_delay);
    memory->gauge[rig->gauge_delay] = output(step, 3, memory->state);
}

/* The law's answer of one period, and the voltage that acts: `voltage_delay` periods late, within the limit. */
static double control(const twin_rig *rig, const law_params *params, const double *input, law_state *law,
                      twin_memory *memory, double *record)
{
    const int faults = (int)input[TWIN_FAULTS];
    law_input given;
    law_output answer;
    double angle, torque;
    twin_sense(rig, memory, input, &angle, &torque);
    given.tick = memory->tick;
    given.reference = (law_real)input[TWIN_REFERENCE];
    given.reference_acceleration = (law_real)input[TWIN_ACCELERATION];
    given.motor_angle = (law_real)angle;
    given.torque = (law_real)torque;
    memory->tick++;

    double *queue = memory->voltage;
    const int last = rig->voltage_delay;
    if (faults & TWIN_TICK_MISSED) {
        /* The timer's hardware goes on with the voltage it was given last. */
        answer = (law_output){0};
        answer.motor_reference = law->motor_reference;
        answer.voltage = queue[last];
        answer.mode = law->mode;
        answer.reason = law->reason;
    } else {
        law_step(law, params, &given, &answer);
        if (faults & TWIN_TICK_REPEATED) {
            law_step(law, params, &given, &answer);
        }
    }
    queue[last] = answer.voltage;
    const double voltage = clamped(queue[0], rig->voltage_limit);
    memmove(queue, queue + 1, sizeof(double) * (size_t)last);

    record[TWIN_OUT_REFERENCE] = input[TWIN_REFERENCE];
    record[TWIN_OUT_ENCODER] = angle;
    record[TWIN_OUT_GAUGE] = torque;
    record[TWIN_OUT_MOTOR_REFERENCE] = answer.motor_reference;
    record[TWIN_OUT_VOLTAGE] = voltage;
    record[TWIN_OUT_ASKED] = answer.voltage;
    record[TWIN_OUT_MODE] = answer.mode;
    record[TWIN_OUT_REASON] = answer.reason;
    record[TWIN_OUT_FLAGS] = answer.flags;
    return voltage;
}

int twin_run(const twin_step *step, const twin_rig *rig, const twin_obstacle *obstacle, const law_params *params,
             int periods, const double *input, law_state *law, twin_memory *memory, double *record)
{
    for (int k = 0; k < periods; ++k, input += TWIN_INPUTS, record += TWIN_COLUMNS) {
        double largest = 0.0;
        record[TWIN_OUT_MOTOR_ANGLE] = memory->state[0];
        record[TWIN_OUT_MOTOR_VELOCITY] = memory->state[1];
        record[TWIN_OUT_TIP_ANGLE] = output(step, 2, memory->state);
        record[TWIN_OUT_TORQUE] = output(step, 3, memory->state);
        const double torque = rig->torque_per_volt * control(rig, params, input, law, memory, record);
        for (int j = 0; j < rig->substeps; ++j) {
            const double push = contact(step, obstacle, memory->state);
            largest = fabs(push) > largest ? fabs(push) : largest;
            motor_step(step, rig, torque, push + input[TWIN_TIP_FORCE], memory);
        }
        record[TWIN_OUT_CONTACT] = largest;
        if (!(fabs(memory->state[0]) < 1e6)) {
            return k + 1; /* diverged: the numbers behind it would be infinite */
        }
    }
    return periods;
}
