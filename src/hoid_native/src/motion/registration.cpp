// Registration of depth images to another camera.

#include <algorithm>
#include <cmath>

#include "motion/motion.hpp"

namespace hoid::motion {

namespace {

// Chosen: a depth pixel is at most so many times nearer to the target than to the depth camera.
// Cameras beside each other differ by less, and a wrong transform must not cost much time.
constexpr float kMaxNearness = 2;

// The whole pixels of a row or column that lie within half a side of a position.
struct Span
{
  int first, end;
};

Span span_of(float center, float half, int size)
{
  // Positions far outside, and NaN, have no pixels; they must not be converted to int.
  if (!(center > -half - 1 && center < static_cast<float>(size) + half)) {
    return {0, 0};
  }
  const int first = static_cast<int>(std::ceil(center - half));
  const int end = static_cast<int>(std::ceil(center + half));
  return {std::max(first, 0), std::min(end, size)};
}

}  // namespace

void register_depth(const DepthSource& source, const Target& target, float* depth_out)
{
  const auto [depth_m, rays, t_m, side_px] = source;
  const auto fx = static_cast<float>(target.camera.fx_px);
  const auto fy = static_cast<float>(target.camera.fy_px);
  const auto cx = static_cast<float>(target.camera.cx_px);
  const auto cy = static_cast<float>(target.camera.cy_px);
  for (std::ptrdiff_t i = 0; i < depth_m.size(); ++i) {
    const float z = depth_m.data[i];
    const float* ray = rays + 3 * i;
    const float depth = z * ray[2] + t_m[2];
    if (!(z > 0 && depth > 0)) {
      continue;
    }
    const float u = fx * (z * ray[0] + t_m[0]) / depth + cx;
    const float v = fy * (z * ray[1] + t_m[1]) / depth + cy;
    const float nearness = std::min(z / depth, kMaxNearness);
    const Span columns = span_of(u, std::max(0.5F, 0.5F * side_px[0] * nearness), target.width);
    const Span rows = span_of(v, std::max(0.5F, 0.5F * side_px[1] * nearness), target.height);
    for (int y = rows.first; y < rows.end; ++y) {
      float* row = depth_out + static_cast<std::ptrdiff_t>(y) * target.width;
      for (int x = columns.first; x < columns.end; ++x) {
        row[x] = row[x] == 0 ? depth : std::min(row[x], depth);
      }
    }
  }
}

}  // namespace hoid::motion
