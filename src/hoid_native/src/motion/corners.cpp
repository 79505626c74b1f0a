#include <cmath>
#include <cstdint>
#include <vector>

#include "motion/motion.hpp"

namespace hoid::motion {

std::vector<int64_t> strongest_in_cells(const CornersOnDepth& seen, const CellGrid& grid)
{
  std::vector<int64_t> best(grid.count, -1);
  const double per_px = 1 / grid.cell_px;
  for (int k = 0; k < seen.count; ++k) {
    const int64_t pixel = seen.pixel[k];
    const int64_t row = pixel / seen.depth_m.width, column = pixel - row * seen.depth_m.width;
    const auto cell = static_cast<int64_t>(static_cast<double>(row) * per_px) * grid.columns +
                      static_cast<int64_t>(static_cast<double>(column) * per_px);
    if (grid.taken[cell] || (best[cell] >= 0 && seen.score[k] <= seen.score[best[cell]])) {
      continue;
    }
    const float depth_m = seen.depth_m.data[pixel];
    if (depth_m > 0 && std::isfinite(depth_m) && seen.is_smooth(pixel)) {
      best[cell] = k;
    }
  }
  std::erase(best, -1);
  return best;
}

}  // namespace hoid::motion
