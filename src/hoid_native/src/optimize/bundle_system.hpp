// Steps of bundle adjustment with the points eliminated by the Schur complement (Triggs et al.,
// Bundle Adjustment - A Modern Synthesis, 2000, sec. 6.1).
#pragma once

#include <cstddef>
#include <cstdint>
#include <Eigen/Core>
#include <vector>

#include "optimize/stereo.hpp"

namespace hoid::optimize {

constexpr double kPivot = 1e-12;  // keeps blocks without observations invertible
constexpr int kPoseSize = 16;  // a row-major 4x4

// The observations of a window of keyframes, sorted by point.
struct Window
{
  StereoParams camera;
  Gates gates;
  int num_free;  // the first cameras are optimized, the others fixed
  std::vector<int32_t> camera_of, point_of;
  std::vector<double> measured, weight;  // (M, 3), (M)
  std::vector<int32_t> start;            // (P + 1) first observation of each point

  int num_points() const { return static_cast<int>(start.size()) - 1; }

  int count() const { return static_cast<int>(weight.size()); }

  ALWAYS_INLINE Observation at(int m) const
  {
    return {measured.data() + 3 * static_cast<std::size_t>(m), weight[m]};
  }
};

// The variables of the adjustment.
struct State
{
  std::vector<double> T, points;  // (C, 16), (P, 3)
};

// The normal equations of one linearization.
struct System
{
  std::vector<double> H_cc, g_c;  // (free, 6, 6), (free, 6)
  std::vector<double> H_pp, g_p;  // (P, 3, 3), (P, 3)
  std::vector<double> H_pc;       // (M, 3, 6), for observations by free cameras
};

// Return the Huber cost of the observations in use, and write the (M) squared normalized residuals
// of all observations; infinite behind the camera.
double cost_of(const Window& window, const State& state, const uint8_t* used, double* chi2_out);

// Write the normal equations at the current state.
void linearize(const Window& window, const State& state, const uint8_t* used, System& system);

// The lower triangle of a symmetric matrix of 6 x 6 blocks: a block for each pair of free cameras
// that observe a common point.
class PoseBlocks
{
public:
  explicit PoseBlocks(const Window& window);

  void clear();

  // The block of cameras i >= h, row-major.
  double* at(int i, int h) { return &values_[36 * static_cast<std::size_t>(slot(i, h))]; }

  // The cameras h <= i with a block, ascending.
  const std::vector<int32_t>& row(int i) const { return rows_[i]; }

  // Whether there are so many blocks that a dense factorization is faster.
  bool is_dense() const;

private:
  int32_t& slot(int i, int h) { return slots_(h, i); }

  int num_free_;
  // (free, free); -1: no block. Eigen reports too little memory by an exception, also where new
  // would end the process.
  Eigen::Matrix<int32_t, Eigen::Dynamic, Eigen::Dynamic> slots_;
  std::vector<std::vector<int32_t>> rows_;
  std::vector<double> values_;
};

// Schur complement: S -= Y^T W and right -= Y^T g_p, with W = H_pc and Y = H_pp^-1 W, summed over
// the points.
void eliminate(
  const Window& window, const System& system, double damping, PoseBlocks& S, double* right);

// Update the points by back-substitution of a step of the cameras (the twists of the free ones).
void move_points(
  const Window& window, const System& system, double damping, const double* step, State& state);

}  // namespace hoid::optimize
