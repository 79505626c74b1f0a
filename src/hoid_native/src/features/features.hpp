// ORB features (Rublee et al., ICCV 2011): FAST corners, an even selection of them, subpixel
// positions, orientations and descriptors.
#pragma once

#include <cstdint>
#include <vector>

#include "common/descriptors.hpp"
#include "common/views.hpp"

namespace hoid::features {

// Smallest distance from the image's edge at which each kernel may be called; it follows from the
// pixels that the kernel reads.
constexpr int kSubpixelBorderPx = 4;    // FAST circle (3 px) around each of the 3x3 pixels
constexpr int kOrientationBorderPx = 15;  // radius of ORB's disc
constexpr int kDescriptorBorderPx = 19;   // ORB's pattern of +-13 px, rotated and rounded

struct Pyramid
{
  std::vector<Image<uint8_t>> levels;
  const float* steps_px;  // (levels, 2) level-0 pixels per pixel of each level, in x and y
};

// FAST corners of a pyramid, level by level in raster order. The score is the largest threshold at
// which the pixel is still a corner.
struct Corners
{
  std::vector<int32_t> xy_px;  // (count, 2) pixels of their own level
  std::vector<double> uv_px;   // (count, 2) pixels of level 0
  std::vector<int64_t> pixel;  // flat index of the nearest level-0 pixel
  std::vector<uint8_t> octave, score;
};

// Pixels (x, y) of an image. The caller checks their distance from its edge.
struct Pixels
{
  const int32_t *x, *y;
  int count;
};

// Return the corners that are at least `border` pixels (at least 3) from the edge of their level.
// A level has none if it is less than 32 px wide or high without the border.
Corners detect_fast(const Pyramid& pyramid, int threshold, int border);

// Write the (count, 2) offset (x, y) from each corner to the subpixel peak of its score, in
// pixels.
void subpixel_offsets(const Image<uint8_t>& image, const Pixels& corners, float* offset_out);

// Write the (count,) orientation of each corner: degrees in [0, 360), clockwise from the x axis.
void orientations(const Image<uint8_t>& image, const Pixels& corners, float* angle_deg_out);

// Write the (count, 32) descriptor of each corner of a smoothed image.
void orb_descriptors(
  const Image<uint8_t>& image, const Pixels& corners, const float* angle_deg, uint8_t* out);

// Corners of several octaves, with positions on level 0.
struct ScoredCorners
{
  Rows<double, 2> uv_px;  // not negative
  const uint8_t *octave, *score;
};

// Return the ascending indices of the corners to keep, spread evenly over `area_px`. Their number
// is at most the sum of the octaves' budgets (not negative).
std::vector<int64_t> spread_evenly(
  const ScoredCorners& corners, const Rows<int64_t>& budgets, double area_px);

}  // namespace hoid::features
