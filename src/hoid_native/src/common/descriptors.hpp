// ORB descriptors: 256 bits.
#pragma once

#include <cstdint>
#include <cstring>

#include "common/multiversion.hpp"
#include "common/views.hpp"

namespace hoid {

constexpr int kDescriptorBytes = 32;

using Descriptors = Rows<uint8_t, kDescriptorBytes>;

ALWAYS_INLINE int hamming(const uint8_t* a, const uint8_t* b)
{
  uint64_t x[4], y[4];
  std::memcpy(x, a, kDescriptorBytes);
  std::memcpy(y, b, kDescriptorBytes);
  return __builtin_popcountll(x[0] ^ y[0]) + __builtin_popcountll(x[1] ^ y[1]) +
         __builtin_popcountll(x[2] ^ y[2]) + __builtin_popcountll(x[3] ^ y[3]);
}

}  // namespace hoid
