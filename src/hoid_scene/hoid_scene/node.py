"""The scene node: images and the poses of keyframes in; dense map, grid, people, objects out."""

from __future__ import annotations

import os
import time
from functools import cache

from hoid_msgs.msg import KeyframePoses as KeyframePosesMsg
from rclpy.clock import Clock, ClockType

from hoid_common import topics
from hoid_common.errors import HoidError
from hoid_common.io.untrusted import expand_home
from hoid_common.poses.keyframe_poses import KeyframePoses, SessionKeyframes
from hoid_common.ros import qos
from hoid_common.ros.conversions.slam import keyframe_poses_from_msg
from hoid_common.ros.execution.timers import set_period
from hoid_common.ros.inputs import Inputs, checked_callback
from hoid_common.ros.large_messages.publisher import OnDemandPublisher
from hoid_common.ros.lifecycle import ManagedNode
from hoid_common.ros.parameters import Parameters
from hoid_common.ros.run import is_end_asked_for, run_node
from hoid_common.store.database import SUFFIX
from hoid_scene.config.scene_config import SceneNodeConfig
from hoid_scene.grid.floor import NO_FLOOR
from hoid_scene.navigation_masks import NavigationMasks
from hoid_scene.ros.outputs import OutputTopic, SceneOutputs
from hoid_scene.ros.scene_images import SceneImage, SceneImages
from hoid_scene.ros.services import SceneServices
from hoid_scene.scene_mapper import SceneMapper
from hoid_scene.scene_scheduler import SceneRequest
from hoid_scene.scene_session import SceneSession
from hoid_scene.store.scene_store import SceneStore
from hoid_scene.tracks.object_track import TrackedObject

# Chosen: largest ratio of the time that is spent on publishing dense map and grid, and on fusing
# submaps again that corrections have deformed, to the pause that follows. They take at most a
# fifth of the time; the rest is left for new images.
_WORK_PER_PAUSE = 0.25
# Chosen: number of fused images without a floor from which this is reported. They take several
# seconds, in which a robot sees its floor.
_MAX_IMAGES_WITHOUT_FLOOR = 30
_STORE_PERIOD_S = 5.0  # chosen: period of storing the object map; a crash loses so much of it
_NO_KEYFRAMES_S = 10.0  # chosen: rgbd_slam starts within a few seconds
_NO_KEYFRAMES = 'no message has come on {}: start rgbd_slam, and a camera whose images it tracks'
_NOT_LEVEL = 'navigation.enabled needs frames.base of rgbd_slam, which makes the map level'


