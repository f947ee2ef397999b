// The real-time loops from Python: a connection to the arm, one call per run, arrays in and out.
#include <nanobind/stl/pair.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <memory>
#include <system_error>

#include "twin_arm.h"
#include "words.h"

extern "C" {
#include "realtime.h"
}

namespace nb = nanobind;

#ifdef __linux__
namespace {

// A connection to the arm: either a channel or two callables.
struct Io {
    realtime_channel *channel = nullptr;
    nb::object read, write, seal;
    std::exception_ptr failure;  // exception of a callable; C cannot pass it on

    Io() = default;
    Io(Io &&other) noexcept
        : channel(std::exchange(other.channel, nullptr)), read(std::move(other.read)), write(std::move(other.write)), seal(std::move(other.seal)) {}
    ~Io() {
        std::free(channel);
    }
};

// Runs `work` under the GIL; the first exception is kept for Python and becomes -1, which stops the run.
template <class Work> int guarded(Io *io, Work work) {
    const nb::gil_scoped_acquire acquire;
    try {
        return work();
    } catch (...) {
        if (!io->failure) io->failure = std::current_exception();
        return -1;
    }
}

int read_callable(void *self, realtime_sample *sample) {
    Io *const io = static_cast<Io *>(self);
    return guarded(io, [&] {
        const nb::object given = io->read();
        if (given.is_none()) return 0;
        std::pair<double, double> values;
        if (!nb::try_cast(given, values)) throw nb::type_error("read() must return (motor_angle, torque) or None");
        sample->value = {values.first, values.second};
        return 1;
    });
}

int write_callable(void *self, const arm_command *c) {
    Io *const io = static_cast<Io *>(self);
    return guarded(io, [&] {
        io->write(c->motor_reference, c->voltage, c->tick, c->mode, c->reason, c->flags);
        return 0;
    });
}

realtime_io io_of(Io &io) {
    if (io.channel) return realtime_io_of(io.channel);
    return {&io, 0, 0, read_callable, write_callable};
}

Io channel_of(realtime_channel *channel) {
    if (!channel) throw std::system_error(errno, std::generic_category());
    Io io;
    io.channel = channel;
    return io;
}

// The tag of a message, computed by a Python function that has the key.
int seal_message(void *sealer, const std::uint8_t *bytes, std::uint8_t *tag) {
    const nb::gil_scoped_acquire acquire;
    try {
        const nb::bytes made(nb::handle(static_cast<PyObject *>(sealer))(nb::bytes(bytes, MESSAGE_BYTES)));
        if (made.size() != MESSAGE_TAG) return -1;
        std::memcpy(tag, made.data(), MESSAGE_TAG);
        return 0;
    } catch (...) {
        return -1;  // the message is neither sent nor accepted
    }
}

Io socket_io(int file, bool arm, nb::object seal) {
    Io io = channel_of(realtime_open_socket(file, arm));
    if (!seal.is_none()) {
        io.channel->seal = seal_message;
        io.channel->sealer = seal.ptr();
        io.seal = std::move(seal);
    }
    return io;
}

Io callables(nb::callable read, nb::callable write) {
    Io io;
    io.read = std::move(read);
    io.write = std::move(write);
    return io;
}

// One sample as (period_ns, motor_angle, torque), or None if no new one has come: for a loop in Python.
nb::object read_once(Io &io) {
    realtime_sample sample = {0U, {0.0, 0.0}};
    const realtime_io way = io_of(io);
    const int found = way.read(way.self, &sample);
    if (io.failure) std::rethrow_exception(std::exchange(io.failure, nullptr));
    if (found < 0) throw std::system_error(EIO, std::generic_category());
    if (found == 0) return nb::none();
    return nb::make_tuple(sample.period_ns, sample.value.motor_angle, sample.value.torque);
}

// Whether the command was taken; a broken connection raises OSError.
bool write_once(Io &io, double reference, double voltage, std::uint32_t tick, std::uint32_t mode, std::uint32_t reason,
                std::uint32_t flags) {
    const arm_command command = {reference, voltage, tick, mode, reason, flags};
    const realtime_io way = io_of(io);
    const int refused = way.write(way.self, &command);
    if (io.failure) std::rethrow_exception(std::exchange(io.failure, nullptr));
    if (refused < 0) throw std::system_error(EIO, std::generic_category());
    return refused == 0;
}

// The machine's clock, or that of a test: an object with now_ns() and sleep_until(ns), which must not raise.
struct Clock {
    nb::object own;
    realtime_clock calls;

