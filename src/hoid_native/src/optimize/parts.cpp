// The part of a view that drags the pose. Parts are the cells of a k-d tree over direction and
// depth (Bentley, CACM 1975), as what moves is in one place.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <Eigen/Cholesky>
#include <limits>
#include <numeric>
#include <vector>

#include "optimize/optimize.hpp"
#include "optimize/stereo.hpp"

namespace hoid::optimize {

namespace {

constexpr int kCells = 16;     // of the tree: parts are a sixteenth of the matches,
constexpr int kMostCells = 4;  // and at most a quarter
constexpr int kAxes = 3;
constexpr double kDamping = 1e-6;  // of a motion that the rest tells nothing of

using Place = std::array<double, kAxes>;                    // x / z, y / z, log z
using Equations = Eigen::Matrix<double, kPose, kPose + 1>;  // coefficients, right-hand side
using Equation = Eigen::Matrix<double, kPose + 1, 1>;

// Return the axis along which some places vary most.
int widest_axis(const std::vector<Place>& places, const int* first, const int* last)
{
  Place mean{}, square{};
  const auto count = static_cast<double>(last - first);
  for (const int* n = first; n != last; ++n) {
    for (int a = 0; a < kAxes; ++a) {
      mean[a] += places[*n][a] / count;
    }
  }
  for (const int* n = first; n != last; ++n) {
    for (int a = 0; a < kAxes; ++a) {
      const double off = places[*n][a] - mean[a];
      square[a] += off * off;
    }
  }
  return static_cast<int>(std::max_element(square.begin(), square.end()) - square.begin());
}

// Return places in order of the cells, all as large: halved again and again where they vary most.
std::vector<int> in_cells(const std::vector<Place>& places)
{
  std::vector<int> order(places.size());
  std::iota(order.begin(), order.end(), 0);
  const auto size = static_cast<std::ptrdiff_t>(order.size());
  for (std::ptrdiff_t length = size; length > size / kCells; length /= 2) {
    for (int* first = order.data(); first != order.data() + size; first += length) {
      const int axis = widest_axis(places, first, first + length);
      std::nth_element(first, first + length / 2, first + length, [&](int one, int other) {
        const double a = places[one][axis], b = places[other][axis];
        return a < b || (a == b && one < other);
      });
    }
  }
  return order;
}

// Add the equations of one match for a left twist, without those of its parts that are outliers.
void add_equations(
  const StereoParams& camera, const Gates& gates, const Observation& seen, const double* x,
  double noise_scale, Equations& sums)
{
  double e[kRows], J_point[kRows][kPoint], J[kRows][kPose];
  residual<false>(camera, x, seen, e);
  point_jacobian<false>(camera, x, J_point);
  pose_jacobian(x, J_point, J);
  const double pixel = seen.weight / (camera.pixel_noise * camera.pixel_noise * noise_scale);
  const double part = camera.relative_noise * seen.disparity();
  const double depth =
    1 / ((camera.disparity_noise_px * camera.disparity_noise_px + part * part) * noise_scale);
  const bool fits = pixel * (e[0] * e[0] + e[1] * e[1]) <= gates.mono;
  const bool depth_fits = depth * e[2] * e[2] <= kGateDisparity;  // not without a reading
  const double weights[kRows] = {fits ? pixel : 0, fits ? pixel : 0, depth_fits ? depth : 0};
  for (int r = 0; r < kRows; ++r) {
    Equation row;
    row << Eigen::Map<const Vector6>(J[r]), e[r];
    sums.noalias() += (weights[r] * row.head<kPose>()) * row.transpose();
  }
}

// By how much the cost of what has these equations falls when the pose follows them.
double gain_of(const Equations& rest)
{
  const Matrix6 H = rest.leftCols<kPose>() + kDamping * Matrix6::Identity();
  const Vector6 g = rest.rightCols<1>();
  return g.dot(H.ldlt().solve(g));
}

// Return the sums of the cells' equations; what comes again counts once.
std::vector<Equations> sum_cells(
  const StereoParams& camera, const Gates& gates, const PoseProblem& problem,
  const std::vector<std::array<double, 3>>& camera_m, const std::vector<int>& order,
  double noise_scale)
{
  std::vector<Equations> cells(kCells, Equations::Zero());
  const std::size_t in_cell = order.size() / kCells;
  for (std::size_t n = 0; n < order.size(); ++n) {
    const int k = order[n];
    if (k < problem.count) {
      const Observation seen{
        problem.measured_px + 3 * static_cast<std::ptrdiff_t>(k), problem.inv_sigma2[k]};
      add_equations(camera, gates, seen, camera_m[k].data(), noise_scale, cells[n / in_cell]);
    }
  }
  return cells;
}

// Some cells in a row.
struct Branch
{
  int first, count;
  double gain;  // by how much the cost of the rest would fall, to first order
};

// Return that which gains most by leaving; `nodes` are cells, siblings side by side.
Branch heaviest_branch(std::vector<Equations> nodes)
{
  const Equations all = std::accumulate(nodes.begin(), nodes.end(), Equations(Equations::Zero()));
  Branch out{0, 1, 0.0};
  for (int count = 1; count <= kMostCells; count *= 2) {
    for (int n = 0; n < kCells / count; ++n) {
      const double gain = gain_of(all - nodes[n]);
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

MovingPart heaviest_part(
  const StereoParams& camera, const Gates& gates, const PoseProblem& problem,
  const PoseArray& T_camera_map, double noise_scale)
{
  std::vector<std::array<double, 3>> camera_m(problem.count);
  std::vector<Place> places;
  for (int k = 0; k < problem.count; ++k) {
    double* x = camera_m[k].data();
    to_camera(T_camera_map.data(), problem.points_m + 3 * static_cast<std::ptrdiff_t>(k), x);
    x[2] = at_least(x[2], kMinDepthM);
    places.push_back({x[0] / x[2], x[1] / x[2], std::log(x[2])});
    if (!std::isfinite(places.back()[0] + places.back()[1] + places.back()[2])) {
      return {std::vector<uint8_t>(problem.count), {}, {}, 0.0};  // it has no order
    }
  }
  for (int n = 0; places.size() % kCells != 0; ++n) {
    places.push_back(Place(places[n]));  // some come again, so that all cells are as large
  }
  const std::vector<int> order = in_cells(places);
  const Branch heaviest =
    heaviest_branch(sum_cells(camera, gates, problem, camera_m, order, noise_scale));
  MovingPart out{std::vector<uint8_t>(problem.count), {}, {}, heaviest.gain};
  out.low.fill(std::numeric_limits<double>::infinity());
  out.high.fill(-std::numeric_limits<double>::infinity());
  const int in_cell = static_cast<int>(order.size()) / kCells;
  for (int n = 0; n < heaviest.count * in_cell; ++n) {
    const int k = order[heaviest.first * in_cell + n];
    out.mask[k % problem.count] = 1;
    for (int a = 0; a < kAxes; ++a) {
      out.low[a] = std::min(out.low[a], places[k][a]);
      out.high[a] = std::max(out.high[a], places[k][a]);
    }
  }
  return out;
}

}  // namespace hoid::optimize
