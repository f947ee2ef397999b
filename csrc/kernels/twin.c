#include "twin.h"

#include <math.h>
#include <string.h>

#include "clones.h"

#define ROWS 8 /* of a block: the stride is a multiple of it */

/* Over the rows of a block. Clang, which compiles the page's engine for size, keeps their sums in memory unless it is told
 * to unroll the loop. */
#ifdef __clang__
#define FRACLINK_ROWS _Pragma("clang loop unroll(full)")
#else
#define FRACLINK_ROWS _Pragma("omp simd")
#endif

/* y = transition x by blocks of rows, whose sums stay in registers over all columns. Every product goes into its own row,
 * four columns at a time in one order, so that nothing is summed across a vector and the result depends neither on the
 * vector's length nor on the block's. */
FRACLINK_CLONES
static void advance(const twin_step *step, const double *restrict x, double *restrict y)
{
    const int stride = step->stride;
    for (int row = 0; row < stride; row += ROWS) {
        const double *restrict column = step->transition + row;
        double sum[ROWS] = {0.0};
        int j = 0;
        for (; j + 4 <= step->states; j += 4, column += 4 * stride) {
            const double a = x[j], b = x[j + 1], c = x[j + 2], d = x[j + 3];
            FRACLINK_ROWS
            for (int i = 0; i < ROWS; ++i) {
                sum[i] += (column[i] * a + column[stride + i] * b) +
                          (column[2 * stride + i] * c + column[3 * stride + i] * d);
            }
        }
        for (; j < step->states; ++j, column += stride) {
            FRACLINK_ROWS
            for (int i = 0; i < ROWS; ++i) {
                sum[i] += column[i] * x[j];
            }
        }
        FRACLINK_ROWS
        for (int i = 0; i < ROWS; ++i) {
            y[row + i] = sum[i];
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
double twin_output(const twin_step *step, int row, const double *restrict x)
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

/* c += a b by rows; the zeros of `a`, most of an arm's matrix, cost nothing. */
FRACLINK_CLONES
static void add_product(int size, const double *restrict a, const double *restrict b, double *restrict c)
{
    for (int i = 0; i < size; ++i, a += size, c += size) {
        for (int k = 0; k < size; ++k) {
            const double factor = a[k];
            if (factor == 0.0) {
                continue;
            }
#pragma omp simd
            for (int j = 0; j < size; ++j) {
                c[j] += factor * b[(long)k * size + j];
            }
        }
    }
}

/* e^A - I of A/2^s by Taylor's series, then s times M <- 2 M + M M: without the identity in it, halving a matrix more
 * often than its spectrum needs (its norm contains the squared frequencies of the modes) costs no digits. */
void twin_exponential(int size, double *matrix, double *work)
{
    const int count = size * size, terms = 12; /* 0.25^12/13! of the matrix: 1e-17 */
    double *const sum = work, *const next = work + count;
    double norm = 0.0, scale = 1.0;
    int halved = 0;
    for (int i = 0; i < count; i += size) {
        double row = 0.0;
        for (int j = 0; j < size; ++j) {
            row += fabs(matrix[i + j]);
        }
        norm = row > norm ? row : norm;
    }
    for (; norm * scale > 0.25 && halved < 64; ++halved) {
        scale *= 0.5;
    }
    for (int i = 0; i < count; ++i) {
        matrix[i] *= scale;
        sum[i] = 0.0;
    }
    for (int round = 0; round < terms + halved; ++round) {
        const int series = round < terms;
        const double *const left = series ? matrix : sum;
        for (int i = 0; i < count; ++i) {
            next[i] = series ? left[i] : 2.0 * left[i];
        }
        add_product(size, left, sum, next);
        for (int i = 0; i < count; ++i) {
            sum[i] = series ? next[i] / (terms - round) : next[i];
        }
    }
    for (int i = 0; i < count; ++i) {
        matrix[i] = sum[i] + (i % (size + 1) ? 0.0 : 1.0);
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

/* The torque as old as the strain amplifier's delay; between two steps the cubic through the four around it. */
static double delayed_torque(const twin_rig *rig, const double *gauge)
{
    const double *w = rig->gauge_weight;
    return w[0] == 1.0 ? gauge[0] : (w[0] * gauge[0] + w[1] * gauge[1]) + (w[2] * gauge[2] + w[3] * gauge[3]);
}

void twin_sense(const twin_rig *rig, twin_memory *memory, const double *input, double *angle, double *torque)
{
    double a = quantised(input[TWIN_ENCODER_GAIN] * memory->state[0] + input[TWIN_ENCODER_ERROR], rig->angle_quantum);
    double g = input[TWIN_GAUGE_GAIN] * rig->gauge_gain * delayed_torque(rig, memory->gauge) + input[TWIN_GAUGE_ERROR];
    g = quantised(clamped(g, rig->gauge_limit), rig->gauge_quantum);
    twin_break(input, memory->angle, memory->torque, &a, &g);
    memory->angle = *angle = a;
    memory->torque = *torque = g;
}

double twin_contact(const twin_step *step, const twin_obstacle *obstacle, const double *state)
{
    if (!(obstacle->stiffness > 0.0)) {
        return 0.0;
    }
    const double depth = obstacle->side * obstacle->length * (twin_output(step, 2, state) - obstacle->angle);
    if (depth <= 0.0) {
        return 0.0;
    }
    const double speed = obstacle->side * obstacle->length * twin_output(step, 4, state);
    const double push = obstacle->stiffness * depth + obstacle->damping * speed;
    return push > 0.0 ? -obstacle->side * push : 0.0;
}

/* One step of motor and link. Friction is a constant torque over the step, the one that brings the hub to
 * rest at its end if friction can do that (it is stuck then), else the sliding friction against the
 * motion: exact stiction without a velocity threshold, and friction that can never push. */
void twin_motor_step(const twin_step *step, const twin_rig *rig, double torque, double force, twin_memory *memory)
{
    double *restrict next = memory->scratch, *restrict state = memory->state;
    advance(step, state, next);
    add(step->stride, torque, step->hub, next);
    if (force != 0.0) {
        add(step->stride, force, step->tip, next);
    }
    const double stopping = next[1] / step->hub[1];
    const double available = memory->stuck ? rig->stiction : rig->coulomb;
    memory->stuck = fabs(stopping) <= available && available > 0.0;
    const double friction = memory->stuck ? stopping : copysign(rig->coulomb, stopping);
#pragma omp simd
    for (int i = 0; i < step->stride; ++i) {
        state[i] = next[i] - friction * step->hub[i];
    }
    if (memory->stuck) {
        state[1] = 0.0; /* rounding of the line above would count as a crawl */
    }
    memmove(memory->gauge, memory->gauge + 1, sizeof(double) * (size_t)rig->gauge_delay);
    memory->gauge[rig->gauge_delay] = twin_output(step, 3, memory->state);
}

double twin_voltage(const twin_rig *rig, twin_memory *memory, double asked)
{
    double *const queue = memory->voltage;
    queue[rig->voltage_delay] = asked;
    const double voltage = fmax(fmin(queue[0], rig->voltage_limit), -rig->voltage_limit);
    memmove(queue, queue + 1, sizeof(double) * (size_t)rig->voltage_delay);
    return voltage;
}

void twin_drive(const twin_step *step, const twin_rig *rig, twin_memory *memory, double asked, double *row)
{
    const double voltage = twin_voltage(rig, memory, isfinite(asked) ? asked : 0.0);
    row[TWIN_DRIVEN_TIP_ANGLE] = twin_output(step, 2, memory->state);
    row[TWIN_DRIVEN_MOTOR_ANGLE] = memory->state[0];
    row[TWIN_DRIVEN_MOTOR_VELOCITY] = memory->state[1];
    row[TWIN_DRIVEN_TORQUE] = twin_output(step, 3, memory->state);
    row[TWIN_DRIVEN_VOLTAGE] = voltage;
    for (int j = 0; j < rig->substeps; ++j) {
        twin_motor_step(step, rig, rig->torque_per_volt * voltage, 0.0, memory);
    }
}
