"""Parameters of the filter and its node, with their defaults, ranges and descriptions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

from hoid_common.config import Config, param, section
from hoid_common.inputs.input_config import NodeConfig
from hoid_common.values import PERSON, REST_S
from hoid_filter.strategy_registry import STRATEGIES

# Chosen: COCO classes of things that people pick up, push or carry indoors, except for cutlery and
# food; and the class box, which COCO lacks.
HANDLED_CLASSES = (
    'chair', 'book', 'cup', 'bottle', 'wine glass', 'bowl', 'laptop', 'keyboard', 'mouse',
    'cell phone', 'remote', 'backpack', 'handbag', 'suitcase', 'sports ball', 'umbrella',
    'teddy bear', 'potted plant', 'tv', 'vase', 'scissors', 'tie', 'frisbee', 'skateboard',
    'tennis racket', 'baseball bat', 'toothbrush', 'hair drier', 'clock', 'box',
)  # fmt: skip
UNFILTERED, STOP = 'unfiltered', 'stop'


@dataclass(frozen=True)
class ExtractionConfig(Config):
    """Parameters of the extraction of ORB features."""

    num_features: int = param(
        1000,  # ORB-SLAM3, TUM1.yaml
        'Largest number of features per image. Raise it in scenes with little texture, lower it '
        'to save processor time.',
        limits=(50, 20000),
    )
    refill: bool = param(
        default=True,  # decision 014
        description='Whether features on dynamic objects are replaced by others on static '
        'surface.',
        expert=True,
    )

    # Whether the number of features per pyramid level follows the image (decision 059). In blurred
    # or dark images most corners on fine levels are noise, and coarse levels then get more
    # features. False: levels have the fixed shares of ORB-SLAM3, and `low_fast_threshold` is used
    # on all levels or on none.
    adapt_levels: bool = param(default=True, internal=True)

    # Number of levels of the image pyramid, and ratio of the scales of neighboring levels
    # (ORB-SLAM3, TUM1.yaml).
    num_levels: ClassVar[int] = 8
    scale_factor: ClassVar[float] = 1.2
    # Smallest distance of a corner from the border of its pyramid level: the radius of a rotated
    # descriptor patch, in pixels of that level.
    border_px: ClassVar[int] = 19
    # Smallest contrast (gray levels) of a FAST corner: ORB-SLAM3's lower threshold, which
    # TUM1.yaml uses for cells without strong corners.
    fast_threshold: ClassVar[int] = 7
    # Chosen: the smallest contrast (gray levels) on a level where `fast_threshold` finds fewer
    # corners than features are wanted, for example on a plain wall.
    low_fast_threshold: ClassVar[int] = 3


@dataclass(frozen=True)
class PlusConfig(Config):
    """Parameters with which the strategy `hoid+` goes beyond the rules of the HOID paper."""

    coast_s: float = param(
        0.4,  # chosen: 12 images at 30 Hz; docs/results/ablation.md, masks
        'Longest time for which hoid+ predicts the box of a person or a handled object that the '
        'detector misses (s). Raise it when people are missed for longer, lower it when '
        'features are removed where nobody is.',
        limits=(0.0, 10.0),
        read_only=False,
    )
    doubt_large_people: bool = param(
        default=True,  # docs/results/ablation.md, false_every
        description='Whether hoid+ ignores a person with a score below 0.5 whose box covers more '
        'than 0.4 of the image, until the fourth detection in a row.',
        read_only=False,
    )
    doubt_in_turns: bool = param(
        default=True,  # decision 050
        description='Whether hoid+, while the camera turns faster than 0.5 rad/s, predicts no box '
        'that the detector missed, and ignores every person with a score below 0.5 until the '
        'fourth detection in a row. It has no effect without motion.enabled.',
        read_only=False,
    )
    remember: bool = param(
        default=True,  # docs/results/ablation.md, masks
        description='Whether hoid+ keeps an object dynamic until it has been seen for a second '
        'with nobody handling it, and needs only half of min_interaction_area while it is '
        'handled.',
        read_only=False,
    )
    keep_background: bool = param(
        default=True,  # docs/results/ablation.md, carry-screen
        description='Whether hoid+ masks only those pixels of a dynamic box whose depth is near '
        'that of the person or object. Set it to false for a camera with poor depth.',
        read_only=False,
    )

    # Chosen: a detected person may be false if its score is below `doubt_score` and either its box
    # covers a larger ratio of the image than `doubt_area`, or the camera turns faster than
    # `doubt_turn_radps`: 0.5 rad/s blur a VGA image by 8 px in 30 ms, the exposure time in a dim
    # room (decision 050). The doubt ends after `doubt_detections` such detections in a row, or one
    # that is not doubtful.
    doubt_area: ClassVar[float] = 0.4
    doubt_score: ClassVar[float] = 0.5
    doubt_turn_radps: ClassVar[float] = 0.5
    doubt_detections: ClassVar[int] = 4
    # Chosen: with `remember`, a handled object stays handled while the box of a person at its
    # depth covers more of its box than `min_interaction_area` times this ratio.
    release_share: ClassVar[float] = 0.5
    # Chosen: pixels in a person's box belong to the person if their depth differs from the torso's
    # by at most this; `object_depth_m` is the same for the middle of an object.
    person_depth_m: ClassVar[float] = 0.45
    object_depth_m: ClassVar[float] = 0.25
    # Chosen, the length of an arm: a handled object is at most this much nearer to the camera than
    # the person's torso. `depth_limit_m` limits how much farther it may be.
    reach_m: ClassVar[float] = 0.6
    # An object counts as static when nobody has handled it for this time.
    rest_s: ClassVar[float] = REST_S


@dataclass(frozen=True)
class MotionConfig(Config):
    """Motion segmentation from depth and tracked points; used by `motion` and `hoid+`."""

    enabled: bool = param(
        default=True,  # docs/results/ablation.md, crowd
        description='Whether hoid+ also masks moving regions that the detector does not find. Set '
        'it to false to save processor time where only known classes move.',
        read_only=False,
    )
    rate_hz: float = param(
        0.0,  # decision 057
        'Largest number of images in which motion is segmented per second of their stamps (Hz); 0 '
        'means every image. Set it to 15 to save processor time; slow objects are then noticed '
        'later.',
        limits=(0.0, 1000.0),
    )
    in_front: bool = param(
        default=True,  # docs/results/ablation.md, slow-6
        description='Whether a surface in front of the depth of earlier images is evidence of a '
        'moving object. Set it to false when poor depth makes static surface seem to move.',
        read_only=False,
    )
    off_course: bool = param(
        default=True,  # docs/results/ablation.md, carry-screen
        description='Whether points whose image motion contradicts the camera motion are evidence '
        'of a moving object. Set it to false when repetitive texture makes static surface seem to '
        'move.',
        read_only=False,
    )

    depth_decides: bool = param(
        default=True,  # docs/results/hand_held.md
        description='Whether earlier depth decides between two camera motions that both explain '
        'much of the image, as where a large screen shows a moving picture, for the strategies '
        'hoid+ (with motion.enabled) and motion. Set it to false when poor depth leads to a wrong '
        'choice.',
        read_only=False,
        internal=True,
    )

    num_points: ClassVar[int] = 300  # chosen: tracked points, one per 32x32 px of a VGA image
    # Chosen: longest time between the two positions of a tracked point that are compared. A longer
    # time reveals slower motion, but includes more drift of the poses.
    anchor_s: ClassVar[float] = 0.7
    # Chosen: time constant with which the evidence of motion decays.
    decay_s: ClassVar[float] = 1.0


@dataclass(frozen=True)
class FilterConfig(Config):
    """Parameters of the filter: the strategy that classifies objects, and feature extraction."""

    strategy: str = param(
        'hoid+',  # docs/results/strategies.md
        'How dynamic objects are identified. Choose hoid+ to remove people, the objects that they '
        'handle, and other regions that move; motion to remove all regions that move, without a '
        'detector; hoid2d or hoid3d for the rules of the HOID paper; person to remove people '
        'only; descriptor for comparisons.',
        choices=STRATEGIES,
    )
    dynamic_classes: tuple[str, ...] = param(
        HANDLED_CLASSES,
        'Classes of objects that are dynamic when a person handles them; empty: all. Add the '
        'objects that people carry where the robot works.',
    )
    min_interaction_area: float = param(
        0.4,  # the HOID paper, which found 0.2 to 0.4 best
        "Ratio of an object's box, from 0 to 1, of which a person's box must cover more for the "
        'object to count as handled. Lower it when carried objects stay in the map; raise it '
        'when objects are removed that people only pass.',
        limits=(0.0, 1.0),
        read_only=False,
    )
    depth_limit_m: float = param(
        0.2,  # the HOID paper
        'Greatest depth difference between a person and an object that the person handles (m), '
        'for hoid3d, and for hoid+ if the object is behind the person (in front: 0.6 m). Raise it '
        'when objects at the end of an outstretched arm stay in the map; lower it when objects '
        'behind people are removed.',
        limits=(0.0, 10.0),
        read_only=False,
    )
    prediction_limit_s: float = param(
        0.5,  # covers a detector that is late by up to 500 ms (decision 031)
        'Longest time for which boxes are predicted while the detector sends no message (s). '
        'Raise it, with detections.wait_s, for a slower detector; lower it when features are '
        'removed where people have been.',
        limits=(0.0, 10.0),
        read_only=False,
        expert=True,
    )
    extraction: ExtractionConfig = section(ExtractionConfig)
    plus: PlusConfig = section(PlusConfig, expert=True)
    motion: MotionConfig = section(MotionConfig, expert=True)

    # Chosen, more than detectors return: only this many boxes of an image, those with the highest
    # scores, are used.
    max_detections: ClassVar[int] = 300
    # Chosen: side of the square at the center of a box whose median depth is the object's depth.
    sample_box_px: ClassVar[int] = 10

    def may_be_handled(self, class_name: str) -> bool:
        """Return whether objects of a class become dynamic when a person handles them.

        This holds for the classes in `dynamic_classes` or, if it names only person, for all
        others.
        """
        return class_name in self._handled or (not self._handled and class_name != PERSON)

    @cached_property
    def _handled(self) -> frozenset[str]:
        return frozenset(self.dynamic_classes) - {PERSON}


@dataclass(frozen=True)
class DetectionInputConfig(Config):
    """Parameters of how images and detections are matched in time."""

    wait_s: float = param(
        0.5,  # covers a detector that is late by up to 500 ms (decision 031)
        "Longest time that an image's final classification waits for its detections, and that "
        "features wait for the detector's first message (s). Raise it, with "
        'prediction_limit_s, for a slower detector.',
        limits=(0.0, 10.0),
        read_only=False,
        expert=True,
    )
    as_vision_msgs: bool = param(
        default=False,
        description='Whether to subscribe to vision_msgs/Detection2DArray on detections_2d '
        'instead of hoid_msgs/DetectionArray on detections. Set it to true for another detector; '
        'its class_id must be the class name.',
        expert=True,
    )
    timeout_s: float = param(
        2.0,  # chosen: four times the longest delay of a detector in decision 031
        'The detector counts as lost when images have arrived for longer than this time without a '
        'message from it (s).',
        limits=(0.1, 3600.0),
        read_only=False,
        expert=True,
    )
    on_loss: str = param(
        UNFILTERED,
        'What to do when the detector is lost: unfiltered keeps publishing features, also those '
        'on people, stop publishes nothing. Choose stop where a map with people in it is worse '
        'than no odometry.',
        choices=(UNFILTERED, STOP),
        read_only=False,
    )


@dataclass(frozen=True)
class FilterNodeConfig(NodeConfig, FilterConfig):
    """Parameters of the filter node."""

    sync_slop_s: float = param(
        0.02,  # chosen: less than the 33 ms between two images of a camera
        'Largest difference between the stamps of a color image and its depth image (s). Raise it '
        'when /diagnostics counts dropped color and depth images; images that were not taken '
        'together may then be paired.',
        limits=(0.0, 1.0),
    )
    detections: DetectionInputConfig = section(DetectionInputConfig)
