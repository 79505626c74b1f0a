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

HOID_RESULT(Judged);

auto of_pairs(
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
  return of_pairs(&masks::overlap_ratios, boxes, others);
}

auto intersections_over_union(const BoxArray& boxes, const BoxArray& others)
{
  return of_pairs(&masks::intersections_over_union, boxes, others);
}

bool are_boxes_fit(
  const Array<float, -1, 4>& boxes, const Vector<float>& scores,
  const std::tuple<int, int>& shape_hw)
{
  require_length("scores", scores, boxes.size());
  return masks::are_boxes_fit(
    std::get<1>(shape_hw), std::get<0>(shape_hw), boxes.size(), boxes.data(), scores.data());
}

Judged judge_boxes(
  const ImageArray<float>& depth_m, const Vector<int64_t>& pixels, const BoxArray& boxes,
  const Vector<uint8_t>& roles, int side_px, double min_share, double apart_m, double reach_px)
{
  require_pixels("depth_m", depth_m);
  require_range("pixels", pixels, 0, static_cast<int64_t>(depth_m.array.size()));
  require_finite("boxes_xyxy_px", boxes);
  require_length("roles", roles, boxes.size());
  require(side_px >= 1, "side_px: must be at least 1");
  const masks::HandlingRule rule{min_share, apart_m, reach_px};
  auto judged = unlocked([&] {
    return masks::judge_boxes(
      view(depth_m), view(boxes), roles.data(), side_px, rule, pixels.data(), pixels.size());
  });
  return make<Judged>(
    give(std::move(judged.depth_m)), give(std::move(judged.overlap)),
    give(std::move(judged.gap_m)), give(std::move(judged.moves)), give(std::move(judged.outside)),
    judged.area_px);
}

}  // namespace

void bind_boxes(nb::module_& module)
{
  module.def("overlap_ratios", &overlap_ratios, "boxes_xyxy_px"_a, "others_xyxy_px"_a, R"(
Return the (N, M) shares of each box's own area that lie in each of the others.

In [0, 1]; 0 for a box without area. This is the interaction area of the HOID paper.

Args:
    boxes_xyxy_px: (N, 4), finite.
    others_xyxy_px: (M, 4), finite.)");
  module.def(
    "intersections_over_union", &intersections_over_union, "boxes_xyxy_px"_a, "others_xyxy_px"_a,
    R"(
Return the (N, M) ratios in [0, 1] of shared area to joint area; 0 without area.

Args:
    boxes_xyxy_px: (N, 4), finite.
    others_xyxy_px: (M, 4), finite.)");
  module.def("are_boxes_fit", &are_boxes_fit, "boxes_xyxy_px"_a, "scores"_a, "shape_hw"_a, R"(
Return whether boxes have areas inside the image and scores are in [0, 1].

Args:
    boxes_xyxy_px: (N, 4) float32.
    scores: (N,) float32.
    shape_hw: of the image.

Raises:
    ValueError: Lengths differ.)");
  module.def(
    "judge_boxes", &judge_boxes, "depth_m"_a, "pixels"_a, "boxes_xyxy_px"_a, "roles"_a,
    "side_px"_a, "min_share"_a, "apart_m"_a,
    "reach_px"_a = std::numeric_limits<double>::quiet_NaN(), R"(
Return which of N boxes move, people and what people handle, and what lies outside them.

Args:
    depth_m: (H, W) float32, not empty; 0 or NaN = no reading.
    pixels: (K,) int64, indices in the flat image.
    boxes_xyxy_px: (N, 4), finite.
    roles: (N,) uint8: `PERSON`, `MAY_BE_HANDLED` or 0.
    side_px: as of `sample_depths_m`.
    min_share: a person handles a box when covering more than this share of it ...
    apart_m: ... and nearer than this in depth; a depth that is not known is near.
    reach_px: instead of the share, where given: a pixel in the box has a part of the person's
        within this reach along rows and columns.

Raises:
    ValueError: The image is empty, a pixel is not in it, a box is not finite, or lengths
        differ.)");
}

}  // namespace hoid::bindings
