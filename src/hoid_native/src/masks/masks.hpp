// Detection boxes: their overlap and interaction, the depth of their objects, and the pixels that
// show dynamic objects. Pixels given as one number are flat indices.
#pragma once

#include <cstdint>
#include <vector>

#include "common/views.hpp"

namespace hoid::masks {

// Roles of boxes: a person, and an object of a class that people may handle. Any other number:
// none.
constexpr uint8_t kPerson = 1, kMayBeHandled = 2;

// Write the (count, count_others) ratios of each box's area that each of the others covers: the
// interaction area of the HOID paper. 0 for a box without area.
void overlap_ratios(const Boxes& boxes, const Boxes& others, double* ratio_out);

// Write the (count, count_others) intersections over union of boxes; 0 for boxes without area.
void intersections_over_union(const Boxes& boxes, const Boxes& others, double* ratio_out);

// The rule by which a person handles an object: their depths differ by less than `apart_m` (an
// unknown depth counts as near), and the person's box covers more than `min_share` of the object's
// box. If `reach_px` is not NaN, it replaces the share: one of the given pixels must lie in the
// object's box, at most this far from the person's box along rows and columns.
struct HandlingRule
{
  double min_share, apart_m, reach_px;
};

// The classification of boxes; the fields are those of hoid_native.results.ClassifiedBoxes.
struct ClassifiedBoxes
{
  std::vector<double> depth_m, overlap, gap_m;
  std::vector<uint8_t> moves;
  std::vector<int64_t> outside;
  int64_t area_px;
};

// Classify boxes as dynamic or static by the rules of the HOID paper.
ClassifiedBoxes classify_boxes(
  const Image<float>& depth_m, const Boxes& boxes, const uint8_t* roles, int side_px,
  const HandlingRule& rule, const Rows<int64_t>& pixels);

// Write the median depth (m) of a square at the center of each box, NaN without a measurement.
void box_center_depths(
  const Image<float>& depth_m, const Boxes& boxes, int side_px, double* median_m_out);

// Write the depth (m) of the person in each box, NaN without a measurement. `known_m` is the
// person's depth in an earlier image, NaN = unknown.
void person_depths(
  const Image<float>& depth_m, const Boxes& boxes, const double* known_m, double* depth_m_out);

// Dynamic objects, from the boxes of a strategy.
struct Objects
{
  Rows<int32_t, 4> areas;   // whole pixels x1, y1, x2, y2 within the image
  const double* depths_m;   // NaN = unknown
  const double* reaches_m;  // largest depth difference, in front and behind, of their regions
  const uint8_t* seen;      // not 0: detected in this image; 0: predicted
};

// Write 1 for each pixel of a depth image that shows a dynamic object, and 0 for the others.
void segment_objects(const Image<float>& depth_m, const Objects& objects, uint8_t* dynamic_out);

}  // namespace hoid::masks
