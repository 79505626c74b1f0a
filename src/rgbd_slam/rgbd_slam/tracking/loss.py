"""Measures for how long a camera has been lost or off the map; decides on new maps."""

from __future__ import annotations

import numpy as np

from hoid_common.sync import RESTART_NS
from hoid_common.values import NS_PER_S, S_PER_NS, FloatArray, IntArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.matching.local_map import find_local_map, visible_points
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.tracked_frame import TrackedFrame

# Chosen: of a gap between two images, at most this time counts as lost; in a longer gap there was
# no image in which the camera could have been found.
_MAX_GAP_NS = NS_PER_S // 2
# Chosen: time and number of images after which a lost camera starts a new map where it sees "new
# ground", that is, surfaces that are not in the map. Most blurs are shorter.
_NEW_GROUND_S = 0.4
_NEW_GROUND_IMAGES = 5
# Chosen: a map in which fewer images were tracked was started too early. The camera then waits
# twice as long for the next map, so that useless images do not start a map every 0.4 s.
_MIN_TRACKED = 15
_MIN_NEW_GROUND = 100  # chosen: number of features with depth that new ground must show
# Chosen: within the time [s] after a loss, new ground must also show this share of the number of
# features with depth in the images that were tracked last. A blurred image has fewer, and a map
# that starts in a blur is lost again. After this time, few features are not due to a blur.
_SHARP_SHARE, _MAX_BLUR_S = 0.8, 1.0
_USUAL_GAIN = 0.1  # chosen: gain of an exponential average, over about 10 images (`_usual`)
_CELL_PX = 80.0  # chosen: side of the cells of the image in which depths are compared
# Chosen: a surface hides a map point if the point is farther away than the surface by more than a
# quarter. The motion of a camera between two images changes depths by less.
_HIDDEN_RATIO = 1.25
# Chosen: after two thirds of the time that a gyro bridges, new ground starts a map even in a blur.
# Such a map stays connected with the one before; a later one would not.
_LATE_BRIDGE_S = 1.0
_OFF_MAP_NS = NS_PER_S  # chosen: tracking without the map for longer is reported
_OFF_MAP = (
    'for {:.0f} s fewer than {} points of the map have been seen; the pose rests on the depth of '
    'the last image and drifts'
)
_COVERED_SHARE = 0.5  # chosen: share of the map points in view that are hidden in a covered view


class LossTimer:
    """Measures for how long images have arrived in which the camera was not found.

    Of a gap between two images, at most 0.5 s counts. Stamps of images may jump, repeat or start
    again (jump back by more than a second).
    """

    def __init__(self) -> None:
        self._newest_ns: int | None = None  # since the stamps started
        self._lost_ns = 0

    def add(self, stamp_ns: int) -> bool:
        """Add the stamp of the next image, and return whether the stamps have started again.

        They have if `stamp_ns` is more than a second older than the newest stamp so far. The
        measured time is then set to zero.
        """
        newest_ns = self._newest_ns
        if newest_ns is None or stamp_ns < newest_ns - RESTART_NS:
            self._newest_ns, self._lost_ns = stamp_ns, 0
            return newest_ns is not None
        gap_ns = max(stamp_ns - newest_ns, 0)
        self._newest_ns = newest_ns + gap_ns
        self._lost_ns += min(gap_ns, _MAX_GAP_NS)
        return False

    def reset(self) -> None:
        """Measure from the latest image on, because the camera was found in it."""
        self._lost_ns = 0

    @property
    def lost_s(self) -> float:
        """Return the time [s] that counts as lost, from the last `reset` to the latest image."""
        return S_PER_NS * self._lost_ns


class OffMapWatch:
    """Watches for how long the pose rests on the last image instead of the map.

    Args:
        min_points: Number of map points with which a pose rests on the map, for the text.
    """

    def __init__(self, min_points: int) -> None:
        self._min_points = min_points
        self._since_ns: int | None = None

    def add(self, stamp_ns: int, *, is_on_map: bool) -> str:
        """Add a tracked image; return a warning once images have been off the map for a second.

        Every further image off the map gives a warning as well; other images give ''.

        Args:
            stamp_ns: Stamp of the image.
            is_on_map: Whether enough points of the map were seen in it.
        """
        if is_on_map:
            self._since_ns = None
            return ''
        if self._since_ns is None or stamp_ns < self._since_ns:
            self._since_ns = stamp_ns
        off_ns = stamp_ns - self._since_ns
        return '' if off_ns < _OFF_MAP_NS else _OFF_MAP.format(S_PER_NS * off_ns, self._min_points)


