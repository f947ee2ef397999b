// Binding of the figures of many loops: a table in, figures and slopes out.
#include <nanobind/stl/tuple.h>

#include <algorithm>
#include <any>
#include <cmath>
#include <complex>
#include <cstdint>
#include <new>
#include <vector>

#include "arrays.h"

extern "C" {
#include "figures.h"
}

namespace nb = nanobind;
using complex = std::complex<double>;

namespace {

// A Table of Python, whose arrays are kept, with the logarithms of its frequencies.
struct Loops {
    figures_table table{};
    std::vector<std::any> kept;
    std::vector<double> log_w, noise_log_w, modes_log_w;

    template <class T> const T *part(nb::handle given, const char *name, int columns) {
        const auto rows = nb::cast<nb::ndarray<const T, nb::c_contig, nb::device::cpu>>(given.attr(name));
        require(rows.size() == size_t(table.links) * size_t(columns), "loops: rows of different length");
        kept.emplace_back(rows);
        return rows.data();
    }

    const cx *pairs(nb::handle given, const char *name, int columns) {
        return reinterpret_cast<const cx *>(part<complex>(given, name, columns));
    }

    const double *logarithms(const double *values, int columns, std::vector<double> &logs) const {
        logs.assign(values, values + size_t(table.links) * size_t(columns));
        for (double &each : logs) each = std::log(each);
        return logs.data();
    }

    Loops(nb::handle given, int mode_points, double doubt, double radius, double region) {
        const auto columns = [given](const char *name) { return nb::cast<int>(given.attr(name).attr("shape")[1]); };
        figures_table &t = table;
        t.links = int(nb::len(given));
        const int n = t.columns = columns("w"), m = t.noise_points = columns("noise_w"), r = columns("modes_w");
        t.expansions = columns("centre");
        require(mode_points > 0 && r % mode_points == 0 && t.expansions > 1, "loops: no whole modes, or no expansions");
        t.modes = r / mode_points, t.mode_points = mode_points;
        t.terms = columns("plant") / t.expansions;
        t.w = part<double>(given, "w", n);
        t.log_w = logarithms(t.w, n, log_w);
        t.rest = pairs(given, "rest", n);
        t.slope = pairs(given, "slope", n);
        t.noise_w = part<double>(given, "noise_w", m);
        t.noise_log_w = logarithms(t.noise_w, m, noise_log_w);
        t.weight = part<double>(given, "weight", m);
        t.noise_rest = pairs(given, "noise_rest", m);
        t.voltage = part<double>(given, "voltage", m);
        t.modes_w = part<double>(given, "modes_w", r);
        t.modes_log_w = logarithms(t.modes_w, r, modes_log_w);
        t.modes_level = pairs(given, "modes_level", r);
        t.doubt = doubt;
        t.centre = part<double>(given, "centre", t.expansions);
        t.plant = pairs(given, "plant", t.expansions * t.terms);
        t.loop = pairs(given, "closing", t.expansions * t.terms);
        t.radius = radius;
        t.region = region;
        t.resonance = part<double>(given, "mode", 1);
        t.highest = part<double>(given, "highest", 1);
        t.band = part<double>(given, "band", 2);
        t.column = part<std::int64_t>(given, "mode_column", 1);
    }
    Loops(const Loops &) = delete; // the table points into its own vectors

    auto figures(Read<double, -1> x, double reference, int order) const {
        const size_t p = x.size(), k = size_t(table.links), rows = size_t(FIGURE_MODES + table.modes);
        require((p == 3 || p == FIGURES_PARAMETERS) && order >= 0, "loops: 3 parameters, or 6 with a notch");
        figures_outer outer{int(p), order, reference, {}};
        std::copy_n(x.data(), p, outer.x);
        auto value = room<double>(rows * k), gradient = room<double>(p * rows * k);
        {
            const nb::gil_scoped_release release;
            if (figures_of(&table, &outer, value.get(), gradient.get())) throw std::bad_alloc();
        }
        return std::make_tuple(owned(std::move(value), {rows, k}), owned(std::move(gradient), {p, rows, k}));
    }
};

} // namespace

void bind_figures(nb::module_ &m) {
    nb::class_<Loops>(m, "Loops")
        .def(nb::init<nb::handle, int, double, double, double>())
        .def("figures", &Loops::figures, nb::arg("x"), nb::arg("reference"), nb::arg("order"));
}
