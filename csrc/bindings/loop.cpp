// The closed loop from Python: one call for one arm or many, arrays in, arrays out.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <complex>

#include "words.h"

extern "C" {
#include "batch.h"
#include "twin.h"
}

namespace nb = nanobind;

namespace {

template <typename T, int N>
using Read = nb::ndarray<const T, nb::ndim<N>, nb::c_contig, nb::device::cpu>;
template <typename T, int N>
using Write = nb::ndarray<T, nb::ndim<N>, nb::c_contig, nb::device::cpu>;
using Complex = std::complex<double>;

// Links of R arms: decay (R, n), weight (R, 6, n), pair (R, m), pair_weight (R, 6, m), first (R, 6), and second
// (R, LOOP_SECOND) or (0, LOOP_SECOND).
struct Links {
    Read<double, 2> decay;
    Read<double, 3> weight;
    Read<double, 2> first;
    Read<double, 2> second;
    size_t pairs;
    std::vector<double> pair_re, pair_im, weight_re, weight_im;

    Links(Read<double, 2> decay_, Read<double, 3> weight_, Read<Complex, 2> pair, Read<Complex, 3> pair_weight,
          Read<double, 2> first_, Read<double, 2> second_)
        : decay(decay_), weight(weight_), first(first_), second(second_), pairs(pair.shape(1)) {
        const size_t runs = decay.shape(0);
        if (weight.shape(0) != runs || weight.shape(1) != LOOP_POWERS || weight.shape(2) != decay.shape(1) ||
            pair.shape(0) != runs || pair_weight.shape(0) != runs || pair_weight.shape(1) != LOOP_POWERS ||
            pair_weight.shape(2) != pairs || first.shape(0) != runs || first.shape(1) != LOOP_POWERS ||
            (second.shape(0) != runs && second.shape(0) != 0) || second.shape(1) != LOOP_SECOND)
            throw std::invalid_argument("array shapes of the links disagree");
        split(pair.data(), pair.size(), pair_re, pair_im);
        split(pair_weight.data(), pair_weight.size(), weight_re, weight_im);
    }

    // The kernel's vectors run over modes, so real and imaginary parts are stored separately.
    static void split(const Complex *z, size_t count, std::vector<double> &re, std::vector<double> &im) {
        re.resize(count);
        im.resize(count);
        for (size_t i = 0; i < count; i++) {
            re[i] = z[i].real();
            im[i] = z[i].imag();
        }
    }

    batch_links view() const {
        return {int(decay.shape(1)), int(pairs),       decay.data(),     weight.data(), pair_re.data(),
                pair_im.data(),      weight_re.data(), weight_im.data(), first.data(),
                second.shape(0) ? second.data() : nullptr};
    }
};

// `numbers` (R, BATCH_COLUMNS); `path` (K, 2, N): angle, acceleration; `faults` (N or 0, TWIN_INPUTS); `signals` (3 or 8, R, N): tip, motor reference,
// voltage, and motor, torque, measured torque, tip estimate, measured angle; `marks` (3, R, N): flags, mode, reason.
// `estimator`: empty, or the payload estimator's parameters.
void run(nb::bytes params, bool single, nb::bytes estimator, const loop_rig &shared, const Links &links, Read<double, 2> numbers,
         Read<uint64_t, 1> seeds, Read<int32_t, 1> chosen, Read<double, 3> path, Read<double, 2> faults,
         Write<double, 3> signals, Write<uint32_t, 3> marks) {
    const size_t runs = numbers.shape(0), n = path.shape(2);
    if (numbers.shape(1) != BATCH_COLUMNS || path.shape(1) != 2 || faults.shape(1) != TWIN_INPUTS ||
        (faults.shape(0) != n && faults.shape(0) != 0) || seeds.shape(0) != runs ||
        chosen.shape(0) != runs || links.decay.shape(0) != runs ||
        (signals.shape(0) != 3 && signals.shape(0) != 8) || signals.shape(1) != runs || signals.shape(2) != n ||
        marks.shape(0) != 3 || marks.shape(1) != runs || marks.shape(2) != n)
        throw std::invalid_argument("array shapes of the closed loop disagree");
    for (size_t r = 0; r < runs; r++)
        if (chosen.data()[r] < 0 || size_t(chosen.data()[r]) >= path.shape(0))
            throw std::invalid_argument("a run follows a reference that is not there");
    const batch_links view = links.view();
    const size_t plane = runs * n;
    double *o = signals.data();
    double *rest = signals.shape(0) == 8 ? o + 3 * plane : nullptr;
    std::uint32_t *f = marks.data();
    const loop_trace traces = {o,
                               o + plane,
                               o + 2 * plane,
                               f,
                               f + plane,
                               f + 2 * plane,
                               rest,
                               rest ? rest + plane : nullptr,
                               rest ? rest + 2 * plane : nullptr,
                               rest ? rest + 3 * plane : nullptr,
                               rest ? rest + 4 * plane : nullptr};
    const law_port &law = port_of(single);
    const auto block = words_of(params, law.sizes[LAW_PARAMS], "params");
    const auto bank = words_of(estimator, estimator.size() ? law.sizes[PAYLOAD_PARAMS] : 0, "estimator");
    loop_rig rig = shared;
    rig.estimator = estimator.size() ? bank.data() : nullptr;
    std::vector<double> noise(LOOP_LANES * n);
    int failed = 0;
    {
        nb::gil_scoped_release release;
        failed = batch_run(int64_t(runs), int64_t(n), &view, &rig, numbers.data(), seeds.data(), chosen.data(),
                           path.data(), faults.shape(0) ? faults.data() : nullptr, &law, block.data(),
                           noise.data(), &traces);
    }
    if (failed) throw std::invalid_argument("too many modes or too long a delay for the closed loop");
}

}  // namespace

void bind_loop(nb::module_ &m) {
    nb::class_<Links>(m, "Links")
        .def(nb::init<Read<double, 2>, Read<double, 3>, Read<Complex, 2>, Read<Complex, 3>, Read<double, 2>,
                      Read<double, 2>>(),
             nb::kw_only(), nb::arg("decay"), nb::arg("weight"), nb::arg("pair"), nb::arg("pair_weight"),
             nb::arg("first"), nb::arg("second"));
    nb::class_<loop_rig>(m, "LoopRig")
        .def("__init__",
             [](loop_rig *self, bool sampled, int substeps, double period, double pole, double encoder,
                double limit, double quantum, double start) {
                 new (self) loop_rig{};
                 self->sampled = sampled;
                 self->substeps = substeps;
                 self->period = period;
                 self->pole = pole;
                 self->encoder = encoder;
                 self->limit = limit;
                 self->quantum = quantum;
                 self->start = start;
             },
             nb::kw_only(), nb::arg("sampled"), nb::arg("substeps"), nb::arg("period"), nb::arg("pole"),
             nb::arg("encoder"), nb::arg("limit"), nb::arg("quantum"), nb::arg("start"));
    m.def("loop_run", &run, "Closed loops of one or many arms under one law.");
    m.def("loop_normal", &loop_normal);
    m.def("loop_weights", [](double decay, double period, int substeps) {
        loop_rig rig = {};
        rig.sampled = 1;
        rig.decay = decay;
        rig.period = period;
        rig.substeps = substeps;
        const loop_weights w = loop_weights_of(&rig);
        return nb::make_tuple(w.keep, w.first, w.second);
    });
}
