// Matching: the feature nearest in Hamming distance among those that may show what is looked for.
#pragma once

#include <cstdint>
#include <vector>

namespace hoid::matching {

constexpr int kDescriptorBytes = 32;

// What queries ask of a feature, wherever it lies.
struct QueryConstraints
{
  const int8_t *min_octave, *max_octave;  // inclusive
  const uint8_t* descriptors;             // (count, 32)
  int count;
};

// Features among which queries look for theirs.
struct Candidates
{
  const float* measurement_px;  // (count, 3) u, v, u_right; NaN u_right: no depth
  const uint8_t* octave;
  const uint8_t* descriptors;  // (count, 32)
  const uint8_t* free;         // not 0 for those that may be matched; null: all
  int count;
};

// How good a match must be.
struct MatchThreshold
{
  int max_distance;  // Hamming
  double ratio;      // by which the best must beat a second best of its octave; 1: no test
};

// Where queries expect their features, and the half sides of the square windows around that.
struct Windows
{
  const double *u, *v, *u_right;  // NaN u_right: unknown
  const double* radius_px;
};

// Segments along which queries expect their features.
struct Segments
{
  const double* ends_px;           // (queries, 4) u, v of both ends; NaN: nowhere
  const double* octave_radius_px;  // how far from a segment a feature of each octave may lie
};

// Matches in order of queries; nothing occurs twice.
struct Pairs
{
  std::vector<int32_t> q, k, distance;
};

// Match features within windows, whose right coordinate agrees where both know one.
Pairs match_by_projection(
  const Windows& windows, const QueryConstraints& wanted, const Candidates& candidates,
  const MatchThreshold& threshold);

// Match features near segments; their right coordinate is not looked at.
Pairs match_along_segments(
  const Segments& segments, const QueryConstraints& wanted, const Candidates& candidates,
  const MatchThreshold& threshold);

// Return the row of each group's descriptor with the least median distance to the others; only a
// group's last rows are compared when it is large. Groups have a row or more, in order.
std::vector<int64_t> typical_descriptors(
  const uint8_t* descriptors, int64_t count, const int64_t* starts, int num_groups);

}  // namespace hoid::matching
