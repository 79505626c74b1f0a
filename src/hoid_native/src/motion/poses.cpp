#include <algorithm>
#include <cmath>
#include <cstddef>
#include <Eigen/Core>
#include <Eigen/Geometry>

#include "common/multiversion.hpp"
#include "motion/motion.hpp"

namespace hoid::motion {

namespace {

constexpr double kNearestM = 0.1;      // a point nearer to the camera fits no pose
constexpr double kLeastAreaM2 = 1e-9;  // of three points, else they lie on a line

}  // namespace

MULTIVERSION("avx2")
void score_poses(
  const optimize::StereoParams& camera, double pixel_px, double limit,
  const double* T_camera_world, int num_poses, const Points& points, double* score_out)
{
  const double per_limit2 = 1 / (pixel_px * pixel_px * limit * limit);
  const double per_disparity2 = 1 / (camera.disparity_noise_px * camera.disparity_noise_px);
  for (int m = 0; m < num_poses; ++m) {
    const double* T = T_camera_world + static_cast<std::ptrdiff_t>(16) * m;
    double score[2] = {0, 0};
    for (int k = 0; k < points.count; ++k) {
      const double *X = points.points_m + static_cast<std::ptrdiff_t>(3) * k,
                   *seen = points.measured_px + static_cast<std::ptrdiff_t>(3) * k;
      const double z = T[8] * X[0] + T[9] * X[1] + T[10] * X[2] + T[11];
      const double scale = 1 / std::max(z, kNearestM);
      const double u = (T[0] * X[0] + T[1] * X[1] + T[2] * X[2] + T[3]) * scale * camera.fx_px +
                       camera.cx_px - seen[0];
      const double v = (T[4] * X[0] + T[5] * X[1] + T[6] * X[2] + T[7]) * scale * camera.fy_px +
                       camera.cy_px - seen[1];
      const double d =
        std::isnan(seen[2]) ? 0.0 : camera.disparity_px_m * scale - (seen[0] - seen[2]);
      const double share = 1 - (u * u + v * v + d * d * per_disparity2) * per_limit2;
      const double counted = z > kNearestM ? std::max(0.0, share) : 0.0;
      score[0] += counted * points.weights[2 * k];
      score[1] += counted * points.weights[2 * k + 1];
    }
    score_out[2 * m] = score[0];
    score_out[2 * m + 1] = score[1];
  }
}

namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

// The mean of three points, and the axes of the plane that they span.
struct Triple
{
  Vector3d middle;
  Matrix3d axes;       // columns: to the first point, across in the plane, the normal
  Vector3d points[3];  // from the middle
  bool is_flat;        // they lie on a line

  Triple(const double* points_m, const int64_t* indices)
  {
    for (int n = 0; n < 3; ++n) {
      points[n] = Eigen::Map<const Vector3d>(points_m + 3 * indices[n]);
    }
    middle = (points[0] + points[1] + points[2]) / 3;
    for (Vector3d& point : points) {
      point -= middle;
    }
    const Vector3d normal = points[0].cross(points[1]);
    is_flat = !(normal.norm() > kLeastAreaM2);
    axes.col(0) = points[0].normalized();
    axes.col(2) = normal.normalized();
    axes.col(1) = axes.col(2).cross(axes.col(0));
  }
};

}  // namespace

void align_triples(
  const double* from_m, const double* to_m, const int64_t* triples, int count, double* T_out)
{
  for (int m = 0; m < count; ++m) {
    Eigen::Map<Eigen::Matrix<double, 4, 4, Eigen::RowMajor>> T(
      T_out + static_cast<std::ptrdiff_t>(16) * m);
    T.setIdentity();
    const int64_t* indices = triples + static_cast<std::ptrdiff_t>(3) * m;
    const Triple from(from_m, indices), to(to_m, indices);
    if (from.is_flat || to.is_flat) {
      continue;
    }
    // Three points span a plane: the least squares turn takes one's normal to the other's, and in
    // the plane by the angle that the points agree on.
    double along = 0, across = 0;
    for (int n = 0; n < 3; ++n) {
      const Vector3d a = from.axes.transpose() * from.points[n],
                     b = to.axes.transpose() * to.points[n];
      along += a[0] * b[0] + a[1] * b[1];
      across += a[0] * b[1] - a[1] * b[0];
    }
    const double length = std::hypot(along, across);
    Matrix3d turn;
    turn << along / length, -across / length, 0, across / length, along / length, 0, 0, 0, 1;
    const Matrix3d R = to.axes * turn * from.axes.transpose();
    T.topLeftCorner<3, 3>() = R;
    T.topRightCorner<3, 1>() = to.middle - R * from.middle;
  }
}

}  // namespace hoid::motion
