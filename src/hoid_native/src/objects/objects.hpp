// The object map: the surface of each detected object in a depth image, and the voxels of an
// object. The image is small; its points are those of its pixels in the map frame. Pixels given as
// one number are flat indices. Parts of a table of rows, one after the other, are given by the
// index after the last row of each (`ends`).
#pragma once

#include <cstdint>
#include <vector>

#include "common/views.hpp"

namespace hoid::objects {

struct DepthPoints
{
  Image<float> depth_m;  // 0 = no measurement
  Points points_m;       // of all pixels
  double pixel_m;        // distance between neighboring pixels at a depth of 1 m
};

// The detections of an image. An object without a known box has a lowest corner beyond the highest
// one.
struct Detections
{
  Rows<int32_t, 4> boxes_px;  // left, top, right, bottom within the image, exclusive
  const double* areas_px;     // of the boxes as they were detected
  const uint8_t* is_person;
  const uint8_t* is_support;   // whether other objects may lie on it
  const uint8_t* may_be_flat;  // whether it may be a part of a plane that goes on around its box
  Transforms T_box_map;        // to the frames of the known boxes
  Points known_low_m, known_high_m;  // corners in these frames
};

// The surfaces of the objects; the fields are those of hoid_native.results.ObjectSurfaces.
struct Surfaces
{
  std::vector<int32_t> detection;
  std::vector<int64_t> pixels, pixels_end, others, others_end;
  std::vector<double> points_m, center_m, low_m, high_m;
};

// Segment the surfaces of detected objects. `owner` has the detection of the known object that
// shows at each pixel, -1 = none.
Surfaces object_surfaces(
  const DepthPoints& image, const Detections& detections, const int32_t* owner);

// Voxels of an object; the fields are those of hoid_native.results.Voxels.
struct Voxels
{
  std::vector<int64_t> keys;
  std::vector<double> means_m;
  std::vector<float> readings, hits, misses;
};

struct VoxelView
{
  Rows<int64_t> keys;
  Points means_m;
  const float *readings, *hits, *misses;
};

// A grid of voxels around the origin, with 2^bits voxels along each axis.
struct VoxelGrid
{
  double voxel_m;
  int bits;
};

// Write the key of each point's voxel, -1 outside the grid.
void voxel_keys(const Points& points_m, const VoxelGrid& grid, int64_t* key_out);

// Return the voxels of the points of one image, each of which was hit once; points outside the grid
// are left out.
Voxels voxels_of(const Points& points_m, const VoxelGrid& grid);

// Return all voxels of two sets, the evidence of which is added where both have one: at most
// `max_voxels`, with a sum of hits and misses of at most `max_count`.
Voxels merged_voxels(
  const VoxelView& first, const VoxelView& second, float max_count, int max_voxels);

// Write 1 for the voxels that were hit in `least_hits` looks and in `least_share` of those that hit
// or missed them. Voxels in one cell of the grid are counted together, if there is a grid.
void solid_voxels(
  const VoxelView& voxels, double least_hits, double least_share, const VoxelGrid* cells,
  uint8_t* solid_out);

// The cells of a surface, in the frame of its object.
struct SurfaceCells
{
  const double* T_object_map;
  Rows<int64_t> keys;  // ascending
  VoxelGrid grid;
};

// Return the ascending pixels with a measurement in a box whose points are in cells of a surface.
std::vector<int64_t> pixels_on_surface(
  const DepthPoints& image, const int32_t* box_px, const SurfaceCells& cells);

// Return the ratio of points that are in cells of a surface; 0 without points.
double share_on_surface(const Points& points_m, const SurfaceCells& cells);

// Write points to other frames: those of each part with its own transform.
void transform_parts(
  const Points& points_m, const Rows<int64_t>& ends, const Transforms& T, double* out);

// Voxels of objects in the camera frame, one object after the other. Those in front of the camera,
// within its range, are projected.
struct ProjectedVoxels
{
  Rows<int64_t> ahead;    // rows of the projected ones
  Rows<double, 2> uv_px;  // their pixels
  Rows<double> depth_m;   // of all
  const uint8_t* is_solid;
  Rows<int64_t> ends;
};

// Largest depth difference of a voxel and the surface that shows it: a constant (m) plus a
// multiple (1/m) of the square of the depth.
struct DepthMargin
{
  double constant_m, per_depth2;
};

// The visibility of voxels; the fields are those of hoid_native.results.SeenVoxels.
struct SeenVoxels
{
  std::vector<double> uv_px;
  std::vector<uint8_t> is_visible;
  std::vector<int64_t> counts;
  std::vector<double> boxes_px;
};

SeenVoxels seen_voxels(
  const Image<float>& depth_m, const ProjectedVoxels& voxels, const DepthMargin& margin);

// Return the ascending rows of the visible voxels that are outside a box (left, top, right and
// bottom, inclusive), or whose nearest pixel is one of the ascending `others`.
std::vector<int64_t> missed_voxels(
  const Rows<double, 2>& uv_px, const uint8_t* is_visible, const double* box_px,
  const Rows<int64_t>& others, int width);

// The points of segments, and the boxes of their detections.
struct SegmentSet
{
  Points points_m;
  Rows<int64_t> ends;
  Rows<int32_t, 4> boxes_px;  // right and bottom are excluded
};

// The boxes of objects, and the pixels of their voxels.
struct ObjectSet
{
  Transforms T_box_map;
  Points low_m, high_m;
  Rows<double, 2> uv_px;
  const uint8_t* is_visible;
  Rows<int64_t> ends;
};

// Write the (segments, objects) geometric means of the ratio of the segment's points that are in
// the box of the object and of the ratio of the object's visible voxels that are in the box of the
// detection; 0 where the pair is not a candidate.
void pair_scores(
  const SegmentSet& segments, const ObjectSet& objects, const uint8_t* is_candidate,
  double* score_out);

}  // namespace hoid::objects
