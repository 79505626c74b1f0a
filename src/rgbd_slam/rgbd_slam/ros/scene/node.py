"""The node of the scene process, which maps the scene: dense map, grid, people and objects."""

from __future__ import annotations

import os
import time
from contextlib import suppress
from multiprocessing.connection import Connection
from queue import SimpleQueue
from threading import Thread
from typing import Any

from hoid_msgs.msg import DynamicObjectArray
from numpy.typing import NDArray
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from std_msgs.msg import Header

from hoid_common import topics
from hoid_common.errors import HoidError, MessageError
from hoid_common.poses.keyframe_poses import KeyframePoses
from hoid_common.ros import conversions
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.ros.frame_tree import LiveAlignment
from hoid_common.ros.inputs import Inputs
from hoid_common.ros.logs import bridge_logging
from hoid_common.ros.run import run_node
from hoid_common.sync import Match, StampMatcher
from hoid_common.values import CameraModel
from hoid_scene.config.dense_config import DenseConfig
from hoid_scene.dense.stored_view import StoredView
from hoid_scene.dense.submap_state import SubmapState
from hoid_scene.grid.floor import NO_FLOOR
from hoid_scene.navigation_masks import NavigationMasks
from hoid_scene.scene_mapper import SceneMapper
from hoid_scene.scene_scheduler import SceneRequest
from hoid_scene.tracks.object_tracker import TrackedObject
from rgbd_slam.ros.scene.commands import execute
from rgbd_slam.ros.scene.messages import (
    ClearScene,
    SavedObjects,
    SavedSubmaps,
    SceneCommand,
    SceneMessage,
    SceneReport,
    SceneSetup,
    Subscribed,
)
from rgbd_slam.ros.scene.outputs import SceneOutputs
from rgbd_slam.ros.timers import set_period

# Largest difference of the stamps of messages that belong to one image. Chosen: those of depth and
# color of one image differ less, and those of two images at 30 Hz more.
_SLOP_NS = 20_000_000
_PATIENCE_NS = 1_000_000_000  # chosen: how long an image waits for the verdict on its objects
# Chosen: largest ratio of the time that is spent on publishing dense map and grid, and on fusing
# submaps again that corrections have deformed, to the pause that follows. They take at most a
# fifth of the time; the rest is left for new images.
_WORK_PER_PAUSE = 0.25
# Chosen: number of fused images without a floor from which this is reported. They take several
# seconds, in which a robot sees its floor.
_MAX_IMAGES_WITHOUT_FLOOR = 30
# A pose has the stamp of its color image. With `sync_slop_s` of the filter up to 20 ms, an image
# has a pose only if the stamps of depth and color fit, so that a gap means late poses. With a
# larger one, the stamps themselves may differ too much.
_LATE_POSES = (
    'the dense map and the tracks get no images: poses arrive too long after their depth images. '
    'Reduce the load of the computer. If it is low, the stamps of depth and color differ by more '
    'than 20 ms: set input.depth_offset_s'
)
_CAPACITY = 60  # chosen: messages of a kind that wait for the others of an image; 2 s at 30 Hz


