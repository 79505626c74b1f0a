"""Parameters of the filter: the only place of their defaults."""

from __future__ import annotations

from dataclasses import dataclass

from hoid_common.config import Config, param

STRATEGIES = ('none', 'person', 'hoid2d', 'hoid3d', 'descriptor')

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
        1000, 'Features per frame, spread over the unmasked image', minimum=50, maximum=20000
    )
    num_levels: int = param(8, 'Levels of the image pyramid', minimum=1, maximum=16)
    scale_factor: float = param(1.2, 'Scale between two levels', minimum=1.01, maximum=2.0)
    fast_threshold: int = param(
        7, 'Grey-level contrast that makes a corner', minimum=1, maximum=100
    )
    border_px: int = param(19, 'Margin without features, at every level', minimum=16, maximum=100)


@dataclass(frozen=True)
class DescriptorConfig(Config):
    """The strategy `descriptor`."""

    window_px: int = param(
        40, 'Side of the square window around a key point', minimum=1, maximum=1000,
        read_only=False,
    )  # fmt: skip
    distance_m: float = param(
        0.3, 'Person and object are this near in depth', minimum=0.0, maximum=10.0, read_only=False
    )


@dataclass(frozen=True)
class FilterConfig(Config):
    """What is removed from the image before tracking, and how features are found."""

    strategy: str = param('hoid2d', 'How dynamic objects are told', choices=STRATEGIES)
    dynamic_classes: tuple[str, ...] = param(
        HANDLED_CLASSES, 'Classes that move when a person handles them; empty = every class'
    )
    min_interaction_area: float = param(
        0.4,
        'An object is handled when a person covers more than this share of its box',
        minimum=0.0,
        maximum=1.0,
        read_only=False,
    )
    depth_limit_m: float = param(
        0.2,
        'hoid3d: and their sample boxes differ by less than this in depth',
        minimum=0.0,
        maximum=10.0,
        read_only=False,
    )
    sample_box_px: int = param(
        10, 'Side of the sample box at the centre of a box', minimum=1, maximum=200
    )
    max_detections: int = param(
        300, 'Detections beyond this many, in falling order of score, are refused', minimum=1,
        maximum=10000,
    )  # fmt: skip
    prediction_limit_s: float = param(
        0.5, 'How long boxes are predicted when the detector says nothing', minimum=0.0,
        maximum=10.0, read_only=False,
    )  # fmt: skip
    extraction: ExtractionConfig = ExtractionConfig()
    descriptor: DescriptorConfig = DescriptorConfig()
