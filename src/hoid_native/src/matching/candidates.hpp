// The two best candidates of a query, and the one-to-one assignment of features to queries.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

#include "common/multiversion.hpp"
#include "matching/matching.hpp"

namespace hoid::matching {

constexpr int kMaxDistance = 257;  // more than the largest Hamming distance of 256 bits

struct Best
{
  int feature = -1;
  int distance = kMaxDistance;
  int second_feature = -1;
  int second_distance = kMaxDistance;

  void update(int k, int new_distance)
  {
    if (new_distance < distance) {
      *this = {k, new_distance, feature, distance};
    } else if (new_distance < second_distance) {
      second_feature = k;
      second_distance = new_distance;
    }
  }
};

ALWAYS_INLINE int hamming(const uint8_t* a, const uint8_t* b)
{
  uint64_t x[4], y[4];
  std::memcpy(x, a, kDescriptorBytes);
  std::memcpy(y, b, kDescriptorBytes);
  return __builtin_popcountll(x[0] ^ y[0]) + __builtin_popcountll(x[1] ^ y[1]) +
         __builtin_popcountll(x[2] ^ y[2]) + __builtin_popcountll(x[3] ^ y[3]);
}

// Queries, candidates and the threshold of a match.
struct Problem
{
  QueryConstraints queries;
  Candidates candidates;
  MatchThreshold threshold;

  ALWAYS_INLINE bool may_match(int q, int k) const
  {
    return candidates.octave[k] >= queries.min_octave[q] &&
           candidates.octave[k] <= queries.max_octave[q] &&
           (candidates.free == nullptr || candidates.free[k] != 0);
  }

  ALWAYS_INLINE int distance(int q, int k) const
  {
    return hamming(
      queries.descriptors + static_cast<std::size_t>(q) * kDescriptorBytes,
      candidates.descriptors + static_cast<std::size_t>(k) * kDescriptorBytes);
  }

  // Whether the best candidate passes the threshold. Lowe's ratio test (IJCV 2004) applies if the
  // second best has the same octave, as in ORB-SLAM.
  bool is_match(const Best& best) const
  {
    if (best.feature < 0 || best.distance > threshold.max_distance) {
      return false;
    }
    const bool needs_ratio_test =
      best.second_feature >= 0 &&
      candidates.octave[best.second_feature] == candidates.octave[best.feature];
    return !(needs_ratio_test && best.distance > threshold.ratio * best.second_distance);
  }
};

// Assigns each feature to the query with the smallest descriptor distance.
class Assignment
{
public:
  explicit Assignment(int num_features)
  : winner_(num_features, -1),
    distance_(num_features, kMaxDistance)
  {
  }

  void offer(int q, const Best& best)
  {
    if (best.distance < distance_[best.feature]) {
      winner_[best.feature] = q;
      distance_[best.feature] = best.distance;
    }
  }

  Pairs pairs(int num_queries) const
  {
    std::vector<int32_t> feature_of(num_queries, -1);
    for (std::size_t k = 0; k < winner_.size(); ++k) {
      if (winner_[k] >= 0) {
        feature_of[winner_[k]] = static_cast<int32_t>(k);
      }
    }
    Pairs out;
    for (int q = 0; q < num_queries; ++q) {
      if (feature_of[q] >= 0) {
        out.q.push_back(q);
        out.k.push_back(feature_of[q]);
        out.distance.push_back(distance_[feature_of[q]]);
      }
    }
    return out;
  }

private:
  std::vector<int> winner_, distance_;
};

}  // namespace hoid::matching
