// The surface of an object in the box of its detection.
//
// The box of an object also shows what the object stands on or leans against, and what hides a part
// of it. The former is removed as planes that continue around the box; the latter is removed where
// its surface fits the box of another object better, or where the place of the object is known.

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <map>
#include <optional>
#include <random>
#include <utility>

#include "common/median.hpp"
#include "objects/objects.hpp"
#include "objects/parts.hpp"

namespace hoid::objects {

namespace {

// Numbers without a source were not tuned.
constexpr int kMinReadings = 6;  // fewer readings do not show where an object is
// Width of the ring around a box: share of the box's longer side, and limits in pixels.
constexpr double kRingShare = 0.25, kRingLeastPx = 2, kRingMostPx = 10;
// Largest number of planes that are removed, and smallest share of the ring's readings on each.
constexpr int kMaxPlanes = 3;
constexpr double kMinPlaneShare = 0.15;
constexpr std::size_t kMaxRing = 250;  // readings of the ring that are used, to bound the time
// An object keeps the readings near a plane if without them less than this share would remain: then
// it is flat itself, like a book on a table.
constexpr double kMinRest = 0.15;
// Then the plane must have at least this ratio of the readings in its box. Otherwise the object is
// hidden, and the plane is a wall or a floor behind it. Chosen.
constexpr double kFlatShare = 0.5;
// How much farther from a plane the readings may be that are removed from an object that is not
// flat: 2.5 standard deviations of depth. Chosen.
constexpr double kNoiseScale = 1.8;
// Two segments that share more than this part of the smaller one are the same surface; the second
// number holds if one of them is a person.
constexpr double kShared = 0.4, kSharedWithPerson = 0.1;
// If at least this ratio of the object's nearest part is at its known place, nothing hides it.
constexpr double kAtPlaceShare = 0.5;
// Ratio of box areas from which on the smaller object may lie on the larger one.
constexpr double kSupportRatio = 3.0;
constexpr double kFilled = 0.6;  // share of a box that its segment's bounding box covers to fill it

struct Segment
{
  int detection;
  Pixels pixels, others;
};

std::size_t num_shared(const Pixels& pixels, const Pixels& others)
{
  std::size_t num = 0;
  auto other = others.begin();
  for (const int64_t pixel : pixels) {
    other = std::find_if(other, others.end(), [&](int64_t next) { return next >= pixel; });
    num += other != others.end() && *other == pixel ? 1 : 0;
  }
  return num;
}

class Segmentation
{
public:
  Segmentation(const DepthPoints& image, const Detections& detections)
  : image_(image), detections_(detections), taken_(image.depth_m.size(), 0)
  {
  }

  // Return the segments of all detections that have enough readings, also of people.
  std::vector<Segment> segments(const int32_t* owner)
  {
    std::vector<Segment> out;
    for (int d = 0; d < detections_.boxes_px.count; ++d) {
      take_known(owner, d);
      if (auto found = segment(d)) {
        out.push_back(std::move(*found));
      }
    }
    return out;
  }

  // Where two segments claim the same surface, the loser is segmented again without that of the
  // winners; it has no pixels if too few are left. A person keeps its pixels.
  void resolve(std::vector<Segment>& segments)
  {
    std::vector<std::pair<bool, double>> claims;
    for (const Segment& segment : segments) {
      claims.push_back(claim(segment));
    }
    std::map<std::size_t, std::vector<std::size_t>> winners;
    for (std::size_t i = 0; i < segments.size(); ++i) {
      for (std::size_t j = 0; j < i; ++j) {
        if (are_same_surface(segments[i], segments[j])) {
          const auto [loser, winner] = claims[i] < claims[j] ? std::pair{i, j} : std::pair{j, i};
          if (!is_person(segments[loser])) {
            winners[loser].push_back(winner);
          }
        }
      }
    }
    std::vector<std::pair<std::size_t, std::optional<Segment>>> again;
    for (const auto& [loser, others] : winners) {
      std::fill(taken_.begin(), taken_.end(), 0);
      for (const std::size_t winner : others) {
        for (const int64_t pixel : segments[winner].pixels) {
          taken_[pixel] = 1;
        }
      }
      again.emplace_back(loser, segment(segments[loser].detection));
    }
    for (auto& [loser, found] : again) {
      if (found) {
        segments[loser] = std::move(*found);
      } else {
        segments[loser].pixels.clear();
      }
    }
  }

  bool is_person(const Segment& segment) const
  {
    return detections_.is_person[segment.detection] != 0;
  }

private:
  PixelBox box(int d) const { return pixel_box(detections_.boxes_px[d]); }

