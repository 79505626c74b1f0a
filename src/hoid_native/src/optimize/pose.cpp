// The pose of one image from matched map points, and from a prior if there is one: Gauss-Newton on
// pixels and disparities with Huber kernels, in rounds that each leave the outliers of the last one
// out (Mur-Artal and Tardos, T-RO 2017, sec. III-C).

#include <algorithm>
#include <Eigen/Cholesky>
#include <Eigen/Geometry>

#include "optimize/optimize.hpp"
#include "optimize/stereo.hpp"

namespace hoid::optimize {

namespace {

constexpr int kMinMatches = 4;       // chosen: three determine a pose, a fourth one checks it
constexpr double kConvergedStep = 1e-7;  // chosen: length of a negligible step, in rad and m

// Iterations of each round, after which outliers are identified again. Not tuned: ORB-SLAM3 has
// four rounds of ten (Optimizer.cc, PoseOptimization).
constexpr int kRounds[] = {4, 3, 3};

// A row of the normal equations: six coefficients, the right-hand side and padding. They are
// vectors, because summing them up takes most of the time.
using Half = double __attribute__((vector_size(4 * sizeof(double))));
struct Row
{
  Half low, high;
};

// The normal equations while they are summed up; only the upper triangle is valid.
struct Sums
{
  Row rows[kPose];
};

// Return whether the derivative of a measurement (row) by a component of the twist is always zero:
// u does not depend on a translation along y, v not on one along x, and the disparity on neither,
// nor on a rotation about z.
template <bool kJoint>
constexpr bool is_zero(int row, int a)
{
  return row == 0 ? a == 4 : row == 1 ? a == 3 : kJoint ? a == 4 : a >= 2 && a <= 4;
}

// Add the normal equations of one observation.
template <bool kJoint>
ALWAYS_INLINE void accumulate(
  const double J[kRows][kPose], const double* e, const Weights& weights, Sums& sums)
{
  for (int r = 0; r < kRows; ++r) {
    const double* d = J[r];
    const Half low = {d[0], d[1], d[2], d[3]}, high = {d[4], d[5], e[r], 0};
    for (int a = 0; a < kPose; ++a) {
      if (is_zero<kJoint>(r, a)) {
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
  const PoseProblem& problem, const double* T, const uint8_t* inliers, Sums& out)
{
  Sums sums{};
  for (int k = 0; k < problem.count(); ++k) {
    if (!inliers[k]) {
      continue;
    }
    const Observation seen = observation(problem, k);
    double x[3], e[3], J_point[kRows][kPoint], J[kRows][kPose];
    transform(T, problem.points_m[k], x);
    if (x[2] < kMinDepthM) {
      continue;
    }
    residual<kJoint>(problem.camera, x, seen, e);
    const Weights weights = weights_of<kJoint>(problem.camera, problem.gates, seen, e);
    point_jacobian<kJoint>(problem.camera, x, J_point);
    pose_jacobian(x, J_point, J);
    accumulate<kJoint>(J, e, weights, sums);
  }
  out = sums;
}

MULTIVERSION("avx2")
void normal_equations(const PoseProblem& problem, const double* T, const uint8_t* inliers, Sums& sums)
{
  if (problem.camera.joint_noise) {
    sum_equations<true>(problem, T, inliers, sums);
  } else {
    sum_equations<false>(problem, T, inliers, sums);
  }
}

// Write the symmetric matrix and the right-hand side of the sums.
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

// Return the left twist e with exp(e) from = to, rotation first: the inverse of `move_pose`.
Vector6 twist_between(const double* from, const double* to)
{
  using Matrix4 = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;
  const Eigen::Map<const Matrix4> T_from(from), T_to(to);
  const Eigen::Matrix3d R = T_to.topLeftCorner<3, 3>() * T_from.topLeftCorner<3, 3>().transpose();
  const Eigen::Vector3d t = T_to.topRightCorner<3, 1>() - R * T_from.topRightCorner<3, 1>();
  const Eigen::AngleAxisd turn(R);
  const double angle = turn.angle();
  const Eigen::Vector3d w = angle * turn.axis();
  // Barfoot, State Estimation for Robotics, sec. 7.1: the inverse left Jacobian of a rotation.
  const double c = angle < kSmallAngleRad
                     ? 1.0 / 12
                     : (1 - 0.5 * angle / std::tan(0.5 * angle)) / (angle * angle);
  Vector6 twist;
  twist << w, t - 0.5 * w.cross(t) + c * w.cross(w.cross(t));
  return twist;
}

// Return the derivative of log(exp(d) exp(e)) by d at 0, for twists with the rotation first. It is
// the series of Barfoot, sec. 7.1, with the Bernoulli numbers of ad(e), to the fifth order.
Matrix6 inverse_left_jacobian(const Vector6& e)
{
  Matrix6 ad = Matrix6::Zero();
  for (int a = 0; a < 3; ++a) {
    const Eigen::Vector3d axis = Eigen::Vector3d::Unit(a);
    ad.block<3, 1>(0, a) = ad.block<3, 1>(3, a + 3) = e.head<3>().cross(axis);
    ad.block<3, 1>(3, a) = e.tail<3>().cross(axis);
  }
  const Matrix6 square = ad * ad;
  return Matrix6::Identity() - ad / 2 + square / 12 - square * square / 720;
}

// Add the normal equations of the prior. Its residual is -e with exp(e) prior = T, so that
// Gauss-Newton minimizes e^T information e beside the errors of the observations.
void add_prior(const PosePrior& prior, const double* T, Matrix6& H, Vector6& g)
{
  const Vector6 e = twist_between(prior.T_camera_map, T);
  const Matrix6 J = inverse_left_jacobian(e);
  const Matrix6 weighted = J.transpose() * Eigen::Map<const Matrix6>(prior.information);
  H += weighted * J;
  g -= weighted * e;
}

void iterate(
  const PoseProblem& problem, const PosePrior* prior, int iterations, const uint8_t* inliers,
  Pose T, Matrix6& information)
{
  Vector6 g;
  Sums sums;
  for (int n = 0; n < iterations; ++n) {
    normal_equations(problem, T, inliers, sums);
    unpack(sums, information, g);
    if (prior != nullptr) {
      add_prior(*prior, T, information, g);
    }
    const Eigen::LLT<Matrix6> factor(information);
    if (factor.info() != Eigen::Success) {
      return;
    }
    const Vector6 step = factor.solve(g);
    move_pose(step, T);
    if (step.squaredNorm() < kConvergedStep * kConvergedStep) {
      return;
    }
  }
}

// Write which matches are inliers of a pose, and their costs if `costs` is not null; return the
// number of inliers.
template <bool kJoint>
ALWAYS_INLINE int write_fit(const PoseProblem& problem, const double* T, uint8_t* inliers, double* costs)
{
  int num_inliers = 0;
  for (int k = 0; k < problem.count(); ++k) {
    const Observation seen = observation(problem, k);
    double x[3], e[3];
    transform(T, problem.points_m[k], x);
    residual<kJoint>(problem.camera, x, seen, e);
    const bool is_ahead = x[2] >= kMinDepthM;
    inliers[k] = is_ahead && chi2<kJoint>(seen, e) <= gate_of(problem.gates, seen);
    num_inliers += inliers[k];
    if (costs != nullptr) {
      costs[k] = truncated_cost<kJoint>(problem.camera, problem.gates, seen, is_ahead ? e : nullptr);
    }
  }
  return num_inliers;
}

MULTIVERSION("avx2")
int evaluate(const PoseProblem& problem, const double* T, uint8_t* inliers, double* costs)
{
  return problem.camera.joint_noise ? write_fit<true>(problem, T, inliers, costs)
                                  : write_fit<false>(problem, T, inliers, costs);
}

}  // namespace

PoseFit optimize_pose(
  const PoseProblem& problem, const double* start, const PosePrior* prior)
{
  PoseFit fit{{}, std::vector<uint8_t>(problem.count(), 1), {}};
  double* T = fit.T_camera_map.data();
  std::copy_n(start, 16, T);
  Matrix6 information = Matrix6::Identity();
  int num_inliers = problem.count();
  for (const int iterations : kRounds) {
    if (num_inliers < kMinMatches && prior == nullptr) {
      break;
    }
    iterate(problem, prior, iterations, fit.inliers.data(), T, information);
    num_inliers = evaluate(problem, T, fit.inliers.data(), nullptr);
  }
  Eigen::Map<Matrix6>(fit.information.data()) = information;
  return fit;
}

MatchEvaluation evaluate_matches(const PoseProblem& problem, const double* T_camera_map)
{
  MatchEvaluation out{
    std::vector<double>(problem.count()), std::vector<uint8_t>(problem.count())};
  evaluate(problem, T_camera_map, out.inliers.data(), out.cost.data());
  return out;
}

}  // namespace hoid::optimize
