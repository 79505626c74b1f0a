// A grid over features, so that a query visits only those around it.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "common/multiversion.hpp"

namespace hoid::matching {

constexpr float kCellPx = 24.0F;  // chosen: about the radius of a search window
// Positions beyond any image's size come from a diverging distortion model. They and NaN are in no
// cell and match nothing.
constexpr float kMaxPositionPx = 16384.0F;

// Features sorted by the cells of a grid over their bounding box.
class Grid
{
public:
  Grid(const float* measurement_px, int count)
  {
    std::vector<int> placed;
    placed.reserve(count);
    for (int k = 0; k < count; ++k) {
      const float u = measurement_px[3 * k], v = measurement_px[3 * k + 1];
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
    sort_into_cells(measurement_px, placed);
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
      const int first = start_[row * columns_ + left], end = start_[row * columns_ + right + 1];
      for (int n = first; n < end; ++n) {
        visit_feature(features_[n]);
      }
    }
  }

private:
  static int cell_of(double offset_px, int count)
  {
    return static_cast<int>(std::clamp(offset_px / kCellPx, 0.0, count - 1.0));
  }

  void sort_into_cells(const float* measurement_px, const std::vector<int>& placed)
  {
    columns_ = static_cast<int>((high_u_ - low_u_) / kCellPx) + 1;
    rows_ = static_cast<int>((high_v_ - low_v_) / kCellPx) + 1;
    start_.assign(static_cast<std::size_t>(columns_) * rows_ + 1, 0);
    features_.resize(placed.size());
    std::vector<int> cell;
    cell.reserve(placed.size());
    for (const int k : placed) {
      const int column = static_cast<int>((measurement_px[3 * k] - low_u_) / kCellPx);
      const int row = static_cast<int>((measurement_px[3 * k + 1] - low_v_) / kCellPx);
      cell.push_back(row * columns_ + column);
      ++start_[cell.back() + 1];
    }
    for (std::size_t c = 1; c < start_.size(); ++c) {
      start_[c] += start_[c - 1];
    }
    std::vector<int> next(start_.begin(), start_.end() - 1);
    for (std::size_t n = 0; n < placed.size(); ++n) {
      features_[next[cell[n]]++] = placed[n];
    }
  }

  float low_u_ = 0, low_v_ = 0, high_u_ = 0, high_v_ = 0;
  int columns_ = 0, rows_ = 0;
  std::vector<int> start_, features_;
};

}  // namespace hoid::matching
