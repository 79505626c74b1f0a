// Views of images and boxes that the caller owns.
#pragma once

#include <cstddef>
#include <cstdint>

namespace hoid {

// A row-major image without padding between its rows.
template <typename T>
struct Image
{
  const T* data;
  int width, height;

  const T* row(int y) const { return data + static_cast<std::ptrdiff_t>(y) * width; }
};

// Computes the row of a flat pixel index by a multiplication, which is faster than a division. The
// half pixel keeps the product away from the whole numbers, so its rounding error cannot change
// the row.
class RowOfPixel
{
public:
  explicit RowOfPixel(int width) : per_width_(1.0 / width) {}

  int64_t operator()(int64_t pixel) const
  {
    return static_cast<int64_t>((static_cast<double>(pixel) + 0.5) * per_width_);
  }

private:
  double per_width_;
};

// Finite boxes (x1, y1, x2, y2), in pixels.
struct Boxes
{
  const double* data;
  int count;

  const double* operator[](int n) const { return data + 4 * static_cast<std::ptrdiff_t>(n); }
};

}  // namespace hoid
