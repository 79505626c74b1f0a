// Overlap of boxes (x1, y1, x2, y2), and their classification by the rules of the HOID paper.

#include <algorithm>
#include <cmath>
#include <limits>

#include "common/multiversion.hpp"
#include "common/pixel_box.hpp"
#include "masks/masks.hpp"

namespace hoid::masks {

namespace {

double side(double first, double last)
{
  return std::max(last - first, 0.0);
}

double area(const double* box)
{
  return side(box[0], box[2]) * side(box[1], box[3]);
}

double shared_area(const double* a, const double* b)
{
  return side(std::max(a[0], b[0]), std::min(a[2], b[2])) *
         side(std::max(a[1], b[1]), std::min(a[3], b[3]));
}

double ratio(double part, double whole)
{
  return whole > 0 ? part / whole : 0.0;
}

template <typename Visit>
void each_pair(const Boxes& boxes, const Boxes& others, Visit visit)
{
  for (int n = 0; n < boxes.count; ++n) {
    for (int m = 0; m < others.count; ++m) {
      visit(boxes[n], others[m]);
    }
  }
}

// Return the pixels of an image with their center in a box, which may extend beyond the image.
PixelBox pixels_in(const double* box, const Image<float>& image)
{
  // The first row or column with its center at or after a position.
  const auto first_from = [](double place_px, int size) {
    return static_cast<int>(std::clamp(std::ceil(place_px), 0.0, static_cast<double>(size)));
  };
  return {
    first_from(box[0], image.width), first_from(box[1], image.height),
    first_from(box[2], image.width), first_from(box[3], image.height)};
}

// Tests whether a person's box touches an object's box, by share or by reach (see HandlingRule).
struct TouchTest
{
  const HandlingRule& rule;
  const Image<float>& image;
  const Rows<int64_t>& pixels;

  bool is_true(const double* object, const double* person, double overlap) const
  {
    if (std::isnan(rule.reach_px)) {
      return overlap > rule.min_share;
    }
    const double within_reach[] = {
      std::max(object[0], person[0] - rule.reach_px),
      std::max(object[1], person[1] - rule.reach_px),
      std::min(object[2], person[2] + rule.reach_px),
      std::min(object[3], person[3] + rule.reach_px)};
    const PixelBox area = pixels_in(within_reach, image);
    return std::any_of(pixels.begin(), pixels.end(), [&](int64_t pixel) {
      return area.contains(pixel % image.width, pixel / image.width);
    });
  }
};

// The interaction of an object with the person whose box covers most of it, among the people who
// handle it or, if nobody does, among all people.
struct Interaction
{
  bool handled = false;  // by any person
  double overlap = 0, gap_m = std::numeric_limits<double>::quiet_NaN();
};

Interaction find_interaction(
  int object, const Boxes& boxes, const uint8_t* roles, const std::vector<double>& depths_m,
  const TouchTest& touch)
{
  Interaction found;
  const double* box = boxes[object];
  double most = -1;
  for (int person = 0; person < boxes.count; ++person) {
    if (roles[person] != kPerson) {
      continue;
    }
    const double overlap = ratio(shared_area(box, boxes[person]), area(box));
    const double gap_m = std::abs(depths_m[object] - depths_m[person]);
    const bool apart = gap_m >= touch.rule.apart_m;  // false for an unknown depth (NaN)
    const bool by_this = touch.is_true(box, boxes[person], overlap) && !apart;
    if (overlap + by_this > most) {
      most = overlap + by_this;
      found = {found.handled, overlap, gap_m};
    }
    found.handled = found.handled || by_this;
  }
  return found;
}

}  // namespace

void overlap_ratios(const Boxes& boxes, const Boxes& others, double* ratio_out)
{
  each_pair(boxes, others, [&](const double* box, const double* other) {
    *ratio_out++ = ratio(shared_area(box, other), area(box));
  });
}

void intersections_over_union(const Boxes& boxes, const Boxes& others, double* ratio_out)
{
  each_pair(boxes, others, [&](const double* box, const double* other) {
    const double shared = shared_area(box, other);
    *ratio_out++ = ratio(shared, area(box) + area(other) - shared);
  });
}

MULTIVERSION("avx2")
ClassifiedBoxes classify_boxes(
  const Image<float>& depth_m, const Boxes& boxes, const uint8_t* roles, int side_px,
  const HandlingRule& rule, const Rows<int64_t>& pixels)
{
  const int count = boxes.count;
  ClassifiedBoxes out{
    std::vector<double>(count),
    std::vector<double>(count, 0.0),
    std::vector<double>(count, std::numeric_limits<double>::quiet_NaN()),
    std::vector<uint8_t>(count, 0),
    std::vector<int64_t>(pixels.count),
    0};
  box_center_depths(depth_m, boxes, side_px, out.depth_m.data());
  const TouchTest touch{rule, depth_m, pixels};
  std::vector<uint8_t> is_moving(depth_m.size());  // whether each pixel moves
  for (int n = 0; n < count; ++n) {
    const Interaction found = find_interaction(n, boxes, roles, out.depth_m, touch);
    const bool is_person = roles[n] == kPerson;
    if (!is_person) {
      out.overlap[n] = found.overlap;
      out.gap_m[n] = found.gap_m;
    }
    if (is_person || (found.handled && roles[n] == kMayBeHandled)) {
      out.moves[n] = roles[n];
      pixels_in(boxes[n], depth_m)
        .each_pixel(depth_m.width, [&](int64_t pixel) { is_moving[pixel] = 1; });
    }
  }
  out.area_px = std::count(is_moving.begin(), is_moving.end(), 0);
  std::size_t num_outside = 0;
  for (int k = 0; k < pixels.count; ++k) {
    // Without a branch to predict: the next position overwrites this one if this pixel is inside.
    out.outside[num_outside] = k;
    num_outside += static_cast<std::size_t>(is_moving[pixels[k]] == 0);
  }
  out.outside.resize(num_outside);
  return out;
}

}  // namespace hoid::masks
