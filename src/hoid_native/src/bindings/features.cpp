#include "features/features.hpp"

#include "bindings/arrays.hpp"

namespace hoid::bindings {

namespace {

HOID_RESULT(Corners);

constexpr std::size_t kMaxLevels = 256;  // an octave is a uint8_t
constexpr double kMaxPx = 1 << 16;       // no image is larger

using GrayImage = ImageArray<uint8_t>;
using Coordinates = Vector<int32_t>;

// Return the pixels (x, y); refuse them if one is less than `border_px` from the image's edge.
features::Pixels pixels_inside(
  const GrayImage& image, const Coordinates& x, const Coordinates& y, int border_px)
{
  require_lengths(x.size(), "y", y);
  const int right = image.size(1) - border_px, bottom = image.size(0) - border_px;
  bool all = true;
  for (int k = 0; k < x.size(); ++k) {
    all &= (x[k] >= border_px) & (x[k] < right) & (y[k] >= border_px) & (y[k] < bottom);
  }
  if (!all) {
    refuse("pixels must be at least " + std::to_string(border_px) + " px from the edge");
  }
  return {x, y, x.size()};
}

}  // namespace

void bind_features(nb::module_& module)
{
  module.def(
    "fast_corners",
    [](
      const std::vector<GrayImage>& levels, const Array<float, -1, 2>& steps_px, int threshold,
      int border_px) {
      require(levels.size() <= kMaxLevels, "levels: must be at most 256");
      require(threshold >= 1 && threshold <= 254, "threshold: must be from 1 to 254");
      require(border_px >= 0, "border_px: must not be negative");
      require_lengths(static_cast<int>(levels.size()), "steps_px", steps_px);
      const features::Pyramid pyramid{{levels.begin(), levels.end()}, steps_px};
      auto found = unlocked([&] { return features::detect_fast(pyramid, threshold, border_px); });
      return make<Corners>(
        give_rows<2>(std::move(found.xy_px)), give_rows<2>(std::move(found.uv_px)),
        std::move(found.pixel), std::move(found.octave), std::move(found.score));
    },
    "levels"_a, "steps_px"_a, "threshold"_a, "border_px"_a, R"(
Return the FAST-9/16 corners of an image pyramid after 3x3 non-maximum suppression.

Source: Rosten and Drummond, ECCV 2006. Corners and scores equal OpenCV's. A level has no corners
if it is less than 32 px wide or high without the border.

Args:
    levels: at most 256 gray images, the finest first.
    steps_px: (L, 2) level-0 pixels per pixel of each level, in x and y.
    threshold: contrast in gray levels that a corner must exceed, from 1 to 254.
    border_px: least distance of a corner from the edge of its level; values below 3 count as 3.)");
  module.def(
    "spread_evenly",
    [](
      const RealArray<-1, 2>& uv_px, const Vector<uint8_t>& octave, const Vector<uint8_t>& score,
      const Vector<int64_t>& budgets, double area_px) {
      require_lengths(uv_px.size(), "octave", octave, "score", score);
      require_range("octave", octave, 0, budgets.size());
      require_range("budgets", budgets, 0, std::numeric_limits<int32_t>::max());
      require(area_px >= 0, "area_px: must not be negative");
      const auto is_inside = [](double at_px) { return at_px >= 0 && at_px < kMaxPx; };
      require(
        std::all_of(uv_px.begin(), uv_px.end(), is_inside), "uv_px: must be in an image");
      return give_rows(unlocked(
        [&] { return features::spread_evenly({uv_px, octave, score}, budgets, area_px); }));
    },
    "uv_px"_a, "octave"_a, "score"_a, "budgets"_a, "area_px"_a, R"(
Return the ascending indices of at most `budgets.sum()` corners, spread evenly over the image.

Each octave divides `area_px` into about as many grid cells as its budget. It takes the strongest
corner of each cell, then the second strongest of each cell, and so on until its budget is used.
Among equal scores the first corner wins. If an octave has too few corners, the other octaves get
the rest of its budget.

Args:
    uv_px: (N, 2) positions of the corners in level 0, from 0 to less than 65536.
    octave, score: (N,) index of the level of each corner, less than L, and its strength.
    budgets: (L,) number of corners wanted from each octave.
    area_px: image area over which the corners are spread, in level-0 pixels. A grid cell has at
        least one pixel.)");
  module.def(
    "subpixel_offsets_px",
    [](const GrayImage& image, const Coordinates& x, const Coordinates& y) {
      const auto corners = pixels_inside(image, x, y, features::kSubpixelBorderPx);
      return fill<float>({corners.count, 2}, [&](float* offset_px) {
        features::subpixel_offsets(image, corners, offset_px);
      });
    },
    "image_gray"_a, "x"_a, "y"_a, R"(
Return the (N, 2) offsets (x, y) in pixels from FAST corners to their subpixel peaks.

The peak is the maximum of the quadratic fitted to the signed FAST scores of the corner's pixel and
its 8 neighbors (docs/decisions/008). Offsets are clamped to [-0.5, 0.5]; they are 0 if the
quadratic has no maximum.

Args:
    x, y: (N,) columns and rows of the corners, at least 4 px from the image's edge.)");
  module.def(
    "orientations_deg",
    [](const GrayImage& image, const Coordinates& x, const Coordinates& y) {
      const auto corners = pixels_inside(image, x, y, features::kOrientationBorderPx);
      return fill<float>({corners.count}, [&](float* angle_deg) {
        features::orientations(image, corners, angle_deg);
      });
    },
    "image_gray"_a, "x"_a, "y"_a, R"(
Return the (N,) orientations of corners in degrees, in [0, 360), clockwise from the x axis.

They are the directions of the intensity centroids (Rublee et al., ORB, ICCV 2011, sec. 3.2).

Args:
    x, y: (N,) columns and rows of the corners, at least 15 px from the image's edge.)");
  module.def(
    "orb_descriptors",
    [](
      const GrayImage& image, const Coordinates& x, const Coordinates& y,
      const Vector<float>& angle_deg) {
      const auto corners = pixels_inside(image, x, y, features::kDescriptorBorderPx);
      require_lengths(corners.count, "angle_deg", angle_deg);
      require_finite("angle_deg", angle_deg);
      return fill<uint8_t>({corners.count, kDescriptorBytes}, [&](uint8_t* bits) {
        features::orb_descriptors(image, corners, angle_deg, bits);
      });
    },
    "image_smooth"_a, "x"_a, "y"_a, "angle_deg"_a, R"(
Return the (N, 32) ORB descriptors of corners of a smoothed image, rotated by their orientations.

Source: Rublee et al., ORB, ICCV 2011, sec. 4. The bits equal OpenCV's.

Args:
    x, y: (N,) columns and rows of the corners, at least 19 px from the image's edge.
    angle_deg: (N,) orientations, as `orientations_deg` returns them; finite.)");
}

}  // namespace hoid::bindings
