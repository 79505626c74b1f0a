"""Names of all topics and services, relative to a node's namespace except ROS's global topics."""

from __future__ import annotations

RGB_IMAGE = 'rgb/image'
CAMERA_INFO = 'rgb/camera_info'
DEPTH_IMAGE = 'depth/image'
IMU = 'imu'
ACCELEROMETER = 'imu/accelerometer'  # for drivers that publish gyro and accelerometer apart
INITIAL_POSE = 'initialpose'  # RViz's "2D Pose Estimate"

DETECTIONS = 'detections'
DETECTIONS_2D = 'detections_2d'  # vision_msgs/Detection2DArray, input instead of `detections`
OWN_DETECTIONS_2D = '~/detections_2d'  # output of hoid_detector, only while it has subscribers
FEATURES = 'features'
# Final verdicts on the features of `features`, which may be provisional.
FEATURE_VERDICTS = 'feature_verdicts'
DYNAMIC_OBJECTS = 'dynamic_objects'
DEBUG_IMAGE = '~/debug_image'
# For another SLAM that extracts features itself; published only while they have subscribers.
MASK = '~/mask'  # mono8, 255 = static, 0 = moving
STATIC_DEPTH = '~/static_depth'  # depth image, 0 on moving objects
# For Nav2's obstacle layers, in the camera's optical frame; published only while they have
# subscribers.
MOVING_POINTS = 'moving_points'
STATIC_POINTS = 'static_points'

ODOM = 'odom'
# Output that replaces `odom` when `odom` is the input of wheel odometry.
VISUAL_ODOM = 'visual_odom'
PATH = 'path'
MAP_POINTS = 'map_points'
CLOUD_MAP = 'cloud_map'
CLOUD_LABELS = 'cloud_map/labels'  # vision_msgs/LabelInfo: the class of each label in cloud_map
GRID_MAP = 'grid_map'
GRID_MAP_UPDATES = 'grid_map_updates'  # map_msgs/OccupancyGridUpdate, changed parts of the grid
KEYFRAMES = 'keyframes'
SLAM_STATUS = 'slam_status'
# For nodes whose maps are attached to keyframes, such as hoid_scene.
KEYFRAME_POSES = 'keyframe_poses'  # hoid_msgs/KeyframePoses
TRACKED_IMAGES = 'tracked_images'  # hoid_msgs/TrackedImage
TRACKED_OBJECTS = 'tracked_objects'  # hoid_msgs/TrackedObjectArray
PEOPLE = 'people'  # people_msgs/People
TRACKED_OBJECT_MARKERS = 'tracked_objects/markers'  # visualization_msgs/MarkerArray
# Masks for Nav2's costmap filters (nav_msgs/OccupancyGrid, nav2_msgs/CostmapFilterInfo).
KEEP_OUT_MASK = 'keep_out_mask'
KEEP_OUT_INFO = 'keep_out_mask/info'
SPEED_MASK = 'speed_mask'
SPEED_INFO = 'speed_mask/info'
OBJECT_MAP = 'object_map'  # vision_msgs/Detection3DArray, the objects at rest
# hoid_msgs/DetectionArray: expected boxes of mapped objects in an image; input of hoid_detector.
EXPECTED_OBJECTS = 'expected_objects'
OBJECT_MAP_MARKERS = 'object_map/markers'  # visualization_msgs/MarkerArray

# Ground truth in bags. It is never on /tf, where it would contradict the estimate.
GROUND_TRUTH = 'ground_truth'
TRUE_DETECTIONS = 'detections_gt'

TF = '/tf'
TF_STATIC = '/tf_static'
NAMESPACED_TF = ((TF, 'tf'), (TF_STATIC, 'tf_static'))
"""Remappings that give each namespace a frame tree of its own, as Nav2 does for several robots."""
CLOCK = '/clock'
DIAGNOSTICS = '/diagnostics'

# Service of hoid_detector.
ENABLE = '~/enable'

# Services of rgbd_slam.
RESET = '~/reset'
PAUSE = '~/pause'
RESUME = '~/resume'
SET_MODE = '~/set_mode'
SAVE_MAP = '~/save_map'
LOAD_MAP = '~/load_map'
SAVE_TRAJECTORY = '~/save_trajectory'

# Services of hoid_scene.
ADD_TO_MAP = '~/add_to_map'  # for rgbd_slam, which saves the map
SAVE_CLOUD = '~/save_cloud'
SAVE_GRID = '~/save_grid'
FIND_OBJECTS = '~/find_objects'
FORGET_OBJECT = '~/forget_object'
SAVE_OBJECTS = '~/save_objects'


def compressed(topic: str) -> str:
    return f'{topic}/compressed'


def compressed_depth(topic: str) -> str:
    return f'{topic}/compressedDepth'


COMPRESSED_SUFFIXES = ('/compressedDepth', '/compressed', '/zstd')
"""Endings that image_transport appends to the name of an image topic for compressed topics."""


def is_compressed(topic: str) -> bool:
    return topic.endswith(COMPRESSED_SUFFIXES)


def image_base(topic: str) -> str:
    """Return the name of an image topic without the suffix that image_transport appends."""
    for suffix in COMPRESSED_SUFFIXES:
        topic = topic.removesuffix(suffix)
    return topic


def camera_info_beside(image_topic: str) -> str:
    return f'{image_base(image_topic).rpartition("/")[0]}/camera_info'


def camera_remappings(rgb: str, depth: str, camera_info: str) -> list[tuple[str, str]]:
    return [
        (RGB_IMAGE, rgb),
        (compressed(RGB_IMAGE), compressed(rgb)),
        (DEPTH_IMAGE, depth),
        (compressed_depth(DEPTH_IMAGE), compressed_depth(depth)),
        (CAMERA_INFO, camera_info),
    ]
