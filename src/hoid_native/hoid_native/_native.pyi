"""Compiled kernels; import them from hoid_native."""

from collections.abc import Sequence
from typing import Annotated, Any

import numpy
import numpy.typing
from numpy.typing import NDArray

import hoid_native.results

def fast_corners(
    levels: Sequence[Annotated[NDArray[numpy.uint8], dict(shape=(None, None), writable=False)]],
    steps_px: Annotated[NDArray[numpy.float32], dict(shape=(None, 2), writable=False)],
    threshold: int,
    border_px: int,
) -> hoid_native.results.Corners:
    """
    Return the FAST-9/16 corners of an image pyramid after 3x3 non-maximum suppression.

    Source: Rosten and Drummond, ECCV 2006. Corners and scores equal OpenCV's.

    Args:
        levels: L gray images (H_l, W_l) uint8, the finest first.
        steps_px: (L, 2) float32 level-0 pixels per pixel of each level, in x and y.
        threshold: gray levels, from 1 to 254.
        border_px: least distance of a corner from the edge of its level; values below 3 count as 3.

    Raises:
        ValueError: The threshold or the border is out of range, there are more than 256 levels, or
            `steps_px` has another number of rows than there are levels.
    """

def spread_evenly(
    uv_px: numpy.typing.NDArray[Any],
    octave: Annotated[NDArray[numpy.uint8], dict(shape=(None,), writable=False)],
    score: Annotated[NDArray[numpy.uint8], dict(shape=(None,), writable=False)],
    budgets: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    area_px: float,
) -> Annotated[NDArray[numpy.int64], dict(shape=(None,))]:
    """
    Return the ascending indices of at most `budgets.sum()` corners, spread evenly over the image.

    Each octave divides `area_px` into about as many grid cells as its budget. It takes the strongest
    corner of each cell, then the second strongest of each cell, and so on until its budget is used.
    Among equal scores the first corner wins. Octaves with too few corners leave the rest of their
    budget to the others.

    Args:
        uv_px: (N, 2) level-0 pixels, not negative.
        octave: (N,) uint8.
        score: (N,) uint8, higher is stronger.
        budgets: (L,) int64 number of corners wanted from each octave.
        area_px: image area (level-0 pixels) to spread the corners over; a cell has at least one pixel.

    Raises:
        ValueError: Lengths differ, an octave has no budget, or a budget, a position or the area is
            negative.
    """

def subpixel_offsets_px(
    image_gray: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), writable=False)],
    x: Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)],
    y: Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)],
) -> Annotated[NDArray[numpy.float32], dict(shape=(None, None))]:
    """
    Return the (N, 2) float32 offsets (x, y) in pixels from FAST corners to their subpixel peaks.

    The peak is the maximum of the quadratic fitted to the signed FAST scores of the corner's pixel and
    its 8 neighbors (docs/decisions/008). Offsets are within [-0.5, 0.5]; they are 0 if the quadratic
    has no maximum.

    Args:
        image_gray: (H, W) uint8.
        x: (N,) int32.
        y: (N,) int32.

    Raises:
        ValueError: A pixel is less than 4 px from the image's edge, or lengths differ.
    """

def orientations_deg(
    image_gray: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), writable=False)],
    x: Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)],
    y: Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)],
) -> Annotated[NDArray[numpy.float32], dict(shape=(None,))]:
    """
    Return the (N,) float32 intensity-centroid orientations of pixels, degrees in [0, 360), y down.

    Source: Rublee et al., ORB, ICCV 2011, sec. 3.2.

    Args:
        image_gray: (H, W) uint8.
        x: (N,) int32.
        y: (N,) int32.

    Raises:
        ValueError: A pixel is less than 15 px from the image's edge, or lengths differ.
    """

def orb_descriptors(
    image_smooth: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), writable=False)],
    x: Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)],
    y: Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)],
    angle_deg: Annotated[NDArray[numpy.float32], dict(shape=(None,), writable=False)],
) -> Annotated[NDArray[numpy.uint8], dict(shape=(None, None))]:
    """
    Return the (N, 32) uint8 ORB descriptors of pixels, rotated by their orientations.

    Source: Rublee et al., ORB, ICCV 2011, sec. 4. The bits equal OpenCV's.

    Args:
        image_smooth: (H, W) uint8, smoothed.
        x: (N,) int32.
        y: (N,) int32.
        angle_deg: (N,) float32 orientations.

    Raises:
        ValueError: A pixel is less than 19 px from the image's edge, an angle is not finite, or
            lengths differ.
    """

