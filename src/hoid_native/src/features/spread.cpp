// Selects a budget of corners that are spread evenly over the image.

#include <algorithm>
#include <cmath>

#include "common/buckets.hpp"
#include "features/features.hpp"

namespace hoid::features {

namespace {

using Indices = std::vector<int32_t>;

// Sort indices by a small, nonnegative key; equal keys keep their order.
template <typename Key>
void sort_by(Key key, Indices& indices)
{
  int32_t last = 0;
  for (const int32_t k : indices) {
    last = std::max<int32_t>(last, key(k));
  }
  indices = sort_into_buckets(indices, static_cast<std::size_t>(last) + 1, key).order;
}

// Sort an octave's corners: the strongest of each cell first, then the second of each cell, and so
// on; by descending score among those of equal rank.
void sort_by_rank(const ScoredCorners& corners, float cells_per_px, Indices& queue)
{
  const auto cell = [&](int32_t k, int axis) {
    return static_cast<std::size_t>(corners.uv_px[k][axis] * cells_per_px);
  };
  std::size_t columns = 0, rows = 0;
  for (const int32_t k : queue) {
    columns = std::max(columns, cell(k, 0) + 1);
    rows = std::max(rows, cell(k, 1) + 1);
  }
  sort_by([&](int32_t k) { return 255 - corners.score[k]; }, queue);
  std::vector<int32_t> stronger(columns * rows, 0), rank(corners.uv_px.count);
  for (const int32_t k : queue) {
    rank[k] = stronger[cell(k, 1) * columns + cell(k, 0)]++;
  }
  sort_by([&](int32_t k) { return rank[k]; }, queue);
}

}  // namespace

std::vector<int64_t> spread_evenly(
  const ScoredCorners& corners, const Rows<int64_t>& budgets, double area_px)
{
  const int count = corners.uv_px.count;
  std::vector<Indices> queues(budgets.count);
  for (int k = 0; k < count; ++k) {
    queues[corners.octave[k]].push_back(k);
  }
  Indices all;
  std::vector<int32_t> surplus(count);
  int64_t total = 0;
  for (int octave = 0; octave < budgets.count; ++octave) {
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
