// The best two candidates of a query, and the one-to-one assignment.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

#include "common/multiversion.hpp"
#include "matching/matching.hpp"

namespace hoid::matching {

constexpr int kFar = 257;  // farther than any two descriptors

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

ALWAYS_INLINE int hamming(const uint8_t* a, const uint8_t* b)
{
  uint64_t x[4], y[4];
  std::memcpy(x, a, kDescriptorBytes);
  std::memcpy(y, b, kDescriptorBytes);
  return __builtin_popcountll(x[0] ^ y[0]) + __builtin_popcountll(x[1] ^ y[1]) +
         __builtin_popcountll(x[2] ^ y[2]) + __builtin_popcountll(x[3] ^ y[3]);
}

// What is matched, and how near it must be.
struct Problem
{
  QueryConstraints wanted;
  Candidates candidates;
  MatchThreshold threshold;

  ALWAYS_INLINE bool may_match(int q, int k) const
  {
    return candidates.octave[k] >= wanted.min_octave[q] &&
           candidates.octave[k] <= wanted.max_octave[q] &&
           (candidates.free == nullptr || candidates.free[k] != 0);
  }

  ALWAYS_INLINE int distance(int q, int k) const
  {
    return hamming(
      wanted.descriptors + static_cast<std::size_t>(q) * kDescriptorBytes,
      candidates.descriptors + static_cast<std::size_t>(k) * kDescriptorBytes);
  }

  bool is_clear(const Best& best) const
  {
    if (best.feature < 0 || best.distance > threshold.max_distance) {
      return false;
    }
    const bool rivalled = best.second_feature >= 0 && candidates.octave[best.second_feature] ==
                                                        candidates.octave[best.feature];
    return !(rivalled && best.distance > threshold.ratio * best.second_distance);
  }
};

// Gives each feature to the nearest of the queries that want it.
class Assignment
{
public:
  explicit Assignment(int num_features) : winner_(num_features, -1), distance_(num_features, kFar)
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
