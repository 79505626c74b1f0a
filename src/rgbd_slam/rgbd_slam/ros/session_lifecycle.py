"""The life of the node's session: starts when camera and base are known, is reset, and ends."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rclpy.node import Node
from std_msgs.msg import Header

from hoid_common import topics
from hoid_common.errors import ConfigError, HoidError, InputError, MapFileError
from hoid_common.inputs.camera_info_check import CameraInfoCheck
from hoid_common.poses.frames import StaticFrames
from hoid_common.ros.conversions import stamp_from_msg
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.slam_status import SlamMode, SlamStatus
from hoid_common.store.map_directory import MAP, existing_map, path_in
from hoid_common.values import CameraModel, FloatArray
from rgbd_slam.config.node_config import SlamNodeConfig
from rgbd_slam.inertial.imu import Imu
from rgbd_slam.mapping.mapper_process import MapperStoppedError
from rgbd_slam.robot_frames import RobotFrames
from rgbd_slam.ros.checkpoints import Checkpoints
from rgbd_slam.ros.keyframe_outputs import KeyframeOutputs
from rgbd_slam.ros.map_loader import MapLoader
from rgbd_slam.ros.motion.wheels import WheelOdometry
from rgbd_slam.session import Processed, SlamSession
from rgbd_slam.store import map_file
from rgbd_slam.store.map_file import MapFile
from rgbd_slam.store.running_map import RunningMap
from rgbd_slam.tracking.motion_sources import ExternalOdometry


class SessionLifecycle:
    """Starts, resets and ends `session`, to which the node passes its messages.

    Args:
        publish_status: Publishes the status of a new session, before its first image.
        wheels: External odometry, if another node sends odom -> base; else None.
        start_imu: Creates the IMU of a new session.
    """

    def __init__(
        self,
        node: Node,
        config: SlamNodeConfig,
        running: RunningMap,
        frames: StaticFrames,
        keyframes: KeyframeOutputs,
        diagnostics: Diagnostics,
        publish_status: Callable[[SlamStatus, Header], None],
        wheels: WheelOdometry | None,
        start_imu: Callable[[], Imu],
    ) -> None:
        self._config, self._frames, self._keyframes = config, frames, keyframes
        self._logger = node.get_logger()
        self._diagnostics, self._publish_status = diagnostics, publish_status
        self._wheels, self._start_imu = wheels, start_imu
        reset = node.resolve_service_name(topics.RESET)
        self._camera_remedy = f'call {reset} to begin a new map with the camera as it is now'
        self._tf_static = node.resolve_topic_name(topics.TF_STATIC)
        self.session: SlamSession | None = None
        self._frame = ''  # frame of the camera_info with which the session began
        self._cameras = CameraInfoCheck(self._camera_remedy)
        self._last_camera: tuple[CameraModel, Header] | None = None  # the latest camera_info
        self._first_map: MapFile | None = None  # map to load into the next session
        # Error because of which the configured map file is not used.
        self._first_map_error: HoidError | None = None
        self._is_reset = False  # True: the configured map file was discarded by a reset
        self.checkpoints = Checkpoints(node, config, running, diagnostics, lambda: self.session)
        self.loader = MapLoader(node, lambda: self.session, keyframes, self.checkpoints.keep)

    def require_session(self) -> SlamSession:
        """Return the session; raise InputError while there is none."""
        if self.session is None:
            raise InputError('nothing has been tracked yet: no camera info and features so far')
        return self.session

    def configure(self) -> None:
        """Read the configured map file, if there is one, for the first session.

        If it cannot be read, but there is a checkpoint of a killed node, the session resumes that
        instead; the error ends the node only if this fails too.

        Raises:
            HoidError: The map file cannot be read, or localization is configured without one.
        """
        self._first_map, self._first_map_error, self._is_reset = None, None, False
        try:
            self._first_map = self._read_first_map()
        except HoidError as error:
            if not self.checkpoints.has_stored:
                raise
            self._first_map_error = error
            self._logger.warning(f'{error}; the checkpoint of the killed node is resumed instead')

    def reconfigure(self, config: SlamNodeConfig) -> None:
        self._config = config
        if self.session is not None:
            self.session.reconfigure(config)

    def update_camera(self, camera: CameraModel, header: Header) -> None:
        """Process a camera_info; start the session if camera and base are now known.

        If another calibration replaces the one in use, the old session ends first.

        Raises:
            HoidError: The configured map file cannot be read again; there is no session then.
            SystemExit: The mapping process does not start, or the configured map cannot be used.
        """
        self._last_camera = camera, header
        self._check_frame('camera_info', header.frame_id)
        is_new = self._cameras.update(camera)
        self._report_camera()
        self._start_anew(is_new)

    def _start_anew(self, is_new_camera: bool) -> None:
        if is_new_camera and self.session is not None:
            self.checkpoints.keep()
            self._end()
            self._keyframes.begin()
            self._first_map = None if self._is_reset else self._read_first_map()
        self._start_if_ready()

    def check_image(self, size_px: tuple[int, int], frame: str) -> None:
        """Check size and frame of an image; start the session if camera and base are now known.

        Raises:
            MessageError: The size differs from that in camera_info.
        """
        self._check_frame('color images', frame)
        try:
            is_new = self._cameras.check_image(size_px)
        finally:
            self._report_camera()
        self._start_anew(is_new)

    def reset(self) -> None:
        """Keep the map, and start an empty session with the latest camera_info."""
        self.checkpoints.discard()
        self._end()
        self._first_map, self._first_map_error, self._is_reset = None, None, True
        self._keyframes.begin()
        self._cameras = CameraInfoCheck(self._camera_remedy)
        if self._last_camera is not None:
            self.update_camera(*self._last_camera)

    def clean_up(self) -> None:
        """Keep the map as `reset` does, but start no session before the next camera_info."""
        self._last_camera = None
        self.reset()

    def close(self, *, is_asked_for: bool) -> None:
        """End the session and its checkpoints (see `Checkpoints.close`)."""
        self.checkpoints.close(is_asked_for=is_asked_for)
        self._end()

    def _start_if_ready(self) -> None:
        camera = self._cameras.camera  # it may be scaled, unlike that of the message
        if self.session is None and camera is not None and self._last_camera is not None:
            self.session = self._start(camera, self._last_camera[1])

    def _check_frame(self, what: str, frame: str) -> None:
        """Report messages with another frame than the camera_info with which the session began."""
        problem = ''
        if self.session is not None and frame != self._frame:
            problem = (
                f'{what}: of frame "{frame}", but the map was begun with "{self._frame}", which '
                f'is kept; {self._camera_remedy}'
            )
        self._diagnostics.report_problem(f'other frame of {what}', problem)

    def _end(self) -> None:
        if self.session is not None:
            self.session.close()
            self.session = None

    def _report_camera(self) -> None:
        self._diagnostics.report_problem('camera', self._cameras.problem)

    def _robot_frames(self, header: Header) -> RobotFrames | None:
        """Return the robot's frames with the camera's mounting; None while that is unknown."""
        names = self._config.frames
        T_base_camera = self._frames.find(names.base, header.frame_id) if names.base else None
        if names.base and T_base_camera is None:
            self._diagnostics.set_problem(
                'base',
                f'{self._tf_static} does not join frames "{names.base}" and "{header.frame_id}": '
                'publish where the camera is mounted',
            )
            return None
        self._diagnostics.clear_problem('base')
        if names.planar and not names.base:
            self._diagnostics.set_problem(
                'planar', 'frames.planar needs frames.base, the frame that moves on the plane'
            )
        return RobotFrames(T_base_camera, planar=names.planar)

    def _start(self, camera: CameraModel, header: Header) -> SlamSession | None:
        """Start a session and its map; None while the camera's pose on the base is unknown."""
        frames = self._robot_frames(header)
        if frames is None:
            return None
        base = self._config.frames.base or header.frame_id

        def camera_motion(first_ns: int, second_ns: int) -> FloatArray | None:
            if self._wheels is None:
                return None
            T_first_second = self._wheels.motion(first_ns, second_ns, base)
            return None if T_first_second is None else frames.camera_motion(T_first_second)

        with exiting_without_mapper():
            session = SlamSession(
                camera,
                self._config,
                frames,
                background=True,
                imu=self._start_imu(),
                motion_sources=[ExternalOdometry(camera_motion)],
            )
        self._frame = header.frame_id
        # Set first, because the loader checks that the session is the present one.
        self.session = session
        if self.checkpoints.resume(session, stamp_from_msg(header.stamp), self.loader):
            self._first_map = None
        elif self._first_map_error is not None:
            raise SystemExit(f'error: {self._first_map_error}') from self._first_map_error
        elif self._first_map is not None:
            self._load_first_map(session, self._first_map)
        done = Processed(session.status(), None)
        self._publish_status(self.checkpoints.finish_resume(session, done).status, header)
        return session

    def _read_first_map(self) -> MapFile | None:
        config = self._config
        if config.map_file:
            return map_file.load(existing_map(config.map_directory, config.map_file))
        if SlamMode[config.mode.upper()] is SlamMode.LOCALIZATION:
            raise ConfigError(
                'mode is localization, which needs a map_file: set it, or the mode mapping'
            )
        return None

    def _load_first_map(self, session: SlamSession, content: MapFile) -> None:
        self._first_map = None
        try:
            mode = SlamMode[self._config.mode.upper()]
            self.loader.load_first(
                session,
                content,
                str(path_in(self._config.map_directory, self._config.map_file, MAP)),
                lambda: session.set_mode(mode),
                extend=mode is SlamMode.MAPPING,
            )
        except MapFileError as error:
            raise SystemExit(f'error: {self._config.map_file}: {error}') from error


def owned_map(node: Node, config: SlamNodeConfig) -> RunningMap:
    """Return the database of a node's map, owned by this process if it writes checkpoints.

    Raises:
        SystemExit: Another process runs a node of this name in the same ROS domain.
    """
    domain, name = os.environ.get('ROS_DOMAIN_ID', '0'), node.get_fully_qualified_name()
    running = RunningMap(config.map_directory, f'{domain}{name}')
    try:
        # A node that localizes in a given map does not change it, so that a crash loses nothing
        # and no checkpoint is needed.
        if config.checkpoint_period_s > 0 and config.mode == SlamMode.MAPPING.name.lower():
            running.own(name)
    except MapFileError as error:
        raise SystemExit(f'error: {error}') from None
    return running


@contextmanager
def exiting_without_mapper() -> Iterator[None]:
    """Replace MapperStoppedError by SystemExit, so that a supervisor restarts the node."""
    try:
        yield
    except MapperStoppedError as error:
        raise SystemExit(f'error: {error}') from error
