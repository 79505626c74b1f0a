#include "objects/layers.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "objects/points.hpp"

namespace hoid::objects {

namespace {

// None of these numbers was tuned where no other source is named.

// The depths in a box are counted in a histogram with bins of 5 cm. A layer is a range of at least
// 4 bins. The object begins at the nearest layer with at least 0.6 times as many pixels as the
// layer with the most (as in `object_sighting`).
constexpr double kBinM = 0.05;
constexpr int kLayerBins = 4;
constexpr double kNearerShare = 0.6;
constexpr double kLayerShare = 0.3;  // thickness of the layer of a large object: share of its size
// An object ends at a gap in depth of this length: a ratio of the size of its box, or this many
// meters if that is less.
constexpr double kGapShare = 0.3, kGapM = 0.25;
constexpr double kEmptyShare = 0.02;  // a bin with a smaller ratio of the box's pixels is empty
// Largest extent of an object along the viewing direction: a ratio of the size of its box, or this
// many meters if that is more.
constexpr double kMaxDepthShare = 0.9, kMinDepthM = 0.2;

// Return the index of the bin of depth where the object begins: the first one with pixels in the
// nearest layer with at least `kNearerShare` times as many pixels as the layer with the most.
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
  // Behind the first layer, the object ends where `gap` successive bins are empty.
  int end = first, num_empty = 0;
  for (int bin = first; bin < num_bins && num_empty < gap; ++bin) {
    const bool is_filled = bin < first + thick || count[bin] > least;
    num_empty = is_filled ? 0 : num_empty + 1;
    end = is_filled ? bin + 1 : end;
  }
  end = std::min(end, first + most);
  Pixels out;
  for (std::size_t n = 0; n < pixels.size(); ++n) {
    // One bin before the layer belongs to the object: depth noise spreads its surface into it.
    if (bins[n] >= first - 1 && bins[n] < end) {
      out.push_back(pixels[n]);
    }
  }
  return out;
}

}  // namespace hoid::objects
