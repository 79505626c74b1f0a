#include "optimize/stereo.hpp"

#include <cstring>

namespace hoid::optimize {

namespace {

// One step of Newton's iteration to the nearest rotation: R <- (3 R - R R^T R) / 2.
void orthonormalize(double R[3][3])
{
  double gram[3][3];
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) {
      gram[r][c] = R[r][0] * R[c][0] + R[r][1] * R[c][1] + R[r][2] * R[c][2];
    }
  }
  double out[3][3];
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) {
      const double product =
        gram[r][0] * R[0][c] + gram[r][1] * R[1][c] + gram[r][2] * R[2][c];
      out[r][c] = 1.5 * R[r][c] - 0.5 * product;
    }
  }
  std::memcpy(R, out, sizeof(out));
}

}  // namespace

void move_pose(const double* twist, Pose T)
{
  const double* w = twist;
  const double* v = twist + 3;
  const double square = w[0] * w[0] + w[1] * w[1] + w[2] * w[2];
  const double angle = std::sqrt(square);
  const bool small = angle < kSmallAngleRad;
  const double a = small ? 1.0 - square / 6 : std::sin(angle) / angle;
  const double b = small ? 0.5 - square / 24 : (1.0 - std::cos(angle)) / square;
  const double c = small ? 1.0 / 6 - square / 120 : (1.0 - a) / square;
  const double W[3][3] = {{0, -w[2], w[1]}, {w[2], 0, -w[0]}, {-w[1], w[0], 0}};
  double R[3][3], V[3][3];
  for (int r = 0; r < 3; ++r) {
    for (int k = 0; k < 3; ++k) {
      const double identity = r == k ? 1.0 : 0.0;
      const double W2 = w[r] * w[k] - square * identity;
      R[r][k] = identity + a * W[r][k] + b * W2;
      V[r][k] = identity + b * W[r][k] + c * W2;
    }
  }
  double rotation[3][3], t[3];
  for (int r = 0; r < 3; ++r) {
    for (int k = 0; k < 3; ++k) {
      rotation[r][k] = R[r][0] * T[k] + R[r][1] * T[4 + k] + R[r][2] * T[8 + k];
    }
    t[r] = R[r][0] * T[3] + R[r][1] * T[7] + R[r][2] * T[11] + V[r][0] * v[0] + V[r][1] * v[1] +
           V[r][2] * v[2];
  }
  orthonormalize(rotation);
  for (int r = 0; r < 3; ++r) {
    for (int k = 0; k < 3; ++k) {
      T[4 * r + k] = rotation[r][k];
    }
    T[4 * r + 3] = t[r];
  }
}

bool solve_positive(double* A, double* b, int n)
{
  for (int r = 0; r < n; ++r) {
    double* row = A + r * n;
    for (int c = 0; c <= r; ++c) {
      const double* other = A + c * n;
      double sum = row[c];
      for (int k = 0; k < c; ++k) {
        sum -= row[k] * other[k];
      }
      if (c < r) {
        row[c] = sum / other[c];
      } else if (sum > 0.0) {
        row[c] = std::sqrt(sum);
      } else {
        return false;
      }
    }
  }
  for (int r = 0; r < n; ++r) {
    for (int k = 0; k < r; ++k) {
      b[r] -= A[r * n + k] * b[k];
    }
    b[r] /= A[r * n + r];
  }
  for (int r = n - 1; r >= 0; --r) {
    for (int k = r + 1; k < n; ++k) {
      b[r] -= A[k * n + r] * b[k];
    }
    b[r] /= A[r * n + r];
  }
  return true;
}

}  // namespace hoid::optimize
