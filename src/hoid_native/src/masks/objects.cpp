// Segments dynamic objects in a depth image: an object consists of the regions between depth jumps
// that belong to its box.

#include <algorithm>
#include <cmath>

#include "common/pixel_box.hpp"
#include "masks/masks.hpp"
#include "masks/regions.hpp"

namespace hoid::masks {

namespace {

constexpr double kMinInsideShare = 0.6;  // chosen: share of an object's region that is in its box
// Chosen: if the regions of a detected object fill a smaller ratio of its box, the object has
// merged with a surface that it touches.
constexpr double kMinFilledShare = 0.25;
// How far an object extends beyond its box, as a ratio of its side (decision 010: `crowd` 2.9 mm
// instead of 3.2, and no image of a half occluded `fr1_xyz` is lost instead of 77).
constexpr double kMaxBeyondShare = 0.1;
// Chosen: gaps without measurements belong to the object up to this many pixels from its regions.
constexpr int kGapReachPx = 5;

// Set the pixels without measurements that have a set pixel within reach along rows and columns.
// `pixels` are those of the area, row by row.
void fill_gaps(const Image<float>& depth_m, const PixelBox& area, std::vector<uint8_t>& pixels)
{
  const int width = area.width(), height = area.height();
  std::vector<uint8_t> beside(pixels.size());  // a set pixel is within reach in the row
  for (int y = 0; y < height; ++y) {
    const uint8_t* row = pixels.data() + static_cast<std::ptrdiff_t>(y) * width;
    int until = 0;
    for (int x = 0; x < width; ++x) {
      if (row[x] != 0) {
        const int first = std::max(until, x - kGapReachPx),
                  last = std::min(width, x + kGapReachPx + 1);
        std::fill(
          beside.begin() + y * width + first, beside.begin() + y * width + last, uint8_t{1});
        until = last;
      }
    }
  }
  // Number of rows within reach that have such a pixel, by column.
  std::vector<uint8_t> near(width, 0);
  for (int y = -kGapReachPx; y < height; ++y) {
    for (int x = 0; x < width && y + kGapReachPx < height; ++x) {
      near[x] += beside[(y + kGapReachPx) * width + x];
    }
    for (int x = 0; x < width && y > kGapReachPx; ++x) {
      near[x] -= beside[(y - kGapReachPx - 1) * width + x];
    }
    for (int x = 0; x < width && y >= 0; ++x) {
      const bool has_reading = depth_m.row(area.top + y)[area.left + x] > 0;
      pixels[y * width + x] |= static_cast<uint8_t>((near[x] > 0) & !has_reading);
    }
  }
}

// One dynamic object (see Objects).
struct Object
{
  PixelBox area;
  double depth_m, reach_m;
  bool seen;  // detected in this image, not predicted
};

// Sets the dynamic pixels, object by object.
class ObjectSegmentation
{
public:
  ObjectSegmentation(const Image<float>& depth_m, const Regions& regions, uint8_t* dynamic)
  : depth_m_(depth_m),
    regions_(regions),
    dynamic_(dynamic),
    inside_(regions.count())
  {
  }

  void add(const Object& object)
  {
    const PixelBox& area = object.area;
    const bool whole = std::isnan(object.depth_m);
    pixels_.assign(
      static_cast<std::size_t>(area.width()) * area.height(), static_cast<uint8_t>(whole));
    if (!whole) {
      const int64_t size = add_regions(object);
      if (object.seen && size < kMinFilledShare * static_cast<double>(pixels_.size())) {
        add_near(object);
      }
      fill_gaps(depth_m_, area, pixels_);
    }
    auto is_set = pixels_.begin();
    area.each_pixel(depth_m_.width, [&](int64_t pixel) { dynamic_[pixel] |= *is_set++; });
  }

private:
  template <typename Visit>
  void each_run(const PixelBox& area, Visit visit) const
  {
    for (int y = area.top; y < area.bottom; ++y) {
      for (const Run* run = regions_.begin(y); run != regions_.end(y) && run->first < area.right;
           ++run) {
        if (run->last > area.left) {
          visit(y, *run);
        }
      }
    }
  }

  // Return the area with a margin for the parts of the object that its box misses.
  PixelBox grown(const PixelBox& area) const
  {
    const auto x = static_cast<int>(std::lround(kMaxBeyondShare * area.width()));
    const auto y = static_cast<int>(std::lround(kMaxBeyondShare * area.height()));
    return {
      std::max(area.left - x, 0), std::max(area.top - y, 0), std::min(area.right + x, depth_m_.width),
      std::min(area.bottom + y, depth_m_.height)};
  }

  // Set the pixels of the regions that belong to an object; return the size of these regions.
  int64_t add_regions(const Object& object)
  {
    const PixelBox& area = object.area;
    touched_.clear();
    each_run(area, [&](int, const Run& run) {
      if (inside_[run.region] == 0) {
        touched_.push_back(run.region);
      }
      inside_[run.region] += run.overlap(area.left, area.right);
    });
    int64_t size = 0;
    for (const int r : touched_) {
      const bool belongs = inside_[r] >= kMinInsideShare * regions_.size[r] &&
                       std::abs(regions_.mean_m[r] - object.depth_m) < object.reach_m;
      size += belongs ? regions_.size[r] : 0;
      inside_[r] = belongs ? 1 : 0;
    }
    each_run(area, [&](int y, const Run& run) {
      if (inside_[run.region] != 0) {
        const int first = std::max(run.first, area.left) - area.left;
        uint8_t* row = pixels_.data() + static_cast<std::ptrdiff_t>(y - area.top) * area.width();
        std::fill_n(row + first, run.overlap(area.left, area.right), uint8_t{1});
      }
    });
    const PixelBox wide = grown(area);
    each_run(wide, [&](int y, const Run& run) {
      const int last = inside_[run.region] != 0 ? std::min(run.last, wide.right) : 0;
      for (int x = std::max(run.first, wide.left); x < last; ++x) {
        dynamic_[y * depth_m_.width + x] = 1;
      }
    });
    for (const int r : touched_) {
      inside_[r] = 0;
    }
    return size;
  }

  // Set every pixel of the area whose depth is near that of the object.
  void add_near(const Object& object)
  {
    const auto middle_m = static_cast<float>(object.depth_m),
               reach_m = static_cast<float>(object.reach_m);
    auto is_set = pixels_.begin();
    object.area.each_pixel(depth_m_.width, [&](int64_t pixel) {
      *is_set++ |= static_cast<uint8_t>(std::abs(depth_m_.data[pixel] - middle_m) < reach_m);
    });
  }

  const Image<float>& depth_m_;
  const Regions& regions_;
  uint8_t* dynamic_;
  std::vector<int> inside_;   // pixels of each region in the current area; all 0 between objects
  std::vector<int> touched_;  // regions in the current area
  std::vector<uint8_t> pixels_;
};

}  // namespace

MULTIVERSION("avx2")
void segment_objects(const Image<float>& depth_m, const Objects& objects, uint8_t* dynamic_out)
{
  std::fill_n(dynamic_out, depth_m.size(), uint8_t{0});
  const Regions regions(depth_m);
  ObjectSegmentation segmentation(depth_m, regions, dynamic_out);
  for (int n = 0; n < objects.areas.count; ++n) {
    segmentation.add(
      {pixel_box(objects.areas[n]), objects.depths_m[n], objects.reaches_m[n],
       objects.seen[n] != 0});
  }
}

}  // namespace hoid::masks
