#include <algorithm>

#include "common/multiversion.hpp"
#include "masks/regions.hpp"
#include "motion/motion.hpp"

namespace hoid::motion {

namespace {

MULTIVERSION("avx2") void label_cells(const Image<float>& depth_m, int cell_px, Segments& out)
{
  const masks::Regions found(depth_m);
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

Segments depth_segments(const Image<float>& depth_m, int cell_px)
{
  Segments out;
  out.label.assign(depth_m.size(), -1);
  if (!out.label.empty()) {
    label_cells(depth_m, cell_px, out);
  }
  return out;
}

}  // namespace hoid::motion
