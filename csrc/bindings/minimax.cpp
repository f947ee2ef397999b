// Binding of the minimax fractions: arrays in, the improved parameters out.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <new>
#include <stdexcept>
#include <vector>

extern "C" {
#include "minimax.h"
}

namespace nb = nanobind;

namespace {

using In = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Rows = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Out = nb::ndarray<double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

void improve(In omega, Rows coefficients, In wanted, int reals, int pairs, const std::vector<int> &powers, Out parameters) {
    const size_t n = omega.shape(0);
    const int poles = reals + 2 * pairs;
    if (coefficients.shape(0) != 4 || coefficients.shape(1) != n || wanted.shape(0) != 2 * n)
        throw std::invalid_argument("minimax: 4 rows of coefficients and 2 values wanted for each frequency");
    if (reals < 0 || pairs < 0 || poles > MINIMAX_ORDER_MOST || parameters.shape(0) != size_t(1 + 2 * poles))
        throw std::invalid_argument("minimax: 0 to 12 poles, with 1 + 2 parameters for each");
    if (std::any_of(powers.begin(), powers.end(), [](int p) { return p < 2 || p > 128 || (p & (p - 1)); }))
        throw std::invalid_argument("minimax: powers of two from 2 to 128");
    const double *c = coefficients.data();
    const minimax_target target{(ptrdiff_t)n, omega.data(), {c, c + n}, {c + 2 * n, c + 3 * n}, wanted.data()};
    nb::gil_scoped_release release;
    if (minimax_improve(&target, reals, pairs, powers.data(), (int)powers.size(), parameters.data())) throw std::bad_alloc();
}

} // namespace

void bind_minimax(nb::module_ &m) {
    m.def("minimax_improve", &improve, nb::arg("omega"), nb::arg("coefficients"), nb::arg("wanted"), nb::arg("reals"),
          nb::arg("pairs"), nb::arg("powers"), nb::arg("parameters"),
          "Partial fractions of smaller worst error, norm by norm, in place.");
}
