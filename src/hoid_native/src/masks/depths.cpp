// The median depth at the center of a box.

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

#include "masks/masks.hpp"
#include "masks/median.hpp"

namespace hoid::masks {

namespace {

// A square window of a depth image. Outside the image it repeats the image's edge.
class Square
{
public:
  // Prefetches the pixels: corner detection has displaced the depth image from the cache.
  ALWAYS_INLINE Square(const Image<float>& depth_m, const double* box, int side)
  : depth_m_(depth_m),
    side_(side),
    left_(first((box[0] + box[2] - side) / 2, depth_m.width)),
    top_(first((box[1] + box[3] - side) / 2, depth_m.height))
  {
#ifdef __GNUC__
    // Not in its own function: GCC drops calls of a function that only prefetches.
    for (int v = top_; v < top_ + side_; ++v) {
      __builtin_prefetch(at(v, left_));
      __builtin_prefetch(at(v, left_ + side_ - 1));
    }
#endif
  }

  // Write the bits of the measurements and return their number. The bits of positive floats are
  // ordered like their values.
  ALWAYS_INLINE int read(uint32_t* bits) const
  {
    int count = 0;
    for (int v = top_; v < top_ + side_; ++v) {
      const float* row = at(v, 0);
      for (int u = left_; u < left_ + side_; ++u) {
        const float reading = row[std::clamp(u, 0, depth_m_.width - 1)];
        // Without a branch: the next pixel overwrites this one if it is no measurement.
        std::memcpy(bits + count, &reading, sizeof(*bits));
        count += static_cast<int>(reading > 0);
      }
    }
    return count;
  }

private:
  // Return the first row or column, clamped: all windows fully outside the image are equal.
  ALWAYS_INLINE int first(double place_px, int size) const
  {
    return static_cast<int>(std::clamp<double>(std::nearbyint(place_px), -side_, size));
  }

  ALWAYS_INLINE const float* at(int v, int u) const
  {
    return depth_m_.row(std::clamp(v, 0, depth_m_.height - 1)) +
           std::clamp(u, 0, depth_m_.width - 1);
  }

  Image<float> depth_m_;
  int side_, left_, top_;
};

}  // namespace

MULTIVERSION("avx2")
void box_center_depths(
  const Image<float>& depth_m, const Boxes& boxes, int side_px, double* median_m_out)
{
  std::vector<Square> squares;
  squares.reserve(boxes.count);
  for (int n = 0; n < boxes.count; ++n) {
    squares.emplace_back(depth_m, boxes[n], side_px);
  }
  std::vector<uint32_t> bits(static_cast<std::size_t>(side_px) * side_px + 1);
  for (int n = 0; n < boxes.count; ++n) {
    median_m_out[n] = median::median(bits.data(), squares[n].read(bits.data()));
  }
}

}  // namespace hoid::masks
