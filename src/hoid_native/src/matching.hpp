// What all ways of matching share: a grid over the features, the best two candidates of a query, and
// the one-to-one assignment.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

#include "multiversion.hpp"

namespace matching {

constexpr int kDescriptorBytes = 32;
constexpr int kFar = 257;  // farther than any two descriptors
constexpr float kCellPx = 24.0F;

struct Best
{
  int feature = -1;
  int distance = kFar;
  int second_feature = -1;
  int second_distance = kFar;

  void consider(int k, int its_distance)
  {
    if (its_distance < distance) {
      *this = {k, its_distance, feature, distance};
    } else if (its_distance < second_distance) {
      second_feature = k;
      second_distance = its_distance;
    }
  }
};

// Features by cell of a grid over their own extent.
class Grid
{
public:
  Grid(const float* measurement_px, int count)
  {
    for (int k = 0; k < count; ++k) {
      const float u = measurement_px[3 * k], v = measurement_px[3 * k + 1];
      low_u_ = k == 0 ? u : std::min(low_u_, u);
      low_v_ = k == 0 ? v : std::min(low_v_, v);
      high_u_ = k == 0 ? u : std::max(high_u_, u);
      high_v_ = k == 0 ? v : std::max(high_v_, v);
    }
    columns_ = static_cast<int>((high_u_ - low_u_) / kCellPx) + 1;
    rows_ = static_cast<int>((high_v_ - low_v_) / kCellPx) + 1;
    start_.assign(static_cast<size_t>(columns_) * rows_ + 1, 0);
    features_.resize(count);
    std::vector<int> cell(count);
    for (int k = 0; k < count; ++k) {
      const int column = static_cast<int>((measurement_px[3 * k] - low_u_) / kCellPx);
      const int row = static_cast<int>((measurement_px[3 * k + 1] - low_v_) / kCellPx);
      cell[k] = row * columns_ + column;
      ++start_[cell[k] + 1];
    }
    for (size_t c = 1; c < start_.size(); ++c) {
      start_[c] += start_[c - 1];
    }
    std::vector<int> next(start_.begin(), start_.end() - 1);
    for (int k = 0; k < count; ++k) {
      features_[next[cell[k]]++] = k;
    }
  }

  // Visit the features of all cells that a rectangle touches.
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

  float low_u_ = 0, low_v_ = 0, high_u_ = 0, high_v_ = 0;
  int columns_ = 0, rows_ = 0;
  std::vector<int> start_, features_;
};

ALWAYS_INLINE int hamming(const uint8_t* a, const uint8_t* b)
{
  uint64_t x[4], y[4];
  std::memcpy(x, a, kDescriptorBytes);
  std::memcpy(y, b, kDescriptorBytes);
  return __builtin_popcountll(x[0] ^ y[0]) + __builtin_popcountll(x[1] ^ y[1]) +
         __builtin_popcountll(x[2] ^ y[2]) + __builtin_popcountll(x[3] ^ y[3]);
}

// What is matched: queries and features, and how near they must be.
struct Problem
{
  int num_queries, num_features;
  const int8_t *min_octave, *max_octave;  // of a query's features
  const uint8_t* query_descriptors;
  const float* measurement_px;  // (features, 3)
  const uint8_t *octave, *descriptors;
  const uint8_t* free;  // null: all are
  int max_distance;
  double ratio;

  ALWAYS_INLINE bool may_match(int q, int k) const
  {
    return octave[k] >= min_octave[q] && octave[k] <= max_octave[q] &&
           (free == nullptr || free[k]);
  }

  ALWAYS_INLINE int distance(int q, int k) const
  {
    return hamming(
      query_descriptors + static_cast<size_t>(q) * kDescriptorBytes,
      descriptors + static_cast<size_t>(k) * kDescriptorBytes);
  }

  bool is_clear(const Best& best) const
  {
    if (best.feature < 0 || best.distance > max_distance) {
      return false;
    }
    const bool rivalled =
      best.second_feature >= 0 && octave[best.second_feature] == octave[best.feature];
    return !(rivalled && best.distance > ratio * best.second_distance);
  }
};

// Gives each feature to the nearest of the queries that want it.
class Assignment
{
public:
  explicit Assignment(int num_features)
  : winner_(num_features, -1), distance_(num_features, kFar)
  {
  }

  void offer(int q, const Best& best)
  {
    if (best.distance < distance_[best.feature]) {
      winner_[best.feature] = q;
      distance_[best.feature] = best.distance;
    }
  }

  // Write pairs (query, feature, distance), in order of queries, and return how many there are.
  int write(int num_queries, int32_t* query_out, int32_t* feature_out, int32_t* distance_out) const
  {
    std::vector<int> feature_of(num_queries, -1);
    for (size_t k = 0; k < winner_.size(); ++k) {
      if (winner_[k] >= 0) {
        feature_of[winner_[k]] = static_cast<int>(k);
      }
    }
    int count = 0;
    for (int q = 0; q < num_queries; ++q) {
      if (feature_of[q] >= 0) {
        query_out[count] = q;
        feature_out[count] = feature_of[q];
        distance_out[count++] = distance_[feature_of[q]];
      }
    }
    return count;
  }

private:
  std::vector<int> winner_, distance_;
};

}  // namespace matching
