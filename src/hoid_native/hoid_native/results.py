"""Results of the kernels, as named tuples of arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Corners(NamedTuple):
    """N FAST corners of an image pyramid, level by level in raster order."""

    xy_px: NDArray[np.int32]  # (N, 2) positions in the corner's level
    uv_px: NDArray[np.float64]  # (N, 2) positions in level 0
    pixel: NDArray[np.int64]  # (N,) nearest level-0 pixels, as indices into the flattened image
    octave: NDArray[np.uint8]  # (N,) index of the corner's level
    score: NDArray[np.uint8]  # (N,) largest FAST threshold at which the pixel is a corner


class Pairs(NamedTuple):
    """M one-to-one matches of queries and features, in order of queries."""

    q: NDArray[np.int32]  # (M,) indices of queries
    k: NDArray[np.int32]  # (M,) indices of features
    distance: NDArray[np.int32]  # (M,) Hamming distances of the descriptors


class Observations(NamedTuple):
    """M observations: keyframe i observes map point j in its feature k."""

    i: NDArray[np.int64]  # (M,) rows of keyframes
    k: NDArray[np.int64]  # (M,) features of the keyframes
    j: NDArray[np.int64]  # (M,) rows of map points


class Neighbors(NamedTuple):
    """The N keyframes that share enough map points with a given keyframe."""

    rows: NDArray[np.int64]  # (N,) rows of keyframes
    shared: NDArray[np.int64]  # (N,) numbers of common map points


class Edges(NamedTuple):
    """E pairs of keyframes that share enough map points."""

    first: NDArray[np.int64]  # (E,) row of one keyframe
    second: NDArray[np.int64]  # (E,) row of the other keyframe, larger than that in `first`
    shared: NDArray[np.int64]  # (E,) numbers of common map points


class PointStatistics(NamedTuple):
    """Values that follow from the observations of R map points."""

    rows: NDArray[np.int64]  # (R,) rows of the points, ascending
    # (R, 3) mean unit vectors from the observing cameras to a point.
    view_direction: NDArray[np.float32]
    reference: NDArray[np.int64]  # (R,) rows of the reference keyframes
    max_distance_m: NDArray[np.float32]  # (R,) largest distance at which the point can be matched
    descriptors: NDArray[np.uint8]  # (R, 32) ORB descriptor that represents each point


class PoseFit(NamedTuple):
    """A camera pose fitted to N matches of map points."""

    T_camera_map: NDArray[np.float64]  # (4, 4)
    # (N,) matches that agree with the pose; all True if there are too few matches.
    inliers: NDArray[np.bool_]
    # (6, 6) inverse covariance of the pose as a left twist, rotation first; the identity if there
    # are too few matches.
    information: NDArray[np.float64]


class MatchEvaluation(NamedTuple):
    """How well each of N matches fits a pose."""

    # (N,) sum of the squared errors of pixel and disparity, each divided by its measured variance
    # and limited to its outlier threshold (see `evaluate_matches` for `joint_noise`).
    cost: NDArray[np.float64]
    inliers: NDArray[np.bool_]  # (N,) matches that pass the outlier test


class BiasingRegion(NamedTuple):
    """The region of an image without which the other ones of N matches fit a pose best."""

    mask: NDArray[np.bool_]  # (N,) matches in the region
    low: NDArray[np.float64]  # (3,) smallest x / z, y / z and log(z / m) in the camera frame
    high: NDArray[np.float64]  # (3,) largest x / z, y / z and log(z / m) in the camera frame
    # Reduction of the cost of the other matches, to first order, if the pose is fitted to them
    # alone.
    gain: float


class BundleFit(NamedTuple):
    """Poses of C cameras and P map points after bundle adjustment of M observations."""

    T_camera_map: NDArray[np.float64]  # (C, 4, 4)
    points_m: NDArray[np.float64]  # (P, 3) in the map frame
    # (M,) squared normalized residuals after the adjustment; infinite for points behind the
    # camera.
    chi2: NDArray[np.float64]
    cost_before: float  # Huber cost of all observations before the adjustment
    cost_after: float  # Huber cost after the adjustment of those observations that it still used


class ClassifiedBoxes(NamedTuple):
    """Which of N boxes are dynamic, and which of K pixels are outside them."""

    depth_m: NDArray[np.float64]  # (N,) median depth at the center of the box; NaN = unknown
    # (N,) share of the box that the box of a person covers: the person who handles the object, or
    # else the one who covers most of it; 0 for people.
    overlap: NDArray[np.float64]
    gap_m: NDArray[np.float64]  # (N,) depth difference to that person; NaN = unknown
    moves: NDArray[np.uint8]  # (N,) role of each dynamic box; 0 = static
    outside: NDArray[np.int64]  # ascending indices of the pixels, among the K, in no dynamic box
    area_px: int  # number of pixels of the whole image in no dynamic box


class Segments(NamedTuple):
    """S segments of a depth image: free of depth jumps, and each within a grid cell.

    A smooth region that extends over several cells has one segment in each of them.
    """

    label: NDArray[np.int32]  # (H, W) segment of each pixel; -1: depth jump, or no depth
    region: NDArray[np.int32]  # (S,) index of the smooth region to which the segment belongs
    area_px: NDArray[np.int32]  # (S,) number of pixels of the segment


class ObjectSurfaces(NamedTuple):
    """The surfaces of S detected objects, one after the other."""

    detection: NDArray[np.int32]  # (S,) ascending indices of the detections
    pixels: NDArray[np.int64]  # (P,) pixels that show the objects, object by object, ascending
    pixels_end: NDArray[np.int64]  # (S,) index in `pixels` after the last pixel of each object
    # (Q,) pixels in the boxes that show something else, object by object.
    others: NDArray[np.int64]
    others_end: NDArray[np.int64]  # (S,) index in `others` after the last pixel of each object
    points_map_m: NDArray[np.float64]  # (P, 3) points of `pixels`
    center_map_m: NDArray[np.float64]  # (S, 3) median of the points along each axis
    low_map_m: NDArray[np.float64]  # (S, 3) lowest corner of the points' bounding box
    high_map_m: NDArray[np.float64]  # (S, 3) highest corner of this box


class Voxels(NamedTuple):
    """N voxels of an object."""

    keys: NDArray[np.int64]  # (N,) ascending, see `voxel_keys`
    means_m: NDArray[np.float64]  # (N, 3) mean of the points measured in each voxel
    readings: NDArray[np.float32]  # (N,) number of these points
    hits: NDArray[np.float32]  # (N,) number of images that measured the object in the voxel
    misses: NDArray[np.float32]  # (N,) number of images that showed no object in the voxel


class SeenVoxels(NamedTuple):
    """Which of the N voxels of O objects an image shows; voxels are sorted by object."""

    uv_px: NDArray[np.float64]  # (N, 2) pixels; NaN out of view
    is_visible: NDArray[np.bool_]  # (N,) whether a surface is measured at the voxel
    # (O, 3) numbers of solid voxels, of visible ones among them, and of ones seen through.
    counts: NDArray[np.int64]
    boxes_px: NDArray[np.float64]  # (O, 4) bounding boxes of visible solid voxels, xyxy; NaN: none
