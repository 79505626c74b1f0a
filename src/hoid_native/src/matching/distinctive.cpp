// The descriptor that represents several observations of one map point.

#include <algorithm>
#include <limits>

#include "matching/candidates.hpp"
#include "matching/matching.hpp"

namespace hoid::matching {

namespace {

constexpr int kMaxCompared = 8;  // chosen: bounds the quadratic time; the newest are compared

// Return the index of the descriptor with the smallest median distance to all; the first if
// several are equal.
ALWAYS_INLINE int most_distinctive(const uint8_t* descriptors, int count)
{
  int best = 0, least = std::numeric_limits<int>::max();
  for (int a = 0; a < count; ++a) {
    int distances[kMaxCompared];  // ascending
    for (int b = 0; b < count; ++b) {
      const int distance =
        hamming(descriptors + a * kDescriptorBytes, descriptors + b * kDescriptorBytes);
      int n = b;
      for (; n > 0 && distances[n - 1] > distance; --n) {
        distances[n] = distances[n - 1];
      }
      distances[n] = distance;
    }
    const int two_medians = distances[(count - 1) / 2] + distances[count / 2];
    if (two_medians < least) {
      least = two_medians;
      best = a;
    }
  }
  return best;
}

}  // namespace

MULTIVERSION("popcnt")
std::vector<int64_t> distinctive_descriptors(
  const uint8_t* descriptors, int64_t count, const int64_t* starts, int num_groups)
{
  std::vector<int64_t> rows(num_groups);
  for (int g = 0; g < num_groups; ++g) {
    const int64_t end = g + 1 < num_groups ? starts[g + 1] : count;
    const int compared = static_cast<int>(std::min<int64_t>(end - starts[g], kMaxCompared));
    const int64_t first = end - compared;
    // Two descriptors have the same distance to each other, so the newer one is taken.
    rows[g] = compared <= 2
                ? end - 1
                : first + most_distinctive(descriptors + first * kDescriptorBytes, compared);
  }
  return rows;
}

}  // namespace hoid::matching
