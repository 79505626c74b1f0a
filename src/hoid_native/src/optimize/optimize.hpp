// Nonlinear least squares on pixels and disparities: the pose of one image, or bundle adjustment.
//
// Pixels and the disparity u - u_right are independent measurements, each with its own robust
// kernel (decision 002), unless `joint_noise` is on. Outliers are identified on (u, v, u_right),
// as by Mur-Artal and Tardos, T-RO 2017.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "common/views.hpp"

namespace hoid::optimize {

// A pinhole camera with a virtual right column, u_right = u - disparity_px_m / depth_m, and its
// noise.
struct StereoParams
{
  double fx_px, fy_px, cx_px, cy_px, disparity_px_m;
  double disparity_noise_px;  // standard deviation of a disparity: constant part
  double relative_noise;      // and part proportional to the disparity
  double pixel_noise;         // standard deviation of u and v, in units of that in `inv_sigma2`
  bool joint_noise;           // u, v and u_right have equal noise and one kernel, as in ORB-SLAM
};

// Squared normalized residuals (chi-square) beyond which an observation is an outlier.
struct Gates
{
  double mono, stereo;  // without depth and with it
};

// Matches of map points in one image, and its camera.
struct PoseProblem
{
  StereoParams camera;
  Gates gates;
  Points points_m;
  Rows<double, 3> measured_px;  // u, v, u_right; NaN u_right: no depth
  Rows<double> inv_sigma2;      // 1 / variance of u, and equally of v, in 1/px^2

  int count() const { return inv_sigma2.count; }
};

// Poses T_camera_map are row-major 4x4 matrices.
struct PoseFit
{
  std::array<double, 16> T_camera_map;
  std::vector<uint8_t> inliers;
  std::array<double, 36> information;  // (6, 6) of the left twist, rotation first; with the prior
};

// A Gaussian prior of the pose, such as the prediction of another sensor.
struct PosePrior
{
  const double* T_camera_map;
  const double* information;  // (6, 6) of the left twist, rotation first
};

// Return the pose that explains the observations, and the prior if there is one, best.
PoseFit optimize_pose(
  const PoseProblem& problem, const double* start, const PosePrior* prior = nullptr);

struct MatchEvaluation
{
  // Squared errors of pixel and disparity over their variances, each truncated at its limit; with
  // `joint_noise`, that of (u, v, u_right), truncated at the outlier limit.
  std::vector<double> cost;
  std::vector<uint8_t> inliers;
};

// Evaluate how well each observation fits a pose.
MatchEvaluation evaluate_matches(const PoseProblem& problem, const double* T_camera_map);

// A region of the view, and the effect of leaving its matches out.
struct BiasingRegion
{
  std::vector<uint8_t> mask;
  std::array<double, 3> low, high;  // bounds of x / z, y / z and log z (m) in the camera frame
  double gain;                      // first-order cost reduction of the other matches
};

// Return the region without which the other matches fit best. Variances are `noise_scale` times
// those that camera and `inv_sigma2` state. `joint_noise` has no effect.
BiasingRegion most_biasing_region(
  const PoseProblem& problem, const double* T_camera_map, double noise_scale);

// Observations of map points by cameras, in any order; at most one for each pair.
struct BundleProblem
{
  Transforms T_camera_map;  // the first `num_free` are optimized
  int num_free;
  Points points_m;
  Rows<int64_t> camera, point;  // indices
  Rows<double, 3> measured_px;  // u, v, u_right; NaN u_right: no depth
  Rows<double> inv_sigma2;      // 1 / variance of u, and equally of v
};

struct BundleFit
{
  std::vector<double> T_camera_map, points_m;
  std::vector<double> chi2;  // of each observation; infinite behind the camera
  double cost_before, cost_after;  // of all observations, and of those in the last round
};

// Bundle adjustment (Levenberg-Marquardt, Huber kernels) in rounds; outliers are dropped between
// them.
BundleFit adjust_bundle(
  const StereoParams& camera, const Gates& gates, const BundleProblem& problem, int rounds,
  int iterations);

}  // namespace hoid::optimize
