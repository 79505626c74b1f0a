// Descriptor matching: for each query the feature with the smallest Hamming distance in a search
// region.
#pragma once

#include <cstdint>
#include <vector>

namespace hoid::matching {

constexpr int kDescriptorBytes = 32;

// Octaves and descriptors of queries.
struct QueryConstraints
{
  const int8_t *min_octave, *max_octave;  // inclusive
  const uint8_t* descriptors;             // (count, 32)
  int count;
};

// Features to match.
struct Candidates
{
  const float* measurement_px;  // (count, 3) u, v, u_right; NaN u_right: no depth
  const uint8_t* octave;
  const uint8_t* descriptors;  // (count, 32)
  const uint8_t* free;         // not 0: may be matched; null: all may
  int count;
};

// Threshold of a match.
struct MatchThreshold
{
  int max_distance;  // Hamming
  double ratio;      // largest ratio of best to second best distance (same octave); 1: no test
};

// Expected positions of the queries' features, and half sides of the square windows around them.
struct Windows
{
  const double *u, *v, *u_right;  // NaN u_right: unknown
  const double* radius_px;
};

// Image segments (of epipolar lines) along which queries expect their features.
struct Segments
{
  const double* ends_px;           // (queries, 4) u, v of both ends; NaN: no segment
  const double* octave_radius_px;  // largest distance of a feature of each octave, not decreasing
};

// One-to-one matches in order of queries: query, feature, Hamming distance.
struct Pairs
{
  std::vector<int32_t> q, k, distance;
};

// Match features within windows. Right coordinates must agree, too, if both are known.
Pairs match_by_projection(
  const Windows& windows, const QueryConstraints& queries, const Candidates& candidates,
  const MatchThreshold& threshold);

// Match features near segments. Right coordinates are ignored.
Pairs match_along_segments(
  const Segments& segments, const QueryConstraints& queries, const Candidates& candidates,
  const MatchThreshold& threshold);

// Return the row of each group's descriptor with the smallest median distance to all of them, as
// ORB-SLAM's ComputeDistinctiveDescriptors. Only the last 8 rows of a group are compared. Groups
// are consecutive and not empty.
std::vector<int64_t> distinctive_descriptors(
  const uint8_t* descriptors, int64_t count, const int64_t* starts, int num_groups);

}  // namespace hoid::matching
