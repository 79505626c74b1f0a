// Medians of positive floats, given by their bits, whose order is that of the values.
//
// They are found by counting, in loops without a branch to predict that the compiler turns into
// vectors.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <limits>

#include "common/multiversion.hpp"

namespace hoid::masks::median {

ALWAYS_INLINE double value(uint32_t bits)
{
  float number;
  std::memcpy(&number, &bits, sizeof(number));
  return number;
}

// The number with `rank` smaller ones (of at least one), found bit by bit below those that all
// have in common.
ALWAYS_INLINE uint32_t select(const uint32_t* bits, int count, int rank)
{
  uint32_t in_all = ~uint32_t{0}, in_any = 0;
  for (int k = 0; k < count; ++k) {
    in_all &= bits[k];
    in_any |= bits[k];
  }
  uint32_t bit = uint32_t{1} << 31;
  while (bit > (in_all ^ in_any)) {
    bit >>= 1;
  }
  uint32_t found = bit == 0 ? in_all : in_all & ~(2 * bit - 1);
  for (; bit != 0; bit >>= 1) {
    const auto middle = static_cast<int32_t>(found | bit);
    int smaller = 0;
    for (int k = 0; k < count; ++k) {
      smaller += static_cast<int>(static_cast<int32_t>(bits[k]) < middle);
    }
    found |= smaller <= rank ? bit : 0;
  }
  return found;
}

// The middle one, or the mean of the two in the middle; NaN when there are none.
ALWAYS_INLINE double median(const uint32_t* bits, int count)
{
  if (count == 0) {
    return std::numeric_limits<double>::quiet_NaN();
  }
  const uint32_t upper = select(bits, count, count / 2);
  if (count % 2 == 1) {
    return value(upper);
  }
  int num_below = 0;
  int32_t below = 0;  // the largest one below the upper of the two
  for (int k = 0; k < count; ++k) {
    const auto number = static_cast<int32_t>(bits[k]);
    const bool is_below = number < static_cast<int32_t>(upper);
    num_below += static_cast<int>(is_below);
    below = std::max(below, is_below ? number : 0);
  }
  const uint32_t lower = num_below == count / 2 ? static_cast<uint32_t>(below) : upper;
  return (value(lower) + value(upper)) / 2;
}

}  // namespace hoid::masks::median
