// Stereo camera model with a virtual right image (decision 002): projection, residuals,
// derivatives.
//
// A map point x_map has camera coordinates x = R x_map + t and projects to u, v and
// u_right = u - disparity_px_m / z (Mur-Artal and Tardos, T-RO 2017, eq. 1). A left twist (w, v),
// rotation first, changes x by -hat(x) w + v (Barfoot, State Estimation for Robotics, sec. 7.1).
#pragma once

#include <cmath>
#include <Eigen/Core>

#include "common/multiversion.hpp"
#include "optimize/optimize.hpp"

namespace hoid::optimize {

constexpr int kPose = 6;   // degrees of freedom
constexpr int kPoint = 3;
constexpr int kRows = 3;  // u, v, and the disparity (or u_right with joint noise)
constexpr double kMinDepthM = 0.05;       // chosen: nearer points count as behind the camera
constexpr double kGateDisparity = 3.841;  // 95 % quantile of chi-square, one degree of freedom
constexpr double kSmallAngleRad = 1e-4;   // below: Taylor series, exact to double precision

using Vector6 = Eigen::Matrix<double, kPose, 1>;
using Matrix6 = Eigen::Matrix<double, kPose, kPose, Eigen::RowMajor>;

// Row-major 4x4, T_camera_map.
using Pose = double*;

// Like std::fmax and std::fmin these return the limit for NaN. The library functions are calls
// that spill the sums from the registers.
ALWAYS_INLINE double at_least(double value, double limit)
{
  return value > limit ? value : limit;
}

ALWAYS_INLINE double at_most(double value, double limit)
{
  return value < limit ? value : limit;
}

// One measurement (u, v, u_right); NaN u_right: no depth. `weight` is the inverse variance of u
// and of v that `inv_sigma2` states, without the factor `pixel_noise`.
struct Observation
{
  const double* measured;
  double weight;

