#include "objects/objects.hpp"

#include <nanobind/stl/tuple.h>

#include <array>
#include <tuple>

#include "bindings/arrays.hpp"
#include "bindings/checks.hpp"
#include "bindings/module.hpp"
#include "bindings/points.hpp"

namespace hoid::bindings {

namespace {

using namespace nb::literals;

HOID_RESULT(ObjectSurfaces);
HOID_RESULT(SeenVoxels);

void require_boxes(const Array<int32_t, -1, 4>& boxes, const ImageArray<float>& depth_m)
{
  for (int d = 0; d < boxes.size(); ++d) {
    const int32_t* box = boxes.data() + static_cast<std::ptrdiff_t>(4) * d;
    const bool is_inside = 0 <= box[0] && box[0] <= box[2] && box[2] <= depth_m.size(1) &&
                           0 <= box[1] && box[1] <= box[3] && box[3] <= depth_m.size(0);
    require(is_inside, "boxes_px: a box is not within the image");
  }
}

ObjectSurfaces object_surfaces(
  const ImageArray<float>& depth_m, const Points& points_map_m, double pixel_m,
  const Array<int32_t, -1, 4>& boxes_px, const Vector<double>& areas_px,
  const Vector<bool>& is_person, const Array<double, -1, 4, 4>& T_box_map,
  const Points& known_low_m, const Points& known_high_m, const Vector<int32_t>& owner)
{
  const objects::DepthPoints image = view(depth_m, points_map_m, pixel_m);
  const int count = boxes_px.size();
  require_boxes(boxes_px, depth_m);
  require_length("areas_px", areas_px, count);
  require_length("is_person", is_person, count);
  require_length("T_box_map", T_box_map, count);
  require_length("known_low_m", known_low_m, count);
  require_length("known_high_m", known_high_m, count);
  require_length("owner", owner, static_cast<int>(depth_m.array.size()));
  require_range("owner", owner, -1, count);
  auto found = unlocked([&] {
    const objects::Detections detections{
      boxes_px.data(),   areas_px.data(),     reinterpret_cast<const uint8_t*>(is_person.data()),
      T_box_map.data(),  known_low_m.data(),  known_high_m.data(),
      count};
    return objects::object_surfaces(image, detections, owner.data());
  });
  return make<ObjectSurfaces>(
    give(std::move(found.detection)), give(std::move(found.pixels)),
    give(std::move(found.pixels_end)), give(std::move(found.others)),
    give(std::move(found.others_end)), give_points(std::move(found.points_m)),
    give_points(std::move(found.center_m)), give_points(std::move(found.low_m)),
    give_points(std::move(found.high_m)));
}

// Require that the parts of `count` rows end in order, the last one with the last row.
void require_ends(const char* name, const Vector<int64_t>& ends, int count)
{
  int64_t last = 0;
  for (int n = 0; n < ends.size(); ++n) {
    require(ends.data()[n] >= last, "ends: must be ascending");
    last = ends.data()[n];
  }
  if (last != count) {
    refuse(std::string(name) + ": the last one must be " + std::to_string(count));
  }
}

auto transformed_parts(
  const Points& points_m, const Vector<int64_t>& ends, const Array<double, -1, 4, 4>& T)
{
  require_ends("ends", ends, points_m.size());
  require_length("T", T, ends.size());
  std::vector<double> out(3 * static_cast<std::size_t>(points_m.size()));
  unlocked([&] {
    objects::transform_parts(points_m.data(), ends.data(), ends.size(), T.data(), out.data());
  });
  return give_points(std::move(out));
}

SeenVoxels seen_voxels(
  const ImageArray<float>& depth_m, const Vector<int64_t>& ahead,
  const Array<double, -1, 2>& uv_px, const Vector<double>& voxel_depth_m,
  const Vector<bool>& is_solid, const Vector<int64_t>& ends,
  const std::tuple<double, double>& margin)
{
  const int count = voxel_depth_m.size();
  require_pixels("depth_m", depth_m);
  require_length("uv_px", uv_px, ahead.size());
  require_length("is_solid", is_solid, count);
  require_range("ahead", ahead, 0, count);
  require_ends("ends", ends, count);
  auto seen = unlocked([&] {
    const objects::ProjectedVoxels voxels{
      ahead.data(), uv_px.data(), ahead.size(), voxel_depth_m.data(),
      reinterpret_cast<const uint8_t*>(is_solid.data()), count, ends.data(), ends.size()};
    return objects::seen_voxels(
      view(depth_m), voxels, {std::get<0>(margin), std::get<1>(margin)});
  });
  const auto num = static_cast<std::size_t>(count), num_objects = ends.array.size();
  return make<SeenVoxels>(
    give(std::move(seen.uv_px), std::array<std::size_t, 2>{num, 2}),
    give<uint8_t, bool>(std::move(seen.is_visible), std::array<std::size_t, 1>{num}),
    give(std::move(seen.counts), std::array<std::size_t, 2>{num_objects, 3}),
    give(std::move(seen.boxes_px), std::array<std::size_t, 2>{num_objects, 4}));
}

auto missed_voxels(
  const Array<double, -1, 2>& uv_px, const Vector<bool>& is_visible, const Array<double, 4>& box_px,
  const Vector<int64_t>& others, int width)
{
  require_length("is_visible", is_visible, uv_px.size());
  return give(unlocked([&] {
    return objects::missed_voxels(
      uv_px.data(), reinterpret_cast<const uint8_t*>(is_visible.data()), uv_px.size(),
      box_px.data(), others.data(), others.size(), width);
  }));
}

auto pair_scores(
  const Points& points_map_m, const Vector<int64_t>& point_ends,
  const Array<int32_t, -1, 4>& boxes_px, const Array<double, -1, 4, 4>& T_box_map,
  const Points& low_m, const Points& high_m, const Array<double, -1, 2>& uv_px,
  const Vector<bool>& is_visible, const Vector<int64_t>& voxel_ends,
  const Array<bool, -1, -1>& is_candidate)
{
  const int num = boxes_px.size(), num_objects = T_box_map.size();
  require_length("point_ends", point_ends, num);
  require_ends("point_ends", point_ends, points_map_m.size());
  require_length("low_m", low_m, num_objects);
  require_length("high_m", high_m, num_objects);
  require_length("voxel_ends", voxel_ends, num_objects);
  require_ends("voxel_ends", voxel_ends, uv_px.size());
  require_length("is_visible", is_visible, uv_px.size());
  const bool is_for_pairs = is_candidate.size(0) == num && is_candidate.size(1) == num_objects;
  require(is_for_pairs, "is_candidate: must have a row for each segment, a column for each object");
  std::vector<double> score(static_cast<std::size_t>(num) * num_objects);
  unlocked([&] {
    const objects::SegmentSet segments{
      points_map_m.data(), point_ends.data(), boxes_px.data(), num};
    const objects::ObjectSet known{
      T_box_map.data(), low_m.data(), high_m.data(), uv_px.data(),
      reinterpret_cast<const uint8_t*>(is_visible.data()), voxel_ends.data(), num_objects};
    objects::pair_scores(
      segments, known, reinterpret_cast<const uint8_t*>(is_candidate.data()), score.data());
  });
  const std::array<std::size_t, 2> shape{
    static_cast<std::size_t>(num), static_cast<std::size_t>(num_objects)};
  return give(std::move(score), shape);
}

}  // namespace

void bind_objects(nb::module_& module)
{
  module.def(
    "object_surfaces", &object_surfaces, "depth_m"_a, "points_map_m"_a, "pixel_m"_a, "boxes_px"_a,
    "areas_px"_a, "is_person"_a, "T_box_map"_a, "known_low_m"_a, "known_high_m"_a, "owner"_a, R"(
Return the surfaces of the detected objects that have enough readings, without people.

The surface is the nearest layer of depth in the box, without planes that continue around the box.
Where two boxes claim the same surface, it belongs to the box that it fills better, or of two boxes
that are filled to the smaller one. The other object is segmented again from the remaining pixels,
and left out if they are too few; a person keeps its pixels. Of a known object that is hidden in
part, the surface is what lies in its known box.

Args:
    depth_m: (H, W) float32 depth, not empty; 0 = no reading.
    points_map_m: (H * W, 3) points of the pixels in the map frame.
    pixel_m: distance between neighboring pixels at a depth of 1 m.
    boxes_px: (D, 4) int32 left, top, right and bottom of the detections, within the image;
        right and bottom are excluded.
    areas_px: (D,) areas of the boxes, also of what is beyond the image.
    is_person: (D,) bool, whether the detection is a person.
    T_box_map: (D, 4, 4) transforms from the map frame to that of the known object.
    known_low_m: (D, 3) lowest corners of the known boxes; not below the highest ones: unknown.
    known_high_m: (D, 3) highest corners.
    owner: (H * W,) int32 detection of the known object that shows at each pixel; -1 = none.

Raises:
    ValueError: The image is empty, a box or an owner is invalid, or lengths differ.)");
  module.def("transformed_parts", &transformed_parts, "points_m"_a, "ends"_a, "T"_a, R"(
Return points (N, 3) in other frames, those of each part with its own transform.

Args:
    points_m: (N, 3) points.
    ends: (P,) int64 index after the last point of each part.
    T: (P, 4, 4) transforms.

Raises:
    ValueError: The ends are not ascending or not those of all points, or lengths differ.)");
  module.def(
    "seen_voxels", &seen_voxels, "depth_m"_a, "ahead"_a, "uv_px"_a, "voxel_depth_m"_a,
    "is_solid"_a, "ends"_a, "margin"_a, R"(
Return what an image shows at the N voxels of O objects, of one after the other.

A voxel is visible if the measured depth at its nearest pixel differs from its own by at most the
margin, and seen through if the measured depth is larger.

Args:
    depth_m: (H, W) float32 depth, not empty; 0 = no reading.
    ahead: (M,) int64 rows of the voxels in front of the camera, within its range.
    uv_px: (M, 2) pixels of these, which need not be within the image.
    voxel_depth_m: (N,) depths of all voxels.
    is_solid: (N,) bool, whether the voxel belongs to its object.
    ends: (O,) int64 index after the last voxel of each object.
    margin: largest difference of depths: constant (m), and multiple of the squared depth (1/m).

Raises:
    ValueError: The image is empty, a row is not that of a voxel, the ends are not ascending or not
        those of all voxels, or lengths differ.)");
  module.def(
    "missed_voxels", &missed_voxels, "uv_px"_a, "is_visible"_a, "box_px"_a, "others"_a, "width"_a,
    R"(
Return the ascending rows of visible voxels that an image shows not to belong to an object.

They are outside the box of the object, or at pixels that show other things.

Args:
    uv_px: (N, 2) pixels of the voxels; NaN where they are not visible.
    is_visible: (N,) bool, whether a surface is measured at the voxel.
    box_px: (4,) left, top, right and bottom; all are inside.
    others: ascending flat indices of the pixels that show other things.
    width: width of the image.

Raises:
    ValueError: Lengths differ.)");
  module.def(
    "pair_scores", &pair_scores, "points_map_m"_a, "point_ends"_a, "boxes_px"_a, "T_box_map"_a,
    "low_m"_a, "high_m"_a, "uv_px"_a, "is_visible"_a, "voxel_ends"_a, "is_candidate"_a, R"(
Return the (S, O) scores of pairs of segments and objects, in [0, 1].

The score is the geometric mean of the share of the segment's points that are in the box of the
object, and of the share of the object's visible voxels that are in the box of the detection. Voxels
up to half a pixel left of this box or above it are inside.

Args:
    points_map_m: (N, 3) points of all segments, of one after the other.
    point_ends: (S,) int64 index after the last point of each segment.
    boxes_px: (S, 4) int32 boxes of the detections; right and bottom are excluded.
    T_box_map: (O, 4, 4) transforms from the map frame to that of the object's box.
    low_m: (O, 3) lowest corners of the objects' boxes.
    high_m: (O, 3) highest corners.
    uv_px: (V, 2) pixels of the voxels of all objects.
    is_visible: (V,) bool, whether the voxel is visible.
    voxel_ends: (O,) int64 index after the last voxel of each object.
    is_candidate: (S, O) bool; the scores of other pairs are 0.

Raises:
    ValueError: Ends are not ascending or not those of all rows, or lengths differ.)");
}

}  // namespace hoid::bindings
