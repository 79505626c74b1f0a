// The region of a view that biases the pose most (decision 036). Regions are the cells of a k-d
// tree (Bentley, CACM 1975) over direction and depth, because a moving object is in one place.

#include <algorithm>
#include <array>
#include <cmath>
#include <Eigen/Cholesky>
#include <limits>
#include <numeric>

#include "optimize/optimize.hpp"
#include "optimize/stereo.hpp"

namespace hoid::optimize {

namespace {

constexpr int kCells = 16;    // leaves of the tree: a region is at least 1/16 of the matches,
constexpr int kMaxCells = 4;  // and at most 1/4 (decision 036)
constexpr int kAxes = 3;
// Damping that makes the normal equations solvable if the other matches leave a motion
// undetermined; numerically negligible.
constexpr double kDamping = 1e-6;

using Location = std::array<double, kAxes>;                 // x / z, y / z, log z
using Equations = Eigen::Matrix<double, kPose, kPose + 1>;  // coefficients, right-hand side
using Equation = Eigen::Matrix<double, kPose + 1, 1>;

// Return the axis with the largest variance of the locations.
int widest_axis(const std::vector<Location>& locations, const int* first, const int* last)
{
  Location mean{}, square{};
  const auto count = static_cast<double>(last - first);
  for (const int* n = first; n != last; ++n) {
    for (int a = 0; a < kAxes; ++a) {
      mean[a] += locations[*n][a] / count;
    }
  }
  for (const int* n = first; n != last; ++n) {
    for (int a = 0; a < kAxes; ++a) {
      const double difference = locations[*n][a] - mean[a];
      square[a] += difference * difference;
    }
  }
  return static_cast<int>(std::max_element(square.begin(), square.end()) - square.begin());
}

// Return the indices of the locations sorted by cells of equal size: each cell is halved at the
// median of its widest axis until there are kCells.
std::vector<int> sort_into_cells(const std::vector<Location>& locations)
{
  std::vector<int> order(locations.size());
  std::iota(order.begin(), order.end(), 0);
  const auto size = static_cast<std::ptrdiff_t>(order.size());
  for (std::ptrdiff_t length = size; length > size / kCells; length /= 2) {
    for (int* first = order.data(); first != order.data() + size; first += length) {
      const int axis = widest_axis(locations, first, first + length);
      std::nth_element(first, first + length / 2, first + length, [&](int one, int other) {
        const double a = locations[one][axis], b = locations[other][axis];
        return a < b || (a == b && one < other);
      });
    }
  }
  return order;
}

// Add the normal equations of one match for a left twist. Pixel and disparity count only if they
// are inliers.
void add_equations(
  const PoseProblem& problem, int k, const double* x, double noise_scale, Equations& sums)
{
  const StereoParams& camera = problem.camera;
  const Observation seen = observation(problem, k);
  double e[kRows], J_point[kRows][kPoint], J[kRows][kPose];
  residual<false>(camera, x, seen, e);
  point_jacobian<false>(camera, x, J_point);
  pose_jacobian(x, J_point, J);
  const double pixel = seen.weight / (camera.pixel_noise * camera.pixel_noise * noise_scale);
  const double depth = 1 / (disparity_variance(camera, seen) * noise_scale);
  const bool is_pixel_inlier = pixel * (e[0] * e[0] + e[1] * e[1]) <= problem.gates.mono;
  // False without a measurement: its disparity is NaN.
  const bool is_depth_inlier = depth * e[2] * e[2] <= kGateDisparity;
  const double weights[kRows] = {
    is_pixel_inlier ? pixel : 0, is_pixel_inlier ? pixel : 0, is_depth_inlier ? depth : 0};
  for (int r = 0; r < kRows; ++r) {
    Equation row;
    row << Eigen::Map<const Vector6>(J[r]), e[r];
    sums.noalias() += (weights[r] * row.head<kPose>()) * row.transpose();
  }
}

// Return the first-order decrease of the cost of the other matches if they alone determine the
// pose.
double cost_reduction(const Equations& rest)
{
  const Matrix6 H = rest.leftCols<kPose>() + kDamping * Matrix6::Identity();
  const Vector6 g = rest.rightCols<1>();
  return g.dot(H.ldlt().solve(g));
}

// Return the normal equations of each cell. Repeated locations (the padding) count once.
std::vector<Equations> sum_cells(
  const PoseProblem& problem, const std::vector<std::array<double, 3>>& camera_m,
  const std::vector<int>& order, double noise_scale)
{
  std::vector<Equations> cells(kCells, Equations::Zero());
  const std::size_t in_cell = order.size() / kCells;
  for (std::size_t n = 0; n < order.size(); ++n) {
    const int k = order[n];
    if (k < problem.count()) {
      add_equations(problem, k, camera_m[k].data(), noise_scale, cells[n / in_cell]);
    }
  }
  return cells;
}

// Consecutive cells of the tree.
struct CellRange
{
  int first, count;
  double gain;  // first-order cost reduction of the rest without them
};

// Return the subtree whose removal reduces the cost of the rest most. `nodes` are the leaves,
// siblings side by side; each pass merges them in pairs.
CellRange most_biasing_cells(std::vector<Equations> nodes)
{
  const Equations all = std::accumulate(nodes.begin(), nodes.end(), Equations(Equations::Zero()));
  CellRange out{0, 1, 0.0};
  for (int count = 1; count <= kMaxCells; count *= 2) {
    for (int n = 0; n < kCells / count; ++n) {
      const double gain = cost_reduction(all - nodes[n]);
      if (gain > out.gain) {
        out = {n * count, count, gain};
      }
    }
    for (int n = 0; n < kCells / count / 2; ++n) {
      nodes[n] = nodes[2 * n] + nodes[2 * n + 1];
    }
  }
  return out;
}

}  // namespace

BiasingRegion most_biasing_region(
  const PoseProblem& problem, const double* T_camera_map, double noise_scale)
{
  std::vector<std::array<double, 3>> camera_m(problem.count());
  std::vector<Location> locations;
  for (int k = 0; k < problem.count(); ++k) {
    double* x = camera_m[k].data();
    transform(T_camera_map, problem.points_m[k], x);
    x[2] = at_least(x[2], kMinDepthM);
    locations.push_back({x[0] / x[2], x[1] / x[2], std::log(x[2])});
    if (!std::isfinite(locations.back()[0] + locations.back()[1] + locations.back()[2])) {
      return {std::vector<uint8_t>(problem.count()), {}, {}, 0.0};  // NaN cannot be sorted
    }
  }
  for (int n = 0; locations.size() % kCells != 0; ++n) {
    locations.push_back(Location(locations[n]));  // padding: all cells have equal size
  }
  const std::vector<int> order = sort_into_cells(locations);
  const CellRange worst =
    most_biasing_cells(sum_cells(problem, camera_m, order, noise_scale));
  BiasingRegion out{std::vector<uint8_t>(problem.count()), {}, {}, worst.gain};
  out.low.fill(std::numeric_limits<double>::infinity());
  out.high.fill(-std::numeric_limits<double>::infinity());
  const int in_cell = static_cast<int>(order.size()) / kCells;
  for (int n = 0; n < worst.count * in_cell; ++n) {
    const int k = order[worst.first * in_cell + n];
    out.mask[k % problem.count()] = 1;
    for (int a = 0; a < kAxes; ++a) {
      out.low[a] = std::min(out.low[a], locations[k][a]);
      out.high[a] = std::max(out.high[a], locations[k][a]);
    }
  }
  return out;
}

}  // namespace hoid::optimize
