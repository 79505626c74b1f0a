"""Compiled kernels; import them from hoid_native."""

from collections.abc import Sequence
from typing import Annotated, Any

import numpy
import numpy.typing
from numpy.typing import NDArray

import hoid_native.parameters
import hoid_native.results

def fast_corners(
    levels: Sequence[Annotated[NDArray[numpy.uint8], dict(shape=(None, None), writable=False)]],
    steps_px: Annotated[NDArray[numpy.float32], dict(shape=(None, 2), writable=False)],
    threshold: int,
    border_px: int,
) -> hoid_native.results.Corners:
    """
    Return the FAST-9/16 corners of an image pyramid after 3x3 non-maximum suppression.

    Source: Rosten and Drummond, ECCV 2006. Corners and scores equal OpenCV's. A level has no corners
    if it is less than 32 px wide or high without the border.

    Args:
        levels: at most 256 gray images, the finest first.
        steps_px: (L, 2) level-0 pixels per pixel of each level, in x and y.
        threshold: contrast in gray levels that a corner must exceed, from 1 to 254.
        border_px: least distance of a corner from the edge of its level; values below 3 count as 3.
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
    Among equal scores the first corner wins. If an octave has too few corners, the other octaves get
    the rest of its budget.

    Args:
        uv_px: (N, 2) positions of the corners in level 0, from 0 to less than 65536.
        octave, score: (N,) index of the level of each corner, less than L, and its strength.
        budgets: (L,) number of corners wanted from each octave.
        area_px: image area over which the corners are spread, in level-0 pixels. A grid cell has at
            least one pixel.
    """

def subpixel_offsets_px(
    image_gray: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), writable=False)],
    x: Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)],
    y: Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)],
) -> Annotated[NDArray[numpy.float32], dict(shape=(None, None))]:
    """
    Return the (N, 2) offsets (x, y) in pixels from FAST corners to their subpixel peaks.

    The peak is the maximum of the quadratic fitted to the signed FAST scores of the corner's pixel and
    its 8 neighbors (docs/decisions/008). Offsets are clamped to [-0.5, 0.5]; they are 0 if the
    quadratic has no maximum.

    Args:
        x, y: (N,) columns and rows of the corners, at least 4 px from the image's edge.
    """

def orientations_deg(
    image_gray: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), writable=False)],
    x: Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)],
    y: Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)],
) -> Annotated[NDArray[numpy.float32], dict(shape=(None,))]:
    """
    Return the (N,) orientations of corners in degrees, in [0, 360), clockwise from the x axis.

    They are the directions of the intensity centroids (Rublee et al., ORB, ICCV 2011, sec. 3.2).

    Args:
        x, y: (N,) columns and rows of the corners, at least 15 px from the image's edge.
    """

def orb_descriptors(
    image_smooth: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), writable=False)],
    x: Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)],
    y: Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)],
    angle_deg: Annotated[NDArray[numpy.float32], dict(shape=(None,), writable=False)],
) -> Annotated[NDArray[numpy.uint8], dict(shape=(None, None))]:
    """
    Return the (N, 32) ORB descriptors of corners of a smoothed image, rotated by their orientations.

    Source: Rublee et al., ORB, ICCV 2011, sec. 4. The bits equal OpenCV's.

    Args:
        x, y: (N,) columns and rows of the corners, at least 19 px from the image's edge.
        angle_deg: (N,) orientations, as `orientations_deg` returns them; finite.
    """

