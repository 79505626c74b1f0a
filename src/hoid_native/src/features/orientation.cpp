// Corner orientation by the intensity centroid of a disc (Rosin, "Measuring corner properties",
// CVIU 1999), as in ORB (Rublee et al., ICCV 2011, sec. 3.2).

#include <cmath>
#include <cstring>

#include "common/multiversion.hpp"
#include "features/features.hpp"

namespace hoid::features {

namespace {

constexpr int kDiscRadius = kOrientationBorderPx;
constexpr int kRows = 2 * kDiscRadius + 1;
constexpr int kColumns = kRows + 1;  // one more, so that a row fills whole vectors

// Weights of the square's pixels in the first moments; 0 outside the disc of radius 15.5 px.
struct Weights
{
  int16_t x[kRows * kColumns] = {}, y[kRows * kColumns] = {};

  Weights()
  {
    for (int v = -kDiscRadius; v <= kDiscRadius; ++v) {
      const int half = static_cast<int>(std::sqrt((kDiscRadius + 0.5) * (kDiscRadius + 0.5) - v * v));
      for (int u = -half; u <= half; ++u) {
        const int at = (v + kDiscRadius) * kColumns + u + kDiscRadius;
        x[at] = static_cast<int16_t>(u);
        y[at] = static_cast<int16_t>(v);
      }
    }
  }
};

}  // namespace

MULTIVERSION("avx2")
void orientations(const Image<uint8_t>& image, const Pixels& corners, float* angle_deg_out)
{
  static const Weights weights;
  uint8_t patch[kRows * kColumns] = {};
  for (int k = 0; k < corners.count; ++k) {
    const uint8_t* corner = image.row(corners.y[k] - kDiscRadius) + corners.x[k] - kDiscRadius;
    for (int row = 0; row < kRows; ++row) {
      std::memcpy(
        patch + row * kColumns, corner + static_cast<std::ptrdiff_t>(row) * image.width, kRows);
    }
    int moment_x = 0, moment_y = 0;
    for (int at = 0; at < kRows * kColumns; ++at) {
      const auto pixel = static_cast<int16_t>(patch[at]);
      moment_x += pixel * weights.x[at];
      moment_y += pixel * weights.y[at];
    }
    constexpr double kDegrees = 180.0 / 3.14159265358979323846;
    const double angle = std::atan2(moment_y, moment_x) * kDegrees;
    const float positive = static_cast<float>(angle < 0 ? angle + 360.0 : angle);
    angle_deg_out[k] = positive < 360.0F ? positive : 0.0F;
  }
}

}  // namespace hoid::features
