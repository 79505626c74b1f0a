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

// Return the (num_tables, count) keys of descriptors (count, 32) in hash tables, in the 32 upper
// bits; the others are 0. Bit n of a key of table t is bit bits[t][n] of the descriptor.
std::vector<uint64_t> hash_keys(
  const uint8_t* descriptors, int count, const uint8_t* bits, int num_tables, int key_bits);

// Sort the keys of each table (num_tables, count) by their upper 32 bits. Equal ones keep their
// order.
void sort_hash_keys(uint64_t* keys, int count, int num_tables, int key_bits);

}  // namespace hoid::matching
