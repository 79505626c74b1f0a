// Masks over a small image, and what they say of the pixels of the full one.

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "multiversion.hpp"

namespace {

// Write, for each of a number of bytes, the union of those that are up to reach steps of some bytes away.
ALWAYS_INLINE void unite(const uint8_t* from, std::ptrdiff_t step, int reach, int count, uint8_t* out)
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

// Write 1 for the pixels that have one that is not 0 within reach along rows and columns, 0 for the others.
extern "C" MULTIVERSION("avx2") void hoid_widen(
  const uint8_t* mask, int32_t width, int32_t height, int32_t reach, uint8_t* out)
{
  std::vector<uint8_t> row(width + 2 * static_cast<std::size_t>(reach));
  std::vector<uint8_t> wide((height + 2 * static_cast<std::size_t>(reach)) * width);  // along rows
  for (int v = 0; v < height; ++v) {
    std::copy_n(mask + static_cast<std::ptrdiff_t>(v) * width, width, row.data() + reach);
    unite(row.data() + reach, 1, reach, width, wide.data() + static_cast<std::ptrdiff_t>(v + reach) * width);
  }
  for (int v = 0; v < height; ++v) {
    uint8_t* to = out + static_cast<std::ptrdiff_t>(v) * width;
    unite(wide.data() + static_cast<std::ptrdiff_t>(v + reach) * width, width, reach, width, to);
    for (int u = 0; u < width; ++u) {
      to[u] = static_cast<uint8_t>(to[u] != 0);
    }
  }
}

// Write, for pixels given as indices in a flat image of some width, values[rows[v] * small_width + columns[u]].
extern "C" void hoid_values_at(
  int32_t width, int32_t small_width, const int64_t* rows, const int64_t* columns, const uint8_t* values,
  int32_t num_pixels, const int64_t* pixels, uint8_t* value_out)
{
  const double per_width = 1.0 / width;
  for (int k = 0; k < num_pixels; ++k) {
    // Half a pixel from every border of rows, which is more than the error of the product; faster than a division.
    const auto v = static_cast<int64_t>((static_cast<double>(pixels[k]) + 0.5) * per_width);
    value_out[k] = values[rows[v] * small_width + columns[pixels[k] - v * width]];
  }
}
