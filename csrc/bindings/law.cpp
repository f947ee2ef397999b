// The law and its payload estimator from Python: parameters and state are bytes, signals are arrays.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include "words.h"

extern "C" {
#include "law.h"
#include "payload_estimator.h"
}

namespace nb = nanobind;

namespace {

template <typename T, int N>
using Array = nb::ndarray<T, nb::ndim<N>, nb::c_contig, nb::device::cpu>;
using Signal = Array<const double, 1>;
using Ticks = Array<const std::uint32_t, 1>;
using Signals = Array<double, 2>;

void require(bool holds, const char *message) {
    if (!holds) throw std::invalid_argument(message);
}

nb::bytes bytes_of(const std::vector<std::uint64_t> &words, int size) { return nb::bytes(words.data(), std::size_t(size)); }

nb::tuple begin_law(const nb::bytes &params, bool single) {
    const law_port &port = port_of(single);
    const auto block = words_of(params, port.sizes[LAW_PARAMS], "params");
    std::vector<std::uint64_t> state(std::size_t(port.sizes[LAW_STATE]) / 8 + 1);
    const std::uint32_t reason = port.begin(state.data(), block.data());
    return nb::make_tuple(bytes_of(state, port.sizes[LAW_STATE]), reason);
}

// Rows as in law_port.h.
nb::bytes run_law(const nb::bytes &params, const nb::bytes &before, Ticks ticks, Array<const double, 2> inputs,
                  Signals outputs, Array<std::uint32_t, 2> marks, bool single) {
    const law_port &port = port_of(single);
    const auto block = words_of(params, port.sizes[LAW_PARAMS], "params");
    auto state = words_of(before, port.sizes[LAW_STATE], "state");
    const std::size_t n = ticks.shape(0);
    require(inputs.shape(0) == PORT_INPUTS && inputs.shape(1) == n && outputs.shape(0) == PORT_OUTPUTS &&
                outputs.shape(1) == n && marks.shape(0) == PORT_MARKS && marks.shape(1) == n,
            "inputs, outputs and marks need 5, 5 and 3 rows of one length");
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
    require(angle.shape(0) == torque.shape(0), "angle and torque need one length");
    return port.wiring(block.data(), angle.data(), torque.data(), std::int64_t(angle.shape(0)));
}

nb::tuple begin_estimate(const nb::bytes &params, bool single) {
    const law_port &port = port_of(single);
    const auto block = words_of(params, port.sizes[PAYLOAD_PARAMS], "params");
    std::vector<std::uint64_t> state(std::size_t(port.sizes[PAYLOAD_STATE]) / 8 + 1);
    const std::uint32_t reason = port.begin_estimate(state.data(), block.data());
    return nb::make_tuple(bytes_of(state, port.sizes[PAYLOAD_STATE]), reason);
}

// Rows of `outputs`: given, estimate, low, high.
nb::bytes run_estimate(const nb::bytes &params, const nb::bytes &before, Ticks ticks, Signal angle, Signal torque,
                      Signals outputs, Array<std::uint32_t, 1> flags, bool single) {
    const law_port &port = port_of(single);
    const auto block = words_of(params, port.sizes[PAYLOAD_PARAMS], "params");
    auto state = words_of(before, port.sizes[PAYLOAD_STATE], "state");
    const std::size_t n = ticks.shape(0);
    require(angle.shape(0) == n && torque.shape(0) == n && flags.shape(0) == n && outputs.shape(0) == 4 &&
                outputs.shape(1) == n,
            "ticks, angle, torque, flags and 4 rows of outputs need one length");
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
    m.def("law_init", &begin_law);
    m.def("law_run", &run_law);
    m.def("law_wiring", &check_wiring);
    m.def("payload_init", &begin_estimate);
    m.def("payload_run", &run_estimate);
    m.def("law_sizes", [](bool single) {
        const int *const sizes = port_of(single).sizes;
        return nb::make_tuple(sizes[LAW_PARAMS], sizes[LAW_STATE]);
    });
    m.def("payload_sizes", [](bool single) {
        const int *const sizes = port_of(single).sizes;
        return nb::make_tuple(sizes[PAYLOAD_PARAMS], sizes[PAYLOAD_STATE]);
    });
    // the headers' own numbers, so that no module repeats them
    m.attr("LAW_RUN") = unsigned(LAW_RUN);
    m.attr("LAW_FLAG_SATURATED") = unsigned(LAW_FLAG_SATURATED);
    m.attr("LAW_FLAG_STARTED") = unsigned(LAW_FLAG_STARTED);
    m.attr("LAW_FLAG_PAYLOAD") = unsigned(LAW_FLAG_PAYLOAD);
    m.attr("PAYLOAD_FROZEN") = unsigned(PAYLOAD_FROZEN);
    m.attr("PAYLOAD_OUTSIDE") = unsigned(PAYLOAD_OUTSIDE);
    m.attr("PAYLOAD_CONTACT") = unsigned(PAYLOAD_CONTACT);
    m.attr("PAYLOAD_GIVEN") = unsigned(PAYLOAD_GIVEN);
    m.attr("PAYLOAD_CHANGED") = unsigned(PAYLOAD_CHANGED);
    m.attr("PAYLOAD_SAMPLE") = unsigned(PAYLOAD_SAMPLE);
}
