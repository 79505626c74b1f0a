// Bundle adjustment of a window of keyframes by Levenberg-Marquardt.

#include <algorithm>
#include <array>
#include <Eigen/Cholesky>
#include <Eigen/Sparse>
#include <numeric>
#include <utility>

#include "common/buckets.hpp"
#include "optimize/bundle_system.hpp"
#include "optimize/optimize.hpp"

namespace hoid::optimize {

namespace {

// Levenberg-Marquardt, chosen: damping relative to the diagonal, and the relative decrease of the
// cost below which a round ends.
constexpr double kFirstDamping = 1e-5, kMinDamping = 1e-9, kMaxDamping = 1e3;
constexpr double kConvergedCost = 1e-4;

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
      Eigen::Map<Matrix6> block(blocks_.at(i, i));
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
        S.block<kPose, kPose>(kPose * i, kPose * h) = Eigen::Map<Matrix6>(blocks_.at(i, h));
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

  // Create the sparse matrix without values, and find where each block is in it.
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

// Return the observations in this order, which is by point.
Window sorted(
  const StereoParams& camera, const Gates& gates, const BundleProblem& problem, Buckets by_point)
{
  Window window{camera, gates, problem.num_free, {}, {}, {}, {}, {}};
  for (const int32_t m : by_point.order) {
    window.camera_of.push_back(static_cast<int32_t>(problem.camera[m]));
    window.point_of.push_back(static_cast<int32_t>(problem.point[m]));
    window.measured.insert(
      window.measured.end(), problem.measured_px[m], problem.measured_px[m] + 3);
    window.weight.push_back(problem.inv_sigma2[m]);
  }
  window.start = std::move(by_point.start);
  return window;
}

}  // namespace

BundleFit adjust_bundle(
  const StereoParams& camera, const Gates& gates, const BundleProblem& problem, int rounds,
  int iterations)
{
  const Transforms& T = problem.T_camera_map;
  const Points& points = problem.points_m;
  std::vector<int32_t> all(problem.point.count);
  std::iota(all.begin(), all.end(), 0);
  const Buckets by_point =
    sort_into_buckets(all, points.count, [&](int32_t m) { return problem.point[m]; });
  Adjustment adjustment(
    sorted(camera, gates, problem, by_point),
    {{T.begin(), T.end()}, {points.begin(), points.end()}});
  BundleFit fit;
  fit.cost_before = adjustment.minimize(iterations);
  for (int round = 1; round < rounds; ++round) {
    adjustment.drop_outliers();
    adjustment.minimize(iterations);
  }
  fit.cost_after = adjustment.update();
  fit.T_camera_map = adjustment.state().T;
  fit.points_m = adjustment.state().points;
  fit.chi2.resize(all.size());
  for (const int32_t n : all) {
    fit.chi2[by_point.order[n]] = adjustment.chi2()[n];
  }
  return fit;
}

}  // namespace hoid::optimize
