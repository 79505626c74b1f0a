// Descriptor matching: for each query the feature with the smallest Hamming distance in a search
// region.
#pragma once

#include <cstdint>
#include <vector>

#include "common/descriptors.hpp"
#include "common/views.hpp"

namespace hoid::matching {

// Queries with their octave limits, which are inclusive.
struct QueryConstraints
{
  const int8_t *min_octave, *max_octave;
  Descriptors descriptors;
};

// Features of one image, which may match a query.
struct Candidates
{
  Rows<float, 3> measurement_px;  // u, v, u_right; NaN u_right: no depth
  const uint8_t* octave;
  Descriptors descriptors;
  const uint8_t* free;  // not 0: may be matched; null: all may
};

// Limits that a match must meet.
struct MatchThreshold
{
  int max_distance;  // Hamming
  double ratio;      // largest ratio of best to second best distance (same octave); 1: no test
};

// Expected positions of the queries' features, and half sides of the square windows around them.
struct Windows
{
  Image<double> projection_px;  // (3, queries) u, v, u_right; NaN u_right: unknown
  const double* radius_px;
};

// Image segments (of epipolar lines) along which queries expect their features.
struct Segments
{
  Rows<double, 4> ends_px;         // u, v of both ends; NaN: no segment
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

// Return the (tables, descriptors) keys of descriptors in hash tables, in the upper 32 bits; the
// lower ones are 0. Bit n of a key of table t is bit bits[t][n] of the descriptor.
std::vector<uint64_t> hash_keys(const Descriptors& descriptors, const Image<uint8_t>& bits);

}  // namespace hoid::matching
