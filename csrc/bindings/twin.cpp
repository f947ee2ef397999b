// Arrays in and out of the twin's kernel.
#include <algorithm>

#include "twin_arm.h"
#include "words.h"

namespace nb = nanobind;

namespace {

Result<double> exponential(Read<double, -1, -1> given) {
    const std::size_t size = given.shape(0);
    require(given.shape(1) == size && size <= 4096, "matrix: square, at most 4096 rows");
    auto matrix = room<double>(size * size);
    std::copy_n(given.data(), size * size, matrix.get());
    {
        const nb::gil_scoped_release release;
        const auto work = room<double>(2 * size * size);
        twin_exponential(int(size), matrix.get(), work.get());
    }
    return owned(std::move(matrix), {size, size});
}

Result<double> run(nb::handle state, nb::bytes params, bool single, Read<double, -1, TWIN_INPUTS> input,
                   nb::bytes estimator) {
    TwinArm arm(state);
    Read<double, 5> obstacle_values;
    Write<std::uint8_t, -1> law, estimate;
    TwinArm::read(state, "obstacle", obstacle_values);
    TwinArm::read(state, "law", law);
    TwinArm::read(state, "estimate", estimate);
    const double *o = obstacle_values.data();
    const twin_obstacle obstacle = {o[0], o[1], o[2], o[3], o[4]};
    const law_port &port = port_of(single);
    const bool estimates = estimator.size() != 0;
    const auto block = words_of(params, port.sizes[LAW_PARAMS], "params");
    const auto bank = words_of(estimator, estimates ? port.sizes[PAYLOAD_PARAMS] : 0, "estimator");
    auto law_memory = words_of(law.data(), law.size(), port.sizes[LAW_STATE], "law");
    auto bank_memory =
        words_of(estimate.data(), estimate.size(), estimates ? port.sizes[PAYLOAD_STATE] : int(estimate.size()), "estimate");
    const twin_law driver = {&port, block.data(), law_memory.data(), estimates ? bank.data() : nullptr, bank_memory.data()};
    auto record = room<double>(input.shape(0) * TWIN_COLUMNS);
    std::size_t done = 0;
    {
        const nb::gil_scoped_release release;
        done = std::size_t(
            twin_run(&arm.step, &arm.rig, &obstacle, &driver, int(input.shape(0)), input.data(), &arm.memory, record.get()));
    }
    std::memcpy(law.data(), law_memory.data(), law.size());
    std::memcpy(estimate.data(), bank_memory.data(), estimate.size());
    return owned(std::move(record), {done, TWIN_COLUMNS});
}

nb::tuple sense(nb::handle state, Read<double, TWIN_INPUTS> input) {
    TwinArm arm(state);
    double angle, torque;
    twin_sense(&arm.rig, &arm.memory, input.data(), &angle, &torque);
    return nb::make_tuple(angle, torque);
}

// Returns what twin_drive records.
Result<double> drive(nb::handle state, double asked) {
    TwinArm arm(state);
    auto row = room<double>(TWIN_DRIVEN_COLUMNS);
    twin_drive(&arm.step, &arm.rig, &arm.memory, asked, row.get());
    return owned(std::move(row), {TWIN_DRIVEN_COLUMNS});
}

}  // namespace

void bind_twin(nb::module_ &m) {
    m.def("twin_exponential", &exponential, "Return the exponential of a square matrix.");
    m.def("twin_run", &run, "Run the law on the twin; the state is updated in place, as below.");
    m.def("twin_sense", &sense, "Encoder and gauge as the controller reads them now.");
    m.def("twin_drive", &drive, "One period of the twin under a voltage.");
    m.attr("TWIN_INPUTS") = int(TWIN_INPUTS);
}
