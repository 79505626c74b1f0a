// FAST-9/16 corners with scores and 3x3 non-maximum suppression on each pyramid level. The score
// is the largest threshold at which the pixel is still a corner.

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

#include "features/fast_circle.hpp"
#include "features/features.hpp"

namespace hoid::features {

namespace {

constexpr int kLanes = 32, kWordLanes = 8;  // bytes of an AVX2 register, and of a word

// A block of 32 pixels in a row, one byte each.
using Lanes = uint8_t __attribute__((vector_size(kLanes)));
using Words = uint64_t __attribute__((vector_size(kLanes)));

ALWAYS_INLINE Lanes load(const uint8_t* at)
{
  Lanes lanes;
  std::memcpy(&lanes, at, kLanes);
  return lanes;
}

ALWAYS_INLINE bool any(Lanes lanes)
{
  const Words words = reinterpret_cast<Words>(lanes);
  return (words[0] | words[1] | words[2] | words[3]) != 0;
}

// a - b, saturated at 0.
ALWAYS_INLINE Lanes excess(Lanes a, Lanes b)
{
  return larger(a, b) - b;
}

ALWAYS_INLINE Lanes contrast(Lanes center, Lanes brightest, Lanes darkest)
{
  return larger(excess(brightest, center), excess(center, darkest));
}

// Call `visit` with the index of each set lane. The bits of a lane are all set or all clear.
template <typename Visit>
ALWAYS_INLINE void for_each_lane(Lanes lanes, Visit visit)
{
  const Words words = reinterpret_cast<Words>(lanes);
  for (int word = 0; word < kLanes / kWordLanes; ++word) {
    for (uint64_t rest = words[word]; rest != 0;) {
      const int lane = std::countr_zero(rest) / 8;
      rest &= ~(uint64_t{0xff} << (8 * lane));
      visit(kWordLanes * word + lane);
    }
  }
}

// Return score + 1 for the block's pixels that are corners at the threshold, 0 for the others.
ALWAYS_INLINE Lanes scores_of(const uint8_t* at, const int* offset, Lanes threshold)
{
  const Lanes center = load(at);
  const Lanes above = load(at + offset[0]), right = load(at + offset[4]),
              below = load(at + offset[8]), left = load(at + offset[12]);
  // Any 9 contiguous circle pixels include two neighboring compass points: a cheap upper bound.
  const Lanes bound = contrast(
    center, smaller(larger(above, below), larger(left, right)),
    larger(smaller(above, below), smaller(left, right)));
  if (!any(excess(bound, threshold))) {
    return Lanes{};
  }
  Lanes ring[kCircle];
  for (int k = 0; k < kCircle; ++k) {
    ring[k] = load(at + offset[k]);
  }
  const Lanes score = contrast(center, best_arc<true>(ring), best_arc<false>(ring));
  return score > threshold ? score : Lanes{};
}

// Write the scores of an image row, without the margin at either end.
ALWAYS_INLINE void score_line(
  const uint8_t* line, int width, int margin, const int* offset, Lanes threshold, uint8_t* out)
{
  const int last = width - margin - kLanes;
  for (int x = margin; x < width - margin; x += kLanes) {
    const int start = std::min(x, last);  // the last block overlaps the one before
    const Lanes score = scores_of(line + start, offset, threshold);
    std::memcpy(out + start, &score, kLanes);
  }
}

// Append the row's pixels that score higher than their 8 neighbors.
ALWAYS_INLINE void add_peaks(
  const uint8_t* above, const uint8_t* line, const uint8_t* below, int width, int margin, int y,
  Corners& out)
{
  const int last = width - margin - kLanes;
  for (int x = margin; x < width - margin; x += kLanes) {
    const int start = std::min(x, last);
    const Lanes mine = load(line + start);
    if (!any(mine)) {
      continue;
    }
    const uint8_t *a = above + start, *m = line + start, *b = below + start;
    const Lanes beside = larger(load(m - 1), load(m + 1));
    const Lanes over = larger(larger(load(a - 1), load(a)), load(a + 1));
    const Lanes under = larger(larger(load(b - 1), load(b)), load(b + 1));
    const Lanes peaks = mine > larger(beside, larger(over, under));
    for_each_lane(peaks, [&](int lane) {
      const int at = start + lane;
      if (at >= x) {
        out.xy_px.insert(out.xy_px.end(), {at, y});
        out.score.push_back(static_cast<uint8_t>(line[at] - 1));
      }
    });
  }
}

// Append the corners of one pyramid level (xy_px and score).
MULTIVERSION("avx2")
void add_corners(const Image<uint8_t>& image, int threshold, int border, Corners& corners)
{
  const int margin = std::max(border, kRadius);
  if (std::min(image.width, image.height) < 2 * static_cast<int64_t>(margin) + kLanes) {
    return;
  }
  int offset[kCircle];
  for (int k = 0; k < kCircle; ++k) {
    offset[k] = kOffsetY[k] * image.width + kOffsetX[k];
  }
  // Suppression runs one row behind scoring, on three rows of scores. Corners outside the border
  // have score 0 and suppress none.
  std::vector<uint8_t> scores(3 * static_cast<std::size_t>(image.width));
  const auto row = [&](int y) {
    return scores.data() + static_cast<std::ptrdiff_t>(y % 3) * image.width;
  };
  const Lanes over = Lanes{} + static_cast<uint8_t>(threshold);
  for (int y = margin; y <= image.height - margin; ++y) {
    if (y < image.height - margin) {
      score_line(image.row(y), image.width, margin, offset, over, row(y));
    } else {
      std::fill_n(row(y), image.width, 0);
    }
    if (y > margin) {
      add_peaks(row(y + 1), row(y + 2), row(y), image.width, margin, y - 1, corners);
    }
  }
}

// Append the level-0 positions of the corners that have none yet.
void add_positions(double step_x_px, double step_y_px, int width, Corners& corners)
{
  for (std::size_t k = corners.pixel.size(); k < corners.score.size(); ++k) {
    // Integer coordinates are pixel centers, so a level's pixel (0, 0) lies at (step - 1) / 2.
    const double u = (corners.xy_px[2 * k] + 0.5) * step_x_px - 0.5,
                 v = (corners.xy_px[2 * k + 1] + 0.5) * step_y_px - 0.5;
    corners.uv_px.insert(corners.uv_px.end(), {u, v});
    corners.pixel.push_back(std::lrint(v) * width + std::lrint(u));
  }
}

}  // namespace

Corners detect_fast(const Pyramid& pyramid, int threshold, int border)
{
  Corners corners;
  for (std::size_t octave = 0; octave < pyramid.levels.size(); ++octave) {
    const float* step_px = pyramid.steps_px + 2 * octave;
    add_corners(pyramid.levels[octave], threshold, border, corners);
    add_positions(step_px[0], step_px[1], pyramid.levels[0].width, corners);
    corners.octave.resize(corners.score.size(), static_cast<uint8_t>(octave));
  }
  return corners;
}

}  // namespace hoid::features
