// Binding of the identification kernel: arrays in, arrays out.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/tuple.h>

#include <cmath>
#include <cstring>
#include <memory>
#include <stdexcept>
#include <vector>

extern "C" {
#include "fit.h"
}

namespace nb = nanobind;
using input_array = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using input_table = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using output_array = nb::ndarray<nb::numpy, double>;

namespace {

output_array owned(std::vector<double> values, std::initializer_list<size_t> shape) {
    auto *held = new std::vector<double>(std::move(values));
    nb::capsule owner(held, [](void *p) noexcept { delete static_cast<std::vector<double> *>(p); });
    return output_array(held->data(), shape, owner);
}

// The log on its grid of rates; the increments of the input are computed once, with zeros on both sides. Motion
// beyond the number of measured samples is that before the first one.
struct Problem {
    fit_problem p{};
    std::vector<double> input, output;

    Problem(input_array motion, input_array measured, double period, int hold, double grid_start,
            double grid_step, int modes, int tail, ptrdiff_t pad) {
        if (motion.shape(0) < measured.shape(0) || measured.shape(0) < 1)
            throw std::invalid_argument("motion must not be shorter than measured");
        size_t samples = motion.shape(0), before = samples - measured.shape(0);
        if (modes < 1 || modes > FIT_MODES_MAX || tail < 0 || tail > FIT_TAIL_MAX || pad < 2 * FIT_LANES)
            throw std::invalid_argument("grid out of range");
        input.assign(samples + 2 * pad + FIT_GROUP * FIT_LANES, 0.0);
        // A jump is that at its sample, a slope that after it.
        double *increment = input.data() + pad + (hold ? 0 : 1), unit = hold ? period : 1.0;
        for (size_t k = 0; k + 1 < samples; k++) increment[k] = (motion.data()[k + 1] - motion.data()[k]) / unit;
        output.assign(measured.data(), measured.data() + measured.shape(0));
        p = {(ptrdiff_t)measured.shape(0), period, hold, input.data() + pad + before, (ptrdiff_t)before, pad,
             output.data(), grid_start, grid_step, modes, tail};
    }

    // Columns of the predicted output for unit gain and of its derivatives; None if the shape has no pole.
    nb::object columns(input_array shape, unsigned mask) {
        check(shape);
        std::unique_ptr<fit_table> table(new fit_table); // local to this call: threads may share the problem
        int bad;
        std::vector<double> values;
        {
            nb::gil_scoped_release release;
            bad = fit_make_table(&p, shape.data(), mask, table.get());
            if (!bad) {
                double gram[FIT_COLUMNS_MAX * FIT_COLUMNS_MAX];
                values.resize(table->outputs * p.count);
                fit_pass(&p, table.get(), gram, values.data());
            }
        }
        if (bad) return nb::none();
        return nb::cast(owned(std::move(values), {(size_t)table->outputs, (size_t)p.count}));
    }

    // Gram matrix of each row of shapes, rows x side x side; NaN where a shape has no pole.
    output_array grams(input_table shapes, unsigned mask) {
        if (shapes.shape(1) != FIT_SHAPE || shapes.shape(0) < 1) throw std::invalid_argument("shapes: 5 columns");
        std::unique_ptr<fit_table> table(new fit_table); // local to this call: threads may share the problem
        size_t count = shapes.shape(0), side = 3;
        for (unsigned bit = 0; bit < FIT_SHAPE; bit++) side += mask >> bit & 1;
        std::vector<double> values(count * side * side, NAN);
        {
            nb::gil_scoped_release release;
            for (size_t i = 0; i < count; i++)
                if (!fit_make_table(&p, shapes.data() + i * FIT_SHAPE, mask, table.get()))
                    fit_pass(&p, table.get(), values.data() + i * side * side, nullptr);
        }
        return owned(std::move(values), {count, side, side});
    }

    // Sum of squares at the best gain and offset for each row of shapes; infinite where a shape has no pole.
    output_array costs(input_table shapes, double gain, double offset) {
        if (shapes.shape(1) != FIT_SHAPE || shapes.shape(0) < 1) throw std::invalid_argument("shapes: 5 columns");
        std::unique_ptr<fit_table> table(new fit_table);
        std::vector<double> values(shapes.shape(0));
        {
            nb::gil_scoped_release release;
            for (size_t i = 0; i < values.size(); i++) {
                fit_request r = request(gain, offset);
                values[i] = fit_cost(&p, shapes.data() + i * FIT_SHAPE, &r, table.get());
            }
        }
        size_t count = values.size();
        return owned(std::move(values), {count});
    }

    // Returns status, shape, gain, offset and cost of the best of several starts, with the Gram matrix there.
    nb::tuple solve(input_table starts, unsigned mask, input_array lower, input_array upper, double gain,
                    double offset, int iterations) {
        std::unique_ptr<fit_table> table(new fit_table);
        check(lower);
        check(upper);
        if (starts.shape(1) != FIT_SHAPE || starts.shape(0) < 1) throw std::invalid_argument("starts: 5 columns");
        fit_request best{};
        double best_shape[FIT_SHAPE] = {0};
        int best_status = FIT_FAILED;
        {
            nb::gil_scoped_release release;
            for (size_t i = 0; i < starts.shape(0); i++) {
                fit_request r = request(gain, offset);
                double shape[FIT_SHAPE];
                std::memcpy(shape, starts.data() + i * FIT_SHAPE, sizeof shape);
                r.mask = mask;
                std::memcpy(r.lower, lower.data(), sizeof r.lower);
                std::memcpy(r.upper, upper.data(), sizeof r.upper);
                r.iterations_max = iterations;
                int status = fit_solve(&p, shape, &r, table.get());
                if (status == FIT_FAILED || (best_status != FIT_FAILED && !(r.cost < best.cost))) continue;
                best = r;
                best_status = status;
                std::memcpy(best_shape, shape, sizeof shape);
            }
        }
        size_t side = 3;
        for (unsigned bit = 0; bit < FIT_SHAPE; bit++) side += mask >> bit & 1;
        return nb::make_tuple(best_status, owned(std::vector<double>(best_shape, best_shape + FIT_SHAPE), {FIT_SHAPE}),
                              best.gain, best.offset, best.cost,
                              owned(std::vector<double>(best.gram, best.gram + side * side), {side, side}));
    }

    // A linear parameter that is NaN is free.
    static fit_request request(double gain, double offset) {
        fit_request r{};
        r.gain_free = std::isnan(gain);
        r.offset_free = std::isnan(offset);
        r.gain = r.gain_free ? 1.0 : gain;
        r.offset = r.offset_free ? 0.0 : offset;
        return r;
    }

    static void check(const input_array &shape) {
        if (shape.shape(0) != FIT_SHAPE) throw std::invalid_argument("a shape has 5 numbers");
    }
};

} // namespace

void bind_fit(nb::module_ &m) {
    nb::class_<Problem>(m, "FitProblem")
        .def(nb::init<input_array, input_array, double, int, double, double, int, int, ptrdiff_t>())
        .def("columns", &Problem::columns)
        .def("grams", &Problem::grams)
        .def("costs", &Problem::costs)
        .def("solve", &Problem::solve);
}
