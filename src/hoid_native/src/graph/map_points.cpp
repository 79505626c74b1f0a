#include "graph/map_points.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace hoid::graph {

namespace {

constexpr int kMaxCompared = 8;  // chosen: bounds the quadratic time; the newest are compared
constexpr double kTiny = 1e-9;   // a mean direction of zero length stays zero

ALWAYS_INLINE double length(const double* v)
{
  return std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
}

// Return the index of the descriptor with the smallest median distance to all; the first if
// several are equal. Two descriptors have the same distance to each other, so the newer one is
// taken.
ALWAYS_INLINE int most_distinctive(const uint8_t* const* descriptors, int count)
{
  if (count <= 2) {
    return count - 1;
  }
  int best = 0, least = std::numeric_limits<int>::max();
  for (int a = 0; a < count; ++a) {
    int distances[kMaxCompared];  // ascending
    for (int b = 0; b < count; ++b) {
      const int distance = hamming(descriptors[a], descriptors[b]);
      int n = b;
      for (; n > 0 && distances[n - 1] > distance; --n) {
        distances[n] = distances[n - 1];
      }
      distances[n] = distance;
    }
    const int two_medians = distances[(count - 1) / 2] + distances[count / 2];
    if (two_medians < least) {
      least = two_medians;
      best = a;
    }
  }
  return best;
}

}  // namespace

MULTIVERSION("popcnt")
PointStatistics point_statistics(
  const KeyframeFeatures& keyframes, const MapPoints& points, const SortedObservations& seen,
  const Rows<double>& octave_scale)
{
  PointStatistics out;
  const auto feature = [&](int n) { return seen.i[n] * keyframes.octave.width + seen.k[n]; };
  for (int first = 0, end = 0; first < seen.j.count; first = end) {
    const int64_t j = seen.j[first];
    const double* position_m = points.position_m[j];
    double mean[3] = {0, 0, 0}, reference_m = 0;
    int reference = -1;
    for (end = first; end < seen.j.count && seen.j[end] == j; ++end) {
      const double* T = keyframes.T_map_camera[seen.i[end]];
      const double ray[3] = {position_m[0] - T[3], position_m[1] - T[7], position_m[2] - T[11]};
      const double distance_m = length(ray);
      for (int axis = 0; axis < 3; ++axis) {
        mean[axis] += ray[axis] / distance_m;
      }
      // The first observation counts until that of the reference keyframe is found.
      const bool is_reference = keyframes.uid[seen.i[end]] == points.reference_uid[j];
      if (end == first || (is_reference && reference < 0)) {
        reference_m = distance_m;
      }
      if (is_reference && reference < 0) {
        reference = end;
      }
    }
    reference = reference < 0 ? first : reference;
    const double norm = std::max(length(mean), kTiny);
    const int octave = std::min<int>(keyframes.octave.data[feature(reference)], octave_scale.count - 1);
    const int compared = std::min(end - first, kMaxCompared);
    const uint8_t* last[kMaxCompared];
    for (int n = 0; n < compared; ++n) {
      last[n] = keyframes.descriptors[feature(end - compared + n)];
    }
    const uint8_t* chosen = last[most_distinctive(last, compared)];
    out.rows.push_back(j);
    for (const double axis : mean) {
      out.view_direction.push_back(static_cast<float>(axis / norm));
    }
    out.reference.push_back(seen.i[reference]);
    out.max_distance_m.push_back(static_cast<float>(reference_m * octave_scale[octave]));
    out.descriptors.insert(out.descriptors.end(), chosen, chosen + kDescriptorBytes);
  }
  return out;
}

void move_points(
  const Transforms& motions, const Numbers& which, double* position_m, float* view_direction)
{
  for (int n = 0; n < which.count; ++n, position_m += 3, view_direction += 3) {
    if (which[n] < 0) {
      continue;
    }
    const double* T = motions[which[n]];
    const double p[3] = {position_m[0], position_m[1], position_m[2]};
    const float v[3] = {view_direction[0], view_direction[1], view_direction[2]};
    transform(T, p, position_m);
    for (int row = 0; row < 3; ++row) {
      const double* R = T + 4 * row;
      view_direction[row] = static_cast<float>(R[0] * v[0] + R[1] * v[1] + R[2] * v[2]);
    }
  }
}

}  // namespace hoid::graph
