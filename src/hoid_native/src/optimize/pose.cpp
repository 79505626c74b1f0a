// The pose of one image from matched map points: Gauss-Newton on pixels and disparities with
// Huber kernels, and without outliers.

#include <cstddef>
#include <Eigen/Cholesky>
#include <vector>

#include "optimize/optimize.hpp"
#include "optimize/stereo.hpp"

namespace hoid::optimize {

namespace {

constexpr int kMinPoints = 4;
constexpr double kConverged = 1e-7;

// Iterations of each round, after which outliers are told anew.
constexpr int kRounds[] = {4, 3, 3};

// What is seen, and by what.
struct Scene
{
  StereoParams camera;
  Gates gates;
  PoseProblem seen;

  ALWAYS_INLINE Observation at(int k) const
  {
    return {seen.measured_px + 3 * static_cast<std::ptrdiff_t>(k), seen.inv_sigma2[k]};
  }
  ALWAYS_INLINE const double* point(int k) const
  {
    return seen.points_m + 3 * static_cast<std::ptrdiff_t>(k);
  }
};

// A row of the equations: six coefficients, the right-hand side, and nothing. As vectors, as the
// sums take most of the time.
using Half = double __attribute__((vector_size(4 * sizeof(double))));
struct Row
{
  Half low, high;
};

// The equations as they are summed up; of the coefficients only the upper triangle.
struct Sums
{
  Row rows[kPose];
};

// Whether a row of the derivatives is 0 for a part of the twist: u does not go with a step along
// y, v not with one along x, and disparity with neither, nor with a turn about z.
template <bool kJoint>
constexpr bool is_none(int row, int a)
{
  return row == 0 ? a == 4 : row == 1 ? a == 3 : kJoint ? a == 4 : a >= 2 && a <= 4;
}

// Add the rows of one observation.
template <bool kJoint>
ALWAYS_INLINE void accumulate(
  const double J[kRows][kPose], const double* e, const Weights& weights, Sums& sums)
{
  for (int r = 0; r < kRows; ++r) {
    const double* d = J[r];
    const Half low = {d[0], d[1], d[2], d[3]}, high = {d[4], d[5], e[r], 0};
    for (int a = 0; a < kPose; ++a) {
      if (is_none<kJoint>(r, a)) {
        continue;
      }
      const double scaled = (r < 2 ? weights.pixel : weights.depth) * d[a];
      if (a < 4) {
        sums.rows[a].low += scaled * low;
      }
      sums.rows[a].high += scaled * high;
    }
  }
}

template <bool kJoint>
ALWAYS_INLINE void sum_equations(
  const Scene& scene, const double* T, const uint8_t* inliers, Sums& out)
{
  Sums sums{};
  for (int k = 0; k < scene.seen.count; ++k) {
    if (!inliers[k]) {
      continue;
    }
    const Observation seen = scene.at(k);
    double x[3], e[3], J_point[kRows][kPoint], J[kRows][kPose];
    to_camera(T, scene.point(k), x);
    if (x[2] < kMinDepthM) {
      continue;
    }
    residual<kJoint>(scene.camera, x, seen, e);
    const Weights weights = weights_of<kJoint>(scene.camera, scene.gates, seen, e);
    point_jacobian<kJoint>(scene.camera, x, J_point);
    pose_jacobian(x, J_point, J);
    accumulate<kJoint>(J, e, weights, sums);
  }
  out = sums;
}

MULTIVERSION("avx2")
void normal_equations(const Scene& scene, const double* T, const uint8_t* inliers, Sums& sums)
{
  if (scene.camera.joint_noise) {
    sum_equations<true>(scene, T, inliers, sums);
  } else {
    sum_equations<false>(scene, T, inliers, sums);
  }
}

// Take the symmetric matrix and the right-hand side out of the sums.
void unpack(const Sums& sums, Matrix6& H, Vector6& g)
{
  for (int a = 0; a < kPose; ++a) {
    const Row& row = sums.rows[a];
    for (int b = a; b < kPose; ++b) {
      H(a, b) = H(b, a) = b < 4 ? row.low[b] : row.high[b - 4];
    }
    g[a] = row.high[2];
  }
}

void iterate(
  const Scene& scene, int iterations, const uint8_t* inliers, Pose T, Matrix6& information)
{
  Vector6 g;
  Sums sums;
  for (int n = 0; n < iterations; ++n) {
    normal_equations(scene, T, inliers, sums);
    unpack(sums, information, g);
    const Eigen::LLT<Matrix6> factor(information);
    if (factor.info() != Eigen::Success) {
      return;
    }
    const Vector6 step = factor.solve(g);
    move_pose(step, T);
    if (step.squaredNorm() < kConverged * kConverged) {
      return;
    }
  }
}

template <bool kJoint>
ALWAYS_INLINE int gate(const Scene& scene, const double* T, uint8_t* inliers)
{
  int count = 0;
  for (int k = 0; k < scene.seen.count; ++k) {
    const Observation seen = scene.at(k);
    double x[3], e[3];
    to_camera(T, scene.point(k), x);
    residual<kJoint>(scene.camera, x, seen, e);
    inliers[k] = x[2] >= kMinDepthM && chi2<kJoint>(seen, e) <= gate_of(scene.gates, seen);
    count += inliers[k];
  }
  return count;
}

MULTIVERSION("avx2") int tell_outliers(const Scene& scene, const double* T, uint8_t* inliers)
{
  return scene.camera.joint_noise ? gate<true>(scene, T, inliers)
                                  : gate<false>(scene, T, inliers);
}

template <bool kJoint>
ALWAYS_INLINE void write_costs(const Scene& scene, const double* T, double* costs)
{
  for (int k = 0; k < scene.seen.count; ++k) {
    const Observation seen = scene.at(k);
    double x[3], e[3];
    to_camera(T, scene.point(k), x);
    residual<kJoint>(scene.camera, x, seen, e);
    costs[k] =
      truncated_cost<kJoint>(scene.camera, scene.gates, seen, x[2] < kMinDepthM ? nullptr : e);
  }
}

MULTIVERSION("avx2") void truncated_costs(const Scene& scene, const double* T, double* costs)
{
  if (scene.camera.joint_noise) {
    write_costs<true>(scene, T, costs);
  } else {
    write_costs<false>(scene, T, costs);
  }
}

}  // namespace

PoseFit optimize_pose(
  const StereoParams& camera, const Gates& gates, const PoseProblem& problem,
  const PoseArray& start)
{
  const Scene scene{camera, gates, problem};
  PoseFit fit{start, std::vector<uint8_t>(problem.count, 1), {}};
  Matrix6 information = Matrix6::Identity();
  int num_inliers = problem.count;
  for (const int iterations : kRounds) {
    if (num_inliers < kMinPoints) {
      break;
    }
    iterate(scene, iterations, fit.inliers.data(), fit.T_camera_map.data(), information);
    num_inliers = tell_outliers(scene, fit.T_camera_map.data(), fit.inliers.data());
  }
  Eigen::Map<Matrix6>(fit.information.data()) = information;
  return fit;
}

MatchEvaluation evaluate_matches(
  const StereoParams& camera, const Gates& gates, const PoseProblem& problem,
  const PoseArray& T_camera_map)
{
  const Scene scene{camera, gates, problem};
  MatchEvaluation out{std::vector<double>(problem.count), std::vector<uint8_t>(problem.count)};
  truncated_costs(scene, T_camera_map.data(), out.cost.data());
  tell_outliers(scene, T_camera_map.data(), out.inliers.data());
  return out;
}

}  // namespace hoid::optimize
