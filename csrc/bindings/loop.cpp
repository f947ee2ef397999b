// Closed loops from Python: the same law with a different arm in each run, LOOP_LANES at a time.
#include <algorithm>
#include <complex>

#include "arrays.h"
#include "words.h"

extern "C" {
#include "loop.h"
#include "twin.h"
}

namespace nb = nanobind;

namespace {

using Complex = std::complex<double>;

// What all rigs of a call have in common.
enum { SAMPLED, SUBSTEPS, PERIOD, POLE, ENCODER, LIMIT, QUANTUM, START, SHARED };

// Columns of a run's numbers.
enum {
    STIFFNESS,      // c [N m/rad]
    GAIN,           // A of the motor [rad/(s^2 V)]
    DECAY,          // B of the motor [1/s]
    FRICTION,       // Coulomb deceleration [rad/s^2]
    OFFSET,         // of the gauge [N m]
    NOISE,          // standard deviation of a gauge sample [N m]
    DELAY,          // whole periods
    AMPLITUDE,      // amplitude of the reference [rad]
    GAUGE_DELAY,    // in periods, not necessarily whole
    GAUGE_GAIN,     // [1]
    PAYLOAD,        // payload given to the law [kg]; 0: none
    COLUMNS
};

loop_rig rig_of(const double *shared, const double *row, const void *estimator) {
    loop_rig rig{};
    rig.sampled = int(shared[SAMPLED]);
    rig.substeps = int(shared[SUBSTEPS]);
    rig.period = shared[PERIOD];
    rig.pole = shared[POLE];
    rig.encoder = shared[ENCODER];
    rig.limit = shared[LIMIT];
    rig.quantum = shared[QUANTUM];
    rig.start = shared[START];
    rig.gain = row[GAIN];
    rig.decay = row[DECAY];
    rig.friction = row[FRICTION];
    rig.offset = row[OFFSET];
    rig.noise = row[NOISE];
    rig.delay = int(row[DELAY]);
    rig.gauge_delay = row[GAUGE_DELAY];
    rig.gauge_gain = row[GAUGE_GAIN];
    rig.payload = row[PAYLOAD];
    rig.estimator = estimator;
    rig.weights = loop_weights_of(&rig);
    return rig;
}

// Links of R arms, padded to the same number of real modes and pairs; `second` may have no rows.
struct Links {
    Read<double, -1, -1> decay;
    Read<double, -1, LOOP_POWERS, -1> weight;
    Read<Complex, -1, -1> pair;
    Read<Complex, -1, LOOP_POWERS, -1> pair_weight;
    Read<double, -1, LOOP_POWERS> first;
    Read<double, -1, LOOP_SECOND> second;

    explicit Links(nb::handle links)
        : decay(nb::cast<decltype(decay)>(links.attr("decay"))),
          weight(nb::cast<decltype(weight)>(links.attr("weight"))),
          pair(nb::cast<decltype(pair)>(links.attr("pair"))),
          pair_weight(nb::cast<decltype(pair_weight)>(links.attr("pair_weight"))),
          first(nb::cast<decltype(first)>(links.attr("first"))),
          second(nb::cast<decltype(second)>(links.attr("second"))) {
        const size_t runs = decay.shape(0);
        require(weight.shape(0) == runs && pair.shape(0) == runs && pair_weight.shape(0) == runs &&
                    first.shape(0) == runs && (second.shape(0) == runs || second.shape(0) == 0) &&
                    weight.shape(2) == decay.shape(1) && pair_weight.shape(2) == pair.shape(1),
                "array shapes of the links disagree");
    }

