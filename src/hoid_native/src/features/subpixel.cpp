// Subpixel position of a FAST corner: the peak of the quadratic fitted (least squares) to the
// signed FAST-9/16 scores of its pixel and 8 neighbors. Signed scores are not clamped to 0 where
// the pixel is no corner: with clamped ones, residuals grow from 0.25 to 0.31 px (decision 008).

#include <algorithm>

#include "features/fast_circle.hpp"
#include "features/features.hpp"

namespace hoid::features {

namespace {

constexpr int kSide = 3, kCellLanes = 16;
constexpr float kMaxOffsetPx = 0.5F;  // the edge of the pixel: no neighbor scores higher

// One number for each of the 3x3 pixels, row by row, then padding.
using Cells = int16_t __attribute__((vector_size(sizeof(int16_t) * kCellLanes)));

ALWAYS_INLINE Cells around(const uint8_t* at, std::ptrdiff_t stride)
{
  Cells cells{};
  for (int row = 0; row < kSide; ++row) {
    for (int column = 0; column < kSide; ++column) {
      cells[kSide * row + column] = at[(row - 1) * stride + column - 1];
    }
  }
  return cells;
}

ALWAYS_INLINE Cells scores(const uint8_t* at, std::ptrdiff_t stride)
{
  const Cells center = around(at, stride);
  Cells ring[kCircle];
  for (int k = 0; k < kCircle; ++k) {
    ring[k] = around(at + kOffsetY[k] * stride + kOffsetX[k], stride);
  }
  return larger<Cells>(best_arc<true>(ring) - center, center - best_arc<false>(ring));
}

// Write the peak of the quadratic a + b x + c y + d x^2 + e x y + f y^2 fitted to 3x3 values,
// clamped to the middle pixel; (0, 0) if the quadratic has no maximum.
ALWAYS_INLINE void write_peak(const Cells& s, float* offset)
{
  const auto sum = [&s](int a, int b, int c) { return static_cast<float>(s[a] + s[b] + s[c]); };
  const float left = sum(0, 3, 6), right = sum(2, 5, 8), over = sum(0, 1, 2), under = sum(6, 7, 8);
  const float b = (right - left) / 6, c = (under - over) / 6;
  const float two_d = (right + left - 2 * sum(1, 4, 7)) / 3;
  const float two_f = (under + over - 2 * sum(3, 4, 5)) / 3;
  const float e = static_cast<float>(s[8] - s[6] - s[2] + s[0]) / 4;
  const float determinant = two_d * two_f - e * e;
  offset[0] = offset[1] = 0;
  if (two_d < 0 && two_f < 0 && determinant > 0) {
    offset[0] = std::clamp((e * c - two_f * b) / determinant, -kMaxOffsetPx, kMaxOffsetPx);
    offset[1] = std::clamp((e * b - two_d * c) / determinant, -kMaxOffsetPx, kMaxOffsetPx);
  }
}

}  // namespace

MULTIVERSION("avx2")
void subpixel_offsets(const Image<uint8_t>& image, const Pixels& corners, float* offset_out)
{
  for (int k = 0; k < corners.count; ++k) {
    const uint8_t* corner = image.row(corners.y[k]) + corners.x[k];
    write_peak(scores(corner, image.width), offset_out + 2 * static_cast<std::ptrdiff_t>(k));
  }
}

}  // namespace hoid::features
