#include "optimize/bundle_system.hpp"

#include <algorithm>
#include <limits>

namespace hoid::optimize {

namespace {

// Chosen: cost of a point behind its camera, far above any Huber cost, so that such steps are
// rejected.
constexpr double kCostBehind = 1e3;
// Chosen: share of the pairs of cameras with a block from which on the factorization is dense. It
// uses vector instructions and is several times as fast per operation as a sparse one.
constexpr double kDenseShare = 0.2;

// J_map = J_point R: derivatives by the point in the map frame.
ALWAYS_INLINE void rotated(
  const double J[kRows][kPoint], const double* T, double out[kRows][kPoint])
{
  for (int r = 0; r < kRows; ++r) {
    for (int a = 0; a < kPoint; ++a) {
      out[r][a] = J[r][0] * T[a] + J[r][1] * T[4 + a] + J[r][2] * T[8 + a];
    }
  }
}

// H[a][b] += sum over rows of weight * A[row][a] * B[row][b].
template <int NA, int NB>
ALWAYS_INLINE void add_product(
  const double A[kRows][NA], const double B[kRows][NB], const Weights& weights, double* H)
{
  for (int r = 0; r < kRows; ++r) {
    for (int a = 0; a < NA; ++a) {
      const double scaled = (r < 2 ? weights.pixel : weights.depth) * A[r][a];
      for (int b = 0; b < NB; ++b) {
        H[a * NB + b] += scaled * B[r][b];
      }
    }
  }
}

template <int N>
ALWAYS_INLINE void add_gradient(
  const double J[kRows][N], const double* e, const Weights& weights, double* g)
{
  for (int a = 0; a < N; ++a) {
    g[a] += weights.pixel * (J[0][a] * e[0] + J[1][a] * e[1]) + weights.depth * J[2][a] * e[2];
  }
}

// Write the inverse of a symmetric 3x3 matrix with its diagonal damped (Levenberg-Marquardt).
ALWAYS_INLINE void inverse_of(const double* H, double damping, double out[3][3])
{
  const double xx = H[0] * (1 + damping) + kPivot, yy = H[4] * (1 + damping) + kPivot;
  const double zz = H[8] * (1 + damping) + kPivot, xy = H[1], xz = H[2], yz = H[5];
  const double a = yy * zz - yz * yz, b = xz * yz - xy * zz, c = xy * yz - xz * yy;
  const double inv = 1.0 / (xx * a + xy * b + xz * c);
  out[0][0] = a * inv;
  out[0][1] = out[1][0] = b * inv;
  out[0][2] = out[2][0] = c * inv;
  out[1][1] = (xx * zz - xz * xz) * inv;
  out[1][2] = out[2][1] = (xy * xz - xx * yz) * inv;
  out[2][2] = (xx * yy - xy * xy) * inv;
}

// S[i, h] -= Y_i^T W_h, for one point and two cameras.
ALWAYS_INLINE void subtract_block(const double Y[3][kPose], const double* W, double* S)
{
  for (int a = 0; a < kPose; ++a) {
    for (int b = 0; b < kPose; ++b) {
      S[a * kPose + b] -= Y[0][a] * W[b] + Y[1][a] * W[6 + b] + Y[2][a] * W[12 + b];
    }
  }
}

template <bool kJoint>
ALWAYS_INLINE void sum_system(
  const Window& window, const State& state, const uint8_t* used, System& system)
{
  for (int m = 0; m < window.count(); ++m) {
    const int i = window.camera_of[m], j = window.point_of[m];
    const double* T = &state.T[kPoseSize * i];
    const Observation seen = window.at(m);
    double x[3], e[3], J[kRows][kPoint], J_map[kRows][kPoint], J_pose[kRows][kPose];
    transform(T, &state.points[3 * j], x);
    if (!used[m] || x[2] < kMinDepthM) {
      continue;
    }
    residual<kJoint>(window.camera, x, seen, e);
    const Weights weight = weights_of<kJoint>(window.camera, window.gates, seen, e);
    point_jacobian<kJoint>(window.camera, x, J);
    rotated(J, T, J_map);
    add_product<kPoint, kPoint>(
      J_map, J_map, weight, &system.H_pp[9 * static_cast<std::size_t>(j)]);
    add_gradient<kPoint>(J_map, e, weight, &system.g_p[3 * j]);
    if (i < window.num_free) {
      pose_jacobian(x, J, J_pose);
      add_product<kPose, kPose>(J_pose, J_pose, weight, &system.H_cc[36 * i]);
      add_gradient<kPose>(J_pose, e, weight, &system.g_c[6 * i]);
      add_product<kPoint, kPose>(
        J_map, J_pose, weight, &system.H_pc[18 * static_cast<std::size_t>(m)]);
    }
  }
}

template <bool kJoint>
ALWAYS_INLINE double sum_costs(
  const Window& window, const State& state, const uint8_t* used, double* chi2_out)
{
  double sum = 0.0;
  for (int m = 0; m < window.count(); ++m) {
    const Observation seen = window.at(m);
    double x[3], e[3];
    const double* T = &state.T[kPoseSize * window.camera_of[m]];
    transform(T, &state.points[kPoint * window.point_of[m]], x);
    residual<kJoint>(window.camera, x, seen, e);
    const bool behind = x[2] < kMinDepthM;
    chi2_out[m] = behind ? std::numeric_limits<double>::infinity() : chi2<kJoint>(seen, e);
    if (used[m]) {
      sum += behind ? kCostBehind : weights_of<kJoint>(window.camera, window.gates, seen, e).cost;
    }
  }
  return sum;
}

}  // namespace

PoseBlocks::PoseBlocks(const Window& window)
: num_free_(window.num_free),
  slots_(decltype(slots_)::Constant(num_free_, num_free_, -1)),
  rows_(num_free_)
{
  int32_t count = 0;
  const auto add = [&](int i, int h) {
    if (slot(i, h) < 0) {
      slot(i, h) = count++;
      rows_[i].push_back(h);
    }
  };
  for (int i = 0; i < num_free_; ++i) {
    add(i, i);
  }
  for (int j = 0; j < window.num_points(); ++j) {
    const int first = window.start[j], end = window.start[j + 1];
    for (int m = first; m < end; ++m) {
      for (int other = first; other < end && window.camera_of[m] < num_free_; ++other) {
        if (window.camera_of[other] <= window.camera_of[m]) {
          add(window.camera_of[m], window.camera_of[other]);
        }
      }
    }
  }
  for (auto& row : rows_) {
    std::sort(row.begin(), row.end());
  }
  values_.resize(36 * static_cast<std::size_t>(count));
}

void PoseBlocks::clear() { std::fill(values_.begin(), values_.end(), 0.0); }

bool PoseBlocks::is_dense() const
{
  const double pairs = 0.5 * num_free_ * (num_free_ + 1.0);
  return static_cast<double>(values_.size()) / 36 > kDenseShare * pairs;
}

MULTIVERSION("avx2")
void eliminate(
  const Window& window, const System& system, double damping, PoseBlocks& S, double* right)
{
  for (int j = 0; j < window.num_points(); ++j) {
    const int first = window.start[j], end = window.start[j + 1];
    double inverse[3][3];
    inverse_of(&system.H_pp[9 * static_cast<std::size_t>(j)], damping, inverse);
    const double* g = &system.g_p[3 * j];
    for (int m = first; m < end; ++m) {
      const int i = window.camera_of[m];
      if (i >= window.num_free) {
        continue;
      }
      const double* W = &system.H_pc[18 * static_cast<std::size_t>(m)];
      double Y[3][kPose];
      for (int r = 0; r < 3; ++r) {
        for (int a = 0; a < kPose; ++a) {
          Y[r][a] = inverse[r][0] * W[a] + inverse[r][1] * W[6 + a] + inverse[r][2] * W[12 + a];
        }
      }
      for (int a = 0; a < kPose; ++a) {
        right[kPose * i + a] -= Y[0][a] * g[0] + Y[1][a] * g[1] + Y[2][a] * g[2];
      }
      for (int other = first; other < end; ++other) {
        const int h = window.camera_of[other];
        if (h > i) {
          continue;
        }
        subtract_block(Y, &system.H_pc[18 * static_cast<std::size_t>(other)], S.at(i, h));
      }
    }
  }
}

MULTIVERSION("avx2")
void linearize(const Window& window, const State& state, const uint8_t* used, System& system)
{
  for (auto* part : {&system.H_cc, &system.g_c, &system.H_pp, &system.g_p, &system.H_pc}) {
    std::fill(part->begin(), part->end(), 0.0);
  }
  if (window.camera.joint_noise) {
    sum_system<true>(window, state, used, system);
  } else {
    sum_system<false>(window, state, used, system);
  }
}

MULTIVERSION("avx2")
void move_points(
  const Window& window, const System& system, double damping, const double* step, State& state)
{
  for (int j = 0; j < window.num_points(); ++j) {
    if (window.start[j] == window.start[j + 1]) {
      continue;
    }
    double left[3];
    std::copy_n(&system.g_p[3 * j], 3, left);
    for (int m = window.start[j]; m < window.start[j + 1]; ++m) {
      const int i = window.camera_of[m];
      if (i < window.num_free) {
        const double* W = &system.H_pc[18 * static_cast<std::size_t>(m)];
        for (int r = 0; r < 3; ++r) {
          for (int a = 0; a < kPose; ++a) {
            left[r] -= W[6 * r + a] * step[kPose * i + a];
          }
        }
      }
    }
    double inverse[3][3];
    inverse_of(&system.H_pp[9 * static_cast<std::size_t>(j)], damping, inverse);
    for (int r = 0; r < 3; ++r) {
      state.points[3 * j + r] +=
        inverse[r][0] * left[0] + inverse[r][1] * left[1] + inverse[r][2] * left[2];
    }
  }
}

MULTIVERSION("avx2")
double cost_of(const Window& window, const State& state, const uint8_t* used, double* chi2_out)
{
  return window.camera.joint_noise ? sum_costs<true>(window, state, used, chi2_out)
                                   : sum_costs<false>(window, state, used, chi2_out);
}

}  // namespace hoid::optimize
