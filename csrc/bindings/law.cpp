// The law and its payload estimator from Python: parameters and state are bytes, signals are arrays.
#include "arrays.h"
#include "words.h"

extern "C" {
#include "law.h"
#include "payload_estimator.h"
}

namespace nb = nanobind;

namespace {

using Signal = Read<double, -1>;
using Ticks = Read<std::uint32_t, -1>;

nb::bytes bytes_of(const std::vector<std::uint64_t> &words, int size) { return nb::bytes(words.data(), std::size_t(size)); }

// Sizes [bytes] of parameters and state, which are neighbours in law_port.sizes.
nb::tuple sizes_of(bool single, int params) {
    const int *const sizes = port_of(single).sizes;
    return nb::make_tuple(sizes[params], sizes[params + 1]);
}

// A fresh state, and the reason why its parameters must not be used.
nb::tuple begun(const law_port &port, law_begin begin, const nb::bytes &given, int params) {
    const auto block = words_of(given, port.sizes[params], "params");
    const int size = port.sizes[params + 1];
    std::vector<std::uint64_t> state(std::size_t(size) / 8 + 1);
    const std::uint32_t reason = begin(state.data(), block.data());
    return nb::make_tuple(bytes_of(state, size), reason);
}

// Rows as in law_port.h.
nb::bytes run_law(const nb::bytes &params, const nb::bytes &before, Ticks ticks, Read<double, PORT_INPUTS, -1> inputs,
                  Write<double, PORT_OUTPUTS, -1> outputs, Write<std::uint32_t, PORT_MARKS, -1> marks, bool single) {
    const law_port &port = port_of(single);
    const auto block = words_of(params, port.sizes[LAW_PARAMS], "params");
    auto state = words_of(before, port.sizes[LAW_STATE], "state");
    const std::size_t n = ticks.size();
    require(inputs.shape(1) == n && outputs.shape(1) == n && marks.shape(1) == n, "rows must have the same length");
    {
        const nb::gil_scoped_release release;
        for (std::size_t k = 0; k < n; k++) {
            double in[PORT_INPUTS], out[PORT_OUTPUTS];
            std::uint32_t mark[PORT_MARKS];
            for (int i = 0; i < PORT_INPUTS; i++) in[i] = inputs.data()[i * n + k];
            port.step(state.data(), block.data(), ticks.data()[k], in, out, mark);
            for (int i = 0; i < PORT_OUTPUTS; i++) outputs.data()[i * n + k] = out[i];
            for (int i = 0; i < PORT_MARKS; i++) marks.data()[i * n + k] = mark[i];
        }
    }
    return bytes_of(state, port.sizes[LAW_STATE]);
}

std::uint32_t check_wiring(const nb::bytes &params, Signal angle, Signal torque, bool single) {
    const law_port &port = port_of(single);
    const auto block = words_of(params, port.sizes[LAW_PARAMS], "params");
    require(angle.size() == torque.size(), "angle and torque must have the same length");
    return port.wiring(block.data(), angle.data(), torque.data(), std::int64_t(angle.size()));
}

// Rows of `outputs`: given, estimate, low, high.
nb::bytes run_estimate(const nb::bytes &params, const nb::bytes &before, Ticks ticks, Signal angle, Signal torque,
                      Write<double, 4, -1> outputs, Write<std::uint32_t, -1> flags, bool single) {
    const law_port &port = port_of(single);
    const auto block = words_of(params, port.sizes[PAYLOAD_PARAMS], "params");
    auto state = words_of(before, port.sizes[PAYLOAD_STATE], "state");
    const std::size_t n = ticks.size();
    require(angle.size() == n && torque.size() == n && flags.size() == n && outputs.shape(1) == n, "rows must have the same length");
    {
        const nb::gil_scoped_release release;
        for (std::size_t k = 0; k < n; k++) {
            double interval[3];
            outputs.data()[k] = port.estimate(state.data(), block.data(), ticks.data()[k], angle.data()[k],
                                              torque.data()[k], interval, flags.data() + k);
            for (int i = 0; i < 3; i++) outputs.data()[(i + 1) * n + k] = interval[i];
        }
    }
    return bytes_of(state, port.sizes[PAYLOAD_STATE]);
}

}  // namespace

void bind_law(nb::module_ &m) {
    m.def("law_init", [](const nb::bytes &params, bool single) {
        return begun(port_of(single), port_of(single).begin, params, LAW_PARAMS);
    });
    m.def("law_run", &run_law);
    m.def("law_wiring", &check_wiring);
    m.def("law_sizes", [](bool single) { return sizes_of(single, LAW_PARAMS); });
    m.def("payload_init", [](const nb::bytes &params, bool single) {
        return begun(port_of(single), port_of(single).begin_estimate, params, PAYLOAD_PARAMS);
    });
    m.def("payload_run", &run_estimate);
    m.def("payload_sizes", [](bool single) { return sizes_of(single, PAYLOAD_PARAMS); });
    // the headers' own numbers, so that no module repeats them
    m.attr("LAW_RUN") = unsigned(LAW_RUN);
    m.attr("LAW_FLAG_SATURATED") = unsigned(LAW_FLAG_SATURATED);
    m.attr("LAW_FLAG_STARTED") = unsigned(LAW_FLAG_STARTED);
    m.attr("LAW_FLAG_PAYLOAD") = unsigned(LAW_FLAG_PAYLOAD);
    m.attr("PAYLOAD_OUTSIDE") = unsigned(PAYLOAD_OUTSIDE);
    m.attr("PAYLOAD_CONTACT") = unsigned(PAYLOAD_CONTACT);
}
