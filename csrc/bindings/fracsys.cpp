// The Python module of the kernels of fracsys; that of fraclink is in module.cpp.
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <complex>
#include <new>

#include "arrays.h"

extern "C" {
#include "minimax.h"
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
                              reinterpret_cast<const cx *>(pole_log_decays.data()),
                              reinterpret_cast<const cx *>(pole_gains.data())};
    auto y = room<double>(n);
    {
        const nb::gil_scoped_release release;
        const auto scratch = room<double>(modes_scratch(&system));
        modes_response(&system, initial.data(), u.data(), y.get(), ptrdiff_t(n), scratch.get());
    }
    return owned(std::move(y), {n});
}

void improve(Read<double, -1> omega, Read<double, 4, -1> coefficients, Read<double, -1> wanted, int reals, int pairs,
             const std::vector<int> &powers, Write<double, -1> parameters) {
    const size_t n = omega.size();
    const int poles = reals + 2 * pairs;
    require(coefficients.shape(1) == n && wanted.size() == 2 * n, "minimax: 4 coefficients and 2 values at a frequency");
    require(reals >= 0 && pairs >= 0 && poles <= MINIMAX_ORDER_MOST && parameters.size() == size_t(1 + 2 * poles),
            "minimax: 0 to 12 poles, with 1 + 2 parameters for each");
    require(std::none_of(powers.begin(), powers.end(), [](int p) { return p < 2 || p > 128 || (p & (p - 1)); }),
            "minimax: powers of two from 2 to 128");
    const double *c = coefficients.data();
    const minimax_target target{ptrdiff_t(n), omega.data(), {c, c + n}, {c + 2 * n, c + 3 * n}, wanted.data()};
    const nb::gil_scoped_release release;
    if (minimax_improve(&target, reals, pairs, powers.data(), int(powers.size()), parameters.data())) throw std::bad_alloc();
}

} // namespace

NB_MODULE(_kernels, m) {
    m.doc() = "Compiled kernels of fracsys. Private: the package's Python modules are the interface.";
    m.def("minimax_improve", &improve, "Partial fractions of smaller worst error, norm by norm, in place.");
    m.def("modes_response", &response, nb::arg("u"), nb::arg("direct"), nb::arg("first"), nb::arg("log_decays"),
          nb::arg("gains"), nb::arg("pole_log_decays"), nb::arg("pole_gains"), nb::arg("initial"),
          "Response of a sum of exponential modes to a held input.");
}