    explicit Clock(nb::object given) : own(std::move(given)), calls{own.ptr(), now_of, sleep_of} {
        require(own.is_none() || (nb::hasattr(own, "now_ns") && nb::hasattr(own, "sleep_until")), "clock: now_ns, sleep_until");
    }
    Clock(const Clock &) = delete;

    static std::int64_t now_of(void *self) noexcept {
        const nb::gil_scoped_acquire acquire;
        return nb::cast<std::int64_t>(nb::handle(static_cast<PyObject *>(self)).attr("now_ns")());
    }
    static void sleep_of(void *self, std::int64_t time_ns) noexcept {
        const nb::gil_scoped_acquire acquire;
        nb::handle(static_cast<PyObject *>(self)).attr("sleep_until")(time_ns);
    }

    const realtime_clock *clock() const { return own.is_none() ? nullptr : &calls; }
    double now() const { return 1e-9 * double(realtime_now(clock())); }
    void sleep(double seconds) const {
        const nb::gil_scoped_release release;
        realtime_sleep_until(clock(), realtime_now(clock()) + std::int64_t(std::llround(1e9 * seconds)));
    }
};

nb::dict told(const realtime_outcome &o) {
    nb::dict d;
    d["stop"] = o.stop;
    d["count"] = o.count;
    d["lost"] = o.lost;
    d["priority_error"] = o.privileges.priority_error;
    d["memory_error"] = o.privileges.memory_error;
    d["origin"] = o.origin;
    d["period_ns"] = o.period_ns;
    return d;
}

// Rows of `path`: reference, acceleration, one value per period. `estimator` and `estimate`: empty, or the payload
// estimator's parameters and first state. Returns the outcome, the record and the marks, which are filled before the
// run and not only allocated, so that no page of them is missing in the loop.
nb::tuple run(Io &io, nb::bytes params, nb::bytes state, bool single, Read<double, 2, -1> path, double payload,
              nb::bytes estimator, nb::bytes estimate, std::int64_t period_ns, std::int64_t patience_ns, int priority,
              bool lock_memory, Clock &clock) {
    const std::size_t length = path.shape(1);
    require(length >= 1 && period_ns >= 1, "path: (2, periods), period above 0");
    const law_port &law = port_of(single);
    const bool estimated = estimator.size() != 0;
    const auto block = words_of(params, law.sizes[LAW_PARAMS], "params");
    auto memory = words_of(state, law.sizes[LAW_STATE], "state");
    const auto bank = words_of(estimator, estimated ? law.sizes[PAYLOAD_PARAMS] : 0, "estimator");
    auto estimates = words_of(estimate, estimated ? law.sizes[PAYLOAD_STATE] : int(estimate.size()), "estimate");
    auto record = room<double>(length * REALTIME_COLUMNS);
    auto marks = room<std::uint32_t>(length * REALTIME_MARKS);
    std::fill_n(record.get(), length * REALTIME_COLUMNS, NAN);
    std::fill_n(marks.get(), length * REALTIME_MARKS, 0U);
    const realtime_plan plan = {period_ns, std::int64_t(length), path.data(), path.data() + length, payload,
                                estimated ? bank.data() : nullptr, estimates.data(), patience_ns, priority,
                                lock_memory, clock.clock()};
    const realtime_io way = io_of(io);
    realtime_outcome outcome;
    {
        const nb::gil_scoped_release release;
        realtime_run(&plan, &way, &law, memory.data(), block.data(), record.get(), marks.get(), &outcome);
    }
    if (io.failure) std::rethrow_exception(std::exchange(io.failure, nullptr));
    const std::size_t count = std::size_t(outcome.count);
    return nb::make_tuple(told(outcome), owned(std::move(record), {count, REALTIME_COLUMNS}),
                          owned(std::move(marks), {count, REALTIME_MARKS}));
}

nb::dict bare(Write<double, -1> latency, std::int64_t period_ns, int priority, bool lock_memory, Clock &clock) {
    const realtime_plan plan = {period_ns, std::int64_t(latency.size()), nullptr, nullptr, 0.0, nullptr, nullptr, 0, priority,
                                lock_memory, clock.clock()};
    realtime_outcome outcome;
    {
        const nb::gil_scoped_release release;
        realtime_bare(&plan, latency.data(), &outcome);
    }
    return told(outcome);
}

// Returns the outcome and the record, which is filled in advance as above.
nb::tuple serve(Io &io, nb::handle state, Read<double, -1> gauge_error, std::int64_t period_ns, std::int64_t watchdog,
                bool once, int priority, Clock &clock) {
    require(io.channel != nullptr, "serve: messages only");
    TwinArm arm(state);
    auto record = room<double>(gauge_error.size() * SERVED_COLUMNS);
    std::fill_n(record.get(), gauge_error.size() * SERVED_COLUMNS, 0.0);
    const served_plan plan = {period_ns, std::int64_t(gauge_error.size()), watchdog, once, gauge_error.data(), priority,
                              clock.clock()};
    served_outcome outcome;
    {
        const nb::gil_scoped_release release;
        realtime_serve(&plan, io.channel, &arm.step, &arm.rig, &arm.memory, record.get(), &outcome);
    }
    nb::dict d;
    d["late"] = outcome.late;
    d["controllers"] = outcome.controllers;
    d["silences"] = outcome.silences;
    d["rejected"] = outcome.rejected;
    d["priority_error"] = outcome.privileges.priority_error;
    return nb::make_tuple(d, owned(std::move(record), {std::size_t(outcome.count), SERVED_COLUMNS}));
}

}  // namespace
#endif

