// Binding of the figures of many loops: a table in, figures and slopes out.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/tuple.h>

#include <algorithm>
#include <cmath>
#include <complex>
#include <new>
#include <stdexcept>
#include <vector>

extern "C" {
#include "figures.h"
}

namespace nb = nanobind;
using complex = std::complex<double>;
template <class T> using vector_of = nb::ndarray<const T, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
template <class T> using table_of = nb::ndarray<const T, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

namespace {

template <class T> nb::ndarray<nb::numpy, T> owned(std::vector<T> values, std::initializer_list<size_t> shape) {
    auto *held = new std::vector<T>(std::move(values));
    nb::capsule owner(held, [](void *p) noexcept { delete static_cast<std::vector<T> *>(p); });
    return nb::ndarray<nb::numpy, T>(held->data(), shape, owner);
}

// The table copied once, with the logarithms of its frequencies.
struct Loops {
    std::vector<double> w, log_w, noise_w, noise_log_w, weight, voltage, modes_w, modes_log_w, resonance, highest, band, centre;
    std::vector<complex> rest, slope, noise_rest, modes_level, plant, loop;
    std::vector<int> column;
    figures_table table{};

    template <class T> static std::vector<T> copied(table_of<T> rows, size_t links, size_t columns) {
        if (rows.shape(0) != links || rows.shape(1) != columns) throw std::invalid_argument("loops: rows of different length");
        return std::vector<T>(rows.data(), rows.data() + rows.size());
    }

    static std::vector<double> logarithms(const std::vector<double> &values) {
        std::vector<double> logs(values.size());
        std::transform(values.begin(), values.end(), logs.begin(), [](double v) { return std::log(v); });
        return logs;
    }

    Loops(table_of<double> own_w, table_of<complex> own_rest, table_of<complex> own_slope, table_of<double> own_noise_w,
          table_of<double> own_weight, table_of<complex> own_noise_rest, table_of<double> own_voltage,
          table_of<double> own_modes_w, table_of<complex> own_modes_level, int mode_points, double doubt, table_of<double> own_centre, table_of<complex> own_plant,
          table_of<complex> own_loop, double radius, double lowest, double furthest, vector_of<double> own_resonance,
          vector_of<double> own_highest, table_of<double> own_band, vector_of<int> own_column) {
        const size_t k = own_w.shape(0), n = own_w.shape(1), m = own_noise_w.shape(1), r = own_modes_w.shape(1);
        const size_t j = own_centre.shape(1), terms = j ? own_plant.shape(1) / j : 0;
        if (mode_points < 1 || r % mode_points || j < 2 || terms < 1 || own_resonance.shape(0) != k || own_highest.shape(0) != k || own_column.shape(0) != k)
            throw std::invalid_argument("loops: rows of different length");
        w = copied(own_w, k, n), rest = copied(own_rest, k, n), slope = copied(own_slope, k, n);
        noise_w = copied(own_noise_w, k, m), weight = copied(own_weight, k, m), voltage = copied(own_voltage, k, m);
        noise_rest = copied(own_noise_rest, k, m);
        modes_w = copied(own_modes_w, k, r), modes_level = copied(own_modes_level, k, r);
        centre = copied(own_centre, k, j), plant = copied(own_plant, k, j * terms), loop = copied(own_loop, k, j * terms);
        resonance.assign(own_resonance.data(), own_resonance.data() + k), band = copied(own_band, k, 2);
        highest.assign(own_highest.data(), own_highest.data() + k);
        column.assign(own_column.data(), own_column.data() + k);
        if (std::any_of(column.begin(), column.end(), [n](int c) { return c < 0 || (size_t)c >= n; }))
            throw std::invalid_argument("loops: a resonance beyond the columns");
        log_w = logarithms(w), noise_log_w = logarithms(noise_w), modes_log_w = logarithms(modes_w);
        auto pairs = [](const std::vector<complex> &values) { return reinterpret_cast<const cx *>(values.data()); };
        table = {(int)k, (int)n, (int)m, (int)r / mode_points, mode_points, (int)j, (int)terms, w.data(), log_w.data(), pairs(rest), pairs(slope),
                 noise_w.data(), noise_log_w.data(), weight.data(), pairs(noise_rest), voltage.data(), modes_w.data(),
                 modes_log_w.data(), pairs(modes_level), doubt, centre.data(), pairs(plant), pairs(loop), radius, {lowest, furthest}, resonance.data(), highest.data(), band.data(), column.data()};
    }
    Loops(const Loops &) = delete; // the table points into its own vectors

    auto figures(vector_of<double> x, double reference, int order) const {
        const size_t p = x.shape(0), k = table.links, rows = FIGURE_MODES + table.modes;
        if ((p != 3 && p != FIGURES_PARAMETERS) || order < 0) throw std::invalid_argument("loops: 3 parameters, or 6 with a notch");
        figures_outer outer{(int)p, order, reference, {}};
        std::copy_n(x.data(), p, outer.x);
        std::vector<double> value(rows * k), gradient(p * rows * k);
        {
            nb::gil_scoped_release release;
            if (figures_of(&table, &outer, value.data(), gradient.data()))
                throw std::bad_alloc();
        }
        return std::make_tuple(owned(std::move(value), {rows, k}), owned(std::move(gradient), {p, rows, k}));
    }
};

} // namespace

void bind_figures(nb::module_ &m) {
    nb::class_<Loops>(m, "Loops")
        .def(nb::init<table_of<double>, table_of<complex>, table_of<complex>, table_of<double>, table_of<double>, table_of<complex>,
                      table_of<double>, table_of<double>, table_of<complex>, int, double, table_of<double>, table_of<complex>, table_of<complex>, double, double, double, vector_of<double>, vector_of<double>, table_of<double>, vector_of<int>>())
        .def("figures", &Loops::figures, nb::arg("x"), nb::arg("reference"), nb::arg("order"));
}
