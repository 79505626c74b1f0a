#include "motion/motion.hpp"

#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <tuple>

#include "bindings/arrays.hpp"
#include "bindings/checks.hpp"
#include "bindings/module.hpp"

namespace hoid::bindings {

namespace {

using namespace nb::literals;
using motion::Pinhole;

HOID_RESULT(Segments);

using MarginTuple = std::tuple<float, float, float>;

motion::Margin margin_of(const MarginTuple& values)
{
  return {std::get<0>(values), std::get<1>(values), std::get<2>(values)};
}

template <typename T, int... kShape>
void require_shape(
  const char* name, const Array<T, kShape...>& image, const ImageArray<float>& like)
{
  if (image.size(0) != like.size(0) || image.size(1) != like.size(1)) {
    refuse(std::string(name) + ": must be as large as depth_m");
  }
}

Segments depth_segments(const ImageArray<float>& depth_m, int cell_px)
{
  require(cell_px >= 1, "cell_px: must be at least 1");
  auto found = unlocked([&] { return motion::depth_segments(view(depth_m), cell_px); });
  const std::array<std::size_t, 2> shape{depth_m.array.shape(0), depth_m.array.shape(1)};
  return make<Segments>(
    give(std::move(found.label), shape), give(std::move(found.region)),
    give(std::move(found.area_px)));
}

auto depths_around(const ImageArray<float>& depth_m)
{
  std::vector<float> range_m(2 * depth_m.array.size());
  unlocked([&] { motion::depths_around(view(depth_m), range_m.data()); });
  const std::array<std::size_t, 3> shape{depth_m.array.shape(0), depth_m.array.shape(1), 2};
  return give(std::move(range_m), shape);
}

// A view to hold another against: T_earlier_now, and the range of depths around its pixels.
using Earlier = std::tuple<RealArray<4, 4>, Array<float, -1, -1, 2>, double>;

auto front_evidence(
  const Pinhole& camera, const ImageArray<float>& depth_m, const ImageArray<int32_t>& label,
  int num_segments, const std::vector<Earlier>& earlier, const MarginTuple& margin,
  const std::tuple<double, double, double>& worth)
{
  require_shape("label", label, depth_m);
  require(num_segments >= 0, "num_segments: must not be negative");
  require_range("label", label, -1, num_segments);
  for (const auto& [T_earlier_now, range_m, rest] : earlier) {
    require_shape("range_m", range_m, depth_m);
  }
  std::vector<double> log_odds(num_segments);
  unlocked([&] {
    for (const auto& [T_earlier_now, range_m, rest] : earlier) {
      motion::add_front_evidence(
        {camera, T_earlier_now.data(), view(depth_m)}, label.data(), range_m.data(),
        margin_of(margin), {std::get<0>(worth), std::get<1>(worth), std::get<2>(worth), rest},
        log_odds);
    }
  });
  return give(std::move(log_odds));
}

auto depths_at(const ImageArray<float>& depth_m, const Vector<int64_t>& pixels)
{
  require_range("pixels", pixels, -1, static_cast<int64_t>(depth_m.array.size()));
  return give(
    unlocked([&] { return motion::depths_at(view(depth_m), pixels.data(), pixels.size()); }));
}

auto carry_over(
  const Pinhole& camera, const RealArray<4, 4>& T_before_now, const ImageArray<float>& depth_m,
  const ImageArray<float>& before_m, const ImageArray<float>& log_odds, const MarginTuple& margin,
  float fade, const ImageArray<int32_t>& label, const Vector<float>& evidence, float limit)
{
  require_shape("before_m", before_m, depth_m);
  require_shape("log_odds", log_odds, depth_m);
  require_shape("label", label, depth_m);
  require_range("label", label, -1, evidence.size());
  require(limit >= 0, "limit: must not be negative");
  std::vector<float> carried(depth_m.array.size());
  unlocked([&] {
    motion::carry_over(
      {camera, T_before_now.data(), view(depth_m)}, before_m.data(), log_odds.data(),
      margin_of(margin), fade, {label.data(), evidence.data(), evidence.size(), limit},
      carried.data());
  });
  const std::array<std::size_t, 2> shape{depth_m.array.shape(0), depth_m.array.shape(1)};
  return give(std::move(carried), shape);
}

auto score_poses(
  const optimize::StereoParams& camera, double pixel_px, double limit,
  const RealArray<-1, 4, 4>& T_camera_world, const RealArray<-1, 3>& points_m,
  const RealArray<-1, 3>& measured_px, const RealArray<-1, 2>& weights)
{
  require(pixel_px > 0 && limit > 0, "pixel_px and limit: must be positive");
  require_length("measured_px", measured_px, points_m.size());
  require_length("weights", weights, points_m.size());
  const motion::Points points{
    points_m.data(), measured_px.data(), weights.data(), points_m.size()};
  const std::array<std::size_t, 2> shape{T_camera_world.array.shape(0), 2};
  std::vector<double> score(shape[0] * shape[1]);
  unlocked([&] {
    motion::score_poses(
      camera, pixel_px, limit, T_camera_world.data(), T_camera_world.size(), points, score.data());
  });
  return give(std::move(score), shape);
}

auto align_triples(
  const RealArray<-1, 3>& from_m, const RealArray<-1, 3>& to_m,
  const Array<int64_t, -1, 3>& triples)
{
  require_length("to_m", to_m, from_m.size());
  require_range("triples", triples, 0, from_m.size());
  const std::array<std::size_t, 3> shape{triples.array.shape(0), 4, 4};
  std::vector<double> T(16 * shape[0]);
  unlocked([&] {
    motion::align_triples(from_m.data(), to_m.data(), triples.data(), triples.size(), T.data());
  });
  return give(std::move(T), shape);
}

auto strongest_in_cells(
  const Vector<int64_t>& corner_pixels, const Vector<uint8_t>& corner_scores,
  const ImageArray<float>& depth_m, const Vector<int64_t>& small_of_pixel,
  const ImageArray<int32_t>& label, double cell_px, const ImageArray<uint8_t>& taken)
{
  require(cell_px > 0, "cell_px: must be positive");
  const auto pixels = static_cast<int>(depth_m.array.size());
  require_length("corner_scores", corner_scores, corner_pixels.size());
  require_length("small_of_pixel", small_of_pixel, pixels);
  require_range("corner_pixels", corner_pixels, 0, pixels);
  const bool covers = taken.size(0) > (depth_m.size(0) - 1) / cell_px &&
                      taken.size(1) > (depth_m.size(1) - 1) / cell_px;
  require(covers, "taken: the cells do not cover the image");
  const motion::CornersOnDepth seen{
    corner_pixels.data(),
    corner_scores.data(),
    corner_pixels.size(),
    view(depth_m),
    small_of_pixel.data(),
    label.data(),
    static_cast<int64_t>(label.array.size())};
  const motion::CellGrid grid{
    cell_px, taken.size(1), taken.data(), static_cast<int>(taken.array.size())};
  return give(unlocked([&] { return motion::strongest_in_cells(seen, grid); }));
}

void bind_views(nb::module_& module)
{
  module.def("depth_segments", &depth_segments, "depth_m"_a, "cell_px"_a, R"(
Return the pieces of a depth image, cut along jumps of depth and along a grid of square cells.

Args:
    depth_m: (H, W) float32; 0 = no reading.
    cell_px: side of a cell, at least 1.

Raises:
    ValueError: The side is less than 1.)");
  module.def("depths_around", &depths_around, "depth_m"_a, R"(
Return the (H, W, 2) least and most depth in the 3x3 pixels around each; 0 without depth there.

Args:
    depth_m: (H, W) float32; 0 = no reading.)");
  module.def(
    "front_evidence", &front_evidence, "camera"_a, "depth_m"_a, "label"_a, "num_segments"_a,
    "earlier"_a, "margin"_a, "worth"_a, R"(
Return the (S,) log-odds that segments move, by what they are in front of in earlier views.

What is behind what was seen says nothing. Every other row is looked at.

Args:
    camera: of all images.
    depth_m: (H, W) float32 now; 0 = no reading.
    label: (H, W) int32 segment of each pixel; -1 = none.
    num_segments: S.
    earlier: of each view T_earlier_now (4, 4), the (H, W, 2) float32 least and most reading around
        each pixel, 0 = none there, and the log-odds against a segment all of which is at them.
    margin: a constant [m], and shares of the depth and of its square, by which a pixel must be
        in front.
    worth: the log-odds of a segment all of which is in front, the share in front up to which there
        is no evidence, and that from which on what agrees is none.

Raises:
    ValueError: Images differ in size, or a label is not one of S.)");
  module.def("depths_at", &depths_at, "depth_m"_a, "pixels"_a, R"(
Return the (K,) float32 depths at pixels; 0 where no number is, and for the index -1.

Args:
    depth_m: (H, W) float32.
    pixels: (K,) int64 indices in the flat image; -1 = none.

Raises:
    ValueError: An index is not in the image.)");
  module.def(
    "carry_over", &carry_over, "camera"_a, "T_before_now"_a, "depth_m"_a, "before_m"_a,
    "log_odds"_a, "margin"_a, "fade"_a, "label"_a, "evidence"_a, "limit"_a, R"(
Return the (H, W) log-odds of pixels by those they had before and the evidence of now.

Before, they had none where another depth was seen in their place. Without depth they have none.

Args:
    camera: of both images.
    T_before_now: (4, 4).
    depth_m: (H, W) float32 now; 0 = no reading.
    before_m: (H, W) float32 depth of the image before.
    log_odds: (H, W) float32 of its pixels.
    margin: a constant [m], and shares of the depth and of its square, by which depths may differ.
    fade: what is left of them.
    label: (H, W) int32 segment of each pixel; -1 = none.
    evidence: (S,) float32 log-odds that are added to segments.
    limit: of the log-odds, either way.

Raises:
    ValueError: Images differ in size, a label is not one of S, or the limit is negative.)");
}

void bind_corners(nb::module_& module)
{
  module.def(
    "strongest_in_cells", &strongest_in_cells, "corner_pixels"_a, "corner_scores"_a, "depth_m"_a,
    "small_of_pixel"_a, "label"_a, "cell_px"_a, "taken"_a, R"(
Return the indices, in order of cell, of the strongest corner of each cell that is not taken.

Only corners with depth, on a piece of the small depth image, are chosen; of equals, the first.

Args:
    corner_pixels: (K,) int64 indices in the flat image.
    corner_scores: (K,) uint8, higher is stronger.
    depth_m: (H, W) float32; 0 or not finite = no reading.
    small_of_pixel: (H * W,) int64 indices in the flat small image.
    label: (h, w) int32 of the small image; -1 = no piece.
    cell_px: side of a cell.
    taken: (rows, columns) uint8 of the cells, which cover the image; 0 = free.

Raises:
    ValueError: Lengths differ, a corner is not in the image, or the cells do not cover it.)");
}

}  // namespace

void bind_motion(nb::module_& module)
{
  nb::class_<Pinhole>(module, "Pinhole", "A camera without distortion.")
    .def(nb::init<double, double, double, double>(), "fx_px"_a, "fy_px"_a, "cx_px"_a, "cy_px"_a)
    .def_ro("fx_px", &Pinhole::fx_px, "Focal length along rows.")
    .def_ro("fy_px", &Pinhole::fy_px, "Focal length along columns.")
    .def_ro("cx_px", &Pinhole::cx_px, "Column of the principal point.")
    .def_ro("cy_px", &Pinhole::cy_px, "Row of the principal point.");
  bind_views(module);
  module.def(
    "score_poses", &score_poses, "camera"_a, "pixel_px"_a, "limit"_a, "T_camera_world"_a,
    "points_m"_a, "measured_px"_a, "weights"_a, R"(
Return the (M, 2) weights of the points that each pose explains, by two sets of weights.

A point counts less the worse it fits.

Args:
    camera: of the image.
    pixel_px: standard deviation of pixels.
    limit: standard deviations beyond which a point counts nothing.
    T_camera_world: (M, 4, 4).
    points_m: (N, 3).
    measured_px: (N, 3) u, v, u_right; NaN u_right: no depth.
    weights: (N, 2).

Raises:
    ValueError: Lengths differ, or the noise or the limit is not positive.)");
  module.def("align_triples", &align_triples, "from_m"_a, "to_m"_a, "triples"_a, R"(
Return the (M, 4, 4) rigid transforms that bring three points each nearest to three others.

Args:
    from_m: (N, 3).
    to_m: (N, 3).
    triples: (M, 3) int64 indices; three points on a line give the identity.

Raises:
    ValueError: Lengths differ, or an index is not one of N.

Source: Umeyama, PAMI 1991, without scale, in closed form for three points.)");
  bind_corners(module);
}

}  // namespace hoid::bindings
