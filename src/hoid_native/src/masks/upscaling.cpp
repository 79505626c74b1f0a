// Nearest-neighbor upscaling at single pixels.

#include <cstdint>

#include "masks/masks.hpp"

namespace hoid::masks {

void values_at(
  const Image<uint8_t>& values, const Upscaling& scale, const int64_t* pixels,
  int num_pixels, uint8_t* value_out)
{
  const int64_t *rows = scale.rows, *columns = scale.columns;
  const int width = scale.width;
  const RowOfPixel row_of(width);
  for (int k = 0; k < num_pixels; ++k) {
    const int64_t v = row_of(pixels[k]);
    value_out[k] = values.data[rows[v] * values.width + columns[pixels[k] - v * width]];
  }
}

}  // namespace hoid::masks
