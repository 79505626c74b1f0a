// What moves, seen in depth images of different times: pieces of an image, what they are in front
// of, and poses held against points.
#pragma once

#include <cstdint>
#include <vector>

#include "common/image.hpp"
#include "optimize/optimize.hpp"

namespace hoid::motion {

// A camera without distortion.
struct Pinhole
{
  double fx_px, fy_px, cx_px, cy_px;
};

// Two depth images of one camera and size; 0 = no reading.
struct Views
{
  Pinhole camera;
  const double* T_earlier_now;  // (4, 4)
  Image<float> depth_m;         // of now
};

// Pieces of a depth image: smooth regions, cut along a grid of square cells.
struct Segments
{
  std::vector<int32_t> label;   // of each pixel; -1: on a jump of depth, or no reading
  std::vector<int32_t> region;  // of each segment
  std::vector<int32_t> area_px;
};

// What it is worth that so large a share of a segment is in front of what was seen earlier.
struct FrontWorth
{
  double front;        // log-odds of a segment all of which is
  double least_front;  // share that is more than a segment's edges
  double mixed;        // share from which on what agrees says nothing
  double rest;         // log-odds against a segment all of which is where something was seen
};

// How far depths may be apart: a constant and shares of the depth and of its square.
struct Margin
{
  float constant_m, linear, square_per_m;

  float at(float depth_m) const
  {
    return constant_m + depth_m * (linear + depth_m * square_per_m);
  }
};

Segments depth_segments(const Image<float>& depth_m, int cell_px);

// Hold the pixels of segments, in every other row, against an earlier view: the least and the most
// depth around each of its pixels, 0 where nothing was measured. Labels are less than the number of
// segments, to whose log-odds of moving the evidence is added.
void add_front_evidence(
  const Views& views, const int32_t* label, const float* range_m, const Margin& margin,
  const FrontWorth& worth, std::vector<double>& log_odds);

// Return the depth at each of some flat pixels, 0 at those of -1 and where it is not finite.
std::vector<float> depths_at(const Image<float>& depth_m, const int64_t* pixels, int count);

// What speaks for or against segments.
struct Evidence
{
  const int32_t* label;     // of each pixel; -1: nothing
  const float* of_segment;  // log-odds
  int num_segments;
  float limit;  // of the log-odds of pixels
};

// Write log-odds of pixels: what they had in the view before, unless that showed something else in
// their place, times `fade`, and the evidence; 0 without depth.
void carry_over(
  const Views& views, const float* before_m, const float* odds, const Margin& margin, float fade,
  const Evidence& evidence, float* odds_out);

// Write the least and the most depth, side by side, in the 3x3 pixels around each that has depth;
// 0 around others.
void depths_around(const Image<float>& depth_m, float* range_m);

// Points as an image shows them.
struct Points
{
  const double* points_m;     // (count, 3)
  const double* measured_px;  // (count, 3) u, v, u_right; NaN u_right: no depth
  const double* weights;      // (count, 2)
  int count;
};

// Write the (num_poses, 2) weights that poses explain, by two sets of weights. A point counts less
// the worse it fits, and nothing beyond so many standard deviations.
void score_poses(
  const optimize::StereoParams& camera, double pixel_px, double limit,
  const double* T_camera_world, int num_poses, const Points& points, double* score_out);

// Write the (count, 4, 4) rigid transforms that bring three of some points nearest to the same of
// others, in the least squares sense; that of three on a line is the identity.
void align_triples(
  const double* from_m, const double* to_m, const int64_t* triples, int count, double* T_out);

// Corners of an image, its depth, and the pieces of its small image.
struct CornersOnDepth
{
  const int64_t* pixel;  // (count,) flat
  const uint8_t* score;
  int count;
  Image<float> depth_m;           // 0 or not finite = no reading
  const int64_t* small_of_pixel;  // flat, of each pixel
  const int32_t* label;           // of each pixel of the small image; -1 = no piece
  int64_t label_count;

  bool is_smooth(int64_t at) const
  {
    const int64_t small = small_of_pixel[at];
    return small >= 0 && small < label_count && label[small] >= 0;
  }
};

// Square cells of an image, row by row.
struct CellGrid
{
  double cell_px;
  int columns;
  const uint8_t* taken;
  int count;
};

// Return the strongest corner with smooth depth of each cell that is not taken, in order of cell;
// of equals, the first.
std::vector<int64_t> strongest_in_cells(const CornersOnDepth& seen, const CellGrid& grid);

}  // namespace hoid::motion
