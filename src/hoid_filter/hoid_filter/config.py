"""Parameters of the filter, with their defaults, ranges and descriptions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

from hoid_common.config import Config, param, section
from hoid_common.values import PERSON
from hoid_filter.strategy_registry import STRATEGIES

# Chosen: the COCO classes that people pick up, push or carry indoors, and boxes.
HANDLED_CLASSES = (
    'chair', 'book', 'cup', 'bottle', 'wine glass', 'bowl', 'laptop', 'keyboard', 'mouse',
    'cell phone', 'remote', 'backpack', 'handbag', 'suitcase', 'sports ball', 'umbrella',
    'teddy bear', 'potted plant', 'tv', 'vase', 'scissors', 'tie', 'frisbee', 'skateboard',
    'tennis racket', 'baseball bat', 'toothbrush', 'hair drier', 'clock', 'box',
)  # fmt: skip


@dataclass(frozen=True)
class ExtractionConfig(Config):
    """ORB extraction. The defaults of the pyramid and FAST are those of ORB-SLAM3."""

    num_features: int = param(
        1000,  # ORB-SLAM3, TUM1.yaml
        'Number of features per image, distributed over its unmasked part. Raise it in scenes '
        'with little texture, lower it to save time.',
        minimum=50,
        maximum=20000,
    )
    num_levels: int = param(
        8,  # ORB-SLAM3, TUM1.yaml
        'Number of levels of the image pyramid.',
        minimum=1,
        maximum=16,
        expert=True,
    )
    scale_factor: float = param(
        1.2,  # ORB-SLAM3, TUM1.yaml
        'Ratio of the scales of two successive pyramid levels (a plain number).',
        minimum=1.01,
        maximum=2.0,
        expert=True,
    )
    refill: bool = param(
        default=True,  # decision 14
        description='Distributes the number of features over the unmasked part of the image. '
        'When it is off, they are distributed over the whole image and then masked, as in the '
        'paper.',
        expert=True,
    )

    border_px: ClassVar[int] = 19  # margin of all levels: the reach of a rotated descriptor patch
    # Smallest contrast of a FAST corner [gray levels] (ORB-SLAM3, TUM1.yaml: its lower
    # threshold, for cells without strong corners).
    fast_threshold: ClassVar[int] = 7


@dataclass(frozen=True)
class PlusConfig(Config):
    """The strategy `hoid+`: its additions to the rules of the paper, each with a switch."""

    bridge_misses: bool = param(
        default=True,  # ablation of masks: without it 15 times as many moving corners are kept
        description='Predicts the boxes of people and handled objects that the detector misses.',
        read_only=False,
    )
    coast_s: float = param(
        0.4,  # chosen: 12 images at 30 Hz
        'Longest time for which a missed box is predicted (s).',
        minimum=0.0,
        maximum=10.0,
        read_only=False,
    )
    doubt_large_people: bool = param(
        default=True,  # ablation, false_every=10: ATE 0.0068 m with it, 0.0154 m without
        description='Ignores a person of low score over most of the image until it has been '
        'detected several times in a row.',
        read_only=False,
    )
    remember: bool = param(
        default=True,  # ablation of masks: without it 2 to 10 times as many moving corners
        description='Keeps an object dynamic after it was handled, until it has been seen at '
        'rest, and lowers the overlap at which it stays handled.',
        read_only=False,
    )
    keep_background: bool = param(
        default=True,  # ablation, carry-screen: ATE 0.0034 m with it, 0.0215 m without
        description='Masks only the part of a box that depth shows to be the person or object, '
        'instead of the whole box.',
        read_only=False,
    )

    # Chosen: a false person covers more of the image than this, with a lower score than this, and
    # rarely in so many images in a row.
    doubt_area: ClassVar[float] = 0.4
    doubt_score: ClassVar[float] = 0.5
    doubt_detections: ClassVar[int] = 4
    # Chosen: half of `min_interaction_area`. An object stays handled while a person covers more.
    release_area: ClassVar[float] = 0.2
    # Chosen: greatest depth difference from a person's torso, or from the middle of an object, to
    # a pixel of the same.
    person_depth_m: ClassVar[float] = 0.45
    object_depth_m: ClassVar[float] = 0.25
    # Greatest distance of a handled object before the torso of a person (m); behind it,
    # depth_limit_m holds (chosen: the length of an arm).
    reach_m: ClassVar[float] = 0.6
    # An object is at rest after it has been seen untouched for this time [s] (chosen, not
    # tuned).
    rest_s: ClassVar[float] = 1.0


@dataclass(frozen=True)
class MotionConfig(Config):
    """Motion segmentation without a detector: the strategy `motion`, and a part of `hoid+`."""

    enabled: bool = param(
        default=True,  # ablation: crowd 0.0019 m with it, 0.0022 m without
        description='Masks undetected moving regions in hoid+.',
        read_only=False,
    )
    in_front: bool = param(
        default=True,  # ablation, slow-6: ATE 0.0034 m with it, 0.0075 m without
        description='Uses surface in front of what earlier images showed as evidence of a moving '
        'object.',
        read_only=False,
    )
    off_course: bool = param(
        default=True,  # ablation, carry-screen: ATE 0.0026 m with it, 0.6272 m without
        description='Uses points whose image motion contradicts the camera motion as evidence of '
        'a moving object.',
        read_only=False,
    )

    num_points: ClassVar[int] = 300  # chosen: tracked points, one per 32x32 px of a VGA image
    # Chosen: greatest age of the position that a tracked point is compared with. A longer time
    # shows slower motion, but adds the drift of the poses.
    anchor_s: ClassVar[float] = 0.7
    decay_s: ClassVar[float] = 1.0  # chosen: time constant in which evidence decays


@dataclass(frozen=True)
class FilterConfig(Config):
    """The strategy that classifies objects, and the extraction of features."""

    strategy: str = param(
        'hoid+',  # docs/results/strategies.md
        'How dynamic objects are identified. Choose hoid2d or hoid3d for the rules of the paper, '
        'person to remove people only, none to remove nothing. Other packages may add strategies.',
        choices=STRATEGIES,
    )
    dynamic_classes: tuple[str, ...] = param(
        HANDLED_CLASSES,
        'Classes of objects that are dynamic when a person handles them; an empty list means all '
        'classes. Add the objects that people carry where the robot works.',
    )
    min_interaction_area: float = param(
        0.4,  # the HOID paper, which found 0.2 to 0.4 best
        "An object is handled when a person's box covers more than this share of its box. Lower "
        'it when carried objects stay in the map, raise it when objects that people only pass in '
        'front of are removed.',
        minimum=0.0,
        maximum=1.0,
        read_only=False,
    )
    depth_limit_m: float = param(
        0.2,  # the HOID paper
        'By hoid3d and hoid+, an object is handled only when its depth differs by less than this '
        'from that of the person (m). Raise it for people who reach far.',
        minimum=0.0,
        maximum=10.0,
        read_only=False,
    )
    max_detections: int = param(
        300,  # chosen: more than detectors return
        'Greatest number of detections per image; those of lowest score beyond it are refused.',
        minimum=1,
        maximum=10000,
        internal=True,
    )
    prediction_limit_s: float = param(
        0.5,  # covers a detector that is late by up to 500 ms (decision 31)
        'Longest time for which boxes are predicted while the detector sends nothing (s).',
        minimum=0.0,
        maximum=10.0,
        read_only=False,
        expert=True,
    )
    extraction: ExtractionConfig = section(ExtractionConfig)
    plus: PlusConfig = section(PlusConfig, expert=True)
    motion: MotionConfig = section(MotionConfig, expert=True)

    sample_box_px: ClassVar[int] = 10  # chosen: side of the box whose median depth is sampled

    def may_be_handled(self, class_name: str) -> bool:
        """Return whether objects of a class are dynamic when a person handles them."""
        return class_name in self._handled or (not self._handled and class_name != PERSON)

    @cached_property
    def _handled(self) -> frozenset[str]:
        return frozenset(self.dynamic_classes) - {PERSON}