class SceneNode(Node):
    """Feeds a `SceneMapper` with images from topics and with poses from the SLAM node's pipe."""

    def __init__(self, messages: Connection, reports: Connection, setup: SceneSetup) -> None:
        # A node name on the command line is meant for the SLAM node.
        rules = (f'__node:={setup.name}', *setup.remappings)
        remappings = [word for rule in rules for word in ('-r', rule)]
        super().__init__(setup.name, cli_args=['--ros-args', *remappings])
        # Building the maps uses only processor time that detector, filter and tracking leave
        # unused (decision 016). The threads of the middleware run already and keep their priority:
        # if they did not answer in time, all other DDS participants would take this one for dead.
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
        bridge_logging(self)
        self._setup = setup
        self._reports = reports
        self._diagnostics = Diagnostics(self)
        self._diagnostics.set_value('process', str(os.getpid()))
        self._scene: SceneMapper | None = None
        self._camera: CameraModel | None = None
        self._outputs = SceneOutputs(self._report, setup)
        self._masks = NavigationMasks(setup.navigation)
        self._stamp_ns = 0  # of the latest image that was used for a scene; 0: none yet
        self._rest_until_s = 0.0  # monotonic time from which dense map and grid may be published
        self._num_fused = 0  # number of images fused into the dense map of this scene
        self._matcher = StampMatcher(
            ('pose', 'depth', 'color', 'objects'), _SLOP_NS, _CAPACITY, ('objects',), _PATIENCE_NS
        )
        inputs = Inputs(self, setup.input, self._diagnostics)
        inputs.depth(self._matched('depth'))
        inputs.color(self._matched('color'))
        self._alignment = LiveAlignment(self, inputs, self._diagnostics)
        inputs.messages(
            DynamicObjectArray, topics.DYNAMIC_OBJECTS, self._on_objects, 'dynamic objects'
        )
        # A timer of steady time publishes the latest map even after images and their clock stop.
        self._timer = self.create_timer(
            setup.dense.publish_period_s,
            self._publish,
            clock=Clock(clock_type=ClockType.STEADY_TIME),
        )
        self._received: SimpleQueue[SceneMessage] = SimpleQueue()
        self._wake = self.create_guard_condition(self._take_received)
        Thread(target=self._listen, args=(messages,), name='from SLAM node', daemon=True).start()

    def _listen(self, messages: Connection) -> None:
        """Receive messages from the SLAM node, until it has ended; then shut this node down."""
        try:
            while True:
                self._received.put(messages.recv())
                self._wake.trigger()
        except (EOFError, OSError, InvalidHandle):  # InvalidHandle: this node is being destroyed
            self.context.try_shutdown()

    def _take_received(self) -> None:
        while not self._received.empty():
            self._take(self._received.get())

    def _take(self, message: SceneMessage) -> None:
        match message:
            case SceneRequest():
                self._add('pose', message.stamp_ns, message)
            case CameraModel():
                self._begin(message)
            case ClearScene():
                self._begin(None)
            case DenseConfig():
                self._reconfigure(message)
            case Subscribed():
                self._outputs.subscribed = message.topics
                self._publish()
            case SceneCommand():
                result = execute(message, self._scene, self._outputs, self._stamp_ns)
                self._report(result)
                self._outputs.note_object_change()
            case _ if self._scene is not None:
                self._change(self._scene, message)

    def _change(
        self, scene: SceneMapper, message: KeyframePoses | SavedSubmaps | SavedObjects | StoredView
    ) -> None:
        """Correct the maps by new keyframe poses, or add a part of a saved scene."""
        match message:
            case KeyframePoses():
                scene.correct(message)
            case SavedSubmaps(path, uids):
                scene.load(SubmapState.read(path), scene.ledger.keyframes, uids)
            case SavedObjects(state, uids):
                scene.load_objects(state, scene.ledger.keyframes, uids)
            case StoredView():
                scene.ledger.restore(message)
        self._on_map_change(scene)

    def _reconfigure(self, dense: DenseConfig) -> None:
        self._setup = self._setup._replace(dense=dense)
        set_period(self._timer, dense.publish_period_s)
        if self._scene is not None and self._scene.reconfigure(dense):
            self._outputs.note_change()

    def _on_map_change(self, scene: SceneMapper) -> None:
        self._outputs.note_change()
        self._report_changes(scene)

    def _report_changes(self, scene: SceneMapper) -> None:
        """Send the changes of the stored images since the last call to the SLAM node.

        Images may be new, attached to another keyframe, or removed. From its list of them, the
        SLAM node restores a scene process that has died.
        """
        for change in scene.ledger.take_changes():
            self._report(change)

    def _report(self, report: SceneReport) -> None:
        with suppress(OSError):  # the SLAM node has ended
            self._reports.send(report)

    def _begin(self, camera: CameraModel | None) -> None:
        if self._scene is not None:
            self._scene.ledger.clear()
            self._report_changes(self._scene)
        self._camera, self._scene, self._num_fused = camera, None, 0
        self._alignment.aligner.color = camera
        if camera is not None:
            self._scene = SceneMapper(
                camera,
                self._setup.dense,
                self._setup.objects,
                self._setup.object_map,
                is_map_level=self._setup.is_map_level,
                folder=self._setup.folder,
            )
        self._masks = NavigationMasks(self._setup.navigation)
        self._matcher.reset()
        self._outputs.clear(self._stamp_ns)
        if self._setup.navigation.enabled and self._stamp_ns:
            self._outputs.publish_masks(self._masks, self._stamp_ns, self.resolve_topic_name)

    def _on_objects(self, msg: DynamicObjectArray) -> None:
        """Add the objects of an image if their verdicts are final: the maps can wait for these."""
        if not msg.provisional:
            self._add('objects', conversions.stamp_from_msg(msg.header.stamp), msg)

    def _matched(self, name: str) -> Any:
        def on_message(msg: Any) -> None:
            self._add(name, conversions.stamp_from_msg(msg.header.stamp), msg)

        return on_message

    def _add(self, name: str, stamp_ns: int, value: Any) -> None:
        for match in self._matcher.add(name, stamp_ns, value):
            try:
                self._map_image(match)
            except HoidError as error:
                self._diagnostics.report(error, 'images refused')
        self._diagnostics.set_count('images missing', self._matcher.counts['pose'].unmatched)
        self._diagnostics.report_problem('stamps', _LATE_POSES if self._matcher.gap else '')

    def _map_image(self, match: Match) -> None:
        """Use an image for the maps for which it was requested; publish tracks and objects."""
        request, depth, color, objects_msg = match.values
        if self._scene is None or self._camera is None:
            return
        depth_m = self._alignment.align(
            conversions.depth_from_msg(depth, self._setup.input.depth_units_per_m),
            depth.header,
            color.header,
            self._camera.size_px,
        )
        objects = () if objects_msg is None else conversions.dynamic_objects_from_msg(objects_msg)
        self._stamp_ns = request.stamp_ns
        if self._setup.objects.enabled and request.track_objects:
            tracks = self._scene.track_objects(request, depth_m, objects)
            self._outputs.publish_objects(tracks, request.stamp_ns)
            self._publish_masks(tracks, request)
        if request.is_for_object_map:
            self._scene.map_objects(request, depth_m, objects)
            self._diagnostics.set_count('mapped objects', self._scene.num_mapped_objects)
            self._outputs.note_object_change()
            self._outputs.publish_object_map(self._scene, self._stamp_ns)
            self._publish_expected(self._scene, color.header)
        if request.is_for_dense_map:
            image_bgr = conversions.color_from_msg(color)
            self._check_size(image_bgr, 'color')
            self._scene.fuse(request, depth_m, image_bgr, objects)
            self._on_map_change(self._scene)
            self._num_fused += 1
            self._diagnostics.count('images fused')
            self._diagnostics.set_count('voxels', self._scene.num_voxels)

    def _publish_expected(self, scene: SceneMapper, header: Header) -> None:
        """Publish where the image with this header should show known objects, for the detector."""
        expected = scene.expected_objects()
        if expected is not None and self._camera is not None:
            self._outputs.publish_expected(expected, header, self._camera.size_px)

    def _publish_masks(self, tracks: tuple[TrackedObject, ...], request: SceneRequest) -> None:
        if not self._setup.navigation.enabled:
            return
        if self._masks.update(tracks, request.T_map_camera, request.stamp_ns):
            self._outputs.publish_masks(self._masks, request.stamp_ns, self.resolve_topic_name)

    def _check_size(self, image: NDArray[Any], what: str) -> None:
        assert self._camera is not None
        size = self._camera.height_px, self._camera.width_px
        if image.shape[:2] != size:
            raise MessageError(
                f'{what} image is {image.shape[1]}x{image.shape[0]}, but the camera is '
                f'{size[1]}x{size[0]}: register depth to color'
            )

    def _publish(self) -> None:
        if self._scene is None:
            return
        self._outputs.publish_object_map(self._scene, self._stamp_ns)
        if time.monotonic() < self._rest_until_s:
            return
        start_s = time.monotonic()
        if self._scene.ledger.fuse_bent():
            self._outputs.note_change()
        if self._outputs.due:
            self._outputs.publish_map(self._scene, self._stamp_ns)
            self._report_floor(self._scene)
        end_s = time.monotonic()
        self._rest_until_s = end_s + (end_s - start_s) / _WORK_PER_PAUSE

    def _report_floor(self, scene: SceneMapper) -> None:
        """Report a problem if the dense map has enough images, but no floor is known."""
        is_late = self._num_fused >= _MAX_IMAGES_WITHOUT_FLOOR and not scene.has_floor
        self._diagnostics.report_problem('floor', NO_FLOOR if is_late else '')


def run_scene_node(messages: Connection, reports: Connection, setup: SceneSetup) -> None:
    """Run the scene node until the SLAM node ends; the main function of the scene process."""
    run_node(lambda: SceneNode(messages, reports, setup))