class ObservationGraph:
    """
    Stores which keyframes observe which map points, and how many points two keyframes share.

    Keyframes (`i`), their features (`k`) and points (`j`) are int64 row numbers from 0 to 2^31 - 2. The
    cost of most calls depends on the observations concerned and not on the size of the map. Except in
    the table of `points_of`, a number in an array that is out of range raises a ValueError.
    """

    def __init__(self) -> None: ...
    def observe(
        self,
        i: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
        k: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
        j: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    ) -> None:
        """
        Add N observations: keyframe i (N,) observes point j (N,) in its feature k (N,).

        They must not have been added before, which is not checked.
        """

    def unobserve(
        self,
        i: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
        k: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
        j: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    ) -> None:
        """
        Remove N observations of points j (N,) by keyframes i (N,) in their features k (N,).

        Raises:
            ValueError: One of the observations does not exist; those before it are removed nevertheless.
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
        Return the observations of points j (P,), sorted by keyframe and feature.

        Args:
            keyframes: (K,) rows of the keyframes whose observations are returned; the observations are
                sorted by the order of the keyframes in this list. None: all keyframes, sorted by row.
        """

    def observations_by_point(
        self, j: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)]
    ) -> hoid_native.results.Observations:
        """
        Return the observations of points j (P,), sorted by point, keyframe and feature.
        """

    def connect(
        self, i: int, j: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)]
    ) -> None:
        """
        Count again how many points keyframe i shares with each other keyframe, and store the numbers.

        Args:
            j: (P,) rows of all points that the keyframe observes.
        """

    def set_neighbors(
        self,
        i: int,
        rows: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
        shared: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    ) -> None:
        """
        Replace the stored numbers of points that keyframe i shares with other keyframes, both ways.

        Args:
            rows: (N,) rows of all keyframes that share points with it, ascending, each once.
            shared: (N,) numbers of shared points, at least 1.
        """

    def neighbors(self, i: int, min_shared: int = 1) -> hoid_native.results.Neighbors:
        """
        Return the keyframes that share at least `min_shared` points with keyframe i, as stored last.

        Those that share most points come first; those that share equally many are sorted by row.
        """

    def edges(self, min_shared: int = 1) -> hoid_native.results.Edges:
        """
        Return the pairs of keyframes that share at least `min_shared` points, as stored last.

        They are sorted by first and second row.
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

        Each step of a path joins two keyframes that share at least `min_shared` points, or a keyframe and
        its parent in the spanning tree. The length is infinite if there is no path.

        Args:
            T_map_camera: (K, 4, 4) poses of all keyframes.
            parents: (K,) row of each keyframe's parent in the spanning tree; -1: none.
            start, goal: rows of the first and the last keyframe.
            m_per_rad: length [m] that is added to a step for each radian of its rotation.
        """

    def count_observed(
        self,
        j: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
        keyframes: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    ) -> Annotated[NDArray[numpy.int64], dict(shape=(None,))]:
        """
        Return how many of the distinct points j (P,) each of the keyframes (K,) observes, (K,).
        """

    def points_of(
        self,
        point_of_feature: Annotated[
            NDArray[numpy.int32], dict(shape=(None, None), writable=False)
        ],
        keyframes: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    ) -> Annotated[NDArray[numpy.int64], dict(shape=(None,))]:
        """
        Return the (P,) ascending rows of the points that at least one of some keyframes (N,) observes.

        What they observe is read from a table, not from the stored observations.

        Args:
            point_of_feature: (K, F) int32 row of the point that each feature of each keyframe observes, or
                -1. The values are not checked.
        """

def point_statistics(
    T_map_camera: numpy.typing.NDArray[Any],
    keyframe_uid: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    octave: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), writable=False)],
    descriptors: Annotated[NDArray[numpy.uint8], dict(shape=(None, None, 32), writable=False)],
    position_m: numpy.typing.NDArray[Any],
    reference_uid: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    i: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    k: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    j: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    octave_scale: numpy.typing.NDArray[Any],
) -> hoid_native.results.PointStatistics:
    """
    Return viewing direction, scale range and descriptor of points, nearly as ORB-SLAM's MapPoint.

    The largest distance is that at which some octave can detect the point: its distance in the
    reference keyframe times the scale of the octave in which it was observed there. If the reference
    keyframe does not observe the point, the keyframe of its first observation becomes the reference.
    The descriptor is one of the point's last eight observations: the one with the least median
    distance to them (ComputeDistinctiveDescriptors of ORB-SLAM); of two, it is the second one.

    Args:
        T_map_camera, keyframe_uid: (K, 4, 4) poses and (K,) uids of the keyframes.
        octave, descriptors: (K, F) and (K, F, 32), of their features.
        position_m, reference_uid: (P, 3) positions of all points, and (P,) uids of their reference
            keyframes.
        i, k, j: (N,) rows of keyframes, which observe in these features these points; j ascends.
        octave_scale: (L,) scales of the octaves, at least one; octaves from L on have the last one.
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
    Apply rigid motions (G, 4, 4) to points and their viewing directions, in place.

    Args:
        which: (N,) index of the motion of each point; -1: the point stays.
        position_m, view_direction: (N, 3) of the points, which are changed.
    """

