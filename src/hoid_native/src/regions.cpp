// What boxes show, cut out of a depth image along its jumps: a person or an object is a region, or a few.

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <vector>

namespace {

constexpr float kJumpM = 0.02F;       // a jump is more than this ...
constexpr float kJumpShare = 0.03F;   // ... plus this share of the depth: surfaces seen at a slant must not break
constexpr double kInsideShare = 0.6;  // of a region that belongs to what a box shows
constexpr double kFilledShare = 0.25; // of a box: with less, what it shows has merged with what it touches
constexpr int kReach = 5;             // pixels from a region within which it fills gaps without readings

// Flags of the pixels with a reading that is no jump away from any of its 8 neighbours.
std::vector<uint8_t> smooth_pixels(const float* depth_m, int width, int height)
{
  std::vector<uint8_t> smooth(static_cast<std::size_t>(width) * height);
  std::vector<float> low(width + 2), high(width + 2);
  for (int y = 0; y < height; ++y) {
    const float* row = depth_m + static_cast<std::ptrdiff_t>(y) * width;
    const float* above = y > 0 ? row - width : row;
    const float* below = y + 1 < height ? row + width : row;
    for (int x = 0; x < width; ++x) {
      low[x + 1] = std::min(row[x], std::min(above[x], below[x]));
      high[x + 1] = std::max(row[x], std::max(above[x], below[x]));
    }
    low[0] = low[1], low[width + 1] = low[width];
    high[0] = high[1], high[width + 1] = high[width];
    uint8_t* out = smooth.data() + static_cast<std::ptrdiff_t>(y) * width;
    for (int x = 0; x < width; ++x) {
      const float most = std::max(high[x], std::max(high[x + 1], high[x + 2]));
      const float least = std::min(low[x], std::min(low[x + 1], low[x + 2]));
      out[x] = static_cast<uint8_t>((most - least < kJumpM + kJumpShare * row[x]) & (row[x] > 0));
    }
  }
  return smooth;
}

// The connected components (4 neighbours) of smooth pixels; label 0 is no region.
class Regions
{
public:
  Regions(const float* depth_m, int width, int height) : label_(smooth_labels(depth_m, width, height))
  {
    const int num = number_roots();
    size.assign(num, 0);
    mean_m.assign(num, 0.0);
    for (std::size_t k = 0; k < label_.size(); ++k) {
      label_[k] = parent_[label_[k]];
      size[label_[k]] += 1;
      mean_m[label_[k]] += static_cast<double>(depth_m[k]);
    }
    for (int r = 0; r < num; ++r) {
      mean_m[r] /= std::max(size[r], 1);
    }
  }

  const int* labels() const { return label_.data(); }

  std::vector<int> size;       // pixels of each region
  std::vector<double> mean_m;  // depth of each region

private:
  std::vector<int> smooth_labels(const float* depth_m, int width, int height)
  {
    const std::vector<uint8_t> smooth = smooth_pixels(depth_m, width, height);
    std::vector<int> labels(smooth.size(), 0);
    parent_.assign(1, 0);
    for (std::size_t k = 0; k < smooth.size(); ++k) {
      if (smooth[k] == 0) {
        continue;
      }
      const int left = k % width > 0 ? labels[k - 1] : 0;
      const int above = k >= static_cast<std::size_t>(width) ? labels[k - width] : 0;
      if (left == 0 && above == 0) {
        labels[k] = static_cast<int>(parent_.size());
        parent_.push_back(labels[k]);
      } else {
        labels[k] = left == 0 || left == above ? above : above == 0 ? left : join(left, above);
      }
    }
    return labels;
  }

  int root(int label)
  {
    while (parent_[label] != label) {
      label = parent_[label] = parent_[parent_[label]];
    }
    return label;
  }

  int join(int a, int b)
  {
    a = root(a), b = root(b);
    return parent_[std::max(a, b)] = std::min(a, b);
  }

  // Replace parents by numbers of regions without gaps; a parent comes before its children.
  int number_roots()
  {
    int num = 0;
    for (std::size_t label = 0; label < parent_.size(); ++label) {
      const bool is_root = parent_[label] == static_cast<int>(label);
      parent_[label] = is_root ? num++ : parent_[parent_[label]];
    }
    return num;
  }

  std::vector<int> parent_;
  std::vector<int> label_;
};

// A part of an image: columns [x1, x2), rows [y1, y2).
struct Area
{
  int x1, y1, x2, y2;

