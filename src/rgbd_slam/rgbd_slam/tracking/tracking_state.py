"""The state machine of tracking: on the map, off it, bridged or lost; and when a map starts.

`docs/architecture.md` shows the states and transitions as a table.
"""

from __future__ import annotations

import logging
from enum import Enum

import numpy as np

from hoid_common.sync import RESTART_NS
from hoid_common.values import NS_PER_S, S_PER_NS
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.matching.covered_view import is_view_covered
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.tracked_frame import TrackedFrame

_logger = logging.getLogger(__name__)

# Chosen: of a gap between two images, at most this time counts as lost, because the camera cannot
# be found without images.
_MAX_GAP_NS = NS_PER_S // 2
# Chosen: a lost camera starts a new map after this time and number of images if it sees "new
# ground", that is, surfaces that are not in the map. Most blurs are shorter.
_NEW_GROUND_S = 0.4
_NEW_GROUND_IMAGES = 5
# Chosen: a map in which fewer images were tracked was started too early. The wait for the next map
# is then doubled, so that useless images do not start a map every 0.4 s.
_MIN_TRACKED = 15
_MIN_NEW_GROUND = 100  # chosen: least number of features with depth on new ground
# Chosen: within this time (s) after a loss, new ground must also show at least this ratio of the
# features with depth in the images tracked last. A blurred image has fewer, and a map that starts
# with it is lost again. After this time, few features are not due to blur.
_SHARP_SHARE, _MAX_BLUR_S = 0.8, 1.0
_USUAL_GAIN = 0.1  # chosen: gain of the exponential average `_usual`, over about 10 images
# Chosen: after two thirds of the time that a gyro bridges, new ground starts a map even in a
# blurred image. Such a map stays connected with the last one; a later one would not.
_LATE_BRIDGE_S = 1.0
_OFF_MAP_NS = NS_PER_S  # chosen: tracking without the map is reported after this time
_OFF_MAP = (
    'for {:.0f} s fewer than {} points of the map have been seen; the pose rests on the depth of '
    'the last image and drifts'
)


class TrackingState(Enum):
    """How the pose of the latest image was determined."""

    NO_MAP = 'no map'
    ON_MAP = 'on the map'  # enough map points fit the pose
    OFF_MAP = 'off the map'  # tracked only by the depth of the last image
    BRIDGED = 'bridged'  # not tracked; the gyro continues the pose, which is recorded
    DEAD_RECKONED = 'dead reckoned'  # not tracked; external odometry continues the pose
    LOST = 'lost'  # no pose


_TRACKED = TrackingState.ON_MAP, TrackingState.OFF_MAP


