// Shared by the bindings of the twin: arrays become the kernel's structs; every size is checked here.
#ifndef FRACLINK_TWIN_ARRAYS_H
#define FRACLINK_TWIN_ARRAYS_H

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>
#include <stdexcept>
#include <vector>

extern "C" {
#include "twin.h"
}

namespace twin_arrays {

namespace nb = nanobind;

using Vector = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Matrix = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Mutable = nb::ndarray<double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using MutableBytes = nb::ndarray<std::uint8_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Counters = nb::ndarray<std::uint32_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

inline void require(bool holds, const char *message) {
    if (!holds) {
        throw std::invalid_argument(message);
    }
}

inline twin_step step_of(const Matrix &transition, const Vector &hub, const Vector &tip, const Matrix &outputs) {
    const std::size_t stride = transition.shape(1);
    require(stride % 8 == 0 && transition.shape(0) <= stride, "transition: (states, stride), stride a multiple of 8");
    require(hub.size() == stride && tip.size() == stride, "hub, tip: one value per row");
    require(outputs.shape(0) == TWIN_OUTPUTS && outputs.shape(1) == stride, "outputs: (6, stride)");
    return {static_cast<int>(transition.shape(0)), static_cast<int>(stride), transition.data(), hub.data(),
            tip.data(), outputs.data()};
}

inline twin_rig rig_of(const Vector &values) {
    require(values.size() == 15, "rig: 15 values");
    const double *v = values.data();
    const twin_rig rig = {static_cast<int>(v[0]), static_cast<int>(v[1]), static_cast<int>(v[2]), v[3], v[4], v[5],
                          v[6], v[7], v[8], v[9], v[10], {v[11], v[12], v[13], v[14]}};
    require(rig.substeps >= 1 && rig.voltage_delay >= 0 && rig.gauge_delay >= 0, "rig: counts");
    require(rig.gauge_weight[0] == 1.0 || rig.gauge_delay >= 3, "rig: a delay between steps needs four torques");
    return rig;
}

// Buffers owned by the caller, from which the kernel continues: link, gauge ring, voltage queue, counters.
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

}  // namespace twin_arrays

#endif
