"""Conversions from messages (`x_from_msg`) and to messages (`x_to_msg`).

A function `x_from_msg` raises MessageError for an invalid message. A function `x_to_msg` for
results takes the Header of the image that they belong to.
"""

from hoid_common.io.camera_info import camera_from_info as camera_from_msg
from hoid_common.messages import (
    detections_from_msg,
    pose_from_msg,
    stamp_from_msg,
    transform_from_msg,
)
from hoid_common.ros.conversions.clouds import Cloud, cloud_from_msg, cloud_to_msg
from hoid_common.ros.conversions.detections import (
    detections_2d_from_msg,
    detections_2d_to_msg,
    detections_to_msg,
    dynamic_objects_from_msg,
    dynamic_objects_to_msg,
)
from hoid_common.ros.conversions.features import (
    FeatureCounts,
    feature_counts_from_msg,
    feature_verdicts_from_msg,
    feature_verdicts_to_msg,
    features_from_msg,
    features_to_msg,
)
from hoid_common.ros.conversions.geometry import (
    camera_frame,
    header_to_msg,
    odometry_to_msg,
    pose_to_msg,
    pose_with_sigmas_from_msg,
    stamp_to_msg,
    transform_to_msg,
)
from hoid_common.ros.conversions.images import (
    ReceivedImage,
    camera_to_msg,
    color_from_msg,
    color_to_msg,
    compressed_color_to_msg,
    compressed_depth_to_msg,
    depth_from_msg,
    depth_to_msg,
    image_from_cdr,
    mask_to_msg,
)
