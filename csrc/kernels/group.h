/* Eight closed loops in step, bit for bit what loop_run gives for each of them.
 *
 * One loop alone waits: each friction substep needs the speed of the one before. Eight loops side by side fill that
 * time, since their motors move in the lanes of one vector. Sums over lanes there are none, so the width of the
 * machine's vectors changes nothing. */
#ifndef FRACLINK_GROUP_H
#define FRACLINK_GROUP_H

#include "loop.h"

#define GROUP_LANES 8

/* One row of `length` per loop. */
typedef struct {
    double *tip;
    double *motor_reference;
    double *voltage;
    uint32_t *flags;
    uint32_t *mode;
    uint32_t *reason;
} group_trace;

/* What one loop of the group is; rigs of a group share `sampled`, `substeps`, `period` and `coupling`'s being zero.
 * Its reference is `amplitude` times the unit reference. `noise` holds its standard normal numbers. */
typedef struct {
    loop_link link;
    loop_rig rig;
    double amplitude;
    const double *angle;
    const double *acceleration;
    const double *noise;
    group_trace trace;
} group_loop;

int group_run_double(const group_loop loops[GROUP_LANES], const void *params, int64_t length);
int group_run_single(const group_loop loops[GROUP_LANES], const void *params, int64_t length);

/* loop_normal of counters 0 ... length - 1. */
void loop_normals(uint64_t seed, double *out, int64_t length);

#endif