class ObservationGraph:
    """
    Which keyframes observe which map points, and how many points two keyframes share.

    Keyframes, features and points are int64 row numbers from 0 to 2^31 - 2. The cost of a call depends
    on the observations concerned, not on the size of the map.
    """

    def __init__(self) -> None: ...
    def observe(
        self,
        i: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
        k: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
        j: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    ) -> None:
        """
        Add (N,) observations: keyframe i observes point j in its feature k.

        Raises:
            ValueError: Lengths differ, or a row is negative.
        """

    def unobserve(
        self,
        i: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
        k: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
        j: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    ) -> None:
        """
        Remove (N,) observations.

        Raises:
            ValueError: Lengths differ, or there is no such observation.
        """

    def clear(self) -> None:
        """Remove all observations and connections."""

    def observations(
        self,
        j: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
        keyframes: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)]
        | None = None,
    ) -> hoid_native.results.Observations:
        """
        Return the observations of points (P,), sorted by keyframe and feature.

        Args:
            j: (P,) points.
            keyframes: (K,) keyframes whose observations are returned, in this order; None: all.
        """

    def connect(
        self, i: int, j: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)]
    ) -> None:
        """
        Recount the points that keyframe i, which observes points j (P,), shares with all others.
        """

    def set_neighbors(
        self,
        i: int,
        rows: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
        shared: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    ) -> None:
        """
        Replace the connections of keyframe i, and those of the others with it.

        Args:
            i: the keyframe.
            rows: (N,) keyframes that share points with it, ascending.
            shared: (N,) numbers of shared points.

        Raises:
            ValueError: Lengths differ, or the rows do not ascend.
        """

    def neighbors(self, i: int, min_shared: int = 1) -> hoid_native.results.Neighbors:
        """
        Return the keyframes that share at least `min_shared` points with i, most first, then by row.
        """

    def edges(self, min_shared: int = 1) -> hoid_native.results.Edges:
        """
        Return the pairs of keyframes that share at least `min_shared` points, by first and second row.
        """

    def path_length_m(
        self,
        T_map_camera: numpy.typing.NDArray[Any],
        parents: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
        start: int,
        goal: int,
        min_shared: int,
        m_per_rad: float,
    ) -> float:
        """
        Return the length [m] of the shortest path between two keyframes (Dijkstra's algorithm).

        Steps of the path join keyframes that share points or are next to each other in the spanning tree.
        The length is infinite without a path.

        Args:
            T_map_camera: (K, 4, 4) poses of all keyframes.
            parents: (K,) row of each keyframe's parent in the spanning tree; -1: none.
            start: the first keyframe.
            goal: the last keyframe.
            min_shared: number of points that the keyframes of a step share at least.
            m_per_rad: the length that a rotation of 1 rad counts as.

        Raises:
            ValueError: Lengths differ, or a row is out of range.
        """

    def count_observed(
        self,
        j: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
        keyframes: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    ) -> Annotated[NDArray[numpy.int64], dict(shape=(None,))]:
        """
        Return how many of the points (P,), without repetitions, each of the keyframes (K,) observes.
        """

    def points_of(
        self,
        point_of_feature: Annotated[
            NDArray[numpy.int32], dict(shape=(None, None), writable=False)
        ],
        keyframes: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    ) -> Annotated[NDArray[numpy.int64], dict(shape=(None,))]:
        """
        Return the (P,) points, ascending, that any of the keyframes (N,) observes.

        Args:
            point_of_feature: (K, F) int32 point that each feature of each keyframe observes; -1: none.
            keyframes: (N,) rows of it.
        """

