// Arrays of numpy in the bindings. Sizes that are fixed are part of the types, so that nanobind checks them.
#ifndef FRACLINK_ARRAYS_H
#define FRACLINK_ARRAYS_H

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstddef>
#include <initializer_list>
#include <stdexcept>
#include <utility>
#include <vector>

template <class T, std::ptrdiff_t... Shape>
using Read = nanobind::ndarray<const T, nanobind::shape<Shape...>, nanobind::c_contig, nanobind::device::cpu>;
template <class T, std::ptrdiff_t... Shape>
using Write = nanobind::ndarray<T, nanobind::shape<Shape...>, nanobind::c_contig, nanobind::device::cpu>;
template <class T> using Result = nanobind::ndarray<nanobind::numpy, T>;

// A new array that owns its values.
template <class T> Result<T> owned(std::vector<T> values, std::initializer_list<std::size_t> shape) {
    auto *held = new std::vector<T>(std::move(values));
    nanobind::capsule owner(held, [](void *p) noexcept { delete static_cast<std::vector<T> *>(p); });
    return Result<T>(held->data(), shape, owner);
}

inline void require(bool holds, const char *message) {
    if (!holds) throw std::invalid_argument(message);
}

#endif
