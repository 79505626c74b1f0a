// Parts of a depth image: boxes of pixels, planes, and the nearest part of a box.
#pragma once

#include <algorithm>
#include <optional>
#include <random>
#include <vector>

#include "common/pixel_box.hpp"
#include "objects/objects.hpp"

namespace hoid::objects {

using Pixels = std::vector<int64_t>;  // flat indices, ascending

// Return whether a point of the map frame is inside a box, not on its border.
inline bool is_in_box(
  const double* T_box_map, const double* low, const double* high, const double* p)
{
  double local[3];
  transform(T_box_map, p, local);
  for (int axis = 0; axis < 3; ++axis) {
    if (!(local[axis] > low[axis] && local[axis] < high[axis])) {
      return false;
    }
  }
  return true;
}

// Return the ratio of points that fulfill a condition; 0 without points.
template <typename Condition>
double share_of(const Points& points_m, Condition is_true)
{
  int num = 0;
  for (int n = 0; n < points_m.count; ++n) {
    num += is_true(points_m[n]) ? 1 : 0;
  }
  return static_cast<double>(num) / std::max(points_m.count, 1);
}

// Return those of the given pixels that show the object: its surface begins at the nearest range
// of depth with many pixels, and ends behind it at the first gap in depth.
// `pixels` are the pixels of the box that have a depth, `side_px` is the longer side of the box.
Pixels nearest_part(const DepthPoints& image, const Pixels& pixels, int side_px);

struct Plane
{
  double normal[3];  // unit vector
  double offset_m;   // dot product of the normal and a point of the plane
};

// Return whether the depth at a pixel is on a plane, as far as the noise of depth shows: within about
// 1.4 standard deviations, times `scale`.
bool is_on(const Plane& plane, const DepthPoints& image, int64_t pixel, double scale);

// Return the plane that most pixels are on, fitted to them; none if they are on a line. There must be
// one pixel at least.
std::optional<Plane> best_plane(
  const DepthPoints& image, const Pixels& pixels, std::mt19937& random);

}  // namespace hoid::objects