def overlap_ratios(
    boxes_xyxy_px: numpy.typing.NDArray[Any], others_xyxy_px: numpy.typing.NDArray[Any]
) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None))]:
    """
    Return the (N, M) ratios of the area of box n that other box m covers, in [0, 1].

    This is the interaction area of the HOID paper. It is 0 for a box without area.
    """

def intersections_over_union(
    boxes_xyxy_px: numpy.typing.NDArray[Any], others_xyxy_px: numpy.typing.NDArray[Any]
) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None))]:
    """
    Return the (N, M) intersections over union of boxes, in [0, 1]; 0 for boxes without area.
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
    Return which of N boxes are dynamic, and which of K pixels lie in none of them.

    Dynamic are people, and objects with the role `MAY_BE_HANDLED` that a person handles: the person's
    box covers more than `min_share` of the object's box, and their depths differ by less than
    `apart_m`. An unknown depth fulfills the second condition.

    Args:
        pixels: (K,) pixels of image corners, as indices into the flattened image.
        roles: (N,) role of each box: `PERSON`, `MAY_BE_HANDLED` or 0 (see `hoid_native.boxes`).
        side_px: side of the square at a box's center whose median depth is the depth of the box; at
            least 1.
        min_share: ratio of an object's box that a person's box must exceed.
        apart_m: depth difference below which person and object must be.
        reach_px: if this is not NaN, it replaces `min_share`: one of the K pixels must lie in the
            object's box, at most this far from the person's box along rows and columns.
    """

def box_center_depths_m(
    depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    boxes_xyxy_px: numpy.typing.NDArray[Any],
    side_px: int,
) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]:
    """
    Return the (N,) median depths (m) in squares at the centers of boxes; NaN without a measurement.

    Args:
        side_px: side of the squares, at least 1. Beyond the image, its border pixels are repeated.
    """

def person_depths_m(
    depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    boxes_xyxy_px: numpy.typing.NDArray[Any],
    known_m: numpy.typing.NDArray[Any],
) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]:
    """
    Return the (N,) depths (m) of the people in boxes; NaN without a measurement.

    A layer is a range of depth as thick as a torso (0.4 m). The depth is the median of the nearest
    layer of the measurements in the middle of the box that has at least 60 % as many of them as the
    fullest layer. Measurements from 10 m on are not used. If the depth of the person in an earlier
    image is known, only measurements near this depth are used, unless there are few of them.

    Args:
        known_m: (N,) depths of the same people in an earlier image; NaN = unknown.
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

    The depth image is split into regions along depth jumps. To an object belong the regions that lie
    mostly in its box and near its depth, and gaps without measurements beside these regions. Because
    boxes are not exact, the object may extend beyond its box by a tenth of the box's side. Parts of a
    region that are further outside are not masked: they belong to something that touches the object,
    like the desk on which a person leans (docs/decisions/010).

    Args:
        areas_xyxy_px: (N, 4) boxes of whole pixels within the image; x2 and y2 are exclusive.
        depths_m: (N,) depths of the objects. NaN = unknown: the whole box is masked.
        reaches_m: (N,) largest difference between an object's depth and the depths of its regions.
        seen: (N,) whether the object was not missed in this image. If the regions of a detected object
            fill little of its box, the object has merged with its surroundings; then all pixels of the
            box near its depth are masked.
    """

def match_by_projection(
    projection_px: numpy.typing.NDArray[Any],
    radius_px: numpy.typing.NDArray[Any],
    queries: hoid_native.parameters.QueryConstraints,
    candidates: hoid_native.parameters.Candidates,
    threshold: hoid_native.parameters.MatchThreshold,
) -> hoid_native.results.Pairs:
    """
    Return one-to-one matches of queries and features within windows around expected positions.

    Args:
        projection_px: (3, Q) expected u, v, u_right of each query; NaN u_right: unknown.
        radius_px: (Q,) half sides of the square windows around u, v. If expected and measured u_right
            are known, they must also agree within the radius.
    """

