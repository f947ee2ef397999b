/* Run after run through loop.c, so that a run of a campaign and the same run alone agree to the last bit. */
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
                      stiffness};
    for (int j = 0; j < LOOP_POWERS; j++)
        link.first[j] = all->first[run * LOOP_POWERS + j];
    return link;
}

static loop_rig rig_of(const loop_rig *shared, const double *row, uint64_t seed)
{
    loop_rig rig = *shared;
    rig.gain = row[BATCH_GAIN];
    rig.decay = row[BATCH_DECAY];
    rig.friction = row[BATCH_FRICTION];
    rig.offset = row[BATCH_OFFSET];
    rig.noise = row[BATCH_NOISE];
    rig.delay = (int)row[BATCH_DELAY];
    rig.seed = seed;
    return rig;
}

int batch_run(int64_t runs, int64_t length, const batch_links *links, const loop_rig *rig, const double *numbers,
              const uint64_t *seeds, const int32_t *chosen, const double *path, const void *params, int single,
              double *scratch, const batch_traces *traces)
{
    double *const angle = scratch;
    double *const acceleration = scratch + length;
    double *const spare = scratch + 2 * length;
    for (int64_t r = 0; r < runs; r++) {
        const double *row = numbers + r * BATCH_COLUMNS;
        const double *unit = path + (int64_t)chosen[r] * 2 * length;
        const loop_link link = link_of(links, r, row[BATCH_STIFFNESS]);
        const loop_rig own = rig_of(rig, row, seeds[r]);
        const int64_t at = r * length;
        for (int64_t k = 0; k < length; k++) {
            angle[k] = row[BATCH_AMPLITUDE] * unit[k];
            acceleration[k] = row[BATCH_AMPLITUDE] * unit[length + k];
        }
        const loop_reference reference = {length, angle, acceleration};
        const loop_trace trace = {traces->tip + at,     spare,
                                  traces->motor_reference + at, spare + length,
                                  spare + 2 * length,   traces->voltage + at,
                                  spare + 3 * length,   traces->flags + at,
                                  traces->mode + at,    traces->reason + at};
        const int failed = single ? loop_run_single(&link, &own, params, &reference, &trace)
                                  : loop_run_double(&link, &own, params, &reference, &trace);
        if (failed)
            return 1;
    }
    return 0;
}
