// Matching: the feature nearest in Hamming distance within a window around each query's expected
// pixel, or along the line where it can be, one to one.

#include <algorithm>
#include <cmath>

#include "matching.hpp"

namespace {

using namespace matching;

// Squared distance of a pixel from a segment that starts at a and runs along (du, dv).
ALWAYS_INLINE double square_from_segment(
  double u, double v, double du, double dv)
{
  const double length2 = du * du + dv * dv;
  const double share = length2 > 0 ? std::clamp((u * du + v * dv) / length2, 0.0, 1.0) : 0.0;
  const double apart_u = u - share * du, apart_v = v - share * dv;
  return apart_u * apart_u + apart_v * apart_v;
}

}  // namespace

// Write pairs (query, feature, distance), in order of queries, and return how many there are.
//
// A candidate lies in the square window, in the octave range, is `free` (null: all are), and where
// both have a right coordinate that agrees too. The best candidate must be within `max_distance`
// and, when the second best is of the same octave, beat it by `ratio`. A feature goes to the
// nearest of the queries that want it.
extern "C" MULTIVERSION("popcnt") int32_t hoid_match_by_projection(
  int32_t num_queries, const double* u, const double* v, const double* u_right,
  const double* radius_px, const int8_t* min_octave, const int8_t* max_octave,
  const uint8_t* query_descriptors, int32_t num_features, const float* measurement_px,
  const uint8_t* octave, const uint8_t* descriptors, const uint8_t* free, int32_t max_distance,
  double ratio, int32_t* query_out, int32_t* feature_out, int32_t* distance_out)
{
  const Problem problem{num_queries, num_features, min_octave, max_octave, query_descriptors,
                        measurement_px, octave, descriptors, free, max_distance, ratio};
  if (num_features == 0) {
    return 0;
  }
  const Grid grid(measurement_px, num_features);
  Assignment assignment(num_features);
  for (int q = 0; q < num_queries; ++q) {
    Best best;
    const double radius = radius_px[q];
    const auto consider = [&](int k) __attribute__((always_inline)) {
      const float* at = measurement_px + 3 * static_cast<size_t>(k);
      const bool inside = std::abs(at[0] - u[q]) < radius && std::abs(at[1] - v[q]) < radius;
      if (!inside || !problem.may_match(q, k) || std::abs(at[2] - u_right[q]) > radius) {
        return;  // a missing right coordinate is NaN, and agrees
      }
      best.consider(k, problem.distance(q, k));
    };
    grid.visit(u[q] - radius, v[q] - radius, u[q] + radius, v[q] + radius, consider);
    if (problem.is_clear(best)) {
      assignment.offer(q, best);
    }
  }
  return assignment.write(num_queries, query_out, feature_out, distance_out);
}

// The same along segments (queries, 4): u, v of both ends. A candidate lies within the radius of
// its own octave (octaves) of the segment.
extern "C" MULTIVERSION("popcnt") int32_t hoid_match_along_segments(
  int32_t num_queries, const double* segments_px, const double* octave_radius_px,
  const int8_t* min_octave, const int8_t* max_octave, const uint8_t* query_descriptors,
  int32_t num_features, const float* measurement_px, const uint8_t* octave,
  const uint8_t* descriptors, const uint8_t* free, int32_t max_distance, double ratio,
  int32_t* query_out, int32_t* feature_out, int32_t* distance_out)
{
  const Problem problem{num_queries, num_features, min_octave, max_octave, query_descriptors,
                        measurement_px, octave, descriptors, free, max_distance, ratio};
  if (num_features == 0) {
    return 0;
  }
  const Grid grid(measurement_px, num_features);
  Assignment assignment(num_features);
  for (int q = 0; q < num_queries; ++q) {
    Best best;
    const double* at = segments_px + 4 * static_cast<size_t>(q);
    const double du = at[2] - at[0], dv = at[3] - at[1];
    const double reach = octave_radius_px[max_octave[q]];
    const auto consider = [&](int k) __attribute__((always_inline)) {
      const float* pixel = measurement_px + 3 * static_cast<size_t>(k);
      const double radius = octave_radius_px[octave[k]];
      if (!problem.may_match(q, k) ||
          square_from_segment(pixel[0] - at[0], pixel[1] - at[1], du, dv) > radius * radius) {
        return;
      }
      best.consider(k, problem.distance(q, k));
    };
    grid.visit(
      std::min(at[0], at[2]) - reach, std::min(at[1], at[3]) - reach,
      std::max(at[0], at[2]) + reach, std::max(at[1], at[3]) + reach, consider);
    if (problem.is_clear(best)) {
      assignment.offer(q, best);
    }
  }
  return assignment.write(num_queries, query_out, feature_out, distance_out);
}
