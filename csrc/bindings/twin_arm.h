// An ArmState of Python for the kernel, which does not check sizes: its arrays by their names, checked here.
#ifndef FRACLINK_TWIN_ARM_H
#define FRACLINK_TWIN_ARM_H

#include <cstdint>
#include <vector>

#include "arrays.h"

extern "C" {
#include "twin.h"
}

struct TwinArm {
    Read<double, -1, -1> transition;
    Read<double, -1> hub, tip;
    Read<double, TWIN_OUTPUTS, -1> outputs;
    Write<double, -1> state, gauge, voltage;
    Write<double, 2> sensed;           // angle, torque
    Write<std::uint32_t, 2> counters;  // stuck, tick
    std::vector<double> scratch;
    twin_step step;
    twin_rig rig;
    twin_memory memory;

    explicit TwinArm(nanobind::handle arm) {
        const nanobind::object matrices = arm.attr("step");
        read(matrices, "transition", transition);
        read(matrices, "hub", hub);
        read(matrices, "tip", tip);
        read(matrices, "outputs", outputs);
        read(arm, "state", state);
        read(arm, "gauge", gauge);
        read(arm, "voltage", voltage);
        read(arm, "sensed", sensed);
        read(arm, "counters", counters);
        Read<double, 15> numbers;
        read(arm, "rig", numbers);
        const std::size_t states = transition.shape(0), stride = transition.shape(1);
        require(stride % 8 == 0 && states <= stride, "transition: (states, stride), stride a multiple of 8");
        require(hub.size() == stride && tip.size() == stride && outputs.shape(1) == stride && state.size() == stride,
                "hub, tip, outputs, state: one value per row");
        const double *v = numbers.data();
        rig = {int(v[0]), int(v[1]), int(v[2]), v[3], v[4], v[5], v[6], v[7], v[8], v[9], v[10],
               {v[11], v[12], v[13], v[14]}};
        require(rig.substeps >= 1 && rig.voltage_delay >= 0 && rig.gauge_delay >= 0, "rig: counts");
        require(rig.gauge_weight[0] == 1.0 || rig.gauge_delay >= 3, "rig: a delay between steps needs four torques");
        require(gauge.size() == std::size_t(rig.gauge_delay) + 1, "gauge: delay + 1 values");
        require(voltage.size() == std::size_t(rig.voltage_delay) + 1, "voltage: delay + 1 values");
        scratch.assign(stride, 0.0);
        step = {int(states), int(stride), transition.data(), hub.data(), tip.data(), outputs.data()};
        memory = {state.data(), gauge.data(), voltage.data(), scratch.data(), sensed.data()[0], sensed.data()[1],
                  int(counters.data()[0]), counters.data()[1]};
    }
    TwinArm(const TwinArm &) = delete;
    ~TwinArm() {
        sensed.data()[0] = memory.angle;
        sensed.data()[1] = memory.torque;
        counters.data()[0] = std::uint32_t(memory.stuck);
        counters.data()[1] = memory.tick;
    }

    template <class Array> static void read(nanobind::handle owner, const char *name, Array &array) {
        array = nanobind::cast<Array>(owner.attr(name));
    }
};

#endif
