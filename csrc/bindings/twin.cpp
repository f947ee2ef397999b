// Arrays in and out of the twin's kernel; every size is checked here, because the kernel does not check them.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cmath>
#include <cstdint>
#include <cstring>
#include <vector>

#include "twin_arrays.h"
#include "words.h"

namespace nb = nanobind;
using namespace twin_arrays;

namespace {

using Result = nb::ndarray<nb::numpy, double, nb::ndim<2>>;

Result matrix(double *data, std::size_t rows, std::size_t columns) {
    nb::capsule owner(data, [](void *p) noexcept { delete[] static_cast<double *>(p); });
    return Result(data, {rows, columns}, owner);
}

Result exponential(Matrix given) {
    const std::size_t size = given.shape(0);
    require(given.shape(1) == size && size <= 4096, "matrix: square, at most 4096 rows");
    double *data = new double[size * size];
    Result result = matrix(data, size, size);
    std::memcpy(data, given.data(), sizeof(double) * size * size);
    std::vector<double> work(2 * size * size);
    nb::gil_scoped_release release;
    twin_exponential(static_cast<int>(size), data, work.data());
    return result;
}

Result run(Matrix transition, Vector hub, Vector tip, Matrix outputs, Vector rig_values, Vector obstacle_values,
           nb::bytes params, bool single, Matrix input, MutableBytes law, Mutable state, Mutable gauge, Mutable voltage,
           Mutable sensed, Counters counters, nb::bytes estimator, MutableBytes estimate) {
    const twin_step step = step_of(transition, hub, tip, outputs);
    const twin_rig rig = rig_of(rig_values);
    require(obstacle_values.size() == 5, "obstacle: 5 values");
    const double *o = obstacle_values.data();
    const twin_obstacle obstacle = {o[0], o[1], o[2], o[3], o[4]};
    const law_port &port = port_of(single);
    const int *const sizes = port.sizes;
    const bool estimates = estimator.size() != 0;
    const auto block = words_of(params, sizes[LAW_PARAMS], "params");
    auto law_memory = words_of(law.data(), law.size(), sizes[LAW_STATE], "law");
    const auto bank = words_of(estimator, estimates ? sizes[PAYLOAD_PARAMS] : 0, "estimator");
    auto bank_memory = words_of(estimate.data(), estimate.size(), int(estimates ? sizes[PAYLOAD_STATE] : estimate.size()), "estimate");
    require(input.shape(1) == TWIN_INPUTS, "input: (periods, TWIN_INPUTS)");
    const std::size_t periods = input.shape(0);
    Memory buffers{state, gauge, voltage, sensed, counters, {}};
    twin_memory memory = buffers.checked(rig, hub.size());
    const twin_law driver = {&port, block.data(), law_memory.data(), estimates ? bank.data() : nullptr, bank_memory.data()};
    double *data = new double[periods * TWIN_COLUMNS]();
    Result whole = matrix(data, periods, TWIN_COLUMNS);
    int done = 0;
    {
        nb::gil_scoped_release release;
        done = twin_run(&step, &rig, &obstacle, &driver, static_cast<int>(periods), input.data(), &memory, data);
    }
    std::memcpy(law.data(), law_memory.data(), law.size());
    std::memcpy(estimate.data(), bank_memory.data(), estimate.size());
    buffers.keep(memory);
    if (static_cast<std::size_t>(done) == periods) {
        return whole;
    }
    double *part = new double[static_cast<std::size_t>(done) * TWIN_COLUMNS];
    std::memcpy(part, data, sizeof(double) * static_cast<std::size_t>(done) * TWIN_COLUMNS);
    return matrix(part, static_cast<std::size_t>(done), TWIN_COLUMNS);
}

nb::tuple sense(Vector rig_values, Vector input, Mutable state, Mutable gauge, Mutable voltage, Mutable sensed,
                Counters counters) {
    const twin_rig rig = rig_of(rig_values);
    require(input.size() == TWIN_INPUTS, "input: TWIN_INPUTS values");
    Memory buffers{state, gauge, voltage, sensed, counters, {}};
    twin_memory memory = buffers.checked(rig, state.size());
    double angle = 0.0;
    double torque = 0.0;
    twin_sense(&rig, &memory, input.data(), &angle, &torque);
    return nb::make_tuple(angle, torque);
}

// One period of an arm driven by a voltage, as in realtime_arm.c: the acting voltage leaves the queue, the twin moves.
// Returns tip angle, motor angle, speed and torque before the motion, and the voltage that acted.
nb::tuple drive(Matrix transition, Vector hub, Vector tip, Matrix outputs, Vector rig_values, Mutable state,
                Mutable gauge, Mutable voltage, Mutable sensed, Counters counters, double asked) {
    const twin_step step = step_of(transition, hub, tip, outputs);
    const twin_rig rig = rig_of(rig_values);
    Memory buffers{state, gauge, voltage, sensed, counters, {}};
    twin_memory memory = buffers.checked(rig, hub.size());
    memory.voltage[rig.voltage_delay] = std::isfinite(asked) ? asked : 0.0;
    const double acts = std::fmax(std::fmin(memory.voltage[0], rig.voltage_limit), -rig.voltage_limit);
    std::memmove(memory.voltage, memory.voltage + 1, sizeof(double) * static_cast<std::size_t>(rig.voltage_delay));
    const nb::tuple before = nb::make_tuple(twin_output(&step, 2, memory.state), twin_output(&step, 0, memory.state),
                                            twin_output(&step, 1, memory.state), twin_output(&step, 3, memory.state),
                                            acts);
    for (int j = 0; j < rig.substeps; j++) {
        twin_motor_step(&step, &rig, rig.torque_per_volt * acts, 0.0, &memory);
    }
    buffers.keep(memory);
    return before;
}

}  // namespace

void bind_twin(nb::module_ &m) {
    m.def("twin_exponential", &exponential, "Return the exponential of a square matrix.");
    m.def("twin_run", &run, "Run the law on the twin; law and the buffers behind it are updated in place.");
    m.def("twin_sense", &sense, "Encoder and gauge as the controller reads them now.");
    m.def("twin_drive", &drive, "One period of the twin under a voltage; the buffers are updated in place.");
    m.attr("TWIN_COLUMNS") = static_cast<int>(TWIN_COLUMNS);
    m.attr("TWIN_INPUTS") = static_cast<int>(TWIN_INPUTS);
}