def match_along_segments(
    segments_px: numpy.typing.NDArray[Any],
    octave_radius_px: numpy.typing.NDArray[Any],
    queries: hoid_native.parameters.QueryConstraints,
    candidates: hoid_native.parameters.Candidates,
    threshold: hoid_native.parameters.MatchThreshold,
) -> hoid_native.results.Pairs:
    """
    Return one-to-one matches of queries and features near image segments (of epipolar lines).

    Args:
        segments_px: (Q, 4) u, v of both ends of each query's segment; NaN: no segment.
        octave_radius_px: (L,) largest distance between a segment and a feature, by the octave of the
            feature. It must not decrease with the octave. All octaves are less than L.
    """

def hash_keys(
    descriptors: Annotated[NDArray[numpy.uint8], dict(shape=(None, 32), writable=False)],
    bits: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), writable=False)],
) -> Annotated[NDArray[numpy.uint64], dict(shape=(None, None))]:
    """
    Return the (T, N) uint64 keys of descriptors (N, 32) in T hash tables, in the 32 upper bits.

    The lower bits are 0. Each key consists of some bits of the descriptor (locality-sensitive hashing,
    Indyk and Motwani, STOC 1998).

    Args:
        bits: (T, B) uint8 bits of the descriptor, at most 32, that are bits 0, 1, ... of the keys of
            each table. They are numbered as `numpy.unpackbits` orders them.
    """

def depth_segments(
    depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    cell_px: int,
) -> hoid_native.results.Segments:
    """
    Return the segments of a depth image, cut along depth jumps and along a grid of square cells.

    A depth jump is a difference of at least 0.02 m plus 3 % of the depth within 3x3 pixels. Pixels
    without a measurement count as depth 0, so that there is a jump beside them.

    Args:
        cell_px: side of a cell in pixels, at least 1.
    """

def occlusion_log_odds(
    camera: hoid_native.parameters.Pinhole,
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
    Return the (S,) log-odds that segments move, by comparison with the depth in earlier views.

    A pixel in front of the depth that an earlier view shows there occludes it: the surface has moved
    there since. A pixel behind this depth is no evidence. Only every other row is compared, to save
    time. The log-odds of all earlier views are added up.

    Args:
        label: (H, W) segment of each pixel, less than S; -1 = none.
        earlier: for each earlier view, the camera motion T_earlier_now (4, 4), the least and the
            greatest depth in the 3x3 pixels around each of its pixels (H, W, 2), 0 where it has no
            depth, and the log-odds against motion of a segment that has the same depth everywhere.
        margin: coefficients of 1 (in m), z and z^2. A pixel of depth z occludes if it is nearer by
            more than their sum.
        evidence: three numbers: the log-odds of a segment that occludes with all its pixels, which are
            multiplied by the ratio of those that do; the occluding ratio that must be exceeded to
            count as evidence; and the occluding ratio from which on equal depth of the other pixels is
            no evidence against motion.
    """

def propagate_log_odds(
    camera: hoid_native.parameters.Pinhole,
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
    Return the (H, W) log-odds that each pixel of the current image moves.

    They are the log-odds of the same surface in the previous image, multiplied by `decay`, plus the
    evidence from the current image. Where the previous image shows another depth or none, a pixel
    starts at 0. A pixel of the current image without a measurement has 0.

    Args:
        T_previous_now: (4, 4) pose of the current camera in the previous camera's frame.
        previous_m, log_odds: (H, W) depth of the previous image, and log-odds of its pixels.
        margin: coefficients of 1 (in m), z and z^2. A pixel of depth z shows the same surface if the
            depths differ by less than their sum.
        label: (H, W) segment of each pixel of the current image, less than S; -1 = none.
        evidence: (S,) log-odds that are added to the pixels of each segment.
        limit: the result is clamped to [-limit, limit].
    """

def score_poses(
    camera: hoid_native.parameters.StereoParams,
    pixel_px: float,
    limit: float,
    T_camera_world: numpy.typing.NDArray[Any],
    points_m: numpy.typing.NDArray[Any],
    measured_px: numpy.typing.NDArray[Any],
    weights: numpy.typing.NDArray[Any],
) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None))]:
    """
    Return the (M, 2) weights of the points that each pose explains, summed for two sets of weights.

    A point counts with 1 - (residual / limit)^2 of its weight; beyond the limit, or nearer than 0.1 m
    in front of the camera, it does not count.

    Args:
        camera: camera model of the image. Its `disparity_noise_px` is in units of `pixel_px` here; the
            other parts of its noise are not used.
        pixel_px: standard deviation of u and of v, positive.
        limit: largest residual of an explained point, in standard deviations, positive.
        T_camera_world: (M, 4, 4) poses of the world in the camera frame.
        points_m, measured_px, weights: (N, 3) points in the world, (N, 3) stereo observations u, v,
            u_right (NaN u_right: no depth), and (N, 2) two weights of each.
    """

