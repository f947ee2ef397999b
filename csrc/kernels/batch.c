/* Many runs, LOOP_LANES at a time. */
#include "batch.h"

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

/* The row of `run`; a signal that is not recorded stays null. */
static loop_trace trace_of(const loop_trace *first, int64_t at)
{
    const loop_trace trace = {first->tip + at,
                              first->motor_reference + at,
                              first->voltage + at,
                              first->flags + at,
                              first->mode + at,
                              first->reason + at,
                              first->motor ? first->motor + at : 0,
                              first->motor ? first->torque + at : 0,
                              first->motor ? first->measured + at : 0,
                              first->motor ? first->tip_estimate + at : 0,
                              first->motor ? first->encoder + at : 0};
    return trace;
}

int batch_run(int64_t runs, int64_t length, const batch_links *links, const loop_rig *rig, const double *numbers,
              const uint64_t *seeds, const int32_t *chosen, const double *path, const double *faults,
              const law_port *law, const void *params, double *noise, const loop_trace *traces)
{
    int failed = 0;
    for (int64_t begin = 0; begin < runs && !failed; begin += LOOP_LANES) {
        loop_arm arms[LOOP_LANES];
        const int count = runs - begin < LOOP_LANES ? (int)(runs - begin) : LOOP_LANES;
        for (int l = 0; l < count; l++) {
            const int64_t run = begin + l;
            const double *const row = numbers + run * BATCH_COLUMNS;
            const double *const unit = path + (int64_t)chosen[run] * 2 * length;
            double *const normal = noise + l * length;
            const loop_arm arm = {link_of(links, run, row[BATCH_STIFFNESS]),
                                  rig_of(rig, row),
                                  row[BATCH_AMPLITUDE],
                                  unit,
                                  unit + length,
                                  normal,
                                  faults,
                                  trace_of(traces, run * length)};
            if (arm.rig.noise > 0.0)
                loop_normals(seeds[run], normal, length);
            arms[l] = arm;
        }
        failed = loop_run(arms, count, law, params, length);
    }
    return failed;
}