  ALWAYS_INLINE bool has_depth() const { return measured[2] == measured[2]; }
  ALWAYS_INLINE double disparity() const { return measured[0] - measured[2]; }
};

ALWAYS_INLINE Observation observation(const PoseProblem& problem, int k)
{
  return {problem.measured_px[k], problem.inv_sigma2[k]};
}

ALWAYS_INLINE double gate_of(const Gates& gates, const Observation& seen)
{
  return seen.has_depth() ? gates.stereo : gates.mono;
}

// The noise model is a template argument, so that it is chosen once for all observations. kJoint:
// as in ORB-SLAM u_right has the noise of u and v, and all three share one kernel.

// Write measured - expected for u, v and the disparity u - u_right (kJoint: u_right); the third is
// 0 without depth. Depths are clamped to kMinDepthM.
template <bool kJoint>
ALWAYS_INLINE void residual(
  const StereoParams& camera, const double* x, const Observation& seen, double* out)
{
  const double inv_z = 1.0 / at_least(x[2], kMinDepthM);
  out[0] = seen.measured[0] - (camera.fx_px * x[0] * inv_z + camera.cx_px);
  out[1] = seen.measured[1] - (camera.fy_px * x[1] * inv_z + camera.cy_px);
  const double disparity = seen.disparity() - camera.disparity_px_m * inv_z;
  out[2] = !seen.has_depth() ? 0.0 : kJoint ? out[0] - disparity : disparity;
}

// Return the statistic of the outlier test: the sum of the squared residuals of u, v and u_right,
// all divided by the variance of pixels.
template <bool kJoint>
ALWAYS_INLINE double chi2(const Observation& seen, const double* e)
{
  const double right = !seen.has_depth() ? 0.0 : kJoint ? e[2] : e[0] - e[2];
  return seen.weight * (e[0] * e[0] + e[1] * e[1] + right * right);
}

ALWAYS_INLINE double huber_cost(double chi2, double gate)
{
  return chi2 <= gate ? chi2 : 2 * std::sqrt(gate * chi2) - gate;
}

ALWAYS_INLINE double huber_weight(double chi2, double gate)
{
  return chi2 <= gate ? 1.0 : std::sqrt(gate / chi2);
}

// Return the variance of a measured disparity, in px^2.
ALWAYS_INLINE double disparity_variance(const StereoParams& camera, const Observation& seen)
{
  const double part = camera.relative_noise * seen.disparity();
  return camera.disparity_noise_px * camera.disparity_noise_px + part * part;
}

// The weights of an observation in the normal equations, and its robust cost. Pixel and disparity
// have separate kernels, because a depth beside an edge can be wrong while the pixel is right.
// Both are in units of `Observation::weight`: pixel errors that all points of an image share do
// not average out.
struct Weights
{
  double pixel, depth, cost;  // weight of u and v, weight of the third row, cost of all
};

template <bool kJoint>
ALWAYS_INLINE Weights weights_of(
  const StereoParams& camera, const Gates& gates, const Observation& seen, const double* e)
{
  if constexpr (kJoint) {
    const double all = chi2<kJoint>(seen, e), gate = gate_of(gates, seen);
    const double weight = seen.weight * huber_weight(all, gate);
    return {weight, seen.has_depth() ? weight : 0.0, huber_cost(all, gate)};
  }
  const double unit = camera.pixel_noise * camera.pixel_noise;
  const double pixel2 = seen.weight * (e[0] * e[0] + e[1] * e[1]) / unit;
  Weights out{
    seen.weight * huber_weight(pixel2, gates.mono), 0.0, unit * huber_cost(pixel2, gates.mono)};
  if (seen.has_depth()) {
    const double weight = 1.0 / disparity_variance(camera, seen);
    const double disparity2 = weight * e[2] * e[2];
    out.depth = unit * weight * huber_weight(disparity2, kGateDisparity);
    out.cost += unit * huber_cost(disparity2, kGateDisparity);
  }
  return out;
}

// Return the squared error of an observation normalized by the measured noise; pixel and disparity
// are truncated at their gates (kJoint: their sum at its gate). Without residuals (`e` null,
// behind the camera): the gates.
template <bool kJoint>
ALWAYS_INLINE double truncated_cost(
  const StereoParams& camera, const Gates& gates, const Observation& seen, const double* e)
{
  const double unit = camera.pixel_noise * camera.pixel_noise;
  if constexpr (kJoint) {
    const double gate = gate_of(gates, seen);
    return e == nullptr ? gate : at_most(chi2<kJoint>(seen, e) / unit, gate);
  }
  if (e == nullptr) {
    return gates.mono + (seen.has_depth() ? kGateDisparity : 0.0);
  }
  double cost = at_most(seen.weight * (e[0] * e[0] + e[1] * e[1]) / unit, gates.mono);
  if (seen.has_depth()) {
    cost += at_most(e[2] * e[2] / disparity_variance(camera, seen), kGateDisparity);
  }
  return cost;
}

// Derivatives of the expected measurement by the point in the camera frame, [row][coordinate].
template <bool kJoint>
ALWAYS_INLINE void point_jacobian(
  const StereoParams& camera, const double* x, double J[kRows][kPoint])
{
  const double inv_z = 1.0 / at_least(x[2], kMinDepthM);
  const double fx = camera.fx_px * inv_z, fy = camera.fy_px * inv_z;
  J[0][0] = fx;
  J[0][1] = 0.0;
  J[0][2] = -fx * x[0] * inv_z;
  J[1][0] = 0.0;
  J[1][1] = fy;
  J[1][2] = -fy * x[1] * inv_z;
  J[2][0] = J[2][1] = 0.0;
  J[2][2] = -camera.disparity_px_m * inv_z * inv_z;
  if constexpr (kJoint) {
    for (int a = 0; a < kPoint; ++a) {
      J[2][a] = J[0][a] - J[2][a];
    }
  }
}

// Derivatives by the left twist of the pose, [row][rotation, then translation].
ALWAYS_INLINE void pose_jacobian(
  const double* x, const double J_point[kRows][kPoint], double J[kRows][kPose])
{
  for (int r = 0; r < kRows; ++r) {
    const double* d = J_point[r];
    J[r][0] = d[2] * x[1] - d[1] * x[2];
    J[r][1] = d[0] * x[2] - d[2] * x[0];
    J[r][2] = d[1] * x[0] - d[0] * x[1];
    J[r][3] = d[0];
    J[r][4] = d[1];
    J[r][5] = d[2];
  }
}

// T <- exp(twist) T; the rotation stays orthonormal.
void move_pose(const Vector6& twist, Pose T);

}  // namespace hoid::optimize
