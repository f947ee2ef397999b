// A block of closed loops from Python: one call for many runs, arrays in, arrays out.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstring>
#include <stdexcept>
#include <vector>

extern "C" {
#include "batch.h"
}

namespace nb = nanobind;

namespace {

template <typename T, int N>
using Read = nb::ndarray<const T, nb::ndim<N>, nb::c_contig, nb::device::cpu>;
template <typename T, int N>
using Write = nb::ndarray<T, nb::ndim<N>, nb::c_contig, nb::device::cpu>;

// `links`: decay (R, n), weight (R, 6, n), pair_re, pair_im (R, m), weight_re, weight_im (R, 6, m), first (R, 6);
// `numbers` (R, BATCH_COLUMNS); `path` (K, 2, N); `signals` (3, R, N): tip, motor reference, voltage;
// `marks` (3, R, N): flags, mode, reason.
void run(nb::bytes params, bool single, const loop_rig &rig, Read<double, 2> decay, Read<double, 3> weight,
         Read<double, 2> pair_re, Read<double, 2> pair_im, Read<double, 3> weight_re, Read<double, 3> weight_im,
         Read<double, 2> first, Read<double, 2> numbers, Read<uint64_t, 1> seeds, Read<int32_t, 1> chosen,
         Read<double, 3> path, Write<double, 3> signals, Write<uint32_t, 3> marks) {
    const size_t runs = numbers.shape(0), n = path.shape(2), reals = decay.shape(1), pairs = pair_re.shape(1);
    const bool fits = numbers.shape(1) == BATCH_COLUMNS && path.shape(1) == 2 && seeds.shape(0) == runs &&
                      chosen.shape(0) == runs && decay.shape(0) == runs && pair_re.shape(0) == runs &&
                      pair_im.shape(0) == runs && pair_im.shape(1) == pairs && first.shape(0) == runs &&
                      first.shape(1) == LOOP_POWERS && weight.shape(0) == runs && weight.shape(1) == LOOP_POWERS &&
                      weight.shape(2) == reals && weight_re.shape(0) == runs && weight_re.shape(1) == LOOP_POWERS &&
                      weight_re.shape(2) == pairs && weight_im.shape(0) == runs &&
                      weight_im.shape(1) == LOOP_POWERS && weight_im.shape(2) == pairs && signals.shape(0) == 3 &&
                      signals.shape(1) == runs && signals.shape(2) == n && marks.shape(0) == 3 &&
                      marks.shape(1) == runs && marks.shape(2) == n;
    if (!fits) throw std::invalid_argument("array shapes of the batch disagree");
    for (size_t r = 0; r < runs; r++)
        if (chosen.data()[r] < 0 || size_t(chosen.data()[r]) >= path.shape(0))
            throw std::invalid_argument("a run follows a reference that is not there");
    const batch_links links = {int(reals),       int(pairs),       decay.data(),     weight.data(), pair_re.data(),
                               pair_im.data(),   weight_re.data(), weight_im.data(), first.data()};
    const size_t plane = runs * n;
    double *o = signals.data();
    uint32_t *f = marks.data();
    const batch_traces traces = {o, o + plane, o + 2 * plane, f, f + plane, f + 2 * plane};
    std::vector<double> block(params.size() / sizeof(double) + 1);  // bytes promise no alignment
    std::memcpy(block.data(), params.c_str(), params.size());
    std::vector<double> scratch(BATCH_SCRATCH * n);
    int failed = 0;
    {
        nb::gil_scoped_release release;
        failed = batch_run(int64_t(runs), int64_t(n), &links, &rig, numbers.data(), seeds.data(), chosen.data(),
                           path.data(), block.data(), single, scratch.data(), &traces);
    }
    if (failed) throw std::invalid_argument("too many modes or too long a delay for the closed loop");
}

}  // namespace

void bind_batch(nb::module_ &m) { m.def("batch_run", &run, "Closed loops of many arms under one law."); }
