// Bundle adjustment of a window of keyframes by Levenberg-Marquardt.

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <Eigen/Cholesky>
#include <Eigen/Sparse>
#include <numeric>
#include <utility>
#include <vector>

#include "optimize/bundle_system.hpp"
#include "optimize/optimize.hpp"

namespace hoid::optimize {

namespace {

// Levenberg-Marquardt, chosen: damping relative to the diagonal, and the relative decrease of the
// cost below which a round ends.
constexpr double kFirstDamping = 1e-5, kMinDamping = 1e-9, kMaxDamping = 1e3;
constexpr double kConvergedCost = 1e-4;

using Block = Eigen::Matrix<double, kPose, kPose, Eigen::RowMajor>;

// The reduced camera system, after the Schur complement.
class Reduced
{
public:
  explicit Reduced(const Window& window)
  : size_(kPose * static_cast<Eigen::Index>(window.num_free)), blocks_(window)
  {
    if (!blocks_.is_dense()) {
      make_pattern();
    }
  }

  // Solve the damped system for the step of the cameras; false if it cannot be solved.
  bool solve(const Window& window, const System& system, double damping, Eigen::VectorXd& step)
  {
    step = Eigen::Map<const Eigen::VectorXd>(system.g_c.data(), size_);
    blocks_.clear();
    for (int i = 0; i < window.num_free; ++i) {
      Eigen::Map<Block> block(blocks_.at(i, i));
      block = Eigen::Map<const Matrix6>(&system.H_cc[36 * static_cast<std::size_t>(i)]);
      block.diagonal().array() += damping * block.diagonal().array() + kPivot;
    }
    eliminate(window, system, damping, blocks_, step.data());
    return blocks_.is_dense() ? solve_dense(step) : solve_sparse(step);
  }

private:
  using Dense = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  using Sparse = Eigen::SparseMatrix<double>;

  bool solve_dense(Eigen::VectorXd& step)
  {
    Dense S = Dense::Zero(size_, size_);
    for (int i = 0; i < num_free(); ++i) {
      for (const int h : blocks_.row(i)) {
        S.block<kPose, kPose>(kPose * i, kPose * h) = Eigen::Map<Block>(blocks_.at(i, h));
      }
    }
    const Eigen::LLT<Eigen::Ref<Dense>> factor(S);  // in place
    if (factor.info() == Eigen::Success) {
      factor.solveInPlace(step);
    }
    return factor.info() == Eigen::Success;
  }

  bool solve_sparse(Eigen::VectorXd& step)
  {
    for (int i = 0; i < num_free(); ++i) {
      for (std::size_t n = 0; n < blocks_.row(i).size(); ++n) {
        const double* block = blocks_.at(i, blocks_.row(i)[n]);
        for (int a = 0; a < kPose; ++a) {
          for (int b = 0; b < kPose; ++b) {
            // Column b of the block is contiguous in the sparse matrix.
            sparse_.valuePtr()[starts_[i][n][b] + a] = block[a * kPose + b];
          }
        }
      }
    }
    factor_.factorize(sparse_);
    if (factor_.info() == Eigen::Success) {
      step = factor_.solve(step);
    }
    return factor_.info() == Eigen::Success;
  }

  // Make the sparse matrix without values, and find where each block is in it.
  void make_pattern()
  {
    std::vector<std::vector<int>> columns(num_free());  // of each camera, those with a block below
    for (int i = 0; i < num_free(); ++i) {
      for (const int h : blocks_.row(i)) {
        columns[h].push_back(i);
      }
    }
    starts_.resize(num_free());
    sparse_.resize(size_, size_);
    std::vector<Eigen::Triplet<double>> entries;
    for (int h = 0; h < num_free(); ++h) {
      for (int b = 0; b < kPose; ++b) {
        for (const int i : columns[h]) {
          if (b == 0) {
            starts_[i].emplace_back();
          }
          // Rows of h come in ascending order, so that this is entry n of row i.
          starts_[i][block_number(i, h)][b] = static_cast<int64_t>(entries.size());
          for (int a = 0; a < kPose; ++a) {
            entries.emplace_back(kPose * i + a, kPose * h + b, 0.0);
          }
        }
      }
    }
    sparse_.setFromTriplets(entries.begin(), entries.end());
    factor_.analyzePattern(sparse_);
  }

  std::size_t block_number(int i, int h) const
  {
    const auto& row = blocks_.row(i);
    return std::lower_bound(row.begin(), row.end(), h) - row.begin();
  }

  int num_free() const { return static_cast<int>(size_ / kPose); }

