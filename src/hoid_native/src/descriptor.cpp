// ORB's descriptor: which of two pixels is brighter, for 256 pairs that turn with the corner.
//
// Steered BRIEF of Rublee et al., ICCV 2011, sec. 4; bit by bit OpenCV's for the same image.

#include <cmath>
#include <cstddef>
#include <cstdint>

#include "multiversion.hpp"
#include "orb_pattern.hpp"

namespace {

// The pattern's pixels by coordinate, all first ones before all second ones.
struct Pixels
{
  float x[2 * kPairs], y[2 * kPairs];

  Pixels()
  {
    for (int k = 0; k < kPairs; ++k) {
      x[k] = kPattern[k].first_x;
      y[k] = kPattern[k].first_y;
      x[kPairs + k] = kPattern[k].second_x;
      y[kPairs + k] = kPattern[k].second_y;
    }
  }
};

// The nearest integer, half to even, of a small number: a sum that has no bits left for fractions.
// std::lrint says the same, but not for several numbers at once.
ALWAYS_INLINE int32_t nearest(float value)
{
  constexpr float kShift = 12582912;  // 1.5 * 2^23
  constexpr int32_t kShiftBits = 0x4B400000;
  const float shifted = value + kShift;
  int32_t bits;
  __builtin_memcpy(&bits, &shifted, sizeof(bits));
  return bits - kShiftBits;
}

ALWAYS_INLINE void describe(
  const uint8_t* corner, int32_t stride, float cosine, float sine, const Pixels& pixels, uint8_t* out)
{
  int32_t at[2 * kPairs];
  for (int k = 0; k < 2 * kPairs; ++k) {
    const float x = pixels.x[k] * cosine - pixels.y[k] * sine;
    const float y = pixels.x[k] * sine + pixels.y[k] * cosine;
    at[k] = nearest(y) * stride + nearest(x);
  }
  uint8_t value[2 * kPairs];
  for (int k = 0; k < 2 * kPairs; ++k) {
    value[k] = corner[at[k]];
  }
  uint8_t brighter[kPairs];
  for (int k = 0; k < kPairs; ++k) {
    brighter[k] = value[k] < value[kPairs + k];
  }
  for (int byte = 0; byte < kPairs / 8; ++byte) {
    int bits = 0;
    for (int k = 0; k < 8; ++k) {
      bits |= brighter[8 * byte + k] << k;
    }
    out[byte] = static_cast<uint8_t>(bits);
  }
}

}  // namespace

// Write the 32 bytes of each (x, y), at least 19 pixels from the edge of a smoothed image.
extern "C" MULTIVERSION("avx2") void hoid_orb_descriptors(
  const uint8_t* image, int32_t stride, int32_t count, const int32_t* x, const int32_t* y,
  const float* angle_deg, uint8_t* out)
{
  static const Pixels pixels;
  constexpr float kRadians = static_cast<float>(3.14159265358979323846 / 180.0);
  for (int k = 0; k < count; ++k) {
    const uint8_t* corner = image + static_cast<std::ptrdiff_t>(y[k]) * stride + x[k];
    const double angle = angle_deg[k] * kRadians;
    describe(corner, stride, static_cast<float>(std::cos(angle)), static_cast<float>(std::sin(angle)), pixels, out + kPairs / 8 * k);
  }
}
