// Least squares on pixels and disparities: the pose of one image, or poses and points of many.
//
// Pixels and the disparity u - u_right are independent measurements with robust kernels of their
// own; outliers are told on (u, v, u_right) (Mur-Artal and Tardos, T-RO 2017).
#pragma once

#include <array>
#include <cstdint>
#include <vector>

namespace hoid::optimize {

// A pinhole camera with a virtual right column, u_right = u - disparity_px_m / depth_m, and its
// noise.
struct StereoParams
{
  double fx_px, fy_px, cx_px, cy_px, disparity_px_m;
  double disparity_noise_px,
    relative_noise;    // of a disparity: what does not depend on it, and what does
  double pixel_noise;  // standard deviation of pixels, in units of that of their weights
  bool joint_noise;    // u_right is as noisy as u and v, all under one kernel, as in ORB-SLAM
};

// Squared normalised residuals beyond which an observation is an outlier.
struct Gates
{
  double mono, stereo;  // without depth and with it
};

using PoseArray = std::array<double, 16>;  // a row-major 4x4, T_camera_map

struct PoseProblem
{
  const double* points_m;     // (count, 3)
  const double* measured_px;  // (count, 3) u, v, u_right; NaN u_right: no depth
  const double* inv_sigma2;   // (count)
  int count;
};

struct PoseFit
{
  PoseArray T_camera_map;
  std::vector<uint8_t> inliers;
  std::array<double, 36> information;  // (6, 6) of the left twist, rotation first
};

// Return the pose that explains the observations best.
PoseFit optimize_pose(
  const StereoParams& camera, const Gates& gates, const PoseProblem& problem,
  const PoseArray& start);

struct MatchJudgement
{
  std::vector<double> cost;  // squared errors at the measured noise, cut off at the gates
  std::vector<uint8_t> inliers;
};

// Say how well each observation fits a pose.
MatchJudgement judge_matches(
  const StereoParams& camera, const Gates& gates, const PoseProblem& problem,
  const PoseArray& T_camera_map);

// Matches in one place, and what it would mean to leave them out.
struct MovingPart
{
  std::vector<uint8_t> mask;
  std::array<double, 3> low, high;  // of x / z, y / z and log z in the camera
  double gain;                      // by how much the cost of the rest would fall, to first order
};

// Return the part without which the rest would fit best; variances are `noise_scale` times those
// of the camera.
MovingPart heaviest_part(
  const StereoParams& camera, const Gates& gates, const PoseProblem& problem,
  const PoseArray& T_camera_map, double noise_scale);

// Observations are in any order; one of a point by a camera at most.
struct BundleProblem
{
  const double* T_camera_map;  // (num_cameras, 4, 4), the first `num_free` are moved
  int num_cameras, num_free;
  const double* points_m;  // (num_points, 3)
  int num_points;
  const int64_t *camera, *point;  // which camera observes which point
  const double* measured_px;      // (num_observations, 3) u, v, u_right; NaN u_right: no depth
  const double* inv_sigma2;
  int num_observations;
};

struct BundleFit
{
  std::vector<double> T_camera_map, points_m;
  std::vector<double> chi2;  // of the observations; infinite behind a camera
  double cost_before, cost_after;
};

// Adjust with a Huber kernel, in rounds after each of which what does not fit is left out.
BundleFit adjust_bundle(
  const StereoParams& camera, const Gates& gates, const BundleProblem& problem, int rounds,
  int iterations);

}  // namespace hoid::optimize
