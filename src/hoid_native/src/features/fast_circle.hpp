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

// `Lanes` is a vector type with one number per pixel; its operators work on all pixels at once.
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

// The smaller value if kBright, else the larger.
template <bool kBright, typename Lanes>
ALWAYS_INLINE Lanes weaker(Lanes a, Lanes b)
{
  return kBright ? smaller(a, b) : larger(a, b);
}

// kBright: over all arcs of 9 contiguous circle pixels, the largest minimum. Otherwise the
// smallest maximum. `ring` holds the 16 circle pixels.
template <bool kBright, typename Lanes>
ALWAYS_INLINE Lanes best_arc(const Lanes* ring)
{
  constexpr int kPairs = kCircle / 2;  // of neighboring arcs, which share 8 pixels
  Lanes two[kPairs], four[kPairs];
  for (int k = 0; k < kPairs; ++k) {
    two[k] = weaker<kBright>(ring[2 * k + 1], ring[(2 * k + 2) % kCircle]);
  }
  for (int k = 0; k < kPairs; ++k) {
    four[k] = weaker<kBright>(two[k], two[(k + 1) % kPairs]);
  }
  Lanes best{};
  for (int k = 0; k < kPairs; ++k) {
    const Lanes eight = weaker<kBright>(four[k], four[(k + 2) % kPairs]);
    const Lanes ninth = weaker<!kBright>(ring[2 * k], ring[(2 * k + 9) % kCircle]);
    const Lanes nine = weaker<kBright>(eight, ninth);
    best = k == 0 ? nine : weaker<!kBright>(best, nine);
  }
  return best;
}

}  // namespace hoid::features
