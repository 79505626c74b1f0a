// The depth in a box: the median at its center, or the depth of a person, which is that of the
// nearest large layer of depths in the middle of the box.

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>

#include "common/median.hpp"
#include "masks/masks.hpp"

namespace hoid::masks {

namespace {

constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();

// Return the first row or column of a square in the middle between two positions. It is clamped
// so that it fits into an int: all squares completely outside the image show its edge.
int first_between(double low_px, double high_px, int side_px, int size)
{
  const double first_px = std::nearbyint((low_px + high_px - side_px) / 2);
  return static_cast<int>(std::clamp<double>(first_px, -side_px, size));
}

// Histogram of depths. All values are chosen, none is tuned.
constexpr float kBinM = 0.1F;
constexpr float kMaxDepthM = 10.0F;  // farther than a depth camera measures
constexpr int kBins = 128;           // kMaxDepthM / kBinM and some more
constexpr int kLayerBins = 4;        // 0.4 m: the thickness of a torso
// The nearest layer with this ratio of the largest one's size is the person; larger layers behind
// it are the background.
constexpr double kMinLayerShare = 0.6;
// The part of a box that mostly shows the person: x1, y1, x2, y2 as shares of its sides.
constexpr double kMiddle[] = {0.2, 0.1, 0.8, 0.9};
constexpr float kMaxStepM = 0.5F;  // a person's depth changes by less between images
// If a smaller ratio of the measurements is near the known depth, the known depth was that of the
// background.
constexpr double kMinNearShare = 0.3;

int pixel(double place_px, int size)
{
  return static_cast<int>(std::clamp(place_px, 0.0, static_cast<double>(size)));
}

// Write the depths in the middle of a box.
void read_middle(const Image<float>& depth_m, const double* box, std::vector<float>& readings)
{
  const int width = depth_m.width, height = depth_m.height;
  const double wide = box[2] - box[0], high = box[3] - box[1];
  const int left = pixel(std::floor(box[0] + kMiddle[0] * wide), width);
  const int right = pixel(std::ceil(box[0] + kMiddle[2] * wide), width);
  const int top = pixel(std::floor(box[1] + kMiddle[1] * high), height);
  const int bottom = pixel(std::ceil(box[1] + kMiddle[3] * high), height);
  readings.clear();
  for (int v = top; v < bottom; ++v) {
    const float* row = depth_m.row(v);
    std::copy_if(
      row + left, row + std::max(left, right), std::back_inserter(readings),
      [](float reading) { return reading > 0 && reading < kMaxDepthM; });
  }
}

// Keep only the measurements near the known depth, unless these are too few.
void keep_near(float known_m, std::vector<float>& readings)
{
  const auto is_near = [known_m](float reading) {
    return std::abs(reading - known_m) < kMaxStepM;
  };
  const auto num_near = std::count_if(readings.begin(), readings.end(), is_near);
  if (static_cast<double>(num_near) > kMinNearShare * static_cast<double>(readings.size())) {
    readings.erase(std::partition(readings.begin(), readings.end(), is_near), readings.end());
  }
}

int bin_of(float reading)
{
  return static_cast<int>(reading / kBinM);
}

// Return the first bin of the nearest large layer of measurements.
int first_layer(const std::vector<float>& readings)
{
  int count[kBins + kLayerBins] = {}, layer[kBins + kLayerBins] = {};
  for (const float reading : readings) {
    ++count[bin_of(reading)];
  }
  for (int b = 0; b < kBins; ++b) {
    layer[b] = count[b] + count[b + 1] + count[b + 2] + count[b + 3];
  }
  const int* largest = std::max_element(layer, layer + kBins);
  const int* first = std::find_if(
    layer, layer + kBins, [&](int size) { return size >= kMinLayerShare * *largest; });
  return static_cast<int>(std::max_element(first, first + kLayerBins) - layer);
}

double median_of_first_layer(std::vector<float>& readings)
{
  if (readings.empty()) {
    return kUnknown;
  }
  const int first = first_layer(readings);
  const auto end = std::partition(readings.begin(), readings.end(), [first](float reading) {
    return bin_of(reading) >= first && bin_of(reading) < first + kLayerBins;
  });
  const auto middle = readings.begin() + (end - readings.begin()) / 2;
  std::nth_element(readings.begin(), middle, end);
  return *middle;
}

}  // namespace

void box_center_depths(
  const Image<float>& depth_m, const Boxes& boxes, int side_px, double* median_m_out)
{
  std::vector<double> readings;
  for (int n = 0; n < boxes.count; ++n) {
    const double* box = boxes[n];
    const int left = first_between(box[0], box[2], side_px, depth_m.width);
    const int top = first_between(box[1], box[3], side_px, depth_m.height);
    readings.clear();
    for (int v = top; v < top + side_px; ++v) {
      const float* row = depth_m.row(std::clamp(v, 0, depth_m.height - 1));
      for (int u = left; u < left + side_px; ++u) {
        const float reading = row[std::clamp(u, 0, depth_m.width - 1)];
        if (reading > 0) {
          readings.push_back(reading);
        }
      }
    }
    median_m_out[n] = readings.empty() ? kUnknown : median(readings);
  }
}

void person_depths(
  const Image<float>& depth_m, const Boxes& boxes, const double* known_m, double* depth_m_out)
{
  std::vector<float> readings;
  for (int n = 0; n < boxes.count; ++n) {
    read_middle(depth_m, boxes[n], readings);
    if (!std::isnan(known_m[n])) {
      keep_near(static_cast<float>(known_m[n]), readings);
    }
    depth_m_out[n] = median_of_first_layer(readings);
  }
}

}  // namespace hoid::masks