def align_triples(
    from_m: numpy.typing.NDArray[Any],
    to_m: numpy.typing.NDArray[Any],
    triples: Annotated[NDArray[numpy.int64], dict(shape=(None, 3), writable=False)],
) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None, None))]:
    """
    Return the (M, 4, 4) rigid transforms T_to_from that align triples of points with least squares.

    Source: Umeyama, PAMI 1991, without scale, in closed form for three points. For three points on a
    line, the result is the identity.

    Args:
        from_m, to_m: (N, 3) points in the frame `from`, and the same points in the frame `to`.
        triples: (M, 3) indices of the points of each triple, less than N.
    """

def register_depth(
    depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    rays: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 3), writable=False)],
    t_m: Annotated[NDArray[numpy.float32], dict(shape=(3), writable=False)],
    side_px: Annotated[NDArray[numpy.float32], dict(shape=(2), writable=False)],
    camera: hoid_native.parameters.Pinhole,
    size_px: tuple[int, int],
) -> Annotated[NDArray[numpy.float32], dict(shape=(None, None))]:
    """
    Return the (H, W) depth image (m) that another camera sees; 0 = no measurement.

    A depth pixel covers as many pixels of the other camera as it is large. Of several depths at a
    pixel, the nearest is kept.

    Args:
        depth_m: (h, w) depth; 0, negative or NaN = no measurement.
        rays: (h, w, 3) ray of each depth pixel in the frame of the other camera. A point at depth z is
            at z times the ray plus `t_m`.
        t_m: (3,) position of the depth camera in the frame of the other camera.
        side_px: (2,) width and height of a depth pixel in pixels of the other camera, at equal depth.
        camera, size_px: the other camera, and its width W and height H, positive.
    """

def voxel_keys(
    points_m: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), writable=False)],
    voxel_m: float,
    bits: int,
) -> Annotated[NDArray[numpy.int64], dict(shape=(None,))]:
    """
    Return the (N,) keys of the voxels of points (N, 3); -1 outside the grid.

    Args:
        voxel_m: side of a voxel, positive.
        bits: the grid has 2^bits voxels along each axis (1 to 20 bits), half of them on either side of
            the origin.
    """

def voxels_of(
    points_m: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), writable=False)],
    voxel_m: float,
    bits: int,
) -> hoid_native.results.Voxels:
    """
    Return the voxels of the points (N, 3) of one image, each of which was hit once.

    Points outside the grid are left out (see `voxel_keys`).
    """

def merged_voxels(
    voxels: tuple[
        Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
        Annotated[NDArray[numpy.float64], dict(shape=(None, 3), writable=False)],
        Annotated[NDArray[numpy.float32], dict(shape=(None,), writable=False)],
        Annotated[NDArray[numpy.float32], dict(shape=(None,), writable=False)],
        Annotated[NDArray[numpy.float32], dict(shape=(None,), writable=False)],
    ],
    others: tuple[
        Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
        Annotated[NDArray[numpy.float64], dict(shape=(None, 3), writable=False)],
        Annotated[NDArray[numpy.float32], dict(shape=(None,), writable=False)],
        Annotated[NDArray[numpy.float32], dict(shape=(None,), writable=False)],
        Annotated[NDArray[numpy.float32], dict(shape=(None,), writable=False)],
    ],
    max_count: float,
    max_voxels: int,
) -> hoid_native.results.Voxels:
    """
    Return the voxels of two sets (`Voxels`), with the sum of the evidence where both have one.

    Args:
        max_count: hits and misses of a voxel are scaled down together to this sum.
        max_voxels: of more voxels, those with fewest hits are left out; at least 1.
    """

