"""The kernels; import them from hoid_native."""

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
    Return the FAST-9/16 corners of a pyramid's levels after 3x3 non-maximum suppression.

    Source: Rosten and Drummond, ECCV 2006; the same corners and scores as OpenCV's.

    Args:
        levels: L of (H_l, W_l) uint8, the finest first.
        steps_px: (L, 2) float32 level-0 pixels per pixel of each level, in x and y.
        threshold: grey levels, from 1 to 254.
        border_px: how far corners are from the edge of their level, at least; 3 where it is less.

    Raises:
        ValueError: The threshold or the border is out of range, or not every level has its steps.
    """

def spread_evenly(
    uv_px: numpy.typing.NDArray[Any],
    octave: Annotated[NDArray[numpy.uint8], dict(shape=(None,), writable=False)],
    score: Annotated[NDArray[numpy.uint8], dict(shape=(None,), writable=False)],
    budgets: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    area_px: float,
) -> Annotated[NDArray[numpy.int64], dict(shape=(None,))]:
    """
    Return the indices (ascending) of the corners to keep, at most `budgets.sum()` of N.

    Each octave lays a grid of about as many cells as its budget over the area to fill. The strongest
    corner of every cell goes first, then the second of every cell, and so on until the octave's budget
    is spent; of equals, the first. What octaves with few corners leave over goes to the others.

    Args:
        uv_px: (N, 2) level-0 pixels, not negative.
        octave: (N,) uint8.
        score: (N,) uint8, higher is stronger.
        budgets: (L,) int64 corners of each octave.
        area_px: image area, in level-0 pixels, that the budget is to fill; no cell is smaller than a
            pixel.

    Raises:
        ValueError: Lengths differ, an octave has no budget, or a budget, a position or
            the area is negative.
    """

def corner_peaks_px(
    image_gray: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), writable=False)],
    x: Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)],
    y: Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)],
) -> Annotated[NDArray[numpy.float32], dict(shape=(None, None))]:
    """
    Return the (N, 2) offsets from FAST corners to where their score peaks between the pixels.

    The peak is that of the quadratic that fits the signed scores of a corner's pixel and its eight
    neighbours best, no further than the edge of the pixel: within [-0.5, 0.5] in x and in y, and 0
    where the quadratic has none.

    Args:
        image_gray: (H, W) uint8.
        x: (N,) int32.
        y: (N,) int32.

    Raises:
        ValueError: A pixel is less than 4 px from the edge, or there are more of x than of y.
    """

def orientations_deg(
    image_gray: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), writable=False)],
    x: Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)],
    y: Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)],
) -> Annotated[NDArray[numpy.float32], dict(shape=(None,))]:
    """
    Return the (N,) intensity-centroid angles in [0, 360) of pixels, y down.

    Source: Rublee et al., ORB, ICCV 2011, sec. 3.2.

    Args:
        image_gray: (H, W) uint8.
        x: (N,) int32.
        y: (N,) int32.

    Raises:
        ValueError: A pixel is less than 15 px from the edge, or there are more of x than of y.
    """

def orb_descriptors(
    image_smooth: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), writable=False)],
    x: Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)],
    y: Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)],
    angle_deg: Annotated[NDArray[numpy.float32], dict(shape=(None,), writable=False)],
) -> Annotated[NDArray[numpy.uint8], dict(shape=(None, None))]:
    """
    Return the (N, 32) descriptors of pixels, turned by their angles.

    Source: Rublee et al., ORB, ICCV 2011, sec. 4; the same bits as OpenCV's.

    Args:
        image_smooth: (H, W) uint8.
        x: (N,) int32.
        y: (N,) int32.
        angle_deg: (N,) float32.

    Raises:
        ValueError: A pixel is less than 19 px from the edge, an angle is not finite, or lengths
            differ.
    """

class FlowPyramid:
    """
    A grey image at halved sizes, and its slopes, in which points are followed.
    """

    def __init__(
        self,
        image_gray: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), writable=False)],
        num_levels: int,
    ) -> None:
        """
        Take an image.

        Args:
            image_gray: (H, W) uint8.
            num_levels: with the image itself; less where one would be too small.

        Raises:
            ValueError: The image is empty, or there is no level.
        """

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the image."""

