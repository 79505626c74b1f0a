// Masks over a small image, and what they say of the pixels of the full one.

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/multiversion.hpp"
#include "masks/masks.hpp"

namespace hoid::masks {

namespace {

// Write, for each of a number of bytes, the union of those that are up to reach steps of some
// bytes away.
ALWAYS_INLINE void unite(
  const uint8_t* from, std::ptrdiff_t step, int reach, int count, uint8_t* out)
{
  for (int x = 0; x < count; ++x) {
    out[x] = from[x];
  }
  for (int k = 1; k <= reach; ++k) {
    const uint8_t *before = from - k * step, *after = from + k * step;
    for (int x = 0; x < count; ++x) {
      out[x] |= before[x] | after[x];
    }
  }
}

}  // namespace

MULTIVERSION("avx2")
void widen(const Image<uint8_t>& mask, int reach, uint8_t* out)
{
  const int width = mask.width, height = mask.height;
  std::vector<uint8_t> row(width + 2 * static_cast<std::size_t>(reach));
  std::vector<uint8_t> wide((height + 2 * static_cast<std::size_t>(reach)) * width);  // along rows
  for (int v = 0; v < height; ++v) {
    std::copy_n(mask.row(v), width, row.data() + reach);
    unite(
      row.data() + reach, 1, reach, width,
      wide.data() + static_cast<std::ptrdiff_t>(v + reach) * width);
  }
  for (int v = 0; v < height; ++v) {
    uint8_t* to = out + static_cast<std::ptrdiff_t>(v) * width;
    unite(wide.data() + static_cast<std::ptrdiff_t>(v + reach) * width, width, reach, width, to);
    for (int u = 0; u < width; ++u) {
      to[u] = static_cast<uint8_t>(to[u] != 0);
    }
  }
}

void values_at(
  const Image<uint8_t>& values, const Magnification& magnification, const int64_t* pixels,
  int num_pixels, uint8_t* value_out)
{
  const int64_t *rows = magnification.rows, *columns = magnification.columns;
  const int width = magnification.width;
  const RowOfPixel row_of(width);
  for (int k = 0; k < num_pixels; ++k) {
    const int64_t v = row_of(pixels[k]);
    value_out[k] = values.data[rows[v] * values.width + columns[pixels[k] - v * width]];
  }
}

}  // namespace hoid::masks
