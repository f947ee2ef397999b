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
using Bytes = nb::ndarray<const std::uint8_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
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
    require(values.size() == 11, "rig: 11 values");
    const double *v = values.data();
    const twin_rig rig = {static_cast<int>(v[0]), static_cast<int>(v[1]), static_cast<int>(v[2]), v[3], v[4], v[5],
                          v[6], v[7], v[8], v[9], v[10]};
    require(rig.substeps >= 1 && rig.voltage_delay >= 0 && rig.gauge_delay >= 0, "rig: counts");
    return rig;
}

twin_memory memory_of(const twin_rig &rig, std::size_t stride, Mutable &state, Mutable &gauge, Mutable &voltage,
                      Counters &counters, std::vector<double> &scratch) {
    require(state.size() == stride, "state: one value per row");
    require(gauge.size() == static_cast<std::size_t>(rig.gauge_delay) + 1, "gauge: delay + 1 values");
    require(voltage.size() >= 1 && voltage.size() >= static_cast<std::size_t>(rig.voltage_delay), "voltage: queue");
    require(counters.size() == 2, "counters: stuck, tick");
    return {state.data(), gauge.data(), voltage.data(), scratch.data(), static_cast<int>(counters.data()[0]),
            counters.data()[1]};
}

Result run(Matrix transition, Vector hub, Vector tip, Matrix outputs, Vector rig_values, Vector obstacle_values,
           Bytes params, Matrix reference, Vector gauge_error, Vector tip_force, MutableBytes law, Mutable state,
           Mutable gauge, Mutable voltage, Counters counters) {
    const twin_step step = step_of(transition, hub, tip, outputs);
    const twin_rig rig = rig_of(rig_values);
    require(obstacle_values.size() == 5, "obstacle: 5 values");
    const double *o = obstacle_values.data();
    const twin_obstacle obstacle = {o[0], o[1], o[2], o[3], o[4]};
    require(params.size() == sizeof(law_params), "params: another size than law_params");
    require(law.size() == sizeof(law_state), "law: another size than law_state");
    const std::size_t periods = gauge_error.size();
    require(reference.shape(0) == periods && reference.shape(1) == 3, "reference: (periods, 3)");
    require(tip_force.size() == periods, "tip_force: one value per period");
    std::vector<double> scratch(hub.size());
    twin_memory memory = memory_of(rig, hub.size(), state, gauge, voltage, counters, scratch);
    law_params block;
    law_state law_memory;
    std::memcpy(&block, params.data(), sizeof block);
    std::memcpy(&law_memory, law.data(), sizeof law_memory);
    double *data = new double[periods * TWIN_COLUMNS]();
    Result whole = matrix(data, periods, TWIN_COLUMNS);
    const int done = twin_run(&step, &rig, &obstacle, &block, static_cast<int>(periods), reference.data(),
                              gauge_error.data(), tip_force.data(), &law_memory, &memory, data);
    std::memcpy(law.data(), &law_memory, sizeof law_memory);
    counters.data()[0] = static_cast<std::uint32_t>(memory.stuck);
    counters.data()[1] = memory.tick;
    if (static_cast<std::size_t>(done) == periods) {
        return whole;
    }
    double *part = new double[static_cast<std::size_t>(done) * TWIN_COLUMNS];
    std::memcpy(part, data, sizeof(double) * static_cast<std::size_t>(done) * TWIN_COLUMNS);
    return matrix(part, static_cast<std::size_t>(done), TWIN_COLUMNS);
}

nb::tuple sense(Matrix transition, Vector hub, Vector tip, Matrix outputs, Vector rig_values, double gauge_error,
                Mutable state, Mutable gauge, Mutable voltage, Counters counters) {
    const twin_step step = step_of(transition, hub, tip, outputs);
    const twin_rig rig = rig_of(rig_values);
    std::vector<double> scratch(hub.size());
    const twin_memory memory = memory_of(rig, hub.size(), state, gauge, voltage, counters, scratch);
    double angle = 0.0;
    double torque = 0.0;
    twin_sense(&step, &rig, &memory, gauge_error, &angle, &torque);
    return nb::make_tuple(angle, torque);
}

}  // namespace

void bind_twin(nb::module_ &m) {
    m.def("twin_march", &march, "March the linear twin; `state` is updated in place.");
    m.def("twin_run", &run, "Run the law on the twin; state, gauge, voltage, law and counters are updated in place.");
    m.def("twin_sense", &sense, "Encoder and gauge as the controller reads them now.");
    m.attr("TWIN_COLUMNS") = TWIN_COLUMNS;
}