def solid_voxels(
    voxels: tuple[
        Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
        Annotated[NDArray[numpy.float64], dict(shape=(None, 3), writable=False)],
        Annotated[NDArray[numpy.float32], dict(shape=(None,), writable=False)],
        Annotated[NDArray[numpy.float32], dict(shape=(None,), writable=False)],
        Annotated[NDArray[numpy.float32], dict(shape=(None,), writable=False)],
    ],
    least_hits: float,
    least_share: float,
    cell_m: float | None,
    bits: int,
) -> Annotated[NDArray[numpy.bool_], dict(shape=(None,))]:
    """
    Return the (N,) mask of the voxels (`Voxels`) that were hit often enough.

    Args:
        least_hits: smallest number of hits.
        least_share: smallest ratio of the hits to the sum of hits and misses.
        cell_m: side of the cells whose voxels are counted together; None: each is counted alone.
        bits: number of cells along each axis (see `voxel_keys`).
    """

def pixels_on_surface(
    depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    points_map_m: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), writable=False)],
    box_px: tuple[int, int, int, int],
    T_object_map: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), writable=False)],
    cells: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    cell_m: float,
    bits: int,
) -> Annotated[NDArray[numpy.int64], dict(shape=(None,))]:
    """
    Return the ascending pixels with depth in a box whose points are in cells of a surface.

    Args:
        box_px: left, top, right and bottom, cut at the border; right and bottom are excluded.
        T_object_map: (4, 4) transform from the map frame to that of the cells.
        cells: ascending keys (`voxel_keys`) of the cells of the surface.
        cell_m, bits: side of a cell, and number of cells along each axis (see `voxel_keys`).
    """

def share_on_surface(
    points_map_m: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), writable=False)],
    T_object_map: Annotated[NDArray[numpy.float64], dict(shape=(4, 4), writable=False)],
    cells: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    cell_m: float,
    bits: int,
) -> float:
    """
    Return the ratio of points (N, 3) that are in cells of a surface; 0 without points.

    The points are in the map frame; the other arguments are those of `pixels_on_surface`.
    """

def object_surfaces(
    depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    points_map_m: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), writable=False)],
    pixel_m: float,
    boxes_px: Annotated[NDArray[numpy.int32], dict(shape=(None, 4), writable=False)],
    areas_px: Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)],
    is_person: Annotated[NDArray[numpy.bool_], dict(shape=(None,), writable=False)],
    is_support: Annotated[NDArray[numpy.bool_], dict(shape=(None,), writable=False)],
    may_be_flat: Annotated[NDArray[numpy.bool_], dict(shape=(None,), writable=False)],
    T_box_map: Annotated[NDArray[numpy.float64], dict(shape=(None, 4, 4), writable=False)],
    known_low_m: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), writable=False)],
    known_high_m: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), writable=False)],
    owner: Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)],
) -> hoid_native.results.ObjectSurfaces:
    """
    Return the surfaces of the D detected objects that have enough depth pixels, without people.

    The surface is the nearest layer of depth in the box, without planes that continue around the box.
    Where two boxes claim the same surface, it belongs to the box that it fills better, or of two boxes
    that are filled to the smaller one. The other object is segmented again from the remaining pixels,
    and left out if they are too few; a person keeps its pixels. Of a known object that is hidden in
    part, the surface is what lies in its known box.

    Args:
        pixel_m: distance between neighboring pixels at a depth of 1 m.
        boxes_px: (D, 4) left, top, right and bottom of the detections, within the image; right and
            bottom are excluded.
        areas_px: (D,) areas of the boxes, also of what is beyond the image.
        is_support: (D,) whether other objects may lie on it.
        may_be_flat: (D,) whether the surface may be a part of a plane that continues around the box.
        T_box_map: (D, 4, 4) transforms from the map frame to that of the known object.
        known_low_m, known_high_m: (D, 3) lowest and highest corners of the known boxes; if the lowest
            ones are not below the highest ones, the object is unknown.
        owner: (H * W,) detection of the known object that shows at each pixel; -1 = none.
    """

def transformed_parts(
    points_m: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), writable=False)],
    ends: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    T: Annotated[NDArray[numpy.float64], dict(shape=(None, 4, 4), writable=False)],
) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None))]:
    """
    Return points (N, 3) in other frames, those of each part with its own transform T (P, 4, 4).
    """

