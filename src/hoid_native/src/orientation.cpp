// Orientation of a corner by the intensity centroid of its disc.
//
// Rosin, "Measuring corner properties", CVIU 1999, as used by ORB (Rublee et al., ICCV 2011).

#include <cmath>
#include <cstddef>
#include <cstdint>

namespace {

constexpr int kRadius = 15;

// Half widths of the rows of a disc of radius 15.5: the same when rows and columns are swapped.
struct Disc
{
  int half_width[kRadius + 1];

  Disc()
  {
    for (int v = 0; v <= kRadius; ++v) {
      half_width[v] = static_cast<int>(std::sqrt((kRadius + 0.5) * (kRadius + 0.5) - v * v));
    }
  }
};

}  // namespace

// Write the angle (degrees, [0, 360), y down) of each (x, y), at least 15 pixels from the edge.
extern "C" void hoid_orientations(
  const uint8_t* image, int32_t stride, int32_t count, const int32_t* x, const int32_t* y,
  float* angle_deg_out)
{
  static const Disc disc;
  for (int k = 0; k < count; ++k) {
    const uint8_t* center = image + static_cast<std::ptrdiff_t>(y[k]) * stride + x[k];
    int moment_x = 0, moment_y = 0;
    for (int v = -kRadius; v <= kRadius; ++v) {
      const int half = disc.half_width[v < 0 ? -v : v];
      const uint8_t* row = center + static_cast<std::ptrdiff_t>(v) * stride;
      int sum = 0, weighted = 0;
      for (int u = -half; u <= half; ++u) {
        sum += row[u];
        weighted += u * row[u];
      }
      moment_x += weighted;
      moment_y += v * sum;
    }
    constexpr double kDegrees = 180.0 / 3.14159265358979323846;
    const double angle = std::atan2(moment_y, moment_x) * kDegrees;
    const float positive = static_cast<float>(angle < 0 ? angle + 360.0 : angle);
    angle_deg_out[k] = positive < 360.0F ? positive : 0.0F;
  }
}
