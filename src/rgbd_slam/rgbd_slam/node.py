"""The SLAM node: receives features; publishes odometry, transforms, path and map."""

from __future__ import annotations

from hoid_msgs.msg import Features, FeatureVerdicts
from std_srvs.srv import Trigger

from hoid_common import topics
from hoid_common.inputs.input_config import RELIABLE
from hoid_common.ros import conversions
from hoid_common.ros.execution.service_handlers import ServiceHandlers
from hoid_common.ros.frame_tree import StaticFrameListener
from hoid_common.ros.inputs import Inputs
from hoid_common.ros.lifecycle import ManagedNode
from hoid_common.ros.parameters import Parameters
from hoid_common.ros.run import is_end_asked_for, run_node
from hoid_common.slam_status import SlamStatus
from rgbd_slam.config.node_config import SlamNodeConfig
from rgbd_slam.ros.initial_pose import relocalize_near_initial_poses
from rgbd_slam.ros.keyframe_outputs import KeyframeOutputs
from rgbd_slam.ros.map_outputs import MapOutputs
from rgbd_slam.ros.map_services import MapServices
from rgbd_slam.ros.motion.imu_input import ImuInput
from rgbd_slam.ros.motion.wheels import WheelOdometry
from rgbd_slam.ros.outputs import SlamOutputs
from rgbd_slam.ros.session_lifecycle import SessionLifecycle, exiting_without_mapper, owned_map
from rgbd_slam.ros.tracking_log import TrackingLog
from rgbd_slam.session import SlamSession

# By section of parameters that this node had until version 0.3: the node that has it now.
_MOVED = dict.fromkeys(('dense', 'objects', 'object_map', 'navigation'), 'hoid_scene')


class RgbdSlamNode(ManagedNode):
    """Passes messages to a `SlamSession`, and publishes its results."""

    def __init__(self) -> None:
        super().__init__('rgbd_slam')
        self._settings = Parameters(self, SlamNodeConfig(), self._reconfigure, moved=_MOVED)
        config = self._settings.config
        running = owned_map(self, config)  # raises an error before anything is started
        static = StaticFrameListener(self, self.diagnostics)
        wheels: WheelOdometry | None = None
        if not config.frames.publish_odom_to_base:
            wheels = WheelOdometry(self, config.frames.odom, static.frames, self.diagnostics)
        self._outputs = SlamOutputs(self, config.frames, static.frames, wheels, self.diagnostics)
        self._tracking_log = TrackingLog(self)
        self._keyframes = KeyframeOutputs(self, config.frames, lambda: self._lifecycle.session)
        self._imu = ImuInput(self, config.imu, static.frames, self.diagnostics)
        self._lifecycle = SessionLifecycle(
            self,
            config,
            running,
            static.frames,
            self._keyframes,
            self.diagnostics,
            self._outputs.publish_status,
            wheels,
            self._imu.start,
        )
        require_session = self._lifecycle.require_session
        handlers = ServiceHandlers(self, self.diagnostics)
        handlers.add(Trigger, topics.RESET, lambda _: self._reset())
        handlers.add(Trigger, topics.PAUSE, lambda _: self._set_paused(is_paused=True))
        handlers.add(Trigger, topics.RESUME, lambda _: self._set_paused(is_paused=False))
        self._map_services = MapServices(
            self,
            config,
            require_session,
            self._keyframes,
            self._lifecycle.loader,
            self.diagnostics,
            self._lifecycle.checkpoints.copy_to,
        )
        self._map_outputs = MapOutputs(self, config, lambda: self._lifecycle.session)
        inputs = Inputs(self, config.input, self.diagnostics)
        inputs.camera(self._lifecycle.update_camera)
        on_features = inputs.with_frame(self._on_features, 'features')
        inputs.messages(Features, topics.FEATURES, on_features, 'features')
        inputs.messages(
            FeatureVerdicts,
            topics.FEATURE_VERDICTS,
            self._on_verdicts,
            'feature verdicts',
            reliability=RELIABLE,
            is_occasional=True,
        )
        self._imu.subscribe(inputs)
        relocalize_near_initial_poses(inputs, require_session, self._outputs.find_in_map)
        self.begin(autostart=config.autostart)

    def configure(self) -> None:
        self._lifecycle.configure()

    def clean_up(self) -> None:
        self._lifecycle.clean_up()

    def destroy_node(self) -> None:
        """End the node's threads and processes, then the node."""
        self._map_outputs.close()
        self._map_services.close()
        self._lifecycle.close(is_asked_for=is_end_asked_for())
        super().destroy_node()

    def _on_features(self, msg: Features) -> None:
        self._lifecycle.check_image((msg.image_width, msg.image_height), msg.header.frame_id)
        session = self._lifecycle.session
        if session is None:
            self.diagnostics.count('features before camera and base were known')
            return
        header = msg.header
        with exiting_without_mapper():
            self._imu.deliver(header.frame_id)
            tracked = session.track(conversions.features_from_msg(msg))
            self._outputs.publish_pose(tracked.pose, header)
            done = session.learn(tracked)
        done = self._lifecycle.checkpoints.finish_resume(session, done)
        self._keyframes.publish_image(done.image, header)
        self._outputs.publish_status(done.status, header)
        self._diagnose(session, done.status)
        self._imu.report()
        self._tracking_log.update(done.status)

    def _on_verdicts(self, msg: FeatureVerdicts) -> None:
        session = self._lifecycle.session
        if session is not None:
            session.apply_verdicts(conversions.feature_verdicts_from_msg(msg))

    def _reset(self) -> str:
        self._lifecycle.reset()
        return 'the map is empty; the next image starts a new one'

    def _set_paused(self, *, is_paused: bool) -> str:
        self._lifecycle.require_session().is_paused = is_paused
        return 'paused: images are ignored' if is_paused else 'running'

    def _diagnose(self, session: SlamSession, status: SlamStatus) -> None:
        self.diagnostics.set_value('state', status.state.name.lower())
        self.diagnostics.report_problem('focal length', session.focal_length.problem)
        self.diagnostics.set_count('images processed', status.frames_processed)
        self.diagnostics.set_count('images missing', status.frames_dropped)
        self.diagnostics.set_count('mapping processes that died', session.map.mapper.num_restarts)
        self.diagnostics.set_count('invalid poses', session.map.atlas.guard.num_refused)
        self.diagnostics.set_count(
            'old poses that no file takes', session.slam.trajectory.num_unwritten
        )

    def _reconfigure(self, config: SlamNodeConfig) -> None:
        self._outputs.reconfigure(config.frames)
        self._map_outputs.reconfigure(config)
        self._lifecycle.reconfigure(config)


def main() -> int:
    return run_node(RgbdSlamNode)
