"""The SLAM node's client of the scene process, and the publishers of the scene's topics."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from rclpy.node import Node

from hoid_common import topics
from hoid_common.errors import InputError
from hoid_common.poses.keyframe_poses import KeyframePoses
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.ros.large_messages.publisher import OnDemandPublisher
from hoid_common.values import CameraModel, IntArray
from hoid_scene.dense.submap_export import ExportMark
from hoid_scene.dense.submap_state import DenseMap, SubmapState, misfit
from hoid_scene.scene_scheduler import SceneRequest, SceneScheduler
from rgbd_slam.config.node_config import SlamNodeConfig
from rgbd_slam.robot_map import LoadedMap
from rgbd_slam.ros.scene.messages import (
    ClearScene,
    CommandResult,
    Output,
    SavedObjects,
    SceneCommand,
    SceneExport,
    SceneSetup,
    Subscribed,
)
from rgbd_slam.ros.scene.outputs import (
    EXPECTED_OUTPUT,
    MAP_OUTPUTS,
    MASK_OUTPUTS,
    OBJECT_MAP_OUTPUTS,
    OBJECT_OUTPUTS,
)
from rgbd_slam.ros.scene.process import SceneProcess
from rgbd_slam.store.map_file import MapFile

_PROBLEM = 'scene'
_DEATHS = 'scene processes that died'


def own_remappings(node: str, argv: Sequence[str]) -> tuple[str, ...]:
    """Return the remapping rules of a command line that are for one node, without its name.

    Rules without a node's name are left out, because rclpy applies them in a child process anyway.
    The rule that renames the node is left out as well.
    """
    rules = [rule for option, rule in pairwise(argv) if option in ('-r', '--remap')]
    own = (rule.removeprefix(f'{node}:') for rule in rules if rule.startswith(f'{node}:'))
    return tuple(rule for rule in own if not rule.startswith('__node:='))


def _do_nothing() -> None:
    pass


class SceneClient:
    """Runs the scene process and publishes its messages, if one of the scene's parts is enabled.

    The parts are the dense map, the tracks of people and objects, and the object map.
    If all are off, there is no process: calls do nothing, but `save` and `ask_objects` raise
    InputError.

    Args:
        node: The SLAM node.
        config: Parameters of the node.
        diagnostics: Diagnostics of the node.
    """

    def __init__(self, node: Node, config: SlamNodeConfig, diagnostics: Diagnostics) -> None:
        self._config = config
        self._diagnostics = diagnostics
        self._process: SceneProcess | None = None
        self._camera: CameraModel | None = None
        self._publishers: dict[str, OnDemandPublisher] = {}
        if not (config.dense.enabled or config.objects.enabled or config.object_map.enabled):
            return
        self._publishers = {
            output.name: OnDemandPublisher(
                node, output.type, output.name, output.qos, self._report_subscribers
            )
            for output in (
                *MAP_OUTPUTS,
                *OBJECT_OUTPUTS,
                *OBJECT_MAP_OUTPUTS,
                EXPECTED_OUTPUT,
                *MASK_OUTPUTS,
            )
            if self._is_published(output.name)
        }
        diagnostics.set_count(_DEATHS, 0)
        setup = SceneSetup(
            name=f'{node.get_name()}_scene',
            map_frame=config.frames.map,
            is_map_level=bool(config.frames.base),
            dense=config.dense,
            objects=config.objects,
            object_map=config.object_map,
            navigation=config.navigation,
            input=config.input,
            remappings=own_remappings(node.get_name(), sys.argv),
        )
        self._process = SceneProcess(setup, self._publish, self._report_end)

    def _is_published(self, topic: str) -> bool:
        """Return whether a topic of the scene is published with these parameters."""
        match topic:
            case topics.TF_STATIC:  # otherwise the grid is in the map frame
                return not self._config.frames.base
            case topics.CLOUD_LABELS:
                return self._config.object_map.label_cloud
            case topics.EXPECTED_OBJECTS:
                return self._config.object_map.prior_score > 0
        is_mask = topic in {output.name for output in MASK_OUTPUTS}
        return self._config.navigation.enabled or not is_mask

    @property
    def _dense_process(self) -> SceneProcess | None:
        """Return the scene process if it makes a dense map, else None."""
        return self._process if self._config.dense.enabled else None

    @property
    def _anchored_process(self) -> SceneProcess | None:
        """Return the scene process if it makes a map that moves with the keyframes, else None."""
        is_on = self._config.dense.enabled or self._config.object_map.enabled
        return self._process if is_on else None

    def scene_scheduler(self) -> SceneScheduler:
        """Return a scheduler that selects the images for the scene mapper."""
        config = self._config
        sections = (config.dense, config.objects, config.object_map)
        return SceneScheduler(*(part.rate_hz if part.enabled else None for part in sections))

    def reconfigure(self, config: SlamNodeConfig) -> None:
        """Apply the parameters that may change at run time."""
        self._config = config
        if self._process is not None:
            self._process.send(config.dense)

    def start_map(self, camera: CameraModel) -> None:
        """Start an empty scene for the images of a camera."""
        self._camera = camera
        if self._process is not None:
            self._process.send(camera)

    def clear(self) -> None:
        """Discard the scene, and stop mapping it until `start_map` is called."""
        if self._process is not None:
            self._process.send(ClearScene())

    def request_maps(
        self, keyframes: KeyframePoses, since: ExportMark | None = None
    ) -> Callable[[], SceneExport] | None:
        """Request dense map and object map, relative to keyframes that are saved with them.

        The scene is corrected by these keyframes first.

        Args:
            keyframes: These keyframes.
            since: Only the contents of the dense map that have changed since this export; None:
                all.

        Returns:
            A function that waits for the maps and returns them, or raises InputError. Instead of
            the function, None if both maps are off.
        """
        process = self._anchored_process
        return None if process is None else process.request_maps(keyframes, since)

    def save(self, *, cloud_path: Path | None = None, grid_path: Path | None = None) -> str:
        """Write the dense map or the grid to a file; return a message for the user.

        Args:
            cloud_path: The file for the dense map; None: it is not written.
            grid_path: The YAML file for the grid; None: it is not written.

        Raises:
            InputError: The dense map is off or empty, no floor is known for the grid, the file
                cannot be written, or the process has ended or is late.
        """
        process = self._dense_process
        if process is None:
            raise InputError('the dense map is off here: dense.enabled is false')
        command = SceneCommand(cloud_path=cloud_path, grid_path=grid_path)
        return process.await_result(process.command(command)).text

    def ask_objects(self, command: SceneCommand) -> CommandResult:
        """Execute a command that concerns the object map, and return its result.

        Raises:
            InputError: The object map is off, the command failed, or the process has ended or is
                late.
        """
        process = self._process
        if process is None or not self._config.object_map.enabled:
            raise InputError('the object map is off here: object_map.enabled is false')
        return process.await_result(process.command(command))

    def use_keyframes(self, loaded: LoadedMap, *, keep: bool) -> None:
        """Use the keyframes of a map that has been loaded.

        If dense map and object map are off, nothing happens.

        Args:
            loaded: The keyframes.
            keep: True: keep the running dense map and object map. False: discard them, and the
                tracks of people and objects.
        """
        process, camera = self._anchored_process, self._camera
        if process is None or camera is None:
            return
        if not keep:
            process.send(camera)
        process.send(loaded.keyframes)

    def prepare(self, content: MapFile, keyframe_uids: IntArray) -> tuple[str, Callable[[], None]]:
        """Prepare dense map and object map of a loaded map. Any thread may call this.

        Args:
            content: The loaded map.
            keyframe_uids: (K,) present uids of the keyframes, in the order of the saved map.

        Returns:
            A note for the response on maps that are left out, or ''; and a function that sends the
            others to the scene process. Call it after `use_keyframes`.

        Raises:
            OSError: The file of the dense map for the scene process cannot be written.
        """
        note, send_dense = self._prepare_dense(content.dense, keyframe_uids)
        process, objects = self._process, content.objects
        if objects is None or process is None or not self._config.object_map.enabled:
            left_out = '' if objects is None else '; the object map is off here'
            return note + left_out, send_dense

        def send() -> None:
            send_dense()
            process.send(SavedObjects(objects, keyframe_uids))

        return note, send

    def _prepare_dense(
        self, dense: DenseMap | None, keyframe_uids: IntArray
    ) -> tuple[str, Callable[[], None]]:
        """Prepare the dense map of a loaded map.

        Args:
            dense: The dense map; None if none was saved with the map.
            keyframe_uids: (K,) present uids of the keyframes, in the order of the saved map.

        Returns:
            A note for the response if the dense map is left out, else ''; and a function that
            sends the dense map to the scene process. Call it after `use_keyframes`.
        """
        process, camera = self._dense_process, self._camera
        if dense is None or process is None or camera is None:
            return '' if dense is None else '; the dense map is off here', _do_nothing
        if parameter := misfit(dense, camera, self._config.dense):
            note = f'; its dense map is left out: it was made with another dense.{parameter}'
            return note, _do_nothing
        if isinstance(dense, SubmapState):
            return '', partial(process.send, process.stored(dense, keyframe_uids))
        views = dense.views(keyframe_uids)

        def send() -> None:
            for view in views:
                process.send(view)

        return '', send

    def enqueue(self, request: SceneRequest | None) -> None:
        """Ask the scene process to use an image, unless too many messages wait.

        Images that are left out are counted in the diagnostics.

        Args:
            request: The request; None: do nothing.
        """
        if self._process is None or request is None:
            return
        self._process.enqueue(request)
        self._diagnostics.set_count('images not mapped', self._process.num_dropped)

    def close(self) -> None:
        """End the process; kill it if it does not end by itself."""
        if self._process is not None:
            self._process.close()

    def _report_subscribers(self) -> None:
        """Send the process the topics that have subscribers.

        /tf_static is left out, because its subscribers need not be interested in the scene.
        """
        if self._process is not None:
            names = {name for name, publisher in self._publishers.items() if publisher.is_wanted}
            self._process.send(Subscribed(frozenset(names - {topics.TF_STATIC})))

    def _publish(self, output: Output) -> None:
        self._diagnostics.clear_problem(_PROBLEM)  # a new process is at work
        self._publishers[output.topic].publish(np.frombuffer(output.data, np.uint8))

    def _report_end(self, how: str, is_restarted: bool) -> None:
        self._diagnostics.count(_DEATHS)
        text = f'the process of dense map and objects has ended ({how})'
        if is_restarted:
            text += '; a new one makes the dense map again'
        else:
            text += ' at its start again and again; see its output and restart the node'
        self._diagnostics.set_problem(_PROBLEM, text, severe=not is_restarted)
