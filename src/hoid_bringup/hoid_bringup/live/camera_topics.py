"""Topics of common camera drivers, so that a camera is chosen by name instead of by three remaps.

Each driver has to publish depth registered to colour; the note says how.
"""

from __future__ import annotations

from typing import NamedTuple

from hoid_common import topics


class CameraTopics(NamedTuple):
    """Where a driver publishes what the suite subscribes to."""

    rgb_image: str
    depth_image: str
    camera_info: str

    def remappings(self) -> list[tuple[str, str]]:
        """Return the suite's names and the driver's, as ROS remaps want them."""
        rgb, depth = topics.RGB_IMAGE, topics.DEPTH_IMAGE
        return [
            (rgb, self.rgb_image),
            (topics.compressed(rgb), topics.compressed(self.rgb_image)),
            (depth, self.depth_image),
            (topics.compressed_depth(depth), topics.compressed_depth(self.depth_image)),
            (topics.CAMERA_INFO, self.camera_info),
        ]


CAMERA_TOPICS = {
    'bag': CameraTopics(topics.RGB_IMAGE, topics.DEPTH_IMAGE, topics.CAMERA_INFO),
    # realsense2_camera 4.x with align_depth.enable:=true
    'realsense': CameraTopics(
        '/camera/camera/color/image_raw',
        '/camera/camera/aligned_depth_to_color/image_raw',
        '/camera/camera/color/camera_info',
    ),
    # azure_kinect_ros_driver; depth_to_rgb is always registered
    'azure_kinect': CameraTopics('/rgb/image_raw', '/depth_to_rgb/image_raw', '/rgb/camera_info'),
    # orbbec_camera with depth_registration:=true
    'orbbec': CameraTopics(
        '/camera/color/image_raw', '/camera/depth/image_raw', '/camera/color/camera_info'
    ),
    # the bags that the TUM RGB-D benchmark itself offers, converted to ROS 2
    'tum': CameraTopics(
        '/camera/rgb/image_color', '/camera/depth/image', '/camera/rgb/camera_info'
    ),
}
