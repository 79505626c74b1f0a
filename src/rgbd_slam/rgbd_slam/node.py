"""The node: features in; odometry, transforms, path and map out."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from hoid_msgs.msg import Features
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header

from hoid_common import topics
from hoid_common.camera_agreement import CameraAgreement
from hoid_common.errors import ConfigError, InputError, MapFileError
from hoid_common.ros import conversions
from hoid_common.ros.frame_tree import StaticFrameListener
from hoid_common.ros.inputs import Inputs
from hoid_common.ros.lifecycle import ManagedNode
from hoid_common.ros.parameters import Parameters
from hoid_common.ros.run import run_node
from hoid_common.slam_status import SlamMode
from hoid_common.values import CameraModel
from rgbd_slam.config.node_config import SlamNodeConfig
from rgbd_slam.map_io import map_file
from rgbd_slam.map_io.map_directory import MAP, path_in
from rgbd_slam.map_io.map_file import MapFile
from rgbd_slam.processes.mapper_process import MapperStoppedError
from rgbd_slam.robot_frames import RobotFrames
from rgbd_slam.ros.answers import Responder
from rgbd_slam.ros.checkpoints import Checkpoints
from rgbd_slam.ros.map_services import MapServices
from rgbd_slam.ros.outputs import SlamOutputs
from rgbd_slam.ros.periods import set_period
from rgbd_slam.ros.scene.link import SceneLink
from rgbd_slam.ros.services import SlamServices
from rgbd_slam.session import Processed, SlamSession


class RgbdSlamNode(ManagedNode):
    """A shell around `SlamSession`, which starts when camera and base are known."""

    def __init__(self) -> None:
        super().__init__('rgbd_slam')
        self._settings = Parameters(self, SlamNodeConfig(), self._reconfigure)
        self._config = self._settings.config
        self._cameras = CameraAgreement()
        self._camera_info: CameraInfo | None = None  # the latest
        self._session: SlamSession | None = None
        self._static = StaticFrameListener(self, self.diagnostics)
        self._outputs = SlamOutputs(
            self, self._config.frames, self._static.frames, self.diagnostics
        )
        self._scene = SceneLink(self, self._config, self.diagnostics)
        self._first_map: MapFile | None = None
        self._is_reset = False  # which forgets that map
        responder = Responder(self, self.diagnostics)
        SlamServices(responder, self._known_session, self._reset)
        self._map_services = MapServices(
            self, self._config, self._known_session, self._scene, self.diagnostics
        )
        self._checkpoints = Checkpoints(
            self, self._config, self.diagnostics, lambda: self._session
        )
        # Wall time, and apart from the images: publishing a map must not hold odometry back.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._map_timer = self.create_timer(
            self._config.map_period_s, self._publish_map, clock=steady
        )
        inputs = Inputs(self, self._config.input, self.diagnostics)
        inputs.messages(CameraInfo, topics.CAMERA_INFO, self._on_camera, 'camera infos')
        inputs.messages(Features, topics.FEATURES, self._on_features, 'features')
        self.begin(autostart=self._config.autostart)

    def configure(self) -> None:
        """Read the map to start with."""
        self._first_map, self._is_reset = self._read_first_map(), False

    def clean_up(self) -> None:
        """Forget the map."""
        self._camera_info = None
        self._reset()

    def destroy_node(self) -> None:
        """End threads and processes before the node."""
        self._map_services.close()
        # An error that ends the node is under way here; whoever asks it to end raises none.
        self._checkpoints.close(is_asked_for=sys.exc_info()[0] is None)
        if self._session is not None:
            self._session.close()
        self._scene.close()
        super().destroy_node()

    def _known_session(self) -> SlamSession:
        if self._session is None:
            raise InputError('nothing has been tracked yet: no camera info and features so far')
        return self._session

    def _on_camera(self, msg: CameraInfo) -> None:
        camera = conversions.camera_from_msg(msg)
        self._camera_info = msg
        is_taken = self._cameras.offer(camera)
        self._say_camera()
        if is_taken and self._session is not None:
            self._session.close()
            self._session = None
            self._scene.clear()
            self._first_map = None if self._is_reset else self._read_first_map()
        if self._session is None and camera == self._cameras.camera:
            self._session = self._start(camera, msg.header)

    def _say_camera(self) -> None:
        if self._cameras.complaint:
            self.diagnostics.set_problem('camera', self._cameras.complaint)
        else:
            self.diagnostics.clear_problem('camera')

    def _on_features(self, msg: Features) -> None:
        try:
            self._cameras.check_image((msg.image_width, msg.image_height))
        finally:
            self._say_camera()
        if self._session is None:
            self.diagnostics.count('features before camera and base were known')
            return
        features = conversions.features_from_msg(msg)
        with _ending_without_mapper():
            done = self._session.process(features)
        done = self._checkpoints.followed(self._session, done)
        self._scene.enqueue(done.fusion)
        self._outputs.publish(done, msg.header)
        self.diagnostics.set_value('state', done.status.state.name.lower())
        self.diagnostics.set_count('images processed', done.status.frames_processed)
        self.diagnostics.set_count('images missing', done.status.frames_dropped)
        restarts = self._session.map.num_restarts
        self.diagnostics.set_count('mapping processes that died', restarts)

    def _reconfigure(self, config: SlamNodeConfig) -> None:
        self._config = config
        self._outputs.reconfigure(config.frames)
        set_period(self._map_timer, config.map_period_s)
        self._scene.reconfigure(config)
        if self._session is not None:
            self._session.reconfigure(config, self._scene.fusion_scheduler())

    def _publish_map(self) -> None:
        if self._session is not None and self._session.take_map_changed():
            self._outputs.publish_map(self._session)

    def _start(self, camera: CameraModel, header: Header) -> SlamSession | None:
        """Return a session, or None while the base is unknown; takes a second or two."""
        names = self._config.frames
        T_base_camera = (
            self._static.frames.find(names.base, header.frame_id) if names.base else None
        )
        if names.base and T_base_camera is None:
            self.diagnostics.set_problem(
                'base', f'/tf_static does not join frames "{names.base}" and "{header.frame_id}"'
            )
            return None
        self.diagnostics.clear_problem('base')
        if names.planar and not names.base:
            self.diagnostics.set_problem(
                'planar', 'frames.planar needs frames.base, the frame that moves on the plane'
            )
        frames = RobotFrames(T_base_camera, planar=names.planar)
        with _ending_without_mapper():
            session = SlamSession(
                camera,
                self._config,
                frames,
                background=True,
                fusion_scheduler=self._scene.fusion_scheduler(),
            )
        self._scene.start_map(camera)
        resumed = self._checkpoints.resume(session, conversions.stamp_from_msg(header.stamp))
        if resumed is not None:
            self._scene.load(None, resumed, keep=False)
        elif self._first_map is not None:
            self._load_first_map(session, self._first_map)
        done = self._checkpoints.followed(session, Processed(session.status(), None))
        self._outputs.publish(done, header)
        return session

    def _read_first_map(self) -> MapFile | None:
        """Return the map to start with; raises HoidError, which ends the node, for a bad one."""
        config = self._config
        if config.map_file:
            return map_file.load(path_in(config.map_directory, config.map_file, MAP))
        if SlamMode[config.mode.upper()] is SlamMode.LOCALIZATION:
            raise ConfigError('mode is localization, which needs a map_file')
        return None

    def _load_first_map(self, session: SlamSession, content: MapFile) -> None:
        self._first_map = None
        try:
            loaded = session.load(content)
        except MapFileError as error:
            raise SystemExit(f'error: {self._config.map_file}: {error}') from error
        session.set_mode(SlamMode[self._config.mode.upper()])
        self._scene.load(content.dense, loaded, keep=False)

    def _reset(self) -> None:
        if self._session is not None:
            self._session.close()
        self._session = self._first_map = None
        self._is_reset = True
        self._checkpoints.forget()
        self._scene.clear()
        self._cameras = CameraAgreement()
        if self._camera_info is not None:
            self._on_camera(self._camera_info)


@contextmanager
def _ending_without_mapper() -> Iterator[None]:
    """End the node when mapping cannot be kept running; a supervisor starts it anew."""
    try:
        yield
    except MapperStoppedError as error:
        raise SystemExit(f'error: {error}') from error


def main() -> int:
    """Run the node."""
    return run_node(RgbdSlamNode)