def seen_voxels(
    depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    ahead: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    uv_px: Annotated[NDArray[numpy.float64], dict(shape=(None, 2), writable=False)],
    voxel_depth_m: Annotated[NDArray[numpy.float64], dict(shape=(None,), writable=False)],
    is_solid: Annotated[NDArray[numpy.bool_], dict(shape=(None,), writable=False)],
    ends: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    margin: tuple[float, float],
) -> hoid_native.results.SeenVoxels:
    """
    Return what an image shows at the N voxels of O objects, of one after the other.

    A voxel is visible if the measured depth at its nearest pixel differs from its own by at most the
    margin, and seen through if the measured depth is larger.

    Args:
        ahead, uv_px: (M,) rows of the voxels in front of the camera, within its range, and (M, 2) their
            pixels, which need not be within the image.
        voxel_depth_m: (N,) depths of all voxels.
        is_solid: (N,) whether the voxel belongs to its object.
        margin: largest difference of depths: constant (m), and multiple of the squared depth (1/m).
    """

def missed_voxels(
    uv_px: Annotated[NDArray[numpy.float64], dict(shape=(None, 2), writable=False)],
    is_visible: Annotated[NDArray[numpy.bool_], dict(shape=(None,), writable=False)],
    box_px: Annotated[NDArray[numpy.float64], dict(shape=(4), writable=False)],
    others: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    width: int,
) -> Annotated[NDArray[numpy.int64], dict(shape=(None,))]:
    """
    Return the ascending rows of visible voxels that an image shows not to belong to an object.

    They are outside the box of the object, or at pixels that show other things.

    Args:
        uv_px: (N, 2) pixels of the voxels; NaN where they are not visible.
        box_px: (4,) left, top, right and bottom; all are inside.
        others: ascending flat indices of the pixels that show other things in an image of this width.
    """

def pair_scores(
    points_map_m: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), writable=False)],
    point_ends: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    boxes_px: Annotated[NDArray[numpy.int32], dict(shape=(None, 4), writable=False)],
    T_box_map: Annotated[NDArray[numpy.float64], dict(shape=(None, 4, 4), writable=False)],
    low_m: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), writable=False)],
    high_m: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), writable=False)],
    uv_px: Annotated[NDArray[numpy.float64], dict(shape=(None, 2), writable=False)],
    is_visible: Annotated[NDArray[numpy.bool_], dict(shape=(None,), writable=False)],
    voxel_ends: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    is_candidate: Annotated[NDArray[numpy.bool_], dict(shape=(None, None), writable=False)],
) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None))]:
    """
    Return the (S, O) scores of pairs of segments and objects, in [0, 1].

    The score is the geometric mean of the ratio of the segment's points that are in the box of the
    object, and of the ratio of the object's visible voxels that are in the box of the detection. Voxels
    up to half a pixel left of this box or above it are inside.

    Args:
        points_map_m: (N, 3) points of all segments, of one after the other.
        boxes_px: (S, 4) boxes of the detections; right and bottom are excluded.
        T_box_map: (O, 4, 4) transforms from the map frame to that of the object's box.
        low_m, high_m: (O, 3) lowest and highest corners of the objects' boxes.
        uv_px, is_visible: (V, 2) pixels of the voxels of all objects, and (V,) whether they are visible.
        is_candidate: (S, O) the scores of other pairs are 0.
    """