def move_points(
    motions: numpy.typing.NDArray[Any],
    which: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    position_m: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu')],
    view_direction: Annotated[
        NDArray[numpy.float32], dict(shape=(None, 3), order='C', device='cpu')
    ],
) -> None:
    """
    Move points and turn their viewing directions, in place.

    Args:
        motions: (G, 4, 4) rigid motions.
        which: (N,) int64 number of the motion of each point; -1: the point stays.
        position_m: (N, 3) float64, changed.
        view_direction: (N, 3) float32, changed.

    Raises:
        ValueError: Lengths differ, or a number is out of range.
    """

class QueryConstraints:
    """
    Octaves and descriptors of Q queries.

    Args:
        min_octave: (Q,) int8, inclusive.
        max_octave: (Q,) int8, inclusive.
        descriptors: (Q, 32) uint8.

    Raises:
        ValueError: Lengths differ.
    """

    def __init__(
        self,
        min_octave: Annotated[NDArray[numpy.int8], dict(shape=(None,), writable=False)],
        max_octave: Annotated[NDArray[numpy.int8], dict(shape=(None,), writable=False)],
        descriptors: Annotated[NDArray[numpy.uint8], dict(shape=(None, 32), writable=False)],
    ) -> None: ...

class Candidates:
    """
    N features to match.

    Args:
        measurement_px: (N, 3) float32 u, v, u_right; NaN u_right: no depth. Features at NaN or beyond
            16384 px match nothing.
        octave: (N,) uint8.
        descriptors: (N, 32) uint8.
        free: (N,) bool, whether each may be matched; None: all may.

    Raises:
        ValueError: Lengths differ.
    """

    def __init__(
        self,
        measurement_px: Annotated[NDArray[numpy.float32], dict(shape=(None, 3), writable=False)],
        octave: Annotated[NDArray[numpy.uint8], dict(shape=(None,), writable=False)],
        descriptors: Annotated[NDArray[numpy.uint8], dict(shape=(None, 32), writable=False)],
        free: Annotated[NDArray[numpy.bool_], dict(shape=(None,), writable=False)] | None = None,
    ) -> None: ...

class MatchThreshold:
    """
    Threshold of a match.

    Args:
        max_distance: largest Hamming distance.
        ratio: largest ratio of the best distance to the second best one of the same octave; 1.0: no
            test.
    """

    def __init__(self, max_distance: int, ratio: float) -> None: ...
    @property
    def max_distance(self) -> int:
        """Largest Hamming distance."""

    @property
    def ratio(self) -> float:
        """Largest ratio of best to second best distance; 1.0: no test."""

def match_by_projection(
    projection_px: numpy.typing.NDArray[Any],
    radius_px: numpy.typing.NDArray[Any],
    queries: QueryConstraints,
    candidates: Candidates,
    threshold: MatchThreshold,
) -> hoid_native.results.Pairs:
    """
    Return one-to-one matches of queries and features within windows around expected positions.

    Args:
        projection_px: (3, Q) expected u, v, u_right of each query; NaN u_right: unknown.
        radius_px: (Q,) half sides of the square windows.
        queries: octaves and descriptors of the queries.
        candidates: features; u_right must agree within the radius, too, if both are known.
        threshold: of a match.

    Raises:
        ValueError: Lengths differ.
    """

def match_along_segments(
    segments_px: numpy.typing.NDArray[Any],
    octave_radius_px: numpy.typing.NDArray[Any],
    queries: QueryConstraints,
    candidates: Candidates,
    threshold: MatchThreshold,
) -> hoid_native.results.Pairs:
    """
    Return one-to-one matches of queries and features near image segments (of epipolar lines).

    Args:
        segments_px: (Q, 4) u, v of both ends; NaN: no segment.
        octave_radius_px: (L,) largest distance from the segment of a feature of each octave.
        queries: octaves and descriptors of the queries.
        candidates: features; u_right is ignored.
        threshold: of a match.

    Raises:
        ValueError: Lengths differ, or an octave is not below L.
    """

