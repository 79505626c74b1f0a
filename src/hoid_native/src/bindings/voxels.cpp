#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>

#include <algorithm>
#include <array>
#include <optional>
#include <tuple>

#include "bindings/arrays.hpp"
#include "bindings/checks.hpp"
#include "bindings/module.hpp"
#include "bindings/points.hpp"
#include "objects/objects.hpp"

namespace hoid::bindings {

namespace {

using namespace nb::literals;

HOID_RESULT(Voxels);

using Matrix = Array<double, 4, 4>;
using Corner = Array<double, 3>;
using BoxTuple = std::tuple<int, int, int, int>;
// The five arrays of `hoid_native.results.Voxels`, in the same order.
using VoxelTuple =
  std::tuple<Vector<int64_t>, Points, Vector<float>, Vector<float>, Vector<float>>;

constexpr int kMaxBits = 20;  // three of them fit into a key

objects::VoxelGrid grid_of(double voxel_m, int bits)
{
  require(voxel_m > 0, "voxel_m: must be positive");
  require(bits >= 1 && bits <= kMaxBits, "bits: must be within 1 to 20");
  return {voxel_m, bits};
}

objects::VoxelView view(const VoxelTuple& voxels)
{
  const auto& [keys, means, readings, hits, misses] = voxels;
  require_length("means_m", means, keys.size());
  require_length("readings", readings, keys.size());
  require_length("hits", hits, keys.size());
  require_length("misses", misses, keys.size());
  return {keys.data(),   means.data(),   readings.data(),
          hits.data(),   misses.data(),  keys.size()};
}

Voxels give_voxels(objects::Voxels&& found)
{
  return make<Voxels>(
    give(std::move(found.keys)), give_points(std::move(found.means_m)),
    give(std::move(found.readings)), give(std::move(found.hits)), give(std::move(found.misses)));
}

auto voxel_keys(const Points& points_m, double voxel_m, int bits)
{
  const objects::VoxelGrid grid = grid_of(voxel_m, bits);
  std::vector<int64_t> keys(points_m.size());
  unlocked([&] { objects::voxel_keys(points_m.data(), points_m.size(), grid, keys.data()); });
  return give(std::move(keys));
}

Voxels voxels_of(const Points& points_m, double voxel_m, int bits)
{
  const objects::VoxelGrid grid = grid_of(voxel_m, bits);
  return give_voxels(
    unlocked([&] { return objects::voxels_of(points_m.data(), points_m.size(), grid); }));
}

Voxels merged_voxels(
  const VoxelTuple& voxels, const VoxelTuple& others, float max_count, int max_voxels)
{
  require(max_voxels >= 1, "max_voxels: must be at least 1");
  const objects::VoxelView first = view(voxels), second = view(others);
  return give_voxels(unlocked(
    [&] { return objects::merged_voxels(first, second, {max_count, max_voxels}); }));
}

auto solid_voxels(
  const VoxelTuple& voxels, double least_hits, double least_share, std::optional<double> cell_m,
  int bits)
{
  const objects::VoxelView all = view(voxels);
  const objects::VoxelGrid cells = grid_of(cell_m.value_or(1.0), bits);
  std::vector<uint8_t> solid(all.count);
  unlocked([&] {
    objects::solid_voxels(
      all, least_hits, least_share, cell_m ? &cells : nullptr, solid.data());
  });
  const std::array<std::size_t, 1> shape{solid.size()};
  return give<uint8_t, bool>(std::move(solid), shape);
}

auto trimmed_box(
  const Points& points_m, const std::optional<Vector<bool>>& chosen, double outer_share)
{
  require(outer_share >= 0 && outer_share <= 0.5, "outer_share: must be within 0 to 0.5");
  if (chosen) {
    require_length("chosen", *chosen, points_m.size());
  }
  const auto* flags = chosen ? reinterpret_cast<const uint8_t*>(chosen->data()) : nullptr;
  const bool has_any = flags == nullptr
                         ? points_m.size() > 0
                         : std::any_of(flags, flags + points_m.size(), [](uint8_t f) { return f; });
  require(has_any, "points_m: there must be one at least");
  std::vector<double> low(3), high(3);
  unlocked([&] {
    objects::trimmed_box(
      points_m.data(), points_m.size(), flags, outer_share, low.data(), high.data());
  });
  return std::tuple{give(std::move(low)), give(std::move(high))};
}

auto cells_of(const Points& points_m, const Vector<bool>& chosen, double cell_m, int bits)
{
  require_length("chosen", chosen, points_m.size());
  const objects::VoxelGrid grid = grid_of(cell_m, bits);
  return give(unlocked([&] {
    return objects::cells_of(
      points_m.data(), points_m.size(), reinterpret_cast<const uint8_t*>(chosen.data()), grid);
  }));
}

auto pixels_on_surface(
  const ImageArray<float>& depth_m, const Points& points_map_m, const BoxTuple& box_px,
  const Matrix& T_object_map, const Vector<int64_t>& cells, double cell_m, int bits)
{
  const objects::DepthPoints image = view(depth_m, points_map_m, 0.0);
  const objects::SurfaceCells surface{
    T_object_map.data(), cells.data(), cells.size(), grid_of(cell_m, bits)};
  const auto [left, top, right, bottom] = box_px;
  const int box[] = {
    std::max(left, 0), std::max(top, 0), std::min(right, depth_m.size(1)),
    std::min(bottom, depth_m.size(0))};
  return give(unlocked([&] { return objects::pixels_on_surface(image, box, surface); }));
}

double share_on_surface(
  const Points& points_map_m, const Matrix& T_object_map, const Vector<int64_t>& cells,
  double cell_m, int bits)
{
  const objects::SurfaceCells surface{
    T_object_map.data(), cells.data(), cells.size(), grid_of(cell_m, bits)};
  return unlocked([&] {
    return objects::share_on_surface(points_map_m.data(), points_map_m.size(), surface);
  });
}

double share_in_box(
  const Points& points_map_m, const Matrix& T_box_map, const Corner& low_m, const Corner& high_m)
{
  return unlocked([&] {
    return objects::share_in_box(
      points_map_m.data(), points_map_m.size(), T_box_map.data(), low_m.data(), high_m.data());
  });
}

}  // namespace

void bind_voxels(nb::module_& module)
{
  module.def("voxel_keys", &voxel_keys, "points_m"_a, "voxel_m"_a, "bits"_a, R"(
Return the (N,) int64 keys of the voxels of points (N, 3); -1 outside the grid.

Args:
    points_m: (N, 3) points.
    voxel_m: side of a voxel.
    bits: the grid has 2^bits voxels along each axis, half of them on either side of the origin.

Raises:
    ValueError: voxel_m is not positive, or bits is not within 1 to 20.)");
  module.def("voxels_of", &voxels_of, "points_m"_a, "voxel_m"_a, "bits"_a, R"(
Return the voxels of the points (N, 3) of one look, each of which was hit once.

Points outside the grid are left out (see `voxel_keys`).

Raises:
    ValueError: voxel_m is not positive, or bits is not within 1 to 20.)");
  module.def(
    "merged_voxels", &merged_voxels, "voxels"_a, "others"_a, "max_count"_a, "max_voxels"_a, R"(
Return the voxels of two sets, with the sum of the evidence where both have one.

Args:
    voxels: keys (ascending), means, readings, hits and misses (`Voxels`).
    others: the same of the other set.
    max_count: hits and misses of a voxel are scaled down together to this sum.
    max_voxels: of more voxels, those with fewest hits are left out.

Raises:
    ValueError: Lengths differ, or max_voxels is less than 1.)");
  module.def(
    "solid_voxels", &solid_voxels, "voxels"_a, "least_hits"_a, "least_share"_a,
    "cell_m"_a.none(), "bits"_a, R"(
Return the (N,) bool mask of the voxels that were hit often enough.

Args:
    voxels: keys, means, readings, hits and misses (`Voxels`).
    least_hits: smallest number of hits.
    least_share: smallest share of the hits in the sum of hits and misses.
    cell_m: side of the cells whose voxels are counted together; None: each is counted alone.
    bits: number of cells along each axis (see `voxel_keys`).

Raises:
    ValueError: Lengths differ, cell_m is not positive, or bits is not within 1 to 20.)");
  module.def("trimmed_box", &trimmed_box, "points_m"_a, "chosen"_a.none(), "outer_share"_a, R"(
Return the lowest and the highest corner (3,) of points without the outermost ones.

Args:
    points_m: (N, 3) points.
    chosen: (N,) bool, which of them are used; None: all.
    outer_share: share of the points that is left out on each side of each axis.

Raises:
    ValueError: No point is chosen, or outer_share is not within 0 to 0.5.)");
  module.def("cells_of", &cells_of, "points_m"_a, "chosen"_a, "cell_m"_a, "bits"_a, R"(
Return the ascending int64 keys (`voxel_keys`) of the cells that contain chosen points (N, 3).

Raises:
    ValueError: Lengths differ, cell_m is not positive, or bits is not within 1 to 20.)");
  module.def(
    "pixels_on_surface", &pixels_on_surface, "depth_m"_a, "points_map_m"_a, "box_px"_a,
    "T_object_map"_a, "cells"_a, "cell_m"_a, "bits"_a, R"(
Return the ascending pixels with a reading in a box whose points are in cells of a surface.

Args:
    depth_m: (H, W) float32 depth, not empty; 0 = no reading.
    points_map_m: (H * W, 3) points of the pixels in the map frame.
    box_px: left, top, right and bottom, cut at the border; right and bottom are excluded.
    T_object_map: (4, 4) transform from the map frame to that of the cells.
    cells: ascending int64 keys of the cells (`cells_of`).
    cell_m: side of a cell.
    bits: number of cells along each axis (see `voxel_keys`).

Raises:
    ValueError: The image is empty, lengths differ, or the grid is invalid.)");
  module.def(
    "share_on_surface", &share_on_surface, "points_map_m"_a, "T_object_map"_a, "cells"_a,
    "cell_m"_a, "bits"_a, R"(
Return the share of points (N, 3) that are in cells of a surface; 0 without points.

Args:
    points_map_m: (N, 3) points of the map frame.
    T_object_map: (4, 4) transform from the map frame to that of the cells.
    cells: ascending int64 keys of the cells (`cells_of`).
    cell_m: side of a cell.
    bits: number of cells along each axis (see `voxel_keys`).

Raises:
    ValueError: cell_m is not positive, or bits is not within 1 to 20.)");
  module.def(
    "share_in_box", &share_in_box, "points_map_m"_a, "T_box_map"_a, "low_m"_a, "high_m"_a, R"(
Return the share of points (N, 3) of the map frame that are inside a box; 0 without points.

Args:
    points_map_m: (N, 3) points.
    T_box_map: (4, 4) transform from the map frame to that of the box.
    low_m: (3,) lowest corner.
    high_m: (3,) highest corner.)");
}

}  // namespace hoid::bindings
