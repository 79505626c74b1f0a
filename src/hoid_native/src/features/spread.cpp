// Selects a budget of corners that are spread evenly over the image.

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <utility>
#include <vector>

#include "features/features.hpp"

namespace hoid::features {

namespace {

using Indices = std::vector<int32_t>;

// Counting sort of indices by a small, nonnegative key; equal keys keep their order.
template <typename Key>
void sort_by(Key key, Indices& indices)
{
  std::vector<int32_t> next(1, 0);
  for (const int32_t k : indices) {
    const auto after = static_cast<std::size_t>(key(k)) + 1;
    next.resize(std::max(next.size(), after + 1), 0);
    ++next[after];
  }
  std::partial_sum(next.begin(), next.end(), next.begin());
  Indices sorted(indices.size());
  for (const int32_t k : indices) {
    sorted[next[key(k)]++] = k;
  }
  indices = std::move(sorted);
}

// Sort an octave's corners: the strongest of each cell first, then the second of each cell, and so
// on; by descending score among those of equal rank.
void sort_by_rank(const ScoredCorners& corners, float cells_per_px, Indices& queue)
{
  const auto cell = [&](int32_t k, int axis) {
    const double at_px = corners.uv_px[2 * static_cast<std::ptrdiff_t>(k) + axis];
    return static_cast<std::size_t>(at_px * cells_per_px);
  };
  std::size_t columns = 0, rows = 0;
  for (const int32_t k : queue) {
    columns = std::max(columns, cell(k, 0) + 1);
    rows = std::max(rows, cell(k, 1) + 1);
  }
  sort_by([&](int32_t k) { return 255 - corners.score[k]; }, queue);
  std::vector<int32_t> stronger(columns * rows, 0), rank(corners.count);
  for (const int32_t k : queue) {
    rank[k] = stronger[cell(k, 1) * columns + cell(k, 0)]++;
  }
  sort_by([&](int32_t k) { return rank[k]; }, queue);
}

}  // namespace

std::vector<int64_t> spread_evenly(
  const ScoredCorners& corners, const int64_t* budgets, int num_octaves, double area_px)
{
  std::vector<Indices> queues(num_octaves);
  for (int k = 0; k < corners.count; ++k) {
    queues[corners.octave[k]].push_back(k);
  }
  Indices all;
  std::vector<int32_t> surplus(corners.count);
  int64_t total = 0;
  for (int octave = 0; octave < num_octaves; ++octave) {
    Indices& queue = queues[octave];
    const auto cells = static_cast<double>(std::max<int64_t>(budgets[octave], 1));
    sort_by_rank(corners, std::min(static_cast<float>(std::sqrt(cells / area_px)), 1.0F), queue);
    int64_t left = budgets[octave];
    for (const int32_t k : queue) {
      surplus[k] = static_cast<int32_t>(std::max<int64_t>(-(--left), 0));
    }
    all.insert(all.end(), queue.begin(), queue.end());
    total += budgets[octave];
  }
  sort_by([&](int32_t k) { return surplus[k]; }, all);
  all.resize(std::min<std::size_t>(all.size(), total));
  sort_by([](int32_t k) { return k; }, all);
  return {all.begin(), all.end()};
}

}  // namespace hoid::features
