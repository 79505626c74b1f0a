// A grid over features, so that a query visits only those around it.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "common/buckets.hpp"
#include "common/multiversion.hpp"
#include "common/views.hpp"

namespace hoid::matching {

constexpr float kCellPx = 24.0F;  // chosen: about the radius of a search window
// Positions beyond any image's size come from a diverging distortion model. They and NaN are in no
// cell and match nothing.
constexpr float kMaxPositionPx = 16384.0F;

// Features sorted by the cells of a grid over their bounding box.
class Grid
{
public:
  explicit Grid(const Rows<float, 3>& measurement_px)
  {
    std::vector<int> placed;
    placed.reserve(measurement_px.count);
    for (int k = 0; k < measurement_px.count; ++k) {
      const float u = measurement_px[k][0], v = measurement_px[k][1];
      if (!(std::abs(u) <= kMaxPositionPx && std::abs(v) <= kMaxPositionPx)) {
        continue;
      }
      const bool first = placed.empty();
      low_u_ = first ? u : std::min(low_u_, u);
      low_v_ = first ? v : std::min(low_v_, v);
      high_u_ = first ? u : std::max(high_u_, u);
      high_v_ = first ? v : std::max(high_v_, v);
      placed.push_back(k);
    }
    columns_ = static_cast<int>((high_u_ - low_u_) / kCellPx) + 1;
    rows_ = static_cast<int>((high_v_ - low_v_) / kCellPx) + 1;
    const auto num_cells = static_cast<std::size_t>(columns_) * rows_;
    features_ = sort_into_buckets(placed, num_cells, [&](int k) {
      const int column = static_cast<int>((measurement_px[k][0] - low_u_) / kCellPx);
      const int row = static_cast<int>((measurement_px[k][1] - low_v_) / kCellPx);
      return row * columns_ + column;
    });
  }

  // Visit the features of all cells that overlap a rectangle.
  template <typename Visit>
  ALWAYS_INLINE void visit(
    double u_min, double v_min, double u_max, double v_max, Visit visit_feature) const
  {
    if (!(u_max >= low_u_ && u_min <= high_u_ && v_max >= low_v_ && v_min <= high_v_)) {
      return;
    }
    const int left = cell_of(u_min - low_u_, columns_), right = cell_of(u_max - low_u_, columns_);
    const int top = cell_of(v_min - low_v_, rows_), bottom = cell_of(v_max - low_v_, rows_);
    for (int row = top; row <= bottom; ++row) {
      const int first = features_.start[row * columns_ + left],
                end = features_.start[row * columns_ + right + 1];
      for (int n = first; n < end; ++n) {
        visit_feature(features_.order[n]);
      }
    }
  }

private:
  static int cell_of(double offset_px, int count)
  {
    return static_cast<int>(std::clamp(offset_px / kCellPx, 0.0, count - 1.0));
  }

  float low_u_ = 0, low_v_ = 0, high_u_ = 0, high_v_ = 0;
  int columns_ = 0, rows_ = 0;
  Buckets features_;
};

}  // namespace hoid::matching
