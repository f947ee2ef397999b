/* The closed loop for a page: law.c, the loop and the twin as the package has them, and the calls that a script needs
 * around them.
 *
 * A script writes the numbers of an arm into the buffers below, calls `run` or `run_twin`, and reads the signals.
 * Everything that needs a mathematics library (weights of link and motor, modes of a beam, noise) was computed by the
 * package and is written with it, so that the run has the package's bits. Built by tools/build_engine.py. */
#include <stddef.h>
#include <string.h>

#include "law.h"
#include "loop.h"
#include "twin.h"

#define LONGEST 4001   /* periods: 4 s at 1 ms */
#define MOST_BLOCK 256 /* words of eight bytes; law_params takes 176 of them in double precision */
#define MOST_STATES 96 /* of the twin and its two inputs, a multiple of 8; two modes of a fractional link take 56 */
#define MOST_GAUGE 1024 /* steps that the twin's gauge may be late */
#define EXPORT(name) __attribute__((export_name(#name))) name

/* A script fills both rigs as three whole numbers and, from byte 16 on, the doubles behind them. */
_Static_assert(offsetof(loop_rig, period) == 16 && offsetof(loop_rig, estimator) == 16 + 17 * 8, "as the script fills it");
_Static_assert(offsetof(twin_rig, torque_per_volt) == 16 && sizeof(twin_rig) == 16 + 12 * 8, "as the script fills it");

/* The link as doubles behind one another: stiffness, first (6), second mode (15), then decay, weight, pair and its
 * weights, as long as its counts of modes make them. */
#define LINK_FIRST 1
#define LINK_SECOND (LINK_FIRST + LOOP_POWERS)
#define LINK_HEAD (LINK_SECOND + LOOP_SECOND)
#define LINK_NUMBERS (LINK_HEAD + (LOOP_POWERS + 1) * LOOP_MODES + 2 * (LOOP_POWERS + 1) * LOOP_MODES)

static double block_words[MOST_BLOCK];
static loop_rig rig_of_model;
static twin_rig rig_of_twin;
static double link_numbers[LINK_NUMBERS];
static double paths[3][LONGEST]; /* reference, its acceleration, standard normal numbers */
static double fault_numbers[LONGEST * TWIN_INPUTS];
static double signals[8][LONGEST];
static uint32_t marks[3][LONGEST];
static double matrix_numbers[MOST_STATES * MOST_STATES]; /* of x' = A x + B u times the step; then its exponential */
static double output_numbers[TWIN_OUTPUTS * MOST_STATES];
static double record[LONGEST * TWIN_COLUMNS];
static double work[2 * MOST_STATES * MOST_STATES];

double *EXPORT(block)(void) { return block_words; }
loop_rig *EXPORT(rig)(void) { return &rig_of_model; }
twin_rig *EXPORT(twin)(void) { return &rig_of_twin; }
double *EXPORT(link)(void) { return link_numbers; }
double *EXPORT(path)(int row) { return paths[row]; }
double *EXPORT(faults)(void) { return fault_numbers; }
double *EXPORT(signal)(int row) { return signals[row]; }
uint32_t *EXPORT(mark)(int row) { return marks[row]; }
double *EXPORT(matrix)(void) { return matrix_numbers; }
double *EXPORT(outputs)(void) { return output_numbers; }

/* Run the buffers' arm for `length` periods. Signals: tip, motor, motor reference, torque, measured torque, voltage,
 * tip estimate, measured angle; marks: flags, mode, reason. Return 0, or 1 where a bound is exceeded. */
