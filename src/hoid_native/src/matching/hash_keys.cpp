// Keys of descriptors for tables of locality-sensitive hashing.

#include <array>

#include "matching/matching.hpp"

namespace hoid::matching {

namespace {

constexpr int kRowBits = 32;  // the lower bits, for the row of the descriptor

// The part of a key that follows from one byte of the descriptor, for each value of the byte.
struct ByteKeys
{
  int byte = 0;
  std::array<uint32_t, 256> key{};
};

// Bit n of a key is bit bits[n] of the descriptor; the first bit of a byte is its highest one.
std::vector<ByteKeys> keys_by_byte(const uint8_t* bits, int key_bits)
{
  std::vector<ByteKeys> parts;
  for (int byte = 0; byte < kDescriptorBytes; ++byte) {
    ByteKeys part;
    part.byte = byte;
    bool is_used = false;
    for (int n = 0; n < key_bits; ++n) {
      if (bits[n] / 8 != byte) {
        continue;
      }
      is_used = true;
      for (unsigned value = 0; value < 256; ++value) {
        part.key[value] |= (value >> (7 - bits[n] % 8) & 1u) << n;
      }
    }
    if (is_used) {
      parts.push_back(part);
    }
  }
  return parts;
}

}  // namespace

std::vector<uint64_t> hash_keys(const Descriptors& descriptors, const Image<uint8_t>& bits)
{
  std::vector<uint64_t> keys;
  keys.reserve(static_cast<std::size_t>(bits.height) * descriptors.count);
  for (int t = 0; t < bits.height; ++t) {
    const std::vector<ByteKeys> parts = keys_by_byte(bits.row(t), bits.width);
    for (int n = 0; n < descriptors.count; ++n) {
      uint32_t key = 0;
      for (const ByteKeys& part : parts) {
        key |= part.key[descriptors[n][part.byte]];
      }
      keys.push_back(static_cast<uint64_t>(key) << kRowBits);
    }
  }
  return keys;
}

}  // namespace hoid::matching
