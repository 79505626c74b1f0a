// Planes through the measurements around a box.
#pragma once

#include <cstdint>
#include <optional>
#include <random>
#include <vector>

#include "objects/objects.hpp"

namespace hoid::objects {

struct Plane
{
  double normal[3];  // unit vector
  double offset_m;   // dot product of the normal and a point of the plane
};

// Return whether the depth at a pixel is on a plane, as far as the noise of depth shows.
bool is_on(const Plane& plane, const DepthPoints& image, int64_t pixel);

// Return the plane that most pixels are on, fitted to them; none if they are on a line. There must be
// one pixel at least.
std::optional<Plane> best_plane(
  const DepthPoints& image, const std::vector<int64_t>& pixels, std::mt19937& random);

}  // namespace hoid::objects
