"""Configuration of the dense map and the navigation grid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from hoid_common.config import Config, param, section
from hoid_common.errors import ConfigError

FILE_MODES = ('trinary', 'scale', 'raw')
"""Of Nav2's map server."""


@dataclass(frozen=True)
class GridConfig(Config):
    """Projection of the dense map to a grid for navigation."""

    resolution_m: float = param(
        0.05, 'Side of a grid cell (m).',
        minimum=0.01, maximum=1.0, read_only=False, expert=True,
    )  # fmt: skip
    min_height_m: float = param(
        0.10, 'Height above the floor below which points are no obstacle (m).',
        minimum=0.0, read_only=False, expert=True,
    )  # fmt: skip
    max_height_m: float = param(
        1.80,
        'Height above the floor above which points are no obstacle (m). Set it to a little more '
        'than the height of the robot.',
        minimum=0.05,
        read_only=False,
    )
    clear_height_m: float = param(
        0.8, 'Height up to which the space over a cell must be seen empty for it to be free (m).',
        minimum=0.0, maximum=3.0, read_only=False, expert=True,
    )  # fmt: skip
    obstacle_margin_m: float = param(
        0.0, 'How much farther than their points, means over voxels, obstacles reach (m).',
        minimum=0.0, maximum=1.0, read_only=False, expert=True,
    )  # fmt: skip
    min_obstacle_points: int = param(
        1, 'Number of voxels in a cell that make it occupied.',
        minimum=1, read_only=False, expert=True,
    )  # fmt: skip

    file_mode: str = param(
        'trinary',
        "Mode of Nav2's map server in which grids are saved. Choose raw for numbers as in the "
        'message, scale for a picture whose unknown cells are transparent.',
        choices=FILE_MODES,
        expert=True,
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

    enabled: bool = param(
        default=True,
        description='Fuses depth images into cloud_map and grid_map, in a process of their own. '
        'Set it to false to save time and memory where only poses are needed.',
    )
    rate_hz: float = param(
        3.0, 'Images that are fused per second, at most (Hz).',
        minimum=0.1, maximum=30.0, read_only=False, expert=True,
    )  # fmt: skip
    voxel_m: float = param(0.025, 'Side of a voxel (m).', minimum=0.005, maximum=0.5, expert=True)
    max_depth_m: float = param(
        3.5, 'Depth beyond which readings are left out, as noise grows with its square (m).',
        minimum=0.5, expert=True,
    )  # fmt: skip
    pixel_stride: int = param(
        2, 'Every n-th pixel and row of the depth image is fused (pixels).',
        minimum=1, maximum=8, expert=True,
    )  # fmt: skip
    min_views: int = param(
        3, 'Number of images that must agree before a voxel is shown.', minimum=1, expert=True
    )
    max_voxels: int = param(
        3_000_000, 'Largest number of voxels, to bound the memory; the least seen are dropped.',
        minimum=1000, expert=True,
    )  # fmt: skip
    max_views: int = param(
        150, 'Number of images kept for fusing anew after a loop closure, about 0.6 MB each.',
        minimum=1, expert=True,
    )  # fmt: skip
    publish_period_s: float = param(
        2.0, 'Shortest time between two clouds or grids that are published (s).',
        minimum=0.1, maximum=3600.0, read_only=False, expert=True,
    )  # fmt: skip
    grid: GridConfig = section(GridConfig)

    mask_margin_px: ClassVar[int] = 16  # this near to a dynamic box, pixels are left out as well
    carve_margin_m: ClassVar[float] = 0.05  # free space ends this far before the surface
    # Share of the images looking at a voxel that must have measured it.
    min_hit_share: ClassVar[float] = 0.5
