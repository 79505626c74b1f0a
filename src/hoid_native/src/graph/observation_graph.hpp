// Which keyframes observe which map points, and how many points two keyframes share. The cost of
// each call depends on the observations concerned, not on the size of the map.
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

// Keyframes as rows, and the number of points that each shares with another one.
struct Neighbors
{
  std::vector<int64_t> rows, shared;
};

struct Edges
{
  std::vector<int64_t> first, second, shared;
};

// The (K, F) points that features observe (-1: none), row-major.
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

class ObservationGraph
{
public:
  void observe(const int64_t* i, const int64_t* k, const int64_t* j, int count);

  // Throws std::invalid_argument if one of them is not known.
  void unobserve(const int64_t* i, const int64_t* k, const int64_t* j, int count);

  void clear();

  // The observations of points, sorted by keyframe and feature.
  Observations observations(const int64_t* j, int count) const;

  // The same of given keyframes only, in their order.
  Observations observations_by(
    const int64_t* j, int count, const int64_t* keyframes, int num_keyframes) const;

  // Recount the points that keyframe i, which observes points j, shares with all others.
  void connect(int64_t i, const int64_t* j, int count);

  // Replace the connections of keyframe i, also those of the others to it.
  void set_neighbors(int64_t i, const int64_t* rows, const int64_t* shared, int count);

  // The keyframes that share at least min_shared points with keyframe i, most first, then by row.
  Neighbors neighbors(int64_t i, int64_t min_shared) const;

  // The pairs of keyframes that share at least min_shared points, by first and second row.
  Edges edges(int64_t min_shared) const;

  // The length [m] of the shortest path between two keyframes over pairs that share at least
  // min_shared points and over the spanning tree; infinite without a path.
  double path_length_m(
    const Poses& poses, int64_t start, int64_t goal, int64_t min_shared, double m_per_rad) const;

  // For each of some keyframes, how many of the points j it observes.
  std::vector<int64_t> count_observed(
    const int64_t* j, int count, const int64_t* keyframes, int num_keyframes) const;

  // The points that any of some keyframes observes, ascending.
  std::vector<int64_t> points_of(
    const PointTable& table, const int64_t* keyframes, int num_keyframes);

private:
  struct Observer
  {
    int32_t keyframe, feature;
    int32_t next;  // observer of the same point, or kNone
  };

  using Connection = std::pair<int32_t, int32_t>;  // row of the other keyframe, shared points

  template <typename Visit>
  void visit(const int64_t* j, int count, Visit visit) const;
  void set_neighbor(int64_t of, int64_t neighbor, int64_t shared);

  std::vector<int32_t> first_;  // of each point, its first observer, or kNone
  std::vector<Observer> observers_;
  std::vector<int32_t> free_;  // unused elements of observers_
  std::vector<std::vector<Connection>> connections_;  // of each keyframe, by row
  std::vector<uint32_t> marks_;  // of each point, the last search that marked it
  uint32_t search_ = 0;
};

}  // namespace hoid::graph
