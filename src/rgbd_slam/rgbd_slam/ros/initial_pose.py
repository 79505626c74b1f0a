"""Where somebody says that the robot is, as a click in RViz does."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped

from hoid_common import topics
from hoid_common.errors import MessageError
from hoid_common.inputs.input_config import RELIABLE
from hoid_common.ros.conversions import pose_with_sigmas_from_msg
from hoid_common.ros.inputs import Inputs
from hoid_common.values import FloatArray
from rgbd_slam.session import SlamSession


class InitialPose:
    """Has the session look there first.

    Args:
        inputs: Of the node.
        session: Gives the session, or raises InputError while there is none.
        find_in_map: Returns T_map_frame (4, 4) of a frame's name, or None where it is unknown.
    """

    def __init__(
        self,
        inputs: Inputs,
        session: Callable[[], SlamSession],
        find_in_map: Callable[[str], FloatArray | None],
    ) -> None:
        self._session = session
        self._find_in_map = find_in_map
        inputs.messages(
            PoseWithCovarianceStamped, topics.INITIAL_POSE, self._take, 'initial poses',
            reliability=RELIABLE, is_occasional=True,
        )  # fmt: skip

    def _take(self, msg: PoseWithCovarianceStamped) -> None:
        try:
            T_frame_base, sigma_m, sigma_rad = pose_with_sigmas_from_msg(msg.pose)
        except MessageError as error:
            raise MessageError(f'{error}, on {topics.INITIAL_POSE}') from error
        frame = msg.header.frame_id
        T_map_frame = self._find_in_map(frame)
        if T_map_frame is None:
            raise MessageError(
                f'frame "{frame}" of {topics.INITIAL_POSE} is not joined with the map by any '
                'transform; give the pose in the map frame'
            )
        self._session().look_first_at(np.asarray(T_map_frame @ T_frame_base), sigma_m, sigma_rad)
