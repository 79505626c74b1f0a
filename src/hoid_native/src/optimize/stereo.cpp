#include "optimize/stereo.hpp"

#include <Eigen/Geometry>

namespace hoid::optimize {

namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using Matrix4 = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;

Matrix3d skew(const Vector3d& w)
{
  Matrix3d W;
  W << 0, -w.z(), w.y(), w.z(), 0, -w.x(), -w.y(), w.x(), 0;
  return W;
}

// One Newton iteration towards the nearest rotation matrix.
Matrix3d orthonormalized(const Matrix3d& R)
{
  return 1.5 * R - 0.5 * (R * R.transpose()) * R;
}

}  // namespace

void move_pose(const Vector6& twist, Pose pose)
{
  const Vector3d w = twist.head<3>(), v = twist.tail<3>();
  const double square = w.squaredNorm(), angle = std::sqrt(square);
  const bool small = angle < kSmallAngleRad;
  const double a = small ? 1.0 - square / 6 : std::sin(angle) / angle;
  const double b = small ? 0.5 - square / 24 : (1.0 - std::cos(angle)) / square;
  const double c = small ? 1.0 / 6 - square / 120 : (1.0 - a) / square;
  const Matrix3d W = skew(w), W2 = W * W;
  const Matrix3d R = Matrix3d::Identity() + a * W + b * W2;
  const Matrix3d V = Matrix3d::Identity() + b * W + c * W2;
  Eigen::Map<Matrix4> T(pose);
  const Matrix3d rotation = R * T.topLeftCorner<3, 3>();
  const Vector3d t = R * T.topRightCorner<3, 1>() + V * v;
  T.topLeftCorner<3, 3>() = orthonormalized(rotation);
  T.topRightCorner<3, 1>() = t;
}

}  // namespace hoid::optimize
