"""Parameters of the filter: the only place of their defaults."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

from hoid_common.config import Config, param, section
from hoid_common.values import PERSON

STRATEGIES = ('none', 'person', 'hoid2d', 'hoid3d', 'descriptor', 'motion', 'hoid+')
WITHOUT_DETECTOR = ('none', 'motion')

# COCO classes that people pick up, push or carry indoors.
HANDLED_CLASSES = (
    'chair', 'book', 'cup', 'bottle', 'wine glass', 'bowl', 'laptop', 'keyboard', 'mouse',
    'cell phone', 'remote', 'backpack', 'handbag', 'suitcase', 'sports ball', 'umbrella',
    'teddy bear', 'potted plant', 'tv', 'vase', 'scissors', 'tie', 'frisbee', 'skateboard',
    'tennis racket', 'baseball bat', 'toothbrush', 'hair drier', 'clock', 'box',
)  # fmt: skip


@dataclass(frozen=True)
class ExtractionConfig(Config):
    """ORB extraction."""

    num_features: int = param(
        1000,
        'Number of features of an image, spread over what is not masked. Raise it in scenes with '
        'little texture, lower it to save time.',
        minimum=50,
        maximum=20000,
    )
    num_levels: int = param(
        8, 'Number of levels of the image pyramid.', minimum=1, maximum=16, expert=True
    )
    scale_factor: float = param(
        1.2, 'Ratio of the scales of two levels of the pyramid, a plain number.',
        minimum=1.01, maximum=2.0, expert=True,
    )  # fmt: skip
    fast_threshold: int = param(
        7, 'Contrast that makes a corner (grey levels).', minimum=1, maximum=100, expert=True
    )
    refill: bool = param(
        default=True,
        description='Spreads the budget of features over what is not masked; without it, over the '
        'whole image, after which masked features are dropped as in the paper.',
        expert=True,
    )

    edge_radius: float = param(
        0.0,
        'How near to an edge of depth no depth is believed, as a share of the width of the '
        'image; 0 believes all. A few pixels are best in homes where nobody is.',
        minimum=0.0,
        maximum=0.05,
        expert=True,
    )

    # Share of the depth by which readings differ at an edge.
    edge_step: ClassVar[float] = 0.05
    border_px: ClassVar[int] = 19  # margin without features at every level: a descriptor's reach


@dataclass(frozen=True)
class PlusConfig(Config):
    """The strategy `hoid+`: what it adds to the paper, each part with a switch."""

    bridge_misses: bool = param(
        default=True,
        description='Predicts the boxes of people and handled objects that the detector misses.',
        read_only=False,
    )
    coast_s: float = param(
        0.4, 'How long a missed box is predicted (s).', minimum=0.0, maximum=10.0, read_only=False
    )
    doubt_large_people: bool = param(
        default=True,
        description='Does not believe a weak person over most of the image at once.',
        read_only=False,
    )
    remember: bool = param(
        default=True,
        description='Remembers who was handled, with hysteresis, until it was seen at rest.',
        read_only=False,
    )
    rest_s: float = param(
        1.0, 'How long an object is seen untouched before it counts as at rest (s).',
        minimum=0.0, maximum=60.0,
    )  # fmt: skip
    chains: bool = param(
        default=True,
        description='Takes what lies on a handled object for handled, too.',
        read_only=False,
    )
    reach_m: float = param(
        0.6,
        'How far before a torso a handled object may be; behind it, depth_limit_m holds (m).',
        minimum=0.0,
        maximum=10.0,
    )
    keep_background: bool = param(
        default=True,
        description='Masks what depth shows to be the person or object, not its whole box.',
        read_only=False,
    )
    fall_back: bool = param(
        default=True,
        description='Unmasks in steps rather than leave too few features.',
        read_only=False,
    )

    doubt_area: ClassVar[float] = 0.4  # share of the image that makes a weak person doubtful
    doubt_score: ClassVar[float] = 0.5  # below which a person is weak
    doubt_detections: ClassVar[int] = 4  # in a row that make a doubtful person believed
    # Share of a handled object that a person must cover, else it is let go.
    release_area: ClassVar[float] = 0.2
    # How far a person reaches before and behind the torso's depth, and an object its middle.
    person_depth_m: ClassVar[float] = 0.45
    object_depth_m: ClassVar[float] = 0.25
    # Corners with depth outside the mask that are too few, as a share of num_features.
    min_static_share: ClassVar[float] = 0.1


@dataclass(frozen=True)
class MotionConfig(Config):
    """What moves without being detected: the strategy `motion`, and a part of `hoid+`."""

    enabled: bool = param(
        default=True,
        description='Masks what moves and is not detected, in hoid+.',
        read_only=False,
    )
    in_front: bool = param(
        default=True,
        description='Takes for evidence what is in front of what was seen earlier.',
        read_only=False,
    )
    off_course: bool = param(
        default=True,
        description='Takes for evidence points that do not go as the camera makes them.',
        read_only=False,
    )

    num_points: ClassVar[int] = 300  # that are followed from image to image
    anchor_s: ClassVar[float] = 0.7  # in which a point is held against where it was seen first
    fade_s: ClassVar[float] = 1.0  # in which a belief fades that nothing speaks for


@dataclass(frozen=True)
class FilterConfig(Config):
    """What is removed from the image before tracking, and how features are found."""

    strategy: str = param(
        'hoid+',
        'Rule by which dynamic objects are told. Choose hoid2d or hoid3d for the rules of the '
        'paper, person to remove people only, none to remove nothing.',
        choices=STRATEGIES,
    )
    dynamic_classes: tuple[str, ...] = param(
        HANDLED_CLASSES,
        'Names of the classes that move when a person handles them; an empty list means every '
        'class. Add what people carry about where the robot works.',
    )
    min_interaction_area: float = param(
        0.4,
        'An object is handled when a person covers more than this share of its box. Lower it when '
        'carried objects stay in the map, raise it when things that people pass in front of go.',
        minimum=0.0,
        maximum=1.0,
        read_only=False,
    )
    depth_limit_m: float = param(
        0.2,
        'An object is handled when it also differs by less than this in depth from the person, '
        'by hoid3d and hoid+ (m). Raise it for people who reach far.',
        minimum=0.0,
        maximum=10.0,
        read_only=False,
    )
    max_detections: int = param(
        300, 'Number of detections beyond which those of lower score are refused.',
        minimum=1, maximum=10000, expert=True,
    )  # fmt: skip
    prediction_limit_s: float = param(
        0.5, 'How long boxes are predicted while the detector says nothing (s).',
        minimum=0.0, maximum=10.0, read_only=False, expert=True,
    )  # fmt: skip
    extraction: ExtractionConfig = section(ExtractionConfig)
    plus: PlusConfig = section(PlusConfig, expert=True)
    motion: MotionConfig = section(MotionConfig, expert=True)

    sample_box_px: ClassVar[int] = 10  # side of the sample box of depth at the centre of a box

    @property
    def needs_detections(self) -> bool:
        """Return whether the strategy looks at boxes at all."""
        return self.strategy not in WITHOUT_DETECTOR

    @property
    def senses_motion(self) -> bool:
        """Return whether what moves is looked for beside what is detected."""
        return self.strategy == 'motion' or (self.strategy == 'hoid+' and self.motion.enabled)

    def may_be_handled(self, class_name: str) -> bool:
        """Return whether a thing of the class moves when a person handles it."""
        return class_name in self._handled or (not self._handled and class_name != PERSON)

    @cached_property
    def _handled(self) -> frozenset[str]:
        return frozenset(self.dynamic_classes) - {PERSON}
