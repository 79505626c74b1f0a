#include "objects/layers.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "objects/points.hpp"

namespace hoid::objects {

namespace {

// None of these numbers was tuned where no other source is named.

// A layer is a range of depth that is at least 4 bins thick. The object begins at the nearest layer
// that has at least 0.6 times the readings of the fullest one (as in `object_sighting`).
constexpr double kBinM = 0.05;
constexpr int kLayerBins = 4;
constexpr double kNearerShare = 0.6;
constexpr double kLayerShare = 0.3;  // thickness of the layer of a large object: share of its size
// An object ends at an empty range of depth of this length: share of the size of its box, at most
// so many meters.
constexpr double kGapShare = 0.3, kGapM = 0.25;
constexpr double kEmptyShare = 0.02;  // of the box's readings; an empty bin has no more than this
// Largest extent of an object along the view: share of the size of its box, at least so many
// meters.
constexpr double kMaxDepthShare = 0.9, kMinDepthM = 0.2;

// Return the first bin with readings in the nearest layer that is filled well.
int first_bin(const std::vector<int>& count, int thick)
{
  const auto num = static_cast<int>(count.size());
  std::vector<int> layers(num, 0);
  for (int bin = num - 1, sum = 0; bin >= 0; --bin) {
    sum += count[bin] - (bin + thick < num ? count[bin + thick] : 0);
    layers[bin] = sum;
  }
  const int fullest = *std::max_element(layers.begin(), layers.end());
  int first = 0;
  while (layers[first] < kNearerShare * fullest) {
    ++first;
  }
  while (count[first] == 0) {
    ++first;
  }
  return first;
}

}  // namespace

Pixels nearest_part(const DepthPoints& image, const Pixels& pixels, int side_px)
{
  if (pixels.empty()) {
    return pixels;
  }
  std::vector<int> bins;
  std::vector<float> depths;
  for (const int64_t pixel : pixels) {
    const float depth_m = image.depth_m.data[pixel];
    depths.push_back(depth_m);
    bins.push_back(static_cast<int>(depth_m / static_cast<float>(kBinM)));
  }
  const double size_m = image.pixel_m * side_px * static_cast<double>(median(depths));
  const auto in_bins = [](double length_m) {
    return static_cast<int>(std::nearbyint(length_m / kBinM));
  };
  const int num_bins = std::max(*std::max_element(bins.begin(), bins.end()) + 1, kLayerBins);
  const int thick = std::max(kLayerBins, in_bins(kLayerShare * size_m));
  const int gap = std::max(2, in_bins(std::min(kGapShare * size_m, kGapM)));
  const int most = in_bins(std::max(kMaxDepthShare * size_m, kMinDepthM));
  std::vector<int> count(num_bins, 0);
  for (const int bin : bins) {
    ++count[bin];
  }
  const int first = first_bin(count, thick);
  const double least = std::max(1.0, kEmptyShare * static_cast<double>(pixels.size()));
  // The object ends before the first `gap` bins that are empty, beyond the first layer.
  int end = first, num_empty = 0;
  for (int bin = first; bin < num_bins && num_empty < gap; ++bin) {
    const bool is_filled = bin < first + thick || count[bin] > least;
    num_empty = is_filled ? 0 : num_empty + 1;
    end = is_filled ? bin + 1 : end;
  }
  end = std::min(end, first + most);
  Pixels out;
  for (std::size_t n = 0; n < pixels.size(); ++n) {
    // One bin before the layer: its first readings are noise of the same surface.
    if (bins[n] >= first - 1 && bins[n] < end) {
      out.push_back(pixels[n]);
    }
  }
  return out;
}

}  // namespace hoid::objects
