// ORB features: FAST corners, which of them to take, where between the pixels they peak, which way
// they point, and what they look like.
#pragma once

#include <cstdint>
#include <vector>

#include "common/image.hpp"

namespace hoid::features {

constexpr int kPeakBorderPx = 4;  // what each kernel reads around a pixel
constexpr int kOrientationBorderPx = 15;
constexpr int kDescriptorBorderPx = 19;
constexpr int kDescriptorBytes = 32;

struct Pyramid
{
  std::vector<Image<uint8_t>> levels;
  const float* steps_px;  // (levels, 2) level-0 pixels per pixel of each level, in x and y
};

// FAST corners of the levels of a pyramid, level by level in raster order; a score is the largest
// threshold at which a pixel still is a corner.
struct Corners
{
  std::vector<int32_t> xy_px;  // (count, 2) pixels of their own level
  std::vector<double> uv_px;   // (count, 2) pixels of level 0
  std::vector<int64_t> pixel;  // nearest in the flat level 0
  std::vector<uint8_t> octave, score;
};

// Pixels of an image, far enough from its edge.
struct Pixels
{
  const int32_t *x, *y;
  int count;
};

// The corners that are at least `border` (>= 3) pixels from the edge of their level.
Corners detect_fast(const Pyramid& pyramid, int threshold, int border);

// Write the offset (x, y) from each corner to the peak of its score.
void corner_peaks(const Image<uint8_t>& image, const Pixels& corners, float* offset_out);

// Write the angle (degrees, [0, 360), y down) of each corner.
void orientations(const Image<uint8_t>& image, const Pixels& corners, float* angle_deg_out);

// Write the descriptor of each corner of a smoothed image.
void orb_descriptors(
  const Image<uint8_t>& image, const Pixels& corners, const float* angle_deg, uint8_t* out);

// Corners of several octaves, by their place on the finest.
struct ScoredCorners
{
  const double* uv_px;  // (count, 2), not negative
  const uint8_t *octave, *score;
  int count;
};

// Return the indices, ascending, of as many corners as the budgets of octaves, which are not
// negative, add up to, spread over an area.
std::vector<int64_t> spread_evenly(
  const ScoredCorners& corners, const int64_t* budgets, int num_octaves, double area_px);

}  // namespace hoid::features