  float depth(int64_t pixel) const { return image_.depth_m.data[pixel]; }

  // Mark the pixels of the box that show known objects of other detections as taken.
  //
  // Pixels of a support whose box is at least three times as large are not: the object of detection
  // `d` may lie on it, and the surface below is removed as a plane.
  void take_known(const int32_t* owner, int d)
  {
    box(d).each_pixel(image_.depth_m.width, [&](int64_t pixel) {
      const int32_t o = owner[pixel];
      taken_[pixel] = o >= 0 && o != d &&
                      (detections_.is_support[o] == 0 ||
                       detections_.areas_px[o] < kSupportRatio * detections_.areas_px[d]);
    });
  }

  // Return the segment of a detection in the pixels that are not taken, if they are enough.
  std::optional<Segment> segment(int d)
  {
    const PixelBox area = box(d);
    Pixels everything, pixels;
    area.each_pixel(image_.depth_m.width, [&](int64_t pixel) {
      if (depth(pixel) != 0) {
        everything.push_back(pixel);
        if (!taken_[pixel]) {
          pixels.push_back(pixel);
        }
      }
    });
    if (pixels.size() < kMinReadings) {
      return std::nullopt;
    }
    if (!detections_.is_person[d]) {
      pixels = without_planes(pixels, d, everything.size());
    }
    Segment out{d, {}, {}};
    std::set_difference(
      everything.begin(), everything.end(), pixels.begin(), pixels.end(),
      std::back_inserter(out.others));
    out.pixels = part(pixels, area, d);
    if (out.pixels.size() < kMinReadings) {
      return std::nullopt;
    }
    return out;
  }

  // Return the pixels that are not on a plane around the box. Those on a plane are kept if too few
  // others would remain of an object that may be flat, and if they fill its box.
  Pixels without_planes(const Pixels& pixels, int d, std::size_t num_readings) const
  {
    Pixels rest = pixels, ring = ring_of(box(d), pixels);
    std::mt19937 random;
    const bool may_be_flat = detections_.may_be_flat[d] != 0;
    const double least_ring = std::max<double>(
      kMinReadings, kMinPlaneShare * static_cast<double>(ring.size()));
    const double least_rest = std::max<double>(
      kMinReadings, kMinRest * static_cast<double>(pixels.size()));
    for (int k = 0; k < kMaxPlanes && static_cast<double>(ring.size()) >= least_ring; ++k) {
      const std::optional<Plane> plane = best_plane(image_, ring, random);
      const Pixels ring_left = plane ? without(*plane, ring, 1.0) : ring;
      if (static_cast<double>(ring.size() - ring_left.size()) < least_ring) {
        break;
      }
      Pixels left = without(*plane, rest, may_be_flat ? 1.0 : kNoiseScale);
      const auto num_on_plane = static_cast<double>(rest.size() - left.size());
      const bool is_flat =
        may_be_flat && num_on_plane >= kFlatShare * static_cast<double>(num_readings);
      if (static_cast<double>(left.size()) >= least_rest || !is_flat) {
        rest = std::move(left);
      }
      ring = ring_left;
    }
    return rest;
  }

  Pixels without(const Plane& plane, const Pixels& pixels, double scale) const
  {
    Pixels out;
    std::copy_if(pixels.begin(), pixels.end(), std::back_inserter(out), [&](int64_t pixel) {
      return !is_on(plane, image_, pixel, scale);
    });
    return out;
  }

  // Return pixels around a box that have about the range of depth of those inside it.
  Pixels ring_of(const PixelBox& area, const Pixels& inside) const
  {
    const auto margin = static_cast<int>(
      std::clamp(std::nearbyint(kRingShare * area.side()), kRingLeastPx, kRingMostPx));
    float low = std::numeric_limits<float>::infinity(), high = 0;
    for (const int64_t pixel : inside) {
      low = std::min(low, depth(pixel));
      high = std::max(high, depth(pixel));
    }
    low *= 0.9F;
    high *= 1.1F;
    const Image<float>& depth_m = image_.depth_m;
    Pixels found;
    for (int v = std::max(0, area.top - margin); v < std::min(depth_m.height, area.bottom + margin);
         ++v) {
      const bool is_beside = v >= area.top && v < area.bottom;
      for (int u = std::max(0, area.left - margin); u < std::min(depth_m.width, area.right + margin);
           ++u) {
        if (is_beside && u == area.left) {
          u = std::max(u, area.right - 1);
          continue;
        }
        const float reading = depth_m.row(v)[u];
        if (reading > low && reading < high) {
          found.push_back(static_cast<int64_t>(v) * depth_m.width + u);
        }
      }
    }
    const std::size_t step = 1 + found.size() / kMaxRing;
    Pixels out;
    for (std::size_t n = 0; n < found.size(); n += step) {
      out.push_back(found[n]);
    }
    return out;
  }

