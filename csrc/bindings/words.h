// The C structs of a law are passed as bytes: parameters and states, in either precision.
#ifndef FRACLINK_WORDS_H
#define FRACLINK_WORDS_H

#include <nanobind/nanobind.h>

#include <cstdint>
#include <cstring>
#include <stdexcept>
#include <string>
#include <vector>

extern "C" {
#include "law_port.h"
}

// Copies in words of eight bytes: the structs hold doubles, and bytes of Python have no guaranteed alignment.
inline std::vector<std::uint64_t> words_of(const void *data, std::size_t size, int expected, const char *what) {
    if (size != std::size_t(expected)) throw std::invalid_argument(std::string(what) + " has the wrong size");
    std::vector<std::uint64_t> words(size / 8 + 1);
    std::memcpy(words.data(), data, size);
    return words;
}

inline std::vector<std::uint64_t> words_of(const nanobind::bytes &bytes, int expected, const char *what) {
    return words_of(bytes.c_str(), bytes.size(), expected, what);
}

inline const law_port &port_of(bool single) { return single ? LAW_IN_SINGLE : LAW_IN_DOUBLE; }

enum { LAW_PARAMS, LAW_STATE, PAYLOAD_PARAMS, PAYLOAD_STATE };  // indices in law_port's sizes

#endif
