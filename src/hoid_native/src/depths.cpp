// Depth of what a box shows, read at the centre of the box.

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

namespace {

// The median, which reorders the values; NaN when there are none.
double median(std::vector<float>& values)
{
  if (values.empty()) {
    return std::numeric_limits<double>::quiet_NaN();
  }
  const auto upper = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), upper, values.end());
  if (values.size() % 2 == 1) {
    return *upper;
  }
  return (static_cast<double>(*std::max_element(values.begin(), upper)) + *upper) / 2;
}

}  // namespace

// Write the median reading of a square at the centre of each box (x1, y1, x2, y2). Beyond the image the
// square sees the image's edge. Readings are positive; 0 and NaN are none.
extern "C" void hoid_sample_depths(
  const float* depth_m, int32_t width, int32_t height, int32_t count, const double* boxes, int32_t side_px,
  double* median_m_out)
{
  std::vector<float> readings;
  readings.reserve(static_cast<std::size_t>(side_px) * static_cast<std::size_t>(side_px));
  for (int n = 0; n < count; ++n) {
    const double* box = boxes + 4 * static_cast<std::ptrdiff_t>(n);
    const int left = static_cast<int>(std::nearbyint((box[0] + box[2] - side_px) / 2));
    const int top = static_cast<int>(std::nearbyint((box[1] + box[3] - side_px) / 2));
    readings.clear();
    for (int v = top; v < top + side_px; ++v) {
      const float* row = depth_m + static_cast<std::ptrdiff_t>(std::clamp(v, 0, height - 1)) * width;
      for (int u = left; u < left + side_px; ++u) {
        const float reading = row[std::clamp(u, 0, width - 1)];
        if (reading > 0) {
          readings.push_back(reading);
        }
      }
    }
    median_m_out[n] = median(readings);
  }
}
