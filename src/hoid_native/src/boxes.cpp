// Boxes (x1, y1, x2, y2): how much of them lies in others, and what the HOID paper says of them.

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "pixel_set.hpp"

extern "C" void hoid_sample_depths(
  const float*, int32_t, int32_t, int32_t, const double*, int32_t, double*);

namespace {

constexpr int kPerson = 1, kMayBeHandled = 2;  // roles

const double* box_at(const double* boxes, int n) { return boxes + 4 * static_cast<std::ptrdiff_t>(n); }

double side(double first, double last) { return std::max(last - first, 0.0); }

double area(const double* box) { return side(box[0], box[2]) * side(box[1], box[3]); }

double shared_area(const double* a, const double* b)
{
  return side(std::max(a[0], b[0]), std::min(a[2], b[2])) * side(std::max(a[1], b[1]), std::min(a[3], b[3]));
}

double ratio(double part, double whole) { return whole > 0 ? part / whole : 0.0; }

template <typename Visit>
void each_pair(int count, const double* boxes, int count_others, const double* others, Visit visit)
{
  for (int n = 0; n < count; ++n) {
    for (int m = 0; m < count_others; ++m) {
      visit(box_at(boxes, n), box_at(others, m));
    }
  }
}

std::vector<int> people_among(int count, const uint8_t* roles)
{
  std::vector<int> people;
  for (int n = 0; n < count; ++n) {
    if (roles[n] == kPerson) {
      people.push_back(n);
    }
  }
  return people;
}

// When a person touches an object: by the share of the object that the person covers, or where a reach is given
// (not NaN), because a pixel of the object has a part of the person within reach along rows and columns.
struct Touch
{
  double min_share, reach_px;
  PixelSet pixels;

  bool at(const double* object, const double* person, double overlap) const
  {
    if (std::isnan(reach_px)) {
      return overlap > min_share;
    }
    const double both[] = {
      std::max(object[0], person[0] - reach_px), std::max(object[1], person[1] - reach_px),
      std::min(object[2], person[2] + reach_px), std::min(object[3], person[3] + reach_px)};
    return pixels.has_any_in(both);
  }
};

// How an object stands to the person who handles it and covers most of it.
struct Interaction
{
  bool handled = false;  // by anybody
  double overlap = 0, gap_m = std::numeric_limits<double>::quiet_NaN();
};

Interaction interaction(
  int object, const double* boxes, const double* depths_m, const std::vector<int>& people, const Touch& touch,
  double apart_m)
{
  Interaction found;
  const double* box = box_at(boxes, object);
  double most = -1;
  for (const int person : people) {
    const double overlap = ratio(shared_area(box, box_at(boxes, person)), area(box));
    const double gap_m = std::abs(depths_m[object] - depths_m[person]);
    const bool apart = gap_m >= apart_m;  // NaN: not
    const bool by_this = touch.at(box, box_at(boxes, person), overlap) && !apart;
    if (overlap + by_this > most) {
      most = overlap + by_this;
      found = {found.handled, overlap, gap_m};
    }
    found.handled = found.handled || by_this;
  }
  return found;
}

}  // namespace

// Write the (count, count_others) shares of each box's own area that lie in each of the others; 0 without area.
extern "C" void hoid_overlap_ratios(
  int32_t count, const double* boxes, int32_t count_others, const double* others, double* ratio_out)
{
  each_pair(count, boxes, count_others, others, [&](const double* box, const double* other) {
    *ratio_out++ = ratio(shared_area(box, other), area(box));
  });
}

// Write the (count, count_others) ratios of shared area to joint area; 0 without area.
extern "C" void hoid_intersections_over_union(
  int32_t count, const double* boxes, int32_t count_others, const double* others, double* ratio_out)
{
  each_pair(count, boxes, count_others, others, [&](const double* box, const double* other) {
    const double shared = shared_area(box, other);
    *ratio_out++ = ratio(shared, area(box) + area(other) - shared);
  });
}

// Return whether all boxes have an area, lie inside the image and have scores in [0, 1].
extern "C" int32_t hoid_are_boxes_fit(
  int32_t width, int32_t height, int32_t count, const float* boxes, const float* scores)
{
  bool fit = true;
  for (int n = 0; n < count; ++n) {
    const float* box = boxes + 4 * static_cast<std::ptrdiff_t>(n);
    fit &= 0 <= box[0] && box[0] < box[2] && box[2] <= width;  // false for NaN
    fit &= 0 <= box[1] && box[1] < box[3] && box[3] <= height;
    fit &= 0 <= scores[n] && scores[n] <= 1;
  }
  return static_cast<int32_t>(fit);
}

// Judge boxes by the rules of the HOID paper; each is a person (role 1), may be handled (2), or neither (0).
//
// A person handles an object of which it covers more than `min_share`, or which has a pixel within `reach_px` of the
// person where that is given (not NaN), unless they are `apart_m` or more apart in depth. Write in rows of `count`
// values: depths; overlap with and depth gap to the person who handles the object and covers most of it, 0 and NaN
// for people. Write the role of what moves, 0 for the rest.
//
// Of pixels, given as indices in the flat image, write which lie in no box that moves: their places among the
// pixels, ascending. Return how many these are, and write how many pixels of the whole image are in none.
extern "C" MULTIVERSION("avx2") int32_t hoid_judge_boxes(
  const float* depth_m, int32_t width, int32_t height, int32_t count, const double* boxes, const uint8_t* roles,
  int32_t side_px, double min_share, double apart_m, double reach_px, int32_t num_pixels, const int64_t* pixels,
  double* out, uint8_t* moves_out, int64_t* place_out, int64_t* area_out)
{
  hoid_sample_depths(depth_m, width, height, count, boxes, side_px, out);
  const std::vector<int> people = people_among(count, roles);
  Touch touch{min_share, reach_px, PixelSet(width, height)};
  for (int k = 0; k < num_pixels && !std::isnan(reach_px); ++k) {
    touch.pixels.add(pixels[k]);
  }
  PixelSet moving(width, height);
  for (int n = 0; n < count; ++n) {
    const Interaction found = interaction(n, boxes, out, people, touch, apart_m);
    const bool is_person = roles[n] == kPerson, moves = is_person || (found.handled && roles[n] == kMayBeHandled);
    out[count + n] = is_person ? 0 : found.overlap;
    out[2 * count + n] = is_person ? std::numeric_limits<double>::quiet_NaN() : found.gap_m;
    moves_out[n] = moves ? roles[n] : 0;
    if (moves) {
      moving.add_box(box_at(boxes, n));
    }
  }
  *area_out = static_cast<int64_t>(width) * height - moving.size();
  int32_t num_outside = 0;
  for (int k = 0; k < num_pixels; ++k) {
    place_out[num_outside] = k;  // overwritten by the next when this one is inside: no branch to predict
    num_outside += static_cast<int32_t>(!moving.has(pixels[k]));
  }
  return num_outside;
}
