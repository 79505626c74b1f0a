#include <algorithm>
#include <cstddef>
#include <limits>

#include "common/multiversion.hpp"
#include "masks/regions.hpp"
#include "motion/motion.hpp"

namespace hoid::motion {

namespace {

MULTIVERSION("avx2") void label_cells(const Image<float>& depth_m, int cell_px, Segments& out)
{
  const masks::Regions found(depth_m.data, depth_m.width, depth_m.height);
  const int columns = (depth_m.width + cell_px - 1) / cell_px;
  std::vector<int32_t> number(static_cast<std::size_t>(found.count()) * columns);
  for (int y = 0; y < depth_m.height; ++y) {
    if (y % cell_px == 0) {
      std::fill(number.begin(), number.end(), -1);
    }
    int32_t* row = out.label.data() + static_cast<std::ptrdiff_t>(y) * depth_m.width;
    for (const masks::Run* run = found.begin(y); run != found.end(y); ++run) {
      for (int first = run->first, last; first < run->last; first = last) {
        const int column = first / cell_px;
        last = std::min(run->last, (column + 1) * cell_px);
        int32_t& segment = number[static_cast<std::size_t>(run->region) * columns + column];
        if (segment < 0) {
          segment = static_cast<int32_t>(out.region.size());
          out.region.push_back(run->region);
          out.area_px.push_back(0);
        }
        out.area_px[segment] += last - first;
        std::fill(row + first, row + last, segment);
      }
    }
  }
}

}  // namespace

MULTIVERSION("avx2")
void depth_ranges_3x3(const Image<float>& depth_m, float* __restrict range_m)
{
  constexpr float kNone = std::numeric_limits<float>::infinity();
  const int width = depth_m.width, last = depth_m.height - 1;
  // Minimum and maximum of three rows in each column, padded by one column at either end.
  std::vector<float> least(width + 2, kNone), most(width + 2, 0.0F);
  for (int v = 0; v <= last; ++v) {
    const float *__restrict above = depth_m.row(std::max(v - 1, 0)),
                *__restrict row = depth_m.row(v),
                *__restrict below = depth_m.row(std::min(v + 1, last));
    for (int u = 0; u < width; ++u) {
      const float a = above[u], b = row[u], c = below[u];
      least[u + 1] =
        std::min(std::min(a > 0 ? a : kNone, b > 0 ? b : kNone), c > 0 ? c : kNone);
      most[u + 1] = std::max(std::max(a, b), c);
    }
    for (int u = 0; u < width; ++u) {
      const float depth = row[u];
      const float nearest = std::min(std::min(least[u], least[u + 1]), least[u + 2]);
      const float farthest = std::max(std::max(most[u], most[u + 1]), most[u + 2]);
      range_m[2 * u] = depth > 0 ? nearest : 0.0F;
      range_m[2 * u + 1] = depth > 0 ? farthest : 0.0F;
    }
    range_m += 2 * static_cast<std::ptrdiff_t>(width);
  }
}

Segments depth_segments(const Image<float>& depth_m, int cell_px)
{
  Segments out;
  out.label.assign(static_cast<std::size_t>(depth_m.width) * depth_m.height, -1);
  if (!out.label.empty()) {
    label_cells(depth_m, cell_px, out);
  }
  return out;
}

}  // namespace hoid::motion
