// Matching by projection: the feature nearest in Hamming distance within a window around each
// query's expected pixel, one to one.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <vector>

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__)
#define MULTIVERSION __attribute__((target_clones("popcnt", "default")))
#else
#define MULTIVERSION
#endif

namespace {

constexpr int kDescriptorBytes = 32;
constexpr int kFar = 257;  // farther than any two descriptors
constexpr float kCellPx = 24.0F;

struct Best
{
  int feature = -1;
  int distance = kFar;
  int second_feature = -1;
  int second_distance = kFar;
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

  template <typename Visit>
  void visit(double u, double v, double radius, Visit visit_feature) const
  {
    if (!(u + radius >= low_u_ && u - radius <= high_u_ && v + radius >= low_v_ &&
          v - radius <= high_v_)) {
      return;
    }
    const int left = std::max(0, static_cast<int>((u - radius - low_u_) / kCellPx));
    const int right =
      std::min(columns_ - 1, static_cast<int>(std::min((u + radius - low_u_) / kCellPx, 1e6)));
    const int top = std::max(0, static_cast<int>((v - radius - low_v_) / kCellPx));
    const int bottom =
      std::min(rows_ - 1, static_cast<int>(std::min((v + radius - low_v_) / kCellPx, 1e6)));
    for (int row = top; row <= bottom; ++row) {
      const int first = start_[row * columns_ + left], end = start_[row * columns_ + right + 1];
      for (int n = first; n < end; ++n) {
        visit_feature(features_[n]);
      }
    }
  }

private:
  float low_u_ = 0, low_v_ = 0, high_u_ = 0, high_v_ = 0;
  int columns_ = 0, rows_ = 0;
  std::vector<int> start_, features_;
};

__attribute__((always_inline)) inline int hamming(const uint8_t* a, const uint8_t* b)
{
  uint64_t x[4], y[4];
  std::memcpy(x, a, kDescriptorBytes);
  std::memcpy(y, b, kDescriptorBytes);
  return __builtin_popcountll(x[0] ^ y[0]) + __builtin_popcountll(x[1] ^ y[1]) +
         __builtin_popcountll(x[2] ^ y[2]) + __builtin_popcountll(x[3] ^ y[3]);
}

}  // namespace

// Write pairs (query, feature, distance), in order of queries, and return how many there are.
//
// A candidate lies in the square window, in the octave range, is `free` (null: all are), and where
// both have a right coordinate that agrees too. The best candidate must be within `max_distance`
// and, when the second best is of the same octave, beat it by `ratio`. A feature goes to the
// nearest of the queries that want it.
extern "C" MULTIVERSION int32_t hoid_match_by_projection(
  int32_t num_queries, const double* u, const double* v, const double* u_right,
  const double* radius_px, const int8_t* min_octave, const int8_t* max_octave,
  const uint8_t* query_descriptors, int32_t num_features, const float* measurement_px,
  const uint8_t* octave, const uint8_t* descriptors, const uint8_t* free, int32_t max_distance,
  double ratio, int32_t* query_out, int32_t* feature_out, int32_t* distance_out)
{
  if (num_features == 0) {
    return 0;
  }
  const Grid grid(measurement_px, num_features);
  std::vector<int> winner(num_features, -1), winner_distance(num_features, kFar);
  for (int q = 0; q < num_queries; ++q) {
    Best best;
    const double radius = radius_px[q];
    const uint8_t* mine = query_descriptors + static_cast<size_t>(q) * kDescriptorBytes;
    grid.visit(u[q], v[q], radius, [&](int k) __attribute__((always_inline)) {
      const float* at = measurement_px + 3 * static_cast<size_t>(k);
      const bool inside = std::abs(at[0] - u[q]) < radius && std::abs(at[1] - v[q]) < radius;
      if (!inside || octave[k] < min_octave[q] || octave[k] > max_octave[q] ||
          (free != nullptr && !free[k]) || std::abs(at[2] - u_right[q]) > radius) {
        return;  // a missing right coordinate is NaN, and agrees
      }
      const int distance =
        hamming(mine, descriptors + static_cast<size_t>(k) * kDescriptorBytes);
      if (distance < best.distance) {
        best = {k, distance, best.feature, best.distance};
      } else if (distance < best.second_distance) {
        best.second_feature = k;
        best.second_distance = distance;
      }
    });
    if (best.feature < 0 || best.distance > max_distance) {
      continue;
    }
    const bool rivalled =
      best.second_feature >= 0 && octave[best.second_feature] == octave[best.feature];
    if (rivalled && best.distance > ratio * best.second_distance) {
      continue;
    }
    if (best.distance < winner_distance[best.feature]) {
      winner[best.feature] = q;
      winner_distance[best.feature] = best.distance;
    }
  }
  std::vector<int> feature_of(num_queries, -1);
  for (int k = 0; k < num_features; ++k) {
    if (winner[k] >= 0) {
      feature_of[winner[k]] = k;
    }
  }
  int count = 0;
  for (int q = 0; q < num_queries; ++q) {
    if (feature_of[q] >= 0) {
      query_out[count] = q;
      feature_out[count] = feature_of[q];
      distance_out[count++] = winner_distance[feature_of[q]];
    }
  }
  return count;
}
