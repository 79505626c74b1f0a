#include "masks/masks.hpp"

#include "bindings/arrays.hpp"

namespace hoid::bindings {

namespace {

HOID_RESULT(ClassifiedBoxes);

using BoxArray = RealArray<-1, 4>;
void require_squares(const ImageArray<float>& depth_m, const BoxArray& boxes, int side_px)
{
  require_pixels(depth_m);
  require_finite("boxes_xyxy_px", boxes);
  require(side_px >= 1, "side_px: must be at least 1");
}

// Add a Python function that calls a kernel for pairs of boxes.
template <typename Kernel>
void bind_pairwise(nb::module_& module, const char* name, Kernel kernel, const char* doc)
{
  module.def(
    name,
    [kernel](const BoxArray& boxes, const BoxArray& others) {
      return fill<double>(
        {boxes.size(), others.size()}, [&](double* ratio) { kernel(boxes, others, ratio); });
    },
    "boxes_xyxy_px"_a, "others_xyxy_px"_a, doc);
}

}  // namespace

void bind_masks(nb::module_& module)
{
  bind_pairwise(module, "overlap_ratios", masks::overlap_ratios, R"(
Return the (N, M) ratios of the area of box n that other box m covers, in [0, 1].

This is the interaction area of the HOID paper. It is 0 for a box without area.)");
  bind_pairwise(
    module, "intersections_over_union", masks::intersections_over_union,
    "Return the (N, M) intersections over union of boxes, in [0, 1]; 0 for boxes without area.");
  module.def(
    "classify_boxes",
    [](
      const ImageArray<float>& depth_m, const Vector<int64_t>& pixels, const BoxArray& boxes,
      const Vector<uint8_t>& roles, int side_px, double min_share, double apart_m,
      double reach_px) {
      require_squares(depth_m, boxes, side_px);
      require_range("pixels", pixels, 0, depth_m.num_elements());
      require_lengths(boxes.size(), "roles", roles);
      auto found = unlocked([&] {
        return masks::classify_boxes(
          depth_m, boxes, roles, side_px, {min_share, apart_m, reach_px}, pixels);
      });
      return make<ClassifiedBoxes>(
        std::move(found.depth_m), std::move(found.overlap), std::move(found.gap_m),
        std::move(found.moves), std::move(found.outside), found.area_px);
    },
    "depth_m"_a, "pixels"_a, "boxes_xyxy_px"_a, "roles"_a, "side_px"_a, "min_share"_a,
    "apart_m"_a, "reach_px"_a = std::numeric_limits<double>::quiet_NaN(), R"(
Return which of N boxes are dynamic, and which of K pixels lie in none of them.

Dynamic are people, and objects with the role `MAY_BE_HANDLED` that a person handles: the person's
box covers more than `min_share` of the object's box, and their depths differ by less than
`apart_m`. An unknown depth fulfills the second condition.

Args:
    pixels: (K,) pixels of image corners, as indices into the flattened image.
    roles: (N,) role of each box: `PERSON`, `MAY_BE_HANDLED` or 0 (see `hoid_native.boxes`).
    side_px: side of the square at a box's center whose median depth is the depth of the box; at
        least 1.
    min_share: ratio of an object's box that a person's box must exceed.
    apart_m: depth difference below which person and object must be.
    reach_px: if this is not NaN, it replaces `min_share`: one of the K pixels must lie in the
        object's box, at most this far from the person's box along rows and columns.)");
  module.def(
    "box_center_depths_m",
    [](const ImageArray<float>& depth_m, const BoxArray& boxes, int side_px) {
      require_squares(depth_m, boxes, side_px);
      return fill<double>({boxes.size()}, [&](double* median_m) {
        masks::box_center_depths(depth_m, boxes, side_px, median_m);
      });
    },
    "depth_m"_a, "boxes_xyxy_px"_a, "side_px"_a, R"(
Return the (N,) median depths (m) in squares at the centers of boxes; NaN without a measurement.

Args:
    side_px: side of the squares, at least 1. Beyond the image, its border pixels are repeated.)");
  module.def(
    "person_depths_m",
    [](const ImageArray<float>& depth_m, const BoxArray& boxes, const RealArray<-1>& known_m) {
      require_finite("boxes_xyxy_px", boxes);
      require_lengths(boxes.size(), "known_m", known_m);
      return fill<double>({boxes.size()}, [&](double* person_m) {
        masks::person_depths(depth_m, boxes, known_m, person_m);
      });
    },
    "depth_m"_a, "boxes_xyxy_px"_a, "known_m"_a, R"(
Return the (N,) depths (m) of the people in boxes; NaN without a measurement.

A layer is a range of depth as thick as a torso (0.4 m). The depth is the median of the nearest
layer of the measurements in the middle of the box that has at least 60 % as many of them as the
fullest layer. Measurements from 10 m on are not used. If the depth of the person in an earlier
image is known, only measurements near this depth are used, unless there are few of them.

Args:
    known_m: (N,) depths of the same people in an earlier image; NaN = unknown.)");
  module.def(
    "segment_objects",
    [](
      const ImageArray<float>& depth_m, const Array<int32_t, -1, 4>& areas, const RealArray<-1>& depths_m,
      const RealArray<-1>& reaches_m, const Vector<bool>& seen) {
      require_boxes("areas_xyxy_px", areas, depth_m);
      require_lengths(
        areas.size(), "depths_m", depths_m, "reaches_m", reaches_m, "seen", seen);
      return fill<bool>({depth_m.size(0), depth_m.size(1)}, [&](uint8_t* dynamic) {
        masks::segment_objects(depth_m, {areas, depths_m, reaches_m, seen}, dynamic);
      });
    },
    "depth_m"_a, "areas_xyxy_px"_a, "depths_m"_a, "reaches_m"_a, "seen"_a, R"(
Return the (H, W) mask of the pixels that show a dynamic object.

The depth image is split into regions along depth jumps. To an object belong the regions that lie
mostly in its box and near its depth, and gaps without measurements beside these regions. Because
boxes are not exact, the object may extend beyond its box by a tenth of the box's side. Parts of a
region that are further outside are not masked: they belong to something that touches the object,
like the desk on which a person leans (docs/decisions/010).

Args:
    areas_xyxy_px: (N, 4) boxes of whole pixels within the image; x2 and y2 are exclusive.
    depths_m: (N,) depths of the objects. NaN = unknown: the whole box is masked.
    reaches_m: (N,) largest difference between an object's depth and the depths of its regions.
    seen: (N,) whether the object was not missed in this image. If the regions of a detected object
        fill little of its box, the object has merged with its surroundings; then all pixels of the
        box near its depth are masked.)");
}

}  // namespace hoid::bindings
