#include "features/features.hpp"

#include <nanobind/stl/vector.h>

#include <algorithm>
#include <limits>

#include "bindings/arrays.hpp"
#include "bindings/checks.hpp"
#include "bindings/module.hpp"

namespace hoid::bindings {

namespace {

using namespace nb::literals;

HOID_RESULT(Corners);

constexpr std::size_t kMaxLevels = 256;  // an octave is a uint8_t

Corners fast_corners(
  const std::vector<ImageArray<uint8_t>>& levels, const Array<float, -1, 2>& steps_px,
  int threshold, int border_px)
{
  require(levels.size() <= kMaxLevels, "levels: must be at most 256");
  require(threshold >= 1 && threshold <= 254, "threshold: must be from 1 to 254");
  require(border_px >= 0, "border_px: must not be negative");
  require_length("steps_px", steps_px, static_cast<int>(levels.size()));
  features::Pyramid pyramid{{}, steps_px.data()};
  for (const auto& level : levels) {
    pyramid.levels.push_back(view(level));
  }
  auto found = unlocked([&] { return features::detect_fast(pyramid, threshold, border_px); });
  const std::array<std::size_t, 2> pairs{found.score.size(), 2};
  return make<Corners>(
    give(std::move(found.xy_px), pairs), give(std::move(found.uv_px), pairs),
    give(std::move(found.pixel)), give(std::move(found.octave)), give(std::move(found.score)));
}

// Return the pixels (x, y); refuse them if one is less than `border_px` from the image's edge.
features::Pixels require_inside(
  const ImageArray<uint8_t>& image, const Vector<int32_t>& x, const Vector<int32_t>& y,
  int border_px)
{
  require_length("y", y, x.size());
  const int right = image.size(1) - border_px, bottom = image.size(0) - border_px;
  bool all = true;
  for (int k = 0; k < x.size(); ++k) {
    all &= (x.data()[k] >= border_px) & (x.data()[k] < right) & (y.data()[k] >= border_px) &
           (y.data()[k] < bottom);
  }
  if (!all) {
    refuse("pixels must be at least " + std::to_string(border_px) + " px from the edge");
  }
  return {x.data(), y.data(), x.size()};
}

auto subpixel_offsets_px(
  const ImageArray<uint8_t>& image, const Vector<int32_t>& x, const Vector<int32_t>& y)
{
  const features::Pixels corners = require_inside(image, x, y, features::kSubpixelBorderPx);
  const auto count = static_cast<std::size_t>(corners.count);
  std::vector<float> offset(2 * count);
  unlocked([&] { features::subpixel_offsets(view(image), corners, offset.data()); });
  return give(std::move(offset), std::array{count, std::size_t{2}});
}

auto orientations_deg(
  const ImageArray<uint8_t>& image, const Vector<int32_t>& x, const Vector<int32_t>& y)
{
  const features::Pixels corners = require_inside(image, x, y, features::kOrientationBorderPx);
  std::vector<float> angle_deg(corners.count);
  unlocked([&] { features::orientations(view(image), corners, angle_deg.data()); });
  return give(std::move(angle_deg));
}

auto orb_descriptors(
  const ImageArray<uint8_t>& image, const Vector<int32_t>& x, const Vector<int32_t>& y,
  const Vector<float>& angle_deg)
{
  const features::Pixels corners = require_inside(image, x, y, features::kDescriptorBorderPx);
  require_length("angle_deg", angle_deg, corners.count);
  require_finite("angle_deg", angle_deg);
  const auto count = static_cast<std::size_t>(corners.count);
  std::vector<uint8_t> bits(features::kDescriptorBytes * count);
  unlocked(
    [&] { features::orb_descriptors(view(image), corners, angle_deg.data(), bits.data()); });
  return give(std::move(bits), std::array{count, std::size_t{features::kDescriptorBytes}});
}

constexpr double kMaxPx = 1 << 16;  // no image is larger

auto spread_evenly(
  const RealArray<-1, 2>& uv_px, const Vector<uint8_t>& octave, const Vector<uint8_t>& score,
  const Vector<int64_t>& budgets, double area_px)
{
  require_length("octave", octave, uv_px.size());
  require_length("score", score, uv_px.size());
  require_range("octave", octave, 0, budgets.size());
  require_range("budgets", budgets, 0, std::numeric_limits<int32_t>::max());
  require(area_px >= 0, "area_px: must not be negative");
  const double *first = uv_px.data(), *last = first + uv_px.array.size();
  const auto is_inside = [](double at_px) { return at_px >= 0 && at_px < kMaxPx; };
  require(std::all_of(first, last, is_inside), "uv_px: must be in an image");
  const features::ScoredCorners corners{uv_px.data(), octave.data(), score.data(), uv_px.size()};
  return give(unlocked(
    [&] { return features::spread_evenly(corners, budgets.data(), budgets.size(), area_px); }));
}

}  // namespace

void bind_features(nb::module_& module)
{
  module.def(
    "fast_corners", &fast_corners, "levels"_a, "steps_px"_a, "threshold"_a, "border_px"_a, R"(
Return the FAST-9/16 corners of an image pyramid after 3x3 non-maximum suppression.

Source: Rosten and Drummond, ECCV 2006. Corners and scores equal OpenCV's. A level has no corners
if it is less than 32 px wide or high without the border.

Args:
    levels: L gray images (H_l, W_l) uint8, the finest first.
    steps_px: (L, 2) float32 level-0 pixels per pixel of each level, in x and y.
    threshold: contrast in gray levels that a corner must exceed, from 1 to 254.
    border_px: least distance of a corner from the edge of its level; values below 3 count as 3.

Raises:
    ValueError: The threshold or the border is out of range, there are more than 256 levels, or
        `steps_px` has another number of rows than there are levels.)");
  module.def(
    "spread_evenly", &spread_evenly, "uv_px"_a, "octave"_a, "score"_a, "budgets"_a, "area_px"_a,
    R"(
Return the ascending indices of at most `budgets.sum()` corners, spread evenly over the image.

Each octave divides `area_px` into about as many grid cells as its budget. It takes the strongest
corner of each cell, then the second strongest of each cell, and so on until its budget is used.
Among equal scores the first corner wins. If an octave has too few corners, the other octaves get
the rest of its budget.

Args:
    uv_px: (N, 2) positions of the corners in level 0, from 0 to less than 65536.
    octave: (N,) uint8 index of the level of each corner.
    score: (N,) uint8 strength of each corner.
    budgets: (L,) int64 number of corners wanted from each octave.
    area_px: image area over which the corners are spread, in level-0 pixels. A grid cell has at
        least one pixel.

Raises:
    ValueError: Lengths differ, an octave is not below L, a budget or the area is negative, or a
        position is out of range.)");
  module.def("subpixel_offsets_px", &subpixel_offsets_px, "image_gray"_a, "x"_a, "y"_a, R"(
Return the (N, 2) float32 offsets (x, y) in pixels from FAST corners to their subpixel peaks.

The peak is the maximum of the quadratic fitted to the signed FAST scores of the corner's pixel and
its 8 neighbors (docs/decisions/008). Offsets are clamped to [-0.5, 0.5]; they are 0 if the
quadratic has no maximum.

Args:
    image_gray: (H, W) uint8 image.
    x: (N,) int32 columns of the corners.
    y: (N,) int32 rows of the corners.

Raises:
    ValueError: A pixel is less than 4 px from the image's edge, or lengths differ.)");
  module.def("orientations_deg", &orientations_deg, "image_gray"_a, "x"_a, "y"_a, R"(
Return the (N,) float32 orientations of corners in degrees, in [0, 360), clockwise from the x axis.

They are the directions of the intensity centroids (Rublee et al., ORB, ICCV 2011, sec. 3.2).

Args:
    image_gray: (H, W) uint8 image.
    x: (N,) int32 columns of the corners.
    y: (N,) int32 rows of the corners.

Raises:
    ValueError: A pixel is less than 15 px from the image's edge, or lengths differ.)");
  module.def(
    "orb_descriptors", &orb_descriptors, "image_smooth"_a, "x"_a, "y"_a, "angle_deg"_a, R"(
Return the (N, 32) uint8 ORB descriptors of corners, rotated by their orientations.

Source: Rublee et al., ORB, ICCV 2011, sec. 4. The bits equal OpenCV's.

Args:
    image_smooth: (H, W) uint8 smoothed gray image.
    x: (N,) int32 columns of the corners.
    y: (N,) int32 rows of the corners.
    angle_deg: (N,) float32 orientations, as `orientations_deg` returns them.

Raises:
    ValueError: A pixel is less than 19 px from the image's edge, an angle is not finite, or
        lengths differ.)");
}

}  // namespace hoid::bindings
