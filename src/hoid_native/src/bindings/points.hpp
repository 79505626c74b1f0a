// Points of the pixels of a depth image, and other arrays of points.
#pragma once

#include <array>
#include <cstddef>
#include <utility>
#include <vector>

#include "bindings/arrays.hpp"
#include "bindings/checks.hpp"
#include "objects/objects.hpp"

namespace hoid::bindings {

using Points = Array<double, -1, 3>;

inline objects::DepthPoints view(
  const ImageArray<float>& depth_m, const Points& points_m, double pixel_m)
{
  require_pixels("depth_m", depth_m);
  require_length("points_map_m", points_m, static_cast<int>(depth_m.array.size()));
  return {view(depth_m), points_m.data(), pixel_m};
}

inline auto give_points(std::vector<double>&& values)
{
  const std::array<std::size_t, 2> shape{values.size() / 3, 3};
  return give(std::move(values), shape);
}

}  // namespace hoid::bindings
