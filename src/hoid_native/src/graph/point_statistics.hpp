// What is derived from the observations of a map point: viewing direction, scale range, descriptor.
#pragma once

#include <cstdint>
#include <vector>

namespace hoid::graph {

// K keyframes with F features each.
struct KeyframeFeatures
{
  const double* T_map_camera;  // (K, 4, 4)
  const int64_t* uid;          // (K,)
  const uint8_t* octave;       // (K, F)
  const uint8_t* descriptors;  // (K, F, 32)
  int num_features;            // F
};

// All points of the map.
struct MapPoints
{
  const double* position_m;      // (P, 3)
  const int64_t* reference_uid;  // (P,) uid of the reference keyframe of each point
};

// N observations sorted by point: keyframe i observes point j in its feature k.
struct SortedObservations
{
  const int64_t *i, *k, *j;
  int count;
};

// The statistics of R points.
struct PointStatistics
{
  std::vector<int64_t> rows;           // (R,) rows of the points, in the order of observations
  std::vector<float> view_direction;   // (R, 3) unit vectors from the cameras to the point
  std::vector<int64_t> reference;      // (R,) row of the reference keyframe
  std::vector<float> max_distance_m;   // (R,)
  std::vector<uint8_t> descriptors;    // (R, 32)
};

// Return the statistics of all observed points. octave_scale has num_octaves scales; larger octaves
// have the last one.
PointStatistics point_statistics(
  const KeyframeFeatures& keyframes, const MapPoints& points, const SortedObservations& seen,
  const double* octave_scale, int num_octaves);

}  // namespace hoid::graph
