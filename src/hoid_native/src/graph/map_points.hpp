// Computes viewing direction, scale range and descriptor of each map point from its observations,
// and moves points with their keyframes.
#pragma once

#include <vector>

#include "common/descriptors.hpp"
#include "graph/observation_graph.hpp"

namespace hoid::graph {

// K keyframes with F features each.
struct KeyframeFeatures
{
  Transforms T_map_camera;
  const int64_t* uid;
  Image<uint8_t> octave;    // (K, F)
  Descriptors descriptors;  // of the K * F features
};

// All points of the map.
struct MapPoints
{
  Points position_m;
  const int64_t* reference_uid;  // uid of the reference keyframe of each point
};

// Observations sorted by point: keyframe i observes point j in its feature k.
struct SortedObservations
{
  Numbers i, k, j;
};

// Statistics of the observed points; the fields are those of hoid_native.results.PointStatistics.
struct PointStatistics
{
  std::vector<int64_t> rows;
  std::vector<float> view_direction;
  std::vector<int64_t> reference;
  std::vector<float> max_distance_m;
  std::vector<uint8_t> descriptors;
};

// Return the statistics of all observed points. Octaves beyond the list of scales have its last
// scale.
PointStatistics point_statistics(
  const KeyframeFeatures& keyframes, const MapPoints& points, const SortedObservations& seen,
  const Rows<double>& octave_scale);

// Apply rigid motions to the positions (N, 3) and the viewing directions (N, 3) of points, in
// place. `which` has the index of the motion of each point; negative: it does not move.
void move_points(
  const Transforms& motions, const Numbers& which, double* position_m, float* view_direction);

}  // namespace hoid::graph
