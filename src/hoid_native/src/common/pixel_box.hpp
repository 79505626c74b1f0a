#pragma once

#include <algorithm>
#include <cstdint>

namespace hoid {

// A rectangle of whole pixels; right and bottom are excluded.
struct PixelBox
{
  int left, top, right, bottom;

  int width() const { return std::max(right - left, 0); }
  int height() const { return std::max(bottom - top, 0); }
  int side() const { return std::max(width(), height()); }

  bool contains(int64_t column, int64_t row) const
  {
    return column >= left && column < right && row >= top && row < bottom;
  }

  // Visit the flat indices of the pixels, row by row.
  template <typename Visit>
  void each_pixel(int image_width, Visit visit) const
  {
    for (int v = top; v < bottom; ++v) {
      const auto first = static_cast<int64_t>(v) * image_width;
      for (int64_t pixel = first + left; pixel < first + right; ++pixel) {
        visit(pixel);
      }
    }
  }
};

inline PixelBox pixel_box(const int32_t* box)
{
  return {box[0], box[1], box[2], box[3]};
}

}  // namespace hoid
