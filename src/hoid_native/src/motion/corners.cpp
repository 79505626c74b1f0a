#include <cmath>
#include <cstdint>
#include <vector>

#include "motion/motion.hpp"

namespace hoid::motion {

namespace {

// Return the cell of each of `count` consecutive pixels.
std::vector<int> cells_of(int count, double cell_px)
{
  const double per_px = 1 / cell_px;
  std::vector<int> cells(count);
  for (int n = 0; n < count; ++n) {
    cells[n] = static_cast<int>(n * per_px);
  }
  return cells;
}

}  // namespace

std::vector<int64_t> strongest_corners_per_cell(const CornersOnDepth& seen, const CellGrid& grid)
{
  std::vector<int64_t> best(grid.count, -1);
  // Tables of the cells of rows and columns: faster than two multiplications per corner.
  const int width = seen.depth_m.width;
  const RowOfPixel row_of(width);
  const std::vector<int> cell_of_column = cells_of(seen.depth_m.width, grid.cell_px),
                         cell_of_row = cells_of(seen.depth_m.height, grid.cell_px);
  for (int k = 0; k < seen.count; ++k) {
    const int64_t pixel = seen.pixel[k];
    const int64_t row = row_of(pixel), column = pixel - row * width;
    const int cell = cell_of_row[row] * grid.columns + cell_of_column[column];
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