  // Return the pixels of the object: its nearest part, or its visible pixels behind an occluder.
  //
  // The latter are the pixels in the known box, if less than half of the nearest part is among them.
  Pixels part(const Pixels& pixels, const PixelBox& area, int d)
  {
    Pixels nearest = nearest_part(image_, pixels, area.side()), at_place;
    const double *low = detections_.known_low_m[d], *high = detections_.known_high_m[d];
    if (!(low[0] < high[0])) {
      return nearest;
    }
    std::copy_if(pixels.begin(), pixels.end(), std::back_inserter(at_place), [&](int64_t pixel) {
      return is_in_box(detections_.T_box_map[d], low, high, image_.points_m[pixel]);
    });
    if (at_place.size() < kMinReadings) {
      return nearest;
    }
    const bool is_nearest = static_cast<double>(num_shared(nearest, at_place)) >=
                            kAtPlaceShare * static_cast<double>(nearest.size());
    return is_nearest ? nearest : at_place;
  }

  // Return whether two segments share much of their pixels.
  bool are_same_surface(const Segment& a, const Segment& b) const
  {
    const double least = is_person(a) || is_person(b) ? kSharedWithPerson : kShared;
    const auto smaller = std::min(a.pixels.size(), b.pixels.size());
    return static_cast<double>(num_shared(a.pixels, b.pixels)) >
           least * static_cast<double>(smaller);
  }

  // Return the sort key of a segment; the one with the larger key keeps the shared pixels.
  //
  // Boxes that are filled come before others, and the smaller box before the larger one. Among
  // boxes that are not filled, the one that is filled more comes first.
  std::pair<bool, double> claim(const Segment& segment) const
  {
    const int width = image_.depth_m.width;
    int left = width, right = 0;
    for (const int64_t pixel : segment.pixels) {
      const auto column = static_cast<int>(pixel % width);
      left = std::min(left, column);
      right = std::max(right, column);
    }
    const auto rows = segment.pixels.back() / width - segment.pixels.front() / width + 1;
    const PixelBox box_px = box(segment.detection);
    const double area = static_cast<double>(box_px.width()) * box_px.height();
    const double fit = static_cast<double>(rows) * (right - left + 1) / std::max(area, 1.0);
    return fit >= kFilled ? std::pair{true, -area} : std::pair{false, fit};
  }

  const DepthPoints& image_;
  const Detections& detections_;
  std::vector<uint8_t> taken_;  // valid in the box of the present detection
};

void add_points(const DepthPoints& image, const Pixels& pixels, Surfaces& out)
{
  for (const int64_t pixel : pixels) {
    const double* p = image.points_m[pixel];
    out.points_m.insert(out.points_m.end(), p, p + 3);
  }
  std::vector<double> values(pixels.size());
  for (int axis = 0; axis < 3; ++axis) {
    std::transform(pixels.begin(), pixels.end(), values.begin(), [&](int64_t pixel) {
      return image.points_m[pixel][axis];
    });
    const auto [low, high] = std::minmax_element(values.begin(), values.end());
    out.low_m.push_back(*low);
    out.high_m.push_back(*high);
    out.center_m.push_back(median(values));
  }
}

}  // namespace

Surfaces object_surfaces(
  const DepthPoints& image, const Detections& detections, const int32_t* owner)
{
  Segmentation segmentation(image, detections);
  std::vector<Segment> segments = segmentation.segments(owner);
  segmentation.resolve(segments);
  Surfaces out;
  for (const Segment& segment : segments) {
    if (segmentation.is_person(segment) || segment.pixels.empty()) {
      continue;
    }
    out.detection.push_back(segment.detection);
    out.pixels.insert(out.pixels.end(), segment.pixels.begin(), segment.pixels.end());
    out.pixels_end.push_back(static_cast<int64_t>(out.pixels.size()));
    out.others.insert(out.others.end(), segment.others.begin(), segment.others.end());
    out.others_end.push_back(static_cast<int64_t>(out.others.size()));
    add_points(image, segment.pixels, out);
  }
  return out;
}

}  // namespace hoid::objects
