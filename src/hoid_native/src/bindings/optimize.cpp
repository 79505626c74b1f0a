#include "optimize/optimize.hpp"

#include "bindings/arrays.hpp"
#include "bindings/cameras.hpp"

namespace hoid::bindings {

namespace {

using optimize::Gates;
using optimize::StereoParams;

HOID_RESULT(PoseFit);
HOID_RESULT(BundleFit);
HOID_RESULT(MatchEvaluation);
HOID_RESULT(BiasingRegion);

template <int... kShape, std::size_t kSize>
auto give_array(const std::array<double, kSize>& values)
{
  return give<double>({values.begin(), values.end()}, {kShape...});
}

optimize::PoseProblem pose_problem(
  const StereoParams& camera, const Gates& gates, const RealRows3& points_m,
  const RealRows3& measured_px, const RealArray<-1>& inv_sigma2)
{
  require_lengths(inv_sigma2.size(), "points_m", points_m, "measured_px", measured_px);
  return {camera, gates, points_m, measured_px, inv_sigma2};
}

std::optional<optimize::PosePrior> pose_prior(
  const std::optional<Matrix>& T_camera_map, const std::optional<RealArray<6, 6>>& information)
{
  require(
    T_camera_map.has_value() == information.has_value(),
    "prior_information: a prior needs a pose and its information");
  if (!information) {
    return std::nullopt;
  }
  require_finite("prior_T_camera_map", *T_camera_map);
  require_finite("prior_information", *information);
  return optimize::PosePrior{*T_camera_map, *information};
}

}  // namespace

HOID_PARAMETERS(Gates, "Gates", double, double);

void bind_optimize(nb::module_& module)
{
  module.def(
    "optimize_pose",
    [](
      const StereoParams& camera, const Gates& gates, const RealRows3& points_m,
      const RealRows3& measured_px, const RealArray<-1>& inv_sigma2, const Matrix& T_camera_map,
      const std::optional<Matrix>& prior_T_camera_map,
      const std::optional<RealArray<6, 6>>& prior_information) {
      const auto problem = pose_problem(camera, gates, points_m, measured_px, inv_sigma2);
      const auto prior = pose_prior(prior_T_camera_map, prior_information);
      auto fit = unlocked([&] {
        return optimize::optimize_pose(problem, T_camera_map, prior ? &*prior : nullptr);
      });
      return make<PoseFit>(
        give_array<4, 4>(fit.T_camera_map), give_flags(std::move(fit.inliers)),
        give_array<6, 6>(fit.information));
    },
    "camera"_a, "gates"_a, "points_m"_a, "measured_px"_a, "inv_sigma2"_a, "T_camera_map"_a,
    "prior_T_camera_map"_a = nb::none(), "prior_information"_a = nb::none(), R"(
Return the camera pose that fits N matches best: Gauss-Newton with Huber kernels.

Pixels and the disparity u - u_right are independent measurements with separate robust kernels,
unless `joint_noise` is on. Outliers are identified on (u, v, u_right) after each of three rounds
(Mur-Artal and Tardos, T-RO 2017). The information of the result has the unit of `inv_sigma2` and
includes the prior. With fewer than four matches and no prior, the initial pose is returned, with
the identity as its information and all matches as inliers. With fewer than four inliers after a
round and no prior, the pose of that round is returned.

Args:
    gates: limits of outliers. The Huber kernel of pixels has the limit `gates.mono`, that of the
        disparity 3.841; with `joint_noise`, both limits are those of outliers.
    points_m: (N, 3) map points in the map frame.
    measured_px: (N, 3) stereo observations u, v, u_right; NaN u_right: no depth.
    inv_sigma2: (N,) 1 / variance of u, and equally of v, of each match [1/px^2]. The outlier test
        applies it to u_right as well. Otherwise, the disparity u - u_right has a variance of its
        own, which the camera states, unless `joint_noise` is on.
    T_camera_map: (4, 4) initial pose of the map in the camera frame.
    prior_T_camera_map: (4, 4) mean of a Gaussian prior of the pose, finite; None: no prior.
    prior_information: (6, 6) inverse covariance of the prior, as a left twist with the rotation
        first, finite; None: no prior. It is added to the information of the matches as it is.)");
  module.def(
    "evaluate_matches",
    [](
      const StereoParams& camera, const Gates& gates, const RealRows3& points_m,
      const RealRows3& measured_px, const RealArray<-1>& inv_sigma2, const Matrix& T_camera_map) {
      const auto problem = pose_problem(camera, gates, points_m, measured_px, inv_sigma2);
      auto evaluation =
        unlocked([&] { return optimize::evaluate_matches(problem, T_camera_map); });
      return make<MatchEvaluation>(
        std::move(evaluation.cost), give_flags(std::move(evaluation.inliers)));
    },
    "camera"_a, "gates"_a, "points_m"_a, "measured_px"_a, "inv_sigma2"_a, "T_camera_map"_a, R"(
Return how well each of N matches fits a pose.

The squared errors of pixel and disparity, each divided by its measured variance, are truncated at
`gates.mono` and at 3.841 (MSAC, Torr and Zisserman, CVIU 2000); with `joint_noise`, that of
(u, v, u_right) at the limit of outliers. Therefore the sum over all matches can be compared
between poses that have different outliers.

Points, measurements and `inv_sigma2` are those of `optimize_pose`.)");
  module.def(
    "most_biasing_region",
    [](
      const StereoParams& camera, const Gates& gates, const RealRows3& points_m,
      const RealRows3& measured_px, const RealArray<-1>& inv_sigma2, const Matrix& T_camera_map,
      double noise_scale) {
      const auto problem = pose_problem(camera, gates, points_m, measured_px, inv_sigma2);
      auto region = unlocked(
        [&] { return optimize::most_biasing_region(problem, T_camera_map, noise_scale); });
      return make<BiasingRegion>(
        give_flags(std::move(region.mask)), give_array<3>(region.low),
        give_array<3>(region.high), region.gain);
    },
    "camera"_a, "gates"_a, "points_m"_a, "measured_px"_a, "inv_sigma2"_a, "T_camera_map"_a,
    "noise_scale"_a, R"(
Return the region of the view without whose matches the other matches fit a pose best.

Candidates are the cells of a k-d tree over direction and depth, which contain from 1/16 to 1/4 of
the matches (docs/decisions/036). Pixel and disparity are independent measurements, even if
`joint_noise` is on. If a point or the pose is not finite, the region is empty and has a gain of 0.

A pixel error beyond `gates.mono` and a disparity error beyond 3.841 are not used.

Args:
    points_m, measured_px, inv_sigma2: as in `optimize_pose`.
    T_camera_map: (4, 4) pose fitted to all matches.
    noise_scale: actual variances divided by the variances that camera and `inv_sigma2` state.)");
  module.def(
    "adjust_bundle",
    [](
      const StereoParams& lens, const Gates& gates, const Matrices& T_camera_map,
      int num_free, const RealRows3& points_m, const Vector<int64_t>& camera,
      const Vector<int64_t>& point, const RealRows3& measured_px, const RealArray<-1>& inv_sigma2,
      int rounds, int iterations) {
      const int num_cameras = T_camera_map.size();
      require_lengths(
        camera.size(), "point", point, "measured_px", measured_px, "inv_sigma2", inv_sigma2);
      require_range("camera", camera, 0, num_cameras);
      require_range("point", point, 0, points_m.size());
      require(
        num_free >= 0 && num_free <= num_cameras,
        "num_free: must be from 0 to the number of cameras");
      const optimize::BundleProblem problem{
        T_camera_map, num_free, points_m, camera, point, measured_px, inv_sigma2};
      auto fit = unlocked(
        [&] { return optimize::adjust_bundle(lens, gates, problem, rounds, iterations); });
      return make<BundleFit>(
        give_rows<4, 4>(std::move(fit.T_camera_map)), give_rows<3>(std::move(fit.points_m)),
        std::move(fit.chi2), fit.cost_before, fit.cost_after);
    },
    "lens"_a, "gates"_a, "T_camera_map"_a, "num_free"_a, "points_m"_a, "camera"_a, "point"_a,
    "measured_px"_a, "inv_sigma2"_a, "rounds"_a, "iterations"_a, R"(
Return camera poses and points after bundle adjustment: Levenberg-Marquardt with Huber kernels.

The adjustment has several rounds. Observations that are outliers after a round are not used in the
following rounds. Pixels and disparities have separate robust kernels, unless `joint_noise` is on.

Args:
    lens, gates: as in `optimize_pose`.
    T_camera_map: (C, 4, 4) camera poses. The first `num_free` are optimized, the others fixed.
    points_m: (P, 3) map points in the map frame, which are all optimized.
    camera, point: (M,) indices of the camera and of the point of each observation. A camera
        observes a point at most once.
    measured_px, inv_sigma2: (M, 3) and (M,) as in `optimize_pose`, of each observation.
    rounds, iterations: number of rounds, at least 1, and largest number of iterations in each.

Raises:
    MemoryError: The dense system of the optimized cameras does not fit in memory.)");
}

}  // namespace hoid::bindings
