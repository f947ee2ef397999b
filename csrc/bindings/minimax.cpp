// Binding of the minimax fractions: arrays in, the improved parameters out.
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <new>

#include "arrays.h"

extern "C" {
#include "minimax.h"
}

namespace nb = nanobind;

namespace {

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

void bind_minimax(nb::module_ &m) {
    m.def("minimax_improve", &improve, "Partial fractions of smaller worst error, norm by norm, in place.");
}
