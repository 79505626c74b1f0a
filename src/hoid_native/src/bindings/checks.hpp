// What a kernel relies on and the types of arrays do not say. Failures become ValueError.
#pragma once

#include <nanobind/nanobind.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>

#include "bindings/arrays.hpp"

namespace hoid::bindings {

[[noreturn]] inline void refuse(const std::string& reason)
{
  throw nb::value_error(reason.c_str());
}

inline void require(bool is_true, const char* reason)
{
  if (!is_true) {
    refuse(reason);
  }
}

template <typename A>
void require_length(const char* name, const A& array, int length)
{
  if (array.size() != length) {
    refuse(
      std::string(name) + ": expected " + std::to_string(length) + " rows, not " +
      std::to_string(array.size()));
  }
}

// All values must be in [low, end).
template <typename T, int... kShape>
void require_range(const char* name, const Array<T, kShape...>& array, int64_t low, int64_t end)
{
  const T *first = array.data(), *last = first + array.array.size();
  T least = 0, most = 0;
  for (const T* at = first; at != last;
       ++at) {  // no early end: this way the loop is one of vectors
    least = at == first ? *at : std::min(least, *at);
    most = at == first ? *at : std::max(most, *at);
  }
  if (first != last && (static_cast<int64_t>(least) < low || static_cast<int64_t>(most) >= end)) {
    refuse(
      std::string(name) + ": " + std::to_string(least) + " to " + std::to_string(most) +
      " is not within 0 to " + std::to_string(end - 1));
  }
}

template <typename T, int... kShape>
void require_finite(const char* name, const Array<T, kShape...>& array)
{
  const T *first = array.data(), *last = first + array.array.size();
  if (!std::all_of(first, last, [](T value) { return std::isfinite(value); })) {
    refuse(std::string(name) + ": not all are finite");
  }
}

template <typename T>
void require_pixels(const char* name, const ImageArray<T>& image)
{
  if (image.array.size() == 0) {
    refuse(std::string(name) + ": the image is empty");
  }
}

}  // namespace hoid::bindings
