// ORB's descriptor, steered BRIEF (Rublee et al., ICCV 2011, sec. 4): 256 comparisons of two
// pixels each, rotated by the corner's orientation. The bits equal OpenCV's for the same image.

#include <cmath>

#include "common/multiversion.hpp"
#include "features/features.hpp"
#include "features/orb_pattern.hpp"

namespace hoid::features {

namespace {

// The pattern by coordinate: the first pixels of all pairs, then the second ones.
struct Pattern
{
  float x[2 * kPairs], y[2 * kPairs];

  Pattern()
  {
    for (int k = 0; k < kPairs; ++k) {
      x[k] = kPattern[k].first_x;
      y[k] = kPattern[k].first_y;
      x[kPairs + k] = kPattern[k].second_x;
      y[kPairs + k] = kPattern[k].second_y;
    }
  }
};

// Round a small number to the nearest integer, half to even, as std::lrint does. Adding 1.5 * 2^23
// leaves no bits for a fraction; unlike std::lrint this compiles to vector instructions.
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
  const uint8_t* corner, int32_t stride, float cosine, float sine, const Pattern& pattern,
  uint8_t* out)
{
  int32_t at[2 * kPairs];
  for (int k = 0; k < 2 * kPairs; ++k) {
    const float x = pattern.x[k] * cosine - pattern.y[k] * sine;
    const float y = pattern.x[k] * sine + pattern.y[k] * cosine;
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
  for (int byte = 0; byte < kDescriptorBytes; ++byte) {
    int bits = 0;
    for (int k = 0; k < 8; ++k) {
      bits |= brighter[8 * byte + k] << k;
    }
    out[byte] = static_cast<uint8_t>(bits);
  }
}

}  // namespace

MULTIVERSION("avx2")
void orb_descriptors(
  const Image<uint8_t>& image, const Pixels& corners, const float* angle_deg, uint8_t* out)
{
  static const Pattern pattern;
  constexpr float kRadians = static_cast<float>(3.14159265358979323846 / 180.0);
  for (int k = 0; k < corners.count; ++k) {
    const uint8_t* corner = image.row(corners.y[k]) + corners.x[k];
    const double angle = angle_deg[k] * kRadians;
    const auto cosine = static_cast<float>(std::cos(angle)),
               sine = static_cast<float>(std::sin(angle));
    describe(
      corner, image.width, cosine, sine, pattern,
      out + kDescriptorBytes * static_cast<std::ptrdiff_t>(k));
  }
}

}  // namespace hoid::features