def distinctive_descriptors(
    descriptors: Annotated[NDArray[numpy.uint8], dict(shape=(None, 32), writable=False)],
    starts: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
) -> Annotated[NDArray[numpy.int64], dict(shape=(None,))]:
    """
    Return the (G,) int64 rows of the descriptors with the smallest median distance in their groups.

    This is ComputeDistinctiveDescriptors of ORB-SLAM.

    Args:
        descriptors: (M, 32) uint8, sorted by group; only the last 8 of a group are compared.
        starts: (G,) int64 first row of each group, ascending.

    Raises:
        ValueError: `starts` does not ascend, or a group starts beyond the descriptors.
    """

class StereoParams:
    """
    A pinhole camera with a virtual right column: u_right = u - disparity_px_m / depth_m.
    """

    def __init__(
        self,
        fx_px: float,
        fy_px: float,
        cx_px: float,
        cy_px: float,
        disparity_px_m: float,
        disparity_noise_px: float,
        relative_noise: float,
        pixel_noise: float = 1.0,
        joint_noise: bool = False,
    ) -> None: ...
    @property
    def fx_px(self) -> float:
        """Focal length along rows."""

    @property
    def fy_px(self) -> float:
        """Focal length along columns."""

    @property
    def cx_px(self) -> float:
        """Column of the principal point."""

    @property
    def cy_px(self) -> float:
        """Row of the principal point."""

    @property
    def disparity_px_m(self) -> float:
        """Disparity at a depth of 1 m."""

    @property
    def disparity_noise_px(self) -> float:
        """
        The part of a disparity's standard deviation that does not depend on it.
        """

    @property
    def relative_noise(self) -> float:
        """The part that grows with the disparity, as a share of it."""

    @property
    def pixel_noise(self) -> float:
        """Standard deviation of pixels, in units of that of their weights."""

    @property
    def joint_noise(self) -> bool:
        """u_right is as noisy as u and v, all under one kernel."""

    def __getstate__(
        self,
    ) -> tuple[float, float, float, float, float, float, float, float, bool]: ...
    def __setstate__(
        self, arg: tuple[float, float, float, float, float, float, float, float, bool], /
    ) -> None: ...

class Gates:
    """
    Squared normalized residuals beyond which an observation is an outlier.
    """

    def __init__(self, mono: float, stereo: float) -> None: ...
    @property
    def mono(self) -> float:
        """Of observations without depth."""

    @property
    def stereo(self) -> float:
        """Of observations with depth."""

def optimize_pose(
    camera: StereoParams,
    gates: Gates,
    points_m: numpy.typing.NDArray[Any],
    measured_px: numpy.typing.NDArray[Any],
    inv_sigma2: numpy.typing.NDArray[Any],
    T_camera_map: numpy.typing.NDArray[Any],
    prior_T_camera_map: numpy.typing.NDArray[Any] | None = None,
    prior_information: numpy.typing.NDArray[Any] | None = None,
) -> hoid_native.results.PoseFit:
    """
    Return the pose that fits the matches best: Gauss-Newton with a Huber kernel.

    Pixels and the disparity u - u_right are independent measurements with separate robust kernels.
    Outliers are identified on (u, v, u_right) after each of three rounds (Mur-Artal and Tardos, T-RO
    2017). The information of the result has the unit of `inv_sigma2` and includes that of the prior.
    With fewer than four matches and no prior, the initial pose is returned.

    Args:
        camera: of the image, with its measured noise.
        gates: chi-square limits of outliers, and of the Huber kernels.
        points_m: (N, 3) in the map frame.
        measured_px: (N, 3) u, v, u_right; NaN u_right: no depth.
        inv_sigma2: (N,) 1 / variance of each coordinate [1/px^2].
        T_camera_map: (4, 4) initial pose.
        prior_T_camera_map: (4, 4) mean of a Gaussian prior, if there is one.
        prior_information: (6, 6) inverse covariance of its left twist, rotation first.

    Raises:
        ValueError: Lengths differ, or the prior is incomplete or not finite.
    """

