// Arrays in and out of the twin's kernel; every size is checked here, the kernel trusts them.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>
#include <cstring>
#include <stdexcept>
#include <vector>

extern "C" {
#include "twin.h"
}

namespace nb = nanobind;

namespace {

using Vector = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Matrix = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Mutable = nb::ndarray<double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using MutableBytes = nb::ndarray<std::uint8_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Counters = nb::ndarray<std::uint32_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Result = nb::ndarray<nb::numpy, double, nb::ndim<2>>;

void require(bool holds, const char *message) {
    if (!holds) {
        throw std::invalid_argument(message);
    }
}

Result matrix(double *data, std::size_t rows, std::size_t columns) {
    nb::capsule owner(data, [](void *p) noexcept { delete[] static_cast<double *>(p); });
    return Result(data, {rows, columns}, owner);
}

twin_step step_of(const Matrix &transition, const Vector &hub, const Vector &tip, const Matrix &outputs) {
    const std::size_t stride = transition.shape(1);
    require(stride % 8 == 0 && transition.shape(0) <= stride, "transition: (states, stride), stride a multiple of 8");
    require(hub.size() == stride && tip.size() == stride, "hub, tip: one value per row");
    require(outputs.shape(0) == TWIN_OUTPUTS && outputs.shape(1) == stride, "outputs: (6, stride)");
    return {static_cast<int>(transition.shape(0)), static_cast<int>(stride), transition.data(), hub.data(),
            tip.data(), outputs.data()};
}

Result march(Matrix transition, Vector hub, Vector tip, Matrix outputs, Vector input, int substeps, Mutable state) {
    const twin_step step = step_of(transition, hub, tip, outputs);
    require(state.size() == hub.size(), "state: one value per row");
    require(substeps >= 1, "substeps: at least 1");
    const std::size_t rows = input.size() * static_cast<std::size_t>(substeps);
    std::vector<double> scratch(hub.size());
    double *data = new double[rows * TWIN_OUTPUTS];
    Result result = matrix(data, rows, TWIN_OUTPUTS);
    twin_march(&step, static_cast<int>(input.size()), substeps, input.data(), state.data(), scratch.data(), data);
    return result;
}

twin_rig rig_of(const Vector &values) {
    require(values.size() == 10, "rig: 10 values");
    const double *v = values.data();
    const twin_rig rig = {static_cast<int>(v[0]), static_cast<int>(v[1]), static_cast<int>(v[2]), v[3], v[4], v[5],
                          v[6], v[7], v[8], v[9]};
    require(rig.substeps >= 1 && rig.voltage_delay >= 0 && rig.gauge_delay >= 0, "rig: counts");
    return rig;
}

// Buffers that the caller owns and the kernel continues from: link, gauge ring, voltage queue, counters.
struct Memory {
    Mutable state, gauge, voltage, sensed;
    Counters counters;
    std::vector<double> scratch;

    twin_memory checked(const twin_rig &rig, std::size_t stride) {
        require(state.size() == stride, "state: one value per row");
        require(gauge.size() == static_cast<std::size_t>(rig.gauge_delay) + 1, "gauge: delay + 1 values");
        require(voltage.size() == static_cast<std::size_t>(rig.voltage_delay) + 1, "voltage: delay + 1 values");
        require(sensed.size() == 2 && counters.size() == 2, "sensed: angle, torque; counters: stuck, tick");
        scratch.assign(stride, 0.0);
        return {state.data(), gauge.data(), voltage.data(), scratch.data(), sensed.data()[0], sensed.data()[1],
                static_cast<int>(counters.data()[0]), counters.data()[1]};
    }

    void keep(const twin_memory &memory) {
        sensed.data()[0] = memory.angle;
        sensed.data()[1] = memory.torque;
        counters.data()[0] = static_cast<std::uint32_t>(memory.stuck);
        counters.data()[1] = memory.tick;
    }
};

Result run(Matrix transition, Vector hub, Vector tip, Matrix outputs, Vector rig_values, Vector obstacle_values,
           nb::bytes params, bool single, Matrix input, MutableBytes law, Mutable state, Mutable gauge, Mutable voltage,
           Mutable sensed, Counters counters) {
    const twin_step step = step_of(transition, hub, tip, outputs);
    const twin_rig rig = rig_of(rig_values);
    require(obstacle_values.size() == 5, "obstacle: 5 values");
    const double *o = obstacle_values.data();
    const twin_obstacle obstacle = {o[0], o[1], o[2], o[3], o[4]};
    int params_size = 0;
    int state_size = 0;
    (single ? twin_sizes_single : twin_sizes_double)(&params_size, &state_size);
    require(params.size() == static_cast<std::size_t>(params_size), "params: another size than law_params");
    require(law.size() == static_cast<std::size_t>(state_size), "law: another size than law_state");
    // Copies in words of eight bytes: the structs hold doubles, and a Python buffer promises no alignment.
    std::vector<std::uint64_t> block(params.size() / 8 + 1);
    std::vector<std::uint64_t> law_memory(law.size() / 8 + 1);
    std::memcpy(block.data(), params.c_str(), params.size());
    std::memcpy(law_memory.data(), law.data(), law.size());
    require(input.shape(1) == TWIN_INPUTS, "input: (periods, TWIN_INPUTS)");
    const std::size_t periods = input.shape(0);
    Memory buffers{state, gauge, voltage, sensed, counters, {}};
    twin_memory memory = buffers.checked(rig, hub.size());
    double *data = new double[periods * TWIN_COLUMNS]();
    Result whole = matrix(data, periods, TWIN_COLUMNS);
    int done = 0;
    {
        nb::gil_scoped_release release;
        const auto run_law = single ? twin_run_single : twin_run_double;
        done = run_law(&step, &rig, &obstacle, block.data(), static_cast<int>(periods), input.data(),
                       law_memory.data(), &memory, data);
    }
    std::memcpy(law.data(), law_memory.data(), law.size());
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

}  // namespace

void bind_twin(nb::module_ &m) {
    m.def("twin_march", &march, "March the linear twin; `state` is updated in place.");
    m.def("twin_run", &run, "Run the law on the twin; law and the buffers behind it are updated in place.");
    m.def("twin_sense", &sense, "Encoder and gauge as the controller reads them now.");
    m.attr("TWIN_COLUMNS") = static_cast<int>(TWIN_COLUMNS);
    m.attr("TWIN_INPUTS") = static_cast<int>(TWIN_INPUTS);
}
