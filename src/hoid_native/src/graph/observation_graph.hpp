// The observations of map points by keyframes, and the numbers of points that two keyframes share.
#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "common/views.hpp"

namespace hoid::graph {

// N observations as parallel arrays: keyframe i observes point j in its feature k.
struct Observations
{
  std::vector<int64_t> i, k, j;
};

// The neighbors of one keyframe: their rows, and the number of points that each shares with it.
struct Neighbors
{
  std::vector<int64_t> rows, shared;
};

// Pairs of keyframes (rows), and the number of points that the two share.
struct Edges
{
  std::vector<int64_t> first, second, shared;
};

// The poses of N keyframes and the spanning tree.
struct SpanningTree
{
  Transforms T_map_camera;
  const int64_t* parents;  // row of each keyframe's parent; negative: none
};

using Numbers = Rows<int64_t>;

// Keyframes (i), their features (k) and points (j) are numbered by row. Observations are added one
// by one, while the numbers of shared points change only by `connect`, `set_neighbors` and
// `clear`. The docstrings of the bindings say what the functions do.
class ObservationGraph
{
public:
  void observe(const Numbers& i, const Numbers& k, const Numbers& j);
  // Throws std::invalid_argument if an observation does not exist.
  void unobserve(const Numbers& i, const Numbers& k, const Numbers& j);
  void clear();
  // `keyframes`: null for all.
  Observations observations(const Numbers& j, const Numbers* keyframes) const;
  Observations observations_by_point(const Numbers& j) const;
  void connect(int64_t i, const Numbers& j);
  void set_neighbors(int64_t i, const Numbers& rows, const Numbers& shared);
  Neighbors neighbors(int64_t i, int64_t min_shared) const;
  Edges edges(int64_t min_shared) const;
  double path_length_m(
    const SpanningTree& tree, int64_t start, int64_t goal, int64_t min_shared,
    double m_per_rad) const;
  std::vector<int64_t> count_observed(const Numbers& j, const Numbers& keyframes) const;
  // `table` has the points that the features (columns) of all keyframes (rows) observe; -1: none.
  std::vector<int64_t> points_of(const Image<int32_t>& table, const Numbers& keyframes);

private:
  struct Observer
  {
    int32_t keyframe, feature;
    int32_t next;  // index of the next observer of the same point, or kNone
  };

  using Connection = std::pair<int32_t, int32_t>;  // row of the other keyframe, shared points

  // Call visit(observer, point) for every observation of points j.
  template <typename Visit>
  void visit(const Numbers& j, Visit visit) const;
  // Set the number of points that a keyframe shares with one neighbor; 0 removes the neighbor.
  void set_neighbor(int64_t of, int64_t neighbor, int64_t shared);

  std::vector<int32_t> first_;  // by point: index of its first observer, or kNone
  std::vector<Observer> observers_;
  std::vector<int32_t> free_;  // unused elements of observers_
  std::vector<std::vector<Connection>> connections_;  // by keyframe: its neighbors, sorted by row
  std::vector<uint32_t> marks_;  // by point: number of the last search (`points_of`) that found it
  uint32_t search_ = 0;          // number of the last search
};

}  // namespace hoid::graph
