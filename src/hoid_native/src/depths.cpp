// Depths where they can be believed: the median at the centre of a box, and pixels away from edges.

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

#include "median.hpp"

namespace {

// A square of a depth image; beyond the image it sees the image's edge.
class Square
{
public:
  // Ask for the pixels ahead of time: the image was last touched before the corners were found.
  ALWAYS_INLINE Square(const float* depth_m, int width, int height, const double* box, int side)
  : depth_m_(depth_m),
    width_(width),
    height_(height),
    side_(side),
    left_(static_cast<int>(std::nearbyint((box[0] + box[2] - side) / 2))),
    top_(static_cast<int>(std::nearbyint((box[1] + box[3] - side) / 2)))
  {
#ifdef __GNUC__
    // Not in a function of its own: GCC drops the call of one that returns nothing and only prefetches.
    for (int v = top_; v < top_ + side_; ++v) {
      __builtin_prefetch(at(v, left_));
      __builtin_prefetch(at(v, left_ + side_ - 1));
    }
#endif
  }

  // Write the readings, as bits: those of positive floats are in the order of their values. Return how many.
  ALWAYS_INLINE int read(uint32_t* bits) const
  {
    int count = 0;
    for (int v = top_; v < top_ + side_; ++v) {
      const float* row = at(v, 0);
      for (int u = left_; u < left_ + side_; ++u) {
        const float reading = row[std::clamp(u, 0, width_ - 1)];
        std::memcpy(bits + count, &reading, sizeof(*bits));  // overwritten by the next when it is none: no branch
        count += static_cast<int>(reading > 0);
      }
    }
    return count;
  }

private:
  ALWAYS_INLINE const float* at(int v, int u) const
  {
    return depth_m_ + static_cast<std::ptrdiff_t>(std::clamp(v, 0, height_ - 1)) * width_ +
           std::clamp(u, 0, width_ - 1);
  }

  const float* depth_m_;
  int width_, height_, side_, left_, top_;
};

}  // namespace

// Write the median reading of a square at the centre of each box (x1, y1, x2, y2). Readings are positive; 0 and
// NaN are none.
extern "C" MULTIVERSION("avx2") void hoid_sample_depths(
  const float* depth_m, int32_t width, int32_t height, int32_t count, const double* boxes, int32_t side_px,
  double* median_m_out)
{
  std::vector<Square> squares;
  squares.reserve(count);
  for (int n = 0; n < count; ++n) {
    squares.emplace_back(depth_m, width, height, boxes + 4 * static_cast<std::ptrdiff_t>(n), side_px);
  }
  std::vector<uint32_t> bits(static_cast<std::size_t>(side_px) * side_px + 1);
  for (int n = 0; n < count; ++n) {
    median_m_out[n] = median::median(bits.data(), squares[n].read(bits.data()));
  }
}

// Write the reading at each pixel (x, y) of the image, or 0 where there is none or an edge is near: where readings in
// the square around it differ by more than a share of it. Readings are positive; 0 and NaN are none.
extern "C" void hoid_depths_off_edges(
  const float* depth_m, int32_t width, int32_t height, int32_t count, const int32_t* x, const int32_t* y,
  int32_t radius_px, double step, float* depth_m_out)
{
  for (int n = 0; n < count; ++n) {
    const float reading = depth_m[static_cast<std::ptrdiff_t>(y[n]) * width + x[n]];
    const int left = std::max(x[n] - radius_px, 0), right = std::min(x[n] + radius_px, width - 1);
    const int top = std::max(y[n] - radius_px, 0), bottom = std::min(y[n] + radius_px, height - 1);
    float nearest = reading, farthest = reading;
    for (int v = top; v <= bottom; ++v) {
      const float* row = depth_m + static_cast<std::ptrdiff_t>(v) * width;
      for (int u = left; u <= right; ++u) {
        nearest = row[u] > 0 && row[u] < nearest ? row[u] : nearest;
        farthest = row[u] > farthest ? row[u] : farthest;
      }
    }
    const bool believed = reading > 0 && farthest - nearest <= step * reading;
    depth_m_out[n] = believed ? reading : 0.0F;
  }
}
