/* Weights of the motor's step. Not compiled for the browser: there they are passed in. */
#include <math.h>

#include "loop.h"

loop_weights loop_weights_of(const loop_rig *rig)
{
    loop_weights w;
    if (!rig->sampled) {
        w.keep = exp(-rig->pole * rig->period);
        w.first = w.second = 0.0;
        return w;
    }
    const double h = rig->period / rig->substeps;
    const double bh = rig->decay * h;
    w.keep = exp(-bh);
    w.first = bh > 0.0 ? -expm1(-bh) / rig->decay : h;
    /* below 1e-4 the difference h - first has lost its digits, but its series has not */
    w.second = bh > 1e-4 ? (h - w.first) / rig->decay : h * h * (0.5 - bh / 6.0 + bh * bh / 24.0);
    return w;
}
