"""The topic `initialpose`: an operator states the robot's pose, for example in RViz."""

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


def relocalize_near_initial_poses(
    inputs: Inputs,
    session: Callable[[], SlamSession],
    find_in_map: Callable[[str], FloatArray | None],
) -> None:
    """Subscribe to initial poses; the session then relocalizes near them first.

    Args:
        find_in_map: Returns T_map_frame (4, 4) for the name of a frame, or None if it is unknown.
    """

    def on_pose(msg: PoseWithCovarianceStamped) -> None:
        try:
            T_frame_base, sigma_m, sigma_rad = pose_with_sigmas_from_msg(msg.pose)
        except MessageError as error:
            raise MessageError(f'{error}, on {topics.INITIAL_POSE}') from error
        frame = msg.header.frame_id
        T_map_frame = find_in_map(frame)
        if T_map_frame is None:
            raise MessageError(
                f'no transform connects frame "{frame}" of {topics.INITIAL_POSE} with the map; '
                'give the pose in the map frame'
            )
        session().relocalize_near(np.asarray(T_map_frame @ T_frame_base), sigma_m, sigma_rad)

    inputs.messages(
        PoseWithCovarianceStamped,
        topics.INITIAL_POSE,
        on_pose,
        'initial poses',
        reliability=RELIABLE,
        is_occasional=True,
    )
