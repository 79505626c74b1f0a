"""Configuration of the dense map and the navigation grid."""

from __future__ import annotations

from dataclasses import dataclass, field

from hoid_common.config import Config, param
from hoid_common.errors import ConfigError


@dataclass(frozen=True)
class GridConfig(Config):
    """Projection of the dense map to a grid for navigation."""

    resolution_m: float = param(
        0.05, 'Side of a grid cell (m).', minimum=0.01, maximum=1.0, read_only=False
    )
    min_height_m: float = param(
        0.10, 'Points lower than this above the floor are no obstacle (m).', minimum=0.0,
        read_only=False,
    )  # fmt: skip
    max_height_m: float = param(
        1.80, 'Points higher than this above the floor are no obstacle (m).', minimum=0.05,
        read_only=False,
    )  # fmt: skip
    clear_height_m: float = param(
        0.8, 'A cell is free when the space over it was seen to be, up to this height (m).',
        minimum=0.0, maximum=3.0, read_only=False,
    )  # fmt: skip
    obstacle_margin_m: float = param(
        0.0, 'Obstacles reach so much farther than their points, means over voxels (m).',
        minimum=0.0, maximum=1.0, read_only=False,
    )  # fmt: skip
    min_obstacle_points: int = param(
        1, 'Voxels in a cell that make it occupied.', minimum=1, read_only=False
    )

    def __post_init__(self) -> None:
        """Raise ConfigError when nothing could be an obstacle."""
        super().__post_init__()
        if self.min_height_m >= self.max_height_m:
            raise ConfigError(
                f'grid.min_height_m, {self.min_height_m:g}, must be less than grid.max_height_m, '
                f'{self.max_height_m:g}'
            )


@dataclass(frozen=True)
class DenseConfig(Config):
    """Fusion of depth images into coloured voxels."""

    enabled: bool = param(True, 'Fuse depth images into `cloud_map` and `grid_map`.')
    rate_hz: float = param(
        3.0, 'Images fused per second, at most.', minimum=0.1, maximum=30.0, read_only=False
    )
    voxel_m: float = param(0.025, 'Side of a voxel (m).', minimum=0.005, maximum=0.5)
    max_depth_m: float = param(
        3.5, 'Farther readings are left out: noise grows with depth squared (m).', minimum=0.5
    )
    pixel_stride: int = param(
        2, 'Every n-th pixel and row of the depth image.', minimum=1, maximum=8
    )
    mask_margin_px: int = param(
        16, 'Pixels this near to a dynamic box are left out as well.', minimum=0
    )
    carve_margin_m: float = param(
        0.05, 'Free space ends this far before the measured surface (m).', minimum=0.01
    )
    min_views: int = param(3, 'Images that must agree before a voxel is shown.', minimum=1)
    min_hit_share: float = param(
        0.5,
        'Share of the images looking at a voxel that must have measured it.',
        minimum=0.0,
        maximum=1.0,
    )
    max_voxels: int = param(3_000_000, 'Memory bound; the least seen are dropped.', minimum=1000)
    max_views: int = param(
        150, 'Images kept for fusing anew after a loop closure, about 0.6 MB each.', minimum=1
    )
    publish_period_s: float = param(
        2.0, 'Cloud and grid are published at most so often (s).', minimum=0.1, maximum=3600.0,
        read_only=False,
    )  # fmt: skip
    grid: GridConfig = field(default_factory=GridConfig)
