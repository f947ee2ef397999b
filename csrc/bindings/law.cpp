// The law from Python: parameters and state are bytes (they are the C structs), signals are arrays.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <stdint.h>

#include <cstring>
#include <stdexcept>
#include <string>

namespace law_double {
extern "C" {
#include "law.h"
}
}  // namespace law_double
#undef FRACLINK_LAW_H
namespace law_float {
#include "law_single.h"
extern "C" {
#include "law.h"
}
}  // namespace law_float
#undef law_check
#undef law_init
#undef law_step
#undef law_check_wiring

namespace nb = nanobind;

namespace {

using In = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Ticks = nb::ndarray<const uint32_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Out = nb::ndarray<double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Marks = nb::ndarray<uint32_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

struct Double {
    using params = law_double::law_params;
    using state = law_double::law_state;
    using input = law_double::law_input;
    using output = law_double::law_output;
    using real = law_double::law_real;
    static void step(state *s, const params *p, const input *i, output *o) { law_double::law_step(s, p, i, o); }
    static uint32_t init(state *s, const params *p) { return law_double::law_init(s, p); }
    using wiring = law_double::law_wiring;
    static uint32_t check(wiring *w, const params *p, real a, real t) { return law_double::law_check_wiring(w, p, a, t); }
};

struct Single {
    using params = law_float::law_params;
    using state = law_float::law_state;
    using input = law_float::law_input;
    using output = law_float::law_output;
    using real = law_float::law_real;
    static void step(state *s, const params *p, const input *i, output *o) { law_float::law_step_single(s, p, i, o); }
    static uint32_t init(state *s, const params *p) { return law_float::law_init_single(s, p); }
    using wiring = law_float::law_wiring;
    static uint32_t check(wiring *w, const params *p, real a, real t) {
        return law_float::law_check_wiring_single(w, p, a, t);
    }
};

template <class T> T from_bytes(const nb::bytes &bytes, const char *what) {
    T value;
    if (bytes.size() != sizeof(T)) throw std::invalid_argument(std::string(what) + " has the wrong size");
    std::memcpy(&value, bytes.c_str(), sizeof(T));
    return value;
}

template <class T> nb::bytes to_bytes(const T &value) { return nb::bytes(reinterpret_cast<const char *>(&value), sizeof(T)); }

template <class L> nb::tuple init(const nb::bytes &params) {
    const auto p = from_bytes<typename L::params>(params, "params");
    typename L::state s;
    const uint32_t reason = L::init(&s, &p);
    return nb::make_tuple(to_bytes(s), reason);
}

// Rows of `inputs`: reference, acceleration, motor angle, torque, payload. Rows of `outputs`: motor reference,
// voltage, compensation, tip estimate, error. Rows of `marks`: mode, reason, flags.
template <class L>
nb::bytes run(const nb::bytes &params, const nb::bytes &state, Ticks ticks,
              nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu> inputs, Out outputs, Marks marks) {
    const auto p = from_bytes<typename L::params>(params, "params");
    auto s = from_bytes<typename L::state>(state, "state");
    const size_t n = ticks.shape(0);
    if (inputs.shape(0) != 5 || inputs.shape(1) != n || outputs.shape(0) != 5 || outputs.shape(1) != n ||
        marks.shape(0) != 3 || marks.shape(1) != n)
        throw std::invalid_argument("inputs, outputs and marks need 5, 5 and 3 rows of one length");
    const double *in = inputs.data();
    double *out = outputs.data();
    uint32_t *mark = marks.data();
    nb::gil_scoped_release release;
    for (size_t k = 0; k < n; k++) {
        using R = typename L::real;
        const typename L::input i = {ticks.data()[k], R(in[k]), R(in[n + k]), R(in[2 * n + k]), R(in[3 * n + k]), R(in[4 * n + k])};
        typename L::output o;
        L::step(&s, &p, &i, &o);
        out[k] = double(o.motor_reference);
        out[n + k] = double(o.voltage);
        out[2 * n + k] = double(o.compensation);
        out[3 * n + k] = double(o.tip_estimate);
        out[4 * n + k] = double(o.error);
        mark[k] = o.mode;
        mark[n + k] = o.reason;
        mark[2 * n + k] = o.flags;
    }
    nb::gil_scoped_acquire acquire;
    return to_bytes(s);
}

template <class L> uint32_t wiring(const nb::bytes &params, In angle, In torque) {
    const auto p = from_bytes<typename L::params>(params, "params");
    typename L::wiring w = {};
    uint32_t reason = 0;
    for (size_t k = 0; k < angle.shape(0) && k < torque.shape(0); k++)
        reason = L::check(&w, &p, typename L::real(angle.data()[k]), typename L::real(torque.data()[k]));
    return reason;
}

}  // namespace

void bind_law(nb::module_ &m) {
    m.def("law_init", [](const nb::bytes &p, bool single) { return single ? init<Single>(p) : init<Double>(p); });
    m.def("law_run", [](const nb::bytes &p, const nb::bytes &s, Ticks t,
                        nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu> i, Out o, Marks marks,
                        bool single) {
        return single ? run<Single>(p, s, t, i, o, marks) : run<Double>(p, s, t, i, o, marks);
    });
    m.def("law_wiring", [](const nb::bytes &p, In angle, In torque, bool single) {
        return single ? wiring<Single>(p, angle, torque) : wiring<Double>(p, angle, torque);
    });
    m.def("law_sizes", [](bool single) {
        return single ? nb::make_tuple(sizeof(Single::params), sizeof(Single::state))
                      : nb::make_tuple(sizeof(Double::params), sizeof(Double::state));
    });
}
