// Keys of descriptors for tables of locality-sensitive hashing, and their sorting.

#include <algorithm>
#include <array>
#include <utility>

#include "matching/matching.hpp"

namespace hoid::matching {

namespace {

constexpr int kRowBits = 32;              // the lower bits, for the row of the descriptor
constexpr int kDigitBits = 11;            // chosen: 2048 counters fit the cache
constexpr int kDigits = 1 << kDigitBits;

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

std::vector<uint64_t> hash_keys(
  const uint8_t* descriptors, int count, const uint8_t* bits, int num_tables, int key_bits)
{
  std::vector<uint64_t> keys(static_cast<std::size_t>(num_tables) * count);
  for (int t = 0; t < num_tables; ++t) {
    const std::vector<ByteKeys> parts = keys_by_byte(bits + t * key_bits, key_bits);
    uint64_t* out = keys.data() + static_cast<std::size_t>(t) * count;
    for (int n = 0; n < count; ++n) {
      const uint8_t* descriptor = descriptors + static_cast<std::size_t>(n) * kDescriptorBytes;
      uint32_t key = 0;
      for (const ByteKeys& part : parts) {
        key |= part.key[descriptor[part.byte]];
      }
      out[n] = static_cast<uint64_t>(key) << kRowBits;
    }
  }
  return keys;
}

void sort_hash_keys(uint64_t* keys, int count, int num_tables, int key_bits)
{
  // A radix sort: by the digits of the key from the lowest to the highest, each time stable.
  std::vector<uint64_t> other(count);
  for (int t = 0; t < num_tables; ++t) {
    uint64_t* table = keys + static_cast<std::size_t>(t) * count;
    for (int shift = 0; shift < key_bits; shift += kDigitBits) {
      std::array<int, kDigits> at{};
      const auto digit = [&](uint64_t key) {
        return static_cast<std::size_t>(key >> (kRowBits + shift)) & (kDigits - 1);
      };
      for (int n = 0; n < count; ++n) {
        ++at[digit(table[n])];
      }
      int before = 0;
      for (int& first : at) {
        before += std::exchange(first, before);
      }
      for (int n = 0; n < count; ++n) {
        other[at[digit(table[n])]++] = table[n];
      }
      std::copy(other.begin(), other.end(), table);
    }
  }
}

}  // namespace hoid::matching
