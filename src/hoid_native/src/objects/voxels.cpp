#include <algorithm>
#include <cmath>
#include <limits>

#include "common/multiversion.hpp"
#include "objects/objects.hpp"
#include "objects/parts.hpp"

namespace hoid::objects {

namespace {

// Return the key of a point's voxel, -1 outside the grid.
int64_t key_of(const double* p, const VoxelGrid& grid)
{
  const auto cells = static_cast<double>(1 << grid.bits), half = cells / 2;
  int64_t key = 0;
  for (int axis = 0; axis < 3; ++axis) {
    const double cell = std::floor(p[axis] / grid.voxel_m) + half;
    if (!(cell >= 0 && cell < cells)) {
      return -1;
    }
    key = key << grid.bits | static_cast<int64_t>(cell);
  }
  return key;
}

// Numbers distinct keys in the order in which they come: a hash table with open addressing. Keys may
// be any number but the smallest one.
class KeyNumbers
{
public:
  explicit KeyNumbers(int max_keys)
  {
    std::size_t size = 16;
    while (size < 2 * static_cast<std::size_t>(max_keys)) {
      size *= 2;
    }
    slots_.assign(size, {kEmpty, 0});
  }

  // Return the number of a key; a new key gets the next number.
  int number_of(int64_t key)
  {
    constexpr uint64_t kGolden = 0x9E3779B97F4A7C15U;  // Fibonacci hashing (Knuth)
    const std::size_t mask = slots_.size() - 1;
    std::size_t at = (static_cast<uint64_t>(key) * kGolden >> 32) & mask;
    while (slots_[at].key != key && slots_[at].key != kEmpty) {
      at = (at + 1) & mask;
    }
    if (slots_[at].key == kEmpty) {
      slots_[at] = {key, num_keys_++};
    }
    return slots_[at].number;
  }

private:
  static constexpr int64_t kEmpty = std::numeric_limits<int64_t>::min();
  struct Slot
  {
    int64_t key;
    int number;
  };
  std::vector<Slot> slots_;
  int num_keys_ = 0;
};

struct Voxel
{
  int64_t key = 0;
  double mean_m[3] = {0, 0, 0};  // the sum of its readings, until `finish`
  float readings = 0, hits = 0, misses = 0;

  void add(const VoxelView& from, int n)
  {
    for (int axis = 0; axis < 3; ++axis) {
      mean_m[axis] += from.means_m[n][axis] * static_cast<double>(from.readings[n]);
    }
    readings += from.readings[n];
    hits += from.hits[n];
    misses += from.misses[n];
  }

  void finish()
  {
    for (double& axis : mean_m) {
      axis /= static_cast<double>(readings);
    }
  }
};

void sort_by_key(std::vector<Voxel>& voxels)
{
  std::sort(voxels.begin(), voxels.end(), [](const Voxel& a, const Voxel& b) {
    return a.key < b.key;
  });
}

Voxels as_columns(const std::vector<Voxel>& voxels)
{
  Voxels out;
  out.means_m.reserve(3 * voxels.size());
  for (const Voxel& voxel : voxels) {
    out.keys.push_back(voxel.key);
    out.means_m.insert(out.means_m.end(), voxel.mean_m, voxel.mean_m + 3);
    out.readings.push_back(voxel.readings);
    out.hits.push_back(voxel.hits);
    out.misses.push_back(voxel.misses);
  }
  return out;
}

bool is_cell(const SurfaceCells& cells, const double* point_map_m)
{
  double local[3];
  transform(cells.T_object_map, point_map_m, local);
  return std::binary_search(cells.keys.begin(), cells.keys.end(), key_of(local, cells.grid));
}

}  // namespace

void voxel_keys(const Points& points_m, const VoxelGrid& grid, int64_t* key_out)
{
  for (int n = 0; n < points_m.count; ++n) {
    key_out[n] = key_of(points_m[n], grid);
  }
}

Voxels voxels_of(const Points& points_m, const VoxelGrid& grid)
{
  KeyNumbers numbers(points_m.count);
  std::vector<Voxel> voxels;
  for (int n = 0; n < points_m.count; ++n) {
    const int64_t key = key_of(points_m[n], grid);
    if (key < 0) {
      continue;
    }
    const auto number = static_cast<std::size_t>(numbers.number_of(key));
    if (number == voxels.size()) {
      voxels.push_back({key});
      voxels.back().hits = 1;
    }
    for (int axis = 0; axis < 3; ++axis) {
      voxels[number].mean_m[axis] += points_m[n][axis];
    }
    voxels[number].readings += 1;
  }
  for (Voxel& voxel : voxels) {
    voxel.finish();
  }
  sort_by_key(voxels);
  return as_columns(voxels);
}

Voxels merged_voxels(
  const VoxelView& first, const VoxelView& second, float max_count, int max_voxels)
{
  std::vector<Voxel> all;
  all.reserve(first.keys.count + second.keys.count);
  for (int a = 0, b = 0; a < first.keys.count || b < second.keys.count;) {
    const bool takes_first = a < first.keys.count && (b == second.keys.count ||
                                                      first.keys[a] <= second.keys[b]);
    const bool takes_second = b < second.keys.count && (a == first.keys.count ||
                                                        second.keys[b] <= first.keys[a]);
    Voxel voxel{takes_first ? first.keys[a] : second.keys[b]};
    if (takes_first) {
      voxel.add(first, a++);
    }
    if (takes_second) {
      voxel.add(second, b++);
    }
    voxel.finish();
    const float scale = std::min(1.0F, max_count / std::max(voxel.hits + voxel.misses, 1.0F));
    voxel.hits *= scale;
    voxel.misses *= scale;
    all.push_back(voxel);
  }
  if (all.size() > static_cast<std::size_t>(max_voxels)) {
    std::nth_element(
      all.begin(), all.begin() + max_voxels, all.end(), [](const Voxel& a, const Voxel& b) {
        return a.hits != b.hits ? a.hits > b.hits : a.key > b.key;
      });
    all.resize(max_voxels);
    sort_by_key(all);
  }
  return as_columns(all);
}

void solid_voxels(
  const VoxelView& voxels, double least_hits, double least_share, const VoxelGrid* cells,
  uint8_t* solid_out)
{
  const int count = voxels.keys.count;
  KeyNumbers numbers(count);
  std::vector<int> cell(count);
  std::vector<double> hits(count), seen(count);  // of each cell
  for (int n = 0; n < count; ++n) {
    cell[n] = cells != nullptr ? numbers.number_of(key_of(voxels.means_m[n], *cells)) : n;
    const double num = voxels.hits[n];
    hits[cell[n]] += num;
    seen[cell[n]] += num + static_cast<double>(voxels.misses[n]);
  }
  for (int n = 0; n < count; ++n) {
    const double num = hits[cell[n]];
    solid_out[n] = num >= least_hits && num >= least_share * seen[cell[n]];
  }
}

std::vector<int64_t> pixels_on_surface(
  const DepthPoints& image, const int32_t* box_px, const SurfaceCells& cells)
{
  std::vector<int64_t> out;
  pixel_box(box_px).each_pixel(image.depth_m.width, [&](int64_t pixel) {
    if (image.depth_m.data[pixel] != 0 && is_cell(cells, image.points_m[pixel])) {
      out.push_back(pixel);
    }
  });
  return out;
}

double share_on_surface(const Points& points_m, const SurfaceCells& cells)
{
  return share_of(points_m, [&](const double* p) { return is_cell(cells, p); });
}

}  // namespace hoid::objects
