/* Eight runs at a time through group.c, the rest, and runs with all their signals, one by one through loop.c: both give
 * the same bits. */
#include "batch.h"

#include "group.h"

static loop_link link_of(const batch_links *all, int64_t run, double stiffness)
{
    const int64_t n = all->reals;
    const int64_t m = all->pairs;
    loop_link link = {all->reals,
                      all->pairs,
                      all->decay + run * n,
                      all->weight + run * n * LOOP_POWERS,
                      all->pair_re + run * m,
                      all->pair_im + run * m,
                      all->weight_re + run * m * LOOP_POWERS,
                      all->weight_im + run * m * LOOP_POWERS,
                      {0},
                      stiffness,
                      all->second ? all->second + run * LOOP_SECOND : 0};
    for (int j = 0; j < LOOP_POWERS; j++)
        link.first[j] = all->first[run * LOOP_POWERS + j];
    return link;
}

static loop_rig rig_of(const loop_rig *shared, const double *row)
{
    loop_rig rig = *shared;
    rig.gain = row[BATCH_GAIN];
    rig.decay = row[BATCH_DECAY];
    rig.friction = row[BATCH_FRICTION];
    rig.offset = row[BATCH_OFFSET];
    rig.noise = row[BATCH_NOISE];
    rig.delay = (int)row[BATCH_DELAY];
    rig.gauge_delay = row[BATCH_GAUGE_DELAY];
    rig.gauge_gain = row[BATCH_GAUGE_GAIN];
    rig.payload = row[BATCH_PAYLOAD];
    rig.weights = loop_weights_of(&rig);
    return rig;
}

typedef struct {
    const batch_links *links;
    const loop_rig *rig;
    const double *numbers;
    const uint64_t *seeds;
    const int32_t *chosen;
    const double *path;
    const double *faults;
    int64_t length;
    const batch_traces *traces;
} batch;

static group_loop loop_of(const batch *b, int64_t r, double *noise)
{
    const double *row = b->numbers + r * BATCH_COLUMNS;
    const double *unit = b->path + (int64_t)b->chosen[r] * 2 * b->length;
    const int64_t at = r * b->length;
    const group_loop loop = {link_of(b->links, r, row[BATCH_STIFFNESS]),
                             rig_of(b->rig, row),
                             row[BATCH_AMPLITUDE],
                             unit,
                             unit + b->length,
                             noise,
                             {b->traces->tip + at, b->traces->motor_reference + at, b->traces->voltage + at,
                              b->traces->flags + at, b->traces->mode + at, b->traces->reason + at}};
    return loop;
}

/* A run by itself: one whose signals are all kept, or the rest of a block that is too small for a group. */
static int run_alone(const batch *b, int64_t r, const void *params, int single, double *scratch)
{
    const group_loop loop = loop_of(b, r, scratch);
    const batch_traces *all = b->traces;
    const int64_t n = b->length;
    double *const angle = scratch;
    double *const acceleration = scratch + n;
    double *const spare = scratch + 2 * n;
    double *const normal = scratch + 7 * n;
    if (loop.rig.noise > 0.0)
        loop_normals(b->seeds[r], normal, n);
    for (int64_t k = 0; k < n; k++) {
        angle[k] = loop.amplitude * loop.angle[k];
        acceleration[k] = loop.amplitude * loop.acceleration[k];
    }
    const int kept = all->motor != 0;
    const loop_input input = {n, angle, acceleration, normal, b->faults};
    const loop_trace trace = {loop.trace.tip,
                              kept ? all->motor + r * n : spare,
                              loop.trace.motor_reference,
                              kept ? all->torque + r * n : spare + n,
                              kept ? all->measured + r * n : spare + 2 * n,
                              loop.trace.voltage,
                              kept ? all->tip_estimate + r * n : spare + 3 * n,
                              kept ? all->encoder + r * n : spare + 4 * n,
                              loop.trace.flags,
                              loop.trace.mode,
                              loop.trace.reason};
    return loop_run(&loop.link, &loop.rig, single ? &LAW_IN_SINGLE : &LAW_IN_DOUBLE, params, &input, &trace);
}

int batch_run(int64_t runs, int64_t length, const batch_links *links, const loop_rig *rig, const double *numbers,
              const uint64_t *seeds, const int32_t *chosen, const double *path, const double *faults,
              const void *params, int single, double *scratch, const batch_traces *traces)
{
    const batch all = {links, rig, numbers, seeds, chosen, path, faults, length, traces};
    int failed = 0;
    int64_t r = 0;
    for (; !traces->motor && !faults && r + GROUP_LANES <= runs && !failed; r += GROUP_LANES) {
        group_loop group[GROUP_LANES];
        for (int l = 0; l < GROUP_LANES; l++) {
            double *noise = scratch + l * length;
            group[l] = loop_of(&all, r + l, noise);
            if (group[l].rig.noise > 0.0)
                loop_normals(seeds[r + l], noise, length);
        }
        failed = single ? group_run_single(group, params, length) : group_run_double(group, params, length);
    }
    for (; r < runs && !failed; r++)
        failed = run_alone(&all, r, params, single, scratch);
    return failed;
}