class TrackingStates:
    """The state of tracking, the time without a tracked image, and the rule for new maps.

    Each public method except `wants_map` is an event with its transition. A lost camera starts a
    new map after `new_map_after_s`, or earlier on new ground. But if something covers the view,
    such as a person, it is better to wait, because the map is behind it. The last known pose, at
    which this is tested, is accurate only for the first image after the loss. Therefore a view
    counts as covered only if it was covered in that image and still is. A loss in a map in which
    fewer than 15 images were tracked continues the loss before it.
    """

    def __init__(self, atlas: Atlas, camera: StereoCamera, config: SlamConfig) -> None:
        self.state = TrackingState.NO_MAP
        self.num_bridged = 0  # number of bridged images since the last tracked one
        self.new_map_after_s = config.places.new_map_after_s
        self._atlas, self._camera, self._config = atlas, camera, config.tracking
        self._newest_ns: int | None = None  # newest stamp since the stamps started anew
        self._lost_ns = 0  # time without a tracked image
        # Stamp of the first image since which all were off the map.
        self._off_map_ns: int | None = None
        self._wait_s = _NEW_GROUND_S
        self._num_tracked = 0  # number of images tracked since the last map was started
        self._num_lost = 0  # number of images since the camera was lost
        self._usual = 0.0  # mean number of features with depth in the last tracked images
        # Whether the view was covered in the first image after the loss; None: no loss yet.
        self._was_covered: bool | None = None

    @property
    def lost_s(self) -> float:
        """Return the time (s) without a tracked image, counting at most 0.5 s of each gap."""
        return S_PER_NS * self._lost_ns

    @property
    def note(self) -> str:
        """Return a warning if images have been tracked off the map for a second, else ''."""
        newest_ns, since_ns = self._newest_ns, self._off_map_ns
        if self.state is not TrackingState.OFF_MAP or newest_ns is None or since_ns is None:
            return ''
        off_ns = newest_ns - since_ns
        min_points = self._config.min_inliers
        return '' if off_ns < _OFF_MAP_NS else _OFF_MAP.format(S_PER_NS * off_ns, min_points)

    def image(self, stamp_ns: int) -> bool:
        """Add the next image; return whether the stamps have started anew.

        They have if `stamp_ns` is more than a second older than the newest stamp.
        """
        newest_ns = self._newest_ns
        if newest_ns is None or stamp_ns < newest_ns - RESTART_NS:
            self._newest_ns, self._lost_ns, self._off_map_ns = stamp_ns, 0, None
            return newest_ns is not None
        gap_ns = max(stamp_ns - newest_ns, 0)
        self._newest_ns = newest_ns + gap_ns
        self._lost_ns += min(gap_ns, _MAX_GAP_NS)
        return False

    def no_map(self) -> None:
        self.state = TrackingState.NO_MAP

    def tracked(self, frame: Frame, *, is_on_map: bool) -> None:
        self._end_loss(TrackingState.ON_MAP if is_on_map else TrackingState.OFF_MAP)
        if is_on_map:
            self._off_map_ns = None
        elif self._off_map_ns is None:
            self._off_map_ns = frame.stamp_ns
        number = _num_seeds(frame)
        self._usual += _USUAL_GAIN * (number - self._usual) if self._usual else number
        self._num_tracked += 1
        if self._num_tracked >= _MIN_TRACKED:
            self._wait_s = _NEW_GROUND_S

    def missed(self, *, is_followed: bool, is_recorded: bool) -> None:
        """Register that the image was not tracked.

        `is_followed`: a motion source continues the pose; `is_recorded`: this pose is as accurate
        as a tracked one, and is recorded.
        """
        if self.state in _TRACKED:
            _logger.debug('image %.3f: too few map points are seen', self._newest_s)
        self.state = TrackingState.DEAD_RECKONED if is_followed else TrackingState.LOST
        if is_recorded:
            self.state = TrackingState.BRIDGED
            self.num_bridged += 1

    def started(self) -> None:
        """Register that the image has started a map.

        The wait for the next map is doubled, until 15 images were tracked in this map.
        """
        _logger.debug('image %.3f: a new map starts', self._newest_s)
        self._end_loss(TrackingState.ON_MAP)
        self._num_tracked = 0
        self._wait_s *= 2

    def discarded(self) -> None:
        """Register that the pose was discarded; the time without a tracked image starts now."""
        self.state, self._lost_ns, self.num_bridged = TrackingState.LOST, 0, 0

    def wants_map(self, frame: Frame, last: TrackedFrame | None) -> bool:
        """Return whether a new map should start with `frame`, in which the camera is lost.

        Call this exactly once for each lost frame, because it counts them.
        """
        lost_s, limit_s = self.lost_s, self.new_map_after_s
        if last is None or lost_s > limit_s:
            return lost_s > limit_s
        is_covered = is_view_covered(
            self._atlas, self._camera, frame, last, self._config.max_local_keyframes
        )
        is_known = self._num_tracked >= _MIN_TRACKED or self._was_covered is None
        if self._num_lost == 0 and is_known:
            self._was_covered = is_covered
        self._num_lost += 1
        is_blur = lost_s <= self._wait_s or self._num_lost <= _NEW_GROUND_IMAGES
        is_late = self.state is TrackingState.BRIDGED and lost_s > _LATE_BRIDGE_S
        needed = _SHARP_SHARE * self._usual if lost_s < _MAX_BLUR_S else 0
        has_features = _num_seeds(frame) >= max(needed, _MIN_NEW_GROUND)
        return bool(
            has_features and (is_late or not is_blur) and not (self._was_covered and is_covered)
        )

    @property
    def _newest_s(self) -> float:
        return S_PER_NS * (self._newest_ns or 0)

    def _end_loss(self, state: TrackingState) -> None:
        if self.state not in _TRACKED and self._lost_ns:
            _logger.debug('image %.3f: tracked after %.2f s', self._newest_s, self.lost_s)
        self.state = state
        self._lost_ns = self._num_lost = self.num_bridged = 0


def _num_seeds(frame: Frame) -> int:
    return int(np.count_nonzero(frame.has_depth & frame.may_seed))
