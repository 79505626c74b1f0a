#include "objects/objects.hpp"

#include "bindings/arrays.hpp"

namespace hoid::bindings {

namespace {

using PointArray = Array<double, -1, 3>;
using PixelArray = Array<double, -1, 2>;
using Flags = Vector<bool>;
using Ends = Vector<int64_t>;
using Keys = Vector<int64_t>;
using ExactMatrix = Array<double, 4, 4>;
using ExactMatrices = Array<double, -1, 4, 4>;
using ImageBoxes = Array<int32_t, -1, 4>;
// The five arrays of `hoid_native.results.Voxels`, in the same order.
using VoxelTuple =
  std::tuple<Keys, PointArray, Vector<float>, Vector<float>, Vector<float>>;

HOID_RESULT(ObjectSurfaces);
HOID_RESULT(SeenVoxels);
HOID_RESULT(Voxels);

constexpr int kMaxBits = 20;  // largest number of bits per axis; three axes fit into a key

objects::DepthPoints depth_points(
  const ImageArray<float>& depth_m, const PointArray& points_m, double pixel_m)
{
  require_pixels(depth_m);
  require_lengths(depth_m.num_elements(), "points_map_m", points_m);
  return {depth_m, points_m, pixel_m};
}

// Require that the parts of `count` rows end in order, the last one with the last row.
void require_ends(const char* name, const Ends& ends, int count)
{
  int64_t last = 0;
  for (const int64_t end : ends) {
    require(end >= last, "ends: must be ascending");
    last = end;
  }
  if (last != count) {
    refuse(std::string(name) + ": the last one must be " + std::to_string(count));
  }
}

objects::VoxelGrid grid_of(double voxel_m, int bits)
{
  require(voxel_m > 0, "voxel_m: must be positive");
  require(bits >= 1 && bits <= kMaxBits, "bits: must be within 1 to 20");
  return {voxel_m, bits};
}

objects::VoxelView view(const VoxelTuple& voxels)
{
  const auto& [keys, means, readings, hits, misses] = voxels;
  require_lengths(
    keys.size(), "means_m", means, "readings", readings, "hits", hits, "misses", misses);
  return {keys, means, readings, hits, misses};
}

Voxels give_voxels(objects::Voxels&& found)
{
  return make<Voxels>(
    std::move(found.keys), give_rows<3>(std::move(found.means_m)), std::move(found.readings),
    std::move(found.hits), std::move(found.misses));
}

void bind_voxels(nb::module_& module)
{
  module.def(
    "voxel_keys",
    [](const PointArray& points_m, double voxel_m, int bits) {
      const auto grid = grid_of(voxel_m, bits);
      return fill<int64_t>(
        {points_m.size()}, [&](int64_t* keys) { objects::voxel_keys(points_m, grid, keys); });
    },
    "points_m"_a, "voxel_m"_a, "bits"_a, R"(
Return the (N,) keys of the voxels of points (N, 3); -1 outside the grid.

Args:
    voxel_m: side of a voxel, positive.
    bits: the grid has 2^bits voxels along each axis (1 to 20 bits), half of them on either side of
        the origin.)");
  module.def(
    "voxels_of",
    [](const PointArray& points_m, double voxel_m, int bits) {
      const auto grid = grid_of(voxel_m, bits);
      return give_voxels(unlocked([&] { return objects::voxels_of(points_m, grid); }));
    },
    "points_m"_a, "voxel_m"_a, "bits"_a, R"(
Return the voxels of the points (N, 3) of one image, each of which was hit once.

Points outside the grid are left out (see `voxel_keys`).)");
  module.def(
    "merged_voxels",
    [](const VoxelTuple& voxels, const VoxelTuple& others, float max_count, int max_voxels) {
      require(max_voxels >= 1, "max_voxels: must be at least 1");
      const auto first = view(voxels), second = view(others);
      return give_voxels(unlocked(
        [&] { return objects::merged_voxels(first, second, max_count, max_voxels); }));
    },
    "voxels"_a, "others"_a, "max_count"_a, "max_voxels"_a, R"(
Return the voxels of two sets (`Voxels`), with the sum of the evidence where both have one.

Args:
    max_count: hits and misses of a voxel are scaled down together to this sum.
    max_voxels: of more voxels, those with fewest hits are left out; at least 1.)");
  module.def(
    "solid_voxels",
    [](
      const VoxelTuple& voxels, double least_hits, double least_share,
      std::optional<double> cell_m, int bits) {
      const auto all = view(voxels);
      const auto cells = grid_of(cell_m.value_or(1.0), bits);
      return fill<bool>({all.keys.count}, [&](uint8_t* solid) {
        objects::solid_voxels(all, least_hits, least_share, cell_m ? &cells : nullptr, solid);
      });
    },
    "voxels"_a, "least_hits"_a, "least_share"_a, "cell_m"_a.none(), "bits"_a, R"(
Return the (N,) mask of the voxels (`Voxels`) that were hit often enough.

Args:
    least_hits: smallest number of hits.
    least_share: smallest ratio of the hits to the sum of hits and misses.
    cell_m: side of the cells whose voxels are counted together; None: each is counted alone.
    bits: number of cells along each axis (see `voxel_keys`).)");
}

void bind_surfaces(nb::module_& module)
{
  module.def(
    "pixels_on_surface",
    [](
      const ImageArray<float>& depth_m, const PointArray& points_map_m,
      const std::tuple<int, int, int, int>& box_px, const ExactMatrix& T_object_map,
      const Keys& cells, double cell_m, int bits) {
      const auto image = depth_points(depth_m, points_map_m, 0.0);
      const objects::SurfaceCells surface{T_object_map, cells, grid_of(cell_m, bits)};
      const auto [left, top, right, bottom] = box_px;
      const int32_t box[] = {
        std::max(left, 0), std::max(top, 0), std::min(right, depth_m.size(1)),
        std::min(bottom, depth_m.size(0))};
      return give_rows(unlocked([&] { return objects::pixels_on_surface(image, box, surface); }));
    },
    "depth_m"_a, "points_map_m"_a, "box_px"_a, "T_object_map"_a, "cells"_a, "cell_m"_a, "bits"_a,
    R"(
Return the ascending pixels with depth in a box whose points are in cells of a surface.

Args:
    box_px: left, top, right and bottom, cut at the border; right and bottom are excluded.
    T_object_map: (4, 4) transform from the map frame to that of the cells.
    cells: ascending keys (`voxel_keys`) of the cells of the surface.
    cell_m, bits: side of a cell, and number of cells along each axis (see `voxel_keys`).)");
  module.def(
    "share_on_surface",
    [](
      const PointArray& points_map_m, const ExactMatrix& T_object_map, const Keys& cells,
      double cell_m, int bits) {
      const objects::SurfaceCells surface{T_object_map, cells, grid_of(cell_m, bits)};
      return unlocked([&] { return objects::share_on_surface(points_map_m, surface); });
    },
    "points_map_m"_a, "T_object_map"_a, "cells"_a, "cell_m"_a, "bits"_a, R"(
Return the ratio of points (N, 3) that are in cells of a surface; 0 without points.

The points are in the map frame; the other arguments are those of `pixels_on_surface`.)");
  module.def(
    "object_surfaces",
    [](
      const ImageArray<float>& depth_m, const PointArray& points_map_m, double pixel_m,
      const ImageBoxes& boxes_px, const Vector<double>& areas_px, const Flags& is_person,
      const Flags& is_support, const Flags& may_be_flat, const ExactMatrices& T_box_map,
      const PointArray& known_low_m,
      const PointArray& known_high_m, const Vector<int32_t>& owner) {
      const auto image = depth_points(depth_m, points_map_m, pixel_m);
      require_boxes("boxes_px", boxes_px, depth_m);
      require_lengths(
        boxes_px.size(), "areas_px", areas_px, "is_person", is_person, "is_support", is_support,
        "may_be_flat", may_be_flat,
        "T_box_map", T_box_map, "known_low_m", known_low_m, "known_high_m", known_high_m);
      require_lengths(depth_m.num_elements(), "owner", owner);
      require_range("owner", owner, -1, boxes_px.size());
      auto found = unlocked([&] {
        return objects::object_surfaces(
          image,
          {boxes_px, areas_px, is_person, is_support, may_be_flat, T_box_map, known_low_m,
           known_high_m},
          owner);
      });
      return make<ObjectSurfaces>(
        std::move(found.detection), std::move(found.pixels), std::move(found.pixels_end),
        std::move(found.others), std::move(found.others_end),
        give_rows<3>(std::move(found.points_m)), give_rows<3>(std::move(found.center_m)),
        give_rows<3>(std::move(found.low_m)), give_rows<3>(std::move(found.high_m)));
    },
    "depth_m"_a, "points_map_m"_a, "pixel_m"_a, "boxes_px"_a, "areas_px"_a, "is_person"_a,
    "is_support"_a, "may_be_flat"_a, "T_box_map"_a, "known_low_m"_a, "known_high_m"_a, "owner"_a, R"(
Return the surfaces of the D detected objects that have enough depth pixels, without people.

The surface is the nearest layer of depth in the box, without planes that continue around the box.
Where two boxes claim the same surface, it belongs to the box that it fills better, or of two boxes
that are filled to the smaller one. The other object is segmented again from the remaining pixels,
and left out if they are too few; a person keeps its pixels. Of a known object that is hidden in
part, the surface is what lies in its known box.

Args:
    pixel_m: distance between neighboring pixels at a depth of 1 m.
    boxes_px: (D, 4) left, top, right and bottom of the detections, within the image; right and
        bottom are excluded.
    areas_px: (D,) areas of the boxes, also of what is beyond the image.
    is_support: (D,) whether other objects may lie on it.
    may_be_flat: (D,) whether the surface may be a part of a plane that continues around the box.
    T_box_map: (D, 4, 4) transforms from the map frame to that of the known object.
    known_low_m, known_high_m: (D, 3) lowest and highest corners of the known boxes; if the lowest
        ones are not below the highest ones, the object is unknown.
    owner: (H * W,) detection of the known object that shows at each pixel; -1 = none.)");
}

}  // namespace

void bind_objects(nb::module_& module)
{
  bind_voxels(module);
  bind_surfaces(module);
  module.def(
    "transformed_parts",
    [](const PointArray& points_m, const Ends& ends, const ExactMatrices& T) {
      require_ends("ends", ends, points_m.size());
      require_lengths(ends.size(), "T", T);
      return fill<double>({points_m.size(), 3}, [&](double* out) {
        objects::transform_parts(points_m, ends, T, out);
      });
    },
    "points_m"_a, "ends"_a, "T"_a, R"(
Return points (N, 3) in other frames, those of each part with its own transform T (P, 4, 4).)");
  module.def(
    "seen_voxels",
    [](
      const ImageArray<float>& depth_m, const Vector<int64_t>& ahead, const PixelArray& uv_px,
      const Vector<double>& voxel_depth_m, const Flags& is_solid, const Ends& ends,
      const std::tuple<double, double>& margin) {
      const int count = voxel_depth_m.size();
      require_pixels(depth_m);
      require_lengths(ahead.size(), "uv_px", uv_px);
      require_lengths(count, "is_solid", is_solid);
      require_range("ahead", ahead, 0, count);
      require_ends("ends", ends, count);
      auto seen = unlocked([&] {
        return objects::seen_voxels(
          depth_m, {ahead, uv_px, voxel_depth_m, is_solid, ends},
          std::make_from_tuple<objects::DepthMargin>(margin));
      });
      return make<SeenVoxels>(
        give_rows<2>(std::move(seen.uv_px)), give_flags(std::move(seen.is_visible)),
        give_rows<3>(std::move(seen.counts)), give_rows<4>(std::move(seen.boxes_px)));
    },
    "depth_m"_a, "ahead"_a, "uv_px"_a, "voxel_depth_m"_a, "is_solid"_a, "ends"_a, "margin"_a, R"(
Return what an image shows at the N voxels of O objects, of one after the other.

A voxel is visible if the measured depth at its nearest pixel differs from its own by at most the
margin, and seen through if the measured depth is larger.

Args:
    ahead, uv_px: (M,) rows of the voxels in front of the camera, within its range, and (M, 2) their
        pixels, which need not be within the image.
    voxel_depth_m: (N,) depths of all voxels.
    is_solid: (N,) whether the voxel belongs to its object.
    margin: largest difference of depths: constant (m), and multiple of the squared depth (1/m).)");
  module.def(
    "missed_voxels",
    [](
      const PixelArray& uv_px, const Flags& is_visible, const Array<double, 4>& box_px,
      const Vector<int64_t>& others, int width) {
      require_lengths(uv_px.size(), "is_visible", is_visible);
      return give_rows(unlocked(
        [&] { return objects::missed_voxels(uv_px, is_visible, box_px, others, width); }));
    },
    "uv_px"_a, "is_visible"_a, "box_px"_a, "others"_a, "width"_a, R"(
Return the ascending rows of visible voxels that an image shows not to belong to an object.

They are outside the box of the object, or at pixels that show other things.

Args:
    uv_px: (N, 2) pixels of the voxels; NaN where they are not visible.
    box_px: (4,) left, top, right and bottom; all are inside.
    others: ascending flat indices of the pixels that show other things in an image of this width.)");
  module.def(
    "pair_scores",
    [](
      const PointArray& points_map_m, const Ends& point_ends, const ImageBoxes& boxes_px,
      const ExactMatrices& T_box_map, const PointArray& low_m, const PointArray& high_m,
      const PixelArray& uv_px, const Flags& is_visible, const Ends& voxel_ends,
      const Array<bool, -1, -1>& is_candidate) {
      const int num = boxes_px.size(), num_objects = T_box_map.size();
      require_lengths(num, "point_ends", point_ends, "is_candidate", is_candidate);
      require_ends("point_ends", point_ends, points_map_m.size());
      require_lengths(
        num_objects, "low_m", low_m, "high_m", high_m, "voxel_ends", voxel_ends);
      require_ends("voxel_ends", voxel_ends, uv_px.size());
      require_lengths(uv_px.size(), "is_visible", is_visible);
      require(
        is_candidate.size(1) == num_objects, "is_candidate: must have a column for each object");
      return fill<double>({num, num_objects}, [&](double* score) {
        objects::pair_scores(
          {points_map_m, point_ends, boxes_px},
          {T_box_map, low_m, high_m, uv_px, is_visible, voxel_ends}, is_candidate, score);
      });
    },
    "points_map_m"_a, "point_ends"_a, "boxes_px"_a, "T_box_map"_a, "low_m"_a, "high_m"_a,
    "uv_px"_a, "is_visible"_a, "voxel_ends"_a, "is_candidate"_a, R"(
Return the (S, O) scores of pairs of segments and objects, in [0, 1].

The score is the geometric mean of the ratio of the segment's points that are in the box of the
object, and of the ratio of the object's visible voxels that are in the box of the detection. Voxels
up to half a pixel left of this box or above it are inside.

Args:
    points_map_m: (N, 3) points of all segments, of one after the other.
    boxes_px: (S, 4) boxes of the detections; right and bottom are excluded.
    T_box_map: (O, 4, 4) transforms from the map frame to that of the object's box.
    low_m, high_m: (O, 3) lowest and highest corners of the objects' boxes.
    uv_px, is_visible: (V, 2) pixels of the voxels of all objects, and (V,) whether they are visible.
    is_candidate: (S, O) the scores of other pairs are 0.)");
}

}  // namespace hoid::bindings
