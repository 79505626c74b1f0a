"""Parameters of the filter: the only place of their defaults."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from hoid_common.config import Config, param
from hoid_common.values import PERSON

STRATEGIES = ('none', 'person', 'hoid2d', 'hoid3d', 'descriptor', 'hoid+')

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
    refill: bool = param(
        True, 'Spread the budget over what is not masked; false: over all, then drop the masked'
    )
    border_px: int = param(19, 'Margin without features, at every level', minimum=19, maximum=100)
    edge_radius: float = param(
        0.0, 'A depth so near to an edge of depth is not believed, as a share of the '
        "image's width; 0 believes all", minimum=0.0, maximum=0.05,
    )  # fmt: skip
    edge_step: float = param(
        0.05, 'Share of the depth by which readings differ at an edge', minimum=0.0, maximum=1.0
    )


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
class PlusConfig(Config):
    """The strategy `hoid+`: what it adds to the paper, each part with a switch."""

    bridge_misses: bool = param(
        True, 'Predict the boxes of people and handled objects that are missed', read_only=False
    )
    coast_s: float = param(
        0.4, 'How long a missed box is predicted', minimum=0.0, maximum=10.0, read_only=False
    )
    doubt_large_people: bool = param(
        True, 'Do not believe a weak person over most of the image at once', read_only=False
    )
    doubt_area: float = param(
        0.4, 'Share of the image that makes a weak person doubtful', minimum=0.0, maximum=1.0
    )
    doubt_score: float = param(0.5, 'Score below which a person is weak', minimum=0.0, maximum=1.0)
    doubt_detections: int = param(
        4, 'Detections in a row that make a doubtful person believed', minimum=1, maximum=100
    )
    remember: bool = param(True, 'Hysteresis and memory of interaction', read_only=False)
    release_area: float = param(
        0.2, 'A handled object is let go when a person covers less than this share of it',
        minimum=0.0, maximum=1.0,
    )  # fmt: skip
    rest_s: float = param(
        1.0, 'How long an object is seen untouched before it counts as at rest',
        minimum=0.0, maximum=60.0,
    )  # fmt: skip
    chains: bool = param(True, 'What lies on a handled object is handled', read_only=False)
    reach_m: float = param(
        0.6, "How far before a torso a handled object may be; behind: depth_limit_m",
        minimum=0.0, maximum=10.0,
    )  # fmt: skip
    keep_background: bool = param(
        True,
        'Mask what depth shows to be the thing, not its whole box',
        read_only=False,
    )
    person_depth_m: float = param(
        0.45, "How far a person reaches before and behind the torso's depth",
        minimum=0.05, maximum=2.0,
    )  # fmt: skip
    object_depth_m: float = param(
        0.25, 'How far a handled object reaches before and behind its middle',
        minimum=0.05, maximum=2.0,
    )  # fmt: skip
    fall_back: bool = param(
        True, 'Unmask in steps rather than leave too few features', read_only=False
    )
    min_static_share: float = param(
        0.1, 'Corners with depth outside the mask that are too few, as a share of num_features',
        minimum=0.0, maximum=1.0,
    )  # fmt: skip


@dataclass(frozen=True)
class FilterConfig(Config):
    """What is removed from the image before tracking, and how features are found."""

    strategy: str = param('hoid+', 'How dynamic objects are told', choices=STRATEGIES)
    dynamic_classes: tuple[str, ...] = param(
        HANDLED_CLASSES, "Classes that move when a person handles them; empty or '' = every class"
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
    plus: PlusConfig = PlusConfig()

    def may_be_handled(self, class_name: str) -> bool:
        """Return whether a thing of the class moves when a person handles it."""
        return class_name in self._handled or (not self._handled and class_name != PERSON)

    @cached_property
    def _handled(self) -> frozenset[str]:
        # A parameter file cannot hold an empty list, but one with an empty name.
        return frozenset(self.dynamic_classes) - {'', PERSON}