  int width() const { return std::max(x2 - x1, 0); }
  int height() const { return std::max(y2 - y1, 0); }
};

// Set the pixels without readings that lie within reach of set pixels of an area, along rows and columns alike.
void fill_gaps(const float* depth_m, int stride, const Area& area, std::vector<uint8_t>& pixels)
{
  const int width = area.width(), height = area.height();
  std::vector<uint8_t> beside(pixels.size());  // within reach along the row
  for (int y = 0; y < height; ++y) {
    const uint8_t* row = pixels.data() + static_cast<std::ptrdiff_t>(y) * width;
    int until = 0;
    for (int x = 0; x < width; ++x) {
      if (row[x] != 0) {
        const int first = std::max(until, x - kReach), last = std::min(width, x + kReach + 1);
        std::fill(beside.begin() + y * width + first, beside.begin() + y * width + last, uint8_t{1});
        until = last;
      }
    }
  }
  std::vector<uint8_t> near(width, 0);  // rows within reach, for each column
  for (int y = -kReach; y < height; ++y) {
    for (int x = 0; x < width && y + kReach < height; ++x) {
      near[x] += beside[(y + kReach) * width + x];
    }
    for (int x = 0; x < width && y > kReach; ++x) {
      near[x] -= beside[(y - kReach - 1) * width + x];
    }
    for (int x = 0; x < width && y >= 0; ++x) {
      const bool has_reading = depth_m[(area.y1 + y) * stride + area.x1 + x] > 0;
      pixels[y * width + x] |= static_cast<uint8_t>((near[x] > 0) & !has_reading);
    }
  }
}

}  // namespace

// Write how sure it is, for each pixel of a depth image, that it shows something that moves; 0 = static.
//
// Each thing is given by the area (x1, y1, x2, y2) of its box, its depth and how far it reaches before and behind
// that, how sure it is that it moves, and whether it was seen there or is only expected. A thing is the regions
// that lie mostly in its area and near its depth, with the gaps between them; when they are too little of an area
// where it was seen, it has merged with what it touches: then every pixel of the area within reach counts. Without
// a depth (NaN) a thing is its area.
extern "C" void hoid_cover_things(
  const float* depth_m, int32_t width, int32_t height, int32_t count, const int32_t* areas, const double* depths_m,
  const double* reaches_m, const uint8_t* certainties, const uint8_t* seen, uint8_t* certainty_out)
{
  Regions regions(depth_m, width, height);
  const int* labels = regions.labels();
  const std::size_t num = regions.size.size();
  std::vector<uint8_t> of_region(num, 0), own(num), pixels;
  std::vector<int> inside(num);
  std::fill(certainty_out, certainty_out + static_cast<std::ptrdiff_t>(width) * height, uint8_t{0});
  for (int n = 0; n < count; ++n) {
    const Area area{areas[4 * n], areas[4 * n + 1], areas[4 * n + 2], areas[4 * n + 3]};
    const bool whole = std::isnan(depths_m[n]);
    pixels.assign(static_cast<std::size_t>(area.width()) * area.height(), static_cast<uint8_t>(whole));
    if (!whole) {
      std::fill(inside.begin(), inside.end(), 0);
      for (int y = area.y1; y < area.y2; ++y) {
        for (int x = area.x1; x < area.x2; ++x) {
          inside[labels[y * width + x]] += 1;
        }
      }
      int64_t own_size = 0;
      own[0] = 0;
      for (std::size_t r = 1; r < num; ++r) {
        own[r] = static_cast<uint8_t>(
          inside[r] >= kInsideShare * regions.size[r] && std::abs(regions.mean_m[r] - depths_m[n]) < reaches_m[n]);
        own_size += own[r] != 0 ? regions.size[r] : 0;
        of_region[r] = own[r] != 0 ? std::max(of_region[r], certainties[n]) : of_region[r];
      }
      const bool merged = seen[n] != 0 && own_size < kFilledShare * static_cast<double>(pixels.size());
      const auto middle_m = static_cast<float>(depths_m[n]), reach_m = static_cast<float>(reaches_m[n]);
      for (int y = area.y1, k = 0; y < area.y2; ++y) {
        for (int x = area.x1; x < area.x2; ++x, ++k) {
          const int at = y * width + x;
          pixels[k] = static_cast<uint8_t>(
            (own[labels[at]] != 0) | (merged & (std::abs(depth_m[at] - middle_m) < reach_m)));
        }
      }
      fill_gaps(depth_m, width, area, pixels);
    }
    for (int y = area.y1, k = 0; y < area.y2; ++y) {
      for (int x = area.x1; x < area.x2; ++x, ++k) {
        uint8_t& out = certainty_out[y * width + x];
        out = pixels[k] != 0 ? std::max(out, certainties[n]) : out;
      }
    }
  }
  for (std::ptrdiff_t k = 0; k < static_cast<std::ptrdiff_t>(width) * height; ++k) {
    certainty_out[k] = std::max(certainty_out[k], of_region[labels[k]]);
  }
}
