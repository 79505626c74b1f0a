#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <vector>

#include "common/multiversion.hpp"
#include "objects/objects.hpp"
#include "objects/points.hpp"
#include "objects/rows.hpp"

namespace hoid::objects {

namespace {

// Return the key of a point's voxel, -1 outside the grid.
ALWAYS_INLINE int64_t key_of(double x, double y, double z, const VoxelGrid& grid)
{
  const auto cells = static_cast<double>(1 << grid.bits), half = cells / 2;
  const double a = std::floor(x / grid.voxel_m) + half, b = std::floor(y / grid.voxel_m) + half,
               c = std::floor(z / grid.voxel_m) + half;
  const bool is_inside = a >= 0 && a < cells && b >= 0 && b < cells && c >= 0 && c < cells;
  if (!is_inside) {
    return -1;
  }
  return static_cast<int64_t>(a) << (2 * grid.bits) | static_cast<int64_t>(b) << grid.bits |
         static_cast<int64_t>(c);
}

ALWAYS_INLINE int64_t key_of(const double* p, const VoxelGrid& grid)
{
  return key_of(p[0], p[1], p[2], grid);
}

// Return the rows in the order of their keys.
std::vector<int> by_key(const std::vector<int64_t>& keys)
{
  std::vector<int> order(keys.size());
  std::iota(order.begin(), order.end(), 0);
  std::sort(order.begin(), order.end(), [&](int a, int b) { return keys[a] < keys[b]; });
  return order;
}

// Add the evidence of a voxel to the last one; its mean is that of all its readings.
void add_to_last(Voxels& out, const VoxelView& from, int n)
{
  const double* mean = point(from.means_m, n);
  double* sum = out.means_m.data() + out.means_m.size() - 3;
  for (int axis = 0; axis < 3; ++axis) {
    sum[axis] += mean[axis] * static_cast<double>(from.readings[n]);
  }
  out.readings.back() += from.readings[n];
  out.hits.back() += from.hits[n];
  out.misses.back() += from.misses[n];
}

void add_voxel(Voxels& out, int64_t key)
{
  out.keys.push_back(key);
  out.means_m.insert(out.means_m.end(), 3, 0.0);
  out.readings.push_back(0);
  out.hits.push_back(0);
  out.misses.push_back(0);
}

void reserve(Voxels& out, int count)
{
  out.keys.reserve(count);
  out.means_m.reserve(3 * static_cast<std::size_t>(count));
  out.readings.reserve(count);
  out.hits.reserve(count);
  out.misses.reserve(count);
}

// Limit the evidence of each voxel, and the number of voxels to those with most hits.
Voxels limited(Voxels&& all, const VoxelLimits& limits)
{
  const auto count = static_cast<int>(all.keys.size());
  for (int n = 0; n < count; ++n) {
    const float seen = all.hits[n] + all.misses[n];
    const float scale = std::min(1.0F, limits.max_count / std::max(seen, 1.0F));
    all.hits[n] *= scale;
    all.misses[n] *= scale;
  }
  if (count <= limits.max_voxels) {
    return std::move(all);
  }
  std::vector<int> kept(count);
  std::iota(kept.begin(), kept.end(), 0);
  const auto end = kept.begin() + limits.max_voxels;
  std::nth_element(kept.begin(), end, kept.end(), [&](int a, int b) {
    return all.hits[a] != all.hits[b] ? all.hits[a] > all.hits[b] : a > b;
  });
  std::sort(kept.begin(), end);
  Voxels out;
  reserve(out, limits.max_voxels);
  for (auto n = kept.begin(); n != end; ++n) {
    const double* mean = point(all.means_m.data(), *n);
    out.keys.push_back(all.keys[*n]);
    out.means_m.insert(out.means_m.end(), mean, mean + 3);
    out.readings.push_back(all.readings[*n]);
    out.hits.push_back(all.hits[*n]);
    out.misses.push_back(all.misses[*n]);
  }
  return out;
}

bool is_cell(const SurfaceCells& cells, const double* point_map_m)
{
  double local[3];
  transform(cells.T_object_map, point_map_m, local);
  return std::binary_search(cells.keys, cells.keys + cells.count, key_of(local, cells.grid));
}

}  // namespace

void voxel_keys(const double* points_m, int count, const VoxelGrid& grid, int64_t* key_out)
{
  for (int n = 0; n < count; ++n) {
    key_out[n] = key_of(point(points_m, n), grid);
  }
}

Voxels voxels_of(const double* points_m, int count, const VoxelGrid& grid)
{
  Rows rows(count);
  std::vector<double> sums;
  std::vector<float> num;
  for (int n = 0; n < count; ++n) {
    const double* p = point(points_m, n);
    const int64_t key = key_of(p, grid);
    if (key < 0) {
      continue;
    }
    const int row = rows.row_of(key);
    if (row == static_cast<int>(num.size())) {
      sums.insert(sums.end(), 3, 0.0);
      num.push_back(0);
    }
    for (int axis = 0; axis < 3; ++axis) {
      sums[3 * static_cast<std::size_t>(row) + axis] += p[axis];
    }
    num[row] += 1;
  }
  Voxels out;
  reserve(out, rows.size());
  for (const int row : by_key(rows.keys())) {
    out.keys.push_back(rows.keys()[row]);
    for (int axis = 0; axis < 3; ++axis) {
      const double sum = sums[3 * static_cast<std::size_t>(row) + axis];
      out.means_m.push_back(sum / static_cast<double>(num[row]));
    }
    out.readings.push_back(num[row]);
  }
  out.hits.assign(out.keys.size(), 1);
  out.misses.assign(out.keys.size(), 0);
  return out;
}

Voxels merged_voxels(const VoxelView& first, const VoxelView& second, const VoxelLimits& limits)
{
  Voxels out;
  reserve(out, first.count + second.count);
  for (int a = 0, b = 0; a < first.count || b < second.count;) {
    const bool takes_first =
      a < first.count && (b == second.count || first.keys[a] <= second.keys[b]);
    const bool takes_second =
      b < second.count && (a == first.count || second.keys[b] <= first.keys[a]);
    add_voxel(out, takes_first ? first.keys[a] : second.keys[b]);
    if (takes_first) {
      add_to_last(out, first, a++);
    }
    if (takes_second) {
      add_to_last(out, second, b++);
    }
    double* mean = out.means_m.data() + out.means_m.size() - 3;
    for (int axis = 0; axis < 3; ++axis) {
      mean[axis] /= static_cast<double>(out.readings.back());
    }
  }
  return limited(std::move(out), limits);
}

void solid_voxels(
  const VoxelView& voxels, double least_hits, double least_share, const VoxelGrid* cells,
  uint8_t* solid_out)
{
  std::vector<double> hits(voxels.hits, voxels.hits + voxels.count), seen(voxels.count);
  for (int n = 0; n < voxels.count; ++n) {
    seen[n] = hits[n] + static_cast<double>(voxels.misses[n]);
  }
  std::vector<int> cell(voxels.count);
  std::iota(cell.begin(), cell.end(), 0);
  if (cells != nullptr) {
    Rows rows(voxels.count);
    std::vector<double> cell_hits(voxels.count, 0.0), cell_seen(voxels.count, 0.0);
    for (int n = 0; n < voxels.count; ++n) {
      cell[n] = rows.row_of(key_of(point(voxels.means_m, n), *cells));
      cell_hits[cell[n]] += hits[n];
      cell_seen[cell[n]] += seen[n];
    }
    hits = std::move(cell_hits);
    seen = std::move(cell_seen);
  }
  for (int n = 0; n < voxels.count; ++n) {
    const double num = hits[cell[n]];
    solid_out[n] = num >= least_hits && num >= least_share * seen[cell[n]];
  }
}

void trimmed_box(
  const double* points_m, int count, const uint8_t* chosen, double outer, double* low_out,
  double* high_out)
{
  std::vector<double> values;
  values.reserve(count);
  for (int axis = 0; axis < 3; ++axis) {
    values.clear();
    for (int n = 0; n < count; ++n) {
      if (chosen == nullptr || chosen[n]) {
        values.push_back(point(points_m, n)[axis]);
      }
    }
    const auto last = static_cast<double>(values.size()) - 1;
    const auto low = values.begin() + std::lrint(outer * last);
    const auto high = values.begin() + std::lrint((1 - outer) * last);
    std::nth_element(values.begin(), low, values.end());
    low_out[axis] = *low;
    std::nth_element(low, high, values.end());
    high_out[axis] = *high;
  }
}

std::vector<int64_t> cells_of(
  const double* points_m, int count, const uint8_t* chosen, const VoxelGrid& grid)
{
  Rows rows(count);
  for (int n = 0; n < count; ++n) {
    if (chosen[n]) {
      rows.row_of(key_of(point(points_m, n), grid));
    }
  }
  std::vector<int64_t> keys = rows.keys();
  std::sort(keys.begin(), keys.end());
  return keys;
}

std::vector<int64_t> pixels_on_surface(
  const DepthPoints& image, const int* box_px, const SurfaceCells& cells)
{
  std::vector<int64_t> out;
  for (int v = box_px[1]; v < box_px[3]; ++v) {
    const auto first = static_cast<int64_t>(v) * image.depth_m.width;
    for (int64_t pixel = first + box_px[0]; pixel < first + box_px[2]; ++pixel) {
      if (image.depth_m.data[pixel] != 0 && is_cell(cells, point(image.points_m, pixel))) {
        out.push_back(pixel);
      }
    }
  }
  return out;
}

double share_on_surface(const double* points_m, int count, const SurfaceCells& cells)
{
  int inside = 0;
  for (int n = 0; n < count; ++n) {
    inside += is_cell(cells, point(points_m, n)) ? 1 : 0;
  }
  return static_cast<double>(inside) / std::max(count, 1);
}

double share_in_box(
  const double* points_m, int count, Transform T_box_map, const double* low_m,
  const double* high_m)
{
  int inside = 0;
  for (int n = 0; n < count; ++n) {
    inside += is_in_box(T_box_map, low_m, high_m, point(points_m, n)) ? 1 : 0;
  }
  return static_cast<double>(inside) / std::max(count, 1);
}

}  // namespace hoid::objects
