"""Parameters of the filter: the only place of their defaults."""

from __future__ import annotations

from dataclasses import dataclass

from hoid_common.config import Config, param


@dataclass(frozen=True)
class ExtractionConfig(Config):
    """ORB extraction."""

    num_features: int = param(
        1000,
        'Features per frame, spread over the part of the image not masked',
        minimum=50,
        maximum=20000,
    )
    num_levels: int = param(8, 'Levels of the image pyramid', minimum=1, maximum=16)
    scale_factor: float = param(1.2, 'Scale between two levels', minimum=1.01, maximum=2.0)
    fast_threshold: int = param(
        7, 'Grey-level contrast that makes a corner', minimum=1, maximum=100
    )
    num_candidates: int = param(
        3000, 'Corners from which the spread-out features are chosen', minimum=50, maximum=100000
    )
    border_px: int = param(19, 'Margin without features, at every level', minimum=16, maximum=100)