class FlowSearch:
    """How points are looked for, and which count as found."""

    def __init__(
        self,
        num_levels: int,
        back_levels: int,
        num_steps: int,
        least_step_px: float,
        margin_px: float,
        return_px: float,
    ) -> None:
        """
        Choose.

        Args:
            num_levels: that are gone through, the smallest first.
            back_levels: the same on the way back.
            num_steps: on each, at most.
            least_step_px: below which a level is done.
            margin_px: from the edge of the image, within which no point counts as found.
            return_px: off the start along either axis, from which on it does not.

        Raises:
            ValueError: A number is less than 1.
        """

def follow_points(
    before: FlowPyramid,
    now: FlowPyramid,
    from_px: Annotated[NDArray[numpy.float32], dict(shape=(None, 2), writable=False)],
    guess_px: Annotated[NDArray[numpy.float32], dict(shape=(None, 2), writable=False)],
    search: FlowSearch,
) -> hoid_native.results.Followed:
    """
    Return where points of one image are in another, by the 9x9 pixels around them.

    A point counts as found when following it back leads to where it was: else it slipped.

    Args:
        before: of the one.
        now: of the other, as large.
        from_px: (N, 2) float32.
        guess_px: (N, 2) float32, where each is looked for.
        search: how.

    Raises:
        ValueError: Sizes or lengths differ.

    Source: Lucas and Kanade, IJCAI 1981, on pyramids, equal to OpenCV's calcOpticalFlowPyrLK.
    """

class QueryConstraints:
    """
    What Q queries ask of a feature, wherever it lies.

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
    N features among which queries look for theirs.

    Args:
        measurement_px: (N, 3) float32 u, v, u_right; NaN u_right: no depth. Features without a
            position (NaN), or further out than any image is large, match nothing.
        octave: (N,) uint8.
        descriptors: (N, 32) uint8.
        free: (N,) bool, those that may be matched; None: all.

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
    How good a match must be.

    Args:
        max_distance: Hamming.
        ratio: by which the best must beat a second best of its octave; 1.0: no test.
    """

    def __init__(self, max_distance: int, ratio: float) -> None: ...
    @property
    def max_distance(self) -> int:
        """Hamming."""

    @property
    def ratio(self) -> float:
        """Of the best distance to the second best; 1.0: no test."""

def match_by_projection(
    projection_px: numpy.typing.NDArray[Any],
    radius_px: numpy.typing.NDArray[Any],
    wanted: QueryConstraints,
    candidates: Candidates,
    threshold: MatchThreshold,
) -> hoid_native.results.Pairs:
    """
    Return the best feature of each query near its expected pixel, one to one.

    Args:
        projection_px: (3, Q) u, v, u_right where each query is expected; NaN u_right: unknown.
        radius_px: (Q,) half sides of the square windows.
        wanted: by each query.
        candidates: which agree in u_right too where both know it.
        threshold: of a match.

    Raises:
        ValueError: Lengths differ.
    """

def match_along_segments(
    segments_px: numpy.typing.NDArray[Any],
    octave_radius_px: numpy.typing.NDArray[Any],
    wanted: QueryConstraints,
    candidates: Candidates,
    threshold: MatchThreshold,
) -> hoid_native.results.Pairs:
    """
    Return the best feature of each query along the segment where it may be, one to one.

    Args:
        segments_px: (Q, 4) u, v of both ends; NaN: nowhere.
        octave_radius_px: (L,) how far from the segment a feature of each octave may lie.
        wanted: by each query.
        candidates: whose u_right is not looked at.
        threshold: of a match.

    Raises:
        ValueError: Lengths differ, or an octave is not below L.
    """