def evaluate_matches(
    camera: StereoParams,
    gates: Gates,
    points_m: numpy.typing.NDArray[Any],
    measured_px: numpy.typing.NDArray[Any],
    inv_sigma2: numpy.typing.NDArray[Any],
    T_camera_map: numpy.typing.NDArray[Any],
) -> hoid_native.results.MatchEvaluation:
    """
    Return how well each match fits a pose.

    The squared errors of pixel and disparity are truncated at their gates (MSAC, Torr and Zisserman,
    CVIU 2000), so that sums over matches compare poses with different outliers.

    Args:
        camera: of the image, with its measured noise.
        gates: chi-square limits of outliers.
        points_m: (N, 3) in the map frame.
        measured_px: (N, 3) u, v, u_right; NaN u_right: no depth.
        inv_sigma2: (N,) 1 / variance of each coordinate [1/px^2].
        T_camera_map: (4, 4).

    Raises:
        ValueError: Lengths differ.
    """

def most_biasing_region(
    camera: StereoParams,
    gates: Gates,
    points_m: numpy.typing.NDArray[Any],
    measured_px: numpy.typing.NDArray[Any],
    inv_sigma2: numpy.typing.NDArray[Any],
    T_camera_map: numpy.typing.NDArray[Any],
    noise_scale: float,
) -> hoid_native.results.BiasingRegion:
    """
    Return the region of the view without whose matches the others would fit best.

    Regions are cells of a k-d tree over direction and depth, with 1/16 to 1/4 of the matches each
    (docs/decisions/036). The region is empty, with a gain of 0, if a point or the pose is not finite.

    Args:
        camera: of the image, with its measured noise.
        gates: chi-square limits of outliers, which are ignored.
        points_m: (N, 3) in the map frame.
        measured_px: (N, 3) u, v, u_right; NaN u_right: no depth.
        inv_sigma2: (N,) 1 / variance of each coordinate [1/px^2].
        T_camera_map: (4, 4) pose fitted to all matches.
        noise_scale: actual variances as a multiple of those of the camera.

    Raises:
        ValueError: Lengths differ.
    """

def adjust_bundle(
    lens: StereoParams,
    gates: Gates,
    T_camera_map: numpy.typing.NDArray[Any],
    num_free: int,
    points_m: numpy.typing.NDArray[Any],
    camera: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    point: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    measured_px: numpy.typing.NDArray[Any],
    inv_sigma2: numpy.typing.NDArray[Any],
    rounds: int,
    iterations: int,
) -> hoid_native.results.BundleFit:
    """
    Return adjusted camera poses and points: Levenberg-Marquardt with Huber kernels, in rounds.

    After each round outliers are left out of the next ones.

    Args:
        lens: camera model of all images.
        gates: chi-square limits of outliers, and of the Huber kernels.
        T_camera_map: (C, 4, 4); the first `num_free` are optimized, the others fixed.
        num_free: number of optimized cameras.
        points_m: (P, 3) in the map frame.
        camera: (M,) int64 index of the camera of each observation.
        point: (M,) int64 index of the point of each observation; at most one for each camera.
        measured_px: (M, 3) u, v, u_right; NaN u_right: no depth.
        inv_sigma2: (M,) 1 / variance of each coordinate [1/px^2].
        rounds: number of rounds, at least 1.
        iterations: largest number of iterations in each round.

    Raises:
        ValueError: Lengths differ, or an index is out of range.
        MemoryError: The dense system of the optimized cameras does not fit in memory.
    """

def overlap_ratios(
    boxes_xyxy_px: numpy.typing.NDArray[Any], others_xyxy_px: numpy.typing.NDArray[Any]
) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None))]:
    """
    Return the (N, M) shares in [0, 1] of each box's area that lie in each of the others.

    This is the interaction area of the HOID paper. It is 0 for a box without area.

    Args:
        boxes_xyxy_px: (N, 4), finite.
        others_xyxy_px: (M, 4), finite.
    """

def intersections_over_union(
    boxes_xyxy_px: numpy.typing.NDArray[Any], others_xyxy_px: numpy.typing.NDArray[Any]
) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None))]:
    """
    Return the (N, M) intersections over union, in [0, 1]; 0 for boxes without area.

    Args:
        boxes_xyxy_px: (N, 4), finite.
        others_xyxy_px: (M, 4), finite.
    """

