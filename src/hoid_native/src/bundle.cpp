// Bundle adjustment of a window of keyframes by Levenberg-Marquardt.

#include <algorithm>
#include <utility>
#include <vector>

#include "bundle_system.hpp"

namespace {

using namespace bundle;

constexpr double kFirstDamping = 1e-5, kMinDamping = 1e-9, kMaxDamping = 1e3;
constexpr double kConverged = 1e-4;  // relative decrease of the cost

// Solve for cameras, then points, and move; false when the system cannot be solved.
bool take_step(const Problem& problem, const System& system, double damping, State& state)
{
  const int n = kPose * problem.num_free;
  std::vector<double> S(static_cast<size_t>(n) * n, 0.0), step(system.g_c);
  for (int i = 0; i < problem.num_free; ++i) {
    for (int a = 0; a < kPose; ++a) {
      double* row = &S[(kPose * i + a) * n + kPose * i];
      std::copy_n(&system.H_cc[36 * i + 6 * a], kPose, row);
      row[a] += damping * row[a] + kPivot;
    }
  }
  eliminate(problem, system, damping, S.data(), step.data());
  if (!solve_positive(S.data(), step.data(), n)) {
    return false;
  }
  move_points(problem, system, damping, step.data(), state);
  for (int i = 0; i < problem.num_free; ++i) {
    move_pose(&step[kPose * i], &state.T[kPoseSize * i]);
  }
  return true;
}

class Adjustment
{
public:
  Adjustment(const Problem& problem, State state)
  : problem_(problem), state_(std::move(state)), used_(problem.num_observations, 1),
    chi2_(problem.num_observations)
  {
    const size_t free = problem.num_free, points = problem.num_points;
    system_.H_cc.resize(36 * free);
    system_.g_c.resize(6 * free);
    system_.H_pp.resize(9 * points);
    system_.g_p.resize(3 * points);
    system_.H_pc.resize(18 * static_cast<size_t>(problem.num_observations));
  }

  // Returns the cost before.
  double minimize(int iterations)
  {
    double damping = kFirstDamping, cost = update();
    const double before = cost;
    bool moved = true;
    for (int n = 0; n < iterations; ++n) {
      if (moved) {
        linearize(problem_, state_, used_.data(), system_);
      }
      const State old = state_;
      moved = take_step(problem_, system_, damping, state_);
      const double new_cost = moved ? update() : cost;
      if (!moved || !(new_cost <= cost)) {
        moved = false;
        state_ = old;
        damping = std::min(100 * damping, kMaxDamping);
        continue;
      }
      const bool done = cost - new_cost < kConverged * cost;
      cost = new_cost;
      damping = std::max(damping / 10, kMinDamping);
      if (done) {
        break;
      }
    }
    return before;
  }

  // Leave out the observations beyond their gates from now on.
  void drop_outliers()
  {
    update();
    for (int m = 0; m < problem_.num_observations; ++m) {
      used_[m] &= chi2_[m] <= problem_.gates.of(problem_.at(m));
    }
  }

  double update() { return cost_of(problem_, state_, used_.data(), chi2_.data()); }

  const State& state() const { return state_; }
  const std::vector<double>& chi2() const { return chi2_; }

private:
  Problem problem_;
  State state_;
  System system_;
  std::vector<uint8_t> used_;
  std::vector<double> chi2_;
};

}  // namespace

// Adjust with a Huber kernel, in rounds after each of which what does not fit is left out. Poses
// (C, 4, 4) and points (P, 3) move; chi2 (M) and the costs before and after are written.
extern "C" int32_t hoid_adjust_bundle(
  const double* camera, const double* gates, int32_t num_cameras, int32_t num_free,
  int32_t num_points, int32_t num_observations, const int32_t* camera_of, const int32_t* point_of,
  const double* measured, const double* weight, int32_t rounds, int32_t iterations,
  double* T, double* points, double* chi2, double* costs)
{
  const Problem problem{
    Camera(camera), {gates[0], gates[1]}, num_cameras, num_free, num_points, num_observations,
    camera_of, point_of, measured, weight};
  Adjustment adjustment(
    problem, {{T, T + kPoseSize * num_cameras}, {points, points + kPoint * num_points}});
  costs[0] = adjustment.minimize(iterations);
  for (int round = 1; round < rounds; ++round) {
    adjustment.drop_outliers();
    adjustment.minimize(iterations);
  }
  costs[1] = adjustment.update();
  std::copy(adjustment.state().T.begin(), adjustment.state().T.end(), T);
  std::copy(adjustment.state().points.begin(), adjustment.state().points.end(), points);
  std::copy(adjustment.chi2().begin(), adjustment.chi2().end(), chi2);
  return 0;
}