def typical_descriptors(
    descriptors: Annotated[NDArray[numpy.uint8], dict(shape=(None, 32), writable=False)],
    starts: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
) -> Annotated[NDArray[numpy.int64], dict(shape=(None,))]:
    """
    Return the (G,) row of each group's descriptor with the least median distance to the others.

    Args:
        descriptors: (M, 32), grouped; only the last eight of a larger group are compared.
        starts: (G,) int64 first row of each group, ascending.

    Raises:
        ValueError: A group starts beyond the descriptors, or where another one does.
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
    Squared normalised residuals beyond which an observation is an outlier.
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
) -> hoid_native.results.PoseFit:
    """
    Return the pose that explains matches best: Gauss-Newton with a Huber kernel.

    Pixels and the disparity u - u_right are independent measurements with robust kernels of their own;
    outliers are told on (u, v, u_right) (Mur-Artal and Tardos, T-RO 2017). Fewer than four matches
    leave the pose alone.

    Args:
        camera: Of the image.
        gates: Of outliers, told anew after each of three rounds, and of the kernel.
        points_m: (N, 3) in the map's frame.
        measured_px: (N, 3) u, v, u_right; NaN u_right: no depth.
        inv_sigma2: (N,) 1 / variance of each coordinate [1/px^2].
        T_camera_map: (4, 4) where to start.

    Raises:
        ValueError: Lengths differ.
    """

def judge_matches(
    camera: StereoParams,
    gates: Gates,
    points_m: numpy.typing.NDArray[Any],
    measured_px: numpy.typing.NDArray[Any],
    inv_sigma2: numpy.typing.NDArray[Any],
    T_camera_map: numpy.typing.NDArray[Any],
) -> hoid_native.results.MatchJudgement:
    """
    Return how well each match fits a pose.

    Errors of pixels and of disparities are each cut off where they become outliers: their sum over
    matches compares poses, whatever is an outlier of which (MSAC).

    Args:
        camera: Of the image, with its measured noise.
        gates: Of outliers.
        points_m: (N, 3) in the map's frame.
        measured_px: (N, 3) u, v, u_right; NaN u_right: no depth.
        inv_sigma2: (N,) 1 / variance of each coordinate [1/px^2].
        T_camera_map: (4, 4).

    Raises:
        ValueError: Lengths differ.
    """

def heaviest_part(
    camera: StereoParams,
    gates: Gates,
    points_m: numpy.typing.NDArray[Any],
    measured_px: numpy.typing.NDArray[Any],
    inv_sigma2: numpy.typing.NDArray[Any],
    T_camera_map: numpy.typing.NDArray[Any],
    noise_scale: float,
) -> hoid_native.results.MovingPart:
    """
    Return the part of the matches without which the rest would fit best.

    Parts are of a sixteenth to a quarter of the matches, near each other in direction and depth. There
    is none, with a gain of 0, where a point or the pose is not finite.

    Args:
        camera: Of the image, with its measured noise.
        gates: Of outliers, which tell nothing; pixels and disparities have gates of their own.
        points_m: (N, 3) in the map's frame.
        measured_px: (N, 3) u, v, u_right; NaN u_right: no depth.
        inv_sigma2: (N,) 1 / variance of each coordinate [1/px^2].
        T_camera_map: (4, 4) that fits them.
        noise_scale: Variances in units of those of the camera.

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
    Adjust with a Huber kernel, in rounds after each of which what does not fit is left out.

    Args:
        lens: Of all images.
        gates: Of outliers, and of the kernel.
        T_camera_map: (C, 4, 4), the first `num_free` are moved.
        num_free: How many cameras move.
        points_m: (P, 3) in the map's frame.
        camera: (M,) int64, which camera observes.
        point: (M,) int64, which point; once a camera at most.
        measured_px: (M, 3) u, v, u_right; NaN u_right: no depth.
        inv_sigma2: (M,) 1 / variance of each coordinate [1/px^2].
        rounds: How many, at least one.
        iterations: Of each round, at most.

    Raises:
        ValueError: Lengths differ, or a camera or a point is not there.
        MemoryError: The cameras that move are too many for a dense system.
    """

def overlap_ratios(
    boxes_xyxy_px: numpy.typing.NDArray[Any], others_xyxy_px: numpy.typing.NDArray[Any]
) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None))]:
    """
    Return the (N, M) shares of each box's own area that lie in each of the others.

    In [0, 1]; 0 for a box without area. This is the interaction area of the HOID paper.

    Args:
        boxes_xyxy_px: (N, 4), finite.
        others_xyxy_px: (M, 4), finite.
    """

def intersections_over_union(
    boxes_xyxy_px: numpy.typing.NDArray[Any], others_xyxy_px: numpy.typing.NDArray[Any]
) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None))]:
    """
    Return the (N, M) ratios in [0, 1] of shared area to joint area; 0 without area.

    Args:
        boxes_xyxy_px: (N, 4), finite.
        others_xyxy_px: (M, 4), finite.
    """

def are_boxes_fit(
    boxes_xyxy_px: Annotated[NDArray[numpy.float32], dict(shape=(None, 4), writable=False)],
    scores: Annotated[NDArray[numpy.float32], dict(shape=(None,), writable=False)],
    shape_hw: tuple[int, int],
) -> bool:
    """
    Return whether boxes have areas inside the image and scores are in [0, 1].

    Args:
        boxes_xyxy_px: (N, 4) float32.
        scores: (N,) float32.
        shape_hw: of the image.

    Raises:
        ValueError: Lengths differ.
    """

def judge_boxes(
    depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    pixels: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    boxes_xyxy_px: numpy.typing.NDArray[Any],
    roles: Annotated[NDArray[numpy.uint8], dict(shape=(None,), writable=False)],
    side_px: int,
    min_share: float,
    apart_m: float,
    reach_px: float = float('nan'),
) -> hoid_native.results.Judged:
    """
    Return which of N boxes move, people and what people handle, and what lies outside them.

    Args:
        depth_m: (H, W) float32, not empty; 0 or NaN = no reading.
        pixels: (K,) int64, indices in the flat image.
        boxes_xyxy_px: (N, 4), finite.
        roles: (N,) uint8: `PERSON`, `MAY_BE_HANDLED` or 0.
        side_px: as of `sample_depths_m`.
        min_share: a person handles a box when covering more than this share of it ...
        apart_m: ... and nearer than this in depth; a depth that is not known is near.
        reach_px: instead of the share, where given: a pixel in the box has a part of the person's
            within this reach along rows and columns.

    Raises:
        ValueError: The image is empty, a pixel is not in it, a box is not finite, or lengths
            differ.
    """

def sample_depths_m(
    depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    boxes_xyxy_px: numpy.typing.NDArray[Any],
    side_px: int,
) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]:
    """
    Return the (N,) median readings of squares at the centres of boxes; NaN without any.

    Args:
        depth_m: (H, W) float32, not empty; 0 or NaN = no reading.
        boxes_xyxy_px: (N, 4), finite.
        side_px: side of a square, at least 1; beyond the image it sees the image's edge.

    Raises:
        ValueError: The image is empty, a box is not finite, or the side is less than 1.
    """

def depths_off_edges_m(
    depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    pixels_xy: Annotated[NDArray[numpy.int32], dict(shape=(None, 2), writable=False)],
    radius_px: int,
    step: float,
) -> Annotated[NDArray[numpy.float32], dict(shape=(None,))]:
    """
    Return the (N,) readings at pixels; 0 where there is none, or where an edge is near.

    Beside an edge a depth camera may read the surface on the other side of it.

    Args:
        depth_m: (H, W) float32; 0 or NaN = no reading.
        pixels_xy: (N, 2) int32 x, y.
        radius_px: half the side of the square around a pixel in which no edge may be; 0: any may.
        step: share of the reading by which others in the square differ where there is one.

    Raises:
        ValueError: A pixel is not in the image.
    """

def torso_depths_m(
    depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    boxes_xyxy_px: numpy.typing.NDArray[Any],
    known_m: numpy.typing.NDArray[Any],
) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]:
    """
    Return the (N,) depths of the layers that fill the middles of people's boxes; NaN: none.

    The nearest layer of about a torso's thickness that is not much smaller than the largest one is
    the person; readings near the known depth are looked at alone unless they are few.

    Args:
        depth_m: (H, W) float32; 0 or NaN = no reading.
        boxes_xyxy_px: (N, 4), finite, in pixels of this image.
        known_m: (N,) depths of the same people a moment ago; NaN = unknown.

    Raises:
        ValueError: A box is not finite, or lengths differ.
    """

def cover_things(
    depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    areas_xyxy_px: Annotated[NDArray[numpy.int32], dict(shape=(None, 4), writable=False)],
    depths_m: numpy.typing.NDArray[Any],
    reaches_m: numpy.typing.NDArray[Any],
    certainties: Annotated[NDArray[numpy.uint8], dict(shape=(None,), writable=False)],
    seen: Annotated[NDArray[numpy.bool_], dict(shape=(None,), writable=False)],
) -> Annotated[NDArray[numpy.uint8], dict(shape=(None, None))]:
    """
    Return how sure it is, (H, W) uint8, that each pixel shows something that moves; 0 = static.

    The image is cut into regions along the jumps of depth. A thing is the regions that lie mostly
    in its area and near its depth, and the gaps without readings beside them. It may reach out of
    its area by a tenth of a side, as a box is not exact; what lies further out has only merged
    with it in depth, as a desk with who leans on it.

    Args:
        depth_m: (H, W) float32; 0 = no reading.
        areas_xyxy_px: (N, 4) int32, whole pixels within the image, the last exclusive.
        depths_m: (N,) of the things; NaN = unknown: then a thing is its whole area.
        reaches_m: (N,) how far things reach before and behind their depth.
        certainties: (N,) uint8, how sure it is that they move.
        seen: (N,) bool, things that are there for sure: when a thing's regions are too little of its
            area, it has merged with what it touches, and all pixels near its depth count.

    Raises:
        ValueError: An area is not in the image, or lengths differ.
    """

def widen(
    mask: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), writable=False)], reach_px: int
) -> Annotated[NDArray[numpy.uint8], dict(shape=(None, None))]:
    """
    Return (H, W) uint8 flags of pixels with one that is not 0 within reach along rows and columns.

    Args:
        mask: (H, W) uint8.
        reach_px: 0: none.
    """

def values_at(
    pixels: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    values: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), writable=False)],
    rows: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    columns: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
) -> Annotated[NDArray[numpy.uint8], dict(shape=(None,))]:
    """
    Return values[rows[v], columns[u]] for each (u, v) of K pixels.

    Args:
        pixels: (K,) int64, indices in the flat (H, W) image.
        values: (h, w) uint8.
        rows: (H,) int64, in [0, h).
        columns: (W,) int64, in [0, w).

    Raises:
        ValueError: A pixel is not in the image, or a row or a column not in `values`.
    """

class Pinhole:
    """A camera without distortion."""

    def __init__(self, fx_px: float, fy_px: float, cx_px: float, cy_px: float) -> None: ...
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

def depth_segments(
    depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    cell_px: int,
) -> hoid_native.results.Segments:
    """
    Return the pieces of a depth image, cut along jumps of depth and along a grid of square cells.

    Args:
        depth_m: (H, W) float32; 0 = no reading.
        cell_px: side of a cell, at least 1.

    Raises:
        ValueError: The side is less than 1.
    """

def depths_around(
    depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
) -> Annotated[NDArray[numpy.float32], dict(shape=(None, None, None))]:
    """
    Return the (H, W, 2) least and most depth in the 3x3 pixels around each; 0 without depth there.

    Args:
        depth_m: (H, W) float32; 0 = no reading.
    """

def front_evidence(
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
    worth: tuple[float, float, float],
) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]:
    """
    Return the (S,) log-odds that segments move, by what they are in front of in earlier views.

    What is behind what was seen says nothing. Every other row is looked at.

    Args:
        camera: of all images.
        depth_m: (H, W) float32 now; 0 = no reading.
        label: (H, W) int32 segment of each pixel; -1 = none.
        num_segments: S.
        earlier: of each view T_earlier_now (4, 4), the (H, W, 2) float32 least and most reading around
            each pixel, 0 = none there, and the log-odds against a segment all of which is at them.
        margin: a constant [m], and shares of the depth and of its square, by which a pixel must be
            in front.
        worth: the log-odds of a segment all of which is in front, the share in front up to which there
            is no evidence, and that from which on what agrees is none.

    Raises:
        ValueError: Images differ in size, or a label is not one of S.
    """

def depths_at(
    depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    pixels: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
) -> Annotated[NDArray[numpy.float32], dict(shape=(None,))]:
    """
    Return the (K,) float32 depths at pixels; 0 where no number is, and for the index -1.

    Args:
        depth_m: (H, W) float32.
        pixels: (K,) int64 indices in the flat image; -1 = none.

    Raises:
        ValueError: An index is not in the image.
    """

def carry_over(
    camera: Pinhole,
    T_before_now: numpy.typing.NDArray[Any],
    depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    before_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    log_odds: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    margin: tuple[float, float, float],
    fade: float,
    label: Annotated[NDArray[numpy.int32], dict(shape=(None, None), writable=False)],
    evidence: Annotated[NDArray[numpy.float32], dict(shape=(None,), writable=False)],
    limit: float,
) -> Annotated[NDArray[numpy.float32], dict(shape=(None, None))]:
    """
    Return the (H, W) log-odds of pixels by those they had before and the evidence of now.

    Before, they had none where another depth was seen in their place. Without depth they have none.

    Args:
        camera: of both images.
        T_before_now: (4, 4).
        depth_m: (H, W) float32 now; 0 = no reading.
        before_m: (H, W) float32 depth of the image before.
        log_odds: (H, W) float32 of its pixels.
        margin: a constant [m], and shares of the depth and of its square, by which depths may differ.
        fade: what is left of them.
        label: (H, W) int32 segment of each pixel; -1 = none.
        evidence: (S,) float32 log-odds that are added to segments.
        limit: of the log-odds, either way.

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
    Return the (M, 2) weights of the points that each pose explains, by two sets of weights.

    A point counts less the worse it fits.

    Args:
        camera: of the image.
        pixel_px: standard deviation of pixels.
        limit: standard deviations beyond which a point counts nothing.
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
    Return the (M, 4, 4) rigid transforms that bring three points each nearest to three others.

    Args:
        from_m: (N, 3).
        to_m: (N, 3).
        triples: (M, 3) int64 indices; three points on a line give the identity.

    Raises:
        ValueError: Lengths differ, or an index is not one of N.

    Source: Umeyama, PAMI 1991, without scale, in closed form for three points.
    """

def strongest_in_cells(
    corner_pixels: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    corner_scores: Annotated[NDArray[numpy.uint8], dict(shape=(None,), writable=False)],
    depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None), writable=False)],
    small_of_pixel: Annotated[NDArray[numpy.int64], dict(shape=(None,), writable=False)],
    label: Annotated[NDArray[numpy.int32], dict(shape=(None, None), writable=False)],
    cell_px: float,
    taken: Annotated[NDArray[numpy.uint8], dict(shape=(None, None), writable=False)],
) -> Annotated[NDArray[numpy.int64], dict(shape=(None,))]:
    """
    Return the indices, in order of cell, of the strongest corner of each cell that is not taken.

    Only corners with depth, on a piece of the small depth image, are chosen; of equals, the first.

    Args:
        corner_pixels: (K,) int64 indices in the flat image.
        corner_scores: (K,) uint8, higher is stronger.
        depth_m: (H, W) float32; 0 or not finite = no reading.
        small_of_pixel: (H * W,) int64 indices in the flat small image.
        label: (h, w) int32 of the small image; -1 = no piece.
        cell_px: side of a cell.
        taken: (rows, columns) uint8 of the cells, which cover the image; 0 = free.

    Raises:
        ValueError: Lengths differ, a corner is not in the image, or the cells do not cover it.
    """
