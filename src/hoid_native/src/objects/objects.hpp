// The object map: the surface of each detected object in a depth image, and the voxels of an
// object. The image is small; its points are those of its pixels in the map frame. Pixels given as
// one number are flat indices.
#pragma once

#include <cstdint>
#include <vector>

#include "common/image.hpp"

namespace hoid::objects {

// A transform: the first three rows of a 4 x 4 matrix, row by row.
using Transform = const double*;

struct DepthPoints
{
  Image<float> depth_m;    // 0 = no measurement
  const double* points_m;  // (height * width, 3)
  double pixel_m;          // distance between neighboring pixels at a depth of 1 m
};

// The detections of an image. The known box of an object that is not known has a lowest corner
// beyond the highest one.
struct Detections
{
  const int32_t* boxes_px;  // (count, 4) left, top, right, bottom within the image, exclusive
  const double* areas_px;   // (count) of the boxes as they were detected
  const uint8_t* is_person;
  const double* T_box_map;    // (count, 4, 4) transforms to the frames of the known boxes
  const double* known_low_m;  // (count, 3) lowest corners in these frames
  const double* known_high_m;
  int count;
};

// The S segments of objects, without people; the pixels of all are one after the other.
struct Surfaces
{
  std::vector<int32_t> detection;  // (S) ascending
  std::vector<int64_t> pixels, pixels_end;  // pixels that show the object, and ends of the segments
  std::vector<int64_t> others, others_end;  // pixels in the box that show other things
  std::vector<double> points_m;             // of `pixels`, (.., 3)
  // (S, 3) medians and ends of the points along each axis.
  std::vector<double> center_m, low_m, high_m;
};

// Segment the surfaces of detected objects. `owner` has the detection of the known object that
// shows at each pixel, -1 = none.
Surfaces object_surfaces(
  const DepthPoints& image, const Detections& detections, const int32_t* owner);

// Voxels by ascending key.
struct Voxels
{
  std::vector<int64_t> keys;
  std::vector<double> means_m;  // (N, 3)
  std::vector<float> readings, hits, misses;
};

struct VoxelView
{
  const int64_t* keys;
  const double* means_m;
  const float *readings, *hits, *misses;
  int count;
};

// A grid of voxels around the origin: `cells` (a power of two) along each axis.
struct VoxelGrid
{
  double voxel_m;
  int bits;  // log2(cells)
};

// Write the key of each point's voxel, -1 outside the grid.
void voxel_keys(const double* points_m, int count, const VoxelGrid& grid, int64_t* key_out);

// Return the voxels of the points of one image, each of which was hit once; points outside the grid
// are left out.
Voxels voxels_of(const double* points_m, int count, const VoxelGrid& grid);

// The largest sum of hits and misses of a voxel, and the largest number of voxels.
struct VoxelLimits
{
  float max_count;
  int max_voxels;
};

// Return all voxels of two sets, the evidence of which is added where both have one.
Voxels merged_voxels(const VoxelView& first, const VoxelView& second, const VoxelLimits& limits);

// Write 1 for the voxels that were hit in `least_hits` looks and in `least_share` of those that hit
// or missed them. Voxels in one cell of the grid are counted together, if there is a grid.
void solid_voxels(
  const VoxelView& voxels, double least_hits, double least_share, const VoxelGrid* cells,
  uint8_t* solid_out);

// Write the lowest and the highest corner of the box of points without the share `outer` of the
// outermost ones on each side; with `chosen`, of those points only.
void trimmed_box(
  const double* points_m, int count, const uint8_t* chosen, double outer, double* low_out,
  double* high_out);

// Return the ascending keys of the cells that contain chosen points.
std::vector<int64_t> cells_of(
  const double* points_m, int count, const uint8_t* chosen, const VoxelGrid& grid);

// The cells of a surface, in the frame of its object.
struct SurfaceCells
{
  Transform T_object_map;
  const int64_t* keys;  // ascending
  int count;
  VoxelGrid grid;
};

// Return the ascending pixels with a measurement in a box whose points are in cells of a surface.
std::vector<int64_t> pixels_on_surface(
  const DepthPoints& image, const int* box_px, const SurfaceCells& cells);

// Return the ratio of points that are in cells of a surface; 0 without points.
double share_on_surface(const double* points_m, int count, const SurfaceCells& cells);

// Return the ratio of points (map frame) that are in a box; 0 without points.
double share_in_box(
  const double* points_m, int count, Transform T_box_map, const double* low_m,
  const double* high_m);

// Write points to other frames: those of each part with its own transform. `ends` has the index
// after the last point of each part, `T` the parts' (4, 4) matrices.
void transform_parts(
  const double* points_m, const int64_t* ends, int num_parts, const double* T, double* out);

// Voxels of O objects in the camera frame, one object after the other. The `num_ahead` ones in
// front of the camera, within its range, are projected.
struct ProjectedVoxels
{
  const int64_t* ahead;   // (num_ahead) their rows
  const double* uv_px;    // (num_ahead, 2) their pixels
  int num_ahead;
  const double* depth_m;  // (count)
  const uint8_t* is_solid;
  int count;
  const int64_t* ends;  // (num_objects) index after the last voxel of each object
  int num_objects;
};

// The depth of a voxel may differ from that of the surface by a length (m) plus a multiple (1/m) of
// its square.
struct DepthMargin
{
  double constant_m, per_depth2;
};

// What an image shows of the voxels.
struct SeenVoxels
{
  std::vector<double> uv_px;        // (count, 2) NaN out of view
  std::vector<uint8_t> is_visible;  // whether a surface is measured at the voxel
  // (num_objects, 3) solid voxels, those of them that are visible, and that are seen through.
  std::vector<int64_t> counts;
  std::vector<double> boxes_px;  // (num_objects, 4) of the visible solid voxels; NaN without any
};

SeenVoxels seen_voxels(
  const Image<float>& depth_m, const ProjectedVoxels& voxels, const DepthMargin& margin);

// Return the ascending rows of the visible voxels (pixels (count, 2)) that are outside a box (left,
// top, right and bottom, inclusive), or whose nearest pixel is one of the ascending `others`.
std::vector<int64_t> missed_voxels(
  const double* uv_px, const uint8_t* is_visible, int count, const double* box_px,
  const int64_t* others, int num_others, int width);

// S segments: their points, and the boxes of their detections.
struct SegmentSet
{
  const double* points_m;  // of all, one after the other
  const int64_t* ends;     // index after the last point of each
  const int32_t* boxes_px;  // (count, 4) right and bottom are excluded
  int count;
};

// O objects: their boxes, and the pixels of their voxels.
struct ObjectSet
{
  const double* T_box_map;  // (count, 4, 4)
  const double *low_m, *high_m;
  const double* uv_px;  // (.., 2) of all voxels, one object after the other
  const uint8_t* is_visible;
  const int64_t* ends;  // index after the last voxel of each
  int count;
};

// Write the (S, O) geometric means of the ratio of the segment's points that are in the box of the
// object and of the ratio of the object's visible voxels that are in the box of the detection; 0
// where the pair is not a candidate. A voxel half a pixel left of a box or above it is inside.
void pair_scores(
  const SegmentSet& segments, const ObjectSet& objects, const uint8_t* is_candidate,
  double* score_out);

}  // namespace hoid::objects