def are_boxes_valid(
    boxes_xyxy_px: Annotated[NDArray[numpy.float32], dict(shape=(None, 4), writable=False)],
    scores: Annotated[NDArray[numpy.float32], dict(shape=(None,), writable=False)],
    shape_hw: tuple[int, int],
) -> bool:
    """
    Return whether all boxes have an area and lie inside the image, and all scores are in [0, 1].

    Args:
        boxes_xyxy_px: (N, 4) float32.
        scores: (N,) float32.
        shape_hw: height and width of the image.

    Raises:
        ValueError: Lengths differ.
    """

def classify_boxes(
    depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    pixels: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    boxes_xyxy_px: numpy.typing.NDArray[Any],
    roles: Annotated[NDArray[numpy.uint8], dict(shape=(None,), writable=False)],
    side_px: int,
    min_share: float,
    apart_m: float,
    reach_px: float = float('nan'),
) -> hoid_native.results.ClassifiedBoxes:
    """
    Return which of N boxes are dynamic (people and the objects they handle), and what is outside them.

    Args:
        depth_m: (H, W) float32, not empty; 0 or NaN = no reading.
        pixels: (K,) int64 flat indices of image corners.
        boxes_xyxy_px: (N, 4), finite.
        roles: (N,) uint8: `PERSON`, `MAY_BE_HANDLED` or 0 (see `hoid_native.boxes`).
        side_px: side of the square at a box's center whose median is its depth.
        min_share: a person handles an object if the person's box covers more than this share of it ...
        apart_m: ... and they are less than this apart in depth. An unknown depth counts as near.
        reach_px: if it is not NaN, it replaces `min_share`: one of the pixels in the object's box must
            be within this reach of the person's box, along rows and columns.

    Raises:
        ValueError: The image is empty, a pixel is not in it, a box is not finite, or lengths
            differ.
    """

def box_center_depths_m(
    depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    boxes_xyxy_px: numpy.typing.NDArray[Any],
    side_px: int,
) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]:
    """
    Return the (N,) median depths (m) of squares at the centers of boxes; NaN without a reading.

    Args:
        depth_m: (H, W) float32, not empty; 0 or NaN = no reading.
        boxes_xyxy_px: (N, 4), finite.
        side_px: side of the squares, at least 1. Outside the image they repeat its edge.

    Raises:
        ValueError: The image is empty, a box is not finite, or the side is less than 1.
    """

def person_depths_m(
    depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    boxes_xyxy_px: numpy.typing.NDArray[Any],
    known_m: numpy.typing.NDArray[Any],
) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]:
    """
    Return the (N,) depths (m) of the people in boxes; NaN without a reading.

    A person is the nearest layer of depths, as thick as a torso, in the middle of the box that is not
    much smaller than the largest layer. Only readings near the known depth are used, unless these are
    few.

    Args:
        depth_m: (H, W) float32; 0 or NaN = no reading.
        boxes_xyxy_px: (N, 4), finite, in pixels of this image.
        known_m: (N,) depths of the same people in an earlier image; NaN = unknown.

    Raises:
        ValueError: A box is not finite, or lengths differ.
    """

def segment_objects(
    depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    areas_xyxy_px: Annotated[NDArray[numpy.int32], dict(shape=(None, 4), writable=False)],
    depths_m: numpy.typing.NDArray[Any],
    reaches_m: numpy.typing.NDArray[Any],
    seen: Annotated[NDArray[numpy.bool_], dict(shape=(None,), writable=False)],
) -> Annotated[NDArray[numpy.bool_], dict(shape=(None, None))]:
    """
    Return the (H, W) mask of the pixels that show a dynamic object.

    The image is split into regions along depth jumps. An object is the regions that lie mostly in its
    area and near its depth, and the gaps without readings beside them. It may extend beyond its area
    by a tenth of a side, because boxes are not exact; parts of its regions further out have only
    merged with it in depth, like the desk that a person leans on (docs/decisions/010).

    Args:
        depth_m: (H, W) float32; 0 = no reading.
        areas_xyxy_px: (N, 4) int32 whole pixels within the image; x2 and y2 are exclusive.
        depths_m: (N,) depths of the objects; NaN = unknown: the object is its whole area.
        reaches_m: (N,) extents of the objects in depth, before and behind their own depth.
        seen: (N,) bool, whether each was detected in this image. If the regions of a detected object
            fill too little of its area, it has merged with what it touches: all pixels of the area
            near its depth count.

    Raises:
        ValueError: An area is not in the image, or lengths differ.
    """

