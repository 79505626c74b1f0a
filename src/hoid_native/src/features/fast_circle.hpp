// The FAST-9/16 test of Rosten and Drummond, "Machine learning for high-speed corner detection",
// ECCV 2006: a pixel is a corner when 9 contiguous pixels of the circle of radius 3 are all
// brighter than it by more than a threshold, or all darker.
#pragma once

#include "common/multiversion.hpp"

namespace hoid::features {

constexpr int kCircle = 16;
constexpr int kRadius = 3;
constexpr int kOffsetX[kCircle] = {0, 1, 2, 3, 3, 3, 2, 1, 0, -1, -2, -3, -3, -3, -2, -1};
constexpr int kOffsetY[kCircle] = {-3, -3, -2, -1, 0, 1, 2, 3, 3, 3, 2, 1, 0, -1, -2, -3};

// Lanes hold one number for each of some pixels; operators work on all of them at once.
template <typename Lanes>
ALWAYS_INLINE Lanes smaller(Lanes a, Lanes b)
{
  return a < b ? a : b;
}

template <typename Lanes>
ALWAYS_INLINE Lanes larger(Lanes a, Lanes b)
{
  return a > b ? a : b;
}

// For each pixel, the most by which all of some 9 contiguous circle pixels exceed it; `gain` holds
// by how much each of the circle does.
template <typename Lanes>
ALWAYS_INLINE Lanes best_arc(const Lanes* gain)
{
  Lanes two[kCircle], four[kCircle];
  for (int k = 0; k < kCircle; ++k) {
    two[k] = smaller(gain[k], gain[(k + 1) % kCircle]);
  }
  for (int k = 0; k < kCircle; ++k) {
    four[k] = smaller(two[k], two[(k + 2) % kCircle]);
  }
  Lanes best{};
  for (int k = 0; k < kCircle; ++k) {
    const Lanes eight = smaller(four[k], four[(k + 4) % kCircle]);
    const Lanes nine = smaller(eight, gain[(k + 8) % kCircle]);
    best = k == 0 ? nine : larger(best, nine);
  }
  return best;
}

}  // namespace hoid::features
