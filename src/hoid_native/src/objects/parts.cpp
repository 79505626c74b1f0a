// Separates the object in a bounding box from the background, by depth and by planes.

#include "objects/parts.hpp"

#include <cmath>
#include <Eigen/Core>
#include <Eigen/Eigenvalues>

#include "common/median.hpp"

namespace hoid::objects {

namespace {

// Numbers without a source were not tuned.

// The depths in a box are counted in a histogram with bins of 5 cm. A layer is a range of at least
// 4 bins. The object begins at the nearest layer with at least 0.6 times as many pixels as the
// layer with the most (as in `object_sighting`).
constexpr double kBinM = 0.05;
constexpr int kLayerBins = 4;
constexpr double kNearerShare = 0.6;
constexpr double kLayerShare = 0.3;  // thickness of the layer of a large object: share of its size
// An object ends at a gap in depth of this length: a ratio of the size of its box, or this many
// meters if that is less.
constexpr double kGapShare = 0.3, kGapM = 0.25;
constexpr double kEmptyShare = 0.02;  // a bin with a smaller ratio of the box's pixels is empty
// Largest extent of an object along the viewing direction: a ratio of the size of its box, or this
// many meters if that is more.
constexpr double kMaxDepthShare = 0.9, kMinDepthM = 0.2;

// Return the index of the bin of depth where the object begins: the first one with pixels in the
// nearest layer with at least `kNearerShare` times as many pixels as the layer with the most.
int first_bin(const std::vector<int>& count, int thick)
{
  const auto num = static_cast<int>(count.size());
  std::vector<int> layers(num, 0);
  for (int bin = num - 1, sum = 0; bin >= 0; --bin) {
    sum += count[bin] - (bin + thick < num ? count[bin + thick] : 0);
    layers[bin] = sum;
  }
  const int fullest = *std::max_element(layers.begin(), layers.end());
  int first = 0;
  while (layers[first] < kNearerShare * fullest) {
    ++first;
  }
  while (count[first] == 0) {
    ++first;
  }
  return first;
}

constexpr int kTrials = 24;  // number of planes through random points that are compared; not tuned
// A pixel with depth z [m] belongs to a plane if its distance from the plane is less than kPlaneM
// * max(1, kPlaneGrowth * z^2), because the noise of depth grows with z^2. Not tuned.
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

  Readings(const DepthPoints& image, const Pixels& pixels)
  {
    for (const int64_t pixel : pixels) {
      const double* p = image.points_m[pixel];
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

Pixels nearest_part(const DepthPoints& image, const Pixels& pixels, int side_px)
{
  if (pixels.empty()) {
    return pixels;
  }
  std::vector<int> bins;
  std::vector<float> depths;
  for (const int64_t pixel : pixels) {
    const float depth_m = image.depth_m.data[pixel];
    depths.push_back(depth_m);
    bins.push_back(static_cast<int>(depth_m / static_cast<float>(kBinM)));
  }
  const double size_m = image.pixel_m * side_px * static_cast<double>(median(depths));
  const auto in_bins = [](double length_m) {
    return static_cast<int>(std::nearbyint(length_m / kBinM));
  };
  const int num_bins = std::max(*std::max_element(bins.begin(), bins.end()) + 1, kLayerBins);
  const int thick = std::max(kLayerBins, in_bins(kLayerShare * size_m));
  const int gap = std::max(2, in_bins(std::min(kGapShare * size_m, kGapM)));
  const int most = in_bins(std::max(kMaxDepthShare * size_m, kMinDepthM));
  std::vector<int> count(num_bins, 0);
  for (const int bin : bins) {
    ++count[bin];
  }
  const int first = first_bin(count, thick);
  const double least = std::max(1.0, kEmptyShare * static_cast<double>(pixels.size()));
  // Behind the first layer, the object ends where `gap` successive bins are empty.
  int end = first, num_empty = 0;
  for (int bin = first; bin < num_bins && num_empty < gap; ++bin) {
    const bool is_filled = bin < first + thick || count[bin] > least;
    num_empty = is_filled ? 0 : num_empty + 1;
    end = is_filled ? bin + 1 : end;
  }
  end = std::min(end, first + most);
  Pixels out;
  for (std::size_t n = 0; n < pixels.size(); ++n) {
    // One bin before the layer belongs to the object: depth noise spreads its surface into it.
    if (bins[n] >= first - 1 && bins[n] < end) {
      out.push_back(pixels[n]);
    }
  }
  return out;
}

bool is_on(const Plane& plane, const DepthPoints& image, int64_t pixel, double scale)
{
  const double *n = plane.normal, *p = image.points_m[pixel];
  const double distance_m = n[0] * p[0] + n[1] * p[1] + n[2] * p[2] - plane.offset_m;
  return std::abs(distance_m) < scale * tolerance_m(image.depth_m.data[pixel]);
}

std::optional<Plane> best_plane(
  const DepthPoints& image, const Pixels& pixels, std::mt19937& random)
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
