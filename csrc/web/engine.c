/* The closed loop for a page: law.c and loop.c as the package has them, and the calls that a script needs around them.
 *
 * A script writes the numbers of an arm into the buffers below, calls `run`, and reads the signals. Everything that
 * takes a library of mathematics (weights of link and motor, noise) was computed by the package and is written with
 * it, so that the run has the package's bits. Built by tools/build_engine.py. */
#include "law.h"
#include "loop.h"
#include "twin.h"

#define LONGEST 4001  /* periods: 4 s at 1 ms */
#define MOST_BLOCK 256 /* words of eight bytes; law_params takes 176 of them in double precision */
#define EXPORT(name) __attribute__((export_name(#name))) name

/* loop_rig and the link's stiffness as numbers, in the order in which a script writes them. */
enum {
    RIG_SAMPLED,
    RIG_SUBSTEPS,
    RIG_DELAY,
    RIG_PERIOD,
    RIG_POLE,
    RIG_GAIN,
    RIG_DECAY,
    RIG_FRICTION,
    RIG_COUPLING,
    RIG_ENCODER,
    RIG_OFFSET,
    RIG_NOISE,
    RIG_LIMIT,
    RIG_QUANTUM,
    RIG_GAUGE_DELAY,
    RIG_GAUGE_GAIN,
    RIG_PAYLOAD,
    RIG_START,
    RIG_KEEP,
    RIG_FIRST,
    RIG_SECOND,
    RIG_STIFFNESS,
    RIG_NUMBERS
};

/* The link as doubles behind one another: first (6), second mode (15), then decay, weight, pair and its weights, as
 * long as its counts of modes make them. */
#define LINK_HEAD (LOOP_POWERS + LOOP_SECOND)
#define LINK_NUMBERS (LINK_HEAD + (LOOP_POWERS + 1) * LOOP_MODES + 2 * (LOOP_POWERS + 1) * LOOP_MODES)

static double block_words[MOST_BLOCK];
static double rig_numbers[RIG_NUMBERS];
static double link_numbers[LINK_NUMBERS];
static double paths[3][LONGEST]; /* reference, its acceleration, standard normal numbers */
static double fault_numbers[LONGEST * TWIN_INPUTS];
static double signals[8][LONGEST];
static uint32_t marks[3][LONGEST];

double *EXPORT(block)(void) { return block_words; }
double *EXPORT(rig)(void) { return rig_numbers; }
double *EXPORT(link)(void) { return link_numbers; }
double *EXPORT(path)(int row) { return paths[row]; }
double *EXPORT(faults)(void) { return fault_numbers; }
double *EXPORT(signal)(int row) { return signals[row]; }
uint32_t *EXPORT(mark)(int row) { return marks[row]; }
int EXPORT(longest)(void) { return LONGEST; }

static loop_rig rig_of(const double *n)
{
    const loop_rig rig = {(int)n[RIG_SAMPLED],
                          (int)n[RIG_SUBSTEPS],
                          (int)n[RIG_DELAY],
                          n[RIG_PERIOD],
                          n[RIG_POLE],
                          n[RIG_GAIN],
                          n[RIG_DECAY],
                          n[RIG_FRICTION],
                          n[RIG_COUPLING],
                          n[RIG_ENCODER],
                          n[RIG_OFFSET],
                          n[RIG_NOISE],
                          n[RIG_LIMIT],
                          n[RIG_QUANTUM],
                          n[RIG_GAUGE_DELAY],
                          n[RIG_GAUGE_GAIN],
                          n[RIG_PAYLOAD],
                          n[RIG_START],
                          {n[RIG_KEEP], n[RIG_FIRST], n[RIG_SECOND]},
                          0};
    return rig;
}

static loop_link link_of(int reals, int pairs, int second, double stiffness)
{
    const double *const decay = link_numbers + LINK_HEAD;
    const double *const weight = decay + reals;
    const double *const pair = weight + LOOP_POWERS * reals;
    const double *const pair_weight = pair + 2 * pairs;
    loop_link link = {reals,
                      pairs,
                      decay,
                      weight,
                      pair,
                      pair + pairs,
                      pair_weight,
                      pair_weight + LOOP_POWERS * pairs,
                      {0},
                      stiffness,
                      second ? link_numbers + LOOP_POWERS : 0};
    for (int i = 0; i < LOOP_POWERS; i++)
        link.first[i] = link_numbers[i];
    return link;
}

/* Run the buffers' arm for `length` periods. Signals: tip, motor, motor reference, torque, measured torque, voltage,
 * tip estimate, measured angle; marks: flags, mode, reason. Return 0, or 1 where a bound is exceeded. */
int EXPORT(run)(int single, int reals, int pairs, int second, int broken, int length)
{
    if (length < 0 || length > LONGEST || reals < 0 || pairs < 0 || reals > LOOP_MODES || pairs > LOOP_MODES)
        return 1;
    const loop_rig rig = rig_of(rig_numbers);
    const loop_link link = link_of(reals, pairs, second, rig_numbers[RIG_STIFFNESS]);
    const loop_input input = {length, paths[0], paths[1], paths[2], broken ? fault_numbers : 0};
    const loop_trace trace = {signals[0], signals[1], signals[2], signals[3], signals[4], signals[5],
                              signals[6], signals[7], marks[0],   marks[1],   marks[2]};
    return single ? loop_run_single(&link, &rig, block_words, &input, &trace)
                  : loop_run_double(&link, &rig, block_words, &input, &trace);
}

/* What a compiler may call for structs that it copies or clears. */
void *memcpy(void *to, const void *from, __SIZE_TYPE__ count)
{
    char *t = to;
    const char *f = from;
    while (count--)
        *t++ = *f++;
    return to;
}

void *memset(void *to, int value, __SIZE_TYPE__ count)
{
    char *t = to;
    while (count--)
        *t++ = (char)value;
    return to;
}
