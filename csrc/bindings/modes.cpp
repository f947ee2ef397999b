// Binding of the recursions of exponential modes: arrays in, arrays out.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <complex>
#include <memory>
#include <stdexcept>

extern "C" {
#include "modes.h"
}

namespace nb = nanobind;
using reals = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using complexes = nb::ndarray<const std::complex<double>, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using output_array = nb::ndarray<nb::numpy, double, nb::ndim<1>>;

namespace {

output_array result(std::unique_ptr<double[]> values, size_t n) {
    double *data = values.release();
    nb::capsule owner(data, [](void *p) noexcept { delete[] static_cast<double *>(p); });
    return output_array(data, {n}, owner);
}

output_array response(reals u, double direct, double first, reals log_decays, reals gains,
                      complexes pole_log_decays, complexes pole_gains, reals initial) {
    size_t real_count = log_decays.shape(0), pairs = pole_log_decays.shape(0), n = u.shape(0);
    if (gains.shape(0) != real_count || pole_gains.shape(0) != pairs ||
        initial.shape(0) != real_count + 2 * pairs)
        throw std::invalid_argument("modes: arrays of different length");
    modes_system system{direct,
                        first,
                        (ptrdiff_t)real_count,
                        (ptrdiff_t)pairs,
                        log_decays.data(),
                        gains.data(),
                        reinterpret_cast<const double *>(pole_log_decays.data()),
                        reinterpret_cast<const double *>(pole_gains.data())};
    std::unique_ptr<double[]> y(new double[std::max<size_t>(n, 1)]);
    {
        nb::gil_scoped_release release;
        std::unique_ptr<double[]> scratch(new double[modes_scratch(&system)]);
        modes_response(&system, initial.data(), u.data(), y.get(), (ptrdiff_t)n, scratch.get());
    }
    return result(std::move(y), n);
}

} // namespace

void bind_modes(nb::module_ &m) {
    m.def("modes_response", &response, nb::arg("u"), nb::arg("direct"), nb::arg("first"), nb::arg("log_decays"),
          nb::arg("gains"), nb::arg("pole_log_decays"), nb::arg("pole_gains"), nb::arg("initial"),
          "Response of a sum of exponential modes to a held input.");
}
