"""Topics of common camera drivers, and the settings with which they register depth to color."""

from __future__ import annotations

from typing import NamedTuple

from hoid_common import topics


class CameraTopics(NamedTuple):
    """Topics of a driver that the suite subscribes to."""

    # Name and version of the driver, and its setting that registers depth to color.
    driver: str
    namespace: str  # default namespace of the driver
    rgb_image: str  # relative to the namespace, as are the next two
    depth_image: str
    camera_info: str

    def remappings(self, namespace: str = '') -> list[tuple[str, str]]:
        """Return the remaps (from, to) of the suite's topics to those of the driver."""
        return topics.camera_remappings(*self.topics(namespace))

    def topics(self, namespace: str = '') -> tuple[str, ...]:
        """Return the names of the topics of color images, depth images and camera info."""
        namespace = namespace or self.namespace
        prefix = f'{namespace.rstrip("/")}/' if namespace else ''
        return tuple(f'{prefix}{name}' for name in self[2:])


CAMERA_TOPICS = {
    'bag': CameraTopics(
        'HOID bags and remapped drivers', '',
        topics.RGB_IMAGE, topics.DEPTH_IMAGE, topics.CAMERA_INFO,
    ),
    'realsense': CameraTopics(
        'realsense2_camera 4.55, align_depth.enable:=true', '/camera/camera',
        'color/image_raw', 'aligned_depth_to_color/image_raw', 'color/camera_info',
    ),
    'realsense_unaligned': CameraTopics(
        'realsense2_camera 4.55 as it starts by default', '/camera/camera',
        'color/image_raw', 'depth/image_rect_raw', 'color/camera_info',
    ),
    'realsense_4_54': CameraTopics(
        'realsense2_camera before 4.55 and that of ROS 1, align_depth', '/camera',
        'color/image_raw', 'aligned_depth_to_color/image_raw', 'color/camera_info',
    ),
    'realsense_viewer': CameraTopics(
        'RealSense Viewer and librealsense (.bag), D435 and D455', '/device_0',
        'sensor_1/Color_0/image/data', 'sensor_0/Depth_0/image/data',
        'sensor_1/Color_0/info/camera_info',
    ),
    'azure_kinect': CameraTopics(
        'azure_kinect_ros_driver 1.4, which always registers depth', '/',
        'rgb/image_raw', 'depth_to_rgb/image_raw', 'rgb/camera_info',
    ),
    'orbbec': CameraTopics(
        'orbbec_camera 1.5 and 2, depth_registration:=true', '/camera',
        'color/image_raw', 'depth/image_raw', 'color/camera_info',
    ),
    'zed': CameraTopics(
        'zed_wrapper 5.1, which always registers depth', '/zed/zed_node',
        'rgb/color/rect/image', 'depth/depth_registered', 'rgb/color/rect/camera_info',
    ),
    'zed_4': CameraTopics(
        'zed_wrapper 4 and 5.0, which always registers depth', '/zed/zed_node',
        'rgb/image_rect_color', 'depth/depth_registered', 'rgb/camera_info',
    ),
    'oak': CameraTopics(
        'depthai_ros_driver 2.11 and 3, stereo aligned to rgb', '/oak',
        'rgb/image_raw', 'stereo/image_raw', 'rgb/camera_info',
    ),
    'openni2': CameraTopics(
        'openni2_camera 2.2, camera_with_cloud.launch.py', '/camera',
        'rgb/image_raw', 'depth_registered/image_raw', 'rgb/camera_info',
    ),
    'tum': CameraTopics(
        "the TUM RGB-D benchmark's own bags", '/camera',
        'rgb/image_color', 'depth/image', 'rgb/camera_info',
    ),
}  # fmt: skip