int EXPORT(run)(int single, int reals, int pairs, int second, int broken, int length)
{
    if (length < 0 || length > LONGEST || reals < 0 || pairs < 0 || reals > LOOP_MODES || pairs > LOOP_MODES)
        return 1;
    const double *const decay = link_numbers + LINK_HEAD;
    const double *const weight = decay + reals;
    const cx *const pair = (const cx *)(weight + LOOP_POWERS * reals);
    loop_arm arm = {
        .link = {reals, pairs, decay, weight, pair, pair + pairs, {0}, link_numbers[0],
                 second ? link_numbers + LINK_SECOND : 0},
        .rig = rig_of_model,
        .amplitude = 1.0,
        .reference = paths[0],
        .acceleration = paths[1],
        .normal = paths[2],
        .faults = broken ? fault_numbers : 0,
        .signal = {signals[0], signals[2], signals[5], signals[1], signals[3], signals[4], signals[6], signals[7]},
        .mark = {marks[0], marks[1], marks[2]}};
    memcpy(arm.link.first, link_numbers + LINK_FIRST, sizeof arm.link.first);
    return loop_run(&arm, 1, single ? &LAW_IN_SINGLE : &LAW_IN_DOUBLE, block_words, length);
}

/* Replace the twin's matrix of `size` rows, its states and two inputs, by its exponential. Return 0, or 1 where it is
 * too large. */
int EXPORT(discretise)(int size)
{
    if (size < 0 || size > MOST_STATES)
        return 1;
    twin_exponential(size, matrix_numbers, work);
    return 0;
}

/* Run the twin, the exponential of whose `size` rows is in the matrix, from rest for `length` periods under the rows of
 * `faults`. Signals and marks as above; after the period in which the arm leaves every bound they stay as they are.
 * Return 0, or 1 where a bound is exceeded. */
int EXPORT(run_twin)(int single, int size, int length)
{
    static const uint8_t columns[] = {TWIN_OUT_TIP_ANGLE, TWIN_OUT_MOTOR_ANGLE,  TWIN_OUT_MOTOR_REFERENCE, TWIN_OUT_TORQUE,
                                      TWIN_OUT_GAUGE,     TWIN_OUT_VOLTAGE,      TWIN_OUT_TIP_ESTIMATE,    TWIN_OUT_ENCODER,
                                      TWIN_OUT_FLAGS,     TWIN_OUT_MODE,         TWIN_OUT_REASON};
    static struct {
        double state[MOST_STATES], scratch[MOST_STATES], hub[MOST_STATES], tip[MOST_STATES];
        double gauge[MOST_GAUGE], voltage[LOOP_DELAY];
        law_state law; /* room for that of either precision: this is the larger one */
    } arm;
    const int states = size - 2, stride = (states + 7) & ~7;
    const twin_step step = {states, stride, work, arm.hub, arm.tip, output_numbers};
    const law_port *const port = single ? &LAW_IN_SINGLE : &LAW_IN_DOUBLE;
    const twin_law law = {port, block_words, &arm.law, 0, 0};
    const twin_obstacle nothing = {0.0, 0.0, 0.0, 0.0, 0.0};
    twin_memory memory = {arm.state, arm.gauge, arm.voltage, arm.scratch, 0.0, 0.0, 1, 1U};
    if (length < 1 || length > LONGEST || states < 2 || size > MOST_STATES || rig_of_twin.gauge_delay >= MOST_GAUGE ||
        rig_of_twin.voltage_delay >= LOOP_DELAY)
        return 1;
    memset(&arm, 0, sizeof arm);
    memset(work, 0, sizeof work);
    for (int i = 0; i < states; i++) {
        const double *const row = matrix_numbers + i * size;
        for (int j = 0; j < states; j++)
            work[j * stride + i] = row[j];
        arm.hub[i] = row[states];
        arm.tip[i] = row[states + 1];
    }
    (void)port->begin(&arm.law, block_words);
    const int done = twin_run(&step, &rig_of_twin, &nothing, &law, length, fault_numbers, &memory, record);
    for (int k = 0; k < length; k++) {
        const double *const row = record + TWIN_COLUMNS * (k < done ? k : done - 1);
        for (int i = 0; i < 8; i++)
            signals[i][k] = row[columns[i]];
        for (int i = 0; i < 3; i++)
            marks[i][k] = (uint32_t)row[columns[8 + i]];
    }
    return 0;
}
