// What stands for several descriptors of one thing.

#include <algorithm>
#include <limits>

#include "matching/candidates.hpp"
#include "matching/matching.hpp"

namespace hoid::matching {

namespace {

constexpr int kMostCompared = 8;  // more change the median little

// Return which of some descriptors has the least median distance to all of them, the first of
// equals.
ALWAYS_INLINE int most_typical(const uint8_t* descriptors, int count)
{
  int best = 0, least = std::numeric_limits<int>::max();
  for (int a = 0; a < count; ++a) {
    int apart[kMostCompared];  // ascending
    for (int b = 0; b < count; ++b) {
      const int distance =
        hamming(descriptors + a * kDescriptorBytes, descriptors + b * kDescriptorBytes);
      int n = b;
      for (; n > 0 && apart[n - 1] > distance; --n) {
        apart[n] = apart[n - 1];
      }
      apart[n] = distance;
    }
    const int two_medians = apart[(count - 1) / 2] + apart[count / 2];
    if (two_medians < least) {
      least = two_medians;
      best = a;
    }
  }
  return best;
}

}  // namespace

MULTIVERSION("popcnt")
std::vector<int64_t> typical_descriptors(
  const uint8_t* descriptors, int64_t count, const int64_t* starts, int num_groups)
{
  std::vector<int64_t> rows(num_groups);
  for (int g = 0; g < num_groups; ++g) {
    const int64_t end = g + 1 < num_groups ? starts[g + 1] : count;
    const int compared = static_cast<int>(std::min<int64_t>(end - starts[g], kMostCompared));
    const int64_t first = end - compared;
    // Of two, both are as typical: the newer is kept.
    rows[g] = compared <= 2
                ? end - 1
                : first + most_typical(descriptors + first * kDescriptorBytes, compared);
  }
  return rows;
}

}  // namespace hoid::matching
