// What boxes show, cut out of a depth image along its jumps: a person or an object is a region, or
// a few.

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "masks/masks.hpp"
#include "masks/regions.hpp"

namespace hoid::masks {

namespace {

constexpr double kInsideShare = 0.6;  // of a region that belongs to what a box shows
constexpr double kFilledShare =
  0.25;  // of a box: with less, what it shows has merged with what it touches
constexpr double kBeyond = 0.1;  // of a box's side: how far what it shows may reach out of it
constexpr int kReach = 5;  // pixels from a region within which it fills gaps without readings

// A part of an image: columns [x1, x2), rows [y1, y2).
struct Area
{
  int x1, y1, x2, y2;

  int width() const { return std::max(x2 - x1, 0); }
  int height() const { return std::max(y2 - y1, 0); }
};

// Set the pixels without readings that lie within reach of set pixels of an area, along rows and
// columns alike.
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
        std::fill(
          beside.begin() + y * width + first, beside.begin() + y * width + last, uint8_t{1});
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

// Something that may move: where and how far it is, and how sure that is.
struct Thing
{
  Area area;
  double depth_m, reach_m;
  uint8_t certainty;
  bool seen;  // there, not only expected there
};

// The cover of things, region by region and then pixel by pixel.
class Cover
{
public:
  Cover(const float* depth_m, int width, int height, const Regions& regions, uint8_t* certainty)
  : depth_m_(depth_m),
    width_(width),
    height_(height),
    regions_(regions),
    certainty_(certainty),
    inside_(regions.count())
  {
  }

  void add(const Thing& thing)
  {
    const Area& area = thing.area;
    const bool whole = std::isnan(thing.depth_m);
    pixels_.assign(
      static_cast<std::size_t>(area.width()) * area.height(), static_cast<uint8_t>(whole));
    if (!whole) {
      const int64_t size = add_regions(thing);
      if (thing.seen && size < kFilledShare * static_cast<double>(pixels_.size())) {
        add_near(thing);
      }
      fill_gaps(depth_m_, width_, area, pixels_);
    }
    for (int y = area.y1, k = 0; y < area.y2; ++y) {
      for (int x = area.x1; x < area.x2; ++x, ++k) {
        uint8_t& out = certainty_[y * width_ + x];
        out = pixels_[k] != 0 ? std::max(out, thing.certainty) : out;
      }
    }
  }

private:
  template <typename Visit>
  void each_run(const Area& area, Visit visit) const
  {
    for (int y = area.y1; y < area.y2; ++y) {
      for (const Run* run = regions_.begin(y); run != regions_.end(y) && run->first < area.x2;
           ++run) {
        if (run->last > area.x1) {
          visit(y, *run);
        }
      }
    }
  }

  // Return an area with what its box may have missed of the thing.
  Area grown(const Area& area) const
  {
    const auto x = static_cast<int>(std::lround(kBeyond * area.width()));
    const auto y = static_cast<int>(std::lround(kBeyond * area.height()));
    return {
      std::max(area.x1 - x, 0), std::max(area.y1 - y, 0), std::min(area.x2 + x, width_),
      std::min(area.y2 + y, height_)};
  }

  // Set the pixels of the regions that belong to a thing; return how many pixels those regions
  // have.
  int64_t add_regions(const Thing& thing)
  {
    const Area& area = thing.area;
    touched_.clear();
    each_run(area, [&](int, const Run& run) {
      if (inside_[run.region] == 0) {
        touched_.push_back(run.region);
      }
      inside_[run.region] += run.shared(area.x1, area.x2);
    });
    int64_t size = 0;
    for (const int r : touched_) {
      const bool own = inside_[r] >= kInsideShare * regions_.size[r] &&
                       std::abs(regions_.mean_m[r] - thing.depth_m) < thing.reach_m;
      size += own ? regions_.size[r] : 0;
      inside_[r] = own ? 1 : 0;
    }
    each_run(area, [&](int y, const Run& run) {
      if (inside_[run.region] != 0) {
        const int first = std::max(run.first, area.x1) - area.x1;
        uint8_t* row = pixels_.data() + static_cast<std::ptrdiff_t>(y - area.y1) * area.width();
        std::fill_n(row + first, run.shared(area.x1, area.x2), uint8_t{1});
      }
    });
    const Area wide = grown(area);
    each_run(wide, [&](int y, const Run& run) {
      const int last = inside_[run.region] != 0 ? std::min(run.last, wide.x2) : 0;
      for (int x = std::max(run.first, wide.x1); x < last; ++x) {
        uint8_t& out = certainty_[y * width_ + x];
        out = std::max(out, thing.certainty);
      }
    });
    for (const int r : touched_) {
      inside_[r] = 0;
    }
    return size;
  }

  // Set every pixel of the area that is as far as the thing.
  void add_near(const Thing& thing)
  {
    const auto middle_m = static_cast<float>(thing.depth_m),
               reach_m = static_cast<float>(thing.reach_m);
    for (int y = thing.area.y1, k = 0; y < thing.area.y2; ++y) {
      for (int x = thing.area.x1; x < thing.area.x2; ++x, ++k) {
        pixels_[k] |=
          static_cast<uint8_t>(std::abs(depth_m_[y * width_ + x] - middle_m) < reach_m);
      }
    }
  }

  const float* depth_m_;
  int width_, height_;
  const Regions& regions_;
  uint8_t* certainty_;
  std::vector<int> inside_;   // pixels of each region in the area at hand; all 0 between things
  std::vector<int> touched_;  // regions in the area at hand
  std::vector<uint8_t> pixels_;
};

}  // namespace

MULTIVERSION("avx2")
void cover_things(const Image<float>& depth_m, const Things& things, uint8_t* certainty_out)
{
  const int width = depth_m.width, height = depth_m.height;
  std::fill(
    certainty_out, certainty_out + static_cast<std::ptrdiff_t>(width) * height, uint8_t{0});
  const Regions found(depth_m.data, width, height);
  Cover cover(depth_m.data, width, height, found, certainty_out);
  for (int n = 0; n < things.count; ++n) {
    const int32_t* area = things.areas + 4 * static_cast<std::ptrdiff_t>(n);
    cover.add(
      {{area[0], area[1], area[2], area[3]},
       things.depths_m[n],
       things.reaches_m[n],
       things.certainties[n],
       things.seen[n] != 0});
  }
}

}  // namespace hoid::masks
