// Checks of arguments beyond dtype and shape. A failed check raises ValueError.
#pragma once

#include <nanobind/nanobind.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>
#include <type_traits>

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

// Require that all values are in [low, end). For types of up to 32 bits, the range must have less
// than 2^32 numbers.
template <typename T, int... kShape>
void require_range(const char* name, const Array<T, kShape...>& array, int64_t low, int64_t end)
{
  // One unsigned comparison per value and no early exit, so that the loop compiles to vector
  // instructions.
  using Unsigned = std::conditional_t<sizeof(T) <= sizeof(uint32_t), uint32_t, uint64_t>;
  const auto first_valid = static_cast<Unsigned>(low), size = static_cast<Unsigned>(end - low);
  const T *first = array.data(), *last = first + array.array.size();
  Unsigned num_outside = 0;
  for (const T* at = first; at != last; ++at) {
    num_outside += static_cast<Unsigned>(*at) - first_valid < size ? 0 : 1;
  }
  if (num_outside > 0) {
    const auto [lowest, highest] = std::minmax_element(first, last);
    refuse(
      std::string(name) + ": " + std::to_string(*lowest) + " to " + std::to_string(*highest) +
      " is not within " + std::to_string(low) + " to " + std::to_string(end - 1));
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
