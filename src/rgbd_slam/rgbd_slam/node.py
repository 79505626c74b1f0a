"""The node: features in; odometry, transforms, path and map out."""

from __future__ import annotations

import sys

from hoid_msgs.msg import Features, FeatureVerdicts
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import CameraInfo

from hoid_common import topics
from hoid_common.inputs.input_config import RELIABLE
from hoid_common.ros import conversions
from hoid_common.ros.frame_tree import StaticFrameListener
from hoid_common.ros.inputs import Inputs
from hoid_common.ros.lifecycle import ManagedNode
from hoid_common.ros.parameters import Parameters
from hoid_common.ros.run import run_node
from hoid_common.slam_status import SlamStatus
from rgbd_slam.config.node_config import SlamNodeConfig
from rgbd_slam.ros.answers import Responder
from rgbd_slam.ros.initial_pose import InitialPose
from rgbd_slam.ros.map_services import MapServices
from rgbd_slam.ros.outputs import SlamOutputs
from rgbd_slam.ros.periods import set_period
from rgbd_slam.ros.running_session import RunningSession
from rgbd_slam.ros.scene.link import SceneLink
from rgbd_slam.ros.services import SlamServices
from rgbd_slam.session import SlamSession


class RgbdSlamNode(ManagedNode):
    """A shell around `SlamSession`, which starts when camera and base are known."""

    def __init__(self) -> None:
        super().__init__('rgbd_slam')
        self._settings = Parameters(self, SlamNodeConfig(), self._reconfigure)
        config = self._settings.config
        static = StaticFrameListener(self, self.diagnostics)
        self._outputs = SlamOutputs(self, config.frames, static.frames, self.diagnostics)
        self._scene = SceneLink(self, config, self.diagnostics)
        self._running = RunningSession(
            self, config, static.frames, self._scene, self.diagnostics,
            self._outputs.publish_status, self._outputs.wheel_motion,
        )  # fmt: skip
        responder = Responder(self, self.diagnostics)
        SlamServices(responder, self._running.known, self._running.reset)
        self._map_services = MapServices(
            self, config, self._running.known, self._scene, self.diagnostics
        )
        # Wall time, and apart from the images: publishing a map must not hold odometry back.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._map_timer = self.create_timer(config.map_period_s, self._publish_map, clock=steady)
        inputs = Inputs(self, config.input, self.diagnostics)
        inputs.messages(CameraInfo, topics.CAMERA_INFO, self._on_camera, 'camera infos')
        inputs.messages(Features, topics.FEATURES, self._on_features, 'features')
        inputs.messages(
            FeatureVerdicts, topics.FEATURE_VERDICTS, self._on_verdicts, 'feature verdicts',
            reliability=RELIABLE, is_occasional=True,
        )  # fmt: skip
        InitialPose(inputs, self._running.known, self._outputs.find_in_map)
        self.begin(autostart=config.autostart)

    def configure(self) -> None:
        """Read the map to start with."""
        self._running.configure()

    def clean_up(self) -> None:
        """Forget the map."""
        self._running.forget()

    def destroy_node(self) -> None:
        """End threads and processes before the node."""
        self._map_services.close()
        # An error that ends the node is under way here; whoever asks it to end raises none.
        self._running.close(is_asked_for=sys.exc_info()[0] is None)
        self._scene.close()
        super().destroy_node()

    def _on_camera(self, msg: CameraInfo) -> None:
        self._running.offer_camera(conversions.camera_from_msg(msg), msg.header)

    def _on_features(self, msg: Features) -> None:
        self._running.check_image((msg.image_width, msg.image_height))
        session = self._running.session
        if session is None:
            self.diagnostics.count('features before camera and base were known')
            return
        tracked = self._running.track(session, conversions.features_from_msg(msg))
        self._outputs.publish_pose(tracked.pose, msg.header)
        done = self._running.learn(session, tracked)
        self._scene.enqueue(done.fusion)
        self._outputs.publish_status(done.status, msg.header)
        self._diagnose(session, done.status)

    def _on_verdicts(self, msg: FeatureVerdicts) -> None:
        session = self._running.session
        if session is not None:
            session.judge_again(conversions.feature_verdicts_from_msg(msg))

    def _diagnose(self, session: SlamSession, status: SlamStatus) -> None:
        self.diagnostics.set_value('state', status.state.name.lower())
        self.diagnostics.set_count('images processed', status.frames_processed)
        self.diagnostics.set_count('images missing', status.frames_dropped)
        self.diagnostics.set_count('mapping processes that died', session.map.num_restarts)
        self.diagnostics.set_count('old poses that no file takes', session.num_unwritten)

    def _reconfigure(self, config: SlamNodeConfig) -> None:
        self._outputs.reconfigure(config.frames)
        set_period(self._map_timer, config.map_period_s)
        self._scene.reconfigure(config)
        self._running.reconfigure(config)

    def _publish_map(self) -> None:
        session = self._running.session
        if session is not None and session.take_map_changed():
            self._outputs.publish_map(session)


def main() -> int:
    """Run the node."""
    return run_node(RgbdSlamNode)
