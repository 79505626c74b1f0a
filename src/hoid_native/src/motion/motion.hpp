// Motion segmentation from depth images of different times: depth segments, their occlusion of
// earlier depth, log-odds of motion, and pose hypotheses (decision 027).
#pragma once

#include <cstdint>
#include <vector>

#include "common/image.hpp"
#include "optimize/optimize.hpp"

namespace hoid::motion {

// A pinhole camera without distortion.
struct Pinhole
{
  double fx_px, fy_px, cx_px, cy_px;
};

// A current depth image (0 = no measurement), and its pose in the frame of an earlier image of the
// same camera and size.
struct ViewPair
{
  Pinhole camera;
  const double* T_earlier_now;  // (4, 4)
  Image<float> depth_m;         // the current image
};

// Segments of a depth image: smooth regions, cut along a grid of square cells.
struct Segments
{
  std::vector<int32_t> label;   // segment of each pixel; -1: on a depth jump, or no measurement
  std::vector<int32_t> region;  // smooth region of each segment
  std::vector<int32_t> area_px;
};

// Evidence of motion from the ratio of a segment that occludes earlier depth.
struct OcclusionEvidence
{
  double occluding;            // log-odds of a segment that occludes with all its pixels
  double min_occluding_share;  // up to this share, occlusion at the segment's edges: no evidence
  double mixed_share;  // from this share on, equal depth of the other pixels is no evidence
  double agreeing;     // log-odds against motion of a segment that has the earlier depth
};

// Tolerated depth difference: a polynomial in the depth.
struct DepthMargin
{
  float constant_m, linear, square_per_m;

  float at(float depth_m) const
  {
    return constant_m + depth_m * (linear + depth_m * square_per_m);
  }
};

// Return the segments of a depth image for square cells of `cell_px`.
Segments depth_segments(const Image<float>& depth_m, int cell_px);

// Add the evidence of one earlier view to the log-odds of segments. A segment in front of the depth
// in the earlier view has moved there since; a segment behind this depth is no evidence. Only every
// other row is compared, to save time. `range_m` (H, W, 2) is the earlier view's `depth_ranges_3x3`;
// labels are below the number of log-odds.
void add_occlusion_evidence(
  const ViewPair& views, const int32_t* label, const float* range_m, const DepthMargin& margin,
  const OcclusionEvidence& evidence, std::vector<double>& log_odds);

// Log-odds of motion to add to the segments of an image.
struct SegmentEvidence
{
  const int32_t* label;  // segment of each pixel; -1: none
  const float* log_odds;  // (num_segments)
  int num_segments;
  float limit;  // the log-odds of a pixel stay within [-limit, limit]
};

// Write the (H, W) log-odds of motion of the current pixels: those of the same surface in the
// previous image times `decay`, plus the evidence. Pixels whose previous image showed another
// depth start at 0; pixels without depth have 0.
void propagate_log_odds(
  const ViewPair& views, const float* previous_m, const float* log_odds, const DepthMargin& margin,
  float decay, const SegmentEvidence& evidence, float* log_odds_out);

// Write the (H, W, 2) minimum and maximum depth in the 3x3 pixels around each pixel with depth; 0
// at the others.
void depth_ranges_3x3(const Image<float>& depth_m, float* range_m);

// Points with their measurements in one image.
struct Points
{
  const double* points_m;     // (count, 3)
  const double* measured_px;  // (count, 3) u, v, u_right; NaN u_right: no depth
  const double* weights;      // (count, 2)
  int count;
};

// Write the (num_poses, 2) sums of the weights of the points that each pose explains, for two sets
// of weights. A point counts 1 - (residual / limit)^2, and nothing beyond `limit` standard
// deviations. That of u and v is `pixel_px`; that of the disparity is `disparity_noise_px` of the
// camera, in units of `pixel_px`.
void score_poses(
  const optimize::StereoParams& camera, double pixel_px, double limit,
  const double* T_camera_world, int num_poses, const Points& points, double* score_out);

// Write the (count, 4, 4) rigid transforms T_to_from that align point triples in the least-squares
// sense (Umeyama, PAMI 1991, without scale); the identity for three points on a line.
void align_triples(
  const double* from_m, const double* to_m, const int64_t* triples, int count, double* T_out);

// The corners of an image, its depth, and the segments of its downscaled image.
struct CornersOnDepth
{
  const int64_t* pixel;  // (count) flat indices
  const uint8_t* score;
  int count;
  Image<float> depth_m;           // 0 or not finite = no measurement
  const int64_t* small_of_pixel;  // flat index in the downscaled image of each pixel
  const int32_t* label;           // segment of each pixel of the downscaled image; -1 = none
  int64_t label_count;

  bool is_smooth(int64_t at) const
  {
    const int64_t small = small_of_pixel[at];
    return small >= 0 && small < label_count && label[small] >= 0;
  }
};

// A grid of square cells over an image, row by row.
struct CellGrid
{
  double cell_px;  // side of a cell
  int columns;
  const uint8_t* taken;  // (count) not 0: no corner wanted
  int count;
};

// Return the index of the strongest corner on a segment in each free cell, in order of cells.
// Among equal scores the first corner wins.
std::vector<int64_t> strongest_corners_per_cell(const CornersOnDepth& seen, const CellGrid& grid);

}  // namespace hoid::motion
