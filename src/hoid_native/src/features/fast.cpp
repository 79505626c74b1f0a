// FAST-9/16 corners with their score and 3x3 non-maximum suppression, on one pyramid level.
//
// The score is the largest threshold at which a pixel still is a corner.

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

#include "features/fast_circle.hpp"
#include "features/features.hpp"

namespace hoid::features {

namespace {

constexpr int kLanes = 32;

// One byte for each of the pixels of a block.
using Lanes = uint8_t __attribute__((vector_size(kLanes)));
using Words = uint64_t __attribute__((vector_size(kLanes)));

ALWAYS_INLINE Lanes load(const uint8_t* at)
{
  Lanes lanes;
  std::memcpy(&lanes, at, kLanes);
  return lanes;
}

// a - b, not below 0.
ALWAYS_INLINE Lanes excess(Lanes a, Lanes b)
{
  return larger(a, b) - b;
}

ALWAYS_INLINE bool any_above(Lanes lanes, uint8_t threshold)
{
  const Words over = reinterpret_cast<Words>(excess(lanes, Lanes{} + threshold));
  return (over[0] | over[1] | over[2] | over[3]) != 0;
}

// Of any 9 contiguous circle pixels at least two neighbouring compass points are members.
ALWAYS_INLINE Lanes bound(const Lanes* gain)
{
  const Lanes vertical = larger(gain[0], gain[8]), horizontal = larger(gain[4], gain[12]);
  return smaller(vertical, horizontal);
}

// For each pixel of a block, the largest threshold at which it is a corner, plus one; pixels of a
// block without any corner at `threshold` may all be 0.
ALWAYS_INLINE Lanes scores_of(const uint8_t* at, const int* offset, uint8_t threshold)
{
  const Lanes center = load(at);
  Lanes brighter[kCircle], darker[kCircle];
  for (int k = 0; k < kCircle; k += 4) {
    const Lanes ring = load(at + offset[k]);
    brighter[k] = excess(ring, center);
    darker[k] = excess(center, ring);
  }
  if (!any_above(larger(bound(brighter), bound(darker)), threshold)) {
    return Lanes{};
  }
  for (int k = 0; k < kCircle; ++k) {
    if (k % 4 != 0) {
      const Lanes ring = load(at + offset[k]);
      brighter[k] = excess(ring, center);
      darker[k] = excess(center, ring);
    }
  }
  return larger(best_arc(brighter), best_arc(darker));
}

struct Row
{
  std::vector<uint8_t> score;
  std::vector<int> columns;
};

void clear(Row& row)
{
  for (const int x : row.columns) {
    row.score[x] = 0;
  }
  row.columns.clear();
}

bool is_peak(const Row& above, const Row& row, const Row& below, int x)
{
  const uint8_t mine = row.score[x];
  const uint8_t* a = above.score.data() + x;
  const uint8_t* b = below.score.data() + x;
  return mine > row.score[x - 1] && mine > row.score[x + 1] && mine > a[-1] && mine > a[0] &&
         mine > a[1] && mine > b[-1] && mine > b[0] && mine > b[1];
}

// Write the scores of the corners of a line into an empty row.
ALWAYS_INLINE void score_line(
  const uint8_t* line, int width, int margin, const int* offset, uint8_t threshold, Row& row)
{
  const int last = width - margin - kLanes;
  for (int x = margin; x < width - margin; x += kLanes) {
    const int start = std::max(std::min(x, last), 0);  // the last block overlaps its neighbour
    const Lanes score = scores_of(line + start, offset, threshold);
    if (!any_above(score, threshold)) {
      continue;
    }
    for (int lane = x - start; lane < kLanes; ++lane) {
      if (score[lane] > threshold) {
        row.score[start + lane] = score[lane];
        row.columns.push_back(start + lane);
      }
    }
  }
}

}  // namespace

MULTIVERSION("avx2")
Corners detect_fast(const Image<uint8_t>& image, int threshold, int border)
{
  Corners corners;
  const int margin = std::max(border, kRadius);
  if (std::min(image.width, image.height) < 2 * static_cast<int64_t>(margin) + kLanes) {
    return corners;
  }
  int offset[kCircle];
  for (int k = 0; k < kCircle; ++k) {
    offset[k] = kOffsetY[k] * image.width + kOffsetX[k];
  }
  Row rows[3];
  for (Row& row : rows) {
    row.score.assign(image.width, 0);
    row.columns.reserve(image.width);
  }
  // Non-maximum suppression runs one row behind detection; scores one pixel beyond the border
  // are not known there, as a corner outside the border does not compete.
  for (int y = margin; y <= image.height - margin; ++y) {
    Row& row = rows[y % 3];
    clear(row);
    if (y < image.height - margin) {
      score_line(image.row(y), image.width, margin, offset, static_cast<uint8_t>(threshold), row);
    }
    const Row& middle = rows[(y + 2) % 3];
    const Row& above = rows[(y + 1) % 3];
    for (const int x : middle.columns) {
      if (y > margin && is_peak(above, middle, row, x)) {
        corners.x.push_back(x);
        corners.y.push_back(y - 1);
        corners.score.push_back(static_cast<uint8_t>(middle.score[x] - 1));
      }
    }
  }
  return corners;
}

}  // namespace hoid::features