def values_at(
    pixels: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    values: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), writable=False)],
    rows: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    columns: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
) -> Annotated[NDArray[numpy.uint8], dict(shape=(None,))]:
    """
    Return the (K,) uint8 values of a small image at pixels (u, v) of a large one.

    Each is `values[rows[v], columns[u]]`: nearest-neighbor upscaling of the pixels asked for.

    Args:
        pixels: (K,) int64 flat indices in the large (H, W) image.
        values: (h, w) uint8 small image.
        rows: (H,) int64 row of the small image for each of the large one.
        columns: (W,) int64 column of the small image for each of the large one.

    Raises:
        ValueError: A pixel is not in the image, or a row or a column not in `values`.
    """

class Pinhole:
    """A pinhole camera without distortion."""

    def __init__(self, fx_px: float, fy_px: float, cx_px: float, cy_px: float) -> None: ...
    @property
    def fx_px(self) -> float:
        """Horizontal focal length."""

    @property
    def fy_px(self) -> float:
        """Vertical focal length."""

    @property
    def cx_px(self) -> float:
        """Column of the principal point."""

    @property
    def cy_px(self) -> float:
        """Row of the principal point."""

def depth_segments(
    depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    cell_px: int,
) -> hoid_native.results.Segments:
    """
    Return the segments of a depth image, cut along depth jumps and along a grid of square cells.

    Args:
        depth_m: (H, W) float32; 0 = no reading.
        cell_px: side of a cell in pixels, at least 1.

    Raises:
        ValueError: The side is less than 1.
    """

def depth_ranges_3x3(
    depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
) -> Annotated[NDArray[numpy.float32], dict(shape=(None, None, None))]:
    """
    Return the (H, W, 2) float32 minimum and maximum depth (m) in the 3x3 pixels around each pixel.

    Both are 0 at pixels without a reading.

    Args:
        depth_m: (H, W) float32; 0 = no reading.
    """

def occlusion_log_odds(
    camera: Pinhole,
    depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    label: Annotated[NDArray[numpy.int32], dict(shape=(None, None), writable=False)],
    num_segments: int,
    earlier: Sequence[
        tuple[
            numpy.typing.NDArray[Any],
            Annotated[NDArray[numpy.float32], dict(shape=(None, None, 2), writable=False)],
            float,
        ]
    ],
    margin: tuple[float, float, float],
    evidence: tuple[float, float, float],
) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]:
    """
    Return the (S,) log-odds that segments move, from their occlusion of the depth in earlier views.

    A segment in front of the depth that an earlier view shows has moved there. A segment behind it is
    no evidence. Only every other row is compared, to save time.

    Args:
        camera: of all images.
        depth_m: (H, W) float32 current depth; 0 = no reading.
        label: (H, W) int32 segment of each pixel; -1 = none.
        num_segments: S.
        earlier: for each earlier view T_earlier_now (4, 4), its `depth_ranges_3x3` (H, W, 2), and the
            log-odds against motion of a segment that agrees with its depth everywhere.
        margin: a pixel occludes if it is nearer by more than the sum of a constant (m) and these
            shares of its depth (m) and of its squared depth.
        evidence: the log-odds of a segment that occludes everywhere, the occluding share up to which
            there is no evidence, and the occluding share from which agreement of the rest is none.

    Raises:
        ValueError: Images differ in size, or a label is not one of S.
    """

def depths_at(
    depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    pixels: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
) -> Annotated[NDArray[numpy.float32], dict(shape=(None,))]:
    """
    Return the (K,) float32 depths (m) at pixels; 0 for index -1 and for depths that are not finite.

    Args:
        depth_m: (H, W) float32.
        pixels: (K,) int64 flat indices; -1 = none.

    Raises:
        ValueError: An index is not in the image.
    """