class NewMapPolicy:
    """Decides when a lost camera starts a new map.

    If something covers the view, such as a person or a hand, it is better to wait: the map is
    behind it. If the camera was lost in a blur and then sees surfaces that are not in the map, it
    is better to start a new map at once. Whether a surface hides the map is evaluated at the last
    known pose, which is accurate only for the first image after the loss. Therefore, a view counts
    as covered only if it was covered in that image and still is. A loss in a map in which fewer
    than 15 images were tracked continues the loss after which this map was started, whose first
    image then decides. The first loss of all has none before it and decides for itself.

    Args:
        atlas: The map.
        camera: The camera.
        config: Parameters.
    """

    def __init__(self, atlas: Atlas, camera: StereoCamera, config: SlamConfig) -> None:
        self._atlas, self._camera = atlas, camera
        self._max_keyframes = config.tracking.max_local_keyframes
        self._wait_s = _NEW_GROUND_S
        self._num_tracked = 0  # number of images tracked since the last map was started
        self._num_lost = 0  # number of images since the camera was lost
        self._usual = 0.0  # mean number of features with depth in the images tracked last
        # Whether the view was covered in the first image after a loss; None: no loss yet. After
        # the first loss, this is updated only if the map in which the camera was lost has had
        # `_MIN_TRACKED` tracked images: the poses of a younger one are not accurate.
        self._was_covered: bool | None = None

    def started(self) -> None:
        """Register that a map was started.

        The wait for the next map is doubled; it is reset once 15 images were tracked in this one.
        """
        self._num_tracked = self._num_lost = 0
        self._wait_s *= 2

    def found(self, frame: Frame) -> None:
        """Register that an image was tracked."""
        number = _num_seeds(frame)
        self._usual += _USUAL_GAIN * (number - self._usual) if self._usual else number
        self._num_lost = 0
        self._num_tracked += 1
        if self._num_tracked >= _MIN_TRACKED:
            self._wait_s = _NEW_GROUND_S

    def wants(
        self,
        frame: Frame,
        last: TrackedFrame | None,
        lost_s: float,
        limit_s: float,
        *,
        is_bridged: bool = False,
    ) -> bool:
        """Return whether a new map should start with this frame.

        Call this once for each frame in which the camera was not found, because it counts them.

        Args:
            frame: A frame in which the camera was not found.
            last: The last tracked frame; None: there is none, and only `limit_s` decides.
            lost_s: Time (s) for which the camera has been lost.
            limit_s: Time (s) after which a map is started whatever the view.
            is_bridged: Whether a gyro still continues the pose. The wait before a new map then
                lasts 1 s at most, because a map that starts while the pose is continued stays
                connected with the map before.
        """
        if last is None or lost_s > limit_s:
            return lost_s > limit_s
        is_covered = self._is_covered(frame, last)
        is_known = self._num_tracked >= _MIN_TRACKED or self._was_covered is None
        if self._num_lost == 0 and is_known:
            self._was_covered = is_covered
        self._num_lost += 1
        is_blur = lost_s <= self._wait_s or self._num_lost <= _NEW_GROUND_IMAGES
        is_late = is_bridged and lost_s > _LATE_BRIDGE_S
        needed = _SHARP_SHARE * self._usual if lost_s < _MAX_BLUR_S else 0
        has_features = _num_seeds(frame) >= max(needed, _MIN_NEW_GROUND)
        return bool(
            has_features and (is_late or not is_blur) and not (self._was_covered and is_covered)
        )

    def _is_covered(self, frame: Frame, last: TrackedFrame) -> bool:
        """Return whether a surface in the frame hides most map points in view of the last pose."""
        atlas, T_camera_map = self._atlas, last.current_pose(self._atlas)
        seen = last.current_points(atlas)
        local_map = find_local_map(
            atlas, seen[seen != NO_POINT], last.reference_uid, self._max_keyframes
        )
        view = visible_points(atlas, self._camera, T_camera_map, local_map.points, radius=1.0)
        k = np.flatnonzero(frame.has_depth)
        if not len(k) or not len(view.points):
            return False
        cells = self._cells(
            np.hstack([frame.measurement_px[k, :2].T, view.queries.projection_px[:2]])
        )
        of_feature, of_point = cells[: len(k)], cells[len(k) :]
        count = np.bincount(of_feature, minlength=cells.max() + 1)
        sum_per_m = np.bincount(of_feature, 1.0 / frame.depth_m[k], cells.max() + 1)
        has_surface = count[of_point] > 0
        of_point, points = of_point[has_surface], view.points[has_surface]
        point_m = atlas.points.position_m[points] @ T_camera_map[2, :3] + T_camera_map[2, 3]
        is_hidden = point_m * sum_per_m[of_point] / count[of_point] > _HIDDEN_RATIO
        return bool(is_hidden.sum() > _COVERED_SHARE * len(view.points))

    def _cells(self, pixels: FloatArray) -> IntArray:
        """Return the (N,) indices of the cells of the undistorted image for (2, N) pixels.

        A pixel beyond the left or upper border is assigned to the first column or row.
        """
        left, top, right, _ = self._camera.bounds_px
        column, row = np.maximum((pixels - np.array([[left], [top]])) // _CELL_PX, 0.0)
        return np.asarray(row * np.ceil((right - left) / _CELL_PX + 1) + column, np.int64)


def _num_seeds(frame: Frame) -> int:
    """Return the number of features with depth that may create map points."""
    return int(np.count_nonzero(frame.has_depth & frame.may_seed))
