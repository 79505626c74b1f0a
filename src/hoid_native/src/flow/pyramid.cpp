#include <algorithm>
#include <utility>

#include "common/multiversion.hpp"
#include "flow/flow.hpp"

namespace hoid::flow {

namespace {

// The pixel within 0 to size - 1 that a mirror on each edge shows at an index.
int mirrored(int index, int size)
{
  while (size > 1 && (index < 0 || index >= size)) {
    index = index < 0 ? -index : 2 * size - 2 - index;
  }
  return size > 1 ? index : 0;
}

// Fill in what lies beyond the edges.
void mirror(Level& level)
{
  int left[kWindow], right[kWindow];
  for (int k = 0; k < kWindow; ++k) {
    left[k] = mirrored(-1 - k, level.width);
    right[k] = mirrored(level.width + k, level.width);
  }
  for (int v = 0; v < level.height; ++v) {
    uint8_t* row = level.pixels.get() + level.index(0, v);
    for (int k = 0; k < kWindow; ++k) {
      row[-1 - k] = row[left[k]];
      row[level.width + k] = row[right[k]];
    }
  }
  const auto copy_row = [&](int to) {
    uint8_t* first = level.pixels.get() + level.index(-kWindow, 0);
    const std::ptrdiff_t step = level.step();
    std::copy_n(first + mirrored(to, level.height) * step, step, first + to * step);
  };
  for (int k = 0; k < kWindow; ++k) {
    copy_row(-1 - k);
    copy_row(level.height + k);
  }
}

// Write the image at half its size, smoothed with 1 4 6 4 1 along both axes.
MULTIVERSION("avx2")
void halve(const Level& from, Level& to)
{
  const int step = from.step(), width = to.width, columns = width + 2;
  std::vector<uint16_t> sums(4 * static_cast<std::size_t>(columns));
  uint16_t* __restrict column = sums.data();  // from -2 on
  uint16_t* __restrict even = column + 2 * columns;
  uint16_t* __restrict odd = even + columns;
  for (int v = 0; v < to.height; ++v) {
    const uint8_t* row = from.pixels.get() + from.index(-2, 2 * v - 2);
    for (int u = 0; u < 2 * columns; ++u) {
      const uint8_t* at = row + u;
      const int outer = at[0] + at[4 * step], inner = at[step] + at[3 * step];
      column[u] = static_cast<uint16_t>(outer + 4 * inner + 6 * at[2 * step]);
    }
    for (int u = 0; u < columns; ++u) {
      even[u] = column[2 * u];
      odd[u] = column[2 * u + 1];
    }
    uint8_t* __restrict out = to.pixels.get() + to.index(0, v);
    for (int u = 0; u < width; ++u) {
      const int sum = even[u] + even[u + 2] + 4 * (odd[u] + odd[u + 1]) + 6 * even[u + 1];
      out[u] = static_cast<uint8_t>(static_cast<uint16_t>(sum + 128) >> 8);
    }
  }
}

MULTIVERSION("avx2")
void find_slopes(Level& level)
{
  const int step = level.step(), width = level.width;
  const auto outside = static_cast<std::size_t>(level.index(0, 0));
  for (int16_t* slopes : {level.slopes_x.get(), level.slopes_y.get()}) {
    std::fill_n(slopes, outside, int16_t{0});
    std::fill_n(slopes + level.index(-kWindow, level.height), kWindow * step, int16_t{0});
  }
  std::vector<int16_t> rows(2 * static_cast<std::size_t>(step));
  int16_t* __restrict smooth = rows.data() + kWindow;
  int16_t* __restrict across = smooth + step;
  for (int v = 0; v < level.height; ++v) {
    const uint8_t* __restrict here = level.pixels.get() + level.index(0, v);
    const uint8_t* __restrict above = here - step, * __restrict below = here + step;
    for (int u = -1; u <= width; ++u) {
      smooth[u] = static_cast<int16_t>(3 * (above[u] + below[u]) + 10 * here[u]);
      across[u] = static_cast<int16_t>(below[u] - above[u]);
    }
    int16_t* __restrict x = level.slopes_x.get() + level.index(0, v);
    int16_t* __restrict y = level.slopes_y.get() + level.index(0, v);
    for (int u = 0; u < width; ++u) {
      x[u] = static_cast<int16_t>(smooth[u + 1] - smooth[u - 1]);
      y[u] = static_cast<int16_t>(3 * (across[u - 1] + across[u + 1]) + 10 * across[u]);
    }
    // To the end of this row, and from the start of the next one.
    std::fill_n(x + width, 2 * kWindow, int16_t{0});
    std::fill_n(y + width, 2 * kWindow, int16_t{0});
  }
}

void finish(Level& level)
{
  mirror(level);
  find_slopes(level);
}

}  // namespace

Level::Level(int width_px, int height_px) : width(width_px), height(height_px)
{
  const auto size = static_cast<std::size_t>(step()) * (height + 2 * kWindow);
  pixels = std::make_unique_for_overwrite<uint8_t[]>(size);
  slopes_x = std::make_unique_for_overwrite<int16_t[]>(size);
  slopes_y = std::make_unique_for_overwrite<int16_t[]>(size);
}

Pyramid::Pyramid(const Image<uint8_t>& image, int num_levels)
{
  levels.emplace_back(image.width, image.height);
  for (int v = 0; v < image.height; ++v) {
    std::copy_n(image.row(v), image.width, levels[0].pixels.get() + levels[0].index(0, v));
  }
  finish(levels[0]);
  while (static_cast<int>(levels.size()) < num_levels) {
    const Level& last = levels.back();
    Level next((last.width + 1) / 2, (last.height + 1) / 2);
    if (std::min(next.width, next.height) <= kWindow) {
      break;
    }
    halve(last, next);
    finish(next);
    levels.push_back(std::move(next));
  }
}

}  // namespace hoid::flow
