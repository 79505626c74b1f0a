// The observations of map points by keyframes, and the numbers of points that two keyframes share.
// The cost of most calls depends on the observations concerned and not on the size of the map.
#pragma once

#include <cstdint>
#include <utility>
#include <vector>

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

// The (K, F) points that the F features of K keyframes observe (-1: none), row-major.
struct PointTable
{
  const int32_t* points;
  int num_keyframes, num_features;
};

// The poses of N keyframes and the spanning tree.
struct Poses
{
  const double* T_map_camera;  // (N, 4, 4)
  const int64_t* parents;      // (N,) row of each keyframe's parent; negative: none
  int count;
};

// Keyframes (i), their features (k) and points (j) are numbered by row. Observations are added one
// by one, while the numbers of shared points change only by `connect`, `set_neighbors` and
// `clear`.
class ObservationGraph
{
public:
  // Add observations: keyframe i[n] observes point j[n] in its feature k[n].
  void observe(const int64_t* i, const int64_t* k, const int64_t* j, int count);

  // Remove observations. Throws std::invalid_argument if one of them does not exist; those before
  // it are removed nevertheless.
  void unobserve(const int64_t* i, const int64_t* k, const int64_t* j, int count);

  // Remove all observations and connections.
  void clear();

  // Return the observations of points j, sorted by keyframe and feature.
  Observations observations(const int64_t* j, int count) const;

  // Return the observations of points j, sorted by point, keyframe and feature.
  Observations observations_by_point(const int64_t* j, int count) const;

  // Return the observations of points j by the given keyframes, in the order of these keyframes,
  // then sorted by feature.
  Observations observations_by(
    const int64_t* j, int count, const int64_t* keyframes, int num_keyframes) const;

  // Count the points that keyframe i shares with every other keyframe anew. j are the points that
  // keyframe i observes.
  void connect(int64_t i, const int64_t* j, int count);

  // Set the neighbors of keyframe i, and the number of points that each shares with it. The rows
  // must be ascending. The connections of other keyframes with i change accordingly.
  void set_neighbors(int64_t i, const int64_t* rows, const int64_t* shared, int count);

  // Return the keyframes that share at least min_shared points with keyframe i. Those that share
  // most come first, those that share equally many are sorted by row.
  Neighbors neighbors(int64_t i, int64_t min_shared) const;

  // Return the pairs of keyframes that share at least min_shared points, sorted by first and then
  // by second row. The first row of a pair is the smaller one.
  Edges edges(int64_t min_shared) const;

  // Return the length [m] of the shortest path between keyframes start and goal; infinity if there
  // is none. A path leads over pairs of keyframes that share at least min_shared points and over
  // the spanning tree. The length of a step is its distance plus m_per_rad for each radian of
  // rotation.
  double path_length_m(
    const Poses& poses, int64_t start, int64_t goal, int64_t min_shared, double m_per_rad) const;

  // Return for each of the given keyframes how many of the points j it observes.
  std::vector<int64_t> count_observed(
    const int64_t* j, int count, const int64_t* keyframes, int num_keyframes) const;

  // Return the points that any of the given keyframes observes, ascending.
  std::vector<int64_t> points_of(
    const PointTable& table, const int64_t* keyframes, int num_keyframes);

private:
  struct Observer
  {
    int32_t keyframe, feature;
    int32_t next;  // index of the next observer of the same point, or kNone
  };

  using Connection = std::pair<int32_t, int32_t>;  // row of the other keyframe, shared points

  // Call visit(observer, point) for every observation of points j.
  template <typename Visit>
  void visit(const int64_t* j, int count, Visit visit) const;
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