def propagate_log_odds(
    camera: Pinhole,
    T_previous_now: numpy.typing.NDArray[Any],
    depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    previous_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    log_odds: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    margin: tuple[float, float, float],
    decay: float,
    label: Annotated[NDArray[numpy.int32], dict(shape=(None, None), writable=False)],
    evidence: Annotated[NDArray[numpy.float32], dict(shape=(None,), writable=False)],
    limit: float,
) -> Annotated[NDArray[numpy.float32], dict(shape=(None, None))]:
    """
    Return the (H, W) float32 log-odds of motion of the current pixels.

    They are the decayed log-odds of the same surface in the previous image plus the evidence of the
    current one. A pixel starts at 0 if the previous image shows another depth there, and has 0 without
    a reading.

    Args:
        camera: of both images.
        T_previous_now: (4, 4).
        depth_m: (H, W) float32 current depth; 0 = no reading.
        previous_m: (H, W) float32 depth of the previous image.
        log_odds: (H, W) float32 of the previous image's pixels.
        margin: depths of one surface differ by less than the sum of a constant (m) and these shares of
            the depth (m) and of its square.
        decay: factor of the previous log-odds.
        label: (H, W) int32 segment of each pixel; -1 = none.
        evidence: (S,) float32 log-odds to add to the pixels of each segment.
        limit: log-odds are clamped to [-limit, limit].

    Raises:
        ValueError: Images differ in size, a label is not one of S, or the limit is negative.
    """

def score_poses(
    camera: StereoParams,
    pixel_px: float,
    limit: float,
    T_camera_world: numpy.typing.NDArray[Any],
    points_m: numpy.typing.NDArray[Any],
    measured_px: numpy.typing.NDArray[Any],
    weights: numpy.typing.NDArray[Any],
) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None))]:
    """
    Return the (M, 2) weight sums of the points that each pose explains, for two sets of weights.

    A point counts 1 - (residual / limit)^2 of its weight, and nothing beyond the limit.

    Args:
        camera: of the image.
        pixel_px: standard deviation of pixels.
        limit: of residuals, in standard deviations.
        T_camera_world: (M, 4, 4).
        points_m: (N, 3).
        measured_px: (N, 3) u, v, u_right; NaN u_right: no depth.
        weights: (N, 2).

    Raises:
        ValueError: Lengths differ, or the noise or the limit is not positive.
    """

def align_triples(
    from_m: numpy.typing.NDArray[Any],
    to_m: numpy.typing.NDArray[Any],
    triples: Annotated[NDArray[numpy.int64], dict(shape=(None, 3), writable=False)],
) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None, None))]:
    """
    Return the (M, 4, 4) least-squares rigid transforms T_to_from of point triples.

    Args:
        from_m: (N, 3).
        to_m: (N, 3).
        triples: (M, 3) int64 indices of points; three points on a line give the identity.

    Raises:
        ValueError: Lengths differ, or an index is not one of N.

    Source: Umeyama, PAMI 1991, without scale, in closed form for three points.
    """

def strongest_corners_per_cell(
    corner_pixels: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    corner_scores: Annotated[NDArray[numpy.uint8], dict(shape=(None,), writable=False)],
    depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    small_of_pixel: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    label: Annotated[NDArray[numpy.int32], dict(shape=(None, None), writable=False)],
    cell_px: float,
    taken: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), writable=False)],
) -> Annotated[NDArray[numpy.int64], dict(shape=(None,))]:
    """
    Return the indices, in order of cells, of the strongest corner in each free cell of a grid.

    Only corners that have depth and lie on a depth segment are chosen. Among equal scores the first
    corner wins.

    Args:
        corner_pixels: (K,) int64 flat indices.
        corner_scores: (K,) uint8, higher is stronger.
        depth_m: (H, W) float32; 0 or not finite = no reading.
        small_of_pixel: (H * W,) int64 flat index in the downscaled image of each pixel.
        label: (h, w) int32 segment of each pixel of the downscaled image; -1 = none.
        cell_px: side of a cell in pixels.
        taken: (rows, columns) uint8 of the cells, which cover the image; 0 = free.

    Raises:
        ValueError: Lengths differ, a corner is not in the image, or the cells do not cover it.
    """
