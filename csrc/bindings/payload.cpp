// The payload estimator from Python: parameters and state are bytes (they are the C structs), signals are arrays.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstring>
#include <stdexcept>
#include <string>

namespace payload_double {
extern "C" {
#include "payload_estimator.h"
}
}  // namespace payload_double
#undef FRACLINK_PAYLOAD_ESTIMATOR_H
#undef FRACLINK_LAW_H
namespace payload_float {
#include "law_single.h"
extern "C" {
#include "payload_estimator.h"
}
}  // namespace payload_float
#undef payload_check
#undef payload_init
#undef payload_step

namespace nb = nanobind;

namespace {

using In = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Ticks = nb::ndarray<const uint32_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Out = nb::ndarray<double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Flags = nb::ndarray<uint32_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

struct Double {
    using params = payload_double::payload_params;
    using state = payload_double::payload_state;
    using output = payload_double::payload_output;
    using real = payload_double::law_real;
    static uint32_t init(state *s, const params *p) { return payload_double::payload_init(s, p); }
    static void step(state *s, const params *p, uint32_t n, real a, real t, output *o) {
        payload_double::payload_step(s, p, n, a, t, o);
    }
};

struct Single {
    using params = payload_float::payload_params;
    using state = payload_float::payload_state;
    using output = payload_float::payload_output;
    using real = payload_float::law_real;
    static uint32_t init(state *s, const params *p) { return payload_float::payload_init_single(s, p); }
    static void step(state *s, const params *p, uint32_t n, real a, real t, output *o) {
        payload_float::payload_step_single(s, p, n, a, t, o);
    }
};

template <class T> T from_bytes(const nb::bytes &bytes, const char *what) {
    T value;
    if (bytes.size() != sizeof(T)) throw std::invalid_argument(std::string(what) + " has the wrong size");
    std::memcpy(&value, bytes.c_str(), sizeof(T));
    return value;
}

template <class T> nb::bytes to_bytes(const T &value) { return nb::bytes(reinterpret_cast<const char *>(&value), sizeof(T)); }

template <class E> nb::tuple init(const nb::bytes &params) {
    const auto p = from_bytes<typename E::params>(params, "params");
    typename E::state s;
    const uint32_t reason = E::init(&s, &p);
    return nb::make_tuple(to_bytes(s), reason);
}

// Rows of `outputs`: given, estimate, low, high.
template <class E>
nb::bytes run(const nb::bytes &params, const nb::bytes &state, Ticks ticks, In angle, In torque, Out outputs, Flags flags) {
    const auto p = from_bytes<typename E::params>(params, "params");
    auto s = from_bytes<typename E::state>(state, "state");
    const size_t n = ticks.shape(0);
    if (angle.shape(0) != n || torque.shape(0) != n || outputs.shape(0) != 4 || outputs.shape(1) != n || flags.shape(0) != n)
        throw std::invalid_argument("ticks, angle, torque, outputs (4 rows) and flags need one length");
    double *out = outputs.data();
    nb::gil_scoped_release release;
    for (size_t k = 0; k < n; k++) {
        typename E::output o;
        E::step(&s, &p, ticks.data()[k], typename E::real(angle.data()[k]), typename E::real(torque.data()[k]), &o);
        out[k] = double(o.given);
        out[n + k] = double(o.estimate);
        out[2 * n + k] = double(o.low);
        out[3 * n + k] = double(o.high);
        flags.data()[k] = o.flags;
    }
    nb::gil_scoped_acquire acquire;
    return to_bytes(s);
}

}  // namespace

void bind_payload(nb::module_ &m) {
    m.def("payload_init", [](const nb::bytes &p, bool single) { return single ? init<Single>(p) : init<Double>(p); });
    m.def("payload_run", [](const nb::bytes &p, const nb::bytes &s, Ticks t, In a, In g, Out o, Flags f, bool single) {
        return single ? run<Single>(p, s, t, a, g, o, f) : run<Double>(p, s, t, a, g, o, f);
    });
    m.def("payload_sizes", [](bool single) {
        return single ? nb::make_tuple(sizeof(Single::params), sizeof(Single::state))
                      : nb::make_tuple(sizeof(Double::params), sizeof(Double::state));
    });
    // the header's own numbers
    m.attr("PAYLOAD_FROZEN") = unsigned(PAYLOAD_FROZEN);
    m.attr("PAYLOAD_OUTSIDE") = unsigned(PAYLOAD_OUTSIDE);
    m.attr("PAYLOAD_CONTACT") = unsigned(PAYLOAD_CONTACT);
    m.attr("PAYLOAD_GIVEN") = unsigned(PAYLOAD_GIVEN);
    m.attr("PAYLOAD_CHANGED") = unsigned(PAYLOAD_CHANGED);
    m.attr("PAYLOAD_SAMPLE") = unsigned(PAYLOAD_SAMPLE);
}
