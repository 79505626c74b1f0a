"""Publishing of keyframe and image poses, for nodes whose maps are attached to keyframes."""

from __future__ import annotations

import time
from collections.abc import Callable

from hoid_msgs.msg import KeyframePoses as KeyframePosesMsg
from hoid_msgs.msg import TrackedImage as TrackedImageMsg
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_msgs.msg import Header

from hoid_common import topics
from hoid_common.poses.keyframe_poses import (
    NO_KEYFRAMES,
    LoadedKeyframes,
    SessionKeyframes,
    TrackedImage,
)
from hoid_common.ros import conversions, qos
from hoid_common.ros.conversions.slam import keyframe_poses_to_msg, tracked_image_to_msg
from hoid_common.ros.large_messages.publisher import OnDemandPublisher
from hoid_common.values import IntArray
from rgbd_slam.config.node_config import FrameConfig
from rgbd_slam.session import SlamSession

_PERIOD_S = 0.2  # chosen: shortest time between two messages with corrected poses only
_MAX_SHARE = 0.02  # chosen: largest ratio of the tracker's time for messages with corrected poses


class KeyframeOutputs:
    """The topics `keyframe_poses` (latched) and `tracked_images`, while they have subscribers.

    Keyframe poses are published when they have changed, and always before the first image whose
    pose is relative to a new keyframe.
    """

    def __init__(
        self, node: Node, frames: FrameConfig, session: Callable[[], SlamSession | None]
    ) -> None:
        self._frames, self._find_session = frames, session
        self._loaded = LoadedKeyframes()
        # The poses that were published last.
        self._last = SessionKeyframes('', None, False, NO_KEYFRAMES)
        self._published: object = None  # `pose_version` of these poses
        self._next_s = 0.0  # monotonic time before which no corrected poses are published
        self._poses = OnDemandPublisher(
            node, KeyframePosesMsg, topics.KEYFRAME_POSES, qos.LATCHED, self._publish
        )
        self._images = OnDemandPublisher(
            node, TrackedImageMsg, topics.TRACKED_IMAGES, qos.OUTPUT, lambda: None
        )
        # A timer, because the map also changes after the last image.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(_PERIOD_S, self._publish_change, clock=steady)

    def begin(self) -> None:
        """Publish that the map was discarded, and with it all data attached to its keyframes."""
        self._loaded = LoadedKeyframes()
        self._publish()

    def note_loaded(
        self, source: str, saved_uids: IntArray, loaded_uids: IntArray, *, keep: bool
    ) -> None:
        """Publish that a saved map was loaded.

        Args:
            source: Path of its file, or the session of the crashed node that has mapped it.
            saved_uids: (K,) ascending uids of its keyframes in that source.
            loaded_uids: (K,) their present uids.
            keep: Whether the running map was kept beside it.
        """
        if not keep:
            self._loaded = LoadedKeyframes()
        number = self._loaded.number + 1
        self._loaded = LoadedKeyframes(number, source, saved_uids, loaded_uids)
        self._publish()

    def message(self) -> KeyframePosesMsg:
        return self._message(self._present())

    def publish_image(self, image: TrackedImage | None, header: Header) -> None:
        """Publish the pose of a tracked image; do nothing if it is None."""
        session = self._find_session()
        if image is None or session is None or not self._images.is_wanted:
            return
        is_known = self._last.keyframes.row_of(image.keyframe_uid) is not None
        if is_known and self._last.session == session.map.session:
            self._publish_change()
        else:
            self._publish()
        row = self._last.keyframes.row_of(image.keyframe_uid)
        if row is not None:
            in_map = Header(stamp=header.stamp, frame_id=self._frames.map)
            T_map_keyframe = self._last.keyframes.T_map_camera[row]
            msg = tracked_image_to_msg(image, self._last.session, T_map_keyframe, in_map)
            self._images.publish(msg)

    def _present(self) -> SessionKeyframes:
        session = self._find_session()
        if session is None:
            return SessionKeyframes('', None, False, NO_KEYFRAMES)
        slam_map = session.map
        return SessionKeyframes(
            slam_map.session,
            session.camera,
            slam_map.frames.is_level,
            slam_map.keyframes(),
            self._loaded,
            slam_map.frames.T_camera_base if self._frames.base else None,
        )

    def _message(self, known: SessionKeyframes) -> KeyframePosesMsg:
        session = self._find_session()
        stamp_ns = 0 if session is None else session.stamp_ns
        return keyframe_poses_to_msg(known, conversions.header_to_msg(stamp_ns, self._frames.map))

    def _publish_change(self) -> None:
        """Publish the poses if they have changed, but not if they were published a moment ago."""
        session = self._find_session()
        if session is None or time.monotonic() < self._next_s:
            return
        if self._published != session.map.pose_version:
            self._publish()

    def _publish(self) -> None:
        if not self._poses.is_wanted:
            return
        start_s, session = time.monotonic(), self._find_session()
        self._last = self._present()
        self._poses.publish(self._message(self._last))
        self._published = None if session is None else session.map.pose_version
        end_s = time.monotonic()
        self._next_s = end_s + max(_PERIOD_S, (end_s - start_s) / _MAX_SHARE)
