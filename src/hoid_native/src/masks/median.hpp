// Medians of positive floats, given as bits, which are ordered like the values. They are found by
// counting in branchless loops that compile to vector instructions.
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

// Return the element that has the position `rank` (from 0) when the elements are sorted. Its bits
// are found one by one, from the highest bit in which elements differ. `count` is at least 1.
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

// Return the median (the mean of the middle two for an even count); NaN for none.
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
  int32_t below = 0;  // the largest element below the upper middle one
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
