// Rows of distinct keys, in the order in which the keys come.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

namespace hoid::objects {

// A hash table with open addressing. Keys may be any number but the smallest one.
class Rows
{
public:
  // Prepare for `count` keys.
  explicit Rows(int count)
  {
    std::size_t size = 16;
    while (size < 2 * static_cast<std::size_t>(count)) {
      size *= 2;
    }
    slots_.assign(size, {kEmpty, 0});
  }

  // Return the row of a key; a new key gets the next row.
  int row_of(int64_t key)
  {
    constexpr uint64_t kGolden = 0x9E3779B97F4A7C15U;  // Fibonacci hashing (Knuth)
    const std::size_t mask = slots_.size() - 1;
    std::size_t at = (static_cast<uint64_t>(key) * kGolden >> 32) & mask;
    while (slots_[at].key != key) {
      if (slots_[at].key == kEmpty) {
        slots_[at] = {key, size()};
        keys_.push_back(key);
        break;
      }
      at = (at + 1) & mask;
    }
    return slots_[at].row;
  }

  int size() const { return static_cast<int>(keys_.size()); }

  // Return the keys by row.
  const std::vector<int64_t>& keys() const { return keys_; }

private:
  static constexpr int64_t kEmpty = std::numeric_limits<int64_t>::min();
  struct Slot
  {
    int64_t key;
    int row;
  };
  std::vector<Slot> slots_;
  std::vector<int64_t> keys_;
};

}  // namespace hoid::objects
