"""Parameters of the dense map and the navigation grid."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import ClassVar

from hoid_common.config import Config, param, section
from hoid_common.errors import ConfigError

# Chosen: readings beyond this depth are not used. Readings between the range of the map
# (`max_depth_m`) and this depth add no surface; they only show that the space in front of them is
# free, for which any accuracy is enough.
CARVE_RANGE_M = 12.0


@dataclass(frozen=True)
class GridConfig(Config):
    """Projection of the dense map onto a grid for navigation."""

    resolution_m: float = param(
        0.05,  # the default of Nav2's costmaps
        'Side of a cell of grid_map (m). Larger cells make the messages smaller and close narrow '
        'passages; cells smaller than dense.voxel_m leave gaps.',
        limits=(0.01, 1.0),
        read_only=False,
        expert=True,
    )
    min_height_m: float = param(
        0.10,  # chosen: above the noise of the floor, and above thresholds and carpets
        'Height above the floor up to which points count as floor (m). Raise it if free floor is '
        'marked as occupied; lower it if low obstacles are missing.',
        limits=(0.0, inf),
        read_only=False,
        expert=True,
    )
    max_height_m: float = param(
        1.80,
        'Height above the floor above which points are not obstacles (m), more than '
        'dense.grid.min_height_m. Set it to a little more than the height of the robot: a '
        'higher value closes passages that the robot fits through.',
        limits=(0.05, inf),
        read_only=False,
    )
    # Height above the floor (m) up to which the space above a cell must have been seen empty
    # before the cell counts as free. Chosen: a little more than the height of a table, since the
    # floor below a table is often seen before its top.
    clear_height_m: ClassVar[float] = 0.8

    def __post_init__(self) -> None:
        """Raise ConfigError if a value is invalid, or the range of obstacle heights is empty."""
        super().__post_init__()
        if self.min_height_m >= self.max_height_m:
            raise ConfigError(
                f'grid.min_height_m, {self.min_height_m:g}, must be less than grid.max_height_m, '
                f'{self.max_height_m:g}'
            )


@dataclass(frozen=True)
class DenseConfig(Config):
    """Fusion of depth images into colored voxels (decision 022)."""

    enabled: bool = param(
        default=True,
        description='Whether to fuse depth images into cloud_map and grid_map. Set it to false to '
        'save time and memory if only poses, people and objects are needed.',
    )
    rate_hz: float = param(
        3.0,  # chosen: an image costs 20 ms (decision 022), so 6 % of a core
        'Largest rate at which images are fused (Hz). Raise it to complete the map sooner.',
        limits=(0.1, 30.0),
        read_only=False,
        expert=True,
    )
    voxel_m: float = param(
        0.025,  # chosen: half a cell of the grid
        'Side of a voxel (m). Raise it to save memory, lower it to map more detail. A saved dense '
        'map needs the value that it was made with.',
        limits=(0.005, 0.5),
        expert=True,
    )
    max_depth_m: float = param(
        3.5,  # chosen: the noise of depth grows with its square (decision 002)
        'Depth beyond which readings add no surface to the dense map (m). Raise it to map more of '
        'a large room, with more noise.',
        limits=(0.5, CARVE_RANGE_M),
        expert=True,
    )
    pixel_stride: int = param(
        2,  # chosen: at 3.5 m two pixels of a 640-pixel image are 1.3 cm apart, half a voxel
        'Step between the rows and columns of the depth image that are fused (pixels); 1 uses '
        'all pixels. A larger step saves time and leaves holes in distant surfaces.',
        limits=(1, 8),
        internal=True,
    )
    max_voxels: int = param(
        3_000_000,  # chosen: 120 MB
        'Largest number of voxels in memory, which take 40 bytes each. The parts of the dense map '
        'that are farthest from the camera are kept in a temporary file. Lower it to save memory.',
        limits=(1000, inf),
        expert=True,
    )
    publish_period_s: float = param(
        2.0,  # chosen, for a display; a cloud of a room has several MB
        'Usual time between two messages on cloud_map and grid_map (s), which are sent when the '
        'dense map has changed. It is longer if making them takes more than a fifth of it.',
        limits=(0.1, 3600.0),
        read_only=False,
        expert=True,
    )
    grid: GridConfig = section(GridConfig)

    # Not tuned: pixels this near to the box of a dynamic object are not fused.
    mask_margin_px: ClassVar[int] = 16
    # Chosen: two voxels of the default size. Space counts as free up to this distance plus the
    # standard deviation of depth before the measured surface, so that noise does not remove voxels
    # of the surface itself.
    carve_margin_m: ClassVar[float] = 0.05
    # Not tuned: a voxel is published only if its hits are at least this share of the images that
    # measured static surface near it. A hit is an image that measured the surface within half a
    # voxel plus the standard deviation of depth. Images that see through the voxel are not
    # counted in the share, but remove hits.
    min_hit_share: ClassVar[float] = 0.5
    # Number of images that must agree before a voxel is published. A larger number removes noise
    # and passers-by, and shows surfaces later (not tuned).
    min_views: ClassVar[int] = 3
