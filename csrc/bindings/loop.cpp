// The closed loop from Python: one call per run, arrays in, arrays out.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstring>
#include <stdexcept>
#include <vector>

extern "C" {
#include "loop.h"
}

namespace nb = nanobind;

namespace {

using Vector = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Matrix = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Signals = nb::ndarray<double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Marks = nb::ndarray<uint32_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

// Rows of `signals`: tip, motor, motor reference, torque, measured torque, voltage, tip estimate; of `marks`: flags,
// mode, reason; of `reference`: angle, velocity, acceleration.
void run(nb::bytes params, bool single, const loop_rig &rig, double stiffness, Vector first, Vector decay,
         Matrix weight, Vector pair_re, Vector pair_im, Matrix weight_re, Matrix weight_im, Matrix reference,
         Signals signals, Marks marks) {
    const size_t n = reference.shape(1);
    const auto reals = decay.shape(0), pairs = pair_re.shape(0);
    if (reference.shape(0) != 3 || signals.shape(0) != 7 || signals.shape(1) != n || marks.shape(0) != 3 ||
        marks.shape(1) != n || first.shape(0) != LOOP_POWERS || weight.shape(0) != LOOP_POWERS || weight.shape(1) != reals ||
        pair_im.shape(0) != pairs || weight_re.shape(0) != LOOP_POWERS || weight_re.shape(1) != pairs ||
        weight_im.shape(0) != LOOP_POWERS || weight_im.shape(1) != pairs)
        throw std::invalid_argument("array shapes of the closed loop disagree");
    loop_link link = {int(reals), int(pairs), decay.data(), weight.data(), pair_re.data(), pair_im.data(),
                      weight_re.data(), weight_im.data(), {0}, stiffness};
    for (int i = 0; i < LOOP_POWERS; i++) link.first[i] = first.data()[i];
    const double *r = reference.data();
    const loop_reference path = {int64_t(n), r, r + 2 * n};
    double *o = signals.data();
    uint32_t *f = marks.data();
    const loop_trace trace = {o, o + n, o + 2 * n, o + 3 * n, o + 4 * n, o + 5 * n, o + 6 * n, f, f + n, f + 2 * n};
    // bytes objects promise no alignment; the law's block wants that of a double
    std::vector<double> block(params.size() / sizeof(double) + 1);
    std::memcpy(block.data(), params.c_str(), params.size());
    int failed = 0;
    {
        nb::gil_scoped_release release;
        failed = single ? loop_run_single(&link, &rig, block.data(), &path, &trace)
                        : loop_run_double(&link, &rig, block.data(), &path, &trace);
    }
    if (failed) throw std::invalid_argument("too many modes or too long a delay for the closed loop");
}

}  // namespace

void bind_loop(nb::module_ &m) {
    nb::class_<loop_rig>(m, "LoopRig")
        .def("__init__",
             [](loop_rig *self, bool sampled, int substeps, int delay, double period, double pole, double gain,
                double decay, double friction, double coupling, double encoder, double offset, double noise,
                double limit, double quantum, double start, uint64_t seed) {
                 new (self) loop_rig{sampled, substeps, delay, period, pole, gain, decay, friction, coupling, encoder,
                                     offset, noise, limit, quantum, start, seed};
             },
             nb::kw_only(), nb::arg("sampled"), nb::arg("substeps"), nb::arg("delay"), nb::arg("period"),
             nb::arg("pole"), nb::arg("gain"), nb::arg("decay"), nb::arg("friction"), nb::arg("coupling"),
             nb::arg("encoder"), nb::arg("offset"), nb::arg("noise"), nb::arg("limit"), nb::arg("quantum"),
             nb::arg("start"), nb::arg("seed"));
    m.def("loop_run", &run);
    m.def("loop_coast", [](nb::ndarray<double, nb::ndim<1>, nb::c_contig, nb::device::cpu> angle, double speed,
                           double gain, double decay, double friction, double period, int substeps) {
        const loop_rig rig = {1, substeps, 0, period, 0, gain, decay, friction, 0, 0, 0, 0, 0, 0, 0, 0};
        loop_coast(&rig, speed, angle.data(), int64_t(angle.shape(0)));
    });
    m.def("loop_normal", &loop_normal);
}