class SceneNode(ManagedNode):
    """Passes messages to a `SceneSession`, and publishes its maps.

    The session begins with the first message of the SLAM node that has a camera.
    """

    def __init__(self) -> None:
        super().__init__('hoid_scene')
        # Building the maps uses only processor time that detector, filter and tracking leave
        # unused (decision 016). The threads of the middleware run already and keep their priority:
        # if they did not answer in time, all other DDS participants would take this one for dead.
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
        self._settings = Parameters(self, SceneNodeConfig(), self._reconfigure)
        config = self._settings.config
        self._outputs = SceneOutputs(self._publisher, config)
        folder = expand_home(config.map_directory, 'map_directory')
        name = self.get_fully_qualified_name()
        domain = os.environ.get('ROS_DOMAIN_ID', '0')
        file = f'.scene-{domain}{name.replace("/", "-")}{SUFFIX}'
        self._store = SceneStore(folder / file, f'{domain}{name}')
        self._session = SceneSession(config, self._store, self._on_begin)
        self._masks = NavigationMasks(config.navigation)
        self._num_fused = 0  # number of images fused into the dense map of this scene
        self._rest_until_s = 0.0  # monotonic time from which dense map and grid may be published
        self._start_s = self._stored_s = time.monotonic()
        inputs = Inputs(self, config.input, self.diagnostics)
        self._images = SceneImages(
            self, inputs, config, self._keyframes, self._on_image, self.diagnostics
        )
        self._subscribe_to_keyframes()
        SceneServices(self, config, self._session, self._outputs, self.diagnostics)
        # A timer of steady time publishes the latest map even after images and their clock stop.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        period_s = config.dense.publish_period_s
        self._timer = self.create_timer(period_s, self._on_timer, clock=steady)
        self.begin(autostart=config.autostart)

    def destroy_node(self) -> None:
        """End the node; after an error, the scene is kept for the next process."""
        self._store_objects()
        self._store.close(keep=not is_end_asked_for())
        super().destroy_node()

    def _publisher(self, output: OutputTopic) -> OnDemandPublisher:
        return OnDemandPublisher(self, output.type, output.name, output.qos, self._publish)

    def _subscribe_to_keyframes(self) -> None:
        self._keyframes_topic = topic = self.resolve_topic_name(topics.KEYFRAME_POSES)
        on_bytes = checked_callback(
            self._on_keyframes, KeyframePosesMsg, topic, 'keyframe poses', self.diagnostics
        )
        self.create_subscription(
            KeyframePosesMsg, topics.KEYFRAME_POSES, on_bytes, qos.LATCHED, raw=True
        )

    def _keyframes(self) -> tuple[str, KeyframePoses] | None:
        known = self._session.known
        if known is None or self._session.mapper is None:
            return None
        return known.session, known.keyframes

    def _on_keyframes(self, msg: KeyframePosesMsg) -> None:
        self._outputs.frame = msg.header.frame_id
        known = keyframe_poses_from_msg(msg)
        self._session.update(known)
        self._outputs.set_level(is_map_level=known.is_level)
        self._images.note_keyframes()
        self._outputs.note_change()
        self.diagnostics.report_problem('loaded map', self._session.problem)

    def _on_begin(self, known: SessionKeyframes) -> None:
        navigation = self._settings.config.navigation
        self._images.begin(known.camera)
        self._masks, self._num_fused = NavigationMasks(navigation), 0
        self._outputs.clear(self._session.stamp_ns)
        self._outputs.note_change()
        is_tilted = navigation.enabled and known.T_camera_base is None
        self.diagnostics.report_problem('level', _NOT_LEVEL if is_tilted else '')

    def _on_image(self, image: SceneImage) -> None:
        """Use an image for the maps that it was selected for; publish tracks and objects."""
        mapper, request = self._session.mapper, image.request
        if mapper is None:
            return
        self._session.stamp_ns = request.stamp_ns
        color = cache(lambda: self._images.color_of(image))
        if request.track_objects:
            tracks = mapper.track_objects(request, image.depth_m, image.objects)
            self._outputs.publish_objects(tracks, request.stamp_ns)
            self._update_masks(tracks, request)
        if mapper.map_objects(request, image.depth_m, image.objects, color):
            self._outputs.note_object_change()
            self._outputs.publish_object_map(mapper, self._session.stamp_ns)
            if (expected := mapper.expected_objects()) is not None:
                self._outputs.publish_expected(expected, image.header, mapper.camera.size_px)
        if request.fuse:
            mapper.fuse(request, image.depth_m, color(), image.objects)
            self._outputs.note_change()
            self._num_fused += 1
            self.diagnostics.count('images fused')
            self.diagnostics.set_count('voxels', len(mapper.dense))

    def _update_masks(self, tracks: tuple[TrackedObject, ...], request: SceneRequest) -> None:
        known = self._session.known
        if known is None or known.T_camera_base is None:
            return
        T_map_base = request.T_map_camera @ known.T_camera_base
        if self._masks.update(tracks, T_map_base, request.stamp_ns):
            self._publish_masks()

    def _publish_masks(self) -> None:
        if self._settings.config.navigation.enabled:
            stamp_ns = self._session.stamp_ns
            self._outputs.publish_masks(self._masks, stamp_ns, self.resolve_topic_name)

    def _on_timer(self) -> None:
        now_s = time.monotonic()
        is_late = self._session.known is None and now_s - self._start_s > _NO_KEYFRAMES_S
        text = _NO_KEYFRAMES.format(self._keyframes_topic)
        self.diagnostics.report_problem('keyframes', text if is_late else '')
        if now_s - self._stored_s > _STORE_PERIOD_S:
            self._stored_s = now_s
            self._store_objects()
        self._publish()

    def _store_objects(self) -> None:
        problem = ''
        try:
            self._session.store_objects()
        except HoidError as error:  # a full disk must not end the node
            problem = f'a crash would lose the object map: {error}'
        self.diagnostics.report_problem('store', problem)

    def _publish(self) -> None:
        mapper = self._session.mapper
        if mapper is None:
            return
        self._outputs.publish_object_map(mapper, self._session.stamp_ns)
        start_s = time.monotonic()
        if start_s < self._rest_until_s:
            return
        if mapper.dense.fuse_bent():
            self._outputs.note_change()
        if self._outputs.due:
            self._outputs.publish_map(mapper, self._session.stamp_ns)
            self._publish_masks()  # after the grid, whose extent they have
            self._report_floor(mapper)
        end_s = time.monotonic()
        self._rest_until_s = end_s + (end_s - start_s) / _WORK_PER_PAUSE

    def _report_floor(self, mapper: SceneMapper) -> None:
        """Report a problem if the dense map has enough images, but no floor is known."""
        is_late = self._num_fused >= _MAX_IMAGES_WITHOUT_FLOOR and mapper.floor is None
        self.diagnostics.report_problem('floor', NO_FLOOR if is_late else '')

    def _reconfigure(self, config: SceneNodeConfig) -> None:
        set_period(self._timer, config.dense.publish_period_s)
        self._images.reconfigure(config)
        mapper = self._session.mapper
        if mapper is not None and mapper.reconfigure(config.dense):
            self._outputs.note_change()


def main() -> int:
    """Run the node until it ends; return its exit code."""
    return run_node(SceneNode)
