#include <algorithm>
#include <cmath>
#include <Eigen/Core>
#include <Eigen/Geometry>

#include "common/multiversion.hpp"
#include "motion/motion.hpp"

namespace hoid::motion {

namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr double kNearestM = 0.1;  // chosen: nearer than most depth cameras measure
// Norm of the cross product (two thirds of the triangle's area) below which three points count as
// on a line, numerically.
constexpr double kMinCrossM2 = 1e-9;

// The columns of an (N, 3) array, contiguous for vector instructions.
struct Columns
{
  std::vector<double> x, y, z;

  explicit Columns(const Rows<double, 3>& rows)
  {
    for (int k = 0; k < rows.count; ++k) {
      x.push_back(rows[k][0]);
      y.push_back(rows[k][1]);
      z.push_back(rows[k][2]);
    }
  }
};

// 1 / (standard deviation of pixels * limit)^2, and the inverse variance of the disparity in units
// of the variance of pixels.
struct Noise
{
  double per_limit2, per_disparity2;
};

// Write how well each point fits a pose: 1 - (residual / limit)^2, at least 0.
ALWAYS_INLINE void write_fits(
  const optimize::StereoParams camera, const Noise noise, const double* pose,
  const Columns& points_m, const Columns& measured_px, double* __restrict fit_out)
{
  double T[12];  // a copy: shows the compiler that the loop's output cannot alias it
  std::copy_n(pose, 12, T);
  const auto count = static_cast<int>(points_m.x.size());
  const double *__restrict x = points_m.x.data(), *__restrict y = points_m.y.data(),
               *__restrict z = points_m.z.data(), *__restrict u = measured_px.x.data(),
               *__restrict v = measured_px.y.data(), *__restrict u_right = measured_px.z.data();
  for (int k = 0; k < count; ++k) {
    const double ahead = T[8] * x[k] + T[9] * y[k] + T[10] * z[k] + T[11];
    const double scale = 1 / (ahead > kNearestM ? ahead : kNearestM);
    const double du = (T[0] * x[k] + T[1] * y[k] + T[2] * z[k] + T[3]) * scale * camera.fx_px +
                      camera.cx_px - u[k];
    const double dv = (T[4] * x[k] + T[5] * y[k] + T[6] * z[k] + T[7]) * scale * camera.fy_px +
                      camera.cy_px - v[k];
    const double error = camera.disparity_px_m * scale - (u[k] - u_right[k]);
    const double d = u_right[k] == u_right[k] ? error : 0.0;
    const double fit =
      1 - (du * du + dv * dv + d * d * noise.per_disparity2) * noise.per_limit2;
    fit_out[k] = (ahead > kNearestM) & (fit > 0) ? fit : 0.0;
  }
}

// Three points relative to their mean, and the axes of their plane.
struct Triple
{
  Vector3d mean;
  Matrix3d axes;       // columns: towards the first point, perpendicular in the plane, normal
  Vector3d points[3];  // relative to the mean
  bool is_degenerate;  // they lie on a line

  Triple(const Points& points_m, const int64_t* indices)
  {
    for (int n = 0; n < 3; ++n) {
      points[n] = Eigen::Map<const Vector3d>(points_m[indices[n]]);
    }
    mean = (points[0] + points[1] + points[2]) / 3;
    for (Vector3d& point : points) {
      point -= mean;
    }
    const Vector3d normal = points[0].cross(points[1]);
    is_degenerate = !(normal.norm() > kMinCrossM2);
    axes.col(0) = points[0].normalized();
    axes.col(2) = normal.normalized();
    axes.col(1) = axes.col(2).cross(axes.col(0));
  }
};

}  // namespace

MULTIVERSION("avx2")
void score_poses(
  const optimize::StereoParams& camera, double pixel_px, double limit,
  const Transforms& T_camera_world, const PointObservations& seen, double* score_out)
{
  const Noise noise{
    1 / (pixel_px * pixel_px * limit * limit),
    1 / (camera.disparity_noise_px * camera.disparity_noise_px)};
  const Columns points_m(seen.points_m), measured_px(seen.measured_px);
  std::vector<double> fit(seen.points_m.count);
  for (int m = 0; m < T_camera_world.count; ++m) {
    write_fits(camera, noise, T_camera_world[m], points_m, measured_px, fit.data());
    double score[2] = {0, 0};
    for (int k = 0; k < seen.weights.count; ++k) {
      score[0] += fit[k] * seen.weights[k][0];
      score[1] += fit[k] * seen.weights[k][1];
    }
    std::copy_n(score, 2, score_out + 2 * m);
  }
}

void align_triples(
  const Points& from_m, const Points& to_m, const Rows<int64_t, 3>& triples, double* T_out)
{
  for (int m = 0; m < triples.count; ++m, T_out += 16) {
    Eigen::Map<Eigen::Matrix<double, 4, 4, Eigen::RowMajor>> T(T_out);
    T.setIdentity();
    const Triple from(from_m, triples[m]), to(to_m, triples[m]);
    if (from.is_degenerate || to.is_degenerate) {
      continue;
    }
    // In closed form: the least-squares rotation maps one plane's normal to the other's, and
    // rotates within the plane by the angle that minimizes the squared distances of the points.
    double along = 0, across = 0;
    for (int n = 0; n < 3; ++n) {
      const Vector3d a = from.axes.transpose() * from.points[n],
                     b = to.axes.transpose() * to.points[n];
      along += a[0] * b[0] + a[1] * b[1];
      across += a[0] * b[1] - a[1] * b[0];
    }
    const double length = std::hypot(along, across);
    Matrix3d in_plane;
    in_plane << along / length, -across / length, 0, across / length, along / length, 0, 0, 0, 1;
    const Matrix3d R = to.axes * in_plane * from.axes.transpose();
    T.topLeftCorner<3, 3>() = R;
    T.topRightCorner<3, 1>() = to.mean - R * from.mean;
  }
}

}  // namespace hoid::motion