  Eigen::Index size_;
  PoseBlocks blocks_;
  Sparse sparse_;
  // For each block of each row, where its columns start among the values of the sparse matrix.
  std::vector<std::vector<std::array<int64_t, kPose>>> starts_;
  Eigen::SimplicialLLT<Sparse, Eigen::Lower> factor_;
};

class Adjustment
{
public:
  Adjustment(Window window, State state)
  : window_(std::move(window)),
    state_(std::move(state)),
    reduced_(window_),
    used_(window_.weight.size(), 1),
    chi2_(window_.weight.size())
  {
    const std::size_t free = window_.num_free, points = state_.points.size() / kPoint;
    system_.H_cc.resize(36 * free);
    system_.g_c.resize(6 * free);
    system_.H_pp.resize(9 * points);
    system_.g_p.resize(3 * points);
    system_.H_pc.resize(18 * window_.weight.size());
  }

  // Run at most `iterations` steps; return the cost before them.
  double minimize(int iterations)
  {
    double damping = kFirstDamping, cost = update();
    const double before = cost;
    bool moved = true;
    for (int n = 0; n < iterations; ++n) {
      if (moved) {
        linearize(window_, state_, used_.data(), system_);
      }
      const State old = state_;
      moved = take_step(damping);
      const double new_cost = moved ? update() : cost;
      if (!moved || !(new_cost <= cost)) {
        moved = false;
        state_ = old;
        damping = std::min(100 * damping, kMaxDamping);
        continue;
      }
      const bool done = cost - new_cost < kConvergedCost * cost;
      cost = new_cost;
      damping = std::max(damping / 10, kMinDamping);
      if (done) {
        break;
      }
    }
    return before;
  }

  // Ignore the observations beyond their gates from now on.
  void drop_outliers()
  {
    update();
    for (int m = 0; m < window_.count(); ++m) {
      used_[m] &= chi2_[m] <= gate_of(window_.gates, window_.at(m));
    }
  }

  double update() { return cost_of(window_, state_, used_.data(), chi2_.data()); }

  const State& state() const { return state_; }
  const std::vector<double>& chi2() const { return chi2_; }

private:
  // Solve the damped system and update cameras and points; false if it cannot be solved.
  bool take_step(double damping)
  {
    Eigen::VectorXd step;
    if (!reduced_.solve(window_, system_, damping, step)) {
      return false;
    }
    move_points(window_, system_, damping, step.data(), state_);
    for (int i = 0; i < window_.num_free; ++i) {
      move_pose(step.segment<kPose>(kPose * i), &state_.T[kPoseSize * i]);
    }
    return true;
  }

  Window window_;
  State state_;
  Reduced reduced_;
  System system_;
  std::vector<uint8_t> used_;
  std::vector<double> chi2_;
};

// Return the position of each observation when all are sorted by point (stable).
std::vector<int32_t> places_by_point(const BundleProblem& problem)
{
  std::vector<int32_t> next(static_cast<std::size_t>(problem.num_points) + 1, 0);
  for (int m = 0; m < problem.num_observations; ++m) {
    ++next[problem.point[m] + 1];
  }
  std::partial_sum(next.begin(), next.end(), next.begin());
  std::vector<int32_t> place(problem.num_observations);
  for (int m = 0; m < problem.num_observations; ++m) {
    place[m] = next[problem.point[m]]++;
  }
  return place;
}

// Return the observations sorted by point.
Window sorted_by_point(
  const StereoParams& camera, const Gates& gates, const BundleProblem& problem)
{
  const auto count = static_cast<std::size_t>(problem.num_observations);
  const std::vector<int32_t> place = places_by_point(problem);
  Window window{camera, gates, problem.num_free, {}, {}, {}, {}};
  window.camera_of.resize(count);
  window.point_of.resize(count);
  window.measured.resize(3 * count);
  window.weight.resize(count);
  for (std::size_t m = 0; m < count; ++m) {
    const auto to = static_cast<std::size_t>(place[m]);
    window.camera_of[to] = static_cast<int32_t>(problem.camera[m]);
    window.point_of[to] = static_cast<int32_t>(problem.point[m]);
    std::copy_n(problem.measured_px + 3 * m, 3, &window.measured[3 * to]);
    window.weight[to] = problem.inv_sigma2[m];
  }
  return window;
}

}  // namespace

BundleFit adjust_bundle(
  const StereoParams& camera, const Gates& gates, const BundleProblem& problem, int rounds,
  int iterations)
{
  const double *T = problem.T_camera_map, *points = problem.points_m;
  Adjustment adjustment(
    sorted_by_point(camera, gates, problem),
    {{T, T + kPoseSize * static_cast<std::ptrdiff_t>(problem.num_cameras)},
     {points, points + kPoint * static_cast<std::ptrdiff_t>(problem.num_points)}});
  BundleFit fit;
  fit.cost_before = adjustment.minimize(iterations);
  for (int round = 1; round < rounds; ++round) {
    adjustment.drop_outliers();
    adjustment.minimize(iterations);
  }
  fit.cost_after = adjustment.update();
  fit.T_camera_map = adjustment.state().T;
  fit.points_m = adjustment.state().points;
  fit.chi2.reserve(problem.num_observations);
  for (const int32_t place : places_by_point(problem)) {
    fit.chi2.push_back(adjustment.chi2()[place]);
  }
  return fit;
}

}  // namespace hoid::optimize