    loop_link of(size_t run, double stiffness) const {
        const size_t n = decay.shape(1), m = pair.shape(1);
        const auto *poles = reinterpret_cast<const cx *>(pair.data());
        const auto *pole_weights = reinterpret_cast<const cx *>(pair_weight.data());
        loop_link link = {int(n), int(m), decay.data() + run * n, weight.data() + run * n * LOOP_POWERS, poles + run * m,
                          pole_weights + run * m * LOOP_POWERS, {}, stiffness,
                          second.shape(0) ? second.data() + run * LOOP_SECOND : nullptr};
        std::copy_n(first.data() + run * LOOP_POWERS, LOOP_POWERS, link.first);
        return link;
    }
};

// `path` (K, 2, N) holds references of unit amplitude, angle and acceleration, of which a run follows the `chosen` one;
// `faults` (N or 0, TWIN_INPUTS) are those of all runs, `estimator` the payload estimator's parameters, or empty. Signals
// and marks are in the order of loop.h; numpy allocates them on large pages.
void run(nb::bytes params, bool single, nb::bytes estimator, Read<double, SHARED> shared, nb::handle given_links,
         Read<double, -1, COLUMNS> numbers, Read<std::uint64_t, -1> seeds, Read<std::int32_t, -1> chosen,
         Read<double, -1, 2, -1> path, Read<double, -1, TWIN_INPUTS> faults, Write<double, LOOP_SIGNALS, -1, -1> signals,
         Write<std::uint32_t, LOOP_MARKS, -1, -1> marks) {
    const Links links(given_links);
    const size_t runs = numbers.shape(0), n = path.shape(2);
    require(seeds.size() == runs && chosen.size() == runs && links.decay.shape(0) == runs &&
                (faults.shape(0) == n || faults.shape(0) == 0) && signals.shape(1) == runs && signals.shape(2) == n &&
                marks.shape(1) == runs && marks.shape(2) == n,
            "array shapes of the closed loop disagree");
    require(std::all_of(chosen.data(), chosen.data() + runs, [&path](int c) { return c >= 0 && size_t(c) < path.shape(0); }),
            "a run follows a reference that does not exist");
    const law_port &law = port_of(single);
    const auto block = words_of(params, law.sizes[LAW_PARAMS], "params");
    const auto bank = words_of(estimator, estimator.size() ? law.sizes[PAYLOAD_PARAMS] : 0, "estimator");
    const auto noise = room<double>(LOOP_LANES * n);
    bool failed = false;
    {
        const nb::gil_scoped_release release;
        for (size_t begin = 0; begin < runs && !failed; begin += LOOP_LANES) {
            loop_arm arms[LOOP_LANES];
            const size_t count = std::min<size_t>(runs - begin, LOOP_LANES);
            for (size_t l = 0; l < count; l++) {
                const size_t each = begin + l;
                const double *row = numbers.data() + each * COLUMNS, *unit = path.data() + chosen.data()[each] * 2 * n;
                double *const normal = noise.get() + l * n;
                loop_arm &arm = arms[l];
                arm = {links.of(each, row[STIFFNESS]), rig_of(shared.data(), row, estimator.size() ? bank.data() : nullptr),
                       row[AMPLITUDE], unit, unit + n, normal, faults.shape(0) ? faults.data() : nullptr, {}, {}};
                for (size_t i = 0; i < LOOP_SIGNALS; i++) arm.signal[i] = signals.data() + (i * runs + each) * n;
                for (size_t i = 0; i < LOOP_MARKS; i++) arm.mark[i] = marks.data() + (i * runs + each) * n;
                if (arm.rig.noise > 0.0) loop_normals(seeds.data()[each], normal, std::int64_t(n));
            }
            failed = loop_run(arms, int(count), &law, block.data(), std::int64_t(n)) != 0;
        }
    }
    require(!failed, "too many modes or too long a delay for the closed loop");
}

Result<double> normals(std::uint64_t seed, size_t count) {
    auto values = room<double>(count);
    loop_normals(seed, values.get(), std::int64_t(count));
    return owned(std::move(values), {count});
}

nb::tuple weights(double decay, double period, int substeps) {
    loop_rig rig{};
    rig.sampled = 1;
    rig.decay = decay;
    rig.period = period;
    rig.substeps = substeps;
    const loop_weights w = loop_weights_of(&rig);
    return nb::make_tuple(w.keep, w.first, w.second);
}

}  // namespace

void bind_loop(nb::module_ &m) {
    m.def("loop_run", &run, "Closed loops of one or many arms under one law.");
    m.def("loop_normals", &normals, "Standard normal numbers, the first ones of a seed's stream.");
    m.def("loop_weights", &weights, "Weights of a step of the motor.");
}