void bind_realtime(nb::module_ &m) {
#ifdef __linux__
    m.attr("REALTIME") = true;
    nb::class_<Io>(m, "RealtimeIo")
        .def_static("socket", &socket_io, nb::arg("file"), nb::arg("arm"), nb::arg("seal").none() = nb::none())
        .def_static("serial", [](int file, bool arm) { return channel_of(realtime_open_serial(file, arm)); })
        .def_static("callables", &callables)
        .def("read", &read_once)
        .def("write", &write_once)
        .def_prop_ro("clocked", [](Io &io) { return io_of(io).clocked != 0; })
        .def_prop_ro("taken", [](Io &io) { return io.channel ? io.channel->taken : 0U; });
    nb::class_<Clock>(m, "RealtimeClock")
        .def(nb::init<nb::object>(), nb::arg("clock").none())
        .def("sleep", &Clock::sleep)
        .def_prop_ro("now", &Clock::now);
    m.def("realtime_run", &run);
    m.def("realtime_bare", &bare);
    m.def("realtime_serve", &serve);
    m.def("realtime_watch_signals", &realtime_watch_signals);
    m.def("realtime_signalled", &realtime_signalled);
    m.def("realtime_release_signals", &realtime_release_signals);
    nb::class_<realtime_privileges>(m, "RealtimePrivileges");
    m.def("realtime_prepare", &realtime_prepare);
    m.def("realtime_relax", [](const realtime_privileges &before) { realtime_relax(&before); });
#else
    m.attr("REALTIME") = false;
#endif
}
