"""Each topic name once; relative but for the global ones, so that a namespace moves them."""

from __future__ import annotations

RGB_IMAGE = 'rgb/image'
CAMERA_INFO = 'rgb/camera_info'
DEPTH_IMAGE = 'depth/image'
IMU = 'imu'
INITIAL_POSE = 'initialpose'  # RViz's name; where the robot is, says somebody

DETECTIONS = 'detections'
DETECTIONS_2D = 'detections_2d'  # vision_msgs/Detection2DArray, in place of `detections`
OWN_DETECTIONS_2D = '~/detections_2d'  # the same of our detector, made while somebody listens
FEATURES = 'features'
FEATURE_VERDICTS = 'feature_verdicts'  # the final word on features of images judged too early
DYNAMIC_OBJECTS = 'dynamic_objects'
DEBUG_IMAGE = '~/debug_image'
# For a SLAM that finds its own features; made while somebody listens.
MASK = '~/mask'  # mono8, 255 = static, 0 = moving
STATIC_DEPTH = '~/static_depth'  # 0 where something moves
# For obstacle layers, in the camera's optical frame; made while somebody listens.
MOVING_POINTS = 'moving_points'
STATIC_POINTS = 'static_points'

ODOM = 'odom'
VISUAL_ODOM = 'visual_odom'  # in its place where `odom` is the wheels'
PATH = 'path'
MAP_POINTS = 'map_points'
CLOUD_MAP = 'cloud_map'
GRID_MAP = 'grid_map'
GRID_MAP_UPDATES = 'grid_map_updates'  # map_msgs/OccupancyGridUpdate, beside the whole grid
KEYFRAMES = 'keyframes'
SLAM_STATUS = 'slam_status'
TRACKED_OBJECTS = 'tracked_objects'  # hoid_msgs/TrackedObjectArray
PEOPLE = 'people'  # people_msgs/People
TRACKED_OBJECT_MARKERS = 'tracked_objects/markers'  # visualization_msgs/MarkerArray

# Truth, in bags of recordings that have it; never on /tf, where it would fight the estimate.
GROUND_TRUTH = 'ground_truth'
TRUE_DETECTIONS = 'detections_gt'

TF = '/tf'
TF_STATIC = '/tf_static'
NAMESPACED_TF = ((TF, 'tf'), (TF_STATIC, 'tf_static'))
"""Remaps that give each namespace a frame tree of its own, as Nav2 does for several robots."""
CLOCK = '/clock'
DIAGNOSTICS = '/diagnostics'

ENABLE = '~/enable'  # service of hoid_detector

# Services of rgbd_slam
RESET = '~/reset'
PAUSE = '~/pause'
RESUME = '~/resume'
SET_MODE = '~/set_mode'
SAVE_MAP = '~/save_map'
LOAD_MAP = '~/load_map'
SAVE_TRAJECTORY = '~/save_trajectory'
SAVE_CLOUD = '~/save_cloud'
SAVE_GRID = '~/save_grid'


def compressed(topic: str) -> str:
    """Return the topic of JPEG or PNG pictures that image_transport puts beside a raw one."""
    return f'{topic}/compressed'


def compressed_depth(topic: str) -> str:
    """Return the topic of losslessly packed depth that image_transport puts beside a raw one."""
    return f'{topic}/compressedDepth'


def camera_remappings(rgb: str, depth: str, camera_info: str) -> list[tuple[str, str]]:
    """Return the suite's names of a camera's topics and the given ones, as ROS remaps want them.

    Packed images are beside the raw ones, where image_transport puts them.
    """
    return [
        (RGB_IMAGE, rgb),
        (compressed(RGB_IMAGE), compressed(rgb)),
        (DEPTH_IMAGE, depth),
        (compressed_depth(DEPTH_IMAGE), compressed_depth(depth)),
        (CAMERA_INFO, camera_info),
    ]
