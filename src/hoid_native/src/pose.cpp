// The pose of one image from matched map points: Gauss-Newton on pixels and disparities with
// Huber kernels, and without outliers.

#include <algorithm>
#include <cstring>
#include <vector>

#include "stereo.hpp"

namespace {

using namespace stereo;

constexpr int kMinPoints = 4;
constexpr double kConverged = 1e-7;

// Iterations of each round, after which outliers are told anew.
constexpr int kRounds[] = {4, 3, 3};

struct Problem
{
  Camera camera;
  Gates gates;
  int count;
  const double* points;    // (count, 3)
  const double* measured;  // (count, 3)
  const double* weight;    // (count)

  ALWAYS_INLINE Observation at(int k) const { return {measured + 3 * k, weight[k]}; }
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
  const Problem& problem, const double* T, const uint8_t* inliers,
  double H[kPose][kPose], double* g)
{
  std::memset(H, 0, sizeof(double) * kPose * kPose);
  std::memset(g, 0, sizeof(double) * kPose);
  for (int k = 0; k < problem.count; ++k) {
    if (!inliers[k]) {
      continue;
    }
    const Observation seen = problem.at(k);
    double x[3], e[3], J_point[kRows][kPoint], J[kRows][kPose];
    to_camera(T, problem.points + 3 * k, x);
    if (x[2] < kMinDepthM) {
      continue;
    }
    residual(problem.camera, x, seen, e);
    const Weights weights = weights_of(problem.camera, problem.gates, seen, e);
    point_jacobian(problem.camera, x, J_point);
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
  const Problem& problem, int iterations, const uint8_t* inliers, Pose T, double* information)
{
  double H[kPose][kPose], factor[kPose * kPose], step[kPose];
  for (int n = 0; n < iterations; ++n) {
    normal_equations(problem, T, inliers, H, step);
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

MULTIVERSION("avx2") int tell_outliers(const Problem& problem, const double* T, uint8_t* inliers)
{
  int count = 0;
  for (int k = 0; k < problem.count; ++k) {
    const Observation seen = problem.at(k);
    double x[3], e[3];
    to_camera(T, problem.points + 3 * k, x);
    residual(problem.camera, x, seen, e);
    inliers[k] = x[2] >= kMinDepthM && chi2(problem.camera, seen, e) <= problem.gates.of(seen);
    count += inliers[k];
  }
  return count;
}

}  // namespace

// Move T (4, 4) to the pose that explains the observations best; write which of them it explains
// and the (6, 6) information of the pose's twist. Returns how many inliers there are.
extern "C" int32_t hoid_optimize_pose(
  const double* camera, const double* gates, int32_t count, const double* points,
  const double* measured, const double* weight, double* T, uint8_t* inliers, double* information)
{
  const Problem problem{
    Camera(camera), {gates[0], gates[1]}, count, points, measured, weight};
  std::fill_n(inliers, count, uint8_t{1});
  for (int a = 0; a < kPose * kPose; ++a) {
    information[a] = a % (kPose + 1) == 0 ? 1.0 : 0.0;
  }
  int num_inliers = count;
  for (const int iterations : kRounds) {
    if (num_inliers < kMinPoints) {
      break;
    }
    iterate(problem, iterations, inliers, T, information);
    num_inliers = tell_outliers(problem, T, inliers);
  }
  return num_inliers;
}
