"""Parameters that every node of the suite has: subscriptions, autostart, expert parameters."""

from __future__ import annotations

from dataclasses import dataclass

from hoid_common.config import Config, param, section

BEST_EFFORT = 'best_effort'
RELIABLE = 'reliable'
AUTO = 'auto'


@dataclass(frozen=True)
class InputConfig(Config):
    """Parameters of a node's subscriptions, which `hoid_common.ros.inputs` makes."""

    reliability: str = param(
        AUTO,
        'Reliability that subscriptions request. Choose reliable to have lost messages sent '
        'again; then nothing is received from best-effort publishers. Choose best_effort to '
        'receive from every publisher, without lost messages being sent again. With auto, a '
        'subscription is reliable unless a publisher of its topic offers best effort only. It '
        'does not apply to IMU topics, which are always best effort, nor to feature_verdicts and '
        'the initial pose, which are always reliable.',
        choices=(AUTO, BEST_EFFORT, RELIABLE),
        expert=True,
    )
    queue_length: int = param(
        5,
        'Number of messages of each topic that wait while the node is busy; older messages are '
        'dropped. It does not apply to IMU topics. Raise it when messages are lost at short '
        'peaks of the processor load.',
        minimum=1,
        maximum=1000,
        expert=True,
    )
    compressed: bool = param(
        default=False,
        description='Whether to subscribe to the compressed images of image_transport '
        '(.../compressed and .../compressedDepth) instead of the raw images. Set it to true when '
        'the camera runs on another computer. Topics that are remapped to names with one of these '
        'endings are compressed in any case.',
    )
    camera_frame: str = param(
        '',
        'Name of the optical frame of the camera, for drivers that publish an empty frame_id. It '
        'has no effect on messages with a frame_id. If this parameter is empty, color images, '
        'camera_info and features without a frame_id are refused; depth images need none.',
        expert=True,
    )
    depth_offset_s: float = param(
        0.0,
        'Time by which the stamps of depth images are later than those of the color images that '
        'were taken at the same instant (s). Set it, for hoid_filter and hoid_scene alike, to the '
        'value that hoid_filter suggests when it reports a constant offset between the stamps. '
        'The node hoid_detector does not use it.',
        minimum=-1.0,
        maximum=1.0,
        expert=True,
    )
    depth_units_per_m: float = param(
        0.0,
        'Number of units of depth images per meter (1/m); 0 means 1000 for whole numbers and 1 '
        'for floats (REP 118). Set it, for hoid_filter and hoid_scene alike, for a driver with '
        'other units, such as 10000 for 0.1 mm. The node hoid_detector ignores it.',
        minimum=0.0,
        maximum=1e6,
        expert=True,
    )


@dataclass(frozen=True)
class NodeConfig(Config):
    """Parameters that every node of the suite has."""

    expert: bool = param(
        default=False,
        description='Whether the node declares its expert parameters. Set it to true before you '
        'change an expert parameter in a parameter file or on the command line; otherwise all '
        'expert parameters keep their defaults.',
    )
    autostart: bool = param(
        default=True,
        description='Whether the node configures and activates itself. Set it to false when a '
        'lifecycle manager configures and activates the node.',
    )
    input: InputConfig = section(InputConfig)
