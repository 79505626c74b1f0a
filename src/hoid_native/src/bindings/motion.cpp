#include "motion/motion.hpp"

#include "bindings/arrays.hpp"
#include "bindings/cameras.hpp"

namespace hoid::bindings {

namespace {

using motion::Pinhole;
using DepthImage = ImageArray<float>;

HOID_RESULT(Segments);

// Coefficients of a depth margin: constant (m), of the depth, and of its square (1/m).
using MarginTuple = std::tuple<float, float, float>;

// An earlier view: T_earlier_now, its 3x3 depth ranges, and the log-odds against motion of a
// segment that has the same depth everywhere.
using EarlierView = std::tuple<Matrix, Array<float, -1, -1, 2>, double>;

// Require that each named image is as large as the depth image.
template <typename A, typename... Others>
void require_shape(
  const DepthImage& depth_m, const char* name, const A& image, const Others&... others)
{
  if (image.size(0) != depth_m.size(0) || image.size(1) != depth_m.size(1)) {
    refuse(std::string(name) + ": must be as large as depth_m");
  }
  if constexpr (sizeof...(others) > 0) {
    require_shape(depth_m, others...);
  }
}

void bind_segments(nb::module_& module)
{
  module.def(
    "depth_segments",
    [](const DepthImage& depth_m, int cell_px) {
      require(cell_px >= 1, "cell_px: must be at least 1");
      auto found = unlocked([&] { return motion::depth_segments(depth_m, cell_px); });
      return make<Segments>(
        give<int32_t>(std::move(found.label), {depth_m.size(0), depth_m.size(1)}),
        std::move(found.region), std::move(found.area_px));
    },
    "depth_m"_a, "cell_px"_a, R"(
Return the segments of a depth image, cut along depth jumps and along a grid of square cells.

A depth jump is a difference of at least 0.02 m plus 3 % of the depth within 3x3 pixels. Pixels
without a measurement count as depth 0, so that there is a jump beside them.

Args:
    cell_px: side of a cell in pixels, at least 1.)");
  module.def(
    "occlusion_log_odds",
    [](
      const Pinhole& camera, const DepthImage& depth_m, const ImageArray<int32_t>& label,
      int num_segments, const std::vector<EarlierView>& earlier, const MarginTuple& margin,
      const std::tuple<double, double, double>& evidence) {
      require_shape(depth_m, "label", label);
      require(num_segments >= 0, "num_segments: must not be negative");
      require_range("label", label, -1, num_segments);
      for (const auto& view : earlier) {
        require_shape(depth_m, "range_m", std::get<1>(view));
      }
      const auto depth_margin = std::make_from_tuple<motion::DepthMargin>(margin);
      const auto [occluding, min_occluding, mixed] = evidence;
      std::vector<double> log_odds(num_segments);
      for (const auto& [T_earlier_now, range_m, agreeing] : earlier) {
        const nb::gil_scoped_release release;
        motion::add_occlusion_evidence(
          {camera, T_earlier_now, depth_m}, label, range_m, depth_margin,
          {occluding, min_occluding, mixed, agreeing}, log_odds);
      }
      return give_rows(std::move(log_odds));
    },
    "camera"_a, "depth_m"_a, "label"_a, "num_segments"_a, "earlier"_a, "margin"_a, "evidence"_a,
    R"(
Return the (S,) log-odds that segments move, by comparison with the depth in earlier views.

A pixel in front of the depth that an earlier view shows there occludes it: the surface has moved
there since. A pixel behind this depth is no evidence. Only every other row is compared, to save
time. The log-odds of all earlier views are added up.

Args:
    label: (H, W) segment of each pixel, less than S; -1 = none.
    earlier: for each earlier view, the camera motion T_earlier_now (4, 4), the least and the
        greatest depth in the 3x3 pixels around each of its pixels (H, W, 2), 0 where it has no
        depth, and the log-odds against motion of a segment that has the same depth everywhere.
    margin: coefficients of 1 (in m), z and z^2. A pixel of depth z occludes if it is nearer by
        more than their sum.
    evidence: three numbers: the log-odds of a segment that occludes with all its pixels, which are
        multiplied by the ratio of those that do; the occluding ratio that must be exceeded to
        count as evidence; and the occluding ratio from which on equal depth of the other pixels is
        no evidence against motion.)");
  module.def(
    "propagate_log_odds",
    [](
      const Pinhole& camera, const Matrix& T_previous_now, const DepthImage& depth_m,
      const DepthImage& previous_m, const ImageArray<float>& log_odds, const MarginTuple& margin,
      float decay, const ImageArray<int32_t>& label, const Vector<float>& evidence, float limit) {
      require_shape(depth_m, "previous_m", previous_m, "log_odds", log_odds, "label", label);
      require_range("label", label, -1, evidence.size());
      require(limit >= 0, "limit: must not be negative");
      return fill<float>({depth_m.size(0), depth_m.size(1)}, [&](float* propagated) {
        motion::propagate_log_odds(
          {camera, T_previous_now, depth_m}, previous_m, log_odds,
          std::make_from_tuple<motion::DepthMargin>(margin), decay, {label, evidence, limit},
          propagated);
      });
    },
    "camera"_a, "T_previous_now"_a, "depth_m"_a, "previous_m"_a, "log_odds"_a, "margin"_a,
    "decay"_a, "label"_a, "evidence"_a, "limit"_a, R"(
Return the (H, W) log-odds that each pixel of the current image moves.

They are the log-odds of the same surface in the previous image, multiplied by `decay`, plus the
evidence from the current image. Where the previous image shows another depth or none, a pixel
starts at 0. A pixel of the current image without a measurement has 0.

Args:
    T_previous_now: (4, 4) pose of the current camera in the previous camera's frame.
    previous_m, log_odds: (H, W) depth of the previous image, and log-odds of its pixels.
    margin: coefficients of 1 (in m), z and z^2. A pixel of depth z shows the same surface if the
        depths differ by less than their sum.
    label: (H, W) segment of each pixel of the current image, less than S; -1 = none.
    evidence: (S,) log-odds that are added to the pixels of each segment.
    limit: the result is clamped to [-limit, limit].)");
}

}  // namespace

void bind_motion(nb::module_& module)
{
  bind_segments(module);
  module.def(
    "score_poses",
    [](
      const optimize::StereoParams& camera, double pixel_px, double limit,
      const Matrices& T_camera_world, const RealRows3& points_m, const RealRows3& measured_px,
      const RealArray<-1, 2>& weights) {
      require(pixel_px > 0 && limit > 0, "pixel_px and limit: must be positive");
      require_lengths(points_m.size(), "measured_px", measured_px, "weights", weights);
      return fill<double>({T_camera_world.size(), 2}, [&](double* score) {
        motion::score_poses(
          camera, pixel_px, limit, T_camera_world, {points_m, measured_px, weights}, score);
      });
    },
    "camera"_a, "pixel_px"_a, "limit"_a, "T_camera_world"_a, "points_m"_a, "measured_px"_a,
    "weights"_a, R"(
Return the (M, 2) weights of the points that each pose explains, summed for two sets of weights.

A point counts with 1 - (residual / limit)^2 of its weight; beyond the limit, or nearer than 0.1 m
in front of the camera, it does not count.

Args:
    camera: camera model of the image. Its `disparity_noise_px` is in units of `pixel_px` here; the
        other parts of its noise are not used.
    pixel_px: standard deviation of u and of v, positive.
    limit: largest residual of an explained point, in standard deviations, positive.
    T_camera_world: (M, 4, 4) poses of the world in the camera frame.
    points_m, measured_px, weights: (N, 3) points in the world, (N, 3) stereo observations u, v,
        u_right (NaN u_right: no depth), and (N, 2) two weights of each.)");
  module.def(
    "align_triples",
    [](const RealRows3& from_m, const RealRows3& to_m, const Array<int64_t, -1, 3>& triples) {
      require_lengths(from_m.size(), "to_m", to_m);
      require_range("triples", triples, 0, from_m.size());
      return fill<double>({triples.size(), 4, 4}, [&](double* T_to_from) {
        motion::align_triples(from_m, to_m, triples, T_to_from);
      });
    },
    "from_m"_a, "to_m"_a, "triples"_a, R"(
Return the (M, 4, 4) rigid transforms T_to_from that align triples of points with least squares.

Source: Umeyama, PAMI 1991, without scale, in closed form for three points. For three points on a
line, the result is the identity.

Args:
    from_m, to_m: (N, 3) points in the frame `from`, and the same points in the frame `to`.
    triples: (M, 3) indices of the points of each triple, less than N.)");
  module.def(
    "register_depth",
    [](
      const DepthImage& depth_m, const Array<float, -1, -1, 3>& rays, const Array<float, 3>& t_m,
      const Array<float, 2>& side_px, const Pinhole& camera,
      const std::tuple<int, int>& size_px) {
      require_shape(depth_m, "rays", rays);
      const auto [width, height] = size_px;
      require(width > 0 && height > 0, "size_px: must be positive");
      return fill<float>({height, width}, [&, width, height](float* registered_m) {
        motion::register_depth(
          {depth_m, rays, t_m, side_px}, {camera, width, height}, registered_m);
      });
    },
    "depth_m"_a, "rays"_a, "t_m"_a, "side_px"_a, "camera"_a, "size_px"_a, R"(
Return the (H, W) depth image (m) that another camera sees; 0 = no measurement.

A depth pixel covers as many pixels of the other camera as it is large. Of several depths at a
pixel, the nearest is kept.

Args:
    depth_m: (h, w) depth; 0, negative or NaN = no measurement.
    rays: (h, w, 3) ray of each depth pixel in the frame of the other camera. A point at depth z is
        at z times the ray plus `t_m`.
    t_m: (3,) position of the depth camera in the frame of the other camera.
    side_px: (2,) width and height of a depth pixel in pixels of the other camera, at equal depth.
    camera, size_px: the other camera, and its width W and height H, positive.)");
}

}  // namespace hoid::bindings
