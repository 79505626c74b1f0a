#include <cmath>
#include <limits>
#include <tuple>

#include <nanobind/stl/tuple.h>

#include "bindings/arrays.hpp"
#include "bindings/checks.hpp"
#include "bindings/module.hpp"
#include "masks/masks.hpp"

namespace hoid::bindings {

namespace {

using namespace nb::literals;

HOID_RESULT(ClassifiedBoxes);

auto pairwise(
  void (*kernel)(const Boxes&, const Boxes&, double*), const BoxArray& boxes,
  const BoxArray& others)
{
  const std::array<std::size_t, 2> shape{boxes.array.shape(0), others.array.shape(0)};
  std::vector<double> ratio(shape[0] * shape[1]);
  unlocked([&] { kernel(view(boxes), view(others), ratio.data()); });
  return give(std::move(ratio), shape);
}

auto overlap_ratios(const BoxArray& boxes, const BoxArray& others)
{
  return pairwise(&masks::overlap_ratios, boxes, others);
}

auto intersections_over_union(const BoxArray& boxes, const BoxArray& others)
{
  return pairwise(&masks::intersections_over_union, boxes, others);
}

bool are_boxes_valid(
  const Array<float, -1, 4>& boxes, const Vector<float>& scores,
  const std::tuple<int, int>& shape_hw)
{
  require_length("scores", scores, boxes.size());
  return masks::are_boxes_valid(
    std::get<1>(shape_hw), std::get<0>(shape_hw), boxes.size(), boxes.data(), scores.data());
}

ClassifiedBoxes classify_boxes(
  const ImageArray<float>& depth_m, const Vector<int64_t>& pixels, const BoxArray& boxes,
  const Vector<uint8_t>& roles, int side_px, double min_share, double apart_m, double reach_px)
{
  require_pixels("depth_m", depth_m);
  require_range("pixels", pixels, 0, static_cast<int64_t>(depth_m.array.size()));
  require_finite("boxes_xyxy_px", boxes);
  require_length("roles", roles, boxes.size());
  require(side_px >= 1, "side_px: must be at least 1");
  const masks::HandlingRule rule{min_share, apart_m, reach_px};
  auto classified = unlocked([&] {
    return masks::classify_boxes(
      view(depth_m), view(boxes), roles.data(), side_px, rule, pixels.data(), pixels.size());
  });
  return make<ClassifiedBoxes>(
    give(std::move(classified.depth_m)), give(std::move(classified.overlap)),
    give(std::move(classified.gap_m)), give(std::move(classified.moves)),
    give(std::move(classified.outside)), classified.area_px);
}

}  // namespace

void bind_boxes(nb::module_& module)
{
  module.def("overlap_ratios", &overlap_ratios, "boxes_xyxy_px"_a, "others_xyxy_px"_a, R"(
Return the (N, M) shares of the area of box n that other box m covers, in [0, 1].

This is the interaction area of the HOID paper. It is 0 for a box without area.

Args:
    boxes_xyxy_px: (N, 4) boxes, finite.
    others_xyxy_px: (M, 4) other boxes, finite.)");
  module.def(
    "intersections_over_union", &intersections_over_union, "boxes_xyxy_px"_a, "others_xyxy_px"_a,
    R"(
Return the (N, M) intersections over union of boxes, in [0, 1]; 0 for boxes without area.

Args:
    boxes_xyxy_px: (N, 4) boxes, finite.
    others_xyxy_px: (M, 4) other boxes, finite.)");
  module.def("are_boxes_valid", &are_boxes_valid, "boxes_xyxy_px"_a, "scores"_a, "shape_hw"_a, R"(
Return whether all boxes have an area and lie inside the image, and all scores are in [0, 1].

Args:
    boxes_xyxy_px: (N, 4) float32 boxes in pixels of the image.
    scores: (N,) float32 scores.
    shape_hw: height and width of the image.

Raises:
    ValueError: Lengths differ.)");
  module.def(
    "classify_boxes", &classify_boxes, "depth_m"_a, "pixels"_a, "boxes_xyxy_px"_a, "roles"_a,
    "side_px"_a, "min_share"_a, "apart_m"_a,
    "reach_px"_a = std::numeric_limits<double>::quiet_NaN(), R"(
Return which of N boxes are dynamic, and which of K pixels lie in none of them.

Dynamic are people, and objects with the role `MAY_BE_HANDLED` that a person handles: the person's
box covers more than `min_share` of the object's box, and their depths differ by less than
`apart_m`. An unknown depth fulfills the second condition.

Args:
    depth_m: (H, W) float32 depth, not empty; 0 or NaN = no reading.
    pixels: (K,) int64 pixels of image corners, as indices into the flattened image.
    boxes_xyxy_px: (N, 4) boxes, finite.
    roles: (N,) uint8 role of each box: `PERSON`, `MAY_BE_HANDLED` or 0 (see `hoid_native.boxes`).
    side_px: side of the square at a box's center whose median depth is the depth of the box.
    min_share: share of an object's box that a person's box must exceed.
    apart_m: depth difference below which person and object must be.
    reach_px: if this is not NaN, it replaces `min_share`: one of the K pixels must lie in the
        object's box, at most this far from the person's box along rows and columns.

Raises:
    ValueError: The image is empty, a pixel is not in it, a box is not finite, the side is less
        than 1, or lengths differ.)");
}

}  // namespace hoid::bindings
