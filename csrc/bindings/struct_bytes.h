// C structs as Python bytes: what parameters and states are to the package, for the law and the payload estimator.
#ifndef FRACLINK_STRUCT_BYTES_H
#define FRACLINK_STRUCT_BYTES_H
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <stdint.h>

#include <cstring>
#include <stdexcept>
#include <string>

namespace struct_bytes {

namespace nb = nanobind;

using In = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Ticks = nb::ndarray<const uint32_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Out = nb::ndarray<double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

template <class T> T from_bytes(const nb::bytes &bytes, const char *what) {
    T value;
    if (bytes.size() != sizeof(T)) throw std::invalid_argument(std::string(what) + " has the wrong size");
    std::memcpy(&value, bytes.c_str(), sizeof(T));
    return value;
}

template <class T> nb::bytes to_bytes(const T &value) { return nb::bytes(reinterpret_cast<const char *>(&value), sizeof(T)); }

// L: a precision's params, state and init.
template <class L> nb::tuple init(const nb::bytes &params) {
    const auto p = from_bytes<typename L::params>(params, "params");
    typename L::state s;
    const uint32_t reason = L::init(&s, &p);
    return nb::make_tuple(to_bytes(s), reason);
}

template <class Double, class Single> void bind_init(nb::module_ &m, const char *init_name, const char *sizes_name) {
    m.def(init_name, [](const nb::bytes &p, bool single) { return single ? init<Single>(p) : init<Double>(p); });
    m.def(sizes_name, [](bool single) {
        return single ? nb::make_tuple(sizeof(typename Single::params), sizeof(typename Single::state))
                      : nb::make_tuple(sizeof(typename Double::params), sizeof(typename Double::state));
    });
}

} // namespace struct_bytes
#endif
