// The pose of one image from matched map points: Gauss-Newton on pixels and disparities with
// Huber kernels, and without outliers.

#include <cstddef>
#include <cstring>
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

// Add the rows of one observation to the upper triangle of H and to g.
ALWAYS_INLINE void accumulate(
  const double J[kRows][kPose], const double* e, const Weights& weights, double H[kPose][kPose],
  double* g)
{
  for (int r = 0; r < kRows; ++r) {
    for (int a = 0; a < kPose; ++a) {
      const double scaled = (r < 2 ? weights.pixel : weights.depth) * J[r][a];
      g[a] += scaled * e[r];
      for (int b = a; b < kPose; ++b) {
        H[a][b] += scaled * J[r][b];
      }
    }
  }
}

MULTIVERSION("avx2") void normal_equations(
  const Scene& scene, const double* T, const uint8_t* inliers,
  double H[kPose][kPose], double* g)
{
  std::memset(H, 0, sizeof(double) * kPose * kPose);
  std::memset(g, 0, sizeof(double) * kPose);
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
    residual(scene.camera, x, seen, e);
    const Weights weights = weights_of(scene.camera, scene.gates, seen, e);
    point_jacobian(scene.camera, x, J_point);
    pose_jacobian(x, J_point, J);
    accumulate(J, e, weights, H, g);
  }
  for (int a = 0; a < kPose; ++a) {
    for (int b = 0; b < a; ++b) {
      H[a][b] = H[b][a];
    }
  }
}

void iterate(
  const Scene& scene, int iterations, const uint8_t* inliers, Pose T, double* information)
{
  double H[kPose][kPose], factor[kPose * kPose], step[kPose];
  for (int n = 0; n < iterations; ++n) {
    normal_equations(scene, T, inliers, H, step);
    std::memcpy(information, H, sizeof(H));
    std::memcpy(factor, H, sizeof(H));
    if (!solve_positive(factor, step, kPose)) {
      return;
    }
    move_pose(step, T);
    double square = 0.0;
    for (const double s : step) {
      square += s * s;
    }
    if (square < kConverged * kConverged) {
      return;
    }
  }
}

MULTIVERSION("avx2") int tell_outliers(const Scene& scene, const double* T, uint8_t* inliers)
{
  int count = 0;
  for (int k = 0; k < scene.seen.count; ++k) {
    const Observation seen = scene.at(k);
    double x[3], e[3];
    to_camera(T, scene.point(k), x);
    residual(scene.camera, x, seen, e);
    inliers[k] = x[2] >= kMinDepthM && chi2(scene.camera, seen, e) <= gate_of(scene.gates, seen);
    count += inliers[k];
  }
  return count;
}

MULTIVERSION("avx2") void truncated_costs(const Scene& scene, const double* T, double* costs)
{
  for (int k = 0; k < scene.seen.count; ++k) {
    const Observation seen = scene.at(k);
    double x[3], e[3];
    to_camera(T, scene.point(k), x);
    residual(scene.camera, x, seen, e);
    costs[k] = truncated_cost(scene.camera, scene.gates, seen, x[2] < kMinDepthM ? nullptr : e);
  }
}

}  // namespace

PoseFit optimize_pose(
  const StereoParams& camera, const Gates& gates, const PoseProblem& problem, const PoseArray& start)
{
  const Scene scene{camera, gates, problem};
  PoseFit fit{start, std::vector<uint8_t>(problem.count, 1), {}};
  for (int a = 0; a < kPose; ++a) {
    fit.information[a * (kPose + 1)] = 1.0;
  }
  int num_inliers = problem.count;
  for (const int iterations : kRounds) {
    if (num_inliers < kMinPoints) {
      break;
    }
    iterate(scene, iterations, fit.inliers.data(), fit.T_camera_map.data(), fit.information.data());
    num_inliers = tell_outliers(scene, fit.T_camera_map.data(), fit.inliers.data());
  }
  return fit;
}

MatchJudgement judge_matches(
  const StereoParams& camera, const Gates& gates, const PoseProblem& problem,
  const PoseArray& T_camera_map)
{
  const Scene scene{camera, gates, problem};
  MatchJudgement out{std::vector<double>(problem.count), std::vector<uint8_t>(problem.count)};
  truncated_costs(scene, T_camera_map.data(), out.cost.data());
  tell_outliers(scene, T_camera_map.data(), out.inliers.data());
  return out;
}

}  // namespace hoid::optimize
