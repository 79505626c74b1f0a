// Motion segmentation from depth images of different times: depth segments, their occlusion of
// earlier depth, log-odds of motion, and pose hypotheses (decision 027); registration of depth.
#pragma once

#include <cstdint>
#include <vector>

#include "common/views.hpp"
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
// other row is compared, to save time. `range_m` (H, W, 2) has the least and the greatest depth around
// each pixel of the earlier view, 0 without depth; labels are below the number of log-odds.
void add_occlusion_evidence(
  const ViewPair& views, const Image<int32_t>& label, const float* range_m,
  const DepthMargin& margin, const OcclusionEvidence& evidence, std::vector<double>& log_odds);

// Log-odds of motion to add to the segments of an image.
struct SegmentEvidence
{
  Image<int32_t> label;  // segment of each pixel; -1: none
  Rows<float> log_odds;
  float limit;  // the log-odds of a pixel stay within [-limit, limit]
};

// Write the (H, W) log-odds of motion of the current pixels: those of the previous image, decayed,
// plus the evidence of their segments.
void propagate_log_odds(
  const ViewPair& views, const float* previous_m, const float* log_odds, const DepthMargin& margin,
  float decay, const SegmentEvidence& evidence, float* log_odds_out);

// Points with their measurements in one image.
struct PointObservations
{
  Points points_m;
  Rows<double, 3> measured_px;  // u, v, u_right; NaN u_right: no depth
  Rows<double, 2> weights;
};

// Write two scores (num_poses, 2) of each pose: sums of both weights of the points, each times how
// well the pose explains the point, from 0 to 1.
void score_poses(
  const optimize::StereoParams& camera, double pixel_px, double limit,
  const Transforms& T_camera_world, const PointObservations& seen, double* score_out);

// Write the (count, 4, 4) rigid transforms T_to_from that align point triples.
void align_triples(
  const Points& from_m, const Points& to_m, const Rows<int64_t, 3>& triples, double* T_out);

// A depth image, and its camera in the frame of the target.
struct DepthSource
{
  Image<float> depth_m;  // 0, negative or NaN = no measurement
  const float* rays;     // (H, W, 3) ray of each pixel, with length 1 along the depth camera's axis
  const float* t_m;      // (3) position of the depth camera
  const float* side_px;  // (2) width and height of a depth pixel in target pixels, at equal depth
};

// The camera to which depth is registered.
struct Target
{
  Pinhole camera;
  int width, height;
};

// Write the depth that the target camera sees at each of its pixels, and leave the other pixels,
// which must be 0, as depth_image_proc's `register` does. A depth pixel covers as many target
// pixels as it is large; the nearest depth wins.
void register_depth(const DepthSource& source, const Target& target, float* depth_out);

}  // namespace hoid::motion
