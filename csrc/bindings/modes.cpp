// Binding of the recursions of exponential modes: arrays in, arrays out.
#include <complex>

#include "arrays.h"

extern "C" {
#include "modes.h"
}

namespace nb = nanobind;

namespace {

using Complexes = Read<std::complex<double>, -1>;

Result<double> response(Read<double, -1> u, double direct, double first, Read<double, -1> log_decays,
                        Read<double, -1> gains, Complexes pole_log_decays, Complexes pole_gains,
                        Read<double, -1> initial) {
    const size_t reals = log_decays.size(), pairs = pole_log_decays.size(), n = u.size();
    require(gains.size() == reals && pole_gains.size() == pairs && initial.size() == reals + 2 * pairs,
            "modes: arrays of different length");
    const modes_system system{direct,
                              first,
                              ptrdiff_t(reals),
                              ptrdiff_t(pairs),
                              log_decays.data(),
                              gains.data(),
                              reinterpret_cast<const double *>(pole_log_decays.data()),
                              reinterpret_cast<const double *>(pole_gains.data())};
    auto y = room<double>(n);
    {
        const nb::gil_scoped_release release;
        const auto scratch = room<double>(modes_scratch(&system));
        modes_response(&system, initial.data(), u.data(), y.get(), ptrdiff_t(n), scratch.get());
    }
    return owned(std::move(y), {n});
}

} // namespace

void bind_modes(nb::module_ &m) {
    m.def("modes_response", &response, nb::arg("u"), nb::arg("direct"), nb::arg("first"), nb::arg("log_decays"),
          nb::arg("gains"), nb::arg("pole_log_decays"), nb::arg("pole_gains"), nb::arg("initial"),
          "Response of a sum of exponential modes to a held input.");
}
