// The parts of a bundle adjustment whose points are eliminated by the Schur complement (Triggs et
// al., Bundle Adjustment - A Modern Synthesis, 2000, sec. 6.1).
#pragma once

#include <cstdint>
#include <vector>

#include "stereo.hpp"

namespace bundle {

using namespace stereo;

constexpr double kPivot = 1e-12;
constexpr int kPoseSize = 16;  // a row-major 4x4

// Arrays over C cameras, of which the first `num_free` move, P points and M observations; these
// are sorted by point.
struct Problem
{
  Camera camera;
  Gates gates;
  int num_cameras, num_free, num_points, num_observations;
  const int32_t* camera_of;  // (M)
  const int32_t* point_of;   // (M)
  const double* measured;    // (M, 3)
  const double* weight;      // (M)

  ALWAYS_INLINE Observation at(int m) const { return {measured + 3 * m, weight[m]}; }
};

struct State
{
  std::vector<double> T, points;  // (C, 16), (P, 3)
};

// The normal equations of one linearisation.
struct System
{
  std::vector<double> H_cc, g_c;  // (free, 6, 6), (free, 6)
  std::vector<double> H_pp, g_p;  // (P, 3, 3), (P, 3)
  std::vector<double> H_pc;       // (M, 3, 6), of observations by free cameras
};

// Return the Huber cost of the observations in use, and write all their squared normalised residuals
// (M); infinite behind a camera.
double cost_of(const Problem& problem, const State& state, const uint8_t* used, double* chi2_out);

void linearize(const Problem& problem, const State& state, const uint8_t* used, System& system);

// S -= Y^T W and right -= Y^T g_p with Y = H_pp^-1 W, W = H_pc, over all points; the upper triangle
// of S is left alone.
void eliminate(
  const Problem& problem, const System& system, double damping, double* S, double* right);

// Move the points as a step of the cameras asks for.
void move_points(
  const Problem& problem, const System& system, double damping, const double* step, State& state);

}  // namespace bundle
