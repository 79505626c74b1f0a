#include "objects/planes.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <Eigen/Core>
#include <Eigen/Eigenvalues>

#include "objects/points.hpp"

namespace hoid::objects {

namespace {

constexpr int kTrials = 24;  // number of planes through random points that are compared; not tuned
// A depth at a depth z [m] belongs to a plane if its distance from it is less than
// kPlaneM * max(1, kPlaneGrowth * z^2), because the noise of depth grows with z^2. Not tuned.
constexpr float kPlaneM = 0.015F, kPlaneGrowth = 0.28F;
// Norm of the cross product (two thirds of the triangle's area) below which three points count as
// on a line, numerically. Every point would be on the plane through them.
constexpr double kMinCrossM2 = 1e-9;

double tolerance_m(float depth_m)
{
  return kPlaneM * std::max(1.0F, kPlaneGrowth * (depth_m * depth_m));
}

// The measurements, contiguous for vector instructions.
struct Readings
{
  std::vector<double> x, y, z, tolerance;

  Readings(const DepthPoints& image, const std::vector<int64_t>& pixels)
  {
    for (const int64_t pixel : pixels) {
      const double* p = point(image.points_m, pixel);
      x.push_back(p[0]);
      y.push_back(p[1]);
      z.push_back(p[2]);
      tolerance.push_back(tolerance_m(image.depth_m.data[pixel]));
    }
  }

  int size() const { return static_cast<int>(x.size()); }
  Eigen::Vector3d at(int n) const { return {x[n], y[n], z[n]}; }
  bool is_near(int n, const Eigen::Vector3d& normal, double offset) const
  {
    const double distance = normal[0] * x[n] + normal[1] * y[n] + normal[2] * z[n] - offset;
    return std::abs(distance) < tolerance[n];
  }
};

}  // namespace

bool is_on(const Plane& plane, const DepthPoints& image, int64_t pixel)
{
  const double *n = plane.normal, *p = point(image.points_m, pixel);
  const double distance_m = n[0] * p[0] + n[1] * p[1] + n[2] * p[2] - plane.offset_m;
  return std::abs(distance_m) < tolerance_m(image.depth_m.data[pixel]);
}

std::optional<Plane> best_plane(
  const DepthPoints& image, const std::vector<int64_t>& pixels, std::mt19937& random)
{
  const Readings readings(image, pixels);
  const auto pick = [&] {
    return readings.at(static_cast<int>(static_cast<uint64_t>(random()) * pixels.size() >> 32));
  };
  Eigen::Vector3d best;
  double best_offset = 0;
  int most = 0;
  for (int trial = 0; trial < kTrials; ++trial) {
    const Eigen::Vector3d a = pick(), b = pick(), c = pick();
    Eigen::Vector3d normal = (b - a).cross(c - a);
    const double cross_m2 = normal.norm();
    if (cross_m2 < kMinCrossM2) {
      continue;
    }
    normal /= cross_m2;
    const double offset = normal.dot(a);
    int count = 0;
    for (int n = 0; n < readings.size(); ++n) {
      count += readings.is_near(n, normal, offset) ? 1 : 0;
    }
    if (count > most) {
      most = count;
      best = normal;
      best_offset = offset;
    }
  }
  if (most == 0) {
    return std::nullopt;
  }
  std::vector<int> chosen;
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (int n = 0; n < readings.size(); ++n) {
    if (readings.is_near(n, best, best_offset)) {
      chosen.push_back(n);
      sum += readings.at(n);
    }
  }
  const Eigen::Vector3d center = sum / static_cast<double>(chosen.size());
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (const int n : chosen) {
    const Eigen::Vector3d offset = readings.at(n) - center;
    scatter += offset * offset.transpose();
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(scatter);
  const Eigen::Vector3d normal = solver.eigenvectors().col(0);
  return Plane{{normal[0], normal[1], normal[2]}, normal.dot(center)};
}

}  // namespace hoid::objects
