// Arrays of numpy in the bindings. Sizes that are fixed are part of the types, so that nanobind checks them.
#ifndef FRACLINK_ARRAYS_H
#define FRACLINK_ARRAYS_H

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstddef>
#include <initializer_list>
#include <memory>
#include <stdexcept>
#include <utility>

template <class T, std::ptrdiff_t... Shape>
using Read = nanobind::ndarray<const T, nanobind::shape<Shape...>, nanobind::c_contig, nanobind::device::cpu>;
template <class T, std::ptrdiff_t... Shape>
using Write = nanobind::ndarray<T, nanobind::shape<Shape...>, nanobind::c_contig, nanobind::device::cpu>;
template <class T> using Result = nanobind::ndarray<nanobind::numpy, T>;

// Room for values, uninitialised: clearing it would take a tenth of a campaign.
template <class T> std::unique_ptr<T[]> room(std::size_t count) { return std::unique_ptr<T[]>(new T[count]); }

// A new array that owns its values, of which there may be more than its shape has.
template <class T> Result<T> owned(std::unique_ptr<T[]> values, std::initializer_list<std::size_t> shape) {
    T *data = values.get();
    nanobind::capsule owner(data, [](void *p) noexcept { delete[] static_cast<T *>(p); });
    values.release();
    return Result<T>(data, shape, owner);
}

inline void require(bool holds, const char *message) {
    if (!holds) throw std::invalid_argument(message);
}

#endif