def optimize_pose(
    camera: hoid_native.parameters.StereoParams,
    gates: hoid_native.parameters.Gates,
    points_m: numpy.typing.NDArray[Any],
    measured_px: numpy.typing.NDArray[Any],
    inv_sigma2: numpy.typing.NDArray[Any],
    T_camera_map: numpy.typing.NDArray[Any],
    prior_T_camera_map: numpy.typing.NDArray[Any] | None = None,
    prior_information: numpy.typing.NDArray[Any] | None = None,
) -> hoid_native.results.PoseFit:
    """
    Return the camera pose that fits N matches best: Gauss-Newton with Huber kernels.

    Pixels and the disparity u - u_right are independent measurements with separate robust kernels,
    unless `joint_noise` is on. Outliers are identified on (u, v, u_right) after each of three rounds
    (Mur-Artal and Tardos, T-RO 2017). The information of the result has the unit of `inv_sigma2` and
    includes the prior. With fewer than four matches and no prior, the initial pose is returned, with
    the identity as its information and all matches as inliers. With fewer than four inliers after a
    round and no prior, the pose of that round is returned.

    Args:
        gates: limits of outliers. The Huber kernel of pixels has the limit `gates.mono`, that of the
            disparity 3.841; with `joint_noise`, both limits are those of outliers.
        points_m: (N, 3) map points in the map frame.
        measured_px: (N, 3) stereo observations u, v, u_right; NaN u_right: no depth.
        inv_sigma2: (N,) 1 / variance of u, and equally of v, of each match [1/px^2]. The outlier test
            applies it to u_right as well. Otherwise, the disparity u - u_right has a variance of its
            own, which the camera states, unless `joint_noise` is on.
        T_camera_map: (4, 4) initial pose of the map in the camera frame.
        prior_T_camera_map: (4, 4) mean of a Gaussian prior of the pose, finite; None: no prior.
        prior_information: (6, 6) inverse covariance of the prior, as a left twist with the rotation
            first, finite; None: no prior. It is added to the information of the matches as it is.
    """

def evaluate_matches(
    camera: hoid_native.parameters.StereoParams,
    gates: hoid_native.parameters.Gates,
    points_m: numpy.typing.NDArray[Any],
    measured_px: numpy.typing.NDArray[Any],
    inv_sigma2: numpy.typing.NDArray[Any],
    T_camera_map: numpy.typing.NDArray[Any],
) -> hoid_native.results.MatchEvaluation:
    """
    Return how well each of N matches fits a pose.

    The squared errors of pixel and disparity, each divided by its measured variance, are truncated at
    `gates.mono` and at 3.841 (MSAC, Torr and Zisserman, CVIU 2000); with `joint_noise`, that of
    (u, v, u_right) at the limit of outliers. Therefore the sum over all matches can be compared
    between poses that have different outliers.

    Points, measurements and `inv_sigma2` are those of `optimize_pose`.
    """

def most_biasing_region(
    camera: hoid_native.parameters.StereoParams,
    gates: hoid_native.parameters.Gates,
    points_m: numpy.typing.NDArray[Any],
    measured_px: numpy.typing.NDArray[Any],
    inv_sigma2: numpy.typing.NDArray[Any],
    T_camera_map: numpy.typing.NDArray[Any],
    noise_scale: float,
) -> hoid_native.results.BiasingRegion:
    """
    Return the region of the view without whose matches the other matches fit a pose best.

    Candidates are the cells of a k-d tree over direction and depth, which contain from 1/16 to 1/4 of
    the matches (docs/decisions/036). Pixel and disparity are independent measurements, even if
    `joint_noise` is on. If a point or the pose is not finite, the region is empty and has a gain of 0.

    A pixel error beyond `gates.mono` and a disparity error beyond 3.841 are not used.

    Args:
        points_m, measured_px, inv_sigma2: as in `optimize_pose`.
        T_camera_map: (4, 4) pose fitted to all matches.
        noise_scale: actual variances divided by the variances that camera and `inv_sigma2` state.
    """

def adjust_bundle(
    lens: hoid_native.parameters.StereoParams,
    gates: hoid_native.parameters.Gates,
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
    Return camera poses and points after bundle adjustment: Levenberg-Marquardt with Huber kernels.

    The adjustment has several rounds. Observations that are outliers after a round are not used in the
    following rounds. Pixels and disparities have separate robust kernels, unless `joint_noise` is on.

    Args:
        lens, gates: as in `optimize_pose`.
        T_camera_map: (C, 4, 4) camera poses. The first `num_free` are optimized, the others fixed.
        points_m: (P, 3) map points in the map frame, which are all optimized.
        camera, point: (M,) indices of the camera and of the point of each observation. A camera
            observes a point at most once.
        measured_px, inv_sigma2: (M, 3) and (M,) as in `optimize_pose`, of each observation.
        rounds, iterations: number of rounds, at least 1, and largest number of iterations in each.

    Raises:
        MemoryError: The dense system of the optimized cameras does not fit in memory.
    """
