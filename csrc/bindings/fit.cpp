// Binding of the identification kernel: arrays in, arrays out.
#include <algorithm>
#include <cmath>
#include <vector>

#include "arrays.h"

extern "C" {
#include "fit.h"
}

namespace nb = nanobind;

namespace {

using Shape = Read<double, FIT_SHAPE>;
using Shapes = Read<double, -1, FIT_SHAPE>;

// Rows of the Gram matrix: measured, predicted, one, and each free shape parameter.
size_t side_of(unsigned mask) {
    size_t side = 3;
    for (unsigned bit = 0; bit < FIT_SHAPE; bit++) side += mask >> bit & 1;
    return side;
}

// A linear parameter that is NaN is free.
fit_request request(double gain, double offset) {
    fit_request r{};
    r.gain_free = std::isnan(gain);
    r.offset_free = std::isnan(offset);
    r.gain = r.gain_free ? 1.0 : gain;
    r.offset = r.offset_free ? 0.0 : offset;
    return r;
}

// The log on its grid of rates; the increments of the input are computed once, with zeros on both sides. If there is
// more motion than measurement, its first samples precede the measurement. Calls have tables of their own: threads may
// share the problem.
struct Problem {
    fit_problem p{};
    std::vector<double> input, output;

    Problem(Read<double, -1> motion, Read<double, -1> measured, double period, int hold, double grid_start,
            double grid_step, int modes, int tail, ptrdiff_t pad) {
        require(motion.size() >= measured.size() && measured.size() > 0, "motion must not be shorter than measured");
        require(modes > 0 && modes <= FIT_MODES_MAX && tail >= 0 && tail <= FIT_TAIL_MAX && pad >= 2 * FIT_LANES,
                "grid out of range");
        size_t samples = motion.size(), before = samples - measured.size();
        input.assign(samples + 2 * pad + FIT_GROUP * FIT_LANES, 0.0);
        // A jump belongs to its sample, a slope to the interval after it.
        double *increment = input.data() + pad + (hold ? 0 : 1), unit = hold ? period : 1.0;
        for (size_t k = 0; k + 1 < samples; k++) increment[k] = (motion.data()[k + 1] - motion.data()[k]) / unit;
        output.assign(measured.data(), measured.data() + measured.size());
        p = {ptrdiff_t(output.size()), period, hold, input.data() + pad + before, ptrdiff_t(before), pad,
             output.data(), grid_start, grid_step, modes, tail};
    }

    // Columns of the predicted output for unit gain and of its derivatives; None if the shape has no pole.
    nb::object columns(Shape shape, unsigned mask) const {
        std::unique_ptr<fit_table> table(new fit_table);
        double gram[FIT_COLUMNS_MAX * FIT_COLUMNS_MAX];
        std::unique_ptr<double[]> values;
        {
            const nb::gil_scoped_release release;
            if (fit_make_table(&p, shape.data(), mask, table.get())) {
                values = room<double>(table->outputs * p.count);
                fit_pass(&p, table.get(), gram, values.get());
            }
        }
        if (!values) return nb::none();
        return nb::cast(owned(std::move(values), {size_t(table->outputs), size_t(p.count)}));
    }

    // Gram matrix of each row of shapes, rows x side x side; NaN where a shape has no pole.
    Result<double> grams(Shapes shapes, unsigned mask) const {
        std::unique_ptr<fit_table> table(new fit_table);
        const size_t count = shapes.shape(0), side = side_of(mask);
        auto values = room<double>(count * side * side);
        std::fill_n(values.get(), count * side * side, NAN);
        {
            const nb::gil_scoped_release release;
            for (size_t i = 0; i < count; i++)
                if (fit_make_table(&p, shapes.data() + i * FIT_SHAPE, mask, table.get()))
                    fit_pass(&p, table.get(), values.get() + i * side * side, nullptr);
        }
        return owned(std::move(values), {count, side, side});
    }

    // Sum of squares at the best gain and offset for each row of shapes; infinite where a shape has no pole.
    Result<double> costs(Shapes shapes, double gain, double offset) const {
        std::unique_ptr<fit_table> table(new fit_table);
        const size_t count = shapes.shape(0);
        auto values = room<double>(count);
        {
            const nb::gil_scoped_release release;
            for (size_t i = 0; i < count; i++) {
                fit_request r = request(gain, offset);
                values[i] = fit_cost(&p, shapes.data() + i * FIT_SHAPE, &r, table.get());
            }
        }
        return owned(std::move(values), {count});
    }

    // Whether the search converged, with shape, gain, offset, cost and Gram matrix at its end; the cost is infinite if
    // the start has no pole.
    nb::tuple solve(Shape start, unsigned mask, Shape lower, Shape upper, double gain, double offset,
                    int iterations) const {
        std::unique_ptr<fit_table> table(new fit_table);
        auto shape = room<double>(FIT_SHAPE);
        std::copy_n(start.data(), FIT_SHAPE, shape.get());
        fit_request r = request(gain, offset);
        r.mask = mask;
        std::copy_n(lower.data(), FIT_SHAPE, r.lower);
        std::copy_n(upper.data(), FIT_SHAPE, r.upper);
        r.iterations_max = iterations;
        bool converged;
        {
            const nb::gil_scoped_release release;
            converged = fit_solve(&p, shape.get(), &r, table.get());
        }
        const size_t side = side_of(mask);
        auto gram = room<double>(side * side);
        std::copy_n(r.gram, side * side, gram.get());
        return nb::make_tuple(converged, owned(std::move(shape), {FIT_SHAPE}), r.gain, r.offset, r.cost,
                              owned(std::move(gram), {side, side}));
    }
};

} // namespace

void bind_fit(nb::module_ &m) {
    nb::class_<Problem>(m, "FitProblem")
        .def(nb::init<Read<double, -1>, Read<double, -1>, double, int, double, double, int, int, ptrdiff_t>())
        .def("columns", &Problem::columns)
        .def("grams", &Problem::grams)
        .def("costs", &Problem::costs)
        .def("solve", &Problem::solve);
}
