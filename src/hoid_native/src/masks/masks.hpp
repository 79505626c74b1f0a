// What moves in an image: boxes and how they touch, how far away what they show is, and the pixels
// that show it.
#pragma once

#include <cstdint>
#include <vector>

#include "common/image.hpp"

namespace hoid::masks {

// Roles of boxes; any other number is none.
constexpr uint8_t kPerson = 1, kMayBeHandled = 2;

// Write the (count, count_others) shares of each box's own area that lie in each of the others; 0
// without area.
void overlap_ratios(const Boxes& boxes, const Boxes& others, double* ratio_out);

// Write the (count, count_others) ratios of shared area to joint area; 0 without area.
void intersections_over_union(const Boxes& boxes, const Boxes& others, double* ratio_out);

// Return whether all boxes (x1, y1, x2, y2) have an area, lie inside the image and have scores in
// [0, 1].
bool are_boxes_fit(int width, int height, int count, const float* boxes, const float* scores);

// When a person handles an object: by covering more than `min_share` of it, or, where a reach is
// given (not NaN), when a pixel of the object has a part of the person within reach along rows and
// columns; and when both are less than `apart_m` apart in depth. A depth that is not known is
// near.
struct HandlingRule
{
  double min_share, apart_m, reach_px;
};

struct Judged
{
  std::vector<double> depth_m;  // median at the centre of each box; NaN without readings
  std::vector<double> overlap;  // with the person who handles an object and covers most of it
  std::vector<double> gap_m;    // in depth to the same; NaN = unknown
  std::vector<uint8_t> moves;   // roles of those that move; 0 = static
  std::vector<int64_t>
    outside;        // of the pixels, ascending, those with their centre in no moving box
  int64_t area_px;  // how many pixels of the whole image are outside
};

// Judge boxes by the rules of the HOID paper. Pixels are given as indices in the flat image.
Judged judge_boxes(
  const Image<float>& depth_m, const Boxes& boxes, const uint8_t* roles, int side_px,
  const HandlingRule& rule, const int64_t* pixels, int num_pixels);

// Write the median reading of a square at the centre of each box. Readings are positive; 0 and NaN
// are none.
void sample_depths(
  const Image<float>& depth_m, const Boxes& boxes, int side_px, double* median_m_out);

// Write the reading at each pixel (x, y) of the image, or 0 where there is none or an edge is
// near: where readings in the square around it differ by more than a share of it. Readings are
// positive; 0 and NaN are none.
void depths_off_edges(
  const Image<float>& depth_m, const int32_t* pixels_xy, int count, int radius_px, double step,
  float* depth_m_out);

// Write the depth of the person in each box, or NaN when there is no reading. A person was known
// to be at some depth a moment ago, or not (NaN).
void torso_depths(
  const Image<float>& depth_m, const Boxes& boxes, const double* known_m, double* torso_m_out);

// Things that may move.
struct Things
{
  const int32_t* areas;        // (count, 4) x1, y1, x2, y2 of whole pixels within the image
  const double* depths_m;      // NaN = unknown
  const double* reaches_m;     // how far they reach before and behind their depth
  const uint8_t* certainties;  // how sure it is that they move
  const uint8_t* seen;         // not 0: there, not only expected there
  int count;
};

// Write how sure it is, for each pixel of a depth image, that it shows something that moves; 0 =
// static.
//
// A thing is the regions that lie mostly in its area and near its depth, with the gaps between
// them; it may reach a little out of its area, no further: a box misses a hand, and what lies
// beyond is the desk that the hand has merged with. When its regions are too little of an area
// where it was seen, it has merged as a whole: then every pixel of the area within reach counts.
// Without a depth a thing is its area.
void cover_things(const Image<float>& depth_m, const Things& things, uint8_t* certainty_out);

// Write 1 for the pixels that have one that is not 0 within reach along rows and columns, 0 for
// the others.
void widen(const Image<uint8_t>& mask, int reach, uint8_t* out);

// How a small image covers a larger one: which of its rows and columns each row and column of that
// shows.
struct Magnification
{
  const int64_t *rows, *columns;
  int width;  // of the large image
};

// Write the values of the small image at pixels of the large one, given as indices in its flat
// form.
void values_at(
  const Image<uint8_t>& values, const Magnification& magnification, const int64_t* pixels,
  int num_pixels, uint8_t* value_out);

}  // namespace hoid::masks
